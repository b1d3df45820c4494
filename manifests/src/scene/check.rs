//! Ranges, names that must be unique, and what this build cannot do yet.

use super::position::{line_column, offset_of, place, unknown};
use super::{Brdf, SceneManifest, SceneSource};
use crate::{ManifestError, Technique, Techniques};
use std::fmt::Display;

/// Longest edge that makes sense, metres: beyond it f32 positions no longer tell neighbours apart.
const MAX_EDGE_LENGTH: f64 = 1e6;
/// Shortest edge, metres.
const MIN_EDGE_LENGTH: f64 = 1e-6;
/// Radiance and intensity beyond this overflow f32 sums over a cubemap.
const MAX_RADIANCE: f64 = 1e12;
/// A hundred turns; beyond, a slip of the pen is likelier.
const MAX_TURN_DEG: f64 = 36_000.0;
/// Farthest that a part may be moved, metres: f32 positions there are a metre apart.
const MAX_DISTANCE: f64 = 1e7;
/// Smallest scale of a part, and the inverse of the largest.
const MIN_SCALE: f64 = 1e-6;

struct Checker<'a> {
    file: &'a str,
    text: &'a str,
    techniques: &'a Techniques,
}

impl Checker<'_> {
    fn range(&self, field: &str, value: impl Display, expected: impl Display) -> ManifestError {
        ManifestError::Range {
            file: place(self.file, self.text, field),
            field: field.to_string(),
            value: value.to_string(),
            expected: expected.to_string(),
        }
    }

    fn unsupported(&self, field: &str, what: &str, help: &str) -> ManifestError {
        ManifestError::Unsupported { file: place(self.file, self.text, field), what: what.to_string(), help: help.to_string() }
    }

    /// `None` is fine; NaN is in no range.
    fn within(&self, field: &str, value: Option<f64>, low: f64, high: f64) -> Result<(), ManifestError> {
        match value {
            Some(value) if !(low..=high).contains(&value) => Err(self.range(field, value, format_args!("{low}..={high}"))),
            _ => Ok(()),
        }
    }

    fn edge_length(&self, field: &str, value: Option<f64>) -> Result<(), ManifestError> {
        match value {
            Some(value) if !(MIN_EDGE_LENGTH..=MAX_EDGE_LENGTH).contains(&value) => {
                Err(self.range(field, value, format_args!("metres in {MIN_EDGE_LENGTH}..={MAX_EDGE_LENGTH}")))
            }
            _ => Ok(()),
        }
    }

    fn technique(&self, field: &str, technique: Option<Technique>) -> Result<(), ManifestError> {
        let is_known = |technique: Technique| technique == Technique::AUTO || self.techniques.get(technique.name()).is_some();
        match technique.filter(|technique| !is_known(*technique)) {
            None => Ok(()),
            Some(technique) => {
                let (line, column) = line_column(self.text, offset_of(self.text, field).unwrap_or(0));
                let known: Vec<&str> = std::iter::once(Technique::AUTO.name()).chain(self.techniques.names()).collect();
                let (message, help) = unknown("unknown name", technique.name(), &known);
                Err(ManifestError::Syntax { file: self.file.to_string(), line, column, message, help })
            }
        }
    }

    fn bounces(&self, field: &str, bounces: Option<u32>) -> Result<(), ManifestError> {
        match bounces {
            Some(bounces) if !(1..=64).contains(&bounces) => Err(self.range(field, bounces, "1..=64")),
            _ => Ok(()),
        }
    }

    fn not_empty(&self, field: &str, value: &str) -> Result<(), ManifestError> {
        if value.trim().is_empty() { Err(self.range(field, "\"\"", "some text")) } else { Ok(()) }
    }
}

