//! `[[material]]` and `[[object]]` rules of a scene manifest, applied.
//!
//! Patterns are globs: `*`, `?`, `[ab]` and `{a,b}` as in a shell. Materials match by name. Objects match by their path of node names
//! (`*` stays within one step of it, `**` crosses steps), or, for a pattern without `/`, by the last step. In a scene of parts,
//! materials are called `part/Name` and match by that or by `Name` alone. Where several rules match, the last one that sets a value
//! wins. A rule that matches nothing is a warning: most often a slip of the pen.
//!
//! A `brdf` becomes the material's model: `diffuse` its base colour, `specular` its specular colour, widths and exponents its roughness
//! (alpha = roughness²; Ward's two widths their mean and their aspect). A measured file is read once and kept as the scene's table.

use super::{Object, Scene};
use crate::error::SceneError;
use globset::{GlobBuilder, GlobMatcher};
use prelight_manifests::Technique;
use prelight_manifests::quality::{Knobs, Shades};
use prelight_manifests::scene::{AlphaModeName, Brdf, MaterialRule, SceneManifest};
use prelight_runtime::brdf::{Measured, phong};
use prelight_runtime::surface::{AlphaMode, Material, Model};
use std::path::Path;

/// glTF's default cutoff of MASK.
const DEFAULT_CUTOFF: f32 = 0.5;

/// What holds for one object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObjectKnobs {
    /// Edge length aimed at, metres; `None` where neither `[bake]` nor a rule sets one.
    pub edge_length: Option<f64>,
    /// Error that `[bake]` or a rule asks for by name; `None` where only a preset has one.
    pub max_error: Option<f64>,
    /// Faces without normals are smoothed up to this angle, degrees; `None`: they are flat.
    pub smooth_angle_deg: Option<f64>,
    /// Shades that `[bake]` or a rule asks for by name; `None` where only a preset has them.
    pub visibility: Option<Shades>,
    /// How transport is represented; never `Auto`.
    pub technique: Technique,
    /// Layer of occluders, where a rule fixes it (`prelight_bake::reach::layer`).
    pub layer: Option<u8>,
    /// An app may move it.
    pub moves: bool,
    /// The rest.
    pub knobs: Knobs,
}

/// Bytes of a pattern. Longer than any list of names that a person writes.
const MAX_PATTERN: usize = 4096;

/// Braces in braces in a pattern. The compiler of patterns goes down once for each.
const MAX_NESTING: usize = 16;

/// Refuses a pattern that nobody writes by hand, before it is compiled; `field` names it in errors.
pub fn check_pattern(field: &str, pattern: &str) -> Result<(), SceneError> {
    let refused = |what: String| SceneError::Refused { what, help: "use several rules with shorter patterns".to_string() };
    if pattern.len() > MAX_PATTERN {
        return Err(refused(format!("{field} is a pattern of {} bytes, at most {MAX_PATTERN} are read", pattern.len())));
    }
    let (mut depth, mut deepest) = (0usize, 0);
    for c in pattern.chars() {
        match c {
            '{' => depth += 1,
            '}' => depth = depth.saturating_sub(1),
            _ => {}
        }
        deepest = deepest.max(depth);
    }
    if deepest > MAX_NESTING {
        return Err(refused(format!("{field} is a pattern with braces {deepest} deep, at most {MAX_NESTING} are read")));
    }
    Ok(())
}

/// `in_paths`: `/` separates steps, which `*` does not cross.
fn matcher(field: &str, pattern: &str, in_paths: bool) -> Result<GlobMatcher, SceneError> {
    check_pattern(field, pattern)?;
    let glob = GlobBuilder::new(pattern).literal_separator(in_paths).build();
    glob.map(|glob| glob.compile_matcher()).map_err(|error| SceneError::Refused {
        what: format!("{field} = \"{pattern}\" is not a glob: {}", error.kind()),
        help: "use *, **, ?, [ab] and {a,b}; a letter that means itself goes in brackets, as [*]".to_string(),
    })
}

/// Whether an object's name matches; see the module's head.
fn object_matches(glob: &GlobMatcher, pattern: &str, name: &str) -> bool {
    let last = name.rsplit('/').next().unwrap_or(name);
    glob.is_match(name) || (!pattern.contains('/') && glob.is_match(last))
}

