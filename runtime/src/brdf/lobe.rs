//! One lobe: the specular part of a surface at one place, whatever its kind.
//!
//! ```text
//! f·n·l = F0 · terms[0] + F90 · terms[1]
//! ```
//!
//! For lobes without a Fresnel factor (Phong, Blinn-Phong, Ward) terms\[1\] is 0 and F0 is the specular colour; a measured one brings its
//! colours along, all in terms\[1\]. Directions are in the frame (tangent, bitangent, normal), v above the horizon ([`super::lift`]).
//! [`Lobe::albedo_terms`] comes from tables made once by quadrature, within [`ALBEDO_ERROR`], those of anisotropic lobes within
//! [`ANISOTROPIC_ALBEDO_ERROR`].

use super::albedo::{AlbedoTable, StretchedTable};
use super::frame::view;
use super::measured::Measured;
use super::{blinn_phong, cook_torrance, ggx, phong, ward};
use std::sync::OnceLock;

/// Largest absolute error of [`Lobe::albedo_terms`] of isotropic lobes (tested).
pub const ALBEDO_ERROR: f32 = 1e-2;

/// The same of anisotropic lobes, met at grazing and where one width is near the floor.
pub const ANISOTROPIC_ALBEDO_ERROR: f32 = 0.05;

/// A lobe and its widths: GGX and Ward alpha, slopes of Beckmann facets, exponents.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lobe<'a> {
    /// No lobe: a Lambert surface.
    None,
    /// Microfacets, [`ggx`].
    Ggx {
        /// Along tangent and bitangent, [`ggx::ALPHA_MIN`]..=1.
        alpha: [f64; 2],
    },
    /// [`phong`].
    Phong {
        /// s ≥ 0.
        exponent: f64,
    },
    /// [`blinn_phong`].
    BlinnPhong {
        /// s ≥ 0.
        exponent: f64,
    },
    /// [`ward`].
    Ward {
        /// Along tangent and bitangent, [`ggx::ALPHA_MIN`]..=1.
        alpha: [f64; 2],
    },
    /// [`cook_torrance`].
    CookTorrance {
        /// Root mean square slope of the facets, [`ggx::ALPHA_MIN`]..=1.
        slope: f64,
    },
    /// [`super::measured`].
    Measured(&'a Measured),
}

