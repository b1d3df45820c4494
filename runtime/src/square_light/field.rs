//! The field of an occluder: how much of any square of directions it blocks, seen from any place around it. In its own space, from its
//! mesh alone.
//!
//! ```text
//! centre, r    a sphere around what blocks
//! places       shells at distance r·radii[k], on each 6 faces x (m + 1)² nodes; node (i, j) at face coordinates tan(π/4 (2i/m − 1)), equal angles
//! frame        z from the place to the centre; x the face's u axis made orthogonal to z; y = z × x
//! map          square p ∈ [−w, w]² of the disc (sphere::disc) around z; outside of the sphere's cone
//!              w(d) = √(1 − √(1 − (r/d)²)), the edge of the cone, for d ≥ 1.03 r; √2, the whole sphere, nearer
//! chunk        "PLOC" 1: counts shells, m, res; sphere [4] f32 (centre, r); radii [shells] f32; coverage [shells, 6, m + 1, m + 1, res, res] u8
//! ```
//!
//! Maps of the eight places around a point are blended in *its own* frame and its own cone: the object's centre stays put, silhouettes of
//! shells
//! coincide, and beyond the last shell the cone shrinks as it should. Lossy: silhouettes between places are blends. Source: \[XJHT06\]
//! section 6.3, with
//! cones for hemispheres.

use super::summed_area;
use crate::chunk::layout::{Reader, Writer};
use crate::error::RuntimeError;
use crate::sphere::cubemap::{face_axes, face_from_direction};
use crate::sphere::disc::{WHOLE, disc_from_direction};
use crate::sphere::frame::dot;
use std::f64::consts::FRAC_PI_4;

const MAGIC: &[u8; 4] = b"PLOC";
const VERSION: u32 = 1;
/// From here on out, in radii, maps are cones.
const CONE_FROM: f64 = 1.03;
/// Shells, nodes along a face and texels along a map that a chunk may have.
pub const CHUNK_LIMITS: [u32; 3] = [32, 64, 128];

/// Distances of the shells, in radii: a place inside the sphere sees the object all around.
pub const RADII: [f32; 11] = [0.4, 0.6, 0.8, 1.03, 1.25, 1.55, 2.0, 2.6, 3.5, 4.7, 6.5];

/// The arrays of a field, borrowed from its chunk.
#[derive(Clone, Copy, Debug)]
pub struct FieldChunk<'a> {
    /// Steps along a face.
    pub m: usize,
    /// Texels along a map.
    pub res: usize,
    /// Middle of what blocks, own space.
    pub centre: [f32; 3],
    /// Nothing that blocks is farther from it, metres.
    pub radius: f32,
    /// Distances of shells, in radii, increasing.
    pub radii: &'a [f32],
    /// `[shells][6][m + 1][m + 1][res][res]`, 255: all of the texel is blocked.
    pub coverage: &'a [u8],
}

/// Unit direction from the centre to a node.
pub fn node(face: usize, m: usize, i: usize, j: usize) -> [f64; 3] {
    let (main, u, v, sign) = face_axes(face);
    let angle = |i: usize| libm::tan(FRAC_PI_4 * (2.0 * i as f64 / m as f64 - 1.0));
    let mut d = [0.0; 3];
    (d[main], d[u], d[v]) = (f64::from(sign), angle(i), angle(j));
    let length = dot(d, d).sqrt();
    d.map(|x| x / length)
}

/// Axes x, y, z of the map at a place in the unit direction `outward` from the centre, on a face.
pub fn frame(face: usize, outward: [f64; 3]) -> [[f64; 3]; 3] {
    let u = face_axes(face).1;
    let z = outward.map(|x| -x);
    let mut x = [0.0; 3];
    x[u] = 1.0;
    let along = z[u];
    let x: [f64; 3] = std::array::from_fn(|k| x[k] - along * z[k]);
    let length = dot(x, x).sqrt();
    let x = x.map(|c| c / length);
    [x, [z[1] * x[2] - z[2] * x[1], z[2] * x[0] - z[0] * x[2], z[0] * x[1] - z[1] * x[0]], z]
}