/// Everything about the values that types cannot say.
pub fn check(manifest: &SceneManifest, file: &str, text: &str, techniques: &Techniques) -> Result<(), ManifestError> {
    let checker = Checker { file, text, techniques };
    if manifest.format == 0 {
        return Err(checker.range("format", 0, 1));
    }
    check_source(manifest, &checker)?;
    check_environments(manifest, &checker)?;

    let bake = &manifest.bake;
    checker.edge_length("bake.edge_length", bake.edge_length)?;
    checker.within("bake.max_error", bake.max_error, 1e-4, 1.0)?;
    checker.within("bake.normal_angle_deg", bake.normal_angle_deg, 1.0, 180.0)?;
    checker.within("bake.smooth_angle_deg", bake.smooth_angle_deg, 0.0, 180.0)?;
    checker.within("bake.area_floor", bake.area_floor, 1e-3, 1.0)?;
    if let Some(face) = bake.face_resolution.filter(|face| *face != 64 && *face != 128) {
        return Err(checker.range("bake.face_resolution", face, "64 or 128"));
    }
    checker.technique("bake.technique", Some(bake.technique))?;
    checker.bounces("bake.bounces", bake.bounces)?;
    checker.bounces("bake.vmf_transfer.bounces", bake.vmf_transfer.bounces)?;
    if let (Some(old), Some(new)) = (bake.bounces, bake.vmf_transfer.bounces)
        && old != new
    {
        let what = format!("`bounces` is {old} in [bake] and {new} in [bake.vmf_transfer]");
        return Err(checker.unsupported("bake.bounces", &what, "keep the one in [bake.vmf_transfer]"));
    }
    let bounces = &manifest.bounces;
    if let Some(rays) = bounces.rays.filter(|rays| !(32..=255).contains(rays)) {
        return Err(checker.range("bounces.rays", rays, "32..=255"));
    }
    checker.within("bounces.spacing", bounces.spacing, 0.0, 0.5)?;
    checker.within("bounces.cluster_weight", bounces.cluster_weight, 0.0, 1.0)?;
    checker.within("bounces.similarity", bounces.similarity, 0.0, 1.0)?;
    check_materials(manifest, &checker)?;
    for (i, rule) in manifest.object.iter().enumerate() {
        checker.not_empty(&format!("object[{i}].match"), &rule.pattern)?;
        checker.edge_length(&format!("object[{i}].edge_length"), rule.edge_length)?;
        checker.within(&format!("object[{i}].max_error"), rule.max_error, 1e-4, 1.0)?;
        checker.technique(&format!("object[{i}].technique"), rule.technique)?;
        checker.within(&format!("object[{i}].smooth_angle_deg"), rule.smooth_angle_deg, 0.0, 180.0)?;
        if let Some(layer) = rule.layer.filter(|layer| *layer > 3) {
            return Err(checker.range(&format!("object[{i}].layer"), layer, "0, 1, 2 or 3"));
        }
    }
    if let Some(memory) = manifest.limits.memory.filter(|memory| memory.0 < 1 << 20) {
        return Err(checker.range("limits.memory", memory, "1MiB or more"));
    }
    Ok(())
}

fn check_source(manifest: &SceneManifest, checker: &Checker) -> Result<(), ManifestError> {
    let source = &manifest.scene;
    if let Some(variant) = &source.variant {
        if source.gltf.is_none() {
            return Err(checker.unsupported("scene.variant", "a variant of parts", "write `variant` into each [[scene.part]]"));
        }
        checker.not_empty("scene.variant", variant)?;
    }
    match (&source.gltf, source.part.is_empty()) {
        (Some(gltf), true) => checker.not_empty("scene.gltf", gltf),
        (None, true) => Err(checker.unsupported("scene", "[scene] names no file", "write `gltf = \"room.glb\"` in it")),
        (Some(_), false) => {
            Err(checker.unsupported("scene.gltf", "[scene] has both `gltf` and `part`", "keep one: a single file, or parts"))
        }
        (None, false) => {
            for i in 0..source.part.len() {
                check_part(source, i, checker)?;
            }
            Ok(())
        }
    }
}

fn check_part(source: &SceneSource, i: usize, checker: &Checker) -> Result<(), ManifestError> {
    let (part, field) = (&source.part[i], |key: &str| format!("scene.part[{i}].{key}"));
    checker.not_empty(&field("gltf"), &part.gltf)?;
    // The place of a name that was not written is that of the file it comes from.
    let named = field(if part.name.is_some() { "name" } else { "gltf" });
    checker.not_empty(&named, part.name())?;
    let quoted = || format!("\"{}\"", part.name());
    if part.name().contains('/') {
        return Err(checker.range(&named, quoted(), "a name without `/`, which stands between the steps of objects' names"));
    }
    if source.part[..i].iter().any(|before| before.name() == part.name()) {
        let expected = match part.name {
            Some(_) => "a name that no part before it has",
            None => "a `name` in this part: one before it has the name of the file already",
        };
        return Err(checker.range(&named, quoted(), expected));
    }
    let within = |key: &str, values: [f64; 3], most: f64| match values.iter().all(|x| x.abs() <= most) {
        true => Ok(()),
        false => Err(checker.range(&field(key), format_args!("{values:?}"), format_args!("three numbers in -{most}..={most}"))),
    };
    within("translate", part.translate, MAX_DISTANCE)?;
    within("rotate_deg", part.rotate_deg, MAX_TURN_DEG)?;
    checker.within(&field("scale"), Some(part.scale), MIN_SCALE, 1.0 / MIN_SCALE)
}

