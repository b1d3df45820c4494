//! Byte counts as people write them: `12GiB`, `500MB`, `1.5 GiB`, `4096`.

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::borrow::Cow;
use std::fmt;
use std::str::FromStr;

/// A number of bytes.
///
/// In text: a decimal number and a unit, `B`, `kB`/`MB`/`GB`/`TB` (powers of 1000) or `KiB`/`MiB`/`GiB`/`TiB` (powers of 1024); case is
/// free, `K`, `M`, `G`, `T` alone are powers of 1024; no unit means bytes. Fractions are rounded down to whole bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ByteSize(pub u64);

/// Why a text is not a byte count.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a size: expected a number and a unit, as in 12GiB, 500MB or 4096")]
pub struct ParseByteSizeError(String);

const UNITS: [(&str, u64); 14] = [
    ("", 1),
    ("b", 1),
    ("k", 1 << 10),
    ("kb", 1_000),
    ("kib", 1 << 10),
    ("m", 1 << 20),
    ("mb", 1_000_000),
    ("mib", 1 << 20),
    ("g", 1 << 30),
    ("gb", 1_000_000_000),
    ("gib", 1 << 30),
    ("t", 1 << 40),
    ("tb", 1_000_000_000_000),
    ("tib", 1 << 40),
];

impl FromStr for ByteSize {
    type Err = ParseByteSizeError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        parse(text.trim()).map(ByteSize).ok_or_else(|| ParseByteSizeError(text.chars().take(80).collect()))
    }
}

/// Exact integer arithmetic: whole part and up to 18 digits of fraction, each times the unit.
fn parse(text: &str) -> Option<u64> {
    let number_length = text.bytes().take_while(|byte| byte.is_ascii_digit() || *byte == b'.').count();
    let (number, unit) = text.split_at(number_length);
    let unit = unit.trim().to_ascii_lowercase();
    let scale = UNITS.iter().find(|(name, _)| *name == unit)?.1;
    let (whole, fraction) = number.split_once('.').unwrap_or((number, ""));
    if whole.is_empty() || fraction.len() > 18 || (number.contains('.') && fraction.is_empty()) {
        return None;
    }
    let whole = whole.parse::<u64>().ok()?.checked_mul(scale)?;
    if fraction.is_empty() {
        return Some(whole);
    }
    let denominator = 10u128.pow(fraction.len() as u32);
    let part = u128::from(fraction.parse::<u64>().ok()?) * u128::from(scale) / denominator;
    whole.checked_add(u64::try_from(part).ok()?)
}

impl fmt::Display for ByteSize {
    /// At most four significant digits and a binary unit: `12 GiB`, `1.5 GiB`, `4.87 MiB`, `17 B`. For people: it rounds.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (name, shift) = match self.0 {
            bytes if bytes >= 1 << 40 => ("TiB", 40),
            bytes if bytes >= 1 << 30 => ("GiB", 30),
            bytes if bytes >= 1 << 20 => ("MiB", 20),
            bytes if bytes >= 1 << 10 => ("KiB", 10),
            bytes => return write!(f, "{bytes} B"),
        };
        let hundredths = (u128::from(self.0) * 100 + (1u128 << shift >> 1)) >> shift;
        let (whole, rest) = (hundredths / 100, hundredths % 100);
        match rest {
            0 => write!(f, "{whole} {name}"),
            rest if rest % 10 == 0 => write!(f, "{whole}.{} {name}", rest / 10),
            rest => write!(f, "{whole}.{rest:02} {name}"),
        }
    }
}

impl Serialize for ByteSize {
    /// Exact: the number of bytes when no binary unit divides it, else that unit.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let exact = [(1u64 << 40, "TiB"), (1 << 30, "GiB"), (1 << 20, "MiB"), (1 << 10, "KiB")];
        match exact.iter().find(|(scale, _)| self.0 != 0 && self.0.is_multiple_of(*scale)) {
            Some((scale, name)) => serializer.collect_str(&format_args!("{}{name}", self.0 / scale)),
            None => serializer.collect_str(&format_args!("{}B", self.0)),
        }
    }
}

impl<'de> Deserialize<'de> for ByteSize {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl serde::de::Visitor<'_> for Visitor {
            type Value = ByteSize;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a size such as \"12GiB\" or a number of bytes")
            }
            fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<ByteSize, E> {
                text.parse().map_err(E::custom)
            }
            fn visit_u64<E: serde::de::Error>(self, bytes: u64) -> Result<ByteSize, E> {
                Ok(ByteSize(bytes))
            }
            fn visit_i64<E: serde::de::Error>(self, bytes: i64) -> Result<ByteSize, E> {
                u64::try_from(bytes).map(ByteSize).map_err(|_| E::custom("a size is never negative"))
            }
        }
        deserializer.deserialize_any(Visitor)
    }
}

impl JsonSchema for ByteSize {
    fn schema_name() -> Cow<'static, str> {
        "ByteSize".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "A size in bytes: a number, or a text such as \"12GiB\" or \"500MB\".",
            "anyOf": [
                { "type": "integer", "minimum": 0 },
                { "type": "string", "pattern": "^[0-9]+(\\.[0-9]+)? ?([KkMmGgTt]([Ii]?[Bb])?|[Bb])?$" }
            ]
        })
    }
}

impl From<ByteSize> for u64 {
    fn from(size: ByteSize) -> u64 {
        size.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_as_people_write_them() {
        let cases: [(&str, u64); 14] = [
            ("0", 0),
            ("4096", 4096),
            ("17B", 17),
            ("12GiB", 12 << 30),
            ("12 gib", 12 << 30),
            ("12G", 12 << 30),
            ("500MB", 500_000_000),
            ("1.5GiB", 3 << 29),
            ("0.5kB", 500),
            ("2.0001kB", 2000),
            (" 3MiB ", 3 << 20),
            ("1TB", 1_000_000_000_000),
            ("16777215TiB", 16_777_215 << 40),
            ("18446744073709551615", u64::MAX),
        ];
        for (text, bytes) in cases {
            assert_eq!(text.parse(), Ok(ByteSize(bytes)), "{text}");
        }
    }

    #[test]
    fn other_text_is_refused_and_never_wraps() {
        for text in [
            "",
            "GiB",
            "-1",
            "1.",
            ".5GiB",
            "1.2.3",
            "12 giga",
            "1e9",
            "18446744073709551616",
            "16777216TiB",
            "0x10",
            "1GiB1",
            "١",
            "9.5 é",
        ] {
            assert!(text.parse::<ByteSize>().is_err(), "{text}");
        }
    }

    #[test]
    fn display_rounds_for_people_and_json_is_exact() {
        let cases = [(17, "17 B"), (1536, "1.5 KiB"), (12 << 30, "12 GiB"), (5_106_000, "4.87 MiB"), (u64::MAX, "16777216 TiB")];
        for (bytes, text) in cases {
            assert_eq!(ByteSize(bytes).to_string(), text);
        }
        for bytes in [0, 1, 1000, 1024, 3 << 29, u64::MAX, (12 << 30) + 1] {
            let json = serde_json::to_string(&ByteSize(bytes)).unwrap();
            assert_eq!(serde_json::from_str::<ByteSize>(&json).unwrap(), ByteSize(bytes), "{json}");
        }
        assert!(serde_json::from_str::<ByteSize>("-5").is_err());
        assert!(serde_json::from_str::<ByteSize>("1.5").is_err());
    }
}