/// Largest measured file that is read, bytes: a table of 12 million nodes.
const MAX_TABLE_BYTES: u64 = 300 << 20;
/// Share of a value that a measured table may lose for being smaller.
const TABLE_TOLERANCE: f32 = 2e-3;

/// Which objects a pattern matches, as `[[object]]` rules match; `field` names it in errors.
pub fn matching_objects(field: &str, pattern: &str, objects: &[Object]) -> Result<Vec<bool>, SceneError> {
    let glob = matcher(field, pattern, true)?;
    Ok(objects.iter().map(|object| object_matches(&glob, pattern, &object.name)).collect())
}

/// Applies all `[[material]]` rules to the scene's materials; adds warnings for rules that match nothing. Files that rules name lie in
/// `folder`.
pub fn apply_materials(manifest: &SceneManifest, folder: &Path, scene: &mut Scene) -> Result<(), SceneError> {
    let mut files: Vec<&str> = Vec::new();
    for (i, rule) in manifest.material.iter().enumerate() {
        let glob = matcher(&format!("material[{i}].match"), &rule.pattern, false)?;
        let own = |name: &str| !manifest.scene.part.is_empty() && name.split_once('/').is_some_and(|(_, own)| glob.is_match(own));
        let matches = |name: &str| glob.is_match(name) || own(name);
        let mut n_matches = 0;
        let mut table = None;
        for material in scene.materials.iter_mut().filter(|material| matches(&material.name)) {
            apply(rule, material);
            if let Some(Brdf::Measured { file }) = &rule.brdf {
                let index = match (table, files.iter().position(|known| *known == file.as_str())) {
                    (Some(index), _) | (None, Some(index)) => index,
                    (None, None) => {
                        scene.tables.push(read_table(&folder.join(file))?);
                        files.push(file);
                        files.len() - 1
                    }
                };
                table = Some(index);
                material.model = Model::Measured { table: index as u32 };
            }
            n_matches += 1;
        }
        if n_matches == 0 {
            scene.warnings.push(format!("material[{i}].match = \"{}\" matches no material", rule.pattern));
        }
    }
    Ok(())
}

fn read_table(file: &Path) -> Result<Measured, SceneError> {
    let bytes = std::fs::metadata(file).map_err(|source| SceneError::input(file, source))?.len();
    if bytes > MAX_TABLE_BYTES {
        return Err(SceneError::Refused {
            what: format!("{} is {bytes} bytes long, a measured table at most {MAX_TABLE_BYTES}", file.display()),
            help: "is it a MERL .binary file?".to_string(),
        });
    }
    let bytes = std::fs::read(file).map_err(|source| SceneError::input(file, source))?;
    Ok(Measured::from_merl(&file.display().to_string(), &bytes)?.reduced(TABLE_TOLERANCE))
}

/// Model, colours and widths of a surface that glTF does not have.
fn apply_brdf(brdf: &Brdf, material: &mut Material) {
    let mut lobe = |model: Model, diffuse: &[f64; 3], specular: &[f64; 3], alpha: f64| {
        material.model = model;
        (0..3).for_each(|k| material.base_color[k] = diffuse[k] as f32);
        material.specular_color = specular.map(|x| x as f32);
        (material.specular, material.metallic, material.roughness) = (1.0, 0.0, alpha.sqrt() as f32);
    };
    match brdf {
        Brdf::Lambert { diffuse } => lobe(Model::Lambert, diffuse, &[0.0; 3], 1.0),
        Brdf::Phong { diffuse, specular, exponent } => lobe(Model::Phong, diffuse, specular, phong::alpha(*exponent)),
        Brdf::BlinnPhong { diffuse, specular, exponent } => lobe(Model::BlinnPhong, diffuse, specular, phong::alpha(*exponent)),
        Brdf::Ward { diffuse, specular, alpha: [x, y] } => {
            lobe(Model::Ward { aspect: (x / y) as f32 }, diffuse, specular, (x * y).sqrt());
        }
        Brdf::CookTorrance { diffuse, specular, slope } => lobe(Model::CookTorrance, diffuse, specular, *slope),
        // The table is the caller's to read.
        Brdf::Measured { .. } => {}
    }
}

