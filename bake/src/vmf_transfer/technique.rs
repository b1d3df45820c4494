//! The technique `vmf_transfer` as a bake sees it: which objects have indirect light, and how finely.

use super::baker::{LEVELS, SceneTransfer};
use super::transfer::TransferOptions;
use crate::factor::{SceneFactors, SceneInputs, Tally, Technique};
use prelight_manifests::Technique as Name;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::any::Any;
use std::sync::Arc;

/// Indirect light in lobes, for the objects that ask for it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VmfTransfer {
    /// `[objects]` how an object's indirect light is baked, if it is. May be shorter.
    pub objects: Vec<Option<TransferOptions>>,
    /// Surfaces between a point and the environment that indirect light crosses, at least 1.
    pub bounces: u32,
}

impl VmfTransfer {
    /// How an object's indirect light is baked, if it is.
    pub(crate) fn options_of(&self, object: u32) -> Option<&TransferOptions> {
        self.objects.get(object as usize).and_then(Option::as_ref)
    }

    /// Changes the options of every object of this technique in a list, where it is in it.
    pub fn change(techniques: &mut [Arc<dyn Technique>], change: impl Fn(&mut TransferOptions)) {
        for technique in techniques {
            if let Some(own) = (&**technique as &dyn Any).downcast_ref::<VmfTransfer>() {
                let mut changed = own.clone();
                changed.objects.iter_mut().flatten().for_each(&change);
                *technique = Arc::new(changed);
            }
        }
    }
}

impl Technique for VmfTransfer {
    fn name(&self) -> &str {
        Name::VMF_TRANSFER.name()
    }

    fn takes(&self, object: u32) -> bool {
        self.options_of(object).is_some()
    }

    fn begin<'a>(&'a self, inputs: &'a SceneInputs<'a>) -> Box<dyn SceneFactors + 'a> {
        Box::new(SceneTransfer::new(self, inputs))
    }

    fn parameters(&self) -> Option<Value> {
        serde_json::to_value(self).ok()
    }

    fn figures(&self, tally: &Tally) -> Vec<(&'static str, Value)> {
        let levels = LEVELS.map(|level| tally.of(level));
        let points: u64 = levels.iter().sum();
        // The mean over points with slices of their medians.
        let samples = (points > 0).then(|| tally.of("effective_samples") as f64 / points as f64);
        let options = self.objects.iter().flatten().next();
        let mut figures = vec![
            ("transfer.patches_traced", json!(tally.of("patches_traced"))),
            ("transfer.points_lit", json!(tally.of("lit_points"))),
            ("transfer.rays", json!(tally.of("rays"))),
            ("transfer.slices", json!(tally.of("slices"))),
            ("transfer.lobes", json!(tally.of("lobes"))),
            ("transfer.levels", json!(levels)),
            ("transfer.noise_limited", json!(tally.of("noise_limited"))),
            ("transfer.samples_per_slice", json!(samples)),
        ];
        if let Some(options) = options {
            figures.push(("transfer.slice_threshold", json!(options.views.budget)));
            figures.push(("transfer.edge_threshold", json!(options.mesh.budget)));
        }
        figures
    }
}
