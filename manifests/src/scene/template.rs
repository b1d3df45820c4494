//! The commented `scene.toml` that `prelight init` writes: what is set is set, every other knob stands there as a comment with its
//! default and what it does.

use crate::quality::Quality;

/// What `init` knows about the scene.
#[derive(Clone, Debug, Default)]
pub struct Template {
    /// Path of the glTF file, relative to the manifest.
    pub gltf: String,
    /// Edge length to pin, metres; `None` leaves it as a comment.
    pub edge_length: Option<f64>,
    /// Why that edge length, as "about 200 000 points".
    pub edge_length_reason: String,
    /// Some names of materials, for the example.
    pub materials: Vec<String>,
    /// Some names of objects, for the example.
    pub objects: Vec<String>,
}

impl Template {
    /// The file's text. It parses, whatever the names are.
    pub fn text(&self) -> String {
        let knobs = Quality::Medium.knobs();
        let gltf = quote(&self.gltf);
        let edge_length = match self.edge_length {
            Some(metres) => knob(&format!("edge_length = {metres:?}"), &format!("metres; {}", one_line(&self.edge_length_reason))),
            None => knob("# edge_length = 0.05", "metres; `prelight plan --points 200000` prints one for a budget"),
        };
        let max_error = knob(
            &format!("# max_error = {:?}", knobs.max_error),
            "diffuse error between points, per object; written out, it chooses edge lengths",
        );
        let angle = knob(&format!("# normal_angle_deg = {:?}", knobs.normal_angle_deg), "edges whose end normals differ by more are split");
        let smooth = knob("# smooth_angle_deg = 40.0", "smooths surfaces whose file has no normals; without it they are flat");
        let floor =
            knob(&format!("# area_floor = {:?}", knobs.area_floor), "edges at shadow borders are split down to this share of edge_length");
        let coarser = knob("# coarser = false", "true: fewer points than vertices where the mesh is finer than edge_length");
        let face = knob(&format!("# face_resolution = {}", knobs.face_resolution), "texels along the side of a cubemap face: 64 or 128");
        let shades = knob("# visibility = \"binary\"", "binary, or gray2, gray4, gray6, gray8, gray: anti-aliased shadows of small lights");
        let material = quote(&glob_of(self.materials.first().map_or("Vase", String::as_str)));
        let object = quote(&glob_of(self.objects.first().map_or("**/Sofa", String::as_str)));
        format!(
            r#"# A scene for prelight. Paths are relative to this file. Lines that start with `# key =` show defaults or examples.
# Editors: `prelight schema > scene.schema.json` has every key with its description.
format = 1

[scene]
gltf = {gltf}

# Lights by name: `prelight render scene.prelight.json -e noon`. The bake does not depend on them.
# [[environment]]
# name = "noon"
# image = "env/noon_1k.hdr"  # .hdr or .exr
# projection = "lat_long"    # or angular, cube_cross, cube_faces; without it, as the file says
# rotate_y_deg = 0.0         # right-handed about the vertical
# intensity = 1.0

[bake]
quality = "medium"           # draft | medium | high: sets of the knobs below
{edge_length}
{max_error}
# technique = "auto"         # or block_product, vmf_transfer: with indirect light
{angle}
{smooth}
{floor}
{coarser}
{face}
{shades}
# field_quality = "medium"   # draft | medium | high: shadows of objects that move
# bvh = "medium"             # fast | medium | slow to build; changes no bit of the result

# Light over other surfaces, added at run time; colours and lights change without a bake.
# [bounces]
# enabled = true             # false: direct light alone
# rays = 64                  # of a point that gathers; 128 for less noise

# Knobs of vmf_transfer alone.
# [bake.vmf_transfer]
# bounces = 1                # surfaces between a point and the environment

# Changes to materials whose names match; a value replaces the glTF factor.
# [[material]]
# match = {material}
# base_color = [0.8, 0.8, 0.8]
# roughness = 0.3
# metallic = 0.0
# emissive = [0.0, 0.0, 0.0]
# alpha_mode = "opaque"      # opaque | mask | blend
# alpha_cutoff = 0.5         # of mask
# occludes = true            # false: lets all light through
# double_sided = true

# Knobs of objects whose names (paths of node names) match.
# [[object]]
# match = {object}
# quality = "high"
# edge_length = 0.01
# visibility = "gray6"       # shades of its own
# moves = true               # an app may move it

[limits]
# memory = "12GiB"           # --memory wins; default a quarter of the machine's
"#
        )
    }
}

/// A line with its comment at the common column.
fn knob(line: &str, comment: &str) -> String {
    format!("{line:28} # {comment}")
}

/// A TOML string on one line.
fn quote(text: &str) -> String {
    toml::Value::String(one_line(text)).to_string()
}

/// Comments end at a newline, so names that hold one lose it.
fn one_line(text: &str) -> String {
    text.chars().map(|letter| if letter.is_control() { ' ' } else { letter }).collect()
}

/// A glob that matches `name` itself: letters with a meaning in globs become `?`.
fn glob_of(name: &str) -> String {
    name.chars().map(|letter| if "*?[]{}!\\".contains(letter) { '?' } else { letter }).collect()
}
