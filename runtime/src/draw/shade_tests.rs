use super::at_points::{INSET, draw_at_points};
use super::raster::Visibility;
use super::raster_tests::{Soup, front_camera, material, random};
use super::shade::{CLAY_ALBEDO, DrawObject, DrawScene, Frame, PointLight, draw, radiance};
use crate::brdf::surface::coat_albedo;
use crate::brdf::{Coat, GltfSurface, Place};
use crate::camera::{Camera, CameraRays};
use crate::chunk::mesh::{Mesh, NO_POINT};
use crate::chunk::points::BURIED;
use crate::surface::{AlphaMode, Material, SurfaceSample, Texture, TextureEncoding, TextureRef, Wrap};
use std::borrow::Cow;
use std::f32::consts::PI;

const BLACK: &(dyn Fn([f32; 3]) -> [f32; 3] + Sync) = &|_| [0.0; 3];

/// Vector irradiance that gives `e(n)` = value for the normal +z.
fn toward_z(value: f32) -> [[f32; 3]; 3] {
    [[0.0, 0.0, value]; 3]
}

fn object<'a>(soup: &'a Soup, irradiance: &'a [[[f32; 3]; 3]]) -> DrawObject<'a> {
    DrawObject { mesh: soup.mesh(), irradiance, lune: &[], glossy: &[], coat: &[], share: &[], between: None, point_flags: &[] }
}

fn picture(objects: &[DrawObject], materials: &[Material], textures: &[Texture], clay: bool, camera: &Camera) -> Frame {
    draw(&DrawScene { objects, materials, textures, tables: &[], background: BLACK, clay }, camera, [64, 64], 16).unwrap()
}

fn square(half: f32, z: f32) -> Soup {
    Soup::new(vec![[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]], vec![[0, 1, 2], [0, 2, 3]])
}

/// Sphere whose points hold the vector irradiance of a constant white sky seen by a convex body: π along the normal.
fn sphere(segments: u32) -> Soup {
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    for i in 0..=segments {
        for j in 0..2 * segments {
            let (theta, phi) = (PI * i as f32 / segments as f32, PI * j as f32 / segments as f32);
            positions.push([theta.sin() * phi.cos(), theta.cos(), -theta.sin() * phi.sin()]);
            if i < segments {
                let (a, b) = (i * 2 * segments + j, i * 2 * segments + (j + 1) % (2 * segments));
                triangles.push([a, a + 2 * segments, b]);
                triangles.push([b, a + 2 * segments, b + 2 * segments]);
            }
        }
    }
    let mut soup = Soup::new(positions, triangles);
    soup.normal = soup.position.clone();
    soup
}

#[test]
fn a_white_sky_gives_albedo_times_e_over_pi_everywhere_on_a_sphere() {
    let soup = sphere(48);
    let irradiance: Vec<_> = soup.normal.iter().map(|n| [n.map(|v| v * PI); 3]).collect();
    let camera = Camera::new([0.5, 1.0, 4.0], [0.0; 3], [0.0, 1.0, 0.0], 35.0).unwrap();
    let frame = picture(&[object(&soup, &irradiance)], &[material(false, AlphaMode::Opaque)], &[], true, &camera);
    let inside = frame.mask.iter().filter(|m| **m).count();
    assert!(inside > 1000);
    for (pixel, _) in frame.image.pixels.iter().zip(&frame.mask).filter(|(_, m)| **m) {
        // 48 segments: interpolated normals are shorter than 1 by up to (π/96)²/2 and are made unit again against an E that is not.
        assert!(pixel.iter().all(|v| (v - CLAY_ALBEDO).abs() < 1e-3), "{pixel:?}");
    }
    // Material: the diffuse factor of the view direction at the pixel.
    let base = Material { base_color: [0.6, 0.3, 0.1, 1.0], roughness: 0.5, ..material(false, AlphaMode::Opaque) };
    let frame = picture(&[object(&soup, &irradiance)], &[base], &[], false, &camera);
    let rays = CameraRays::new(&camera, 64, 64).unwrap();
    let surface = GltfSurface { base_color: [0.6, 0.3, 0.1], roughness: 0.5, ..GltfSurface::default() };
    let (mut checked, eye) = (0, camera.eye);
    for i in (0..64 * 64).filter(|i| frame.mask[*i]) {
        let d = rays.direction((i % 64) as f32 + 0.5, (i / 64) as f32 + 0.5);
        let b = (0..3).map(|k| eye[k] * d[k]).sum::<f32>();
        let c = eye.iter().map(|v| v * v).sum::<f32>() - 1.0;
        let root = (b * b - c).max(0.0).sqrt();
        // At the rim the albedo changes within a pixel and the facets show.
        if root < 0.4 {
            continue;
        }
        let expected = surface.diffuse(root).map(|f| f * PI);
        for k in 0..3 {
            assert!((frame.image.pixels[i][k] - expected[k]).abs() < 2e-3, "{i} {:?} {expected:?}", frame.image.pixels[i]);
        }
        checked += 1;
    }
    assert!(checked > 800);
}

