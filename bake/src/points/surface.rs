//! Material parameters of points, averaged over what they stand for.
//!
//! A point's footprint is its hat function on the refined mesh, the weight with which draw interpolates from it: each adjacent triangle
//! is sampled at the centroids of its 16 equal parts, weighted by area and by the barycentric weight of the point's corner.
//!
//! ```text
//! roughness: α = roughness², mean of α² over the footprint
//! normal:    mean m of the mapped normals, each bent about the point's own n_s, so that curvature of the mesh does not count
//! widened:   α'² = mean α² + 2/κ,  1/κ = (1 − |m|²) / (|m|·(3 − |m|²)),  roughness = α'^½, at most 1
//! ```
//!
//! κ is the concentration of the von Mises–Fisher distribution with mean length |m|; a lobe exp(κ·cos θ) falls off like a Beckmann lobe
//! with α² = 2/κ, and such slopes add. Lossy: 16 samples a triangle, not an integral, and GGX has longer tails than Beckmann.
//!
//! Samples that a MASK material cuts away count for nothing: there is no surface. Where all are cut, and without such textures, the
//! factors stand to the bit, and n_s.

use crate::mesh::RefinedTriangle;
use crate::mesh::origin::area_normal;
use crate::mesh::weld::{narrow, wide};
use crate::points::{ObjectPlan, Patch};
use glam::DVec3;
use prelight_runtime::asset::points::BACK_SIDE;
use prelight_runtime::asset::surface::PointSurfaces;
use prelight_runtime::surface::detail::{Detail, fill_details, has_detail};
use prelight_runtime::surface::{AlphaMode, Material, bend_normal, resolve, tangent_from_uv};
use prelight_scene::Scene;

/// Averaged parameters of an object's points, in their order. See [`PointSurfaces`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ObjectSurfaces {
    /// Mean mapped normal, unit, on the point's side.
    pub normal: Vec<[f32; 3]>,
    /// Perceptual roughness, widened, 0..1.
    pub roughness: Vec<f32>,
    /// Metalness 0..1.
    pub metallic: Vec<f32>,
    /// Index into the scene's materials.
    pub material: Vec<u32>,
    /// What lobes need beyond the averages; empty where no material of the object needs any, or nobody asked.
    pub details: Vec<Detail>,
}

impl ObjectSurfaces {
    /// With what lobes need beyond the averages.
    pub(crate) fn with_details(mut self, scene: &Scene, plan: &ObjectPlan) -> Self {
        if self.material.iter().any(|material| has_detail(&scene.materials[*material as usize])) {
            self.details = vec![Detail::default(); plan.n_points()];
            fill_details(&plan.mesh().view(), &scene.materials, &scene.textures, None, &mut self.details);
        }
        self
    }

    /// The surface chunk of a patch, borrowed.
    pub(crate) fn patch(&self, patch: &Patch) -> PointSurfaces<'_> {
        let range = patch.range();
        PointSurfaces {
            normal: &self.normal[range.clone()],
            roughness: &self.roughness[range.clone()],
            metallic: &self.metallic[range.clone()],
            material: &self.material[range],
        }
    }
}

/// Averages the materials of an object over the footprints of its points. Deterministic: sums run in mesh order, in f64.
pub(crate) fn point_surfaces(scene: &Scene, plan: &ObjectPlan) -> ObjectSurfaces {
    let footprints = Footprints::new(scene, plan);
    let mut surfaces = ObjectSurfaces::default();
    for (i, &source) in plan.source.iter().enumerate() {
        let back = plan.flags[i] & BACK_SIDE != 0;
        let primitive = plan.refined.points.primitive[source as usize];
        let index = plan.base.primitives[primitive as usize].material;
        let material = &scene.materials[index as usize];
        let mut sample = PointSample { normal: plan.normal[i], roughness: unit(material.roughness), metallic: unit(material.metallic) };
        if is_textured(material) {
            footprints.sums[source as usize].finish(material, plan.refined.points.normal[source as usize], back, &mut sample);
        }
        surfaces.normal.push(sample.normal);
        surfaces.roughness.push(sample.roughness);
        surfaces.metallic.push(sample.metallic);
        surfaces.material.push(index);
    }
    surfaces
}

struct PointSample {
    normal: [f32; 3],
    roughness: f32,
    metallic: f32,
}

