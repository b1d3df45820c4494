//! Points of one object: refinement, sides, areas, normals, ray origins, put into patches.
//!
//! A point of the refined mesh is baked once for the front and, where its material is double-sided, once for the back, with n_s and
//! n_g negated. Index of a point in the object = its place in the concatenation of the patches ([`crate::points::patch`]).
//!
//! | quantity | rule |
//! |---|---|
//! | position | linear midpoint of the edge, rounded once a level: at most half an ulp of the position off the base triangle a level |
//! | n_s | normalised mean of the ends' |
//! | n_g | area-weighted mean over the base triangles that hold the point in its own smoothing group and primitive |
//! | area | a third of the refined triangles around it, summed in f64 in mesh order |
//! | origin, excluded triangles | [`crate::mesh::origin`] |

use crate::error::PlanError;
use crate::mesh::edge::EdgeTable;
use crate::mesh::origin::{Surroundings, area_normal};
use crate::mesh::split::refine;
use crate::mesh::weld::{BaseMesh, narrow, wide};
use crate::mesh::{PointParams, Refined};
use crate::points::Patch;
use crate::points::bare::BarePoints;
use crate::points::coarse::{Stand, representatives, stand_ins};
use crate::points::draft::Drafts;
use crate::points::patch::{FIRST_LEAK_LEVEL, Place, cut_patches, thin_out};
use crate::trace::TraceOrigin;
use prelight_runtime::asset::mesh::{BLENDED, Blend, Mesh, NO_POINT};
use prelight_runtime::asset::points::{BACK_SIDE, BURIED, Points};
use prelight_scene::Scene;
use prelight_scene::world::World;
use std::sync::Arc;

/// Everything planned for one object. Arrays have one element a point, in patch order.
#[derive(Clone, Debug, Default)]
pub struct ObjectPlan {
    /// Index of the object in the scene.
    pub object: u32,
    /// World position.
    pub position: Vec<[f32; 3]>,
    /// Shading normal n_s, unit, on the point's side.
    pub normal: Vec<[f32; 3]>,
    /// Geometric normal n_g, unit, on the point's side.
    pub geometric_normal: Vec<[f32; 3]>,
    /// Surface that the point stands for, m².
    pub area: Vec<f32>,
    /// Bits [`BACK_SIDE`] and [`BURIED`].
    pub flags: Vec<u32>,
    /// Where its rays start.
    pub origin: Vec<[f32; 3]>,
    /// Patches in order; their ranges partition the points.
    pub patches: Vec<Patch>,
    /// The refined mesh.
    pub(crate) refined: Refined,
    /// The welded base mesh.
    pub(crate) base: Arc<BaseMesh>,
    /// `[refined points]` the point that shades its front.
    pub(crate) front: Vec<u32>,
    /// `[refined points]` the point that shades its back, or [`NO_POINT`].
    pub(crate) back: Vec<u32>,
    /// `[points]` the refined point behind it.
    pub(crate) source: Vec<u32>,
    /// What stands in for refined points that are not baked, ascending; empty unless the bake is coarser than the mesh.
    pub(crate) stands: Vec<Stand>,
    /// Rounds of [`crate::points::differing::split_differing`] so far.
    pub(crate) leak_rounds: u8,
    /// `[points]` mean edges, of a plan without a mesh; empty where the mesh tells.
    mean_edges: Vec<f64>,
    /// Excluded triangles of point i: `excluded[excluded_start[i]..excluded_start[i + 1]]`.
    excluded_start: Vec<u32>,
    excluded: Vec<u32>,
}

/// Plans one object: reads nothing of any other.
///
/// Deterministic; objects can be planned in parallel. An object without a triangle that has an area gives an empty plan.
pub fn plan_object(scene: &Scene, world: &World, object: usize, params: &PointParams) -> Result<ObjectPlan, PlanError> {
    params.check()?;
    let base = Arc::new(BaseMesh::build(scene, world, object));
    let refined = refine(&base, params)?;
    let mut plan = ObjectPlan { object: object as u32, excluded_start: vec![0], base, refined, ..ObjectPlan::default() };
    let mut baked = vec![true; plan.refined.level.len()];
    if params.coarser {
        baked = representatives(&plan.base, &plan.refined, params);
        plan.stands = stand_ins(&plan.refined, params.edge_length, &mut baked);
    }
    let points: Vec<u32> = (0..baked.len() as u32).filter(|point| baked[*point as usize]).collect();
    plan.append(&points, None, params);
    Ok(plan)
}

impl ObjectPlan {
    /// Points alone: what can be asked of such a plan is what baking a factor asks, no mesh and no areas.
    pub(crate) fn bare(points: BarePoints) -> ObjectPlan {
        let mut excluded_start = vec![0];
        excluded_start.extend(points.n_excluded.iter().scan(0, |end, n| {
            *end += n;
            Some(*end)
        }));
        ObjectPlan {
            object: points.object,
            position: points.origin.clone(),
            normal: points.normal,
            geometric_normal: points.geometric_normal,
            area: vec![0.0; points.origin.len()],
            flags: points.flags,
            origin: points.origin,
            patches: points.patches,
            mean_edges: points.mean_edges,
            excluded_start,
            excluded: points.excluded,
            ..ObjectPlan::default()
        }
    }

