//! What shuts the environment out: a sky dome, a backdrop, a room without openings.
//!
//! Rays from a few points of the scene are held against objects large enough to enclose it. Where nearly all of them are blocked, a
//! bake is black whatever the light, and nothing in it says why. A look at few points, so it names what is plain, not every case.
//! Only solid surfaces count: neither cut-outs nor what `occludes = false` opens.

use super::world::{Placement, has_area};
use super::{Mesh, Object, Scene};
use glam::DVec3;
use prelight_runtime::surface::{AlphaMode, Material};
use rayon::prelude::*;

/// Points that rays start from, and rays a point.
const POINTS: usize = 12;
const RAYS: usize = 26;
/// Share of blocked rays from which the environment counts as shut out.
const SHUT: f64 = 0.98;
/// Share of the scene's diagonal from which an object may be a wall of the room around it.
const LARGE: f64 = 0.5;
/// More triangles than this are not held against rays.
const MOST_TRIANGLES: usize = 1 << 20;
/// Walls that a message names.
const MOST_NAMES: usize = 3;
/// Rays start this share of the scene's diagonal above their surface.
const LIFT: f64 = 1e-5;

type Triangle = [DVec3; 3];

/// One object, flattened.
struct Part {
    low: DVec3,
    high: DVec3,
    /// Triangles with area; the second says that it is seen from both sides, the third that it blocks.
    triangles: Vec<(Triangle, bool, bool)>,
}

/// At most one sentence, which names what encloses the scene.
pub(crate) fn warnings(scene: &Scene) -> Vec<String> {
    let triangles = |mesh: &Mesh| mesh.primitives.iter().map(|primitive| primitive.triangles.len()).sum::<usize>();
    if scene.objects.iter().map(|object| triangles(&object.mesh)).sum::<usize>() > 8 * MOST_TRIANGLES {
        return Vec::new();
    }
    let parts: Vec<Part> = scene.objects.par_iter().map(|object| flatten(scene, object)).collect();
    let low = parts.iter().fold(DVec3::INFINITY, |low, part| low.min(part.low));
    let high = parts.iter().fold(DVec3::NEG_INFINITY, |high, part| high.max(part.high));
    let diagonal = (high - low).length();
    if !(diagonal.is_finite() && diagonal > 0.0) {
        return Vec::new();
    }
    let help = "no light of the environment comes in (help: [[material]] match = its material's name, occludes = false)";
    let around = |k: usize| {
        let part = &parts[k];
        let slack = DVec3::splat(1e-3 * diagonal);
        let holds = |other: &Part| part.low.cmple(other.low + slack).all() && part.high.cmpge(other.high - slack).all();
        (part.high - part.low).min_element() > 1e-3 * diagonal && parts.iter().all(holds)
    };
    for k in (0..parts.len()).filter(|&k| around(k)) {
        if is_shut(&parts, &[k], diagonal) {
            return vec![format!("{} encloses the scene: {help}", scene.objects[k].name)];
        }
    }
    let walls: Vec<usize> = (0..parts.len()).filter(|&k| (parts[k].high - parts[k].low).length() >= LARGE * diagonal).collect();
    if walls.len() < 2 || !is_shut(&parts, &walls, diagonal) {
        return Vec::new();
    }
    let names: Vec<&str> = walls.iter().take(MOST_NAMES).map(|&k| scene.objects[k].name.as_str()).collect();
    let more = walls.len() - names.len();
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    vec![format!("{}{more} enclose the scene: {help}", names.join(", "))]
}

fn is_solid(material: &Material) -> bool {
    match (material.alpha_mode, material.occludes) {
        (_, Some(false)) => false,
        (AlphaMode::Opaque, _) => true,
        (AlphaMode::Blend, Some(true)) => true,
        (AlphaMode::Blend, _) => material.base_color_texture.is_none() && material.base_color[3] >= 0.5,
        (AlphaMode::Mask { .. }, _) => false,
    }
}

fn flatten(scene: &Scene, object: &Object) -> Part {
    let placement = Placement::new(object.world_from_local);
    let mut part = Part { low: DVec3::INFINITY, high: DVec3::NEG_INFINITY, triangles: Vec::new() };
    for primitive in &object.mesh.primitives {
        let material = scene.materials.get(primitive.material as usize);
        let (both, solid) = (material.is_some_and(|m| m.double_sided), material.is_none_or(is_solid));
        for t in &primitive.triangles {
            let t = if placement.mirrored { [t[0], t[2], t[1]] } else { *t };
            let corners = t.map(|v| placement.point(primitive.positions[v as usize]));
            if has_area(&corners) {
                let corners = corners.map(|corner| DVec3::from(corner.map(f64::from)));
                corners.iter().for_each(|&corner| (part.low, part.high) = (part.low.min(corner), part.high.max(corner)));
                part.triangles.push((corners, both, solid));
            }
        }
    }
    part
}

/// Whether nearly all rays from the scene meet the walls. Points lie on what is no wall, or, where there is nothing else, on the walls.
fn is_shut(parts: &[Part], walls: &[usize], diagonal: f64) -> bool {
    let blocking: Vec<Triangle> =
        walls.iter().flat_map(|&k| &parts[k].triangles).filter(|(.., solid)| *solid).map(|(triangle, ..)| *triangle).collect();
    if blocking.is_empty() || blocking.len() > MOST_TRIANGLES {
        return false;
    }
    let others: Vec<usize> = (0..parts.len()).filter(|k| !walls.contains(k) && !parts[*k].triangles.is_empty()).collect();
    let on = if others.is_empty() { walls } else { &others };
    let starts = points(parts, on, LIFT * diagonal);
    let rays: Vec<(DVec3, DVec3)> = starts.iter().flat_map(|&start| (0..RAYS).map(move |i| (start, direction(i)))).collect();
    let blocked = rays.par_iter().filter(|(from, along)| blocking.iter().any(|triangle| meets(triangle, *from, *along))).count();
    !rays.is_empty() && blocked as f64 >= SHUT * rays.len() as f64
}

