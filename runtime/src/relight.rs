//! One asset under changing light and view: what an app keeps between frames.
//!
//! ```no_run
//! # use prelight_runtime::{asset::Asset, relight::Relighter, environment::LightCubemap, draw::camera::Camera};
//! # fn example(asset: &Asset, light: &LightCubemap, camera: Camera) -> Result<(), prelight_runtime::error::RuntimeError> {
//! let mut relighter = Relighter::new(asset);
//! relighter.set_light(light);
//! let view = relighter.view(&camera, [1280, 720], 16)?;
//! relighter.shade(camera.eye, Some(&view.points));
//! let frame = relighter.draw(&view, &|_| [0.0; 3], false)?;
//! # Ok(()) }
//! ```
//!
//! An asset with transfer gets its indirect light on top of the exact direct light ([`Relighter::set_indirect`] turns that off). Direct
//! highlights between points are looked up per pixel where [`Relighter::set_highlights`] asks for it, as it does from the start where there is
//! transfer. For both, preparing a light also filters it ([`crate::vmf_transfer::light`]); without, [`Relighter::set_light`] does not allocate after
//! its first call. [`Relighter::shade`] never does. Diffuse light is computed once per light and patch, and kept while only the view moves; glossy
//! light follows the eye, to an [`Accuracy`]. [`Relighter::set_material`] changes a surface without a bake.

mod work;

use crate::asset::Asset;
use crate::block_product::Light;
use crate::block_product::change::{LightChange, update_diffuse};
use crate::brdf::{Lobe, Measured, ggx};
use crate::camera::Camera;
use crate::chunk::mesh::Mesh;
use crate::chunk::surface::PointSurfaces;
use crate::draw::at_points::{PointImage, draw_at_points};
use crate::draw::raster::Visibility;
use crate::draw::shade::{DrawObject, DrawScene, Frame, draw_visible};
use crate::environment::LightCubemap;
use crate::error::RuntimeError;
use crate::light::lune::Lune;
use crate::light::{Accuracy, Glossy, PointLobe};
use crate::sphere::icosahedron::{Icosahedron, MAX_LEVEL};
use crate::surface::detail::{Detail, fill_details, has_detail, is_bent, point_lobe};
use crate::surface::{AlphaMode, Material, Model};
use crate::vmf_transfer::FilteredLight;
use crate::vmf_transfer::highlight::Highlight;
use crate::vmf_transfer::pixel::{EyeLobes, PixelLobes};
use work::{Part, Work};

/// Buffers for the light at every point of an asset.
pub struct Relighter<'a> {
    asset: &'a Asset,
    light: Option<Light>,
    /// Only where the asset has transfer.
    indirect: Option<Indirect>,
    /// `[points][channel][axis]` vector irradiance, W·m⁻².
    irradiance: Vec<[[f32; 3]; 3]>,
    /// `[points]` what bent normals need beside it; empty while no material has a normal map.
    lune: Vec<Lune>,
    /// `[points]` glossy radiance in two terms.
    glossy: Vec<Glossy>,
    /// `[points]` radiance of a whole clear coat; empty while no material has one.
    coat: Vec<[f32; 3]>,
    /// `[points]` lobes of indirect light toward the eye; empty without transfer.
    lobes: Vec<EyeLobes>,
    /// `[points]` direct light between them; empty while highlights are off.
    highlights: Vec<Highlight>,
    /// The light in which lobes and highlights are looked up; none where neither is wanted.
    filtered: Option<FilteredLight>,
    surfaces: Surfaces<'a>,
    accuracy: Accuracy,
    /// What [`Relighter::change_light`] compares with.
    cubemap: Option<LightCubemap>,
    /// `[points]` what `irradiance` rounds away; empty before the first change.
    rest: Vec<[[f32; 3]; 3]>,
    /// Most flux of the lights that patches were summed under.
    at_full: f64,
    /// `[points]` flags, gathered from the patches.
    flags: Vec<u32>,
    /// `[patches]` irradiance is that of the current light.
    is_lit: Vec<bool>,
}

