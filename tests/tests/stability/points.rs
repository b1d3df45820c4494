//! Points hold still: closed boxes are closed, smooth things look smooth, thin things do not leak, sides and mirrors agree.
//!
//! All of it end to end: bake, open, light, draw. Figures of a run are printed (`--nocapture`).

use prelight_bake::progress::Silent;
use prelight_bake::reference::{ReferenceOptions, render_reference};
use prelight_bake::trace::{OccluderOptions, Occluders};
use prelight_runtime::asset::Asset;
use prelight_runtime::asset::points::{BACK_SIDE, BURIED};
use prelight_runtime::draw::camera::{Camera, CameraRays};
use prelight_runtime::draw::image::Image;
use prelight_runtime::draw::metrics::compare;
use prelight_runtime::draw::shade::{CLAY_ALBEDO, Frame};
use prelight_runtime::draw::{Background, Style};
use prelight_runtime::environment::{Environment, LightCubemap};
use prelight_runtime::relight::Relighter;
use prelight_runtime::sphere::cubemap::{face_from_direction, texel_unit_direction};
use prelight_scene::world::World;
use prelight_scene::{Primitive, Scene};
use prelight_tests::{baked_asset, cuboid, quad, scene, sphere};
use std::collections::BTreeMap;
use std::f32::consts::PI;
use std::sync::Arc;

/// Materials of `prelight_tests::scene`.
const SINGLE: u32 = 0;
const DOUBLE: u32 = 2;
const FACE_RESOLUTION: usize = 64;

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The same triangles with fronts where backs were.
fn inside_out(mut primitive: Primitive) -> Primitive {
    primitive.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
    primitive
}

/// A point with what the tests ask about it.
#[derive(Clone, Copy, Debug)]
struct Point {
    position: [f32; 3],
    normal: [f32; 3],
    is_back: bool,
    is_buried: bool,
    /// No texel at all is open.
    is_blocked: bool,
    /// Of the light given, W·m⁻²; green.
    irradiance: f32,
}

/// All points of an object under a light.
fn points(asset: &Arc<Asset>, object: usize, light: &LightCubemap) -> Vec<Point> {
    let mut relighter = Relighter::new(asset.clone());
    relighter.set_light(light).unwrap();
    relighter.shade([0.0, 9.0, 0.0], None).unwrap();
    let mut points = Vec::new();
    for patch in &asset.patches()[asset.objects()[object].patches.clone()] {
        let (arrays, visibility) = (patch.points(), patch.visibility());
        points.extend(patch.points.clone().enumerate().map(|(local, i)| Point {
            position: arrays.position[local],
            normal: arrays.normal[local],
            is_back: arrays.flags[local] & BACK_SIDE != 0,
            is_buried: arrays.flags[local] & BURIED != 0,
            is_blocked: visibility.point(local).transitions() == 0,
            irradiance: dot(relighter.irradiance()[i][1], arrays.normal[local]),
        }));
    }
    assert_eq!(points.len(), asset.objects()[object].points.len());
    points
}

fn draw(asset: &Arc<Asset>, light: &LightCubemap, camera: &Camera, size: [usize; 2]) -> Frame {
    let mut relighter = Relighter::new(asset.clone());
    relighter.set_light(light).unwrap();
    let view = relighter.view(camera, size, 16).unwrap();
    relighter.shade(camera.eye, Some(&view.points)).unwrap();
    relighter.draw(&view, Background::Black, Style::Clay).unwrap()
}

fn look(eye: [f32; 3], at: [f32; 3], fov_y_deg: f32) -> Camera {
    Camera::upright(eye, at, fov_y_deg).unwrap()
}

/// Radiance 1 from everywhere.
fn white() -> Environment {
    Environment::new(4, 2, vec![[1.0; 3]; 8])
}

fn light_from(environment: &Environment) -> LightCubemap {
    LightCubemap::from_environment(environment, FACE_RESOLUTION)
}

