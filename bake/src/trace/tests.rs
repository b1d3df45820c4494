//! Fast against slow: every path, tree and order must give the oracle's bits.

use super::predicate::Projected;
use super::scenes::{Random, bumpy_sphere, closed_box, cut_out, random_triangles, world_of};
use super::*;
use obvhs::BvhBuildParams;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::ray::Ray;
use obvhs::rt_triangle::RtTriangle;
use obvhs::triangle::Triangle;
use prelight_runtime::sphere::cubemap::texel_direction;
use prelight_runtime::surface::Texture;
use prelight_scene::world::{Occlusion, World};

const PATHS: [SimdPath; 2] = [SimdPath::Scalar, SimdPath::Avx2];

fn words(n: usize) -> usize {
    6 * n * n / 64
}

fn differing(a: &[u64], b: &[u64]) -> u32 {
    a.iter().zip(b).map(|(a, b)| (a ^ b).count_ones()).sum()
}

struct Origin {
    origin: [f32; 3],
    normal: [f32; 3],
    base: Vec<u32>,
}

impl Origin {
    fn trace(&self) -> TraceOrigin<'_> {
        TraceOrigin { origin: self.origin, normal: self.normal, base_triangles: &self.base }
    }
}

/// Origins in the open, on triangles (excluded and not), and on the planes of axis-aligned faces.
fn origins(world: &World, seed: u64, n: usize) -> Vec<Origin> {
    let mut random = Random(seed);
    let mut origin = |i: usize| {
        let id = (random.bits() % world.positions.len() as u64) as usize;
        let t = world.positions[id];
        let on_triangle: [f32; 3] = std::array::from_fn(|k| (t[0][k] + t[1][k] + t[2][k]) / 3.0);
        let normal = random.direction();
        match i % 4 {
            0 => Origin { origin: random.cube().map(|c| 2.0 * c), normal, base: vec![] },
            1 => Origin { origin: on_triangle, normal, base: vec![id as u32] },
            2 => Origin { origin: std::array::from_fn(|k| on_triangle[k] + 1e-4 * normal[k]), normal, base: vec![] },
            _ => Origin { origin: t[1], normal, base: vec![id as u32] },
        }
    };
    (0..n).map(&mut origin).collect()
}

