//! Points that must not be interpolated from, because they lie inside something.
//!
//! Only points that see nothing are asked. From such a point, [`N_DIRECTIONS`] rays leave over the hemisphere of n_g. It is buried if
//!
//! - at least half of them first meet the back of a single-sided surface: the point lies inside a solid; or
//! - at least half of them first meet a triangle within 45° of parallel to it, within 2⁻⁸ of the local edge length along n_g: another
//!   surface coincides with this one.
//!
//! The answer depends on what lies within the **reach** of those rays: the farthest of the nearest hits.
//!
//! A closed dark room makes neither: its walls are met from the front, and in its corners they are not parallel.

use crate::mesh::origin::area_normal;
use crate::mesh::weld::{narrow, wide};
use crate::points::ObjectPlan;
use crate::reach::shaft::Bounds;
use glam::DVec3;
use prelight_runtime::sphere::frame::tangents;
use prelight_scene::Scene;
use prelight_scene::world::World;

/// Rays a point.
pub(crate) const N_DIRECTIONS: usize = 32;
/// Height over the surface, in local edges, below which another surface counts as coincident.
const COINCIDENT: f64 = 1.0 / 256.0;

/// Closest hit of a ray: distance in lengths of the direction, base triangle, and whether its back was met.
pub(crate) type ClosestHit<'a> = dyn Fn([f32; 3], [f32; 3]) -> Option<(f32, u32, bool)> + Sync + 'a;

/// Points of an object that are buried, ascending: of those for which `sees_nothing` holds.
///
/// `closest` traces against the whole scene, both faces of each triangle.
#[cfg(test)]
pub(crate) fn find_buried(
    scene: &Scene,
    world: &World,
    plan: &ObjectPlan,
    edge_length: f32,
    sees_nothing: &dyn Fn(u32) -> bool,
    closest: &ClosestHit,
) -> Vec<u32> {
    let probe = BuriedProbe::new(scene, world);
    (0..plan.n_points() as u32).filter(|&i| sees_nothing(i) && probe.ask(plan, i, edge_length, closest).is_buried).collect()
}

/// What became of a point that sees nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Verdict {
    /// It lies inside something.
    pub is_buried: bool,
    /// Metres from the ray origin within which all lies that decided; infinite if a ray met nothing.
    pub reach: f64,
}

/// The rule, for one point at a time.
pub struct BuriedProbe<'a> {
    scene: &'a Scene,
    world: &'a World,
    directions: [DVec3; N_DIRECTIONS],
}

/// Whether a ray from an origin along a direction meets something up to a distance.
pub(crate) type Meets<'a> = dyn Fn([f32; 3], [f32; 3], f32) -> bool + 'a;

/// Where something is that was not, or was and is not.
pub(crate) struct Boxes<'a> {
    each: &'a [Bounds],
    /// Bounds of all together; `None` where there is none.
    all: Option<Bounds>,
}

impl<'a> Boxes<'a> {
    /// Some boxes, and the bounds of all of them.
    pub(crate) fn new(each: &'a [Bounds]) -> Boxes<'a> {
        let joined = |mut all: Bounds, bounds: &Bounds| {
            all.join(bounds);
            all
        };
        Boxes { each, all: (!each.is_empty()).then(|| each.iter().fold(Bounds::EMPTY, joined)) }
    }
}

impl<'a> BuriedProbe<'a> {
    /// For points of this scene.
    pub fn new(scene: &'a Scene, world: &'a World) -> Self {
        BuriedProbe { scene, world, directions: hemisphere() }
    }

    /// Whether point `i`, which sees nothing, is buried.
    pub(crate) fn ask(&self, plan: &ObjectPlan, i: u32, edge_length: f32, closest: &ClosestHit) -> Verdict {
        self.ask_from(plan.origin[i as usize], plan.geometric_normal[i as usize], local_edge(plan, i, edge_length), closest)
    }

    /// The same of any place that sees nothing, with its geometric normal; `local_edge`: mean edge of its triangle, at most the bake's, metres.
    pub(crate) fn ask_from(&self, origin: [f32; 3], normal: [f32; 3], local_edge: f64, closest: &ClosestHit) -> Verdict {
        let limit = COINCIDENT * local_edge;
        let (t, b) = tangents(normal);
        let (t, b, n) = (wide(t), wide(b), wide(normal));
        let (mut behind, mut near, mut reach) = (0, 0, 0.0f64);
        for (asked, d) in self.directions.iter().enumerate() {
            // No ray beyond those that decide: most points in closed rooms are settled by half of them, and depend on no more.
            let left = N_DIRECTIONS - asked;
            let is_half = |count: usize| 2 * count >= N_DIRECTIONS;
            if is_half(behind) || is_half(near) || !(is_half(behind + left) || is_half(near + left)) {
                break;
            }
            let direction = narrow(t * d.x + b * d.y + n * d.z);
            if let Some((distance, triangle, back)) = closest(origin, direction) {
                let corners = &self.world.positions[triangle as usize];
                behind += usize::from(back && self.is_single_sided(triangle));
                let facing = area_normal(corners).normalize_or_zero().dot(n).abs();
                near += usize::from(f64::from(distance) * d.z <= limit && facing > std::f64::consts::FRAC_1_SQRT_2);
                let (mut place, mut bounds) = (Bounds::EMPTY, Bounds::EMPTY);
                place.add(origin);
                corners.iter().for_each(|corner| bounds.add(*corner));
                // Also the box that was met, where rounding has the hit before it.
                reach = reach.max(f64::from(distance) * wide(direction).length()).max(bounds.distance(&place));
            } else {
                reach = f64::INFINITY;
            }
        }
        // Hits lie before their box by 2⁻¹⁰ at most (`trace::ray`).
        Verdict { is_buried: 2 * behind >= N_DIRECTIONS || 2 * near >= N_DIRECTIONS, reach: reach * (1.0 + 1.0 / 256.0) }
    }