/// Flux 1 from one texel, that which holds a direction; also that texel's own direction.
fn one_texel(direction: [f64; 3]) -> (LightCubemap, [f32; 3]) {
    let (face, s, t) = face_from_direction(direction);
    let index = |c: f64| (((c + 1.0) * 0.5 * FACE_RESOLUTION as f64) as usize).min(FACE_RESOLUTION - 1);
    let (x, y) = (index(s), index(t));
    let toward = texel_unit_direction(FACE_RESOLUTION, face, x, y);
    let mut light = LightCubemap::black(FACE_RESOLUTION);
    let texel = (face * FACE_RESOLUTION + y) * FACE_RESOLUTION + x;
    light.flux[texel] = [1.0; 3];
    light.moment[texel] = [toward; 3];
    (light, toward)
}

/// Where the ray through a pixel's centre meets the plane y = 0, in metres along x and z, if nothing solid of the box is before it.
fn floor_pixels(camera: &Camera, size: [usize; 2], solid: Option<([f32; 3], [f32; 3])>) -> Vec<Option<[f64; 2]>> {
    let rays = CameraRays::new(camera, size[0], size[1]).unwrap();
    let eye = camera.eye.map(f64::from);
    let at = |i: usize| {
        let d = rays.direction_f64((i % size[0]) as f64 + 0.5, (i / size[0]) as f64 + 0.5);
        let distance = -eye[1] / d[1];
        let hits_solid = solid.is_some_and(|(lower, upper)| {
            let (mut near, mut far) = (0.0f64, f64::INFINITY);
            for k in 0..3 {
                let (a, b) = ((f64::from(lower[k]) - eye[k]) / d[k], (f64::from(upper[k]) - eye[k]) / d[k]);
                (near, far) = (near.max(a.min(b)), far.min(a.max(b)));
            }
            near <= far
        });
        (distance > 0.0 && !hits_solid).then(|| [eye[0] + distance * d[0], eye[2] + distance * d[2]])
    };
    (0..size[0] * size[1]).map(at).collect()
}

// ---- closed boxes

#[test]
fn a_closed_box_with_hard_edges_is_blocked_in_all_texels_at_every_point_inside() {
    let light = light_from(&white());
    let (lower, upper) = ([-0.7, -0.2, -1.1], [0.9, 1.3, 1.0]);
    let box_of = |material: u32| cuboid(lower, upper, material);
    // Turned about two axes and moved, so that no face lies along an axis and coordinates are rounded.
    let (c, s) = (0.8, 0.6);
    let turned = [c, s * c, s * s, 0.0, -s, c * c, c * s, 0.0, 0.0, -s, c, 0.0, 12.3, -4.5, 67.8, 1.0];
    for turn in [false, true] {
        // (what, primitive, which points look into the box)
        let cases: [(&str, Primitive, fn(&Point) -> bool); 3] = [
            ("single-sided, fronts inside", inside_out(box_of(SINGLE)), |_| true),
            ("double-sided, fronts inside", inside_out(box_of(DOUBLE)), |point| !point.is_back),
            ("double-sided, fronts outside", box_of(DOUBLE), |point| point.is_back),
        ];
        for (what, primitive, looks_in) in cases {
            let is_double = primitive.material == DOUBLE;
            let mut scene = scene(vec![("box", primitive)]);
            if turn {
                scene.objects[0].world_from_local = turned;
            }
            let points = points(&baked_asset(&scene, 0.25), 0, &light);
            let inside: Vec<&Point> = points.iter().filter(|point| looks_in(point)).collect();
            let open = inside.iter().filter(|point| !point.is_blocked).count();
            println!("closed box, {what}, turned {turn}: {open} of {} inner points see out", inside.len());
            assert!(inside.len() > 300, "{what}: {}", inside.len());
            assert_eq!(open, 0, "{what}");
            assert!(inside.iter().all(|point| point.irradiance == 0.0));
            // Not vacuous: the other side of the same surface sees the whole sky.
            let outside: Vec<&Point> = points.iter().filter(|point| !looks_in(point)).collect();
            assert_eq!(outside.len(), if is_double { inside.len() } else { 0 });
            assert!(outside.iter().all(|point| (point.irradiance - PI).abs() < 0.02 * PI), "{what}: the outside is open");
        }
    }
}

