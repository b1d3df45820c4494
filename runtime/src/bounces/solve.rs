//! Steps of radiosity over the links of an asset.
//!
//! Every step reads the one before alone and each patch writes its own part, so threads change no bit; [`Solver::step`] allocates nothing.

use super::albedo::Sender;
use super::links::{Links, decode_direction};
use super::nodes;
use crate::chunk::layout::PATCH_POINTS;
use crate::chunk::points::Points;
use crate::error::RuntimeError;
use crate::light::layer::Bounces;
use std::collections::HashMap;
use std::f32::consts::PI;
use std::ops::Range;
use std::sync::Arc;

/// Steps of [`Bounces::Settled`] at most: 0.9 of the light is left of each at an albedo of 0.9.
const MOST_STEPS: u32 = 64;

/// Least cosine that a link's direction counts with in vector irradiance.
const LEAST_COSINE: f32 = 0.1;

/// A patch as solving reads it.
#[derive(Clone, Copy)]
pub struct PatchInput<'a> {
    /// Where its points are.
    pub points: Points<'a>,
    /// Its links; `None` where it was baked without: it gets no bounced light, and sends none.
    pub links: Option<Links<'a>>,
}

/// Places of a patch in the arrays of a solver.
#[derive(Clone, Copy, Debug)]
struct Place {
    patch: usize,
    point: usize,
    n_points: usize,
    target: usize,
}

impl Place {
    fn n_nodes(&self) -> usize {
        nodes::count(self.n_points)
    }
}

/// Bounced light of one asset.
pub struct Solver {
    places: Vec<Place>,
    /// `[targets of all patches]` first node of each, numbered through the asset.
    target: Arc<[u32]>,
    /// `[points]` what each counts in the means of its nodes: area times the share of its rays that end not close by.
    weight: Vec<f32>,
    senders: Vec<Sender>,
    /// `[points]` direct irradiance.
    direct: Vec<[f32; 3]>,
    /// `[points]` bounced irradiance.
    bounced: Vec<[f32; 3]>,
    /// `[nodes]` radiance that leaves; the fourth is padding.
    radiosity: Vec<[f32; 4]>,
    /// `[patches]` what the last step changed, and how much light there is, both times area.
    change: Vec<[f64; 2]>,
    /// `[points][channel][axis]` bounced vector irradiance.
    vector: Vec<[[f32; 3]; 3]>,
}

/// First nodes of the targets that patches name, numbered through the asset, patch after patch. `digests`: `[patches]` of points chunks.
///
/// # Errors
/// A target that is not among them, or a node that its patch has not.
pub fn resolve(patches: &[PatchInput], digests: &[[u8; 16]]) -> Result<Vec<u32>, RuntimeError> {
    let error = |what: String| RuntimeError::Chunk { kind: "links", digest: String::new(), what };
    let (mut first, mut by_digest) = (0u64, HashMap::new());
    for (patch, digest) in patches.iter().zip(digests) {
        by_digest.entry(*digest).or_insert((first, patch.points.len()));
        first += nodes::count(patch.points.len()) as u64;
    }
    if first > u64::from(u32::MAX) {
        return Err(error(format!("{first} nodes are more than links can name")));
    }
    let mut resolved = Vec::new();
    for (index, links) in patches.iter().enumerate().filter_map(|(index, patch)| Some((index, patch.links?))) {
        let known =
            |digest: &[u8; 16]| by_digest.get(digest).copied().ok_or_else(|| error(format!("patch {index} names one that is not there")));
        let targets = links.targets.iter().map(known).collect::<Result<Vec<_>, _>>()?;
        for (target, node) in links.target.iter().zip(links.node) {
            let (_, n) = targets[usize::from(*target)];
            if usize::from(*node) >= nodes::count(n) {
                return Err(error(format!("patch {index} names node {node} of a patch of {n} points")));
            }
        }
        resolved.extend(targets.iter().map(|(first, _)| *first as u32));
    }
    Ok(resolved)
}

