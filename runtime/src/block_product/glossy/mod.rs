//! Glossy light: a lobe times light over the open texels, as finely as it matters.
//!
//! ```text
//! B[s][c] = Σ_open flux_c · g_s(l)         g: `light::TexelLobe`, s = 0 the factor of F0, s = 1 that of F90
//! ```
//!
//! Three levels: blocks of 16×16 texels, cells of 4×4, texels; sixteen of a kind at a time. For a block or cell with light W, mean direction of
//! the light c, radius r (every texel within r of c) and mean square spread σ²:
//!
//! ```text
//! matters   W · max g > 0.03 τ                max g over the ball of radius r around c
//! bent      W · max g · κ σ² > τ              what one sample at c can miss, the mean of a linear function being exact
//! skewed    W · max g · 0.6 √(κ σ²) > τ       what one sample at c can miss of a part of the cell, whose mean is elsewhere
//! ```
//!
//! with max g and κ of each lobe from [`formula`]. A fully open block or cell that is not bent is one sample at c; the open part of a block that is
//! not bent is one at its own mean direction ([`open_part`]). A bent block is taken apart to cells; a bent cell, or a skewed one with hidden
//! texels, to texels. The open texels of a cell that is neither take the value at c. What does not matter is dropped: losses add up, hence
//! the small share. Runs across the horizon of the normal count as bent and skewed. A block of which no cell is near either skips its
//! cells' tests. So the light decides the effort, not an angle.
//!
//! τ is the accuracy's `relative` times the result, for cells a quarter of that. The result is guessed to be that of the point
//! before (of the first one: from the brightness around the lobe), and summed once more where the guess was more than four times too high.
//! Results below the accuracy's `floor` of the sphere's mean radiance are held to that instead.
//!
//! A lobe that needs normalising, at grazing views, is summed over the solid angles of all texels in the same way first. A measured lobe has
//! no κ: what matters of it is taken apart to the texels, the exact sparse product.
//! Lossy: by about the accuracy; how often by more, see [`Accuracy`]. A relative 0 gives the plain sum, 100 dB and better.

pub(crate) mod formula;
mod groups;
mod open_part;
mod parts;
mod seen;
mod sum;

use super::light::Light;
use super::visibility::Visibility;
use crate::chunk::surface::PointSurfaces;
use crate::light::{Accuracy, GLOSSY_FLOOR, GLOSSY_TOLERANCE, Glossy, PointLobe, SimdPath, TexelLobe, lanes};
use formula::Lobe;
use seen::Seen;
use sum::{Guess, Over};

/// Share of the threshold for what is dropped: losses add up, while errors of samples differ in sign. Above it, decibels fall faster than time.
const DROPPED: f32 = 0.03;
/// Threshold of a cell, relative to a block's: there are sixteen of them.
const CELL_SHARE: f32 = 0.25;

/// Glossy radiance of GGX surfaces of a patch toward `eye`, W·sr⁻¹·m⁻², to [`Accuracy::FINE`].
///
/// `position` in metres, `surfaces` normals and roughnesses of the same points. See [`shade_lobes`].
pub fn shade_glossy(
    light: &Light,
    position: &[[f32; 3]],
    surfaces: &PointSurfaces,
    visibility: &Visibility,
    eye: [f32; 3],
    out: &mut [Glossy],
) {
    shade_glossy_with(SimdPath::detect(), GLOSSY_TOLERANCE, light, position, surfaces, visibility, eye, out);
}

/// [`shade_glossy`] with chosen instructions (falls back where the CPU lacks them) and relative error.
pub fn shade_glossy_with(
    path: SimdPath,
    tolerance: f32,
    light: &Light,
    position: &[[f32; 3]],
    surfaces: &PointSurfaces,
    visibility: &Visibility,
    eye: [f32; 3],
    out: &mut [Glossy],
) {
    let n = visibility.len();
    assert!(surfaces.normal.len() == n && surfaces.roughness.len() == n, "one per point");
    let accuracy = Accuracy { relative: tolerance, floor: GLOSSY_FLOOR };
    let lobe = |i: usize| PointLobe::ggx(surfaces.normal[i], surfaces.roughness[i]);
    shade_lobes(path, accuracy, light, position, lobe, visibility, eye, out);
}

/// Glossy radiance of every point of a patch toward `eye`, W·sr⁻¹·m⁻²; `lobe` tells what a point reflects with.
///
/// The visibility holds the horizon of n_s, and texels below a bent normal add nothing. A point whose normal is turned away from the eye is
/// seen at grazing, see [`crate::brdf::ggx::lift_view`]. `out` has one element per point. Does not allocate. Error: `accuracy`.
/// Panics when lengths or resolutions disagree.
pub fn shade_lobes<'a>(
    path: SimdPath,
    accuracy: Accuracy,
    light: &Light,
    position: &[[f32; 3]],
    lobe: impl Fn(usize) -> PointLobe<'a>,
    visibility: &Visibility,
    eye: [f32; 3],
    out: &mut [Glossy],
) {
    let n = visibility.len();
    assert!(out.len() == n && position.len() == n, "one per point");
    assert_eq!(light.face_resolution(), visibility.face_resolution(), "light and visibility of the same cubemap");
    let path = path.available();
    let blocks = light.flux.blocks.weight.len();
    let floor = accuracy.floor * light.mean_radiance;
    let least = open_part::LEAST * 4.0 * std::f32::consts::PI * light.mean_radiance;
    let (everything, mut seen) = (Seen::everything(blocks), Seen::new());
    // What the neighbour before gave is the best guess of a result.
    let mut guess = 0.0;
    for point in 0..n {
        let own = lobe(point);
        let toward: [f32; 3] = std::array::from_fn(|k| eye[k] - position[point][k]);
        let length = toward.iter().map(|x| f64::from(*x) * f64::from(*x)).sum::<f64>().sqrt();
        // An eye at the point sees it along its normal.
        let view = if length > 0.0 { toward.map(|x| (f64::from(x) / length) as f32) } else { own.normal };
        let mut texel_lobe = TexelLobe::new(&own, view, light.face_resolution());
        if texel_lobe.needs_normalising() {
            let threshold = accuracy.relative * texel_lobe.albedo() as f32;
            let (lobe, light) = (&Lobe::new(&texel_lobe), &light.solid_angle);
            let energy = Over::<true> { lobe, light, seen: &everything, point: None, suffix: &[], least: 0.0, threshold };
            texel_lobe.normalise(f64::from(lanes::run(path, energy)[0][0]));
        }
        let visible = visibility.point(point);
        seen.set(&visible);
        let lobe = &Lobe::new(&texel_lobe);
        if point == 0 {
            let albedo = texel_lobe.albedo() as f32;
            let first = Guess { lobe, flux: &light.flux.blocks, solid_angle: &light.solid_angle.blocks, seen: &seen, albedo };
            guess = lanes::run(path, first).max(floor);
        }
        loop {
            let threshold = accuracy.relative * guess;
            let (suffix, flux) = (&light.suffix[..], &light.flux);
            out[point] =
                lanes::run(path, Over::<false> { lobe, light: flux, seen: &seen, point: Some(&visible), suffix, least, threshold });
            let result = out[point].as_flattened().iter().sum::<f32>().max(floor);
            let too_high = guess > 4.0 * result;
            guess = result;
            // An infinite guess, from light near the end of f32, is not worth a second pass.
            if !too_high || !threshold.is_finite() {
                break;
            }
        }
    }
}
