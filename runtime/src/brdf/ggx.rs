//! GGX microfacet reflection, isotropic and anisotropic, single scattering, split into two Schlick terms.
//!
//! ```text
//! f(v, l)·n·l = D(h)·G2(v, l)·F(v·h) / (4 n·v n·l) · n·l,      h = (v + l) / |v + l|
//! D(h)        = a² / (π (a² cos²θ_h + sin²θ_h)²)
//! G2          = 2 n·v n·l / (n·l S(n·v) + n·v S(n·l)),         S(c) = √(a² + (1 − a²) c²)      height-correlated Smith
//! F(v·h)      = F0 + (1 − F0)(1 − v·h)⁵ = F0·(1 − s) + s,      s = (1 − v·h)⁵                  Schlick
//! ```
//!
//! so that f·n·l = F0·terms\[0\] + terms\[1\]: a caller that keeps the two sums may choose F0 later, per channel and per pixel.
//! Anisotropic, with widths a_x, a_y along the tangent and the bitangent:
//!
//! ```text
//! D(h) = 1 / (π a_x a_y (h_x²/a_x² + h_y²/a_y² + h_z²)²),     S(c) = √(a_x² c_x² + a_y² c_y² + c_z²)
//! ```
//!
//! [`stretched`] gives the widths of KHR_materials_anisotropy. Functions with `local` in their name take directions in the frame
//! (tangent, bitangent, normal) and `[a_x, a_y]`; the others are isotropic, in world space.
//!
//! | symbol | here |
//! |---|---|
//! | a | `alpha(roughness)` = max(roughness², [`ALPHA_MIN`]) |
//! | S | [`smith_root`] |
//! | D, G2 | never apart: n·l and n·v cancel in `D · n·l / (2 (n·l S(n·v) + n·v S(n·l)))`, finite at grazing |
//!
//! sin²θ_h is |n × h|², not 1 − cos²: at the smallest alpha the latter loses every digit of the peak.
//! Sources: Walter et al. 2007 (D), Heitz 2014 (G2), Dupuy and Benyoub 2023 (sampling of visible normals by spherical caps).
//!
//! Lossy: energy of multiple scattering is missing (albedo 0.56 at roughness 1, F0 = 1, n·v = 0.3). A view direction below the normal's
//! horizon is lifted to n·v = [`N_DOT_V_MIN`], see [`lift_view`].

use super::albedo::AlbedoTable;
pub use super::frame::{ALPHA_MIN, N_DOT_V_MIN};
use super::frame::{cross, half_vector, reflect};
use crate::sphere::frame::{dot, tangents};
use std::f64::consts::PI;
use std::sync::OnceLock;

/// Width of the lobe: roughness², at least [`ALPHA_MIN`]. `roughness` is glTF's perceptual roughness, clamped to 0..=1.
pub fn alpha(roughness: f32) -> f64 {
    let roughness = f64::from(roughness.clamp(0.0, 1.0));
    (roughness * roughness).max(ALPHA_MIN)
}

/// S(c) = √(a² + (1 − a²) c²) of the Smith terms, at `cosine` = n·v or n·l.
pub(crate) fn smith_root(alpha: f64, cosine: f64) -> f64 {
    (alpha * alpha + (1.0 - alpha * alpha) * cosine * cosine).sqrt()
}

/// The view direction that shading uses: `v` itself where n·v ≥ [`N_DOT_V_MIN`], else the nearest unit vector in the plane of n and v
/// that has that cosine. Bent normals need it: a point that is seen can have its normal turned away.
pub(crate) fn lift_view(n: [f64; 3], v: [f64; 3]) -> [f64; 3] {
    let n_dot_v = dot(n, v);
    if n_dot_v >= N_DOT_V_MIN {
        return v;
    }
    let along: [f64; 3] = std::array::from_fn(|k| v[k] - n_dot_v * n[k]);
    let length = dot(along, along).sqrt();
    if length < 1e-6 {
        return n;
    }
    let sine = (1.0 - N_DOT_V_MIN * N_DOT_V_MIN).sqrt() / length;
    std::array::from_fn(|k| N_DOT_V_MIN * n[k] + sine * along[k])
}