// ---- smooth surfaces

/// Lambert of one direction on a mesh with interpolated normals, four samples a pixel, brute force in f64: what the coarse mesh can show at best.
fn lambert_of_mesh(primitive: &Primitive, toward: [f32; 3], camera: &Camera, size: [usize; 2]) -> Image {
    let rays = CameraRays::new(camera, size[0], size[1]).unwrap();
    let cross = |a: [f64; 3], b: [f64; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let from_eye = |i: u32| std::array::from_fn(|k| f64::from(primitive.positions[i as usize][k]) - f64::from(camera.eye[k]));
    let normals = primitive.normals.as_ref().unwrap();
    let shade = |x: f64, y: f64| -> f32 {
        let d = rays.direction_f64(x, y);
        for triangle in &primitive.triangles {
            let [a, b, c] = triangle.map(from_eye);
            // All below 0: the ray meets the front; the sphere is convex, so the first is the only one.
            let w = [dot(d, cross(b, c)), dot(d, cross(c, a)), dot(d, cross(a, b))];
            if w.iter().all(|w| *w <= 0.0) && w.iter().any(|w| *w < 0.0) {
                let n = std::array::from_fn(|k| (0..3).map(|j| -w[j] * f64::from(normals[triangle[j] as usize][k])).sum::<f64>());
                return (dot(n, toward.map(f64::from)) / dot(n, n).sqrt()).max(0.0) as f32 * CLAY_ALBEDO / PI;
            }
        }
        0.0
    };
    let pixel = |i: usize| {
        let sample =
            |s: usize| shade((i % size[0]) as f64 + 0.25 + 0.5 * (s % 2) as f64, (i / size[0]) as f64 + 0.25 + 0.5 * (s / 2) as f64);
        [(0..4).map(sample).sum::<f32>() / 4.0; 3]
    };
    Image { width: size[0], height: size[1], pixels: (0..size[0] * size[1]).map(pixel).collect() }
}

/// Decibels of the drawn 12 x 8 sphere under one texel: to the 200-segment sphere drawn the same way, and to perfect Lambert on the 12 x 8
/// mesh itself; pixels of the latter that are drawn darker than 0.7 of it, where it is not black.
fn coarse_sphere(direction: [f64; 3]) -> (f64, f64, usize) {
    let camera = look([0.0, 0.9, 2.6], [0.0; 3], 28.0);
    let size = [160, 160];
    let of = |slices: u32, stacks: u32| sphere([0.0; 3], 0.5, slices, stacks, SINGLE);
    let (light, toward) = one_texel(direction);
    let [coarse, fine] = [(12, 8), (200, 100)].map(|(slices, stacks)| {
        let asset = baked_asset(&scene(vec![("s", of(slices, stacks))]), 0.05);
        draw(&asset, &light, &camera, size)
    });
    let best = lambert_of_mesh(&of(12, 8), toward, &camera, size);
    let mask: Vec<bool> = coarse.mask.iter().zip(&fine.mask).map(|(a, b)| *a && *b).collect();
    let psnr = |test: &Image, reference: &Image| {
        let metrics = compare(test, reference, &mask, None, None).unwrap();
        assert!(metrics.mask_share > 0.3, "the sphere fills the picture");
        metrics.mask.psnr_db.unwrap()
    };
    let (to_fine, to_best) = (psnr(&coarse.image, &fine.image), psnr(&coarse.image, &best));
    let is_dark = |i: &usize| mask[*i] && best.pixels[*i][1] > 0.01 && coarse.image.pixels[*i][1] < 0.7 * best.pixels[*i][1];
    let dark = (0..mask.len()).filter(is_dark).count();
    println!(
        "12 x 8 sphere, light from {direction:?}: {to_fine:.2} dB to 200 segments, where perfect shading of its mesh has {:.2} dB; {to_best:.2} dB to that, {dark} dark pixels",
        psnr(&best, &fine.image)
    );
    assert!(best.pixels.iter().any(|p| p[1] > 0.05), "something is lit");
    (to_fine, to_best, dark)
}

#[test]
fn a_coarse_smooth_sphere_under_one_texel_shows_no_dark_facet() {
    let (to_fine, to_best, dark) = coarse_sphere([0.95, 0.3, 0.1]);
    assert!(to_fine >= 32.0 && to_best >= 40.0 && dark == 0, "{to_fine} {to_best} {dark}");
}

// ---- thin things

#[test]
fn a_sheet_a_tenth_of_a_millimetre_over_a_floor_hides_it() {
    const EDGE: f32 = 0.1;
    let light = light_from(&white());
    for material in [SINGLE, DOUBLE] {
        // Sizes that keep the floor's points and the sheet's border apart.
        let scene = scene(vec![
            ("floor", quad([-1.03, 0.0, -1.01], [0.0, 0.0, 2.07], [2.11, 0.0, 0.0], SINGLE)),
            ("sheet", quad([-0.5, 1e-4, -0.5], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], material)),
        ]);
        let asset = baked_asset(&scene, EDGE);
        let floor = points(&asset, 0, &light);
        // How far inside the sheet's border a point lies; negative outside.
        let depth = |point: &Point| (0.5 - point.position[0].abs()).min(0.5 - point.position[2].abs());
        let lit: Vec<f32> = floor.iter().filter(|p| depth(p) < -2.0 * EDGE).map(|p| p.irradiance).collect();
        let lit_mean = lit.iter().sum::<f32>() / lit.len() as f32;
        let dark: Vec<&Point> = floor.iter().filter(|p| depth(p) > 2.0 * EDGE).collect();
        let leak = dark.iter().map(|p| p.irradiance).fold(0.0, f32::max) / lit_mean;
        println!("sheet (material {material}): {} dark points, worst {:.4} % of {lit_mean:.4}", dark.len(), 100.0 * leak);
        assert!(dark.len() > 20 && lit.len() > 100 && (lit_mean - PI).abs() < 0.01 * PI, "{} {} {lit_mean}", dark.len(), lit.len());
        assert!(leak < 0.02, "{leak}");
        assert!(dark.iter().all(|p| p.is_buried), "nothing is drawn from between floor and sheet");
        for point in points(&asset, 1, &light) {
            let expected = if point.is_back { 0.0 } else { PI };
            // The horizon cuts the sky's texels at n·ω = 0: a percent of the cosine-weighted sky.
            let inner = depth(&point) > 2.0 * EDGE || !point.is_back;
            assert!(!inner || (point.irradiance - expected).abs() < 0.01 * PI, "{point:?}");
        }
    }
}

