//! The formulas of `brdf::TexelLobe` sixteen runs at a time, and bounds of each over a ball of directions.
//!
//! For a run with mean direction c, every texel within the chord r of it, each component of H is within r of that at c; so with the largest
//! |H_z|, the least |H_x| and |H_y| of the ball, t ≥ t₀, and
//!
//! | shape | most | κ |
//! |---|---|---|
//! | GGX, one width | gain · (z + r)/D(z + r) · (\|H\|²/q)² | 4 (c − 1)/q + 4 (1 − v·h)³ + [`shadowed_cosine`], D = z S(v) + n·v S(l) |
//! | GGX, two widths | gain/S(v) · (\|H\|²/q)² | 4 (c − 1)/q + 4 (1 − v·h)³ + 1/(z(z + n·v)) |
//! | Ward | gain · Z · (1 + m²t₀) exp(−t₀), Z = max z/(z + n·v)² | 2 c (1 + t₀)/H_z² + (2 n·v + z)/(Z (z + n·v)⁴) |
//! | Cook-Torrance | gain · (1 + m²t)² exp(−t) · max G | 2 c (1 + t₀)/H_z² + 1/(z(z + n·v)) + 4 |
//! | Blinn-Phong | gain · z (1 + t₀)^(−s/2) | 1.5 s c (1 + e)/((1 + t₀) H_z²) + 1/(2z²), e = s t₀/(2(1 + t₀)) |
//! | Phong | gain · z (1 − d₀)ˢ, d₀ = max(0, \|c − r\| − r)²/2 | 1.5 s (1 + s d₀) + 1/(2z²) |
//! | measured | z · (the table's largest value from the half angle of t₀ on) | 1/r², as everything is taken apart down to cells |
//!
//! `most` is meant as a bound over the ball; only results held to the oracle test it so far, not balls one by one. κ is half its second derivative relative to `most`, so that one sample at c is off by about
//! `most` · κ · σ² for light with a mean square spread σ²: an estimate, good where σ is below the lobe's width, and cut off at `most`.
//! m² is the larger squared width, c its smaller one's reciprocal, z the least n·l of the ball.

use crate::brdf::Measured;
use crate::light::lanes::{Lanes, WIDTH};
use crate::light::texel_lobe::{Shape, TexelLobe};

/// Half the second derivative of q⁻² along l, relative, in units of 1 / (a_x² q): 2 at the peak, 8 in the tail.
const GGX_CURVATURE: f32 = 4.0;
/// The same of Schlick's (1 − v·h)⁵ and of the factors that vary slowly.
const SLOW_CURVATURE: f32 = 4.0;
/// Keeps reciprocals finite.
const TINY: f32 = 1e-8;
/// Covers rough reciprocals (2⁻¹¹) in bounds.
const ROUGH: f32 = 1.01;

/// [`TexelLobe`] in f32, as the loops need it.
#[derive(Clone, Debug)]
pub struct Lobe<'a> {
    pub shape: Shape,
    pub frame: [[f32; 3]; 3],
    pub view: [f32; 3],
    pub inverse_width: [f32; 2],
    pub smith: [f32; 3],
    pub smith_view: f32,
    /// s for Phong, s/2 for Blinn-Phong.
    pub exponent: f32,
    pub gain: f32,
    pub table: Option<&'a Measured>,
}

impl<'a> Lobe<'a> {
    pub(crate) fn new(lobe: &TexelLobe<'a>) -> Self {
        let exponent = if lobe.shape == Shape::BlinnPhong { 0.5 * lobe.exponent } else { lobe.exponent };
        Lobe {
            shape: lobe.shape,
            frame: lobe.frame.map(|axis| axis.map(|x| x as f32)),
            view: lobe.view.map(|x| x as f32),
            inverse_width: lobe.inverse_width.map(|x| x as f32),
            smith: lobe.smith.map(|x| x as f32),
            smith_view: lobe.smith_view as f32,
            exponent: exponent as f32,
            gain: lobe.gain as f32,
            table: lobe.table,
        }
    }
}

