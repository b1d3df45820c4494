//! Lights that errors are measured under. Part of the algorithm: they decide edge lengths, so they come from `libm` alone and never change
//! without a new algorithm version.
//!
//! A budget is a promise for lights like real ones, so the probes are such lights: a sun anywhere in a clear sky, a round lamp or window anywhere in a
//! dim room, an overcast sky. A sun's disc is 1.8° across and gives four times what the sky gives; no probe is a single texel of 10⁵ times the rest, and
//! nothing is promised for one.
//!
//! ```text
//! steer   48 suns and 24 lamps (5° to 16° in radius), each kind on a spiral; overcast, clear without a sun, the dim room
//! judge   12 suns and 6 lamps in directions drawn from a fixed seed, two skies and two studios as `environment` makes them, turned by the same seed
//! ```
//!
//! Both have the same share of suns, which are what few points show badly. Those that judge never steer, and were drawn before anything was measured
//! under them; the seed is a new one whenever what steers, or the margin, was chosen by looking at them.

use super::lit::RunningMoments;
use prelight_runtime::environment::{Environment, LightCubemap, sky, studio};
use prelight_runtime::sphere::cubemap::{row_major_from_hilbert, texel_unit_direction};
use std::f64::consts::PI;

/// Texels along a face's side of the truth.
pub(crate) const TRUE_RESOLUTION: usize = 128;

/// Texels along a face's side of what stands in for the exact environment, where the grid's own error is asked for.
pub(crate) const EXACT_RESOLUTION: usize = 256;

/// Seed of the directions of probes that judge.
const HELD_BACK_SEED: u64 = 20_261_123;

/// Angular radius of a sun, degrees.
const SUN_RADIUS: f64 = 0.9;
/// Irradiance of a surface that faces a sun; the clear sky gives about one.
const SUN: [f64; 3] = [4.0, 3.7, 3.1];
/// Irradiance of a point that faces a lamp; the room gives about 0.16.
const LAMP: [f64; 3] = [1.6, 1.5, 1.4];

/// Light that probes share.
#[derive(Debug)]
pub(super) struct Dome {
    /// At the bake's face resolution.
    pub shown: RunningMoments,
    /// At [`TRUE_RESOLUTION`].
    pub truth: LightCubemap,
    /// At [`EXACT_RESOLUTION`]; only of lights that judge.
    pub exact: Option<LightCubemap>,
}

/// A texel's number and the light in it.
type Lit = (u32, [[f32; 3]; 3]);

/// A light as the bake shows it and as the truth has it.
#[derive(Debug)]
pub struct Probe {
    /// For people.
    pub name: String,
    /// One of [`Probes::held_back`].
    pub is_held_back: bool,
    pub(super) dome: usize,
    pub(super) truth_lamps: Vec<Lit>,
    pub(super) exact_lamps: Vec<Lit>,
}

/// Lights.
#[derive(Debug)]
pub struct Probes {
    /// In a fixed order.
    pub lights: Vec<Probe>,
    pub(super) face_resolution: usize,
    pub(super) domes: Vec<Dome>,
    /// Hilbert position, probe and light of every lit texel of every lamp at the bake's face resolution, in that order.
    pub(super) shown_lamps: Vec<(u32, u32, [[f32; 3]; 3])>,
}

/// A round lamp.
#[derive(Clone, Copy, Debug)]
struct Lamp {
    direction: [f64; 3],
    /// Degrees.
    radius: f64,
    /// Irradiance of a surface that faces it.
    irradiance: [f64; 3],
}

impl Probes {
    /// From environments with their names; these judge.
    pub fn new(environments: Vec<(String, Environment)>, face_resolution: u32) -> Self {
        let mut probes = Self::none(face_resolution);
        for (name, environment) in environments {
            let dome = probes.add_dome(&environment, true);
            probes.lights.push(Probe { name, is_held_back: false, dome, truth_lamps: Vec::new(), exact_lamps: Vec::new() });
        }
        probes
    }

