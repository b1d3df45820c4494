//! The demo's room: a corner with a window to the left, a table with things of different gloss, a plant, a picture.
//!
//! Metres. The floor is y = 0, the back wall z = −1.8 faces +Z, the left wall x = −2 faces +X and has the window. Front and right are open.

use super::paint;
use super::shapes::{append, cuboid, lathe, leaf, placed, ring, sheet, sheet_with_hole, sphere};
use crate::export::{GlbBuilder, Transform};
use crate::{Mesh, Primitive};
use prelight_runtime::draw::camera::{Camera, SceneCamera};
use prelight_runtime::error::RuntimeError;
use prelight_runtime::surface::{Material, Texture, TextureRef, Wrap};

const LEFT: f32 = -2.0;
const RIGHT: f32 = 2.6;
const BACK: f32 = -1.8;
const FRONT: f32 = 3.2;
const WALL: f32 = 3.1;
/// The window's wall is taller, so that the sun comes through the window only.
const WINDOW_WALL: f32 = 4.8;
/// The window: from and to, along z and up.
pub(super) const WINDOW: [[f32; 2]; 2] = [[-0.65, 0.85], [0.9, 2.3]];
const TABLE_TOP: f32 = 0.75;

/// Names of the cameras.
pub(super) const CAMERAS: [&str; 2] = ["room", "table"];

/// The whole scene as a binary glTF.
///
/// # Errors
/// When a texture cannot be encoded.
pub(super) fn glb() -> Result<Vec<u8>, RuntimeError> {
    let mut room = Room { glb: GlbBuilder::new() };
    room.shell()?;
    room.table()?;
    room.on_the_table();
    room.around();
    let up = [0.0, 1.0, 0.0];
    let views = [
        Camera::new([2.35, 1.62, 2.75], [-0.22, 0.86, -0.42], up, 38.0)?,
        Camera::new([0.78, 1.22, 1.22], [-0.06, 0.83, -0.16], up, 34.0)?,
    ];
    for (name, camera) in CAMERAS.iter().zip(views) {
        room.glb.camera(&SceneCamera { name: name.to_string(), camera });
    }
    Ok(room.glb.to_glb())
}

struct Room {
    glb: GlbBuilder,
}

/// sRGB bytes as a linear colour.
fn colour(srgb: [u8; 3]) -> [f32; 4] {
    let linear = srgb.map(|byte| prelight_runtime::draw::tonemap::linear_from_srgb(f32::from(byte) / 255.0));
    [linear[0], linear[1], linear[2], 1.0]
}

impl Room {
    fn material(&mut self, name: &str, base_color: [f32; 4], roughness: f32, metallic: f32) -> u32 {
        self.glb.material(&Material { name: name.to_string(), base_color, roughness, metallic, ..Material::default() })
    }

    /// A material with a texture; `scale` is not applied here: texture coordinates come scaled.
    fn textured(&mut self, name: &str, texture: &Texture, roughness: f32) -> Result<u32, RuntimeError> {
        let image = self.glb.image(name, &png(texture)?);
        let base_color_texture = Some(TextureRef { texture: image, uv_set: 0, wrap: [Wrap::Repeat; 2], nearest: false, transform: None });
        let material = Material { name: name.to_string(), base_color_texture, roughness, metallic: 0.0, ..Material::default() };
        Ok(self.glb.material(&material))
    }

    fn add(&mut self, name: &str, primitives: Vec<Primitive>, transform: Transform) {
        let mesh = self.glb.mesh(name, &Mesh { primitives });
        self.glb.node(name, None, transform, Some(mesh));
    }

