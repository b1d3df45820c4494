//! The edge length for a scene whose manifest pins none.
//!
//! A preset's budget of points becomes one edge length for the whole scene, once; it is printed and meant to be pinned in scene.toml.
//! A mesh that is denser than the budget by itself would then get no refinement at all, and its large walls no shadows. So where nobody
//! asked for a number of points, the budget is at least twice what the base mesh has.

use crate::cost::counts::{Counter, Counts};
use crate::error::PlanError;
use crate::mesh::PointParams;
use crate::points::count::edge_length_by_counts;
use prelight_scene::Scene;
use prelight_scene::world::World;
use rayon::prelude::*;

/// An edge length and what it makes.
#[derive(Clone, Debug, PartialEq)]
pub struct Density {
    /// Metres, three digits.
    pub edge_length: f32,
    /// `[objects]` points at it, counted; both sides. Of the object in `apart`, at its own.
    pub points: Vec<u64>,
    /// An object that is far larger than all others together, and its own edge length: it would take nearly all points otherwise.
    pub apart: Option<(usize, f32)>,
}

/// An object takes at least this share of all points to have a density of its own, in tenths.
const APART_TENTHS: u64 = 9;
/// Times that it is larger than the box around all others.
const APART_SIZE: f64 = 16.0;

impl Density {
    /// Points of the scene.
    pub fn total_points(&self) -> u64 {
        self.points.iter().sum()
    }
}

/// Edge length for a budget of points; the other knobs come from `params`.
///
/// `asked`: a budget that somebody asked for, kept as far as the base mesh lets it. Without one, `preset` points or twice the base mesh's;
/// `preset` alone where the bake may be coarser than the mesh.
/// The result does not depend on threads.
pub fn density(scene: &Scene, world: &World, params: &PointParams, asked: Option<u64>, preset: u64) -> Result<Density, PlanError> {
    density_of(&Counter::new(scene, world, &Counts::default()), params, asked, preset, false)
}

/// [`density`] by what is known already. `apart`: an object that is far larger than all others may have a density of its own.
///
/// # Errors
/// As [`density`].
pub(crate) fn density_of(
    objects: &Counter,
    params: &PointParams,
    asked: Option<u64>,
    preset: u64,
    apart: bool,
) -> Result<Density, PlanError> {
    let budget = asked.unwrap_or_else(|| {
        if params.coarser {
            return preset;
        }
        let unrefined = PointParams { max_level: 0, ..*params };
        preset.max(objects.total(&unrefined, u64::MAX).points.saturating_mul(2))
    });
    let count = |params: &PointParams, enough: u64| objects.total(params, enough);
    let edge_length = edge_length_by_counts(objects.longest_edge(), params, budget, &count)?;
    let points = objects.each(&params.with_edge_length(edge_length));
    let Some(huge) = huge(objects.world(), &points).filter(|_| apart) else { return Ok(Density { edge_length, points, apart: None }) };
    // A quarter of the points is for the huge one, the rest for what stands in front of it.
    let others = |params: &PointParams, enough: u64| objects.total_where(params, enough, |object| object != huge);
    let edge_length = edge_length_by_counts(objects.longest_edge(), params, budget - budget / 4, &others)?;
    let alone = |params: &PointParams, enough: u64| objects.total_where(params, enough, |object| object == huge);
    let own = edge_length_by_counts(objects.longest_edge(), params, budget / 4, &alone)?.max(edge_length);
    // The huge one is never counted at the fine length: that could be billions.
    let length = |object: usize| if object == huge { own } else { edge_length };
    let count = |object: usize| objects.count(object, &params.with_edge_length(length(object)), u64::MAX).points;
    let points = (0..points.len()).into_par_iter().map(count).collect();
    Ok(Density { edge_length, points, apart: Some((huge, own)) })
}

