//! Surface chunk of a patch: material parameters averaged over each point's footprint, so that glossy light at a point
//! stands for the surface around it. Everything that draw can apply per pixel (base colour, F0) stays out.
//!
//! Counts: `n` points. Arrays: normal `[n, 3]` f32 unit, the mean of the mapped normals (n_s where there is no normal map);
//! roughness `[n]` f32 perceptual, widened by the spread of the mapped normals; metallic `[n]` f32; material `[n]` u32.

use super::layout::{Reader, Writer, are_directions};
use crate::error::RuntimeError;

const MAGIC: &[u8; 4] = b"PLSF";
const VERSION: u32 = 1;

/// The arrays of one patch, borrowed from its chunk. Each has n elements.
#[derive(Clone, Copy, Debug)]
pub struct PointSurfaces<'a> {
    /// Mean mapped normal, unit, on the point's side: the glossy term's normal.
    pub normal: &'a [[f32; 3]],
    /// Perceptual roughness 0..1.
    pub roughness: &'a [f32],
    /// Metalness 0..1.
    pub metallic: &'a [f32],
    /// Index into the asset's materials.
    pub material: &'a [u32],
}

impl<'a> PointSurfaces<'a> {
    /// The chunk's bytes.
    pub fn to_chunk(&self) -> Vec<u8> {
        Writer::new(MAGIC, VERSION, [self.roughness.len() as u32, 0, 0, 0, 0, 0])
            .array(self.normal)
            .array(self.roughness)
            .array(self.metallic)
            .array(self.material)
            .finish()
    }

    /// Borrows from a chunk.
    pub fn from_chunk(bytes: &'a [u8]) -> Result<Self, RuntimeError> {
        let mut reader = Reader::new("surface", MAGIC, VERSION, bytes)?;
        let n = reader.counts[0] as usize;
        let surfaces =
            PointSurfaces { normal: reader.array(n)?, roughness: reader.array(n)?, metallic: reader.array(n)?, material: reader.array(n)? };
        let unit = |v: &f32| (0.0..=1.0).contains(v);
        if !surfaces.roughness.iter().all(unit) || !surfaces.metallic.iter().all(unit) || !are_directions(surfaces.normal) {
            return Err(reader.error("a roughness, metalness or normal is out of range"));
        }
        reader.finish()?;
        Ok(surfaces)
    }
}
