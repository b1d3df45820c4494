use super::*;
use crate::Primitive;
use crate::fixture::{load_bytes, png};
use prelight_runtime::draw::camera::Camera;

fn quad(material: u32) -> Primitive {
    let n = 1.0 / 3.0f32.sqrt();
    Primitive {
        positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.5], [0.0, 1.0, -0.1]],
        normals: Some(vec![[0.0, 0.0, 1.0], [n, n, n], [0.0, 1.0, 0.0], [0.0; 3]]),
        tangents: Some(vec![[1.0, 0.0, 0.0, -1.0]; 4]),
        uvs: [Some(vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.5], [0.0, 1.0]]), Some(vec![[0.25; 2]; 4])],
        colors: Some(vec![[1.0, 0.5, 0.25, 0.125]; 4]),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        material,
    }
}

#[test]
fn what_is_written_is_what_is_read() {
    let mut glb = GlbBuilder::new();
    let colour = glb.image("colour", &png(5, 3));
    let bumps = glb.image("bumps", &png(2, 2));
    let reference = |texture, uv_set| TextureRef { texture, uv_set, wrap: [Wrap::Clamp, Wrap::Mirror], nearest: true, transform: None };
    let full = Material {
        name: "Everything".into(),
        base_color: [0.25, 0.5, 0.75, 0.875],
        base_color_texture: Some(reference(colour, 0)),
        metallic: 0.125,
        roughness: 0.625,
        metallic_roughness_texture: Some(reference(bumps, 1)),
        emissive: [4.0, 2.0, 0.0],
        emissive_texture: Some(reference(colour, 0)),
        normal_texture: Some(reference(bumps, 1)),
        normal_scale: 0.5,
        ior: 1.25,
        specular: 0.5,
        specular_texture: Some(reference(bumps, 1)),
        specular_color: [2.0, 0.5, 0.25],
        specular_color_texture: Some(reference(colour, 0)),
        anisotropy: 0.75,
        anisotropy_rotation: 0.5,
        anisotropy_texture: Some(reference(bumps, 1)),
        clearcoat: 0.25,
        clearcoat_texture: Some(reference(bumps, 1)),
        clearcoat_roughness: 0.125,
        clearcoat_roughness_texture: Some(reference(bumps, 1)),
        clearcoat_normal_texture: Some(reference(bumps, 1)),
        clearcoat_normal_scale: 0.25,
        unlit: false,
        model: prelight_runtime::surface::Model::Gltf,
        alpha_mode: AlphaMode::Mask { cutoff: 0.75 },
        double_sided: true,
        occludes: None,
        blocks_from: None,
    };
    let glass = Material { name: "Glass".into(), alpha_mode: AlphaMode::Blend, base_color: [1.0, 1.0, 1.0, 0.25], ..Material::default() };
    let materials = [glb.material(&full), glb.material(&glass)];
    let mesh = Mesh { primitives: vec![quad(materials[0]), Primitive { normals: None, tangents: None, ..quad(materials[1]) }] };
    let index = glb.mesh("Quad", &mesh);
    let root = glb.node("root", None, Transform::turned([1.0, 2.0, 3.0], 90.0), None);
    glb.node("Sofa", Some(root), Transform::default(), Some(index));
    glb.node("Sofa", Some(root), Transform { scale: [-2.0, 1.0, 1.0], ..Transform::default() }, Some(index));
    glb.node("", Some(root), Transform::translation([0.5, 0.0, 0.0]), Some(index));
    let camera = Camera { eye: [1.0, 2.0, 3.0], look_at: [0.0, 2.0, 2.0], up: [0.0, 1.0, 0.0], fov_y_deg: 45.0 };
    glb.camera(&SceneCamera { name: "Door".into(), camera });
    glb.scene_extras(json!({ "bake": 7 }));

    let scene = load_bytes(&glb.to_glb()).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(scene.objects.iter().map(|o| o.name.as_str()).collect::<Vec<_>>(), ["root/Sofa", "root/Sofa#2", "root/node_3"]);
    assert!(std::sync::Arc::ptr_eq(&scene.objects[0].mesh, &scene.objects[2].mesh), "instances share their mesh");
    for (written, read) in mesh.primitives.iter().zip(&scene.objects[0].mesh.primitives) {
        assert_eq!(written.positions, read.positions);
        assert_eq!(written.normals, read.normals);
        assert_eq!(written.tangents, read.tangents);
        assert_eq!(written.uvs, read.uvs);
        assert_eq!(written.colors, read.colors);
        assert_eq!(written.triangles, read.triangles);
        assert_eq!(written.material, read.material);
    }
    // Textures are numbered by first use: colour as sRGB, bumps as linear; the same image in the same encoding is one texture.
    let read = &scene.materials[0];
    assert_eq!((read.base_color_texture, read.normal_texture), (Some(reference(0, 0)), Some(reference(1, 1))));
    assert_eq!(*read, full);
    assert_eq!(scene.materials[1], glass);
    assert_eq!(scene.textures.iter().map(|t| (t.width, t.height)).collect::<Vec<_>>(), [(5, 3), (2, 2)]);
    assert_eq!(scene.textures[0].texels[4 * (5 + 2)..][..4], [32, 16, 7, 253], "rows from the top");
    // 90 degrees about +Y takes +X to −Z.
    let m = scene.objects[0].world_from_local;
    let expected = [0.0, 0.0, -1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 1.0];
    assert!(m.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-7), "{m:?}");
    let found = scene.cameras[0].camera;
    assert_eq!((scene.cameras[0].name.as_str(), found.eye), ("Door", camera.eye));
    assert!((found.fov_y_deg - 45.0).abs() < 1e-4);
    let axis: Vec<f32> = (0..3).map(|i| found.look_at[i] - found.eye[i]).collect();
    assert!((axis[0] - axis[2]).abs() < 1e-5 && axis[0] < 0.0 && axis[1].abs() < 1e-6, "{axis:?}");
    assert_eq!(scene.extras, json!({ "scene": { "bake": 7 } }));
    assert_eq!(
        scene.warnings,
        ["emission lights the scene by bounces alone: small bright surfaces leave noise (1, first: materials[0] \"Everything\")"]
    );
}
