//! Lights that a cubemap, a sum or a number could lose.

use super::scenes::{quad, scene};
use super::{Bench, Found};
use prelight_bake::error::BakeError;
use prelight_bake::progress::check;
use prelight_runtime::asset::Asset;
use prelight_runtime::block_product::change::{LightChange, update_diffuse};
use prelight_runtime::block_product::shade_diffuse;
use prelight_runtime::block_product::{Glossy, Light};
use prelight_runtime::environment::{Environment, LightCubemap, sky};
use prelight_runtime::relight::Relighter;
use prelight_runtime::sphere::cubemap::BLOCK_SIDE;
use std::f64::consts::PI;
use std::sync::Arc;

const FACE_RESOLUTION: usize = 64;

fn lit(asset: &Arc<Asset>, environment: &Environment) -> Lit {
    let mut relighter = Relighter::new(asset.clone());
    relighter.set_light(&LightCubemap::from_environment(environment, FACE_RESOLUTION)).expect("the bench bakes at this face resolution");
    relighter.shade([1.0, 0.75, 1.0], None).expect("a light is set");
    (relighter.irradiance().to_vec(), relighter.glossy().to_vec())
}

/// Radiance 1000 from one pixel of an image.
fn one_pixel(width: usize, height: usize, row: usize) -> Environment {
    let mut pixels = vec![[0.0; 3]; width * height];
    pixels[row * width + width / 3] = [1000.0; 3];
    Environment::new(width, height, pixels)
}

/// Irradiance of an open, level surface under [`one_pixel`] above the horizon, W·m⁻²: ∫ sin λ dω over the pixel.
fn level(width: usize, height: usize, row: usize) -> f64 {
    let sine = |row: usize| (PI * (0.5 - row as f64 / height as f64)).sin();
    1000.0 * 2.0 * PI / width as f64 * 0.5 * (sine(row).powi(2) - sine(row + 1).powi(2))
}

fn open_floor(bench: &Bench) -> Result<Arc<Asset>, BakeError> {
    bench.baked(&scene(vec![("floor", quad([-1.0, 0.0, -1.0], [0.0, 0.0, 2.0], [2.0, 0.0, 0.0], 0))]), 1.0)
}

/// Upward part of the irradiance, green, least and most over the points.
fn upward(asset: &Arc<Asset>, environment: &Environment) -> [f64; 2] {
    let (irradiance, _) = lit(asset, environment);
    let values = || irradiance.iter().map(|e| f64::from(e[1][1]));
    [values().fold(f64::INFINITY, f64::min), values().fold(0.0, f64::max)]
}

/// See [`super::MODES`].
pub fn sweep_around(bench: &Bench) -> Result<Found, BakeError> {
    let asset = open_floor(bench)?;
    const SIZE: (usize, usize) = (512, 256);
    let (mut off, mut jump, mut series) = (0.0f64, 0.0f64, Vec::new());
    for elevation in [20.0, 50.0] {
        let row = ((0.5 - elevation / 180.0) * SIZE.1 as f64) as usize;
        let (light, exact) = (one_pixel(SIZE.0, SIZE.1, row), level(SIZE.0, SIZE.1, row));
        let mut before = None;
        for place in 0..bench.sizes.sweep {
            check(bench.progress)?;
            let turned = light.clone().with_rotation(0.013 + 360.0 * place as f64 / bench.sizes.sweep as f64);
            let ends = upward(&asset, &turned);
            let error = ends.iter().fold(0.0f64, |most, e| most.max((e / exact - 1.0).abs()));
            off = off.max(error);
            jump = jump.max(before.map_or(0.0, |before: f64| (ends[1] - before).abs() / exact));
            before = Some(ends[1]);
            series.push(error);
        }
    }
    Ok(Found { figures: vec![off, jump], series, pictures: None })
}