    /// Mean edge of the base triangle that a point was made in, metres.
    pub(crate) fn mean_edge(&self, i: u32) -> f64 {
        if let Some(edge) = self.mean_edges.get(i as usize) {
            return *edge;
        }
        let home = self.refined.home[self.source[i as usize] as usize];
        Surroundings::new(std::iter::once(self.base.corner_positions(home.base)), 1.0).mean_edge
    }

    /// Number of points.
    pub(crate) fn n_points(&self) -> usize {
        self.position.len()
    }

    /// Number of refined triangles.
    pub(crate) fn n_triangles(&self) -> usize {
        self.refined.triangles.len()
    }

    /// The points chunk of a patch, borrowed.
    pub(crate) fn points(&self, patch: &Patch) -> Points<'_> {
        let range = patch.range();
        Points {
            position: &self.position[range.clone()],
            normal: &self.normal[range.clone()],
            geometric_normal: &self.geometric_normal[range.clone()],
            area: &self.area[range.clone()],
            flags: &self.flags[range],
        }
    }

    /// Ids of the base triangles that never block point `i`, ascending.
    pub(crate) fn base_triangles(&self, i: usize) -> &[u32] {
        &self.excluded[self.excluded_start[i] as usize..self.excluded_start[i + 1] as usize]
    }

    /// What the tracer needs of point `i`.
    pub fn trace_origin(&self, i: usize) -> TraceOrigin<'_> {
        TraceOrigin { origin: self.origin[i], normal: self.normal[i], base_triangles: self.base_triangles(i) }
    }

    /// Marks points as buried: draw does not interpolate from them.
    pub(crate) fn mark_buried(&mut self, points: &[u32]) {
        points.iter().for_each(|&i| self.flags[i as usize] |= BURIED);
    }

    /// Number of points marked as buried.
    pub(crate) fn n_buried(&self) -> usize {
        self.flags.iter().filter(|&&f| f & BURIED != 0).count()
    }

    /// The draw mesh.
    pub(crate) fn mesh(&self) -> ObjectMesh {
        let vertices = &self.refined.vertices;
        let of = |values: &[[f32; 3]]| vertices.point.iter().map(|&p| values[p as usize]).collect();
        let mut blends = Vec::new();
        let front = self.lit(&self.front, &mut blends);
        let back = self.lit(&self.back, &mut blends);
        let points = |side: &[u32]| vertices.point.iter().map(|&p| side[p as usize]).collect();
        let material = |base: u32| self.base.primitives[self.base.triangles[base as usize].primitive as usize].material;
        ObjectMesh {
            position: of(&self.refined.points.position),
            normal: of(&self.refined.points.normal),
            point_front: points(&front),
            point_back: points(&back),
            triangles: self.refined.triangles.iter().map(|t| t.vertices).collect(),
            material: self.refined.triangles.iter().map(|t| material(t.base)).collect(),
            uv0: vertices.uv[0].clone(),
            uv1: vertices.uv[1].clone(),
            tangent: vertices.tangent.clone(),
            color: vertices.color.clone(),
            blends,
        }
    }

    /// What lights one side of each refined point, as the mesh chunk says it.
    fn lit(&self, side: &[u32], blends: &mut Vec<Blend>) -> Vec<u32> {
        let mut lit = side.to_vec();
        for stand in &self.stands {
            let points = stand.sources.map(|source| side[source as usize]);
            if !points.contains(&NO_POINT) {
                lit[stand.point as usize] = BLENDED + blends.len() as u32;
                blends.push(Blend { points, weights: stand.weights });
            }
        }
        lit
    }

    /// Bakes points that something stood in for: those of which two sources differ. `None` when there is none.
    ///
    /// `differs` is as in [`crate::points::differing::split_differing`]. Points so far keep their indices, patches, names and flags.
    pub(crate) fn without_leaking_stands(&self, params: &PointParams, differs: &dyn Fn(u32, u32) -> bool) -> Option<ObjectPlan> {
        let level = FIRST_LEAK_LEVEL.checked_add(self.leak_rounds)?;
        let mut asked = EdgeTable::default();
        let mut leaks = |stand: &&Stand| {
            let mut leaks = false;
            for (k, &a) in stand.sources.iter().enumerate() {
                for &b in stand.sources[..k].iter().filter(|b| **b != a) {
                    let differ = |side: &[u32]| {
                        let (i, j) = (side[a as usize], side[b as usize]);
                        i != NO_POINT && j != NO_POINT && differs(i.min(j), i.max(j))
                    };
                    let known = asked.get(a, b);
                    let answer = known.unwrap_or_else(|| u32::from(differ(&self.front) || differ(&self.back)));
                    asked.get_or_insert(a, b, answer);
                    leaks |= answer == 1;
                }
            }
            leaks
        };
        let points: Vec<u32> = self.stands.iter().filter(&mut leaks).map(|stand| stand.point).collect();
        if points.is_empty() {
            return None;
        }
        let mut next = self.clone();
        let mut baked = vec![true; next.refined.level.len()];
        next.stands.iter().for_each(|stand| baked[stand.point as usize] = false);
        points.iter().for_each(|point| baked[*point as usize] = true);
        next.stands = stand_ins(&next.refined, params.edge_length, &mut baked);
        let is_new = |point: &u32| baked[*point as usize] && next.front[*point as usize] == NO_POINT;
        let points: Vec<u32> = (0..baked.len() as u32).filter(is_new).collect();
        next.leak_rounds += 1;
        next.append(&points, Some(level), params);
        Some(next)
    }

    /// Adds refined points as patches of their own, and sums the areas anew. `level` as in [`Drafts::new`].
    pub(crate) fn append(&mut self, points: &[u32], level: Option<u8>, params: &PointParams) {
        let first_point = self.n_points();
        let drafts = Drafts::new(&self.base, &self.refined, points, level, params.edge_length);
        let mut places: Vec<Place> = (drafts.sides.iter().zip(0..)).map(|(d, point)| Place { point, ..d.place }).collect();
        if level.is_none() {
            thin_out(&mut places);
        }
        places.sort_unstable();
        self.patches.extend(cut_patches(&places, first_point as u32));
        self.front.resize(self.refined.level.len(), NO_POINT);
        self.back.resize(self.refined.level.len(), NO_POINT);
        self.reserve(places.len(), drafts.excluded.len());
        for place in &places {
            let draft = &drafts.sides[place.point as usize];
            let point = draft.place.point;
            let sign = if place.back { -1.0 } else { 1.0 };
            let side = if place.back { &mut self.back } else { &mut self.front };
            side[point as usize] = self.position.len() as u32;
            self.position.push(self.refined.points.position[point as usize]);
            self.normal.push(narrow(wide(self.refined.points.normal[point as usize]) * sign));
            self.geometric_normal.push(draft.geometric_normal);
            self.origin.push(draft.origin);
            self.flags.push(if place.back { BACK_SIDE } else { 0 });
            self.source.push(point);
            self.excluded.extend_from_slice(drafts.excluded(draft));
            self.excluded_start.push(self.excluded.len() as u32);
        }
        self.sum_areas();
    }

    fn reserve(&mut self, points: usize, excluded: usize) {
        self.position.reserve_exact(points);
        self.normal.reserve_exact(points);
        self.geometric_normal.reserve_exact(points);
        self.origin.reserve_exact(points);
        self.flags.reserve_exact(points);
        self.source.reserve_exact(points);
        self.excluded.reserve_exact(excluded);
        self.excluded_start.reserve_exact(points);
    }

    /// Areas of all points: splitting triangles changes those of old points too.
    pub(crate) fn sum_areas(&mut self) {
        let refined = &self.refined;
        let mut sums = vec![0.0f64; refined.level.len()];
        for triangle in &refined.triangles {
            let points = triangle.vertices.map(|v| refined.point(v));
            let corners = points.map(|p| refined.points.position[p as usize]);
            let share = area_normal(&corners).length() / 6.0;
            points.iter().for_each(|&p| sums[p as usize] += share);
        }
        for stand in &self.stands {
            let sum = sums[stand.point as usize];
            stand.sources.iter().zip(stand.weights).for_each(|(&p, weight)| sums[p as usize] += sum * f64::from(weight));
        }
        self.area = self.source.iter().map(|&p| sums[p as usize] as f32).collect();
    }
}

