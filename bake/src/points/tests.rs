//! Claims about points that need no tracer, and those that a slow occlusion test can check.

use crate::error::PlanError;
use crate::mesh::PointParams;
use crate::mesh::weld::{BaseMesh, wide};
use crate::points::PatchName;
use crate::points::test_scenes::*;
use crate::points::{ObjectPlan, plan_object};
use prelight_runtime::asset::mesh::NO_POINT;
use prelight_runtime::asset::points::BACK_SIDE;
use prelight_scene::world::World;
use prelight_scene::{Primitive, Scene};
use std::collections::{BTreeMap, BTreeSet};

fn only(primitives: Vec<Primitive>) -> Scene {
    let mut scene = scene();
    add(&mut scene, "thing", primitives, IDENTITY);
    scene
}

fn base(scene: &Scene) -> BaseMesh {
    BaseMesh::build(scene, &World::build(scene), 0)
}

/// Arrays agree in length, patches partition the points, areas sum to the surface, unit normals, triangles excluded in order.
fn check_invariants(plan: &ObjectPlan) {
    let n = plan.n_points();
    let lengths = [plan.normal.len(), plan.geometric_normal.len(), plan.area.len(), plan.flags.len(), plan.origin.len()];
    assert_eq!(lengths, [n; 5]);
    let mut next = 0;
    let mut names = BTreeSet::new();
    for patch in &plan.patches {
        assert_eq!(patch.first, next);
        assert!((1..=256).contains(&patch.n_points), "{patch:?}");
        assert!(names.insert(patch.name), "two patches are called {:?}", patch.name);
        next += patch.n_points;
        for i in patch.range() {
            let back = plan.flags[i] & BACK_SIDE != 0;
            assert_eq!(back, patch.name.back);
            let axis = patch.name.axis as usize;
            let component = plan.geometric_normal[i][axis / 2];
            assert!(component.abs() >= 0.577 && (component < 0.0) == (axis % 2 == 1), "{:?} {axis}", plan.geometric_normal[i]);
        }
    }
    assert_eq!(next as usize, n);
    for i in 0..n {
        assert!((wide(plan.normal[i]).length() - 1.0).abs() < 1e-6 && (wide(plan.geometric_normal[i]).length() - 1.0).abs() < 1e-6);
        assert!(plan.base_triangles(i).windows(2).all(|w| w[0] < w[1]));
        assert!(plan.area[i] > 0.0);
    }
    let mesh = plan.mesh();
    assert!(mesh.triangles.iter().flatten().all(|&v| (v as usize) < mesh.position.len()));
    for (v, &p) in mesh.point_front.iter().enumerate() {
        assert_eq!((mesh.position[v], mesh.normal[v]), (plan.position[p as usize], plan.normal[p as usize]));
        let back = mesh.point_back[v];
        if back != NO_POINT {
            assert_eq!(plan.normal[back as usize], mesh.normal[v].map(|x| -x));
        }
    }
    let area = |side: bool| -> f64 { (0..n).filter(|&i| (plan.flags[i] & BACK_SIDE != 0) == side).map(|i| f64::from(plan.area[i])).sum() };
    let surface: f64 = mesh.triangles.iter().map(|t| triangle_area(t.map(|v| mesh.position[v as usize]))).sum();
    // f32 rounding of each point's area.
    assert!((area(false) - surface).abs() <= 1e-6 * surface, "{} {surface}", area(false));
}

fn triangle_area(corners: [[f32; 3]; 3]) -> f64 {
    crate::mesh::origin::area_normal(&corners).length() / 2.0
}

/// Every edge of the refined mesh, by positions: how often it runs each way.
fn edge_uses(plan: &ObjectPlan) -> BTreeMap<[[u32; 3]; 2], [u32; 2]> {
    let mesh = plan.mesh();
    let mut uses = BTreeMap::new();
    for t in &mesh.triangles {
        for k in 0..3 {
            let [a, b] = [t[k], t[(k + 1) % 3]].map(|v| mesh.position[v as usize].map(f32::to_bits));
            let (key, way) = if a <= b { ([a, b], 0) } else { ([b, a], 1) };
            uses.entry(key).or_insert([0; 2])[way] += 1;
        }
    }
    uses
}

/// A closed surface stays closed: each edge is used exactly once each way, so no vertex lies inside a neighbour's edge.
fn check_watertight(plan: &ObjectPlan) {
    for (edge, uses) in edge_uses(plan) {
        assert_eq!(uses, [1, 1], "T-vertex or hole at {:?}", edge.map(|p| p.map(f32::from_bits)));
    }
}