/// A lobe in registers.
#[derive(Clone, Copy)]
pub(crate) struct Registers<L: Lanes> {
    pub frame: [[L::V; 3]; 3],
    view: [L::V; 3],
    inverse_width: [L::V; 2],
    smith: [L::V; 3],
    smith_view: L::V,
    exponent: L::V,
    gain: L::V,
    one: L::V,
    zero: L::V,
}

impl<L: Lanes> Registers<L> {
    #[inline(always)]
    pub(crate) fn new(lanes: L, lobe: &Lobe) -> Self {
        let set = |x: f32| lanes.splat(x);
        Registers {
            frame: [
                [set(lobe.frame[0][0]), set(lobe.frame[0][1]), set(lobe.frame[0][2])],
                [set(lobe.frame[1][0]), set(lobe.frame[1][1]), set(lobe.frame[1][2])],
                [set(lobe.frame[2][0]), set(lobe.frame[2][1]), set(lobe.frame[2][2])],
            ],
            view: [set(lobe.view[0]), set(lobe.view[1]), set(lobe.view[2])],
            inverse_width: [set(lobe.inverse_width[0]), set(lobe.inverse_width[1])],
            smith: [set(lobe.smith[0]), set(lobe.smith[1]), set(lobe.smith[2])],
            smith_view: set(lobe.smith_view),
            exponent: set(lobe.exponent),
            gain: set(lobe.gain),
            one: set(1.0),
            zero: set(0.0),
        }
    }

    /// Components of directions in the lobe's frame.
    #[inline(always)]
    pub(crate) fn local(&self, lanes: L, d: [L::V; 3]) -> [L::V; 3] {
        let along = |axis: usize| {
            let e = &self.frame[axis];
            lanes.fma(e[2], d[2], lanes.fma(e[1], d[1], lanes.mul(e[0], d[0])))
        };
        [along(0), along(1), along(2)]
    }

    /// (1 − |H|/2)⁵, Schlick's share of white.
    #[inline(always)]
    pub(crate) fn schlick(&self, lanes: L, hh: L::V) -> L::V {
        let t = lanes.max(lanes.fnma(lanes.splat(0.5), lanes.quick_root(hh), self.one), self.zero);
        let tt = lanes.mul(t, t);
        lanes.mul(lanes.mul(tt, tt), t)
    }
}

/// A formula: its value at directions, and its bounds over balls around them.
pub(crate) trait Formula: Copy {
    /// The value splits into two Schlick terms.
    const SCHLICK: bool;

    /// Value where n·l = z > 0 (anything elsewhere), and |H|² where it splits.
    fn value<L: Lanes>(lanes: L, lobe: &Registers<L>, local: [L::V; 3]) -> (L::V, L::V);

    /// `most` and κ of the module head over balls of radius `r`, horizon aside.
    fn bounds<L: Lanes>(lanes: L, lobe: &Registers<L>, local: [L::V; 3], r: L::V) -> (L::V, L::V);
}

/// √a for bounds, within 2⁻¹¹.
#[inline(always)]
fn rough_root<L: Lanes>(lanes: L, a: L::V) -> L::V {
    let a = lanes.max(a, lanes.splat(TINY));
    lanes.mul(a, lanes.rough_inverse_root(a))
}

/// H and the squares of its components.
#[inline(always)]
fn half_vector<L: Lanes>(lanes: L, lobe: &Registers<L>, [x, y, z]: [L::V; 3]) -> ([L::V; 3], [L::V; 3]) {
    let h = [lanes.add(x, lobe.view[0]), lanes.add(y, lobe.view[1]), lanes.add(z, lobe.view[2])];
    (h, [lanes.mul(h[0], h[0]), lanes.mul(h[1], h[1]), lanes.mul(h[2], h[2])])
}

