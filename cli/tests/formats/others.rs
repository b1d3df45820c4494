//! The scene in other formats, in parts, and with images, samplers and lobes said in another way.

use super::room::*;
use super::{LOSSLESS_DB, QUANTISED_DB, alike, picture, picture_of};
use image::codecs::png::PngEncoder;
use image::{DynamicImage, ExtendedColorType, ImageEncoder, ImageFormat, RgbImage};
use prelight_runtime::draw::metrics::compare;
use prelight_runtime::surface::{Material, TextureRef, Wrap};
use prelight_scene::export::{GlbBuilder, Transform, write_glb};
use prelight_scene::{Mesh, Primitive};
use serde_json::{Value, json};
use std::fmt::Write;

/// IEC 61966-2-1.
fn linear(srgb: u8) -> f32 {
    let x = f64::from(srgb) / 255.0;
    (if x <= 0.04045 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }) as f32
}

/// What OBJ and PLY can say of a surface: Lambert, from both sides.
fn matt(color: [f32; 3]) -> Material {
    let [r, g, b] = color;
    Material { base_color: [r, g, b, 1.0], metallic: 0.0, roughness: 1.0, specular: 0.0, double_sided: true, ..Material::default() }
}

/// A primitive in world space; a mirrored one is wound the other way.
fn placed(mut primitive: Primitive, place: &Transform) -> Primitive {
    let Transform { translation: t, scale: s, .. } = *place;
    primitive.positions.iter_mut().for_each(|p| *p = [0, 1, 2].map(|k| p[k] * s[k] + t[k]));
    for n in primitive.normals.iter_mut().flatten() {
        let m = glam::Vec3::from([0, 1, 2].map(|k| n[k] / s[k])).normalize();
        *n = m.to_array();
    }
    if s[0] * s[1] * s[2] < 0.0 {
        primitive.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
    }
    primitive
}

/// The floor and the balls in world space.
fn flattened() -> Vec<Primitive> {
    [floor(0)].into_iter().chain(places().iter().map(|place| placed(ball(0), place))).collect()
}

/// The scene with these materials for floor and balls, as glTF.
fn truth(floor_of: impl FnOnce(&mut GlbBuilder) -> Material, ball_of: Material) -> Vec<u8> {
    let mut glb = GlbBuilder::new();
    let tiles = floor_of(&mut glb);
    let paints = [glb.material(&tiles), glb.material(&ball_of)];
    for (k, mut primitive) in flattened().into_iter().enumerate() {
        primitive.material = paints[k.min(1)];
        let mesh = glb.mesh("Mesh", &Mesh { primitives: vec![primitive] });
        glb.node("Mesh", None, Transform::default(), Some(mesh));
    }
    glb.to_glb()
}

#[test]
fn an_obj_file_is_the_same_scene() {
    let (mut obj, mut first) = (String::from("mtllib a.mtl\n"), 1);
    for (k, primitive) in flattened().iter().enumerate() {
        writeln!(obj, "o Mesh{k}\nusemtl {}", if k == 0 { "Tiles" } else { "Red" }).unwrap();
        primitive.positions.iter().for_each(|[x, y, z]| writeln!(obj, "v {x} {y} {z}").unwrap());
        // Images stand on their heads there.
        primitive.uvs[0].iter().flatten().for_each(|[u, v]| writeln!(obj, "vt {u} {}", 1.0 - v).unwrap());
        primitive.normals.iter().flatten().for_each(|[x, y, z]| writeln!(obj, "vn {x} {y} {z}").unwrap());
        for t in &primitive.triangles {
            let [a, b, c] = t.map(|v| v as usize + first).map(|v| format!("{v}/{v}/{v}"));
            writeln!(obj, "f {a} {b} {c}").unwrap();
        }
        first += primitive.positions.len();
    }
    let mtl = "newmtl Tiles\nKd 1 1 1\nmap_Kd checker.png\nnewmtl Red\nKd 0.8 0.1 0.1\n";
    let image = checker(ImageFormat::Png);
    let files = [("a.obj", obj.as_bytes()), ("a.mtl", mtl.as_bytes()), ("checker.png", &image)];
    let truth = truth(
        |glb| {
            let texture = glb.image("checker", &image);
            let wrapped = TextureRef { texture, uv_set: 0, wrap: [Wrap::Repeat; 2], nearest: false, transform: None };
            Material { base_color_texture: Some(wrapped), ..matt([1.0; 3]) }
        },
        matt([0.8, 0.1, 0.1]),
    );
    alike("OBJ", &picture_of(&files, "gltf = \"a.obj\""), &picture(&truth, ""), LOSSLESS_DB);
}