    fn shell(&mut self) -> Result<(), RuntimeError> {
        let plaster = self.material("Plaster", colour([226, 219, 206]), 0.95, 0.0);
        let paint = self.material("White paint", colour([236, 234, 228]), 0.45, 0.0);
        let oak = self.textured("Oak floor", &paint::oak_planks(), 0.38)?;
        let depth = FRONT - BACK;

        let mut floor = sheet([LEFT, 0.0, FRONT], [RIGHT - LEFT, 0.0, 0.0], [0.0, 0.0, -depth], oak);
        scale_uv(&mut floor, [1.0 / 1.8; 2]);
        self.add("Floor", vec![floor], Transform::default());
        self.add("Back wall", vec![sheet([LEFT, 0.0, BACK], [RIGHT - LEFT, 0.0, 0.0], [0.0, WALL, 0.0], plaster)], Transform::default());

        // Along −z, so shares run from the front.
        let [along, up] = WINDOW;
        let hole = [[(FRONT - along[1]) / depth, (FRONT - along[0]) / depth], up.map(|y| y / WINDOW_WALL)];
        let left = sheet_with_hole([LEFT, 0.0, FRONT], [0.0, 0.0, -depth], [0.0, WINDOW_WALL, 0.0], hole, plaster);
        let (wide, high) = (along[1] - along[0], up[1] - up[0]);
        const DEEP: f32 = 0.2;
        let (near, far) = (along[1], along[0]);
        let mut reveal = sheet([LEFT - DEEP, up[0], near], [DEEP, 0.0, 0.0], [0.0, 0.0, -wide], plaster);
        append(&mut reveal, sheet([LEFT - DEEP, up[1], far], [DEEP, 0.0, 0.0], [0.0, 0.0, wide], plaster));
        append(&mut reveal, sheet([LEFT, up[0], far], [-DEEP, 0.0, 0.0], [0.0, high, 0.0], plaster));
        append(&mut reveal, sheet([LEFT - DEEP, up[0], near], [DEEP, 0.0, 0.0], [0.0, high, 0.0], plaster));
        // Reveals face into the opening.
        flip_toward(&mut reveal, [LEFT - 0.5 * DEEP, 0.5 * (up[0] + up[1]), 0.5 * (near + far)]);
        append(&mut reveal, left);
        self.add("Window wall", vec![reveal], Transform::default());

        const BAR: f32 = 0.055;
        let x = LEFT - 0.5 * DEEP - 0.5 * BAR;
        let bar = |low: [f32; 2], size: [f32; 2]| cuboid([x, low[1], low[0]], [BAR, size[1], size[0]], paint);
        let mut frame = bar([along[0], up[0]], [wide, BAR]);
        append(&mut frame, bar([along[0], up[1] - BAR], [wide, BAR]));
        for z in [along[0], along[1] - BAR, 0.5 * (along[0] + along[1] - BAR)] {
            append(&mut frame, bar([z, up[0] + BAR], [BAR, high - 2.0 * BAR]));
        }
        let middle = 0.5 * (wide - 3.0 * BAR);
        for z in [along[0] + BAR, along[0] + 2.0 * BAR + middle] {
            append(&mut frame, bar([z, up[0] + 0.62 * high], [middle, BAR]));
        }
        self.add("Window frame", vec![frame], Transform::default());
        let sill = cuboid([LEFT - 0.02, up[0] - 0.035, along[0] - 0.08], [0.16, 0.035, wide + 0.16], paint);
        let mut boards = cuboid([LEFT + 0.016, 0.0, BACK], [RIGHT - LEFT - 0.016, 0.09, 0.016], paint);
        append(&mut boards, cuboid([LEFT, 0.0, BACK], [0.016, 0.09, depth], paint));
        append(&mut boards, sill);
        self.add("Skirting and sill", vec![boards], Transform::default());
        Ok(())
    }

    fn table(&mut self) -> Result<(), RuntimeError> {
        let walnut = self.textured("Walnut", &paint::walnut(), 0.32)?;
        let (wide, deep, thick, leg) = (1.55, 0.88, 0.038, 0.055);
        let top = TABLE_TOP - thick;
        let mut table = cuboid([-0.5 * wide, top, -0.5 * deep], [wide, thick, deep], walnut);
        for sx in [-1.0, 1.0] {
            for sz in [-1.0, 1.0] {
                let foot = [sx * (0.5 * wide - 0.09) - 0.5 * leg, 0.0, sz * (0.5 * deep - 0.08) - 0.5 * leg];
                append(&mut table, cuboid(foot, [leg, top, leg], walnut));
            }
            append(&mut table, cuboid([sx * (0.5 * wide - 0.09) - 0.011, top - 0.075, -0.36 + 0.0525], [0.022, 0.075, 0.615], walnut));
        }
        for sz in [-1.0, 1.0] {
            append(&mut table, cuboid([-0.6575, top - 0.075, sz * (0.5 * deep - 0.08) - 0.011], [1.315, 0.075, 0.022], walnut));
        }
        scale_uv(&mut table, [0.9, 0.9]);
        self.add("Table", vec![table], Transform::turned([0.0, 0.008, -0.3], 4.0));

        let rug = self.textured("Rug", &paint::rug(), 1.0)?;
        let mut cloth = cuboid([-1.25, 0.0, -0.95], [2.5, 0.008, 1.9], rug);
        // The pattern once over the top, its edge colour on the sides.
        let positions = cloth.positions.clone();
        for (uv, p) in cloth.uvs[0].iter_mut().flatten().zip(&positions) {
            *uv = [(p[0] + 1.25) / 2.5, (p[2] + 0.95) / 1.9];
        }
        self.add("Rug", vec![cloth], Transform::turned([0.1, 0.0, -0.1], 4.0));
        Ok(())
    }

