//! Indirect light at points: what other surfaces send, added to the direct light that [`crate::block_product`] computes exactly.
//!
//! ```text
//! irradiance += n · Σ_j α_j light(μ_j, κ_j)                            n: the point's normal
//! glossy     += Σ_j (1, grazing_j) α_j light(μ_j, κ_j)                 j over the blend of the three nearest slices
//! ```
//!
//! Both go into the buffers that drawing reads, so base colour, metalness and F0 are applied per pixel.
//!
//! Lossy: irradiance has no direction of its own (on the bent normals of a map it counts as coming evenly, [`crate::light::lune`]); between points glossy light is what
//! [`super::pixel`] makes of it; slices carry single scattering of as many bounces as were baked, and their interpolation error.

use super::interpolate::{Blend, blend};
use super::light::FilteredLight;
use super::pixel::EyeLobes;
use super::transfer::{PointTransfer, Record, SLICE_LOBES, Transfer, TransferLobe, decode};
use crate::light::Glossy;
use crate::light::lune::BentLight;
use crate::sphere::frame::tangents;
use crate::sphere::icosahedron::Icosahedron;

/// Adds indirect irradiance of every point of a patch, as a vector along its normal and to second moments. All slices have one element a
/// point, `second` may have none.
pub fn add_irradiance(
    light: &FilteredLight,
    transfer: &Transfer,
    normal: &[[f32; 3]],
    irradiance: &mut [[[f32; 3]; 3]],
    second: &mut [[f32; 6]],
) {
    for i in 0..transfer.len() {
        let received = radiance_of(light, transfer.point(i).irradiance);
        for c in 0..3 {
            (0..3).for_each(|k| irradiance[i][c][k] += received[c] * normal[i][k]);
        }
        if let Some(second) = second.get_mut(i) {
            BentLight::add_even(second, received);
        }
    }
}

fn radiance_of(light: &FilteredLight, records: &[Record]) -> [f32; 3] {
    let mut sum = [0.0; 3];
    for record in records {
        let lobe = decode(record).lobe;
        if lobe.weight != [0.0; 3] {
            let value = light.lookup(lobe.mu, lobe.kappa);
            (0..3).for_each(|c| sum[c] += lobe.weight[c] * value[c]);
        }
    }
    sum
}

/// Adds indirect glossy light of every point of a patch toward `eye`, and keeps its lobes for the pixels between points in `lobes`, whatever they
/// held. `normal`: the glossy normals that the slices were baked about.
pub fn add_glossy(
    light: &FilteredLight,
    solid: &Icosahedron,
    transfer: &Transfer,
    position: &[[f32; 3]],
    normal: &[[f32; 3]],
    eye: [f32; 3],
    glossy: &mut [Glossy],
    lobes: &mut [EyeLobes],
) {
    for i in 0..transfer.len() {
        lobes[i] = add_glossy_at(light, solid, &transfer.point(i), position[i], normal[i], eye, &mut glossy[i]);
    }
}

/// [`add_glossy`] of one point; returns its lobes.
pub(super) fn add_glossy_at(
    light: &FilteredLight,
    solid: &Icosahedron,
    point: &PointTransfer,
    position: [f32; 3],
    normal: [f32; 3],
    eye: [f32; 3],
    glossy: &mut Glossy,
) -> EyeLobes {
    let mut lobes = EyeLobes::default();
    let toward: [f32; 3] = std::array::from_fn(|k| eye[k] - position[k]);
    let length = (toward[0] * toward[0] + toward[1] * toward[1] + toward[2] * toward[2]).sqrt();
    if point.level.is_none() || length <= 0.0 || !length.is_finite() {
        return lobes;
    }
    let view = toward.map(|c| c / length);
    let light = lobes.look_up(light, &slot_lobes(solid, point, normal, view));
    for (sum, term) in glossy.iter_mut().zip(light) {
        (0..3).for_each(|c| sum[c] += term[c]);
    }
    lobes
}

/// The lobes of a point toward a view, world space: for each slot the blend of the three slices around it. None of them is black.
pub fn glossy_lobes(
    solid: &Icosahedron,
    point: &PointTransfer,
    normal: [f32; 3],
    view: [f32; 3],
) -> impl Iterator<Item = (super::Lobe, f32)> {
    slot_lobes(solid, point, normal, view).into_iter().flat_map(|(blend, grazing)| {
        let n = blend.lobes().len();
        (0..n).map(move |i| (blend.lobes()[i], grazing)).filter(|(lobe, _)| lobe.weight != [0.0; 3])
    })
}

