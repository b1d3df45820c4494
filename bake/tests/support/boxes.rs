//! Boxes for scenes of tests.

use prelight_scene::Primitive;

/// A box from the origin on, its corners its own on every face.
pub fn cuboid(size: [f32; 3]) -> Primitive {
    let corner = |k: usize| [0, 1, 2].map(|axis| if k >> axis & 1 == 1 { size[axis] } else { 0.0 });
    let mut primitive = Primitive::default();
    for face in [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]] {
        let first = primitive.positions.len() as u32;
        primitive.positions.extend(face.map(corner));
        primitive.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    primitive
}
