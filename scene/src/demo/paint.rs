//! Textures painted in code: oak planks, walnut, a rug, a picture. sRGB bytes, the same on every machine.

use prelight_runtime::surface::{Texture, TextureEncoding};
use std::borrow::Cow;

/// A colour, sRGB 0..1.
type Colour = [f32; 3];

fn paint(width: u32, height: u32, colour: impl Fn(f32, f32) -> Colour) -> Texture<'static> {
    let mut texels = Vec::with_capacity(4 * (width * height) as usize);
    for y in 0..height {
        for x in 0..width {
            let rgb = colour((x as f32 + 0.5) / width as f32, (y as f32 + 0.5) / height as f32);
            texels.extend(rgb.map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8));
            texels.push(255);
        }
    }
    Texture { width, height, encoding: TextureEncoding::Srgb, texels: Cow::Owned(texels) }
}

/// Twelve rows of planks over a square of 1.8 m; tiles.
pub(super) fn oak_planks() -> Texture<'static> {
    const ROWS: f32 = 12.0;
    paint(768, 768, |u, v| {
        let row = (v * ROWS).floor();
        // Two planks a row, shifted row by row.
        let along = u * 2.0 + hash(row as i32, 7) * 2.0;
        let plank = along.floor().rem_euclid(2.0);
        let (x, y) = (along.fract(), (v * ROWS).fract());
        let seed = (row * 2.0 + plank) as i32;
        let tone = 0.82 + 0.22 * hash(seed, 1);
        let grain = grain(x * 3.0 + 17.0 * hash(seed, 2), y * 1.6 + 31.0 * hash(seed, 3), 9.0);
        let edge = (y.min(1.0 - y) * 1.8 / ROWS).min(x.min(1.0 - x) * 0.9);
        let groove = if edge < 0.0022 { 0.62 } else { 1.0 };
        let warm = 0.03 * (hash(seed, 4) - 0.5);
        mix([0.80 + warm, 0.65, 0.47 - warm], [0.67, 0.50, 0.34], grain).map(|c| c * tone * groove)
    })
}

/// Boards of dark wood along u.
pub(super) fn walnut() -> Texture<'static> {
    const BOARDS: f32 = 5.0;
    paint(512, 512, |u, v| {
        let board = (v * BOARDS).floor() as i32;
        let y = (v * BOARDS).fract();
        let grain = grain(u * 3.0 + 9.0 * hash(board, 5), y * 1.2 + 23.0 * hash(board, 6), 4.0);
        let tone = 0.88 + 0.2 * hash(board, 7);
        let seam = if y < 0.012 { 0.7 } else { 1.0 };
        mix([0.45, 0.29, 0.19], [0.31, 0.19, 0.12], grain).map(|c| c * tone * seam)
    })
}

/// Stripes with a border, woven.
pub(super) fn rug() -> Texture<'static> {
    let (cream, blue, rust) = ([0.82, 0.77, 0.67], [0.20, 0.29, 0.38], [0.62, 0.30, 0.20]);
    paint(512, 384, |u, v| {
        let weave = 0.93 + 0.07 * hash((u * 256.0) as i32, (v * 192.0) as i32);
        let (x, y) = ((u * 4.0).min(4.0 - u * 4.0), (v * 3.0).min(3.0 - v * 3.0));
        let rim = x.min(y);
        let colour = if rim < 0.12 {
            blue
        } else if rim < 0.17 {
            cream
        } else if rim < 0.25 {
            rust
        } else if rim < 0.29 {
            cream
        } else {
            // Lozenges.
            let d = ((u * 8.0).fract() - 0.5).abs() + ((v * 6.0).fract() - 0.5).abs();
            if d < 0.12 {
                rust
            } else if (0.36..0.44).contains(&d) {
                blue
            } else {
                cream
            }
        };
        colour.map(|c| c * weave)
    })
}

/// A low sun over hills, in flat colours.
pub(super) fn picture() -> Texture<'static> {
    paint(384, 512, |u, v| {
        let paper = 0.96 + 0.04 * hash((u * 384.0) as i32, (v * 512.0) as i32);
        let hill = |height: f32, waves: f32, phase: f32| {
            height + 0.05 * libm::sinf(u * waves + phase) + 0.03 * libm::sinf(u * waves * 2.3 + 1.7 * phase)
        };
        let sun = (u - 0.62) * (u - 0.62) + (v - 0.36) * (v - 0.36) * 1.78;
        let colour = if v > hill(0.83, 5.0, 1.0) {
            [0.13, 0.20, 0.23]
        } else if v > hill(0.70, 4.0, 2.6) {
            [0.22, 0.36, 0.38]
        } else if v > hill(0.58, 6.0, 4.4) {
            [0.45, 0.55, 0.50]
        } else if sun < 0.03 {
            [0.93, 0.47, 0.25]
        } else {
            mix([0.96, 0.87, 0.70], [0.93, 0.74, 0.56], v * 1.6)
        };
        // A white mount around.
        let rim = (u * 384.0).min(384.0 - u * 384.0).min((v * 512.0).min(512.0 - v * 512.0));
        if rim < 44.0 { [0.94, 0.93, 0.90] } else { colour.map(|c| c * paper) }
    })
}

fn mix(a: Colour, b: Colour, t: f32) -> Colour {
    let t = t.clamp(0.0, 1.0);
    std::array::from_fn(|k| a[k] + (b[k] - a[k]) * t)
}

/// Long dark lines that bend along x; 0..1.
fn grain(x: f32, y: f32, lines: f32) -> f32 {
    let bend = noise(x * 0.9, y * 2.0, 11) * 0.9 + noise(x * 2.5, y * 5.0, 12) * 0.25;
    let rings = (y + bend * 0.5) * lines;
    let wave = 0.5 + 0.5 * libm::sinf(rings * 2.0 * std::f32::consts::PI * 0.5);
    let fibre = noise(x * 6.0, y * 90.0, 13);
    0.62 * wave * wave + 0.38 * fibre
}

/// Value noise 0..1, smooth.
fn noise(x: f32, y: f32, seed: i32) -> f32 {
    let (i, j) = (x.floor(), y.floor());
    let (fx, fy) = (x - i, y - j);
    let smooth = |t: f32| t * t * (3.0 - 2.0 * t);
    let (sx, sy) = (smooth(fx), smooth(fy));
    let at = |di: i32, dj: i32| hash((i as i32 + di).wrapping_mul(8191).wrapping_add(seed), j as i32 + dj);
    let (top, bottom) = (at(0, 0) + (at(1, 0) - at(0, 0)) * sx, at(0, 1) + (at(1, 1) - at(0, 1)) * sx);
    top + (bottom - top) * sy
}

/// 0..1 from two integers.
fn hash(a: i32, b: i32) -> f32 {
    let mut x = (a as u32).wrapping_mul(0x9E37_79B9) ^ (b as u32).wrapping_mul(0x85EB_CA6B) ^ 0xC2B2_AE35;
    for _ in 0..2 {
        x = (x ^ (x >> 15)).wrapping_mul(0x2C1B_3C6D);
    }
    (x >> 8) as f32 / 16_777_216.0
}
