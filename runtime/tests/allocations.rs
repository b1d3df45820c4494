//! Shading a patch allocates nothing of ours.
#![allow(unsafe_code)] // a counting global allocator cannot be written without

#[path = "support/occluders.rs"]
mod occluders;

use occluders::{Patch, sky, studio};
use prelight_runtime::asset::surface::PointSurfaces;
use prelight_runtime::block_product::{GLOSSY_TOLERANCE, Light, SimdPath, shade_diffuse_with, shade_glossy_with};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: every call is passed on to the system's allocator unchanged; the counter is a thread-local without a destructor.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: the caller's promise is the same.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise is the same.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: the caller's promise is the same.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn allocations(run: impl FnOnce()) -> usize {
    let before = ALLOCATIONS.get();
    run();
    ALLOCATIONS.get() - before
}

#[test]
fn shading_and_updating_a_light_allocate_nothing() {
    assert_eq!(allocations(|| drop(std::hint::black_box(vec![1u8]))), 1, "the counter counts");
    let patch = Patch::among_occluders(64, 32, 5);
    let (visibility, other) = (patch.visibility(), studio(64));
    let mut light = Light::prepare(&sky(64, 1e3));
    let surfaces = PointSurfaces { normal: &patch.normal, roughness: &patch.roughness, metallic: &[], material: &[] };
    let (mut diffuse, mut glossy) = (vec![[[0.0; 3]; 3]; 32], vec![[[0.0; 3]; 2]; 32]);
    let mut shade = |path: SimdPath, light: &Light| {
        shade_diffuse_with(path, light, &visibility, &mut diffuse);
        shade_glossy_with(path, GLOSSY_TOLERANCE, light, &patch.position, &surfaces, &visibility, [2.0, 1.0, 3.0], &mut glossy);
    };
    // The first call makes the table of albedos.
    shade(SimdPath::Scalar, &light);
    for path in SimdPath::all_available() {
        assert_eq!(allocations(|| shade(path, &light)), 0, "{path:?}");
    }
    assert_eq!(allocations(|| light.update(&other)), 0);
}
