//! Nothing that shading reads is copied: not from a program's own bytes, not from a mapped file.
#![allow(unsafe_code)] // a counting global allocator cannot be written without

use prelight_runtime::asset::Asset;
use prelight_store::{AssetPackWriter, ChunkSource, FormChoice, Store};
use prelight_tests::{bake_into, options, still_life};
use std::alloc::{GlobalAlloc, Layout, System};
use std::ops::Range;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

struct Counting;

/// Bytes that were ever asked for, by any thread.
static BYTES: AtomicU64 = AtomicU64::new(0);

// SAFETY: every call is handed to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        BYTES.fetch_add(layout.size() as u64, Ordering::Relaxed);
        // SAFETY: the caller's promise is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise is passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

/// A packed asset of about 2,000 points; what is hot lies raw.
fn packed(path: &Path) {
    let folder = tempfile::tempdir().unwrap();
    let scene = still_life();
    let baked = bake_into(&scene, &options(&scene, 0.05), folder.path());
    let store = Store::open(folder.path()).unwrap();
    let manifest = baked.seal(Default::default(), &store).unwrap();
    let mut writer = AssetPackWriter::create(path, manifest.to_text().as_bytes()).unwrap();
    for descriptor in manifest.content.descriptors() {
        let form = if descriptor.kind.is_hot() { FormChoice::Raw } else { FormChoice::Auto };
        writer.add(&store.chunk(descriptor).unwrap(), form).unwrap();
    }
    writer.finish().unwrap();
}

/// Whether all arrays of all patches lie inside these bytes.
fn lies_in(asset: &Asset, bytes: &Range<*const u8>) -> bool {
    let within = |pointer: *const u8| bytes.contains(&pointer);
    asset.patches().iter().all(|patch| {
        let (points, surfaces, visibility) = (patch.points(), patch.surfaces(), patch.visibility());
        within(points.position.as_ptr().cast())
            && within(points.flags.as_ptr().cast())
            && within(surfaces.roughness.as_ptr().cast())
            && within(visibility.point(0).blocks.as_ptr().cast())
            && within(visibility.point(0).positions.as_ptr())
    }) && (0..asset.objects().len()).all(|object| within(asset.mesh(object).position.as_ptr().cast()))
}

#[test]
fn opening_embedded_or_mapped_bytes_copies_no_array() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("still.prelight");
    packed(&path);
    // As include_bytes! in an `Aligned` gives them: for ever, and on a boundary of 64.
    let file = std::fs::read(&path).unwrap();
    let leaked: &'static mut [u8] = vec![0; file.len() + 64].leak();
    let start = leaked.as_ptr().align_offset(64);
    leaked[start..start + file.len()].copy_from_slice(&file);
    let embedded: &'static [u8] = &leaked[start..start + file.len()];

    let count = |run: &dyn Fn() -> Asset| {
        let before = BYTES.load(Ordering::Relaxed);
        let asset = run();
        (BYTES.load(Ordering::Relaxed) - before, asset)
    };
    let (by_embedding, asset) = count(&|| Asset::open_static("still", embedded).unwrap());
    let resident = asset.resident_bytes();
    assert!(lies_in(&asset, &embedded.as_ptr_range()), "an array was copied out of the program's bytes");
    let (by_mapping, mapped) = count(&|| Asset::open_file(&path, None).unwrap());
    assert!(!lies_in(&mapped, &embedded.as_ptr_range()), "the check can fail");
    assert_eq!(mapped.manifest().asset_digest, asset.manifest().asset_digest);
    let (by_copying, copied) = count(&|| Asset::open_bytes("still", &file).unwrap());
    assert!(by_copying > resident && copied.resident_bytes() == resident, "the counter counts");
    eprintln!("{resident} bytes of arrays; allocated: embedded {by_embedding}, mapped {by_mapping}, copied {by_copying}");
    // The manifest as text and as a tree, tables of entries, decoded base geometry: less than the arrays, and each of them once.
    assert!(by_embedding + resident / 2 < by_copying, "{by_embedding} {by_copying}");
    if cfg!(target_os = "linux") {
        assert!(by_mapping + resident / 2 < by_copying, "{by_mapping} {by_copying}");
    }
}
