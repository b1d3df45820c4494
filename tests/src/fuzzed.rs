//! What the fuzz targets do with their bytes, as plain functions: `fuzz/` drives them with a fuzzer, `tests/fuzz_corpus.rs` replays the corpora.
//!
//! Each may return whatever it likes and must not panic, hang, or ask for memory that the bytes do not pay for. Formats with a check of
//! their own are tried twice: as they come, and with the check made right, which is what a hostile writer would do.

use crate::recipe::cook;
use prelight_bake::progress::Silent;
use prelight_bake::reference::{ReferenceOptions, render_reference};
use prelight_bake::trace::{OccluderOptions, Occluders};
use prelight_manifests::{AssetManifest, ChunkKind, Descriptor, Dtype, SceneManifest};
use prelight_runtime::asset::{base, mesh::Mesh, points::Points, surface::PointSurfaces};
use prelight_runtime::block_product::visibility::{Visibility, open_words};
use prelight_runtime::brdf::Measured;
use prelight_runtime::environment::{Environment, LightCubemap, Limits};
use prelight_runtime::relight::Relighter;
use prelight_runtime::sphere::icosahedron::{Icosahedron, MAX_LEVEL};
use prelight_runtime::surface::{Texture, TextureRef, Wrap};
use prelight_runtime::vmf_transfer::Transfer;
use prelight_runtime::{Camera, FrameOptions, Style};
use prelight_scene::chunks::scene_from_asset;
use prelight_scene::world::World;
use prelight_store::header::{CHUNK_HEADER_BYTES, ChunkHeader};
use prelight_store::{CheckOptions, Chunk, ChunkSource, MemorySource, Store, digest_of, ledger, pack};
use std::sync::{Arc, OnceLock};

