use super::framing::automatic_view;
use super::raster_tests::{Soup, material};
use crate::camera::CameraRays;
use crate::surface::AlphaMode;

/// Triangles of a box, outward, `skip` faces left out (axis · 2 + high).
fn cuboid(low: [f32; 3], high: [f32; 3], skip: &[usize]) -> Vec<[[f32; 3]; 3]> {
    let mut triangles = Vec::new();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for side in (0..2).filter(|side| !skip.contains(&(axis * 2 + side))) {
            let corner = |s: bool, t: bool| {
                let mut p = low;
                p[axis] = if side == 1 { high[axis] } else { low[axis] };
                (p[u], p[v]) = (if s { high[u] } else { low[u] }, if t { high[v] } else { low[v] });
                p
            };
            let [a, b, c, d] = [corner(false, false), corner(true, false), corner(true, true), corner(false, true)];
            triangles.extend(if side == 1 { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] });
        }
    }
    triangles
}

fn soup(triangles: Vec<[[f32; 3]; 3]>) -> Soup {
    let n = triangles.len() as u32;
    Soup::new(triangles.concat(), (0..n).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect())
}

#[test]
fn every_vertex_is_in_the_frame_and_some_reach_its_margin() {
    for (low, high) in [([-1.0, 0.0, -2.0], [3.0, 1.0, 1.0]), ([1e4, 5.0, 0.0], [1e4 + 1.0, 9.0, 1.0]), ([-1e-4; 3], [1e-4; 3])] {
        let soup = soup(cuboid(low, high, &[]));
        for aspect in [0.5, 1.0, 16.0 / 9.0] {
            let camera = automatic_view(&[soup.mesh()], &[material(true, AlphaMode::Opaque)], &[], aspect);
            let (width, height) = ((1000.0 * aspect) as usize, 1000);
            let rays = CameraRays::new(&camera, width, height).unwrap();
            let mut nearest = f64::INFINITY;
            for p in &soup.position {
                let h = rays.homogeneous(*p);
                let (x, y) = (h[0] / h[2] / width as f64, h[1] / h[2] / 1000.0);
                assert!(h[2] > 0.0, "{camera:?}");
                nearest = nearest.min(x).min(y).min(1.0 - x).min(1.0 - y);
            }
            // FILL leaves 3.5 % on either side; f32 positions far from the origin cost a little.
            assert!((0.03..0.04).contains(&nearest), "{nearest} {camera:?}");
            assert!(camera.eye[1] > camera.look_at[1]);
        }
    }
}

#[test]
fn a_plate_that_faces_z_is_seen_from_its_front() {
    // Its front is rough: many small pyramids; its back and rim are flat.
    let mut triangles = cuboid([-1.0, 0.0, -0.05], [1.0, 1.4, 0.0], &[5]);
    for i in 0..14 {
        for j in 0..10 {
            let (x, y) = (i as f32 / 7.0 - 1.0, j as f32 * 0.14);
            let (a, b, c, d) = ([x, y, 0.0], [x + 1.0 / 7.0, y, 0.0], [x + 1.0 / 7.0, y + 0.14, 0.0], [x, y + 0.14, 0.0]);
            let top = [x + 0.07, y + 0.07, 0.05];
            triangles.extend([[a, b, top], [b, c, top], [c, d, top], [d, a, top]]);
        }
    }
    let camera = automatic_view(&[soup(triangles).mesh()], &[material(false, AlphaMode::Opaque)], &[], 1.5);
    let toward = [0, 1, 2].map(|k| camera.eye[k] - camera.look_at[k]);
    assert!(toward[2] > 0.7 * (toward[0] * toward[0] + toward[1] * toward[1]).sqrt(), "{camera:?}");
}

#[test]
fn rooms_are_looked_into_from_their_open_side_and_flats_from_above() {
    let room = |open: &[usize]| {
        let mut triangles = cuboid([-2.0, 0.0, -2.0], [2.0, 2.5, 2.0], open);
        triangles.extend(cuboid([-0.5, 0.0, -0.5], [0.5, 0.8, 0.5], &[]));
        triangles.extend(cuboid([1.0, 0.0, -1.6], [1.6, 1.4, -1.0], &[]));
        let camera = automatic_view(&[soup(triangles).mesh()], &[material(true, AlphaMode::Opaque)], &[], 16.0 / 9.0);
        [0, 1, 2].map(|k| camera.eye[k] - camera.look_at[k])
    };
    // Walls at −X and −Z only, as a stage: from +X +Z. Mirrored: from −X +Z. Only the back open: from behind.
    let [x, _, z] = room(&[1, 3, 5]);
    assert!(x > 0.0 && z > 0.0, "{x} {z}");
    let [x, _, z] = room(&[0, 3, 5]);
    assert!(x < 0.0 && z > 0.0, "{x} {z}");
    let [_, _, z] = room(&[4]);
    assert!(z < 0.0, "{z}");
    // Four walls and no ceiling: from well above.
    let [x, y, z] = room(&[3]);
    assert!(y > 0.6 * (x * x + z * z).sqrt(), "{x} {y} {z}");
}

#[test]
fn a_wide_ground_does_not_push_its_object_away() {
    let mut triangles = cuboid([-10.0, -0.01, -10.0], [10.0, 0.0, 10.0], &[]);
    triangles.extend(cuboid([-0.4, 0.0, -0.3], [0.4, 1.0, 0.3], &[]));
    let camera = automatic_view(&[soup(triangles).mesh()], &[material(true, AlphaMode::Opaque)], &[], 1.5);
    let distance = (0..3).map(|k| (camera.eye[k] - camera.look_at[k]).powi(2)).sum::<f32>().sqrt();
    assert!((1.5..6.0).contains(&distance), "{distance}");
}

#[test]
fn empty_flat_and_broken_scenes_get_a_usable_view() {
    let point = Soup::new(vec![[3.0; 3]; 3], vec![[0, 1, 2]]);
    let nan = Soup::new(vec![[f32::NAN; 3], [0.0; 3], [1.0; 3]], vec![[0, 1, 2]]);
    let flat = soup(vec![[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]]);
    for meshes in [vec![], vec![point.mesh()], vec![nan.mesh()], vec![flat.mesh()]] {
        for aspect in [1.7, 0.0, f32::NAN] {
            let camera = automatic_view(&meshes, &[], &[], aspect);
            assert!(CameraRays::new(&camera, 16, 9).is_ok(), "{camera:?}");
            assert_eq!(camera, automatic_view(&meshes, &[], &[], aspect));
        }
    }
}
