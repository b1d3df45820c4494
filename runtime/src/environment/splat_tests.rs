//! Claims about the splat: energy, vector irradiance, continuity of a turning sun, borders and corners.

use crate::sphere::frame::dot;
use std::f64::consts::PI;

use super::{Environment, LightCubemap, Splatter};
use crate::sphere::cubemap::{texel_solid_angle, texel_unit_direction};

const N: usize = 64;

/// Counter-based random numbers in 0..1 (SplitMix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn direction(&mut self) -> [f64; 3] {
        let (z, phi) = (2.0 * self.next() - 1.0, 2.0 * PI * self.next());
        let r = (1.0 - z * z).sqrt();
        [r * phi.cos(), r * phi.sin(), z]
    }
}

fn unit_directions(n: usize) -> Vec<[f64; 3]> {
    (0..6 * n * n).map(|i| texel_unit_direction(n, i / (n * n), i % n, i / n % n).map(f64::from)).collect()
}

/// A black image with one bright pixel.
fn one_pixel_sun(width: usize, height: usize, x: usize, y: usize) -> Environment {
    let mut pixels = vec![[0.0; 3]; width * height];
    pixels[y * width + x] = [50_000.0, 40_000.0, 20_000.0];
    Environment::new(width, height, pixels)
}

fn random_environment(width: usize, height: usize, random: &mut Random) -> Environment {
    let value = |random: &mut Random| (6.0 * random.next() - 3.0).exp() as f32;
    Environment::new(width, height, (0..width * height).map(|_| [value(random), value(random), value(random)]).collect())
}

/// ∫ L max(0, n·ω) dω of the exact image by midpoints of `fine`² parts of each bright pixel: the slow truth.
fn exact_irradiance(environment: &Environment, normal: [f64; 3], fine: usize) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for y in 0..environment.height {
        let (top, bottom) = (environment.row_edge_sine(y), environment.row_edge_sine(y + 1));
        let part = environment.pixel_solid_angle(y) / (fine * fine) as f64;
        for x in 0..environment.width {
            let radiance = environment.pixel_radiance(x, y);
            if radiance == [0.0; 3] {
                continue;
            }
            for i in 0..fine {
                let sine = top + (bottom - top) * (i as f64 + 0.5) / fine as f64;
                for j in 0..fine {
                    let direction = environment.direction_from_sine(x as f64 + (j as f64 + 0.5) / fine as f64, sine);
                    let cosine = dot(normal, direction).max(0.0);
                    for c in 0..3 {
                        sum[c] += f64::from(radiance[c]) * cosine * part;
                    }
                }
            }
        }
    }
    sum
}

/// Irradiance of an unoccluded point as techniques compute it: moments of texels whose centre is above the horizon.
fn cubemap_irradiance(light: &LightCubemap, directions: &[[f64; 3]], normal: [f64; 3]) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for (moment, direction) in light.moment.iter().zip(directions) {
        if dot(normal, *direction) > 0.0 {
            for c in 0..3 {
                sum[c] += dot(normal, moment[c].map(f64::from));
            }
        }
    }
    sum
}

#[test]
fn energy_before_equals_energy_after_at_every_size() {
    let mut random = Random(1);
    for (width, height, degrees, n) in
        [(1, 1, 10.0, N), (7, 5, -80.0, N), (64, 32, 1.5, 16), (1023, 511, 0.1, N), (512, 256, 77.7, 128), (600, 300, 5.0, 16)]
    {
        let environment = random_environment(width, height, &mut random).with_rotation(degrees).with_intensity(2.5);
        let (light, report) = LightCubemap::with_energy(&environment, n);
        let mut source = [0.0; 3];
        for y in 0..height {
            for x in 0..width {
                for c in 0..3 {
                    source[c] += f64::from(environment.pixels[y * width + x][c]) * 2.5 * environment.pixel_solid_angle(y);
                }
            }
        }
        for c in 0..3 {
            // Cells are summed exactly but for f64 rounding; the texels are rounded to f32 (2⁻²⁴ each, unbiased).
            assert!((report.before[c] / source[c] - 1.0).abs() < 1e-11, "{width} x {height}: {report:?}, {source:?}");
            let stored: f64 = light.flux.iter().map(|flux| f64::from(flux[c])).sum();
            assert!((stored - report.after[c]).abs() < 1e-9 * stored);
        }
        assert!(report.relative_loss() < 1e-6, "{width} x {height}: {report:?}");
    }
}