/// Half the side of the map at a distance, in radii.
pub fn width(distance: f64) -> f64 {
    if distance < CONE_FROM {
        return std::f64::consts::SQRT_2;
    }
    let sine = 1.0 / distance;
    // 1 − √(1 − s²) without its loss for small s.
    (sine * sine / (1.0 + (1.0 - sine * sine).sqrt())).sqrt()
}

impl<'a> FieldChunk<'a> {
    /// The chunk's bytes.
    pub fn to_chunk(&self) -> Vec<u8> {
        let counts = [self.radii.len() as u32, self.m as u32, self.res as u32, 0, 0, 0];
        let [x, y, z] = self.centre;
        Writer::new(MAGIC, VERSION, counts).array(&[x, y, z, self.radius]).array(self.radii).array(self.coverage).finish()
    }

    /// Borrows from a chunk and proves it.
    ///
    /// # Errors
    /// What does not hold.
    pub fn from_chunk(bytes: &'a [u8]) -> Result<Self, RuntimeError> {
        let mut reader = Reader::new("field", MAGIC, VERSION, bytes)?;
        let [shells, m, res, ..] = reader.counts;
        if [shells, m, res].into_iter().zip(CHUNK_LIMITS).any(|(count, most)| !(1..=most).contains(&count)) || res < 4 {
            return Err(reader.error("a field has 1..=32 shells, 1..=64 steps and maps of 4..=128 texels"));
        }
        let [shells, m, res] = [shells, m, res].map(|count| count as usize);
        let sphere: &[f32] = reader.array(4)?;
        let radii: &[f32] = reader.array(shells)?;
        let coverage = reader.array(shells * 6 * (m + 1) * (m + 1) * res * res)?;
        if !(sphere.iter().all(|x| x.is_finite()) && sphere[3] > 0.0) {
            return Err(reader.error("its sphere is not finite, or of no size"));
        }
        if radii.iter().any(|d| !(0.01..=1e6).contains(d)) || radii.windows(2).any(|pair| pair[0] >= pair[1]) {
            return Err(reader.error("its shells do not increase"));
        }
        reader.finish()?;
        Ok(FieldChunk { m, res, centre: [sphere[0], sphere[1], sphere[2]], radius: sphere[3], radii, coverage })
    }
}

/// A field ready to be asked: summed areas of every map, four bytes a corner.
#[derive(Clone, Debug)]
pub struct Field {
    m: usize,
    res: usize,
    centre: [f32; 3],
    radius: f32,
    /// Logarithms of the shells' distances.
    shells: Vec<f32>,
    /// Half the side of each shell's maps.
    widths: Vec<f32>,
    /// `[maps][(res + 1)²]`
    sums: Vec<u32>,
}

/// A place in a field: found once, asked for many squares.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Rows: the axes of the frame.
    frame: [[f32; 3]; 3],
    /// First sums of the maps around, and what they weigh.
    maps: [(u32, f32); 8],
    /// Half the side of the maps of the nearer and of the farther shell, as seen from here.
    widths: [f32; 2],
    /// Edge of the cone beyond which nothing blocks; more than the whole sphere inside of it.
    edge: f32,
}

impl Field {
    /// Makes the summed areas.
    pub fn open(chunk: &FieldChunk) -> Field {
        let FieldChunk { m, res, centre, radius, radii, coverage } = *chunk;
        let texels = res * res;
        let mut sums = vec![0; coverage.len() / texels * (res + 1) * (res + 1)];
        for (map, sums) in coverage.chunks_exact(texels).zip(sums.chunks_exact_mut((res + 1) * (res + 1))) {
            summed_area::fill(res, |i| u32::from(map[i]), sums);
        }
        let widths = radii.iter().map(|d| width(f64::from(*d)) as f32).collect();
        Field { m, res, centre, radius, shells: radii.iter().map(|d| d.ln()).collect(), widths, sums }
    }

    /// Middle of what blocks, own space.
    pub fn centre(&self) -> [f32; 3] {
        self.centre
    }

