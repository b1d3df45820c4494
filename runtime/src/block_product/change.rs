//! A light that changed in few blocks: only those are summed again.
//!
//! ```text
//! E[c][a] += Σ_changed blocks Σ_runs ( S[begin] − S[end] )        S: suffix sums inside a block of (moment after − moment before)
//! ```
//!
//! Drift. B += T·ΔL in f32 leaks where a light flashes: rounding the large sum is never taken back, 3e-2 after 10⁵ frames (PAPERS.md, \[Ove06\] erratum 2). So
//! differences are taken in f64 of the stored f32 moments, summed in f64, and the irradiance is kept as two f32, the second holding what the
//! first rounds away: 2⁻⁴⁸ a frame. What a full pass rounded stays: relative to the light at that time, so [`LightChange::allows`] asks for
//! a full pass once the light has fallen to a thousandth of that.
//!
//! Not lossy beyond the full pass: a thousand flashes of 10⁴ stay within 1e-5 (tested).

use super::visibility::Visibility;
use crate::environment::LightCubemap;
use crate::sphere::cubemap::{BLOCK_TEXELS, row_major_from_hilbert};

/// Share of blocks up to which a partial update is worth it.
pub(crate) const MOST_CHANGED: f32 = 0.125;
/// A light this much darker than at the last full pass needs another.
const DARKENING: f64 = 1e-3;

/// Difference of two lights, block by block.
#[derive(Clone, Debug, Default)]
pub struct LightChange {
    /// Blocks that differ, increasing.
    blocks: Vec<u16>,
    /// `[blocks][257]` sums of the difference from a position of the block on, `[channel · 3 + axis]`.
    suffix: Vec<[f64; 9]>,
    face_resolution: usize,
}

impl LightChange {
    /// Panics when the two are not of the same size.
    pub fn between(before: &LightCubemap, after: &LightCubemap) -> Self {
        let n = after.face_resolution;
        assert!(before.face_resolution == n && before.moment.len() == after.moment.len(), "lights of the same cubemap");
        let (order, face_texels) = (row_major_from_hilbert(n), n * n);
        let mut change = LightChange { face_resolution: n, ..LightChange::default() };
        for block in 0..6 * face_texels / BLOCK_TEXELS {
            let texel = |p: usize| {
                let position = block * BLOCK_TEXELS + p;
                position / face_texels * face_texels + order[position % face_texels] as usize
            };
            if (0..BLOCK_TEXELS).all(|p| before.moment[texel(p)] == after.moment[texel(p)]) {
                continue;
            }
            let first = change.suffix.len();
            change.blocks.push(block as u16);
            change.suffix.resize(first + BLOCK_TEXELS + 1, [0.0; 9]);
            for p in (0..BLOCK_TEXELS).rev() {
                let (old, new) = (before.moment[texel(p)].as_flattened(), after.moment[texel(p)].as_flattened());
                let next = change.suffix[first + p + 1];
                change.suffix[first + p] = std::array::from_fn(|lane| next[lane] + (f64::from(new[lane]) - f64::from(old[lane])));
            }
        }
        change
    }

    /// Share of the blocks that differ, 0..=1.
    pub fn share(&self) -> f32 {
        self.blocks.len() as f32 * BLOCK_TEXELS as f32 / (6 * self.face_resolution * self.face_resolution).max(1) as f32
    }

    /// Whether a partial update is worth it and keeps a full pass's accuracy; `at_full` and `now`: sums of the lights' flux.
    pub fn allows(&self, at_full: f64, now: f64) -> bool {
        self.share() <= MOST_CHANGED && now >= DARKENING * at_full
    }
}

/// Adds a change to the vector irradiance of every point of a patch; `rest` is what `irradiance` rounds away, zeros after a full pass.
///
/// Panics when lengths or resolutions disagree. Does not allocate.
pub fn update_diffuse(change: &LightChange, visibility: &Visibility, irradiance: &mut [[[f32; 3]; 3]], rest: &mut [[[f32; 3]; 3]]) {
    let n = visibility.len();
    assert!(irradiance.len() == n && rest.len() == n, "one result per point");
    assert_eq!(change.face_resolution, visibility.face_resolution(), "light and visibility of the same cubemap");
    for point in 0..n {
        let own = visibility.point(point);
        let mut sum = [0.0f64; 9];
        let mut add = |from: &[f64; 9], to: &[f64; 9]| (0..9).for_each(|lane| sum[lane] += from[lane] - to[lane]);
        // Blocks with transitions before the one looked at, their transitions, and whether what follows them is open.
        let (mut block, mut counted, mut first, mut open) = (0usize, 0usize, 0usize, false);
        for (at, changed) in change.blocks.iter().map(|b| usize::from(*b)).enumerate() {
            while block < changed {
                // The words up to the changed block, as many bits at once as lie in one word.
                let end = changed.min((block / 32 + 1) * 32);
                let mask = (u32::MAX >> (31 - (end - 1) % 32)) & (u32::MAX << (block % 32));
                let before = (own.blocks[block / 32] & mask).count_ones() as usize;
                let transitions: usize = own.counts[counted..counted + before].iter().map(|count| usize::from(*count) + 1).sum();
                open ^= transitions % 2 == 1;
                (counted, first, block) = (counted + before, first + transitions, end);
            }
            let suffix = &change.suffix[at * (BLOCK_TEXELS + 1)..(at + 1) * (BLOCK_TEXELS + 1)];
            if own.blocks[changed / 32] >> (changed % 32) & 1 == 0 {
                if open {
                    add(&suffix[0], &suffix[BLOCK_TEXELS]);
                }
                continue;
            }
            let count = usize::from(own.counts[counted]) + 1;
            let mut begin = open.then_some(0);
            for position in &own.positions[first..first + count] {
                match begin.take() {
                    None => begin = Some(usize::from(*position)),
                    Some(from) => add(&suffix[from], &suffix[usize::from(*position)]),
                }
            }
            if let Some(from) = begin {
                add(&suffix[from], &suffix[BLOCK_TEXELS]);
            }
        }
        if let Some(fractions) = own.fractions.filter(|fractions| !fractions.is_empty()) {
            let step = 1.0 / f64::from(fractions.steps);
            let mut changed = change.blocks.iter().map(|block| usize::from(*block)).enumerate().peekable();
            for (position, correction) in fractions.iter() {
                let block = position / BLOCK_TEXELS;
                while changed.next_if(|(_, changed)| *changed < block).is_some() {}
                match changed.peek() {
                    None => break,
                    Some((at, changed)) if *changed == block => {
                        let first = at * (BLOCK_TEXELS + 1) + position % BLOCK_TEXELS;
                        let (from, to) = (&change.suffix[first], &change.suffix[first + 1]);
                        (0..9).for_each(|lane| sum[lane] += f64::from(correction) * step * (from[lane] - to[lane]));
                    }
                    Some(_) => {}
                }
            }
        }
        let (high, low) = (irradiance[point].as_flattened_mut(), rest[point].as_flattened_mut());
        for lane in 0..9 {
            let exact = f64::from(high[lane]) + f64::from(low[lane]) + sum[lane];
            high[lane] = exact as f32;
            low[lane] = (exact - f64::from(high[lane])) as f32;
        }
    }
}