#[test]
fn a_thin_wall_on_a_two_triangle_floor_does_not_leak() {
    const EDGE: f32 = 0.2;
    let light = light_from(&white());
    // Offsets of the floor's border: points fall into the wall's centimetre, close to it, between.
    for shift in [0.0, 0.037, 0.1] {
        let wall = |lower: [f32; 3], upper: [f32; 3]| cuboid(lower, upper, SINGLE);
        let scene = scene(vec![
            ("floor", quad([-2.0 - shift, 0.0, -1.2 - shift], [0.0, 0.0, 2.4], [4.2, 0.0, 0.0], SINGLE)),
            ("wall", wall([-0.005, 0.0, -1.0], [0.005, 2.0, 1.0])),
            ("far", wall([1.6, 0.0, -1.0], [1.61, 2.0, 1.0])),
            ("left", wall([-0.005, 0.0, -1.0], [1.61, 2.0, -0.99])),
            ("right", wall([-0.005, 0.0, 0.99], [1.61, 2.0, 1.0])),
            ("roof", wall([-0.005, 1.99, -1.0], [1.61, 2.0, 1.0])),
        ]);
        let asset = baked_asset(&scene, EDGE);
        let floor = points(&asset, 0, &light);
        let lit: Vec<f32> = floor.iter().filter(|p| p.position[0] < -2.0 * EDGE).map(|p| p.irradiance).collect();
        let lit_mean = lit.iter().sum::<f32>() / lit.len() as f32;
        let in_room = |x: f32, z: f32, from_wall: f32| x > 0.005 + from_wall && x < 1.6 - from_wall && z.abs() < 0.99 - from_wall;
        let see_out = floor.iter().filter(|p| in_room(p.position[0], p.position[2], 1e-3) && !p.is_blocked).count();
        // A picture of the floor inside, from below the roof: what interpolation makes of the points.
        let (camera, size) = (look([0.8, 1.9, 0.0], [0.8, 0.0, 0.0], 60.0), [160, 160]);
        let frame = draw(&asset, &light, &camera, size);
        let lit_radiance = CLAY_ALBEDO / PI * lit_mean;
        let worst = |edges: f32| {
            let pixels = floor_pixels(&camera, size, None);
            let chosen = pixels.iter().zip(&frame.image.pixels);
            let chosen = chosen.filter(|(at, _)| at.is_some_and(|[x, z]| in_room(x as f32, z as f32, edges * EDGE)));
            chosen.fold((0, 0.0f32), |(n, worst), (_, p)| (n + 1, worst.max(p[1] / lit_radiance)))
        };
        let ((near, at_wall), (_, one), (far, two)) = (worst(0.05), worst(1.0), worst(2.0));
        println!(
            "thin wall, floor moved {shift}: {see_out} points of the room see out; worst pixel {:.3} % at the wall, {:.3} % one edge away, {:.3} % two edges away",
            100.0 * at_wall,
            100.0 * one,
            100.0 * two
        );
        assert!(lit.len() > 50 && lit_mean > 0.6 * PI && near > far && far > 1000, "{} {lit_mean} {near} {far}", lit.len());
        assert_eq!(see_out, 0, "the room is closed");
        assert!(two < 0.02, "{two} of the lit side at two edges from a wall");
        assert!(frame.mask.iter().all(|covered| *covered), "the picture is filled by the room");
    }
}

