//! Rows of a patch: what the rays of its points met, as bytes that the ledger keeps between rounds and bakes.
//!
//! Little-endian, in this order: version u32; n, t, g, rays u32; targets `[t, 16]` ([`super::targets::Identity`]); gather `[g]` u8; sources `[n, 8]`
//! u8; weights `[n, 8]` u8; then of the first [`FIRST`] rays of every point, and of the other rays of those that gather: targets u16, points u8,
//! distances u16.

use super::earlier::Earlier;
use super::gather::{Chooser, Gathering};
use super::options::BounceOptions;
use super::targets::{Identity, Met, Source, Targets, hash_of};
use crate::trace::sequence::Sequence;
use prelight_runtime::bounces::links::SOURCES;
use prelight_runtime::sphere::frame::tangents;
use std::collections::BTreeMap;

/// Rays that every point casts.
pub(super) const FIRST: usize = 32;
/// Marks a ray that ended at no point.
pub(super) const NOBODY: u16 = u16::MAX;
const VERSION: u32 = 2;
const SEED: u64 = 0x6c69_6e6b;
/// How far a point may see for Ward's rule, in edge lengths, at least and at most: 1 cm and 3 m at an edge of 5 cm.
const REACH: [f32; 2] = [0.2, 60.0];
/// Distance up to which a hit is close by, in edge lengths.
const CLOSE: f32 = 2.0;

/// What one ray met, in the numbers of its rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Ray {
    /// Number of the target patch; of the nearest corner's where the hit is black; [`NOBODY`] for sky and backs.
    pub target: u16,
    /// Point of that patch.
    pub point: u8,
    /// Distance, see [`Ray::distance`].
    far: u16,
}

/// The sign of the distance: the hit is black.
const BLACK: u16 = 1 << 15;

impl Ray {
    const NONE: Ray = Ray { target: NOBODY, point: 0, far: 0 };

    /// At least how far the hit is, at most 1/128 farther, in lengths of a unit direction; infinite for the sky.
    pub(super) fn distance(&self) -> f32 {
        f32::from_bits(u32::from(self.far & !BLACK) << 16)
    }

    /// Whether the hit sends nothing on although it is a front.
    pub(super) fn is_black(&self) -> bool {
        self.far & BLACK != 0
    }

    /// The point that the ray ended at.
    pub(super) fn hit(&self) -> Option<(u16, u8)> {
        (self.target != NOBODY && !self.is_black()).then_some((self.target, self.point))
    }

    /// What a histogram tells apart: quarters of target patches, of 64 points each; all that is no point is one.
    pub(super) fn bin(&self) -> u32 {
        self.hit().map_or(u32::MAX, |(target, point)| u32::from(target) << 2 | u32::from(point) >> 6)
    }
}

/// The upper half of a float's bits, rounded up.
fn rounded_up(distance: f32) -> u16 {
    let bits = distance.to_bits();
    (bits >> 16) as u16 + u16::from(bits & 0xffff != 0)
}

/// Rows of one patch.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Rows {
    /// `[t]` target patches.
    pub targets: Vec<Identity>,
    /// `[g]` points that gather, ascending.
    pub gather: Vec<u8>,
    /// Rays of a point that gathers.
    pub rays: u32,
    /// `[n]`
    pub source: Vec<[u8; SOURCES]>,
    /// `[n]`
    pub weight: Vec<[u8; SOURCES]>,
    /// `[n]` first rays.
    pub first: Vec<[Ray; FIRST]>,
    /// `[g · (rays − FIRST)]` the others.
    pub rest: Vec<Ray>,
}

/// A hash of where a point's rays start.
pub(super) fn place_of(source: &Source) -> u64 {
    hash_of(source.origin.iter().chain(&source.normal))
}

/// Direction of ray `k` of a point, and a number in 0..1 that draws the corner of its hit.
pub(super) fn ray(source: &Source, place: u64, k: usize) -> ([f32; 3], f64) {
    let sequence = Sequence::new(SEED, place, 0, k as u32);
    let ([u, v], [drawn, _]) = (sequence.pair(0), sequence.pair(1));
    let (radius, angle) = (u.sqrt(), 2.0 * std::f64::consts::PI * v);
    let (x, y, z) = ((radius * libm::cos(angle)) as f32, (radius * libm::sin(angle)) as f32, (1.0 - u).sqrt() as f32);
    let (tangent, bitangent) = tangents(source.normal);
    (std::array::from_fn(|i| x * tangent[i] + y * bitangent[i] + z * source.normal[i]), drawn)
}

/// Casts the rays of one patch, or takes them over.
struct Caster<'a> {
    targets: &'a Targets<'a>,
    points: &'a [Source],
    places: Vec<u64>,
    earlier: Option<&'a Earlier<'a>>,
    /// Local numbers of target patches, in the order in which rays meet them.
    known: BTreeMap<u32, u16>,
    order: Vec<u32>,
    /// Rays that were cast.
    cast: u64,
}