#[test]
fn closed_meshes_stay_closed_at_any_edge_length_and_angle() {
    let shapes = [
        cuboid([0.0; 3], [1.0, 0.01, 3.0], false, 0),
        smooth_cuboid([-1.0; 3], [1.0, 2.0, 0.5], false, 1),
        sphere([0.3, -2.0, 9.0], 1.7, 12, 8, false),
        sphere([0.0; 3], 0.5, 5, 3, false),
    ];
    for (i, shape) in shapes.into_iter().enumerate() {
        for (length, angle) in [(10.0, 180.0), (0.4, 180.0), (10.0, 11.0), (0.13, 20.0)] {
            let scene = only(vec![shape.clone()]);
            let params = PointParams { normal_angle_deg: angle, ..params(length) };
            let (_, plans) = plan(&scene, &params);
            check_watertight(&plans[0]);
            check_invariants(&plans[0]);
            assert!(plans[0].n_triangles() >= shape.triangles.len(), "{i}");
        }
    }
}

#[test]
fn noisy_closed_meshes_stay_closed_where_normals_split_only_one_side_of_a_crease() {
    // A sphere whose triangles have their own normals on one half and smooth, wildly turned ones on the other.
    for seed in 0..6u32 {
        let mut state = u64::from(seed) * 77 + 1;
        let mut random = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 40) as f32 / (1u64 << 24) as f32 - 0.5
        };
        let mut shape = sphere([0.0; 3], 1.0, 9, 7, false);
        for p in &mut shape.positions {
            *p = p.map(|x| x + 0.1 * random());
        }
        for n in shape.normals.iter_mut().flatten() {
            *n = if random() > 0.1 { [0.0; 3] } else { n.map(|x| x + 0.6 * random()) };
        }
        let scene = only(vec![shape]);
        let (_, plans) = plan(&scene, &PointParams { normal_angle_deg: 15.0, ..params(0.3) });
        assert!(plans[0].n_triangles() > 500, "seed {seed}");
        check_watertight(&plans[0]);
        check_invariants(&plans[0]);
    }
}

#[test]
fn points_are_welded_by_position_normal_and_primitive_but_not_by_uv() {
    // Two coplanar squares side by side, all corners written out, with a uv seam between them.
    let mut strip = quad([0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], 0);
    let other = quad([1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], 0);
    strip.positions.extend(&other.positions);
    strip.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + 4)));
    strip.uvs[0] = Some(vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]);
    let mesh = base(&only(vec![strip.clone()]));
    assert_eq!(mesh.points.position.len(), 6, "flat and coplanar: equal normals weld");
    assert_eq!(mesh.vertices.point.len(), 8, "the seam keeps its vertices");
    assert_eq!(mesh.n_sites, 6);

    // The same surface as two primitives: the border is not welded, but it is one site.
    let two = only(vec![quad([0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], 0), other]);
    let mesh = base(&two);
    assert_eq!((mesh.points.position.len(), mesh.n_sites), (8, 6));

    // A box: three points at each corner, one site.
    let mesh = base(&only(vec![cuboid([0.0; 3], [1.0; 3], false, 0)]));
    assert_eq!((mesh.points.position.len(), mesh.n_sites), (24, 8));
    let mesh = base(&only(vec![smooth_cuboid([0.0; 3], [1.0; 3], false, 0)]));
    assert_eq!((mesh.points.position.len(), mesh.n_sites), (8, 8));

    // The seam survives refinement: half-way vertices of both sides share one point.
    let (_, plans) = plan(&only(vec![strip]), &params(0.6));
    let mesh = plans[0].mesh();
    let at_seam: Vec<usize> = (0..mesh.position.len()).filter(|&v| mesh.position[v] == [1.0, 0.5, 0.0]).collect();
    assert_eq!(at_seam.len(), 2);
    assert_eq!(mesh.point_front[at_seam[0]], mesh.point_front[at_seam[1]]);
    let mut uvs = at_seam.iter().map(|&v| mesh.uv0[v]).collect::<Vec<_>>();
    uvs.sort_by(|a, b| a.partial_cmp(b).unwrap());
    assert_eq!(uvs, [[0.0, 0.5], [1.0, 0.5]]);
}

#[test]
fn double_sided_surfaces_have_back_points_with_negated_normals() {
    let scene = only(vec![quad([0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], 1)]);
    let (world, plans) = plan(&scene, &params(0.3));
    let plan = &plans[0];
    check_invariants(plan);
    let n_back = plan.flags.iter().filter(|f| **f & BACK_SIDE != 0).count();
    assert_eq!(2 * n_back, plan.n_points());
    assert!(plan.mesh().point_back.iter().all(|&p| p != NO_POINT));
    for i in 0..plan.n_points() {
        let height = plan.origin[i][1];
        let expected = if plan.flags[i] & BACK_SIDE != 0 { 1.0 } else { -1.0 };
        assert_eq!(plan.normal[i], [0.0, expected, 0.0], "e1 × e2 points down");
        assert!(height * expected > 0.0, "each side starts on its own side");
        assert_eq!(open_share(&world, plan, i, &directions(4)), 1.0);
    }
}

