//! The points of the scene as rays see them: where each one's rays start, and which point a hit stands for.

use super::locate::Locator;
use crate::error::BakeError;
use crate::mesh::origin::surface_origin;
use crate::reach::key::Hasher;
use crate::trace::{Hit, Occluders};
use prelight_manifests::asset::AssetObject;
use prelight_runtime::asset::mesh::{Blend, Lit, Mesh};
use prelight_runtime::asset::points::{BURIED, Points};
use prelight_scene::Scene;
use prelight_scene::world::World;
use prelight_store::{ChunkSource, Store};
use rayon::prelude::*;
use std::collections::HashMap;
use std::ops::Range;

/// Share of a segment that is asked for occluders: its ends lie on surfaces.
const WITHIN: f32 = 1.0 - 1e-3;

/// A point: where its rays start.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Source {
    pub position: [f32; 3],
    pub origin: [f32; 3],
    /// n_s.
    pub normal: [f32; 3],
    /// The base triangle that it lies on.
    pub base: u32,
    pub is_buried: bool,
}

/// The points of an object.
struct ObjectPoints {
    points: Vec<Source>,
    /// `[patches + 1]` first point of each patch.
    first: Vec<u32>,
    /// Number of its first patch in the scene.
    first_patch: u32,
    locator: Locator,
    corners: Corners,
    edge_length: f32,
    /// Longest edge of a refined triangle, metres.
    longest_edge: f32,
    /// `[patches]`
    identities: Vec<Identity>,
}

/// Names a patch by all that decides which of its points a hit stands for: its points, the refined triangles around them, its object's edge length.
pub(super) type Identity = [u8; 16];

/// What lights the corners of an object's refined triangles, as in [`Mesh`].
struct Corners {
    triangles: Vec<[u32; 3]>,
    front: Vec<u32>,
    back: Vec<u32>,
    blends: Vec<Blend>,
}

/// The points of all objects.
pub(super) struct Targets<'a> {
    scene: &'a Scene,
    world: &'a World,
    occluders: &'a Occluders,
    /// `[objects of the asset]`
    objects: Vec<ObjectPoints>,
    /// `[objects of the scene]` which of them each is.
    by_scene: Vec<Option<u32>>,
    /// `[patches]` object and patch in it.
    pub patches: Vec<(u32, u32)>,
    by_identity: HashMap<Identity, u32>,
}

/// What a ray met.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Met {
    /// No point: the environment, a back, or what was not baked.
    Nobody,
    /// A point: patch of the scene, and its place there.
    Point(u32, u8),
}

impl<'a> Targets<'a> {
    /// Reads the chunks of the objects of an asset; `in_scene[i]`: which object of the scene object `i` is.
    pub(super) fn new(
        (scene, world): (&'a Scene, &'a World),
        occluders: &'a Occluders,
        objects: &[AssetObject],
        in_scene: &[usize],
        store: &Store,
    ) -> Result<Self, BakeError> {
        let mut by_scene = vec![None; scene.objects.len()];
        in_scene.iter().enumerate().for_each(|(at, object)| by_scene[*object] = Some(at as u32));
        let mut firsts = Vec::with_capacity(objects.len());
        objects.iter().fold(0, |first, object| {
            firsts.push(first);
            first + object.patches.len() as u32
        });
        let read = |((object, first_patch), at): ((&AssetObject, u32), &usize)| ObjectPoints::read(world, object, *at, first_patch, store);
        let objects: Vec<ObjectPoints> = objects.par_iter().zip(firsts).zip(in_scene).map(read).collect::<Result<_, BakeError>>()?;
        let patches = |(at, object): (usize, &ObjectPoints)| {
            (0..object.first.len() as u32 - 1).map(move |patch| (at as u32, patch)).collect::<Vec<_>>()
        };
        let patches = objects.iter().enumerate().flat_map(patches).collect();
        let by_identity =
            objects.iter().flat_map(|object| object.identities.iter().zip(object.first_patch..)).map(|(name, patch)| (*name, patch));
        let by_identity = by_identity.collect();
        Ok(Targets { scene, world, occluders, objects, by_scene, patches, by_identity })
    }

    /// The points of a patch.
    pub(super) fn patch(&self, patch: u32) -> &[Source] {
        let (object, local) = self.patches[patch as usize];
        let object = &self.objects[object as usize];
        &object.points[object.patch_range(local as usize)]
    }

    /// Edge length of a patch's object, metres.
    pub(super) fn edge_length(&self, patch: u32) -> f32 {
        self.objects[self.patches[patch as usize].0 as usize].edge_length
    }

    /// Longest edge of the refined triangles of a patch's object, metres.
    pub(super) fn longest_edge(&self, patch: u32) -> f32 {
        self.objects[self.patches[patch as usize].0 as usize].longest_edge
    }

    /// Names a patch.
    pub(super) fn identity(&self, patch: u32) -> Identity {
        let (object, local) = self.patches[patch as usize];
        self.objects[object as usize].identities[local as usize]
    }