impl Caster<'_> {
    /// Ray `k` of a point; `before`: what it met in an earlier bake.
    fn ray(&mut self, point: usize, k: usize, before: Option<Ray>) -> Ray {
        let source = &self.points[point];
        let taken = before.zip(self.earlier).and_then(|(ray, earlier)| earlier.still(source, self.places[point], k, ray));
        let (distance, met, is_black) = taken.unwrap_or_else(|| {
            let (direction, drawn) = ray(source, self.places[point], k);
            self.cast += 1;
            self.targets.cast(source, direction, drawn)
        });
        let far = rounded_up(distance) | if is_black { BLACK } else { 0 };
        match met {
            Met::Point(patch, point) => self.number(patch).map_or(Ray { far, ..Ray::NONE }, |target| Ray { target, point, far }),
            Met::Nobody => Ray { far, ..Ray::NONE },
        }
    }

    /// The number of a patch; `None` beyond 65,534 of them, whose light is left out.
    fn number(&mut self, patch: u32) -> Option<u16> {
        if let Some(number) = self.known.get(&patch) {
            return Some(*number);
        }
        if self.order.len() >= usize::from(NOBODY) {
            return None;
        }
        self.known.insert(patch, self.order.len() as u16);
        self.order.push(patch);
        Some(self.order.len() as u16 - 1)
    }
}

impl Rows {
    /// Casts the rays of a patch, but for those that an earlier bake cast and that meet what they met. Gives the number of rays cast, too.
    pub(super) fn cast(targets: &Targets, patch: u32, options: &BounceOptions, earlier: Option<&Earlier>) -> (Rows, u64) {
        let (points, edge) = (targets.patch(patch), targets.edge_length(patch));
        let places = points.iter().map(place_of).collect();
        let mut caster = Caster { targets, points, places, earlier, known: BTreeMap::new(), order: Vec::new(), cast: 0 };
        let (mut first, mut reach) = (Vec::with_capacity(points.len()), Vec::with_capacity(points.len()));
        for (i, point) in points.iter().enumerate() {
            let (mut rays, mut inverse) = ([Ray::NONE; FIRST], 0.0f32);
            for (k, ray) in rays.iter_mut().enumerate().filter(|_| !point.is_buried) {
                *ray = caster.ray(i, k, earlier.map(|earlier| earlier.rows.first[i][k]));
                inverse += 1.0 / ray.distance().max(f32::MIN_POSITIVE);
            }
            reach.push((FIRST as f32 / inverse.max(f32::MIN_POSITIVE)).clamp(REACH[0] * edge, REACH[1] * edge));
            first.push(rays);
        }
        let chooser = Chooser { points, reach: &reach, order: &caster.places, spacing: options.spacing, edge_length: edge };
        let Gathering { gather, source, weight } = match earlier.and_then(|earlier| earlier.gathering(&first)) {
            Some(gathering) => gathering,
            None => chooser.choose(&|p, q| targets.sees(&points[p], &points[q])),
        };
        let mut rest = Vec::with_capacity(gather.len() * (options.rays as usize - FIRST));
        for point in gather.iter().map(|point| usize::from(*point)) {
            let before = earlier.and_then(|earlier| earlier.rows.rest_of(point));
            for k in FIRST..options.rays as usize {
                rest.push(caster.ray(point, k, before.map(|before| before[k - FIRST])));
            }
        }
        let identities = caster.order.iter().map(|patch| targets.identity(*patch)).collect();
        (Rows { targets: identities, gather, rays: options.rays, source, weight, first, rest }, caster.cast)
    }

    /// Number of points.
    pub(super) fn len(&self) -> usize {
        self.first.len()
    }

    /// The rays of gathering point `g`, in their order.
    pub(super) fn met_by(&self, g: usize) -> impl Iterator<Item = &Ray> {
        let more = self.rays as usize - FIRST;
        self.first[usize::from(self.gather[g])].iter().chain(&self.rest[g * more..(g + 1) * more])
    }

    /// The rays beyond the first of a point, where it gathers.
    fn rest_of(&self, point: usize) -> Option<&[Ray]> {
        let (g, more) = (self.gather.binary_search(&(point as u8)).ok()?, self.rays as usize - FIRST);
        Some(&self.rest[g * more..(g + 1) * more])
    }

    /// `[n]` share of a point's first rays that end on a surface not close by, in 255ths.
    pub(super) fn seen(&self, edge_length: f32) -> Vec<u8> {
        let is_far = |ray: &&Ray| (CLOSE * edge_length..f32::INFINITY).contains(&ray.distance());
        self.first.iter().map(|rays| (rays.iter().filter(is_far).count() * 255 / FIRST) as u8).collect()
    }

