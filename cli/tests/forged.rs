//! Packs of few bytes that claim much, and that hold what no bake writes, through every verb that takes one: an error or a result, soon, in
//! little memory, and never a panic.

#[path = "support/command.rs"]
mod command;
#[path = "../../tests/src/forge.rs"]
#[allow(dead_code)]
mod forge;

use command::{prelight, stderr};
use forge::{Forge, set_u32};
use prelight_manifests::ChunkKind;
use prelight_manifests::asset::AssetObject;
use prelight_runtime::asset::mesh::{Mesh, NO_POINT};
use prelight_store::pack::PackBuilder;
use prelight_store::{Chunk, FormChoice};
use std::path::Path;
use std::time::{Duration, Instant};

/// Against hangs; on an idle machine the mark is ten seconds of processor time.
const PATIENCE: Duration = Duration::from_secs(30);
/// What a file's reader may take beyond what any asset takes, and for each byte of the file.
const FREE: f64 = 64.0;
const PER_BYTE: f64 = 64.0 / (1 << 20) as f64;

fn whole() -> Forge {
    Forge::of_pack(include_bytes!("../../tests/compat/asset-2/every-kind.prelight"))
}

/// Every verb on `FILE`; of those that write, all write into the folder.
const VERBS: [&[&str]; 10] = [
    &["render", "FILE", "-e", "sky.hdr", "--size", "16x16", "--samples", "1", "-o", "out.png"],
    &["render", "FILE", "-e", "sky.hdr", "--size", "16x16", "--samples", "1", "--reference", "2", "-o", "out.png"],
    &["inspect", "FILE"],
    &["inspect", "FILE", "--map", "points", "--size", "16x16", "-o", "map.png"],
    &["inspect", "FILE", "--map", "bytes", "--size", "16x16", "-o", "map.png"],
    &["inspect", "FILE", "--map", "error", "-e", "sky.hdr", "--reference", "2", "--size", "16x16", "-o", "map.png"],
    &["diff", "FILE", "whole.prelight"],
    &["unpack", "FILE", "--store", "unpacked", "-o", "unpacked.prelight.json"],
    &["verify", "--store", "unpacked"],
    &["pack", "unpacked.prelight.json", "-o", "again.prelight"],
];

/// MiB that the command says it held.
fn peak(text: &str) -> f64 {
    let said = text.lines().find_map(|line| line.strip_prefix("peak memory: ")).unwrap_or_else(|| panic!("no peak in {text}"));
    let (number, unit) = said.split_once(' ').unwrap_or_else(|| said.split_at(said.find(|c: char| c.is_alphabetic()).unwrap()));
    let number: f64 = number.trim().parse().unwrap();
    match unit.trim() {
        "B" => number / (1 << 20) as f64,
        "KiB" => number / 1024.0,
        "MiB" => number,
        "GiB" => number * 1024.0,
        other => panic!("{other}"),
    }
}

/// Runs all verbs on a file; their exit codes and MiB, in order.
fn run_all(folder: &Path, name: &str, bytes: &[u8], usual: Option<&[(i32, f64)]>) -> Vec<(i32, f64)> {
    let file = format!("{name}.prelight");
    std::fs::write(folder.join(&file), bytes).unwrap();
    let _ = std::fs::remove_dir_all(folder.join("unpacked"));
    let _ = std::fs::remove_file(folder.join("unpacked.prelight.json"));
    let one = |(i, arguments): (usize, &&[&str])| {
        let arguments: Vec<&str> = arguments.iter().map(|argument| if *argument == "FILE" { file.as_str() } else { argument }).collect();
        let start = Instant::now();
        let output = prelight(folder).args(&arguments).arg("-v").output().unwrap();
        let (text, code) = (stderr(&output), output.status.code());
        assert!(start.elapsed() < PATIENCE && !text.contains("panicked"), "{arguments:?}: {text}");
        let code = code.unwrap_or_else(|| panic!("{arguments:?}: {text}"));
        assert!([0, 3, 4, 6, 7, 10].contains(&code), "{arguments:?}: {code}: {text}");
        assert!(code == 0 || code == 4 || text.contains("error: "), "{arguments:?}: {text}");
        let held = peak(&text);
        if let Some((_, usual)) = usual.map(|usual| usual[i]) {
            let allowed = usual + FREE + PER_BYTE * bytes.len() as f64;
            assert!(held <= allowed, "{arguments:?}: {held} MiB of {allowed}: {text}");
        }
        (code, held)
    };
    VERBS.iter().enumerate().map(one).collect()
}

fn copies(object: &AssetObject, n: usize) -> Vec<AssetObject> {
    let named = |i: usize| AssetObject { name: format!("{i}"), ..object.clone() };
    (0..n).map(named).collect()
}

