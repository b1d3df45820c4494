use super::raster::{Visibility, sample_pattern};
use crate::camera::{Camera, CameraRays};
use crate::chunk::mesh::{Mesh, NO_POINT};
use crate::surface::{AlphaMode, Material};

/// Plain triangles whose points are their vertices.
pub(crate) struct Soup {
    pub position: Vec<[f32; 3]>,
    pub normal: Vec<[f32; 3]>,
    pub triangles: Vec<[u32; 3]>,
    pub material: Vec<u32>,
    pub points: Vec<u32>,
    pub back: Vec<u32>,
}

impl Soup {
    pub(crate) fn new(position: Vec<[f32; 3]>, triangles: Vec<[u32; 3]>) -> Self {
        let n = position.len();
        Soup {
            position,
            normal: vec![[0.0, 0.0, 1.0]; n],
            material: vec![0; triangles.len()],
            triangles,
            points: (0..n as u32).collect(),
            back: vec![NO_POINT; n],
        }
    }

    pub(crate) fn mesh(&self) -> Mesh<'_> {
        Mesh {
            position: &self.position,
            normal: &self.normal,
            point_front: &self.points,
            point_back: &self.back,
            triangles: &self.triangles,
            material: &self.material,
            ..Mesh::default()
        }
    }
}

pub(crate) fn material(double_sided: bool, alpha_mode: AlphaMode) -> Material {
    Material { double_sided, alpha_mode, metallic: 0.0, ..Material::default() }
}

/// Looks along −z from z = 5 so that world x, y in −4..4 fill 64 x 64 pixels at z = 0.
pub(crate) fn front_camera() -> Camera {
    let fov = 2.0 * libm::atan(4.0 / 5.0) * 180.0 / std::f64::consts::PI;
    Camera::new([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], fov as f32).unwrap()
}

fn see(soup: &Soup, materials: &[Material], camera: &Camera, size: [usize; 2], samples: usize) -> Visibility {
    Visibility::new(&[soup.mesh()], materials, &[], camera, size, samples).unwrap()
}

/// Triangle that each sample sees, by brute force from the tile lists: `[pixel][sample]`.
fn per_sample(visibility: &Visibility) -> Vec<Option<u32>> {
    let n = visibility.pattern.len();
    let tiles_x = visibility.width.div_ceil(super::raster::TILE);
    let mut seen = vec![None; visibility.width * visibility.height * n];
    for (tile, fragments) in visibility.tiles.iter().enumerate() {
        for fragment in &fragments.solid {
            let pixel = usize::from(fragment.pixel);
            let x = tile % tiles_x * super::raster::TILE + pixel % super::raster::TILE;
            let y = tile / tiles_x * super::raster::TILE + pixel / super::raster::TILE;
            for s in (0..n).filter(|s| fragment.samples >> s & 1 == 1) {
                let slot = &mut seen[(y * visibility.width + x) * n + s];
                assert!(slot.is_none(), "sample seen twice");
                *slot = Some(fragment.triangle);
            }
        }
    }
    seen
}

/// Nearest front-facing hit of a ray, Möller and Trumbore in f64; the margin is the smallest weight (0 on an edge).
fn trace(soup: &Soup, eye: [f64; 3], d: [f64; 3], double_sided: bool) -> (Option<u32>, f64) {
    let sub = |a: [f64; 3], b: [f64; 3]| -> [f64; 3] { std::array::from_fn(|k| a[k] - b[k]) };
    let cross = super::camera::cross;
    let dot = crate::sphere::frame::dot;
    let (mut best, mut margin) = ((f64::INFINITY, None), 1.0f64);
    for (id, corners) in soup.triangles.iter().enumerate() {
        let [a, b, c] = corners.map(|v| soup.position[v as usize].map(f64::from));
        let (e1, e2) = (sub(b, a), sub(c, a));
        let p = cross(d, e2);
        let det = dot(e1, p);
        if det == 0.0 || (det < 0.0 && !double_sided) {
            continue;
        }
        let s = sub(eye, a);
        let u = dot(s, p) / det;
        let q = cross(s, e1);
        let v = dot(d, q) / det;
        let t = dot(e2, q) / det;
        let smallest = u.min(v).min(1.0 - u - v);
        margin = margin.min(smallest.abs());
        if smallest >= 0.0 && t > 0.0 && t < best.0 {
            best = (t, Some(id as u32));
        }
    }
    (best.1, margin)
}

