//! Origin of a scene that lies far from its file's: what positions are counted from, so that f32 resolves them.
//!
//! f32 has 24 bits. Of a building of 20 m at 4,500 km from the origin it keeps half a metre, and everything that follows (points, rays, their
//! offsets) would see a heap of steps. So where a scene's centre lies more than [`FAR`] times its size from the file's origin, along
//! any axis, whole steps of a power of two are taken off there, in f64, before anything is rounded. Near the origin nothing changes.
//!
//! Translations of nodes beyond [`EXACT_FROM`] are read in f64 for the same reason.

use super::accessor::Buffers;
use super::node::{Matrix, Placed};
use super::pose::Shape;
use super::{Object, Scene};
use gltf::json::mesh::Semantic;
use gltf::json::validation::Checked;
use serde_json::Value;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Distance of the centre, in half diagonals of the scene, from which on it is moved: f32 resolves 30 millionths of the scene there.
const FAR: f64 = 256.0;
/// Translations with a component of at least this size keep all bits of the file, metres: an f32 there is a millimetre off.
pub(crate) const EXACT_FROM: f64 = 8192.0;

/// Translations in f64 by node, where they are far.
pub(crate) type Far = BTreeMap<usize, [f64; 3]>;

/// Finds the far translations of a description, of `translation` and of `matrix`.
pub(crate) fn far_translations(description: &Value) -> Far {
    let nodes = description.get("nodes").and_then(Value::as_array).into_iter().flatten();
    let translation = |(index, node): (usize, &Value)| {
        let (list, first) = match node.get("matrix") {
            Some(matrix) => (matrix, 12),
            None => (node.get("translation")?, 0),
        };
        let list = list.as_array()?;
        let mut exact = [0.0; 3];
        for (k, value) in exact.iter_mut().enumerate() {
            *value = list.get(first + k)?.as_f64()?;
        }
        exact.iter().any(|value| value.abs() >= EXACT_FROM).then_some((index, exact))
    };
    nodes.enumerate().filter_map(translation).collect()
}

/// Bounds that grow, in f64.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    low: [f64; 3],
    high: [f64; 3],
}

impl Default for Bounds {
    fn default() -> Self {
        Bounds { low: [f64::INFINITY; 3], high: [f64::NEG_INFINITY; 3] }
    }
}

impl Bounds {
    /// Takes in a box of local space, placed.
    fn add(&mut self, matrix: &Matrix, low: [f64; 3], high: [f64; 3]) {
        for corner in 0..8 {
            let p: [f64; 3] = std::array::from_fn(|k| if corner >> k & 1 == 0 { low[k] } else { high[k] });
            for k in 0..3 {
                let x = matrix[k] * p[0] + matrix[4 + k] * p[1] + matrix[8 + k] * p[2] + matrix[12 + k];
                if x.is_finite() {
                    (self.low[k], self.high[k]) = (self.low[k].min(x), self.high[k].max(x));
                }
            }
        }
    }

    /// Takes in a point.
    pub fn point(&mut self, point: [f64; 3]) {
        self.add(&super::node::IDENTITY, point, point);
    }

    /// What to count positions from: zero along each axis that is near, else a multiple of a power of two that is about the scene's size.
    pub fn origin(&self) -> [f64; 3] {
        let half: [f64; 3] = std::array::from_fn(|k| (self.high[k] - self.low[k]) / 2.0);
        let size = (half[0] * half[0] + half[1] * half[1] + half[2] * half[2]).sqrt();
        if !size.is_finite() {
            return [0.0; 3];
        }
        // At least a metre: round numbers are easier to read.
        let mut step = 1.0f64;
        while step < size {
            step *= 2.0;
        }
        std::array::from_fn(|k| {
            let centre = self.low[k] + half[k];
            if centre.abs() > FAR * size.max(1.0) { (centre / step).round() * step } else { 0.0 }
        })
    }
}

