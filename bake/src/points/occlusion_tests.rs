//! Claims about ray origins, checked with a slow occlusion test over all triangles.

use crate::mesh::origin::surface_origin;
use crate::mesh::weld::{narrow, wide};
use crate::points::test_scenes::*;
use glam::DVec3;
use prelight_runtime::asset::points::BACK_SIDE;
use prelight_scene::{Primitive, Scene};

/// Largest open share over all points of object 0, with a coarse cubemap of odd resolution: some texels lie on its axes.
fn most_open(scene: &Scene, edge_length: f32) -> (f64, usize) {
    let (world, plans) = plan(scene, &params(edge_length));
    let texels = directions(9);
    let shares = (0..plans[0].n_points()).map(|i| open_share(&world, &plans[0], i, &texels));
    (shares.fold(0.0, f64::max), plans[0].n_points())
}

fn only(primitive: Primitive) -> Scene {
    let mut scene = scene();
    add(&mut scene, "thing", vec![primitive], IDENTITY);
    scene
}

#[test]
fn a_closed_box_is_dark_inside_at_every_point() {
    for (lower, upper) in [([0.0; 3], [1.0, 2.0, 3.0]), ([-900.3, 17.7, 3.1], [-899.9, 17.9, 3.7]), ([-1e-3; 3], [2e-3, 1e-3, 1e-3])] {
        let extent = upper[2] - lower[2];
        for shape in [cuboid(lower, upper, true, 0), smooth_cuboid(lower, upper, true, 0)] {
            let (share, n) = most_open(&only(shape), extent / 6.0);
            assert_eq!(share, 0.0, "{lower:?}, {n} points");
            assert!(n >= 60, "{n}");
        }
    }
}

#[test]
fn a_mirrored_closed_box_and_the_back_of_one_are_dark_inside() {
    let mut mirror = IDENTITY;
    mirror[5] = -1.0;
    let mut scene = scene();
    add(&mut scene, "mirrored", vec![cuboid([0.0; 3], [1.0, 2.0, 3.0], true, 0)], mirror);
    assert_eq!(most_open(&scene, 0.8).0, 0.0);

    // Double-sided and wound outwards: backs are inside, fronts outside.
    for shape in [cuboid([0.0; 3], [1.0, 2.0, 3.0], false, 1), smooth_cuboid([0.0; 3], [1.0, 2.0, 3.0], false, 1)] {
        let (world, plans) = plan(&only(shape), &params(0.8));
        for i in 0..plans[0].n_points() {
            let share = open_share(&world, &plans[0], i, &directions(7));
            if plans[0].flags[i] & BACK_SIDE != 0 {
                assert_eq!(share, 0.0);
            } else {
                assert!(share > 0.9, "{share}");
            }
        }
    }
}

#[test]
fn origins_at_the_corners_of_a_room_stand_inside_it() {
    let (lower, upper) = ([3.0, 0.0, -7.0], [8.0, 2.5, -3.0]);
    let (_, plans) = plan(&only(cuboid(lower, upper, true, 0)), &params(0.5));
    for origin in &plans[0].origin {
        for k in 0..3 {
            assert!(origin[k] > lower[k] && origin[k] < upper[k], "{origin:?}");
        }
    }
}

#[test]
fn a_coarse_smooth_sphere_is_open_all_over_and_dark_inside() {
    for length in [3.0, 0.2] {
        let (world, mut plans) = plan(&only(sphere([5.0, 1.0, 2.0], 1.0, 12, 8, false)), &params(length));
        let texels = directions(16);
        for i in 0..plans[0].n_points() {
            let share = open_share(&world, &plans[0], i, &texels);
            assert_eq!(share, 1.0, "a dark facet at {:?}", plans[0].position[i]);
        }
        // Not so from the facets themselves: without the lift there would be something to see.
        if length < 1.0 {
            let flat = &mut plans[0];
            for i in 0..flat.n_points() {
                flat.origin[i] = narrow(wide(flat.position[i]) + wide(flat.geometric_normal[i]) * 1e-5);
            }
            let dark = (0..flat.n_points()).filter(|&i| open_share(&world, flat, i, &texels) < 1.0).count();
            assert!(dark > 100, "{dark} dark points without the lift");
        }
        let (share, _) = most_open(&only(sphere([5.0, 1.0, 2.0], 1.0, 12, 8, true)), length);
        assert_eq!(share, 0.0, "the same sphere from within");
    }
}

#[test]
fn a_sheet_a_tenth_of_a_millimetre_over_a_floor_keeps_it_dark() {
    let mut scene = only(quad([-1.0, 0.0, -1.0], [0.0, 0.0, 2.0], [2.0, 0.0, 0.0], 0));
    add(&mut scene, "sheet", vec![quad([-0.52, 1e-4, -0.52], [0.0, 0.0, 1.04], [1.04, 0.0, 0.0], 1)], IDENTITY);
    let (world, plans) = plan(&scene, &params(0.1));
    let plan = &plans[0];
    let (mut under, mut beside) = (0, 0);
    for i in 0..plan.n_points() {
        let [x, _, z] = plan.position[i];
        let share = open_share(&world, plan, i, &directions(8));
        if x.abs().max(z.abs()) < 0.52 - 0.2 {
            under += 1;
            assert!(share < 0.02, "light at {x} {z}: {share}");
        } else if x.abs().max(z.abs()) > 0.53 {
            beside += 1;
            assert!(share > 0.99, "dark at {x} {z}: {share}");
        }
    }
    assert!(under > 20 && beside > 20);
}

