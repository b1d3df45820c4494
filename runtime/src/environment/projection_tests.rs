//! Claims about projections: where each puts a direction, what tells them apart, and that light keeps its amount.

use super::projection::{CROSS, FACES, face_of};
use super::{CleanReport, Environment, LightCubemap, Limits, MapOptions, Projection};

/// Any smooth light that tells directions apart.
fn smooth(d: [f64; 3]) -> [f32; 3] {
    d.map(|component| (1.0 + component) as f32)
}

fn image(width: usize, height: usize, light: impl Fn(usize, usize) -> [f32; 3]) -> Vec<u8> {
    Environment::new(width, height, (0..width * height).map(|i| light(i % width, i / width)).collect()).to_exr().unwrap()
}

fn decode(bytes: &[u8], projection: Option<Projection>) -> Result<(Environment, CleanReport), String> {
    let options = MapOptions { projection, layer: None };
    Environment::decode_as("map.exr", bytes, &options, &Limits::default()).map_err(|error| error.to_string())
}

fn unit(d: [f64; 3]) -> [f64; 3] {
    let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
    d.map(|v| v / length)
}

/// A column of faces as OpenEXR defines it: the two coordinates beside the axis, each over 0..1 of the square.
fn openexr_face(x: usize, y: usize, side: usize) -> [f64; 3] {
    let at = |i: usize| (i as f64 + 0.5) / side as f64 * 2.0 - 1.0;
    let (u, v) = (at(x), at(y % side));
    unit(match y / side {
        0 => [1.0, -v, u],
        1 => [-1.0, -v, -u],
        2 => [u, 1.0, -v],
        3 => [u, -1.0, v],
        4 => [-u, -v, 1.0],
        _ => [u, -v, -1.0],
    })
}

/// Directions over the sphere.
fn directions() -> impl Iterator<Item = [f64; 3]> {
    (0..500).map(|i| {
        let (y, turn) = (1.0 - (i as f64 + 0.5) / 250.0, i as f64 * 2.399963);
        let across = (1.0 - y * y).sqrt();
        [across * turn.cos(), y, across * turn.sin()]
    })
}

fn shows_smooth_light(map: &Environment, tolerance: f32) {
    for direction in directions() {
        let (found, expected) = (map.radiance(direction.map(|v| v as f32)), smooth(direction));
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < tolerance), "{direction:?}: {found:?} {expected:?}");
    }
}

#[test]
fn cube_faces_lie_as_openexr_lays_them() {
    let column = image(64, 384, |x, y| smooth(openexr_face(x, y, 64)));
    let row = image(384, 64, |x, y| smooth(openexr_face(x % 64, x / 64 * 64 + y, 64)));
    for file in [column, row] {
        let (map, report) = decode(&file, None).unwrap();
        shows_smooth_light(&map, 0.05);
        assert!(report.warnings()[0].contains("read as cube_faces"), "{:?}", report.warnings());
        assert!(decode(&file, Some(Projection::CubeFaces)).unwrap().1.warnings().is_empty());
    }
}

