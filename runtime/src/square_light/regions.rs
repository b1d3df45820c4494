//! How much of the light of each region a point sees, from the runs of its open texels: nothing is stored for it.
//!
//! ```text
//! line[p][i] = Σ_{q ≥ p} of the luminance of texels q of region i, all of a region being 65,535        p along the Hilbert order, 0..=6n²
//! open[i]    = Σ_runs (line[begin][i] − line[end][i])        wrapping
//! ```
//!
//! One 64-byte line a position for at most 32 regions, 1.6 MB at 64². Each end of a run is within half a unit. A black region counts its
//! solid angle.

use super::tree::Tree;
use crate::block_product::visibility::PointVisibility;
use crate::environment::LightCubemap;
use crate::sphere::cubemap::{row_major_from_hilbert, texel_solid_angle};
use crate::square_light::moments::LUMINANCE;

/// Most regions.
pub const MOST_REGIONS: usize = 32;

/// All of a region.
pub const ALL: u16 = u16::MAX;

#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
struct Line([u16; MOST_REGIONS]);

/// Sums of the regions of one cut along the Hilbert order.
#[derive(Clone, Debug)]
pub struct Regions {
    n_regions: usize,
    /// `[6n² + 1]`
    lines: Vec<Line>,
}

impl Regions {
    /// Those of a cut of at most 32 nodes.
    pub fn of_cut(tree: &Tree, cut: &[u32], light: &LightCubemap) -> Regions {
        Regions::build(&tree.regions(cut), cut.len(), light)
    }

    /// Sums of a light whose texels, row-major, are of the regions `region_of`.
    ///
    /// # Panics
    /// With more than 32 regions, or texels of another cubemap.
    pub fn build(region_of: &[u16], n_regions: usize, light: &LightCubemap) -> Regions {
        assert!(n_regions <= MOST_REGIONS && region_of.len() == light.flux.len(), "at most 32 regions of the light's texels");
        let n = light.face_resolution;
        let (face_texels, hilbert) = (n * n, row_major_from_hilbert(n));
        let luminance = |texel: usize| (0..3).map(|c| LUMINANCE[c] * f64::from(light.flux[texel][c])).sum::<f64>();
        let mut total = [0.0f64; MOST_REGIONS];
        region_of.iter().enumerate().for_each(|(texel, region)| total[*region as usize] += luminance(texel));
        let is_black = total.map(|sum| sum <= 0.0);
        let areas: Vec<f64> = if is_black[..n_regions].contains(&true) {
            (0..face_texels).map(|i| texel_solid_angle(n, i % n, i / n)).collect()
        } else {
            Vec::new()
        };
        let weight = |texel: usize, region: usize| if is_black[region] { areas[texel % face_texels] } else { luminance(texel) };
        for (texel, region) in region_of.iter().enumerate().filter(|(_, region)| is_black[**region as usize]) {
            total[*region as usize] += areas[texel % face_texels];
        }
        let mut lines = vec![Line([0; MOST_REGIONS]); region_of.len() + 1];
        let (mut sums, mut line) = ([0.0f64; MOST_REGIONS], Line([0; MOST_REGIONS]));
        for position in (0..region_of.len()).rev() {
            let texel = position / face_texels * face_texels + hilbert[position % face_texels] as usize;
            let region = region_of[texel] as usize;
            sums[region] += weight(texel, region);
            line.0[region] = (f64::from(ALL) * (sums[region] / total[region]).min(1.0) + 0.5) as u16;
            lines[position] = line;
        }
        Regions { n_regions, lines }
    }

    /// Regions of the cut.
    pub fn len(&self) -> usize {
        self.n_regions
    }

    /// Whether there is no region.
    pub fn is_empty(&self) -> bool {
        self.n_regions == 0
    }

    /// Part of each region's light that a point sees; [`ALL`] is everything.
    pub fn open(&self, point: &PointVisibility) -> [u16; MOST_REGIONS] {
        let mut sums = [0u16; MOST_REGIONS];
        point.for_each_run(self.lines.len() - 1, |begin, end| self.add(begin, end, &mut sums));
        sums
    }