/// A target by its name.
pub type Target = (&'static str, fn(&[u8]));

/// All targets; each has a folder of this name in `fuzz/corpus`.
pub const TARGETS: [Target; 14] = [
    ("header", header),
    ("pack", pack),
    ("segment", segment),
    ("manifest", manifest),
    ("gltf", gltf),
    ("visibility", visibility),
    ("chunk", chunk),
    ("environment", environment),
    ("scene", scene),
    ("transfer", transfer),
    ("texture", texture),
    ("brdf", brdf),
    ("state", state),
    ("asset", asset),
];

/// Bytes that any target may ask for.
const MEMORY: u64 = 64 << 20;

/// The 128 bytes before a chunk.
pub fn header(bytes: &[u8]) {
    let _ = ChunkHeader::decode(bytes);
    let Some(fixed) = bytes.get(..CHUNK_HEADER_BYTES) else { return };
    let mut fixed = fixed.to_vec();
    let check = digest_of(&fixed[..96]);
    fixed[96..].copy_from_slice(&check.0);
    if let Ok(header) = ChunkHeader::decode(&fixed) {
        assert_eq!(header.encode()[..], fixed[..], "what is read is written back the same");
    }
}

/// A pack: index and foot, scan, and every chunk read.
pub fn pack(bytes: &[u8]) {
    read_pack(bytes);
    // The index's own check, made right where the foot is whole enough to say where the index begins.
    let Some(foot) = bytes.len().checked_sub(pack::PACK_LINE_BYTES) else { return };
    let start = u64::from_le_bytes(bytes[foot + 16..foot + 24].try_into().expect("eight bytes"));
    let Some(start) = usize::try_from(start).ok().filter(|start| *start <= foot) else { return };
    let mut fixed = bytes.to_vec();
    let check = digest_of(&fixed[start..foot + 32]);
    fixed[foot + 32..].copy_from_slice(&check.0);
    read_pack(&fixed);
}

fn read_pack(bytes: &[u8]) {
    let scanned = pack::scan(bytes);
    let parsed = pack::parse(bytes).unwrap_or_default();
    for entry in scanned.iter().chain(&parsed) {
        assert!(entry.range().end <= bytes.len() as u64, "every entry lies inside");
    }
    let mut source = MemorySource::new();
    if source.add_pack("fuzzed", bytes).is_err() {
        return;
    }
    let _ = source.manifest();
    for entry in parsed.iter().filter(|entry| entry.plain_bytes <= MEMORY) {
        let (kind, dtype) = (ChunkKind::Mesh, Dtype::U8);
        let descriptor = Descriptor { kind, digest: entry.digest, bytes: entry.plain_bytes, dtype, shape: Vec::new() };
        if let Ok(chunk) = source.chunk(&descriptor) {
            assert_eq!(digest_of(&chunk), entry.digest, "no wrong byte comes out");
        }
    }
}

/// A ledger segment and its records.
pub fn segment(bytes: &[u8]) {
    let _ = ledger::read_segment(bytes);
    if bytes.len() >= 64 {
        let mut fixed = bytes.to_vec();
        let check = digest_of(&[&fixed[..32], &fixed[64..]].concat());
        fixed[32..64].copy_from_slice(&check.0);
        let _ = ledger::read_segment(&fixed);
    }
}

/// An asset's manifest.
pub fn manifest(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    if let Ok(asset) = AssetManifest::parse("fuzzed", text) {
        assert_eq!(AssetManifest::parse("fuzzed", &asset.to_text()).ok(), Some(asset));
    }
}

/// A scene.toml, and the patterns in it.
pub fn scene(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let _ = prelight_scene::overrides::check_pattern("fuzzed", text);
    if let Err(error) = SceneManifest::parse("fuzzed", text) {
        assert!(!error.to_string().is_empty(), "what is wrong has words");
    }
}

/// A glTF file: container, JSON, accessors, meshes, materials, textures.
pub fn gltf(bytes: &[u8]) {
    let Ok(folder) = tempfile::tempdir() else { return };
    let name = if bytes.starts_with(b"glTF") { "a.glb" } else { "a.gltf" };
    let path = folder.path().join(name);
    if std::fs::write(&path, bytes).is_ok() {
        let limits = prelight_scene::gltf::LoadLimits { max_bytes: MEMORY };
        let _ = prelight_scene::gltf::load(&path, &limits);
    }
}

/// A visibility chunk, and every point of it walked.
pub fn visibility(bytes: &[u8]) {
    let aligned = Chunk::from_plain(bytes);
    let Ok(visibility) = Visibility::from_chunk(&aligned) else { return };
    let texels = 6 * visibility.face_resolution() * visibility.face_resolution();
    let mut open = vec![0; open_words(visibility.face_resolution())];
    for i in 0..visibility.len() {
        let point = visibility.point(i);
        point.for_each_run(texels, |begin, end| assert!(begin < end && end <= texels, "runs are ordered and inside"));
        point.to_open_bits(visibility.face_resolution(), &mut open);
        point.for_each_fraction(|position, _, _| assert!(position < texels, "texels in part are inside"));
    }
}

/// Chunks of points, surfaces, meshes and base geometry.
pub fn chunk(bytes: &[u8]) {
    let aligned = Chunk::from_plain(bytes);
    let _ = Points::from_chunk(&aligned);
    let _ = PointSurfaces::from_chunk(&aligned);
    let _ = Mesh::from_chunk(&aligned, 1000);
    let _ = base::from_chunk(&aligned);
}

/// Radiance and OpenEXR images.
pub fn environment(bytes: &[u8]) {
    let _ = Environment::decode("fuzzed", bytes, &Limits::new(MEMORY));
}

/// A transfer chunk, and every lobe of it decoded.
pub fn transfer(bytes: &[u8]) {
    static SOLID: OnceLock<Icosahedron> = OnceLock::new();
    let solid = SOLID.get_or_init(|| Icosahedron::new(MAX_LEVEL));
    let aligned = Chunk::from_plain(bytes);
    let Ok(transfer) = Transfer::from_chunk(&aligned, solid) else { return };
    for i in 0..transfer.len() {
        let point = transfer.point(i);
        let places = point.level.map_or(0, |level| solid.stored(level).len());
        for place in 0..places {
            let lobe = point.slice(solid, place, 0).lobe;
            assert!(lobe.weight.iter().chain(&lobe.mu).all(|x| x.is_finite()) && lobe.kappa.is_finite(), "lobes are numbers");
        }
    }
}

/// A texture chunk, and its corners looked up.
pub fn texture(bytes: &[u8]) {
    let aligned = Chunk::from_plain(bytes);
    let Ok(texture) = Texture::from_chunk(&aligned) else { return };
    for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror] {
        let reference = TextureRef { texture: 0, uv_set: 0, wrap: [wrap; 2], nearest: false, transform: None };
        for uv in [[0.0, 0.0], [1.0, 1.0], [-1e18, 1e18], [f32::NAN, f32::INFINITY], [0.999_999_94, -1e-45]] {
            assert!(texture.sample(&reference, uv).iter().all(|x| (0.0..=1.0).contains(x)), "texels are shares");
        }
    }
}