/// Materials as they are now.
struct Surfaces<'a> {
    materials: Vec<Material>,
    /// As they were when the points' averages were made.
    baked: &'a [Material],
    tables: Vec<Measured>,
    /// `[points]`, or empty while no material needs them.
    details: Vec<Detail>,
}

impl Surfaces<'_> {
    /// Roughness of a point whose average was `roughness` when the material was baked.
    ///
    /// The normals' spread adds to alpha², the factor multiplies what is below it. With both textures the two cannot be told apart, and all
    /// is taken to scale with the factor.
    fn roughness(&self, material: usize, roughness: f32) -> f32 {
        let (baked, now) = (&self.baked[material], &self.materials[material]);
        if baked.roughness == now.roughness && baked.metallic_roughness_texture == now.metallic_roughness_texture {
            return roughness;
        }
        let (before, after) = (baked.roughness.powi(4), now.roughness.powi(4));
        if baked.metallic_roughness_texture.is_some() && now.metallic_roughness_texture.is_some() && baked.roughness > 0.0 {
            return (roughness * now.roughness / baked.roughness).min(1.0);
        }
        let spread = if baked.normal_texture.is_some() { (roughness.powi(4) - before).max(0.0) } else { 0.0 };
        if spread > 0.0 { (after + spread).min(1.0).sqrt().sqrt() } else { now.roughness }
    }

    /// What point `i` of a patch, `point` of the asset, reflects with.
    fn lobe<'b>(&'b self, surfaces: &PointSurfaces, i: usize, point: usize) -> PointLobe<'b> {
        let index = surfaces.material[i] as usize;
        let (material, detail) = (&self.materials[index], self.details.get(point).copied().unwrap_or_default());
        point_lobe(material, self.roughness(index, surfaces.roughness[i]), surfaces.normal[i], &detail, &self.tables)
    }

    /// The same for the clear coat.
    fn coat(&self, surfaces: &PointSurfaces, i: usize, point: usize) -> PointLobe<'static> {
        let detail = self.details.get(point).copied().unwrap_or_default();
        let has_coat = self.materials[surfaces.material[i] as usize].clearcoat > 0.0;
        let lobe = if has_coat { Lobe::Ggx { alpha: [ggx::alpha(detail.coat_roughness); 2] } } else { Lobe::None };
        PointLobe { lobe, normal: if has_coat { detail.coat_normal } else { surfaces.normal[i] }, tangent: [0.0; 3] }
    }
}

/// What indirect light needs besides the chunks.
struct Indirect {
    solid: Icosahedron,
    is_on: bool,
}

/// What one camera sees of an asset.
pub struct View {
    visibility: Visibility,
    /// `[points of the asset]` drawing interpolates from this point.
    pub points: Vec<bool>,
}

impl<'a> Relighter<'a> {
    /// Buffers for all points: 80 bytes each, 88 more where the asset has transfer, 52 with highlights, 32 with normal maps.
    pub fn new(asset: &'a Asset) -> Self {
        let has_transfer = asset.patches.iter().any(|patch| patch.transfer().is_some());
        let has_normal_map = asset.materials().iter().any(|material| material.normal_texture.is_some());
        let mut flags = Vec::with_capacity(asset.n_points());
        asset.patches.iter().for_each(|patch| flags.extend_from_slice(patch.points().flags));
        let mut relighter = Relighter {
            asset,
            light: None,
            indirect: has_transfer.then(|| Indirect { solid: Icosahedron::new(MAX_LEVEL), is_on: true }),
            coat: Vec::new(),
            lobes: if has_transfer { vec![EyeLobes::default(); asset.n_points()] } else { Vec::new() },
            highlights: Vec::new(),
            filtered: None,
            surfaces: Surfaces {
                materials: asset.materials().to_vec(),
                baked: asset.materials(),
                tables: asset.tables().to_vec(),
                details: Vec::new(),
            },
            accuracy: Accuracy::FINE,
            cubemap: None,
            rest: Vec::new(),
            at_full: 0.0,
            irradiance: vec![[[0.0; 3]; 3]; asset.n_points()],
            lune: if has_normal_map { vec![Lune::default(); asset.n_points()] } else { Vec::new() },
            glossy: vec![Glossy::default(); asset.n_points()],
            flags,
            is_lit: vec![false; asset.patches.len()],
        };
        relighter.fill_details(None);
        relighter.set_highlights(has_transfer);
        relighter
    }

