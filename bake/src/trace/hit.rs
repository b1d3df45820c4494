//! What a ray finds: shading normal, mapped normal, material and ray origin at a hit on the base mesh, by the rules that planning and
//! drawing use.

use crate::mesh::origin::surface_origin;
use crate::mesh::weld::corner_normals;
use crate::trace::Hit;
use prelight_runtime::brdf::{Measured, Place, Surface};
use prelight_runtime::draw::shade::CLAY_ALBEDO;
use prelight_runtime::sphere::frame::{dot, tangents};
use prelight_runtime::surface::{AlphaMode, SurfaceSample, bend_normal, resolve, tangent_from_uv};
use prelight_scene::Scene;
use prelight_scene::world::World;
use std::f32::consts::PI;

/// Edge length of objects for which none is given, metres.
pub const EDGE_LENGTH: f32 = 0.05;

/// The geometry and how it is looked at.
#[derive(Clone, Copy)]
pub(crate) struct Surfaces<'a> {
    pub scene: &'a Scene,
    pub world: &'a World,
    pub clay: bool,
    /// Measured tables of the scene.
    pub tables: &'a [Measured],
    /// `[objects]` edge length of the bake, metres; [`EDGE_LENGTH`] beyond its end.
    pub edge_lengths: &'a [f32],
}

/// How light leaves a surface.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Reflection<'a> {
    Surface(Surface<'a>),
    /// Lambert.
    Clay,
    /// Nothing: the surface is its own picture.
    Unlit,
}

/// A surface at a hit, on the side that the ray came from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shading<'a> {
    pub triangle: u32,
    pub origin: [f32; 3],
    /// n_s: the horizon.
    pub normal: [f32; 3],
    /// Where the material stands: its normal is n_b.
    pub place: Place,
    pub reflection: Reflection<'a>,
    pub emissive: [f32; 3],
    /// The triangle itself does not block rays that start here.
    pub exclude: bool,
}

/// A hit before anything is shaded.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Met<'a> {
    pub hit: Hit,
    pub mode: AlphaMode,
    /// Back of a single-sided surface: not seen by the camera, black to everything else.
    pub culled: bool,
    surface: SurfaceSample,
    material: &'a prelight_runtime::surface::Material,
}

fn mix<const N: usize>(weights: [f32; 3], values: [[f32; N]; 3]) -> [f32; N] {
    std::array::from_fn(|k| weights[0] * values[0][k] + weights[1] * values[1][k] + weights[2] * values[2][k])
}