/// The refined mesh of an object as draw wants it, owned. See [`Mesh`] for shapes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ObjectMesh {
    /// World position.
    pub position: Vec<[f32; 3]>,
    /// Front shading normal.
    pub normal: Vec<[f32; 3]>,
    /// Point that shades the front, or [`NO_POINT`], or [`BLENDED`] + index into `blends`.
    pub point_front: Vec<u32>,
    /// The same for the back.
    pub point_back: Vec<u32>,
    /// Vertex indices.
    pub triangles: Vec<[u32; 3]>,
    /// Index into the scene's materials.
    pub material: Vec<u32>,
    /// First texture coordinates, or empty. Zero where a primitive of the object has none.
    pub uv0: Vec<[f32; 2]>,
    /// Second texture coordinates, likewise.
    pub uv1: Vec<[f32; 2]>,
    /// Tangent and bitangent sign; empty if no material of the object has a normal map, zero where this one has none.
    pub tangent: Vec<[f32; 4]>,
    /// Linear RGBA, or empty. One where a primitive of the object has none.
    pub color: Vec<[f32; 4]>,
    /// What lights vertices without a point of their own.
    pub blends: Vec<Blend>,
}

impl ObjectMesh {
    /// Borrowed, to become a chunk.
    pub(crate) fn view(&self) -> Mesh<'_> {
        Mesh {
            position: &self.position,
            normal: &self.normal,
            point_front: &self.point_front,
            point_back: &self.point_back,
            triangles: &self.triangles,
            material: &self.material,
            uv0: &self.uv0,
            uv1: &self.uv1,
            tangent: &self.tangent,
            color: &self.color,
            blends: &self.blends,
        }
    }
}
