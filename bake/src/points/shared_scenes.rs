//! Claims about the development scenes, where they are.

use crate::mesh::PointParams;
use crate::mesh::weld::BaseMesh;
use crate::points::count::{PointCount, count_object, edge_length_for_points};
use crate::points::plan_object;
use prelight_manifests::Quality;
use prelight_scene::Scene;
use prelight_scene::gltf::{LoadLimits, load};
use prelight_scene::world::World;
use std::path::Path;

fn shared(name: &str) -> Option<(Scene, World)> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/scenes").join(name).with_extension("glb");
    if !path.exists() {
        eprintln!("SKIPPED: {} is not there", path.display());
        return None;
    }
    let scene = load(&path, &LoadLimits::default()).unwrap_or_else(|e| panic!("{e}"));
    let world = World::build(&scene);
    Some((scene, world))
}

#[test]
fn apartment_at_5_cm_stays_under_a_million_and_a_half_triangles() {
    let Some((scene, world)) = shared("apartment") else { return };
    let params = PointParams::new(&Quality::Medium.knobs(), 0.05);
    let mut planned = PointCount::default();
    let mut counted = PointCount::default();
    let mut n_patches = 0;
    for object in 0..scene.objects.len() {
        let plan = plan_object(&scene, &world, object, &params).unwrap();
        planned.points += plan.n_points() as u64;
        planned.triangles += plan.n_triangles() as u64;
        n_patches += plan.patches.len();
        let count = count_object(&plan.base, &params, u64::MAX);
        counted.points += count.points;
        counted.triangles += count.triangles;
    }
    println!("{planned:?}, {n_patches} patches; counted {counted:?}");
    assert!(planned.triangles < 1_500_000, "{planned:?}");
    assert!(planned.triangles > 1_000_000, "5 cm is not coarser than it says: {planned:?}");
    // Hard edges that are split for a neighbour's normals are not counted.
    assert!(counted.points <= planned.points && counted.points * 100 > planned.points * 98, "{counted:?} {planned:?}");
}

#[test]
fn a_budget_of_200_000_points_is_kept_on_table_chairs() {
    let Some((scene, world)) = shared("table_chairs") else { return };
    let params = PointParams::new(&Quality::Medium.knobs(), 1.0);
    let length = edge_length_for_points(&BaseMesh::build_all(&scene, &world), &params, 200_000).unwrap();
    let params = params.with_edge_length(length);
    let points: usize = (0..scene.objects.len()).map(|o| plan_object(&scene, &world, o, &params).unwrap().n_points()).sum();
    // Hard edges that are split for a neighbour's normals are not counted: 1 %.
    assert!((100_000..=202_000).contains(&points), "{points} points at {length} m");
}
