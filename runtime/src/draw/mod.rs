//! From shaded points to an image: camera, rasteriser, tone map, image files, metrics.

pub mod camera;
pub mod image;