/// The origin of a file's nodes, by the bounds that its accessors claim. `joints` are the matrices of each skin.
pub(crate) fn of_nodes(
    buffers: &Buffers,
    placed: &[Placed],
    (shapes, shape_of): (&[Shape], &[usize]),
    joints: &[Arc<Vec<Matrix>>],
) -> [f64; 3] {
    let root = buffers.root;
    let numbers = |value: &Option<Value>| -> Option<[f64; 3]> {
        let list = value.as_ref()?.as_array()?;
        Some([list.first()?.as_f64()?, list.get(1)?.as_f64()?, list.get(2)?.as_f64()?])
    };
    let boxes: Vec<Option<([f64; 3], [f64; 3])>> = (root.meshes.iter())
        .map(|mesh| {
            let positions = mesh.primitives.iter().filter_map(|p| p.attributes.get(&Checked::Valid(Semantic::Positions)));
            let claimed = positions.filter_map(|index| {
                let accessor = root.accessors.get(index.value())?;
                Some((numbers(&accessor.min)?, numbers(&accessor.max)?))
            });
            claimed.reduce(|a, b| {
                let pick = |f: fn(f64, f64) -> f64, a: [f64; 3], b: [f64; 3]| std::array::from_fn(|k| f(a[k], b[k]));
                (pick(f64::min, a.0, b.0), pick(f64::max, a.1, b.1))
            })
        })
        .collect();
    let mut bounds = Bounds::default();
    for (placed, shape) in placed.iter().zip(shape_of) {
        let shape = &shapes[*shape];
        let (low, high) = boxes[shape.mesh].unwrap_or_default();
        let joints = shape.skin.and_then(|skin| joints.get(skin)).map(|joints| joints.as_slice()).unwrap_or_default();
        match joints {
            [] => bounds.add(&placed.world_from_local, low, high),
            joints => joints.iter().for_each(|joint| bounds.add(joint, low, high)),
        }
    }
    bounds.origin()
}

/// Counts nodes, and what is posed by them, from an origin.
pub(crate) fn move_nodes(origin: [f64; 3], placed: &mut [Placed], shapes: &mut [Shape], joints: &mut [Arc<Vec<Matrix>>]) {
    if origin == [0.0; 3] {
        return;
    }
    placed.iter_mut().for_each(|placed| shift(&mut placed.world_from_local, origin, -1.0));
    shapes.iter_mut().filter_map(|shape| shape.rest.as_mut()).for_each(|rest| shift(rest, origin, -1.0));
    joints.iter_mut().flat_map(Arc::make_mut).for_each(|joint| shift(joint, origin, -1.0));
}

/// Moves a scene whose objects are counted from the file's origin, where it is far; cameras are the caller's to place.
pub(crate) fn recentre(scene: &mut Scene) {
    let mut bounds = Bounds::default();
    for object in &scene.objects {
        let points = object.mesh.primitives.iter().flat_map(|primitive| &primitive.positions);
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for point in points {
            for k in 0..3 {
                let x = f64::from(point[k]);
                (low[k], high[k]) = (low[k].min(x), high[k].max(x));
            }
        }
        if low[0] <= high[0] {
            bounds.add(&object.world_from_local, low, high);
        }
    }
    scene.origin = bounds.origin();
    if scene.origin != [0.0; 3] {
        scene.objects.iter_mut().for_each(|Object { world_from_local, .. }| shift(world_from_local, scene.origin, -1.0));
    }
}

/// Adds `sign` times the origin to a transform's translation.
pub(crate) fn shift(matrix: &mut Matrix, origin: [f64; 3], sign: f64) {
    (0..3).for_each(|k| matrix[12 + k] += sign * origin[k]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::node::IDENTITY;

    fn origin(low: [f64; 3], high: [f64; 3]) -> [f64; 3] {
        let mut bounds = Bounds::default();
        bounds.add(&IDENTITY, low, high);
        bounds.origin()
    }

    #[test]
    fn only_axes_that_are_far_are_moved_and_by_round_numbers() {
        assert_eq!(origin([-5.0, 0.0, -5.0], [5.0, 3.0, 5.0]), [0.0; 3]);
        assert_eq!(origin([995.0, 0.0, -5.0], [1005.0, 3.0, 5.0]), [0.0; 3]);
        assert_eq!(origin([999_997.5, 0.0, -1_000_002.5], [1_000_002.5, 3.0, -999_997.5]), [1_000_000.0, 0.0, -1_000_000.0]);
        let [x, y, z] = origin([4_498_000.3, 12.0, 1.0], [4_500_000.3, 40.0, 2.0]);
        assert_eq!((x % 1024.0, y, z), (0.0, 0.0, 0.0));
        assert!((x - 4_499_000.3).abs() <= 512.0);
        assert_eq!(Bounds::default().origin(), [0.0; 3]);
    }

    #[test]
    fn far_translations_keep_every_bit() {
        let json = serde_json::json!({ "nodes": [
            { "translation": [4_500_000.25, 1.0, 0.1] }, { "translation": [1.5, 2.0, 0.1] }, {},
            { "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 123_456.789, 0, 1] }, { "translation": ["a", 1e6, 0] },
        ] });
        let far = far_translations(&json);
        assert_eq!(far, BTreeMap::from([(0, [4_500_000.25, 1.0, 0.1]), (3, [0.0, 123_456.789, 0.0])]));
    }
}
