//! The picture at its points: what is left of the error when nothing is interpolated.
//!
//! Each pixel is moved to the point that weighs most in it and drawn there, in the light of that point alone. A reference traced toward
//! the same places then shows the error at points; what the whole picture's error has beyond it is interpolation's.
//!
//! The place lies [`INSET`] of the way to the triangle's other corners, so that a ray from the eye meets this triangle and not a
//! neighbour across a hard edge.

use super::image::Image;
use super::raster::{TILE, Visibility, blend_corners};
use super::shade::{DrawScene, Shader, check_light, take_pixel};
use super::threads::map_indices;
use crate::error::RuntimeError;

/// Weight of each of the two other corners at the place that stands for a point.
pub(crate) const INSET: f32 = 0.01;

/// Radiance at points, pixel by pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct PointImage {
    /// Linear radiance toward the eye; black where there is no target.
    pub image: Image,
    /// `[height · width]` world position that each pixel was moved to; `None` on the background, behind BLEND and where no corner has
    /// a point that may light it.
    pub targets: Vec<Option<[f32; 3]>>,
}

/// Draws what `visibility` found, each pixel at a point; it must come from the same meshes and materials.
///
/// # Errors
/// As [`super::draw_visible`].
pub fn draw_at_points(scene: &DrawScene, visibility: &Visibility) -> Result<PointImage, RuntimeError> {
    check_light(scene)?;
    let (width, height) = (visibility.width, visibility.height);
    let tiles_x = width.div_ceil(TILE);
    let tiles = map_indices(visibility.tiles.len(), |tile| {
        let origin = [tile % tiles_x * TILE, tile / tiles_x * TILE];
        let shader = Shader { scene, visibility, origin };
        let (mut solid, mut blend) = (visibility.tiles[tile].solid.as_slice(), visibility.tiles[tile].blend.as_slice());
        let mut drawn = Vec::new();
        for pixel in 0..TILE * TILE {
            let (x, y) = (origin[0] + pixel % TILE, origin[1] + pixel / TILE);
            let solid_here = take_pixel(&mut solid, pixel);
            let blend_here = take_pixel(&mut blend, pixel);
            if x >= width || y >= height || !blend_here.is_empty() {
                continue;
            }
            let Some(fragment) = solid_here.iter().max_by_key(|fragment| fragment.samples.count_ones()) else { continue };
            if let Some((target, radiance)) = at_point(&shader, fragment.triangle, x, y) {
                drawn.push((y * width + x, target, radiance));
            }
        }
        drawn
    });
    let mut drawn = PointImage { image: Image::black(width, height), targets: vec![None; width * height] };
    for (at, target, radiance) in tiles.into_iter().flatten() {
        drawn.image.pixels[at] = radiance;
        drawn.targets[at] = Some(target);
    }
    Ok(drawn)
}

/// Place and radiance of the point that weighs most at the centre of a pixel.
fn at_point(shader: &Shader, triangle: u32, x: usize, y: usize) -> Option<([f32; 3], [f32; 3])> {
    let gathered = shader.gather(triangle)?;
    let there = gathered.edges.weights(x as f64 + 0.5, y as f64 + 0.5);
    let nearest = (0..3).filter(|k| gathered.points[*k].n == 1).max_by(|a, b| there[*a].total_cmp(&there[*b]))?;
    let at = |far: f32| std::array::from_fn(|k| if k == nearest { 1.0 - 2.0 * far } else { far });
    let target = blend_corners(at(INSET), gathered.corners.map(|v| gathered.mesh.position[v]));
    let eye = shader.visibility.rays.eye();
    let toward: [f32; 3] = std::array::from_fn(|k| target[k] - eye[k]);
    let length = toward.iter().map(|v| v * v).sum::<f32>().sqrt();
    let (radiance, alpha) = shader.place_at(&gathered, at(INSET), at(0.0), toward.map(|v| v / length));
    (alpha > 0.0 && length > 0.0).then_some((target, radiance))
}