fn check(name: &str, world: &World, textures: &[Texture<'static>], face_resolution: usize, from: &[Origin], options: &[OccluderOptions]) {
    let truth: Vec<Vec<u64>> = from
        .iter()
        .map(|o| {
            let mut open = vec![0; words(face_resolution)];
            open_texels_by_brute_force(world, textures, &o.trace(), face_resolution, &mut open);
            open
        })
        .collect();
    let open: u32 = truth.iter().flatten().map(|w| w.count_ones()).sum();
    let above: u32 = from
        .iter()
        .map(|o| {
            let mut above = vec![0; words(face_resolution)];
            horizon::above_horizon(o.normal, face_resolution, &mut above);
            above.iter().map(|w| w.count_ones()).sum::<u32>()
        })
        .sum();
    assert!(open < above, "{name}: something must be covered");
    let (mut scratch, mut found) = (Scratch::default(), vec![0; words(face_resolution)]);
    for &option in options {
        let occluders = Occluders::build(world, textures, option);
        for (i, (o, truth)) in from.iter().zip(&truth).enumerate() {
            occluders.open_texels(&o.trace(), face_resolution, &mut scratch, &mut found);
            assert_eq!(differing(&found, truth), 0, "{name}, origin {i} {:?}, {option:?}", o.origin);
        }
    }
}

fn every_option() -> Vec<OccluderOptions> {
    let mut all: Vec<OccluderOptions> =
        TreeQuality::ALL.map(|quality| OccluderOptions { quality, leaf_size: 16, simd: SimdPath::Avx2 }).to_vec();
    for simd in PATHS {
        all.extend([8, 32, 64, 120].map(|leaf_size| OccluderOptions { quality: TreeQuality::Medium, leaf_size, simd }));
    }
    all
}

#[test]
fn random_scenes_give_the_oracles_bits_for_every_tree_and_path() {
    for (seed, n, size) in [(1, 300, 0.5), (2, 900, 0.08), (3, 60, 3.0), (4, 1, 2.0), (5, 9, 1.0)] {
        let world = random_triangles(seed, n, size);
        check(&format!("seed {seed}"), &world, &[], 64, &origins(&world, seed + 100, 8), &every_option());
    }
}

#[test]
fn cut_outs_give_the_oracles_bits() {
    let mut world = random_triangles(11, 300, 0.8);
    let solid = world.clone();
    let textures = cut_out(&mut world, 2);
    let from = origins(&world, 12, 6);
    check("masks", &world, &textures, 64, &from, &every_option());
    let count = |world: &World| {
        let mut open = vec![0; words(64)];
        open_texels_by_brute_force(world, &textures, &from[0].trace(), 64, &mut open);
        open.iter().map(|w| w.count_ones()).sum::<u32>()
    };
    assert!(count(&world) > count(&solid), "the cut-outs must let something through");
}

#[test]
fn faces_of_128_texels_give_the_oracles_bits() {
    let world = random_triangles(21, 200, 0.5);
    let options = PATHS.map(|simd| OccluderOptions { simd, ..OccluderOptions::default() });
    check("128", &world, &[], 128, &origins(&world, 22, 4), &options);
}

#[test]
fn order_and_winding_of_triangles_cannot_matter() {
    let world = random_triangles(31, 400, 0.4);
    let mut random = Random(32);
    let mut shuffled: Vec<usize> = (0..world.positions.len()).collect();
    for i in (1..shuffled.len()).rev() {
        shuffled.swap(i, (random.bits() % (i as u64 + 1)) as usize);
    }
    let turn = |t: [[f32; 3]; 3], i: usize| if i.is_multiple_of(2) { [t[2], t[1], t[0]] } else { [t[1], t[2], t[0]] };
    let other = world_of(shuffled.iter().map(|&i| turn(world.positions[i], i)).collect());
    let (a, b) = (Occluders::build(&world, &[], OccluderOptions::default()), Occluders::build(&other, &[], OccluderOptions::default()));
    let mut scratch = Scratch::default();
    for mut o in origins(&world, 33, 12) {
        let (mut first, mut second) = (vec![0; words(64)], vec![0; words(64)]);
        a.open_texels(&o.trace(), 64, &mut scratch, &mut first);
        o.base = o.base.iter().map(|&id| shuffled.iter().position(|&i| i == id as usize).unwrap() as u32).collect();
        b.open_texels(&o.trace(), 64, &mut scratch, &mut second);
        assert_eq!(first, second);
    }
}

#[test]
fn layers_and_start_masks_cannot_matter() {
    let world = random_triangles(41, 500, 0.5);
    let options = OccluderOptions::default();
    let whole = Occluders::build(&world, &[], options);
    let layers = [0, 1, 2].map(|layer| Occluders::build_where(&world, &[], options, |id| id % 3 == layer));
    let (mut scratch, mut random) = (Scratch::default(), Random(42));
    for o in origins(&world, 43, 12) {
        let (mut one, mut many) = (vec![0; words(64)], vec![0; words(64)]);
        whole.open_texels(&o.trace(), 64, &mut scratch, &mut one);
        horizon::above_horizon(o.normal, 64, &mut many);
        for layer in &layers {
            layer.close_covered(&o.trace(), 64, &mut scratch, &mut many);
        }
        assert_eq!(one, many);
        let start: Vec<u64> = many.iter().map(|_| random.bits()).collect();
        let mut part = start.clone();
        whole.close_covered(&TraceOrigin { normal: [0.0; 3], ..o.trace() }, 64, &mut scratch, &mut part);
        horizon::above_horizon(o.normal, 64, &mut many);
        for i in 0..many.len() {
            assert_eq!(part[i] & many[i], one[i] & start[i]);
        }
    }
}

#[test]
fn a_closed_box_of_any_scale_hides_everything_and_leaks_nowhere() {
    for scale in [1e-4f32, 1.0, 1e5] {
        let lo = [-1.0, -0.7, -2.3].map(|c| c * scale);
        let hi = [1.3, 0.9, 1.1].map(|c| c * scale);
        let world = world_of(closed_box(lo, hi));
        let occluders = Occluders::build(&world, &[], OccluderOptions::default());
        let (mut scratch, mut open, mut random) = (Scratch::default(), vec![0; words(64)], Random(5));
        for _ in 0..50 {
            let origin = std::array::from_fn(|k| lo[k] + (hi[k] - lo[k]) * (0.001 + 0.998 * random.unit()));
            let from = TraceOrigin { origin, normal: random.direction(), base_triangles: &[] };
            occluders.open_texels(&from, 64, &mut scratch, &mut open);
            assert!(open.iter().all(|&w| w == 0), "scale {scale}, {origin:?}");
        }
    }
}

#[test]
fn a_finely_tessellated_sphere_has_no_holes_from_inside() {
    // Triangles far below a texel, so nearly every texel lies within rounding of several edges.
    let world = world_of(bumpy_sphere([10.0, 20.0, -5.0], 2.0, 150));
    let occluders = Occluders::build(&world, &[], OccluderOptions::default());
    let (mut scratch, mut open, mut random) = (Scratch::default(), vec![0; words(128)], Random(6));
    for _ in 0..20 {
        let inside = random.cube();
        let origin = std::array::from_fn(|k| [10.0, 20.0, -5.0][k] + 0.6 * inside[k]);
        occluders.open_texels(&TraceOrigin { origin, normal: random.direction(), base_triangles: &[] }, 128, &mut scratch, &mut open);
        assert_eq!(open.iter().map(|w| w.count_ones()).sum::<u32>(), 0);
    }
}

#[test]
fn an_empty_world_leaves_the_horizon() {
    let mut world = random_triangles(51, 5, 1.0);
    world.occlusion.fill(Occlusion::None);
    for world in [world, World::default()] {
        let occluders = Occluders::build(&world, &[], OccluderOptions::default());
        let (mut open, mut above) = (vec![0; words(64)], vec![0; words(64)]);
        let from = TraceOrigin { origin: [0.0; 3], normal: [0.0, 0.6, 0.8], base_triangles: &[] };
        occluders.open_texels(&from, 64, &mut Scratch::default(), &mut open);
        horizon::above_horizon(from.normal, 64, &mut above);
        assert_eq!(open, above);
        assert_eq!(occluders.closest_hit([0.0; 3], [0.0, 1.0, 0.0], &[]), None);
    }
}

#[test]
fn coordinates_too_large_to_trace_are_counted_and_left_out() {
    let mut world = random_triangles(52, 50, 0.5);
    world.positions[3][0][1] = 1e30;
    world.positions[4][2][0] = f32::NAN;
    let untraceable = world.positions.iter().filter(|corners| !super::predicate::is_traceable(corners)).count();
    assert_eq!(untraceable, 2);
    check("untraceable", &world, &[], 64, &origins(&random_triangles(52, 50, 0.5), 53, 4), &[OccluderOptions::default()]);
}

/// Whether a texel lies within `margin` texels of an edge of some triangle near its direction: where a rounding may decide.
fn on_an_edge(world: &World, from: &TraceOrigin, face: usize, x: usize, y: usize) -> bool {
    let view = predicate::View::new(from.origin, 64, face, [0, 0]);
    let margin = 1e-3 / 32.0;
    world.positions.iter().any(|corners| {
        let Some(p) = Projected::new(&view, &predicate::canonical(corners)) else { return false };
        let inside = |dx: f32, dy: f32| p.contains(view.du[x] + dx * margin, view.dv[y] + dy * margin);
        let first = inside(0.0, 0.0);
        [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (0.7, 0.7), (-0.7, 0.7), (0.7, -0.7), (-0.7, -0.7)]
            .iter()
            .any(|&(a, b)| inside(a, b) != first)
    })
}

#[test]
fn bits_agree_with_single_rays_of_obvhs_but_at_edges() {
    let mut triangles = bumpy_sphere([0.0, 1.2, 0.0], 1.0, 60);
    triangles.extend(bumpy_sphere([1.5, 0.4, 0.6], 0.4, 24));
    triangles.extend(closed_box([-4.0, -0.1, -4.0], [4.0, 0.0, 4.0]));
    triangles.extend(random_triangles(61, 300, 0.1).positions);
    let world = world_of(triangles);
    let occluders = Occluders::build(&world, &[], OccluderOptions::default());

    let corners: Vec<Triangle> = world.positions.iter().map(|t| Triangle { v0: t[0].into(), v1: t[1].into(), v2: t[2].into() }).collect();
    let bvh = build_bvh2_from_tris(&corners, BvhBuildParams::medium_build(), &mut Default::default());
    let rays: Vec<RtTriangle> = bvh.primitive_indices.iter().map(|&i| (&corners[i as usize]).into()).collect();

    let (mut scratch, mut open, mut random) = (Scratch::default(), vec![0; words(64)], Random(62));
    let (mut traced, mut wrong) = (0, Vec::new());
    for _ in 0..40 {
        let origin = [6.0 * random.unit() - 3.0, 2.5 * random.unit() + 0.01, 6.0 * random.unit() - 3.0];
        let from = TraceOrigin { origin, normal: random.direction(), base_triangles: &[] };
        occluders.open_texels(&from, 64, &mut scratch, &mut open);
        for i in (0..6 * 64 * 64).filter(|i| horizon::is_above_horizon(from.normal, 64, i / 4096, i % 64, i / 64 % 64)) {
            let (face, y, x) = (i / 4096, i / 64 % 64, i % 64);
            let ray = Ray::new_inf(origin.into(), texel_direction(64, face, x, y).into());
            let miss = bvh.ray_traverse_miss(ray, |ray, id| rays[id].intersect(ray));
            traced += 1;
            if miss != (open[i / 64] >> (i % 64) & 1 == 1) {
                wrong.push((from, face, x, y));
            }
        }
    }
    assert!(wrong.len() as f64 <= 1e-5 * f64::from(traced) + 1.0, "{} of {traced}", wrong.len());
    for (from, face, x, y) in wrong {
        assert!(on_an_edge(&world, &from, face, x, y), "{face} {x} {y}");
    }
}

/// Closest hit in f64, Möller and Trumbore's way, over all triangles.
fn closest_in_f64(world: &World, origin: [f32; 3], direction: [f32; 3], excluded: &[u32]) -> Option<(f64, u32, bool)> {
    let wide = |v: [f32; 3]| v.map(f64::from);
    let minus = |a: [f64; 3], b: [f64; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    let cross = |a: [f64; 3], b: [f64; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let (o, d) = (wide(origin), wide(direction));
    let hit = |id: u32| {
        let t = world.positions[id as usize].map(wide);
        let (e1, e2) = (minus(t[1], t[0]), minus(t[2], t[0]));
        let p = cross(d, e2);
        let det = dot(e1, p);
        let s = minus(o, t[0]);
        let q = cross(s, e1);
        let (u, v, t) = (dot(s, p) / det, dot(d, q) / det, dot(e2, q) / det);
        (det != 0.0 && u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t >= 0.0).then_some((t, id, det < 0.0))
    };
    (0..world.positions.len() as u32).filter(|id| !excluded.contains(id)).filter_map(hit).min_by(|a, b| a.0.total_cmp(&b.0))
}

#[test]
fn closest_hits_equal_brute_force_in_f64() {
    let world = random_triangles(71, 600, 0.6);
    for simd in PATHS {
        let occluders = Occluders::build(&world, &[], OccluderOptions { simd, leaf_size: 16, ..OccluderOptions::default() });
        let (mut random, mut hits, mut odd) = (Random(72), 0, 0);
        for i in 0..4000 {
            let origin = random.cube().map(|c| 2.0 * c);
            let mut direction = random.direction();
            if i % 10 == 0 {
                direction = [[0.0, 0.0, 1.0], [0.0, -2.0, 0.0], [-0.5, 0.0, 0.0]][i / 10 % 3];
            }
            let excluded: Vec<u32> =
                closest_in_f64(&world, origin, direction, &[]).filter(|_| i % 3 == 0).map(|hit| hit.1).into_iter().collect();
            let truth = closest_in_f64(&world, origin, direction, &excluded);
            let found = occluders.closest_hit(origin, direction, &excluded);
            let (Some((t, id, back)), Some(hit)) = (truth, found) else {
                odd += usize::from(truth.is_some() != found.is_some());
                continue;
            };
            hits += 1;
            if id != hit.triangle {
                odd += 1;
                continue;
            }
            // t loses to the cosine between ray and surface; 1e-4 leaves room for grazing hits.
            assert!((f64::from(hit.t) - t).abs() <= 1e-4 * t.max(0.1), "{} {t}", hit.t);
            assert_eq!(hit.back_face, back);
            let corners = world.positions[id as usize];
            for k in 0..3 {
                let at = (0..3).map(|i| hit.barycentrics[i] * corners[i][k]).sum::<f32>();
                assert!((at - (origin[k] + hit.t * direction[k])).abs() < 2e-4, "{at}");
            }
            assert!(occluders.occluded(origin, direction, hit.t * 1.001, &excluded));
            assert!(!occluders.occluded(origin, direction, hit.t * 0.999, &excluded));
        }
        assert!(hits > 1000 && odd <= 2, "{hits} hits, {odd} on edges");
    }
}

#[test]
fn rays_and_coverage_ask_the_same_cut_outs() {
    let mut world = random_triangles(81, 200, 0.8);
    let textures = cut_out(&mut world, 1);
    let occluders = Occluders::build(&world, &textures, OccluderOptions::default());
    let (mut scratch, mut open) = (Scratch::default(), vec![0; words(64)]);
    let (mut differ, mut traced) = (0, 0);
    for o in origins(&world, 82, 8) {
        occluders.open_texels(&o.trace(), 64, &mut scratch, &mut open);
        for i in (0..6 * 64 * 64).filter(|i| horizon::is_above_horizon(o.normal, 64, i / 4096, i % 64, i / 64 % 64)) {
            let blocked = occluders.occluded(o.origin, texel_direction(64, i / 4096, i % 64, i / 64 % 64), f32::INFINITY, &o.base);
            traced += 1;
            differ += u32::from(blocked == (open[i / 64] >> (i % 64) & 1 == 1));
        }
    }
    // The same predicate in another order of operations: only texels within rounding of an edge may differ.
    assert!(f64::from(differ) <= 2e-4 * f64::from(traced), "{differ} of {traced}");
}