/// Random numbers from a counter.
pub(crate) fn random(i: u32) -> f32 {
    let mut x = i.wrapping_mul(0x9E37_79B9) ^ 0x85EB_CA6B;
    for _ in 0..2 {
        x = (x ^ (x >> 15)).wrapping_mul(0x2C1B_3C6D);
    }
    (x >> 8) as f32 / 16_777_216.0
}

/// Triangles of all sizes, some behind the eye, some across its plane.
fn random_soup(n: u32) -> Soup {
    let mut positions = Vec::new();
    for t in 0..n {
        let size = if t % 3 == 0 { 8.0 } else { 0.7 };
        let centre: [f32; 3] = std::array::from_fn(|k| (random(t * 100 + k as u32) - 0.5) * 10.0);
        for corner in 0..3 {
            positions.push(std::array::from_fn(|k| centre[k] + (random(t * 100 + 10 * corner + 10 + k as u32) - 0.5) * size));
        }
    }
    Soup::new(positions, (0..n).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect())
}

#[test]
fn every_sample_sees_what_its_ray_hits_also_behind_and_across_the_eye_plane() {
    let soup = random_soup(120);
    let camera = Camera::new([0.3, -0.2, 1.0], [0.0, 0.4, -1.0], [0.1, 1.0, 0.0], 75.0).unwrap();
    for double_sided in [false, true] {
        let visibility = see(&soup, &[material(double_sided, AlphaMode::Opaque)], &camera, [70, 45], 16);
        let rays = CameraRays::new(&camera, 70, 45).unwrap();
        let (mut hits, mut skipped) = (0, 0);
        for (i, seen) in per_sample(&visibility).iter().enumerate() {
            let (pixel, [ox, oy]) = (i / 16, visibility.pattern[i % 16].map(f64::from));
            let d = rays.direction_f64((pixel % 70) as f64 + ox, (pixel / 70) as f64 + oy);
            let (expected, margin) = trace(&soup, camera.eye.map(f64::from), d, double_sided);
            // Within 1e-6 of an edge, in weights, rounding decides.
            if margin < 1e-6 {
                skipped += 1;
                continue;
            }
            assert_eq!(*seen, expected, "sample {i}");
            hits += usize::from(expected.is_some());
        }
        assert!(hits > 10_000 && skipped < 100, "{hits} {skipped}");
    }
}

/// A fan and strips that share every edge, drawn at places where edges and corners meet samples exactly.
#[test]
fn shared_edges_leave_no_gap_and_hit_no_sample_twice() {
    let mut soup = Soup::new(
        (0..81).map(|i| [(i % 9) as f32 - 4.0, (i / 9) as f32 - 4.0, random(i as u32) * 0.5]).collect(),
        (0..64)
            .flat_map(|i| {
                let a = i / 8 * 9 + i % 8;
                if i % 3 == 0 { [[a, a + 1, a + 10], [a, a + 10, a + 9]] } else { [[a, a + 1, a + 9], [a + 1, a + 10, a + 9]] }
            })
            .collect(),
    );
    let mut on_edge = 0;
    for (flat, size) in [(false, 64), (true, 64), (true, 65)] {
        if flat {
            // With 65 pixels the edges x = 0 and y = 0 run exactly through the samples of a column and a row (one sample a pixel).
            soup.position.iter_mut().for_each(|p| p[2] = 0.0);
        }
        for samples in [1, 4, 16, 64] {
            // As BLEND every triangle keeps its own samples: the sum must be one layer.
            let visibility = see(&soup, &[material(false, AlphaMode::Blend)], &front_camera(), [size, size], samples);
            let tiles_x = size.div_ceil(32);
            let mut layers = vec![0u8; size * size * samples];
            for (tile, fragments) in visibility.tiles.iter().enumerate() {
                assert!(fragments.solid.is_empty());
                for fragment in &fragments.blend {
                    let pixel = usize::from(fragment.pixel);
                    let (x, y) = (tile % tiles_x * 32 + pixel % 32, tile / tiles_x * 32 + pixel / 32);
                    for s in (0..samples).filter(|s| fragment.samples >> s & 1 == 1) {
                        layers[(y * size + x) * samples + s] += 1;
                    }
                }
            }
            for (i, count) in layers.iter().enumerate() {
                let (x, y) = (i / samples % size, i / samples / size);
                let inner = (2..62).contains(&x) && (2..62).contains(&y);
                assert!(*count == 1 || (!inner && *count == 0), "{samples} samples, pixel {x} {y}: {count} layers");
                on_edge += usize::from(inner && size == 65 && samples == 1 && (x == 32 || y == 32));
            }
        }
    }
    assert!(on_edge > 100);
}

