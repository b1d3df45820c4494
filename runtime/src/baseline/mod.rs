//! Products that prelight's techniques are measured against. [`pixel_product`] is what all others mean; the rest is there to be beaten:
//! [`dense`] and [`lobe`] sum over texels, [`haar_triple`] over wavelets \[NRH04\], [`sh_product`] over spherical harmonics \[SKS02\], [`ifl`]
//! over blocks as the paper does \[IFL\].

pub mod dense;
pub mod haar_triple;
pub mod ifl;
pub mod lobe;
pub mod pixel_product;
pub mod sh_product;
#[cfg(target_arch = "x86_64")]
mod simd;