#[test]
fn a_mirrored_instance_faces_outwards_from_both_sides() {
    let mut mirror = IDENTITY;
    mirror[0] = -1.0;
    mirror[12] = 5.0;
    for material in [0, 1] {
        let mut scene = scene();
        let shape = sphere([0.5, 0.0, 0.0], 1.0, 12, 8, false);
        add(&mut scene, "plain", vec![Primitive { material, ..shape.clone() }], IDENTITY);
        add(&mut scene, "mirrored", vec![Primitive { material, ..shape }], mirror);
        let (_, plans) = plan(&scene, &params(0.4));
        let (plain, mirrored) = (&plans[0], &plans[1]);
        check_invariants(mirrored);
        check_watertight(mirrored);
        assert_eq!((plain.n_points(), plain.n_triangles()), (mirrored.n_points(), mirrored.n_triangles()));
        for (plan, centre) in [(plain, [0.5, 0.0, 0.0]), (mirrored, [4.5, 0.0, 0.0])] {
            for i in 0..plan.n_points() {
                let outwards = wide(plan.position[i]) - wide(centre);
                let side = if plan.flags[i] & BACK_SIDE != 0 { -1.0 } else { 1.0 };
                assert!(side * wide(plan.normal[i]).dot(outwards) > 0.9);
                assert!(side * wide(plan.geometric_normal[i]).dot(outwards) > 0.8);
            }
        }
    }
}

#[test]
fn winding_against_the_normals_flips_the_normals_to_the_front() {
    let mut quad = quad([0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], 0);
    quad.normals = Some(vec![[0.0, 0.0, -1.0]; 4]);
    let (_, plans) = plan(&only(vec![quad]), &params(2.0));
    assert!(plans[0].normal.iter().all(|n| *n == [0.0, 0.0, 1.0]));
}

#[test]
fn slivers_are_cut_along_their_length_only() {
    let strip = primitive(vec![[0.0; 3], [8.0, 0.0, 0.0], [8.0, 0.01, 0.0], [0.0, 0.01, 0.0]], vec![[0, 1, 2], [0, 2, 3]], 0);
    let (_, plans) = plan(&only(vec![strip]), &params(0.26));
    // 32 pieces on both long edges and on the diagonal: two strips of 32 + 32 + 1 − 2 triangles. 1-to-4 would make 2·4⁵ = 2048.
    let plan = &plans[0];
    check_invariants(plan);
    assert_eq!(plan.n_triangles(), 2 * 63);
    assert_eq!(plan.n_points(), 3 * 33 - 2, "no point off the three long edges");
    let mesh = plan.mesh();
    for t in &mesh.triangles {
        for k in 0..3 {
            let [a, b] = [t[k], t[(k + 1) % 3]].map(|v| wide(mesh.position[v as usize]));
            assert!((b - a).length() <= 0.26 * 4.0 / 3.0 * 1.42, "rungs are at most √2 longer than edges");
        }
    }
}

#[test]
fn triangles_with_one_two_or_three_split_edges_become_two_three_or_four() {
    let pieces = |corners: [[f32; 3]; 3]| {
        let (_, plans) = plan(&only(vec![primitive(corners.to_vec(), vec![[0, 1, 2]], 0)]), &params(0.75));
        check_invariants(&plans[0]);
        plans[0].n_triangles()
    };
    assert_eq!(pieces([[0.0; 3], [0.9, 0.0, 0.0], [0.4, 0.8, 0.0]]), 1);
    assert_eq!(pieces([[0.0; 3], [1.2, 0.0, 0.0], [0.6, 0.7, 0.0]]), 2);
    assert_eq!(pieces([[0.0; 3], [1.2, 0.0, 0.0], [1.0, 0.9, 0.0]]), 3);
    assert_eq!(pieces([[0.0; 3], [1.2, 0.0, 0.0], [0.6, 1.1, 0.0]]), 4);
    assert_eq!(pieces([[0.0; 3], [1.9, 0.0, 0.0], [0.9, 0.7, 0.0]]), 4);
}

#[test]
fn zero_area_triangles_and_empty_objects_make_no_points() {
    let mut odd = quad([0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], 0);
    odd.triangles.insert(0, [1, 1, 2]);
    odd.positions.push([f32::NAN, 0.0, 0.0]);
    odd.triangles.push([0, 4, 1]);
    let mut scene = only(vec![odd]);
    add(&mut scene, "nothing", vec![primitive(vec![[1.0; 3]; 3], vec![[0, 1, 2]], 0)], IDENTITY);
    let (_, plans) = plan(&scene, &params(0.5));
    check_invariants(&plans[0]);
    assert!(plans[0].position.iter().flatten().all(|x| x.is_finite()));
    assert_eq!((plans[1].n_points(), plans[1].n_triangles(), plans[1].patches.len()), (0, 0, 0));
}

