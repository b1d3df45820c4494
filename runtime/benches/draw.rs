//! Drawing 1280 x 720 at 16 samples a pixel over 1.2 million triangles, and the metrics of such a picture.
//!
//! Each part also checks its answer: a wavy floor fills the lower half and takes a constant light.

use criterion::{Criterion, criterion_group, criterion_main};
use prelight_runtime::asset::mesh::{Mesh, NO_POINT};
use prelight_runtime::draw::{Camera, DrawObject, DrawScene, Image, Visibility, draw_visible, metrics};
use prelight_runtime::surface::Material;
use std::hint::black_box;

const SIDE: u32 = 774;
const SIZE: [usize; 2] = [1280, 720];

struct Floor {
    position: Vec<[f32; 3]>,
    normal: Vec<[f32; 3]>,
    points: Vec<u32>,
    back: Vec<u32>,
    triangles: Vec<[u32; 3]>,
    material: Vec<u32>,
}

/// A wavy floor of 2 · 774² = 1.2 million triangles.
fn floor() -> Floor {
    let vertex = |i: u32| {
        let (x, z) = ((i % (SIDE + 1)) as f32 / SIDE as f32 - 0.5, (i / (SIDE + 1)) as f32 / SIDE as f32 - 0.5);
        [x * 20.0, 0.3 * (x * 40.0).sin() * (z * 40.0).cos(), z * 20.0]
    };
    let n = (SIDE + 1) * (SIDE + 1);
    let corner = |t: u32| t / SIDE * (SIDE + 1) + t % SIDE;
    let square = |a: u32| [[a, a + SIDE + 1, a + 1], [a + 1, a + SIDE + 1, a + SIDE + 2]];
    let triangles: Vec<[u32; 3]> = (0..SIDE * SIDE).flat_map(|t| square(corner(t))).collect();
    Floor {
        position: (0..n).map(vertex).collect(),
        normal: vec![[0.0, 1.0, 0.0]; n as usize],
        points: (0..n).collect(),
        back: vec![NO_POINT; n as usize],
        material: vec![0; triangles.len()],
        triangles,
    }
}

fn draw(criterion: &mut Criterion) {
    let floor = floor();
    let mesh = Mesh {
        position: &floor.position,
        normal: &floor.normal,
        point_front: &floor.points,
        point_back: &floor.back,
        triangles: &floor.triangles,
        material: &floor.material,
        ..Mesh::default()
    };
    let materials = [Material { metallic: 0.0, roughness: 1.0, double_sided: true, ..Material::default() }];
    let camera = Camera::new([0.0, 4.0, 11.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], 50.0).unwrap();
    let see = || Visibility::new(&[mesh], &materials, &[], &camera, SIZE, 16).unwrap();
    let visibility = see();
    let irradiance = vec![[[0.0, std::f32::consts::PI, 0.0]; 3]; floor.position.len()];
    let objects =
        [DrawObject { mesh, irradiance: &irradiance, lune: &[], glossy: &[], coat: &[], share: &[], between: None, point_flags: &[] }];
    let scene = DrawScene { objects: &objects, materials: &materials, textures: &[], tables: &[], background: &|_| [0.2; 3], clay: true };
    let frame = draw_visible(&scene, &visibility).unwrap();
    let lit = frame.image.pixels.iter().filter(|p| (p[0] - 0.5).abs() < 1e-5).count();
    assert!(lit > SIZE[0] * SIZE[1] / 3, "the floor fills the lower part: {lit}");
    let metrics = metrics::compare(&frame.image, &frame.image, &frame.mask, None, None).unwrap();
    assert_eq!(metrics.mask.psnr_db, None);

    let mut group = criterion.benchmark_group("draw 1280x720x16, 1.2 M triangles");
    group.sample_size(10);
    group.bench_function("visibility", |b| b.iter(|| black_box(see())));
    group.bench_function("clay", |b| b.iter(|| draw_visible(&scene, black_box(&visibility)).unwrap()));
    let shaded = DrawScene { clay: false, ..scene };
    group.bench_function("material", |b| b.iter(|| draw_visible(&shaded, black_box(&visibility)).unwrap()));
    let other = Image { pixels: frame.image.pixels.iter().map(|p| p.map(|v| v * 1.1)).collect(), ..frame.image };
    group.bench_function("metrics", |b| b.iter(|| metrics::compare(black_box(&other), &frame.image, &frame.mask, None, None).unwrap()));
    group.finish();
}

criterion_group!(benches, draw);
criterion_main!(benches);