#[test]
fn attributes_are_those_of_the_world_triangle_not_of_the_screen() {
    // A floor that recedes: irradiance is a linear function of the world position.
    let soup = Soup::new(vec![[-9.0, -1.0, 4.5], [9.0, -1.0, 4.5], [0.0, -1.0, -40.0]], vec![[0, 1, 2]]);
    let linear = |p: [f32; 3]| 3.0 + 0.2 * p[0] - 0.1 * p[2];
    let irradiance: Vec<_> = soup.position.iter().map(|p| toward_z(linear(*p))).collect();
    let camera = front_camera();
    let materials = [material(true, AlphaMode::Opaque)];
    let scene = DrawScene {
        objects: &[object(&soup, &irradiance)],
        materials: &materials,
        textures: &[],
        tables: &[],
        background: BLACK,
        clay: true,
    };
    let frame = draw(&scene, &camera, [64, 64], 1).unwrap();
    let rays = CameraRays::new(&camera, 64, 64).unwrap();
    let mut checked = 0;
    for i in (0..64 * 64).filter(|i| frame.mask[*i]) {
        let d = rays.direction((i % 64) as f32 + 0.5, (i / 64) as f32 + 0.5);
        let t = -1.0 / d[1];
        let expected = linear([d[0] * t, -1.0, 5.0 + d[2] * t]) * CLAY_ALBEDO / PI;
        assert!((frame.image.pixels[i][0] - expected).abs() < 1e-4 * (1.0 + expected), "{i}");
        checked += 1;
    }
    assert!(checked > 1000);
}

#[test]
fn blend_is_drawn_over_what_is_behind_in_depth_order() {
    let (near, middle, wall) = (square(9.0, 1.0), square(9.0, 0.5), square(9.0, 0.0));
    let light: Vec<Vec<_>> = [4.0, 2.0, 1.0].iter().map(|v| vec![toward_z(*v); 4]).collect();
    let mut soups = [near, middle, wall];
    (0..3).for_each(|i| soups[i].material = vec![i as u32; 2]);
    let glass = |alpha: f32| Material { base_color: [1.0, 1.0, 1.0, alpha], ..material(false, AlphaMode::Blend) };
    let materials = [glass(0.25), glass(0.5), material(false, AlphaMode::Opaque)];
    let mut objects: Vec<_> = (0..3).map(|i| object(&soups[i], &light[i])).collect();
    let value = |v: f32| v * CLAY_ALBEDO / PI;
    let expected = 0.25 * value(4.0) + 0.75 * (0.5 * value(2.0) + 0.5 * value(1.0));
    for _ in 0..3 {
        objects.rotate_left(1);
        let frame = picture(&objects, &materials, &[], true, &front_camera());
        assert!(frame.mask.iter().all(|m| *m));
        // Also along the diagonals that the triangles share: no seam.
        assert!(frame.image.pixels.iter().all(|p| (p[1] - expected).abs() < 1e-5), "{:?} {expected}", frame.image.pixels[40]);
    }
    // Nothing behind: over the background.
    let scene =
        DrawScene { objects: &objects[..0], materials: &materials, textures: &[], tables: &[], background: &|_| [3.0; 3], clay: true };
    let frame = draw(&scene, &front_camera(), [33, 20], 16).unwrap();
    assert!(frame.image.pixels.iter().all(|p| (p[0] - 3.0).abs() < 1e-5) && frame.coverage.iter().all(|c| *c == 0.0));
}