    /// The patch of that name.
    pub(super) fn by_identity(&self, identity: &Identity) -> Option<u32> {
        self.by_identity.get(identity).copied()
    }

    /// Numbers of objects of the scene that are not in the asset: hits on them are black.
    pub(super) fn absent(&self) -> impl Iterator<Item = u32> {
        (0..).zip(&self.by_scene).filter(|(_, at)| at.is_none()).map(|(object, _)| object)
    }

    /// Whether nothing lies between two points.
    pub(super) fn sees(&self, from: &Source, to: &Source) -> bool {
        self.is_clear((from.origin, from.base), (to.origin, to.base))
    }

    fn is_clear(&self, (from, base_from): ([f32; 3], u32), (to, base_to): ([f32; 3], u32)) -> bool {
        let direction: [f32; 3] = std::array::from_fn(|k| to[k] - from[k]);
        let excluded = [base_from.min(base_to), base_from.max(base_to)];
        direction == [0.0; 3] || !self.occluders.occluded(from, direction, WITHIN, &excluded)
    }

    /// Casts a ray; `u` in 0..1 draws a corner. Distance of the hit, what it stands for, and whether it is black although it is a front: then it
    /// stands for no more than where it is.
    pub(super) fn cast(&self, from: &Source, direction: [f32; 3], u: f64) -> (f32, Met, bool) {
        let Some(hit) = self.occluders.closest_hit(from.origin, direction, &[from.base]) else {
            return (f32::INFINITY, Met::Nobody, false);
        };
        let (met, is_black) = self.met(&hit, u).unwrap_or((Met::Nobody, false));
        (hit.t, met, is_black)
    }

    /// The corner that a hit stands for: one of those that it sees, by their weights.
    fn met(&self, hit: &Hit, u: f64) -> Option<(Met, bool)> {
        let part = &self.world.primitives[self.world.primitive[hit.triangle as usize] as usize];
        if hit.back_face && !self.scene.materials[part.material as usize].double_sided {
            return None;
        }
        let object = &self.objects[self.by_scene[part.object as usize]? as usize];
        let (triangle, weights) = object.locator.locate(hit.triangle, hit.barycentrics)?;
        let mut left = object.corners.of(triangle, weights, hit.back_face);
        let start = surface_origin(self.world, hit.triangle, hit.barycentrics, hit.back_face, object.edge_length).origin;
        let of = |point: u32| {
            let patch = object.first.partition_point(|first| *first <= point) - 1;
            Met::Point(object.first_patch + patch as u32, (point - object.first[patch]) as u8)
        };
        let (nearest, _) = left.iter().copied().reduce(|a, b| if b.1 > a.1 { b } else { a })?;
        let mut u = u;
        while let Some(drawn) = draw(&left, &mut u) {
            let (point, _) = left.swap_remove(drawn);
            let corner = &object.points[point as usize];
            if !corner.is_buried && self.is_clear((start, hit.triangle), (corner.origin, corner.base)) {
                return Some((of(point), false));
            }
        }
        Some((of(nearest), true))
    }
}

/// A hash of numbers in their order; zeros of both signs are one.
pub(super) fn hash_of<'a>(floats: impl Iterator<Item = &'a f32>) -> u64 {
    floats.fold(0xcbf2_9ce4_8422_2325, |hash, x| {
        let mixed = (hash ^ u64::from((x + 0.0).to_bits())).wrapping_mul(0x0000_0100_0000_01b3);
        mixed ^ mixed >> 29
    })
}

/// Draws one by weight, and makes what is left of the random number another.
fn draw(left: &[(u32, f32)], u: &mut f64) -> Option<usize> {
    let all: f64 = left.iter().map(|(_, weight)| f64::from(*weight)).sum();
    if all <= 0.0 {
        return None;
    }
    let mut below = 0.0;
    for (index, (_, weight)) in left.iter().enumerate() {
        let share = f64::from(*weight) / all;
        if *u < below + share || index + 1 == left.len() {
            if share > 0.0 {
                *u = ((*u - below) / share).clamp(0.0, 1.0 - f64::EPSILON);
            }
            return Some(index);
        }
        below += share;
    }
    None
}

