//! The automatic view: most files have no camera, so this is what everybody sees.
//!
//! 1. **What to show.** Everything; but when a flat ground reaches far beyond what stands on it, what stands on it, with room around.
//! 2. **From where.** Candidates on a sphere, glTF's front (+Z) to the viewer, are drawn small and scored by how much they tell: the
//!    entropy of the picture over parts of the scene (a lattice of cells times six directions of the surface), times a preference for the
//!    usual three-quarter view from a little above, higher above what lies flat. Walls, open tops, thin plates and rooms decide by what they hide: nothing is special-cased.
//! 3. **How far.** The nearest eye from which every vertex lies inside the frame with a margin, in closed form.
//!
//! The same scene gives the same view on every machine: f64 and `libm`, no random numbers.
//! Entropy as a measure of views: Vázquez et al. 2001.

use super::raster::Visibility;
use super::threads::map_indices;
use crate::camera::{Camera, sub};
use crate::chunk::mesh::Mesh;
use crate::sphere::frame::dot;
use crate::surface::{Material, Texture};
use std::collections::BTreeMap;

/// Vertical field of view of the automatic view, degrees.
pub(crate) const FRAMING_FOV_Y_DEG: f32 = 35.0;
/// Share of the frame's half width that the scene may fill.
const FILL: f64 = 0.93;
/// The same when the ground goes on beyond what is shown.
const FILL_ON_GROUND: f64 = 0.72;
/// Weight of filling the frame against telling much.
const FILL_EXPONENT: f64 = 0.15;
/// Rows of the small pictures.
const ROWS: usize = 54;
/// Cells of the lattice along a side.
const CELLS: f64 = 6.0;
const AZIMUTHS: [f64; 10] = [30.0, -30.0, 0.0, 60.0, -60.0, 90.0, -90.0, 135.0, -135.0, 180.0];
const ELEVATIONS: [f64; 5] = [8.0, 18.0, 30.0, 42.0, 56.0];
/// Elevation at which azimuths are compared first.
const FIRST_ELEVATION: f64 = 30.0;

/// A view that shows the scene, for pictures of `aspect` = width / height. An empty scene gets a view of the unit cube.
pub fn automatic_view(meshes: &[Mesh], materials: &[Material], textures: &[Texture], aspect: f32) -> Camera {
    let aspect = if aspect.is_finite() { f64::from(aspect).clamp(0.05, 20.0) } else { 1.0 };
    let Some(subject) = Subject::new(meshes) else {
        return view([[-0.5, -0.5, -0.5], [0.5, 0.5, 0.5]].iter().copied(), 30.0, 20.0, aspect, FILL);
    };
    let size = [((ROWS as f64 * aspect) as usize).clamp(8, 4 * ROWS), ROWS];
    let score = |azimuth: f64, elevation: f64| {
        let camera = view(subject.hull.iter().copied(), azimuth, elevation, aspect, subject.fill);
        let told = Visibility::new(meshes, materials, textures, &camera, size, 1).map_or(0.0, |seen| subject.entropy(meshes, &seen));
        told * preference(azimuth, elevation, subject.ideal_elevation)
    };
    let by_azimuth = map_indices(AZIMUTHS.len(), |i| score(AZIMUTHS[i], FIRST_ELEVATION));
    let mut order: Vec<usize> = (0..AZIMUTHS.len()).collect();
    order.sort_by(|a, b| by_azimuth[*b].total_cmp(&by_azimuth[*a]));
    let candidates: Vec<(f64, f64)> = order[..2].iter().flat_map(|i| ELEVATIONS.map(|elevation| (AZIMUTHS[*i], elevation))).collect();
    let scores = map_indices(candidates.len(), |i| score(candidates[i].0, candidates[i].1));
    // The first of equal ones.
    let best = (0..candidates.len()).rev().max_by(|a, b| scores[*a].total_cmp(&scores[*b])).unwrap_or(0);
    view(subject.hull.iter().copied(), candidates[best].0, candidates[best].1, aspect, subject.fill)
}

/// Factor for what people expect: from the front, turned a little, from a little above.
fn preference(azimuth: f64, elevation: f64, ideal_elevation: f64) -> f64 {
    let turned = (azimuth.abs() - 30.0).abs() / 150.0;
    let tilted = (elevation - ideal_elevation).abs() / 70.0;
    let left = if azimuth < 0.0 { 0.01 } else { 0.0 };
    1.0 - 0.22 * turned - 0.8 * tilted * tilted - left
}

/// What the view is about.
struct Subject {
    /// Vertices that must lie in the frame.
    hull: Vec<[f32; 3]>,
    low: [f64; 3],
    size: f64,
    fill: f64,
    /// Degrees: 20 for what stands, up to 60 for what lies flat.
    ideal_elevation: f64,
}

