//! From light at points to pixels.
//!
//! Per fragment (a triangle in some samples of a pixel), at the centroid of its samples:
//!
//! ```text
//! radiance = emissive + (1 − c·E_c(n_c·v)) · (base(n_b·v) · Σ wᵢ Eᵢ(n_b) + F0 · glossy[0] + F90 · glossy[1]) + c · coat
//! ```
//!
//! Eᵢ(n_b) is max(0, Eᵢ·n_b) of the vector irradiance of a corner's point, and wᵢ its weight: cut off corner by corner, since a sun that one
//! of them sees below n_b would take the light of the others too. Where a normal map bends n_b, the light between the two horizons is added
//! ([`crate::light::lune`]). Glossy are the two Schlick terms, interpolated like it, lobes looked up again
//! ([`crate::light::Layer::between`]); n_b is the interpolated shading normal bent by the normal map; base, F0, F90 and the clear coat c are those of
//! [`crate::brdf::Surface`] (base/π · (1 − metal)(1 − E_d) for glTF). Corners without a point, and buried ones, leave the
//! interpolation: the weights of the others grow to sum 1; a triangle with none left gets no light.
//!
//! Where a pixel covers more than one texel of a texture, the fragment's samples are shaded in as many groups as it covers texels (at
//! most one a sample), so that minified textures are box filtered like everything else. The pixel is the mean of its samples. The
//! background is looked up once per quarter of a pixel.
//!
//! Clay: 0.5/π · Σ wᵢ max(0, Eᵢ·n_s) for every surface, alpha kept.

use super::image::Image;
use super::raster::{Edges, Fragment, TILE, TileFragments, Visibility, blend_corners};
use super::threads::map_indices;
use super::tonemap::{automatic_exposure, expose};
use crate::brdf::{Measured, Place};
use crate::camera::Camera;
use crate::chunk::mesh::{Lit, Mesh};
use crate::chunk::points::BURIED;
use crate::error::RuntimeError;
use crate::light::lune::{Bend, BentLight};
use crate::light::{BetweenPoints, PointLobe};
use crate::square_light::Share;
use crate::surface::{Material, SurfaceSample, Texture, bend_normal, resolve, tangent_from_uv};
use std::f32::consts::PI;

/// Reflectance of every surface in clay.
pub const CLAY_ALBEDO: f32 = 0.5;

/// An object with the light at its points. The three arrays of points have one element each per point.
#[derive(Clone, Copy)]
pub struct DrawObject<'a> {
    /// Triangles.
    pub mesh: Mesh<'a>,
    /// `[points][channel][axis]` vector irradiance, W·m⁻².
    pub irradiance: &'a [[[f32; 3]; 3]],
    /// `[points]` what bent normals need beside it. Empty: nothing is known.
    pub lune: &'a [BentLight],
    /// `[points][term][channel]` glossy radiance: the factor of F0, and the rest. Empty: none.
    pub glossy: &'a [[[f32; 3]; 2]],
    /// `[points][channel]` radiance of a whole clear coat. Empty: none.
    pub coat: &'a [[f32; 3]],
    /// `[points]` what objects that move leave of all this. Empty: all of it.
    pub share: &'a [Share],
    /// What layers say of glossy light between points. `None`: interpolated light is all.
    pub between: Option<&'a dyn BetweenPoints>,
    /// `[points]` flags of [`crate::chunk::points`]. Empty: none is buried.
    pub point_flags: &'a [u32],
}

/// What is drawn.
#[derive(Clone, Copy)]
pub struct DrawScene<'a> {
    /// Objects; triangles name materials.
    pub objects: &'a [DrawObject<'a>],
    /// Materials of the asset.
    pub materials: &'a [Material],
    /// Textures of the asset.
    pub textures: &'a [Texture<'a>],
    /// Measured tables of the asset.
    pub tables: &'a [Measured],
    /// Radiance from a unit world direction, where nothing is.
    pub background: &'a (dyn Fn([f32; 3]) -> [f32; 3] + Sync),
    /// Two-sided Lambert 0.5 instead of the materials.
    pub clay: bool,
}

/// A drawn image.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Linear radiance.
    pub image: Image,
    /// `[height · width]` share of the samples that hit a surface, 0..1.
    pub coverage: Vec<f32>,
    /// `[height · width]` all samples hit a surface: where pictures are compared.
    pub mask: Vec<bool>,
}

