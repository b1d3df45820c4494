//! Broken, malicious and odd files through the built command: what is legal bakes and renders, the rest has its exit code and says what
//! to do. Nothing panics or hangs.

use prelight_runtime::draw::image::Image;
use prelight_runtime::surface::{Material, TextureRef, Wrap};
use prelight_scene::export::{GlbBuilder, Transform, write_glb};
use prelight_scene::{Mesh, Primitive};
use serde_json::{Value, json};
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Against hangs only: all of these take well under a second on an idle machine.
const PATIENCE: Duration = Duration::from_secs(10);

/// Runs to the end, which must come soon and without a panic.
fn run(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_prelight"));
    command.current_dir(folder).args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    for variable in ["PRELIGHT_JOBS", "PRELIGHT_MEMORY", "PRELIGHT_STORE", "NO_COLOR", "CLICOLOR_FORCE"] {
        command.env_remove(variable);
    }
    let mut child = command.spawn().expect("the command starts");
    let start = Instant::now();
    // What it says is far less than a pipe holds.
    while child.try_wait().unwrap().is_none() {
        if start.elapsed() > PATIENCE {
            child.kill().unwrap();
            panic!("{arguments:?} hangs");
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    let output = child.wait_with_output().unwrap();
    assert!(!stderr(&output).contains("panicked"), "{arguments:?}: {}", stderr(&output));
    output
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// The command ends with the code, names the file and says what to do.
fn refused(folder: &Path, arguments: &[&str], code: i32, file: &str) {
    let output = run(folder, arguments);
    let text = stderr(&output);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {text}");
    assert!(text.starts_with("error: ") && text.contains(file) && text.contains("\n  help: "), "{arguments:?}: {text}");
    assert!(text.len() < 2000 && output.stdout.is_empty(), "{arguments:?}: {text}");
}

fn succeeds(folder: &Path, arguments: &[&str]) {
    let output = run(folder, arguments);
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", stderr(&output));
}

/// A unit square facing +Y, centred.
fn square(material: u32) -> Mesh {
    let positions = vec![[-0.5, 0.0, -0.5], [-0.5, 0.0, 0.5], [0.5, 0.0, 0.5], [0.5, 0.0, -0.5]];
    Mesh { primitives: vec![Primitive { positions, triangles: vec![[0, 1, 2], [0, 2, 3]], material, ..Primitive::default() }] }
}

/// A rough red that no grey sky shows.
fn red() -> Material {
    Material { base_color: [0.8, 0.05, 0.05, 1.0], metallic: 0.0, double_sided: true, ..Material::default() }
}

fn small() -> GlbBuilder {
    let mut glb = GlbBuilder::new();
    let paint = glb.material(&red());
    let mesh = glb.mesh("Square", &square(paint));
    let root = glb.node("Root", None, Transform::default(), None);
    glb.node("Plate", Some(root), Transform::default(), Some(mesh));
    glb
}

/// A Radiance image of radiance 1, uncompressed.
fn sky(width: usize, height: usize) -> Vec<u8> {
    let head = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n");
    [head.into_bytes(), [128, 128, 128, 129].repeat(width * height)].concat()
}

/// A PNG that is nothing but a header claiming the size, its checksum right.
fn png_claiming(width: u32, height: u32) -> Vec<u8> {
    let head = [b"IHDR".as_slice(), &width.to_be_bytes(), &height.to_be_bytes(), &[8, 6, 0, 0, 0]].concat();
    let mut crc = u32::MAX;
    for &byte in &head {
        crc ^= u32::from(byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 { (crc >> 1) ^ 0xEDB8_8320 } else { crc >> 1 };
        }
    }
    [b"\x89PNG\r\n\x1a\n\0\0\0\x0D".as_slice(), &head, &(!crc).to_be_bytes(), b"\0\0\0\0IDAT\x35\xAF\x06\x1E"].concat()
}

fn flawed(change: impl FnOnce(&mut Value)) -> Vec<u8> {
    let glb = small();
    let mut json = glb.json();
    change(&mut json);
    write_glb(&json, glb.binary())
}

/// The small scene with four bytes of an accessor's data replaced.
fn with_data(accessor: usize, value: [u8; 4]) -> Vec<u8> {
    let glb = small();
    let (json, mut binary) = (glb.json(), glb.binary().to_vec());
    let view = json["accessors"][accessor]["bufferView"].as_u64().unwrap() as usize;
    let at = json["bufferViews"][view]["byteOffset"].as_u64().unwrap() as usize;
    binary[at..at + 4].copy_from_slice(&value);
    write_glb(&json, &binary)
}

fn with_buffer(uri: &str) -> Vec<u8> {
    let glb = small();
    let mut json = glb.json();
    json["buffers"][0]["uri"] = json!(uri);
    json.to_string().into_bytes()
}

fn with_huge_image() -> Vec<u8> {
    let mut glb = GlbBuilder::new();
    let texture = glb.image("huge", &png_claiming(65535, 65535));
    let reference = TextureRef { texture, uv_set: 0, wrap: [Wrap::Repeat; 2], nearest: false, transform: None };
    let paint = glb.material(&Material { base_color_texture: Some(reference), ..red() });
    let mut mesh = square(paint);
    mesh.primitives[0].uvs[0] = Some(vec![[0.0; 2]; 4]);
    let mesh = glb.mesh("Square", &mesh);
    glb.node("Plate", None, Transform::default(), Some(mesh));
    glb.to_glb()
}

#[test]
fn bad_scenes_are_refused_by_every_verb() {
    let outer = tempfile::tempdir().unwrap();
    let folder = outer.path().join("scene");
    std::fs::create_dir(&folder).unwrap();
    std::fs::write(outer.path().join("secret.bin"), small().binary()).unwrap();
    let whole = small().to_glb();
    let nan = f32::NAN.to_le_bytes();
    // Accessor 0 holds the positions, 1 the vertex indices.
    let cases: Vec<(&str, Vec<u8>, i32)> = vec![
        ("nothing.glb", Vec::new(), 3),
        ("truncated.glb", whole[..whole.len() / 2].to_vec(), 3),
        ("truncated-by-one.glb", whole[..whole.len() - 1].to_vec(), 3),
        ("not-json.gltf", b"v 0 0 0\nf 1 1 1\n".to_vec(), 3),
        ("half-json.gltf", b"{\"asset\": {\"version\": \"2.0\"}, \"nodes\": [".to_vec(), 3),
        ("version-1.glb", flawed(|j| j["asset"]["version"] = json!("1.0")), 3),
        ("vertex-index.glb", with_data(1, u32::MAX.to_le_bytes()), 3),
        ("accessor-count.glb", flawed(|j| j["accessors"][0]["count"] = json!(u32::MAX)), 3),
        ("accessor-offset.glb", flawed(|j| j["accessors"][0]["byteOffset"] = json!(u64::MAX - 3)), 3),
        ("view-length.glb", flawed(|j| j["bufferViews"][0]["byteLength"] = json!(u64::MAX - 3)), 3),
        ("accessor-beyond.glb", flawed(|j| j["meshes"][0]["primitives"][0]["indices"] = json!(99)), 3),
        ("cycle.glb", flawed(|j| j["nodes"][1]["children"] = json!([0])), 3),
        ("own-child.glb", flawed(|j| j["nodes"][1]["children"] = json!([1])), 3),
        ("nan.glb", with_data(0, nan), 3),
        ("missing-buffer.gltf", with_buffer("missing.bin"), 3),
        ("escaping-buffer.gltf", with_buffer("../secret.bin"), 3),
        ("escaping-quietly.gltf", with_buffer("%2e%2e/secret.bin"), 3),
        ("remote-buffer.gltf", with_buffer("https://example.com/a.bin"), 3),
        ("empty.glb", flawed(|j| j["scenes"] = json!([{}])), 3),
        ("only-zero-size.glb", flawed(|j| j["nodes"][0]["scale"] = json!([0, 0, 0])), 3),
        ("huge-image.glb", with_huge_image(), 7),
        (
            "huge-sparse.glb",
            flawed(|j| {
                j["accessors"][0] = json!({ "componentType": 5126, "count": 400_000_000, "type": "VEC3", "min": [0, 0, 0], "max": [0, 0, 0],
                    "sparse": { "count": 1, "indices": { "bufferView": 1, "componentType": 5125 }, "values": { "bufferView": 0 } } });
            }),
            7,
        ),
    ];
    for (file, bytes, code) in &cases {
        std::fs::write(folder.join(file), bytes).unwrap();
        for verb in ["check", "bake"] {
            refused(&folder, &[verb, file, "--memory", "1GiB"], *code, file);
        }
        refused(&folder, &["render", file, "-e", "sky.hdr"], 3, file);
    }
    // On a machine of any size, the claim must not be believed.
    let trusted = run(&folder, &["check", "huge-image.glb", "--memory", "1TiB"]);
    assert!(matches!(trusted.status.code(), Some(3 | 7)), "{}", stderr(&trusted));
    let left: Vec<_> = std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left.len(), cases.len(), "refused before anything is written: {left:?}");
}

#[test]
fn bad_environments_and_assets_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.join(name), bytes).unwrap();
    write("plate.glb", &small().to_glb());
    succeeds(folder, &["bake", "plate.glb", "--points", "200"]);
    let whole = sky(16, 8);
    let exr = Image::black(16, 8).to_exr().unwrap();
    let claim = |text: &str| [b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n".as_slice(), text.as_bytes(), &[128; 64]].concat();
    let cases: [(&str, &[u8], i32); 9] = [
        ("nothing.hdr", b"", 3),
        ("cut.hdr", &whole[..whole.len() / 2], 3),
        ("cut-by-one.hdr", &whole[..whole.len() - 1], 3),
        ("head-only.hdr", &whole[..30], 3),
        ("cut.exr", &exr[..exr.len() / 2], 3),
        ("text.exr", b"hello", 3),
        ("negative.hdr", &claim("-Y -3 +X 4\n"), 3),
        ("no-pixels.hdr", &claim("-Y 0 +X 0\n"), 3),
        ("huge.hdr", &claim("-Y 65535 +X 65535\n"), 7),
    ];
    for (file, bytes, code) in cases {
        write(file, bytes);
        refused(folder, &["render", "plate.prelight.json", "-e", file, "--memory", "1GiB"], code, file);
        write(
            "scene.toml",
            format!("format = 1\nscene.gltf = \"plate.glb\"\n[[environment]]\nname = \"a\"\nimage = \"{file}\"\n").as_bytes(),
        );
        refused(folder, &["check", "--memory", "1GiB"], code, file);
    }
    refused(folder, &["render", "plate.prelight.json", "-e", "missing.hdr"], 3, "missing.hdr");

    write("sky.hdr", &whole);
    let asset = std::fs::read_to_string(folder.join("plate.prelight.json")).unwrap();
    let edited = |change: &dyn Fn(&mut Value)| {
        let mut value: Value = serde_json::from_str(&asset).unwrap();
        change(&mut value);
        value.to_string()
    };
    let assets = [
        ("cut.json", asset[..asset.len() / 2].to_string()),
        ("format.json", edited(&|a| a["format"] = json!(99))),
        ("points.json", edited(&|a| a["content"]["objects"][0]["n_points"] = json!(u32::MAX))),
    ];
    for (file, text) in assets {
        write(file, text.as_bytes());
        refused(folder, &["render", file, "-e", "sky.hdr"], 3, file);
    }
    // Plausible but for the digest of the whole: corrupt.
    write("bytes.json", edited(&|a| a["content"]["objects"][0]["mesh"]["bytes"] = json!(u64::MAX)).as_bytes());
    refused(folder, &["render", "bytes.json", "-e", "sky.hdr"], 6, "bytes.json: its content hashes to");
    assert!(!folder.join("render.png").exists(), "a refused picture was written");
}

/// Bakes and renders; the share of the picture's pixels that show the red paint lit by the sky.
fn lit(folder: &Path, sky: &str, view: &[&str]) -> f64 {
    let arguments = ["render", "scene.prelight.json", "-e", sky, "--size", "64x48", "--samples", "1", "-o", "picture.exr"];
    succeeds(folder, &[&arguments, view].concat());
    let bytes = std::fs::read(folder.join("picture.exr")).unwrap();
    let image = Image::from_bytes(&bytes, "picture.exr", 1 << 20).unwrap();
    assert!(image.pixels.iter().flatten().all(|value| value.is_finite() && *value >= 0.0));
    // Albedo 0.8 under a sky of radiance 1 from all sides: 0.8, a little more or less for the gloss and the texels' edges.
    let lit = image.pixels.iter().filter(|[red, green, _]| (0.5..1.1).contains(red) && *green < 0.5 * red).count();
    lit as f64 / image.pixels.len() as f64
}

fn bake(folder: &Path, glb: &GlbBuilder) {
    std::fs::write(folder.join("scene.glb"), glb.to_glb()).unwrap();
    std::fs::write(folder.join("sky.hdr"), sky(16, 8)).unwrap();
    succeeds(folder, &["check", "scene.glb"]);
    succeeds(folder, &["bake", "scene.glb", "--points", "500"]);
}

const FROM_ABOVE: [&str; 4] = ["--eye", "0.3,1.5,0.5", "--look-at", "0,0,0"];

#[test]
fn a_mesh_of_no_size_beside_others_bakes_and_renders() {
    let folder = tempfile::tempdir().unwrap();
    let mut glb = small();
    let mut speck = square(0);
    speck.primitives[0].positions = vec![[0.25; 3]; 4];
    let speck = glb.mesh("Speck", &speck);
    glb.node("Speck", None, Transform::default(), Some(speck));
    // A plane of no extent, by a scale of zero.
    glb.node("Flat", None, Transform { scale: [0.0, 1.0, 0.0], ..Transform::default() }, Some(0));
    bake(folder.path(), &glb);
    let share = lit(folder.path(), "sky.hdr", &FROM_ABOVE);
    assert!((0.05..0.9).contains(&share), "{share}");
    assert!(lit(folder.path(), "sky.hdr", &[]) > 0.05, "the automatic view shows it");
}

#[test]
fn nodes_400_deep_bake_and_render_where_they_end() {
    let folder = tempfile::tempdir().unwrap();
    let mut glb = GlbBuilder::new();
    let paint = glb.material(&red());
    let mesh = glb.mesh("Square", &square(paint));
    let step = Transform::translation([0.0, 0.0625, 0.0]);
    let mut parent = None;
    for _ in 0..399 {
        parent = Some(glb.node("", parent, step, None));
    }
    glb.node("Deep", parent, step, Some(mesh));
    bake(folder.path(), &glb);
    // 400 steps of 1/16 m: at a height of 25 m.
    let share = lit(folder.path(), "sky.hdr", &["--eye", "0.3,26.5,0.5", "--look-at", "0,25,0"]);
    assert!((0.05..0.9).contains(&share), "{share}");
}

#[test]
fn scales_of_a_ten_thousandth_and_a_hundred_thousand_share_a_scene() {
    let folder = tempfile::tempdir().unwrap();
    let mut glb = GlbBuilder::new();
    let paint = glb.material(&red());
    let mesh = glb.mesh("Square", &square(paint));
    glb.node("Tiny", None, Transform { scale: [1e-4; 3], ..Transform::default() }, Some(mesh));
    // Of three the usual one is the median: neither of the others is too far from it.
    glb.node("Usual", None, Transform::translation([30.0, 0.0, 0.0]), Some(mesh));
    glb.node("Vast", None, Transform { scale: [1e5; 3], ..Transform::translation([0.0, -1e4, 0.0]) }, Some(mesh));
    bake(folder.path(), &glb);
    let tiny = lit(folder.path(), "sky.hdr", &["--eye", "0.00003,0.00015,0.00005", "--look-at", "0,0,0"]);
    let vast = lit(folder.path(), "sky.hdr", &["--eye", "30000,140000,50000", "--look-at", "0,-10000,0"]);
    assert!(tiny > 0.05 && vast > 0.05, "tiny {tiny}, vast {vast}");
    assert!(lit(folder.path(), "sky.hdr", &[]) > 0.02, "the automatic view shows the vast one");
}

#[test]
fn environments_of_odd_sizes_light_alike() {
    let folder = tempfile::tempdir().unwrap();
    bake(folder.path(), &small());
    let usual = lit(folder.path(), "sky.hdr", &FROM_ABOVE);
    for (width, height) in [(7, 5), (1, 1), (3, 1), (2, 9), (1021, 3)] {
        std::fs::write(folder.path().join("odd.hdr"), sky(width, height)).unwrap();
        let share = lit(folder.path(), "odd.hdr", &FROM_ABOVE);
        assert!(share > 0.05 && (share - usual).abs() < 1e-3, "{width} x {height}: {share}, usually {usual}");
    }
}
