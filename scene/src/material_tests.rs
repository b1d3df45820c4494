//! What files say about materials arrives as the record says it.

use super::export::{GlbBuilder, Transform};
use super::fixture::{encode, load_bytes, load_json, png, small, triangle};
use super::gltf::{LoadLimits, load_variant};
use super::{Mesh, Primitive, Scene};
use image::{DynamicImage, ImageFormat, RgbaImage};
use prelight_runtime::surface::{Material, TextureEncoding, Wrap};
use serde_json::{Value, json};

fn with_material(extensions: Value) -> Scene {
    let glb = small();
    let mut json = glb.json();
    json["materials"][0]["extensions"] = extensions;
    load_json(&json, glb.binary()).unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn extensions_of_materials_are_kept_as_the_file_gives_them() {
    let texture = |scale: f64| json!({ "index": 0, "scale": scale });
    let scene = with_material(json!({
        "KHR_materials_ior": { "ior": 1.25 },
        "KHR_materials_specular": { "specularFactor": 0.5, "specularColorFactor": [2.0, 0.5, 0.25], "specularTexture": texture(1.0),
            "specularColorTexture": texture(1.0) },
        "KHR_materials_anisotropy": { "anisotropyStrength": 0.75, "anisotropyRotation": 0.5, "anisotropyTexture": texture(1.0) },
        "KHR_materials_clearcoat": { "clearcoatFactor": 0.25, "clearcoatRoughnessFactor": 0.125, "clearcoatTexture": texture(1.0),
            "clearcoatRoughnessTexture": texture(1.0), "clearcoatNormalTexture": texture(0.25) },
        "KHR_materials_emissive_strength": { "emissiveStrength": 3 },
    }));
    let m = &scene.materials[0];
    assert_eq!((m.ior, m.specular, m.specular_color), (1.25, 0.5, [2.0, 0.5, 0.25]));
    assert_eq!((m.anisotropy, m.anisotropy_rotation), (0.75, 0.5));
    assert_eq!((m.clearcoat, m.clearcoat_roughness, m.clearcoat_normal_scale), (0.25, 0.125, 0.25));
    assert_eq!(m.textures().count(), 1 + 2 + 1 + 3);
    let encoding = |reference: Option<prelight_runtime::surface::TextureRef>| scene.textures[reference.unwrap().texture as usize].encoding;
    assert_eq!(encoding(m.specular_color_texture), TextureEncoding::Srgb);
    for linear in [m.specular_texture, m.anisotropy_texture, m.clearcoat_texture, m.clearcoat_roughness_texture, m.clearcoat_normal_texture]
    {
        assert_eq!(encoding(linear), TextureEncoding::Linear);
    }
    let primitive = &scene.objects[0].mesh.primitives[0];
    assert!(primitive.tangents.is_some(), "anisotropy needs a direction");
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
}

#[test]
fn a_material_without_extensions_is_the_plain_one() {
    let scene = with_material(json!({}));
    let plain = Material { name: "Paint".into(), base_color_texture: scene.materials[0].base_color_texture, ..Material::default() };
    assert_eq!(scene.materials[0], plain);
    assert_eq!((plain.ior, plain.specular, plain.specular_color), (1.5, 1.0, [1.0; 3]));
}

#[test]
fn factors_out_of_range_are_clamped_with_a_warning() {
    let scene = with_material(json!({
        "KHR_materials_ior": { "ior": 0.5 },
        "KHR_materials_specular": { "specularFactor": 3, "specularColorFactor": [-1, 9, 0] },
        "KHR_materials_anisotropy": { "anisotropyStrength": 2 },
        "KHR_materials_clearcoat": { "clearcoatFactor": -1, "clearcoatRoughnessFactor": 7 },
    }));
    let m = &scene.materials[0];
    assert_eq!((m.ior, m.specular, m.specular_color, m.anisotropy), (1.0, 1.0, [0.0, 9.0, 0.0], 1.0));
    assert_eq!((m.clearcoat, m.clearcoat_roughness), (0.0, 1.0));
    assert!(scene.warnings.iter().any(|w| w.contains("clamped (1, first: materials[0] \"Paint\")")), "{:?}", scene.warnings);
}

#[test]
fn anisotropy_without_any_direction_is_left_out_and_named() {
    let glb = small();
    let mut json = glb.json();
    json["materials"][0] = json!({ "name": "Brushed", "extensions": { "KHR_materials_anisotropy": { "anisotropyStrength": 1 } } });
    json["meshes"][0]["primitives"][0]["attributes"].as_object_mut().unwrap().remove("TEXCOORD_0");
    let scene = load_json(&json, glb.binary()).unwrap();
    let primitive = &scene.objects[0].mesh.primitives[0];
    assert_eq!(scene.materials[primitive.material as usize].anisotropy, 0.0);
    assert_eq!(scene.materials[0].anisotropy, 1.0, "other surfaces keep it");
    assert!(scene.warnings.iter().any(|w| w.contains("anisotropy without tangents")), "{:?}", scene.warnings);
}

#[test]
fn unlit_materials_keep_their_base_colour_only() {
    let glb = small();
    let mut json = glb.json();
    json["materials"][0]["extensions"] = json!({ "KHR_materials_unlit": {} });
    json["materials"][0]["normalTexture"] = json!({ "index": 0 });
    let scene = load_json(&json, glb.binary()).unwrap();
    let m = &scene.materials[0];
    assert!(m.unlit && m.base_color_texture.is_some() && m.normal_texture.is_none());
}

/// One RGBA texel of every (specular, glossiness), and what the older model says about it.
#[test]
fn specular_glossiness_becomes_reflectance_and_roughness() {
    let mut glb = GlbBuilder::new();
    let image = RgbaImage::from_fn(4, 1, |x, _| image::Rgba([10, 100, 250, (85 * x) as u8]));
    let image = glb.image("gloss", &encode(DynamicImage::ImageRgba8(image), ImageFormat::Png));
    let reference =
        prelight_runtime::surface::TextureRef { texture: image, uv_set: 0, wrap: [Wrap::Clamp; 2], nearest: true, transform: None };
    let paint = glb.material(&Material { base_color_texture: Some(reference), ..Material::default() });
    let mesh = glb.mesh("Sail", &Mesh { primitives: vec![Primitive { material: paint, ..triangle() }] });
    glb.node("Boat", None, Transform::default(), Some(mesh));
    for (with_texture, glossiness) in [(true, 1.0), (true, 0.4), (false, 0.4)] {
        let mut json = glb.json();
        let mut old =
            json!({ "diffuseFactor": [0.5, 0.25, 0.125, 0.75], "specularFactor": [0.5, 0.6, 0.7], "glossinessFactor": glossiness });
        if with_texture {
            old["specularGlossinessTexture"] = json!({ "index": 0 });
            old["diffuseTexture"] = json!({ "index": 0 });
        }
        json["materials"][0]["extensions"] = json!({ "KHR_materials_pbrSpecularGlossiness": old });
        json["extensionsRequired"] = json!(["KHR_materials_pbrSpecularGlossiness"]);
        let scene = load_json(&json, glb.binary()).unwrap();
        let m = &scene.materials[0];
        assert_eq!((m.base_color, m.metallic, m.ior), ([0.5, 0.25, 0.125, 0.75], 0.0, 0.0));
        assert_eq!(m.specular_color, [0.5, 0.6, 0.7]);
        if !with_texture {
            assert!(m.textures().next().is_none() && (m.roughness - 0.6).abs() < 1e-6);
            continue;
        }
        let sample = |reference: Option<prelight_runtime::surface::TextureRef>, u: f32| {
            let reference = reference.unwrap();
            scene.textures[reference.texture as usize].sample(&reference, [u, 0.5])
        };
        for x in 0..4 {
            let u = (x as f32 + 0.5) / 4.0;
            let expected = 1.0 - glossiness as f32 * (85 * x) as f32 / 255.0;
            // Half a step of 8 bits.
            assert!((sample(m.metallic_roughness_texture, u)[1] * m.roughness - expected).abs() < 0.5001 / 255.0, "{glossiness} {x}");
            assert_eq!(sample(m.specular_color_texture, u)[..3], sample(m.base_color_texture, u)[..3]);
        }
    }
}

#[test]
fn a_variant_replaces_the_materials_that_it_names() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("boat.glb");
    let mut glb = GlbBuilder::new();
    let paints: Vec<u32> =
        ["Red", "Blue"].iter().map(|name| glb.material(&Material { name: name.to_string(), ..Material::default() })).collect();
    let primitives = vec![Primitive { material: paints[0], ..triangle() }; 2];
    let mesh = glb.mesh("Sail", &Mesh { primitives });
    glb.node("Boat", None, Transform::default(), Some(mesh));
    let mut json = glb.json();
    json["extensions"] = json!({ "KHR_materials_variants": { "variants": [{ "name": "Day" }, { "name": "Night" }] } });
    json["extensionsUsed"] = json!(["KHR_materials_variants"]);
    let mappings = json!([{ "material": 0, "variants": [0] }, { "material": 1, "variants": [1] }]);
    json["meshes"][0]["primitives"][1]["extensions"] = json!({ "KHR_materials_variants": { "mappings": mappings } });
    std::fs::write(&path, super::export::write_glb(&json, glb.binary())).unwrap();
    let names = |variant: Option<&str>| {
        let scene = load_variant(&path, &LoadLimits::default(), variant).unwrap_or_else(|e| panic!("{e}"));
        scene.objects[0].mesh.primitives.iter().map(|p| scene.materials[p.material as usize].name.clone()).collect::<Vec<_>>()
    };
    assert_eq!(names(None), ["Red", "Red"]);
    assert_eq!(names(Some("Day")), ["Red", "Red"]);
    assert_eq!(names(Some("Night")), ["Red", "Blue"]);
    let error = load_variant(&path, &LoadLimits::default(), Some("Dusk")).unwrap_err().to_string();
    assert!(error.contains("\"Dusk\"") && error.contains("it has \"Day\", \"Night\""), "{error}");
}

