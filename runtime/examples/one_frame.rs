//! A picture of an asset in 30 lines: open, light, camera, PNG.
//!
//! `cargo run -p prelight-runtime --example one_frame -- room.prelight sky.hdr room.png`; without arguments a box under a clear sky.

use prelight_runtime::{Aligned, Asset, Background, Camera, Environment, FrameOptions, LightCubemap, Limits, Relighter, sky};

static BOX: &Aligned<[u8]> = &Aligned(*include_bytes!("box.prelight"));

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let asset = match arguments.first() {
        Some(file) => Asset::open_file(file.as_ref(), None)?,
        None => Asset::open_static("box.prelight", &BOX.0)?,
    };
    let environment = match arguments.get(1) {
        Some(file) => Environment::decode(file, &std::fs::read(file)?, &Limits::default())?.0,
        None => sky([0.5, 0.8, 0.3]),
    };
    let camera = match asset.cameras().first() {
        Some(scene) => scene.camera,
        None => Camera::upright([1.5, 1.0, 2.0], [0.0, 0.2, 0.0], 45.0)?,
    };
    let mut relighter = Relighter::new(asset);
    relighter.set_light(&LightCubemap::from_environment(&environment, relighter.asset().face_resolution()))?;
    let options = FrameOptions::default().background(Background::Environment(&environment));
    let frame = relighter.frame(&camera, [640, 480], options)?;
    let output = arguments.get(2).map_or("frame.png", String::as_str);
    std::fs::write(output, frame.to_png()?)?;
    println!("{output}");
    Ok(())
}
