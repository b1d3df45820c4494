//! Sums over texels: tiled SIMD for diffuse light, over the open texels for glossy.

use crate::contestant::{Contestant, InMotion, PatchLight, Shot};
use prelight_runtime::asset::AssetPatch;
use prelight_runtime::baseline::dense::{self, PixelLight};
use prelight_runtime::block_product::Light;
use prelight_runtime::block_product::shade_glossy_with;
use prelight_runtime::block_product::visibility::open_words;
use prelight_runtime::environment::LightCubemap;

/// The method; it has one budget.
#[derive(Clone, Copy, Debug, Default)]
pub struct PixelSums;

impl Contestant for PixelSums {
    type Budget = ();
    type Tables = ();
    /// One bit a texel.
    type Patch = Vec<u64>;
    /// Planar texels, and the pyramid whose finest level the glossy sum reads.
    type Light = (PixelLight, Light);
    type Buffers = ();

    fn name(&self) -> &str {
        "pixel_sums"
    }

    fn budgets(&self) -> Vec<()> {
        vec![()]
    }

    fn label(&self, (): &()) -> String {
        "all texels".to_string()
    }

    fn style(&self) -> Option<usize> {
        Some(4)
    }

    fn keeps_diffuse(&self) -> bool {
        true
    }

    fn in_motion(&self, (): &()) -> InMotion {
        InMotion::Left
    }

    fn tables(&self, (): &(), _: usize) {}

    fn buffers(&self, _: usize) {}

    fn convert(&self, (): &(), patch: &AssetPatch) -> Vec<u64> {
        let visibility = patch.visibility();
        let n = visibility.face_resolution();
        let mut bits = vec![0; visibility.len() * open_words(n)];
        for (point, words) in bits.chunks_exact_mut(open_words(n)).enumerate() {
            visibility.point(point).to_open_bits(n, words);
        }
        bits
    }

    fn bytes(&self, _: &AssetPatch, bits: &Vec<u64>) -> usize {
        size_of_val(&bits[..])
    }

    fn prepare(&self, (): &(), light: &LightCubemap) -> (PixelLight, Light) {
        (PixelLight::new(light), Light::prepare(light))
    }

    fn shade(&self, (pixels, light): &(PixelLight, Light), shot: &Shot<'_, Vec<u64>>, (): &mut (), out: &mut PatchLight) -> f64 {
        if !shot.has_diffuse {
            dense::vector_tiled(shot.path, pixels, shot.converted, &mut out.irradiance);
        }
        let (position, surfaces, visibility) = (shot.patch.points().position, shot.patch.surfaces(), shot.patch.visibility());
        shade_glossy_with(shot.path, 0.0, light, position, &surfaces, &visibility, shot.eye, &mut out.glossy);
        0.0
    }
}