impl<'a> Surfaces<'a> {
    /// The material at a hit.
    pub(crate) fn meet(&self, hit: Hit) -> Met<'a> {
        let part = &self.world.primitives[self.world.primitive[hit.triangle as usize] as usize];
        let local = &self.scene.objects[part.object as usize].mesh.primitives[part.primitive as usize];
        let corners = part.triangles[(hit.triangle - part.first_triangle) as usize].map(|v| v as usize);
        let uv = |set: usize| local.uvs[set].as_ref().map_or([0.0; 2], |uv| mix(hit.barycentrics, corners.map(|v| uv[v])));
        let color = local.colors.as_ref().map_or([1.0; 4], |colors| mix(hit.barycentrics, corners.map(|v| colors[v])));
        let material = &self.scene.materials[part.material as usize];
        let surface = resolve(material, &self.scene.textures, uv(0), uv(1), color);
        Met { hit, mode: material.alpha_mode, culled: hit.back_face && !material.double_sided, surface, material }
    }

    /// Everything that shading needs.
    pub(crate) fn shade(&self, met: &Met) -> Shading<'a> {
        let hit = met.hit;
        let part = &self.world.primitives[self.world.primitive[hit.triangle as usize] as usize];
        let edge_length = self.edge_lengths.get(part.object as usize).copied().unwrap_or(EDGE_LENGTH);
        let start = surface_origin(self.world, hit.triangle, hit.barycentrics, hit.back_face, edge_length);
        let mut place = Place::about(start.normal);
        if !self.clay {
            let side = if hit.back_face { -1.0 } else { 1.0 };
            let front = start.normal.map(|c| c * side);
            let surface = &met.surface;
            let needs_tangent = surface.normal_tangent.is_some() || surface.coat_normal_tangent.is_some() || met.material.is_anisotropic();
            let tangent = if needs_tangent { self.tangent(met) } else { [0.0; 4] };
            let bend = |bent: Option<[f32; 3]>| bent.map_or(front, |bent| bend_normal(bent, front, tangent));
            // The bent normal of the back is the negated front one.
            place = surface.place(bend(surface.normal_tangent), bend(surface.coat_normal_tangent), tangent, side);
        }
        let surface = &met.surface;
        let reflection = if self.clay {
            Reflection::Clay
        } else if surface.unlit {
            Reflection::Unlit
        } else {
            Reflection::Surface(surface.surface(self.tables))
        };
        Shading {
            triangle: hit.triangle,
            origin: start.origin,
            normal: start.normal,
            place,
            reflection,
            emissive: if self.clay { [0.0; 3] } else { surface.emissive },
            exclude: start.exclude_triangle,
        }
    }

    /// The tangent that draw uses: the mesh's, else from texture coordinates.
    fn tangent(&self, met: &Met) -> [f32; 4] {
        let triangle = met.hit.triangle;
        let part = &self.world.primitives[self.world.primitive[triangle as usize] as usize];
        let corners = part.triangles[(triangle - part.first_triangle) as usize].map(|v| v as usize);
        if !part.tangents.is_empty() {
            let [x, y, z, _] = mix(met.hit.barycentrics, corners.map(|v| part.tangents[v]));
            let sign = part.tangents[corners[0]][3];
            // A negated normal needs a negated sign to keep the bitangent.
            return [x, y, z, if corner_normals(self.world, triangle).flipped { -sign } else { sign }];
        }
        let local = &self.scene.objects[part.object as usize].mesh.primitives[part.primitive as usize];
        let material = met.material;
        let mapped = material.normal_texture.or(material.clearcoat_normal_texture).or(material.anisotropy_texture);
        let set = mapped.map_or(0, |reference| usize::from(reference.uv_set == 1));
        let uvs = local.uvs[set].as_ref().map_or([[0.0; 2]; 3], |uv| corners.map(|v| uv[v]));
        let uvs = uvs.map(|uv| mapped.map_or(uv, |reference| reference.place(uv)));
        tangent_from_uv(self.world.positions[triangle as usize], uvs).unwrap_or([0.0; 4])
    }
}

impl Met<'_> {
    /// Share of what is behind that this surface hides.
    pub(crate) fn alpha(&self) -> f32 {
        if self.mode == AlphaMode::Blend { self.surface.alpha } else { 1.0 }
    }

    /// Whether a cut-out is here at all.
    pub(crate) fn is_there(&self) -> bool {
        match self.mode {
            AlphaMode::Mask { cutoff } => self.surface.alpha >= cutoff,
            _ => true,
        }
    }
}

impl Shading<'_> {
    /// f·n·l toward viewer `v` of light from `l`; 0 below either horizon.
    pub(crate) fn eval(&self, v: [f32; 3], l: [f32; 3]) -> [f32; 3] {
        if dot(self.normal, l) <= 0.0 {
            return [0.0; 3];
        }
        match self.reflection {
            Reflection::Surface(surface) => surface.eval(&self.place, v, l),
            Reflection::Clay => [CLAY_ALBEDO / PI * dot(self.place.normal, l).max(0.0); 3],
            Reflection::Unlit => [0.0; 3],
        }
    }

    /// A direction to continue with.
    pub(crate) fn sample(&self, v: [f32; 3], u: [f32; 3]) -> [f32; 3] {
        match self.reflection {
            Reflection::Surface(surface) => surface.sample(&self.place, v, u),
            Reflection::Clay | Reflection::Unlit => {
                let (t, b) = tangents(self.place.normal);
                let (radius, phi) = (f64::from(u[0]).sqrt(), 2.0 * std::f64::consts::PI * f64::from(u[1]));
                let (x, y, z) = (radius * libm::cos(phi), radius * libm::sin(phi), (1.0 - f64::from(u[0])).sqrt());
                std::array::from_fn(|k| (x * f64::from(t[k]) + y * f64::from(b[k]) + z * f64::from(self.place.normal[k])) as f32)
            }
        }
    }

    /// Density of [`Self::sample`], sr⁻¹.
    pub(crate) fn pdf(&self, v: [f32; 3], l: [f32; 3]) -> f32 {
        match self.reflection {
            Reflection::Surface(surface) => surface.pdf(&self.place, v, l),
            Reflection::Clay | Reflection::Unlit => dot(self.place.normal, l).max(0.0) / PI,
        }
    }

    /// Ids that do not block rays from here.
    pub(crate) fn excluded(&self) -> &[u32] {
        if self.exclude { std::slice::from_ref(&self.triangle) } else { &[] }
    }
}