    /// Changes how exactly glossy light is computed; [`Accuracy::FINE`] before.
    pub fn set_accuracy(&mut self, accuracy: Accuracy) {
        self.accuracy = accuracy;
    }

    /// Whether direct light on curved glossy surfaces is looked up per pixel between points, so that highlights move over them instead of fading
    /// from point to point ([`crate::vmf_transfer::highlight`]). From the next [`Relighter::set_light`] on, which takes a fifth of a
    /// second more; drawing takes about a sixth more.
    pub fn set_highlights(&mut self, is_on: bool) {
        self.highlights.clear();
        self.highlights.shrink_to_fit();
        if is_on {
            self.highlights.resize(self.asset.n_points(), Highlight::default());
        }
    }

    /// Materials as they are now, as the asset numbers them.
    pub fn materials(&self) -> &[Material] {
        &self.surfaces.materials
    }

    /// Adds a measured table for [`Model::Measured`]; returns its number.
    pub fn add_table(&mut self, table: Measured) -> u32 {
        self.surfaces.tables.push(table);
        self.surfaces.tables.len() as u32 - 1
    }

    /// Changes a material, without a new bake: model, colours, widths and textures of anything but normals and opacity. The next
    /// [`Relighter::shade`] shows it; diffuse light stays. Averages over a point's footprint stay those of the baked textures.
    ///
    /// # Errors
    /// A material or table that is not there, a value out of range, or a change of what was baked: sides, opacity, normal map, or another
    /// roughness texture. Nothing is changed then.
    pub fn set_material(&mut self, index: usize, material: Material) -> Result<(), RuntimeError> {
        let error = |what: &str| RuntimeError::Material { name: material.name.clone(), what: what.to_string() };
        let baked = self.surfaces.baked.get(index).ok_or_else(|| error("there is no material of that number"))?;
        let opacity = |m: &Material| {
            let cut = m.alpha_mode != AlphaMode::Opaque;
            (m.alpha_mode, m.double_sided, m.occludes, cut.then_some((m.base_color[3], m.base_color_texture)))
        };
        if opacity(baked) != opacity(&material) {
            return Err(error("its sides and its opacity are baked: they decide what blocks light"));
        }
        let normals = |m: &Material| m.normal_texture.map(|texture| (texture, m.normal_scale));
        if normals(baked) != normals(&material) {
            return Err(error("its normal map is baked into the points' mean normals"));
        }
        if material.metallic_roughness_texture.is_some() && material.metallic_roughness_texture != baked.metallic_roughness_texture {
            return Err(error("its roughness texture is averaged by the bake: keep it or take it out"));
        }
        if material.textures().any(|texture| texture.texture as usize >= self.asset.textures().len() || texture.uv_set > 1) {
            return Err(error("a texture is not in the asset"));
        }
        let unit = [
            material.metallic,
            material.roughness,
            material.specular,
            material.anisotropy,
            material.clearcoat,
            material.clearcoat_roughness,
        ];
        let aspect = if let Model::Ward { aspect } = material.model { aspect } else { 1.0 };
        let mut positive = material.emissive.iter().chain(&material.specular_color).chain(std::slice::from_ref(&material.ior));
        let in_range = unit.iter().chain(&material.base_color).all(|x| (0.0..=1.0).contains(x))
            && positive.all(|x| (0.0..=f32::MAX).contains(x))
            && (1e-3..=1e3).contains(&aspect)
            && material.anisotropy_rotation.is_finite();
        if !in_range {
            return Err(error("a value is out of range: shares are 0..=1, colours not negative, aspect 0.001..=1000"));
        }
        if matches!(material.model, Model::Measured { table } if table as usize >= self.surfaces.tables.len()) {
            return Err(error("its measured table is not there: add_table comes first"));
        }
        self.surfaces.materials[index] = material;
        self.fill_details(Some(index));
        Ok(())
    }

