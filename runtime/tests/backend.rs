//! A backend of another crate: it gets what it needs through the seam, and nothing of the CPU's.

use prelight_runtime::asset::{Aligned, Asset};
use prelight_runtime::draw::{Camera, Frame, FrameOptions, Image};
use prelight_runtime::environment::{LightCubemap, sky};
use prelight_runtime::error::RuntimeError;
use prelight_runtime::light::LightOptions;
use prelight_runtime::relight::Relighter;
use prelight_runtime::relight::backend::{Backend, DrawJob, ShadeJob};

static BOX: &Aligned<[u8]> = &Aligned(*include_bytes!("../examples/box.prelight"));

/// Lights every point, and draws the share of lit points where anything is seen.
struct Flat;

#[derive(Default)]
struct Held {
    positions: Vec<[f32; 3]>,
    flux: f32,
    lit: usize,
}

impl Backend for Flat {
    type Asset = Held;

    fn upload(&self, asset: &Asset) -> Result<Held, RuntimeError> {
        let positions = asset.patches().iter().flat_map(|patch| patch.view().points.position).copied().collect();
        Ok(Held { positions, ..Held::default() })
    }

    fn configure(&self, _: &mut Held, _: &LightOptions, _: Option<&LightCubemap>) {}

    fn prepare(&self, held: &mut Held, light: &LightCubemap, _: Option<&LightCubemap>) -> Result<(), RuntimeError> {
        (held.flux, held.lit) = (light.flux.as_flattened().iter().sum(), 0);
        Ok(())
    }

    fn shade(&self, held: &mut Held, job: &ShadeJob) -> Result<usize, RuntimeError> {
        held.lit = job.wanted.map_or(held.positions.len(), |wanted| wanted.iter().filter(|wanted| **wanted).count());
        Ok(held.lit)
    }

    fn draw(&self, held: &Held, job: &DrawJob) -> Result<Frame, RuntimeError> {
        let [width, height] = job.view.size;
        let image = Image { width, height, pixels: vec![[held.lit as f32 / held.positions.len() as f32; 3]; width * height] };
        Ok(Frame { image, coverage: vec![1.0; width * height], mask: vec![true; width * height] })
    }
}

#[test]
fn a_backend_of_another_crate_makes_frames() {
    let asset = Asset::open_static("box.prelight", &BOX.0).unwrap();
    let light = LightCubemap::from_environment(&sky([0.3, 0.8, 0.2]), asset.face_resolution());
    let mut relighter = Relighter::with_backend(asset, Flat).unwrap();
    let camera = Camera::upright([1.5, 1.0, 2.0], [0.0, 0.2, 0.0], 40.0).unwrap();
    assert!(matches!(relighter.frame(&camera, [8, 6], FrameOptions::default()), Err(RuntimeError::NoLight)));
    relighter.set_light(&light).unwrap();
    let frame = relighter.frame(&camera, [8, 6], FrameOptions::default()).unwrap();
    assert!(frame.image.pixels.iter().flatten().all(|x| *x > 0.0 && *x <= 1.0));
}
