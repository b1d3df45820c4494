//! The only way to refer to a chunk: what it is, its digest, its size and its shape.

use crate::Digest;
use serde::{Deserialize, Serialize};

/// What a chunk holds. The layout of each is in the module of `prelight-runtime` that reads it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ChunkKind {
    /// Shading points of one patch.
    Points,
    /// Material parameters of one patch's points, averaged over each point's footprint.
    Surface,
    /// Which texels each point of one patch sees.
    Visibility,
    /// Light that reaches each point of one patch over other surfaces.
    Transfer,
    /// Refined triangle mesh of one object.
    Mesh,
    /// Materials of the asset, JSON.
    Materials,
    /// Texels of one texture.
    Texture,
    /// Cameras of the scene, JSON.
    Cameras,
    /// Names and extras of nodes and materials, JSON.
    Names,
    /// An image traced once and kept: reference of a chart.
    Image,
    /// Geometry of one object as its source gave it.
    Base,
    /// Measured surface: values over the angles of half and difference vector.
    Brdf,
}

/// Element type of a chunk's main array.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Dtype {
    /// Bytes, or a layout with a header of its own.
    U8,
    /// Little-endian unsigned 32-bit.
    U32,
    /// Little-endian IEEE 754 single precision.
    F32,
}

/// A reference to a chunk.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Descriptor {
    /// What the bytes mean.
    pub kind: ChunkKind,
    /// blake3 of the plain bytes.
    pub digest: Digest,
    /// Length of the plain bytes.
    pub bytes: u64,
    /// Element type.
    pub dtype: Dtype,
    /// Shape in memory order, outermost first. For layouts with a header: their leading count.
    pub shape: Vec<u64>,
}
