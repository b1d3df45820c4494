//! A frame allocates nothing: light changes, eye moves, points are shaded in buffers that are there.
#![allow(unsafe_code)]

use prelight_runtime::asset::Asset;
use prelight_runtime::environment::{LightCubemap, sky};
use prelight_runtime::relight::Relighter;
use prelight_store::Store;
use prelight_tests::{bake_into, options, still_life};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::Arc;

struct Counting;

thread_local! {
    static COUNT: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: every call is handed to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.with(|count| count.set(count.get() + 1));
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

#[test]
fn a_frame_with_a_new_light_and_a_new_eye_allocates_nothing_on_one_thread() {
    let folder = tempfile::tempdir().unwrap();
    let scene = still_life();
    let baked = bake_into(&scene, &options(&scene, 0.05), folder.path());
    let store = Store::open(folder.path()).unwrap();
    let asset = Arc::new(Asset::open(baked.seal(Default::default(), &store).unwrap(), &store).unwrap());
    let noon = LightCubemap::from_environment(&sky([0.3, 0.8, 0.2]), 64);
    let evening = LightCubemap::from_environment(&sky([0.9, 0.2, 0.2]), 64);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    pool.install(|| {
        let mut relighter = Relighter::new(asset.clone());
        relighter.set_light(&noon).unwrap();
        relighter.shade([1.0, 1.0, 1.0], None).unwrap();
        let before = COUNT.with(Cell::get);
        assert!(before > 0, "the counter counts");
        relighter.set_light(&evening).unwrap();
        let shaded = relighter.shade([1.0, 0.5, -1.0], None).unwrap();
        assert_eq!(COUNT.with(Cell::get) - before, 0);
        assert_eq!(shaded, asset.n_points());
        assert!(relighter.glossy().iter().flatten().flatten().all(|x| x.is_finite()));
        assert!(relighter.irradiance().iter().flatten().flatten().any(|x| *x > 0.0));
    });
}