fn apply(rule: &MaterialRule, material: &mut Material) {
    if let Some(brdf) = &rule.brdf {
        apply_brdf(brdf, material);
    }
    if let Some(color) = &rule.base_color {
        for (to, from) in material.base_color.iter_mut().zip(color) {
            *to = *from as f32;
        }
    }
    if let Some(roughness) = rule.roughness {
        material.roughness = roughness as f32;
    }
    if let Some(metallic) = rule.metallic {
        material.metallic = metallic as f32;
    }
    if let Some(emissive) = rule.emissive {
        material.emissive = emissive.map(|x| x as f32);
    }
    match rule.alpha_mode {
        Some(AlphaModeName::Opaque) => material.alpha_mode = AlphaMode::Opaque,
        Some(AlphaModeName::Blend) => material.alpha_mode = AlphaMode::Blend,
        Some(AlphaModeName::Mask) if !matches!(material.alpha_mode, AlphaMode::Mask { .. }) => {
            material.alpha_mode = AlphaMode::Mask { cutoff: DEFAULT_CUTOFF };
        }
        Some(AlphaModeName::Mask) | None => {}
    }
    match (rule.alpha_cutoff, &mut material.alpha_mode) {
        (Some(value), AlphaMode::Mask { cutoff }) => *cutoff = value as f32,
        (Some(value), AlphaMode::Blend) => material.blocks_from = Some(value as f32),
        _ => {}
    }
    if rule.occludes.is_some() {
        material.occludes = rule.occludes;
    }
    if let Some(double_sided) = rule.double_sided {
        material.double_sided = double_sided;
    }
}

/// Knobs of every object, in their order, and warnings for rules that match nothing.
///
/// A rule's `quality` replaces the preset; knobs that `[bake]` itself sets stay, and so does its `edge_length` unless the rule has one.
pub fn object_knobs(manifest: &SceneManifest, objects: &[Object]) -> Result<(Vec<ObjectKnobs>, Vec<String>), SceneError> {
    let mut sections = vec![manifest.bake.clone(); objects.len()];
    let mut layers = vec![(None, false); objects.len()];
    let mut warnings = Vec::new();
    for (i, rule) in manifest.object.iter().enumerate() {
        let glob = matcher(&format!("object[{i}].match"), &rule.pattern, true)?;
        let mut n_matches = 0;
        for ((section, (layer, moves)), object) in sections.iter_mut().zip(&mut layers).zip(objects) {
            if object_matches(&glob, &rule.pattern, &object.name) {
                section.quality = rule.quality.unwrap_or(section.quality);
                section.technique = rule.technique.unwrap_or(section.technique);
                section.edge_length = rule.edge_length.or(section.edge_length);
                section.max_error = rule.max_error.or(section.max_error);
                section.coarser = rule.coarser.or(section.coarser);
                section.visibility = rule.visibility.or(section.visibility);
                section.smooth_angle_deg = rule.smooth_angle_deg.or(section.smooth_angle_deg);
                *layer = rule.layer.or(*layer);
                *moves = rule.moves.unwrap_or(*moves);
                n_matches += 1;
            }
        }
        if n_matches == 0 {
            warnings.push(format!("object[{i}].match = \"{}\" matches no object", rule.pattern));
        }
    }
    let resolve = |(section, (layer, moves)): (prelight_manifests::scene::BakeSection, (Option<u8>, bool))| ObjectKnobs {
        layer,
        moves,
        edge_length: section.edge_length,
        max_error: section.max_error,
        smooth_angle_deg: section.smooth_angle_deg,
        visibility: section.visibility,
        technique: section.technique.resolved(),
        knobs: section.knobs(),
    };
    Ok((sections.into_iter().zip(layers).map(resolve).collect(), warnings))
}

#[cfg(test)]
mod tests {
    use super::*;
    use prelight_manifests::Quality;
    use std::sync::Arc;

    fn manifest(rules: &str) -> SceneManifest {
        SceneManifest::parse("scene.toml", &format!("format = 1\nscene.gltf = \"a.glb\"\n{rules}")).unwrap()
    }

    fn scene(materials: &[&str], objects: &[&str]) -> Scene {
        let material = |name: &&str| Material { name: name.to_string(), ..Material::default() };
        let object = |name: &&str| Object { name: name.to_string(), mesh: Arc::default(), world_from_local: [0.0; 16] };
        Scene { materials: materials.iter().map(material).collect(), objects: objects.iter().map(object).collect(), ..Scene::default() }
    }

