//! Which triangle every sample of every pixel sees: the visibility buffer.
//!
//! Edges are planes through the eye. With corners a, b, c as homogeneous pixel coordinates ([`super::camera::CameraRays::homogeneous`])
//! and d = (x, y, 1) for a sample at (x, y):
//!
//! ```text
//! E_a = d · (b × c)   E_b = d · (c × a)   E_c = d · (a × b)   det = a · (b × c)
//! weights of the corners = E / ΣE, in world space, no perspective division;   1 / distance along the axis = ΣE / det
//! ```
//!
//! A sample is inside when the three have det's sign. That holds for triangles that pass behind the eye too, so nothing is clipped
//! (only the bounding box is). Two triangles that share an edge compute bit by bit opposite E, so a sample belongs to exactly one of them,
//! also on the edge: ties go by the sign of the edge's coefficients. Front faces have det < 0. (Olano and Greer 1997.)
//!
//! Tiles of 32 x 32 pixels are independent and each keeps its list of fragments, (pixel, triangle, set of samples), so the result
//! does not depend on threads. MASK cuts are tested per sample. BLEND fragments are kept beside, the nearest [`MAX_BLEND_LAYERS`] of a pixel.

use super::threads::map_indices;
use crate::camera::{Camera, CameraRays, cross};
use crate::chunk::mesh::Mesh;
use crate::error::RuntimeError;
use crate::sphere::frame::dot;
use crate::surface::{AlphaMode, Material, Texture, resolve_alpha};

/// Pixels along a tile's side.
pub(super) const TILE: usize = 32;
/// Most samples of a pixel: a set of samples is 64 bits.
pub(crate) const MAX_SAMPLES: usize = 64;
/// Most BLEND triangles that are drawn over each other in one pixel; farther ones are left out.
pub(crate) const MAX_BLEND_LAYERS: usize = 32;
/// Largest side of a drawn image.
pub(crate) const MAX_SIDE: usize = 16384;
/// Triangles whose box meets more tiles than this are looked at by every tile, so that bins stay small.
const LARGE_TILES: usize = 64;
/// Triangles of a job of binning.
const CHUNK: usize = 1 << 14;
const NO_TRIANGLE: u32 = u32::MAX;

/// A triangle in some samples of a pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fragment {
    /// Bit s is set where the triangle is what sample s sees.
    pub samples: u64,
    /// Triangle id, counted through all objects.
    pub triangle: u32,
    /// Pixel of the tile, `y · TILE + x`.
    pub pixel: u16,
}

/// What the samples of a tile see.
#[derive(Debug, Default)]
pub(super) struct TileFragments {
    /// Solid surfaces, by pixel; at most one per sample.
    pub solid: Vec<Fragment>,
    /// BLEND surfaces in front of them, by pixel, the farthest first.
    pub blend: Vec<Fragment>,
}

/// What every sample of an image sees. Light does not enter: one buffer serves all lights of a still camera.
#[derive(Debug)]
pub struct Visibility {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) pattern: Vec<[f32; 2]>,
    pub(super) rays: CameraRays,
    pub(super) tiles: Vec<TileFragments>,
    pub(super) object_start: Vec<u32>,
}

/// Fixed sample positions in a pixel, 0..1: the first `n` of the (0, 2)-sequence, so every split of the pixel into 16 equal boxes with
/// power-of-two sides holds one of 16 samples. One sample is the centre. For powers of two from 4 up, runs of n/4 lie in one quadrant each.
pub(crate) fn sample_pattern(n: usize) -> Vec<[f32; 2]> {
    let cells = n.max(1).next_power_of_two() as f32;
    let bits = cells.log2() as u32;
    let position = |i: u32| {
        // Van der Corput and Sobol's second dimension, as integers of `bits` bits.
        let (mut x, mut y, mut column) = (0u32, 0u32, 1u32 << 31);
        for k in 0..32 {
            if i >> k & 1 == 1 {
                x |= 1 << (31 - k);
                y ^= column;
            }
            column ^= column >> 1;
        }
        let scaled = |v: u32| (if bits == 0 { 0 } else { v >> (32 - bits) }) as f32 + 0.5;
        [scaled(x) / cells, scaled(y) / cells]
    };
    let mut pattern: Vec<[f32; 2]> = (0..n as u32).map(position).collect();
    pattern.sort_by_key(|p| (p[1] >= 0.5, p[0] >= 0.5));
    pattern
}

