//! Single-sided surfaces whose backs are seen.
//!
//! A single-sided face is not drawn from behind, yet blocks light from both sides. The back of a closed solid is never seen: rays
//! from it, inward, meet backs only. The back of a floor or of a doll's house faces the sky, and is meant to. So a surface is told when
//! most rays from its back meet somebody's front: a partition, or a wall that was turned the wrong way round.

use super::thin::second_side;
use super::{Finding, samples};
use crate::trace::Occluders;
use prelight_runtime::draw::camera::CameraRays;
use prelight_scene::Scene;
use prelight_scene::world::World;
use rayon::prelude::*;

/// Share of rays from behind that must meet a front.
const SEEN_SHARE: f64 = 0.5;
/// What is nearer behind than this share of the object's second longest side leaves no room to look from.
const NEAR_SHARE: f32 = 0.05;
/// Share of a camera's picture that may show through backs before it is told.
const CAMERA_SHARE: f64 = 0.01;
/// Rays of a camera: a picture of this many pixels.
const CAMERA_PIXELS: [usize; 2] = [64, 36];

/// Directions into the half-space around +z: straight, and four at 60 degrees from it.
const DIRECTIONS: [[f32; 3]; 5] = [[0.0, 0.0, 1.0], [0.866, 0.0, 0.5], [-0.866, 0.0, 0.5], [0.0, 0.866, 0.5], [0.0, -0.866, 0.5]];

pub(super) fn findings(scene: &Scene, world: &World, occluders: &Occluders) -> Vec<Finding> {
    let single_sided = |triangle: u32| {
        let primitive = &world.primitives[world.primitive[triangle as usize] as usize];
        !scene.materials[primitive.material as usize].double_sided
    };
    let open = |object: usize| {
        let (mut fronts, mut rays) = (0u32, 0u32);
        let range = world.object_start[object] as usize..world.object_start[object + 1] as usize;
        let near = NEAR_SHARE * second_side(world, range);
        for sample in samples(world, object).iter().filter(|sample| single_sided(sample.triangle)) {
            let axes = frame(sample.normal.map(|x| -x));
            for local in DIRECTIONS {
                let direction = std::array::from_fn(|k| local[0] * axes[0][k] + local[1] * axes[1][k] + local[2] * axes[2][k]);
                let hit = occluders.closest_hit(sample.centre, direction, &[sample.triangle]);
                rays += 1;
                // A double-sided surface is a front from both sides.
                fronts += u32::from(hit.is_some_and(|hit| hit.t > near && (!hit.back_face || !single_sided(hit.triangle))));
            }
        }
        let share = f64::from(fronts) / f64::from(rays.max(1));
        (share > SEEN_SHARE).then_some((share, object))
    };
    let mut sheets: Vec<(f64, usize)> = (0..scene.objects.len()).into_par_iter().filter_map(open).collect();
    sheets.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut found = Vec::new();
    if !sheets.is_empty() {
        found.push(Finding {
            kind: "seen_from_behind",
            text: format!(
                "{} single-sided with the back to other surfaces: seen from there, invisible, though light stops at it",
                super::count(sheets.len(), "object is", "objects are")
            ),
            names: sheets.iter().map(|(_, object)| scene.objects[*object].name.clone()).collect(),
            help: "if they are to be seen from both sides: [[material]] match = \"…\", double_sided = true",
        });
    }
    let looks = |camera: &prelight_runtime::draw::camera::SceneCamera| {
        let rays = CameraRays::new(&camera.camera, CAMERA_PIXELS[0], CAMERA_PIXELS[1]).ok()?;
        let mut backs = 0;
        for y in 0..CAMERA_PIXELS[1] {
            for x in 0..CAMERA_PIXELS[0] {
                let direction = rays.direction(x as f32 + 0.5, y as f32 + 0.5);
                let hit = occluders.closest_hit(camera.camera.eye, direction, &[]);
                backs += usize::from(hit.is_some_and(|hit| hit.back_face && single_sided(hit.triangle)));
            }
        }
        let share = backs as f64 / (CAMERA_PIXELS[0] * CAMERA_PIXELS[1]) as f64;
        (share > CAMERA_SHARE).then(|| format!("{} ({:.0} % of its picture)", camera.name, 100.0 * share))
    };
    let cameras: Vec<String> = scene.cameras.par_iter().filter_map(looks).collect();
    if !cameras.is_empty() {
        found.push(Finding {
            kind: "camera_sees_backs",
            text: format!(
                "{} at the backs of single-sided surfaces, and through them",
                super::count(cameras.len(), "camera looks", "cameras look")
            ),
            names: cameras,
            help: "move the camera, or make the surfaces double_sided",
        });
    }
    found
}

/// Two unit axes across `normal`, and it.
pub(super) fn frame(normal: [f32; 3]) -> [[f32; 3]; 3] {
    let helper = if normal[0].abs() < 0.7 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    let cross = |a: [f32; 3], b: [f32; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let u = cross(normal, helper);
    let length = (u[0] * u[0] + u[1] * u[1] + u[2] * u[2]).sqrt();
    let u = u.map(|x| x / length);
    [u, cross(normal, u), normal]
}
