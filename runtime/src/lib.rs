//! The thin half of prelight: **open, prepare, shade, draw**. Casts no ray and writes no chunk.
//!
//! An app needs [`Asset`], [`Relighter`], [`Camera`], [`Environment`] and [`LightCubemap`]:
//!
//! ```no_run
//! use prelight_runtime::{Asset, Camera, Environment, FrameOptions, LightCubemap, Limits, Relighter};
//!
//! # #[cfg(feature = "fs")]
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let asset = Asset::open_file("room.prelight".as_ref(), None)?;
//! let (environment, _) = Environment::decode("sky.hdr", &std::fs::read("sky.hdr")?, &Limits::default())?;
//! let mut relighter = Relighter::new(asset);
//! relighter.set_light(&LightCubemap::from_environment(&environment, relighter.asset().face_resolution()))?;
//! let camera = Camera::upright([0.0, 1.6, 4.0], [0.0, 1.0, 0.0], 45.0)?;
//! let frame = relighter.frame(&camera, [1280, 720], FrameOptions::default())?;
//! # let _ = frame;
//! # Ok(()) }
//! # #[cfg(not(feature = "fs"))]
//! # fn main() {}
//! ```
//!
//! The modules below are what bakes, charts and tests of this workspace need as well; they change without notice.
//!
//! Public APIs show plain arrays (`[f32; 3]`, `[f32; 16]` column-major), never the types of a math or graphics crate.
//! Right-handed, Y up, metres; linear Rec.709 radiance in W·sr⁻¹·m⁻².

pub mod asset;
pub mod baseline;
pub mod block_product;
pub mod bounces;
pub mod brdf;
pub mod camera;
pub mod chunk;
pub mod draw;
pub mod environment;
pub mod error;
pub mod light;
pub mod relight;
pub mod sphere;
pub mod square_light;
pub mod surface;
pub mod vmf_transfer;

pub use asset::{Aligned, Asset, AssetObject, AssetPatch};
pub use camera::{Camera, SceneCamera};
pub use draw::{Background, Frame, FrameOptions, Image, Style};
pub use environment::{CleanReport, Environment, LightCubemap, Limits, Splatter, sky, studio};
pub use error::RuntimeError;
pub use light::layer::{Bounces, Highlights, Indirect, Layer, LightOptions};
pub use light::{Accuracy, PointLobe};
pub use relight::{Backend, Cpu, LayerFactory, Relighter, Techniques, View};
pub use surface::{AlphaMode, Material, Model, TextureRef, Wrap};

// What signatures show of the crates below, so that an app depends on this one alone.
pub use prelight_manifests::{AssetManifest, ChunkKind, Descriptor, Digest, ManifestError};
#[cfg(feature = "fs")]
pub use prelight_store::Store;
pub use prelight_store::{Chunk, ChunkSource, MemorySource, StoreError};
