//! Products that prelight's techniques are measured against. [`pixel_product`] is what all others mean; [`dense`] is there to be beaten.

pub mod dense;
pub mod pixel_product;
#[cfg(target_arch = "x86_64")]
mod simd;