    fn on_the_table(&mut self) {
        let top = TABLE_TOP + 0.008;
        let glaze = self.material("Teal glaze", colour([18, 92, 98]), 0.14, 0.0);
        self.add("Vase", vec![lathe(&vase(), 96, glaze)], Transform::translation([-0.36, top, -0.47]));

        let brass = self.material("Brass", [0.87, 0.62, 0.27, 1.0], 0.28, 1.0);
        self.add("Goblet", vec![lathe(&goblet(), 80, brass)], Transform::translation([0.16, top, -0.46]));

        // A bowl with fruit.
        let clay = self.material("Terracotta", colour([176, 96, 66]), 0.9, 0.0);
        let peel = self.material("Orange peel", colour([236, 128, 24]), 0.42, 0.0);
        self.add("Bowl", vec![lathe(&bowl(), 80, clay)], Transform::translation([-0.02, top, -0.14]));
        let fruit = [[-0.052, 0.066, 0.022], [0.05, 0.067, 0.032], [0.004, 0.066, -0.055], [0.003, 0.135, 0.002]];
        let oranges = self.glb.mesh("Orange", &Mesh { primitives: vec![sphere(0.043, 48, peel)] });
        for [x, y, z] in fruit {
            self.glb.node("Orange", None, Transform::translation([x - 0.02, top + y, z - 0.14]), Some(oranges));
        }

        // Books with a steel ring on them.
        let covers = [[126, 38, 34], [36, 62, 92], [214, 196, 150]];
        let paper = self.material("Paper", colour([232, 226, 210]), 0.95, 0.0);
        let (mut height, mut books) = (0.0, Vec::new());
        for (i, (cover, (size, degrees))) in
            covers.into_iter().zip([([0.25, 0.036, 0.18], 12.0), ([0.23, 0.028, 0.165], -6.0), ([0.2, 0.024, 0.15], 21.0)]).enumerate()
        {
            let cloth = self.material(&format!("Book cloth {}", i + 1), colour(cover), 0.6, 0.0);
            let [wide, thick, deep] = size;
            let board = 0.003;
            let mut shell = cuboid([-0.5 * wide, 0.0, -0.5 * deep], [wide, board, deep], cloth);
            append(&mut shell, cuboid([-0.5 * wide, thick - board, -0.5 * deep], [wide, board, deep], cloth));
            append(&mut shell, cuboid([-0.5 * wide, board, -0.5 * deep], [board, thick - 2.0 * board, deep], cloth));
            let pages =
                cuboid([-0.5 * wide + board, board, -0.5 * deep + 0.005], [wide - board - 0.005, thick - 2.0 * board, deep - 0.01], paper);
            books.extend([placed(shell, degrees, [0.0, height, 0.0]), placed(pages, degrees, [0.0, height, 0.0])]);
            height += thick;
        }
        let books_at = [0.46, top, -0.3];
        self.add("Books", books, Transform::translation(books_at));
        let steel = self.material("Steel", [0.76, 0.75, 0.73, 1.0], 0.2, 1.0);
        let (radius, thickness) = (0.075, 0.021);
        let upright = [books_at[0], top + height + radius + thickness, books_at[2]];
        self.add("Ring", vec![ring(radius, thickness, 96, 40, steel)], Transform::turned(upright, -28.0));

        // Painted blocks.
        let paints = [([190, 56, 44], 0.5), ([222, 176, 60], 0.5), ([58, 108, 84], 0.5)];
        let places = [([-0.5, 0.0, -0.1], 24.0), ([-0.415, 0.0, -0.075], -16.0), ([-0.462, 0.062, -0.09], 8.0)];
        for (i, ((srgb, roughness), (place, degrees))) in paints.into_iter().zip(places).enumerate() {
            let lacquer = self.material(&format!("Block paint {}", i + 1), colour(srgb), roughness, 0.0);
            let block = cuboid([-0.031, 0.0, -0.031], [0.062, 0.062, 0.062], lacquer);
            let place = [place[0], top + place[1], place[2]];
            self.add("Block", vec![block], Transform::turned(place, degrees));
        }
    }

