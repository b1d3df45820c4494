//! Every way of saying the same scene: each file bakes and renders like the plain one.
//!
//! Lossless ways must reach 40 dB, quantised ones 35 dB. Files in `fixtures` were made from the very scene of [`room`] by the tools that
//! people use; `PRELIGHT_FIXTURES=FOLDER cargo test -p prelight-cli --test formats` writes its source there, `.ci/fixtures` runs the tools.

mod others;
mod room;
mod variations;

use prelight_runtime::draw::image::Image;
use prelight_runtime::draw::metrics::compare;
use prelight_scene::export::write_glb;
use serde_json::{Value, json};
use std::path::Path;
use std::process::{Command, Stdio};

/// The same triangles in another order: f32 rounding only.
const LOSSLESS_DB: f64 = 40.0;
/// Positions of 14 bits, normals of 8.
const QUANTISED_DB: f64 = 35.0;

fn run(folder: &Path, arguments: &[&str]) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_prelight"));
    command.current_dir(folder).args(arguments).stdin(Stdio::null());
    for variable in ["PRELIGHT_JOBS", "PRELIGHT_MEMORY", "PRELIGHT_STORE", "NO_COLOR", "CLICOLOR_FORCE"] {
        command.env_remove(variable);
    }
    let output = command.output().expect("the command starts");
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && !text.contains("panicked"), "{arguments:?}: {text}");
}

/// A sky that is brighter and bluer above, with a warm side.
fn sky() -> Vec<u8> {
    let mut bytes = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 16\n".to_vec();
    for y in 0..8u8 {
        for x in 0..16u8 {
            let side = 8 * x.min(15 - x);
            bytes.extend([40 + side, 60 + 8 * (8 - y), 50 + 20 * (8 - y), 129]);
        }
    }
    bytes
}

/// Bakes and renders a file; `settings` go into the `[scene]` of its scene.toml.
fn picture(bytes: &[u8], settings: &str) -> Image {
    picture_of(&[("a.glb", bytes)], &format!("gltf = \"a.glb\"\n{settings}"))
}

/// Bakes and renders a scene of several files, whose scene.toml has these lines in its `[scene]`.
fn picture_of(files: &[(&str, &[u8])], scene: &str) -> Image {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    files.iter().for_each(|(name, bytes)| std::fs::write(folder.join(name), bytes).unwrap());
    std::fs::write(folder.join("sky.hdr"), sky()).unwrap();
    std::fs::write(folder.join("scene.toml"), format!("format = 1\n[scene]\n{scene}\n")).unwrap();
    run(folder, &["bake", "scene.toml", "-o", "a.prelight.json", "--quality", "draft", "--edge-length", "0.25"]);
    let view = ["--eye", "0.6,1.4,2.2", "--look-at", "0,0.2,0", "--fov", "45"];
    let render = ["render", "a.prelight.json", "-e", "sky.hdr", "--size", "96x72", "--samples", "4", "-o", "a.exr"];
    run(folder, &[&render[..], &view].concat());
    let bytes = std::fs::read(folder.join("a.exr")).unwrap();
    Image::from_bytes(&bytes, "a.exr", 1 << 20).unwrap()
}

/// The test's picture is that of the truth within `least_db`.
fn alike(name: &str, test: &Image, truth: &Image, least_db: f64) {
    // None: equal to the last bit.
    let db = compare(test, truth, &[], None, None).unwrap().frame.psnr_db.unwrap_or(f64::INFINITY);
    println!("{name}: {db:.1} dB");
    assert!(db >= least_db, "{name}: {db:.1} dB, expected at least {least_db}");
}

/// The plain scene's picture, made once for all tests.
fn plain() -> &'static Image {
    static PLAIN: std::sync::OnceLock<Image> = std::sync::OnceLock::new();
    PLAIN.get_or_init(|| picture(&room::room().to_glb(), ""))
}

#[test]
fn the_measure_sees_a_ball_that_moved() {
    let glb = room::room();
    let mut json = glb.json();
    json["nodes"][2]["translation"][0] = json!(-0.45);
    let moved = picture(&write_glb(&json, glb.binary()), "");
    let db = compare(&moved, plain(), &[], None, None).unwrap().frame.psnr_db.unwrap();
    assert!(db < QUANTISED_DB, "{db}");
}

#[test]
fn files_of_gltfpack_and_gltf_transform_look_like_their_source() {
    if let Ok(folder) = std::env::var("PRELIGHT_FIXTURES") {
        std::fs::write(Path::new(&folder).join("source.glb"), room::room().to_glb()).unwrap();
    }
    let fixtures: [(&str, &[u8], &[&str]); 6] = [
        ("gltfpack", include_bytes!("../../../scene/tests/fixtures/quantised.glb"), &["KHR_mesh_quantization"]),
        ("gltfpack -cc", include_bytes!("../../../scene/tests/fixtures/meshopt-ext.glb"), &["EXT_meshopt_compression"]),
        ("gltfpack -cz", include_bytes!("../../../scene/tests/fixtures/meshopt-khr.glb"), &["KHR_meshopt_compression"]),
        ("gltf-transform draco", include_bytes!("../../../scene/tests/fixtures/draco.glb"), &["KHR_draco_mesh_compression"]),
        (
            "gltf-transform draco, sequential",
            include_bytes!("../../../scene/tests/fixtures/draco-sequential.glb"),
            &["KHR_draco_mesh_compression"],
        ),
        (
            "gltf-transform instance, webp",
            include_bytes!("../../../scene/tests/fixtures/instanced.glb"),
            &["EXT_mesh_gpu_instancing", "EXT_texture_webp"],
        ),
    ];
    for (name, bytes, extensions) in fixtures {
        let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let json: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
        for extension in extensions {
            assert!(json["extensionsUsed"].as_array().unwrap().contains(&json!(extension)), "{name} does not use {extension}");
        }
        alike(name, &picture(bytes, ""), plain(), QUANTISED_DB);
    }
}