// ---- sides and mirrors

#[test]
fn a_double_sided_sheet_is_lit_on_the_side_of_the_light_alone() {
    let asset = baked_asset(&scene(vec![("sheet", quad([-0.5, -0.5, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], DOUBLE))]), 0.1);
    let size = [64, 64];
    for (side, name) in [(1.0, "front"), (-1.0, "back")] {
        let (light, toward) = one_texel([0.3, 0.4, 0.8 * side]);
        let expected = toward[2].abs();
        let points = points(&asset, 0, &light);
        assert_eq!(points.iter().filter(|p| p.is_back).count() * 2, points.len());
        for point in &points {
            assert_eq!(point.normal[2] < 0.0, point.is_back);
            let is_lit = point.normal[2] * toward[2] > 0.0;
            let expected = if is_lit { expected } else { 0.0 };
            // Suffix sums are f32 of a sum of one term.
            assert!((point.irradiance - expected).abs() < 1e-6, "{name} {point:?}");
        }
        for eye in [2.0f32, -2.0] {
            let frame = draw(&asset, &light, &look([0.0, 0.0, eye], [0.0; 3], 40.0), size);
            let expected = if f64::from(eye) * side > 0.0 { CLAY_ALBEDO / PI * expected } else { 0.0 };
            let seen: Vec<f32> = (0..frame.mask.len()).filter(|i| frame.mask[*i]).map(|i| frame.image.pixels[i][1]).collect();
            assert!(seen.len() > 500 && seen.iter().all(|v| (v - expected).abs() < 1e-6), "{name} lit, seen from z = {eye}");
        }
    }
}

