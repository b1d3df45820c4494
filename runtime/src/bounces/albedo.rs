//! What the points of an object send on: albedo and emission, means over the surface around each.
//!
//! A triangle's material is taken at its centroid, where it has textures at the centroids of its four quarters, and counts for its corners by its
//! area. A surface of any model sends as if it were matt, with its albedo over all directions.

use crate::brdf::{Measured, Place, Surface};
use crate::chunk::mesh::Mesh;
use crate::surface::{Material, Texture, resolve};

/// Heights at which the albedo of a surface is taken: the middles of four equal shares of n·v², so that their mean is the cosine-weighted one.
const HEIGHTS: [f32; 4] = [0.353_553_4, 0.612_372_4, 0.790_569_4, 0.935_414_3];

/// What a surface sends on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sender {
    /// Share of what it receives, per channel, 0..=1.
    pub albedo: [f32; 3],
    /// Radiance that it sends by itself, W·sr⁻¹·m⁻².
    pub emitted: [f32; 3],
}

/// Albedo over all directions.
fn albedo(surface: &Surface) -> [f32; 3] {
    let place = Place::about([0.0, 0.0, 1.0]);
    let mut sum = [0.0; 3];
    for z in HEIGHTS {
        let toward = surface.albedo(&place, [(1.0 - z * z).sqrt(), 0.0, z]);
        (0..3).for_each(|k| sum[k] += toward[k] / HEIGHTS.len() as f32);
    }
    sum.map(|x| x.clamp(0.0, 1.0))
}

/// Barycentric centroids of a triangle's quarters.
const QUARTERS: [[f32; 3]; 4] =
    [[1.0 / 3.0; 3], [2.0 / 3.0, 1.0 / 6.0, 1.0 / 6.0], [1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0], [1.0 / 6.0, 1.0 / 6.0, 2.0 / 3.0]];

/// Fills in what the points of an object send on. `senders`: `[points of the object]`; those that no triangle has stay black.
pub fn fill_senders(mesh: &Mesh, materials: &[Material], textures: &[Texture], tables: &[Measured], senders: &mut [Sender]) {
    let plain: Vec<Option<Sender>> = materials.iter().map(|material| constant(material, mesh, textures, tables)).collect();
    let mut weights = vec![0.0f32; senders.len()];
    senders.fill(Sender::default());
    for (triangle, corners) in mesh.triangles.iter().enumerate() {
        let (Some(material), corners) = (materials.get(mesh.material[triangle] as usize), corners.map(|v| v as usize)) else { continue };
        let own = plain[mesh.material[triangle] as usize].unwrap_or_else(|| mean(material, mesh, corners, textures, tables));
        let area = area(corners.map(|v| mesh.position[v]));
        for v in corners {
            let (front, back) = (mesh.front(v), mesh.back(v));
            for (point, share) in front.shares().chain(back.shares()) {
                let (weight, sender) = (area * share, &mut senders[point as usize]);
                weights[point as usize] += weight;
                for k in 0..3 {
                    sender.albedo[k] += weight * own.albedo[k];
                    sender.emitted[k] += weight * own.emitted[k];
                }
            }
        }
    }
    for (sender, weight) in senders.iter_mut().zip(weights).filter(|(_, weight)| *weight > 0.0) {
        sender.albedo = sender.albedo.map(|x| x / weight);
        sender.emitted = sender.emitted.map(|x| x / weight);
    }
}

/// What a material sends where nothing on it varies.
fn constant(material: &Material, mesh: &Mesh, textures: &[Texture], tables: &[Measured]) -> Option<Sender> {
    let varies = material.textures().next().is_some() || !mesh.color.is_empty();
    (!varies).then(|| sender(material, textures, tables, [[0.0; 2]; 2], [1.0; 4]))
}

/// The mean over a triangle.
fn mean(material: &Material, mesh: &Mesh, corners: [usize; 3], textures: &[Texture], tables: &[Measured]) -> Sender {
    let mix = |weights: [f32; 3], at: usize, of: &dyn Fn(usize, usize) -> f32| (0..3).map(|k| weights[k] * of(corners[k], at)).sum::<f32>();
    let mut sum = Sender::default();
    for weights in QUARTERS {
        let uv = |set: &[[f32; 2]]| if set.is_empty() { [0.0; 2] } else { [0, 1].map(|at| mix(weights, at, &|v, k| set[v][k])) };
        let color = if mesh.color.is_empty() { [1.0; 4] } else { [0, 1, 2, 3].map(|at| mix(weights, at, &|v, k| mesh.color[v][k])) };
        let own = sender(material, textures, tables, [uv(mesh.uv0), uv(mesh.uv1)], color);
        for k in 0..3 {
            sum.albedo[k] += own.albedo[k] / QUARTERS.len() as f32;
            sum.emitted[k] += own.emitted[k] / QUARTERS.len() as f32;
        }
    }
    sum
}

fn sender(material: &Material, textures: &[Texture], tables: &[Measured], [uv0, uv1]: [[f32; 2]; 2], color: [f32; 4]) -> Sender {
    let sample = resolve(material, textures, uv0, uv1, color);
    // An unlit surface is a picture: it is seen, and lights nothing.
    if sample.unlit { Sender::default() } else { Sender { albedo: albedo(&sample.surface(tables)), emitted: sample.emissive } }
}

fn area(corners: [[f32; 3]; 3]) -> f32 {
    let edge = |k: usize| -> [f32; 3] { std::array::from_fn(|i| corners[k][i] - corners[0][i]) };
    let ([a, b, c], [d, e, f]) = (edge(1), edge(2));
    let normal = [b * f - c * e, c * d - a * f, a * e - b * d];
    0.5 * normal.iter().map(|x| x * x).sum::<f32>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chunk::mesh::NO_POINT;
    use crate::surface::Model;

    #[test]
    fn a_matt_surface_sends_its_colour_and_a_lamp_its_light() {
        let matt = Material { base_color: [0.8, 0.4, 0.2, 1.0], model: Model::Lambert, emissive: [1.0, 2.0, 3.0], ..Material::default() };
        let white = Material { roughness: 0.5, ..Material::default() };
        let position = [[0.0; 3], [2.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]];
        let mesh = Mesh {
            position: &position,
            normal: &[[0.0, 0.0, 1.0]; 4],
            point_front: &[0, 1, 2, 3],
            point_back: &[NO_POINT; 4],
            triangles: &[[0, 1, 2], [0, 2, 3]],
            material: &[0, 1],
            ..Mesh::default()
        };
        let mut senders = [Sender::default(); 5];
        fill_senders(&mesh, &[matt, white], &[], &[], &mut senders);
        // A quarter of a part in a million: sums of four f32.
        assert!(senders[1].albedo.iter().zip([0.8, 0.4, 0.2]).all(|(a, b)| (a - b).abs() < 1e-6), "{:?}", senders[1]);
        assert_eq!((senders[1].emitted, senders[4]), ([1.0, 2.0, 3.0], Sender::default()));
        // A glTF dielectric's base is covered once more than it should be for energy: it returns somewhat less than all.
        assert!(senders[3].albedo.iter().all(|a| (0.85..=1.0).contains(a)), "{:?}", senders[3]);
        // Areas 1 and 1/2: two thirds of the lamp.
        assert!((senders[0].emitted[0] - 2.0 / 3.0).abs() < 1e-6, "{:?}", senders[0]);
    }
}
