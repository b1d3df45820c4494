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

/// An edge length and what it makes.
#[derive(Clone, Debug, PartialEq)]
pub struct Density {
    /// Metres, three digits.
    pub edge_length: f32,
    /// `[objects]` points at it, counted; both sides.
    pub points: Vec<u64>,
}

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
    density_of(&Counter::new(scene, world, &Counts::default()), params, asked, preset)
}

/// [`density`] by what is known already.
///
/// # Errors
/// As [`density`].
pub(crate) fn density_of(objects: &Counter, params: &PointParams, asked: Option<u64>, preset: u64) -> Result<Density, PlanError> {
    let budget = asked.unwrap_or_else(|| {
        if params.coarser {
            return preset;
        }
        let unrefined = PointParams { max_level: 0, ..*params };
        preset.max(objects.total(&unrefined, u64::MAX).points.saturating_mul(2))
    });
    let count = |params: &PointParams, enough: u64| objects.total(params, enough);
    let edge_length = edge_length_by_counts(objects.longest_edge(), params, budget, &count)?;
    Ok(Density { edge_length, points: objects.each(&params.with_edge_length(edge_length)) })
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
