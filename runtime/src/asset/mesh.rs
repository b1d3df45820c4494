//! Mesh chunk of an object: the refined triangles that draw rasterises, world space.
//!
//! Counts: `v` vertices, `t` triangles, `attributes` bits. Arrays: position `[v, 3]` f32; normal `[v, 3]` f32 (front side);
//! point_front `[v]` u32 and point_back `[v]` u32, point of the object or [`NO_POINT`]; triangles `[t, 3]` u32;
//! material `[t]` u32; then, each only if its bit is set: uv0 `[v, 2]` f32, uv1 `[v, 2]` f32, tangent `[v, 4]` f32
//! (w is the sign of the bitangent), color `[v, 4]` f32 linear.
//!
//! Vertices that differ only in texture coordinates share a point. Triangles wind counter-clockwise seen from the front.

use super::layout::{Reader, Writer};
use crate::error::RuntimeError;

const MAGIC: &[u8; 4] = b"PLMS";
const VERSION: u32 = 1;
const HAS_UV0: u32 = 1;
const HAS_UV1: u32 = 2;
const HAS_TANGENT: u32 = 4;
const HAS_COLOR: u32 = 8;

/// Marks a vertex without a point on that side.
pub const NO_POINT: u32 = u32::MAX;

/// The arrays of one object, borrowed. Optional ones are empty when absent.
#[derive(Clone, Copy, Debug, Default)]
pub struct Mesh<'a> {
    /// `[v]` world position, metres.
    pub position: &'a [[f32; 3]],
    /// `[v]` front shading normal, unit.
    pub normal: &'a [[f32; 3]],
    /// `[v]` the object's point that shades the front, or [`NO_POINT`].
    pub point_front: &'a [u32],
    /// `[v]` the object's point that shades the back, or [`NO_POINT`].
    pub point_back: &'a [u32],
    /// `[t]` vertex indices.
    pub triangles: &'a [[u32; 3]],
    /// `[t]` index into the asset's materials.
    pub material: &'a [u32],
    /// `[v]` first texture coordinates, or empty.
    pub uv0: &'a [[f32; 2]],
    /// `[v]` second texture coordinates, or empty.
    pub uv1: &'a [[f32; 2]],
    /// `[v]` tangent and bitangent sign, or empty.
    pub tangent: &'a [[f32; 4]],
    /// `[v]` linear RGBA, or empty.
    pub color: &'a [[f32; 4]],
}

impl<'a> Mesh<'a> {
    /// The chunk's bytes.
    pub fn to_chunk(&self) -> Vec<u8> {
        let bit = |present: bool, bit: u32| if present { bit } else { 0 };
        let attributes = bit(!self.uv0.is_empty(), HAS_UV0)
            | bit(!self.uv1.is_empty(), HAS_UV1)
            | bit(!self.tangent.is_empty(), HAS_TANGENT)
            | bit(!self.color.is_empty(), HAS_COLOR);
        let counts = [self.position.len() as u32, self.triangles.len() as u32, attributes, 0, 0, 0];
        Writer::new(MAGIC, VERSION, counts)
            .array(self.position)
            .array(self.normal)
            .array(self.point_front)
            .array(self.point_back)
            .array(self.triangles)
            .array(self.material)
            .array(self.uv0)
            .array(self.uv1)
            .array(self.tangent)
            .array(self.color)
            .finish()
    }

    /// Borrows from a chunk; `n_points` is the object's, which bounds the point indices.
    pub fn from_chunk(bytes: &'a [u8], n_points: u32) -> Result<Self, RuntimeError> {
        let mut reader = Reader::new("mesh", MAGIC, VERSION, bytes)?;
        let mesh = Self::borrow(&mut reader)?;
        let v = mesh.position.len();
        if mesh.triangles.iter().flatten().any(|i| *i as usize >= v) {
            return Err(reader.error("a triangle names a vertex that is not there"));
        }
        if mesh.point_front.iter().chain(mesh.point_back).any(|p| *p != NO_POINT && *p >= n_points) {
            return Err(reader.error("a vertex names a point that is not there"));
        }
        reader.finish()?;
        Ok(mesh)
    }

    /// Borrows again from a chunk that [`Mesh::from_chunk`] has proved: no second look at every index.
    ///
    /// Panics where even the header is wrong.
    pub(crate) fn from_proven_chunk(bytes: &'a [u8]) -> Self {
        let reader = Reader::new("mesh", MAGIC, VERSION, bytes);
        reader.and_then(|mut reader| Self::borrow(&mut reader)).expect("a chunk that was proved before")
    }

    /// The arrays as the header says, indices unseen.
    fn borrow(reader: &mut Reader<'a>) -> Result<Self, RuntimeError> {
        let [v, t, attributes, ..] = reader.counts;
        let (v, t) = (v as usize, t as usize);
        let optional = |bit: u32| if attributes & bit != 0 { v } else { 0 };
        Ok(Mesh {
            position: reader.array(v)?,
            normal: reader.array(v)?,
            point_front: reader.array(v)?,
            point_back: reader.array(v)?,
            triangles: reader.array(t)?,
            material: reader.array(t)?,
            uv0: reader.array(optional(HAS_UV0))?,
            uv1: reader.array(optional(HAS_UV1))?,
            tangent: reader.array(optional(HAS_TANGENT))?,
            color: reader.array(optional(HAS_COLOR))?,
        })
    }
}