/// Places just above surfaces, spread over the objects and over the triangles of each.
fn points(parts: &[Part], on: &[usize], lift: f64) -> Vec<DVec3> {
    let mut points = Vec::new();
    let step = on.len().div_ceil(POINTS);
    let each = POINTS.div_ceil(on.len());
    for &k in on.iter().step_by(step.max(1)) {
        let triangles = &parts[k].triangles;
        for i in 0..each.min(triangles.len()) {
            let ([a, b, c], both, _) = triangles[i * triangles.len() / each.min(triangles.len())];
            let (centre, normal) = ((a + b + c) / 3.0, (b - a).cross(c - a).normalize_or_zero() * lift);
            points.push(centre + normal);
            if both {
                points.push(centre - normal);
            }
        }
    }
    points
}

/// Direction `i` of a spiral that covers the sphere evenly.
fn direction(i: usize) -> DVec3 {
    let z = 1.0 - (2 * i + 1) as f64 / RAYS as f64;
    let angle = 2.399_963_229_728_653 * i as f64 + 0.1;
    let radius = (1.0 - z * z).sqrt();
    DVec3::new(radius * libm::cos(angle), z, radius * libm::sin(angle))
}

/// Ray against triangle by Möller and Trumbore, from either side.
fn meets([a, b, c]: &Triangle, from: DVec3, along: DVec3) -> bool {
    let (e1, e2) = (*b - *a, *c - *a);
    let p = along.cross(e2);
    let determinant = e1.dot(p);
    if determinant == 0.0 {
        return false;
    }
    let s = from - *a;
    let u = s.dot(p) / determinant;
    let q = s.cross(e1);
    let v = along.dot(q) / determinant;
    u >= 0.0 && v >= 0.0 && u + v <= 1.0 && e2.dot(q) / determinant > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Primitive;
    use std::sync::Arc;

    /// A box of which single faces may be left out, seen from inside.
    fn room(low: [f32; 3], high: [f32; 3], faces: &[usize]) -> Primitive {
        let corner = |i: usize| std::array::from_fn(|k| if i >> k & 1 == 1 { high[k] } else { low[k] });
        let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let triangles = faces.iter().flat_map(|&face| {
            let [a, b, c, d] = quads[face];
            // Wound outward above, so turned here.
            [[a, c, b], [a, d, c]]
        });
        Primitive { positions: (0..8).map(corner).collect(), triangles: triangles.collect(), ..Primitive::default() }
    }

    fn scene(parts: Vec<(&str, Primitive, u32)>, occludes: Option<bool>) -> Scene {
        let materials = vec![Material { double_sided: true, ..Material::default() }, Material { occludes, ..Material::default() }];
        let object = |(name, primitive, material): (&str, Primitive, u32)| Object {
            name: name.to_string(),
            mesh: Arc::new(Mesh { primitives: vec![Primitive { material, ..primitive }] }),
            world_from_local: crate::node::IDENTITY,
        };
        Scene { objects: parts.into_iter().map(object).collect(), materials, ..Scene::default() }
    }

    const ALL: [usize; 6] = [0, 1, 2, 3, 4, 5];

    #[test]
    fn a_dome_a_box_and_a_closed_room_are_named_and_open_scenes_are_not() {
        let floor = || ("floor", room([-2.0, 0.0, -2.0], [2.0, 0.5, 2.0], &[2]), 0);
        let crate_ = || ("crate", room([-0.5, 0.0, -0.5], [0.5, 1.0, 0.5], &ALL), 0);
        let around = |faces: &[usize]| ("backdrop", room([-9.0; 3], [9.0; 3], faces), 1);
        let walls = || (0..6).map(|face| (["w0", "w1", "w2", "w3", "w4", "w5"][face], room([-9.0; 3], [9.0; 3], &[face]), 1));
        let named = |parts: Vec<(&str, Primitive, u32)>, occludes: Option<bool>| warnings(&scene(parts, occludes));
        let text = named(vec![floor(), crate_(), around(&ALL)], None);
        assert!(text.len() == 1 && text[0].starts_with("backdrop encloses the scene") && text[0].contains("occludes = false"), "{text:?}");
        assert_eq!(named(vec![around(&ALL)], None).len(), 1, "an empty room");
        let text = named(walls().chain([floor()]).collect(), None);
        assert!(text.len() == 1 && text[0].starts_with("w0, w1, w2 and 3 more enclose the scene"), "{text:?}");
        assert!(named(vec![floor(), crate_(), around(&ALL)], Some(false)).is_empty(), "opened by its material");
        assert!(named(vec![floor(), crate_(), around(&ALL[1..])], None).is_empty(), "an open side");
        assert!(named(walls().skip(1).chain([floor()]).collect(), None).is_empty(), "an open side");
        assert!(named(vec![floor(), crate_()], None).is_empty());
        assert!(named(vec![crate_()], None).is_empty(), "a crate alone is seen from outside");
        assert!(named(Vec::new(), None).is_empty());
    }
}