#[test]
fn an_inside_out_box_blocks_as_a_box_and_shows_the_side_that_is_there() {
    let light = light_from(&white());
    let (lower, upper) = ([-0.3, 0.2, -0.3], [0.4, 0.8, 0.3]);
    let with = |primitive: Primitive| {
        let floor = quad([-1.0, 0.0, -1.0], [0.0, 0.0, 2.0], [2.0, 0.0, 0.0], SINGLE);
        baked_asset(&scene(vec![("floor", floor), ("box", primitive)]), 0.1)
    };
    let plain = with(cuboid(lower, upper, SINGLE));
    let single = with(inside_out(cuboid(lower, upper, SINGLE)));
    let double = with(inside_out(cuboid(lower, upper, DOUBLE)));
    let floor = |asset: &Arc<Asset>| -> Vec<(bool, u32)> {
        points(asset, 0, &light).iter().map(|p| (p.is_buried, p.irradiance.to_bits())).collect()
    };
    assert!(points(&plain, 0, &light).iter().any(|p| p.irradiance < 0.5 * PI), "the box casts a shadow");
    assert_eq!(floor(&single), floor(&plain), "triangles block from both sides");
    assert_eq!(floor(&double), floor(&plain));

    // From outside. A double-sided one looks like the plain one; of a single-sided one only far walls are seen, and no light is in there.
    let (camera, size) = (look([1.2, 1.6, 2.0], [0.05, 0.4, 0.0], 40.0), [160, 120]);
    let [of_plain, of_single, of_double] = [&plain, &single, &double].map(|asset| draw(asset, &light, &camera, size));
    let metrics = compare(&of_double.image, &of_plain.image, &of_plain.mask, None, None).unwrap();
    println!("inside-out double-sided box against a plain one: {:?} dB, relative L2 {:?}", metrics.mask.psnr_db, metrics.mask.relative_l2);
    assert!(metrics.mask_share > 0.3 && metrics.mask.relative_l2.unwrap() < 1e-3, "{metrics:?}");
    let solid = floor_pixels(&camera, size, Some((lower, upper)));
    // Pixels all around are on the box too: away from its outline.
    let is_on_box = |i: usize| {
        let (x, y) = (i % size[0], i / size[0]);
        (2..size[0] - 2).contains(&x)
            && (2..size[1] - 2).contains(&y)
            && (0..25).all(|k| solid[(y + k / 5 - 2) * size[0] + x + k % 5 - 2].is_none())
    };
    let on_box: Vec<usize> = (0..solid.len()).filter(|i| is_on_box(*i) && of_plain.mask[*i]).collect();
    assert!(on_box.len() > 500, "{}", on_box.len());
    assert!(on_box.iter().all(|i| of_plain.image.pixels[*i][1] > 0.05), "the plain box is lit");
    assert!(on_box.iter().all(|i| of_single.image.pixels[*i] == [0.0; 3]), "walls seen from within a closed box are dark");

    // From inside: dark, both.
    for asset in [&single, &double] {
        let frame = draw(asset, &light, &look([0.05, 0.5, 0.0], [0.4, 0.7, 0.3], 90.0), [32, 32]);
        (0..32 * 32).for_each(|i| assert!(frame.mask[i] && frame.image.pixels[i] == [0.0; 3], "pixel {i}"));
    }
}

/// Some of everything, without any symmetry.
fn lopsided() -> Scene {
    scene(vec![
        ("floor", quad([-0.6, 0.0, -0.6], [0.0, 0.0, 1.2], [1.3, 0.0, 0.0], SINGLE)),
        ("box", cuboid([-0.4, 0.05, -0.3], [-0.1, 0.35, 0.0], SINGLE)),
        ("sphere", sphere([0.27, 0.2, 0.1], 0.15, 12, 8, SINGLE)),
        ("sheet", quad([-0.1, 0.2, 0.3], [0.4, 0.0, 0.05], [0.0, 0.3, 0.1], DOUBLE)),
    ])
}