    /// Whether a ray that point `i` may ask comes near one of the boxes within `reach` metres: where none does, what lies in them is not part
    /// of the answer.
    ///
    /// Near is within 2⁻⁸ of the distance, far more than rounding puts a hit beside its triangle. `meets`: whether a ray meets something in the
    /// boxes up to a distance, where that can be asked; without it a ray that comes near a box does.
    pub(crate) fn may_meet(&self, plan: &ObjectPlan, i: u32, boxes: &Boxes, reach: f64, meets: Option<&Meets>) -> bool {
        let Some(all) = &boxes.all else { return false };
        let normal = plan.geometric_normal[i as usize];
        let origin = wide(plan.origin[i as usize]);
        let around = |bounds: &Bounds| {
            let (lower, upper) = (wide(bounds.lower) - origin, wide(bounds.upper) - origin);
            let slack = DVec3::splat(lower.abs().max(upper.abs()).max_element() / 256.0);
            (lower - slack, upper + slack)
        };
        let all = around(all);
        // Behind the surface: no ray goes there.
        let n = wide(normal);
        let highest = (all.0 * n).max(all.1 * n);
        if highest.x + highest.y + highest.z <= 0.0 {
            return false;
        }
        let (t, b) = tangents(normal);
        let (t, b) = (wide(t), wide(b));
        let reach = reach * (1.0 + 1.0 / 128.0);
        let comes_near = |direction: DVec3, (lower, upper): (DVec3, DVec3)| {
            let (mut from, mut to) = (0.0f64, reach);
            for axis in 0..3 {
                if direction[axis] == 0.0 {
                    if lower[axis] > 0.0 || upper[axis] < 0.0 {
                        return false;
                    }
                    continue;
                }
                let (near, far) = (lower[axis] / direction[axis], upper[axis] / direction[axis]);
                from = from.max(near.min(far));
                to = to.min(near.max(far));
            }
            from <= to
        };
        let directions = self.directions.iter().map(|d| t * d.x + b * d.y + n * d.z);
        directions.filter(|direction| comes_near(*direction, all)).any(|direction| match meets {
            Some(meets) => meets(plan.origin[i as usize], narrow(direction), reach as f32),
            None => boxes.each.iter().any(|bounds| comes_near(direction, around(bounds))),
        })
    }

    /// Winding and sidedness of a triangle, as keys have it.
    pub(crate) fn side(&self, triangle: u32) -> u8 {
        crate::reach::pieces::side(self.scene, self.world, triangle)
    }

