use super::*;
use crate::fixture::png;
use crate::gltf::LoadLimits;
use crate::world::World;

const LIMIT: LoadLimits = LoadLimits { max_bytes: 64 << 20 };

/// A folder with `a.obj` and what lies beside it, loaded.
fn load_with(text: &[u8], beside: &[(&str, &[u8])], limits: &LoadLimits) -> Result<Scene, SceneError> {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in beside {
        std::fs::write(folder.path().join(name), bytes).unwrap();
    }
    let path = folder.path().join("a.obj");
    std::fs::write(&path, text).unwrap();
    crate::file::load(&path, None, limits)
}

fn loaded(text: &str) -> Scene {
    load_with(text.as_bytes(), &[], &LIMIT).unwrap_or_else(|error| panic!("{text}: {error}"))
}

const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

#[test]
fn objects_groups_materials_and_corners_are_read() {
    let text = "mtllib a b.mtl\no Left\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0.25\nvt 0 1\nvn 0 0 1\nusemtl Red\nf 1/1/1 2/2/1 3/3/1\n\
        usemtl Blue\nf -3//-1 -2//-1 -1//-1\ng Right\nv 1 1 0 # a comment\nf 2 \\\n 4 3\n";
    let library = "newmtl Red\nKd 0.5 0.25 0\nmap_Kd -s 1 1 1 dots.png\nKs 1 1 1\nnewmtl Blue\nKd 0 0 1\nd 0.25\nKe 2 2 2\n";
    let scene = load_with(text.as_bytes(), &[("a b.mtl", library.as_bytes()), ("dots.png", &png(4, 4))], &LIMIT).unwrap();
    let names: Vec<&str> = scene.objects.iter().map(|object| object.name.as_str()).collect();
    assert_eq!(names, ["Left", "Right"]);
    let [red, blue] = &scene.objects[0].mesh.primitives[..] else { panic!("a change of material is a primitive") };
    let uvs = red.uvs[0].as_ref().unwrap();
    assert_eq!(uvs[1], [1.0, 0.75], "v counts from the bottom");
    assert!(red.normals.is_some() && blue.normals.is_some() && blue.uvs[0].is_none());
    let material = |primitive: &Primitive| &scene.materials[primitive.material as usize];
    let red = material(red);
    assert_eq!((red.name.as_str(), red.base_color, red.metallic, red.roughness), ("Red", [0.5, 0.25, 0.0, 1.0], 0.0, 1.0));
    assert!(red.double_sided && red.base_color_texture.is_some() && scene.textures.len() == 1);
    let blue = material(blue);
    assert_eq!((blue.alpha_mode, blue.base_color[3], blue.emissive), (AlphaMode::Blend, 0.25, [2.0; 3]));
    let triangle = World::build(&scene).positions[2];
    assert_eq!(triangle, [[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]], "a statement over two lines");
    assert!(scene.warnings.iter().any(|warning| warning.starts_with("specular colours are left out")), "{:?}", scene.warnings);
}