    fn none(face_resolution: u32) -> Self {
        Probes { lights: Vec::new(), face_resolution: face_resolution as usize, domes: Vec::new(), shown_lamps: Vec::new() }
    }

    fn add_dome(&mut self, environment: &Environment, judge: bool) -> usize {
        let light = |n: usize| LightCubemap::from_environment(environment, n);
        let exact = judge.then(|| light(EXACT_RESOLUTION));
        self.domes.push(Dome { shown: RunningMoments::new(&light(self.face_resolution)), truth: light(TRUE_RESOLUTION), exact });
        self.domes.len() - 1
    }

    /// A probe for each lamp under a dome. Lamps stand apart: one image holds them all.
    fn add_lamps(&mut self, kind: &str, dome: usize, lamps: &[Lamp], judge: bool) {
        let image = painted_lamps(lamps);
        let split = |n: usize| {
            let light = LightCubemap::from_environment(&image, n);
            let mut of: Vec<Vec<Lit>> = vec![Vec::new(); lamps.len()];
            for (texel, moment) in light.moment.iter().enumerate().filter(|(_, moment)| **moment != [[0.0; 3]; 3]) {
                let at = texel_unit_direction(n, texel / (n * n), texel % n, texel / n % n).map(f64::from);
                let near = |lamp: &Lamp| dot(at, lamp.direction);
                let nearest = (0..lamps.len()).max_by(|a, b| near(&lamps[*a]).total_cmp(&near(&lamps[*b]))).expect("a lamp is lit");
                of[nearest].push((texel as u32, *moment));
            }
            of
        };
        let first = self.lights.len() as u32;
        let n = self.face_resolution;
        let mut position = vec![0u32; n * n];
        row_major_from_hilbert(n).iter().enumerate().for_each(|(at, texel)| position[*texel as usize] = at as u32);
        for (lamp, texels) in split(n).into_iter().enumerate() {
            let at = |texel: usize| (texel / (n * n) * n * n) as u32 + position[texel % (n * n)];
            self.shown_lamps.extend(texels.into_iter().map(|(texel, moment)| (at(texel as usize), first + lamp as u32, moment)));
        }
        self.shown_lamps.sort_unstable_by_key(|(position, probe, _)| (*position, *probe));
        let mut exact = if judge { split(EXACT_RESOLUTION) } else { vec![Vec::new(); lamps.len()] };
        for (i, (lamp, truth_lamps)) in lamps.iter().zip(split(TRUE_RESOLUTION)).enumerate() {
            let name = format!("{kind} {:.0?}", lamp.direction.map(|x| 100.0 * x));
            self.lights.push(Probe { name, is_held_back: false, dome, truth_lamps, exact_lamps: std::mem::take(&mut exact[i]) });
        }
    }

    /// Adds the lights of others, after these.
    ///
    /// # Panics
    /// When they are for another face resolution.
    pub fn extend(&mut self, others: Probes) {
        assert_eq!(self.face_resolution, others.face_resolution, "probes for one bake");
        let (domes, lights) = (self.domes.len(), self.lights.len() as u32);
        self.domes.extend(others.domes);
        self.lights.extend(others.lights.into_iter().map(|probe| Probe { dome: domes + probe.dome, ..probe }));
        self.shown_lamps.extend(others.shown_lamps.into_iter().map(|(position, probe, moment)| (position, lights + probe, moment)));
        self.shown_lamps.sort_unstable_by_key(|(position, probe, _)| (*position, *probe));
    }

