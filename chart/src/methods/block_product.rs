//! Block products: exact diffuse light, glossy light to an accuracy.

use crate::contestant::{Contestant, InMotion, PatchLight, Shot};
use prelight_runtime::asset::AssetPatch;
use prelight_runtime::block_product::Accuracy;
use prelight_runtime::block_product::Light;
use prelight_runtime::block_product::brdf::PointLobe;
use prelight_runtime::block_product::visibility::Visibility;
use prelight_runtime::block_product::{shade_diffuse, shade_lobes};
use prelight_runtime::environment::LightCubemap;

/// The method at several accuracies.
#[derive(Clone, Debug)]
pub struct BlockProduct {
    /// A relative 0 is the plain sum in f32.
    pub accuracies: Vec<Accuracy>,
}

impl Default for BlockProduct {
    fn default() -> Self {
        let loose = Accuracy { relative: 0.3, ..Accuracy::DISPLAY };
        let fine = |relative: f32| Accuracy { relative, ..Accuracy::FINE };
        BlockProduct { accuracies: vec![loose, Accuracy::DISPLAY, Accuracy::FINE, fine(1e-4), fine(0.0)] }
    }
}

impl Contestant for BlockProduct {
    type Budget = Accuracy;
    type Tables = ();
    type Patch = ();
    type Light = (Light, Accuracy);
    type Buffers = ();

    fn name(&self) -> &str {
        "block_product"
    }

    fn budgets(&self) -> Vec<Accuracy> {
        self.accuracies.clone()
    }

    fn label(&self, accuracy: &Accuracy) -> String {
        match *accuracy {
            Accuracy::DISPLAY => format!("display, {}", accuracy.relative),
            Accuracy::FINE => format!("fine, {}", accuracy.relative),
            _ => format!("tolerance {}", accuracy.relative),
        }
    }

    fn style(&self) -> Option<usize> {
        Some(0)
    }

    fn keeps_diffuse(&self) -> bool {
        true
    }

    fn in_motion(&self, accuracy: &Accuracy) -> InMotion {
        match accuracy.relative {
            0.0 => InMotion::Truth,
            // What is nearly exact does not flicker.
            relative if relative < Accuracy::DISPLAY.relative => InMotion::Left,
            _ => InMotion::Drawn,
        }
    }

    fn tables(&self, _: &Accuracy, _: usize) {}

    fn buffers(&self, _: usize) {}

    fn convert(&self, (): &(), _: &AssetPatch) {}

    fn bytes(&self, patch: &AssetPatch, (): &()) -> usize {
        chunk_bytes(&patch.visibility())
    }

    fn prepare(&self, accuracy: &Accuracy, light: &LightCubemap) -> (Light, Accuracy) {
        (Light::prepare(light), *accuracy)
    }

    fn shade(&self, (light, accuracy): &(Light, Accuracy), shot: &Shot<'_, ()>, (): &mut (), out: &mut PatchLight) -> f64 {
        let (visibility, surfaces) = (shot.patch.visibility(), shot.patch.surfaces());
        if !shot.has_diffuse {
            shade_diffuse(light, &visibility, &mut out.irradiance);
        }
        let lobe = |i: usize| PointLobe::ggx(surfaces.normal[i], surfaces.roughness[i]);
        let position = shot.patch.points().position;
        shade_lobes(shot.path, *accuracy, light, position, lobe, &visibility, shot.eye, &mut out.glossy);
        0.0
    }
}

/// Bytes that block products read of the visibility of a patch.
pub(super) fn chunk_bytes(visibility: &Visibility) -> usize {
    let point = |point: usize| {
        let point = visibility.point(point);
        let parts = point.fractions.map_or(0, |parts| 4 + size_of_val(parts.blocks) + parts.counts.len() + 2 * parts.len());
        4 + size_of_val(point.blocks) + point.counts.len() + point.transitions() + parts
    };
    // 64 bytes of padding and the array of starts belong to the patch.
    68 + (0..visibility.len()).map(point).sum::<usize>()
}
