//! The scene that every format is compared on: a textured floor, and one ball mesh three times, upright, squeezed and mirrored.

use image::{DynamicImage, ImageFormat, RgbaImage};
use prelight_runtime::surface::{Material, TextureRef, Wrap};
use prelight_scene::export::{GlbBuilder, Transform};
use prelight_scene::{Mesh, Primitive};
use std::io::Cursor;

/// Sectors of the ball.
const SECTORS: u32 = 20;

/// A floor of 4 x 4 squares in y = 0, uv over 0..1.
pub fn floor(material: u32) -> Primitive {
    let mut floor = Primitive { normals: Some(Vec::new()), uvs: [Some(Vec::new()), None], material, ..Primitive::default() };
    for j in 0..5 {
        for i in 0..5 {
            let (u, v) = (i as f32 / 4.0, j as f32 / 4.0);
            floor.positions.push([2.0 * u - 1.0, 0.0, 2.0 * v - 1.0]);
            floor.normals.as_mut().unwrap().push([0.0, 1.0, 0.0]);
            floor.uvs[0].as_mut().unwrap().push([u, v]);
        }
    }
    for j in 0..4 {
        for i in 0..4 {
            let a = 5 * j + i;
            floor.triangles.extend([[a, a + 5, a + 6], [a, a + 6, a + 1]]);
        }
    }
    floor
}

/// A ball of radius 1 around the origin.
pub fn ball(material: u32) -> Primitive {
    let rings = SECTORS / 2;
    let mut ball = Primitive { normals: Some(Vec::new()), uvs: [Some(Vec::new()), None], material, ..Primitive::default() };
    for j in 0..=rings {
        for i in 0..=SECTORS {
            let (u, v) = (f64::from(i) / f64::from(SECTORS), f64::from(j) / f64::from(rings));
            let (around, down) = (u * std::f64::consts::TAU, v * std::f64::consts::PI);
            let p = [down.sin() * around.cos(), down.cos(), -down.sin() * around.sin()].map(|x| x as f32);
            ball.positions.push(p);
            ball.normals.as_mut().unwrap().push(p);
            ball.uvs[0].as_mut().unwrap().push([u as f32, v as f32]);
        }
    }
    let columns = SECTORS + 1;
    for j in 0..rings {
        for i in 0..SECTORS {
            let a = j * columns + i;
            if j > 0 {
                ball.triangles.push([a, a + columns, a + 1]);
            }
            if j + 1 < rings {
                ball.triangles.push([a + 1, a + columns, a + columns + 1]);
            }
        }
    }
    ball
}

/// A checker of two colours, smooth enough that a pixel's place hardly matters.
pub fn checker(format: ImageFormat) -> Vec<u8> {
    let image =
        RgbaImage::from_fn(
            8,
            8,
            |x, y| if (x / 4 + y / 4) % 2 == 0 { image::Rgba([200, 120, 60, 255]) } else { image::Rgba([60, 90, 160, 255]) },
        );
    encode(DynamicImage::ImageRgba8(image), format)
}

pub fn encode(image: DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

/// Bilinear, clamped, first set.
pub fn reference(texture: u32) -> Option<TextureRef> {
    Some(TextureRef { texture, uv_set: 0, wrap: [Wrap::Clamp; 2], nearest: false, transform: None })
}

/// Places of the balls.
pub fn places() -> [Transform; 3] {
    let at = |x: f32, z: f32, scale: [f32; 3]| Transform { scale, ..Transform::translation([x, scale[1], z]) };
    [at(-0.5, -0.2, [0.3; 3]), at(0.25, -0.4, [0.2, 0.4, 0.2]), at(0.4, 0.4, [-0.25, 0.2, 0.2])]
}

/// The whole scene: accessors 0..4 are the floor's positions, normals, uvs and indices, 4..8 the ball's.
pub fn room() -> GlbBuilder {
    let mut glb = GlbBuilder::new();
    let image = glb.image("checker", &checker(ImageFormat::Png));
    let tiles =
        Material { name: "Tiles".into(), base_color_texture: reference(image), metallic: 0.0, roughness: 0.9, ..Material::default() };
    let red = Material { name: "Red".into(), base_color: [0.8, 0.1, 0.1, 1.0], metallic: 0.0, roughness: 0.5, ..Material::default() };
    let (tiles, red) = (glb.material(&tiles), glb.material(&red));
    let floor = glb.mesh("Floor", &Mesh { primitives: vec![floor(tiles)] });
    let ball = glb.mesh("Ball", &Mesh { primitives: vec![ball(red)] });
    glb.node("Floor", None, Transform::default(), Some(floor));
    let root = glb.node("Balls", None, Transform::default(), None);
    for place in places() {
        glb.node("Ball", Some(root), place, Some(ball));
    }
    glb
}