/// Edge planes of a triangle as the pixels see them, det's sign taken out.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edges {
    /// Coefficients (x, y, 1) of E_a, E_b, E_c: all at least 0 inside.
    pub planes: [[f64; 3]; 3],
    /// |det|.
    pub determinant: f64,
    /// The camera sees the front.
    pub front: bool,
}

impl Edges {
    /// `None` for triangles seen edge on, without area, or not finite.
    pub(crate) fn new([a, b, c]: [[f64; 3]; 3]) -> Option<Self> {
        let planes = [cross(b, c), cross(c, a), cross(a, b)];
        let determinant = dot(a, planes[0]);
        let front = determinant < 0.0;
        let planes = if front { planes.map(|plane| plane.map(|v| -v)) } else { planes };
        (determinant != 0.0 && determinant.is_finite()).then_some(Edges { planes, determinant: determinant.abs(), front })
    }

    /// Weights of the corners at pixel coordinates, clamped into the triangle (an end of a rounded edge may lie outside by 1e-7).
    pub(crate) fn weights(&self, x: f64, y: f64) -> [f32; 3] {
        let e = self.planes.map(|[a, b, c]| (c + a * x + b * y).max(0.0));
        let sum = e[0] + e[1] + e[2];
        if sum > 0.0 { e.map(|v| (v / sum) as f32) } else { [1.0 / 3.0; 3] }
    }

    /// Derivatives of the weights by x and by y.
    pub(crate) fn weight_gradients(&self, x: f64, y: f64) -> [[f32; 3]; 2] {
        let e = self.planes.map(|[a, b, c]| c + a * x + b * y);
        let sum = e[0] + e[1] + e[2];
        [0, 1].map(|axis| {
            let d = self.planes.map(|plane| plane[axis]);
            let d_sum = d[0] + d[1] + d[2];
            std::array::from_fn(|k| ((d[k] - e[k] / sum * d_sum) / sum) as f32)
        })
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Class {
    Solid,
    Mask(f32),
    Blend,
}

struct Rasteriser<'a> {
    meshes: &'a [Mesh<'a>],
    materials: &'a [Material],
    textures: &'a [Texture<'a>],
    classes: Vec<(Class, bool)>,
    object_start: Vec<u32>,
    homogeneous: Vec<Vec<[f64; 3]>>,
    width: usize,
    height: usize,
    pattern: Vec<[f32; 2]>,
    /// The samples' places in a pixel along x and along y, ascending.
    places: [Vec<f64>; 2],
}

/// Arrays of a triangle's samples, kept between triangles.
struct Scratch {
    /// Offsets of the three edges and of 1/z, at each sample relative to its pixel.
    offsets: [[f32; MAX_SAMPLES]; 4],
    inverse_z: [f32; MAX_SAMPLES],
}

impl Scratch {
    const NEW: Scratch = Scratch { offsets: [[0.0; MAX_SAMPLES]; 4], inverse_z: [0.0; MAX_SAMPLES] };
}

impl Visibility {
    /// Rasterises. `samples` is clamped to 1..=[`MAX_SAMPLES`].
    ///
    /// # Errors
    /// When the camera is not usable, a side is 0 or above [`MAX_SIDE`], or there are 2³² triangles.
    pub fn new(
        meshes: &[Mesh],
        materials: &[Material],
        textures: &[Texture],
        camera: &Camera,
        [width, height]: [usize; 2],
        samples: usize,
    ) -> Result<Self, RuntimeError> {
        let rays = CameraRays::new(camera, width, height)?;
        if width > MAX_SIDE || height > MAX_SIDE {
            return Err(RuntimeError::Camera { what: format!("image size {width}x{height}, at most {MAX_SIDE} a side") });
        }
        let mut object_start = vec![0u32];
        for mesh in meshes {
            let end = u64::from(object_start[object_start.len() - 1]) + mesh.triangles.len() as u64;
            let end = u32::try_from(end).ok().filter(|end| *end < NO_TRIANGLE);
            object_start.push(end.ok_or_else(|| RuntimeError::Camera { what: "more than 2^32 triangles to draw".to_string() })?);
        }
        let class = |material: &Material| {
            let class = match material.alpha_mode {
                AlphaMode::Opaque => Class::Solid,
                AlphaMode::Mask { cutoff } => Class::Mask(cutoff),
                AlphaMode::Blend => Class::Blend,
            };
            (class, material.double_sided)
        };
        let pattern = sample_pattern(samples.clamp(1, MAX_SAMPLES));
        let places = [0, 1].map(|axis: usize| {
            let mut places: Vec<f64> = pattern.iter().map(|p| f64::from(p[axis])).collect();
            places.sort_by(f64::total_cmp);
            places
        });
        let rasteriser = Rasteriser {
            meshes,
            materials,
            textures,
            classes: materials.iter().map(class).collect(),
            homogeneous: map_indices(meshes.len(), |o| meshes[o].position.iter().map(|p| rays.homogeneous(*p)).collect()),
            object_start,
            width,
            height,
            pattern,
            places,
        };
        let bins = rasteriser.bins();
        let tiles = map_indices(rasteriser.tiles_x() * rasteriser.tiles_y(), |tile| rasteriser.tile(tile, &bins));
        Ok(Visibility { width, height, pattern: rasteriser.pattern, rays, tiles, object_start: rasteriser.object_start })
    }