/// The object that takes nearly all of the points only because it is so large: a sky dome, a backdrop, a plane to the horizon.
fn huge(world: &World, points: &[u64]) -> Option<usize> {
    let total: u64 = points.iter().sum();
    let (huge, most) = points.iter().copied().enumerate().max_by_key(|(_, points)| *points)?;
    if most.saturating_mul(10) < total.saturating_mul(APART_TENTHS) || most == total {
        return None;
    }
    let diagonal = |keep: &dyn Fn(usize) -> bool| {
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for object in (0..points.len()).filter(|object| keep(*object)) {
            let triangles = world.object_start[object] as usize..world.object_start[object + 1] as usize;
            for corner in world.positions[triangles].iter().flatten().filter(|corner| corner.iter().all(|x| x.is_finite())) {
                for k in 0..3 {
                    (low[k], high[k]) = (low[k].min(f64::from(corner[k])), high[k].max(f64::from(corner[k])));
                }
            }
        }
        (0..3).map(|k| (high[k] - low[k]).max(0.0)).map(|side| side * side).sum::<f64>().sqrt()
    };
    (diagonal(&|object| object == huge) >= APART_SIZE * diagonal(&|object| object != huge)).then_some(huge)
}

#[cfg(test)]
mod tests {
    use super::*;
    use prelight_manifests::Quality;
    use prelight_runtime::surface::Material;
    use prelight_scene::{Mesh, Object, Primitive};
    use std::sync::Arc;

    /// A floor of 10 m of two triangles, and a dense sheet of 1 m of 2·n² triangles above it.
    fn floor_and_sheet(n: u32) -> Scene {
        let grid = |n: u32, side: f32, y: f32| {
            let at = |i: u32| side * (i as f32 / n as f32 - 0.5);
            let positions = (0..=n).flat_map(|z| (0..=n).map(move |x| [at(x), y, at(z)])).collect();
            let cell = |x: u32, z: u32| {
                let a = z * (n + 1) + x;
                [[a, a + n + 1, a + 1], [a + 1, a + n + 1, a + n + 2]]
            };
            let triangles = (0..n).flat_map(|z| (0..n).flat_map(move |x| cell(x, z))).collect();
            Primitive { positions, triangles, ..Primitive::default() }
        };
        let object = |name: &str, primitive: Primitive| Object {
            name: name.into(),
            mesh: Arc::new(Mesh { primitives: vec![primitive] }),
            world_from_local: std::array::from_fn(|i| f64::from(u8::from(i % 5 == 0))),
        };
        Scene {
            objects: vec![object("floor", grid(1, 10.0, 0.0)), object("sheet", grid(n, 1.0, 1.0))],
            materials: vec![Material::default()],
            ..Scene::default()
        }
    }

    #[test]
    fn a_huge_object_does_not_take_the_points_of_what_stands_in_it() {
        let mut scene = floor_and_sheet(2);
        // The floor becomes a plane of 1 km, the sheet stays 1 m.
        (0..3).for_each(|k| scene.objects[0].world_from_local[5 * k] = 100.0);
        let world = World::build(&scene);
        let params = PointParams::new(&Quality::Medium.knobs(), 1.0);
        let spread = |scene: &Scene, world: &World| {
            density_of(&Counter::new(scene, world, &Counts::default()), &params, Some(8000), 0, true).unwrap()
        };
        let found = spread(&scene, &world);
        let Some((0, own)) = found.apart else { panic!("{found:?}") };
        assert!(own > 5.0 && found.edge_length < 0.05, "{found:?}");
        // Both halve their edges at once: the next step has four times the points, 8450.
        assert!(found.points[1] > 1000 && found.points[0] > 500 && found.total_points() <= 8000, "{found:?}");
        // A room and a table.
        let mut ordinary = floor_and_sheet(2);
        (0..3).for_each(|k| ordinary.objects[0].world_from_local[5 * k] = 0.5);
        assert_eq!(spread(&ordinary, &World::build(&ordinary)).apart, None);
    }

    #[test]
    fn a_dense_mesh_does_not_leave_the_floor_without_points() {
        let scene = floor_and_sheet(40);
        let world = World::build(&scene);
        let params = PointParams::new(&Quality::Medium.knobs(), 1.0);
        // The sheet alone has 41² = 1681 points: a budget of 1000 affords nothing for the floor's 10 m edges.
        let asked = density(&scene, &world, &params, Some(1000), 0).unwrap();
        assert!(asked.edge_length > 7.0 && asked.total_points() < 1800, "what was asked for is kept as far as it can be: {asked:?}");
        let default = density(&scene, &world, &params, None, 1000).unwrap();
        assert!(default.edge_length < 0.5, "{default:?}");
        assert!((2000..=3400).contains(&default.total_points()), "at most twice the base mesh: {default:?}");
        let generous = density(&scene, &world, &params, None, 20_000).unwrap();
        assert!((10_000..=20_000).contains(&generous.total_points()), "a budget above that counts: {generous:?}");
    }
}