#[test]
fn webp_textures_are_read_and_win_over_their_fallback() {
    let colours = RgbaImage::from_fn(7, 5, |x, y| image::Rgba([(30 * x) as u8, (40 * y) as u8, 9, 255 - (x * y) as u8]));
    let webp = encode(DynamicImage::ImageRgba8(colours.clone()), ImageFormat::WebP);
    let glb = small();
    let mut json = glb.json();
    let mut binary = glb.binary().to_vec();
    let view = json["bufferViews"].as_array().unwrap().len();
    json["bufferViews"].as_array_mut().unwrap().push(json!({ "buffer": 0, "byteOffset": binary.len(), "byteLength": webp.len() }));
    binary.extend_from_slice(&webp);
    json["buffers"][0]["byteLength"] = json!(binary.len());
    json["images"].as_array_mut().unwrap().push(json!({ "bufferView": view, "mimeType": "image/webp" }));
    for fallback in [true, false] {
        json["textures"][0]["extensions"] = json!({ "EXT_texture_webp": { "source": 1 } });
        if !fallback {
            json["textures"][0].as_object_mut().unwrap().remove("source");
            json["extensionsRequired"] = json!(["EXT_texture_webp"]);
        }
        let scene = load_json(&json, &binary).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((scene.textures[0].width, scene.textures[0].height), (7, 5));
        assert_eq!(scene.textures[0].texels.as_ref(), colours.as_raw().as_slice(), "lossless");
    }
}

