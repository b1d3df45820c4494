//! Sampled texels against brute force, against ever finer binary faces, and on features thinner than a texel.

use super::samples_oracle::open_samples_by_brute_force;
use super::scenes::{Random, bumpy_sphere, closed_box, cut_out, random_triangles, world_of};
use super::*;
use prelight_runtime::surface::Texture;
use prelight_scene::world::World;

/// Texels open in part, by number; and the bits of texels of which anything is open.
fn sampled(occluders: &Occluders, from: &TraceOrigin, n: usize) -> (Vec<u64>, Vec<(u32, u64)>) {
    let (mut open, mut parts, mut scratch) = (vec![0; 6 * n * n / 64], Vec::new(), Scratch::default());
    horizon::above_horizon(from.normal, n, &mut open);
    occluders.close_samples_by(0, 0..6, from, n, &mut scratch, (&mut open, &mut parts));
    (open, parts)
}

/// Every texel's samples.
fn unpacked(open: &[u64], parts: &[(u32, u64)], n: usize) -> Vec<u64> {
    let whole = |texel: usize| if open[texel / 64] >> (texel % 64) & 1 == 1 { u64::MAX } else { 0 };
    let mut all: Vec<u64> = (0..6 * n * n).map(whole).collect();
    for (texel, samples) in parts {
        assert!(*samples != 0 && *samples != u64::MAX && all[*texel as usize] == u64::MAX, "texel {texel} is not open in part");
        all[*texel as usize] = *samples;
    }
    all
}

fn options() -> Vec<OccluderOptions> {
    let some = |simd, leaf_size| OccluderOptions { simd, leaf_size, ..OccluderOptions::default() };
    vec![some(SimdPath::Scalar, 64), some(SimdPath::Avx2, 64), some(SimdPath::Avx2, 8)]
}

