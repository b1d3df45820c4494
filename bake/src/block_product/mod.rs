//! The technique `block_product`: what a bake writes for it.

pub mod visibility;