impl Frame {
    /// PNG bytes for a screen: exposed so that all but the brightest twentieth of the surfaces keep their detail.
    ///
    /// # Errors
    /// For a frame without pixels.
    pub fn to_png(&self) -> Result<Vec<u8>, RuntimeError> {
        expose(&self.image, automatic_exposure(&self.image, &self.mask)).to_png()
    }
}

/// Rasterises and shades.
///
/// # Errors
/// As [`Visibility::new`] and [`draw_visible`].
pub fn draw(scene: &DrawScene, camera: &Camera, size: [usize; 2], samples: usize) -> Result<Frame, RuntimeError> {
    let meshes: Vec<Mesh> = scene.objects.iter().map(|object| object.mesh).collect();
    draw_visible(scene, &Visibility::new(&meshes, scene.materials, scene.textures, camera, size, samples)?)
}

/// Shades what `visibility` found; it must come from the same meshes and materials.
///
/// # Errors
/// When an object's arrays are shorter than the points that its mesh names.
pub fn draw_visible(scene: &DrawScene, visibility: &Visibility) -> Result<Frame, RuntimeError> {
    check_light(scene)?;
    let (width, height) = (visibility.width, visibility.height);
    let tiles_x = width.div_ceil(TILE);
    let tiles = map_indices(visibility.tiles.len(), |tile| {
        Shader { scene, visibility, origin: [tile % tiles_x * TILE, tile / tiles_x * TILE] }.tile(&visibility.tiles[tile])
    });
    let mut image = Image { width, height, pixels: vec![[0.0; 3]; width * height] };
    let mut coverage = vec![0.0; width * height];
    for (tile, pixels) in tiles.iter().enumerate() {
        let (x0, y0) = (tile % tiles_x * TILE, tile / tiles_x * TILE);
        let columns = TILE.min(width - x0);
        for (row, y) in (y0..(y0 + TILE).min(height)).enumerate() {
            for column in 0..columns {
                let at = y * width + x0 + column;
                (image.pixels[at], coverage[at]) = pixels[row * TILE + column];
            }
        }
    }
    let mask = coverage.iter().map(|share| *share == 1.0).collect();
    Ok(Frame { image, coverage, mask })
}

/// Every object has light for the points that its mesh names.
pub(super) fn check_light(scene: &DrawScene) -> Result<(), RuntimeError> {
    for object in scene.objects {
        let needed = object.mesh.n_points();
        let short = |len: usize, may_lack: bool| len < needed && !(may_lack && len == 0);
        if short(object.irradiance.len(), false)
            || short(object.lune.len(), true)
            || short(object.glossy.len(), true)
            || short(object.coat.len(), true)
            || short(object.share.len(), true)
            || object.between.is_some_and(|between| short(between.n_points(), false))
            || short(object.point_flags.len(), true)
        {
            let what = format!("light for {} points, its mesh names {needed}", object.irradiance.len());
            return Err(RuntimeError::Chunk { kind: "mesh", digest: String::new(), what });
        }
    }
    Ok(())
}

/// A triangle, gathered once for its fragments.
pub(super) struct Gathered<'a> {
    id: u32,
    pub(super) edges: Edges,
    pub(super) corners: [usize; 3],
    pub(super) mesh: &'a Mesh<'a>,
    object: &'a DrawObject<'a>,
    /// Points that light the visible side; `None` for corners that leave the interpolation.
    pub(super) points: [Shares; 3],
    material: Option<&'a Material>,
    /// Texels along u and v of the largest texture, [0, 0] without textures.
    texels: [f32; 2],
    tangent_from_uv: Option<[f32; 4]>,
}

impl Gathered<'_> {
    /// The points of the corners, where none of those that light the triangle is a blend; a corner without light stands in with another's.
    fn single_points(&self) -> Option<[usize; 3]> {
        let any = self.points.iter().find(|shares| shares.n > 0)?.points[0];
        let is_single = self.points.iter().all(|shares| shares.n < 2);
        is_single.then(|| std::array::from_fn(|k| if self.points[k].n > 0 { self.points[k].points[0] } else { any } as usize))
    }
}

