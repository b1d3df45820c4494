//! Where rays start: one rule for bake, oracle and reference.
//!
//! ```text
//! origin = p + lift·n_g + shift·t + offset·n_g
//! offset = 2⁻²¹·max(|p|, |corners|)_∞ + 2⁻¹⁴·e       off the surface, a few ulp and a little of the mean edge
//! shift  = min(2⁻¹⁰·e + 2⁻²¹·max, |t|)               toward the centroid, along the surface
//! e      = min(mean edge of the triangles that hold p, edge_length)
//! ```
//!
//! t is (centroid − p) without its part against n_g (a convex surface's centroid lies below it): a point on the border of a floor moves
//! onto its own side of the wall that stands there, and a closed box is closed seen from each of its corners. `lift` is Hanika 2021, "Hacking the shadow
//! terminator": p projected onto the tangent plane of each corner, weighted barycentrically, here only outwards along n_g and at most an
//! eighth of the mean edge, so that coarse smooth spheres show no dark facets and a box with smooth normals does not sprout.
//!
//! Lengths come from the point's own triangles and coordinates, never from the scene. The base triangles that hold a point do not
//! block it, except those that it stands before: where a smooth surface is concave, a ray below one of its own triangles is really
//! blocked (without this a closed room with smooth normals would leak along its edges).

use crate::mesh::weld::{corner_normals, narrow, wide};
use glam::DVec3;
use prelight_scene::world::World;

/// Offset and least shift in units of the largest coordinate: four ulp at the upper end of a binade.
const ULPS: f64 = 1.0 / (1 << 21) as f64;
/// Offset along n_g in mean edges.
const OFFSET: f64 = 1.0 / (1 << 14) as f64;
/// Shift along the surface in mean edges.
const SHIFT: f64 = 1.0 / (1 << 10) as f64;
/// Largest lift in mean edges.
const LARGEST_LIFT: f64 = 0.125;
/// Sine of the angle above which a surface counts as concave at a point. Below a texel (2⁻⁶), above noise.
const CONCAVE: f64 = 1.0 / (1 << 8) as f64;

/// The base triangles around a point, summed up. Normals point to the point's side.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surroundings {
    /// Area-weighted mean normal, unit; zero if the normals cancel.
    pub geometric_normal: DVec3,
    /// Area-weighted centroid.
    pub centroid: DVec3,
    /// Mean edge, metres.
    pub mean_edge: f64,
    /// Largest absolute coordinate.
    pub largest_coordinate: f64,
}

/// Twice the area times the unit normal of a triangle.
#[inline]
pub(crate) fn area_normal(corners: &[[f32; 3]; 3]) -> DVec3 {
    let [a, b, c] = corners.map(wide);
    (b - a).cross(c - a)
}

/// What a triangle adds to the surroundings of the points on it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Facet {
    /// Unit normal, zero where there is none.
    pub normal: DVec3,
    /// Twice the area times the unit normal.
    twice: DVec3,
    /// Twice the area.
    weight: f64,
    /// Sum of the corners, times `weight`.
    moment: DVec3,
    /// Sum of the edges, metres.
    edges: f64,
    /// Largest absolute coordinate.
    largest: f64,
}

impl Facet {
    /// The facet of a triangle's corners.
    pub(crate) fn new(corners: &[[f32; 3]; 3]) -> Facet {
        let twice = area_normal(corners);
        let weight = twice.length();
        let largest = corners.iter().flatten().fold(0.0f64, |m, x| m.max(f64::from(x.abs())));
        let [a, b, c] = corners.map(wide);
        let edges = (b - a).length() + (c - b).length() + (a - c).length();
        Facet { normal: twice.normalize_or_zero(), twice, weight, moment: (a + b + c) * weight, edges, largest }
    }
}

impl Surroundings {
    /// Sums over the triangles that hold a point, seen from one side (`sign` is −1 for the back).
    pub(crate) fn new(triangles: impl Iterator<Item = [[f32; 3]; 3]>, sign: f64) -> Surroundings {
        Surroundings::of(triangles.map(|corners| Facet::new(&corners)), sign)
    }

    /// The same of facets.
    pub(crate) fn of(facets: impl Iterator<Item = Facet>, sign: f64) -> Surroundings {
        let (mut normal, mut centroid, mut area, mut edges, mut n, mut largest) = (DVec3::ZERO, DVec3::ZERO, 0.0, 0.0, 0.0, 0.0f64);
        for facet in facets {
            normal += facet.twice * sign;
            centroid += facet.moment;
            area += facet.weight;
            edges += facet.edges;
            n += 3.0;
            largest = largest.max(facet.largest);
        }
        Surroundings {
            geometric_normal: normal.normalize_or_zero(),
            centroid: centroid / (3.0 * area),
            mean_edge: edges / n,
            largest_coordinate: largest,
        }
    }
}

