//! Appendix A: at how many places a block's surface is sampled.

use std::f32::consts::PI;

/// Exponents up to here are moderate: four terms near the mirror direction do.
const MODERATE: f32 = 30.0;
/// Exponents up to here are strong: sixteen terms near the mirror direction do. Beyond, texels.
const STRONG: f32 = 250.0;

/// Samples of a block: 1, 4, 16 or 256.
///
/// `cosine` of the angle between the view direction and the block's centre mirrored about the normal; `exponent` of the Phong lobe, `None` for a
/// surface without one. Source: \[IFL\] Appendix A; its gaps are closed as the head of [`super`] says.
pub fn samples(exponent: Option<f32>, cosine: f32) -> usize {
    let Some(exponent) = exponent else { return 1 };
    // cos(π/8) and cos(π/4).
    let (near, wide) = ((PI / 8.0).cos(), std::f32::consts::FRAC_1_SQRT_2);
    match exponent {
        s if s <= MODERATE => {
            if cosine > wide {
                4
            } else {
                1
            }
        }
        s if cosine > near => {
            if s <= STRONG {
                16
            } else {
                256
            }
        }
        _ => {
            if cosine > wide {
                4
            } else {
                1
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_of_the_appendix() {
        let at = |degrees: f32| degrees.to_radians().cos();
        let cases = [
            (None, 0.0, 1),
            (Some(10.0), 0.0, 4),
            (Some(10.0), 44.0, 4),
            (Some(10.0), 46.0, 1),
            (Some(30.0), 10.0, 4),
            (Some(31.0), 10.0, 16),
            (Some(100.0), 23.0, 4),
            (Some(100.0), 46.0, 1),
            (Some(250.0), 22.0, 16),
            (Some(251.0), 22.0, 256),
            (Some(251.0), 30.0, 4),
            (Some(251.0), 120.0, 1),
        ];
        for (exponent, degrees, expected) in cases {
            assert_eq!(samples(exponent, at(degrees)), expected, "{exponent:?} at {degrees}");
        }
    }
}