    /// Object and triangle of it.
    pub(super) fn locate(&self, triangle: u32) -> (usize, usize) {
        locate(&self.object_start, triangle)
    }

    /// Whether the camera sees each point, in the sense that drawing interpolates from it: `[object][point]`.
    ///
    /// `n_points` are the objects' numbers of points. Shading only these gives the same image as shading all.
    ///
    /// # Panics
    /// When `meshes` are not those of [`Visibility::new`] or `n_points` is shorter.
    pub fn visible_points(&self, meshes: &[Mesh], n_points: &[usize]) -> Vec<Vec<bool>> {
        let mut visible: Vec<Vec<bool>> = n_points.iter().map(|n| vec![false; *n]).collect();
        let mut last = NO_TRIANGLE;
        for fragment in self.tiles.iter().flat_map(|tile| tile.solid.iter().chain(&tile.blend)) {
            if fragment.triangle == last {
                continue;
            }
            last = fragment.triangle;
            let (object, triangle) = self.locate(last);
            let mesh = &meshes[object];
            let corners = mesh.triangles[triangle];
            let edges = Edges::new(corners.map(|v| self.rays.homogeneous(mesh.position[v as usize])));
            let front = edges.is_some_and(|edges| edges.front);
            for v in corners.map(|v| v as usize) {
                let lit = if front { mesh.front(v) } else { mesh.back(v) };
                lit.shares().for_each(|(point, _)| visible[object][point as usize] = true);
            }
        }
        visible
    }
}

fn locate(object_start: &[u32], triangle: u32) -> (usize, usize) {
    let object = object_start.partition_point(|start| *start <= triangle) - 1;
    (object, (triangle - object_start[object]) as usize)
}

struct Bins {
    /// `[tiles + 1]` where each tile's triangles start.
    start: Vec<u32>,
    triangles: Vec<u32>,
    large: Vec<(u32, PixelBox)>,
}

/// Inclusive pixel ranges.
type PixelBox = [usize; 4];

