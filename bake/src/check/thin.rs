//! Walls thinner than the points can tell apart.
//!
//! Light on one side of a wall leaks to the other where an edge of the refined mesh crosses under it. Edges whose ends see different things
//! are split, but no shorter than `area_floor · edge_length` ([`PointParams::shortest_split`] halved). A wall at least that thick holds
//! the middle of such an edge, which is buried and ends the leak; a thinner one, or a single sheet, does not.
//!
//! Thin alone is no flaw: a table top leaks nothing. So from both sides of a thin place rays run along it, and only where they meet the
//! same other object at the same distance, a floor or a ceiling that runs on under the wall, and the wall is still beside them there, does
//! the place count.

use super::facing::frame;
use super::{Finding, Sample, samples};
use crate::mesh::PointParams;
use crate::trace::Occluders;
use prelight_scene::Scene;
use prelight_scene::world::World;
use rayon::prelude::*;

/// A wall is at least this many of its finest edges high and wide; smaller things cast no room-sized leaks.
const WALL_EDGES: f32 = 16.0;
/// Share of an object's samples that must leak.
const LEAK_SHARE: f64 = 0.05;

/// A wall that leaks.
struct Wall {
    /// Thickness of the thinnest leaking place, metres; 0 for a sheet.
    thickness: f32,
    /// Shortest edges there, metres.
    finest: f32,
    object: usize,
}

pub(super) fn findings(scene: &Scene, world: &World, params: &[PointParams], occluders: &Occluders) -> Vec<Finding> {
    let object_of = |triangle: u32| world.primitives[world.primitive[triangle as usize] as usize].object;
    let wall = |object: usize| {
        let finest = (params[object].shortest_split() * 0.5) as f32;
        let range = world.object_start[object] as usize..world.object_start[object + 1] as usize;
        if second_side(world, range) < WALL_EDGES * finest {
            return None;
        }
        let samples = samples(world, object);
        let mut leaks: Vec<f32> = samples.iter().filter_map(|sample| leak(sample, finest, object as u32, occluders, &object_of)).collect();
        if leaks.is_empty() || (leaks.len() as f64) < LEAK_SHARE * samples.len() as f64 {
            return None;
        }
        leaks.sort_by(f32::total_cmp);
        Some(Wall { thickness: leaks[0], finest, object })
    };
    let mut walls: Vec<Wall> = (0..scene.objects.len()).into_par_iter().filter_map(wall).collect();
    walls.sort_by(|a, b| a.thickness.total_cmp(&b.thickness).then(a.object.cmp(&b.object)));
    if walls.is_empty() {
        return Vec::new();
    }
    let finest = walls.iter().map(|wall| wall.finest).fold(0.0, f32::max);
    vec![Finding {
        kind: "thin_walls",
        text: format!(
            "{} thinner than the finest edges beside them (up to {}), and surfaces run on under them: light may leak that far",
            super::count(walls.len(), "object is", "objects are"),
            length(finest)
        ),
        names: walls.iter().map(|wall| format!("{} ({})", scene.objects[wall.object].name, length(wall.thickness))).collect(),
        help: "give walls a thickness, or lower edge_length or area_floor of what they stand on",
    }]
}

/// How thin the object is at a sample under which something runs on.
fn leak(sample: &Sample, finest: f32, object: u32, occluders: &Occluders, object_of: &impl Fn(u32) -> u32) -> Option<f32> {
    let back = sample.normal.map(|x| -x);
    let thickness = match occluders.closest_hit(sample.centre, back, &[sample.triangle]) {
        Some(hit) if hit.back_face && hit.t >= finest => return None,
        Some(hit) if hit.back_face => hit.t,
        // Air behind: a sheet.
        _ => 0.0,
    };
    let [u, v, _] = frame(sample.normal);
    let from = |distance: f32| -> [f32; 3] { std::array::from_fn(|k| sample.centre[k] + distance * sample.normal[k]) };
    let (front, behind) = (from(finest), from(-thickness - finest));
    // Along the axes as the frame has them, and halfway between: one of eight meets a floor under a wall of any turn.
    let diagonal = |s: f32, t: f32| -> [f32; 3] { std::array::from_fn(|k| s * u[k] + t * v[k]) };
    let ring = [(1.0, 0.0), (0.7, 0.7), (0.0, 1.0), (-0.7, 0.7), (-1.0, 0.0), (-0.7, -0.7), (0.0, -1.0), (0.7, -0.7)];
    let runs_on = ring.iter().any(|(s, t)| {
        let direction = diagonal(*s, *t);
        let hits = [front, behind].map(|origin| occluders.closest_hit(origin, direction, &[]));
        let [Some(a), Some(b)] = hits else { return false };
        let other = object_of(a.triangle);
        if other == object || other != object_of(b.triangle) || (a.t - b.t).abs() > 4.0 * finest {
            return false;
        }
        // The thin thing must still be there beside what runs on: a table top ends before the wall.
        let beside = std::array::from_fn(|k| front[k] + (a.t - finest).max(0.0) * direction[k]);
        let wall = occluders.closest_hit(beside, back, &[]);
        wall.is_some_and(|wall| object_of(wall.triangle) == object && wall.t <= 2.0 * finest + thickness)
    });
    runs_on.then_some(thickness)
}

/// The second longest side of an object's box, metres.
pub(super) fn second_side(world: &World, triangles: std::ops::Range<usize>) -> f32 {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for corner in world.positions[triangles].iter().flatten().filter(|corner| corner.iter().all(|x| x.is_finite())) {
        for k in 0..3 {
            low[k] = low[k].min(corner[k]);
            high[k] = high[k].max(corner[k]);
        }
    }
    let mut sides: [f32; 3] = std::array::from_fn(|k| high[k] - low[k]);
    sides.sort_by(f32::total_cmp);
    sides[1]
}

/// `4 mm`, `1.2 cm`, `3.4 m`.
pub(super) fn length(metres: f32) -> String {
    match metres {
        m if m < 0.01 => format!("{:.1} mm", 1e3 * m),
        m if m < 1.0 => format!("{:.1} cm", 1e2 * m),
        m => format!("{m:.1} m"),
    }
}