/// Least c_x H_x² + c_y H_y² of a ball.
#[inline(always)]
fn least_spread<L: Lanes>(lanes: L, lobe: &Registers<L>, h: &[L::V; 3], r: L::V) -> L::V {
    let away = |h: L::V| lanes.max(lanes.sub(lanes.abs(h), r), lobe.zero);
    let (x, y) = (away(h[0]), away(h[1]));
    lanes.fma(lanes.mul(x, x), lobe.inverse_width[0], lanes.mul(lanes.mul(y, y), lobe.inverse_width[1]))
}

/// 1/(z(z + n·v)) with the least z.
#[inline(always)]
fn grazing<L: Lanes>(lanes: L, lobe: &Registers<L>, z: L::V, r: L::V) -> L::V {
    let lift = lanes.max(lanes.sub(z, r), lanes.splat(TINY));
    lanes.rough_reciprocal(lanes.mul(lift, lanes.add(lift, lobe.view[2])))
}

/// What Gaussian and power lobes of the slopes share: least t, c/H_z² with the least H_z, and the powers' base-two logarithm of e.
#[inline(always)]
fn slopes<L: Lanes>(lanes: L, lobe: &Registers<L>, local: [L::V; 3], r: L::V) -> (L::V, L::V) {
    let (h, _) = half_vector(lanes, lobe, local);
    let high = lanes.rough_reciprocal(lanes.add(h[2], r));
    let spread = least_spread(lanes, lobe, &h, r);
    let t = lanes.mul(lanes.splat(1.0 / ROUGH), lanes.mul(spread, lanes.mul(high, high)));
    let low = lanes.rough_reciprocal(lanes.max(lanes.sub(h[2], r), lobe.view[2]));
    let steep = lanes.max(lobe.inverse_width[0], lobe.inverse_width[1]);
    (t, lanes.mul(steep, lanes.mul(low, low)))
}

/// Microfacets of GGX; `STRETCHED` when shadowing has two widths.
#[derive(Clone, Copy)]
pub(crate) struct Ggx<const STRETCHED: bool>;

impl<const STRETCHED: bool> Formula for Ggx<STRETCHED> {
    const SCHLICK: bool = true;

    #[inline(always)]
    fn value<L: Lanes>(lanes: L, lobe: &Registers<L>, local: [L::V; 3]) -> (L::V, L::V) {
        let (_, [xx, yy, zz]) = half_vector(lanes, lobe, local);
        let [x, y, z] = local;
        let q = lanes.fma(xx, lobe.inverse_width[0], lanes.fma(yy, lobe.inverse_width[1], zz));
        let hh = lanes.add(lanes.add(xx, yy), zz);
        let square = if STRETCHED {
            let across = lanes.fma(lobe.smith[1], x, lanes.mul(lobe.smith[2], y));
            lanes.fma(z, z, lanes.fma(lanes.mul(lobe.smith[0], x), x, lanes.mul(across, y)))
        } else {
            lanes.fma(lanes.mul(lanes.sub(lobe.one, lobe.smith[0]), z), z, lobe.smith[0])
        };
        let smith_light = lanes.quick_root(square);
        let under = lanes.mul(lanes.mul(q, q), lanes.fma(z, lobe.smith_view, lanes.mul(lobe.view[2], smith_light)));
        let over = lanes.mul(lanes.mul(lobe.gain, z), lanes.mul(hh, hh));
        (lanes.mul(over, lanes.reciprocal(under)), hh)
    }

