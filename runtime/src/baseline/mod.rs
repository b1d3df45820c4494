//! Products that prelight's techniques are measured against. [`pixel_product`] is what all others mean.

pub mod pixel_product;