#[test]
fn mask_cuts_where_alpha_is_below_the_cutoff() {
    let mut soup = square(4.0, 0.0);
    let uv = [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]];
    soup.material = vec![0; 2];
    // Left texel opaque, right clear, nearest.
    let texture =
        Texture { width: 2, height: 1, encoding: TextureEncoding::Srgb, texels: Cow::Owned(vec![255, 255, 255, 255, 255, 255, 255, 100]) };
    let reference = TextureRef { texture: 0, uv_set: 0, wrap: [Wrap::Clamp; 2], nearest: true, transform: None };
    let cut = Material { base_color_texture: Some(reference), ..material(false, AlphaMode::Mask { cutoff: 0.5 }) };
    let irradiance = vec![toward_z(1.0); 4];
    let drawn = DrawObject { mesh: Mesh { uv0: &uv, ..soup.mesh() }, ..object(&soup, &irradiance) };
    let frame = picture(&[drawn], &[cut], &[texture], true, &front_camera());
    for i in 0..64 * 64 {
        let x = i % 64;
        if x != 31 && x != 32 {
            assert_eq!(frame.coverage[i], if x < 32 { 1.0 } else { 0.0 }, "{i}");
        }
    }
}

#[test]
fn buried_and_missing_points_leave_the_interpolation() {
    let mut soup = square(4.0, 0.0);
    let mut irradiance = vec![toward_z(1.0); 4];
    irradiance[1] = toward_z(50.0);
    soup.points[3] = NO_POINT;
    let flags = [0, BURIED, 0, 0];
    let drawn = DrawObject { point_flags: &flags, ..object(&soup, &irradiance) };
    let frame = picture(&[drawn], &[material(false, AlphaMode::Opaque)], &[], true, &front_camera());
    assert!(frame.image.pixels.iter().all(|p| (p[0] - CLAY_ALBEDO / PI).abs() < 1e-6));
    let all = [BURIED; 4];
    let dark = DrawObject { point_flags: &all, ..object(&soup, &irradiance) };
    let frame = picture(&[dark], &[material(false, AlphaMode::Opaque)], &[], true, &front_camera());
    assert!(frame.image.pixels.iter().all(|p| *p == [0.0; 3]) && frame.mask.iter().all(|m| *m));
}

#[test]
fn the_back_of_a_double_sided_surface_takes_its_back_points_and_the_negated_normal() {
    let mut soup = square(4.0, 0.0);
    // Turned away from the camera: the front normal is −z.
    soup.triangles = vec![[0, 2, 1], [0, 3, 2]];
    soup.normal = vec![[0.0, 0.0, -1.0]; 4];
    soup.points = vec![0; 4];
    soup.back = vec![1; 4];
    let irradiance = [toward_z(-7.0), toward_z(2.0)];
    let frame = picture(&[object(&soup, &irradiance)], &[material(true, AlphaMode::Opaque)], &[], true, &front_camera());
    assert!(frame.image.pixels.iter().all(|p| (p[0] - 2.0 * CLAY_ALBEDO / PI).abs() < 1e-6));
}

/// A smooth triangle's pixel can turn away from a sun that one corner's point sees: that corner gives nothing then, and takes nothing.
#[test]
fn a_sun_below_the_pixels_normal_takes_no_light_of_other_corners() {
    let soup = square(4.0, 0.0);
    let light = |below: f32| {
        let irradiance = [toward_z(below), toward_z(2.0), toward_z(2.0), toward_z(2.0)];
        picture(&[object(&soup, &irradiance)], &[material(false, AlphaMode::Opaque)], &[], true, &front_camera()).image.pixels
    };
    let (sunny, dark) = (light(-100.0), light(0.0));
    assert_eq!(sunny, dark);
    assert!(sunny.iter().filter(|p| p[0] > 0.0).count() * 10 > sunny.len() * 9);
}

