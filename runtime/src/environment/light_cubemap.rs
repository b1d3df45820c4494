//! Light on the cubemap: flux and moment per texel, what every technique prepares from.

use super::{Environment, Splatter};

/// Distant light, gathered into the texels of a cubemap ([`crate::sphere::cubemap`]).
///
/// Each source pixel is spread over the nearest texel centres with continuous weights that sum to 1 ([`Splatter`]); a texel
/// keeps the flux and the moment of what it received. With L the radiance times `intensity` and w the weight of this texel:
///
/// ```text
/// flux[texel][c]         = Σ w ∫ L_c dω            W·m⁻²
/// moment[texel][c][axis] = Σ w ∫ L_c ω_axis dω     W·m⁻²
/// ```
///
/// So the irradiance of a point with normal n that sees the texels S is Σ_{S} n·moment, and it equals that of the exact image
/// where S holds every texel that the light above the horizon was spread over. Error: at 64² a source pixel reaches
/// texel centres at most 2.6° away, so light nearer than that to the horizon can lose a part (or bring one from below). Relative
/// error of the unoccluded irradiance of a one-pixel sun, 64² faces (random suns, turns and normals; printed by the test):
///
/// | sun above the horizon | mean | largest |
/// |---|---|---|
/// | 0.2° to 1° | 0.18 | 0.8 |
/// | 1° to 2° | 0.01 | 0.25 |
/// | 2° to 3° | 3e-7 | 2e-6 |
/// | 3° to 4° | 3e-7 | 5e-6 |
/// | from 4° on | 3e-8 | 2e-7 |
#[derive(Clone, Debug, PartialEq)]
pub struct LightCubemap {
    /// Texels along a side of a face.
    pub face_resolution: usize,
    /// Flux per texel and channel. Shape `[6·n²]`, texels row-major: `face·n² + y·n + x`. Finite, not negative.
    pub flux: Vec<[f32; 3]>,
    /// Moment per texel, `[texel][channel][axis]`. Shape `[6·n²]`. Its length per channel is at most the flux.
    pub moment: Vec<[[f32; 3]; 3]>,
}

/// Energy of an environment and of the cubemap made from it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnergyReport {
    /// ∫ L dω over the source image, per channel, W·m⁻².
    pub before: [f64; 3],
    /// Sum of `flux` over all texels, per channel. Differs from `before` by f32 rounding alone.
    pub after: [f64; 3],
}

impl EnergyReport {
    /// Largest relative difference of a channel.
    pub fn relative_loss(&self) -> f64 {
        let loss = |c: usize| (self.after[c] - self.before[c]).abs() / self.before[c].abs().max(f64::MIN_POSITIVE);
        loss(0).max(loss(1)).max(loss(2))
    }
}

impl LightCubemap {
    /// A cubemap without light. `face_resolution` is at least 2.
    pub fn black(face_resolution: usize) -> Self {
        let n_texels = 6 * face_resolution * face_resolution;
        Self { face_resolution, flux: vec![[0.0; 3]; n_texels], moment: vec![[[0.0; 3]; 3]; n_texels] }
    }

    /// Light of an environment at a face resolution of at least 2: an asset's [`crate::asset::Asset::face_resolution`].
    #[must_use]
    pub fn from_environment(environment: &Environment, face_resolution: usize) -> Self {
        Self::with_energy(environment, face_resolution).0
    }

    /// [`LightCubemap::from_environment`], and the energy before and after: what shows that none was lost.
    #[must_use]
    pub fn with_energy(environment: &Environment, face_resolution: usize) -> (Self, EnergyReport) {
        let mut light = Self::black(face_resolution);
        let report = light.update_from(environment, &mut Splatter::new(face_resolution));
        (light, report)
    }

    /// Replaces the light by that of another environment, or of the same one turned. No allocation after the splatter's first
    /// image of this size.
    ///
    /// # Panics
    /// When the splatter was made for another face resolution.
    pub fn update_from(&mut self, environment: &Environment, splatter: &mut Splatter) -> EnergyReport {
        splatter.splat(environment, self)
    }
}
