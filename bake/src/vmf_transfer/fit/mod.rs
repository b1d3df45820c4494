//! Fits: from paths or numeric slices to few parameters.
//!
//! | file | what |
//! |---|---|
//! | [`vmf`] | one lobe from weighted directions, in closed form |
//! | [`mixture`] | several lobes from weighted directions, by soft expectation maximisation |
//! | `harmonics`, in tests | spherical harmonics of paths and of lobes, and what each costs |
//! | [`thin`] | which slices need not be stored |
//! | [`mod@slice`] | lobes of a BRDF's slice in the least-squares sense |

#[cfg(test)]
mod harmonics;
pub mod mixture;
pub mod slice;
pub mod thin;
pub mod vmf;

#[cfg(test)]
mod transfer_tests;
