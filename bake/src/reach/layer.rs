//! Layers of occluders: big things are traced first, so that a smaller one enters a key only where the big ones left a tile open.
//!
//! A triangle's layer comes from the size of the **connected component** of its object that it belongs to, so that a merged whole-house
//! mesh is not one thing. Components share corners of equal world position bits; size is the longest side of the component's bounds in the
//! object's own space, times the length of the transform's columns: metres, the same however the object is turned.
//!
//! ```text
//! layer k:  size >= LIMITS[k], the first that holds; the last layer has the rest
//! ```
//!
//! Never from the size of the scene, a rank or a neighbour: a far tree does not move a chair to another layer. `[[object]] layer` in
//! scene.toml overrides all of an object's components. Layers decide keys and time, never a bit of the result.

use prelight_scene::Scene;
use prelight_scene::world::{Occlusion, World, WorldPrimitive};
use rayon::prelude::*;
use std::collections::HashMap;

/// Layers at most.
pub const MAX_LAYERS: usize = 4;

/// Least size of the first layers, metres: architecture, furniture, things; the last layer takes what is smaller.
pub(crate) const LIMITS: [f64; MAX_LAYERS - 1] = [4.0, 1.0, 0.25];

/// The layer of a size in metres.
pub(crate) fn layer_of_size(size: f64) -> u8 {
    LIMITS.iter().position(|limit| size >= *limit).unwrap_or(MAX_LAYERS - 1) as u8
}

/// `[triangles of the world]` layers. `fixed`: one per object, what the manifest says; may be shorter.
pub fn layers(scene: &Scene, world: &World, fixed: &[Option<u8>]) -> Vec<u8> {
    let of_object = |object: usize| -> Vec<u8> {
        let first = world.primitives.partition_point(|p| (p.object as usize) < object);
        let end = world.primitives.partition_point(|p| p.object as usize <= object);
        let parts = &world.primitives[first..end];
        match fixed.get(object).copied().flatten() {
            Some(layer) => {
                let triangles = parts.iter().map(|part| part.triangles.len()).sum();
                vec![layer.min(MAX_LAYERS as u8 - 1); triangles]
            }
            None => Components::new(scene, world, object, parts).layers(parts),
        }
    };
    (0..scene.objects.len()).into_par_iter().flat_map_iter(of_object).collect()
}

/// Connected components of one object: a forest over its distinct places.
struct Components {
    parent: Vec<u32>,
    /// `[places]` bounds of the component at its root, metres in the object's own axes.
    bounds: Vec<[[f64; 3]; 2]>,
    /// First vertex of each part in `place`.
    first: Vec<usize>,
    /// `[vertices of all parts]`.
    place: Vec<u32>,
}

impl Components {
    fn new(scene: &Scene, world: &World, object: usize, parts: &[WorldPrimitive]) -> Components {
        let source = &scene.objects[object];
        let m = &source.world_from_local;
        let scale: [f64; 3] =
            std::array::from_fn(|k| (m[4 * k] * m[4 * k] + m[4 * k + 1] * m[4 * k + 1] + m[4 * k + 2] * m[4 * k + 2]).sqrt());
        let mut components = Components { parent: Vec::new(), bounds: Vec::new(), first: Vec::new(), place: Vec::new() };
        let mut places: HashMap<[u32; 3], u32> = HashMap::new();
        for part in parts {
            components.first.push(components.place.len());
            for position in &part.positions {
                let next = places.len() as u32;
                components.place.push(*places.entry(position.map(f32::to_bits)).or_insert(next));
            }
        }
        components.parent = (0..places.len() as u32).collect();
        let occludes = |part: &WorldPrimitive, k: usize| world.occlusion[part.first_triangle as usize + k] != Occlusion::None;
        for (part, &first) in parts.iter().zip(&components.first.clone()) {
            for (_, triangle) in part.triangles.iter().enumerate().filter(|(k, _)| occludes(part, *k)) {
                let [a, b, c] = triangle.map(|v| components.place[first + v as usize]);
                components.join(a, b);
                components.join(b, c);
            }
        }
        components.bounds = vec![[[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]]; places.len()];
        for (part, &first) in parts.iter().zip(&components.first.clone()) {
            let local = &source.mesh.primitives[part.primitive as usize].positions;
            for (_, triangle) in part.triangles.iter().enumerate().filter(|(k, _)| occludes(part, *k)) {
                for vertex in triangle {
                    let root = components.root(components.place[first + *vertex as usize]) as usize;
                    for axis in 0..3 {
                        let at = f64::from(local[*vertex as usize][axis]) * scale[axis];
                        let [lower, upper] = &mut components.bounds[root];
                        lower[axis] = lower[axis].min(at);
                        upper[axis] = upper[axis].max(at);
                    }
                }
            }
        }
        components
    }

