//! Visibility of a patch: which directions each point sees, traced, compared and written.
//!
//! | file | what |
//! |---|---|
//! | [`baker`], `retrace`, `buried` | the factor: patches looked up, traced or taken over, and asked for buried points |
//! | [`patch`] | one patch: which of its tiles hold, and what the others are |
//! | [`bits`], [`gray`] | the open texels of a patch while it is traced, binary and grayscale |
//! | [`delta`] | a patch of an earlier bake, traced again only where an edit may have changed it |
//! | [`encode`] | the chunk that the runtime reads |
//! | [`difference`], [`border`] | how much two points differ, and which edges borders of shadows cross |

pub mod baker;
pub mod bits;
pub mod border;
mod buried;
pub mod delta;
pub mod difference;
pub mod encode;
pub mod gray;
pub mod patch;
mod retrace;