#[test]
fn a_ply_file_is_the_same_scene() {
    // Colours are sRGB bytes; text, and numbers in the order of this machine's opposite.
    let (grey, red) = ([180u8, 170, 160], [230u8, 90, 80]);
    let primitives = flattened();
    let counts = [primitives.iter().map(|p| p.positions.len()).sum::<usize>(), primitives.iter().map(|p| p.triangles.len()).sum()];
    let header = |format: &str| {
        let properties = ["float x", "float y", "float z", "float nx", "float ny", "float nz", "uchar red", "uchar green", "uchar blue"];
        let properties: String = properties.iter().map(|property| format!("property {property}\n")).collect();
        let [vertices, faces] = counts;
        format!(
            "ply\nformat {format} 1.0\nelement vertex {vertices}\n{properties}element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
        )
    };
    let (mut text, mut binary) = (header("ascii"), header("binary_big_endian").into_bytes());
    let mut faces = (String::new(), Vec::new());
    let mut first = 0;
    for (k, primitive) in primitives.iter().enumerate() {
        let color = if k == 0 { grey } else { red };
        for (p, n) in primitive.positions.iter().zip(primitive.normals.iter().flatten()) {
            let [r, g, b] = color;
            writeln!(text, "{} {} {} {} {} {} {r} {g} {b}", p[0], p[1], p[2], n[0], n[1], n[2]).unwrap();
            binary.extend(p.iter().chain(n).flat_map(|x| x.to_be_bytes()).chain(color));
        }
        for t in &primitive.triangles {
            let [a, b, c] = t.map(|v| v + first);
            writeln!(faces.0, "3 {a} {b} {c}").unwrap();
            faces.1.extend([3].into_iter().chain([a, b, c].iter().flat_map(|v| v.to_be_bytes())));
        }
        first += primitive.positions.len() as u32;
    }
    text += &faces.0;
    binary.extend(faces.1);
    let truth = picture(&truth(|_| matt(grey.map(linear)), matt(red.map(linear))), "");
    for (name, bytes) in [("PLY, text", text.as_bytes()), ("PLY, big-endian", &binary)] {
        alike(name, &picture_of(&[("a.ply", bytes)], "gltf = \"a.ply\""), &truth, LOSSLESS_DB);
    }
}

