//! Arguments that several verbs share, and how their values are read.

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use prelight_manifests::Quality;
use prelight_manifests::quality::Shades;
use prelight_manifests::scene::Projection;
use serde_json::{Value, json};
use std::path::PathBuf;
use std::time::Duration;

/// The scene to work on.
#[derive(Args, Clone, Debug)]
pub struct SceneArgs {
    /// A scene.toml, or a scene file: .glb, .gltf, .obj, .ply
    #[arg(value_name = "SCENE", default_value = "scene.toml")]
    pub scene: PathBuf,
}

/// Knobs of a bake that win over the scene manifest.
#[derive(Args, Clone, Debug, Default, PartialEq)]
pub struct BakeKnobs {
    /// Preset of all knobs: draft, medium or high
    #[arg(long, value_name = "Q", value_parser = quality_parser())]
    pub quality: Option<Quality>,
    /// Budget of points, turned into an edge length once
    #[arg(long, value_name = "N", conflicts_with = "edge_length", value_parser = clap::value_parser!(u64).range(16..))]
    pub points: Option<u64>,
    /// Edge length of the refined mesh aimed at, metres, or with a unit as 3cm
    #[arg(long, value_name = "M", value_parser = length)]
    pub edge_length: Option<f32>,
    /// Bake fewer points than a mesh has vertices, where it is finer than the edge length
    #[arg(long)]
    pub coarser: bool,
    /// Texels along the side of a cubemap face: 64 or 128
    #[arg(long, value_name = "N", value_parser = PossibleValuesParser::new(["64", "128"]).map(|n| if n == "128" { 128u32 } else { 64 }))]
    pub face_resolution: Option<u32>,
    /// Visibility of a texel that an edge crosses: binary, or gray in 2, 4, 6, 8 bits or not quantised
    #[arg(long, value_name = "V", value_parser = PossibleValuesParser::new(Shades::NAMES).map(|name| Shades::named(&name).unwrap_or_default()))]
    pub visibility: Option<Shades>,
}

impl BakeKnobs {
    /// As the asset's report keeps them, so that `repair` bakes with the same ones.
    pub fn to_json(&self) -> Value {
        json!({
            "quality": self.quality.map(|quality| quality.to_string()),
            "points": self.points,
            "edge_length": self.edge_length,
            "coarser": self.coarser,
            "face_resolution": self.face_resolution,
            "visibility": self.visibility.map(Shades::name),
        })
    }

    /// From an asset's report; what is not there was not given.
    pub fn from_json(knobs: &Value) -> Self {
        BakeKnobs {
            quality: knobs["quality"].as_str().and_then(|name| name.parse().ok()),
            points: knobs["points"].as_u64(),
            edge_length: knobs["edge_length"].as_f64().map(|length| length as f32),
            coarser: knobs["coarser"].as_bool().unwrap_or(false),
            face_resolution: knobs["face_resolution"].as_u64().map(|n| n as u32).filter(|n| matches!(n, 64 | 128)),
            visibility: knobs["visibility"].as_str().and_then(Shades::named),
        }
    }
}

/// Where to look from, and how large the image is.
#[derive(Args, Clone, Debug)]
pub struct ViewArgs {
    /// Width and height in pixels
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = size)]
    pub size: (u32, u32),
    /// A camera of the scene, by name
    #[arg(long, value_name = "NAME", conflicts_with_all = ["eye", "look_at"])]
    pub camera: Option<String>,
    /// Position of the camera in the file's space, metres
    #[arg(long, value_name = "X,Y,Z", requires = "look_at", value_parser = vec3, allow_hyphen_values = true)]
    pub eye: Option<[f64; 3]>,
    /// A point that the camera looks at
    #[arg(long, value_name = "X,Y,Z", requires = "eye", value_parser = vec3, allow_hyphen_values = true)]
    pub look_at: Option<[f64; 3]>,
    /// Vertical field of view, degrees
    #[arg(long, value_name = "DEG", value_parser = field_of_view)]
    pub fov: Option<f32>,
}

/// How an environment's file is read.
#[derive(Args, Clone, Debug, Default)]
pub struct MapArgs {
    /// How the sphere lies in the environment's image; without it as the file says, else by its shape
    #[arg(long, value_name = "P", requires = "environment", value_parser = projection_parser())]
    pub projection: Option<Projection>,
    /// Layer of an OpenEXR environment
    #[arg(long, value_name = "NAME", requires = "environment")]
    pub layer: Option<String>,
}

fn projection_parser() -> impl TypedValueParser<Value = Projection> {
    let named = |name: String| Projection::ALL.into_iter().find(|projection| projection.name() == name).unwrap_or(Projection::LatLong);
    PossibleValuesParser::new(Projection::ALL.map(Projection::name)).map(named)
}

fn quality_parser() -> impl TypedValueParser<Value = Quality> {
    PossibleValuesParser::new(Quality::NAMES).map(|name| name.parse().unwrap_or_default())
}

/// `x,y,z`, finite.
pub fn vec3(text: &str) -> Result<[f64; 3], String> {
    let parts: Vec<&str> = text.split(',').collect();
    let [x, y, z] = parts[..] else { return Err("expected three numbers, as in 1,1.5,-2".into()) };
    let number = |text: &str| {
        finite(text)?;
        text.trim().parse::<f64>().map_err(|_| format!("`{text}` is not a number"))
    };
    Ok([number(x)?, number(y)?, number(z)?])
}

/// `1280x720`, each in 1..=16384.
pub fn size(text: &str) -> Result<(u32, u32), String> {
    let expected = || "expected width and height in 1..=16384, as in 1280x720".to_string();
    let (width, height) = text.split_once(['x', 'X']).ok_or_else(expected)?;
    let side = |text: &str| text.parse::<u32>().ok().filter(|side| (1..=16384).contains(side)).ok_or_else(expected);
    Ok((side(width)?, side(height)?))
}