#[test]
fn normal_maps_bend_the_diffuse_part() {
    let soup = square(4.0, 0.0);
    let uv = [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]];
    // Tilted toward +u, that is +x.
    let texels = vec![218, 128, 218, 255];
    let texture = Texture { width: 1, height: 1, encoding: TextureEncoding::Linear, texels: Cow::Owned(texels) };
    let reference = TextureRef { texture: 0, uv_set: 0, wrap: [Wrap::Repeat; 2], nearest: false, transform: None };
    let bumpy = Material { normal_texture: Some(reference), roughness: 1.0, ..material(false, AlphaMode::Opaque) };
    let irradiance = vec![[[1.0, 0.0, 0.0]; 3]; 4];
    let tangents = [[1.0, 0.0, 0.0, 1.0]; 4];
    for tangent in [&[][..], &tangents[..]] {
        let drawn = DrawObject { mesh: Mesh { uv0: &uv, tangent, ..soup.mesh() }, ..object(&soup, &irradiance) };
        let frame = picture(&[drawn], std::slice::from_ref(&bumpy), std::slice::from_ref(&texture), false, &front_camera());
        let n = [90.0f32 / 127.5, 0.5 / 127.5, 90.5 / 127.5];
        let x = n[0] / (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
        let centre = frame.image.pixels[32 * 64 + 32];
        let expected = GltfSurface::default().diffuse(x)[0] * x;
        assert!((centre[0] - expected).abs() < 3e-3, "{centre:?} {expected}");
    }
}

#[test]
fn emission_and_glossy_terms_add_up_as_documented() {
    let surface = SurfaceSample {
        base_color: [0.8, 0.4, 0.2],
        metallic: 0.25,
        roughness: 0.3,
        emissive: [0.5, 0.0, 0.0],
        ..SurfaceSample::default()
    };
    let brdf = GltfSurface { base_color: surface.base_color, metallic: 0.25, roughness: 0.3, ..GltfSurface::default() };
    let light = PointLight { received: [2.0, 3.0, 4.0], glossy: [[1.0, 2.0, 3.0], [0.1, 0.2, 0.3]], coat: [5.0, 6.0, 7.0] };
    let (place, view) = (Place::about([0.0, 0.0, 1.0]), [0.51f32.sqrt(), 0.0, 0.7]);
    let got = radiance(&surface, &place, view, &[], &light);
    let coat = Coat { strength: 0.5, roughness: 0.2 };
    let coated = radiance(&SurfaceSample { coat, ..surface }, &place, view, &[], &light);
    for k in 0..3 {
        let f0 = 0.04 + (surface.base_color[k] - 0.04) * 0.25;
        let expected = surface.emissive[k] + brdf.diffuse(0.7)[k] * [2.0, 3.0, 4.0][k] + f0 * (k + 1) as f32 + 0.1 * (k + 1) as f32;
        assert!((got[k] - expected).abs() < 1e-6);
        let passed = (got[k] - surface.emissive[k]) * (1.0 - 0.5 * coat_albedo(0.7, 0.2));
        assert!((coated[k] - surface.emissive[k] - passed - 0.5 * light.coat[k]).abs() < 1e-6);
    }
}

/// A checker of one texel a sample: the mean must be grey although the pixel's centre is black or white.
#[test]
fn minified_textures_are_averaged_over_the_pixel() {
    let soup = square(4.0, 0.0);
    let uv = [[0.0, 128.0], [128.0, 128.0], [128.0, 0.0], [0.0, 0.0]];
    let texture = Texture {
        width: 2,
        height: 2,
        encoding: TextureEncoding::Linear,
        texels: Cow::Owned([[255u8; 4], [0, 0, 0, 255], [0, 0, 0, 255], [255; 4]].concat()),
    };
    let reference = TextureRef { texture: 0, uv_set: 0, wrap: [Wrap::Repeat; 2], nearest: true, transform: None };
    let glowing =
        Material { emissive: [1.0; 3], emissive_texture: Some(reference), base_color: [0.0; 4], ..material(false, AlphaMode::Opaque) };
    let irradiance = vec![toward_z(0.0); 4];
    let drawn = DrawObject { mesh: Mesh { uv0: &uv, ..soup.mesh() }, ..object(&soup, &irradiance) };
    let frame = picture(&[drawn], &[glowing], &[texture], false, &front_camera());
    assert!(frame.image.pixels.iter().all(|p| (p[0] - 0.5).abs() < 0.13), "{:?}", frame.image.pixels[77]);
}

