//! Memory that packs of few bytes can make their reader take: counted by the allocator, from opening to a drawn and a decoded picture.
#![allow(unsafe_code)] // a counting global allocator cannot be written without

use prelight_manifests::ChunkKind;
use prelight_manifests::asset::AssetObject;
use prelight_runtime::asset::OpenOptions;
use prelight_runtime::environment::{LightCubemap, sky};
use prelight_runtime::{Asset, Camera, Environment, FrameOptions, Limits, Relighter, RuntimeError};
use prelight_store::FormChoice;
use prelight_store::pack::PackBuilder;
use prelight_tests::forge::Forge;
use prelight_tests::recipe::cook;
use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::time::{Duration, Instant};

struct Counting;

static NOW: AtomicUsize = AtomicUsize::new(0);
static MOST: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call is handed to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let now = NOW.fetch_add(layout.size(), Relaxed) + layout.size();
        MOST.fetch_max(now, Relaxed);
        // SAFETY: the caller's promise is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        NOW.fetch_sub(layout.size(), Relaxed);
        // SAFETY: the caller's promise is passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

/// What a reader may take freely, and for each byte of a file.
const FREE: usize = 64 << 20;
const PER_BYTE: usize = 64;
/// Against hangs; the mark is ten seconds of one processor in a release build.
const PATIENCE: Duration = Duration::from_secs(30);

/// The most that was held while it ran, beyond what was held before.
fn most<T>(run: impl FnOnce() -> T) -> (usize, Duration, T) {
    let (before, start) = (NOW.load(Relaxed), Instant::now());
    MOST.store(before, Relaxed);
    let result = run();
    (MOST.load(Relaxed) - before, start.elapsed(), result)
}

/// What light and picture take of any asset of one point: tables of the light, tiles of the picture.
fn light_and_draw(asset: Asset) -> usize {
    let camera = Camera::upright([0.7, 0.6, 1.2], [0.0, 0.15, 0.0], 40.0).unwrap();
    let light = LightCubemap::from_environment(&sky([0.3, 0.8, 0.2]), asset.face_resolution());
    let mut relighter = Relighter::new(asset);
    relighter.set_light(&light).unwrap();
    let frame = relighter.frame(&camera, [32, 32], FrameOptions::default().samples(1)).unwrap();
    assert!(frame.image.pixels.as_flattened().iter().all(|x| x.is_finite()));
    frame.image.pixels.len()
}

/// Opens a file, and lights and draws what opens; says what became of it.
fn use_pack(name: &str, pack: &[u8], fixed: usize) -> Result<usize, RuntimeError> {
    let (held, time, result) = most(|| Asset::open_bytes(name, pack).map(light_and_draw));
    let said = result.as_ref().map_or_else(|error| error.to_string(), |_| "opens".to_string());
    eprintln!("{name}: {} bytes, {held} held, {:.1} s: {said}", pack.len(), time.as_secs_f64());
    let allowed = FREE + PER_BYTE * pack.len() + fixed;
    assert!(held <= allowed && time < PATIENCE, "{name}: {held} of {allowed}, {time:?}");
    assert!(said.len() < 500, "{name}: {said}");
    result
}

/// A file whose manifest is compressed too.
fn squeezed(forge: &mut Forge, manifest: &str) -> Vec<u8> {
    let mut builder = PackBuilder::new();
    builder.add(manifest.as_bytes(), FormChoice::Auto);
    for digest in forge.all() {
        builder.add(forge.plain(&digest), FormChoice::Auto);
    }
    builder.finish()
}

fn copies(object: &AssetObject, n: usize) -> Vec<AssetObject> {
    let named = |i: usize| AssetObject { name: format!("{i}"), ..object.clone() };
    (0..n).map(named).collect()
}

