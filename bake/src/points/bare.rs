//! Points of some patches without the mesh that they came from: all that baking a factor of them reads beside the scene, in bytes, so that
//! another process can.
//!
//! ```text
//! part    layout 1, object, edge length, patches p, points n, excluded ids e, bits (1 surfaces, 2 details)
//!         [p] points of each patch
//!         [n] origin 3, n_s 3, n_g 3, flags, mean edge 2, number of excluded ids; [e] excluded ids
//!         bit 1: [n] mapped normal 3, roughness, material;  bit 2: [n] tangent 3, anisotropy, coat normal 3, coat roughness
//! ```
//!
//! All of it u32 or the bits of f32, little-endian, one array after the other; a mean edge is the two halves of an f64, the lower first. Parts
//! follow one another without gap. About 60 bytes a point, 80 with surfaces.

use crate::points::surface::ObjectSurfaces;
use crate::points::{ObjectPlan, Patch, PatchName};
use prelight_runtime::asset::points::PATCH_POINTS;
use prelight_runtime::surface::detail::Detail;

/// Version of the layout above.
const LAYOUT: u32 = 1;
const HEAD: usize = 7;
const SURFACES: u32 = 1;
const DETAILS: u32 = 2;

/// Patches of one object, able to be baked and nothing else: they have no mesh, no areas and no names.
#[derive(Clone, Debug)]
pub(crate) struct BarePatches {
    /// The points; its patches begin at 0.
    pub plan: ObjectPlan,
    /// The object's edge length, metres.
    pub edge_length: f32,
    /// Averages over the points' footprints, without metalness; `None` where no factor asks for them.
    pub surfaces: Option<ObjectSurfaces>,
}

/// Parts of [`ObjectPlan::bare`]. Arrays have one element a point.
#[derive(Default)]
pub(crate) struct BarePoints {
    /// Index of the object in the scene.
    pub object: u32,
    /// The patches, from point 0 on.
    pub patches: Vec<Patch>,
    /// Where rays start.
    pub origin: Vec<[f32; 3]>,
    /// n_s.
    pub normal: Vec<[f32; 3]>,
    /// n_g.
    pub geometric_normal: Vec<[f32; 3]>,
    /// As of a plan.
    pub flags: Vec<u32>,
    /// Mean edge of the base triangle that a point was made in, metres.
    pub mean_edges: Vec<f64>,
    /// Number of excluded triangles of each point.
    pub n_excluded: Vec<u32>,
    /// Their ids, one point after the other.
    pub excluded: Vec<u32>,
}

/// Appends patches of an object; those after one another in the plan lie so here.
pub(crate) fn encode(plan: &ObjectPlan, edge_length: f32, surfaces: Option<&ObjectSurfaces>, patches: &[&Patch], bytes: &mut Vec<u8>) {
    let points: Vec<usize> = patches.iter().flat_map(|patch| patch.range()).collect();
    let n_excluded: usize = points.iter().map(|&i| plan.base_triangles(i).len()).sum();
    let details = surfaces.is_some_and(|surfaces| !surfaces.details.is_empty());
    let bits = if surfaces.is_some() { SURFACES } else { 0 } | if details { DETAILS } else { 0 };
    let mut out = Words { bytes };
    let counts = [patches.len(), points.len(), n_excluded].map(|n| n as u32);
    out.words([LAYOUT, plan.object, edge_length.to_bits()].into_iter().chain(counts).chain([bits]));
    out.words(patches.iter().map(|patch| patch.n_points));
    out.vectors(points.iter().map(|&i| plan.origin[i]));
    out.vectors(points.iter().map(|&i| plan.normal[i]));
    out.vectors(points.iter().map(|&i| plan.geometric_normal[i]));
    out.words(points.iter().map(|&i| plan.flags[i]));
    out.words(points.iter().flat_map(|&i| halves(plan.mean_edge(i as u32))));
    out.words(points.iter().map(|&i| plan.base_triangles(i).len() as u32));
    out.words(points.iter().flat_map(|&i| plan.base_triangles(i).iter().copied()));
    let Some(surfaces) = surfaces else { return };
    out.vectors(points.iter().map(|&i| surfaces.normal[i]));
    out.words(points.iter().map(|&i| surfaces.roughness[i].to_bits()));
    out.words(points.iter().map(|&i| surfaces.material[i]));
    if details {
        let details = || points.iter().map(|&i| &surfaces.details[i]);
        out.vectors(details().map(|detail| detail.tangent));
        out.words(details().map(|detail| detail.anisotropy.to_bits()));
        out.vectors(details().map(|detail| detail.coat_normal));
        out.words(details().map(|detail| detail.coat_roughness.to_bits()));
    }
}