/// Measured surfaces: MERL's files, and chunks of them.
pub fn brdf(bytes: &[u8]) {
    let _ = Measured::from_merl("fuzzed", bytes);
    let aligned = Chunk::from_plain(bytes);
    // Of those that are read the quadrature takes milliseconds each.
    let _ = Measured::from_chunk(&aligned);
}

/// The note of a check that was stopped, in a store of its own.
pub fn state(bytes: &[u8]) {
    static FOLDER: OnceLock<(tempfile::TempDir, Store)> = OnceLock::new();
    let (folder, store) = FOLDER.get_or_init(|| {
        // In memory where that can be had: every run writes and syncs.
        let memory = std::path::Path::new("/dev/shm");
        let folder = if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() }.expect("a temporary folder");
        let store = Store::open_or_create(folder.path()).expect("a fresh folder");
        let mut writer = store.writer();
        writer.put(ChunkKind::Mesh, Dtype::U8, vec![4], b"four").expect("room on the disk");
        writer.commit().expect("room on the disk");
        (folder, store)
    });
    let head = format!("prelight verify 2\nstore {}\nsample 1 0\n", store.id());
    let body = [head.as_bytes(), bytes].concat();
    let note = [&body[..], format!("check {}\n", digest_of(&body)).as_bytes()].concat();
    for text in [&note[..], bytes] {
        if std::fs::write(folder.path().join("verify.state"), text).is_ok() {
            let report = store.check(&CheckOptions { threads: 1, ..CheckOptions::default() }, &|_| true).expect("a store that can be read");
            assert!(report.finished && report.findings.is_empty() && !report.resumed, "a note that was never written is not believed");
        }
    }
}

/// An asset that a recipe makes ([`crate::recipe`]): opened, lit, shaded, drawn and traced.
pub fn asset(bytes: &[u8]) {
    let Ok(asset) = cook(bytes).open() else { return };
    let asset = Arc::new(asset);
    let (width, height) = (8, 4);
    let sky = Environment::new(width, height, (0..32).map(|i| [0.5 + i as f32 * 0.1, 1.0, 2.0]).collect());
    let light = LightCubemap::from_environment(&sky, asset.face_resolution());
    let camera = Camera::upright([0.7, 0.6, 1.2], [0.0, 0.15, 0.0], 40.0).expect("a camera");
    let mut relighter = Relighter::new(asset.clone());
    relighter.set_light(&light).expect("a light of the asset's resolution");
    for camera in asset.cameras().iter().map(|known| known.camera).take(1).chain([camera]) {
        for style in [Style::default(), Style::Clay] {
            let options = FrameOptions::default().samples(4).style(style);
            let Ok(frame) = relighter.frame(&camera, [12, 8], options) else { continue };
            assert!(frame.image.pixels.as_flattened().iter().all(|x| x.is_finite()), "pixels are numbers");
        }
    }
    assert!(relighter.irradiance().as_flattened().as_flattened().iter().all(|x| x.is_finite()), "light is numbers");
    let scene = scene_from_asset(&asset);
    let world = World::build(&scene);
    let occluders = Occluders::build(&world, &scene.textures, OccluderOptions::default());
    let options = ReferenceOptions { width: 6, height: 4, samples_per_pixel: 2, bounces: 1, ..ReferenceOptions::default() };
    if let Ok(traced) = render_reference(&scene, &world, &occluders, &sky, &camera, &options, &Silent) {
        assert!(traced.image.pixels.as_flattened().iter().all(|x| x.is_finite()), "traced pixels are numbers");
    }
}
