//! One light prepared for every technique, and one patch shaded with one of them.

use super::clock::thread_nanoseconds;
use super::technique::Technique;
use prelight_runtime::asset::AssetPatch;
use prelight_runtime::baseline::dense::{self, PixelLight};
use prelight_runtime::baseline::haar_triple::{HaarProjector, HaarTree, LobeSampler, VisibilityTree, kept_coefficients, triple_product};
use prelight_runtime::baseline::sh_product;
use prelight_runtime::baseline::sh_product::{ShLight, ShPoints, VisibilityProjector};
use prelight_runtime::block_product::brdf::PointLobe;
use prelight_runtime::block_product::shade_diffuse;
use prelight_runtime::block_product::visibility::open_words;
use prelight_runtime::block_product::{Glossy, shade_glossy_with, shade_lobes};
use prelight_runtime::block_product::{Light, SimdPath};
use prelight_runtime::environment::LightCubemap;
use prelight_runtime::sphere::icosahedron::{Icosahedron, MAX_LEVEL};
use prelight_runtime::vmf_transfer::FilteredLight;
use prelight_runtime::vmf_transfer::pixel::EyeLobes;
use prelight_runtime::vmf_transfer::shade::{add_glossy, add_irradiance};
use prelight_runtime::vmf_transfer::transfer::{Record, Transfer};

/// Tolerance of the direct light below lobes: far below what lobes lose.
const LOBES_TOLERANCE: f32 = 1e-3;

/// Light at points: what drawing needs.
#[derive(Clone, Debug, Default)]
pub struct PatchLight {
    /// `[points][channel][axis]`, W·m⁻².
    pub irradiance: Vec<[[f32; 3]; 3]>,
    /// `[points][term][channel]`, W·sr⁻¹·m⁻².
    pub glossy: Vec<Glossy>,
    /// `[points]` lobes toward the eye; empty where the technique has none.
    pub lobes: Vec<EyeLobes>,
}

/// Tables that depend on the cubemap's size alone.
pub struct Tables {
    face_resolution: usize,
    harmonics: Vec<(usize, VisibilityProjector)>,
}

impl Tables {
    /// For the techniques of a chart.
    pub fn new(face_resolution: usize, techniques: &[Technique]) -> Self {
        let bands = techniques.iter().filter_map(|technique| match technique {
            Technique::ShProduct { bands } => Some(*bands),
            _ => None,
        });
        Tables { face_resolution, harmonics: bands.map(|bands| (bands, VisibilityProjector::new(face_resolution, bands))).collect() }
    }
}

/// What a technique keeps of a patch's visibility.
pub enum BakedPatch {
    /// The chunk itself.
    Chunk,
    /// One bit a texel.
    Bits(Vec<u64>),
    /// One tree a point.
    Trees(Vec<VisibilityTree>),
    /// Coefficients, `[points][bands²]`.
    Harmonics(Vec<f32>),
}

impl BakedPatch {
    /// Converts a patch's visibility.
    pub fn new(technique: Technique, tables: &Tables, patch: &AssetPatch) -> Self {
        let (visibility, n) = (patch.visibility(), tables.face_resolution);
        match technique {
            Technique::BlockProduct { .. } | Technique::VmfTransfer => BakedPatch::Chunk,
            Technique::PixelSums => {
                let mut bits = vec![0; visibility.len() * open_words(n)];
                for (point, words) in bits.chunks_exact_mut(open_words(n)).enumerate() {
                    visibility.point(point).to_open_bits(n, words);
                }
                BakedPatch::Bits(bits)
            }
            Technique::HaarTriple { .. } => {
                BakedPatch::Trees((0..visibility.len()).map(|point| VisibilityTree::new(n, &visibility.point(point))).collect())
            }
            Technique::ShProduct { bands } => {
                let (_, projector) = tables.harmonics.iter().find(|(b, _)| *b == bands).expect("tables were made for this technique");
                let mut all = vec![0.0; visibility.len() * bands * bands];
                for (point, out) in all.chunks_exact_mut(bands * bands).enumerate() {
                    projector.project(&visibility.point(point), out);
                }
                BakedPatch::Harmonics(all)
            }
        }
    }

