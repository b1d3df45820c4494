//! Lengths as people write them: `0.03`, `"3cm"`, `"30 mm"`, `"0.03 m"`; in memory always metres.

use serde::Deserializer;
use serde::de::{Error, Visitor};
use std::fmt;

const UNITS: [(&str, f64); 9] =
    [("mm", 1e-3), ("cm", 1e-2), ("dm", 1e-1), ("m", 1.0), ("km", 1e3), ("in", 0.0254), ("ft", 0.3048), ("yd", 0.9144), ("", 1.0)];

/// Metres of a text: a number, and one of mm, cm, dm, m, km, in, ft, yd; without a unit metres. `None`: neither.
pub fn parse(text: &str) -> Option<f64> {
    let text = text.trim();
    let end = text.find(|c: char| c.is_alphabetic() && !matches!(c, 'e' | 'E')).unwrap_or(text.len());
    let (number, unit) = text.split_at(end);
    let metres = UNITS.iter().find(|(name, _)| name.eq_ignore_ascii_case(unit.trim()))?.1;
    Some(number.trim().parse::<f64>().ok()? * metres)
}

/// What a length looks like, for messages.
pub const FORM: &str = "a length: metres as 0.03, or with a unit as \"3cm\"";

/// Reads an optional length: a number of metres, or a text with a unit.
///
/// # Errors
/// Anything else.
pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    struct Length;
    impl Visitor<'_> for Length {
        type Value = f64;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str(FORM)
        }

        fn visit_f64<E: Error>(self, metres: f64) -> Result<f64, E> {
            Ok(metres)
        }

        fn visit_i64<E: Error>(self, metres: i64) -> Result<f64, E> {
            Ok(metres as f64)
        }

        fn visit_u64<E: Error>(self, metres: u64) -> Result<f64, E> {
            Ok(metres as f64)
        }

        fn visit_str<E: Error>(self, text: &str) -> Result<f64, E> {
            parse(text).ok_or_else(|| E::custom(format!("`{}` is not {FORM}", text.chars().take(40).collect::<String>())))
        }
    }
    deserializer.deserialize_any(Length).map(Some)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_metres_whatever_their_unit() {
        for (text, metres) in
            [("3cm", 0.03), ("30 mm", 0.03), ("0.03", 0.03), ("1e-2m", 0.01), ("2 km", 2000.0), ("1in", 0.0254), ("1.5M", 1.5)]
        {
            let found = parse(text).unwrap_or(f64::NAN);
            assert!((found - metres).abs() < 1e-12 * metres.max(1.0), "{text}: {found}");
        }
        for bad in ["", "cm", "3 parsec", "3cm cm", "three", "1,5m"] {
            assert_eq!(parse(bad), None, "{bad}");
        }
    }
}
