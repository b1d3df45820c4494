//! From lobes at points to pixels: lobes are interpolated, then light is looked up.
//!
//! ```text
//! linear(x)  = Σ_k w_k Σ_j α_kj light(μ_kj, κ_kj)          what interpolating light at the corners k of a triangle gives
//! moved(x)   = Σ_j α_j light(μ_j, κ_j),  j of blend(corners' lobes, w)
//! glossy(x)  = interpolated glossy light + moved − linear
//! ```
//!
//! Between the corners of a curved surface a reflection then moves, where interpolated light fades from one place into the next. Light at
//! points stays whole, so whoever reads it needs no pixel stage. A slot that is already a cross-fade of several lobes at a corner, lobes
//! of corners that are too far apart to be one, and corners without a point of their own stay linear. At a corner the correction is 0.
//! Source: \[LD09\] section 6 (slices per vertex, lookup per pixel).

use super::highlight::{self, Highlight};
use super::interpolate::{Blend, blend};
use super::light::FilteredLight;
use super::lobe::{Lobe, luminance};
use super::transfer::SLICE_LOBES;
use crate::light::{BetweenPoints, Glossy, PointLobe};
use bytemuck::{Pod, Zeroable};

/// One lobe of a point toward the eye that it was last shaded for. Black where the slot has none or several.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
struct EyeLobe {
    lobe: Lobe,
    grazing: f32,
    /// Looked up at the point.
    radiance: [f32; 3],
}

/// The lobes of a point toward the eye. 88 bytes.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub struct EyeLobes {
    slots: [EyeLobe; SLICE_LOBES],
}

/// What pixels look lobes up with.
#[derive(Clone, Copy, Debug)]
pub struct PixelLobes<'a> {
    /// The light that the points were shaded in.
    pub light: &'a FilteredLight,
    /// `[points]` of indirect light. Empty: none.
    pub lobes: &'a [EyeLobes],
    /// `[points]` of direct light. Empty: none, it stays linear.
    pub highlights: &'a [Highlight],
}

impl EyeLobes {
    /// Looks the slots of a point up, keeps those that one lobe stands for, and returns their light in both Schlick terms.
    pub(super) fn look_up(&mut self, light: &FilteredLight, slots: &[(Blend, f32); SLICE_LOBES]) -> Glossy {
        let mut glossy = Glossy::default();
        *self = EyeLobes::default();
        for (kept, (blend, grazing)) in self.slots.iter_mut().zip(slots) {
            let radiance = looked_up(light, blend);
            for c in 0..3 {
                glossy[0][c] += radiance[c];
                glossy[1][c] += grazing * radiance[c];
            }
            if let [lobe] = blend.lobes() {
                *kept = EyeLobe { lobe: *lobe, grazing: *grazing, radiance };
            }
        }
        glossy
    }
}

fn looked_up(light: &FilteredLight, blend: &Blend) -> [f32; 3] {
    let mut radiance = [0.0; 3];
    for lobe in blend.lobes().iter().filter(|lobe| lobe.weight != [0.0; 3]) {
        let value = light.lookup(lobe.mu, lobe.kappa);
        (0..3).for_each(|c| radiance[c] += lobe.weight[c] * value[c]);
    }
    radiance
}

/// Adds moved − linear to glossy light that was interpolated between three points that keep these lobes.
pub(super) fn move_lobes(light: &FilteredLight, points: [&EyeLobes; 3], weights: [f32; 3], glossy: &mut Glossy) {
    for slot in 0..SLICE_LOBES {
        let corners = points.map(|point| &point.slots[slot]);
        let say: [f32; 3] = std::array::from_fn(|k| weights[k] * luminance(corners[k].lobe.weight));
        let sum = say[0] + say[1] + say[2];
        if sum <= 0.0 {
            continue;
        }
        let blend = blend(corners.map(|corner| corner.lobe), weights);
        if blend.lobes().len() > 1 {
            continue;
        }
        let moved = looked_up(light, &blend);
        let grazing = (0..3).map(|k| say[k] * corners[k].grazing).sum::<f32>() / sum;
        for c in 0..3 {
            let linear: [f32; 3] = std::array::from_fn(|k| weights[k] * corners[k].radiance[c]);
            glossy[0][c] += moved[c] - (linear[0] + linear[1] + linear[2]);
            glossy[1][c] += grazing * moved[c] - (0..3).map(|k| linear[k] * corners[k].grazing).sum::<f32>();
        }
    }
}

