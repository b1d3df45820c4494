//! A lobe as stored: 14 bytes.
//!
//! | record | |
//! |---|---|
//! | 0..3 | α, red, green, blue: half |
//! | 3 | grazing: half; the second Schlick term in units of the first |
//! | 4 | κ: half |
//! | 5, 6 | μ: octahedral, 16 bits an axis |
//!
//! Lossy: α and κ to 2⁻¹¹, μ to 6·10⁻⁵ rad (relative L2 0.0014 at κ = 10³, 0.014 at 10⁵); the second term has the colour of the first.

use super::lobe::Lobe;
use half::f16;

/// A lobe and its share of the second Schlick term.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TransferLobe {
    /// Factor of F0 (slices), or of the irradiance.
    pub lobe: Lobe,
    /// The term without F0, in units of the first; 0 for irradiance.
    pub grazing: f32,
}

/// A lobe as stored.
pub type Record = [u16; 7];

/// Rounds a lobe to its record. Not finite or too large becomes 0 or the largest half.
pub fn encode(lobe: &TransferLobe) -> Record {
    // NaN is not above 0.
    let half = |x: f32| f16::from_f32(if x > 0.0 { x.min(65504.0) } else { 0.0 }).to_bits();
    let [r, g, b] = lobe.lobe.weight.map(half);
    let [x, y] = octahedral(lobe.lobe.mu);
    [r, g, b, half(lobe.grazing), half(lobe.lobe.kappa), x, y]
}

/// The lobe of a record.
pub fn decode(record: &Record) -> TransferLobe {
    let half = |bits: u16| f16::from_bits(bits).to_f32();
    let weight = [half(record[0]), half(record[1]), half(record[2])];
    TransferLobe { lobe: Lobe { weight, mu: from_octahedral([record[5], record[6]]), kappa: half(record[4]) }, grazing: half(record[3]) }
}

fn octahedral(d: [f32; 3]) -> [u16; 2] {
    let sum = d[0].abs() + d[1].abs() + d[2].abs();
    if !(sum > 0.0 && sum.is_finite()) {
        return [32768, 32768];
    }
    let (mut x, mut y) = (d[0] / sum, d[1] / sum);
    if d[2] < 0.0 {
        (x, y) = ((1.0 - y.abs()) * 1f32.copysign(x), (1.0 - x.abs()) * 1f32.copysign(y));
    }
    // 65534 steps: both ends and the middle are hit exactly.
    [x, y].map(|c| (f64::from(c) * 32767.0 + 32767.5) as u16)
}

fn from_octahedral(bits: [u16; 2]) -> [f32; 3] {
    let [x, y] = bits.map(|b| (f32::from(b) - 32767.0) / 32767.0);
    let z = 1.0 - x.abs() - y.abs();
    let fold = (-z).max(0.0);
    let d = [x - fold.copysign(x), y - fold.copysign(y), z];
    let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
    if length > 0.0 { d.map(|c| c / length) } else { [0.0, 0.0, 1.0] }
}

/// Whether a record holds numbers only: none negative, none infinite.
pub(super) fn is_number(record: &Record) -> bool {
    record[..5].iter().all(|bits| bits & 0x8000 == 0 && bits & 0x7c00 != 0x7c00)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sphere::vmf::square_to_vmf;

    #[test]
    fn records_keep_lobes_to_their_promise() {
        for i in 0..2000 {
            let u = [(f64::from(i) + 0.5) / 2000.0, (f64::from(i) * 0.618_034).fract()];
            let mu = square_to_vmf([0.0, 0.0, 1.0], 0.0, u).map(|c| c as f32);
            let kappa = 10f32.powf(0.0025 * i as f32 - 1.0);
            let lobe = TransferLobe { lobe: Lobe { weight: [0.7, 0.01, 3e-5], mu, kappa }, grazing: 0.2 };
            let back = decode(&encode(&lobe));
            assert!(back.lobe.chord_squared(&lobe.lobe) < 6.3e-5f64.powi(2), "{mu:?} {back:?}");
            assert!((back.lobe.kappa / kappa - 1.0).abs() < 1.0 / 2048.0 && (back.grazing - 0.2).abs() < 1e-4);
        }
        for mu in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]] {
            let back = decode(&encode(&TransferLobe { lobe: Lobe { mu, ..Lobe::default() }, grazing: 0.0 }));
            assert!(back.lobe.chord_squared(&Lobe { mu, ..Lobe::default() }) < 1e-9, "{mu:?} {back:?}");
        }
    }

    #[test]
    fn halves_never_become_infinite_or_nan() {
        for kappa in [65519.0, 65520.0, 1e6, f32::INFINITY, f32::NAN, -1.0, 0.0, 6e-8, 1e-30] {
            let lobe = TransferLobe { lobe: Lobe { weight: [kappa; 3], mu: [f32::NAN, 0.0, 0.0], kappa }, grazing: kappa };
            let back = decode(&encode(&lobe));
            assert!(
                back.lobe.kappa.is_finite() && back.grazing.is_finite() && back.lobe.mu.iter().all(|c| c.is_finite()),
                "{kappa}: {back:?}"
            );
            if kappa >= 65519.0 {
                assert_eq!(back.lobe.kappa, 65504.0);
            }
        }
    }
}
