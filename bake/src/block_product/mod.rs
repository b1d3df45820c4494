//! What a bake writes for block products.

pub mod visibility;