fn check_environments(manifest: &SceneManifest, checker: &Checker) -> Result<(), ManifestError> {
    for (i, entry) in manifest.environment.iter().enumerate() {
        let field = |key: &str| format!("environment[{i}].{key}");
        checker.not_empty(&field("name"), &entry.name)?;
        checker.not_empty(&field("image"), &entry.image)?;
        if let Some(layer) = &entry.layer {
            checker.not_empty(&field("layer"), layer)?;
        }
        if manifest.environment[..i].iter().any(|before| before.name == entry.name) {
            return Err(checker.range(&field("name"), format_args!("\"{}\"", entry.name), "a name that no environment before it has"));
        }
        checker.within(&field("rotate_y_deg"), Some(entry.rotate_y_deg), -MAX_TURN_DEG, MAX_TURN_DEG)?;
        checker.within(&field("intensity"), Some(entry.intensity), 0.0, MAX_RADIANCE)?;
    }
    Ok(())
}

fn check_materials(manifest: &SceneManifest, checker: &Checker) -> Result<(), ManifestError> {
    for (i, rule) in manifest.material.iter().enumerate() {
        let field = |key: &str| format!("material[{i}].{key}");
        checker.not_empty(&field("match"), &rule.pattern)?;
        let is_color = |color: &Vec<f64>| (3..=4).contains(&color.len()) && color.iter().all(|x| (0.0..=1.0).contains(x));
        if let Some(color) = rule.base_color.as_ref().filter(|color| !is_color(color)) {
            return Err(checker.range(&field("base_color"), format_args!("{color:?}"), "3 or 4 numbers in 0..=1"));
        }
        if let Some(emissive) = rule.emissive.filter(|color| color.iter().any(|x| !(0.0..=MAX_RADIANCE).contains(x))) {
            return Err(checker.range(&field("emissive"), format_args!("{emissive:?}"), "three numbers, 0 or more"));
        }
        checker.within(&field("roughness"), rule.roughness, 0.0, 1.0)?;
        checker.within(&field("metallic"), rule.metallic, 0.0, 1.0)?;
        checker.within(&field("alpha_cutoff"), rule.alpha_cutoff, 0.0, 1.0)?;
        if let Some(brdf) = &rule.brdf {
            check_brdf(brdf, &field("brdf"), checker)?;
        }
    }
    Ok(())
}

/// Albedos in 0..=1 that do not sum to more, widths and exponents in their ranges.
fn check_brdf(brdf: &Brdf, field: &str, checker: &Checker) -> Result<(), ManifestError> {
    const BLACK: [f64; 3] = [0.0; 3];
    let (diffuse, specular, widths, exponent) = match brdf {
        Brdf::Lambert { diffuse } => (*diffuse, BLACK, [1.0; 2], 0.0),
        Brdf::Ward { diffuse, specular, alpha } => (*diffuse, *specular, *alpha, 0.0),
        Brdf::Phong { diffuse, specular, exponent } | Brdf::BlinnPhong { diffuse, specular, exponent } => {
            (*diffuse, *specular, [1.0; 2], *exponent)
        }
        // The base gets what the facets leave.
        Brdf::CookTorrance { diffuse, specular, slope } => {
            if specular.iter().any(|x| !(0.0..=1.0).contains(x)) {
                return Err(checker.range(&format!("{field}.specular"), format_args!("{specular:?}"), "three numbers in 0..=1"));
            }
            (*diffuse, BLACK, [*slope; 2], 0.0)
        }
        Brdf::Measured { file } => return checker.not_empty(&format!("{field}.file"), file),
    };
    for (name, color) in [("diffuse", diffuse), ("specular", specular)] {
        if color.iter().any(|x| !(0.0..=1.0).contains(x)) {
            return Err(checker.range(&format!("{field}.{name}"), format_args!("{color:?}"), "three numbers in 0..=1"));
        }
    }
    // Decimal fractions that sum to 1 on paper may miss it by a rounding.
    if (0..3).any(|k| diffuse[k] + specular[k] > 1.0 + 1e-6) {
        let sum = format!("{:?}", [0, 1, 2].map(|k: usize| diffuse[k] + specular[k]));
        return Err(checker.range(field, sum, "diffuse + specular of at most 1 per channel, or it returns more than it gets"));
    }
    for width in widths {
        checker.within(field, Some(width), 1e-3, 1.0)?;
    }
    checker.within(&format!("{field}.exponent"), Some(exponent), 0.0, 1e6)
}