impl BetweenPoints for PixelLobes<'_> {
    fn n_points(&self) -> usize {
        match (self.lobes.len(), self.highlights.len()) {
            (0, 0) => usize::MAX,
            (0, n) | (n, 0) => n,
            (n, m) => n.min(m),
        }
    }

    fn correct(&self, points: [usize; 3], weights: [f32; 3], view: [f32; 3], own: Option<&PointLobe>, glossy: &mut Glossy) {
        if !self.highlights.is_empty() {
            highlight::correct(self.light, points.map(|point| &self.highlights[point]), weights, view, own, glossy);
        }
        if !self.lobes.is_empty() {
            move_lobes(self.light, points.map(|point| &self.lobes[point]), weights, glossy);
        }
        // Differences of sums may fall below nothing by their rounding.
        glossy.iter_mut().flatten().for_each(|value| *value = value.max(0.0));
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::environment::LightCubemap;
    use crate::sphere::cubemap::{texel_solid_angle, texel_unit_direction};

    /// A dark sky with one bright spot about +y.
    pub(crate) fn spot() -> LightCubemap {
        let n = 64;
        let mut light = LightCubemap::black(n);
        for i in 0..6 * n * n {
            let (face, y, x) = (i / (n * n), i / n % n, i % n);
            let d = texel_unit_direction(n, face, x, y);
            let radiance = 0.1 + 20.0 * (60.0 * (d[1] - 1.0)).exp();
            let flux = [radiance * texel_solid_angle(n, x, y) as f32; 3];
            light.flux[i] = flux;
            light.moment[i] = flux.map(|f| d.map(|c| c * f));
        }
        light
    }

    fn look_up(light: &FilteredLight, slots: &[(Blend, f32); SLICE_LOBES]) -> (EyeLobes, Glossy) {
        let mut own = EyeLobes::default();
        let glossy = own.look_up(light, slots);
        (own, glossy)
    }

    /// No direct light: the view does not matter.
    const VIEW: [f32; 3] = [0.0, 1.0, 0.0];

    fn one(angle: f32, kappa: f32) -> (Blend, f32) {
        let lobe = Lobe { weight: [0.8, 0.6, 0.4], mu: [angle.sin(), angle.cos(), 0.0], kappa };
        (blend([lobe; 3], [1.0, 0.0, 0.0]), 0.25)
    }

    fn black() -> (Blend, f32) {
        (blend([Lobe::default(); 3], [1.0, 0.0, 0.0]), 0.0)
    }

    #[test]
    fn a_highlight_between_two_points_is_as_bright_as_it_is_there() {
        let light = FilteredLight::prepare(&spot());
        // The spot is mirrored half way between two points that both look past it.
        let at = |angle: f32| look_up(&light, &[black(), one(angle, 60.0)]);
        let ((left, left_light), (right, right_light), (_, truth)) = (at(-0.1), at(0.1), at(0.0));
        let lobes = [left, right];
        let linear: Glossy = std::array::from_fn(|t| std::array::from_fn(|c| 0.5 * (left_light[t][c] + right_light[t][c])));
        let mut moved = linear;
        PixelLobes { light: &light, lobes: &lobes, highlights: &[] }.correct([0, 1, 0], [0.25, 0.5, 0.25], VIEW, None, &mut moved);
        for term in 0..2 {
            let (before, after) = (linear[term][1] / truth[term][1] - 1.0, moved[term][1] / truth[term][1] - 1.0);
            assert!(before < -0.1 && after.abs() < 0.01, "{term}: {before} {after}");
        }
    }

    #[test]
    fn corners_and_cross_fades_stay_as_they_are() {
        let light = FilteredLight::prepare(&spot());
        let mut far = [one(0.0, 60.0); SLICE_LOBES];
        let apart = [0.0f32, 1.0].map(|angle| Lobe { weight: [0.5; 3], mu: [angle.sin(), angle.cos(), 0.0], kappa: 60.0 });
        far[0] = (blend([apart[0], apart[1], apart[0]], [0.5, 0.5, 0.0]), 0.5);
        assert!(far[0].0.lobes().len() > 1);
        let (near, near_light) = look_up(&light, &[black(), one(0.05, 60.0)]);
        let (faded, faded_light) = look_up(&light, &far);
        let lobes = [near, faded, EyeLobes::default()];
        let drawn = PixelLobes { light: &light, lobes: &lobes, highlights: &[] };
        for (point, own) in [(0, near_light), (1, faded_light), (2, Glossy::default())] {
            let mut got = own;
            drawn.correct([point, 2, (point + 1) % 3], [1.0, 0.0, 0.0], VIEW, None, &mut got);
            let close = |a: &f32, b: &f32| (a - b).abs() <= 1e-5 * b.abs().max(1e-3);
            assert!(got.iter().flatten().zip(own.iter().flatten()).all(|(a, b)| close(a, b)), "{point}: {got:?} {own:?}");
        }
        // Nothing is left of the fade but its light at the point: half way it is halved, whatever the other slot does.
        let fade_only = EyeLobes { slots: [EyeLobe::default(), near.slots[1]] };
        let mut half = [[1.0; 3]; 2];
        PixelLobes { light: &light, lobes: &[fade_only; 3], highlights: &[] }.correct([0, 1, 2], [0.5, 0.5, 0.0], VIEW, None, &mut half);
        assert!(half.iter().flatten().all(|value| (value - 1.0).abs() < 1e-5), "equal lobes need no correction: {half:?}");
    }
}
