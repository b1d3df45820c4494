//! The paper's surface: Lambert and an energy-conserving Phong lobe.
//!
//! ```text
//! ρ(ω)·n·ω = (kd/π + ks (s + 2)/2π · max(0, r·ω)^s) · max(0, n·ω)          r: the view direction mirrored about n
//! ```
//!
//! Grey: kd and ks are one number each, the light brings the colour.

/// A surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Phong {
    /// Diffuse reflectance.
    pub kd: f32,
    /// Specular reflectance.
    pub ks: f32,
    /// s; only read where `ks` > 0.
    pub exponent: f32,
}

impl Phong {
    /// Exponent of the lobe if there is one.
    pub fn lobe(&self) -> Option<f32> {
        (self.ks > 0.0).then_some(self.exponent)
    }

    /// Value times the cosine, in f64: the oracle. All unit vectors.
    pub fn value(&self, n: [f64; 3], mirror: [f64; 3], l: [f64; 3]) -> f64 {
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let (s, pi) = (f64::from(self.exponent), std::f64::consts::PI);
        let lobe = if self.ks > 0.0 { libm::pow(dot(mirror, l).max(0.0), s) * (s + 2.0) / (2.0 * pi) } else { 0.0 };
        (f64::from(self.kd) / pi + f64::from(self.ks) * lobe) * dot(n, l).max(0.0)
    }
}

/// The constants of one point's loops.
#[derive(Clone, Copy)]
pub(super) struct Lobe {
    pub n: [f32; 3],
    pub mirror: [f32; 3],
    pub diffuse: f32,
    pub specular: f32,
    pub exponent: f32,
}

impl Lobe {
    pub(crate) fn new(surface: &Phong, n: [f32; 3], v: [f32; 3]) -> Self {
        let n_dot_v = n[0] * v[0] + n[1] * v[1] + n[2] * v[2];
        let pi = std::f32::consts::PI;
        Lobe {
            n,
            mirror: std::array::from_fn(|k| 2.0 * n_dot_v * n[k] - v[k]),
            diffuse: surface.kd / pi,
            specular: surface.ks * (surface.exponent + 2.0) / (2.0 * pi),
            exponent: surface.exponent,
        }
    }

    /// Value times the cosine; nothing branches, so loops over it vectorise.
    #[inline(always)]
    pub(crate) fn value(&self, l: [f32; 3]) -> f32 {
        let cosine = self.n[0] * l[0] + self.n[1] * l[1] + self.n[2] * l[2];
        let mirror = self.mirror[0] * l[0] + self.mirror[1] * l[1] + self.mirror[2] * l[2];
        let cosine = if cosine > 0.0 { cosine } else { 0.0 };
        (self.diffuse + self.specular * power(mirror, self.exponent)) * cosine
    }
}

/// x^s for x ≤ 1 and s ≥ 0; 0 below 2⁻¹⁰⁰. Relative error: 2e-7 · (1 + s), from the rounding of s·log₂ x.
#[inline(always)]
pub(super) fn power(x: f32, s: f32) -> f32 {
    let x = if x > 1e-30 { x } else { 1e-30 };
    let bits = x.to_bits();
    // x = m 2^e, m in √½..√2.
    let shifted = bits.wrapping_sub(0x3f35_04f3);
    let e = (shifted as i32) >> 23;
    let m = f32::from_bits(bits.wrapping_sub((e as u32) << 23));
    let t = (m - 1.0) / (m + 1.0);
    let t2 = t * t;
    // 2/ln 2 · atanh t, |t| < 0.172.
    let log = t * (2.885_390_1 + t2 * (0.961_796_7 + t2 * (0.577_078 + t2 * (0.412_198_6 + t2 * 0.320_598_8))));
    let y = s * (e as f32 + log);
    let y = if y > -100.0 { y } else { -100.0 };
    // Nearest integer, by the rounding of the sum.
    const ROUND: f32 = 12_582_912.0;
    let rounded = (y + ROUND) - ROUND;
    let f = y - rounded;
    let fraction = 1.0
        + f * (std::f32::consts::LN_2
            + f * (0.240_226_5 + f * (0.055_504_11 + f * (0.009_618_129 + f * (0.001_333_355_8 + f * 0.000_154_035_3)))));
    let scale = f32::from_bits(((rounded as i32 + 127) as u32) << 23);
    if y > -100.0 { fraction * scale } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn power_is_pow_within_its_stated_error() {
        for s in [1.0f32, 10.0, 50.0, 200.0, 1000.0] {
            for i in 0..=2000 {
                let x = i as f32 / 2000.0;
                let exact = libm::pow(f64::from(x), f64::from(s));
                let got = f64::from(power(x, s));
                let allowed = 4e-7 * (1.0 + f64::from(s)) * exact + 1e-29;
                assert!((got - exact).abs() <= allowed, "{x}^{s}: {got} {exact}");
            }
        }
        assert_eq!(power(-1.0, 20.0), 0.0);
    }
}
