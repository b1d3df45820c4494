//! A light that turns over a still camera: the view is kept, the light changes, and a lamp that flickers costs only what it changes.
//!
//! `cargo run --release -p prelight-runtime --example turning_light -- room.prelight`; without an argument a box.

use prelight_runtime::{Accuracy, Aligned, Asset, Background, Camera, LightCubemap, Relighter, Splatter, Style, sky};
use std::time::Instant;

static BOX: &Aligned<[u8]> = &Aligned(*include_bytes!("box.prelight"));

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let asset = match std::env::args().nth(1) {
        Some(file) => Asset::open_file(file.as_ref(), None)?,
        None => Asset::open_static("box.prelight", &BOX.0)?,
    };
    let camera = asset.cameras().first().map(|scene| scene.camera);
    let camera = camera.map_or_else(|| Camera::upright([1.5, 1.0, 2.0], [0.0, 0.2, 0.0], 45.0), Ok)?;
    let mut relighter = Relighter::new(asset);
    relighter.set_accuracy(Accuracy::DISPLAY);
    // Once for all frames: what the camera sees, and the buffers of the light.
    let view = relighter.view(&camera, [640, 480], 4)?;
    let n = relighter.asset().face_resolution();
    let (mut light, mut splatter) = (LightCubemap::black(n), Splatter::new(n));
    let noon = sky([0.5, 0.8, 0.3]);
    for step in 0..12 {
        let start = Instant::now();
        light.update_from(&noon.clone().with_rotation(30.0 * f64::from(step)), &mut splatter);
        relighter.set_light(&light)?;
        let shaded = relighter.shade(camera.eye, Some(&view.points))?;
        let frame = relighter.draw(&view, Background::Black, Style::Materials)?;
        let mean = frame.image.pixels.iter().flatten().sum::<f32>() / (3 * frame.image.pixels.len()) as f32;
        println!("{:>3} degrees: {shaded} points, mean radiance {mean:.3}, {:.1} ms", 30 * step, 1e3 * start.elapsed().as_secs_f64());
    }
    Ok(())
}
