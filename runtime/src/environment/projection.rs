//! Projections of maps other than latitude-longitude: told by the option, the file or the shape, then resampled to latitude-longitude.
//!
//! | projection | shape | what lies where |
//! |---|---|---|
//! | `lat_long` | 2:1 | see the module head: +X in the middle, +Z to the right of it, +Y on top |
//! | `angular` | a disc in a square | +X in the middle, +Z to the right, +Y up; the angle to +X grows with the radius, to 180° at the rim |
//! | `cube_cross` | 3:4 or 4:3 | +X in the middle of the cross, +Z right, −Z left, +Y above, −Y below; −X below that (upside down) or to the right of +Z |
//! | `cube_faces` | 1:6 or 6:1 | +X −X +Y −Y +Z −Z, each as OpenEXR turns it: upright and seen from within; +Y has +Z on top, −Y has −Z |
//!
//! So the middle of a lat-long map, of an angular map and of a cross is one direction: a map that was converted between them keeps its light
//! where it was. A texel of the result is the mean of samples at its equal parts of solid angle, each the pixel of the source that it meets.

use std::f64::consts::PI;

use prelight_manifests::scene::Projection;

use super::source::{Decoded, Source};
use crate::error::RuntimeError;

/// Texels along a row of the result at least: small maps have sharp pixels that a coarse result would smear.
const LEAST_WIDTH: usize = 256;

/// Side of a face from which on a row or a column of six is taken for a cube without being told, pixels.
const LEAST_SIDE: usize = 4;

/// A square of the source that shows one side of the cube.
#[derive(Clone, Copy, Debug)]
pub(super) struct Face {
    /// Square of the image, counted in squares from the left and the top.
    pub(super) at: [usize; 2],
    /// Direction of its middle, and where its pixels run to the right and down.
    pub(super) axis: [f64; 3],
    pub(super) right: [f64; 3],
    pub(super) down: [f64; 3],
}

const X: [f64; 3] = [1.0, 0.0, 0.0];
const Y: [f64; 3] = [0.0, 1.0, 0.0];
const Z: [f64; 3] = [0.0, 0.0, 1.0];

const fn minus(v: [f64; 3]) -> [f64; 3] {
    [-v[0], -v[1], -v[2]]
}

const fn face(at: [usize; 2], axis: [f64; 3], right: [f64; 3], down: [f64; 3]) -> Face {
    Face { at, axis, right, down }
}

/// A column of six; a row has x and y of `at` exchanged.
pub(super) const FACES: [Face; 6] = [
    face([0, 0], X, Z, minus(Y)),
    face([0, 1], minus(X), minus(Z), minus(Y)),
    face([0, 2], Y, X, minus(Z)),
    face([0, 3], minus(Y), X, Z),
    face([0, 4], Z, minus(X), minus(Y)),
    face([0, 5], minus(Z), X, minus(Y)),
];

/// What both crosses share; the back comes last.
pub(super) const CROSS: [Face; 6] = [
    face([1, 1], X, Z, minus(Y)),
    face([2, 1], Z, minus(X), minus(Y)),
    face([0, 1], minus(Z), X, minus(Y)),
    face([1, 0], Y, Z, X),
    face([1, 2], minus(Y), Z, minus(X)),
    face([1, 3], minus(X), Z, Y),
];

/// Where a direction is found in the source.
enum Layout {
    LatLong,
    /// The disc's diameter, pixels.
    Angular(usize),
    /// Faces, and the side of a square, pixels.
    Cube(Box<[Face; 6]>, usize),
}

/// The layout of a projection in an image of this size; `None` where the size does not fit it.
fn layout(projection: Projection, width: usize, height: usize) -> Option<Layout> {
    match projection {
        Projection::LatLong => Some(Layout::LatLong),
        Projection::Angular => (width == height).then_some(Layout::Angular(width)),
        Projection::CubeFaces if width.checked_mul(6) == Some(height) => Some(Layout::Cube(Box::new(FACES), width)),
        Projection::CubeFaces if height.checked_mul(6) == Some(width) => {
            Some(Layout::Cube(Box::new(FACES.map(|face| Face { at: [face.at[1], 0], ..face })), height))
        }
        Projection::CubeCross if width.is_multiple_of(3) && width / 3 * 4 == height => Some(Layout::Cube(Box::new(CROSS), width / 3)),
        Projection::CubeCross if width.is_multiple_of(4) && width / 4 * 3 == height => {
            let mut faces = CROSS;
            faces[5] = face([3, 1], minus(X), minus(Z), minus(Y));
            Some(Layout::Cube(Box::new(faces), width / 4))
        }
        Projection::CubeFaces | Projection::CubeCross => None,
    }
}