/// Reads all parts.
///
/// # Errors
/// What does not hold, in words: ids and indices are below `n_triangles`, `n_objects` and `n_materials`, counts agree, nothing is left over.
pub(crate) fn decode(bytes: &[u8], n_triangles: u32, n_objects: u32, n_materials: u32) -> Result<Vec<BarePatches>, &'static str> {
    let (words, rest) = bytes.as_chunks::<4>();
    if !rest.is_empty() {
        return Err("its length is no multiple of 4");
    }
    let mut input = Reader { words };
    let mut parts = Vec::new();
    while !input.words.is_empty() {
        let part = input.part().ok_or("it ends inside a part, or has counts that no patch has")?;
        let (plan, surfaces) = (&part.plan, part.surfaces.as_ref());
        let excluded = || (0..plan.n_points()).flat_map(|i| plan.base_triangles(i));
        if plan.object >= n_objects || excluded().any(|id| *id >= n_triangles) {
            return Err("it names an object or a triangle that the scene has not");
        }
        if surfaces.is_some_and(|surfaces| surfaces.material.iter().any(|material| *material >= n_materials)) {
            return Err("it names a material that the scene has not");
        }
        parts.push(part);
    }
    Ok(parts)
}

fn halves(x: f64) -> [u32; 2] {
    let bits = x.to_bits();
    [bits as u32, (bits >> 32) as u32]
}

struct Words<'a> {
    bytes: &'a mut Vec<u8>,
}

impl Words<'_> {
    fn words(&mut self, words: impl IntoIterator<Item = u32>) {
        words.into_iter().for_each(|word| self.bytes.extend_from_slice(&word.to_le_bytes()));
    }

    fn vectors(&mut self, vectors: impl Iterator<Item = [f32; 3]>) {
        self.words(vectors.flat_map(|vector| vector.map(f32::to_bits)));
    }
}

struct Reader<'a> {
    words: &'a [[u8; 4]],
}