impl Solver {
    /// A solver for patches whose targets begin at the nodes `target`, as [`resolve`] gives them; black until senders are set.
    pub fn new(patches: &[PatchInput], target: Arc<[u32]>) -> Self {
        let (mut places, mut weight) = (Vec::with_capacity(patches.len()), Vec::new());
        let (mut point, mut node, mut first) = (0, 0, 0);
        for (patch, PatchInput { points, links }) in patches.iter().enumerate() {
            let n_points = points.len();
            places.push(Place { patch, point, n_points, target: first });
            weight.extend((0..n_points).map(|i| links.map_or(0.0, |links| points.area[i].max(0.0) * f32::from(links.seen[i]) / 255.0)));
            (point, node, first) = (point + n_points, node + nodes::count(n_points), first + links.map_or(0, |links| links.targets.len()));
        }
        Solver {
            change: vec![[0.0; 2]; places.len()],
            places,
            target,
            weight,
            senders: vec![Sender::default(); point],
            direct: vec![[0.0; 3]; point],
            bounced: vec![[0.0; 3]; point],
            radiosity: vec![[0.0; 4]; node],
            vector: vec![[[0.0; 3]; 3]; point],
        }
    }

    /// `[points]` what each sends on, to be filled.
    pub fn senders(&mut self) -> &mut [Sender] {
        &mut self.senders
    }

    /// Direct and bounced irradiance of a point, of the last [`Solver::solve`].
    pub fn of(&self, point: usize) -> [[f32; 3]; 2] {
        [self.direct[point], self.bounced[point]]
    }

    /// `[points][channel][axis]` bounced vector irradiance of the last [`Solver::solve`], W·m⁻².
    pub fn vector(&self) -> &[[[f32; 3]; 3]] {
        &self.vector
    }

    /// Bytes that it holds.
    pub fn bytes(&self) -> usize {
        4 * self.target.len() + self.weight.len() * (4 + size_of::<Sender>() + 12 + 12 + 36) + 16 * self.radiosity.len()
    }