impl Rasteriser<'_> {
    fn tiles_x(&self) -> usize {
        self.width.div_ceil(TILE)
    }

    fn tiles_y(&self) -> usize {
        self.height.div_ceil(TILE)
    }

    fn corners(&self, object: usize, triangle: usize) -> [[f64; 3]; 3] {
        self.meshes[object].triangles[triangle].map(|v| self.homogeneous[object][v as usize])
    }

    fn class(&self, object: usize, triangle: usize) -> (Class, bool) {
        let material = self.meshes[object].material[triangle] as usize;
        self.classes.get(material).copied().unwrap_or((Class::Solid, true))
    }

    /// Pixels of which the triangle may cover samples; `None` when there are none, or it is culled.
    fn pixel_box(&self, corners: [[f64; 3]; 3], double_sided: bool) -> Option<PixelBox> {
        // A box is cheaper than a determinant, and most triangles that are out of view are far out of it.
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        let mut include = |p: [f64; 3]| {
            for k in 0..2 {
                low[k] = low[k].min(p[k] / p[2]);
                high[k] = high[k].max(p[k] / p[2]);
            }
        };
        let farthest = corners[0][2].max(corners[1][2]).max(corners[2][2]);
        // What lies nearer than a millionth of the triangle's reach is at the eye itself: not worth a box over the whole image.
        let reach = corners.iter().fold(farthest, |m, p| m.max(-p[2]));
        let near = reach * 1e-6;
        let in_front = farthest > near;
        if !in_front {
            return None;
        }
        for k in 0..3 {
            let (p, q) = (corners[k], corners[(k + 1) % 3]);
            if p[2] >= near {
                include(p);
            }
            if (p[2] >= near) != (q[2] >= near) {
                let t = (near - p[2]) / (q[2] - p[2]);
                include([p[0] + (q[0] - p[0]) * t, p[1] + (q[1] - p[1]) * t, near]);
            }
        }
        // Rounding may put a covered sample a hair outside the box.
        const MARGIN: f64 = 0.01;
        let size = [self.width as f64, self.height as f64];
        let mut pixels = [0; 4];
        for k in 0..2 {
            let (first, last) = ((low[k] - MARGIN).max(0.0), high[k] + MARGIN);
            let in_view = first <= last && first < size[k];
            if !in_view {
                return None;
            }
            pixels[k] = first as usize;
            pixels[k + 2] = last.min(size[k] - 0.5) as usize;
            // Most triangles of a dense mesh lie between the samples.
            let passes = |pixel: usize| self.places[k].iter().any(|place| (first..=last).contains(&(pixel as f64 + place)));
            if pixels[k + 2] - pixels[k] < 2 && !passes(pixels[k]) && !passes(pixels[k + 2]) {
                return None;
            }
        }
        (double_sided || Edges::new(corners)?.front).then_some(pixels)
    }

    /// Triangles of each tile.
    fn bins(&self) -> Bins {
        let n_triangles = self.object_start[self.object_start.len() - 1] as usize;
        let (tiles_x, tiles_y) = (self.tiles_x(), self.tiles_y());
        let chunks = map_indices(n_triangles.div_ceil(CHUNK), |chunk| {
            let mut small = Vec::new();
            let mut large = Vec::new();
            for id in chunk * CHUNK..((chunk + 1) * CHUNK).min(n_triangles) {
                let (object, triangle) = locate(&self.object_start, id as u32);
                let (_, double_sided) = self.class(object, triangle);
                let Some(pixels) = self.pixel_box(self.corners(object, triangle), double_sided) else {
                    continue;
                };
                let [x0, y0, x1, y1] = pixels.map(|p| p / TILE);
                if (x1 - x0 + 1) * (y1 - y0 + 1) > LARGE_TILES {
                    large.push((id as u32, pixels));
                } else {
                    small.extend((y0..=y1).flat_map(|y| (x0..=x1).map(move |x| ((y * tiles_x + x) as u32, id as u32))));
                }
            }
            (small, large)
        });
        let mut start = vec![0u32; tiles_x * tiles_y + 1];
        for (tile, _) in chunks.iter().flat_map(|(small, _)| small) {
            start[*tile as usize + 1] += 1;
        }
        for tile in 0..tiles_x * tiles_y {
            start[tile + 1] += start[tile];
        }
        let mut triangles = vec![0; start[tiles_x * tiles_y] as usize];
        let mut next = start.clone();
        for (tile, id) in chunks.iter().flat_map(|(small, _)| small) {
            triangles[next[*tile as usize] as usize] = *id;
            next[*tile as usize] += 1;
        }
        Bins { start, triangles, large: chunks.into_iter().flat_map(|(_, large)| large).collect() }
    }

    fn tile(&self, tile: usize, bins: &Bins) -> TileFragments {
        let (x0, y0) = (tile % self.tiles_x() * TILE, tile / self.tiles_x() * TILE);
        let bounds = [x0, y0, (x0 + TILE).min(self.width) - 1, (y0 + TILE).min(self.height) - 1];
        let meets = |b: &PixelBox| b[0] <= bounds[2] && b[2] >= bounds[0] && b[1] <= bounds[3] && b[3] >= bounds[1];
        let large = bins.large.iter().filter(|(_, pixels)| meets(pixels)).map(|(id, _)| *id);
        let small = &bins.triangles[bins.start[tile] as usize..bins.start[tile + 1] as usize];
        let triangles: Vec<u32> = large.chain(small.iter().copied()).collect();
        if triangles.is_empty() {
            return TileFragments::default();
        }
        let n = self.pattern.len();
        let mut depth = TileDepth { inverse_z: vec![0.0; TILE * TILE * n], triangle: vec![NO_TRIANGLE; TILE * TILE * n] };
        let mut blend = Vec::new();
        let mut scratch = Scratch::NEW;
        for id in triangles {
            let (object, triangle) = locate(&self.object_start, id);
            if self.class(object, triangle).0 == Class::Blend {
                blend.push(id);
            } else {
                self.draw_solid(id, bounds, &mut depth, &mut scratch);
            }
        }
        let solid = self.fragments(&depth);
        let blend = if blend.is_empty() { Vec::new() } else { self.blend_fragments(&blend, bounds, &depth) };
        TileFragments { solid, blend }
    }

    fn draw_solid(&self, id: u32, bounds: PixelBox, depth: &mut TileDepth, scratch: &mut Scratch) {
        let (object, triangle) = locate(&self.object_start, id);
        let (class, double_sided) = self.class(object, triangle);
        let n = self.pattern.len();
        self.cover(id, bounds, double_sided, scratch, |x, y, mut samples, inverse_z| {
            if let Class::Mask(cutoff) = class {
                samples = self.cut(object, triangle, cutoff, x, y, samples);
            }
            let at = ((y - bounds[1]) * TILE + x - bounds[0]) * n;
            while samples != 0 {
                let s = samples.trailing_zeros() as usize;
                samples &= samples - 1;
                let value = inverse_z[s];
                let old = depth.inverse_z[at + s];
                // Equal depth: the smaller id, so that the order of the bins does not matter.
                if value > old || (value == old && value > 0.0 && id < depth.triangle[at + s]) {
                    depth.inverse_z[at + s] = value;
                    depth.triangle[at + s] = id;
                }
            }
        });
    }

    /// Samples whose alpha reaches the cutoff.
    fn cut(&self, object: usize, triangle: usize, cutoff: f32, x: usize, y: usize, samples: u64) -> u64 {
        let mesh = &self.meshes[object];
        let Some(edges) = Edges::new(self.corners(object, triangle)) else {
            return 0;
        };
        let Some(material) = self.materials.get(mesh.material[triangle] as usize) else {
            return samples;
        };
        let corners = mesh.triangles[triangle].map(|v| v as usize);
        let mut kept = 0;
        for s in (0..self.pattern.len()).filter(|s| samples >> s & 1 == 1) {
            let [ox, oy] = self.pattern[s].map(f64::from);
            let weights = edges.weights(x as f64 + ox, y as f64 + oy);
            let uv = |uvs: &[[f32; 2]]| if uvs.is_empty() { [0.0; 2] } else { blend_corners(weights, corners.map(|v| uvs[v])) };
            let alpha = if mesh.color.is_empty() { 1.0 } else { blend_corners(weights, corners.map(|v| mesh.color[v]))[3] };
            if resolve_alpha(material, self.textures, uv(mesh.uv0), uv(mesh.uv1), alpha) >= cutoff {
                kept |= 1 << s;
            }
        }
        kept
    }

    /// Calls `f(x, y, samples inside, 1/z of every sample)` for each pixel of the tile that the triangle covers in part.
    fn cover(
        &self,
        id: u32,
        bounds: PixelBox,
        double_sided: bool,
        Scratch { offsets, inverse_z }: &mut Scratch,
        mut f: impl FnMut(usize, usize, u64, &[f32; MAX_SAMPLES]),
    ) {
        let (object, triangle) = locate(&self.object_start, id);
        let corners = self.corners(object, triangle);
        let Some(pixels) = self.pixel_box(corners, double_sided) else {
            return;
        };
        let Some(edges) = Edges::new(corners) else {
            return;
        };
        let planes = edges.planes;
        // 1/z as a plane of its own: the sum of the rounded edges would lose bits on large triangles.
        let z_plane: [f64; 3] = std::array::from_fn(|k| (planes[0][k] + planes[1][k] + planes[2][k]) / edges.determinant);
        if !planes.iter().chain([&z_plane]).flatten().all(|v| (*v as f32).is_finite()) {
            return;
        }
        // On the edge itself: inside when the plane grows to the right, or down where it does not change to the right.
        let owns = planes.map(|[a, b, _]| a > 0.0 || (a == 0.0 && b > 0.0));
        let n = self.pattern.len();
        for (k, plane) in planes.iter().chain([&z_plane]).enumerate() {
            for (s, [ox, oy]) in self.pattern.iter().enumerate() {
                offsets[k][s] = (plane[0] * f64::from(*ox) + plane[1] * f64::from(*oy)) as f32;
            }
        }
        let value = |plane: &[f64; 3], x: usize, y: usize| plane[2] + plane[0] * x as f64 + plane[1] * y as f64;
        let largest = planes.map(|[a, b, _]| a.max(0.0) + b.max(0.0));
        for y in pixels[1].max(bounds[1])..=pixels[3].min(bounds[3]) {
            for x in pixels[0].max(bounds[0])..=pixels[2].min(bounds[2]) {
                let corner = [0, 1, 2].map(|k| value(&planes[k], x, y));
                if (0..3).any(|k| corner[k] + largest[k] < 0.0) {
                    continue;
                }
                let e = corner.map(|v| v as f32);
                let mut samples = 0u64;
                for s in 0..n {
                    let values = [e[0] + offsets[0][s], e[1] + offsets[1][s], e[2] + offsets[2][s]];
                    let inside = (0..3).all(|k| values[k] > 0.0 || (values[k] == 0.0 && owns[k]));
                    samples |= u64::from(inside) << s;
                }
                if samples != 0 {
                    let z = value(&z_plane, x, y) as f32;
                    for s in 0..n {
                        inverse_z[s] = z + offsets[3][s];
                    }
                    f(x, y, samples, inverse_z);
                }
            }
        }
    }

    /// The tile's samples as fragments.
    fn fragments(&self, depth: &TileDepth) -> Vec<Fragment> {
        let n = self.pattern.len();
        let mut fragments: Vec<Fragment> = Vec::new();
        for pixel in 0..TILE * TILE {
            let first = fragments.len();
            for (s, id) in depth.triangle[pixel * n..(pixel + 1) * n].iter().enumerate() {
                if *id == NO_TRIANGLE {
                    continue;
                }
                match fragments[first..].iter_mut().rev().find(|fragment| fragment.triangle == *id) {
                    Some(fragment) => fragment.samples |= 1 << s,
                    None => fragments.push(Fragment { samples: 1 << s, triangle: *id, pixel: pixel as u16 }),
                }
            }
        }
        fragments.shrink_to_fit();
        fragments
    }

    /// BLEND fragments in front of the solid ones, the nearest of each pixel, the farthest first.
    fn blend_fragments(&self, triangles: &[u32], bounds: PixelBox, depth: &TileDepth) -> Vec<Fragment> {
        let n = self.pattern.len();
        let mut layers: Vec<Vec<(f32, Fragment)>> = vec![Vec::new(); TILE * TILE];
        let mut scratch = Scratch::NEW;
        for id in triangles {
            let (object, triangle) = locate(&self.object_start, *id);
            let (_, double_sided) = self.class(object, triangle);
            self.cover(*id, bounds, double_sided, &mut scratch, |x, y, samples, inverse_z| {
                let pixel = (y - bounds[1]) * TILE + x - bounds[0];
                let seen = |s: &usize| samples >> s & 1 == 1 && inverse_z[*s] > depth.inverse_z[pixel * n + *s];
                let (mut set, mut sum) = (0u64, 0.0);
                for s in (0..n).filter(seen) {
                    set |= 1 << s;
                    sum += inverse_z[s];
                }
                if set == 0 {
                    return;
                }
                let nearness = sum / set.count_ones() as f32;
                let list = &mut layers[pixel];
                let at = list.partition_point(|(other, fragment)| (*other, fragment.triangle) < (nearness, *id));
                list.insert(at, (nearness, Fragment { samples: set, triangle: *id, pixel: pixel as u16 }));
                if list.len() > MAX_BLEND_LAYERS {
                    list.remove(0);
                }
            });
        }
        layers.into_iter().flatten().map(|(_, fragment)| fragment).collect()
    }
}

struct TileDepth {
    /// `[TILE · TILE, samples]` 1 / distance along the axis, 0 where nothing is.
    inverse_z: Vec<f32>,
    triangle: Vec<u32>,
}

/// Σ weight · corner value.
pub(super) fn blend_corners<const N: usize>(weights: [f32; 3], corners: [[f32; N]; 3]) -> [f32; N] {
    std::array::from_fn(|k| weights[0] * corners[0][k] + weights[1] * corners[1][k] + weights[2] * corners[2][k])
}