#[test]
fn moments_sum_to_the_exact_moment_of_the_image() {
    let mut random = Random(2);
    for (width, height, n) in [(3, 2, N), (64, 32, N), (311, 155, 64), (511, 255, 16)] {
        let environment = random_environment(width, height, &mut random).with_rotation(31.0);
        let (light, report) = LightCubemap::with_energy(&environment, n);
        let mut sum = [[0.0; 3]; 3];
        for moment in &light.moment {
            for c in 0..3 {
                for axis in 0..3 {
                    sum[c][axis] += f64::from(moment[c][axis]);
                }
            }
        }
        // n·M over the whole sphere is the irradiance of the front less that of the back.
        for axis in 0..3 {
            let mut normal = [0.0; 3];
            normal[axis] = 1.0;
            let fine = 1600 / width + 1;
            let front = exact_irradiance(&environment, normal, fine);
            let back = exact_irradiance(&environment, normal.map(|v: f64| -v), fine);
            for c in 0..3 {
                let expected = front[c] - back[c];
                // The midpoint rule of the truth is good to about 1e-5 of the energy.
                assert!((sum[c][axis] - expected).abs() < 2e-5 * report.before[c], "{width}: {} {expected}", sum[c][axis]);
            }
        }
    }
}

#[test]
fn a_white_sphere_fills_every_texel_by_its_solid_angle() {
    // The widest spacing of cells (half the smallest texel) leaves a ripple of the tent of at most 4 % a side; where cells are finer it is
    // far less. No texel starves, whatever the size of the source.
    for (width, height, n) in [(1, 1, N), (7, 5, N), (64, 32, N), (1024, 512, N), (600, 300, 8), (640, 320, 128)] {
        let environment = Environment::new(width, height, vec![[1.0; 3]; width * height]).with_rotation(12.3);
        let light = LightCubemap::from_environment(&environment, n);
        let (mut low, mut high, mut squares) = (f64::MAX, 0.0f64, 0.0);
        for (i, flux) in light.flux.iter().enumerate() {
            let ratio = f64::from(flux[0]) / texel_solid_angle(n, i % n, i / n % n);
            (low, high) = (low.min(ratio), high.max(ratio));
            squares += (ratio - 1.0) * (ratio - 1.0);
        }
        let rms = (squares / light.flux.len() as f64).sqrt();
        eprintln!("{width} x {height} at {n}: flux over solid angle {low:.4}..{high:.4}, rms {rms:.5}");
        assert!(low > 0.92 && high < 1.08 && rms < 0.02, "{width} x {height} at {n}: {low} {high} {rms}");
    }
}

#[test]
fn unoccluded_irradiance_of_a_sun_is_exact_from_four_degrees_above_the_horizon() {
    let directions = unit_directions(N);
    let mut random = Random(3);
    let mut splatter = Splatter::new(N);
    let mut light = LightCubemap::black(N);
    // Largest and mean error per degree above the horizon, relative to the exact irradiance; from 4° on in the last row.
    let mut table = [[0.0f64; 3]; 5];
    for _ in 0..120 {
        let (x, y) = ((random.next() * 1024.0) as usize, (random.next() * 512.0) as usize);
        let sun = one_pixel_sun(1024, 512, x, y).with_rotation(720.0 * random.next() - 360.0);
        light.update_from(&sun, &mut splatter);
        let towards = sun.direction_from_pixel(x as f64 + 0.5, y as f64 + 0.5);
        for i in 0..5 {
            // Four points with the sun between 0.2° and 4°, one anywhere above.
            let elevation = if i < 4 { (0.2 + 3.8 * random.next()).to_radians() } else { (4.0 + 86.0 * random.next()).to_radians() };
            let side = random.direction();
            let along = dot(side, towards);
            let flat: [f64; 3] = std::array::from_fn(|k| side[k] - along * towards[k]);
            let length = dot(flat, flat).sqrt();
            let normal = std::array::from_fn(|k| towards[k] * elevation.sin() + flat[k] / length * elevation.cos());
            let exact = exact_irradiance(&sun, normal, 24);
            let found = cubemap_irradiance(&light, &directions, normal);
            let error = (0..3).map(|c| (found[c] / exact[c] - 1.0).abs()).fold(0.0, f64::max);
            let row = &mut table[(elevation.to_degrees() as usize).min(4)];
            row[0] = row[0].max(error);
            row[1] += error;
            row[2] += 1.0;
        }
    }
    for (degrees, [largest, sum, count]) in table.into_iter().enumerate() {
        let to = if degrees < 4 { (degrees + 1).to_string() } else { "90".into() };
        eprintln!("sun {degrees}..{to} degrees above the horizon: mean error {:.2e}, largest {largest:.2e}", sum / count);
        assert!(count > 20.0);
    }
    assert!(table[4][0] < 1e-4, "{table:?}");
}