fn is_textured(material: &Material) -> bool {
    material.metallic_roughness_texture.is_some() || material.normal_texture.is_some()
}

/// 0..1; NaN becomes 0.
fn unit(v: f32) -> f32 {
    if v > 0.0 { v.min(1.0) } else { 0.0 }
}

/// Sums over one footprint.
#[derive(Clone, Copy, Default)]
struct Sums {
    weight: f64,
    alpha_squared: f64,
    metallic: f64,
    normal: DVec3,
}

impl Sums {
    /// Adds a share of another footprint.
    fn add(&mut self, other: Sums, share: f64) {
        self.weight += other.weight * share;
        self.alpha_squared += other.alpha_squared * share;
        self.metallic += other.metallic * share;
        self.normal += other.normal * share;
    }

    fn finish(&self, material: &Material, front_normal: [f32; 3], back: bool, sample: &mut PointSample) {
        if self.weight <= 0.0 {
            return;
        }
        let mut alpha_squared = self.alpha_squared / self.weight;
        if material.normal_texture.is_some() {
            let mean = self.normal / self.weight;
            let length = mean.length().min(1.0);
            // A mean below the horizon has no meaning as a normal; n_s stands, fully widened by the short mean.
            if mean.dot(wide(front_normal)) > 0.0 {
                sample.normal = narrow(mean.normalize() * if back { -1.0 } else { 1.0 });
            }
            let spread = if length > 0.0 { (1.0 - length * length) / (length * (3.0 - length * length)) } else { 1.0 };
            // f32 rounding of unit normals is no spread.
            alpha_squared += if spread > 1e-6 { 2.0 * spread } else { 0.0 };
        }
        if material.metallic_roughness_texture.is_some() {
            sample.metallic = unit((self.metallic / self.weight) as f32);
        }
        if material.metallic_roughness_texture.is_some() || alpha_squared > self.alpha_squared / self.weight {
            sample.roughness = unit(alpha_squared.min(1.0).sqrt().sqrt() as f32);
        }
    }
}

/// Sums of all refined points; empty if no material of the object is textured.
struct Footprints {
    sums: Vec<Sums>,
}

impl Footprints {
    fn new(scene: &Scene, plan: &ObjectPlan) -> Footprints {
        // Only what is averaged is looked up, and what cuts.
        let lean = |index: u32| {
            let material = &scene.materials[index as usize];
            let cuts = matches!(material.alpha_mode, AlphaMode::Mask { .. });
            let base_color_texture = material.base_color_texture.filter(|_| cuts);
            Material { base_color_texture, emissive_texture: None, ..material.clone() }
        };
        let materials: Vec<Material> = plan.base.primitives.iter().map(|p| lean(p.material)).collect();
        if !materials.iter().any(is_textured) {
            return Footprints { sums: Vec::new() };
        }
        let mut footprints = Footprints { sums: vec![Sums::default(); plan.refined.level.len()] };
        for triangle in &plan.refined.triangles {
            let material = &materials[plan.base.triangles[triangle.base as usize].primitive as usize];
            if is_textured(material) {
                footprints.add(scene, plan, triangle, material);
            }
        }
        for stand in &plan.stands {
            let sums = footprints.sums[stand.point as usize];
            stand.sources.iter().zip(stand.weights).for_each(|(p, weight)| footprints.sums[*p as usize].add(sums, f64::from(weight)));
        }
        footprints
    }