    /// Bytes that shading reads of the visibility of all points of the patch; of its lobes too where the technique has them.
    pub fn bytes(&self, technique: Technique, patch: &AssetPatch) -> usize {
        let lobes = if technique == Technique::VmfTransfer { patch.transfer().map_or(0, |lobes| lobes_bytes(&lobes)) } else { 0 };
        lobes
            + match self {
                BakedPatch::Chunk => {
                    let visibility = patch.visibility();
                    let n = visibility.len();
                    // 64 bytes of padding and the array of starts belong to the patch.
                    let point = |point: usize| {
                        let point = visibility.point(point);
                        let parts = point.fractions.map_or(0, |parts| 4 + size_of_val(parts.blocks) + parts.counts.len() + 2 * parts.len());
                        4 + size_of_val(point.blocks) + point.counts.len() + point.transitions() + parts
                    };
                    68 + (0..n).map(point).sum::<usize>()
                }
                BakedPatch::Bits(bits) => size_of_val(&bits[..]),
                BakedPatch::Trees(trees) => trees.iter().map(VisibilityTree::bytes).sum(),
                BakedPatch::Harmonics(all) => size_of_val(&all[..]),
            }
    }
}

/// Records of all points; their levels and starts are a few bytes more.
fn lobes_bytes(lobes: &Transfer) -> usize {
    (0..lobes.len()).map(|i| size_of::<Record>() * lobes.point(i).n_records()).sum()
}

/// A light prepared for one technique at one budget.
pub enum PreparedLight {
    /// Suffix sums and pyramids.
    Blocks(Box<Light>),
    /// Planar texels, and the pyramid whose finest level the glossy sum reads.
    Pixels(Box<(PixelLight, Light)>),
    /// A tree.
    Haar(HaarTree),
    /// A matrix.
    Harmonics(ShLight),
    /// Suffix sums, and one map a width of lobes.
    Lobes(Box<(Light, FilteredLight, Icosahedron)>),
}

impl PreparedLight {
    /// Prepares a cubemap.
    pub fn new(technique: Technique, light: &LightCubemap) -> Self {
        match technique {
            Technique::BlockProduct { .. } => PreparedLight::Blocks(Box::new(Light::prepare(light))),
            Technique::PixelSums => PreparedLight::Pixels(Box::new((PixelLight::new(light), Light::prepare(light)))),
            Technique::HaarTriple { share } => {
                PreparedLight::Haar(HaarTree::from_light(light, kept_coefficients(light.face_resolution, share)))
            }
            Technique::ShProduct { bands } => PreparedLight::Harmonics(ShLight::new(light, bands)),
            Technique::VmfTransfer => {
                PreparedLight::Lobes(Box::new((Light::prepare(light), FilteredLight::prepare(light), Icosahedron::new(MAX_LEVEL))))
            }
        }
    }

    /// The light that pixels look lobes up in.
    pub fn filtered(&self) -> Option<&FilteredLight> {
        match self {
            PreparedLight::Lobes(prepared) => Some(&prepared.1),
            _ => None,
        }
    }
}

/// Points whose surfaces are projected before their products are taken.
const HAAR_RUN: usize = 16;

/// Buffers of one thread.
pub struct Shader {
    /// Only the eye moved since the last call with these buffers: techniques that can keep diffuse light do.
    pub only_view_moved: bool,
    path: SimdPath,
    sampler: LobeSampler,
    projector: HaarProjector,
    lobes: Vec<HaarTree>,
    view: Vec<[f32; 3]>,
}

/// CPU time of one call, nanoseconds.
#[derive(Clone, Copy, Debug, Default)]
pub struct Spent {
    /// The product, and all that it needs but ρ.
    pub product: f64,
    /// Projection of ρ, where the technique has one.
    pub projection: f64,
}

impl Shader {
    /// Buffers for a face resolution.
    pub fn new(face_resolution: usize) -> Self {
        Shader {
            only_view_moved: false,
            path: SimdPath::detect(),
            sampler: LobeSampler::new(face_resolution),
            projector: HaarProjector::new(face_resolution),
            lobes: vec![HaarTree::flat(face_resolution); HAAR_RUN],
            view: Vec::new(),
        }
    }