#[test]
fn irradiance_of_a_whole_image_is_exact_but_for_light_at_the_horizon() {
    let directions = unit_directions(N);
    let mut random = Random(4);
    for (width, height) in [(16, 8), (256, 128)] {
        let environment = random_environment(width, height, &mut random).with_rotation(200.0 * random.next());
        let light = LightCubemap::from_environment(&environment, N);
        for _ in 0..5 {
            let normal = random.direction();
            let exact = exact_irradiance(&environment, normal, 640 / width);
            let found = cubemap_irradiance(&light, &directions, normal);
            for c in 0..3 {
                // Light within a texel of the horizon: 3 % of the hemisphere at a cosine of up to 0.03, half of it misjudged at worst.
                assert!((found[c] / exact[c] - 1.0).abs() < 5e-4, "{width} x {height}: {found:?} {exact:?}");
            }
        }
    }
}

/// Share of a sun that the texels hold: flux per texel divided by the sum. Sparse: (texel, share).
fn shares(light: &LightCubemap) -> Vec<(usize, f64)> {
    let total: f64 = light.flux.iter().map(|flux| f64::from(flux[0])).sum();
    let held = light.flux.iter().enumerate().filter(|(_, flux)| flux[0] > 0.0);
    held.map(|(texel, flux)| (texel, f64::from(flux[0]) / total)).collect()
}

/// The most that any set of open texels can gain or lose between two frames.
fn largest_change(before: &[(usize, f64)], after: &[(usize, f64)]) -> f64 {
    let share = |list: &[(usize, f64)], texel| list.iter().find(|entry| entry.0 == texel).map_or(0.0, |entry| entry.1);
    let gained: f64 = after.iter().map(|&(texel, now)| (now - share(before, texel)).max(0.0)).sum();
    let lost: f64 = before.iter().map(|&(texel, then)| (then - share(after, texel)).max(0.0)).sum();
    gained.max(lost)
}

#[test]
fn a_sun_turned_by_a_twentieth_of_a_degree_changes_no_point_by_more_than_an_eighth() {
    // Not only across straight edges: whichever texels are open, what they hold together changes by at most 1/8 of the sun.
    let mut splatter = Splatter::new(N);
    let mut light = LightCubemap::black(N);
    let mut random = Random(5);
    let mut worst = 0.0f64;
    // The corner of a face lies at a latitude of 35.26°: rows 155 and 156 of 512. Then rows anywhere.
    let rows: Vec<usize> = [155, 156, 255, 128, 0, 511].into_iter().chain((0..6).map(|_| (random.next() * 512.0) as usize)).collect();
    for y in rows {
        let mut previous: Option<Vec<(usize, f64)>> = None;
        // 45° face borders and corners lie at 45° and 135°: turn across one, then somewhere random.
        for start in [44.3, 200.0 * random.next()] {
            for frame in 0..28 {
                let sun = one_pixel_sun(1024, 512, 512, y).with_rotation(start + 0.05 * f64::from(frame));
                light.update_from(&sun, &mut splatter);
                let now = shares(&light);
                if let Some(before) = previous.take() {
                    worst = worst.max(largest_change(&before, &now));
                }
                previous = Some(now);
            }
            previous = None;
        }
    }
    eprintln!("largest change in a frame of 0.05 degrees: {worst:.4} of the sun");
    assert!(worst > 0.01 && worst < 0.125, "{worst}");
}

#[test]
fn a_sun_that_crosses_an_occluder_edge_fades_over_several_frames() {
    // A half space cuts the sky; the sun turns across its edge. What the point receives glides from all to nothing.
    let directions = unit_directions(N);
    let mut splatter = Splatter::new(N);
    let mut light = LightCubemap::black(N);
    let mut random = Random(6);
    for _ in 0..8 {
        let y = 100 + (random.next() * 300.0) as usize;
        let sun = |degrees: f64| one_pixel_sun(1024, 512, 300, y).with_rotation(degrees);
        let middle = 360.0 * random.next();
        let towards = sun(middle).direction_from_pixel(300.5, y as f64 + 0.5);
        // The edge's plane holds the sun's direction at the middle frame, and is not along its path.
        let path = [towards[2], 0.0, -towards[0]];
        let (tilt, length) = (random.next() - 0.5, dot(path, path).sqrt());
        let wall: [f64; 3] =
            std::array::from_fn(|k| path[k] / length + tilt * if k == 1 { length } else { -towards[1] * towards[k] / length });
        let normal = towards;
        let received = |light: &LightCubemap| -> f64 {
            let open = light.moment.iter().zip(&directions).filter(|(_, d)| dot(wall, **d) < 0.0 && dot(normal, **d) > 0.0);
            open.map(|(moment, _)| dot(normal, moment[0].map(f64::from))).sum()
        };
        let unoccluded = exact_irradiance(&sun(middle), normal, 8)[0];
        let series: Vec<f64> = (-45..=45)
            .map(|frame| {
                light.update_from(&sun(middle + 0.05 * f64::from(frame)), &mut splatter);
                received(&light) / unoccluded
            })
            .collect();
        assert!(series[0] > 0.99 && series[90] < 1e-6, "{} {}", series[0], series[90]);
        let step = series.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
        assert!(step < 0.125, "a frame changes the point by {step} of the sun");
    }
}