    /// Halves the path as it walks.
    fn root(&mut self, mut place: u32) -> u32 {
        while self.parent[place as usize] != place {
            let above = self.parent[self.parent[place as usize] as usize];
            self.parent[place as usize] = above;
            place = above;
        }
        place
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }

    fn layers(mut self, parts: &[WorldPrimitive]) -> Vec<u8> {
        let mut layers = Vec::with_capacity(parts.iter().map(|part| part.triangles.len()).sum());
        for (k, part) in parts.iter().enumerate() {
            for triangle in &part.triangles {
                let root = self.root(self.place[self.first[k] + triangle[0] as usize]) as usize;
                let [lower, upper] = self.bounds[root];
                // A triangle that blocks nothing may be alone, with empty bounds: any layer will do.
                let size = (0..3).map(|axis| upper[axis] - lower[axis]).fold(0.0, f64::max);
                layers.push(layer_of_size(size));
            }
        }
        layers
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::test_scenes::*;

    fn layers_of(scene: &Scene) -> Vec<u8> {
        layers(scene, &World::build(scene), &[])
    }

    #[test]
    fn limits_are_inclusive() {
        assert_eq!([9.0, 4.0, 3.9, 1.0, 0.9, 0.25, 0.2, 0.0].map(layer_of_size), [0, 0, 1, 1, 2, 2, 3, 3]);
    }

    #[test]
    fn a_merged_mesh_has_the_layers_of_its_parts_and_primitives_that_touch_are_one() {
        let mut scene = scene();
        let wall = quad([0.0; 3], [5.0, 0.0, 0.0], [0.0, 3.0, 0.0], 0);
        // Shares an edge with the wall, in another primitive.
        let ledge = quad([0.0; 3], [0.0, 0.0, 0.1], [5.0, 0.0, 0.0], 1);
        let knob = cuboid([1.0, 1.0, 0.2], [1.1, 1.1, 0.3], false, 0);
        let mut merged = wall.clone();
        let shift = merged.positions.len() as u32;
        merged.positions.extend(&knob.positions);
        merged.triangles.extend(knob.triangles.iter().map(|t| t.map(|v| v + shift)));
        add(&mut scene, "house", vec![merged, ledge], IDENTITY);
        let found = layers_of(&scene);
        assert_eq!(found, [vec![0; 2], vec![3; 12], vec![0; 2]].concat());
        assert_eq!(layers(&scene, &World::build(&scene), &[Some(1)]), vec![1; 16]);
    }

    #[test]
    fn turning_keeps_and_scaling_changes_the_layer_and_neighbours_do_not_matter() {
        let rod = || vec![quad([0.0; 3], [1.1, 0.0, 0.0], [0.0, 0.1, 0.0], 0)];
        let (c, s) = (libm::cos(0.6), libm::sin(0.6));
        let turned = [c, s, 0.0, 0.0, -s, c, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 3.0, 4.0, 5.0, 1.0];
        let mut quarter = turned;
        quarter[..12].iter_mut().for_each(|x| *x *= 0.125);
        let mut scene = scene();
        for (name, matrix) in [("rod", IDENTITY), ("turned", turned), ("small", quarter)] {
            add(&mut scene, name, rod(), matrix);
        }
        assert_eq!(layers_of(&scene), [1, 1, 1, 1, 3, 3]);
        add(&mut scene, "far", vec![quad([1e4, 0.0, 0.0], [500.0, 0.0, 0.0], [0.0, 80.0, 0.0], 0)], IDENTITY);
        assert_eq!(layers_of(&scene), [1, 1, 1, 1, 3, 3, 0, 0]);
    }
}
