//! A whole surface at one place: a Lambert base, a lobe over it, a clear coat over both.
//!
//! ```text
//! f·n·l = (1 − c·E_c(n_c·v)) · ( diffuse/π · (1 − E_u(n·v)) · n·l  +  F0 · terms[0] + F90 · terms[1] )  +  c · (0.04 · coat[0] + coat[1])
//! ```
//!
//! terms are those of the [`Lobe`], coat those of an isotropic GGX lobe about the coat's own normal n_c; E_u is the albedo of what covers
//! the base ([`Surface::under`]), E_c that of the coat. So a surface returns at most what it receives wherever its lobe does, up to the
//! error of the albedo tables. KHR_materials_clearcoat weighs what is below by 1 − c·F(n_c·v); E takes the coat's roughness into account.

use super::frame::{cross, lift};
use super::lobe::Lobe;
use super::{ggx, lambert};
use crate::sphere::frame::{dot, tangents};

/// Reflectance of a clear coat along its normal.
pub(crate) const COAT_F0: f32 = 0.04;

/// A clear coat; strength 0 is none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Coat {
    /// 0..=1.
    pub strength: f32,
    /// Perceptual, 0..=1.
    pub roughness: f32,
}

/// How a surface stands in the world. Unit vectors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Along the first width of an anisotropic lobe, perpendicular to the normal.
    pub tangent: [f32; 3],
    /// normal × tangent, or its negative where texture coordinates are mirrored.
    pub bitangent: [f32; 3],
    /// What base and lobe are shaded with.
    pub normal: [f32; 3],
    /// What the coat is shaded with.
    pub coat_normal: [f32; 3],
}

impl Place {
    /// A place whose tangent does not matter.
    pub fn about(normal: [f32; 3]) -> Self {
        let (tangent, bitangent) = tangents(normal);
        Place { tangent, bitangent, normal, coat_normal: normal }
    }

    /// A place whose frame follows `tangent` (made perpendicular to the normal), turned to the unit `direction` between it and the
    /// bitangent `sign` · n × t. A tangent that is zero or along the normal gives [`Place::about`].
    pub(crate) fn along(normal: [f32; 3], tangent: [f32; 4], direction: [f32; 2]) -> Self {
        let n = normal.map(f64::from);
        let t = [tangent[0], tangent[1], tangent[2]].map(f64::from);
        let along = dot(t, n);
        let flat: [f64; 3] = std::array::from_fn(|k| t[k] - along * n[k]);
        let length = dot(flat, flat).sqrt();
        if length < 1e-6 || !length.is_finite() {
            return Place::about(normal);
        }
        let t = flat.map(|x| x / length);
        let b = cross(n, t).map(|x| if tangent[3] < 0.0 { -x } else { x });
        let [cosine, sine] = direction.map(f64::from);
        let turned: [f64; 3] = std::array::from_fn(|k| cosine * t[k] + sine * b[k]);
        let across: [f64; 3] = std::array::from_fn(|k| cosine * b[k] - sine * t[k]);
        Place { tangent: turned.map(|x| x as f32), bitangent: across.map(|x| x as f32), normal, coat_normal: normal }
    }

    fn local(&self, w: [f32; 3]) -> [f64; 3] {
        [self.tangent, self.bitangent, self.normal].map(|axis| dot(axis.map(f64::from), w.map(f64::from)))
    }

    fn world(&self, w: [f64; 3]) -> [f32; 3] {
        let [t, b, n] = [self.tangent, self.bitangent, self.normal].map(|axis| axis.map(f64::from));
        std::array::from_fn(|k| (w[0] * t[k] + w[1] * b[k] + w[2] * n[k]) as f32)
    }
}

/// A surface at one place. Colours are linear Rec.709.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface<'a> {
    /// Albedo of the base before anything covers it, 0..=1.
    pub diffuse: [f32; 3],
    /// F0 and F90 of what covers the base and takes its share of the light first; [0, 0] where the base gets everything.
    pub under: [f32; 2],
    /// Factor of the lobe's first term.
    pub f0: [f32; 3],
    /// Factor of the second.
    pub f90: f32,
    /// The lobe.
    pub lobe: Lobe<'a>,
    /// The clear coat.
    pub coat: Coat,
}

impl Default for Surface<'_> {
    /// Black.
    fn default() -> Self {
        Surface { diffuse: [0.0; 3], under: [0.0; 2], f0: [0.0; 3], f90: 0.0, lobe: Lobe::None, coat: Coat::default() }
    }
}

/// Probabilities of sampling coat, lobe and base.
struct Shares {
    coat: f32,
    lobe: f32,
}