#[test]
fn textures_that_only_other_readers_have_are_named_with_a_way_out() {
    for (name, way_out) in [("KHR_texture_basisu", "ktxdecompress"), ("EXT_texture_avif", "PNG or JPEG"), ("MSFT_texture_dds", "PNG")] {
        let glb = small();
        let mut json = glb.json();
        json["textures"][0] = json!({ "name": "floor", "extensions": { name: { "source": 0 } } });
        let error = load_json(&json, glb.binary()).unwrap_err();
        assert_eq!(error.exit_code(), 3);
        let text = error.to_string();
        assert!(text.contains(name) && text.contains("textures[0] \"floor\"") && text.contains(way_out), "{text}");
    }
}

/// A PNG with an iCCP chunk, a gAMA chunk and 16 bits a channel: the numbers stay as they are, the encoding comes from the use.
#[test]
fn colour_profiles_in_images_are_ignored() {
    let plain = png(4, 4);
    let with_chunk = |kind: &[u8; 4], data: &[u8]| {
        let mut crc = u32::MAX;
        for byte in kind.iter().chain(data) {
            crc ^= u32::from(*byte);
            for _ in 0..8 {
                crc = if crc & 1 == 1 { (crc >> 1) ^ 0xEDB8_8320 } else { crc >> 1 };
            }
        }
        // Behind the header, 8 + 25 bytes in.
        let length = (data.len() as u32).to_be_bytes();
        [&plain[..33], &length, kind, data, &(!crc).to_be_bytes(), &plain[33..]].concat()
    };
    // A stored deflate block of 4 bytes stands for the profile.
    let profile = b"odd\0\0\x78\x01\x01\x04\x00\xfb\xffoops\x04\x7f\x01\xc2";
    let images = [plain.clone(), with_chunk(b"gAMA", &22727u32.to_be_bytes()), with_chunk(b"iCCP", profile)];
    let texels: Vec<Vec<u8>> = images
        .iter()
        .map(|image| {
            let mut glb = small();
            let texture = glb.image("dots", image);
            let mut json = glb.json();
            json["textures"][0]["source"] = json!(texture);
            load_json(&json, glb.binary()).unwrap_or_else(|e| panic!("{e}")).textures[0].texels.to_vec()
        })
        .collect();
    assert_eq!(texels[0], texels[1]);
    assert_eq!(texels[0], texels[2]);
}

#[test]
fn samplers_wrap_and_filter_as_they_say() {
    let modes = [(10497, Wrap::Repeat), (33071, Wrap::Clamp), (33648, Wrap::Mirror)];
    for (s, wrap_s) in modes {
        for (t, wrap_t) in modes {
            for (filter, nearest) in [(Some(9728), true), (Some(9729), false), (None, false)] {
                let glb = small();
                let mut json = glb.json();
                json["samplers"][0] = json!({ "wrapS": s, "wrapT": t });
                if let Some(filter) = filter {
                    json["samplers"][0]["magFilter"] = json!(filter);
                }
                let reference = load_json(&json, glb.binary()).unwrap().materials[0].base_color_texture.unwrap();
                assert_eq!((reference.wrap, reference.nearest), ([wrap_s, wrap_t], nearest));
            }
        }
    }
    let glb = small();
    let mut json = glb.json();
    json["textures"][0].as_object_mut().unwrap().remove("sampler");
    let reference = load_json(&json, glb.binary()).unwrap().materials[0].base_color_texture.unwrap();
    assert_eq!((reference.wrap, reference.nearest), ([Wrap::Repeat; 2], false));
    // A whole file, so that the builder's own way is covered too.
    load_bytes(&glb.to_glb()).unwrap();
}