/// The files, by what they claim.
fn hostile() -> Vec<(&'static str, Vec<u8>)> {
    let mut files = Vec::new();
    let mut forge = whole();
    forge.change_first(ChunkKind::Materials, |plain| *plain = format!("[{}{{}}]", "{},".repeat(5_000_000)).into_bytes());
    files.push(("materials", forge.pack(FormChoice::Auto)));

    let text = whole().seal().manifest.to_text();
    let numbers = format!("\"report\": {{ \"n\": [{}0],", "0,".repeat(5_000_000));
    let mut builder = PackBuilder::new();
    builder.add(text.replacen("\"report\": {", &numbers, 1).as_bytes(), FormChoice::Auto);
    files.push(("report", builder.finish()));

    let mut forge = whole();
    forge.change_first(ChunkKind::Texture, |plain| {
        plain.truncate(64);
        set_u32(plain, 8, 1 << 31);
        set_u32(plain, 12, 1 << 31);
    });
    files.push(("texture", forge.pack(FormChoice::Auto)));

    let mut forge = whole();
    let brdf = forge.manifest.content.brdfs[0].clone();
    forge.manifest.content.brdfs.extend(std::iter::repeat_n(brdf, 20_000));
    files.push(("tables", forge.pack(FormChoice::Auto)));

    // Geometry that four thousand objects have in common: cheap to name, dear to trace.
    let mut forge = whole();
    forge.manifest.content.objects = copies(&forge.manifest.content.objects[3].clone(), 4000);
    files.push(("instances", forge.pack(FormChoice::Auto)));

    let mut forge = whole();
    let object = &mut forge.manifest.content.objects[0];
    let (n_points, mesh) = (object.n_points, object.mesh.digest);
    (object.patches, object.n_points) = (Vec::new(), 0);
    forge.change(mesh, |plain| {
        let chunk = Chunk::from_plain(plain);
        let mesh = Mesh::from_chunk(&chunk, n_points).unwrap();
        let (none, material) = (vec![NO_POINT; mesh.position.len()], vec![999; mesh.triangles.len()]);
        *plain = Mesh { point_front: &none, point_back: &none, material: &material, ..mesh }.to_chunk();
    });
    files.push(("nowhere", forge.pack(FormChoice::Auto)));

    let mut forge = whole();
    forge.manifest.content.objects.iter_mut().for_each(|object| object.world_from_local = [1e300; 16]);
    files.push(("transform", forge.pack(FormChoice::Auto)));

    // 20 MiB of zeros under a digest of their own, as chunk after chunk that nothing reads.
    let mut forge = whole();
    for (i, name) in ["a", "b", "c", "d"].iter().enumerate() {
        let plain = forge.manifest.content.names.clone();
        let digest = forge.put(vec![i as u8; 20 << 20]);
        let mut object = forge.manifest.content.objects[0].clone();
        (object.name, object.base.digest, object.base.bytes) = (name.to_string(), digest, 20 << 20);
        forge.manifest.content.objects.push(object);
        drop(plain);
    }
    files.push(("zeros", forge.pack(FormChoice::Auto)));
    files
}

#[test]
fn hostile_packs_end_every_verb_soon_and_in_little_memory() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(
        folder.join("sky.hdr"),
        [&b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n"[..], &[128, 128, 128, 129].repeat(8)].concat(),
    )
    .unwrap();
    let usual = run_all(folder, "whole", &whole().pack(FormChoice::Auto), None);
    assert!(usual.iter().all(|(code, _)| *code == 0), "{usual:?}");
    for (name, bytes) in hostile() {
        let found = run_all(folder, name, &bytes, Some(&usual));
        eprintln!("{name}, {} bytes: {found:?}", bytes.len());
        let opens = matches!(name, "tables" | "instances" | "transform");
        assert!(opens || found[..6].iter().all(|(code, _)| [6, 7].contains(code)), "{name}: {found:?}");
    }
}

/// One triangle of 3·10³⁸ m beside things of a metre.
#[test]
fn an_object_out_of_all_proportion_is_refused_by_name() {
    use prelight_scene::export::{GlbBuilder, Transform};
    let folder = tempfile::tempdir().unwrap();
    let mut glb = GlbBuilder::new();
    let material = glb.material(&Default::default());
    for (name, size) in [("Chair", 1.0f32), ("Table", 2.0), ("Horizon", 3e38)] {
        let positions = vec![[0.0; 3], [0.0, 0.0, size], [size, 0.0, 0.0]];
        let primitive = prelight_scene::Primitive { positions, triangles: vec![[0, 1, 2]], material, ..Default::default() };
        let mesh = glb.mesh(name, &prelight_scene::Mesh { primitives: vec![primitive] });
        glb.node(name, None, Transform::default(), Some(mesh));
    }
    std::fs::write(folder.path().join("scene.glb"), glb.to_glb()).unwrap();
    let verbs: [&[&str]; 4] = [
        &["plan", "scene.glb", "--points", "64"],
        &["check", "scene.glb"],
        &["bake", "scene.glb", "--points", "64", "-o", "out.prelight.json"],
        &["init", "scene.glb", "-o", "scene.toml"],
    ];
    for arguments in verbs {
        let start = Instant::now();
        let output = prelight(folder.path()).args(arguments).output().unwrap();
        let text = stderr(&output);
        assert_eq!(output.status.code(), Some(3), "{arguments:?}: {text}");
        assert!(text.contains("Horizon") && text.contains("help: ") && start.elapsed() < PATIENCE, "{arguments:?}: {text}");
    }
}