#[test]
fn a_far_object_changes_no_point_and_no_name_of_another() {
    let mut scene = only(vec![sphere([1.0; 3], 2.0, 16, 9, false), quad([0.0; 3], [4.0, 0.0, 0.0], [0.0, 0.0, 4.0], 1)]);
    let (_, before) = plan(&scene, &params(0.2));
    add(&mut scene, "far", vec![cuboid([0.0; 3], [0.01; 3], false, 0)], translation(4.0e4, -3.0e4, 1.0e4));
    let (_, after) = plan(&scene, &params(0.2));
    assert_eq!(digest(&before[0]), digest(&after[0]));
    assert!(before[0].n_points() > 2000);
}

/// Every array of a plan as text.
fn digest(plan: &ObjectPlan) -> String {
    let excluded: Vec<&[u32]> = (0..plan.n_points()).map(|i| plan.base_triangles(i)).collect();
    let points = (&plan.position, &plan.normal, &plan.geometric_normal, &plan.area, &plan.flags, &plan.origin);
    format!("{points:?} {:?} {excluded:?} {:?}", plan.patches, plan.mesh())
}

#[test]
fn the_same_object_is_planned_to_the_same_bits_anywhere_among_others() {
    let shape = || vec![sphere([1.0; 3], 2.0, 16, 9, false)];
    let mut scene = only(shape());
    add(&mut scene, "copy", shape(), IDENTITY);
    let (_, plans) = plan(&scene, &params(0.2));
    assert_eq!(digest(&plans[0]).replace(char::is_numeric, "").len(), digest(&plans[1]).replace(char::is_numeric, "").len());
    let (_, again) = plan(&scene, &params(0.2));
    assert_eq!(digest(&plans[0]), digest(&again[0]));
    assert_eq!((&plans[0].position, &plans[0].origin, &plans[0].patches), (&plans[1].position, &plans[1].origin, &plans[1].patches));
}

#[test]
fn a_finer_edge_length_keeps_the_points_and_names_of_coarser_levels() {
    let keep = |shape: Primitive, levels: std::ops::RangeInclusive<u8>| {
        let scene = only(vec![shape]);
        let world = World::build(&scene);
        let [coarse, fine] = [0.30, 0.075].map(|length| plan_object(&scene, &world, 0, &params(length)).unwrap());
        assert!(fine.n_points() > 4 * coarse.n_points());
        let points = |plan: &ObjectPlan| -> Vec<(PatchName, Vec<[f32; 3]>)> {
            let wanted = plan.patches.iter().filter(|p| levels.contains(&p.name.level));
            wanted.map(|p| (p.name, plan.position[p.range()].to_vec())).collect()
        };
        let (coarse, fine) = (points(&coarse), points(&fine));
        assert!(!coarse.is_empty() && coarse == fine, "a name or a point changed");
    };
    // Base points stay whatever happens, whole rounds stay where both lengths split every edge.
    keep(sphere([1.0; 3], 2.0, 12, 8, false), 0..=0);
    keep(quad([0.0; 3], [9.0, 0.0, 0.0], [0.0, 0.0, 9.0], 1), 0..=4);
}

#[test]
fn levels_are_nested_and_base_points_are_the_meshs_own() {
    let scene = only(vec![sphere([0.0; 3], 1.0, 12, 8, false)]);
    let (_, plans) = plan(&scene, &params(0.1));
    let level_0: usize = plans[0].patches.iter().filter(|p| p.name.level == 0).map(|p| p.n_points as usize).sum();
    assert_eq!(level_0, 12 * 7 + 2);
    assert!(plans[0].patches.windows(2).all(|w| w[0].name < w[1].name));
}

#[test]
fn too_many_triangles_is_an_error_that_names_the_object() {
    let scene = only(vec![quad([0.0; 3], [1.0e5, 0.0, 0.0], [0.0, 1.0e5, 0.0], 0)]);
    let world = World::build(&scene);
    let params = PointParams { max_triangles: 10_000, ..params(0.05) };
    let error = plan_object(&scene, &world, 0, &params).unwrap_err();
    assert!(matches!(&error, PlanError::TooManyTriangles { object, .. } if object == "thing"), "{error}");
    for bad in [PointParams { edge_length: 0.0, ..params }, PointParams { normal_angle_deg: f32::NAN, ..params }] {
        assert!(matches!(plan_object(&scene, &world, 0, &bad), Err(PlanError::Range { .. })));
    }
}