impl Reader<'_> {
    fn part(&mut self) -> Option<BarePatches> {
        let head = self.words(HEAD)?;
        let [layout, object, edge_length, n_patches, n, n_excluded, bits] = head[..] else { return None };
        let (n_patches, n) = (n_patches as usize, n as usize);
        let is_known = layout == LAYOUT && bits & !(SURFACES | DETAILS) == 0 && bits != DETAILS;
        let sizes = self.words(n_patches).filter(|_| is_known)?;
        let mut patches = Vec::with_capacity(n_patches);
        let mut first = 0u32;
        for (run, &n_points) in sizes.iter().enumerate() {
            if n_points == 0 || n_points as usize > PATCH_POINTS {
                return None;
            }
            let name = PatchName { level: 0, fine: false, back: false, axis: 0, cell: 0, depth: 0, run: run as u32 };
            patches.push(Patch { name, first, n_points });
            first = first.checked_add(n_points)?;
        }
        if first as usize != n {
            return None;
        }
        let (origin, normal, geometric_normal) = (self.vectors(n)?, self.vectors(n)?, self.vectors(n)?);
        let flags = self.words(n)?;
        let halves = self.words(n.checked_mul(2)?)?;
        let mean_edges = halves.chunks_exact(2).map(|half| f64::from_bits(u64::from(half[1]) << 32 | u64::from(half[0]))).collect();
        let counts = self.words(n)?;
        if counts.iter().map(|count| u64::from(*count)).sum::<u64>() != u64::from(n_excluded) {
            return None;
        }
        let excluded = self.words(n_excluded as usize)?;
        let points = BarePoints { object, patches, origin, normal, geometric_normal, flags, mean_edges, n_excluded: counts, excluded };
        let surfaces = if bits & SURFACES != 0 { Some(self.surfaces(n, bits & DETAILS != 0)?) } else { None };
        Some(BarePatches { plan: ObjectPlan::bare(points), edge_length: f32::from_bits(edge_length), surfaces })
    }

    fn surfaces(&mut self, n: usize, has_details: bool) -> Option<ObjectSurfaces> {
        let (normal, roughness, material) = (self.vectors(n)?, self.floats(n)?, self.words(n)?);
        let mut surfaces = ObjectSurfaces { normal, roughness, material, ..ObjectSurfaces::default() };
        if has_details {
            let (tangent, anisotropy) = (self.vectors(n)?, self.floats(n)?);
            let (coat_normal, coat_roughness) = (self.vectors(n)?, self.floats(n)?);
            let detail = |i: usize| Detail {
                tangent: tangent[i],
                anisotropy: anisotropy[i],
                coat_normal: coat_normal[i],
                coat_roughness: coat_roughness[i],
            };
            surfaces.details = (0..n).map(detail).collect();
        }
        Some(surfaces)
    }

    fn words(&mut self, n: usize) -> Option<Vec<u32>> {
        let (words, rest) = self.words.split_at_checked(n)?;
        self.words = rest;
        Some(words.iter().map(|word| u32::from_le_bytes(*word)).collect())
    }

    fn floats(&mut self, n: usize) -> Option<Vec<f32>> {
        Some(self.words(n)?.into_iter().map(f32::from_bits).collect())
    }

    fn vectors(&mut self, n: usize) -> Option<Vec<[f32; 3]>> {
        Some(self.floats(n.checked_mul(3)?)?.chunks_exact(3).map(|vector| [vector[0], vector[1], vector[2]]).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::PointParams;
    use crate::points::plan_object;
    use crate::points::surface::point_surfaces;
    use crate::points::test_scenes;
    use prelight_manifests::quality::Quality;
    use prelight_scene::world::World;

    fn sample() -> (Vec<u8>, ObjectPlan, ObjectSurfaces, [u32; 3]) {
        let mut scene = test_scenes::scene();
        let cuboid = test_scenes::smooth_cuboid([0.0; 3], [1.0, 0.7, 0.4], false, 1);
        test_scenes::add(&mut scene, "box", vec![cuboid], test_scenes::IDENTITY);
        let world = World::build(&scene);
        let params = PointParams::new(&Quality::Draft.knobs(), 0.1);
        let plan = plan_object(&scene, &world, 0, &params).unwrap();
        let mut surfaces = point_surfaces(&scene, &plan);
        surfaces.details = (0..plan.n_points()).map(|i| Detail { anisotropy: i as f32, ..Detail::default() }).collect();
        let patches: Vec<&Patch> = plan.patches.iter().collect();
        let mut bytes = Vec::new();
        encode(&plan, 0.1, Some(&surfaces), &patches, &mut bytes);
        let limits = [world.positions.len(), scene.objects.len(), scene.materials.len()].map(|n| n as u32);
        (bytes, plan, surfaces, limits)
    }

    #[test]
    fn all_that_a_factor_reads_of_a_point_comes_back() {
        let (mut bytes, plan, surfaces, [triangles, objects, materials]) = sample();
        assert!(plan.n_points() > 300 && plan.patches.len() > 2);
        // A second part: every second patch, without surfaces.
        let some: Vec<&Patch> = plan.patches.iter().step_by(2).collect();
        encode(&plan, 0.1, None, &some, &mut bytes);
        let parts = decode(&bytes, triangles, objects, materials).unwrap();
        assert_eq!(parts.len(), 2);
        let back = &parts[0];
        assert_eq!((back.edge_length, back.plan.object, back.plan.n_points()), (0.1, plan.object, plan.n_points()));
        let own = back.surfaces.as_ref().unwrap();
        assert_eq!((&own.normal, &own.roughness, &own.material), (&surfaces.normal, &surfaces.roughness, &surfaces.material));
        assert_eq!(own.details, surfaces.details);
        let of = |plan: &ObjectPlan, i: usize| {
            let from = plan.trace_origin(i);
            (from.origin, from.normal, plan.geometric_normal[i], plan.flags[i], plan.mean_edge(i as u32), from.base_triangles.to_vec())
        };
        (0..plan.n_points()).for_each(|i| assert_eq!(of(&back.plan, i), of(&plan, i), "{i}"));
        assert_eq!(parts[1].plan.patches.len(), some.len());
        for (own, patch) in parts[1].plan.patches.iter().zip(some) {
            own.range().zip(patch.range()).for_each(|(i, j)| assert_eq!(of(&parts[1].plan, i), of(&plan, j)));
        }
        assert!(parts[1].surfaces.is_none());
    }

    #[test]
    fn what_is_cut_or_names_what_is_not_there_is_refused() {
        let (bytes, _, _, [triangles, objects, materials]) = sample();
        for length in (1..bytes.len()).step_by(37) {
            assert!(decode(&bytes[..length], triangles, objects, materials).is_err(), "{length}");
        }
        assert!(decode(&bytes, 0, objects, materials).is_err() && decode(&bytes, triangles, 0, materials).is_err());
        assert!(decode(&bytes, triangles, objects, 0).is_err());
        for (word, value) in [(0, 2), (3, u32::MAX), (4, 0), (5, 1), (6, 4), (7, 257), (7, 0)] {
            let mut wrong = bytes.clone();
            wrong[4 * word..4 * word + 4].copy_from_slice(&u32::to_le_bytes(value));
            assert!(decode(&wrong, triangles, objects, materials).is_err(), "word {word} = {value}");
        }
        assert!(decode(&[], 0, 0, 0).unwrap().is_empty());
    }
}