#[test]
fn a_mirrored_scene_is_the_mirror_image_from_both_sides() {
    let plain = lopsided();
    let mut mirrored = plain.clone();
    mirrored.objects.iter_mut().for_each(|object| object.world_from_local[0] = -1.0);
    let [plain, mirrored] = [plain, mirrored].map(|scene| baked_asset(&scene, 0.08));
    // Different light from everywhere, and its mirror image: longitude φ becomes π − φ, column i becomes 3w/2 − 1 − i.
    let (w, h) = (32, 16);
    let value = |i: usize| [0.1 + ((i * 37) % 101) as f32 / 50.0, 0.2 + ((i * 53) % 97) as f32 / 50.0, 0.1 + ((i * 71) % 89) as f32 / 50.0];
    let light = light_from(&Environment::new(w, h, (0..w * h).map(value).collect()));
    let reflected = |i: usize| value(i / w * w + (3 * w / 2 - 1 - i % w) % w);
    let light_mirrored = light_from(&Environment::new(w, h, (0..w * h).map(reflected).collect()));

    let (mut worst, mut total) = (0.0f32, 0);
    for object in 0..4 {
        let (a, b) = (points(&plain, object, &light), points(&mirrored, object, &light_mirrored));
        assert_eq!(a.len(), b.len(), "object {object}");
        let key = |p: &Point, sign: f32| (p.is_back, [sign * p.position[0] + 0.0, p.position[1], p.position[2]].map(f32::to_bits));
        let mut by_place: BTreeMap<_, Vec<&Point>> = BTreeMap::new();
        a.iter().for_each(|p| by_place.entry(key(p, 1.0)).or_default().push(p));
        for p in &b {
            let normal = [-p.normal[0], p.normal[1], p.normal[2]];
            let twin = by_place.get(&key(p, -1.0)).and_then(|here| here.iter().find(|q| dot(q.normal, normal) > 0.9999));
            let twin = twin.unwrap_or_else(|| panic!("object {object}: no mirror image of {p:?}"));
            assert_eq!(twin.is_buried, p.is_buried);
            worst = worst.max((twin.irradiance - p.irradiance).abs());
            total += 1;
        }
    }
    println!("mirrored: irradiance of {total} points differs by at most {worst}");
    // Texels whose centres lie on an edge of a triangle fall to one side: a few of 24,576, each about 1e-3 of the light.
    assert!(total > 500 && worst < 0.01, "{worst}");

    for eye in [[0.9, 1.1, 1.6], [-1.0, 0.7, -1.4]] {
        let (camera, size) = (look(eye, [0.0, 0.15, 0.0], 40.0), [160, 120]);
        let other = look([-eye[0], eye[1], eye[2]], [0.0, 0.15, 0.0], 40.0);
        let a = draw(&plain, &light, &camera, size);
        let b = draw(&mirrored, &light_mirrored, &other, size);
        let flip = |i: usize| i / size[0] * size[0] + size[0] - 1 - i % size[0];
        let flipped = Image { pixels: (0..b.image.pixels.len()).map(|i| b.image.pixels[flip(i)]).collect(), ..b.image };
        let mask: Vec<bool> = (0..a.mask.len()).map(|i| a.mask[i] && b.mask[flip(i)]).collect();
        let metrics = compare(&flipped, &a.image, &mask, None, None).unwrap();
        let psnr = metrics.mask.psnr_db.unwrap_or(f64::INFINITY);
        println!("mirrored, from {eye:?}: {psnr:.2} dB over {:.3} of the frame", metrics.mask_share);
        assert!(metrics.mask_share > 0.2 && psnr > 45.0, "{psnr}");
    }
}

// ---- standing on things