    #[test]
    fn a_cutoff_of_a_blend_surface_is_where_it_blocks() {
        let rule = |mode: &str| {
            let text =
                format!("format = 1\nscene.gltf = \"a.glb\"\n[[material]]\nmatch = \"*\"\nalpha_mode = \"{mode}\"\nalpha_cutoff = 0.25\n");
            SceneManifest::parse("scene.toml", &text).unwrap().material.remove(0)
        };
        let mut material = Material::default();
        apply(&rule("blend"), &mut material);
        assert_eq!((material.alpha_mode, material.blocks_from), (AlphaMode::Blend, Some(0.25)));
        apply(&rule("mask"), &mut material);
        assert_eq!(material.alpha_mode, AlphaMode::Mask { cutoff: 0.25 });
    }

    #[test]
    fn the_last_matching_rule_wins_value_by_value() {
        let rules = r#"
            [[material]]
            match = "Vase*"
            roughness = 0.25
            base_color = [0.5, 0.25, 0.125]
            [[material]]
            match = "Vase Blue"
            roughness = 0.75
            alpha_mode = "mask"
            alpha_cutoff = 0.25
            occludes = true
            double_sided = true
            emissive = [1, 2, 3]
            metallic = 0
            [[material]]
            match = "Vaze"
        "#;
        let mut scene = scene(&["Vase Red", "Vase Blue", "Floor", "Vase/Old"], &[]);
        apply_materials(&manifest(rules), Path::new(""), &mut scene).unwrap();
        let [red, blue, floor, old] = &scene.materials[..] else { panic!() };
        assert_eq!((red.roughness, red.base_color, red.metallic), (0.25, [0.5, 0.25, 0.125, 1.0], 1.0));
        assert_eq!((blue.roughness, blue.base_color[0], blue.metallic), (0.75, 0.5, 0.0));
        assert_eq!((blue.alpha_mode, blue.occludes), (AlphaMode::Mask { cutoff: 0.25 }, Some(true)));
        assert_eq!((blue.double_sided, blue.emissive), (true, [1.0, 2.0, 3.0]));
        assert_eq!(*floor, Material { name: "Floor".into(), ..Material::default() });
        assert_eq!(old.roughness, 0.25, "a slash in a material's name is a letter like any other");
        assert_eq!(scene.warnings, ["material[2].match = \"Vaze\" matches no material"]);
    }

    #[test]
    fn surfaces_beyond_gltf_become_models_colours_and_roughness() {
        let folder = tempfile::tempdir().unwrap();
        let mut bytes: Vec<u8> = [4i32, 2, 2].iter().flat_map(|n| n.to_le_bytes()).collect();
        (0..48).for_each(|i| bytes.extend(f64::from(i).to_le_bytes()));
        std::fs::write(folder.path().join("a.binary"), &bytes).unwrap();
        let rules = r#"
            [[material]]
            match = "Ward"
            brdf = { ward = { diffuse = [0.1, 0.2, 0.3], specular = [0.3, 0.2, 0.1], alpha = [0.08, 0.32] } }
            [[material]]
            match = "Shiny"
            brdf = { phong = { diffuse = [0.1, 0.1, 0.1], specular = [0.5, 0.5, 0.5], exponent = 200 } }
            [[material]]
            match = "{One,Two}"
            brdf = { measured = { file = "a.binary" } }
        "#;
        let mut scene = scene(&["Ward", "Shiny", "One", "Two"], &[]);
        apply_materials(&manifest(rules), folder.path(), &mut scene).unwrap();
        let [ward, shiny, one, two] = &scene.materials[..] else { panic!() };
        let Model::Ward { aspect } = ward.model else { panic!("{ward:?}") };
        assert!((aspect - 0.25).abs() < 1e-6 && (ward.roughness.powi(2) - 0.16).abs() < 1e-6);
        assert_eq!((ward.base_color, ward.specular_color), ([0.1, 0.2, 0.3, 1.0], [0.3, 0.2, 0.1]));
        assert!(shiny.model == Model::Phong && (phong::exponent(f64::from(shiny.roughness).powi(2)) - 200.0).abs() < 0.1);
        assert_eq!((one.model, two.model, scene.tables.len()), (Model::Measured { table: 0 }, Model::Measured { table: 0 }, 1));
        std::fs::write(folder.path().join("a.binary"), &bytes[..40]).unwrap();
        let error = apply_materials(&manifest(rules), folder.path(), &mut scene).unwrap_err().to_string();
        assert!(error.contains("a.binary") && error.contains("396"), "{error}");
    }