#[test]
fn parts_of_several_files_are_the_same_scene() {
    let paint = |color: [f32; 3]| Material { roughness: 0.6, specular: 1.0, ..matt(color) };
    let single = |primitive: Primitive, color: [f32; 3]| {
        let mut glb = GlbBuilder::new();
        let material = glb.material(&paint(color));
        let mesh = glb.mesh("Mesh", &Mesh { primitives: vec![Primitive { material, ..primitive }] });
        glb.node("Mesh", None, Transform::default(), Some(mesh));
        glb.to_glb()
    };
    let (grey, red) = ([0.5, 0.5, 0.5], [0.8, 0.1, 0.1]);
    let files = [("floor.glb", single(floor(0), grey)), ("ball.glb", single(ball(0), red))];
    let settings = "[[scene.part]]\ngltf = \"floor.glb\"\n\
        [[scene.part]]\ngltf = \"ball.glb\"\nname = \"left\"\nscale = 0.3\ntranslate = [-0.5, 0.3, -0.2]\n\
        [[scene.part]]\ngltf = \"ball.glb\"\nname = \"right\"\nscale = 0.25\nrotate_deg = [0, 90, 0]\ntranslate = [0.4, 0.25, 0.3]\n";
    let mut glb = GlbBuilder::new();
    let paints = [glb.material(&paint(grey)), glb.material(&paint(red))];
    let floor = glb.mesh("Floor", &Mesh { primitives: vec![Primitive { material: paints[0], ..floor(0) }] });
    let ball = glb.mesh("Ball", &Mesh { primitives: vec![Primitive { material: paints[1], ..ball(0) }] });
    glb.node("Floor", None, Transform::default(), Some(floor));
    glb.node("Left", None, Transform { scale: [0.3; 3], ..Transform::translation([-0.5, 0.3, -0.2]) }, Some(ball));
    glb.node("Right", None, Transform { scale: [0.25; 3], ..Transform::turned([0.4, 0.25, 0.3], 90.0) }, Some(ball));
    let files: Vec<(&str, &[u8])> = files.iter().map(|(name, bytes)| (*name, &bytes[..])).collect();
    alike("parts", &picture_of(&files, settings), &picture(&glb.to_glb(), ""), LOSSLESS_DB);
}

/// The textured floor under one sampler.
fn tiled(image: &[u8], repeats: f32, wrap: Wrap, nearest: bool) -> Vec<u8> {
    let mut glb = GlbBuilder::new();
    let texture = glb.image("image", image);
    let wrapped = TextureRef { texture, uv_set: 0, wrap: [wrap; 2], nearest, transform: None };
    let tiles = glb.material(&Material { base_color_texture: Some(wrapped), metallic: 0.0, roughness: 0.9, ..Material::default() });
    let mut floor = floor(tiles);
    floor.uvs[0].iter_mut().flatten().flatten().for_each(|x| *x *= repeats);
    let floor = glb.mesh("Floor", &Mesh { primitives: vec![floor] });
    glb.node("Floor", None, Transform::default(), Some(floor));
    glb.to_glb()
}

#[test]
fn wraps_filters_and_profiles_are_the_same_scene() {
    let color = |x: u32, y: u32| image::Rgb([200 - 20 * x as u8, 60 + 15 * y as u8, if x + y > 6 { 200 } else { 40 }]);
    let of = |side: u32, at: &dyn Fn(u32) -> u32| RgbImage::from_fn(side, side, |x, y| color(at(x), at(y)));
    let png = |image: &RgbImage| encode(DynamicImage::ImageRgb8(image.clone()), ImageFormat::Png);
    let tile = of(8, &|x| x);
    let mirrored = png(&of(16, &|x| x.min(15 - x)));
    let repeated = png(&of(16, &|x| x % 8));
    let truth = picture(&tiled(&mirrored, 1.0, Wrap::Clamp, false), "");
    alike("mirrored", &picture(&tiled(&png(&tile), 2.0, Wrap::Mirror, false), ""), &truth, LOSSLESS_DB);
    let plain = picture(&tiled(&repeated, 1.0, Wrap::Repeat, false), "");
    let apart = compare(&truth, &plain, &[], None, None).unwrap().frame.psnr_db.unwrap();
    assert!(apart < QUANTISED_DB, "a wrong wrap would go unseen: {apart} dB");
    alike("repeated", &picture(&tiled(&png(&tile), 2.0, Wrap::Repeat, false), ""), &plain, LOSSLESS_DB);
    // A profile that would turn every colour about, were it followed.
    let mut bytes = Vec::new();
    let mut encoder = PngEncoder::new(&mut bytes);
    encoder.set_icc_profile(b"not a profile".to_vec()).unwrap();
    encoder.write_image(tile.as_raw(), 8, 8, ExtendedColorType::Rgb8).unwrap();
    assert!(bytes.windows(4).any(|w| w == b"iCCP"));
    alike("a profile", &picture(&tiled(&bytes, 2.0, Wrap::Repeat, false), ""), &plain, LOSSLESS_DB);
    let plain = picture(&tiled(&png(&of(64, &|x| x / 8)), 1.0, Wrap::Clamp, true), "");
    alike("nearest", &picture(&tiled(&png(&tile), 1.0, Wrap::Clamp, true), ""), &plain, LOSSLESS_DB);
}