pub(super) struct Shader<'a> {
    pub(super) scene: &'a DrawScene<'a>,
    pub(super) visibility: &'a Visibility,
    pub(super) origin: [usize; 2],
}

impl<'a> Shader<'a> {
    /// Colour and coverage of each pixel of the tile, `[TILE · TILE]`.
    fn tile(&self, fragments: &TileFragments) -> Vec<([f32; 3], f32)> {
        let n = self.visibility.pattern.len();
        let all = u64::MAX >> (64 - n);
        let mut pixels = vec![([0.0; 3], 0.0); TILE * TILE];
        let (mut solid, mut blend) = (fragments.solid.as_slice(), fragments.blend.as_slice());
        let mut gathered = None;
        for pixel in 0..TILE * TILE {
            let (x, y) = (self.origin[0] + pixel % TILE, self.origin[1] + pixel / TILE);
            let solid_here = take_pixel(&mut solid, pixel);
            let blend_here = take_pixel(&mut blend, pixel);
            if x >= self.visibility.width || y >= self.visibility.height {
                continue;
            }
            let covered = solid_here.iter().fold(0, |set, fragment| set | fragment.samples);
            if blend_here.is_empty() {
                let mut sum = [0.0f32; 3];
                for fragment in solid_here {
                    add(&mut sum, self.fragment(fragment, [x, y], &mut gathered).0, fragment.samples.count_ones() as f32);
                }
                self.background(all & !covered, [x, y], |samples, color| add(&mut sum, color, samples.count_ones() as f32));
                pixels[pixel] = (sum.map(|v| shown(v / n as f32)), covered.count_ones() as f32 / n as f32);
                continue;
            }
            // Samples one by one: each has its own stack.
            let mut colors = [[0.0f32; 3]; 64];
            let mut set = |samples: u64, color: [f32; 3]| bits(samples).for_each(|s| colors[s] = color);
            self.background(all & !covered, [x, y], &mut set);
            for fragment in solid_here {
                set(fragment.samples, self.fragment(fragment, [x, y], &mut gathered).0);
            }
            let mut drawn = covered;
            for fragment in blend_here {
                let (color, alpha) = self.fragment(fragment, [x, y], &mut gathered);
                if alpha > 0.0 {
                    drawn |= fragment.samples;
                }
                for s in bits(fragment.samples) {
                    colors[s] = std::array::from_fn(|k| colors[s][k] + (color[k] - colors[s][k]) * alpha);
                }
            }
            let mut sum = [0.0; 3];
            colors[..n].iter().for_each(|color| add(&mut sum, *color, 1.0));
            pixels[pixel] = (sum.map(|v| shown(v / n as f32)), drawn.count_ones() as f32 / n as f32);
        }
        pixels
    }

    /// Looks the background up for the samples of each quarter of the pixel.
    fn background(&self, samples: u64, pixel: [usize; 2], mut f: impl FnMut(u64, [f32; 3])) {
        if samples == 0 {
            return;
        }
        let n = self.visibility.pattern.len();
        let groups = if n.is_multiple_of(4) { 4 } else { 1 };
        let size = n / groups;
        for group in 0..groups {
            let set = samples & ((u64::MAX >> (64 - size)) << (group * size));
            if set != 0 {
                let [x, y] = self.centroid(set, pixel);
                f(set, (self.scene.background)(self.visibility.rays.direction(x as f32, y as f32)));
            }
        }
    }

    fn centroid(&self, samples: u64, pixel: [usize; 2]) -> [f64; 2] {
        let mut sum = [0.0; 2];
        for s in bits(samples) {
            (0..2).for_each(|k| sum[k] += f64::from(self.visibility.pattern[s][k]));
        }
        [0, 1].map(|k| pixel[k] as f64 + sum[k] / f64::from(samples.count_ones()))
    }