fn check(name: &str, world: &World, textures: &[Texture<'static>], n: usize, origins: usize, seed: u64) {
    let (mut random, mut in_part) = (Random(seed), 0);
    let mut truth = vec![0; 6 * n * n];
    let all: Vec<Occluders> = options().into_iter().map(|options| Occluders::build(world, textures, options)).collect();
    for i in 0..origins {
        let id = (random.bits() % world.positions.len() as u64) as u32;
        let on = world.positions[id as usize];
        let origin = if i % 2 == 0 { random.cube() } else { std::array::from_fn(|k| (on[0][k] + on[1][k] + on[2][k]) / 3.0) };
        let base = [id];
        let from = TraceOrigin { origin, normal: random.direction(), base_triangles: &base[..i % 2] };
        open_samples_by_brute_force(world, textures, &from, n, &mut truth);
        for occluders in &all {
            let (open, parts) = sampled(occluders, &from, n);
            assert!(unpacked(&open, &parts, n) == truth, "{name}, origin {i}");
            in_part += parts.len();
        }
    }
    assert!(in_part > 20 * origins, "{name}: {in_part} texels in part");
}

#[test]
fn samples_are_those_of_brute_force_on_every_path() {
    for (seed, n, size) in [(1, 150, 0.5), (2, 400, 0.08), (3, 40, 3.0)] {
        check(&format!("seed {seed}"), &random_triangles(seed, n, size), &[], 64, 4, seed + 50);
    }
    check("128", &random_triangles(5, 60, 0.5), &[], 128, 2, 55);
    let mut world = random_triangles(11, 120, 0.8);
    let textures = cut_out(&mut world, 2);
    check("masks", &world, &textures, 64, 3, 61);
    check("ball", &world_of(bumpy_sphere([2.5, 0.1, -0.2], 1.0, 12)), &[], 64, 4, 71);
}

/// Share of a texel that is open by `k`×`k` binary texels of a finer face; the horizon aside.
fn shares_by_finer_faces(occluders: &Occluders, from: &TraceOrigin, n: usize, k: usize) -> Vec<f64> {
    let fine = n * k;
    let mut open = vec![u64::MAX; 6 * fine * fine / 64];
    occluders.close_covered(from, fine, &mut Scratch::default(), &mut open);
    let mut shares = vec![0.0; 6 * n * n];
    for texel in (0..6 * fine * fine).filter(|texel| open[texel / 64] >> (texel % 64) & 1 == 1) {
        let (face, y, x) = (texel / (fine * fine), texel / fine % fine / k, texel % fine / k);
        shares[(face * n + y) * n + x] += 1.0 / (k * k) as f64;
    }
    shares
}

/// A fence of poles, a ball and a box, some of it thinner than a texel.
fn fence() -> World {
    let mut triangles = bumpy_sphere([1.6, 0.4, 0.3], 0.5, 16);
    triangles.extend(closed_box([-2.0, -0.5, -2.0], [-1.0, 0.4, -1.5]));
    for i in 0..12 {
        let x = -1.5 + 0.27 * i as f32;
        triangles.extend(closed_box([x, -0.3, 2.0], [x + 0.004 * (1 + i) as f32, 1.2, 2.01]));
    }
    world_of(triangles)
}

#[test]
fn samples_are_the_texels_of_a_face_eight_times_as_fine_and_near_those_of_one_sixteen_times_as_fine() {
    let occluders = Occluders::build(&fence(), &[], OccluderOptions::default());
    let n = 64;
    for origin in [[0.0; 3], [0.3, 0.2, 0.6]] {
        let from = TraceOrigin { origin, normal: [0.0, 1.0, 0.0], base_triangles: &[] };
        let (open, parts) = sampled(&occluders, &from, n);
        let got = unpacked(&open, &parts, n);
        let mut above = vec![0; 6 * n * n / 64];
        horizon::above_horizon(from.normal, n, &mut above);
        let (eight, sixteen) = (shares_by_finer_faces(&occluders, &from, n, 8), shares_by_finer_faces(&occluders, &from, n, 16));
        let (mut unequal, mut in_part, mut sum) = (0, 0, 0.0);
        for texel in 0..6 * n * n {
            let share = f64::from(got[texel].count_ones()) / 64.0;
            if above[texel / 64] >> (texel % 64) & 1 == 0 {
                assert_eq!(share, 0.0, "the horizon is by the centre");
                continue;
            }
            unequal += u32::from(share != eight[texel]);
            if share > 0.0 && share < 1.0 {
                in_part += 1;
                sum += (share - sixteen[texel]).abs();
                // A straight edge along a row of samples is off by half a row: 1/16; a texel may hold both edges of a pole and one behind.
                assert!((share - sixteen[texel]).abs() <= 0.19, "{share} {}", sixteen[texel]);
            }
        }
        // Only rectangles differ, and only where the planes of a sliver are uncertain: the sides of poles, seen edge on.
        assert!(unequal <= 3, "{unequal}");
        // Half of all edges along a row of samples agree, half are off by 1/16; poles have two.
        assert!(in_part > 200 && sum < 0.06 * f64::from(in_part), "{in_part} in part, mean off by {}", sum / f64::from(in_part));
    }
}

#[test]
fn a_pole_of_a_quarter_texel_is_seen_by_every_point() {
    // A texel at the middle of a face is 2/64 wide at distance 1.
    let (width, distance) = (0.25 * 2.0 / 64.0, 1.0);
    let pole = world_of(closed_box([-0.5 * width, -0.2, distance], [0.5 * width, 0.2, distance + 0.001]));
    let occluders = Occluders::build(&pole, &[], OccluderOptions::default());
    let (mut binary_misses, mut scratch) = (0, Scratch::default());
    for i in 0..100 {
        let from = TraceOrigin { origin: [0.001 * i as f32 - 0.05, 0.0, 0.0], normal: [0.0, 0.0, 1.0], base_triangles: &[] };
        let (open, parts) = sampled(&occluders, &from, 64);
        let hidden: u32 = unpacked(&open, &parts, 64).iter().map(|samples| samples.count_zeros() % 64).sum();
        // 0.4 high is 12.8 texels; a quarter of each, give or take one sample of eight.
        let texels = f64::from(hidden) / 64.0;
        assert!((12.8 * 0.125..12.8 * 0.38).contains(&texels), "point {i}: {texels} texels");
        let (mut bits, mut free) = (vec![0; 6 * 64], vec![0; 6 * 64]);
        occluders.open_texels(&from, 64, &mut scratch, &mut bits);
        horizon::above_horizon(from.normal, 64, &mut free);
        binary_misses += u32::from(bits == free);
    }
    assert!(binary_misses > 50, "the test is about something that binary visibility misses: {binary_misses}");
}

#[test]
fn samples_do_not_depend_on_how_the_work_is_cut() {
    let world = random_triangles(9, 200, 0.4);
    let layer_of: Vec<u8> = (0..world.positions.len()).map(|id| (id % 3) as u8).collect();
    let one = Occluders::build(&world, &[], OccluderOptions::default());
    let layers = Occluders::build_layers(&world, &[], OccluderOptions::default(), &layer_of, 3);
    let mut random = Random(3);
    for n in [64, 128] {
        let from = TraceOrigin { origin: random.cube(), normal: random.direction(), base_triangles: &[] };
        let (open, parts) = sampled(&one, &from, n);
        let (mut found, mut in_part, mut scratch) = (vec![0; 6 * n * n / 64], Vec::new(), Scratch::default());
        horizon::above_horizon(from.normal, n, &mut found);
        for layer in 0..3 {
            // By faces, each with its own part of the list.
            let mut all = Vec::new();
            for face in 0..6 {
                let own = |texel: u32| texel as usize / (n * n) == face;
                let mut list: Vec<(u32, u64)> = in_part.iter().copied().filter(|(texel, _)| own(*texel)).collect();
                layers.close_samples_by(layer, face..face + 1, &from, n, &mut scratch, (&mut found, &mut list));
                all.extend(list);
            }
            in_part = all;
        }
        assert_eq!((&found, &in_part), (&open, &parts));
        assert!(parts.len() > 100);
    }
}
