//! Glossy light of a point in two Schlick terms, and how exactly it is wanted.

/// Glossy radiance of a point toward the eye, `[term][channel]`: radiance = F0 · \[0\] + F90 · \[1\], W·sr⁻¹·m⁻².
pub type Glossy = [[f32; 3]; 2];

/// The budget of an error: how far a result may be off, relative to itself or to `floor` times the sphere's mean radiance if that is more.
///
/// An aim, not a bound. Measured on 4096 points × six kinds of surface of 32 random scenes that nothing was tuned on (both terms, all channels,
/// absolute errors summed), at [`Accuracy::FINE`]: of GGX half within 0.16 of it, 95 % within 1.0, 99 % within 1.7, the worst 5.2; of the
/// others less, but for a worst of 5.5. Looser ones keep farther below it: [`Accuracy::DISPLAY`] 99 % within 0.5.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Accuracy {
    /// Share of the result.
    pub relative: f32,
    /// Share of the sphere's mean radiance below which a result needs no relative accuracy.
    pub floor: f32,
}

impl Accuracy {
    /// For measurements and converged pictures: 60 to 120 dB in linear radiance, 85 to 160 dB of PSNR.
    pub const FINE: Accuracy = Accuracy { relative: GLOSSY_TOLERANCE, floor: GLOSSY_FLOOR };
    /// For a display: meant for errors of about a thousandth of white, the sky's mean radiance standing for white. Measured (bench
    /// `surfaces`, fourteen surfaces under a sky and under small lights): 60 to 105 dB of PSNR.
    pub const DISPLAY: Accuracy = Accuracy { relative: 2e-2, floor: 0.25 };

    /// The accuracy that keeps glossy light out of a relative L2 error of `max_error`: a twentieth of it.
    pub fn from_max_error(max_error: f32) -> Self {
        Accuracy { relative: (0.05 * max_error).clamp(0.0, 0.05), ..Accuracy::FINE }
    }
}

/// `relative` of [`Accuracy::FINE`].
pub const GLOSSY_TOLERANCE: f32 = 1e-3;
/// `floor` of [`Accuracy::FINE`].
pub const GLOSSY_FLOOR: f32 = 1e-2;