    /// Makes what materials need beyond the baked averages, and room for clear coats.
    fn fill_details(&mut self, only: Option<usize>) {
        let surfaces = &mut self.surfaces;
        let of_all = surfaces.details.is_empty();
        if of_all && !surfaces.materials.iter().any(has_detail) {
            return;
        }
        surfaces.details.resize(self.asset.n_points(), Detail::default());
        let textures = self.asset.textures();
        for (at, object) in self.asset.objects.iter().enumerate() {
            let details = &mut surfaces.details[object.points.clone()];
            fill_details(&self.asset.mesh(at), &surfaces.materials, &textures, only.filter(|_| !of_all), details);
        }
        if surfaces.materials.iter().any(|material| material.clearcoat > 0.0) {
            self.coat.resize(self.asset.n_points(), [0.0; 3]);
        }
    }

    /// Changes the light. The cubemap must have the asset's face resolution.
    pub fn set_light(&mut self, light: &LightCubemap) {
        match &mut self.light {
            Some(prepared) => prepared.update(light),
            None => self.light = Some(Light::prepare(light)),
        }
        let is_wanted = self.indirect.is_some() || !self.highlights.is_empty();
        self.filtered = is_wanted.then(|| FilteredLight::prepare(light));
        // Those of the last light say nothing about this one's.
        self.lobes.fill(EyeLobes::default());
        self.highlights.fill(Highlight::default());
        self.is_lit.fill(false);
        self.cubemap = None;
    }

    /// [`Relighter::set_light`] for a light that differs little from the last one given here: where few blocks of the cubemap changed, only
    /// those are summed again, at every point that was lit, without drift ([`LightChange`]). Patches with a normal map wait for the next
    /// [`Relighter::shade`], which sums all of theirs. Keeps a copy of the light.
    pub fn change_light(&mut self, light: &LightCubemap) {
        let total: f64 = light.flux.as_flattened().iter().map(|flux| f64::from(*flux)).sum();
        // Indirect light has no sums to change: it is looked up again, and direct light with it.
        let before = self.cubemap.take().filter(|_| self.indirect.is_none());
        let change = before.map(|before| LightChange::between(&before, light));
        let mut lit = self.is_lit.clone();
        self.set_light(light);
        self.cubemap = Some(light.clone());
        match change.filter(|change| change.allows(self.at_full, total)) {
            Some(change) => {
                self.rest.resize(self.irradiance.len(), [[0.0; 3]; 3]);
                for (patch, is_lit) in self.asset.patches.iter().zip(&mut lit).filter(|(_, lit)| **lit) {
                    if !self.lune.is_empty() && is_bent(&patch.surfaces(), self.surfaces.baked) {
                        *is_lit = false;
                        continue;
                    }
                    let range = patch.points.clone();
                    update_diffuse(&change, &patch.visibility(), &mut self.irradiance[range.clone()], &mut self.rest[range]);
                }
                self.is_lit = lit;
                self.at_full = self.at_full.max(total);
            }
            None => {
                self.rest.fill([[0.0; 3]; 3]);
                self.at_full = total;
            }
        }
    }

    /// Whether light that came over other surfaces is added; on from the start, and without effect where none was baked.
    pub fn set_indirect(&mut self, is_on: bool) {
        if let Some(indirect) = &mut self.indirect
            && std::mem::replace(&mut indirect.is_on, is_on) != is_on
        {
            self.is_lit.fill(false);
            self.lobes.fill(EyeLobes::default());
        }
    }

    /// Computes the light at points for an eye: of the patches that hold a wanted point, or of all. Returns how many points that were.
    ///
    /// Panics before the first [`Relighter::set_light`], or when `wanted` has not one element per point.
    pub fn shade(&mut self, eye: [f32; 3], wanted: Option<&[bool]>) -> usize {
        self.work(Some(eye), wanted)
    }

    /// [`Relighter::shade`] without glossy light, which stays what it was: all that clay needs.
    pub fn shade_diffuse(&mut self, wanted: Option<&[bool]>) -> usize {
        self.work(None, wanted)
    }