    #[inline(always)]
    fn bounds<L: Lanes>(lanes: L, lobe: &Registers<L>, local: [L::V; 3], r: L::V) -> (L::V, L::V) {
        let (h, [xx, yy, zz]) = half_vector(lanes, lobe, local);
        let z = lanes.max(lanes.sub(h[2], r), lobe.zero);
        let q = lanes.fma(z, z, least_spread(lanes, lobe, &h, r));
        // Widths are at most 1, so q ≥ |H|² whatever the box says; the lower limit keeps the quotient finite.
        let inverse_q = lanes.rough_reciprocal(lanes.max(q, lanes.splat(TINY)));
        let length = rough_root(lanes, lanes.add(lanes.add(xx, yy), zz));
        let long = lanes.min(lanes.add(length, r), lanes.splat(2.0));
        let ratio = lanes.min(lanes.mul(lanes.mul(long, long), inverse_q), lobe.one);
        let steep = lanes.sub(lanes.max(lobe.inverse_width[0], lobe.inverse_width[1]), lobe.one);
        // (1 − v·h)³ with the least v·h.
        let t = lanes.min(lanes.fnma(lanes.splat(0.5), lanes.sub(length, r), lobe.one), lobe.one);
        let slow = lanes.mul(lanes.splat(SLOW_CURVATURE), lanes.mul(lanes.mul(t, t), t));
        let (cosine, bend) = if STRETCHED {
            (lanes.rough_reciprocal(lobe.smith_view), grazing(lanes, lobe, local[2], r))
        } else {
            shadowed_cosine(lanes, lobe, local[2], r)
        };
        let most = lanes.mul(lanes.mul(lanes.splat(ROUGH * ROUGH), lobe.gain), lanes.mul(cosine, lanes.mul(ratio, ratio)));
        (most, lanes.fma(lanes.mul(lanes.splat(GGX_CURVATURE), steep), inverse_q, lanes.add(slow, bend)))
    }
}

/// D = z S(v) + n·v S(l) and 1/S(l) of lobes with one width, within 2⁻¹⁰.
#[inline(always)]
fn smith<L: Lanes>(lanes: L, lobe: &Registers<L>, z: L::V) -> (L::V, L::V) {
    let a = lobe.smith[0];
    let square = lanes.fma(lanes.mul(lanes.sub(lobe.one, a), z), z, a);
    let inverse = lanes.rough_inverse_root(square);
    (lanes.fma(z, lobe.smith_view, lanes.mul(lobe.view[2], lanes.mul(square, inverse))), inverse)
}

/// Bounds of n·l/(n·l S(v) + n·v S(l)) with one width: the most, and half the second derivative relative to that.
#[inline(always)]
fn shadowed_cosine<L: Lanes>(lanes: L, lobe: &Registers<L>, z: L::V, r: L::V) -> (L::V, L::V) {
    let a = lobe.smith[0];
    let high = lanes.min(lanes.max(lanes.add(z, r), lanes.splat(TINY)), lobe.one);
    let (above, _) = smith(lanes, lobe, high);
    let (below, inverse_s) = smith(lanes, lobe, lanes.max(lanes.sub(z, r), lobe.zero));
    let inverse_sum = lanes.rough_reciprocal(below);
    // d²/dz² = −n·v a/(s D²) [(1 − a) z/s² + 2 D′/D], with (1 − a) z ≤ s and D′ ≤ S(v) + n·v.
    let slope = lanes.mul(lanes.add(lobe.smith_view, lobe.view[2]), inverse_sum);
    let rate = lanes.fma(lanes.splat(0.5), inverse_s, slope);
    let curve = lanes.mul(lanes.mul(lobe.view[2], a), lanes.mul(inverse_s, lanes.mul(inverse_sum, inverse_sum)));
    let bend = lanes.mul(lanes.mul(curve, rate), lanes.mul(above, lanes.rough_reciprocal(high)));
    (lanes.mul(high, lanes.rough_reciprocal(above)), bend)
}

/// Ward's Gaussian.
#[derive(Clone, Copy)]
pub(crate) struct Ward;

impl Formula for Ward {
    const SCHLICK: bool = false;

    #[inline(always)]
    fn value<L: Lanes>(lanes: L, lobe: &Registers<L>, local: [L::V; 3]) -> (L::V, L::V) {
        let (_, [xx, yy, zz]) = half_vector(lanes, lobe, local);
        let inverse = lanes.reciprocal(zz);
        let t = lanes.mul(lanes.fma(xx, lobe.inverse_width[0], lanes.mul(yy, lobe.inverse_width[1])), inverse);
        let hh = lanes.add(lanes.add(xx, yy), zz);
        let factor = lanes.mul(lanes.mul(lobe.gain, local[2]), lanes.mul(lanes.mul(hh, inverse), inverse));
        (lanes.mul(factor, lanes.exp2(lanes.mul(t, lanes.splat(-std::f32::consts::LOG2_E)))), hh)
    }