#[test]
fn every_face_is_seen_from_within_and_the_cross_holds_together() {
    let cross = |a: [f64; 3], b: [f64; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    for face in FACES.iter().chain(&CROSS) {
        assert_eq!(cross(face.right, face.down).map(|v| v + 0.0), face.axis.map(|v| v + 0.0));
    }
    // Where two squares of a cross touch, the middle of the edge is one direction.
    let sum = |a: [f64; 3], b: [f64; 3], sign: f64| std::array::from_fn::<f64, 3, _>(|k| a[k] + sign * b[k]);
    for (i, face) in CROSS.iter().enumerate() {
        for other in &CROSS[..i] {
            let (dx, dy) = (other.at[0] as i64 - face.at[0] as i64, other.at[1] as i64 - face.at[1] as i64);
            let (axis, sign) = match (dx, dy) {
                (1 | -1, 0) => (face.right, dx as f64),
                (0, 1 | -1) => (face.down, dy as f64),
                _ => continue,
            };
            let others = if dx != 0 { other.right } else { other.down };
            assert_eq!(sum(face.axis, axis, sign), sum(other.axis, others, -sign), "{face:?} {other:?}");
        }
    }
}

#[test]
fn crosses_put_their_middle_where_a_lat_long_map_has_it() {
    for (width, height) in [(96, 128), (128, 96)] {
        let file = image(width, height, |x, y| face_of(Projection::CubeCross, width, height, x, y).map_or([0.0; 3], |d| smooth(unit(d))));
        let (map, report) = decode(&file, None).unwrap();
        shows_smooth_light(&map, 0.1);
        assert!(report.warnings()[0].contains("read as cube_cross"), "{:?}", report.warnings());
    }
    // A picture of that shape whose corners are not empty is no cross, unless somebody says so.
    let photo = image(128, 96, |x, y| [x as f32, y as f32, 1.0]);
    let (map, report) = decode(&photo, None).unwrap();
    assert_eq!((map.width, map.height), (128, 96));
    assert!(report.warnings()[0].contains("where a lat-long map is 2:1"), "{:?}", report.warnings());
    assert_eq!(decode(&photo, Some(Projection::CubeCross)).unwrap().0.width, 256);
}

#[test]
fn an_angular_map_has_its_axis_in_the_middle_and_its_back_on_the_rim() {
    let side = 201;
    let file = image(side, side, |x, y| {
        let [right, up] = [x as f64 + 0.5, side as f64 - y as f64 - 0.5].map(|v| v / side as f64 * 2.0 - 1.0);
        let radius = (right * right + up * up).sqrt();
        if radius > 1.0 {
            return [0.0; 3];
        }
        let angle = std::f64::consts::PI * radius;
        let across = angle.sin() / radius.max(1e-9);
        smooth([angle.cos(), up * across, right * across])
    });
    let (map, report) = decode(&file, None).unwrap();
    shows_smooth_light(&map, 0.12);
    assert!(report.warnings()[0].contains("read as angular"), "{:?}", report.warnings());
}

#[test]
fn shapes_that_do_not_fit_are_refused_with_the_shape_that_would() {
    let file = image(64, 32, |x, _| [x as f32; 3]);
    assert!(decode(&file, None).unwrap().1.warnings().is_empty());
    for (projection, words) in [(Projection::CubeFaces, "1:6"), (Projection::CubeCross, "3:4"), (Projection::Angular, "as wide as high")] {
        let error = decode(&file, Some(projection)).unwrap_err();
        assert!(error.contains("64 x 32") && error.contains(words), "{error}");
    }
}

#[test]
fn light_of_a_cube_keeps_its_amount() {
    let file = image(16, 96, |x, y| [1.0 + (x * y % 7) as f32, if (x, y) == (3, 20) { 400.0 } else { 0.0 }, 1.0]);
    let (map, _) = decode(&file, Some(Projection::CubeFaces)).unwrap();
    let (_, energy) = LightCubemap::with_energy(&map, 64);
    // Solid angle of a texel: 4/n² over (1 + u² + v²)^1.5 at its middle.
    let at = |i: usize| (i as f64 + 0.5) / 8.0 - 1.0;
    let solid = |x: usize, y: usize| 4.0 / 256.0 / (1.0 + at(x) * at(x) + at(y % 16) * at(y % 16)).powf(1.5);
    let mut sum = [0.0; 2];
    for y in 0..96 {
        for x in 0..16 {
            sum[0] += (1.0 + (x * y % 7) as f64) * solid(x, y);
        }
    }
    sum[1] = 400.0 * solid(3, 20);
    for k in 0..2 {
        assert!((energy.before[k] / sum[k] - 1.0).abs() < 0.02, "{:?} {sum:?}", energy.before);
    }
}