    fn around(&mut self) {
        let pot = self.material("Grey pot", colour([120, 122, 120]), 0.75, 0.0);
        let soil = self.material("Soil", colour([58, 44, 34]), 1.0, 0.0);
        let green = Material {
            name: "Leaf".to_string(),
            base_color: colour([62, 104, 48]),
            roughness: 0.48,
            metallic: 0.0,
            double_sided: true,
            ..Material::default()
        };
        let green = self.glb.material(&green);
        let at = [1.45, 0.0, -1.2];
        let earth = lathe(&[[0.165, 0.30], [0.0, 0.312]], 40, soil);
        self.add("Pot", vec![lathe(&pot_profile(), 64, pot), earth], Transform::translation(at));
        let mut leaves = Primitive { material: green, ..Primitive::default() };
        const LEAVES: u32 = 26;
        for i in 0..LEAVES {
            // Sunflower order: the inner ones stand, the outer ones hang.
            let share = i as f32 / (LEAVES - 1) as f32;
            let azimuth = i as f32 * 2.399_963;
            let blade = leaf(azimuth, 0.14 + 0.42 * share, 0.98 - 0.42 * share, 0.085, green);
            let (sine, cosine) = (libm::sinf(azimuth), libm::cosf(azimuth));
            append(&mut leaves, placed(blade, 0.0, [0.05 * share * sine, 0.3, 0.05 * share * cosine]));
        }
        self.add("Plant", vec![leaves], Transform::translation(at));

        let wood = self.material("Black wood", colour([34, 30, 28]), 0.4, 0.0);
        let (wide, high, deep, rim) = (0.62, 0.8, 0.03, 0.03);
        let low = [0.05, 1.28, BACK];
        let mut frame = cuboid(low, [wide, rim, deep], wood);
        append(&mut frame, cuboid([low[0], low[1] + high - rim, BACK], [wide, rim, deep], wood));
        append(&mut frame, cuboid([low[0], low[1] + rim, BACK], [rim, high - 2.0 * rim, deep], wood));
        append(&mut frame, cuboid([low[0] + wide - rim, low[1] + rim, BACK], [rim, high - 2.0 * rim, deep], wood));
        self.add("Picture frame", vec![frame], Transform::default());
        // The print itself; a texture that fails to encode leaves white paper.
        let print = self.textured("Print", &paint::picture(), 0.85).unwrap_or(wood);
        let mut sheet =
            sheet([low[0] + rim, low[1] + rim, BACK + 0.012], [wide - 2.0 * rim, 0.0, 0.0], [0.0, high - 2.0 * rim, 0.0], print);
        scale_uv(&mut sheet, [1.0 / (wide - 2.0 * rim), 1.0 / (high - 2.0 * rim)]);
        self.add("Picture", vec![sheet], Transform::default());
    }
}

/// PNG bytes of a painted texture.
fn png(texture: &Texture) -> Result<Vec<u8>, RuntimeError> {
    use image::ImageEncoder;
    let rgb: Vec<u8> = texture.texels.chunks(4).flat_map(|t| [t[0], t[1], t[2]]).collect();
    let mut bytes = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut bytes);
    let written = encoder.write_image(&rgb, texture.width, texture.height, image::ExtendedColorType::Rgb8);
    written.map_err(|error| RuntimeError::Image { file: "demo texture".to_string(), what: error.to_string() })?;
    Ok(bytes)
}

fn scale_uv(shape: &mut Primitive, scale: [f32; 2]) {
    shape.uvs[0].iter_mut().flatten().for_each(|uv| *uv = [uv[0] * scale[0], uv[1] * scale[1]]);
}