    /// As bytes.
    pub(super) fn encode(&self) -> Vec<u8> {
        let (n, t, g) = (self.first.len(), self.targets.len(), self.gather.len());
        let rays = || self.first.as_flattened().iter().chain(&self.rest);
        let mut bytes = Vec::with_capacity(20 + 16 * t + g + 16 * n + 5 * (FIRST * n + self.rest.len()));
        [VERSION, n as u32, t as u32, g as u32, self.rays].iter().for_each(|word| bytes.extend_from_slice(&word.to_le_bytes()));
        bytes.extend_from_slice(self.targets.as_flattened());
        bytes.extend_from_slice(&self.gather);
        bytes.extend_from_slice(self.source.as_flattened());
        bytes.extend_from_slice(self.weight.as_flattened());
        rays().for_each(|ray| bytes.extend_from_slice(&ray.target.to_le_bytes()));
        bytes.extend(rays().map(|ray| ray.point));
        rays().for_each(|ray| bytes.extend_from_slice(&ray.far.to_le_bytes()));
        bytes
    }

    /// From bytes; `None` where they are no rows, or a number in them is out of range.
    pub(super) fn decode(bytes: &[u8]) -> Option<Rows> {
        let mut rest = bytes;
        let mut take = |len: usize| rest.split_off(..len);
        let shorts = |bytes: &[u8]| -> Vec<u16> { bytes.as_chunks::<2>().0.iter().map(|word| u16::from_le_bytes(*word)).collect() };
        let sources = |bytes: &[u8]| bytes.as_chunks::<SOURCES>().0.to_vec();
        let head = take(20)?.as_chunks::<4>().0;
        let [version, n, t, g, rays] = std::array::from_fn(|i| u32::from_le_bytes(head[i]) as usize);
        if version != VERSION as usize || !(1..=256).contains(&n) || t > usize::from(NOBODY) || g > n || !(FIRST..=255).contains(&rays) {
            return None;
        }
        let (targets, gather) = (take(16 * t)?.as_chunks::<16>().0.to_vec(), take(g)?.to_vec());
        let (source, weight) = (sources(take(SOURCES * n)?), sources(take(SOURCES * n)?));
        let count = FIRST * n + (rays - FIRST) * g;
        let (target, point, far) = (shorts(take(2 * count)?), take(count)?, shorts(take(2 * count)?));
        let fits = rest.is_empty()
            && target.iter().all(|target| *target == NOBODY || usize::from(*target) < t)
            && gather.iter().all(|point| usize::from(*point) < n)
            && gather.windows(2).all(|w| w[0] < w[1]);
        let ray = |i: usize| Ray { target: target[i], point: point[i], far: far[i] };
        fits.then(|| Rows {
            targets,
            gather,
            rays: rays as u32,
            source,
            weight,
            first: (0..n).map(|i| std::array::from_fn(|k| ray(FIRST * i + k))).collect(),
            rest: (FIRST * n..count).map(ray).collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_round_trip_and_no_cut_of_them_is_taken() {
        let ray = |k: usize| Ray {
            target: if k.is_multiple_of(3) { NOBODY } else { (k % 2) as u16 },
            point: k as u8,
            far: rounded_up(k as f32 * 0.3),
        };
        let rows = Rows {
            targets: vec![[1; 16], [2; 16]],
            gather: vec![1],
            rays: 40,
            source: vec![[0; SOURCES]; 2],
            weight: vec![[3; SOURCES]; 2],
            first: vec![std::array::from_fn(ray); 2],
            rest: (0..8).map(ray).collect(),
        };
        let bytes = rows.encode();
        assert_eq!(Rows::decode(&bytes).as_ref(), Some(&rows));
        assert!((0..bytes.len()).all(|cut| Rows::decode(&bytes[..cut]).is_none()));
        assert_eq!(rows.met_by(0).count(), 40);
        assert!((rows.rest_of(0).is_none(), rows.rest_of(1).map(<[Ray]>::len)) == (true, Some(8)));
    }

    #[test]
    fn distances_are_rounded_up_by_less_than_a_hundredth() {
        for distance in [0.0f32, 1e-30, 0.1, 0.99999, 1.0, 3.3333, 1e4, 3e30] {
            let ray = Ray { far: rounded_up(distance), ..Ray::NONE };
            assert!(ray.distance() >= distance && ray.distance() <= distance * (1.0 + 1.0 / 128.0), "{distance} {}", ray.distance());
        }
        assert_eq!(Ray { far: rounded_up(f32::INFINITY) | BLACK, ..Ray::NONE }.distance(), f32::INFINITY);
    }
}