/// A finite number.
pub fn finite(text: &str) -> Result<f32, String> {
    let number: f32 = text.trim().parse().map_err(|_| format!("`{text}` is not a number"))?;
    if number.is_finite() { Ok(number) } else { Err(format!("`{text}` is not a finite number")) }
}

/// An error that is asked for: relative L2 above 0, at most 1.
pub fn max_error(text: &str) -> Result<f64, String> {
    let error: f64 = text.parse().map_err(|_| "expected an error, for example 0.05".to_string())?;
    if error > 0.0 && error <= 1.0 { Ok(error) } else { Err("expected an error above 0, at most 1".to_string()) }
}

/// A finite number above zero.
pub fn positive(text: &str) -> Result<f32, String> {
    finite(text).and_then(|number| if number > 0.0 { Ok(number) } else { Err("expected a number above 0".into()) })
}

/// Metres above zero, or another unit of length.
pub fn length(text: &str) -> Result<f32, String> {
    let metres = prelight_manifests::length::parse(text).ok_or_else(|| "expected a length above 0, as 0.03 or 3cm".to_string())?;
    positive(&metres.to_string())
}

/// `8h`, `1h30min`, `90s`: numbers with units, the larger before the smaller.
pub fn duration(text: &str) -> Result<Duration, String> {
    let expected = || "expected a time with units, as in 8h, 1h30min or 90s".to_string();
    let (mut rest, mut seconds, mut last) = (text.trim(), 0u64, u64::MAX);
    if rest.is_empty() {
        return Err(expected());
    }
    while !rest.is_empty() {
        let digits = rest.find(|letter: char| !letter.is_ascii_digit()).ok_or_else(expected)?;
        let number: u64 = rest[..digits].parse().map_err(|_| expected())?;
        let unit = rest[digits..].find(|letter: char| letter.is_ascii_digit()).map_or(rest.len(), |end| digits + end);
        let factor = match rest[digits..unit].trim() {
            "d" => 86_400,
            "h" => 3600,
            "min" | "m" => 60,
            "s" => 1,
            _ => return Err(expected()),
        };
        if factor >= last {
            return Err(expected());
        }
        seconds = number.checked_mul(factor).and_then(|more| seconds.checked_add(more)).ok_or_else(expected)?;
        (rest, last) = (&rest[unit..], factor);
    }
    // A year is more than any bake, and no clock overflows.
    if (1..=365 * 86_400).contains(&seconds) { Ok(Duration::from_secs(seconds)) } else { Err("expected 1s to 365d".to_string()) }
}

fn field_of_view(text: &str) -> Result<f32, String> {
    finite(text).and_then(|deg| if (1.0..=179.0).contains(&deg) { Ok(deg) } else { Err("expected 1..=179 degrees".into()) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn knobs_survive_the_report() {
        let fine = BakeKnobs { face_resolution: Some(128), visibility: Some(Shades::Gray6), ..BakeKnobs::default() };
        let many = BakeKnobs { quality: Some(Quality::High), points: Some(5000), ..BakeKnobs::default() };
        for knobs in [BakeKnobs::default(), many, BakeKnobs { edge_length: Some(0.1), ..BakeKnobs::default() }, fine] {
            assert_eq!(BakeKnobs::from_json(&knobs.to_json()), knobs);
        }
    }

    #[test]
    fn knobs_are_read_from_the_command_line() {
        use clap::Parser;
        #[derive(Parser)]
        struct Line {
            #[command(flatten)]
            knobs: BakeKnobs,
        }
        let read = |line: &str| Line::try_parse_from(format!("prelight {line}").split_whitespace()).map(|line| line.knobs);
        let line = "--quality high --points 5000 --coarser --face-resolution 128 --visibility gray6";
        let knobs = BakeKnobs {
            quality: Some(Quality::High),
            points: Some(5000),
            edge_length: None,
            coarser: true,
            face_resolution: Some(128),
            visibility: Some(Shades::Gray6),
        };
        assert_eq!(read(line).expect("a good line"), knobs);
        assert_eq!(read("--edge-length 0.5 --face-resolution 64").expect("a good line").face_resolution, Some(64));
        for bad in ["--face-resolution 32", "--visibility gray5", "--quality best", "--points 3", "--edge-length 0"] {
            assert!(read(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn values_are_read_or_refused() {
        assert_eq!(vec3("1, -2.5,3e-1"), Ok([1.0, -2.5, 0.3]));
        assert_eq!(size("1280x720"), Ok((1280, 720)));
        assert_eq!((length("3cm"), length("0.25")), (Ok(0.03), Ok(0.25)));
        assert!(length("3 parsec").is_err() && length("-3cm").is_err());
        for bad in ["", "1,2", "1,2,3,4", "1,2,x", "1,inf,2", "nan,0,0"] {
            assert!(vec3(bad).is_err(), "{bad}");
        }
        for bad in ["", "1280", "0x720", "1280x", "-1x5", "99999x10", "1x2x3"] {
            assert!(size(bad).is_err(), "{bad}");
        }
        for (text, seconds) in [("90s", 90), ("8h", 28_800), ("1h30min", 5400), ("2m 5s", 125), ("1d", 86_400)] {
            assert_eq!(duration(text), Ok(Duration::from_secs(seconds)), "{text}");
        }
        for bad in ["", "8", "h", "0s", "-1h", "1.5h", "30min1h", "1h1h", "99999999999999999999h", "400d", "1 hour"] {
            assert!(duration(bad).is_err(), "{bad}");
        }
        for bad in ["0", "-1", "inf", "NaN", "five"] {
            assert!(positive(bad).is_err(), "{bad}");
        }
    }
}
