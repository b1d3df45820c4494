//! A relighter answers a call that comes too early, or does not fit, with an error, and what it is told shows at once.

use prelight_runtime::asset::{Aligned, Asset};
use prelight_runtime::draw::{Camera, FrameOptions, Style};
use prelight_runtime::environment::{LightCubemap, sky};
use prelight_runtime::error::RuntimeError;
use prelight_runtime::light::layer::Highlights;
use prelight_runtime::relight::Relighter;
use std::sync::Arc;

static BOX: &Aligned<[u8]> = &Aligned(*include_bytes!("../examples/box.prelight"));

fn asset() -> Arc<Asset> {
    Arc::new(Asset::open_static("box.prelight", &BOX.0).unwrap())
}

fn camera() -> Camera {
    Camera::upright([1.5, 1.0, 2.0], [0.0, 0.2, 0.0], 40.0).unwrap()
}

#[test]
fn shading_before_a_light_is_an_error_and_a_light_of_another_size_is_refused_at_once() {
    let asset = asset();
    let mut relighter = Relighter::new(asset.clone());
    assert!(matches!(relighter.shade([1.0; 3], None), Err(RuntimeError::NoLight)));
    assert!(matches!(relighter.frame(&camera(), [16, 12], FrameOptions::default()), Err(RuntimeError::NoLight)));
    let other = if asset.face_resolution() == 64 { 128 } else { 64 };
    let light = LightCubemap::from_environment(&sky([0.3, 0.8, 0.2]), other);
    let refused = |result: Result<(), RuntimeError>| matches!(result, Err(RuntimeError::FaceResolution { found, .. }) if found == other);
    assert!(refused(relighter.set_light(&light)) && refused(relighter.change_light(&light)));
    assert!(matches!(relighter.shade([1.0; 3], None), Err(RuntimeError::NoLight)), "nothing was taken");
    relighter.set_light(&LightCubemap::from_environment(&sky([0.3, 0.8, 0.2]), asset.face_resolution())).unwrap();
    assert!(matches!(relighter.shade([1.0; 3], Some(&[true])), Err(RuntimeError::Points { found: 1, .. })));
    assert_eq!(relighter.shade([1.0; 3], None).unwrap(), asset.n_points());
}

#[test]
fn a_frame_is_its_parts_and_the_relighter_may_go_anywhere() {
    let asset = asset();
    let light = LightCubemap::from_environment(&sky([0.3, 0.8, 0.2]), asset.face_resolution());
    let mut relighter = Relighter::new(asset);
    relighter.set_light(&light).unwrap();
    let options = FrameOptions::default().samples(4);
    let whole = std::thread::spawn(move || {
        let frame = relighter.frame(&camera(), [32, 24], options).unwrap();
        (relighter, frame)
    });
    let (mut relighter, whole) = whole.join().unwrap();
    let view = relighter.view(&camera(), [32, 24], 4).unwrap();
    relighter.shade(camera().eye, Some(&view.points)).unwrap();
    assert!(whole == relighter.draw(&view, options.background, Style::Materials).unwrap());
    let clay = relighter.frame(&camera(), [32, 24], options.style(Style::Clay)).unwrap();
    assert!(clay.image.pixels != whole.image.pixels && clay.coverage == whole.coverage);
}

#[test]
fn highlights_asked_for_under_a_light_are_those_asked_for_before_it() {
    let asset = asset();
    let light = LightCubemap::from_environment(&sky([0.3, 0.8, 0.2]), asset.face_resolution());
    let picture = |late: bool, highlights: Highlights| {
        let mut relighter = Relighter::new(asset.clone());
        if !late {
            relighter.set_highlights(highlights);
        }
        relighter.set_light(&light).unwrap();
        if late {
            relighter.set_highlights(highlights);
        }
        relighter.frame(&camera(), [48, 32], FrameOptions::default().samples(4)).unwrap().image
    };
    assert!(picture(true, Highlights::PerPixel) == picture(false, Highlights::PerPixel));
    assert!(picture(true, Highlights::Interpolated) == picture(false, Highlights::Interpolated));
}
