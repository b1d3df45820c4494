//! Sizes that no scene has: an object so large, or so far out, that numbers no longer tell its neighbours apart.
//!
//! One triangle of 3·10³⁸ m among things of a metre is a fault of an export. Whatever is measured by the scene's size (cells, levels of
//! refinement, ray offsets) would go to waste or never end, so it is refused by name before anything is counted.

use crate::error::PlanError;
use prelight_scene::Scene;
use prelight_scene::world::World;

/// Largest coordinate, metres: squares of differences stay finite in f32. Assets hold none beyond it.
const FARTHEST: f64 = 1e18;

/// Largest extent, in medians of the extents of all objects that have one.
const MOST_MEDIANS: f64 = 1e7;

/// Fails for the first object that is out of all proportion.
///
/// # Errors
/// [`PlanError::Extent`], which names it.
pub fn check_extents(scene: &Scene, world: &World) -> Result<(), PlanError> {
    let boxes: Vec<Box> = (0..scene.objects.len()).map(|object| Box::of(world, object)).collect();
    let mut extents: Vec<f64> = boxes.iter().map(Box::extent).filter(|extent| *extent > 0.0).collect();
    extents.sort_by(f64::total_cmp);
    let Some(median) = extents.get(extents.len().saturating_sub(1) / 2).copied() else { return Ok(()) };
    for (object, found) in scene.objects.iter().zip(&boxes) {
        let (reach, extent) = (found.reach(), found.extent());
        let what = match () {
            () if reach > FARTHEST => format!("reaches {reach:.0e} m from the origin, {FARTHEST:.0e} m is the farthest"),
            () if extent > MOST_MEDIANS * median => {
                format!("is {extent:.0e} m across, {:.0e} times the median of all objects", extent / median)
            }
            () => continue,
        };
        return Err(PlanError::Extent { object: object.name.clone(), what });
    }
    Ok(())
}

/// Bounds of an object's triangles, those left out that are not finite: they are neither lit nor in the way.
#[derive(Clone, Copy)]
struct Box {
    low: [f64; 3],
    high: [f64; 3],
}

impl Box {
    fn of(world: &World, object: usize) -> Self {
        let mut bounds = Box { low: [f64::INFINITY; 3], high: [f64::NEG_INFINITY; 3] };
        let triangles = world.object_start[object] as usize..world.object_start[object + 1] as usize;
        for corners in world.positions[triangles].iter().filter(|corners| corners.as_flattened().iter().all(|x| x.is_finite())) {
            for corner in corners {
                for k in 0..3 {
                    bounds.low[k] = bounds.low[k].min(f64::from(corner[k]));
                    bounds.high[k] = bounds.high[k].max(f64::from(corner[k]));
                }
            }
        }
        bounds
    }

    /// Longest side, metres; not above 0 for a box without a corner.
    fn extent(&self) -> f64 {
        (0..3).map(|k| self.high[k] - self.low[k]).fold(0.0, f64::max)
    }

    /// Largest coordinate, metres.
    fn reach(&self) -> f64 {
        self.low.iter().chain(&self.high).map(|x| x.abs()).filter(|x| x.is_finite()).fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::test_scenes::*;

    fn check(sizes: &[f32]) -> Result<(), PlanError> {
        let mut scene = scene();
        for (i, size) in sizes.iter().enumerate() {
            add(&mut scene, &format!("object {i}"), vec![quad([0.0; 3], [*size, 0.0, 0.0], [0.0, 0.5 * size, 0.0], 0)], IDENTITY);
        }
        check_extents(&scene, &World::build(&scene))
    }

    #[test]
    fn what_is_out_of_all_proportion_is_named_and_what_is_merely_large_is_not() {
        assert_eq!(check(&[]), Ok(()));
        assert_eq!(check(&[0.0]), Ok(()));
        assert_eq!(check(&[1e-3, 1.0, 2e3, 1e3]), Ok(()));
        assert_eq!(check(&[1e12]), Ok(()), "alone it is its own measure");
        for sizes in [&[1.0, 2.0, 3e38, 1.0][..], &[1.0, 1.0, 3e7], &[0.5, 1e-6, 1e8], &[1.0, 1.0, 2e18]] {
            let error = check(sizes).unwrap_err().to_string();
            assert!(error.contains("'object 2'") && error.contains("help: "), "{error}");
        }
        assert!(check(&[3e38]).unwrap_err().to_string().contains("from the origin"));
    }
}
