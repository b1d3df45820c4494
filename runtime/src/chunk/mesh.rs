//! Mesh chunk of an object: the refined triangles that draw rasterises, world space.
//!
//! Counts: `v` vertices, `t` triangles, `attributes` bits. Arrays: position `[v, 3]` f32; normal `[v, 3]` f32 (front side);
//! point_front `[v]` u32 and point_back `[v]` u32, point of the object or [`NO_POINT`]; triangles `[t, 3]` u32;
//! material `[t]` u32; then, each only if its bit is set: uv0 `[v, 2]` f32, uv1 `[v, 2]` f32, tangent `[v, 4]` f32
//! (w is the sign of the bitangent), color `[v, 4]` f32 linear.
//!
//! Vertices that differ only in texture coordinates share a point. Triangles wind counter-clockwise seen from the front.
//!
//! **Coarser than the mesh** (version 2, written only where a vertex needs it): a vertex may have no point of its own but a [`Blend`] of up
//! to four. Its point_front or point_back is then [`BLENDED`] plus the index of the blend, and one more array ends the chunk: `[b]` of
//! points `[4]` u32 and weights `[4]` f32, b being the fourth count. Lossy: what is shown there is a mean of what is baked around it.

use super::layout::{Reader, Writer, are_directions, are_moderate};
use crate::error::RuntimeError;
use bytemuck::{Pod, Zeroable};

const MAGIC: &[u8; 4] = b"PLMS";
/// Without blends.
const VERSION: u32 = 1;
/// With blends.
const BLENDED_VERSION: u32 = 2;
const HAS_UV0: u32 = 1;
const HAS_UV1: u32 = 2;
const HAS_TANGENT: u32 = 4;
const HAS_COLOR: u32 = 8;

/// Marks a vertex without a point on that side.
pub const NO_POINT: u32 = u32::MAX;

/// From here up to [`NO_POINT`], the rest of a vertex's point is the index of a [`Blend`].
pub const BLENDED: u32 = 1 << 31;

/// Light of a vertex that has no point of its own: a mean of up to four points of the object on the same side.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Blend {
    /// Points of the object; unused ones repeat the first and weigh nothing.
    pub points: [u32; 4],
    /// Not negative; they sum to 1.
    pub weights: [f32; 4],
}

/// What lights a vertex on one side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lit<'a> {
    /// Nothing.
    Nowhere,
    /// A point of its own.
    Point(u32),
    /// Several.
    Blend(&'a Blend),
}

impl Lit<'_> {
    /// The points and what they weigh: four, one or none.
    pub fn shares(&self) -> impl Iterator<Item = (u32, f32)> {
        let (points, weights, n) = match self {
            Lit::Nowhere => ([0; 4], [0.0; 4], 0),
            Lit::Point(point) => ([*point; 4], [1.0; 4], 1),
            Lit::Blend(blend) => (blend.points, blend.weights, 4),
        };
        points.into_iter().zip(weights).take(n)
    }
}

/// The arrays of one object, borrowed. Optional ones are empty when absent.
#[derive(Clone, Copy, Debug, Default)]
pub struct Mesh<'a> {
    /// `[v]` world position, metres.
    pub position: &'a [[f32; 3]],
    /// `[v]` front shading normal, unit.
    pub normal: &'a [[f32; 3]],
    /// `[v]` the object's point that shades the front, or [`NO_POINT`], or [`BLENDED`] + index into `blends`.
    pub point_front: &'a [u32],
    /// `[v]` the same for the back.
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
    /// `[b]` what lights vertices without a point of their own; most meshes have none.
    pub blends: &'a [Blend],
}

impl<'a> Mesh<'a> {
    /// The chunk's bytes.
    pub fn to_chunk(&self) -> Vec<u8> {
        let bit = |present: bool, bit: u32| if present { bit } else { 0 };
        let attributes = bit(!self.uv0.is_empty(), HAS_UV0)
            | bit(!self.uv1.is_empty(), HAS_UV1)
            | bit(!self.tangent.is_empty(), HAS_TANGENT)
            | bit(!self.color.is_empty(), HAS_COLOR);
        let (v, t, b) = (self.position.len() as u32, self.triangles.len() as u32, self.blends.len() as u32);
        let version = if b == 0 { VERSION } else { BLENDED_VERSION };
        let writer = Writer::new(MAGIC, version, [v, t, attributes, b, 0, 0])
            .array(self.position)
            .array(self.normal)
            .array(self.point_front)
            .array(self.point_back)
            .array(self.triangles)
            .array(self.material)
            .array(self.uv0)
            .array(self.uv1)
            .array(self.tangent)
            .array(self.color);
        if b == 0 {
            return writer.finish();
        }
        writer.array(self.blends).finish()
    }