    /// Those that steer.
    pub fn steering(face_resolution: u32) -> Self {
        let mut probes = Self::none(face_resolution);
        let [clear, overcast, room] = [clear_sky(), overcast_sky(), dim_room()].map(|image| probes.add_dome(&image, false));
        let golden = PI * (3.0 - 5f64.sqrt());
        let suns: Vec<Lamp> = (0..48)
            .map(|i| {
                // Sines of 8° to 75°.
                let height = 0.139 + (0.966 - 0.139) * (f64::from(i) + 0.5) / 48.0;
                Lamp { direction: direction(height, golden * f64::from(i)), radius: SUN_RADIUS, irradiance: SUN }
            })
            .collect();
        probes.add_lamps("sun", clear, &suns, false);
        let lamps: Vec<Lamp> = (0..24)
            .map(|i| {
                // From 10° below to 64° above; large ones in turn with small ones.
                let height = -0.17 + 1.07 * (f64::from(i) + 0.5) / 24.0;
                Lamp {
                    direction: direction(height, 1.0 + golden * f64::from(i)),
                    radius: 5.0 + 1.5 * f64::from(i * 3 % 8),
                    irradiance: LAMP,
                }
            })
            .collect();
        probes.add_lamps("lamp", room, &lamps, false);
        let plain = |name: &str, dome| Probe {
            name: name.to_string(),
            is_held_back: false,
            dome,
            truth_lamps: Vec::new(),
            exact_lamps: Vec::new(),
        };
        probes.lights.extend([plain("overcast", overcast), plain("clear", clear), plain("dim room", room)]);
        probes
    }

    /// Those that judge.
    pub fn held_back(face_resolution: u32) -> Self {
        let mut probes = Self::none(face_resolution);
        let mut counter = 0;
        let mut random = || {
            counter += 1;
            super::places::unit(HELD_BACK_SEED, counter, 0)
        };
        let mut drawn = |n: usize, heights: [f64; 2], radius: [f64; 2], irradiance: [f64; 3]| {
            let mut lamps: Vec<Lamp> = Vec::new();
            while lamps.len() < n {
                let direction = direction(heights[0] + (heights[1] - heights[0]) * random(), 2.0 * PI * random());
                let lamp = Lamp { direction, radius: radius[0] + (radius[1] - radius[0]) * random(), irradiance };
                // One image holds them all: their texels stay apart.
                let apart = |other: &Lamp| dot(other.direction, direction) < libm::cos((other.radius + lamp.radius + 6.0) * PI / 180.0);
                if lamps.iter().all(apart) {
                    lamps.push(lamp);
                }
            }
            lamps
        };
        let (suns, lamps) = (drawn(12, [0.139, 0.966], [SUN_RADIUS; 2], SUN), drawn(6, [-0.17, 0.9], [5.0, 16.0], LAMP));
        let turned = [random(), random()].map(|turn| 360.0 * turn);
        let skies = [random(), random()].map(|turn| direction(0.139 + 0.827 * turn, 2.0 * PI * random()).map(|x| x as f32));
        let [clear, room] = [clear_sky(), dim_room()].map(|image| probes.add_dome(&image, true));
        probes.add_lamps("held-back sun", clear, &suns, true);
        probes.add_lamps("held-back lamp", room, &lamps, true);
        let whole = (skies.iter().map(|sun| (format!("held-back sky {sun:.2?}"), sky(*sun))))
            .chain(turned.iter().map(|turn| (format!("held-back studio {turn:.0}"), studio().with_rotation(*turn))));
        probes.extend(Self::new(whole.collect(), face_resolution));
        probes.lights.iter_mut().for_each(|probe| probe.is_held_back = true);
        probes
    }

    /// Number of lights, the first ones, whose error is the one that judges.
    pub fn n_held_back(&self) -> usize {
        self.lights.iter().take_while(|probe| probe.is_held_back).count()
    }
}