#[test]
fn few_bytes_take_little_memory_whatever_they_claim() {
    let whole = || cook(&[]);
    let plain = whole().pack(FormChoice::Auto);
    let (fixed, ..) = most(|| light_and_draw(Asset::open_bytes("whole", &plain).unwrap()));
    eprintln!("light and picture: {fixed}");
    assert!(fixed < FREE);
    let refused = |result: Result<usize, RuntimeError>| {
        assert!(matches!(result, Err(RuntimeError::Memory { .. } | RuntimeError::Store(_))), "{result:?}")
    };

    // Materials of two bytes each.
    let mut forge = whole();
    forge.change_first(ChunkKind::Materials, |plain| *plain = format!("[{}{{}}]", "{},".repeat(5_000_000)).into_bytes());
    refused(use_pack("materials", &forge.pack(FormChoice::Auto), fixed));

    // A report of numbers, in a manifest that is compressed.
    let text = whole().seal().manifest.to_text();
    let report = format!("\"report\": {{ \"n\": [{}0],", "0,".repeat(10_000_000));
    let text = text.replacen("\"report\": {", &report, 1);
    refused(use_pack("report", &squeezed(&mut whole(), &text), fixed));

    // One patch again and again: 256 points with their light a line of text.
    let mut forge = whole();
    let patch = forge.manifest.content.objects[0].patches[0].clone();
    forge.manifest.content.objects[0].n_points += 100_000 * patch.n_points;
    forge.manifest.content.objects[0].patches.extend(std::iter::repeat_n(patch, 100_000));
    let text = serde_json::to_string(&serde_json::from_str::<serde_json::Value>(&forge.seal().manifest.to_text()).unwrap()).unwrap();
    assert!(use_pack("patches", &squeezed(&mut forge, &text), fixed).is_err());

    // A measured surface that is named twenty thousand times is made ready once.
    let mut forge = whole();
    let brdf = forge.manifest.content.brdfs[0].clone();
    forge.manifest.content.brdfs.extend(std::iter::repeat_n(brdf, 20_000));
    use_pack("tables", &forge.pack(FormChoice::Auto), fixed).unwrap();

    // Large chunks that many objects name: looked at and drawn each time.
    for kind in [ChunkKind::Base, ChunkKind::Mesh] {
        let mut forge = whole();
        let object = forge.manifest.content.objects[0].clone();
        let digest = if kind == ChunkKind::Base { object.base.digest } else { object.mesh.digest };
        forge.change(digest, |plain| plain.resize(4 << 20, 0));
        let object = forge.manifest.content.objects[0].clone();
        forge.manifest.content.objects = copies(&object, 400);
        assert!(use_pack("instances", &forge.pack(FormChoice::Auto), fixed).is_err());
    }

    // An image of one colour in 137 bytes.
    let mut hdr = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 905969664\n".to_vec();
    hdr.extend([9, 9, 9, 9]);
    [255, 255, 255, 52].iter().for_each(|n| hdr.extend([1, 1, 1, *n]));
    let (held, _, result) = most(|| Environment::decode("line.hdr", &hdr, &Limits::default()).map(|_| ()));
    assert!(result.is_err() && held < FREE, "{held} {result:?}");
}

#[test]
fn one_limit_is_shared_by_assets_and_images() {
    let pack = cook(&[]).pack(FormChoice::Auto);
    let limits = Limits::new(8 << 20);
    let open = || OpenOptions::new().limits(&limits).open_bytes("whole", &pack);
    let asset = open().unwrap();
    let of_asset = limits.budget().used();
    assert!(of_asset > 10_000 && asset.budget().used() == of_asset, "{of_asset}");
    let hdr = [&b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 100 +X 200\n"[..], &[128, 128, 128, 129].repeat(20_000)].concat();
    let (image, _) = Environment::decode("sky.hdr", &hdr, &limits).unwrap();
    let turned = image.clone().with_rotation(90.0);
    assert_eq!(limits.budget().used(), of_asset + 240_000);
    drop(image);
    assert_eq!(limits.budget().used(), of_asset + 240_000, "a copy of it is left");
    drop(turned);
    // Full: whoever comes next is refused, and gets what is given back.
    let filler = limits.budget().charge(limits.budget().left() - 1000).unwrap();
    assert!(matches!(Environment::decode("sky.hdr", &hdr, &limits), Err(RuntimeError::Memory { limit: 1000, .. })));
    assert!(matches!(open().map(|_| ()), Err(RuntimeError::Memory { .. } | RuntimeError::Store(_))));
    drop((filler, asset));
    assert_eq!(limits.budget().used(), 0);
    open().unwrap();
}