    #[test]
    fn objects_match_by_path_or_by_last_step() {
        let names = ["root/Sofa", "root/Sofa/Leg", "root/hall/Sofa#2", "Lamp"];
        let cases: [(&str, [bool; 4]); 7] = [
            ("Sofa*", [true, false, true, false]),
            ("root/*", [true, false, false, false]),
            ("root/**", [true, true, true, false]),
            ("**/Sofa*", [true, false, true, false]),
            ("**", [true; 4]),
            ("*", [true; 4]),
            ("{Lamp,Leg}", [false, true, false, true]),
        ];
        for (pattern, expected) in cases {
            let rules = format!("[[object]]\nmatch = \"{pattern}\"\nedge_length = 0.5");
            let (knobs, warnings) = object_knobs(&manifest(&rules), &scene(&[], &names).objects).unwrap();
            let matched: Vec<bool> = knobs.iter().map(|knobs| knobs.edge_length.is_some()).collect();
            assert_eq!(matched, expected, "{pattern}");
            assert!(warnings.is_empty());
        }
    }

    #[test]
    fn object_rules_keep_what_they_do_not_set() {
        let rules = r#"
            [bake]
            quality = "draft"
            edge_length = 0.1
            max_error = 0.125
            [[object]]
            match = "Sofa"
            quality = "high"
            visibility = "gray6"
            [[object]]
            match = "Chair"
        "#;
        let (knobs, warnings) = object_knobs(&manifest(rules), &scene(&[], &["Sofa", "Lamp"]).objects).unwrap();
        assert_eq!(knobs[0].edge_length, Some(0.1));
        assert_eq!(knobs[0].knobs.normal_angle_deg, Quality::High.knobs().normal_angle_deg);
        assert_eq!(knobs[1].knobs.normal_angle_deg, Quality::Draft.knobs().normal_angle_deg);
        assert!(knobs.iter().all(|knobs| knobs.knobs.max_error == 0.125 && knobs.technique == Technique::BLOCK_PRODUCT));
        assert_eq!(warnings, ["object[1].match = \"Chair\" matches no object"]);
        assert_eq!([0, 1].map(|object| knobs[object].visibility), [Some(Shades::Gray6), None]);
        assert_eq!([0, 1].map(|object| knobs[object].knobs.visibility), [Shades::Gray6, Shades::Binary]);
        // The bake's own is for those without a rule, and written out it is pinned as well.
        let rules = rules.replace("max_error", "visibility = \"gray2\"\nmax_error");
        let knobs = object_knobs(&manifest(&rules), &scene(&[], &["Sofa", "Lamp"]).objects).unwrap().0;
        assert_eq!([0, 1].map(|object| knobs[object].visibility), [Some(Shades::Gray6), Some(Shades::Gray2)]);
    }

    #[test]
    fn a_pattern_that_nobody_writes_is_refused_before_it_is_compiled() {
        let knobs = |pattern: &str| object_knobs(&manifest(&format!("[[object]]\nmatch = \"{pattern}\"")), &[]);
        let nested = |depth: usize| format!("{}a{}", "{".repeat(depth), "}".repeat(depth));
        assert!(knobs(&nested(MAX_NESTING)).is_ok() && knobs(&"a".repeat(MAX_PATTERN)).is_ok());
        for (pattern, what) in [
            ("{".repeat(50_000), "50000 bytes"),
            ("{".repeat(4000), "4000 deep"),
            (nested(17), "17 deep"),
            ("*".repeat(5000), "5000 bytes"),
        ] {
            let error = knobs(&pattern).unwrap_err().to_string();
            assert!(error.contains("object[0].match") && error.contains(what) && error.contains("help: ") && error.len() < 300, "{error}");
        }
    }

    #[test]
    fn a_broken_glob_is_named() {
        let error = object_knobs(&manifest("[[object]]\nmatch = \"[a\""), &[]).unwrap_err().to_string();
        assert!(error.contains("object[0].match = \"[a\"") && error.contains("help: "), "{error}");
    }
}