    #[inline(always)]
    fn bounds<L: Lanes>(lanes: L, lobe: &Registers<L>, local: [L::V; 3], r: L::V) -> (L::V, L::V) {
        let (t, steep) = slopes(lanes, lobe, local, r);
        // z/(z + n·v)² peaks at z = n·v.
        let least = lanes.max(lanes.sub(local[2], r), lobe.zero);
        let z = lanes.min(lanes.max(lobe.view[2], least), lanes.max(lanes.add(local[2], r), lanes.splat(TINY)));
        let sum = lanes.rough_reciprocal(lanes.add(z, lobe.view[2]));
        let cosine = lanes.mul(z, lanes.mul(sum, sum));
        let large = lanes.rough_reciprocal(lanes.min(lobe.inverse_width[0], lobe.inverse_width[1]));
        let gaussian = lanes.mul(lanes.fma(large, t, lobe.one), lanes.exp2(lanes.mul(t, lanes.splat(-std::f32::consts::LOG2_E))));
        let most = lanes.mul(lanes.mul(lanes.splat(ROUGH), lobe.gain), lanes.mul(cosine, gaussian));
        // Half of d²/dz² of z/(z + n·v)² is below (2 n·v + z)/(z + n·v)⁴.
        let low = lanes.rough_reciprocal(lanes.add(least, lobe.view[2]));
        let square = lanes.mul(low, low);
        let curve = lanes.mul(lanes.add(lanes.add(lobe.view[2], lobe.view[2]), least), lanes.mul(square, square));
        let bend = lanes.mul(curve, lanes.rough_reciprocal(lanes.max(cosine, lanes.splat(TINY))));
        (most, lanes.fma(lanes.mul(lanes.splat(2.0), steep), lanes.add(lobe.one, t), bend))
    }
}

/// Beckmann facets in grooves.
#[derive(Clone, Copy)]
pub(crate) struct CookTorrance;

impl Formula for CookTorrance {
    const SCHLICK: bool = true;

    #[inline(always)]
    fn value<L: Lanes>(lanes: L, lobe: &Registers<L>, local: [L::V; 3]) -> (L::V, L::V) {
        let (h, [xx, yy, zz]) = half_vector(lanes, lobe, local);
        let inverse = lanes.reciprocal(zz);
        let t = lanes.mul(lanes.fma(xx, lobe.inverse_width[0], lanes.mul(yy, lobe.inverse_width[1])), inverse);
        let hh = lanes.add(lanes.add(xx, yy), zz);
        let ratio = lanes.mul(hh, inverse);
        let grooves = lanes.mul(lanes.mul(lanes.splat(4.0), h[2]), lanes.mul(lanes.min(local[2], lobe.view[2]), lanes.reciprocal(hh)));
        let gaussian = lanes.exp2(lanes.mul(t, lanes.splat(-std::f32::consts::LOG2_E)));
        let facets = lanes.mul(lanes.mul(lobe.gain, lanes.mul(ratio, ratio)), gaussian);
        (lanes.mul(facets, lanes.min(grooves, lobe.one)), hh)
    }