#[test]
fn a_box_on_a_floor_buries_the_floor_below_it_and_darkens_none_beside_it() {
    const EDGE: f32 = 0.1;
    let environment = white();
    let light = light_from(&environment);
    // Not on a line of the floor's points.
    let (lower, upper) = ([-0.33, 0.0, -0.27], [0.26, 0.45, 0.31]);
    let scene =
        scene(vec![("floor", quad([-1.0, 0.0, -1.0], [0.0, 0.0, 2.0], [2.0, 0.0, 0.0], SINGLE)), ("box", cuboid(lower, upper, SINGLE))]);
    let asset = baked_asset(&scene, EDGE);
    // How far from the box's footprint; negative inside.
    let outside = |x: f32, z: f32| (lower[0] - x).max(x - upper[0]).max(lower[2] - z).max(z - upper[2]);
    let floor = points(&asset, 0, &light);
    let (mut below, mut beside) = (0, 0);
    for point in &floor {
        let distance = outside(point.position[0], point.position[2]);
        if distance < -1e-3 {
            below += 1;
            assert!(point.is_buried && point.is_blocked, "{point:?}");
        } else if distance > 1e-3 {
            beside += 1;
            assert!(!point.is_buried && !point.is_blocked, "{point:?}");
        }
    }
    assert!(below > 20 && beside > 200, "{below} {beside}");

    let (camera, size) = (look([1.1, 1.9, 1.5], [0.0, 0.1, 0.0], 45.0), [128, 96]);
    let frame = draw(&asset, &light, &camera, size);
    let world = World::build(&scene);
    let occluders = Occluders::build(&world, &scene.textures, OccluderOptions { leaf_size: 16, ..OccluderOptions::default() });
    let options = ReferenceOptions {
        width: size[0],
        height: size[1],
        samples_per_pixel: 32,
        clay: true,
        edge_lengths: vec![EDGE; scene.objects.len()],
        ..ReferenceOptions::default()
    };
    let truth = render_reference(&scene, &world, &occluders, &environment, &camera, &options, &Silent).unwrap();
    let pixels = floor_pixels(&camera, size, Some((lower, upper)));
    // Bands of floor around the box, metres from its footprint: nearest first, then all that is seen.
    for (from, to, tolerance) in [(0.02, 0.1, 0.05), (0.1, 0.2, 0.03), (0.02, 2.0, 0.02)] {
        let (mut n, mut drawn, mut expected) = (0, 0.0, 0.0);
        for (i, at) in pixels.iter().enumerate() {
            let Some([x, z]) = at else { continue };
            let distance = outside(*x as f32, *z as f32);
            if (from..to).contains(&distance) && truth.mask[i] && frame.mask[i] {
                n += 1;
                drawn += f64::from(frame.image.pixels[i][1]);
                expected += f64::from(truth.image.pixels[i][1]);
            }
        }
        println!("floor {from}..{to} m beside the box: {:.2} % of the reference over {n} pixels", 100.0 * drawn / expected);
        assert!(n > 150, "{n}");
        assert!((drawn / expected - 1.0).abs() < tolerance, "{from}..{to}: {}", drawn / expected);
    }
}

/// Triangles whose box began in the right half of the last column, or the lower half of the last row, were once taken for out of view:
/// 31 pixels of 552,960 missed samples.
#[test]
fn a_closed_surface_seen_from_inside_has_no_pinholes() {
    let asset = baked_asset(&scene(vec![("box", inside_out(cuboid([-0.3, 0.2, -0.3], [0.4, 0.8, 0.3], SINGLE)))]), 0.1);
    let (light, n) = (light_from(&white()), 96);
    for turn in 0..60 {
        let turn = turn as f32;
        let at = [0.4 + (turn * 1.3).sin(), 0.7 + 0.3 * (turn * 2.1).sin(), 0.3 + (turn * 0.7).cos()];
        let frame = draw(&asset, &light, &look([0.05, 0.5, 0.0], at, 90.0), [n, n]);
        let hole = frame.mask.iter().position(|hit| !hit);
        assert!(hole.is_none(), "view {turn}, pixel {hole:?}");
    }
}

/// What falls short today, held where it is.
mod known_issues {
    use super::*;

    /// Short of 32 dB to the 200-segment sphere where the light stands near the eye or behind: not by dark facets (no pixel inside the outline is darker than the mesh's
    /// own normals say), but because flat triangles lie up to 5 % of the radius inside the sphere, so that a pixel shows another normal. Perfect
    /// shading of the mesh falls short as well, by the same.
    #[test]
    fn parallax_of_a_coarse_sphere_costs_more_than_its_points() {
        for (direction, to_fine_today) in [([0.5, 0.6, 0.7], 27.0), ([-0.6, 0.1, -0.5], 24.5)] {
            let (to_fine, to_best, dark) = coarse_sphere(direction);
            // One pixel on the outline, lit from behind: 16 samples there, 4 here.
            assert!(to_fine >= to_fine_today && to_best >= 40.0 && dark <= 1, "{to_fine} {to_best} {dark}");
        }
    }
}
