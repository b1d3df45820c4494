//! What the pixels of normal maps need beside vector irradiance, from direct light: the same for every method.

use crate::contestant::PatchLight;
use prelight_runtime::asset::{Asset, AssetPatch};
use prelight_runtime::block_product::Light;
use prelight_runtime::block_product::SimdPath;
use prelight_runtime::block_product::shade_moments;
use prelight_runtime::environment::LightCubemap;
use prelight_runtime::light::lune::BentLight;
use prelight_runtime::surface::detail::is_bent;

/// `[points of the asset]`; empty where no shaded patch has a normal map. `shaded`: patches with their light.
pub fn lunes(asset: &Asset, light: &LightCubemap, shaded: &[(&AssetPatch, &PatchLight)]) -> Vec<BentLight> {
    let bent: Vec<_> = shaded.iter().filter(|(patch, _)| is_bent(&patch.surfaces(), asset.materials())).collect();
    if bent.is_empty() {
        return Vec::new();
    }
    let light = Light::prepare(light);
    let mut lunes = vec![BentLight::default(); asset.n_points()];
    for (patch, shaded) in bent {
        let (n, normal) = (patch.points.len(), patch.points().normal);
        let (mut direct, mut second) = (vec![[[0.0; 3]; 3]; n], vec![[0.0; 6]; n]);
        shade_moments(SimdPath::detect(), &light, &patch.visibility(), &mut direct, &mut second);
        for at in 0..n {
            // What a method adds to direct light comes along the normal.
            let added = std::array::from_fn(|c| (0..3).map(|k| (shaded.irradiance[at][c][k] - direct[at][c][k]) * normal[at][k]).sum());
            BentLight::add_even(&mut second[at], added);
            lunes[patch.points.start + at] = BentLight::new(&shaded.irradiance[at], second[at], normal[at]);
        }
    }
    lunes
}
