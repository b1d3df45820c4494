//! Visibility of 512 points: coverage rasterisation against single rays, the same origins, the same texels, interleaved, in thread CPU
//! time. Prints the ratio, microseconds a point and the share of differing bits; fails when more than 1e-5 of the bits differ.
//!
//! Single rays: obvhs BVH2 medium, triangles in the tree's order, one ray a texel above the horizon. For the ratio that the marks speak
//! of, build with `RUSTFLAGS="-C target-cpu=native"`. Scenes are read from `../shared/scenes`; without them one made in code stands in.
//!
//! Below, the bytes of the same scenes' patches: of their chunks in memory and after zstd -3, beside those of the same bits as gaps between
//! changes in row order, varints, after zstd -3.
//!
//! `PRELIGHT_BENCH_ONLY=apartment` picks scenes, `PRELIGHT_BENCH_ROUNDS=0` leaves out the rays, `PRELIGHT_BENCH_FACE=128` takes faces of
//! 128² texels instead of 64².

use obvhs::BvhBuildParams;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::ray::Ray;
use obvhs::rt_triangle::RtTriangle;
use obvhs::triangle::Triangle;
use prelight_bake::block_product::visibility::encode::encode;
use prelight_bake::trace::{OccluderOptions, Occluders, Scratch, TraceOrigin, TreeQuality, horizon};
use prelight_runtime::block_product::visibility::open_words;
use prelight_runtime::sphere::cubemap::texel_direction;
use prelight_scene::gltf::{LoadLimits, load};
use prelight_scene::world::{Occlusion, World};
use rustix::time::{ClockId, clock_gettime};

const RUNS: usize = 16;
const RUN_POINTS: usize = 32;
/// Points of a full patch.
const PATCH_POINTS: usize = 256;

struct Subject {
    name: String,
    world: World,
    face_resolution: usize,
}

type Point = ([f32; 3], [f32; 3]);

fn thread_seconds() -> f64 {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}

/// Order of a point along a Morton curve of 2^20 cells a side over the bounds.
fn morton(p: [f32; 3], lo: [f32; 3], size: f32) -> u64 {
    (0..3).fold(0, |code, k| {
        let cell = ((p[k] - lo[k]) / size * 1048575.0) as u64;
        code | (0..20).fold(0, |spread, bit| spread | (cell >> bit & 1) << (3 * bit)) << k
    })
}

/// Near the first corner of every triangle, inside it, so that no origin lies on the plane of a neighbour; and the triangle's normal.
fn surface_points(world: &World) -> Vec<Point> {
    let solid = world.positions.iter().zip(&world.occlusion).filter(|(_, o)| **o != Occlusion::None);
    let point = |(t, _): (&[[f32; 3]; 3], _)| {
        let d = |i: usize, k: usize| t[i][k] - t[0][k];
        let normal = [0, 1, 2].map(|k: usize| d(1, (k + 1) % 3) * d(2, (k + 2) % 3) - d(1, (k + 2) % 3) * d(2, (k + 1) % 3));
        let length = normal.iter().map(|c| c * c).sum::<f32>().sqrt();
        let at = std::array::from_fn(|k| t[0][k] + (d(1, k) + d(2, k)) / 16.0);
        (length > 0.0).then(|| (at, normal.map(|c| c / length)))
    };
    solid.filter_map(point).collect()
}

/// 16 runs of neighbours, evenly spaced along a space-filling curve, lifted off the surface by 1e-5 of the diagonal.
fn origins(world: &World, run_points: usize) -> Vec<Point> {
    let corners = || world.positions.iter().flatten();
    let lo: [f32; 3] = std::array::from_fn(|k| corners().map(|c| c[k]).fold(f32::INFINITY, f32::min));
    let hi: [f32; 3] = std::array::from_fn(|k| corners().map(|c| c[k]).fold(f32::NEG_INFINITY, f32::max));
    let diagonal = (0..3).map(|k| (hi[k] - lo[k]).powi(2)).sum::<f32>().sqrt();
    let mut points = surface_points(world);
    points.sort_by_key(|(p, _)| morton(*p, lo, diagonal));
    let step = points.len() / RUNS;
    let run = |r: usize| points[r * step..].iter().take(run_points);
    let lift = |(p, n): &Point| (std::array::from_fn(|k| p[k] + 1e-5 * diagonal * n[k]), *n);
    (0..RUNS).flat_map(run).map(lift).collect()
}

struct SingleRays {
    bvh: obvhs::bvh2::Bvh2,
    triangles: Vec<RtTriangle>,
}

