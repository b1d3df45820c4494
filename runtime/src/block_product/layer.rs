//! The layer: exact direct light at points, and from light to light only what changed.
//!
//! While lights follow each other by small changes, a point's row holds its own irradiance as two sets of nine floats, the second what the first
//! rounds away; a patch that was summed under the light before is then updated ([`super::change`]), any other summed anew. Patches with bent
//! normals are always summed anew: second moments have no update.

use super::change::{LightChange, update_diffuse};
use super::{Light, Visibility, shade_lobes, shade_moments};
use crate::chunk::layout::PATCH_POINTS;
use crate::environment::LightCubemap;
use crate::light::layer::{Diffuse, Held, Layer, LightOptions, Patch, Remembered, Rows, Sight};
use crate::light::{Accuracy, Glossy, SimdPath};
use prelight_manifests::ChunkKind;

/// Floats of a vector irradiance.
const IRRADIANCE: usize = 9;

/// Direct light through visibility.
pub(crate) struct BlockProduct {
    light: Option<Light>,
    accuracy: Accuracy,
    /// While lights are changes of each other.
    following: Option<Following>,
}

/// What is known of the light before.
struct Following {
    /// `None` where a full pass is better.
    change: Option<LightChange>,
    /// Most flux of the lights that patches were summed under.
    at_full: f64,
}

impl BlockProduct {
    /// A layer without light.
    pub(crate) fn new() -> Self {
        BlockProduct { light: None, accuracy: LightOptions::default().accuracy, following: None }
    }
}

impl Default for BlockProduct {
    fn default() -> Self {
        BlockProduct::new()
    }
}

impl Following {
    fn next(last: Option<Following>, before: &LightCubemap, light: &LightCubemap) -> Self {
        let now: f64 = light.flux.as_flattened().iter().map(|flux| f64::from(*flux)).sum();
        // Under the first change, rows do not hold the light before.
        let change = last.as_ref().map(|last| (LightChange::between(before, light), last.at_full));
        match change.filter(|(change, at_full)| change.allows(*at_full, now)) {
            Some((change, at_full)) => Following { change: Some(change), at_full: at_full.max(now) },
            None => Following { change: None, at_full: now },
        }
    }
}

impl Layer for BlockProduct {
    fn remembers(&self) -> Remembered {
        Remembered { diffuse: if self.following.is_some() { 2 * IRRADIANCE } else { 0 }, ..Remembered::default() }
    }

    fn configure(&mut self, options: &LightOptions, _: Option<&LightCubemap>) -> bool {
        self.accuracy = options.accuracy;
        false
    }

    fn prepare(&mut self, light: &LightCubemap, before: Option<&LightCubemap>) {
        match &mut self.light {
            Some(prepared) => prepared.update(light),
            None => self.light = Some(Light::prepare(light)),
        }
        let last = self.following.take();
        self.following = before.map(|before| Following::next(last, before, light));
    }

    fn diffuse(&self, patch: &Patch, held: Held, rows: &mut Rows, out: &mut Diffuse) {
        let Some((light, visibility)) = self.light.as_ref().zip(visibility(patch)) else { return };
        let Some(following) = &self.following else {
            return out.write(|irradiance, second| shade_moments(SimdPath::detect(), light, &visibility, irradiance, second));
        };
        let mut low = [[[0.0; 3]; 3]; PATCH_POINTS];
        let low = &mut low[..patch.len()];
        let change = following.change.as_ref().filter(|_| held == Held::LightBefore && !out.has_moments());
        out.write(|high, second| {
            match change {
                Some(change) => {
                    for i in 0..high.len() {
                        let (first, rest) = rows.of(i).split_at(IRRADIANCE);
                        high[i].as_flattened_mut().copy_from_slice(first);
                        low[i].as_flattened_mut().copy_from_slice(rest);
                    }
                    update_diffuse(change, &visibility, high, low);
                }
                None => shade_moments(SimdPath::detect(), light, &visibility, high, second),
            }
            for i in 0..high.len() {
                let (first, rest) = rows.of(i).split_at_mut(IRRADIANCE);
                first.copy_from_slice(high[i].as_flattened());
                rest.copy_from_slice(low[i].as_flattened());
            }
        });
    }

    fn glossy(&self, patch: &Patch, sight: &Sight, _: &mut Rows, out: &mut [Glossy]) {
        let Some((light, visibility)) = self.light.as_ref().zip(visibility(patch)) else { return };
        let mut own = [Glossy::default(); PATCH_POINTS];
        let own = &mut own[..patch.len()];
        let lobe = |i: usize| sight.lobes[i];
        shade_lobes(SimdPath::detect(), self.accuracy, light, patch.points.position, lobe, &visibility, sight.eye, own);
        out.as_flattened_mut().as_flattened_mut().iter_mut().zip(own.as_flattened().as_flattened()).for_each(|(sum, own)| *sum += own);
    }

    fn coat(&self, patch: &Patch, sight: &Sight, out: &mut [Glossy]) {
        self.glossy(patch, sight, &mut Rows::none(), out);
    }
}

fn visibility<'a>(patch: &Patch<'a>) -> Option<Visibility<'a>> {
    patch.factor(ChunkKind::Visibility).map(Visibility::from_proven_chunk)
}