    /// Radiance and alpha of a fragment, means over its groups of samples.
    fn fragment(&self, fragment: &Fragment, pixel: [usize; 2], cache: &mut Option<Gathered<'a>>) -> ([f32; 3], f32) {
        if cache.as_ref().is_none_or(|gathered| gathered.id != fragment.triangle) {
            *cache = self.gather(fragment.triangle);
        }
        let Some(gathered) = cache else {
            return ([0.0; 3], 0.0);
        };
        let covered = fragment.samples.count_ones();
        let groups = self.groups(gathered, fragment.samples, pixel);
        if groups == 1 {
            let [x, y] = self.centroid(fragment.samples, pixel);
            return self.place(gathered, x, y);
        }
        let (mut color, mut alpha) = ([0.0; 3], 0.0);
        let mut rest = fragment.samples;
        for group in 0..groups {
            let size = covered * (group + 1) / groups - covered * group / groups;
            let mut set = 0;
            for _ in 0..size {
                set |= rest & rest.wrapping_neg();
                rest &= rest - 1;
            }
            let [x, y] = self.centroid(set, pixel);
            let (part, part_alpha) = self.place(gathered, x, y);
            // Weighted by alpha, so that the cut-out parts of a texture do not tint the rest.
            let share = size as f32 / covered as f32;
            add(&mut color, part, share * part_alpha);
            alpha += part_alpha * share;
        }
        if alpha > 0.0 { (color.map(|v| v / alpha), alpha) } else { ([0.0; 3], 0.0) }
    }

    /// Texels that the fragment covers, 1..=its samples.
    fn groups(&self, gathered: &Gathered, samples: u64, pixel: [usize; 2]) -> u32 {
        let covered = samples.count_ones();
        if covered == 1 || gathered.texels[0] == 0.0 || gathered.mesh.uv0.is_empty() {
            return 1;
        }
        let gradients = gathered.edges.weight_gradients(pixel[0] as f64 + 0.5, pixel[1] as f64 + 0.5);
        let uvs = gathered.corners.map(|v| gathered.mesh.uv0[v]);
        // The longer axis of the footprint decides: a stretched footprint needs its samples along one direction.
        let reach = |gradient: [f32; 3]| {
            let [u, v] = blend_corners(gradient, uvs);
            (u.abs() * gathered.texels[0]).max(v.abs() * gathered.texels[1])
        };
        let texels = reach(gradients[0]).max(1.0) * reach(gradients[1]).max(1.0) * covered as f32 / self.visibility.pattern.len() as f32;
        // NaN counts as one.
        (texels.ceil() as u32).clamp(1, covered)
    }

