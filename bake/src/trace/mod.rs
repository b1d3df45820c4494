//! Everything that casts rays; nothing else in prelight does.
//!
//! A texel's bit is the OR over all occluding triangles of one f32 predicate (DESIGN: keys): hierarchies, rectangles, order and early
//! outs may only skip what the predicate would reject.

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
