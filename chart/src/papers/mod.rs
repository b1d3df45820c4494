//! The tables and figures of one paper each, made with its own algorithm or for its own question.
//!
//! | file | paper |
//! |---|---|
//! | [`ifl`] | \[IFL\]: block products as printed |
//! | [`ld09`] | \[LD09\]: lobes for glossy interreflections |
//! | [`uniform`] | \[LD09\] section 7: adaptive against uniform meshes |
//! | [`xjht06`] | \[XJHT06\]: lights in squares, and what moves |

pub mod ifl;
pub mod ld09;
pub mod uniform;
pub mod xjht06;