#[test]
fn coverage_of_a_triangle_is_its_area() {
    let soup = Soup::new(vec![[-3.0, -3.0, 0.0], [3.5, -2.0, 0.0], [0.3, 3.1, 0.0]], vec![[0, 1, 2]]);
    let area = 0.5 * (6.5 * 6.1 - 1.0 * 3.3) * 64.0;
    for samples in [4, 16, 64] {
        let visibility = see(&soup, &[material(false, AlphaMode::Opaque)], &front_camera(), [64, 64], samples);
        let count: u32 = visibility.tiles.iter().flat_map(|tile| &tile.solid).map(|f| f.samples.count_ones()).sum();
        let seen = f64::from(count) / samples as f64;
        // A border of 150 pixels whose samples err independently: well under half a pixel row.
        assert!((seen - area).abs() < 4.0, "{seen} {area}");
    }
}

#[test]
fn the_back_of_a_single_sided_triangle_is_not_seen() {
    let mut soup = Soup::new(vec![[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]], vec![[0, 2, 1]]);
    let count = |soup: &Soup, double| {
        let visibility = see(soup, &[material(double, AlphaMode::Opaque)], &front_camera(), [64, 64], 4);
        visibility.tiles.iter().map(|tile| tile.solid.len()).sum::<usize>()
    };
    assert_eq!(count(&soup, false), 0);
    assert!(count(&soup, true) > 0);
    soup.triangles = vec![[0, 1, 2]];
    assert!(count(&soup, false) > 0);
}

#[test]
fn patterns_put_one_of_sixteen_samples_in_every_elementary_box() {
    assert_eq!(sample_pattern(1), [[0.5, 0.5]]);
    let pattern = sample_pattern(16);
    for (columns, rows) in [(16, 1), (8, 2), (4, 4), (2, 8), (1, 16)] {
        let mut boxes: Vec<usize> =
            pattern.iter().map(|[x, y]| (x * columns as f32) as usize * rows + (y * rows as f32) as usize).collect();
        boxes.sort_unstable();
        assert_eq!(boxes, (0..16).collect::<Vec<_>>(), "{columns} x {rows}");
    }
    for quarter in pattern.chunks(4) {
        assert!(quarter.iter().all(|p| (p[0] >= 0.5, p[1] >= 0.5) == (quarter[0][0] >= 0.5, quarter[0][1] >= 0.5)));
    }
}

#[test]
fn points_of_hidden_triangles_are_not_asked_for() {
    let square = |z: f32, s: f32| [[-s, -s, z], [s, -s, z], [s, s, z], [-s, s, z]];
    let positions: Vec<[f32; 3]> = [square(0.0, 3.0), square(-1.0, 1.0), square(-2.0, 9.0)].concat();
    let soup = Soup::new(positions, vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7], [8, 9, 10], [8, 10, 11]]);
    let visibility = see(&soup, &[material(false, AlphaMode::Opaque)], &front_camera(), [64, 64], 4);
    let visible = visibility.visible_points(&[soup.mesh()], &[12]);
    let expected: Vec<bool> = (0..12).map(|p| !(4..8).contains(&p)).collect();
    assert_eq!(visible[0], expected);
}

#[test]
fn not_finite_and_empty_triangles_are_left_out() {
    let mut soup = random_soup(9);
    soup.position[0] = [f32::NAN; 3];
    soup.position[4] = [f32::INFINITY, 0.0, 0.0];
    soup.position[7] = soup.position[6];
    soup.position[9] = [f32::MAX, f32::MAX, -f32::MAX];
    let visibility = see(&soup, &[material(true, AlphaMode::Opaque)], &front_camera(), [40, 40], 16);
    assert!(visibility.tiles.iter().flat_map(|tile| &tile.solid).all(|f| f.triangle > 2));
    assert!(Visibility::new(&[], &[], &[], &front_camera(), [20_000, 10], 1).is_err());
    assert!(Visibility::new(&[], &[], &[], &front_camera(), [33, 65], 1).is_ok());
}