    /// Borrows from a chunk; `n_points` is the object's, which bounds the point indices.
    pub fn from_chunk(bytes: &'a [u8], n_points: u32) -> Result<Self, RuntimeError> {
        let mut reader = Self::reader(bytes)?;
        let mesh = Self::borrow(&mut reader)?;
        if !are_moderate(mesh.position) || !are_moderate(mesh.uv0) || !are_moderate(mesh.uv1) || !are_moderate(mesh.color) {
            return Err(reader.error("a position, texture coordinate or colour is out of range"));
        }
        if !are_directions(mesh.normal) || !are_directions(mesh.tangent) {
            return Err(reader.error("a normal or tangent is no direction"));
        }
        let v = mesh.position.len();
        if mesh.triangles.iter().flatten().any(|i| *i as usize >= v) {
            return Err(reader.error("a triangle names a vertex that is not there"));
        }
        let is_known = |p: u32| p == NO_POINT || if p >= BLENDED { ((p - BLENDED) as usize) < mesh.blends.len() } else { p < n_points };
        if mesh.point_front.iter().chain(mesh.point_back).any(|p| !is_known(*p)) {
            return Err(reader.error("a vertex names a point that is not there"));
        }
        if mesh.blends.iter().any(|blend| blend.points.iter().any(|p| *p >= n_points)) {
            return Err(reader.error("a blend names a point that is not there"));
        }
        // 1e-4: four weights that were rounded.
        let is_mean = |weights: [f32; 4]| weights.iter().all(|w| *w >= 0.0) && (weights.iter().sum::<f32>() - 1.0).abs() < 1e-4;
        if mesh.blends.iter().any(|blend| !is_mean(blend.weights)) {
            return Err(reader.error("the weights of a blend do not sum to 1"));
        }
        reader.finish()?;
        Ok(mesh)
    }

    /// Borrows again from a chunk that [`Mesh::from_chunk`] has proved: no second look at every index.
    ///
    /// Panics where even the header is wrong.
    pub(crate) fn from_proven_chunk(bytes: &'a [u8]) -> Self {
        Self::reader(bytes).and_then(|mut reader| Self::borrow(&mut reader)).expect("a chunk that was proved before")
    }

    /// What lights the front of a vertex.
    pub fn front(&self, vertex: usize) -> Lit<'a> {
        self.lit(self.point_front[vertex])
    }

    /// What lights the back of a vertex.
    pub fn back(&self, vertex: usize) -> Lit<'a> {
        self.lit(self.point_back[vertex])
    }

    fn lit(&self, point: u32) -> Lit<'a> {
        match point {
            NO_POINT => Lit::Nowhere,
            BLENDED.. => Lit::Blend(&self.blends[(point - BLENDED) as usize]),
            _ => Lit::Point(point),
        }
    }

    /// One more than the highest point that a vertex or blend names.
    pub(crate) fn n_points(&self) -> usize {
        let own = self.point_front.iter().chain(self.point_back).filter(|p| **p < BLENDED);
        own.chain(self.blends.iter().flat_map(|blend| &blend.points)).max().map_or(0, |p| *p as usize + 1)
    }

    fn reader(bytes: &'a [u8]) -> Result<Reader<'a>, RuntimeError> {
        let mut reader = Reader::of_versions("mesh", MAGIC, VERSION..=BLENDED_VERSION, bytes)?;
        let blended = reader.version == BLENDED_VERSION;
        if !blended {
            reader.counts[3] = 0;
        }
        Ok(reader)
    }

    /// The arrays as the header says, indices unseen.
    fn borrow(reader: &mut Reader<'a>) -> Result<Self, RuntimeError> {
        let [v, t, attributes, b, ..] = reader.counts;
        let (v, t, b) = (v as usize, t as usize, b as usize);
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
            blends: if b > 0 { reader.array(b)? } else { &[] },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use prelight_store::Chunk;

    #[test]
    fn blends_round_trip_and_what_is_wrong_in_them_is_refused() {
        let (position, normal) = ([[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [[0.0, 0.0, 1.0]; 3]);
        let good = Blend { points: [0, 1, 0, 0], weights: [0.25, 0.75, 0.0, 0.0] };
        let mesh = |blends: &'static [Blend], front: &'static [u32]| {
            let mesh = Mesh { position: &position, normal: &normal, point_front: front, point_back: &[NO_POINT; 3], ..Mesh::default() };
            Chunk::from_plain(&Mesh { triangles: &[[0, 1, 2]], material: &[0], blends, ..mesh }.to_chunk())
        };
        let chunk = mesh(Box::leak(Box::new([good])), &[0, 1, BLENDED]);
        let read = Mesh::from_chunk(&chunk, 2).unwrap();
        assert_eq!((read.front(1), read.front(2), read.back(2)), (Lit::Point(1), Lit::Blend(&good), Lit::Nowhere));
        assert_eq!(read.front(2).shares().filter(|share| share.1 > 0.0).collect::<Vec<_>>(), [(0, 0.25), (1, 0.75)]);
        assert_eq!(read.n_points(), 2);
        for cut in 0..chunk.len() {
            assert!(Mesh::from_chunk(&chunk[..cut], 2).is_err(), "{cut}");
        }
        assert!(Mesh::from_chunk(&chunk, 1).is_err(), "a blend names point 1");
        assert!(Mesh::from_chunk(&mesh(Box::leak(Box::new([good])), &[0, 1, BLENDED + 1]), 2).is_err());
        for weights in [[0.5, 0.25, 0.0, 0.0], [1.5, -0.5, 0.0, 0.0], [f32::NAN; 4]] {
            assert!(Mesh::from_chunk(&mesh(Box::leak(Box::new([Blend { weights, ..good }])), &[0, 1, BLENDED]), 2).is_err(), "{weights:?}");
        }
        let plain = mesh(&[], &[0, 1, NO_POINT]);
        assert_eq!(plain[4..8], VERSION.to_le_bytes(), "a mesh without blends is what it always was");
        assert_eq!(Mesh::from_chunk(&plain, 2).unwrap().front(2), Lit::Nowhere);
    }
}