/// The shape that a projection needs, for messages.
fn shape(projection: Projection) -> &'static str {
    match projection {
        Projection::LatLong => "any size, best 2:1",
        Projection::Angular => "as wide as high",
        Projection::CubeCross => "3:4 or 4:3, of whole squares",
        Projection::CubeFaces => "1:6 or 6:1",
    }
}

/// Makes a latitude-longitude image of what was decoded: by `asked`, else by what the file declares, else by its shape.
///
/// # Errors
/// When the size does not fit the projection that was asked for or declared, or the result exceeds the limit.
pub(super) fn unwrap(source: Source<'_>, mut decoded: Decoded, asked: Option<Projection>) -> Result<Decoded, RuntimeError> {
    let known = asked.or(decoded.projection);
    let projection = known.unwrap_or_else(|| {
        let (projection, note) = guess(decoded.width, decoded.height, &decoded.pixels);
        decoded.notes.extend(note);
        projection
    });
    let Some(layout) = layout(projection, decoded.width, decoded.height) else {
        let (name, by) = (projection.name(), if asked.is_some() { "was asked for" } else { "its header names" });
        let what = format!("it is {} x {} pixels; {name}, which {by}, is {}", decoded.width, decoded.height, shape(projection));
        return Err(source.error(what, "choose with projection = \"lat_long\", \"angular\", \"cube_cross\" or \"cube_faces\""));
    };
    let natural = match &layout {
        Layout::LatLong => return Ok(decoded),
        // The pixels' size in angle stays.
        Layout::Angular(diameter) => diameter.next_multiple_of(2),
        Layout::Cube(_, side) => 4 * side,
    };
    let width = natural * LEAST_WIDTH.div_ceil(natural).max(1);
    let bytes = |pixels: usize| pixels as u64 * 12;
    let _unwrapped =
        source.take_memory(&format!("an image of {width} x {}", width / 2), bytes(width * width / 2) + bytes(decoded.pixels.len()))?;
    let mut pixels = source.reserve_pixels(width * width / 2)?;
    pixels.resize(width * width / 2, [0.0; 3]);
    resample(&decoded, &layout, width, &mut pixels);
    Ok(Decoded { width, height: width / 2, pixels, ..decoded })
}

/// The projection that a shape tells, and what a person should know of that.
fn guess(width: usize, height: usize, pixels: &[[f32; 3]]) -> (Projection, Option<String>) {
    let is_uniform = pixels.iter().all(|pixel| *pixel == pixels[0]);
    if is_uniform || width.abs_diff(2 * height) <= (width / 100).max(1) {
        return (Projection::LatLong, None);
    }
    let is_plain = |mut outside: Box<dyn Iterator<Item = [f32; 3]> + '_>| {
        let first = outside.next();
        first.is_some_and(|first| outside.all(|pixel| pixel == first))
    };
    let pixel = |i: usize| pixels[i];
    let fits = |projection: Projection| match layout(projection, width, height) {
        Some(Layout::Cube(faces, side)) if projection == Projection::CubeCross => {
            let is_outside = move |i: &usize| faces.iter().all(|face| face.at != [i % width / side, i / width / side]);
            is_plain(Box::new((0..pixels.len()).filter(is_outside).map(pixel)))
        }
        Some(Layout::Angular(diameter)) => {
            // The rim itself is often softened.
            let most = (diameter as f64 / 2.0 + 2.0) * (diameter as f64 / 2.0 + 2.0);
            let is_outside = move |i: &usize| {
                let [x, y] = [i % width, i / width].map(|at| at as f64 + 0.5 - diameter as f64 / 2.0);
                x * x + y * y > most
            };
            is_plain(Box::new((0..pixels.len()).filter(is_outside).map(pixel)))
        }
        Some(Layout::Cube(_, side)) => side >= LEAST_SIDE,
        _ => false,
    };
    let found = [Projection::CubeFaces, Projection::CubeCross, Projection::Angular].into_iter().find(|projection| fits(*projection));
    match found {
        Some(projection) => {
            let name = projection.name();
            (projection, Some(format!("is {width} x {height}: read as {name}; projection = \"lat_long\" reads it as a lat-long map")))
        }
        None => {
            let note = format!(
                "is {width} x {height} where a lat-long map is 2:1, and was read as one; if it is not, say projection = \"angular\", \
                 \"cube_cross\" or \"cube_faces\""
            );
            (Projection::LatLong, Some(note))
        }
    }
}