    pub(super) fn gather(&self, id: u32) -> Option<Gathered<'a>> {
        let (object, triangle) = self.visibility.locate(id);
        let object = &self.scene.objects[object];
        let mesh = &object.mesh;
        let corners = mesh.triangles[triangle].map(|v| v as usize);
        let edges = Edges::new(corners.map(|v| self.visibility.rays.homogeneous(mesh.position[v])))?;
        let usable = |v: usize| {
            let lit = if edges.front { mesh.front(v) } else { mesh.back(v) };
            let buried = |point: u32| object.point_flags.get(point as usize).is_some_and(|flags| flags & BURIED != 0);
            Shares::new(lit, buried)
        };
        let material = self.scene.materials.get(mesh.material[triangle] as usize);
        let mut gathered =
            Gathered { id, edges, corners, mesh, object, points: corners.map(usable), material, texels: [0.0; 2], tangent_from_uv: None };
        if let Some(material) = material.filter(|_| !self.scene.clay) {
            for reference in material.textures() {
                let Some(texture) = self.scene.textures.get(reference.texture as usize) else { continue };
                let texels = reference.texels(texture.width, texture.height);
                gathered.texels = [0, 1].map(|k| gathered.texels[k].max(texels[k]));
            }
            let mapped = material.normal_texture.or(material.clearcoat_normal_texture).or(material.anisotropy_texture);
            if mesh.tangent.is_empty() && (mapped.is_some() || material.is_anisotropic()) {
                let set = mapped.map_or(0, |reference| reference.uv_set);
                let uvs = corners.map(|v| coordinates(mesh, set, v));
                let uvs = uvs.map(|uv| mapped.map_or(uv, |reference| reference.place(uv)));
                gathered.tangent_from_uv = tangent_from_uv(corners.map(|v| mesh.position[v]), uvs);
            }
        }
        Some(gathered)
    }

    /// Radiance and alpha at pixel coordinates.
    fn place(&self, gathered: &Gathered, x: f64, y: f64) -> ([f32; 3], f32) {
        let weights = gathered.edges.weights(x, y);
        self.place_at(gathered, weights, weights, self.visibility.rays.direction(x as f32, y as f32))
    }

    /// Radiance and alpha where the corners weigh `weights`, seen along the unit direction `view`, in the light that the corners'
    /// points give by `light_weights`.
    pub(super) fn place_at(&self, gathered: &Gathered, weights: [f32; 3], light_weights: [f32; 3], view: [f32; 3]) -> ([f32; 3], f32) {
        let Gathered { mesh, corners, .. } = gathered;
        let uv = |uvs: &[[f32; 2]]| if uvs.is_empty() { [0.0; 2] } else { blend_corners(weights, corners.map(|v| uvs[v])) };
        let color = if mesh.color.is_empty() { [1.0; 4] } else { blend_corners(weights, corners.map(|v| mesh.color[v])) };
        let surface = match gathered.material {
            Some(material) => resolve(material, self.scene.textures, uv(mesh.uv0), uv(mesh.uv1), color),
            None => resolve(&Material { metallic: 0.0, ..Material::default() }, &[], [0.0; 2], [0.0; 2], [1.0; 4]),
        };
        if surface.unlit && !self.scene.clay {
            return (surface.emissive, surface.alpha);
        }
        let side = if gathered.edges.front { 1.0 } else { -1.0 };
        let front_normal = self.front_normal(gathered, weights);
        if self.scene.clay {
            let normal = front_normal.map(|v| v * side);
            let light = self.light(gathered, light_weights, &Bend::new(normal, normal), view, None);
            return (light.received.map(|e| e * (CLAY_ALBEDO / PI)), surface.alpha);
        }
        let tangent = match gathered.tangent_from_uv {
            None if mesh.tangent.is_empty() => [0.0; 4],
            None => {
                let sum = blend_corners(weights, corners.map(|v| mesh.tangent[v]));
                [sum[0], sum[1], sum[2], mesh.tangent[corners[0]][3]]
            }
            Some(tangent) => tangent,
        };
        let bend = |bent: Option<[f32; 3]>| bent.map_or(front_normal, |bent| bend_normal(bent, front_normal, tangent));
        let place = surface.place(bend(surface.normal_tangent), bend(surface.coat_normal_tangent), tangent, side);
        let toward = view.map(|v| -v);
        let is_textured = |m: &Material| m.normal_texture.is_some() || m.metallic_roughness_texture.is_some();
        let own = gathered.material.is_some_and(is_textured).then(|| {
            let lobe = surface.surface(self.scene.tables).lobe;
            PointLobe { lobe, normal: place.normal, tangent: place.tangent }
        });
        let bend = Bend::new(front_normal.map(|v| v * side), place.normal);
        let light = self.light(gathered, light_weights, &bend, view, own.as_ref());
        (radiance(&surface, &place, toward, self.scene.tables, &light), surface.alpha)
    }

    /// Unit shading normal of the front.
    fn front_normal(&self, gathered: &Gathered, weights: [f32; 3]) -> [f32; 3] {
        let mesh = gathered.mesh;
        let unit = |v: [f32; 3]| {
            let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
            (length > f32::MIN_POSITIVE && length.is_finite()).then(|| v.map(|x| x / length))
        };
        unit(blend_corners(weights, gathered.corners.map(|v| mesh.normal[v]))).unwrap_or_else(|| {
            let [a, b, c] = gathered.corners.map(|v| mesh.position[v]);
            let (p, q): ([f32; 3], [f32; 3]) = (std::array::from_fn(|k| b[k] - a[k]), std::array::from_fn(|k| c[k] - a[k]));
            unit([p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]).unwrap_or([0.0, 1.0, 0.0])
        })
    }

    /// Light from the corners that have a usable point, on a surface with this normal, seen along the unit direction `view`; `own`: what textures
    /// make of the place.
    fn light(&self, gathered: &Gathered, weights: [f32; 3], bend: &Bend, view: [f32; 3], own: Option<&PointLobe>) -> PointLight {
        let (mut light, mut left_glossy) = (PointLight::default(), [0.0f32; 3]);
        let usable = |k: &usize| gathered.points[*k].n > 0;
        let sum: f32 = (0..3).filter(usable).map(|k| weights[k]).sum();
        let count = (0..3).filter(usable).count();
        // At a corner that has no point the others may weigh nothing: they share equally there.
        let weight_of = |k: usize| if sum > 1e-6 { weights[k] / sum } else { 1.0 / count as f32 };
        for k in (0..3).filter(usable) {
            for (point, share) in gathered.points[k].iter() {
                let weight = weight_of(k) * share;
                let e = gathered.object.irradiance[point];
                let lune = gathered.object.lune.get(point).copied().unwrap_or_default();
                let left = gathered.object.share.get(point).unwrap_or(&Share::ALL);
                let received = lune.irradiance(&e, bend);
                add(&mut light.received, std::array::from_fn(|k| received[k] * left.diffuse[k]), weight);
                add(&mut left_glossy, left.glossy, weight);
                if let Some(g) = gathered.object.glossy.get(point) {
                    (0..2).for_each(|term| add(&mut light.glossy[term], g[term], weight));
                }
                if let Some(coat) = gathered.object.coat.get(point) {
                    add(&mut light.coat, std::array::from_fn(|k| coat[k] * left.glossy[k]), weight);
                }
            }
        }
        if let Some(between) = gathered.object.between
            && let Some(points) = gathered.single_points()
        {
            let weights = std::array::from_fn(|k| if usable(&k) { weight_of(k) } else { 0.0 });
            between.correct(points, weights, view.map(|v| -v), own, &mut light.glossy);
        }
        if !gathered.object.share.is_empty() {
            light.glossy.iter_mut().for_each(|term| (0..3).for_each(|k| term[k] *= left_glossy[k].min(1.0)));
        }
        light
    }
}