    /// Adds bounces under a light whose vector irradiance at points is `direct`. Gives the share of the mean irradiance that the last step
    /// changed. `patch` gives a patch by its index.
    pub fn solve<'a>(&mut self, bounces: Bounces, direct: &[[[f32; 3]; 3]], patch: &(impl Fn(usize) -> PatchInput<'a> + Sync)) -> f32 {
        self.receive(direct, patch);
        let (steps, enough) = match bounces {
            Bounces::Off => (0, 0.0),
            Bounces::Steps(steps) => (steps, 0.0),
            Bounces::Settled(enough) => (MOST_STEPS, enough),
            Bounces::Progressive => (1, 0.0),
        };
        if bounces != Bounces::Progressive {
            self.bounced.fill([0.0; 3]);
        }
        let mut change = 0.0;
        for _ in 0..steps {
            change = self.step(patch);
            if change <= enough {
                break;
            }
        }
        self.aim(patch, steps > 0);
        change
    }

    /// Direct irradiance of all points.
    fn receive<'a>(&mut self, direct: &[[[f32; 3]; 3]], patch: &(impl Fn(usize) -> PatchInput<'a> + Sync)) {
        each_patch(&self.places, &mut self.direct, |place| place.n_points, &mut [(); 0], &|place, out, _| {
            let normal = patch(place.patch).points.normal;
            for (i, out) in out.iter_mut().enumerate() {
                let vector = &direct[place.point + i];
                *out = std::array::from_fn(|c| (0..3).map(|k| vector[c][k] * normal[i][k]).sum::<f32>().max(0.0));
            }
        });
    }

    /// One bounce more. Gives the share of the mean irradiance that it changed.
    pub fn step<'a>(&mut self, patch: &(impl Fn(usize) -> PatchInput<'a> + Sync)) -> f32 {
        self.send();
        let Solver { places, target, radiosity, direct, bounced, change, .. } = self;
        let (target, radiosity, direct) = (&target[..], &radiosity[..], &direct[..]);
        each_patch(places, bounced, |place| place.n_points, change, &|place, out, change| {
            let input = patch(place.patch);
            let Some(links) = input.links else { return };
            let mut gathered = [[0.0f32; 3]; PATCH_POINTS];
            let scale = PI / links.rays as f32;
            for (g, sum) in gathered.iter_mut().enumerate().take(links.gather.len()) {
                for l in links.of(g) {
                    let (sent, count) = (radiosity[sender(target, place, &links, l)], f32::from(links.count[l]));
                    (0..3).for_each(|c| sum[c] += count * sent[c]);
                }
                *sum = sum.map(|x| x * scale);
            }
            let mut sums = [0.0f64; 2];
            for (i, out) in out.iter_mut().enumerate() {
                let now: [f32; 3] = blend(&links, i, |g| gathered[g]);
                let area = f64::from(input.points.area[i].max(0.0));
                let (before, light) = (*out, direct[place.point + i]);
                sums[0] += area * (0..3).map(|c| f64::from((now[c] - before[c]).abs())).sum::<f64>();
                sums[1] += area * (0..3).map(|c| f64::from(light[c] + now[c])).sum::<f64>();
                *out = now;
            }
            change[0] = sums;
        });
        let [changed, all] = self.change.iter().fold([0.0; 2], |[a, b], [c, d]| [a + c, b + d]);
        if all > 0.0 { (changed / all) as f32 } else { 0.0 }
    }

    /// What points and clusters send on.
    fn send(&mut self) {
        let Solver { places, weight, senders, direct, bounced, radiosity, .. } = self;
        let (weight, senders, direct, bounced) = (&weight[..], &senders[..], &direct[..], &bounced[..]);
        each_patch(places, radiosity, Place::n_nodes, &mut [(); 0], &|place, out, _| {
            let n = place.n_points;
            let mut weights = [0.0f32; nodes::count(PATCH_POINTS)];
            for i in 0..n {
                let at = place.point + i;
                let Sender { albedo, emitted } = senders[at];
                let sent = |c: usize| albedo[c] / PI * (direct[at][c] + bounced[at][c]) + emitted[c];
                (out[i], weights[i]) = ([sent(0), sent(1), sent(2), 0.0], weight[at]);
            }
            for level in 1..=nodes::RUNS.len() {
                let (first, below) = (nodes::first(n, level), nodes::first(n, level - 1));
                for node in 0..nodes::len(n, level) {
                    let children = below + 4 * node..(below + 4 * node + 4).min(below + nodes::len(n, level - 1));
                    (out[first + node], weights[first + node]) = mean(out, &weights, children);
                }
            }
        });
    }

    /// Vector irradiance from what the last step read: as much along the normal as the step found.
    fn aim<'a>(&mut self, patch: &(impl Fn(usize) -> PatchInput<'a> + Sync), is_lit: bool) {
        let Solver { places, target, radiosity, bounced, vector, .. } = self;
        let (target, radiosity, bounced) = (&target[..], &radiosity[..], &bounced[..]);
        each_patch(places, vector, |place| place.n_points, &mut [(); 0], &|place, out, _| {
            let input = patch(place.patch);
            let Some(links) = input.links.filter(|_| is_lit) else { return out.fill([[0.0; 3]; 3]) };
            let mut gathered = [[[0.0f32; 3]; 3]; PATCH_POINTS];
            let scale = PI / links.rays as f32;
            for (g, sum) in gathered.iter_mut().enumerate().take(links.gather.len()) {
                let normal = input.points.normal[usize::from(links.gather[g])];
                for l in links.of(g) {
                    let (sent, direction) = (radiosity[sender(target, place, &links, l)], decode_direction(links.direction[l]));
                    let cosine: f32 = (0..3).map(|k| direction[k] * normal[k]).sum();
                    let weight = scale * f32::from(links.count[l]) / cosine.max(LEAST_COSINE);
                    (0..3).for_each(|c| (0..3).for_each(|k| sum[c][k] += weight * sent[c] * direction[k]));
                }
            }
            for (i, out) in out.iter_mut().enumerate() {
                let normal = input.points.normal[i];
                for (c, out) in out.iter_mut().enumerate() {
                    let vector: [f32; 3] = blend(&links, i, |g| gathered[g][c]);
                    let along: f32 = (0..3).map(|k| vector[k] * normal[k]).sum();
                    *out = std::array::from_fn(|k| vector[k] + (bounced[place.point + i][c] - along) * normal[k]);
                }
            }
        });
    }
}

/// The node that a link of a patch names.
fn sender(target: &[u32], place: &Place, links: &Links, link: usize) -> usize {
    target[place.target + usize::from(links.target[link])] as usize + usize::from(links.node[link])
}