/// See [`super::MODES`].
pub fn sweep_horizon(bench: &Bench) -> Result<Found, BakeError> {
    let asset = open_floor(bench)?;
    // 0.18° a row.
    const SIZE: (usize, usize) = (64, 1024);
    let rows = (SIZE.1 / 2 - 34..SIZE.1 / 2 + 17).rev().step_by(if bench.sizes.sweep < 100 { 3 } else { 1 });
    let (mut worst, mut series) = (0.0f64, Vec::new());
    for row in rows {
        check(bench.progress)?;
        let exact = if row < SIZE.1 / 2 { level(SIZE.0, SIZE.1, row) } else { 0.0 };
        let flux = 1000.0 * 2.0 * PI / SIZE.0 as f64 * PI / SIZE.1 as f64;
        let ends = upward(&asset, &one_pixel(SIZE.0, SIZE.1, row));
        let error = ends.iter().fold(0.0f64, |most, e| most.max((e - exact).abs() / flux));
        worst = worst.max(error);
        series.push(error);
    }
    Ok(Found { figures: vec![worst], series, pictures: None })
}

/// Vector irradiance and glossy light of every point.
type Lit = (Vec<[[f32; 3]; 3]>, Vec<Glossy>);

/// Worst |a / scale − b| relative to the largest b of diffuse and of glossy light, and how many values of a are not finite. Zeros must be zeros.
fn scaled(a: &Lit, b: &Lit, scale: f64) -> ([f64; 2], usize) {
    let worst = |a: &[f32], b: &[f32]| {
        let most = b.iter().fold(0.0f64, |most, x| most.max(f64::from(x.abs())));
        // Of the brightest: sums that nearly cancel are as exact as what they are sums of.
        let off = |(a, b): (&f32, &f32)| (f64::from(*a) / scale - f64::from(*b)).abs() / most.max(f64::MIN_POSITIVE);
        a.iter().zip(b).map(off).fold(0.0, f64::max)
    };
    let broken = |values: &[f32]| values.iter().filter(|x| !x.is_finite()).count();
    let (diffuse, own) = (a.0.as_flattened().as_flattened(), b.0.as_flattened().as_flattened());
    let (glossy, own_glossy) = (a.1.as_flattened().as_flattened(), b.1.as_flattened().as_flattened());
    ([worst(diffuse, own), worst(glossy, own_glossy)], broken(diffuse) + broken(glossy))
}

/// See [`super::MODES`].
pub fn exposure_steps(bench: &Bench) -> Result<Found, BakeError> {
    let (_, asset) = bench.still_life()?;
    let light = sky([0.5, 0.5, 0.6]);
    let plain = lit(asset, &light);
    let mut series = Vec::new();
    for exponent in [-12, -3, -1, 1, 4, 10] {
        check(bench.progress)?;
        let scale = 2f64.powi(exponent);
        series.push(scaled(&lit(asset, &light.clone().with_intensity(scale as f32)), &plain, scale).0.into_iter().fold(0.0, f64::max));
    }
    Ok(Found { figures: vec![series.iter().copied().fold(0.0, f64::max)], series, pictures: None })
}

/// See [`super::MODES`].
pub fn scales(bench: &Bench) -> Result<Found, BakeError> {
    let (_, asset) = bench.still_life()?;
    let light = sky([0.5, 0.5, 0.6]);
    let plain = lit(asset, &light);
    let (mut worst, mut broken) = ([0.0f64; 2], 0);
    for scale in [1e-4f32, 1e5] {
        let (errors, lost) = scaled(&lit(asset, &light.clone().with_intensity(scale)), &plain, f64::from(scale));
        (worst, broken) = ([worst[0].max(errors[0]), worst[1].max(errors[1])], broken + lost);
    }
    Ok(Found { figures: vec![worst[0], worst[1], broken as f64], ..Found::default() })
}

