//! Direct glossy light between points: what an open sky would reflect is looked up per pixel, what blocks it is interpolated.
//!
//! ```text
//! open(n, v, κ) = light(v mirrored about n, κ)                                  κ = 1 / (2 α² n·v), an exponent itself for Phong
//! direct(x)     = D + (open(x) − O) · min(D / O, MOST_RATIO)                    D = Σ_k w_k D_k, O = Σ_k w_k open_k, each channel and term
//! ```
//!
//! D_k is the exact direct light of corner k, from [`crate::block_product`]; normals and ln κ are interpolated, the view is the pixel's own. The
//! ratio holds what the lobe leaves out: visibility, shadowing, the lobe's foot. At a corner nothing is added, whatever the lobe is worth; in
//! between a highlight moves over a curved surface instead of fading from one point into the next. Where textures give a pixel a normal or a width
//! of its own, open(x) is looked up with those, at corners too: points know only the mean over their footprint. Light never falls below 0: the ratio
//! is at most D / O. A corner whose lamp is hidden pulls the ratio down by as much as that lamp weighs in O, so it cannot appear between corners
//! that look near it and do not see it; one that no corner's lobe reaches can.
//!
//! Measured lobes, and points without a lobe, stay linear. Lossy: second order in what the ratio changes along an edge, so shadow edges
//! are as sharp as the points. Source: own; \[LD09\] section 6 looks slices up per pixel in the same way, κ of a half vector's lobe as in the
//! warp of Wang et al. 2009.

use super::light::FilteredLight;
use crate::brdf::{Lobe, phong};
use crate::light::Glossy;
use crate::light::PointLobe;
use crate::sphere::frame::dot;
use bytemuck::{Pod, Zeroable};

/// Most that direct light may follow the open sky's: a ratio far above 1 says that the lobe is not where the light comes from.
pub(crate) const MOST_RATIO: f32 = 2.0;
/// Least n·v that narrows a lobe.
const LEAST_COSINE: f64 = 0.1;

/// What a point's lobe would reflect toward the eye under an open sky, beside what it does reflect. 52 bytes.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Highlight {
    normal: [f32; 3],
    /// 0: none.
    kappa: f32,
    /// Looked up at the point.
    open: [f32; 3],
    /// D_k.
    direct: Glossy,
}

/// Concentration of the light that a lobe gathers toward a view at `cosine` from its normal; `None` where that is not known.
fn concentration(lobe: &Lobe, cosine: f64) -> Option<f64> {
    let alpha_squared = match *lobe {
        Lobe::None | Lobe::Measured(_) => return None,
        Lobe::Phong { exponent } => return Some(exponent.max(1e-2)),
        Lobe::BlinnPhong { exponent } => phong::alpha(exponent).powi(2),
        Lobe::Ggx { alpha } | Lobe::Ward { alpha } => alpha[0] * alpha[1],
        Lobe::CookTorrance { slope } => slope * slope,
    };
    Some(1.0 / (2.0 * alpha_squared * cosine.max(LEAST_COSINE)))
}

/// `None` without a direction.
fn unit(v: [f32; 3]) -> Option<[f32; 3]> {
    let length = dot(v, v).sqrt();
    (length > 0.0 && length.is_finite()).then(|| v.map(|c| c / length))
}

/// v mirrored about n.
fn mirrored(n: [f32; 3], v: [f32; 3]) -> [f32; 3] {
    let cosine = dot(n, v);
    std::array::from_fn(|k| 2.0 * cosine * n[k] - v[k])
}

impl Highlight {
    /// What a point at `position` keeps for the pixels around it: its direct light alone is `direct`, toward `eye`.
    pub(crate) fn toward(light: &FilteredLight, lobe: &PointLobe, position: [f32; 3], eye: [f32; 3], direct: &Glossy) -> Self {
        let view = unit(std::array::from_fn(|k| eye[k] - position[k]));
        view.map_or(Highlight::default(), |view| Highlight::at(light, lobe, view, direct))
    }

