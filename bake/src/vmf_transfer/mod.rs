//! Writes what `prelight_runtime::vmf_transfer` reads.

pub mod transfer;