/// See [`super::MODES`].
pub fn darkness(bench: &Bench) -> Result<Found, BakeError> {
    let (_, asset) = bench.still_life()?;
    let (irradiance, glossy) = lit(asset, &Environment::new(4, 2, vec![[0.0; 3]; 8]));
    let values = irradiance.iter().flatten().flatten().chain(glossy.iter().flatten().flatten());
    Ok(Found { figures: vec![values.fold(0.0f64, |most, x| most.max(f64::from(x.abs())))], ..Found::default() })
}

/// See [`super::MODES`].
pub fn drift(bench: &Bench) -> Result<Found, BakeError> {
    let (_, asset) = bench.still_life()?;
    let patch = &asset.patches()[asset.patches().len() / 2];
    let visibility = patch.visibility();
    let base = LightCubemap::from_environment(&sky([0.2, 0.9, 0.1]), FACE_RESOLUTION);
    // The block that the sun is in.
    let brightest = (0..base.flux.len()).max_by(|a, b| base.flux[*a][1].total_cmp(&base.flux[*b][1])).unwrap_or(0);
    let (x, y) = (brightest % FACE_RESOLUTION / BLOCK_SIDE * BLOCK_SIDE, brightest / FACE_RESOLUTION / BLOCK_SIDE * BLOCK_SIDE);
    let texels: Vec<usize> = (0..BLOCK_SIDE * BLOCK_SIDE).map(|i| (y + i / BLOCK_SIDE) * FACE_RESOLUTION + x + i % BLOCK_SIDE).collect();
    let total = |light: &LightCubemap| -> f64 { light.flux.iter().map(|flux| f64::from(flux[0] + flux[1] + flux[2])).sum() };
    let (mut now, mut next) = (base.clone(), base.clone());
    let mut irradiance = vec![[[0.0f32; 3]; 3]; visibility.len()];
    let mut rest = irradiance.clone();
    let mut at_full = total(&base);
    shade_diffuse(&Light::prepare(&base), &visibility, &mut irradiance);
    let rest_of_light = at_full - texels.iter().map(|i| f64::from(base.flux[*i][0] + base.flux[*i][1] + base.flux[*i][2])).sum::<f64>();
    let own = at_full - rest_of_light;
    let (mut worst, mut series) = (0.0f64, Vec::new());
    for frame in 1..=bench.sizes.drift {
        let jitter = 0.7 + 0.6 * ((frame as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40) as f32 / (1u64 << 24) as f32;
        let factor = if frame % 200 == 100 { 1e4 } else { jitter };
        for i in &texels {
            next.flux[*i] = base.flux[*i].map(|x| x * factor);
            next.moment[*i] = base.moment[*i].map(|m| m.map(|x| x * factor));
        }
        let change = LightChange::between(&now, &next);
        let flux = rest_of_light + own * f64::from(factor);
        if change.allows(at_full, flux) {
            update_diffuse(&change, &visibility, &mut irradiance, &mut rest);
            at_full = at_full.max(flux);
        } else {
            shade_diffuse(&Light::prepare(&next), &visibility, &mut irradiance);
            rest.fill([[0.0; 3]; 3]);
            at_full = flux;
        }
        std::mem::swap(&mut now, &mut next);
        if frame % (bench.sizes.drift / 20).max(1) == 0 {
            check(bench.progress)?;
            let mut fresh = irradiance.clone();
            shade_diffuse(&Light::prepare(&now), &visibility, &mut fresh);
            let norm = |e: &[[f32; 3]; 3]| e.iter().flatten().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt();
            let most = fresh.iter().map(norm).fold(0.0, f64::max);
            let error = (irradiance.iter().zip(&fresh))
                .map(|(a, b)| {
                    let difference = std::array::from_fn(|c| std::array::from_fn(|k| a[c][k] - b[c][k]));
                    norm(&difference) / norm(b).max(1e-3 * most)
                })
                .fold(0.0, f64::max);
            worst = worst.max(error);
            series.push(error);
        }
    }
    Ok(Found { figures: vec![worst], series, pictures: None })
}