/// The lobe times n·l as the factor of F0 and the rest: `[D G2 n·l / (4 n·v n·l) · (1 − s), the same · s]`, in sr⁻¹.
///
/// `n`, `v`, `l` unit. 0 where n·l ≤ 0. Error: f64 inside, so that of the inputs.
pub fn terms(n: [f32; 3], v: [f32; 3], l: [f32; 3], roughness: f32) -> [f32; 2] {
    terms_f64(n.map(f64::from), v.map(f64::from), l.map(f64::from), alpha(roughness)).map(|term| term as f32)
}

/// [`terms`] in f64, of `alpha` instead of roughness.
pub(crate) fn terms_f64(n: [f64; 3], v: [f64; 3], l: [f64; 3], alpha: f64) -> [f64; 2] {
    let n_dot_l = dot(n, l);
    if n_dot_l <= 0.0 {
        return [0.0; 2];
    }
    let v = lift_view(n, v);
    let n_dot_v = dot(n, v);
    let geometry = 0.5 * n_dot_l / (n_dot_l * smith_root(alpha, n_dot_v) + n_dot_v * smith_root(alpha, n_dot_l));
    let h = half_vector(v, l);
    let lobe = normal_distribution(n, h, alpha) * geometry;
    let s = schlick(dot(v, h));
    [lobe * (1.0 - s), lobe * s]
}

/// A direction toward the light, distributed as the visible normals: `u` uniform in \[0, 1)². May lie below the horizon, where
/// [`terms`] is 0.
pub fn sample(n: [f32; 3], v: [f32; 3], roughness: f32, u: [f32; 2]) -> [f32; 3] {
    let alpha = alpha(roughness);
    let (t, b) = tangents(n);
    let (t, b, n) = (t.map(f64::from), b.map(f64::from), n.map(f64::from));
    let v = lift_view(n, v.map(f64::from));
    let local = [dot(t, v), dot(b, v), dot(n, v)];
    let h = visible_normal(local, [alpha; 2], u.map(f64::from));
    let l = reflect(local, h);
    std::array::from_fn(|k| (l[0] * t[k] + l[1] * b[k] + l[2] * n[k]) as f32)
}

/// Density of [`sample`] per solid angle of l, sr⁻¹.
pub fn pdf(n: [f32; 3], v: [f32; 3], l: [f32; 3], roughness: f32) -> f32 {
    let alpha = alpha(roughness);
    let (n, l) = (n.map(f64::from), l.map(f64::from));
    let v = lift_view(n, v.map(f64::from));
    let h = half_vector(v, l);
    if dot(h, n) <= 0.0 {
        return 0.0;
    }
    let n_dot_v = dot(n, v);
    (normal_distribution(n, h, alpha) / (2.0 * (n_dot_v + smith_root(alpha, n_dot_v)))) as f32
}

/// S(c) of anisotropic widths, at a unit direction of the local frame.
pub(crate) fn smith_root_local(alpha: [f64; 2], c: [f64; 3]) -> f64 {
    let [x, y] = [alpha[0] * c[0], alpha[1] * c[1]];
    (x * x + y * y + c[2] * c[2]).sqrt()
}

/// [`terms`] of anisotropic widths in the local frame. `v` above the horizon; 0 where l is below.
pub(crate) fn local_terms(v: [f64; 3], l: [f64; 3], alpha: [f64; 2]) -> [f64; 2] {
    if l[2] <= 0.0 {
        return [0.0; 2];
    }
    let geometry = 0.5 * l[2] / (l[2] * smith_root_local(alpha, v) + v[2] * smith_root_local(alpha, l));
    let h = half_vector(v, l);
    let lobe = local_distribution(h, alpha) * geometry;
    let s = schlick(dot(v, h));
    [lobe * (1.0 - s), lobe * s]
}

/// A direction toward the light from the visible normals of anisotropic widths; `u` uniform in \[0, 1)².
pub(crate) fn local_sample(v: [f64; 3], alpha: [f64; 2], u: [f64; 2]) -> [f64; 3] {
    reflect(v, visible_normal(v, alpha, u))
}