    /// Nothing that blocks is farther from the centre, metres.
    pub fn radius(&self) -> f32 {
        self.radius
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> usize {
        4 * self.sums.len()
    }

    /// A place in own space.
    pub fn at(&self, place: [f32; 3]) -> Place {
        let e: [f64; 3] = std::array::from_fn(|k| f64::from(place[k]) - f64::from(self.centre[k]));
        let length = dot(e, e).sqrt();
        let outward = if length > 1e-12 { e.map(|x| x / length) } else { [1.0, 0.0, 0.0] };
        let distance = length / f64::from(self.radius);
        let (face, s, t) = face_from_direction(outward);
        // Equal angles.
        let along = |s: f64| {
            let at = (s.atan() / FRAC_PI_4 + 1.0) * 0.5 * self.m as f64;
            let cell = (at.max(0.0) as usize).min(self.m - 1);
            (cell, (at - cell as f64).clamp(0.0, 1.0) as f32)
        };
        let [(i, a), (j, b)] = [along(s), along(t)];
        let last = self.shells.len() - 1;
        let log = (distance.max(1e-9) as f32).ln();
        let shell = self.shells.partition_point(|own| *own <= log).saturating_sub(1).min(last.saturating_sub(1));
        let next = (shell + 1).min(last);
        let between = self.shells[next] - self.shells[shell];
        let c = if between > 0.0 { ((log - self.shells[shell]) / between).clamp(0.0, 1.0) } else { 0.0 };
        let corners = (self.res + 1) * (self.res + 1);
        let map = |shell: usize, i: usize, j: usize| ((((shell * 6 + face) * (self.m + 1) + j) * (self.m + 1) + i) * corners) as u32;
        let maps = std::array::from_fn(|k| {
            let (shell, weight) = if k < 4 { (shell, 1.0 - c) } else { (next, c) };
            let (di, dj) = (k & 1, k >> 1 & 1);
            let part = |f: f32, upper: usize| if upper == 1 { f } else { 1.0 - f };
            (map(shell, i + di, j + dj), weight * part(a, di) * part(b, dj))
        });
        // Cones are seen as they are from here; whole spheres are what they are.
        let own = width(distance) as f32;
        let is_out = distance >= CONE_FROM;
        let seen = |shell: usize| if is_out && self.widths[shell] < WHOLE { own } else { self.widths[shell] };
        let edge = if is_out { own } else { f32::INFINITY };
        Place { frame: frame(face, outward).map(|axis| axis.map(|x| x as f32)), maps, widths: [seen(shell), seen(next)], edge }
    }

    /// Part of a square that is blocked, 0..=1: `centre` its unit direction in own space, `half` half its side in the disc.
    #[inline]
    pub fn blocked(&self, place: &Place, centre: [f32; 3], half: f32) -> f32 {
        let z = dot(place.frame[2], centre);
        let reach = place.edge + std::f32::consts::SQRT_2 * half;
        // |p|² = 1 − z.
        if 1.0 - z > reach * reach {
            return 0.0;
        }
        let p = disc_from_direction([dot(place.frame[0], centre), dot(place.frame[1], centre), z]);
        let res = self.res as f32;
        let mut sum = 0.0;
        for (maps, width) in place.maps.as_chunks::<4>().0.iter().zip(place.widths) {
            if maps.iter().all(|(_, weight)| *weight == 0.0) {
                continue;
            }
            // From −w..w to texels; at least one texel of the map, so that small squares slide instead of stepping.
            let scale = 0.5 * res / width;
            let (half, at) = ((half * scale).max(0.5), p.map(|x| (x + width) * scale));
            let (low, high) = (at.map(|x| x - half), at.map(|x| x + half));
            if (0..2).any(|k| high[k] <= 0.0 || low[k] >= res) {
                continue;
            }
            let area = 4.0 * half * half * 255.0;
            for (first, weight) in maps.iter().filter(|(_, weight)| *weight > 0.0) {
                let corners = (self.res + 1) * (self.res + 1);
                let sums = &self.sums[*first as usize..][..corners];
                sum += weight * summed_area::rectangle(self.res, sums, low, high) / area;
            }
        }
        sum.clamp(0.0, 1.0)
    }
}