#[test]
fn walls_on_a_two_triangle_floor_do_not_leak() {
    // A hut of single sheets without a floor of its own, turned against the floor's grid, standing on two triangles of 4 m.
    let mut scene = only(quad([-2.0, 0.0, -2.0], [0.0, 0.0, 4.0], [4.0, 0.0, 0.0], 0));
    let (cos, sin) = (0.8, 0.6);
    let turned = [cos, 0.0, -sin, 0.0, 0.0, 1.0, 0.0, 0.0, sin, 0.0, cos, 0.0, 0.0, 0.0, 0.0, 1.0];
    let mut hut = cuboid([-1.0, 0.0, -1.0], [1.0, 1.5, 1.0], false, 0);
    hut.triangles.retain(|t| t.iter().any(|&v| hut.positions[v as usize][1] > 0.0));
    add(&mut scene, "hut", vec![hut], turned);
    let (world, plans) = plan(&scene, &params(0.25));
    let plan = &plans[0];
    let mut inside = 0;
    for i in 0..plan.n_points() {
        let [x, _, z] = plan.position[i].map(f64::from);
        let local = [cos * x - sin * z, sin * x + cos * z];
        if local[0].abs().max(local[1].abs()) < 1.0 - 0.5 {
            inside += 1;
            let share = open_share(&world, plan, i, &directions(8));
            assert!(share < 0.02, "light inside the hut at {x} {z}: {share}");
        }
    }
    assert!(inside > 20);
}

#[test]
fn an_open_sheet_is_lit_on_both_sides_and_dark_on_neither() {
    let mut bent = sphere([0.0; 3], 1.0, 16, 12, false);
    bent.triangles.retain(|t| t.iter().all(|&v| bent.positions[v as usize][1] > 0.7));
    bent.material = 1;
    let (world, plans) = plan(&only(bent), &params(0.1));
    let plan = &plans[0];
    for i in 0..plan.n_points() {
        let share = open_share(&world, plan, i, &directions(8));
        let back = plan.flags[i] & BACK_SIDE != 0;
        // The hollow side sees its own rim.
        assert!(if back { share > 0.5 } else { share == 1.0 }, "back {back}: {share}");
    }
}

#[test]
fn any_hit_starts_where_a_point_in_the_same_place_does() {
    let scene = only(sphere([5.0, 1.0, 2.0], 1.0, 12, 8, false));
    let length = 0.1;
    let (world, plans) = plan(&scene, &params(length));
    let plan = &plans[0];
    let mut compared = 0;
    for i in 0..plan.n_points() {
        let home = plan.refined.home[plan.source[i] as usize];
        let weights = home.weights().map(|w| f32::from(w) / 32768.0);
        if weights.contains(&0.0) {
            continue;
        }
        compared += 1;
        let triangle = plan.base.triangles[home.base as usize].id;
        let hit = surface_origin(&world, triangle, weights, false, length);
        assert!((wide(hit.origin) - wide(plan.origin[i])).length() < 4.0 * 2f64.powi(-21), "{:?} {:?}", hit.origin, plan.origin[i]);
        assert_eq!(hit.geometric_normal, plan.geometric_normal[i]);
        // Midpoints of normals are normalised level by level, a hit's once: 15° between the corners' normals.
        assert!(wide(hit.normal).dot(wide(plan.normal[i])) > 0.9999);
        assert_eq!(plan.base_triangles(i), [triangle]);
        assert!(hit.exclude_triangle);
    }
    assert!(compared > 1000);
    // The same on the back of a double-sided sheet.
    let sheet = only(quad([0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], 1));
    let world = prelight_scene::world::World::build(&sheet);
    let [front, back] = [false, true].map(|back| surface_origin(&world, 0, [0.25, 0.25, 0.5], back, 0.1));
    assert!(front.origin[2] > 0.0 && back.origin[2] < 0.0);
    assert_eq!(front.normal, back.normal.map(|x| -x));
}

#[test]
fn offsets_come_from_the_triangle_and_not_from_the_scene() {
    let (_, plans) = plan(&only(quad([0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], 0)), &params(0.05));
    for (origin, position) in plans[0].origin.iter().zip(&plans[0].position) {
        let d = wide(*origin) - wide(*position);
        assert!(d.z > 0.0 && d.z < 1e-5, "a few µm at 5 cm and 1 m: {}", d.z);
        assert!(DVec3::new(d.x, d.y, 0.0).length() < 6e-5);
    }
}