impl Subject {
    fn new(meshes: &[Mesh]) -> Option<Self> {
        let everything = bounds(meshes, |_| true)?;
        let extent = |b: [[f64; 3]; 2]| sub(b[1], b[0]);
        let whole = extent(everything);
        // The ground: what stays in the lowest part, a slab's rim too.
        let level = everything[0][1] + 0.03 * whole[1];
        let ground = |corners: &[[f64; 3]; 3]| corners.iter().all(|p| p[1] <= level);
        let standing = bounds(meshes, |corners| !ground(corners));
        let (shown, fill, on_ground) = match standing {
            // Far: what stands covers less than a third of the ground along its longer side.
            Some(b) if extent(b)[0].max(extent(b)[2]) * 3.0 < whole[0].max(whole[2]) => (b, FILL_ON_GROUND, true),
            _ => (everything, FILL, false),
        };
        let mut hull: Vec<[f32; 3]> = Vec::new();
        for mesh in meshes {
            let mut used = vec![false; mesh.position.len()];
            for triangle in mesh.triangles {
                let corners = triangle.map(|v| mesh.position[v as usize].map(f64::from));
                if corners.iter().flatten().all(|v| v.is_finite()) && !(on_ground && ground(&corners)) {
                    triangle.iter().for_each(|v| used[*v as usize] = true);
                }
            }
            hull.extend(mesh.position.iter().zip(used).filter(|(_, used)| *used).map(|(p, _)| *p));
        }
        let size = extent(shown).iter().fold(0.0f64, |m, v| m.max(*v)).max(f64::MIN_POSITIVE);
        let [wide, high, deep] = extent(shown);
        let flatness = (1.0 - 2.0 * high / wide.max(deep).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        Some(Subject { hull, low: shown[0], size, fill, ideal_elevation: 20.0 + 40.0 * flatness })
    }

    /// −Σ p ln p over the parts of the scene that the pixels show, times a power of the share of the frame that they fill.
    fn entropy(&self, meshes: &[Mesh], seen: &Visibility) -> f64 {
        let mut parts: BTreeMap<[i32; 4], u32> = BTreeMap::new();
        let mut total = 0;
        for fragment in seen.tiles.iter().flat_map(|tile| &tile.solid) {
            let (object, triangle) = seen.locate(fragment.triangle);
            let mesh = &meshes[object];
            let corners = mesh.triangles[triangle].map(|v| mesh.position[v as usize].map(f64::from));
            let centre: [f64; 3] = std::array::from_fn(|k| (corners[0][k] + corners[1][k] + corners[2][k]) / 3.0);
            let cell = [0, 1, 2].map(|k| ((centre[k] - self.low[k]) / self.size * CELLS).floor().clamp(-1.0, CELLS) as i32);
            if cell.iter().all(|c| (0..CELLS as i32).contains(c)) {
                let n = super::camera::cross(sub(corners[1], corners[0]), sub(corners[2], corners[0]));
                let axis = (0..3).fold(0, |best, k| if n[k].abs() > n[best].abs() { k } else { best });
                *parts.entry([cell[0], cell[1], cell[2], axis as i32 * 2 + i32::from(n[axis] < 0.0)]).or_default() += 1;
                total += 1;
            }
        }
        let term = |count: u32| {
            let p = f64::from(count) / f64::from(total);
            -p * libm::log(p)
        };
        // What fills the frame is seen better, but a turned view may leave corners free.
        let filled = f64::from(total) / (seen.width * seen.height) as f64;
        parts.values().map(|count| term(*count)).sum::<f64>() * libm::pow(filled, FILL_EXPONENT)
    }
}

/// Bounds of the triangles that `keep` keeps; corners that are not finite are left out.
fn bounds(meshes: &[Mesh], keep: impl Fn(&[[f64; 3]; 3]) -> bool) -> Option<[[f64; 3]; 2]> {
    let mut b = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
    for mesh in meshes {
        for triangle in mesh.triangles {
            let corners = triangle.map(|v| mesh.position[v as usize].map(f64::from));
            if corners.iter().flatten().all(|v| v.is_finite()) && keep(&corners) {
                for p in corners {
                    (0..3).for_each(|k| (b[0][k], b[1][k]) = (b[0][k].min(p[k]), b[1][k].max(p[k])));
                }
            }
        }
    }
    (b[0][0] <= b[1][0]).then_some(b)
}

/// The nearest view from a direction that holds all points: azimuth from +Z toward +X, elevation up, degrees.
///
/// Along each image axis, with x the offset and d the depth of a point, |x − x_eye| ≤ t (d − d_eye): two planes, one unknown each.
fn view(points: impl Iterator<Item = [f32; 3]> + Clone, azimuth: f64, elevation: f64, aspect: f64, fill: f64) -> Camera {
    let radians = std::f64::consts::PI / 180.0;
    let (sa, ca) = (libm::sin(azimuth * radians), libm::cos(azimuth * radians));
    let (se, ce) = (libm::sin(elevation * radians), libm::cos(elevation * radians));
    let forward = [-ce * sa, -se, -ce * ca];
    let right = [ca, 0.0, -sa];
    let up = super::camera::cross(right, forward);
    let tan_y = libm::tan(f64::from(FRAMING_FOV_Y_DEG) * 0.5 * radians) * fill;
    let reach = |axis: [f64; 3], tangent: f64| {
        points.clone().map(|p| dot(axis, p.map(f64::from)) - tangent * dot(forward, p.map(f64::from))).fold(f64::NEG_INFINITY, f64::max)
    };
    let negated = |v: [f64; 3]| v.map(|x| -x);
    let fit = |axis: [f64; 3], tangent: f64| {
        let (high, low) = (reach(axis, tangent), reach(negated(axis), tangent));
        // Position along the axis, and the greatest depth that the eye may have.
        ((high - low) * 0.5, -(high + low) / (2.0 * tangent))
    };
    let (x, depth_x) = fit(right, tan_y * aspect);
    let (y, depth_y) = fit(up, tan_y);
    let depth = depth_x.min(depth_y);
    let (near, far) =
        points.clone().map(|p| dot(forward, p.map(f64::from))).fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), d| (a.min(d), b.max(d)));
    // A single point or a line along the axis would put the eye onto it.
    let depth = depth.min(near - 1e-3 * (far - near)).min(near - f64::from(f32::EPSILON) * 16.0 * near.abs().max(1e-6));
    let place = |d: f64| -> [f32; 3] { std::array::from_fn(|k| (right[k] * x + up[k] * y + forward[k] * d) as f32) };
    Camera { eye: place(depth), look_at: place((near + far) * 0.5), up: [0.0, 1.0, 0.0], fov_y_deg: FRAMING_FOV_Y_DEG }
}
