//! New points before they are put into patches: which base triangles hold them, their normals and ray origins, side by side.

use crate::mesh::Refined;
use crate::mesh::edge::edge_key;
use crate::mesh::origin::{Facet, Lift, Surroundings, is_excluded, ray_origin};
use crate::mesh::refined::ONE;
use crate::mesh::weld::{BaseMesh, narrow, wide};
use crate::points::patch::{Lattice, Place, dominant_axis};

/// One side of a refined point.
pub(crate) struct Draft {
    /// Where it belongs; `point` is the refined point.
    pub place: Place,
    pub origin: [f32; 3],
    pub geometric_normal: [f32; 3],
    first_excluded: u32,
    n_excluded: u32,
}

/// Sides of refined points, in their order, front before back.
pub(crate) struct Drafts {
    pub sides: Vec<Draft>,
    /// Ids of base triangles, draft by draft.
    pub excluded: Vec<u32>,
}

impl Drafts {
    /// Drafts of some refined points; `level` in place of their own, where they come later than their level.
    pub(crate) fn new(base: &BaseMesh, refined: &Refined, points: &[u32], level: Option<u8>, edge_length: f32) -> Drafts {
        let (holders, lattice) = (Holders::new(base), Lattice::new(base));
        let mut drafts = Drafts { sides: Vec::with_capacity(points.len()), excluded: Vec::with_capacity(points.len()) };
        // Every point of a dense mesh meets six triangles, on one side or two.
        let facets: Vec<Facet> = match 4 * points.len() > base.triangles.len() {
            true => (0..base.triangles.len() as u32).map(|t| Facet::new(&base.corner_positions(t))).collect(),
            false => Vec::new(),
        };
        let facet = |t: u32| facets.get(t as usize).copied().unwrap_or_else(|| Facet::new(&base.corner_positions(t)));
        let (mut held, mut around) = (Vec::new(), Vec::new());
        for point in points.iter().map(|point| *point as usize) {
            let home = refined.home[point];
            holders.of(home.base, home.weights(), &mut held);
            around.clear();
            around.extend(held.iter().map(|t| (*t, facet(*t))));
            let [x, y, z] = base.corner_points(home.base).map(|p| wide(base.local[p as usize]));
            let weights = home.weights().map(|w| f64::from(w) / f64::from(ONE));
            let code = lattice.code((x * weights[0] + y * weights[1] + z * weights[2]).to_array());
            let double_sided = base.primitives[refined.points.primitive[point] as usize].double_sided;
            for back in [false, true].into_iter().take(if double_sided { 2 } else { 1 }) {
                let place = Place { level: level.unwrap_or(refined.level[point]), fine: false, back, axis: 0, code, point: point as u32 };
                drafts.push(base, refined, place, &around, edge_length);
            }
        }
        drafts
    }

    /// Ids of the base triangles that never block a draft, ascending.
    pub(crate) fn excluded(&self, draft: &Draft) -> &[u32] {
        &self.excluded[draft.first_excluded as usize..][..draft.n_excluded as usize]
    }

    fn push(&mut self, base: &BaseMesh, refined: &Refined, place: Place, held: &[(u32, Facet)], edge_length: f32) {
        let point = place.point as usize;
        let sign = if place.back { -1.0 } else { 1.0 };
        let position = wide(refined.points.position[point]);
        let around = Surroundings::of(held.iter().map(|(_, facet)| *facet), sign);
        let normal = wide(refined.points.normal[point]) * sign;
        let geometric = if around.geometric_normal.length_squared() > 0.5 { around.geometric_normal } else { normal };

        let home = refined.home[point];
        let weights = home.weights().map(|w| f64::from(w) / f64::from(ONE));
        let normals = base.corner_normals(home.base).map(|n| narrow(wide(n) * sign));
        let lift = Lift::new(position, &base.corner_positions(home.base), &normals, weights, geometric);
        let origin = ray_origin(position, geometric, &around, lift, edge_length);

        let first_excluded = self.excluded.len() as u32;
        for (triangle, facet) in held.iter().map(|(t, facet)| (*t, facet)) {
            let (facing, corner) = (facet.normal * sign, base.corner_positions(triangle)[0]);
            if is_excluded(position, origin, facing, wide(corner), &around, lift) {
                self.excluded.push(base.triangles[triangle as usize].id);
            }
        }
        let n_excluded = self.excluded.len() as u32 - first_excluded;
        let geometric_normal = narrow(geometric);
        let place = Place { axis: dominant_axis(geometric_normal), ..place };
        self.sides.push(Draft { place, origin, geometric_normal, first_excluded, n_excluded });
    }
}

/// Which base triangles hold which points of an object.
struct Holders<'a> {
    base: &'a BaseMesh,
    /// `[base points + 1]`, then triangles: corners.
    fan_start: Vec<u32>,
    fan: Vec<u32>,
}

impl<'a> Holders<'a> {
    fn new(base: &'a BaseMesh) -> Self {
        let mut fan_start = vec![0u32; base.points.position.len() + 1];
        let triangles = || 0..base.triangles.len() as u32;
        for t in triangles() {
            base.corner_points(t).iter().for_each(|&p| fan_start[p as usize + 1] += 1);
        }
        for p in 1..fan_start.len() {
            fan_start[p] += fan_start[p - 1];
        }
        let mut fan = vec![0u32; 3 * base.triangles.len()];
        let mut next = fan_start.clone();
        for t in triangles() {
            for point in base.corner_points(t) {
                let at = &mut next[point as usize];
                fan[*at as usize] = t;
                *at += 1;
            }
        }
        Holders { base, fan_start, fan }
    }

    fn fan(&self, point: u32) -> &[u32] {
        &self.fan[self.fan_start[point as usize] as usize..self.fan_start[point as usize + 1] as usize]
    }

    /// Base triangles (indices, ascending) that hold a point: the fan of a base point, the triangles at the base edge of a point on
    /// one, else the triangle that it lies in.
    fn of(&self, base: u32, weights: [u16; 3], held: &mut Vec<u32>) {
        held.clear();
        let points = self.base.corner_points(base);
        let zero = |k: usize| weights[k] == 0;
        if let Some(k) = (0..3).find(|&k| zero((k + 1) % 3) && zero((k + 2) % 3)) {
            held.extend_from_slice(self.fan(points[k]));
            // A triangle with two corners at one point is there twice.
            held.dedup();
        } else if let Some(k) = (0..3).find(|&k| zero(k)) {
            let [p, q] = [points[(k + 1) % 3], points[(k + 2) % 3]];
            let has_edge = |t: &u32| {
                let corners = self.base.corner_points(*t);
                (0..3).any(|i| edge_key(corners[i], corners[(i + 1) % 3]) == edge_key(p, q))
            };
            let [a, b] = [self.fan(p), self.fan(q)];
            held.extend(if a.len() <= b.len() { a } else { b }.iter().filter(|t| has_edge(t)));
            held.dedup();
        } else {
            held.push(base);
        }
    }
}
