//! Candidates of an object: an edge length, and how far the borders of shadows are refined on top of it.
//!
//! ```text
//! edge length   8, 4, 2, 1, ½ times what the object has without a budget; ¼, 1/8, 1/16, 1/32 where the object is small or its mesh so fine that
//!               the edge length before still gives few points
//! most unrest   none, 4, 1, ¼, 2⁻⁴, 2⁻⁶, 2⁻⁸, 2⁻¹⁰ of that edge length squared, m²·sr; edges are split down to 1/32 of it   (crate::block_product::visibility::border)
//! ```
//!
//! Price of a candidate: its points. Work of a bake, work of a frame and bytes are in proportion to them at one face resolution and one depth of bits.

use super::around::refine_around;
use super::directions::Directions;
use super::measure::{Sums, measure_planned};
use super::places::{PlaceSet, Places};
use super::probes::Probes;
use super::traced::Tracing;
use crate::error::BakeError;
use crate::mesh::PointParams;
use crate::mesh::weld::BaseMesh;
use crate::points::buried::BuriedProbe;
use crate::points::count::count_object;
use crate::points::{ObjectPlan, plan_object};
use crate::trace::Occluders;
use prelight_runtime::asset::points::BURIED;
use prelight_scene::Scene;
use prelight_scene::world::World;

/// Places of an object at which a candidate is judged.
pub const PLACES: usize = 640;
/// Edge lengths, as shares of the one that the object would have without a budget.
pub const LENGTHS: [f32; 9] = [8.0, 4.0, 2.0, 1.0, 0.5, 0.25, 0.125, 0.0625, 0.03125];
/// As many of them any object may be asked for.
const FREE_LENGTHS: usize = 5;
/// The others where the one before them has fewer points than the object has without a budget, or than this: a small object may be as fine as its
/// budget needs, whatever its edge length.
const LEAST_POINTS: u64 = 8192;
/// Unrest that borders keep, in units of that edge length squared.
pub const BORDERS: [f32; 8] = [f32::INFINITY, 4.0, 1.0, 0.25, 1.0 / 16.0, 1.0 / 64.0, 1.0 / 256.0, 1.0 / 1024.0];
/// Shortest edge at a border, in units of that edge length.
const FINEST: f32 = 1.0 / 32.0;
/// The same in units of a candidate's own edges, where that is shorter.
const SHORTEST: f32 = 1.0 / 8.0;
/// A candidate is taken only if it is expected to stay below this share of the budget: other suns throw their borders elsewhere.
pub const MARGIN: f64 = 0.75;

/// One candidate of an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Index into [`LENGTHS`].
    pub length: usize,
    /// Index into [`BORDERS`].
    pub border: usize,
    /// Both, as a bake wants them.
    pub params: PointParams,
    /// Points that it is expected to have.
    pub points: u64,
    /// Error to be expected, from the probes that steer ([`Sums::expected`]).
    pub predicted: f64,
}

impl Candidate {
    /// Whether it meets a budget with the margin.
    pub(crate) fn meets(&self, budget: f64) -> bool {
        self.predicted <= MARGIN * budget
    }
}

/// The parameters of a candidate. `own` are the object's without a budget.
pub(crate) fn params(own: &PointParams, length: usize, border: usize) -> PointParams {
    let at_length = PointParams { coarser: true, ..own.with_edge_length(own.edge_length * LENGTHS[length]) };
    if BORDERS[border].is_infinite() {
        return at_length;
    }
    // In units of this candidate's own edges; short ones may be divided as well.
    let area_floor = at_length.area_floor.min(FINEST / LENGTHS[length]).min(SHORTEST);
    PointParams { area_floor, max_shadow_gap: BORDERS[border] * own.edge_length * own.edge_length, ..at_length }
}

/// Which edge length and border give some parameters, if any.
pub fn grid_index(own: &PointParams, of: &PointParams) -> Option<(usize, usize)> {
    let mut all = (0..LENGTHS.len()).flat_map(|length| (0..BORDERS.len()).map(move |border| (length, border)));
    all.find(|(length, border)| params(own, *length, *border) == *of)
}

/// An object whose candidates are asked for: what they share is found once.
pub struct ObjectSearch<'a> {
    scene: &'a Scene,
    world: &'a World,
    object: usize,
    own: PointParams,
    probes: &'a Probes,
    places: Places,
    tracing: Tracing<'a>,
    /// Points without a budget.
    own_points: u64,
    /// `[length][with a border]`: the floor of edges differs, and with it what curved surfaces are split into.
    plans: [[Option<ObjectPlan>; 2]; LENGTHS.len()],
}

