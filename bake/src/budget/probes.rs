//! Lights that errors are measured under. Part of the algorithm: they decide edge lengths, so they come from `libm` alone and never change
//! without a new algorithm version.

use prelight_runtime::block_product::Light;
use prelight_runtime::environment::{Environment, LightCubemap};
use prelight_runtime::environment::{sky, studio};

/// Texels along a face's side of the truth.
pub const TRUE_RESOLUTION: usize = 128;

/// Texels along a face's side of what stands in for the exact environment, where the grid's own error is asked for.
pub const EXACT_RESOLUTION: usize = 256;

/// A light as the bake shows it and as the truth has it.
#[derive(Debug)]
pub struct Probe {
    /// For people.
    pub name: String,
    /// One of [`Probes::held_back`].
    pub is_held_back: bool,
    /// At the bake's face resolution.
    pub shown: LightCubemap,
    /// The same, prepared for what is baked: its sums differ in the last bits from one instruction set to another, so they decide nothing.
    pub prepared: Light,
    /// At [`TRUE_RESOLUTION`].
    pub truth: LightCubemap,
    /// At [`EXACT_RESOLUTION`]; only of lights that judge.
    pub exact: Option<LightCubemap>,
}

/// Lights.
#[derive(Debug)]
pub struct Probes {
    /// In a fixed order.
    pub lights: Vec<Probe>,
}

impl Probes {
    /// From environments with their names; these judge.
    pub fn new(environments: Vec<(String, Environment)>, face_resolution: u32) -> Self {
        Self::with(environments, face_resolution, true)
    }

    fn with(environments: Vec<(String, Environment)>, face_resolution: u32, judge: bool) -> Self {
        let probe = |(name, environment): (String, Environment)| {
            let shown = LightCubemap::from_environment(&environment, face_resolution as usize).0;
            let truth = LightCubemap::from_environment(&environment, TRUE_RESOLUTION).0;
            let exact = judge.then(|| LightCubemap::from_environment(&environment, EXACT_RESOLUTION).0);
            Probe { name, exact, is_held_back: false, prepared: Light::prepare(&shown), shown, truth }
        };
        Probes { lights: environments.into_iter().map(probe).collect() }
    }

    /// Those that steer: suns all around, from 12° to 64° high, so that the border of each shadow comes over other places with each, and a studio
    /// from two sides.
    pub fn steering(face_resolution: u32) -> Self {
        let suns = [[0.5, 0.7, 0.4], [-0.8, 0.25, 0.3], [0.1, 0.5, -0.8], [-0.5, 0.6, -0.4], [0.9, 0.2, 0.1], [-0.1, 0.35, 0.9]];
        let mut lights: Vec<(String, Environment)> = suns.map(|sun| (format!("sun {sun:?}"), sky(sun))).into();
        lights.push(("studio".to_string(), studio()));
        lights.push(("studio turned".to_string(), studio().with_rotation(215.0)));
        Self::with(lights, face_resolution, false)
    }

    /// Those that judge: other suns, and the studio turned.
    pub fn held_back(face_resolution: u32) -> Self {
        let lights = vec![
            ("held-back high sun", sky([-0.3, 0.8, -0.5])),
            ("held-back low sun", sky([0.9, 0.3, -0.25])),
            ("held-back studio", studio().with_rotation(130.0)),
        ];
        let mut probes = Self::new(lights.into_iter().map(|(name, light)| (name.to_string(), light)).collect(), face_resolution);
        probes.lights.iter_mut().for_each(|probe| probe.is_held_back = true);
        probes
    }

    /// Of how many lights, which come first, the error is the one that judges.
    pub fn n_held_back(&self) -> usize {
        self.lights.iter().take_while(|probe| probe.is_held_back).count()
    }
}