#[test]
fn weights_are_one_at_texel_centres_and_continuous_everywhere() {
    let neighbours = Splatter::new(N).neighbours;
    for (texel, direction) in unit_directions(N).into_iter().enumerate() {
        let (found, weights) = neighbours.around(direction);
        let at_centre: f64 = found.iter().zip(weights).filter(|(index, _)| **index == texel).map(|(_, weight)| weight).sum();
        // The centre's unit direction is rounded to f32: 1e-7 of a turn is 1e-5 of a texel.
        assert!(at_centre > 1.0 - 1e-4, "texel {texel}: {found:?} {weights:?}");
    }
    // Walks along random great circles and through borders and corners: total variation per radian is bounded by the smallest texel.
    let mut random = Random(7);
    let directions = unit_directions(N);
    let step = 1e-4;
    for walk in 0..400 {
        let start = match walk % 4 {
            0 => random.direction(),
            1 => [1.0, if random.next() < 0.5 { 1.0 } else { -1.0 }, 2.0 * random.next() - 1.0],
            2 => [if random.next() < 0.5 { 1.0 } else { -1.0 }, 1.0, -1.0],
            _ => [2.0 * random.next() - 1.0, -1.0, -1.0],
        };
        let length = dot(start, start).sqrt();
        let start = start.map(|v| v / length);
        let side = random.direction();
        let mut previous: Option<Vec<(usize, f64)>> = None;
        for i in -100..100 {
            let at: [f64; 3] = std::array::from_fn(|k| start[k] + side[k] * step * f64::from(i));
            let (found, weights) = neighbours.around(at);
            assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            let now: Vec<_> = found.into_iter().zip(weights).filter(|(_, weight)| *weight > 0.0).collect();
            for &(texel, _) in &now {
                let cosine = dot(directions[texel], at) / dot(at, at).sqrt();
                assert!(cosine > 2.6f64.to_radians().cos(), "texel {texel} is {}° away", cosine.acos().to_degrees());
            }
            if let Some(before) = previous.replace(now) {
                let change = largest_change(&before, previous.as_ref().unwrap_or(&before));
                assert!(change < step / 0.0070, "walk {walk}: {change} in a step of {step}");
            }
        }
    }
}

#[test]
fn update_equals_a_fresh_cubemap_whatever_came_before() {
    let mut random = Random(8);
    let mut splatter = Splatter::new(16);
    let mut light = LightCubemap::black(16);
    for (width, height, degrees) in [(64, 32, 0.0), (64, 32, 50.0), (5, 3, 50.0), (300, 150, -20.0)] {
        let environment = random_environment(width, height, &mut random).with_rotation(degrees);
        let report = light.update_from(&environment, &mut splatter);
        let (fresh, fresh_report) = LightCubemap::with_energy(&environment, 16);
        assert_eq!((&light, report), (&fresh, fresh_report));
    }
}

#[test]
fn black_light_and_light_beyond_f32_stay_finite() {
    let (light, report) = LightCubemap::with_energy(&Environment::new(4, 2, vec![[0.0; 3]; 8]), 8);
    assert!(light.flux.iter().flatten().chain(light.moment.iter().flatten().flatten()).all(|value| *value == 0.0));
    assert_eq!(report.relative_loss(), 0.0);
    let huge = Environment::new(4, 2, vec![[f32::MAX; 3]; 8]).with_intensity(1e30);
    let light = LightCubemap::from_environment(&huge, 8);
    assert!(light.flux.iter().flatten().chain(light.moment.iter().flatten().flatten()).all(|value| value.is_finite()));
}

#[cfg(feature = "parallel")]
#[test]
fn one_and_three_threads_give_the_same_bits() {
    let environment = random_environment(256, 128, &mut Random(9)).with_rotation(12.0);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| LightCubemap::with_energy(&environment, 32))
    };
    assert_eq!(on(1), on(3));
}