/// Density of [`local_sample`] per solid angle of l, sr⁻¹.
pub(crate) fn local_pdf(v: [f64; 3], l: [f64; 3], alpha: [f64; 2]) -> f64 {
    let h = half_vector(v, l);
    if h[2] <= 0.0 { 0.0 } else { local_distribution(h, alpha) / (2.0 * (v[2] + smith_root_local(alpha, v))) }
}

/// Widths along tangent and bitangent of a lobe of width `alpha` with a strength 0..1: mix(alpha, 1, strength²) and alpha.
/// Source: KHR_materials_anisotropy.
pub(crate) fn stretched(alpha: f64, strength: f64) -> [f64; 2] {
    [alpha + (1.0 - alpha) * strength * strength, alpha]
}

fn local_distribution(h: [f64; 3], alpha: [f64; 2]) -> f64 {
    let [x, y] = [h[0] / alpha[0], h[1] / alpha[1]];
    let spread = x * x + y * y + h[2] * h[2];
    1.0 / (PI * alpha[0] * alpha[1] * spread * spread)
}

/// Directional albedo ∫ f n·l dl of a surface seen at `n_dot_v`, as the factor of F0 and the rest: E = F0·t0 + t1.
///
/// From a table made once by quadrature, 64 × 40. Each term is within [`ALBEDO_ERROR`] of the exact integral, within a third of that where
/// n·v ≥ 0.05. t0 + t1 ≤ 1. n·v below [`N_DOT_V_MIN`] counts as that.
pub fn albedo_terms(n_dot_v: f32, roughness: f32) -> [f32; 2] {
    static TABLE: OnceLock<AlbedoTable<64, 40>> = OnceLock::new();
    let exact = |n_dot_v, alpha| albedo_quadrature(n_dot_v, alpha, RINGS, SECTORS);
    TABLE.get_or_init(|| AlbedoTable::new(exact)).lookup(n_dot_v, roughness)
}

/// Nodes of the quadrature behind [`albedo_terms`].
const RINGS: usize = 32;
const SECTORS: usize = 16;

/// Largest absolute error of [`albedo_terms`], measured against a quadrature of 18 times as many nodes; met where n·v is near alpha.
pub const ALBEDO_ERROR: f32 = 5e-3;

/// The two albedo integrals by quadrature over visible normals, for `n_dot_v` > 0. Deterministic.
///
/// `rings` × `sectors` midpoints of (z, φ) on the spherical cap; the weight left over is G2 / G1(v).
pub(crate) fn albedo_quadrature(n_dot_v: f64, alpha: f64, rings: usize, sectors: usize) -> [f64; 2] {
    let n_dot_v = n_dot_v.max(N_DOT_V_MIN);
    let v = [(1.0 - n_dot_v * n_dot_v).max(0.0).sqrt(), 0.0, n_dot_v];
    let s_v = smith_root(alpha, n_dot_v);
    let mut sum = [0.0; 2];
    for ring in 0..rings {
        for sector in 0..sectors {
            // Half the circle is enough: the integrand is even in φ. 1 − q³ crowds rings where steep facets cut the lobe off.
            let q = (ring as f64 + 0.5) / rings as f64;
            let u = [0.5 * (sector as f64 + 0.5) / sectors as f64, 1.0 - q * q * q];
            let h = visible_normal(v, [alpha; 2], u);
            let n_dot_l = reflect(v, h)[2];
            if n_dot_l > 0.0 {
                let share = n_dot_l * (n_dot_v + s_v) / (n_dot_l * s_v + n_dot_v * smith_root(alpha, n_dot_l));
                let weight = 3.0 * q * q * share;
                let s = schlick(dot(v, h));
                sum[0] += weight * (1.0 - s);
                sum[1] += weight * s;
            }
        }
    }
    sum.map(|term| term / (rings * sectors) as f64)
}

/// (1 − cosine)⁵, Schlick's share of white.
pub(crate) fn schlick(cosine: f64) -> f64 {
    let rest = (1.0 - cosine).clamp(0.0, 1.0);
    let square = rest * rest;
    square * square * rest
}

fn normal_distribution(n: [f64; 3], h: [f64; 3], alpha: f64) -> f64 {
    let (cosine, sine) = (dot(n, h), cross(n, h));
    let a2 = alpha * alpha;
    let spread = a2 * cosine * cosine + dot(sine, sine);
    a2 / (PI * spread * spread)
}

