//! What the still scene leaves of the light in open space: for points that move, on a lattice of places.
//!
//! A place has a visibility chunk's runs, without a horizon ([`crate::block_product::visibility`]); under a light they give what of each region's light
//! arrives there. In between the eight places around are blended, those that see nothing (inside of something) left out. Outside of all lattices nothing is
//! known, and all light arrives. Lossy: a shadow's edge is as soft as the spacing, and light leaks through what is thinner.

use super::regions::{MOST_REGIONS, Regions};
use crate::block_product::visibility::Visibility;

/// Where the places of a lattice are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// The first place, world.
    pub low: [f32; 3],
    /// Places along each axis, at least 2.
    pub counts: [usize; 3],
    /// Between neighbours, metres.
    pub spacing: f32,
}

impl Grid {
    /// Number of places.
    pub fn len(&self) -> usize {
        self.counts.iter().product()
    }

    /// Whether there is no place.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Position of a place; x runs fastest.
    pub fn place(&self, index: usize) -> [f32; 3] {
        let [nx, ny, _] = self.counts;
        let at = [index % nx, index / nx % ny, index / (nx * ny)];
        std::array::from_fn(|k| self.low[k] + at[k] as f32 * self.spacing)
    }

    /// The eight places around a position, and their weights; `None` outside, where the nearest is more than half a step away.
    fn around(&self, p: [f32; 3]) -> Option<[(usize, f32); 8]> {
        let (mut first, mut between) = ([0; 3], [0.0; 3]);
        for k in 0..3 {
            let last = (self.counts[k] - 1) as f32;
            let at = (p[k] - self.low[k]) / self.spacing;
            if !(-0.5..=last + 0.5).contains(&at) {
                return None;
            }
            let at = at.clamp(0.0, last);
            first[k] = (at as usize).min(self.counts[k] - 2);
            between[k] = at - first[k] as f32;
        }
        let [nx, ny, _] = self.counts;
        Some(std::array::from_fn(|corner| {
            let bit = |k: usize| corner >> k & 1;
            let index = ((first[2] + bit(2)) * ny + first[1] + bit(1)) * nx + first[0] + bit(0);
            let part = |k: usize| if bit(k) == 1 { between[k] } else { 1.0 - between[k] };
            (index, part(0) * part(1) * part(2))
        }))
    }
}

/// A lattice under a light.
#[derive(Clone, Debug)]
pub struct Lattice {
    grid: Grid,
    /// `[places]` of 255: what of each region's light arrives.
    parts: Vec<[u8; MOST_REGIONS]>,
    /// `[places]` sees nothing.
    blind: Vec<bool>,
}

impl Lattice {
    /// A lattice without light.
    pub fn new(grid: Grid) -> Lattice {
        Lattice { grid, parts: vec![[0; MOST_REGIONS]; grid.len()], blind: vec![true; grid.len()] }
    }

    /// Takes the regions of a light; `chunks` are the places' proven visibility, in order.
    pub fn light<'a>(&mut self, regions: &Regions, chunks: impl Iterator<Item = Visibility<'a>>) {
        let mut index = 0;
        for chunk in chunks {
            for i in 0..chunk.len() {
                let point = chunk.point(i);
                self.blind[index] = point.is_blind();
                self.parts[index] = regions.open(&point).map(|part| part.div_ceil(257).min(255) as u8);
                index += 1;
            }
        }
    }

    /// What of each region's light arrives at a position, 0..=1; `None` where that is not known.
    pub fn at(&self, p: [f32; 3]) -> Option<[f32; MOST_REGIONS]> {
        let around = self.grid.around(p)?;
        let seeing = || around.iter().filter(|(place, weight)| *weight > 0.0 && !self.blind[*place]);
        let all: f32 = seeing().map(|(_, weight)| weight).sum();
        if all <= 0.0 {
            return None;
        }
        let mut sum = [0.0; MOST_REGIONS];
        for (place, weight) in seeing() {
            (0..MOST_REGIONS).for_each(|k| sum[k] += f32::from(self.parts[*place][k]) * (weight / (255.0 * all)));
        }
        Some(sum.map(|part| part.min(1.0)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn between_places_is_their_blend_and_blind_ones_are_left_out() {
        let grid = Grid { low: [1.0, 0.0, -1.0], counts: [3, 2, 2], spacing: 0.5 };
        let mut lattice = Lattice::new(grid);
        assert!(lattice.at([1.2, 0.1, -0.9]).is_none(), "all of them blind");
        for index in 0..grid.len() {
            lattice.parts[index][0] = (100.0 * (grid.place(index)[0] - 1.0)) as u8;
            lattice.blind[index] = false;
        }
        let at = |lattice: &Lattice, x: f32| 255.0 * lattice.at([x, 0.25, -0.75]).unwrap()[0];
        assert!((at(&lattice, 1.25) - 25.0).abs() < 1e-3 && (at(&lattice, 1.8) - 80.0).abs() < 1e-3);
        assert!((at(&lattice, 0.8) - 0.0).abs() < 1e-3 && lattice.at([0.7, 0.25, -0.75]).is_none());
        (0..grid.len()).filter(|index| grid.place(*index)[0] < 1.2).for_each(|index| lattice.blind[index] = true);
        assert!((at(&lattice, 1.25) - 50.0).abs() < 1e-3);
    }
}