impl Surface<'_> {
    /// Share of the light that passes the coat both ways, seen at `n_dot_v` of the coat's normal.
    pub(crate) fn under_coat(&self, coat_n_dot_v: f32) -> f32 {
        if self.coat.strength <= 0.0 { 1.0 } else { 1.0 - self.coat.strength * coat_albedo(coat_n_dot_v, self.coat.roughness) }
    }

    /// What a unit of irradiance leaves as diffuse radiance toward the local view direction, coat aside, sr⁻¹.
    fn base(&self, v: [f64; 3]) -> [f32; 3] {
        let factor = if self.under == [0.0; 2] {
            1.0
        } else {
            let [t0, t1] = self.lobe.albedo_terms(v);
            (1.0 - self.under[0] * t0[0] - self.under[1] * t1[0]).max(0.0)
        };
        self.diffuse.map(|albedo| albedo * factor / std::f32::consts::PI)
    }

    /// What a unit of irradiance leaves as diffuse radiance toward `v`, below the coat, sr⁻¹.
    pub fn diffuse_toward(&self, place: &Place, v: [f32; 3]) -> [f32; 3] {
        let under = self.under_coat(dot32(place.coat_normal, v));
        self.base(lift(place.local(v))).map(|base| under * base)
    }

    /// Radiance toward `v` of a place that receives `irradiance` (per channel, on its normal), `glossy` light in the lobe's two terms
    /// and `coat` light, the coat's two terms already weighted.
    pub(crate) fn relit(&self, place: &Place, v: [f32; 3], irradiance: [f32; 3], glossy: [[f32; 3]; 2], coat: [f32; 3]) -> [f32; 3] {
        let base = self.base(lift(place.local(v)));
        let under = self.under_coat(dot32(place.coat_normal, v));
        let strength = self.coat.strength;
        std::array::from_fn(|k| {
            under * (base[k] * irradiance[k] + self.f0[k] * glossy[0][k] + self.f90 * glossy[1][k]) + strength * coat[k]
        })
    }

    /// f(v, l) times n·l, sr⁻¹; 0 below the horizon of the normal (of the coat's for the coat).
    pub fn eval(&self, place: &Place, v: [f32; 3], l: [f32; 3]) -> [f32; 3] {
        let (wo, wi) = (lift(place.local(v)), place.local(l));
        let mut value = [0.0; 3];
        if wi[2] > 0.0 {
            let (base, terms) = (self.base(wo), self.lobe.terms(wo, wi));
            let under = self.under_coat(dot32(place.coat_normal, v));
            value =
                std::array::from_fn(|k| under * (base[k] * wi[2] as f32 + self.f0[k] * terms[0][k] as f32 + self.f90 * terms[1][k] as f32));
        }
        if self.coat.strength > 0.0 {
            let [c0, c1] = ggx::terms(place.coat_normal, v, l, self.coat.roughness);
            value = value.map(|x| x + self.coat.strength * (COAT_F0 * c0 + c1));
        }
        value
    }

    /// A direction toward the light, from a mixture of coat, lobe and cosine; `u` uniform in \[0, 1)³, `u[2]` picks the part.
    /// May lie below the horizon, where [`Self::eval`] is 0.
    pub fn sample(&self, place: &Place, v: [f32; 3], u: [f32; 3]) -> [f32; 3] {
        let wo = lift(place.local(v));
        let shares = self.shares(place, v, wo);
        if u[2] < shares.coat {
            return ggx::sample(place.coat_normal, v, self.coat.roughness, [u[0], u[1]]);
        }
        let uv = [f64::from(u[0]), f64::from(u[1])];
        if u[2] < shares.coat + shares.lobe {
            return place.world(self.lobe.sample(wo, uv));
        }
        place.world(lambert::sample(uv))
    }

    /// Density of [`Self::sample`] per solid angle, sr⁻¹.
    pub fn pdf(&self, place: &Place, v: [f32; 3], l: [f32; 3]) -> f32 {
        let (wo, wi) = (lift(place.local(v)), place.local(l));
        let shares = self.shares(place, v, wo);
        let coat = if shares.coat > 0.0 { shares.coat * ggx::pdf(place.coat_normal, v, l, self.coat.roughness) } else { 0.0 };
        let lobe = if shares.lobe > 0.0 { shares.lobe * self.lobe.pdf(wo, wi) as f32 } else { 0.0 };
        coat + lobe + (1.0 - shares.coat - shares.lobe) * lambert::pdf(wi) as f32
    }

    /// Directional albedo toward `v`: what a white sky leaves as radiance, divided by π for the base.
    pub fn albedo(&self, place: &Place, v: [f32; 3]) -> [f32; 3] {
        let wo = lift(place.local(v));
        let terms = self.lobe.albedo_terms(wo);
        let coat = coat_albedo(dot32(place.coat_normal, v), self.coat.roughness);
        self.relit(place, v, [std::f32::consts::PI; 3], terms, [coat; 3])
    }

    /// By their albedos; the lobe keeps 0.1..=0.9 of what base and lobe share, unless one of them is not there.
    fn shares(&self, place: &Place, v: [f32; 3], wo: [f64; 3]) -> Shares {
        let mean = |c: [f32; 3]| (c[0] + c[1] + c[2]) / 3.0;
        let terms = self.lobe.albedo_terms(wo);
        let lobe: f32 = (0..3).map(|k| self.f0[k] * terms[0][k] + self.f90 * terms[1][k]).sum::<f32>() / 3.0;
        let base = mean(self.base(wo)) * std::f32::consts::PI;
        let mut share = if self.lobe == Lobe::None {
            0.0
        } else if base <= 0.0 {
            1.0
        } else {
            (lobe / (lobe + base)).clamp(0.1, 0.9)
        };
        let mut coat = 0.0;
        if self.coat.strength > 0.0 {
            let own = self.coat.strength * coat_albedo(dot32(place.coat_normal, v), self.coat.roughness);
            coat = (own / (own + lobe + base)).clamp(0.1, 0.9);
            share *= 1.0 - coat;
        }
        Shares { coat, lobe: share }
    }
}

/// Directional albedo of a whole coat.
pub(crate) fn coat_albedo(n_dot_v: f32, roughness: f32) -> f32 {
    let [t0, t1] = ggx::albedo_terms(n_dot_v, roughness);
    COAT_F0 * t0 + t1
}

fn dot32(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
