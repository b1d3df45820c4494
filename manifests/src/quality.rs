//! Quality presets: documented sets of knobs. A knob set in `scene.toml` or on the command line wins over its preset.
//!
//! | knob | draft | medium | high | what it does |
//! |---|---|---|---|---|
//! | `points` | 50 000 | 200 000 | 1 000 000 | point budget that is turned into an edge length when none is given |
//! | `normal_angle_deg` | 40 | 25 | 15 | edges whose end normals differ by more are split |
//! | `area_floor` | 1/4 | 1/4 | 1/8 | shadow edges are split down to this share of the edge length |
//! | `max_error` | 0.05 | 0.02 | 0.01 | relative L2 of radiance aimed at, per object |
//! | `coarser` | false | false | false | where the mesh is finer than the edge length, only some of its vertices are baked |
//! | `face_resolution` | 64 | 64 | 64 | texels along a cubemap face's side |
//! | `visibility` | binary | binary | binary | shades of a texel at a shadow's edge |
//! | `bvh` | fast | medium | medium | how long the BVH build may take; changes no bit of the result |

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// A preset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Quality {
    /// Seconds: to see whether the scene is right.
    Draft,
    /// The default.
    #[default]
    Medium,
    /// For final pictures.
    High,
}

/// How long the BVH build may take. Never changes a bit of the result.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum BvhBuild {
    /// Quick to build, slower to trace.
    Fast,
    /// The default.
    #[default]
    Medium,
    /// Slow to build, quickest to trace.
    Slow,
}

/// How finely a texel's openness is told apart.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Shades {
    /// Open or closed, by the texel's centre. Lossless.
    #[default]
    Binary,
    /// 64 samples a texel where something's edge crosses it, in 2 bits: thirds.
    Gray2,
    /// The same in 4 bits.
    Gray4,
    /// The same in 6 bits.
    Gray6,
    /// The same in 8 bits.
    Gray8,
    /// The same, not quantised: 64ths.
    Gray,
}

impl Shades {
    /// Names as written.
    pub const NAMES: [&'static str; 6] = ["binary", "gray2", "gray4", "gray6", "gray8", "gray"];

    /// All of them, in the order of their names.
    const ALL: [Shades; 6] = [Shades::Binary, Shades::Gray2, Shades::Gray4, Shades::Gray6, Shades::Gray8, Shades::Gray];

    /// By its name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|all| all.name() == name)
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        Self::NAMES[self as usize]
    }

    /// By the steps from closed to open of a chunk; `None`: binary.
    pub fn of_steps(steps: Option<u32>) -> Option<Self> {
        Self::ALL.into_iter().find(|all| all.steps() == steps)
    }

    /// Steps from closed to open; `None` of binary.
    pub fn steps(self) -> Option<u32> {
        match self {
            Shades::Binary => None,
            Shades::Gray2 => Some(3),
            Shades::Gray4 => Some(15),
            Shades::Gray6 => Some(63),
            Shades::Gray8 => Some(255),
            Shades::Gray => Some(64),
        }
    }
}

/// Everything that a preset decides.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Knobs {
    /// Point budget, turned into an edge length once when no edge length is given.
    pub points: u64,
    /// Degrees between the normals at an edge's ends above which it is split, 1..=180.
    pub normal_angle_deg: f64,
    /// Shortest edge that refinement at shadow edges makes, as a share of the edge length, in 0..=1.
    pub area_floor: f64,
    /// Relative L2 of radiance aimed at, per object.
    pub max_error: f64,
    /// Where the mesh is finer than the edge length, only some of its vertices are baked; the others interpolate.
    pub coarser: bool,
    /// Texels along a cubemap face's side, 64 or 128.
    pub face_resolution: u32,
    /// How finely a texel's openness is told apart.
    pub visibility: Shades,
    /// How long the BVH build may take.
    pub bvh: BvhBuild,
}

impl Quality {
    /// Names as written, in rising order.
    pub const NAMES: [&'static str; 3] = ["draft", "medium", "high"];

    /// The knobs behind the name.
    pub fn knobs(self) -> Knobs {
        let (points, normal_angle_deg, area_floor, max_error, bvh) = match self {
            Quality::Draft => (50_000, 40.0, 1.0 / 4.0, 0.05, BvhBuild::Fast),
            Quality::Medium => (200_000, 25.0, 1.0 / 4.0, 0.02, BvhBuild::Medium),
            Quality::High => (1_000_000, 15.0, 1.0 / 8.0, 0.01, BvhBuild::Medium),
        };
        let (coarser, face_resolution, visibility) = (false, 64, Shades::Binary);
        Knobs { points, normal_angle_deg, area_floor, max_error, coarser, face_resolution, visibility, bvh }
    }
}

impl fmt::Display for Quality {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(Quality::NAMES[*self as usize])
    }
}

/// Why a text is not a preset.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a quality: expected draft, medium or high")]
pub struct ParseQualityError(String);

impl FromStr for Quality {
    type Err = ParseQualityError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let all = [Quality::Draft, Quality::Medium, Quality::High];
        all.into_iter().find(|quality| quality.to_string() == text).ok_or_else(|| ParseQualityError(text.chars().take(80).collect()))
    }
}

/// How finely the field of an object that moves is kept: places around it, and directions from each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum FieldQuality {
    /// 1.4 MB a field.
    Draft,
    /// 5.5 MB.
    #[default]
    Medium,
    /// 19.5 MB.
    High,
}

impl FieldQuality {
    /// Steps of places along a cube's face, and texels along a map.
    pub fn steps_and_texels(self) -> [usize; 2] {
        match self {
            FieldQuality::Draft => [8, 16],
            FieldQuality::Medium => [8, 32],
            FieldQuality::High => [16, 32],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_parse_back_and_agree_with_serde() {
        for name in Quality::NAMES {
            let quality: Quality = name.parse().unwrap();
            assert_eq!(quality.to_string(), name);
            assert_eq!(serde_json::to_value(quality).unwrap(), name);
        }
        assert!("Medium".parse::<Quality>().is_err());
    }

    #[test]
    fn shades_parse_back_and_agree_with_serde() {
        for name in Shades::NAMES {
            let shades = Shades::named(name).unwrap();
            assert_eq!(Shades::of_steps(shades.steps()), Some(shades));
            assert_eq!((shades.name(), serde_json::to_value(shades).unwrap()), (name, name.into()));
        }
        assert_eq!(Shades::named("gray3"), None);
    }

    #[test]
    fn each_preset_is_finer_than_the_one_before() {
        let knobs: Vec<Knobs> = Quality::NAMES.iter().map(|name| name.parse::<Quality>().unwrap().knobs()).collect();
        for pair in knobs.windows(2) {
            assert!(pair[0].points < pair[1].points);
            assert!(pair[0].normal_angle_deg > pair[1].normal_angle_deg);
            assert!(pair[0].area_floor >= pair[1].area_floor);
            assert!(pair[0].max_error > pair[1].max_error);
        }
    }
}
