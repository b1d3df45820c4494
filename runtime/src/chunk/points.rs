//! Points chunk of a patch: where its points are and how they are oriented.
//!
//! Counts: `n` points (1..=256). Arrays: position `[n, 3]` f32 metres; normal `[n, 3]` f32 unit, the shading normal n_s that
//! bounds the hemisphere; geometric_normal `[n, 3]` f32 unit; area `[n]` f32 m², the surface that the point stands for;
//! flags `[n]` u32, see [`BACK_SIDE`] and [`BURIED`].

pub use super::layout::PATCH_POINTS;
use super::layout::{LARGEST, Reader, Writer, are_directions, are_moderate};
use crate::error::RuntimeError;

const MAGIC: &[u8; 4] = b"PLPT";
const VERSION: u32 = 1;

/// Flag: the point shades the back of a double-sided surface; its normals are already flipped.
pub const BACK_SIDE: u32 = 1;
/// Flag: the point lies inside another solid or on a coincident surface and must not be interpolated from.
pub const BURIED: u32 = 2;

/// The arrays of one patch, borrowed from its chunk. Each has n elements.
#[derive(Clone, Copy, Debug)]
pub struct Points<'a> {
    /// World position, metres.
    pub position: &'a [[f32; 3]],
    /// Shading normal, unit, on the point's side.
    pub normal: &'a [[f32; 3]],
    /// Geometric normal, unit, on the point's side.
    pub geometric_normal: &'a [[f32; 3]],
    /// Surface area that the point stands for, m².
    pub area: &'a [f32],
    /// [`BACK_SIDE`] | [`BURIED`].
    pub flags: &'a [u32],
}

impl<'a> Points<'a> {
    /// Number of points.
    pub(crate) fn len(&self) -> usize {
        self.position.len()
    }

    /// Never true for a parsed chunk.
    pub fn is_empty(&self) -> bool {
        self.position.is_empty()
    }

    /// The chunk's bytes.
    pub fn to_chunk(&self) -> Vec<u8> {
        let n = self.position.len();
        assert!((1..=PATCH_POINTS).contains(&n), "a patch has 1..=256 points, not {n}");
        Writer::new(MAGIC, VERSION, [n as u32, 0, 0, 0, 0, 0])
            .array(self.position)
            .array(self.normal)
            .array(self.geometric_normal)
            .array(self.area)
            .array(self.flags)
            .finish()
    }

    /// Borrows from a chunk.
    pub fn from_chunk(bytes: &'a [u8]) -> Result<Self, RuntimeError> {
        let mut reader = Reader::new("points", MAGIC, VERSION, bytes)?;
        let points = Self::arrays(&mut reader)?;
        if !are_moderate(points.position) || !points.area.iter().all(|area| (0.0..=LARGEST).contains(area)) {
            return Err(reader.error("a position or area is out of range"));
        }
        if !are_directions(points.normal) || !are_directions(points.geometric_normal) {
            return Err(reader.error("a normal is no direction"));
        }
        if points.flags.iter().any(|flags| flags & !(BACK_SIDE | BURIED) != 0) {
            return Err(reader.error("a flag that this build does not know"));
        }
        reader.finish()?;
        Ok(points)
    }

    /// Borrows again from a chunk that [`Points::from_chunk`] has proved: no second look at every number.
    ///
    /// Panics where even the layout is wrong.
    pub(crate) fn from_proven_chunk(bytes: &'a [u8]) -> Self {
        let reader = Reader::new("points", MAGIC, VERSION, bytes);
        reader.and_then(|mut reader| Self::arrays(&mut reader)).expect("a chunk that was proved before")
    }

    fn arrays(reader: &mut Reader<'a>) -> Result<Self, RuntimeError> {
        let n = reader.counts[0] as usize;
        if !(1..=PATCH_POINTS).contains(&n) {
            return Err(reader.error("a patch has 1..=256 points"));
        }
        Ok(Points {
            position: reader.array(n)?,
            normal: reader.array(n)?,
            geometric_normal: reader.array(n)?,
            area: reader.array(n)?,
            flags: reader.array(n)?,
        })
    }
}