#[test]
fn faces_of_any_size_colours_and_w_are_read() {
    let scene = loaded(&format!("{SQUARE}f 1 2 3 4\n"));
    assert_eq!(World::build(&scene).positions.len(), 2);
    let scene = loaded("v 0 0 0 2\nv 2 0 0 2\nv 0 2 0 2\nf 1 2 3\n");
    assert_eq!(World::build(&scene).positions[0][1], [1.0, 0.0, 0.0], "w divides");
    let coloured = loaded("v 0 0 0 1 1 1\nv 1 0 0 0.5 0 1\nv 0 1 0 0 0 0\nf 1 2 3\n");
    let colors = coloured.objects[0].mesh.primitives[0].colors.as_ref().unwrap();
    // sRGB 0.5 is linear 0.214.
    assert!((colors[1][0] - 0.2140).abs() < 1e-3 && colors[0] == [1.0; 4] && colors[2][..3] == [0.0; 3], "{colors:?}");
    let part = loaded("v 0 0 0 1 1 1\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    assert!(part.objects[0].mesh.primitives[0].colors.is_none() && part.warnings[0].contains("colours that some vertices lack"));
}

#[test]
fn what_is_missing_beside_the_geometry_is_a_warning() {
    let text = format!("mtllib none.mtl\n{SQUARE}usemtl Gone\nf 1 2 3\nl 1 2\np 1\n");
    let scene = loaded(&text);
    let has = |words: &str| scene.warnings.iter().any(|warning| warning.contains(words));
    assert!(has("material libraries that cannot be read are left out (1, first: none.mtl") && has("points and lines are not read (2"));
    let library = "newmtl A\nKd 0.5\nmap_Kd C:\\textures\\wood.tga\nmap_Bump b.png\n";
    let scene =
        load_with(format!("mtllib a.mtl\n{SQUARE}usemtl A\nf 1 2 3\n").as_bytes(), &[("a.mtl", library.as_bytes())], &LIMIT).unwrap();
    let material = &scene.materials[scene.objects[0].mesh.primitives[0].material as usize];
    assert_eq!(material.base_color, [0.5, 0.5, 0.5, 1.0], "one number is grey");
    let has = |words: &str| scene.warnings.iter().any(|warning| warning.contains(words));
    assert!(
        has("textures that cannot be read are left out (1, first: newmtl A: C:") && has("textures other than map_Kd"),
        "{:?}",
        scene.warnings
    );
    let mixed = loaded(&format!("vn 0 0 1\n{SQUARE}f 1//1 2 3\n"));
    assert!(mixed.objects[0].mesh.primitives[0].normals.is_none() && mixed.warnings[0].contains("normals that some corners"));
}

#[test]
fn the_same_mesh_has_the_same_triangles_as_in_gltf() {
    let glb = crate::fixture::load_bytes(&crate::fixture::small().to_glb()).unwrap();
    let mut text = String::new();
    for [a, b, c] in &World::build(&glb).positions {
        for [x, y, z] in [a, b, c] {
            text += &format!("v {x} {y} {z}\n");
        }
        text += "f -3 -2 -1\n";
    }
    assert_eq!(World::build(&loaded(&text)).positions, World::build(&glb).positions);
}

/// One flaw each: (text, words of the message).
const HOSTILE: &[(&str, &str)] = &[
    ("", "no vertices and no faces"),
    ("\0\0\0\0", "no vertices and no faces"),
    ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "it has vertices and no faces"),
    ("f 1 2 3\n", "line 1"),
    ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "line 4"),
    ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "names position 0"),
    ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -4 1 2\n", "names position -4"),
    ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9223372036854775807\n", "names position 9223372036854775807"),
    ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -9223372036854775808\n", "names position -9223372036854775808"),
    ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n", "no corner of a face"),
    ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/1 2 3\n", "names texture coordinate 1"),
    ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1//7 2 3\n", "names normal 7"),
    ("v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//6148914691236517206 2 3\n", "names normal 6148914691236517206"),
    ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1///1 2 3\n", "expected v, v/vt"),
    ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf /1 2 3\n", "no corner"),
    ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf one two three\n", "\"one\""),
    ("v 0 0\n", "a position of 2 numbers"),
    ("v\n", "a position of 0 numbers"),
    ("v 0 0 nan\n", "\"nan\" in a position is not a finite number"),
    ("v 0 0 1e99\n", "not a finite number"),
    ("v 0 0 inf\n", "not a finite number"),
    ("v 0 0 0 0\n", "w = 0"),
    ("v 1 2 3 4 5 6 7 8 9 10\n", "a position of 9 numbers"),
    ("v x y z\n", "\"x\""),
    ("vt\n", "without numbers"),
    ("vt nan 0\n", "texture coordinate"),
    ("vn 1 2\n", "a normal of 2 numbers"),
    ("vn 1 2 -inf\n", "normal"),
    ("v 0 0 0\nf 1 1 1\n", "zero area"),
];

#[test]
fn hostile_text_is_refused_with_its_line() {
    for (text, words) in HOSTILE {
        let error = load_with(text.as_bytes(), &[], &LIMIT).expect_err(text).to_string();
        assert!(error.contains(words) && error.contains("a.obj") && error.contains("help: "), "{text:?}: {error}");
        assert!(error.len() < 1000, "{text:?}");
    }
}

