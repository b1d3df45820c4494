//! Which points of a patch gather, and from which of those the others interpolate: irradiance caching's rule (Ward 1988), inside a patch.
//!
//! ```text
//! p needs no rays where a gathering q has   |p − q| / min(R_p, R_q) + √(1 − n_p·n_q) < spacing       R: harmonic mean distance of their rays
//! sources of p: the 8 nearest in  (|Δ|² + 4 (Δ·n)²) / h² + 4 (1 − n·n')  that it sees, itself first, weight 1 − error / reach
//! ```
//!
//! `h` is the edge length, `error` the left side of Ward's rule, `reach` twice the spacing. Points that gather are means with their neighbours too:
//! the noise of few rays shows less, light bends as little as between any two points that share a source. The order of choice is a
//! hash of each point's place, so it does not hang on its index.

use super::targets::Source;
use prelight_runtime::bounces::links::SOURCES;

/// How far sources reach, in units of the spacing.
const REACH: f32 = 2.0;

/// What choosing reads of a patch.
pub(super) struct Chooser<'a> {
    pub points: &'a [Source],
    /// `[points]` how far each sees, metres.
    pub reach: &'a [f32],
    /// `[points]` hash of each one's place.
    pub order: &'a [u64],
    pub spacing: f32,
    pub edge_length: f32,
}

/// Points that gather, ascending, and the sources of all: indices into them and 255ths, all 0 for buried points.
pub(super) struct Gathering {
    pub gather: Vec<u8>,
    pub source: Vec<[u8; SOURCES]>,
    pub weight: Vec<[u8; SOURCES]>,
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl Chooser<'_> {
    /// Chooses. `sees(p, q)`: whether nothing lies between two points.
    pub(super) fn choose(&self, sees: &dyn Fn(usize, usize) -> bool) -> Gathering {
        let mut order: Vec<usize> = (0..self.points.len()).filter(|i| !self.points[*i].is_buried).collect();
        order.sort_unstable_by_key(|i| (self.order[*i], *i));
        let mut gathers = vec![false; self.points.len()];
        let mut chosen: Vec<usize> = Vec::new();
        for &p in &order {
            if !chosen.iter().any(|&q| self.error(p, q) < self.spacing) {
                chosen.push(p);
                gathers[p] = true;
            }
        }
        // Whoever sees no source gathers too; that adds sources, never takes one away, so one pass is enough.
        let mut sources: Vec<Vec<(usize, f32)>> = vec![Vec::new(); self.points.len()];
        for &p in &order {
            sources[p] = self.sources(p, &chosen, sees);
            if sources[p].is_empty() {
                (gathers[p], sources[p]) = (true, vec![(p, 1.0)]);
            }
        }
        let gather: Vec<u8> = (0..self.points.len()).filter(|i| gathers[*i]).map(|i| i as u8).collect();
        let index = |point: usize| gather.binary_search(&(point as u8)).expect("sources gather") as u8;
        let (mut source, mut weight) = (vec![[0; SOURCES]; self.points.len()], vec![[0; SOURCES]; self.points.len()]);
        for &p in &order {
            let shares = in_255ths(&sources[p]);
            for (k, (point, _)) in sources[p].iter().enumerate() {
                (source[p][k], weight[p][k]) = (index(*point), shares[k]);
            }
        }
        Gathering { gather, source, weight }
    }

    /// How far off `p` is from `q`, by Ward's estimate.
    fn error(&self, p: usize, q: usize) -> f32 {
        let (a, b) = (&self.points[p], &self.points[q]);
        let away: [f32; 3] = std::array::from_fn(|k| b.position[k] - a.position[k]);
        dot(away, away).sqrt() / self.reach[p].min(self.reach[q]) + (1.0 - dot(a.normal, b.normal)).max(0.0).sqrt()
    }

    fn sources(&self, p: usize, chosen: &[usize], sees: &dyn Fn(usize, usize) -> bool) -> Vec<(usize, f32)> {
        let a = &self.points[p];
        let distance = |q: usize| {
            let b = &self.points[q];
            let away: [f32; 3] = std::array::from_fn(|k| b.position[k] - a.position[k]);
            let above = dot(away, a.normal);
            (dot(away, away) + 4.0 * above * above) / (self.edge_length * self.edge_length) + 4.0 * (1.0 - dot(a.normal, b.normal)).max(0.0)
        };
        let reach = REACH * self.spacing;
        let mut near: Vec<(f32, usize)> =
            chosen.iter().filter(|q| p == **q || self.error(p, **q) < reach).map(|&q| (distance(q), q)).collect();
        near.sort_unstable_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
        near.truncate(SOURCES + 2);
        let weight = |q: usize| if p == q { 1.0 } else { 1.0 - self.error(p, q) / reach };
        near.into_iter().filter(|(_, q)| p == *q || sees(p, *q)).take(SOURCES).map(|(_, q)| (q, weight(q))).collect()
    }
}

/// Weights as whole 255ths with that sum: the largest takes what rounding leaves.
fn in_255ths(sources: &[(usize, f32)]) -> [u8; SOURCES] {
    let all: f32 = sources.iter().map(|(_, weight)| weight).sum();
    let mut shares = [0u8; SOURCES];
    for (share, (_, weight)) in shares.iter_mut().zip(sources) {
        *share = (weight / all * 255.0) as u8;
    }
    let left = 255 - shares.iter().map(|share| u32::from(*share)).sum::<u32>();
    let largest = (0..sources.len()).max_by_key(|k| (shares[*k], usize::MAX - k)).unwrap_or(0);
    shares[largest] += left as u8;
    shares
}
