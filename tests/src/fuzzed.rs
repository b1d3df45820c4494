//! What the fuzz targets do with their bytes, as plain functions: `fuzz/` drives them with a fuzzer, `tests/fuzz_corpus.rs` replays the corpora.
//!
//! Each may return whatever it likes and must not panic, hang, or ask for memory that the bytes do not pay for. Formats with a check of
//! their own are tried twice: as they come, and with the check made right, which is what a hostile writer would do.

use prelight_manifests::{AssetManifest, ChunkKind, Descriptor, Dtype, SceneManifest};
use prelight_runtime::asset::{base, mesh::Mesh, points::Points, surface::PointSurfaces};
use prelight_runtime::block_product::visibility::{Visibility, open_words};
use prelight_runtime::environment::{Environment, Limits};
use prelight_store::header::{CHUNK_HEADER_BYTES, ChunkHeader};
use prelight_store::{ChunkSource, MemorySource, digest_of, ledger, pack};

/// A target by its name.
pub type Target = (&'static str, fn(&[u8]));

/// All targets; each has a folder of this name in `fuzz/corpus`.
pub const TARGETS: [Target; 8] = [
    ("header", header),
    ("pack", pack),
    ("segment", segment),
    ("manifest", manifest),
    ("gltf", gltf),
    ("visibility", visibility),
    ("chunk", chunk),
    ("environment", environment),
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

/// Asset and scene manifests.
pub fn manifest(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    if let Ok(asset) = AssetManifest::parse("fuzzed", text) {
        assert_eq!(AssetManifest::parse("fuzzed", &asset.to_text()).ok(), Some(asset));
    }
    let _ = SceneManifest::parse("fuzzed", text);
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
    let aligned = prelight_store::Chunk::from_plain(bytes);
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
    let aligned = prelight_store::Chunk::from_plain(bytes);
    let _ = Points::from_chunk(&aligned);
    let _ = PointSurfaces::from_chunk(&aligned);
    let _ = Mesh::from_chunk(&aligned, 1000);
    let _ = base::from_chunk(&aligned);
}

/// Radiance and OpenEXR images.
pub fn environment(bytes: &[u8]) {
    let _ = Environment::decode("fuzzed", bytes, &Limits { max_bytes: MEMORY });
}