/// A unit direction by the sine of its height and its longitude.
fn direction(height: f64, longitude: f64) -> [f64; 3] {
    let level = (1.0 - height * height).sqrt();
    [level * libm::cos(longitude), height, level * libm::sin(longitude)]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// A clear sky over brown ground, without a sun.
fn clear_sky() -> Environment {
    painted(|height| {
        let (zenith, horizon, ground) = ([0.10, 0.22, 0.50], [0.48, 0.56, 0.66], [0.17, 0.14, 0.11]);
        let haze = libm::exp(-height.abs() * if height < 0.0 { 25.0 } else { 5.0 });
        let far = if height < 0.0 { ground } else { zenith };
        std::array::from_fn(|c| far[c] + (horizon[c] - far[c]) * haze)
    })
}

/// Three times as bright above as at the horizon (the CIE's overcast sky), over ground.
fn overcast_sky() -> Environment {
    painted(|height| [if height < 0.0 { 0.06 } else { 0.4 * (1.0 + 2.0 * height) / 3.0 }; 3])
}

/// Walls of one radiance.
fn dim_room() -> Environment {
    painted(|_| [0.05; 3])
}

/// An image of a function of the sine of the height.
fn painted(radiance: impl Fn(f64) -> [f64; 3]) -> Environment {
    const SIZE: [usize; 2] = [128, 64];
    let mut image = Environment::new(SIZE[0], SIZE[1], vec![[0.0; 3]; SIZE[0] * SIZE[1]]);
    for y in 0..SIZE[1] {
        let row = radiance(image.direction_from_pixel(0.0, y as f64 + 0.5)[1]).map(|x| x as f32);
        image.pixels[y * SIZE[0]..][..SIZE[0]].fill(row);
    }
    image
}

/// Lamps on black, averaged over 4×4 samples a pixel of 0.7°.
fn painted_lamps(lamps: &[Lamp]) -> Environment {
    const SIZE: [usize; 2] = [512, 256];
    const SIDE: usize = 4;
    let mut image = Environment::new(SIZE[0], SIZE[1], vec![[0.0; 3]; SIZE[0] * SIZE[1]]);
    let longitudes: Vec<[f64; 2]> = (0..SIZE[0] * SIDE)
        .map(|x| {
            let [cosine, _, sine] = image.direction_from_pixel((x as f64 + 0.5) / SIDE as f64, 0.5 * SIZE[1] as f64);
            [cosine, sine]
        })
        .collect();
    for y in 0..SIZE[1] * SIDE {
        let height = image.direction_from_pixel(0.0, (y as f64 + 0.5) / SIDE as f64)[1];
        let level = (1.0 - height * height).max(0.0).sqrt();
        for lamp in lamps {
            let (least, angle) = (libm::cos(lamp.radius * PI / 180.0), lamp.radius * PI / 180.0);
            // Rows that the lamp does not reach.
            if (libm::asin(height) - libm::asin(lamp.direction[1])).abs() > angle {
                continue;
            }
            for (x, [cosine, sine]) in longitudes.iter().enumerate() {
                if dot([level * cosine, height, level * sine], lamp.direction) > least {
                    // A small disc gives its radiance times π sin².
                    let whole = PI * libm::sin(angle) * libm::sin(angle) * (SIDE * SIDE) as f64;
                    let pixel = &mut image.pixels[y / SIDE * SIZE[0] + x / SIDE];
                    (0..3).for_each(|c| pixel[c] += (lamp.irradiance[c] / whole) as f32);
                }
            }
        }
    }
    image
}

#[cfg(test)]
mod tests {
    use super::super::lit::{Detail, seen, shown};
    use super::*;
    use crate::block_product::visibility::encode::encode;
    use prelight_runtime::block_product::visibility::{Visibility, open_words};

    /// Open where a fixed generator says so, in runs and alone.
    fn bits(n: usize) -> Vec<u64> {
        let mut state = 11u64;
        let mut random = move || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            state >> 16
        };
        (0..open_words(n)).map(|word| if word % 3 == 0 { u64::MAX } else { random() << 16 | random() }).collect()
    }

    /// Moments of the texels that are open, one by one.
    fn by_texel(light: &LightCubemap, open: &[u64]) -> [[f64; 3]; 3] {
        let mut sum = [[0.0; 3]; 3];
        for (texel, moment) in light.moment.iter().enumerate().filter(|(texel, _)| open[texel / 64] >> (texel % 64) & 1 == 1) {
            assert!(texel < 6 * light.face_resolution * light.face_resolution);
            (0..9).for_each(|i| sum[i / 3][i % 3] += f64::from(moment[i / 3][i % 3]));
        }
        sum
    }

    /// f32 rounding of the moments' sum, of a few W/m².
    const ROUNDING: f64 = 2e-6;

    #[test]
    fn domes_and_lamps_give_the_plain_sum_over_open_texels() {
        let lamps = [([0.0, 1.0, 0.0], 0.9), ([0.6, 0.0, 0.8], 12.0), ([-0.36, 0.48, -0.8], 5.0)].map(|(direction, radius)| Lamp {
            direction,
            radius,
            irradiance: [3.0, 2.0, 1.0],
        });
        let mut probes = Probes::new(vec![("studio".into(), studio())], 64);
        let dark = probes.add_dome(&painted(|_| [0.0; 3]), true);
        probes.add_lamps("lamp", dark, &lamps, true);
        let image = painted_lamps(&lamps);
        let cubemap = |environment: &Environment, n| LightCubemap::from_environment(environment, n);
        let near = |lit: &[[[f32; 3]; 3]], n: usize, open: &[u64]| {
            let whole = by_texel(&cubemap(&studio(), n), open);
            let all = by_texel(&cubemap(&image, n), open);
            for i in 0..9 {
                let at = |lit: &[[f32; 3]; 3]| f64::from(lit[i / 3][i % 3]);
                assert!((at(&lit[0]) - whole[i / 3][i % 3]).abs() < ROUNDING, "{n} {i}");
                // Every texel of the image is one lamp's.
                let of_lamps: f64 = lit[1..].iter().map(at).sum();
                assert!((of_lamps - all[i / 3][i % 3]).abs() < ROUNDING, "{n} {i}: {of_lamps}");
            }
        };
        let open = bits(64);
        let chunk = encode(64, &open);
        near(&shown(&probes, &Visibility::from_chunk(&chunk).unwrap().point(0)), 64, &open);
        for (detail, n) in [(Detail::True, TRUE_RESOLUTION), (Detail::Exact, EXACT_RESOLUTION)] {
            let open = bits(n);
            let lit: Vec<_> = seen(&probes, detail, &open, &mut Vec::new()).into_iter().flatten().collect();
            near(&lit, n, &open);
        }
        // The middle lamp alone: half of its texels closed gives about half of it.
        let facing = |open: &[u64]| {
            let lit = shown(&probes, &Visibility::from_chunk(&encode(64, open)).unwrap().point(0));
            (0..3).map(|k| f64::from(lit[2][0][k]) * lamps[1].direction[k]).sum::<f64>()
        };
        assert!((facing(&vec![u64::MAX; open_words(64)]) - 3.0).abs() < 0.05);
        assert_eq!(facing(&vec![0; open_words(64)]), 0.0);
    }

    #[test]
    fn texels_open_in_part_count_in_part() {
        let mut probes = Probes::none(64);
        let dark = probes.add_dome(&painted(|_| [0.0; 3]), false);
        let up = Lamp { direction: [0.0, 1.0, 0.0], radius: 9.0, irradiance: [1.0; 3] };
        probes.add_lamps("lamp", dark, &[up], false);
        let open = vec![u64::MAX; open_words(TRUE_RESOLUTION)];
        let mut parts: Vec<(u32, u64)> = probes.lights[0].truth_lamps.iter().map(|(texel, _)| (*texel, 0x0f0f_0f0f_0f0f_0f0f)).collect();
        let whole = seen(&probes, Detail::True, &open, &mut Vec::new())[0].unwrap();
        let half = seen(&probes, Detail::True, &open, &mut parts)[0].unwrap();
        assert!((half[0][1] - 0.5 * whole[0][1]).abs() < 1e-6 && whole[0][1] > 0.9, "{whole:?} {half:?}");
    }

    #[test]
    fn what_judges_never_steers() {
        let (steering, held_back) = (Probes::steering(64), Probes::held_back(64));
        assert_eq!((steering.lights.len(), steering.n_held_back()), (75, 0));
        assert_eq!((held_back.lights.len(), held_back.n_held_back()), (22, 22));
        let names = |probes: &Probes| probes.lights.iter().map(|probe| probe.name.clone()).collect::<Vec<_>>();
        assert!(names(&held_back).iter().all(|name| !names(&steering).contains(name)));
        assert_eq!(names(&held_back), names(&Probes::held_back(64)));
    }
}