    #[inline(always)]
    fn bounds<L: Lanes>(lanes: L, lobe: &Registers<L>, local: [L::V; 3], r: L::V) -> (L::V, L::V) {
        let (t, steep) = slopes(lanes, lobe, local, r);
        let inverse_large = lanes.min(lobe.inverse_width[0], lobe.inverse_width[1]);
        let large = lanes.mul(lanes.splat(ROUGH), lanes.rough_reciprocal(inverse_large));
        // (1 + m²t)² exp(−t) peaks at t = 2 − 1/m².
        let at = lanes.max(t, lanes.sub(lanes.splat(2.0), lanes.mul(lanes.splat(1.0 / ROUGH), inverse_large)));
        let slope = lanes.fma(large, at, lobe.one);
        let gaussian = lanes.mul(lanes.mul(slope, slope), lanes.exp2(lanes.mul(at, lanes.splat(-std::f32::consts::LOG2_E))));
        let (high, low) = (lanes.add(local[2], r), lanes.max(lanes.sub(local[2], r), lobe.zero));
        let above = lanes.mul(high, lanes.rough_reciprocal(lanes.max(lanes.add(high, lobe.view[2]), lanes.splat(TINY))));
        let below = lanes.mul(lobe.view[2], lanes.rough_reciprocal(lanes.add(low, lobe.view[2])));
        let grooves = lanes.min(lanes.mul(lanes.splat(4.0), lanes.min(above, below)), lobe.one);
        let most = lanes.mul(lanes.mul(lanes.splat(ROUGH), lobe.gain), lanes.mul(gaussian, grooves));
        let slow = lanes.add(grazing(lanes, lobe, local[2], r), lanes.splat(SLOW_CURVATURE));
        (most, lanes.fma(lanes.mul(lanes.splat(2.0), steep), lanes.add(lobe.one, t), slow))
    }
}

/// κ of a power lobe from that of the power alone: the product with n·l adds a cross term, split between the two.
#[inline(always)]
fn with_cosine<L: Lanes>(lanes: L, z: L::V, r: L::V, kappa: L::V) -> L::V {
    let lift = lanes.max(lanes.sub(z, r), lanes.splat(1e-4));
    let inverse = lanes.rough_reciprocal(lift);
    lanes.fma(lanes.splat(1.5), kappa, lanes.mul(lanes.splat(0.5), lanes.mul(inverse, inverse)))
}

/// A power of n·h.
#[derive(Clone, Copy)]
pub(crate) struct BlinnPhong;

impl Formula for BlinnPhong {
    const SCHLICK: bool = false;

    #[inline(always)]
    fn value<L: Lanes>(lanes: L, lobe: &Registers<L>, local: [L::V; 3]) -> (L::V, L::V) {
        let (_, [xx, yy, zz]) = half_vector(lanes, lobe, local);
        let t = lanes.mul(lanes.fma(xx, lobe.inverse_width[0], lanes.mul(yy, lobe.inverse_width[1])), lanes.reciprocal(zz));
        let power = lanes.exp2(lanes.mul(lanes.sub(lobe.zero, lobe.exponent), lanes.log2_1p(t)));
        (lanes.mul(lanes.mul(lobe.gain, local[2]), power), zz)
    }

    #[inline(always)]
    fn bounds<L: Lanes>(lanes: L, lobe: &Registers<L>, local: [L::V; 3], r: L::V) -> (L::V, L::V) {
        let (t, steep) = slopes(lanes, lobe, local, r);
        let z = lanes.min(lanes.add(local[2], r), lobe.one);
        let power = lanes.exp2(lanes.mul(lanes.sub(lobe.zero, lobe.exponent), lanes.log2_1p(t)));
        let most = lanes.mul(lanes.mul(lanes.splat(ROUGH), lobe.gain), lanes.mul(z, power));
        let inverse = lanes.rough_reciprocal(lanes.add(lobe.one, t));
        let e = lanes.mul(lobe.exponent, lanes.mul(t, inverse));
        let kappa = lanes.mul(lanes.mul(lanes.mul(lanes.splat(2.0), lobe.exponent), steep), lanes.mul(inverse, lanes.add(lobe.one, e)));
        (most, with_cosine(lanes, local[2], r, kappa))
    }
}

/// A power of r·l.
#[derive(Clone, Copy)]
pub struct Phong;

/// 1 − r·l, from the chord.
#[inline(always)]
fn versine<L: Lanes>(lanes: L, lobe: &Registers<L>, [x, y, z]: [L::V; 3]) -> L::V {
    let d = [lanes.add(x, lobe.view[0]), lanes.add(y, lobe.view[1]), lanes.sub(z, lobe.view[2])];
    let square = lanes.fma(d[0], d[0], lanes.fma(d[1], d[1], lanes.mul(d[2], d[2])));
    lanes.mul(lanes.splat(0.5), square)
}

