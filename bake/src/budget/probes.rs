//! Lights that errors are measured under. Part of the algorithm: they decide edge lengths, so they come from `libm` alone and never change
//! without a new algorithm version.

use prelight_runtime::block_product::Light;
use prelight_runtime::environment::{Environment, LightCubemap};
use prelight_runtime::environment::{sky, studio};

/// Texels along a face's side of the truth.
pub const TRUE_RESOLUTION: usize = 128;

/// A light as the bake shows it and as the truth has it.
#[derive(Debug)]
pub struct Probe {
    /// For people.
    pub name: String,
    /// At the bake's face resolution.
    pub shown: LightCubemap,
    /// The same, prepared for what is baked.
    pub prepared: Light,
    /// At [`TRUE_RESOLUTION`].
    pub truth: LightCubemap,
}

/// Lights.
#[derive(Debug)]
pub struct Probes {
    /// In a fixed order.
    pub lights: Vec<Probe>,
}

impl Probes {
    /// From environments with their names.
    pub fn new(environments: Vec<(String, Environment)>, face_resolution: u32) -> Self {
        let probe = |(name, environment): (String, Environment)| {
            let shown = LightCubemap::from_environment(&environment, face_resolution as usize).0;
            let truth = LightCubemap::from_environment(&environment, TRUE_RESOLUTION).0;
            Probe { name, prepared: Light::prepare(&shown), shown, truth }
        };
        Probes { lights: environments.into_iter().map(probe).collect() }
    }

    /// Those that steer: two suns, one high and one low, and a studio.
    pub fn steering(face_resolution: u32) -> Self {
        let lights = vec![("high sun", sky([0.5, 0.7, 0.4])), ("low sun", sky([-0.8, 0.25, 0.3])), ("studio", studio())];
        Self::new(lights.into_iter().map(|(name, light)| (name.to_string(), light)).collect(), face_resolution)
    }

    /// Those that judge: other suns, and the studio turned.
    pub fn held_back(face_resolution: u32) -> Self {
        let lights = vec![
            ("held-back high sun", sky([-0.3, 0.8, -0.5])),
            ("held-back low sun", sky([0.9, 0.3, -0.25])),
            ("held-back studio", studio().with_rotation(130.0)),
        ];
        Self::new(lights.into_iter().map(|(name, light)| (name.to_string(), light)).collect(), face_resolution)
    }
}
