//! From shaded points to an image: camera, rasteriser, tone map, image files, metrics.
//!
//! [`raster::Visibility`] finds what each sample sees, [`shade::draw_visible`] turns light at points into an [`image::Image`].

pub use crate::camera;
pub mod at_points;
pub mod flip;
pub mod framing;
pub mod image;
pub mod metrics;
pub mod options;
pub mod raster;
pub mod shade;
mod threads;
pub mod tonemap;

#[cfg(test)]
mod framing_tests;
#[cfg(test)]
mod raster_tests;
#[cfg(test)]
mod shade_tests;

pub use crate::camera::{Camera, CameraRays, SceneCamera};
pub use at_points::{PointImage, draw_at_points};
pub use framing::automatic_view;
pub use image::Image;
pub use metrics::{Metrics, Scores};
pub use options::{Background, FrameOptions, Style};
pub use raster::Visibility;
pub use shade::{DrawObject, DrawScene, Frame, draw, draw_visible};