    fn is_single_sided(&self, triangle: u32) -> bool {
        let primitive = &self.world.primitives[self.world.primitive[triangle as usize] as usize];
        !self.scene.materials[primitive.material as usize].double_sided
    }
}

/// Mean edge of the base triangle that a point was made in, at most the bake's edge length.
pub(crate) fn local_edge(plan: &ObjectPlan, i: u32, edge_length: f32) -> f64 {
    plan.mean_edge(i).min(f64::from(edge_length))
}

/// Equal solid angles over the upper hemisphere: a Fibonacci spiral.
fn hemisphere() -> [DVec3; N_DIRECTIONS] {
    /// 2π(1 − 1/φ), the golden angle.
    const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;
    std::array::from_fn(|i| {
        let z = (i as f64 + 0.5) / N_DIRECTIONS as f64;
        let (radius, phi) = ((1.0 - z * z).sqrt(), GOLDEN_ANGLE * i as f64);
        DVec3::new(radius * libm::cos(phi), radius * libm::sin(phi), z)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::test_scenes::*;

    #[test]
    fn directions_are_unit_and_cover_the_hemisphere_evenly() {
        let directions = hemisphere();
        let mean: DVec3 = directions.iter().sum::<DVec3>() / N_DIRECTIONS as f64;
        assert!(directions.iter().all(|d| (d.length() - 1.0).abs() < 1e-12 && d.z > 0.0));
        // The mean of a hemisphere is (0, 0, ½); 32 points leave a few hundredths sideways.
        assert!((mean - DVec3::new(0.0, 0.0, 0.5)).length() < 0.03, "{mean}");
    }

    #[test]
    fn what_no_ray_comes_near_is_not_part_of_the_answer() {
        let mut scene = scene();
        add(&mut scene, "floor", vec![quad([-1.0, 0.0, -1.0], [0.0, 0.0, 2.0], [2.0, 0.0, 0.0], 0)], IDENTITY);
        let (world, plans) = plan(&scene, &params(0.5));
        let probe = BuriedProbe::new(&scene, &world);
        let at = |y: f32, size: f32| Bounds { lower: [-size, y, -size], upper: [size, y + 0.1, size] };
        let (mut met, mut asked) = (0, 0);
        for i in 0..plans[0].n_points() as u32 {
            let may_meet = |boxes: &[Bounds], reach| probe.may_meet(&plans[0], i, &Boxes::new(boxes), reach, None);
            assert!(!may_meet(&[], 9.0) && !may_meet(&[at(-1.0, 5.0)], f64::INFINITY), "behind the surface");
            assert!(may_meet(&[at(-1.0, 5.0), at(1.0, 30.0)], f64::INFINITY), "a ceiling");
            assert!(!may_meet(&[at(-1.0, 5.0), at(1.0, 30.0)], 0.8), "a ceiling that is out of reach");
            // A thing that some of the rays hit: never one that is hit by none.
            let thing = at(2.0, 0.3);
            let corners = [thing.lower, thing.upper];
            let inside = |p: DVec3| (0..3).all(|k| p[k] >= f64::from(corners[0][k]) && p[k] <= f64::from(corners[1][k]));
            let (t, b) = tangents(plans[0].geometric_normal[i as usize]);
            let hits = hemisphere().iter().any(|d| {
                let direction = wide(t) * d.x + wide(b) * d.y + wide(plans[0].geometric_normal[i as usize]) * d.z;
                (0..4000).any(|step| inside(wide(plans[0].origin[i as usize]) + direction * (f64::from(step) / 1000.0)))
            });
            let may = may_meet(&[at(-1.0, 5.0), thing], 10.0);
            assert!(may || !hits, "point {i}");
            met += u32::from(may);
            asked += 1;
        }
        assert!(met > 0 && met < asked, "{met} of {asked}");
    }

    fn buried(scene: &Scene, object: usize, edge_length: f32) -> (World, Vec<ObjectPlan>, Vec<u32>) {
        let (world, plans) = plan(scene, &params(edge_length));
        let plan = &plans[object];
        let texels = directions(6);
        let sees_nothing = |i: u32| open_share(&world, plan, i as usize, &texels) == 0.0;
        let hit =
            |origin: [f32; 3], direction: [f32; 3]| closest(&world, origin, wide(direction), &[]).map(|(t, id, back)| (t as f32, id, back));
        let found = find_buried(scene, &world, plan, edge_length, &sees_nothing, &hit);
        (world, plans, found)
    }

    #[test]
    fn floor_points_inside_a_solid_box_are_buried_and_no_others() {
        let mut scene = scene();
        add(&mut scene, "floor", vec![quad([-1.0, 0.0, -1.0], [0.0, 0.0, 2.0], [2.0, 0.0, 0.0], 0)], IDENTITY);
        add(&mut scene, "box", vec![cuboid([-0.33, -0.1, -0.33], [0.33, 0.4, 0.33], false, 0)], IDENTITY);
        let (_, mut plans, found) = buried(&scene, 0, 0.25);
        let plan = &mut plans[0];
        assert!(!found.is_empty());
        for i in 0..plan.n_points() as u32 {
            let [x, _, z] = plan.position[i as usize];
            assert_eq!(found.contains(&i), x.abs() < 0.33 && z.abs() < 0.33, "{x} {z}");
        }
        plan.mark_buried(&found);
        assert_eq!(plan.n_buried(), found.len());
    }

    #[test]
    fn a_floor_under_a_tight_double_sided_sheet_is_buried_but_a_dark_room_is_not() {
        let mut scene = scene();
        add(&mut scene, "floor", vec![quad([-1.0, 0.0, -1.0], [0.0, 0.0, 2.0], [2.0, 0.0, 0.0], 0)], IDENTITY);
        add(&mut scene, "sheet", vec![quad([-3.0, 1e-4, -3.0], [0.0, 0.0, 6.0], [6.0, 0.0, 0.0], 1)], IDENTITY);
        let (_, plans, found) = buried(&scene, 0, 0.25);
        assert_eq!(found.len(), plans[0].n_points(), "0.1 mm is within 2⁻⁸ of 0.25 m");

        let mut scene = crate::points::test_scenes::scene();
        add(&mut scene, "room", vec![cuboid([0.0; 3], [2.0, 2.0, 2.0], true, 0)], IDENTITY);
        let (_, _, found) = buried(&scene, 0, 0.6);
        assert!(found.is_empty(), "dark, but in front of its walls");
    }
}