/// (1 − d)ˢ, 0 from d = 1 on.
#[inline(always)]
fn power<L: Lanes>(lanes: L, lobe: &Registers<L>, d: L::V) -> L::V {
    // The last f32 below 1 bounds what a power with a small exponent keeps there.
    let inside = lanes.min(d, lanes.splat(0.999_999_9));
    let power = lanes.exp2(lanes.mul(lobe.exponent, lanes.log2_1p(lanes.sub(lobe.zero, inside))));
    lanes.keep(lanes.greater(lobe.one, d), power)
}

impl Formula for Phong {
    const SCHLICK: bool = false;

    #[inline(always)]
    fn value<L: Lanes>(lanes: L, lobe: &Registers<L>, local: [L::V; 3]) -> (L::V, L::V) {
        let d = versine(lanes, lobe, local);
        (lanes.mul(lanes.mul(lobe.gain, local[2]), power(lanes, lobe, d)), d)
    }

    #[inline(always)]
    fn bounds<L: Lanes>(lanes: L, lobe: &Registers<L>, local: [L::V; 3], r: L::V) -> (L::V, L::V) {
        let two = lanes.splat(2.0);
        let chord = lanes.mul(lanes.splat(1.0 / ROUGH), rough_root(lanes, lanes.mul(two, versine(lanes, lobe, local))));
        let near = lanes.max(lanes.sub(chord, r), lobe.zero);
        let d = lanes.mul(lanes.splat(0.5 / ROUGH), lanes.mul(near, near));
        let z = lanes.min(lanes.add(local[2], r), lobe.one);
        let most = lanes.mul(lanes.mul(lanes.splat(ROUGH), lobe.gain), lanes.mul(z, power(lanes, lobe, d)));
        let kappa = lanes.mul(lobe.exponent, lanes.fma(lobe.exponent, d, lobe.one));
        (most, with_cosine(lanes, local[2], r, kappa))
    }
}

/// Values `[channel][run]` of a measured lobe where the bits are set, one run after the other.
pub(crate) fn measured_values(lobe: &Lobe, directions: [&[f32; WIDTH]; 3], bits: u16) -> [[f32; WIDTH]; 3] {
    let mut out = [[0.0; WIDTH]; 3];
    let Some(table) = lobe.table else { return out };
    let view = lobe.view.map(f64::from);
    let mut rest = bits;
    while rest != 0 {
        let run = rest.trailing_zeros() as usize;
        rest &= rest - 1;
        let l = lobe.frame.map(|e| f64::from(e[0] * directions[0][run] + e[1] * directions[1][run] + e[2] * directions[2][run]));
        let value = table.value(view, l);
        (0..3).for_each(|channel| out[channel][run] = value[channel] as f32 * lobe.gain);
    }
    out
}

/// `most` of a measured lobe over balls of radius `r`, horizon aside.
pub(crate) fn measured_bounds(lobe: &Lobe, directions: [&[f32; WIDTH]; 3], radius: &[f32; WIDTH]) -> [f32; WIDTH] {
    let Some(table) = lobe.table else { return [0.0; WIDTH] };
    std::array::from_fn(|run| {
        let [x, y, z] = lobe.frame.map(|e| e[0] * directions[0][run] + e[1] * directions[1][run] + e[2] * directions[2][run]);
        let (hx, hy, hz, r) = (x + lobe.view[0], y + lobe.view[1], z + lobe.view[2], radius[run]);
        // A vector within r of H is turned by at most asin(r/|H|), so its sine is at least sin θ cos δ − cos θ sin δ.
        let hh = (hx * hx + hy * hy + hz * hz).max(1e-12);
        let (across, length) = ((hx * hx + hy * hy).sqrt(), hh.sqrt());
        let turn = (r / length).min(1.0);
        let sine = (across * (1.0 - turn * turn).sqrt() - hz.max(0.0) * turn) / length;
        ROUGH * lobe.gain * (z + r).clamp(0.0, 1.0) * table.peak_at(if sine > 0.0 { sine * 0.999 } else { 0.0 })
    })
}
