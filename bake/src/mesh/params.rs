//! What decides how densely points lie on a surface.

use crate::error::PlanError;
use prelight_manifests::quality::Knobs;

/// Levels of splitting below a base edge that barycentric coordinates can name exactly (multiples of 2⁻¹⁵ in a u16).
pub(crate) const DEEPEST_LEVEL: u32 = 15;

/// Knobs of refinement. Each is a length, an angle or a limit of its own: none comes from the size of the scene, so an edit
/// somewhere changes no points elsewhere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointParams {
    /// Edge length aimed at, metres, above 0. Edges longer than 4/3 of it are halved, so those that were end between 2/3 and 4/3.
    pub edge_length: f32,
    /// Edges whose end normals differ by more than this are split. Degrees, 0..=180; 180 never splits.
    pub normal_angle_deg: f32,
    /// Shortest edge that refinement makes, as a share of the edge length, 0..=1: what bounds splitting for normals and leaks.
    pub area_floor: f32,
    /// Times that a base edge may be halved, 0..=[`DEEPEST_LEVEL`].
    pub max_level: u32,
    /// Where the mesh is finer than `edge_length`, only some of its points are baked, the others interpolate.
    pub coarser: bool,
    /// Shadow gap of an edge, m²·sr, above which the borders of shadows split it down to the floor ([`crate::block_product::visibility::border`]); infinite: never.
    pub max_shadow_gap: f32,
    /// Triangles with an edge whose ends differ are cut in four, as in \[LD09\], in the place of edges in two. For its chart: it makes more points.
    pub quarters: bool,
    /// Refined triangles of one object; more is an error that says so, not an allocation.
    pub max_triangles: u32,
}

impl PointParams {
    /// The knobs of a preset (or of a manifest) at an edge length in metres.
    pub fn new(knobs: &Knobs, edge_length: f32) -> Self {
        PointParams {
            edge_length,
            normal_angle_deg: knobs.normal_angle_deg as f32,
            area_floor: knobs.area_floor as f32,
            max_level: DEEPEST_LEVEL,
            coarser: knobs.coarser,
            max_shadow_gap: f32::INFINITY,
            quarters: false,
            max_triangles: 1 << 26,
        }
    }

    /// The same parameters at another edge length.
    pub fn with_edge_length(self, edge_length: f32) -> Self {
        PointParams { edge_length, ..self }
    }

    /// Edges up to this are never split, metres: twice the shortest that may be made.
    pub(crate) fn shortest_split(&self) -> f64 {
        2.0 * f64::from(self.area_floor) * f64::from(self.edge_length)
    }

    /// Refuses what refinement cannot work with.
    pub(crate) fn check(&self) -> Result<(), PlanError> {
        let error = |field, value: f64, expected| Err(PlanError::Range { field, value, expected });
        if !(self.edge_length > 0.0 && self.edge_length.is_finite()) {
            return error("edge_length", self.edge_length.into(), "a finite length above 0");
        }
        if !(0.0..=180.0).contains(&self.normal_angle_deg) {
            return error("normal_angle_deg", self.normal_angle_deg.into(), "0..=180");
        }
        if !(0.0..=1.0).contains(&self.area_floor) {
            return error("area_floor", self.area_floor.into(), "0..=1");
        }
        if self.max_level > DEEPEST_LEVEL {
            return error("max_level", self.max_level.into(), "0..=15");
        }
        if self.max_shadow_gap.is_nan() || self.max_shadow_gap < 0.0 {
            return error("max_shadow_gap", self.max_shadow_gap.into(), "0 or more");
        }
        Ok(())
    }
}
