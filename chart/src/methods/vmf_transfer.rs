//! Block products with the lobes of \[LD09\] for light that came over another surface; only of assets that have lobes.

use super::block_product::chunk_bytes;
use crate::contestant::{Contestant, PatchLight, Shot};
use prelight_runtime::asset::{Asset, AssetPatch};
use prelight_runtime::block_product::Light;
use prelight_runtime::block_product::{shade_diffuse, shade_glossy_with};
use prelight_runtime::environment::LightCubemap;
use prelight_runtime::sphere::icosahedron::{Icosahedron, MAX_LEVEL};
use prelight_runtime::vmf_transfer::FilteredLight;
use prelight_runtime::vmf_transfer::pixel::EyeLobes;
use prelight_runtime::vmf_transfer::shade::{add_glossy, add_irradiance};
use prelight_runtime::vmf_transfer::transfer::{Record, Transfer};

/// Tolerance of the direct light below lobes: far below what lobes lose.
const TOLERANCE: f32 = 1e-3;

/// The method; it has one budget.
#[derive(Clone, Copy, Debug, Default)]
pub struct VmfTransfer;

/// Suffix sums of the direct light, and one map a width of lobes.
pub struct Prepared {
    direct: Light,
    filtered: FilteredLight,
    solid: Icosahedron,
}

impl Contestant for VmfTransfer {
    type Budget = ();
    type Tables = ();
    type Patch = ();
    type Light = Prepared;
    type Buffers = ();

    fn name(&self) -> &str {
        "vmf_transfer"
    }

    fn budgets(&self) -> Vec<()> {
        vec![()]
    }

    fn label(&self, (): &()) -> String {
        "one bounce".to_string()
    }

    fn style(&self) -> Option<usize> {
        Some(3)
    }

    fn is_for(&self, asset: &Asset) -> bool {
        asset.patches().iter().any(|patch| patch.transfer().is_some())
    }

    fn is_direct(&self) -> bool {
        false
    }

    fn keeps_diffuse(&self) -> bool {
        true
    }

    fn tables(&self, (): &(), _: usize) {}

    fn buffers(&self, _: usize) {}

    fn convert(&self, (): &(), _: &AssetPatch) {}

    fn bytes(&self, patch: &AssetPatch, (): &()) -> usize {
        chunk_bytes(&patch.visibility()) + patch.transfer().map_or(0, |lobes| lobes_bytes(&lobes))
    }

    fn prepare(&self, (): &(), light: &LightCubemap) -> Prepared {
        Prepared { direct: Light::prepare(light), filtered: FilteredLight::prepare(light), solid: Icosahedron::new(MAX_LEVEL) }
    }

    fn shade(&self, light: &Prepared, shot: &Shot<'_, ()>, (): &mut (), out: &mut PatchLight) -> f64 {
        let Prepared { direct, filtered, solid } = light;
        let (points, surfaces, visibility) = (shot.patch.points(), shot.patch.surfaces(), shot.patch.visibility());
        let position = points.position;
        if !shot.has_diffuse {
            shade_diffuse(direct, &visibility, &mut out.irradiance);
        }
        shade_glossy_with(shot.path, TOLERANCE, direct, position, &surfaces, &visibility, shot.eye, &mut out.glossy);
        let Some(transfer) = shot.patch.transfer() else { return 0.0 };
        if !shot.has_diffuse {
            add_irradiance(filtered, &transfer, points.normal, &mut out.irradiance, &mut []);
        }
        out.lobes.resize(visibility.len(), EyeLobes::default());
        add_glossy(filtered, solid, &transfer, position, surfaces.normal, shot.eye, &mut out.glossy, &mut out.lobes);
        0.0
    }

    fn pixel_light<'a>(&self, light: &'a Prepared) -> Option<&'a FilteredLight> {
        Some(&light.filtered)
    }
}

/// Bytes of the records of all points; their levels and starts are a few more.
fn lobes_bytes(lobes: &Transfer) -> usize {
    (0..lobes.len()).map(|i| size_of::<Record>() * lobes.point(i).n_records()).sum()
}