/// The same slot by slot, black ones too, each with its second Schlick term.
pub fn slot_lobes(solid: &Icosahedron, point: &PointTransfer, normal: [f32; 3], view: [f32; 3]) -> [(Blend, f32); SLICE_LOBES] {
    let (t, b) = tangents(normal);
    let along = |axis: [f32; 3]| axis[0] * view[0] + axis[1] * view[1] + axis[2] * view[2];
    let found = solid.locate(point.level.unwrap_or(0), [along(t), along(b), along(normal)]);
    std::array::from_fn(|slot| {
        let lobes: [TransferLobe; 3] = found.places.map(|place| point.slice(solid, place, slot));
        let say: [f32; 3] = std::array::from_fn(|k| found.weights[k] * super::lobe::luminance(lobes[k].lobe.weight));
        let sum = say[0] + say[1] + say[2];
        let grazing = if sum > 0.0 { (0..3).map(|k| say[k] * lobes[k].grazing).sum::<f32>() / sum } else { 0.0 };
        (blend(lobes.map(|l| l.lobe), found.weights), grazing)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::LightCubemap;
    use crate::sphere::cubemap::{texel_solid_angle, texel_unit_direction};
    use crate::sphere::icosahedron::MAX_LEVEL;
    use crate::vmf_transfer::Lobe;
    use crate::vmf_transfer::transfer::{PointRecords, encode, n_words};

    fn sky() -> LightCubemap {
        let n = 64;
        let mut light = LightCubemap::black(n);
        for i in 0..6 * n * n {
            let (face, y, x) = (i / (n * n), i / n % n, i % n);
            let d = texel_unit_direction(n, face, x, y);
            let flux = [(1.0 + d[1]) * texel_solid_angle(n, x, y) as f32; 3];
            light.flux[i] = flux;
            light.moment[i] = flux.map(|f| d.map(|c| c * f));
        }
        light
    }

    #[test]
    fn constant_slices_give_the_sum_of_their_lobes_whatever_the_view() {
        let (solid, light) = (Icosahedron::new(MAX_LEVEL), FilteredLight::prepare(&sky()));
        let lobe = |weight: f32, mu: [f32; 3]| TransferLobe { lobe: Lobe { weight: [weight; 3], mu, kappa: 30.0 }, grazing: 0.5 };
        let (a, b) = (lobe(0.25, [0.0, 1.0, 0.0]), lobe(0.125, [0.0, 0.0, 1.0]));
        let black = TransferLobe::default();
        let n_slots = solid.stored(2).len() * SLICE_LOBES;
        let mut kept = vec![u32::MAX; n_words(&solid, 2)];
        kept[n_slots / 32] = (1 << (n_slots % 32)) - 1;
        let slices = (0..n_slots).map(|i| encode(if i % 2 == 0 { &a } else { &b })).collect();
        let own = PointRecords { level: 2, irradiance: vec![encode(&a), encode(&black)], kept, slices };
        let chunk = Transfer::to_chunk(&[own, PointRecords::DARK]);
        let chunk = prelight_store::Chunk::from_plain(&chunk);
        let transfer = Transfer::from_chunk(&chunk, &solid).unwrap();
        let normal = [[0.0, 0.6, 0.8]; 2];
        // A lobe of κ around d sees 1 + A(κ)·d_y of this sky.
        let mean = 1.0 - 1.0 / 30.0;
        let expected = 0.25 * (1.0 + mean) + 0.125;
        for eye in [[0.0, 5.0, 5.0], [3.0, 1.0, 2.0], [-4.0, 0.0, 0.1], [0.0, 0.6, 0.8]] {
            let mut glossy = [[[0.0; 3]; 2]; 2];
            add_glossy(&light, &solid, &transfer, &[[0.0; 3]; 2], &normal, eye, &mut glossy, &mut [EyeLobes::default(); 2]);
            assert!((glossy[0][0][1] / expected - 1.0).abs() < 0.01, "{eye:?}: {glossy:?}");
            assert!((glossy[0][1][1] / glossy[0][0][1] - 0.5).abs() < 1e-3);
            assert_eq!(glossy[1], [[0.0; 3]; 2]);
        }
        let mut irradiance = [[[0.0; 3]; 3]; 2];
        add_irradiance(&light, &transfer, &normal, &mut irradiance, &mut []);
        let along: f32 = (0..3).map(|k| irradiance[0][0][k] * normal[0][k]).sum();
        assert!((along / (0.25 * (1.0 + mean)) - 1.0).abs() < 0.01, "{along}");
        assert_eq!(irradiance[1], [[0.0; 3]; 3]);
        let mut at_the_point = [[[0.0; 3]; 2]; 2];
        add_glossy(&light, &solid, &transfer, &[[1.0; 3]; 2], &normal, [1.0; 3], &mut at_the_point, &mut [EyeLobes::default(); 2]);
        assert_eq!(at_the_point[0], [[0.0; 3]; 2], "no view from inside the point");
    }
}
