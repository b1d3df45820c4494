//! An app with its scene inside: no file is opened, and nothing of the arrays that shading reads is copied.
//!
//! `cargo run -p prelight-runtime --example embedded`. The asset was made with
//! `prelight bake box.glb --edge-length 0.5 && prelight pack box.prelight.json` from a floor and a box, its report emptied.

use prelight_runtime::asset::{Aligned, Asset};
use prelight_runtime::environment::{LightCubemap, sky};
use prelight_runtime::relight::Relighter;

/// The wrapper puts the bytes on a 64-byte boundary, where every array of the asset can be used as it lies.
static BOX: &Aligned<[u8]> = &Aligned(*include_bytes!("box.prelight"));

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let asset = Asset::open_static("box.prelight", &BOX.0)?;
    let embedded = BOX.0.as_ptr_range();
    for patch in asset.patches() {
        let first = patch.points().position.as_ptr().cast();
        assert!(embedded.contains(&first), "points are read where the program has them");
    }
    let mut relighter = Relighter::new(asset);
    for hour in [7.0f32, 12.0, 17.0] {
        let height = ((hour - 6.0) / 12.0 * std::f32::consts::PI).sin();
        let light = LightCubemap::from_environment(&sky([0.5, height, 0.3]), relighter.asset().face_resolution());
        relighter.set_light(&light)?;
        let shaded = relighter.shade([1.0, 1.0, 2.0], None)?;
        let mean: f32 = relighter.irradiance().iter().flatten().map(|axis| axis[1].abs()).sum::<f32>() / (3 * shaded) as f32;
        println!("{hour:>4} h: {shaded} points, mean vertical irradiance {mean:.2} W/m2");
    }
    Ok(())
}