    fn work(&mut self, eye: Option<[f32; 3]>, wanted: Option<&[bool]>) -> usize {
        let light = self.light.as_ref().expect("set_light comes before shade");
        assert!(wanted.is_none_or(|wanted| wanted.len() == self.irradiance.len()), "one flag per point");
        let filtered = self.filtered.as_ref();
        let work = Work {
            light,
            surfaces: &self.surfaces,
            accuracy: self.accuracy,
            indirect: self.indirect.as_ref().filter(|indirect| indirect.is_on).zip(filtered),
            highlights: filtered.filter(|_| !self.highlights.is_empty()),
            eye,
            wanted,
        };
        work.run(Part {
            patches: &self.asset.patches,
            is_lit: &mut self.is_lit,
            irradiance: &mut self.irradiance,
            lune: &mut self.lune,
            glossy: &mut self.glossy,
            coat: &mut self.coat,
            lobes: &mut self.lobes,
            highlights: &mut self.highlights,
        })
    }

    /// `[points][channel][axis]` vector irradiance of the points shaded last, W·m⁻².
    pub fn irradiance(&self) -> &[[[f32; 3]; 3]] {
        &self.irradiance
    }

    /// `[points]` glossy radiance of the points shaded last.
    pub fn glossy(&self) -> &[Glossy] {
        &self.glossy
    }

    /// Rasterises: what a camera sees does not depend on light, so a view can be kept while the camera is still.
    pub fn view(&self, camera: &Camera, size: [usize; 2], samples: usize) -> Result<View, RuntimeError> {
        let meshes = self.meshes();
        let visibility = Visibility::new(&meshes, self.materials(), &self.asset.textures(), camera, size, samples)?;
        let n_points: Vec<usize> = self.asset.objects.iter().map(|object| object.points.len()).collect();
        let points = visibility.visible_points(&meshes, &n_points).concat();
        Ok(View { visibility, points })
    }

    /// Draws a view with the light of the last [`Relighter::shade`]; `background` gives radiance where nothing is.
    pub fn draw(&self, view: &View, background: &(dyn Fn([f32; 3]) -> [f32; 3] + Sync), clay: bool) -> Result<Frame, RuntimeError> {
        self.with_scene(background, clay, |scene| draw_visible(scene, &view.visibility))
    }

    /// Draws each pixel of a view at the point that weighs most in it: the error at points, without interpolation's.
    ///
    /// # Errors
    /// As [`Relighter::draw`].
    pub fn draw_at_points(&self, view: &View, clay: bool) -> Result<PointImage, RuntimeError> {
        self.with_scene(&|_| [0.0; 3], clay, |scene| draw_at_points(scene, &view.visibility))
    }

    fn with_scene<T>(&self, background: &(dyn Fn([f32; 3]) -> [f32; 3] + Sync), clay: bool, f: impl FnOnce(&DrawScene) -> T) -> T {
        let objects: Vec<DrawObject> = (self.asset.objects.iter().zip(self.meshes()))
            .map(|(object, mesh)| DrawObject {
                mesh,
                irradiance: &self.irradiance[object.points.clone()],
                lune: self.lune.get(object.points.clone()).unwrap_or_default(),
                glossy: &self.glossy[object.points.clone()],
                coat: self.coat.get(object.points.clone()).unwrap_or_default(),
                lobes: self.filtered.as_ref().map(|light| PixelLobes {
                    light,
                    lobes: self.lobes.get(object.points.clone()).unwrap_or_default(),
                    highlights: self.highlights.get(object.points.clone()).unwrap_or_default(),
                }),
                point_flags: &self.flags[object.points.clone()],
            })
            .collect();
        let (materials, textures) = (self.materials(), self.asset.textures());
        f(&DrawScene { objects: &objects, materials, textures: &textures, tables: &self.surfaces.tables, background, clay })
    }

    fn meshes(&self) -> Vec<Mesh<'a>> {
        (0..self.asset.objects.len()).map(|object| self.asset.mesh(object)).collect()
    }
}
