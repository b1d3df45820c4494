//! The tables of `scene.toml`. The comments of fields here are the descriptions in the JSON schema.

use crate::quality::{BvhBuild, FieldQuality, Knobs, Quality, Shades};
use crate::{ByteSize, Technique};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[scene]`: one file, or several parts.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneSource {
    /// A file, relative to this one: glTF 2.0 (.glb, .gltf), Wavefront (.obj) or .ply.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gltf: Option<String>,
    /// Which of the file's material variants (KHR_materials_variants) to use, by name; without it, none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variant: Option<String>,
    /// Several files instead of `gltf`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub part: Vec<ScenePart>,
}

/// `[[scene.part]]`: one of several files, placed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ScenePart {
    /// A file, relative to this one: glTF 2.0 (.glb, .gltf), Wavefront (.obj) or .ply. Parts may share one: it is read and stored once.
    pub gltf: String,
    /// First step of its objects' and materials' names, without `/`; unique. Without it, the file's name without extension.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Moves it, metres; after `scale` and `rotate_deg`.
    #[serde(default)]
    pub translate: [f64; 3],
    /// Which of the file's material variants (KHR_materials_variants) to use, by name; without it, none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variant: Option<String>,
    /// Turns it about X, then Y, then Z, degrees, right-handed; after `scale`. `[-90, 0, 0]` stands a file up whose Z is up.
    #[serde(default)]
    pub rotate_deg: [f64; 3],
    /// Multiplies its size, above 0: 0.001 for a file in millimetres.
    #[serde(default = "one")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub scale: f64,
}

impl ScenePart {
    /// The name given, else that of the file without its folder and extension.
    pub fn name(&self) -> &str {
        let file = self.gltf.rsplit(['/', '\\']).next().unwrap_or_default();
        let stem = file.rsplit_once('.').map_or(file, |(stem, _)| if stem.is_empty() { file } else { stem });
        self.name.as_deref().unwrap_or(stem)
    }
}

/// `[[environment]]`: a light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EnvironmentEntry {
    /// What `render -e` calls it; unique.
    pub name: String,
    /// Image of all directions, .hdr or .exr, relative to this file.
    pub image: String,
    /// How the sphere lies in the image. Without it: as the file says, else by its shape.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub projection: Option<Projection>,
    /// Layer of an OpenEXR file; without it the nameless one, `Combined`, `beauty` or `rgba` before others.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub layer: Option<String>,
    /// Turns it about the vertical, degrees, right-handed: at 90 what was at +X stands at -Z.
    #[serde(default)]
    pub rotate_y_deg: f64,
    /// Multiplies its radiance, 0 or more.
    #[serde(default = "one")]
    #[schemars(range(min = 0.0))]
    pub intensity: f64,
}

/// How the sphere of directions lies in an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Projection {
    /// Latitude and longitude, 2:1.
    LatLong,
    /// An angular map, or light probe: a disc in a square.
    Angular,
    /// The six sides of a cube unfolded to a cross, 3:4 or 4:3.
    CubeCross,
    /// The six sides of a cube in a column or a row, +X -X +Y -Y +Z -Z.
    CubeFaces,
}

impl Projection {
    /// All of them.
    pub const ALL: [Projection; 4] = [Projection::LatLong, Projection::Angular, Projection::CubeCross, Projection::CubeFaces];

    /// The name in scene.toml and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Projection::LatLong => "lat_long",
            Projection::Angular => "angular",
            Projection::CubeCross => "cube_cross",
            Projection::CubeFaces => "cube_faces",
        }
    }
}

fn one() -> f64 {
    1.0
}

/// `[bake]`: a preset, and knobs that win over it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BakeSection {
    /// Preset of all knobs.
    #[serde(default)]
    pub quality: Quality,
    /// Edge length of the refined mesh aimed at, metres, or with a unit as `"3cm"`. `prelight plan --points N` prints one for a budget of points.
    #[serde(default, deserialize_with = "crate::length::deserialize", skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0, "type" = ["number", "string", "null"]))]
    pub edge_length: Option<f64>,
    /// Relative L2 of diffuse radiance aimed at between points, per object, 0.0001 to 1. Written here, it chooses each object's edge
    /// length and, where they are not written out, the face resolution and which objects get shades of gray.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0001, max = 1.0))]
    pub max_error: Option<f64>,
    /// How transport is represented.
    #[serde(default)]
    pub technique: Technique,
    /// The old place of `bounces` in `[bake.vmf_transfer]`; still read. Parsing moves it there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1, max = 64), extend("deprecated" = true))]
    pub bounces: Option<u32>,
    /// Edges whose end normals differ by more are split, degrees, 1 to 180.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1.0, max = 180.0))]
    pub normal_angle_deg: Option<f64>,
    /// Smooths surfaces whose file has no normals: faces that differ by at most this meet without a crease, degrees, 0 to 180. glTF says flat.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 180.0))]
    pub smooth_angle_deg: Option<f64>,
    /// Edges at shadow borders are split down to this share of `edge_length`, 0.001 to 1. At 1 they are not split.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.001, max = 1.0))]
    pub area_floor: Option<f64>,
    /// Bakes fewer points than the mesh has vertices where it is finer than `edge_length`; the other vertices interpolate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coarser: Option<bool>,
    /// Texels along the side of a cubemap face, 64 or 128.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("enum" = [64, 128]))]
    pub face_resolution: Option<u32>,
    /// Shades of a texel that an edge crosses: `binary`, or `gray2`, `gray4`, `gray6`, `gray8`, `gray` by bits, the last not quantised.
    /// An `[[object]]` may have its own. Written out, no `max_error` chooses them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub visibility: Option<Shades>,
    /// How long the BVH build may take. Changes no bit of the result.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bvh: Option<BvhBuild>,
    /// How finely what objects that move block is kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub field_quality: Option<FieldQuality>,
    /// Knobs of the technique `vmf_transfer` alone.
    #[serde(default, skip_serializing_if = "VmfTransferSection::is_default")]
    pub vmf_transfer: VmfTransferSection,
}

/// `[bake.vmf_transfer]`: knobs of that technique.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct VmfTransferSection {
    /// Surfaces between a point and the environment that indirect light crosses at most, 1 to 64; 1 unless given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1, max = 64))]
    pub bounces: Option<u32>,
}

/// `[bounces]`: light that reaches a surface over others, at run time, whatever the technique.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BouncesSection {
    /// Whether links between surfaces are baked, so that light bounces.
    #[serde(default = "BouncesSection::is_usual")]
    pub enabled: bool,
    /// Rays of a point that gathers, 32 to 255; 64 unless given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 32, max = 255))]
    pub rays: Option<u32>,
    /// How far apart points that gather lie, as a share of how far they see, 0 to 0.5: 0 lets every point gather; 0.05 unless given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 0.5))]
    pub spacing: Option<f64>,
    /// Share of a point's rays that one cluster of points may stand for, 0 to 1; 0.05 unless given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1.0))]
    pub cluster_weight: Option<f64>,
    /// How much the views of points of one cluster may differ, 0 to 1; 0.5 unless given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1.0))]
    pub similarity: Option<f64>,
}

impl Default for BouncesSection {
    fn default() -> Self {
        BouncesSection { enabled: Self::is_usual(), rays: None, spacing: None, cluster_weight: None, similarity: None }
    }
}

impl BouncesSection {
    fn is_usual() -> bool {
        true
    }
}

impl VmfTransferSection {
    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

impl BakeSection {
    /// The preset's knobs with those of this section over them.
    pub fn knobs(&self) -> Knobs {
        let preset = self.quality.knobs();
        Knobs {
            points: preset.points,
            normal_angle_deg: self.normal_angle_deg.unwrap_or(preset.normal_angle_deg),
            area_floor: self.area_floor.unwrap_or(preset.area_floor),
            max_error: self.max_error.unwrap_or(preset.max_error),
            coarser: self.coarser.unwrap_or(preset.coarser),
            face_resolution: self.face_resolution.unwrap_or(preset.face_resolution),
            visibility: self.visibility.unwrap_or(preset.visibility),
            bvh: self.bvh.unwrap_or(preset.bvh),
        }
    }
}

/// `[[material]]`: changes the materials whose names match. A value replaces the glTF factor; a texture still multiplies it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MaterialRule {
    /// Glob over material names, as `Vase*`.
    #[serde(rename = "match")]
    pub pattern: String,
    /// Linear base colour, 3 or 4 numbers in 0..1; the fourth is opacity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(length(min = 3, max = 4))]
    pub base_color: Option<Vec<f64>>,
    /// 0 mirror .. 1 rough.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1.0))]
    pub roughness: Option<f64>,
    /// 0 dielectric .. 1 metal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1.0))]
    pub metallic: Option<f64>,
    /// Emitted linear radiance, 0 or more. Lights the scene where light bounces.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub emissive: Option<[f64; 3]>,
    /// What alpha does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alpha_mode: Option<AlphaModeName>,
    /// Alpha at and above which a `mask` surface exists, and a `blend` surface blocks light (0.5 unless given), 0..1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1.0))]
    pub alpha_cutoff: Option<f64>,
    /// Whether it blocks light: `false` lets all light through, on any material; `true` makes a `blend` surface solid. Without it, a `blend`
    /// surface blocks where its alpha is at least `alpha_cutoff`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub occludes: Option<bool>,
    /// Seen and shaded from both sides.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub double_sided: Option<bool>,
    /// A surface that glTF does not have.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub brdf: Option<Brdf>,
}

/// What alpha does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AlphaModeName {
    /// Nothing.
    Opaque,
    /// Cuts.
    Mask,
    /// Drawn over what is behind.
    Blend,
}

/// Surfaces beyond glTF. Textures of the glTF material still count: base colour multiplies `diffuse`, the roughness texture the widths.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Brdf {
    /// The same radiance in every direction.
    Lambert {
        /// Linear diffuse albedo.
        diffuse: [f64; 3],
    },
    /// Ward's anisotropic lobe over a Lambert base.
    Ward {
        /// Linear diffuse albedo.
        diffuse: [f64; 3],
        /// Linear specular albedo.
        specular: [f64; 3],
        /// Widths along tangent and bitangent, 0.001 to 1.
        alpha: [f64; 2],
    },
    /// Normalised Phong lobe over a Lambert base.
    Phong {
        /// Linear diffuse albedo.
        diffuse: [f64; 3],
        /// Linear specular albedo.
        specular: [f64; 3],
        /// Exponent of the cosine, 0 to 1000000.
        exponent: f64,
    },
    /// Normalised Blinn-Phong lobe over a Lambert base.
    BlinnPhong {
        /// Linear diffuse albedo.
        diffuse: [f64; 3],
        /// Linear specular albedo.
        specular: [f64; 3],
        /// Exponent of the cosine of the half vector, 0 to 1000000.
        exponent: f64,
    },
    /// Beckmann facets with Schlick's Fresnel factor over a Lambert base, which gets what the facets leave.
    CookTorrance {
        /// Linear diffuse albedo.
        diffuse: [f64; 3],
        /// Linear reflectance along the normal.
        specular: [f64; 3],
        /// Root mean square slope of the facets, 0.001 to 1.
        slope: f64,
    },
    /// A measured isotropic material.
    Measured {
        /// MERL `.binary` file, relative to this file.
        file: String,
    },
}

/// `[[object]]`: knobs of the objects whose names match.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ObjectRule {
    /// Glob over object names: paths of node names, as `**/Sofa*`.
    #[serde(rename = "match")]
    pub pattern: String,
    /// Preset of this object's knobs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quality: Option<Quality>,
    /// How its transport is represented.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub technique: Option<Technique>,
    /// Edge length of its refined mesh aimed at, metres, or with a unit as `"3cm"`.
    #[serde(default, deserialize_with = "crate::length::deserialize", skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0, "type" = ["number", "string", "null"]))]
    pub edge_length: Option<f64>,
    /// Error aimed at between its points, as the key of `[bake]`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0001, max = 1.0))]
    pub max_error: Option<f64>,
    /// Bakes fewer points than its mesh has vertices, as the key of `[bake]`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coarser: Option<bool>,
    /// Shades of a texel that an edge crosses, at its points, as the key of `[bake]`; written out, no budget chooses them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub visibility: Option<Shades>,
    /// Smooths it where its file has no normals, as the key of `[bake]`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 180.0))]
    pub smooth_angle_deg: Option<f64>,
    /// Layer in which it blocks light: 0 architecture, 1 furniture, 2 things, 3 small things. Without one, its parts' own sizes decide
    /// (4 m, 1 m, 0.25 m). Decides how much a rebake redoes, never a bit of the result.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0, max = 3))]
    pub layer: Option<u8>,
    /// An app may move it: the bakes of others leave it out, its own is of it alone, and it casts shadows by a field.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub moves: Option<bool>,
}

/// `[limits]`: what the bake may use.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// Most memory, as "12GiB". `--memory` wins over it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory: Option<ByteSize>,
}