#[test]
fn one_thread_and_many_draw_the_same_bits_and_only_visible_points_matter() {
    let soup = sphere(20);
    let irradiance: Vec<_> = (0..soup.position.len() as u32).map(|i| [[random(i), random(i + 9), 2.0]; 3]).collect();
    let glossy: Vec<_> = (0..soup.position.len() as u32).map(|i| [[random(i + 5); 3], [random(i + 6); 3]]).collect();
    let camera = Camera::new([1.5, 1.0, 2.0], [0.0; 3], [0.0, 1.0, 0.0], 50.0).unwrap();
    let materials = [material(false, AlphaMode::Opaque)];
    let render = |irradiance: &[[[f32; 3]; 3]]| {
        let drawn = DrawObject { glossy: &glossy, ..object(&soup, irradiance) };
        picture(&[drawn], &materials, &[], false, &camera)
    };
    let expected = render(&irradiance);
    #[cfg(feature = "parallel")]
    for threads in [1, 2, 5] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert_eq!(pool.install(|| render(&irradiance)), expected, "{threads} threads");
    }
    let visibility = super::Visibility::new(&[soup.mesh()], &materials, &[], &camera, [64, 64], 16).unwrap();
    let visible = visibility.visible_points(&[soup.mesh()], &[irradiance.len()]);
    let hidden = visible[0].iter().filter(|v| !**v).count();
    assert!(hidden > 200);
    let partial: Vec<_> = irradiance.iter().zip(&visible[0]).map(|(e, v)| if *v { *e } else { [[f32::NAN; 3]; 3] }).collect();
    assert_eq!(render(&partial), expected);
}

#[test]
fn light_for_too_few_points_is_an_error() {
    let soup = square(1.0, 0.0);
    let scene = DrawScene {
        objects: &[object(&soup, &[[[0.0; 3]; 3]; 3])],
        materials: &[],
        textures: &[],
        tables: &[],
        background: BLACK,
        clay: false,
    };
    assert!(draw(&scene, &front_camera(), [8, 8], 1).is_err());
}

#[test]
fn at_points_every_pixel_shows_the_light_of_one_point_and_says_where() {
    let soup = square(1.0, 0.0);
    let light = [1.0, 2.0, 3.0, 4.0];
    let irradiance = light.map(toward_z);
    let objects = [object(&soup, &irradiance)];
    let camera = front_camera();
    let scene = DrawScene {
        objects: &objects,
        materials: &[material(false, AlphaMode::Opaque)],
        textures: &[],
        tables: &[],
        background: BLACK,
        clay: true,
    };
    let visibility = Visibility::new(&[soup.mesh()], scene.materials, &[], &camera, [64, 64], 4).unwrap();
    let drawn = draw_at_points(&scene, &visibility).unwrap();
    let mut seen = [0; 4];
    for (pixel, target) in drawn.image.pixels.iter().zip(&drawn.targets) {
        let Some(target) = target else {
            assert_eq!(*pixel, [0.0; 3]);
            continue;
        };
        let point = (0..4).min_by(|a, b| distance(soup.position[*a], *target).total_cmp(&distance(soup.position[*b], *target))).unwrap();
        // The place is INSET of the way along both sides of at most 2√2.
        assert!(distance(soup.position[point], *target) < 2.0 * INSET * 2.0 * 2f32.sqrt(), "{target:?}");
        assert!((pixel[0] - light[point] * CLAY_ALBEDO / PI).abs() < 1e-6, "{pixel:?} {point}");
        seen[point] += 1;
    }
    assert!(seen.iter().all(|count| *count > 30), "{seen:?}");
}

fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|k| (a[k] - b[k]) * (a[k] - b[k])).sum::<f32>().sqrt()
}
