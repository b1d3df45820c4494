//! Values that light cannot have are replaced and counted: NaN, infinities and negatives.

/// Largest radiance of an environment, W·sr⁻¹·m⁻²: nine decades above the sun's, so that sums and products of light stay finite.
pub const MOST_RADIANCE: f32 = 1e18;

/// What was changed in, or passed over by, the decoding of an environment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CleanReport {
    /// Channel values that were NaN, now 0.
    pub nan: u64,
    /// Channel values that were +∞, now the largest finite value of the image (0 when it has none).
    pub infinite: u64,
    /// Channel values below zero (−∞ too), now 0.
    pub negative: u64,
    /// Channel values above [`MOST_RADIANCE`], now that.
    pub too_large: u64,
    /// The largest finite value of any channel, at most [`MOST_RADIANCE`].
    pub largest: f32,
    /// What the file says and prelight passes over, one sentence each.
    pub notes: Vec<String>,
}

impl CleanReport {
    /// One warning per thing that a user may want to know; empty for a clean image.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        for (count, kind, now) in [
            (self.nan, "not numbers", "0".to_owned()),
            (self.infinite, "infinite", format!("{}, the largest finite one", self.largest)),
            (self.negative, "negative", "0".to_owned()),
            (self.too_large, "brighter than any light", format!("{MOST_RADIANCE:e}")),
        ] {
            if count > 0 {
                warnings.push(format!("{count} channel values are {kind}; set to {now}"));
            }
        }
        warnings.extend(self.notes.iter().cloned());
        warnings
    }
}

/// Replaces what light cannot be, in place.
pub(super) fn clean(pixels: &mut [[f32; 3]]) -> CleanReport {
    let finite = pixels.iter().flatten().copied().filter(|value| value.is_finite());
    let mut report = CleanReport { largest: finite.fold(0.0, f32::max).min(MOST_RADIANCE), ..CleanReport::default() };
    for value in pixels.iter_mut().flatten() {
        if value.is_nan() {
            report.nan += 1;
            *value = 0.0;
        } else if *value < 0.0 {
            report.negative += 1;
            *value = 0.0;
        } else if value.is_infinite() {
            report.infinite += 1;
            *value = report.largest;
        } else if *value > MOST_RADIANCE {
            report.too_large += 1;
            *value = MOST_RADIANCE;
        }
    }
    report
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impossible_values_are_replaced_and_counted() {
        let mut pixels = [[f32::NAN, 1.0, -2.0], [f32::INFINITY, f32::NEG_INFINITY, 7.5], [-0.0, 0.0, f32::INFINITY]];
        let report = clean(&mut pixels);
        assert_eq!(pixels, [[0.0, 1.0, 0.0], [7.5, 0.0, 7.5], [0.0, 0.0, 7.5]]);
        assert_eq!((report.nan, report.infinite, report.negative, report.largest), (1, 2, 2, 7.5));
        assert_eq!(report.warnings().len(), 3);
        assert_eq!(clean(&mut pixels).warnings(), Vec::<String>::new());
    }

    #[test]
    fn what_is_brighter_than_any_light_is_cut_and_counted() {
        let mut pixels = [[f32::MAX, 2e18, f32::INFINITY]];
        let report = clean(&mut pixels);
        assert_eq!((pixels, report.too_large, report.infinite), ([[1e18; 3]], 2, 1));
        assert_eq!(report.warnings().len(), 2);
    }

    #[test]
    fn an_image_without_finite_values_turns_black() {
        let mut pixels = [[f32::INFINITY, f32::NAN, f32::INFINITY]];
        assert_eq!((clean(&mut pixels).infinite, pixels), (2, [[0.0; 3]]));
    }
}
