//! Environments: images of distant light, and the light that techniques prepare from them.
//!
//! ```text
//! .hdr, .exr ──decode, unwrap──> Environment ──splat──> LightCubemap (flux and moment per texel)
//!                                    ├── radiance(direction): the exact environment, constant per source pixel
//!                                    ├── filtered(direction, spread): what a picture shows behind everything
//!                                    └── EnvironmentSampler: directions by luminance × solid angle
//! ```
//!
//! Conventions: latitude-longitude images with rows from the top, linear Rec.709 radiance. The unit direction (x, y, z) is
//! read at u = atan2(z, x)/2π + ½, v = ½ − asin(y)/π from the top, and longitude wraps. So +X is the centre of the image,
//! +Z three quarters to the right, −X the seam and +Y the top row. `rotate_y_deg` turns the light right-handed about +Y: at 90,
//! what was at +X stands at −Z.

mod clean;
mod decode;
#[cfg(test)]
mod decode_tests;
mod encode;
mod exr;
mod filter;
mod image;
mod light_cubemap;
mod primaries;
mod procedural;
mod projection;
#[cfg(test)]
mod projection_tests;
mod radiance;
mod sampler;
mod scanline;
mod source;
mod splat;
#[cfg(test)]
mod splat_tests;

pub use clean::{CleanReport, MOST_RADIANCE};
pub use image::Environment;
pub use light_cubemap::{EnergyReport, LightCubemap};
pub use prelight_manifests::scene::Projection;
pub use procedural::{sky, studio};
pub use sampler::{EnvironmentSample, EnvironmentSampler};
pub use source::{Limits, MapOptions};
pub use splat::Splatter;