    fn add(&mut self, scene: &Scene, plan: &ObjectPlan, triangle: &RefinedTriangle, material: &Material) {
        let vertices = &plan.refined.vertices;
        let points = triangle.vertices.map(|v| vertices.point[v as usize] as usize);
        let positions = points.map(|p| plan.refined.points.position[p]);
        let normals = points.map(|p| plan.refined.points.normal[p]);
        let corners = triangle.vertices.map(|v| v as usize);
        let uvs = [0, 1].map(|set| corners.map(|v| vertices.uv[set].get(v).copied().unwrap_or_default()));
        let tangents = match material.normal_texture {
            Some(reference) if vertices.tangent.is_empty() => {
                let uvs = uvs[usize::from(reference.uv_set == 1)].map(|uv| reference.place(uv));
                [tangent_from_uv(positions, uvs).unwrap_or_default(); 3]
            }
            Some(_) => corners.map(|v| vertices.tangent[v]),
            None => [[0.0; 4]; 3],
        };
        let colors = (!vertices.color.is_empty()).then(|| corners.map(|v| vertices.color[v][3]));
        let area = area_normal(&positions).length() / 32.0;
        for weights in centroids() {
            let uv = uvs.map(|uv| [0, 1].map(|i| uv[0][i] * weights[0] + uv[1][i] * weights[1] + uv[2][i] * weights[2]));
            let alpha = colors.map_or(1.0, |a| a[0] * weights[0] + a[1] * weights[1] + a[2] * weights[2]);
            let sample = resolve(material, &scene.textures, uv[0], uv[1], [1.0, 1.0, 1.0, alpha]);
            if matches!(material.alpha_mode, AlphaMode::Mask { cutoff } if sample.alpha < cutoff) {
                continue;
            }
            let alpha = f64::from(sample.roughness) * f64::from(sample.roughness);
            for k in 0..3 {
                let weight = area * f64::from(weights[k]);
                let sums = &mut self.sums[points[k]];
                sums.weight += weight;
                sums.alpha_squared += weight * alpha * alpha;
                sums.metallic += weight * f64::from(sample.metallic);
                if let Some(bent) = sample.normal_tangent {
                    sums.normal += wide(bend_normal(bent, normals[k], tangents[k])) * weight;
                }
            }
        }
    }
}