/// Turns every triangle, with its own normals, to the side of `inside`.
fn flip_toward(shape: &mut Primitive, inside: [f32; 3]) {
    let Some(normals) = &mut shape.normals else { return };
    for (normal, p) in normals.iter_mut().zip(&shape.positions) {
        if (0..3).map(|k| normal[k] * (inside[k] - p[k])).sum::<f32>() < 0.0 {
            *normal = normal.map(|v| -v);
        }
    }
    for t in &mut shape.triangles {
        let [a, b, c] = t.map(|v| shape.positions[v as usize]);
        let (u, v): ([f32; 3], [f32; 3]) = (std::array::from_fn(|k| b[k] - a[k]), std::array::from_fn(|k| c[k] - a[k]));
        let face = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        let normal = normals[t[0] as usize];
        if (0..3).map(|k| normal[k] * face[k]).sum::<f32>() < 0.0 {
            t.swap(1, 2);
        }
    }
}

/// A smooth curve through points (radius, height): Catmull-Rom, `steps` a span.
fn curve(points: &[[f32; 2]], steps: usize) -> Vec<[f32; 2]> {
    let mut out = Vec::new();
    for i in 0..points.len() - 1 {
        let at = |k: isize| points[(i as isize + k).clamp(0, points.len() as isize - 1) as usize];
        let [p, q, r, s] = [at(-1), at(0), at(1), at(2)];
        for step in 0..steps {
            let t = step as f32 / steps as f32;
            out.push([0, 1].map(|k| {
                let linear = (r[k] - p[k]) * t;
                let square = (2.0 * p[k] - 5.0 * q[k] + 4.0 * r[k] - s[k]) * t * t;
                let cube = (3.0 * q[k] - p[k] - 3.0 * r[k] + s[k]) * t * t * t;
                // On the axis, exactly.
                (q[k] + 0.5 * (linear + square + cube)).max(0.0)
            }));
        }
    }
    out.push(points[points.len() - 1]);
    out
}

fn vase() -> Vec<[f32; 2]> {
    let outside = curve(&[[0.048, 0.0], [0.062, 0.02], [0.098, 0.11], [0.083, 0.2], [0.036, 0.275], [0.033, 0.31], [0.05, 0.345]], 9);
    let inside = curve(&[[0.046, 0.345], [0.029, 0.31], [0.031, 0.275], [0.07, 0.2], [0.07, 0.1]], 5);
    let foot = [[0.0, 0.0], [0.048, 0.0], [0.048, 0.0]];
    [&foot[..], &outside[1..], &inside[..], &[[0.0, 0.05]]].concat()
}

fn goblet() -> Vec<[f32; 2]> {
    let outside = curve(
        &[[0.052, 0.006], [0.03, 0.014], [0.011, 0.03], [0.0095, 0.065], [0.013, 0.088], [0.036, 0.105], [0.05, 0.14], [0.047, 0.19]],
        8,
    );
    let inside = curve(&[[0.0445, 0.19], [0.0475, 0.142], [0.034, 0.11], [0.012, 0.098]], 6);
    let foot = [[0.0, 0.0], [0.052, 0.0], [0.052, 0.0], [0.052, 0.006]];
    [&foot[..], &outside[1..], &inside[..], &[[0.0, 0.097]]].concat()
}

fn bowl() -> Vec<[f32; 2]> {
    let outside = curve(&[[0.055, 0.0], [0.085, 0.018], [0.125, 0.06], [0.142, 0.1]], 8);
    let inside = curve(&[[0.136, 0.1], [0.118, 0.062], [0.08, 0.024], [0.04, 0.014]], 8);
    let foot = [[0.0, 0.0], [0.055, 0.0], [0.055, 0.0]];
    [&foot[..], &outside[1..], &inside[..], &[[0.0, 0.013]]].concat()
}

fn pot_profile() -> Vec<[f32; 2]> {
    vec![
        [0.0, 0.0],
        [0.13, 0.0],
        [0.13, 0.0],
        [0.145, 0.11],
        [0.16, 0.22],
        [0.175, 0.33],
        [0.175, 0.33],
        [0.192, 0.33],
        [0.192, 0.33],
        [0.192, 0.345],
        [0.192, 0.345],
        [0.165, 0.345],
        [0.165, 0.345],
        [0.165, 0.30],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vessels_close_on_the_axis_and_never_cross_it() {
        for profile in [vase(), goblet(), bowl(), pot_profile()] {
            assert_eq!(profile[0], [0.0, 0.0]);
            assert!(profile.iter().all(|p| p[0] >= 0.0 && p[1] >= 0.0));
        }
    }
}