impl Lobe<'_> {
    /// f·n·l as the factors of F0 and F90, `[term][channel]`, sr⁻¹; 0 below the horizon.
    pub fn terms(&self, v: [f64; 3], l: [f64; 3]) -> [[f64; 3]; 2] {
        let gray = |value: f64| [[value; 3], [0.0; 3]];
        match *self {
            Lobe::None => [[0.0; 3]; 2],
            Lobe::Ggx { alpha } => ggx::local_terms(v, l, alpha).map(|term| [term; 3]),
            Lobe::Phong { exponent } => gray(phong::value(v, l, exponent)),
            Lobe::BlinnPhong { exponent } => gray(blinn_phong::value(v, l, exponent)),
            Lobe::Ward { alpha } => gray(ward::value(v, l, alpha)),
            Lobe::CookTorrance { slope } => cook_torrance::terms(v, l, slope).map(|term| [term; 3]),
            Lobe::Measured(table) => [[0.0; 3], table.value(v, l)],
        }
    }

    /// A direction about as the lobe; may lie below the horizon. `u` uniform in \[0, 1)². [`Lobe::None`] gives the normal.
    pub(crate) fn sample(&self, v: [f64; 3], u: [f64; 2]) -> [f64; 3] {
        match *self {
            Lobe::None => [0.0, 0.0, 1.0],
            Lobe::Ggx { alpha } => ggx::local_sample(v, alpha, u),
            Lobe::Phong { exponent } => phong::sample(v, exponent, u),
            Lobe::BlinnPhong { exponent } => blinn_phong::sample(v, exponent, u),
            Lobe::Ward { alpha } => ward::sample(v, alpha, u),
            Lobe::CookTorrance { slope } => cook_torrance::sample(v, slope, u),
            Lobe::Measured(table) => table.sample(v, u),
        }
    }

    /// Density of [`Lobe::sample`], sr⁻¹; 0 for [`Lobe::None`].
    pub(crate) fn pdf(&self, v: [f64; 3], l: [f64; 3]) -> f64 {
        match *self {
            Lobe::None => 0.0,
            Lobe::Ggx { alpha } => ggx::local_pdf(v, l, alpha),
            Lobe::Phong { exponent } => phong::pdf(v, l, exponent),
            Lobe::BlinnPhong { exponent } => blinn_phong::pdf(v, l, exponent),
            Lobe::Ward { alpha } => ward::pdf(v, l, alpha),
            Lobe::CookTorrance { slope } => cook_torrance::pdf(v, l, slope),
            Lobe::Measured(table) => table.pdf(v, l),
        }
    }

    /// Directional albedo ∫ f n·l dl as the factors of F0 and F90, toward the local view direction `v`.
    pub(crate) fn albedo_terms(&self, v: [f64; 3]) -> [[f32; 3]; 2] {
        static PHONG: OnceLock<AlbedoTable<48, 32>> = OnceLock::new();
        static BLINN_PHONG: OnceLock<AlbedoTable<48, 32>> = OnceLock::new();
        static WARD: OnceLock<AlbedoTable<48, 32>> = OnceLock::new();
        static COOK_TORRANCE: OnceLock<AlbedoTable<48, 32>> = OnceLock::new();
        let table = |table: &'static OnceLock<AlbedoTable<48, 32>>, alpha: f64, lobe: fn(f64) -> Lobe<'static>| {
            let table = table.get_or_init(|| AlbedoTable::new(|n_dot_v, alpha| lobe(alpha).albedo_quadrature(view(n_dot_v), 24, 16)));
            table.lookup(v[2] as f32, alpha.sqrt() as f32).map(|term| [term; 3])
        };
        static GGX_STRETCHED: OnceLock<StretchedTable> = OnceLock::new();
        static WARD_STRETCHED: OnceLock<StretchedTable> = OnceLock::new();
        let stretched = |table: &'static OnceLock<StretchedTable>, alpha: [f64; 2], lobe: fn([f64; 2]) -> Lobe<'static>| {
            let table = table.get_or_init(|| StretchedTable::new(|v, alpha| lobe(alpha).albedo_quadrature(v, 16, 12)));
            table.lookup(v, alpha).map(|term| [term; 3])
        };
        match *self {
            Lobe::None => [[0.0; 3]; 2],
            Lobe::Ggx { alpha } if alpha[0] != alpha[1] => stretched(&GGX_STRETCHED, alpha, |alpha| Lobe::Ggx { alpha }),
            Lobe::Ward { alpha } if alpha[0] != alpha[1] => stretched(&WARD_STRETCHED, alpha, |alpha| Lobe::Ward { alpha }),
            Lobe::Ggx { alpha } => ggx::albedo_terms(v[2] as f32, alpha[0].sqrt() as f32).map(|term| [term; 3]),
            Lobe::Phong { exponent } => table(&PHONG, phong::alpha(exponent), |alpha| Lobe::Phong { exponent: phong::exponent(alpha) }),
            Lobe::BlinnPhong { exponent } => {
                table(&BLINN_PHONG, phong::alpha(exponent), |alpha| Lobe::BlinnPhong { exponent: phong::exponent(alpha) })
            }
            Lobe::Ward { alpha } => table(&WARD, alpha[0], |alpha| Lobe::Ward { alpha: [alpha; 2] }),
            Lobe::CookTorrance { slope } => table(&COOK_TORRANCE, slope, |slope| Lobe::CookTorrance { slope }),
            Lobe::Measured(table) => [[0.0; 3], table.albedo(v[2] as f32)],
        }
    }

    /// The albedo by a grid of `rings` × `sectors` samples, value over density; channel 0.
    pub(crate) fn albedo_quadrature(&self, v: [f64; 3], rings: usize, sectors: usize) -> [f64; 2] {
        let mut sum = [0.0; 2];
        for i in 0..rings * sectors {
            // A ring's samples are turned against its neighbour's, or few sectors would always meet the same azimuths.
            let turn = (i / sectors) as f64 * 0.618_033_988_749_895;
            let u = [((i / sectors) as f64 + 0.5) / rings as f64, (((i % sectors) as f64 + 0.5) / sectors as f64 + turn).fract()];
            let l = self.sample(v, u);
            let (value, density) = (self.terms(v, l), self.pdf(v, l));
            if density > 0.0 {
                (0..2).for_each(|term| sum[term] += value[term][0] / density);
            }
        }
        sum.map(|term| term / (rings * sectors) as f64)
    }

    /// Whether the azimuth of the frame matters.
    pub fn is_anisotropic(&self) -> bool {
        match self {
            Lobe::Ggx { alpha } | Lobe::Ward { alpha } => alpha[0] != alpha[1],
            _ => false,
        }
    }
}