    /// Shades the first `points` points of a patch toward `eye`. Only Haar products stop before the last point: one of theirs costs as much as
    /// hundreds of the others'.
    pub fn shade(
        &mut self,
        technique: Technique,
        light: &PreparedLight,
        patch: &AssetPatch,
        baked: &BakedPatch,
        eye: [f32; 3],
        points: usize,
        out: &mut PatchLight,
    ) -> Spent {
        let (position, surfaces, visibility) = (patch.points().position, patch.surfaces(), patch.visibility());
        let n = visibility.len();
        out.irradiance.resize(n, [[0.0; 3]; 3]);
        out.glossy.resize(n, [[0.0; 3]; 2]);
        let toward = |point: usize| {
            let v: [f32; 3] = std::array::from_fn(|k| eye[k] - position[point][k]);
            let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
            if length > 0.0 { v.map(|x| x / length) } else { surfaces.normal[point] }
        };
        let start = thread_nanoseconds();
        let mut projection = 0.0;
        let is_lit = self.only_view_moved && technique.keeps_diffuse();
        match (technique, light, baked) {
            (Technique::BlockProduct { accuracy }, PreparedLight::Blocks(light), BakedPatch::Chunk) => {
                if !is_lit {
                    shade_diffuse(light, &visibility, &mut out.irradiance);
                }
                let lobe = |i: usize| PointLobe::ggx(surfaces.normal[i], surfaces.roughness[i]);
                shade_lobes(self.path, accuracy, light, position, lobe, &visibility, eye, &mut out.glossy);
            }
            (Technique::PixelSums, PreparedLight::Pixels(light), BakedPatch::Bits(open)) => {
                if !is_lit {
                    dense::vector_tiled(self.path, &light.0, open, &mut out.irradiance);
                }
                shade_glossy_with(self.path, 0.0, &light.1, position, &surfaces, &visibility, eye, &mut out.glossy);
            }
            (Technique::HaarTriple { share }, PreparedLight::Haar(light), BakedPatch::Trees(trees)) => {
                let kept = kept_coefficients(visibility.face_resolution(), share);
                // In runs, because asking for the time costs as much as a tenth of a product.
                for first in (0..points.min(trees.len())).step_by(HAAR_RUN) {
                    let run = first..(first + HAAR_RUN).min(points).min(trees.len());
                    let before = thread_nanoseconds();
                    for (point, lobe) in run.clone().zip(&mut self.lobes) {
                        let values = self.sampler.sample(self.path, surfaces.normal[point], toward(point), surfaces.roughness[point]);
                        self.projector.project(values, kept, lobe);
                    }
                    projection += thread_nanoseconds() - before;
                    for (point, lobe) in run.zip(&self.lobes) {
                        let [irradiance, f0, rest] = triple_product(light, &trees[point], lobe);
                        let normal = surfaces.normal[point];
                        out.irradiance[point] = irradiance.map(|e| normal.map(|n| e * n));
                        out.glossy[point] = [f0, rest];
                    }
                }
            }
            (Technique::ShProduct { .. }, PreparedLight::Harmonics(light), BakedPatch::Harmonics(coefficients)) => {
                self.view.clear();
                self.view.extend((0..n).map(toward));
                let points =
                    ShPoints { visibility: coefficients, normal: surfaces.normal, view: &self.view, roughness: surfaces.roughness };
                sh_product::shade(self.path, light, points, &mut out.irradiance, &mut out.glossy);
            }
            (Technique::VmfTransfer, PreparedLight::Lobes(prepared), BakedPatch::Chunk) => {
                let (light, filtered, solid) = &**prepared;
                let transfer = patch.transfer();
                if !is_lit {
                    shade_diffuse(light, &visibility, &mut out.irradiance);
                }
                shade_glossy_with(self.path, LOBES_TOLERANCE, light, position, &surfaces, &visibility, eye, &mut out.glossy);
                if let Some(transfer) = &transfer {
                    if !is_lit {
                        add_irradiance(filtered, transfer, patch.points().normal, &mut out.irradiance, &mut []);
                    }
                    out.lobes.resize(n, EyeLobes::default());
                    add_glossy(filtered, solid, transfer, position, surfaces.normal, eye, &mut out.glossy, &mut out.lobes);
                }
            }
            _ => unreachable!("light and patch were prepared for another technique"),
        }
        Spent { product: thread_nanoseconds() - start - projection, projection }
    }
}