/// Normal of a facet that `v` sees, in the frame where n is +Z. The stretched view direction reflects a uniform point of the cap z > −v.z.
fn visible_normal(v: [f64; 3], alpha: [f64; 2], u: [f64; 2]) -> [f64; 3] {
    let stretched = normalised([alpha[0] * v[0], alpha[1] * v[1], v[2]]);
    let phi = 2.0 * PI * u[0];
    let z = (1.0 - u[1]) * (1.0 + stretched[2]) - stretched[2];
    let radius = (1.0 - z * z).max(0.0).sqrt();
    let cap = [radius * libm::cos(phi), radius * libm::sin(phi), z];
    let h: [f64; 3] = std::array::from_fn(|k| cap[k] + stretched[k]);
    normalised([alpha[0] * h[0], alpha[1] * h[1], h[2].max(0.0)])
}

fn normalised(x: [f64; 3]) -> [f64; 3] {
    let length = dot(x, x).sqrt();
    if length < 1e-12 { [0.0, 0.0, 1.0] } else { x.map(|c| c / length) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROUGHNESSES: [f32; 7] = [0.0, 0.05, 0.2, 0.35, 0.5, 0.8, 1.0];
    const COSINES: [f32; 7] = [0.001, 0.01, 0.06, 0.2, 0.5, 0.9, 1.0];

    fn view(cosine: f32) -> [f32; 3] {
        [(1.0 - cosine * cosine).sqrt(), 0.0, cosine]
    }

    #[test]
    fn lobe_without_its_cosine_is_reciprocal() {
        let n = [0.0, 0.0, 1.0];
        for roughness in ROUGHNESSES {
            for a in COSINES {
                for (b, phi) in [(0.3f32, 1.0f32), (0.9, 3.0), (0.02, 2.5)] {
                    let sine = (1.0 - b * b).sqrt();
                    let (v, l) = (view(a), [sine * phi.cos(), sine * phi.sin(), b]);
                    let (one, other) = (terms(n, v, l, roughness), terms(n, l, v, roughness));
                    for k in 0..2 {
                        let (f, g) = (one[k] / l[2], other[k] / v[2]);
                        assert!((f - g).abs() <= 1e-5 * f.abs().max(1e-12), "{roughness} {a} {b}: {f} {g}");
                    }
                }
            }
        }
    }

    /// The table against an integral that knows nothing of visible normals: `terms_f64` over l in polar coordinates around the mirror direction.
    #[test]
    fn albedo_agrees_with_brute_quadrature_of_the_lobe() {
        for roughness in [0.2, 0.35, 0.5, 0.8, 1.0] {
            for cosine in [0.05, 0.2, 0.5, 0.9, 1.0] {
                let (v, n) = (view(cosine).map(f64::from), [0.0, 0.0, 1.0]);
                let mirror = [-v[0] as f32, -v[1] as f32, v[2] as f32];
                let (t, b) = tangents(mirror);
                let (t, b, m) = (t.map(f64::from), b.map(f64::from), mirror.map(f64::from));
                let (rings, sectors) = (800, 120);
                let mut sum = [0.0; 2];
                for i in 0..rings {
                    // θ = π q³ puts most rings into the peak; dω = sin θ · 3π q² dq dφ.
                    let q = (i as f64 + 0.5) / rings as f64;
                    let theta = PI * q * q * q;
                    let measure = libm::sin(theta) * 3.0 * PI * q * q / rings as f64 * 2.0 * PI / sectors as f64;
                    for j in 0..sectors {
                        let phi = 2.0 * PI * (j as f64 + 0.5) / sectors as f64;
                        let (x, y, z) = (libm::sin(theta) * libm::cos(phi), libm::sin(theta) * libm::sin(phi), libm::cos(theta));
                        let l = std::array::from_fn(|k| x * t[k] + y * b[k] + z * m[k]);
                        let value = terms_f64(n, v, l, alpha(roughness));
                        (0..2).for_each(|k| sum[k] += value[k] * measure);
                    }
                }
                let table = albedo_terms(cosine, roughness);
                for k in 0..2 {
                    assert!((sum[k] - f64::from(table[k])).abs() < f64::from(ALBEDO_ERROR), "{roughness} {cosine}: {sum:?} {table:?}");
                }
            }
        }
    }

    #[test]
    fn albedo_table_stays_within_its_stated_error_and_below_one() {
        let mut worst = (0.0f32, 0.0, 0.0);
        for i in 0..=60 {
            let roughness = i as f32 / 60.0 * 0.997 + 0.002;
            for j in 0..=60 {
                let root = j as f32 / 60.0;
                let cosine = (root * root).max(N_DOT_V_MIN as f32);
                let exact = albedo_quadrature(f64::from(cosine), alpha(roughness), 192, 48);
                let table = albedo_terms(cosine, roughness);
                assert!(table[0] + table[1] <= 1.0 + 1e-6, "{roughness} {cosine}");
                for k in 0..2 {
                    let error = (exact[k] as f32 - table[k]).abs() * if cosine < 0.05 { 1.0 } else { 3.0 };
                    if error > worst.0 {
                        worst = (error, roughness, cosine);
                    }
                }
            }
        }
        assert!(worst.0 < ALBEDO_ERROR, "worst error, roughness, n·v: {worst:?}");
    }

    /// Σ value/pdf over a grid of u is the albedo: `sample`, `pdf` and `terms` belong together.
    #[test]
    fn sampling_with_its_density_gives_the_albedo() {
        let n = [0.36, 0.48, 0.8];
        let (t, _) = tangents(n);
        for roughness in ROUGHNESSES {
            for cosine in COSINES {
                let sine = (1.0 - cosine * cosine).sqrt();
                let v = std::array::from_fn(|k| cosine * n[k] + sine * t[k]);
                let (grid, rings) = (32, 512);
                let mut sum = [0.0f64; 2];
                for i in 0..grid * rings {
                    let u = [((i % grid) as f32 + 0.5) / grid as f32, ((i / grid) as f32 + 0.5) / rings as f32];
                    let l = sample(n, v, roughness, u);
                    let density = pdf(n, v, l, roughness);
                    let value = terms(n, v, l, roughness);
                    if value[0] + value[1] > 0.0 {
                        (0..2).for_each(|k| sum[k] += f64::from(value[k] / density));
                    }
                }
                let table = albedo_terms(cosine, roughness);
                for k in 0..2 {
                    let mean = sum[k] / (grid * rings) as f64;
                    assert!((mean - f64::from(table[k])).abs() < 4e-3, "{roughness} {cosine}: {mean} {table:?}");
                }
            }
        }
    }

    /// The density integrates to at most 1 over the sphere of l (a little goes below the horizon), and to 1 when seen along n.
    #[test]
    fn density_integrates_to_one() {
        let n = [0.0, 0.0, 1.0];
        for (roughness, cosine) in [(0.3, 1.0), (0.5, 0.7), (0.8, 0.3), (1.0, 0.9), (1.0, 0.02)] {
            let (rings, sectors) = (1500, 200);
            let mut sum = 0.0;
            for i in 0..rings {
                let z = -1.0 + 2.0 * (i as f64 + 0.5) / rings as f64;
                for j in 0..sectors {
                    let phi = 2.0 * PI * (j as f64 + 0.5) / sectors as f64;
                    let radius = (1.0 - z * z).sqrt();
                    let l = [radius * libm::cos(phi), radius * libm::sin(phi), z].map(|x| x as f32);
                    sum += f64::from(pdf(n, view(cosine), l, roughness)) * 4.0 * PI / (rings * sectors) as f64;
                }
            }
            assert!((sum - 1.0).abs() < 1e-2, "{roughness} {cosine}: {sum}");
        }
    }

    #[test]
    fn odd_views_stay_finite() {
        let n = [0.0, 0.0, 1.0];
        for v in [[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.6, 0.0, -0.8], [1e-9, 0.0, -1.0]] {
            for l in [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [-1.0, 0.0, 1e-7], [-0.6, 0.0, 0.8]] {
                for roughness in ROUGHNESSES {
                    let value = terms(n, v, l, roughness);
                    assert!(value.iter().all(|x| x.is_finite() && *x >= 0.0) && pdf(n, v, l, roughness).is_finite());
                }
            }
        }
    }
}
