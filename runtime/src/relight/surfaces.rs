//! Materials as they are now: what points reflect with after a material was changed without a bake.

use crate::asset::Asset;
use crate::brdf::{Lobe, Measured, ggx};
use crate::chunk::surface::PointSurfaces;
use crate::error::RuntimeError;
use crate::light::PointLobe;
use crate::surface::detail::{Detail, fill_details, has_detail, point_lobe};
use crate::surface::{AlphaMode, Material, Model};

/// Materials of an asset as they are now, and what points reflect with.
pub struct Surfaces {
    materials: Vec<Material>,
    /// As they were when the points' averages were made.
    baked: Vec<Material>,
    tables: Vec<Measured>,
    /// `[points]`, or empty while no material needs them.
    details: Vec<Detail>,
    /// Counts changes.
    edition: u64,
}

impl Surfaces {
    /// Those of an asset.
    pub(super) fn new(asset: &Asset) -> Self {
        let (materials, tables) = (asset.materials().to_vec(), asset.tables().to_vec());
        let mut surfaces = Surfaces { baked: materials.clone(), materials, tables, details: Vec::new(), edition: 0 };
        surfaces.fill_details(asset, None);
        surfaces
    }

    /// Another number after every change.
    pub(super) fn edition(&self) -> u64 {
        self.edition
    }

    /// Materials as they are now, as the asset numbers them.
    pub(crate) fn materials(&self) -> &[Material] {
        &self.materials
    }

    /// Materials as they were when the points' averages were made.
    pub(crate) fn baked(&self) -> &[Material] {
        &self.baked
    }

    /// Measured tables: the asset's, then those that were added.
    pub(crate) fn tables(&self) -> &[Measured] {
        &self.tables
    }

    /// Adds a table; returns its number.
    pub(super) fn add_table(&mut self, table: Measured) -> u32 {
        self.tables.push(table);
        self.tables.len() as u32 - 1
    }

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
    pub(crate) fn lobe<'b>(&'b self, surfaces: &PointSurfaces, i: usize, point: usize) -> PointLobe<'b> {
        let index = surfaces.material[i] as usize;
        let (material, detail) = (&self.materials[index], self.details.get(point).copied().unwrap_or_default());
        point_lobe(material, self.roughness(index, surfaces.roughness[i]), surfaces.normal[i], &detail, &self.tables)
    }

    /// Clear coat of point `i` of a patch, `point` of the asset.
    pub(crate) fn coat(&self, surfaces: &PointSurfaces, i: usize, point: usize) -> PointLobe<'static> {
        let detail = self.details.get(point).copied().unwrap_or_default();
        let has_coat = self.materials[surfaces.material[i] as usize].clearcoat > 0.0;
        let lobe = if has_coat { Lobe::Ggx { alpha: [ggx::alpha(detail.coat_roughness); 2] } } else { Lobe::None };
        PointLobe { lobe, normal: if has_coat { detail.coat_normal } else { surfaces.normal[i] }, tangent: [0.0; 3] }
    }

    /// [`super::Relighter::set_material`].
    pub(super) fn set(&mut self, asset: &Asset, index: usize, material: Material) -> Result<(), RuntimeError> {
        let error = |what: &str| RuntimeError::Material { name: material.name.clone(), what: what.to_string() };
        let baked = self.baked.get(index).ok_or_else(|| error("there is no material of that number"))?;
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
        if material.textures().any(|texture| texture.texture as usize >= asset.textures().len() || texture.uv_set > 1) {
            return Err(error("a texture is not in the asset"));
        }
        if let Some(what) = material.fault() {
            return Err(error(what));
        }
        if matches!(material.model, Model::Measured { table } if table as usize >= self.tables.len()) {
            return Err(error("its measured table is not there: add_table comes first"));
        }
        self.materials[index] = material;
        self.edition += 1;
        self.fill_details(asset, Some(index));
        Ok(())
    }

    /// Makes what materials need beyond the baked averages, of material `only` or of all.
    fn fill_details(&mut self, asset: &Asset, only: Option<usize>) {
        let of_all = self.details.is_empty();
        if of_all && !self.materials.iter().any(has_detail) {
            return;
        }
        self.details.resize(asset.n_points(), Detail::default());
        let textures = asset.textures();
        for (at, object) in asset.objects().iter().enumerate() {
            let details = &mut self.details[object.points.clone()];
            fill_details(&asset.mesh(at), &self.materials, &textures, only.filter(|_| !of_all), details);
        }
    }

    /// Whether any material has a clear coat.
    pub(crate) fn has_coat(&self) -> bool {
        self.materials.iter().any(|material| material.clearcoat > 0.0)
    }
}