#[test]
fn reflectances_coats_and_encodings_said_in_other_ways_look_alike() {
    let pictured = |material: &Material, pixel: [u8; 3], change: &dyn Fn(&mut Value, u32)| {
        let mut glb = GlbBuilder::new();
        let image = RgbImage::from_pixel(2, 2, image::Rgb(pixel));
        let texture = glb.image("constant", &encode(DynamicImage::ImageRgb8(image), ImageFormat::Png));
        let paint = glb.material(material);
        let ball = glb.mesh("Ball", &Mesh { primitives: vec![ball(paint)] });
        glb.node("Ball", None, Transform { scale: [0.6; 3], ..Transform::default() }, Some(ball));
        let mut json = glb.json();
        json["textures"] = json!([{ "source": texture }]);
        change(&mut json["materials"][0], 0);
        picture(&write_glb(&json, glb.binary()), "")
    };
    let white = [255; 3];
    let none: &dyn Fn(&mut Value, u32) = &|_, _| {};
    let paint = Material { base_color: [0.5, 0.4, 0.3, 1.0], metallic: 0.0, roughness: 0.4, ..Material::default() };
    // (1 / 3)² = 0.04 · 25 / 9.
    let glass = pictured(&Material { ior: 2.0, ..paint.clone() }, white, none);
    let factor = 25.0 / 9.0;
    alike("ior", &glass, &pictured(&Material { specular_color: [factor; 3], ..paint.clone() }, white, none), LOSSLESS_DB);

    // A coat over nothing is the gloss of a black dielectric.
    let black = Material { base_color: [0.0, 0.0, 0.0, 1.0], ..paint.clone() };
    let gloss = pictured(&black, white, none);
    let coat = Material { specular: 0.0, clearcoat: 1.0, clearcoat_roughness: 0.4, ..black };
    alike("clear coat", &pictured(&coat, white, none), &gloss, LOSSLESS_DB);

    // A constant texture instead of factors: colours are sRGB, everything else is linear.
    let color = [188u8, 150, 90];
    let [r, g, b] = color.map(linear);
    let truth = pictured(&Material { base_color: [r, g, b, 1.0], ..paint.clone() }, white, none);
    let test = pictured(&Material { base_color: [1.0; 4], ..paint.clone() }, color, &|m, texture| {
        m["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": texture });
    });
    alike("an sRGB colour", &test, &truth, LOSSLESS_DB);
    let rough = |x: u8| f32::from(x) / 255.0;
    let truth = pictured(&Material { roughness: rough(100), metallic: rough(200), ..paint.clone() }, white, none);
    let test = pictured(&Material { roughness: 1.0, metallic: 1.0, ..paint.clone() }, [0, 100, 200], &|m, texture| {
        m["pbrMetallicRoughness"]["metallicRoughnessTexture"] = json!({ "index": texture });
    });
    alike("a linear roughness", &test, &truth, LOSSLESS_DB);

    // Direction and strength from a texture of 8 bits.
    let metal = Material { metallic: 1.0, ..paint };
    let (rotation, strength) = (0.7f32, 0.6f32);
    let truth = pictured(&Material { anisotropy: strength, anisotropy_rotation: rotation, ..metal.clone() }, white, none);
    let byte = |x: f32| (255.0 * x).round() as u8;
    let pixel = [byte(0.5 + 0.5 * rotation.cos()), byte(0.5 + 0.5 * rotation.sin()), byte(strength)];
    let test = pictured(&metal, pixel, &|m, texture| {
        let lobe = json!({ "anisotropyStrength": 1, "anisotropyTexture": { "index": texture } });
        m["extensions"] = json!({ "KHR_materials_anisotropy": lobe });
    });
    alike("anisotropy", &test, &truth, QUANTISED_DB);
}