/// An object, and what blocks its light.
#[derive(Clone, Copy)]
pub struct ObjectInput<'a> {
    /// Whose materials count.
    pub scene: &'a Scene,
    /// Its triangles.
    pub world: &'a World,
    /// What blocks light.
    pub occluders: &'a Occluders,
    /// What points may lie in.
    pub solids: &'a BuriedProbe<'a>,
    /// Which object of the scene.
    pub object: usize,
    /// Its parameters without a budget.
    pub own: PointParams,
}

impl ObjectInput<'_> {
    /// Where the object is judged, and what is true there.
    pub fn places(&self, probes: &Probes, drawn: PlaceSet) -> Places {
        let base = BaseMesh::build(self.scene, self.world, self.object);
        Places::new(&base, self.world, self.occluders, self.solids, self.own.edge_length, probes, PLACES, drawn)
    }
}

impl<'a> ObjectSearch<'a> {
    /// At the subject's own `places`.
    ///
    /// # Errors
    /// An object that cannot be planned.
    pub fn new(subject: &ObjectInput<'a>, probes: &'a Probes, directions: Directions, places: Places) -> Result<Self, BakeError> {
        let ObjectInput { scene, world, occluders, solids, object, own } = *subject;
        let coarsest = plan_object(scene, world, object, &params(&own, 0, 0))?;
        let tracing = Tracing::new(occluders, probes, solids, own.edge_length, directions);
        let own_points = count_object(&coarsest.base, &own, u64::MAX).points;
        let plans = std::array::from_fn(|length| [(length == 0).then(|| coarsest.clone()), None]);
        Ok(ObjectSearch { scene, world, object, own, probes, places, tracing, own_points, plans })
    }

    /// Whether a budget may ask for an edge length.
    ///
    /// # Errors
    /// A candidate that cannot be planned.
    pub(crate) fn allows(&mut self, length: usize) -> Result<bool, BakeError> {
        if length < FREE_LENGTHS {
            return Ok(true);
        }
        let own_points = self.own_points.max(LEAST_POINTS);
        Ok((self.plan(length - 1, 0)?.n_points() as u64) < own_points)
    }

    /// Points of an edge length without borders, whether allowed or not, as far as refinement makes them.
    pub(crate) fn counted(&self, length: usize) -> u64 {
        let base = &self.plans[0][0].as_ref().expect("planned first").base;
        count_object(base, &params(&self.own, length, 0), u64::MAX).points
    }

    /// What points lose where they stand, however many there are: [`Places::point_error`].
    pub fn point_error(&self) -> Sums {
        self.places.point_error(&self.tracing)
    }

    /// The same at other shades than the question's.
    pub(super) fn point_error_in(&self, tracing: &Tracing) -> Sums {
        self.places.point_error(tracing)
    }

    /// A candidate that is known already, at other shades: refined by the question's, and only then traced.
    ///
    /// # Errors
    /// As [`ObjectSearch::candidate`].
    pub(super) fn in_shades(&mut self, known: &Candidate, tracing: &Tracing) -> Result<Candidate, BakeError> {
        let (mut near, points) = self.around(known.length, known.border)?;
        near.flags.iter_mut().for_each(|flags| *flags &= !BURIED);
        tracing.mark_buried(&mut near);
        let sums = measure_planned(&near, &self.places, self.probes, tracing);
        Ok(Candidate { points, predicted: sums.expected(0..sums.truth.len()), ..*known })
    }

    fn plan(&mut self, length: usize, border: usize) -> Result<&ObjectPlan, BakeError> {
        let slot = &mut self.plans[length][usize::from(border > 0)];
        if slot.is_none() {
            *slot = Some(plan_object(self.scene, self.world, self.object, &params(&self.own, length, border))?);
        }
        Ok(slot.as_ref().expect("just planned"))
    }

    /// The candidate at an edge length and a border.
    ///
    /// # Errors
    /// A candidate that cannot be planned.
    pub fn candidate(&mut self, length: usize, border: usize) -> Result<Candidate, BakeError> {
        Ok(self.asked(length, border)?.0)
    }

    /// [`ObjectSearch::candidate`] and its sums under each light.
    ///
    /// # Errors
    /// As `candidate`.
    pub fn asked(&mut self, length: usize, border: usize) -> Result<(Candidate, Sums), BakeError> {
        let (near, points) = self.around(length, border)?;
        let params = params(&self.own, length, border);
        let sums = measure_planned(&near, &self.places, self.probes, &self.tracing);
        Ok((Candidate { length, border, params, points, predicted: sums.expected(0..sums.truth.len()) }, sums))
    }

    /// The candidate's plan where places are, refined as a bake does it, and the points that all of it is expected to have.
    ///
    /// # Errors
    /// As `candidate`.
    pub fn around(&mut self, length: usize, border: usize) -> Result<(ObjectPlan, u64), BakeError> {
        self.plan(length, border)?;
        let plan = self.plans[length][usize::from(border > 0)].as_ref().expect("just planned");
        Ok(refine_around(plan, &params(&self.own, length, border), &self.places, &self.tracing)?)
    }
}