/// Points that light a corner, buried ones left out: the weights of the others grow to sum 1.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Shares {
    points: [u32; 4],
    weights: [f32; 4],
    /// How many of them there are; 0: the corner has no light of its own.
    pub n: usize,
}

impl Shares {
    fn new(lit: Lit, buried: impl Fn(u32) -> bool) -> Self {
        let mut shares = Shares::default();
        let mut sum = 0.0;
        for (point, weight) in lit.shares().filter(|(point, weight)| *weight > 0.0 && !buried(*point)) {
            (shares.points[shares.n], shares.weights[shares.n]) = (point, weight);
            (shares.n, sum) = (shares.n + 1, sum + weight);
        }
        if shares.n > 0 && sum < 1.0 {
            shares.weights.iter_mut().for_each(|weight| *weight /= sum);
        }
        shares
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = (usize, f32)> {
        self.points.into_iter().map(|point| point as usize).zip(self.weights).take(self.n)
    }
}

/// Light at a place of a surface, before its material.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PointLight {
    /// Irradiance per channel, W·m⁻².
    pub received: [f32; 3],
    /// `[term][channel]` glossy radiance.
    pub glossy: [[f32; 3]; 2],
    /// Radiance of a whole clear coat.
    pub coat: [f32; 3],
}

/// Radiance toward the unit `view` of a surface in this light.
pub(crate) fn radiance(surface: &SurfaceSample, place: &Place, view: [f32; 3], tables: &[Measured], light: &PointLight) -> [f32; 3] {
    let reflected = surface.surface(tables).relit(place, view, light.received, light.glossy, light.coat);
    std::array::from_fn(|k| surface.emissive[k] + reflected[k])
}

fn coordinates(mesh: &Mesh, set: u32, vertex: usize) -> [f32; 2] {
    let set = if set == 1 { mesh.uv1 } else { mesh.uv0 };
    set.get(vertex).copied().unwrap_or([0.0; 2])
}

/// A pixel's value, finite whatever light and surfaces multiplied to: not a number is black.
fn shown(value: f32) -> f32 {
    if value.is_nan() { 0.0 } else { value.clamp(f32::MIN, f32::MAX) }
}

/// Splits off the fragments of `pixel` from the front of a list that is sorted by pixel.
pub(super) fn take_pixel<'f>(list: &mut &'f [Fragment], pixel: usize) -> &'f [Fragment] {
    let count = list.iter().take_while(|fragment| usize::from(fragment.pixel) == pixel).count();
    let (taken, rest) = list.split_at(count);
    *list = rest;
    taken
}

fn bits(mut set: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        (set != 0).then(|| {
            let bit = set.trailing_zeros() as usize;
            set &= set - 1;
            bit
        })
    })
}

fn add(sum: &mut [f32; 3], value: [f32; 3], weight: f32) {
    (0..3).for_each(|k| sum[k] += value[k] * weight);
}
