//! What some lobes need at a point beyond its averaged surface: a tangent, and the clear coat's own normal and roughness.
//!
//! Taken at the point's vertex, from the mesh and the textures: nothing of it is baked, so a material may gain anisotropy or a coat at run
//! time. Lossy: textures of anisotropy and coat are read at the vertex, not averaged over what the point stands for.

use super::{Material, SurfaceSample, Texture, bend_normal, resolve, tangent_from_uv};
use crate::brdf::{Lobe, Measured};
use crate::chunk::mesh::{Lit, Mesh};
use crate::chunk::surface::PointSurfaces;
use crate::light::PointLobe;

/// Details of one point. Zeros where its material needs none of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Detail {
    /// Direction of the first width of an anisotropic lobe.
    pub tangent: [f32; 3],
    /// Strength of glTF's anisotropy.
    pub anisotropy: f32,
    /// Unit normal of the coat, on the point's side.
    pub coat_normal: [f32; 3],
    /// Perceptual roughness of the coat.
    pub coat_roughness: f32,
}

/// Whether points of a material have a detail.
pub fn has_detail(material: &Material) -> bool {
    material.is_anisotropic() || material.clearcoat > 0.0
}

/// What a point reflects with: a material of averaged `roughness` about the mean mapped `normal`.
pub fn point_lobe<'a>(material: &Material, roughness: f32, normal: [f32; 3], detail: &Detail, tables: &'a [Measured]) -> PointLobe<'a> {
    let sample = SurfaceSample { roughness, anisotropy: detail.anisotropy, model: material.model, ..SurfaceSample::default() };
    let lobe = if material.unlit { Lobe::None } else { sample.lobe(tables) };
    PointLobe { lobe, normal, tangent: detail.tangent }
}

/// Whether any of a patch's points has a normal map, so that its light is wanted on bent normals.
pub fn is_bent(surfaces: &PointSurfaces, materials: &[Material]) -> bool {
    surfaces.material.iter().any(|material| materials[*material as usize].normal_texture.is_some())
}

/// Fills the details of an object's points, of material `only` or of all. The first corner of a point in the mesh's order counts.
pub fn fill_details(mesh: &Mesh, materials: &[Material], textures: &[Texture], only: Option<usize>, details: &mut [Detail]) {
    let mut done = vec![false; details.len()];
    for (triangle, corners) in mesh.triangles.iter().enumerate() {
        let index = mesh.material[triangle] as usize;
        let Some(material) = materials.get(index).filter(|_| only.is_none_or(|only| only == index)) else { continue };
        let corners = corners.map(|v| v as usize);
        let mut from_uv = None;
        for v in corners {
            for (lit, side) in [(mesh.front(v), 1.0), (mesh.back(v), -1.0)] {
                // Each point has a vertex of its own.
                let Lit::Point(point) = lit else { continue };
                if std::mem::replace(&mut done[point as usize], true) {
                    continue;
                }
                details[point as usize] = Detail::default();
                if !has_detail(material) {
                    continue;
                }
                let uv = |set: &[[f32; 2]]| set.get(v).copied().unwrap_or_default();
                let tangent = mesh.tangent.get(v).copied().unwrap_or_else(|| {
                    *from_uv.get_or_insert_with(|| {
                        let mapped = material.normal_texture.or(material.clearcoat_normal_texture).or(material.anisotropy_texture);
                        let set = if mapped.is_some_and(|reference| reference.uv_set == 1) { mesh.uv1 } else { mesh.uv0 };
                        let uvs = corners.map(|v| set.get(v).copied().unwrap_or_default());
                        let uvs = uvs.map(|uv| mapped.map_or(uv, |reference| reference.place(uv)));
                        tangent_from_uv(corners.map(|v| mesh.position[v]), uvs).unwrap_or_default()
                    })
                });
                let sample = resolve(material, textures, uv(mesh.uv0), uv(mesh.uv1), [1.0; 4]);
                let normal = mesh.normal[v];
                let bend = |bent: Option<[f32; 3]>| bent.map_or(normal, |bent| bend_normal(bent, normal, tangent));
                let place = sample.place(bend(sample.normal_tangent), bend(sample.coat_normal_tangent), tangent, side);
                details[point as usize] = Detail {
                    tangent: place.tangent,
                    anisotropy: sample.anisotropy,
                    coat_normal: place.coat_normal,
                    coat_roughness: sample.coat.roughness,
                };
            }
        }
    }
}