/// What a point has from the points that gather for it.
fn blend(links: &Links, point: usize, of: impl Fn(usize) -> [f32; 3]) -> [f32; 3] {
    let mut sum = [0.0; 3];
    for (source, weight) in links.source[point].iter().zip(links.weight[point]).filter(|(_, weight)| *weight > 0) {
        let own = of(usize::from(*source));
        (0..3).for_each(|c| sum[c] += f32::from(weight) / 255.0 * own[c]);
    }
    sum
}

/// The weighted mean of some nodes and the sum of their weights; where none counts, the plain mean.
fn mean(sent: &[[f32; 4]], weights: &[f32], children: Range<usize>) -> ([f32; 4], f32) {
    let all: f32 = weights[children.clone()].iter().sum();
    let (mut sum, n) = ([0.0; 4], children.len() as f32);
    for child in children {
        let share = if all > 0.0 { weights[child] / all } else { 1.0 / n };
        (0..3).for_each(|c| sum[c] += share * sent[child][c]);
    }
    (sum, all)
}

/// Patches that are not worth splitting.
const GRAIN: usize = 16;

/// Hands each patch its elements of `out`, and its one of `own` where that has any; halves on two threads where there are any.
fn each_patch<T: Send, U: Send>(
    places: &[Place],
    out: &mut [T],
    size: impl Fn(&Place) -> usize + Copy + Sync + Send,
    own: &mut [U],
    f: &(impl Fn(&Place, &mut [T], &mut [U]) + Sync),
) {
    let has_own = usize::from(!own.is_empty());
    if places.len() <= GRAIN || cfg!(not(feature = "parallel")) {
        let (mut out, mut own) = (out, own);
        for place in places {
            let (first, rest) = out.split_at_mut(size(place));
            let (one, others) = own.split_at_mut(has_own);
            f(place, first, one);
            (out, own) = (rest, others);
        }
        return;
    }
    let (first, second) = places.split_at(places.len() / 2);
    let elements = first.iter().map(size).sum();
    let ((out_a, out_b), (own_a, own_b)) = (out.split_at_mut(elements), own.split_at_mut(has_own * first.len()));
    join(|| each_patch(first, out_a, size, own_a, f), || each_patch(second, out_b, size, own_b, f));
}

#[cfg(feature = "parallel")]
fn join(a: impl FnOnce() + Send, b: impl FnOnce() + Send) {
    rayon::join(a, b);
}