/// Height of a smooth surface over its triangle.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Lift {
    /// Outward part of the lift, along n_g; metres, 0 or more.
    pub height: f64,
    /// Mean signed height over the corners' tangent planes, metres: positive where the surface is concave.
    pub concavity: f64,
}

impl Lift {
    /// At barycentric `weights` of a triangle with corner normals on the point's side.
    pub(crate) fn new(
        position: DVec3,
        corners: &[[f32; 3]; 3],
        normals: &[[f32; 3]; 3],
        weights: [f64; 3],
        geometric_normal: DVec3,
    ) -> Lift {
        let mut lift = Lift::default();
        for k in 0..3 {
            let normal = wide(normals[k]);
            let above = (position - wide(corners[k])).dot(normal);
            lift.height -= weights[k] * above.min(0.0) * normal.dot(geometric_normal);
            lift.concavity += weights[k] * above * normal.dot(geometric_normal);
        }
        lift.height = lift.height.max(0.0);
        lift
    }
}

/// A ray origin and what does not block it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SurfaceOrigin {
    /// Where rays start.
    pub origin: [f32; 3],
    /// Shading normal n_s on this side, unit.
    pub normal: [f32; 3],
    /// Geometric normal n_g on this side, unit.
    pub geometric_normal: [f32; 3],
    /// The triangle itself never blocks rays from here.
    pub exclude_triangle: bool,
}

/// The rule above. `edge_length` is the bake's.
pub(crate) fn ray_origin(position: DVec3, geometric_normal: DVec3, around: &Surroundings, lift: Lift, edge_length: f32) -> [f32; 3] {
    let largest = position.abs().max_element().max(around.largest_coordinate);
    let edge = around.mean_edge.min(f64::from(edge_length));
    let inward = around.centroid - position;
    let along = inward - geometric_normal * inward.dot(geometric_normal).min(0.0);
    let distance = along.length();
    let shift = (SHIFT * edge + ULPS * largest).min(distance);
    let tangential = if distance > 0.0 { along * (shift / distance) } else { DVec3::ZERO };
    let height = lift.height.min(LARGEST_LIFT * around.mean_edge) + ULPS * largest + OFFSET * edge;
    narrow(position + geometric_normal * height + tangential)
}

/// Whether a base triangle that holds a point must let the point's rays pass: yes, unless the surface is concave there and the
/// origin stands before the triangle. `normal` is the triangle's, unit, on the point's side.
pub(crate) fn is_excluded(position: DVec3, origin: [f32; 3], normal: DVec3, corner: DVec3, around: &Surroundings, lift: Lift) -> bool {
    let inward = around.centroid - position;
    let hollow = normal.dot(inward) > CONCAVE * inward.length() || lift.concavity > CONCAVE * around.mean_edge;
    let before = normal.dot(wide(origin) - corner) > 0.25 * ULPS * around.largest_coordinate;
    !(hollow && before)
}

/// The rule for any hit on the base mesh: a world triangle with an area, barycentric weights of its corners, and a side.
///
/// n_s is the interpolated [`corner_normals`], n_g the triangle's.
pub(crate) fn surface_origin(world: &World, triangle: u32, weights: [f32; 3], back: bool, edge_length: f32) -> SurfaceOrigin {
    let corners = world.positions[triangle as usize];
    let sign = if back { -1.0 } else { 1.0 };
    let normals = corner_normals(world, triangle).front.map(|n| narrow(wide(n) * sign));
    let weights = weights.map(f64::from);
    let mix = |v: &[[f32; 3]; 3]| wide(v[0]) * weights[0] + wide(v[1]) * weights[1] + wide(v[2]) * weights[2];
    let position = mix(&corners);
    let around = Surroundings::new(std::iter::once(corners), sign);
    let geometric = around.geometric_normal;
    let lift = Lift::new(position, &corners, &normals, weights, geometric);
    let origin = ray_origin(position, geometric, &around, lift, edge_length);
    SurfaceOrigin {
        origin,
        normal: narrow(mix(&normals).normalize_or(geometric)),
        geometric_normal: narrow(geometric),
        exclude_triangle: is_excluded(position, origin, geometric, wide(corners[0]), &around, lift),
    }
}