/// Barycentric centroids of the 16 equal parts of a triangle.
fn centroids() -> impl Iterator<Item = [f32; 3]> {
    let at = |i: u32, j: u32, third: u32| {
        let (u, v) = ((3 * i + third) as f32 / 12.0, (3 * j + third) as f32 / 12.0);
        [1.0 - u - v, u, v]
    };
    (0..4u32).flat_map(move |i| {
        (0..4 - i).flat_map(move |j| {
            let turned = (i + j < 3).then(|| at(i, j, 2));
            std::iter::once(at(i, j, 1)).chain(turned)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::test_scenes::*;
    use prelight_runtime::surface::{Texture, TextureEncoding, TextureRef, Wrap};
    use std::borrow::Cow;

    fn texture(texels: &[[u8; 4]], width: u32) -> Texture<'static> {
        let height = texels.len() as u32 / width;
        Texture { width, height, encoding: TextureEncoding::Linear, texels: Cow::Owned(texels.concat()) }
    }

    fn reference(texture: u32) -> Option<TextureRef> {
        Some(TextureRef { texture, uv_set: 0, wrap: [Wrap::Repeat; 2], nearest: true, transform: None })
    }

    /// A unit square facing +z with uv = (x, 1 − y), u along +x and v down.
    fn square(material: Material, textures: Vec<Texture<'static>>) -> (Scene, ObjectPlan) {
        let mut quad = quad([0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], 0);
        quad.uvs[0] = Some(quad.positions.iter().map(|p| [p[0], 1.0 - p[1]]).collect());
        let mut scene = Scene { materials: vec![material], textures, ..Scene::default() };
        add(&mut scene, "square", vec![quad], IDENTITY);
        let (_, mut plans) = plan(&scene, &params(0.3));
        (scene, plans.remove(0))
    }

    #[test]
    fn the_sixteen_centroids_average_any_linear_function_exactly() {
        let all: Vec<[f32; 3]> = centroids().collect();
        assert_eq!(all.len(), 16);
        for k in 0..3 {
            let mean: f32 = all.iter().map(|w| w[k]).sum::<f32>() / 16.0;
            // Each barycentric weight has the mean 1/3; f32 sums of 16 terms.
            assert!((mean - 1.0 / 3.0).abs() < 1e-6);
        }
        let mut sorted: Vec<String> = all.iter().map(|w| format!("{w:?}")).collect();
        sorted.sort();
        sorted.dedup();
        assert_eq!(sorted.len(), 16);
    }

    #[test]
    fn untextured_materials_keep_their_factors_and_normals_to_the_bit() {
        let material = Material { roughness: 0.3337, metallic: 0.123, double_sided: true, ..Material::default() };
        let (scene, plan) = square(material, vec![]);
        let surfaces = point_surfaces(&scene, &plan);
        assert!(surfaces.roughness.iter().all(|r| *r == 0.3337) && surfaces.metallic.iter().all(|m| *m == 0.123));
        assert_eq!(surfaces.normal, plan.normal);
        assert!(plan.patches.iter().all(|p| surfaces.patch(p).roughness.len() == p.n_points as usize));
    }

    #[test]
    fn roughness_and_metalness_are_means_over_the_footprint() {
        // The left half is rough 0.5 and no metal, the right half rough 1 and metal.
        let textures = vec![texture(&[[0, 128, 0, 0], [0, 255, 255, 0]], 2)];
        let material = Material { metallic_roughness_texture: reference(0), ..Material::default() };
        let (scene, plan) = square(material, textures);
        let surfaces = point_surfaces(&scene, &plan);
        let low = 128.0 / 255.0;
        for i in 0..plan.n_points() {
            let x = plan.position[i][0];
            assert!((low..=1.0).contains(&surfaces.roughness[i]));
            if x < 0.2 {
                // √√(r⁴) of a constant footprint: f32 rounding of the result.
                assert!((surfaces.roughness[i] - low).abs() < 1e-6 && surfaces.metallic[i] == 0.0, "{x}");
            } else if x > 0.8 {
                assert_eq!((surfaces.roughness[i], surfaces.metallic[i]), (1.0, 1.0));
            } else if x == 0.5 {
                // 16 samples a triangle meet the border of the halves by symmetry of the mesh to 1/16.
                assert!((surfaces.metallic[i] - 0.5).abs() < 0.07, "{}", surfaces.metallic[i]);
            }
        }
    }

    #[test]
    fn a_constant_normal_map_bends_without_widening_and_a_rough_one_widens() {
        // x = 0.5, y = 0, z = √¾ in tangent space, to 8 bits.
        let bent = [191, 128, 237, 0];
        let textures = vec![texture(&[bent], 1)];
        let material = Material { normal_texture: reference(0), roughness: 0.25, double_sided: true, ..Material::default() };
        let (scene, plan) = square(material.clone(), textures);
        let surfaces = point_surfaces(&scene, &plan);
        for i in 0..plan.n_points() {
            let side = plan.normal[i][2];
            // 1/255 of rounding in the texels.
            assert!((surfaces.normal[i][0] * side - 0.5).abs() < 0.01, "u grows along +x: {:?}", surfaces.normal[i]);
            assert_eq!(surfaces.roughness[i], 0.25);
        }
        let other = [64, 128, 237, 0];
        let (scene, plan) = square(material, vec![texture(&[bent, other].repeat(32), 64)]);
        let surfaces = point_surfaces(&scene, &plan);
        let middle = (0..plan.n_points()).find(|&i| plan.position[i] == [0.5, 0.5, 0.0]).expect("edges are halved");
        // Half leans +30°, half −30°: |m| = cos 30° up to sampling, 1/κ = 0.25/(0.866·2.25) = 0.128, α² = 0.25⁴ + 0.257.
        let expected = (0.25f64.powi(4) + 0.257).sqrt().sqrt();
        assert!((f64::from(surfaces.roughness[middle]) - expected).abs() < 0.02, "{} {expected}", surfaces.roughness[middle]);
        assert!(surfaces.normal[middle][2].abs() > 0.98);
    }

    #[test]
    fn what_a_mask_cuts_away_is_not_averaged() {
        // The left half is cut away and would be rough 0.5; the right half is smooth metal.
        let textures = vec![texture(&[[0, 128, 0, 0], [0, 51, 255, 0]], 2), texture(&[[255, 255, 255, 0], [255; 4]], 2)];
        let material = Material {
            metallic_roughness_texture: reference(0),
            base_color_texture: reference(1),
            alpha_mode: AlphaMode::Mask { cutoff: 0.5 },
            ..Material::default()
        };
        let (scene, plan) = square(material, textures);
        let surfaces = point_surfaces(&scene, &plan);
        let mut n_kept = 0;
        for i in 0..plan.n_points() {
            if plan.position[i][0] >= 0.5 {
                // √√(r⁴): f32 rounding of the result.
                assert!((surfaces.roughness[i] - 0.2).abs() < 1e-6 && surfaces.metallic[i] == 1.0, "{:?}", plan.position[i]);
                n_kept += 1;
            }
        }
        assert!(n_kept > 4);
        let gone = (0..plan.n_points()).find(|&i| plan.position[i] == [0.0; 3]).expect("corners are points");
        assert_eq!((surfaces.roughness[gone], surfaces.metallic[gone]), (1.0, 1.0), "nothing is left to average: the factors");
    }
}