    /// Adds a run of texels.
    #[inline(always)]
    fn add(&self, begin: usize, end: usize, sums: &mut [u16; MOST_REGIONS]) {
        let (begin, end) = (&self.lines[begin].0, &self.lines[end].0);
        (0..MOST_REGIONS).for_each(|i| sums[i] = sums[i].wrapping_add(begin[i].wrapping_sub(end[i])));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::block_product::visibility::{STREAM_PADDING, Visibility, block_count};
    use crate::square_light::tree_tests::{noise, spots};

    /// A chunk of one point with these transitions.
    fn chunk(n: usize, transitions: &[usize]) -> Vec<u8> {
        let mut blocks = vec![0u32; block_count(n) / 32];
        let (mut counts, mut positions): (Vec<u8>, Vec<u8>) = (Vec::new(), Vec::new());
        for (i, at) in transitions.iter().enumerate() {
            let block = at / 256;
            blocks[block / 32] |= 1 << (block % 32);
            positions.push((at % 256) as u8);
            match i.checked_sub(1).is_some_and(|before| transitions[before] / 256 == block) {
                true => *counts.last_mut().unwrap() += 1,
                false => counts.push(0),
            }
        }
        let mut stream = [counts, positions].concat();
        let own = stream.len() as u32;
        stream.resize(stream.len() + STREAM_PADDING, 0);
        Visibility::to_chunk(n, &[0, own], &blocks, &stream)
    }

    #[test]
    fn what_a_point_sees_of_a_region_is_a_sum_over_its_texels() {
        let n = 64;
        let light = spots(n, 5);
        let tree = Tree::build(&light);
        let cut = tree.base_cut(32);
        let (of, regions) = (tree.regions(&cut), Regions::of_cut(&tree, &cut, &light));
        for seed in 0..6 {
            let transitions: Vec<usize> = (0..6 * n * n).filter(|at| noise(at * 31 + seed) > 0.995 - 0.1 * (seed % 2) as f32).collect();
            let bytes = chunk(n, &transitions);
            let aligned: Vec<u64> = bytes.chunks_exact(8).map(|c| u64::from_le_bytes(c.try_into().unwrap())).collect();
            let visibility = Visibility::from_chunk(bytemuck::cast_slice(&aligned)).unwrap();
            let found = regions.open(&visibility.point(0));
            let mut words = vec![0u64; crate::block_product::visibility::open_words(n)];
            visibility.point(0).to_open_bits(n, &mut words);
            let (mut open, mut all) = ([0.0f64; 32], [0.0f64; 32]);
            for texel in 0..6 * n * n {
                let luminance: f64 = (0..3).map(|c| LUMINANCE[c] * f64::from(light.flux[texel][c])).sum();
                all[of[texel] as usize] += luminance;
                open[of[texel] as usize] += luminance * f64::from((words[texel / 64] >> (texel % 64) & 1) as u32);
            }
            let runs = transitions.len() as f64;
            for i in 0..cut.len() {
                let share = f64::from(found[i]) / f64::from(ALL);
                // Each end is off by half a unit at most, without a preferred side.
                assert!((share - open[i] / all[i]).abs() < (2.0 + 2.0 * runs.sqrt()) / 65_535.0, "{i}: {share} {}", open[i] / all[i]);
            }
        }
    }

    #[test]
    fn everything_open_is_all_of_every_region_and_black_ones_count_their_size() {
        for light in [LightCubemap::black(64), spots(64, 1)] {
            let tree = Tree::build(&light);
            let regions = Regions::of_cut(&tree, &tree.cut(7), &light);
            let bytes = chunk(64, &[0]);
            let aligned: Vec<u64> = bytes.chunks_exact(8).map(|c| u64::from_le_bytes(c.try_into().unwrap())).collect();
            let visibility = Visibility::from_chunk(bytemuck::cast_slice(&aligned)).unwrap();
            assert!(regions.open(&visibility.point(0))[..7].iter().all(|part| *part == ALL));
        }
    }
}