/// Fills `pixels`, `[width / 2, width]`, rows from the top.
fn resample(from: &Decoded, layout: &Layout, width: usize, pixels: &mut [[f32; 3]]) {
    let height = width / 2;
    let parts = if width <= 1024 { 8 } else { 4 };
    let middle = |i: usize, n: usize| (i as f64 + 0.5) / n as f64;
    let longitudes: Vec<[f64; 2]> = (0..width * parts)
        .map(|i| {
            let longitude = 2.0 * PI * (middle(i, width * parts) - 0.5);
            [libm::cos(longitude), libm::sin(longitude)]
        })
        .collect();
    let row = |y: usize, row: &mut [[f32; 3]]| {
        let edge = |y: usize| libm::sin(PI * (0.5 - y as f64 / height as f64));
        let (top, bottom) = (edge(y), edge(y + 1));
        let sines: Vec<f64> = (0..parts).map(|part| top + (bottom - top) * middle(part, parts)).collect();
        for (x, pixel) in row.iter_mut().enumerate() {
            let mut sum = [0.0f64; 3];
            for sine in &sines {
                let cosine = (1.0 - sine * sine).max(0.0).sqrt();
                for [cos, sin] in &longitudes[x * parts..][..parts] {
                    let found = layout.pixel([cosine * cos, *sine, cosine * sin], from.width);
                    (0..3).for_each(|k| sum[k] += f64::from(from.pixels[found][k]));
                }
            }
            *pixel = sum.map(|value| (value / (parts * parts) as f64) as f32);
        }
    };
    #[cfg(feature = "parallel")]
    {
        use rayon::prelude::*;
        pixels.par_chunks_exact_mut(width).enumerate().for_each(|(y, pixels)| row(y, pixels));
    }
    #[cfg(not(feature = "parallel"))]
    pixels.chunks_exact_mut(width).enumerate().for_each(|(y, pixels)| row(y, pixels));
}

impl Layout {
    /// Index of the pixel that a unit direction meets, in an image of this width.
    fn pixel(&self, direction: [f64; 3], width: usize) -> usize {
        let dot = |a: [f64; 3]| a[0] * direction[0] + a[1] * direction[1] + a[2] * direction[2];
        let cell = |position: f64, n: usize| ((position * n as f64) as usize).min(n - 1);
        match self {
            Layout::LatLong => 0,
            Layout::Angular(diameter) => {
                let [x, y, z] = direction;
                let across = (y * y + z * z).sqrt();
                // Half a pixel inside the rim, beyond which there is no map.
                let radius = (libm::atan2(across, x) / PI).min(1.0 - 1.0 / *diameter as f64);
                let [right, up] = if across > 0.0 { [z, y].map(|v| v / across * radius) } else { [0.0; 2] };
                cell(0.5 - up / 2.0, *diameter) * width + cell(0.5 + right / 2.0, *diameter)
            }
            Layout::Cube(faces, side) => {
                let mut nearest = &faces[0];
                faces.iter().for_each(|face| {
                    if dot(face.axis) > dot(nearest.axis) {
                        nearest = face;
                    }
                });
                let along = dot(nearest.axis);
                let [x, y] = [nearest.right, nearest.down].map(|axis| cell((dot(axis) / along + 1.0) / 2.0, *side));
                (nearest.at[1] * side + y) * width + nearest.at[0] * side + x
            }
        }
    }
}

/// Direction of a pixel's middle in an image of faces, not of unit length; `None` outside of the squares.
#[cfg(test)]
pub(super) fn face_of(projection: Projection, width: usize, height: usize, x: usize, y: usize) -> Option<[f64; 3]> {
    let Some(Layout::Cube(faces, side)) = layout(projection, width, height) else { return None };
    let face = faces.iter().find(|face| face.at == [x / side, y / side])?;
    let [u, v] = [x % side, y % side].map(|at| (at as f64 + 0.5) / side as f64 * 2.0 - 1.0);
    Some(std::array::from_fn(|k| face.axis[k] + u * face.right[k] + v * face.down[k]))
}