impl ObjectPoints {
    fn read(world: &World, object: &AssetObject, in_scene: usize, first_patch: u32, store: &Store) -> Result<Self, BakeError> {
        let (mut points, mut first) = (Vec::with_capacity(object.n_points as usize), vec![0]);
        for patch in &object.patches {
            let chunk = store.chunk(&patch.points)?;
            let read = Points::from_chunk(&chunk)?;
            points.extend((0..read.flags.len()).map(|i| Source {
                position: read.position[i],
                origin: read.position[i],
                normal: read.normal[i],
                base: u32::MAX,
                is_buried: read.flags[i] & BURIED != 0,
            }));
            first.push(points.len() as u32);
        }
        let chunk = store.chunk(&object.mesh)?;
        let mesh = Mesh::from_chunk(&chunk, object.n_points)?;
        let ids = world.object_start[in_scene]..world.object_start[in_scene + 1];
        let locator = Locator::new(world, ids, &mesh);
        let corners = Corners {
            triangles: mesh.triangles.to_vec(),
            front: mesh.point_front.to_vec(),
            back: mesh.point_back.to_vec(),
            blends: mesh.blends.to_vec(),
        };
        let identities = vec![[0; 16]; object.patches.len()];
        let (edge_length, longest_edge) = (object.edge_length, 0.0);
        let mut found = ObjectPoints { points, first, first_patch, locator, corners, edge_length, longest_edge, identities };
        found.name(object, &mesh);
        found.place(world, &mesh);
        Ok(found)
    }

    /// Names patches, and measures edges.
    fn name(&mut self, object: &AssetObject, mesh: &Mesh) {
        let mut around = vec![0u64; self.identities.len()];
        let mut longest = 0.0f32;
        for corners in mesh.triangles {
            let positions = corners.map(|v| mesh.position[v as usize]);
            let hash = hash_of(positions.as_flattened().iter());
            for v in corners {
                let (front, back) = (mesh.front(*v as usize), mesh.back(*v as usize));
                // The point and its weight too, so that another choice of points for the same triangle is another name.
                for (point, share) in front.shares().chain(back.shares()) {
                    let patch = self.first.partition_point(|first| *first <= point) - 1;
                    let own = hash ^ u64::from(point - self.first[patch]) << 32 ^ u64::from(share.to_bits());
                    around[patch] = around[patch].wrapping_add(own.wrapping_mul(0x9e37_79b9_7f4a_7c15));
                }
            }
            let length = |a: [f32; 3], b: [f32; 3]| (0..3).map(|k| (a[k] - b[k]) * (a[k] - b[k])).sum::<f32>();
            longest = (0..3).map(|k| length(positions[k], positions[(k + 1) % 3])).fold(longest, f32::max);
        }
        self.longest_edge = longest.sqrt();
        for ((name, patch), around) in self.identities.iter_mut().zip(&object.patches).zip(around) {
            let mut hasher = Hasher::new("prelight bounce target");
            hasher.bytes(&patch.points.digest.0);
            hasher.bytes(&around.to_le_bytes());
            hasher.floats(&[object.edge_length]);
            *name = hasher.finish_short();
        }
    }

    /// Finds where the rays of points start: by the rule for hits, on the largest refined triangle around each, close to it.
    fn place(&mut self, world: &World, mesh: &Mesh) {
        let mut largest = vec![(0.0f32, u32::MAX, 0u8, false); self.points.len()];
        for (triangle, corners) in mesh.triangles.iter().enumerate() {
            let [a, b, c] = corners.map(|v| mesh.position[v as usize]);
            let size = twice_area(a, b, c);
            for (k, v) in corners.iter().enumerate() {
                for (lit, back) in [(mesh.front(*v as usize), false), (mesh.back(*v as usize), true)] {
                    let Lit::Point(point) = lit else { continue };
                    let known = &mut largest[point as usize];
                    if size > known.0 {
                        *known = (size, triangle as u32, k as u8, back);
                    }
                }
            }
        }
        for (point, (_, triangle, corner, back)) in self.points.iter_mut().zip(largest) {
            if let Some((base, weights)) = self.locator.near_corner(triangle as usize, usize::from(corner)) {
                point.origin = surface_origin(world, base, weights, back, self.edge_length).origin;
                point.base = base;
            }
        }
    }

    fn patch_range(&self, patch: usize) -> Range<usize> {
        self.first[patch] as usize..self.first[patch + 1] as usize
    }
}

impl Corners {
    /// Points of the corners of a refined triangle on a side, and what each weighs.
    fn of(&self, triangle: usize, weights: [f32; 3], back: bool) -> Vec<(u32, f32)> {
        let side = if back { &self.back } else { &self.front };
        let lit = Mesh { point_front: side, blends: &self.blends, ..Mesh::default() };
        let mut corners = Vec::with_capacity(3);
        for (v, weight) in self.triangles[triangle].into_iter().zip(weights) {
            corners
                .extend(lit.front(v as usize).shares().map(|(point, share)| (point, share * weight)).filter(|(_, weight)| *weight > 0.0));
        }
        corners
    }
}

fn twice_area(a: [f32; 3], b: [f32; 3], c: [f32; 3]) -> f32 {
    let edge = |p: [f32; 3]| -> [f32; 3] { std::array::from_fn(|k| p[k] - a[k]) };
    let ([a, b, c], [d, e, f]) = (edge(b), edge(c));
    let normal = [b * f - c * e, c * d - a * f, a * e - b * d];
    normal.iter().map(|x| x * x).sum::<f32>().sqrt()
}