    fn at(light: &FilteredLight, lobe: &PointLobe, view: [f32; 3], direct: &Glossy) -> Self {
        let cosine = dot(lobe.normal, view);
        match concentration(&lobe.lobe, f64::from(cosine)) {
            Some(kappa) if cosine > 0.0 => {
                let (normal, kappa) = (lobe.normal, kappa as f32);
                Highlight { normal, kappa, open: light.lookup(mirrored(normal, view), kappa), direct: *direct }
            }
            _ => Highlight::default(),
        }
    }
}

/// Adds to glossy light that was interpolated between three points what direct light gains where the pixel looks along `-view`; `own`: what the
/// pixel reflects with, where that is not what lies between the points.
pub(super) fn correct(
    light: &FilteredLight,
    corners: [&Highlight; 3],
    weights: [f32; 3],
    view: [f32; 3],
    own: Option<&PointLobe>,
    glossy: &mut Glossy,
) {
    // A corner without a lobe stays linear, and leaves the others' share to them.
    let known = corners.map(|corner| corner.kappa > 0.0);
    let share: f32 = (0..3).filter(|k| known[*k]).map(|k| weights[k]).sum();
    if share <= 0.0 {
        return;
    }
    let of = |value: &dyn Fn(&Highlight) -> f32| (0..3).filter(|k| known[*k]).map(|k| weights[k] * value(corners[k])).sum::<f32>();
    let Some(normal) = unit(std::array::from_fn(|axis| of(&|corner| corner.normal[axis]))) else { return };
    if dot(normal, view) <= 0.0 {
        return;
    }
    let of_pixel = |own: &PointLobe| {
        let cosine = dot(own.normal, view);
        concentration(&own.lobe, f64::from(cosine)).filter(|_| cosine > 0.0).map(|kappa| (own.normal, kappa as f32))
    };
    let interpolated = || (normal, libm::expf(of(&|corner| libm::logf(corner.kappa)) / share));
    let (normal, kappa) = own.and_then(of_pixel).unwrap_or_else(interpolated);
    let here = light.lookup(mirrored(normal, view), kappa);
    for c in 0..3 {
        let open = of(&|corner| corner.open[c]);
        if open <= f32::MIN_POSITIVE {
            continue;
        }
        for (term, glossy) in glossy.iter_mut().enumerate() {
            let ratio = (of(&|corner| corner.direct[term][c]) / open).min(MOST_RATIO);
            glossy[c] += (share * here[c] - open) * ratio;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::pixel::tests::spot;
    use super::*;
    use crate::environment::LightCubemap;
    use crate::sphere::cubemap::texel_unit_direction;
    use crate::sphere::frame::tangents;

    fn turned(angle: f32) -> [f32; 3] {
        [angle.sin(), angle.cos(), 0.0]
    }

    /// Sum over the texels, those with x below `wall` hidden.
    fn exact(light: &LightCubemap, lobe: &PointLobe, view: [f32; 3], wall: f32) -> Glossy {
        let (n, (t, b)) = (light.face_resolution, tangents(lobe.normal));
        let local = |d: [f32; 3]| [dot(d, t), dot(d, b), dot(d, lobe.normal)].map(f64::from);
        let mut sum = [[0.0f64; 3]; 2];
        for (i, flux) in light.flux.iter().enumerate() {
            let d = texel_unit_direction(n, i / (n * n), i % n, i / n % n);
            if dot(d, lobe.normal) <= 0.0 || d[0] < wall {
                continue;
            }
            let terms = lobe.lobe.terms(local(view), local(d));
            (0..6).for_each(|k| sum[k / 3][k % 3] += f64::from(flux[k % 3]) * terms[k / 3][k % 3]);
        }
        sum.map(|term| term.map(|c| c as f32))
    }

    /// Direct light half way between two points of a cylinder, seen from `view`: interpolated, corrected, exact.
    fn half_way(lobe: Lobe, [from, to]: [f32; 2], view: [f32; 3], wall: f32) -> [f32; 3] {
        let (light, at) = (spot(), |angle: f32| PointLobe { lobe, normal: turned(angle), tangent: [0.0; 3] });
        let filtered = FilteredLight::prepare(&light);
        let ends = [from, to].map(|angle| {
            let direct = exact(&light, &at(angle), view, wall);
            (direct, Highlight::at(&filtered, &at(angle), view, &direct))
        });
        let linear: Glossy = std::array::from_fn(|t| std::array::from_fn(|c| 0.5 * (ends[0].0[t][c] + ends[1].0[t][c])));
        let mut drawn = linear;
        correct(&filtered, [&ends[0].1, &ends[1].1, &ends[0].1], [0.25, 0.5, 0.25], view, None, &mut drawn);
        [linear[0][1], drawn[0][1], exact(&light, &at(0.5 * (from + to)), view, wall)[0][1]]
    }

    #[test]
    fn a_highlight_between_two_points_is_as_bright_as_the_sum_over_the_texels() {
        let lobes = [
            Lobe::BlinnPhong { exponent: 128.0 },
            Lobe::Ggx { alpha: [0.12; 2] },
            Lobe::Ward { alpha: [0.12; 2] },
            Lobe::CookTorrance { slope: 0.12 },
            Lobe::Phong { exponent: 32.0 },
        ];
        // The spot is mirrored in the middle; both ends look past it.
        for (lobe, tilt) in lobes.into_iter().flat_map(|lobe| [0.0f32, 0.5].map(|tilt| (lobe, tilt))) {
            let view = turned(-tilt);
            let [linear, drawn, truth] = half_way(lobe, [-0.5 * tilt - 0.1, -0.5 * tilt + 0.1], view, -2.0);
            let (before, after) = (linear / truth - 1.0, drawn / truth - 1.0);
            assert!(before < -0.25 && after.abs() < 0.25 * before.abs(), "{lobe:?} {tilt}: {before} {after}");
        }
    }

    #[test]
    fn what_no_end_sees_stays_dark_and_a_wall_hides_what_it_hides() {
        let lobe = Lobe::BlinnPhong { exponent: 128.0 };
        // Nothing is open.
        assert_eq!(half_way(lobe, [-0.1, 0.1], [0.0, 1.0, 0.0], 2.0), [0.0; 3]);
        // The spot is hidden, the sky beyond it is not: what is drawn is no further from the truth than the spot's own share at the ends.
        let [linear, drawn, truth] = half_way(lobe, [-0.1, 0.1], [0.0, 1.0, 0.0], 0.15);
        let [_, _, open] = half_way(lobe, [-0.1, 0.1], [0.0, 1.0, 0.0], -2.0);
        assert!(truth < 0.1 * open && (drawn - truth).abs() < 0.1 * open, "{linear} {drawn} {truth} {open}");
    }

    #[test]
    fn at_a_point_nothing_is_added_and_nothing_odd_gives_nan() {
        let light = FilteredLight::prepare(&spot());
        let odd = [
            Lobe::None,
            Lobe::Phong { exponent: 0.0 },
            Lobe::BlinnPhong { exponent: 1e9 },
            Lobe::Ggx { alpha: [1e-3, 1.0] },
            Lobe::BlinnPhong { exponent: 128.0 },
        ];
        let view = turned(0.3);
        let at = |lobe: Lobe, angle: f32| {
            Highlight::at(&light, &PointLobe { lobe, normal: turned(angle), tangent: [0.0; 3] }, view, &[[7.0, 0.0, 1e-3]; 2])
        };
        for (a, b) in odd.into_iter().flat_map(|a| odd.map(|b| (a, b))) {
            for angles in [[0.0, 0.2], [1.0, -1.0], [1.6, 0.3], [-2.0, -2.5]] {
                let corners = [at(a, angles[0]), at(b, angles[1]), Highlight::default()];
                for (weights, is_corner) in [([1.0, 0.0, 0.0], true), ([0.0, 1.0, 0.0], true), ([0.3, 0.3, 0.4], false)] {
                    let mut got = [[7.0, 0.0, 1e-3]; 2];
                    correct(&light, [&corners[0], &corners[1], &corners[2]], weights, view, None, &mut got);
                    assert!(got.iter().flatten().all(|value| value.is_finite() && *value >= -1e-5), "{a:?} {b:?} {got:?}");
                    assert!(
                        !is_corner || got.iter().flatten().zip([7.0, 0.0, 1e-3, 7.0, 0.0, 1e-3]).all(|(a, b)| (a - b).abs() <= 1e-5 * b),
                        "{got:?}"
                    );
                }
            }
        }
    }
}