#[test]
fn hostile_libraries_neither_panic_nor_hide_the_geometry() {
    let long = format!("newmtl {}\n", "x".repeat(1 << 20));
    let cases: &[&[u8]] = &[
        b"",
        b"Kd 1 1\n",
        b"newmtl\n",
        b"newmtl A\nKd\nKs 1\nKe 1 1\nd\nNs\nNi\nillum\nmap_Kd\nmap_d\nbump\nKa 1\n",
        b"newmtl A\nKd spectral a.rfl\nKd xyz 1 1 1\nKd 1e99 nan -5\nd nan\nTr nan\n",
        b"newmtl A\nmap_Kd ../../../../etc/passwd\n",
        b"newmtl A\nmap_Kd /etc/passwd\n",
        b"newmtl A\nmap_Kd https://example.com/a.png\n",
        b"newmtl A\nmap_Kd a.obj\n",
        b"newmtl A\nmap_Kd -o\n",
        b"newmtl A\nKe -1 -1 -1\nKd 7 7 7\n",
        b"newmtl \xE9t\xE9\nKd 1 1 1\n",
        b"\xFF\xFE\x00\x00",
        long.as_bytes(),
    ];
    let text = format!("mtllib a.mtl\n{SQUARE}usemtl A\nf 1 2 3\n");
    for library in cases {
        let scene = load_with(text.as_bytes(), &[("a.mtl", library)], &LIMIT).unwrap_or_else(|error| panic!("{library:?}: {error}"));
        assert_eq!(scene.objects.len(), 1);
        assert!(scene.materials.iter().all(|material| material.base_color.iter().all(|x| (0.0..=1.0).contains(x))));
    }
    for name in ["../a.mtl", "/dev/zero", ".", "a.obj"] {
        assert_eq!(loaded(&text.replace("a.mtl", name)).objects.len(), 1, "{name}");
    }
}

#[test]
fn no_prefix_and_no_single_change_of_a_file_panics() {
    let text = "mtllib a.mtl\no Left\nv 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 0 1 0 1 0 0\nvt 0 0\nvn 0 0 1\nusemtl Red\nf 1/1/1 2/1/1 3/1/1\nf -3//1 -2//1 -1//1\n";
    let library = "newmtl Red\nKd 0.5 0.25 0\nd 0.5\nKe 1 0 0\nmap_Kd a.png\n";
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.obj");
    let mut n_read = 0;
    let mut tried = |text: &[u8], library: &[u8]| {
        std::fs::write(&path, text).unwrap();
        std::fs::write(folder.path().join("a.mtl"), library).unwrap();
        n_read += usize::from(crate::file::load(&path, None, &LIMIT).is_ok());
    };
    for end in 0..text.len() {
        tried(&text.as_bytes()[..end], library.as_bytes());
    }
    for end in 0..library.len() {
        tried(text.as_bytes(), &library.as_bytes()[..end]);
    }
    for at in 0..text.len() {
        for byte in [b'9', b'-', b'/', b' ', b'\n', 0xFF] {
            let mut changed = text.as_bytes().to_vec();
            changed[at] = byte;
            tried(&changed, library.as_bytes());
        }
    }
    assert!(n_read > 100, "most must be readable: {n_read}");
}

#[test]
fn memory_is_counted_before_it_is_taken() {
    let square = format!("{SQUARE}{}", "f 1 2 3 4\n".repeat(2000));
    let mut max_bytes = 1000;
    let mut refusals = 0;
    while let Err(error) = load_with(square.as_bytes(), &[], &LoadLimits { max_bytes }) {
        let SceneError::Memory { needed, limit, .. } = error else { panic!("{error}") };
        assert!(needed > limit && limit == max_bytes);
        max_bytes = needed;
        refusals += 1;
    }
    assert!((2..40).contains(&refusals), "{refusals}");
    // A quad here holds ten bytes; 300 a corner are allowed for.
    assert!(max_bytes < 16 << 20, "{max_bytes}");
}
