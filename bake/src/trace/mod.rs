//! Everything that casts rays; nothing else in prelight does.
//!
//! A texel's bit is the OR over all occluding triangles of one f32 predicate: hierarchies, rectangles, order and early
//! outs may only skip what the predicate would reject.
//!
//! | file | what |
//! |---|---|
//! | `predicate` | the predicate, its exactness, and the brute-force oracle |
//! | `horizon` | n_s·ω > 0 for every texel |
//! | `mask` | alpha cut-outs |
//! | `tree` | 8-wide hierarchy, collapsed from obvhs' binary one |
//! | `coverage`, `simd` | all texels of an origin at once: scalar, and its AVX2 twin |
//! | `samples` | the same for 8×8 samples of every texel: grayscale |
//! | `ray` | single rays: any hit, closest hit |
//! | `hit` | the surface where a ray ends, and how it reflects |
//! | `sequence` | random numbers of (seed, pixel or point, sample) |
//! | `path` | paths from a point over other surfaces to the environment |
//! | `occluders` | the public face of the rest |

mod coverage;
pub(crate) mod hit;
pub mod horizon;
mod mask;
mod occluders;
pub mod path;
pub mod predicate;
mod ray;
pub mod samples;
#[cfg(test)]
mod samples_oracle;
#[cfg(test)]
mod samples_tests;
#[cfg(test)]
pub(crate) mod scenes;
pub(crate) mod sequence;
#[cfg(target_arch = "x86_64")]
mod simd;
#[cfg(test)]
mod tests;
mod tree;

pub use occluders::{OccluderOptions, Occluders, Scratch, TreeQuality};
pub use predicate::open_texels_by_brute_force;
pub use prelight_runtime::light::SimdPath;
pub(crate) use ray::BEYOND;
pub use ray::Hit;

/// Where a point's visibility is traced from.
#[derive(Clone, Copy, Debug)]
pub struct TraceOrigin<'a> {
    /// World position of the ray origin, offset already applied.
    pub origin: [f32; 3],
    /// Shading normal n_s: a texel is open only if n_s·ω > 0.
    pub normal: [f32; 3],
    /// Ids of the base triangles that hold the point, ascending; they never block it.
    pub base_triangles: &'a [u32],
}
