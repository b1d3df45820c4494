//! What points of candidates see, traced once however many candidates share them.

use super::directions::{Directions, Work};
use super::lit::{Irradiance, shown};
use super::probes::Probes;
use crate::points::ObjectPlan;
use crate::points::buried::BuriedProbe;
use crate::trace::Occluders;
use prelight_runtime::asset::mesh::NO_POINT;
use prelight_runtime::block_product::visibility::Visibility;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

/// One point.
#[derive(Debug)]
pub(super) struct Traced {
    /// Its visibility, a chunk of one point.
    chunk: Vec<u8>,
    /// Inside something: draw does not interpolate from it.
    pub is_buried: bool,
    /// Under each light.
    pub lit: Vec<Irradiance>,
}

impl Traced {
    /// Its visibility, alone.
    pub(crate) fn visibility(&self) -> Visibility<'_> {
        Visibility::from_chunk(&self.chunk).expect("encoded by `Tracing::point`")
    }
}

/// Points by where their rays start.
pub struct Tracing<'a> {
    occluders: &'a Occluders,
    probes: &'a Probes,
    solids: &'a BuriedProbe<'a>,
    edge_length: f32,
    pub(super) directions: Directions,
    known: RefCell<BTreeMap<[u32; 6], Rc<Traced>>>,
    work: RefCell<Work>,
}

impl<'a> Tracing<'a> {
    /// Nothing is traced yet. `edge_length` is the object's without a budget.
    pub fn new(
        occluders: &'a Occluders,
        probes: &'a Probes,
        solids: &'a BuriedProbe<'a>,
        edge_length: f32,
        directions: Directions,
    ) -> Self {
        Tracing { occluders, probes, solids, edge_length, directions, known: RefCell::default(), work: RefCell::default() }
    }

    /// What blocks light.
    pub(super) fn occluders(&self) -> &Occluders {
        self.occluders
    }

    /// Lights.
    pub(super) fn probes(&self) -> &Probes {
        self.probes
    }

    /// What a point of a plan sees.
    pub(super) fn point(&self, plan: &ObjectPlan, point: u32) -> Rc<Traced> {
        let from = plan.trace_origin(point as usize);
        let key = std::array::from_fn(|i| if i < 3 { from.origin[i].to_bits() } else { from.normal[i - 3].to_bits() });
        if let Some(known) = self.known.borrow().get(&key) {
            return known.clone();
        }
        let (chunk, is_open) = self.directions.trace(self.occluders, &from, &mut self.work.borrow_mut());
        let lit = shown(self.probes, &Visibility::from_chunk(&chunk).expect("just encoded").point(0));
        let closest = |origin: [f32; 3], direction: [f32; 3]| {
            let hit = self.occluders.closest_hit(origin, direction, from.base_triangles)?;
            Some((hit.t, hit.triangle, hit.back_face))
        };
        let is_buried = !is_open && self.solids.ask(plan, point, self.edge_length, &closest).is_buried;
        let traced = Rc::new(Traced { lit, is_buried, chunk });
        self.known.borrow_mut().insert(key, traced.clone());
        traced
    }

    /// Marks the buried points of a plan's triangles, as a bake does.
    pub(super) fn mark_buried(&self, plan: &mut ObjectPlan) {
        let mut corners: Vec<u32> = plan.refined.triangles.iter().flat_map(|t| t.vertices).map(|v| plan.refined.point(v)).collect();
        corners.sort_unstable();
        corners.dedup();
        let sides = corners.iter().flat_map(|corner| [plan.front[*corner as usize], plan.back[*corner as usize]]);
        let buried: Vec<u32> = sides.filter(|point| *point != NO_POINT && self.point(plan, *point).is_buried).collect();
        plan.mark_buried(&buried);
    }
}
