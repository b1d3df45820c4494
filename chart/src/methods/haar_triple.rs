//! Haar triple products, \[NRH04\]: a share of the coefficients of light and of surface is kept.

use crate::clock::thread_nanoseconds;
use crate::contestant::{Contestant, InMotion, PatchLight, Shot};
use prelight_runtime::asset::AssetPatch;
use prelight_runtime::baseline::haar_triple::{HaarProjector, HaarTree, LobeSampler, VisibilityTree, kept_coefficients, triple_product};
use prelight_runtime::environment::LightCubemap;

/// Points whose surfaces are projected before their products are taken: asking for the time costs as much as a tenth of a product.
const RUN: usize = 16;

/// The method at several shares.
#[derive(Clone, Debug)]
pub struct HaarTriple {
    /// 0..=1 of 6·n² coefficients per channel.
    pub shares: Vec<f64>,
}

impl Default for HaarTriple {
    fn default() -> Self {
        HaarTriple { shares: vec![0.01, 0.1] }
    }
}

/// What one thread projects surfaces with.
pub struct Buffers {
    sampler: LobeSampler,
    projector: HaarProjector,
    lobes: Vec<HaarTree>,
}

impl Contestant for HaarTriple {
    type Budget = f64;
    type Tables = ();
    /// One tree a point.
    type Patch = Vec<VisibilityTree>;
    /// A tree, and how many coefficients are kept of a surface.
    type Light = (HaarTree, usize);
    type Buffers = Buffers;

    fn name(&self) -> &str {
        "haar_triple"
    }

    fn budgets(&self) -> Vec<f64> {
        self.shares.clone()
    }

    fn label(&self, share: &f64) -> String {
        format!("{} %", 100.0 * share)
    }

    fn style(&self) -> Option<usize> {
        Some(1)
    }

    fn is_dear(&self) -> bool {
        true
    }

    fn in_motion(&self, _: &f64) -> InMotion {
        InMotion::Left
    }

    fn tables(&self, _: &f64, _: usize) {}

    fn buffers(&self, face_resolution: usize) -> Buffers {
        Buffers {
            sampler: LobeSampler::new(face_resolution),
            projector: HaarProjector::new(face_resolution),
            lobes: vec![HaarTree::flat(face_resolution); RUN],
        }
    }

    fn convert(&self, (): &(), patch: &AssetPatch) -> Vec<VisibilityTree> {
        let visibility = patch.visibility();
        let n = visibility.face_resolution();
        (0..visibility.len()).map(|point| VisibilityTree::new(n, &visibility.point(point))).collect()
    }

    fn bytes(&self, _: &AssetPatch, trees: &Vec<VisibilityTree>) -> usize {
        trees.iter().map(VisibilityTree::bytes).sum()
    }

    fn prepare(&self, share: &f64, light: &LightCubemap) -> (HaarTree, usize) {
        let kept = kept_coefficients(light.face_resolution, *share);
        (HaarTree::from_light(light, kept), kept)
    }

    fn shade(
        &self,
        (light, kept): &(HaarTree, usize),
        shot: &Shot<'_, Vec<VisibilityTree>>,
        buffers: &mut Buffers,
        out: &mut PatchLight,
    ) -> f64 {
        let (position, surfaces) = (shot.patch.points().position, shot.patch.surfaces());
        let Buffers { sampler, projector, lobes } = buffers;
        let n_points = shot.n_points.min(shot.converted.len());
        let mut projection = 0.0;
        for first in (0..n_points).step_by(RUN) {
            let run = first..(first + RUN).min(n_points);
            let before = thread_nanoseconds();
            for (point, lobe) in run.clone().zip(&mut *lobes) {
                let normal = surfaces.normal[point];
                let values = sampler.sample(shot.path, normal, shot.toward_eye(position[point], normal), surfaces.roughness[point]);
                projector.project(values, *kept, lobe);
            }
            projection += thread_nanoseconds() - before;
            for (point, lobe) in run.zip(&*lobes) {
                let [irradiance, f0, rest] = triple_product(light, &shot.converted[point], lobe);
                let normal = surfaces.normal[point];
                out.irradiance[point] = irradiance.map(|e| normal.map(|n| e * n));
                out.glossy[point] = [f0, rest];
            }
        }
        projection
    }
}