impl SingleRays {
    fn build(world: &World) -> Self {
        let solid = world.positions.iter().zip(&world.occlusion).filter(|(_, o)| **o != Occlusion::None);
        let corners: Vec<Triangle> = solid.map(|(t, _)| Triangle { v0: t[0].into(), v1: t[1].into(), v2: t[2].into() }).collect();
        let bvh = build_bvh2_from_tris(&corners, BvhBuildParams::medium_build(), &mut Default::default());
        let triangles = bvh.primitive_indices.iter().map(|&i| (&corners[i as usize]).into()).collect();
        SingleRays { bvh, triangles }
    }

    fn open_texels(&self, (origin, normal): Point, n: usize, open: &mut [u64]) {
        horizon::above_horizon(normal, n, open);
        for (index, word) in open.iter_mut().enumerate() {
            let mut rest = *word;
            while rest != 0 {
                let bit = rest.trailing_zeros() as usize;
                rest &= rest - 1;
                let texel = 64 * index + bit;
                let ray = Ray::new_inf(origin.into(), texel_direction(n, texel / (n * n), texel % n, texel / n % n).into());
                if !self.bvh.ray_traverse_miss(ray, |ray, id| self.triangles[id].intersect(ray)) {
                    *word &= !(1 << bit);
                }
            }
        }
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn measure(subject: &Subject) {
    let (points, n) = (origins(&subject.world, RUN_POINTS), subject.face_resolution);
    let rounds = std::env::var("PRELIGHT_BENCH_ROUNDS").ok().and_then(|r| r.parse().ok()).unwrap_or(3);
    let seconds = std::time::Instant::now();
    let occluders = Occluders::build(&subject.world, &[], OccluderOptions::default());
    let built = seconds.elapsed().as_secs_f64();
    let slow = Occluders::build(&subject.world, &[], OccluderOptions { quality: TreeQuality::VerySlow, ..OccluderOptions::default() });
    let rays = SingleRays::build(&subject.world);
    let mut scratch = Scratch::default();
    let (mut fast, mut truth) = (vec![0; open_words(n)], vec![0; open_words(n)]);
    let (mut traced, mut differing, mut still_open) = (0u64, 0u64, 0u64);
    let mut times = [const { Vec::new() }; 3];
    for round in 0..rounds.max(1) {
        let mut spent = [0.0; 3];
        for run in points.chunks(RUN_POINTS) {
            // Whole runs alternate, so that a slow moment of the machine falls on all three alike.
            for (occluders, spent) in [&occluders, &slow].into_iter().zip(&mut spent) {
                let start = thread_seconds();
                for &(origin, normal) in run {
                    occluders.open_texels(&TraceOrigin { origin, normal, base_triangles: &[] }, n, &mut scratch, &mut fast);
                    std::hint::black_box(&fast);
                }
                *spent += thread_seconds() - start;
            }
            if rounds > 0 {
                for &point in run {
                    let start = thread_seconds();
                    rays.open_texels(point, n, &mut truth);
                    spent[2] += thread_seconds() - start;
                    if round == 0 {
                        let (origin, normal) = point;
                        horizon::above_horizon(normal, n, &mut fast);
                        traced += fast.iter().map(|w| u64::from(w.count_ones())).sum::<u64>();
                        occluders.open_texels(&TraceOrigin { origin, normal, base_triangles: &[] }, n, &mut scratch, &mut fast);
                        differing += fast.iter().zip(&truth).map(|(a, b)| u64::from((a ^ b).count_ones())).sum::<u64>();
                        still_open += fast.iter().map(|w| u64::from(w.count_ones())).sum::<u64>();
                    }
                }
            }
        }
        for (times, spent) in times.iter_mut().zip(spent) {
            times.push(spent / points.len() as f64 * 1e6);
        }
    }
    let [medium, very_slow, single] = times.map(median);
    println!(
        "{:<14} {:>8} {:>7.2} | {:>8.1} {:>6.1}x | {:>8.1} {:>6.1}x | {:>9.1} {:>6.2} | {:>6.3} {:>6} of {traced}",
        subject.name,
        subject.world.positions.len(),
        built,
        medium,
        single / medium,
        very_slow,
        single / very_slow,
        single,
        traced as f64 / points.len() as f64 / single,
        1.0 - still_open as f64 / traced.max(1) as f64,
        differing,
    );
    assert!(differing as f64 <= 1e-5 * traced as f64 + 1.0, "{differing} of {traced} bits differ from single rays");
}

/// Gaps between the changes of row-major bits, as varints.
fn row_order(open: &[u64], out: &mut Vec<u8>) {
    let (mut last, mut state) = (0, false);
    for texel in 0..64 * open.len() {
        if (open[texel / 64] >> (texel % 64) & 1 == 1) != state {
            let mut gap = texel - last;
            while gap >= 128 {
                out.push((gap % 128) as u8 | 128);
                gap /= 128;
            }
            out.push(gap as u8);
            (last, state) = (texel, !state);
        }
    }
    // Closes the point: no change is a gap of 0 but the first.
    out.push(0);
}

/// Bytes a point: chunk, chunk after zstd, row order after zstd.
fn bytes(subject: &Subject) {
    let (points, n) = (origins(&subject.world, PATCH_POINTS), subject.face_resolution);
    let occluders = Occluders::build(&subject.world, &[], OccluderOptions::default());
    let mut scratch = Scratch::default();
    let squeezed = |bytes: &[u8]| zstd::bulk::compress(bytes, 3).map_or(bytes.len(), |small| small.len());
    let mut sums = [0; 3];
    for patch in points.chunks(PATCH_POINTS) {
        let (mut open, mut rows) = (vec![0; open_words(n) * patch.len()], Vec::new());
        for (&(origin, normal), open) in patch.iter().zip(open.chunks_mut(open_words(n))) {
            occluders.open_texels(&TraceOrigin { origin, normal, base_triangles: &[] }, n, &mut scratch, open);
            row_order(open, &mut rows);
        }
        let chunk = encode(n, &open);
        for (sum, bytes) in sums.iter_mut().zip([chunk.len(), squeezed(&chunk), squeezed(&rows)]) {
            *sum += bytes;
        }
    }
    let [chunk, stored, rows] = sums.map(|sum| sum as f64 / points.len() as f64);
    println!(
        "{:<14} bytes a point: {chunk:>6.1} in memory, {stored:>6.1} stored, {rows:>6.1} in row order: {:.2}x",
        subject.name,
        stored / rows
    );
}

/// A wavy floor under a wavy sheet: stands in where the shared scenes are absent.
fn made_in_code() -> World {
    let height = |x: usize, z: usize| ((x as f32 * 0.7).sin() + (z as f32 * 0.45).cos()) * 0.02;
    let sheet = |y: f32, n: usize| -> Vec<[[f32; 3]; 3]> {
        let at = move |x: usize, z: usize| [x as f32 / n as f32, y + height(x, z), z as f32 / n as f32];
        let quad = move |x: usize, z: usize| [[at(x, z), at(x, z + 1), at(x + 1, z + 1)], [at(x, z), at(x + 1, z + 1), at(x + 1, z)]];
        (0..n).flat_map(|x| (0..n).flat_map(move |z| quad(x, z))).collect()
    };
    let positions = [sheet(0.0, 180), sheet(0.2, 60)].concat();
    let occlusion = vec![Occlusion::Opaque; positions.len()];
    World { positions, occlusion, ..World::default() }
}

fn main() {
    let face_resolution = if std::env::var("PRELIGHT_BENCH_FACE").is_ok_and(|face| face == "128") { 128 } else { 64 };
    println!("faces of {face_resolution}² texels");
    println!(
        "{:<14} {:>8} {:>7} | {:>8} {:>7} | {:>8} {:>7} | {:>9} {:>6} | {:>6} differing bits",
        "scene", "tris", "build s", "us/point", "ratio", "v.slow", "ratio", "rays us", "Mray/s", "hidden"
    );
    let only = std::env::var("PRELIGHT_BENCH_ONLY").unwrap_or_default();
    let mut subjects = Vec::new();
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/scenes");
    for name in ["bunny_plane", "apartment", "dragon", "table_chairs"].into_iter().filter(|name| name.contains(&only)) {
        let path = folder.join(name).with_extension("glb");
        if !path.exists() {
            eprintln!("SKIPPED: {name}: there is no {}", path.display());
            continue;
        }
        match load(&path, &LoadLimits::default()) {
            Ok(scene) => subjects.push(Subject { name: name.into(), world: World::build(&scene), face_resolution }),
            Err(error) => eprintln!("SKIPPED: {name}: {error}"),
        }
    }
    if "made_in_code".contains(&only) {
        subjects.push(Subject { name: "made_in_code".into(), world: made_in_code(), face_resolution });
    }
    subjects.iter().for_each(measure);
    subjects.iter().for_each(bytes);
}