#[cfg(not(feature = "parallel"))]
fn join(a: impl FnOnce(), b: impl FnOnce()) {
    a();
    b();
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A closed body of `n` points in one patch, each of which sees all of it: every row has all of its rays.
    struct Closed {
        position: Vec<[f32; 3]>,
        normal: Vec<[f32; 3]>,
        area: Vec<f32>,
        flags: Vec<u32>,
        arrays: Arrays,
    }

    #[derive(Default)]
    struct Arrays {
        gather: Vec<u8>,
        end: Vec<u32>,
        target: Vec<u16>,
        node: Vec<u16>,
        count: Vec<u8>,
        direction: Vec<[i8; 2]>,
        source: Vec<[u8; 8]>,
    }

    impl Closed {
        fn new(n: usize, level: usize) -> Self {
            let nodes = nodes::first(n, level)..nodes::first(n, level) + nodes::len(n, level);
            let mut arrays = Arrays::default();
            for i in 0..n {
                let left = 60 - nodes.len();
                for (k, node) in nodes.clone().enumerate() {
                    arrays.target.push(0);
                    arrays.node.push(node as u16);
                    arrays.count.push(if k == i % nodes.len() { left as u8 + 1 } else { 1 });
                    arrays.direction.push([(k % 100) as i8, 0]);
                }
                arrays.gather.push(i as u8);
                arrays.end.push(arrays.target.len() as u32);
                arrays.source.push([i as u8, 0, 0, 0, 0, 0, 0, 0]);
            }
            Closed {
                position: vec![[0.0; 3]; n],
                normal: vec![[0.0, 0.0, 1.0]; n],
                area: (0..n).map(|i| 1.0 + i as f32).collect(),
                flags: vec![0; n],
                arrays,
            }
        }

        fn input(&self) -> PatchInput<'_> {
            let Arrays { gather, end, target, node, count, direction, source } = &self.arrays;
            let n = self.position.len();
            let points = Points {
                position: &self.position,
                normal: &self.normal,
                geometric_normal: &self.normal,
                area: &self.area,
                flags: &self.flags,
            };
            const WEIGHT: [[u8; 8]; 48] = [[255, 0, 0, 0, 0, 0, 0, 0]; 48];
            let links = Links {
                rays: 60,
                targets: &[[5; 16]],
                gather,
                end,
                target,
                node,
                count,
                direction,
                source,
                weight: &WEIGHT[..n],
                seen: &[255; 48][..n],
            };
            PatchInput { points, links: Some(links) }
        }
    }

    #[test]
    fn a_closed_body_holds_what_the_geometric_series_says() {
        for (n, level) in [(7, 0), (48, 1), (48, 2), (48, 4)] {
            let closed = Closed::new(n, level);
            let target = resolve(&[closed.input()], &[[5; 16]]).unwrap();
            let mut solver = Solver::new(&[closed.input()], target.into());
            let direct = vec![[[0.0, 0.0, 1.0], [0.0, 0.0, 2.0], [0.0, 0.0, 0.5]]; n];
            for albedo in [0.5f32, 0.8, 0.95] {
                solver.senders().fill(Sender { albedo: [albedo; 3], emitted: [0.0; 3] });
                for steps in [1, 3, 30] {
                    solver.solve(Bounces::Steps(steps), &direct, &|_| closed.input());
                    let expected = (1.0 - albedo.powi(steps as i32 + 1)) / (1.0 - albedo) - 1.0;
                    for vector in solver.vector() {
                        // f32 sums of 60 rays over up to 30 steps; along the normal, whatever the directions.
                        assert!((vector[0][2] / expected - 1.0).abs() < 1e-4, "{level} {albedo} {steps}: {vector:?} {expected}");
                        assert!((vector[1][2] / (2.0 * expected) - 1.0).abs() < 1e-4);
                    }
                }
            }
            solver.senders().fill(Sender { albedo: [0.8; 3], emitted: [0.0; 3] });
            let change = solver.solve(Bounces::default(), &direct, &|_| closed.input());
            assert!(change <= 1e-3 && change > 0.0);
        }
    }

    #[test]
    fn a_lamp_lights_without_any_environment_and_off_is_off() {
        let closed = Closed::new(8, 0);
        let mut solver = Solver::new(&[closed.input()], resolve(&[closed.input()], &[[5; 16]]).unwrap().into());
        solver.senders().fill(Sender { albedo: [0.0; 3], emitted: [1.0; 3] });
        let dark = vec![[[0.0; 3]; 3]; 8];
        solver.solve(Bounces::default(), &dark, &|_| closed.input());
        assert!(solver.vector().iter().all(|vector| (vector[0][2] / PI - 1.0).abs() < 1e-5), "a white sky all around gives π");
        solver.solve(Bounces::Off, &dark, &|_| closed.input());
        assert!(solver.vector().as_flattened().iter().all(|vector| *vector == [0.0; 3]));
    }

    #[test]
    fn progressive_steps_end_where_settled_ones_do() {
        let closed = Closed::new(48, 1);
        let mut solver = Solver::new(&[closed.input()], resolve(&[closed.input()], &[[5; 16]]).unwrap().into());
        solver.senders().fill(Sender { albedo: [0.6; 3], emitted: [0.0; 3] });
        let direct: Vec<[[f32; 3]; 3]> = (0..48).map(|i| [[0.0, 0.0, i as f32]; 3]).collect();
        solver.solve(Bounces::Settled(0.0), &direct, &|_| closed.input());
        let settled = solver.vector().to_vec();
        solver.solve(Bounces::Off, &direct, &|_| closed.input());
        for _ in 0..64 {
            solver.solve(Bounces::Progressive, &direct, &|_| closed.input());
        }
        for (a, b) in solver.vector().iter().zip(&settled) {
            assert!((a[0][2] - b[0][2]).abs() <= 1e-5 * b[0][2].abs());
        }
    }

    #[test]
    fn links_to_nowhere_are_refused() {
        let closed = Closed::new(4, 0);
        assert!(resolve(&[closed.input()], &[[6; 16]]).unwrap_err().to_string().contains("not there"));
        let mut wrong = Closed::new(4, 0);
        wrong.arrays.node[0] = nodes::count(4) as u16;
        assert!(resolve(&[wrong.input()], &[[5; 16]]).unwrap_err().to_string().contains("node"));
    }
}
