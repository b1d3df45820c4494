//! Base chunk: the geometry of an object as its source gave it, local space. Instances share one chunk.
//!
//! Nothing at run time draws from it; it is what makes an asset complete: the reference path tracer, rebakes at another density and exports
//! work from here, never from the source file.
//!
//! Counts: `p` primitives. First array: `[p, 8]` u32 heads: vertices, triangles, material, attributes, zeros. Then per primitive
//! position `[v, 3]` f32, triangles `[t, 3]` u32, and each only if its bit is set: normal `[v, 3]` f32, tangent `[v, 4]` f32, uv0 `[v, 2]` f32,
//! uv1 `[v, 2]` f32, color `[v, 4]` f32 linear.

use super::layout::{Reader, Writer, are_moderate};
use crate::error::RuntimeError;

const MAGIC: &[u8; 4] = b"PLBS";
const VERSION: u32 = 1;
const HAS_NORMAL: u32 = 1;
const HAS_TANGENT: u32 = 2;
const HAS_UV0: u32 = 4;
const HAS_UV1: u32 = 8;
const HAS_COLOR: u32 = 16;

/// Triangles with one material. Absent attributes are `None`, present ones have one element a vertex.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BasePrimitive<'a> {
    /// Local positions.
    pub positions: &'a [[f32; 3]],
    /// Vertex indices, in range.
    pub triangles: &'a [[u32; 3]],
    /// Index into the asset's materials.
    pub material: u32,
    /// Local normals.
    pub normals: Option<&'a [[f32; 3]]>,
    /// Tangents and signs of the bitangent.
    pub tangents: Option<&'a [[f32; 4]]>,
    /// Two sets of texture coordinates.
    pub uvs: [Option<&'a [[f32; 2]]>; 2],
    /// Linear RGBA.
    pub colors: Option<&'a [[f32; 4]]>,
}

/// The chunk's bytes.
pub fn to_chunk(primitives: &[BasePrimitive]) -> Vec<u8> {
    let bit = |present: bool, bit: u32| if present { bit } else { 0 };
    let head = |p: &BasePrimitive| {
        let attributes = bit(p.normals.is_some(), HAS_NORMAL)
            | bit(p.tangents.is_some(), HAS_TANGENT)
            | bit(p.uvs[0].is_some(), HAS_UV0)
            | bit(p.uvs[1].is_some(), HAS_UV1)
            | bit(p.colors.is_some(), HAS_COLOR);
        [p.positions.len() as u32, p.triangles.len() as u32, p.material, attributes, 0, 0, 0, 0]
    };
    let heads: Vec<[u32; 8]> = primitives.iter().map(head).collect();
    let mut writer = Writer::new(MAGIC, VERSION, [primitives.len() as u32, 0, 0, 0, 0, 0]).array(&heads);
    for p in primitives {
        writer = writer.array(p.positions).array(p.triangles);
        writer = writer.array(p.normals.unwrap_or_default()).array(p.tangents.unwrap_or_default());
        writer = writer.array(p.uvs[0].unwrap_or_default()).array(p.uvs[1].unwrap_or_default()).array(p.colors.unwrap_or_default());
    }
    writer.finish()
}

/// Borrows from a chunk; indices are in range afterwards, and numbers are finite.
///
/// # Errors
/// Anything but what [`to_chunk`] writes.
pub fn from_chunk(bytes: &[u8]) -> Result<Vec<BasePrimitive<'_>>, RuntimeError> {
    parse(bytes, true)
}

/// Borrows again from a chunk that [`from_chunk`] has proved: no second look at every index and number.
///
/// Panics where even the layout is wrong.
pub(crate) fn from_proven_chunk(bytes: &[u8]) -> Vec<BasePrimitive<'_>> {
    parse(bytes, false).expect("a chunk that was proved before")
}

fn parse(bytes: &[u8], prove: bool) -> Result<Vec<BasePrimitive<'_>>, RuntimeError> {
    let mut reader = Reader::new("base", MAGIC, VERSION, bytes)?;
    let heads: &[[u32; 8]] = reader.array(reader.counts[0] as usize)?;
    let mut primitives = Vec::with_capacity(heads.len());
    for [v, t, material, attributes, ..] in heads {
        let (v, t) = (*v as usize, *t as usize);
        let has = |bit: u32| attributes & bit != 0;
        let (positions, triangles): (_, &[[u32; 3]]) = (reader.array(v)?, reader.array(t)?);
        if prove && triangles.iter().flatten().any(|i| *i as usize >= v) {
            return Err(reader.error("a triangle names a vertex that is not there"));
        }
        let primitive = BasePrimitive {
            positions,
            triangles,
            material: *material,
            normals: if has(HAS_NORMAL) { Some(reader.array(v)?) } else { None },
            tangents: if has(HAS_TANGENT) { Some(reader.array(v)?) } else { None },
            uvs: [if has(HAS_UV0) { Some(reader.array(v)?) } else { None }, if has(HAS_UV1) { Some(reader.array(v)?) } else { None }],
            colors: if has(HAS_COLOR) { Some(reader.array(v)?) } else { None },
        };
        if prove && !is_moderate(&primitive) {
            return Err(reader.error("a number of a vertex is out of range"));
        }
        primitives.push(primitive);
    }
    reader.finish()?;
    Ok(primitives)
}

fn is_moderate(primitive: &BasePrimitive) -> bool {
    are_moderate(primitive.positions)
        && primitive.normals.is_none_or(are_moderate)
        && primitive.tangents.is_none_or(are_moderate)
        && primitive.uvs.iter().flatten().all(|uv| are_moderate(uv))
        && primitive.colors.is_none_or(are_moderate)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_attribute_round_trips_and_damage_is_refused() {
        let positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let plain = BasePrimitive { positions: &positions, triangles: &[[0, 1, 2]], material: 3, ..Default::default() };
        let rich = BasePrimitive {
            normals: Some(&[[0.0, 0.0, 1.0]; 3]),
            tangents: Some(&[[1.0, 0.0, 0.0, -1.0]; 3]),
            uvs: [None, Some(&[[0.5, 0.25]; 3])],
            colors: Some(&[[1.0, 0.5, 0.25, 0.125]; 3]),
            ..plain
        };
        // Aligned, as the store gives it.
        let chunk = prelight_store::Chunk::from_plain(&to_chunk(&[plain, rich]));
        assert_eq!(from_chunk(&chunk).unwrap(), [plain, rich]);
        for cut in 0..chunk.len() {
            assert!(from_chunk(&chunk[..cut]).is_err(), "{cut}");
        }
        let bad = BasePrimitive { triangles: &[[0, 1, 3]], ..plain };
        assert!(from_chunk(&prelight_store::Chunk::from_plain(&to_chunk(&[bad]))).is_err());
    }
}
