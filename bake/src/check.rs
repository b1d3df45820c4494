//! What will not work, or will look wrong, in a scene that loads: found before hours of baking, told with counts and names.
//!
//! | finding | when | judged by |
//! |---|---|---|
//! | `input` | whatever reading had to say: lights not transported, anisotropy without uv, textures left out, ... | the loader |
//! | `seen_from_behind` | single-sided surfaces whose backs face other surfaces: invisible there, while light stops at them | rays, [`facing`] |
//! | `camera_sees_backs` | a camera of the scene looks at such sides | rays, [`facing`] |
//! | `thin_walls` | closer to what is behind than refinement goes: light may leak across | rays, [`thin`] |
//! | `unused` | textures, materials and meshes of the files that nothing shows | the files' descriptions, [`unused`] |
//! | `scale` | the scene is smaller than a hand or larger than a town | bounds |
//! | `far_from_origin` | f32 positions there are coarser than the points | bounds |
//! | `empty` | objects without a triangle that can be seen | the flattened world |
//!
//! Rays are a fixed sample per object, so the cost does not grow with the scene's triangles; findings by rays are estimates, and
//! the same on every machine.

mod attributes;
mod facing;
mod thin;
mod unused;

use crate::error::BakeError;
use crate::mesh::PointParams;
use crate::progress::{Progress, Stage, check};
use crate::trace::{OccluderOptions, Occluders};
use prelight_scene::Scene;
use prelight_scene::input::SceneInput;
use prelight_scene::world::World;

/// Something that a person should look at before a bake.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// Which of the kinds of this module's table.
    pub kind: &'static str,
    /// What, with counts; one line.
    pub text: String,
    /// Names of what it concerns, worst first, all of them.
    pub names: Vec<String>,
    /// What to do; empty where `text` says it.
    pub help: &'static str,
}

/// Looks for everything. `params`: one per object, as a bake would have them.
///
/// # Errors
/// [`BakeError::Cancelled`].
pub fn findings(
    input: &SceneInput,
    scene: &Scene,
    world: &World,
    params: &[PointParams],
    progress: &dyn Progress,
) -> Result<Vec<Finding>, BakeError> {
    let stage = Stage::begin(progress, "look", Some(4), "kinds of flaw");
    let mut found: Vec<Finding> =
        (scene.warnings.iter()).map(|warning| Finding { kind: "input", text: warning.clone(), names: Vec::new(), help: "" }).collect();
    found.extend(attributes::findings(scene, world));
    found.extend(unused::findings(input));
    stage.advance(1);
    check(progress)?;
    let occluders = Occluders::build(world, &scene.textures, OccluderOptions::default());
    stage.advance(1);
    check(progress)?;
    found.extend(facing::findings(scene, world, &occluders));
    stage.advance(1);
    check(progress)?;
    found.extend(thin::findings(scene, world, params, &occluders));
    Ok(found)
}

/// Triangles of an object that are looked at, at most this many, evenly by their area.
const SAMPLES: usize = 96;

/// A point in the middle of a triangle, its front normal and the triangle's area.
struct Sample {
    triangle: u32,
    centre: [f32; 3],
    normal: [f32; 3],
}

/// Points on an object's occluding triangles: where equal steps through their areas land.
fn samples(world: &World, object: usize) -> Vec<Sample> {
    let range = world.object_start[object]..world.object_start[object + 1];
    let mut cumulated = Vec::with_capacity(range.len());
    let mut sum = 0.0f64;
    for id in range.clone() {
        sum += area_normal(world, id).map_or(0.0, |(area, _)| area);
        cumulated.push(sum);
    }
    if !(sum > 0.0 && sum.is_finite()) {
        return Vec::new();
    }
    let n = SAMPLES.min(range.len());
    let pick = |k: usize| {
        let target = (k as f64 + 0.5) / n as f64 * sum;
        let at = cumulated.partition_point(|c| *c < target).min(range.len() - 1);
        let id = range.start + at as u32;
        let (_, normal) = area_normal(world, id)?;
        let corners = &world.positions[id as usize];
        let centre =
            std::array::from_fn(|k| ((f64::from(corners[0][k]) + f64::from(corners[1][k]) + f64::from(corners[2][k])) / 3.0) as f32);
        Some(Sample { triangle: id, centre, normal })
    };
    (0..n).filter_map(pick).collect()
}

/// Area and unit front normal; nothing where the triangle blocks no light or has no area.
fn area_normal(world: &World, id: u32) -> Option<(f64, [f32; 3])> {
    if world.occlusion[id as usize] == prelight_scene::world::Occlusion::None {
        return None;
    }
    let [a, b, c] = world.positions[id as usize].map(|p| p.map(f64::from));
    let (u, v): ([f64; 3], [f64; 3]) = (std::array::from_fn(|k| b[k] - a[k]), std::array::from_fn(|k| c[k] - a[k]));
    let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
    (length > 0.0).then(|| (0.5 * length, n.map(|x| (x / length) as f32)))
}

/// `1 object is`, `3 objects are`.
fn count(n: usize, one: &str, many: &str) -> String {
    format!("{n} {}", if n == 1 { one } else { many })
}

#[cfg(test)]
mod tests;
