//! Shapes as primitives: turned on a lathe, boxes, sheets, rings and leaves.
//!
//! Lengths in metres, Y up, triangles counter-clockwise from outside. Texture coordinates run once around a turned shape; on boxes
//! and sheets one unit is one metre, so that textures keep their scale.

use crate::Primitive;

type Vector = [f32; 3];

/// A grid of `columns + 1` x `rows + 1` vertices; `vertex(column, row)` gives position, normal and texture coordinate.
fn grid(columns: u32, rows: u32, material: u32, vertex: impl Fn(u32, u32) -> (Vector, Vector, [f32; 2])) -> Primitive {
    let mut shape = Primitive { material, normals: Some(Vec::new()), uvs: [Some(Vec::new()), None], ..Primitive::default() };
    for row in 0..=rows {
        for column in 0..=columns {
            let (position, normal, uv) = vertex(column, row);
            push(&mut shape, position, normal, uv);
            if row < rows && column < columns {
                let a = row * (columns + 1) + column;
                let d = a + columns + 1;
                shape.triangles.extend([[a, a + 1, d + 1], [a, d + 1, d]]);
            }
        }
    }
    drop_empty_triangles(&mut shape);
    shape
}

fn push(shape: &mut Primitive, position: Vector, normal: Vector, uv: [f32; 2]) {
    shape.positions.push(position);
    shape.normals.get_or_insert_default().push(normal);
    shape.uvs[0].get_or_insert_default().push(uv);
}

/// Triangles at the poles of turned shapes have two equal corners.
fn drop_empty_triangles(shape: &mut Primitive) {
    let positions = &shape.positions;
    shape.triangles.retain(|t| {
        let [a, b, c] = t.map(|v| positions[v as usize]);
        a != b && b != c && c != a
    });
}

/// A profile turned about the Y axis: (radius, height) from the bottom up on the outside, then down on the inside if it is a vessel.
///
/// The normal at a profile point is that of its two neighbours' line; two equal points in a row make a sharp edge.
pub(super) fn lathe(profile: &[[f32; 2]], sectors: u32, material: u32) -> Primitive {
    // Parts between sharp edges, each a grid of its own.
    let mut parts: Vec<Vec<[f32; 2]>> = vec![Vec::new()];
    for (i, point) in profile.iter().enumerate() {
        if i > 0 && profile[i - 1] == *point {
            parts.push(Vec::new());
        }
        let last = parts.len() - 1;
        parts[last].push(*point);
    }
    let mut whole = Primitive { material, ..Primitive::default() };
    for part in parts.iter().filter(|part| part.len() > 1) {
        let length: Vec<f32> = std::iter::once(0.0)
            .chain(part.windows(2).scan(0.0, |sum, pair| {
                *sum += distance(pair[0], pair[1]);
                Some(*sum)
            }))
            .collect();
        let rows = part.len() as u32 - 1;
        let turned = grid(sectors, rows, material, |column, row| {
            let row = row as usize;
            let (before, after) = (part[row.saturating_sub(1)], part[(row + 1).min(part.len() - 1)]);
            let along = [after[0] - before[0], after[1] - before[1]];
            let scale = 1.0 / (along[0] * along[0] + along[1] * along[1]).sqrt();
            let (sine, cosine) = turn(column, sectors);
            let (outward, upward) = (along[1] * scale, -along[0] * scale);
            let [radius, height] = part[row];
            // On the axis every sector has the same normal.
            let outward = if radius == 0.0 { 0.0 } else { outward };
            let normal = unit([outward * sine, upward, outward * cosine]);
            ([radius * sine, height, radius * cosine], normal, [column as f32 / sectors as f32, length[row]])
        });
        append(&mut whole, turned);
    }
    whole
}

/// Sine and cosine of a part of a turn; the last column has exactly the first one's.
fn turn(column: u32, columns: u32) -> (f32, f32) {
    let angle = f64::from(column % columns) / f64::from(columns) * 2.0 * std::f64::consts::PI;
    (libm::sin(angle) as f32, libm::cos(angle) as f32)
}

/// A sphere around the origin.
pub(super) fn sphere(radius: f32, sectors: u32, material: u32) -> Primitive {
    let rows = sectors / 2;
    let at = |row: u32| {
        let angle = (f64::from(row) / f64::from(rows) - 0.5) * std::f64::consts::PI;
        // Exactly on the axis at the poles.
        let cosine = if row == 0 || row == rows { 0.0 } else { libm::cos(angle) };
        [radius * cosine as f32, radius * libm::sin(angle) as f32]
    };
    lathe(&(0..=rows).map(at).collect::<Vec<_>>(), sectors, material)
}

/// A ring that stands upright in the plane of X and Y, around the origin.
pub(super) fn ring(radius: f32, thickness: f32, sectors: u32, sides: u32, material: u32) -> Primitive {
    grid(sectors, sides, material, |column, row| {
        let (sine, cosine) = turn(column, sectors);
        let (lift, out) = turn(row, sides);
        let normal = [cosine * out, sine * out, lift];
        let position = [cosine * (radius + thickness * out), sine * (radius + thickness * out), thickness * lift];
        (position, normal, [column as f32 / sectors as f32, row as f32 / sides as f32])
    })
}

/// A parallelogram from `corner` along `u` and `v`, facing u × v.
pub(super) fn sheet(corner: Vector, u: Vector, v: Vector, material: u32) -> Primitive {
    let normal = unit([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]);
    let size = [u, v].map(|side| (side[0] * side[0] + side[1] * side[1] + side[2] * side[2]).sqrt());
    grid(1, 1, material, |column, row| {
        let (s, t) = (column as f32, row as f32);
        let position = std::array::from_fn(|k| corner[k] + u[k] * s + v[k] * t);
        (position, normal, [size[0] * s, size[1] * (1.0 - t)])
    })
}

/// [`sheet`] with a rectangular hole: `hole` is (from, to) along u and along v, as shares of the sides. Its eight parts share corners.
pub(super) fn sheet_with_hole(corner: Vector, u: Vector, v: Vector, hole: [[f32; 2]; 2], material: u32) -> Primitive {
    let steps = hole.map(|[from, to]| [0.0, from, to, 1.0]);
    let at = |s: f32, t: f32| -> Vector { std::array::from_fn(|k| corner[k] + u[k] * s + v[k] * t) };
    let size = [u, v].map(|side| (side[0] * side[0] + side[1] * side[1] + side[2] * side[2]).sqrt());
    let normal = unit([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]);
    let mut wall = grid(3, 3, material, |column, row| {
        let (s, t) = (steps[0][column as usize], steps[1][row as usize]);
        (at(s, t), normal, [size[0] * s, size[1] * (1.0 - t)])
    });
    // Two triangles a cell, row by row: the middle cell is the fifth.
    wall.triangles.drain(8..10);
    wall
}

/// A box with its lowest corner at `low`.
pub(super) fn cuboid(low: Vector, size: Vector, material: u32) -> Primitive {
    let mut shape = Primitive { material, ..Primitive::default() };
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut along = [[0.0; 3]; 2];
        (along[0][u], along[1][v]) = (size[u], size[v]);
        let mut far = low;
        far[axis] += size[axis];
        append(&mut shape, sheet(far, along[0], along[1], material));
        append(&mut shape, sheet(low, along[1], along[0], material));
    }
    shape
}

/// A leaf: starts at the origin, rises by about `rise` while it reaches `reach` along `azimuth` (radians from +Z toward +X), and hangs over at its end.
/// It has no thickness: its material must be double-sided.
pub(super) fn leaf(azimuth: f32, reach: f32, rise: f32, width: f32, material: u32) -> Primitive {
    const ROWS: u32 = 20;
    let (sine, cosine) = (libm::sinf(azimuth), libm::cosf(azimuth));
    // The spine is a parabola: up first, then over.
    let spine = |t: f32| [reach * t * (0.35 + 0.65 * t), rise * t * (2.2 - 1.35 * t)];
    grid(4, ROWS, material, |column, row| {
        let t = row as f32 / ROWS as f32;
        // From +1 to −1, so that the upper side is the front.
        let across = 1.0 - column as f32 / 2.0;
        let half = 0.5 * width * libm::sinf(std::f32::consts::PI * (0.06 + 0.94 * t).min(1.0)).max(0.0).sqrt();
        let [out, up] = spine(t);
        let step = 0.01;
        let (a, b) = (spine(t - step), spine(t + step));
        let slope = [b[0] - a[0], b[1] - a[1]];
        // A shallow V across.
        let fold = 0.25;
        let place = |out: f32, side: f32, up: f32| [out * sine + side * cosine, up, out * cosine - side * sine];
        let position = place(out, across * half, up + fold * half * across.abs());
        let tilt = fold * if across == 0.0 { 0.0 } else { across.signum() };
        let normal = unit(place(-slope[1], -tilt * slope[0].hypot(slope[1]), slope[0]));
        (position, normal, [column as f32 / 4.0, t])
    })
}

/// Turns about +Y by degrees, then moves.
pub(super) fn placed(mut shape: Primitive, degrees: f64, to: Vector) -> Primitive {
    let angle = degrees * std::f64::consts::PI / 180.0;
    let (sine, cosine) = (libm::sin(angle) as f32, libm::cos(angle) as f32);
    let turned = |v: Vector| [cosine * v[0] + sine * v[2], v[1], cosine * v[2] - sine * v[0]];
    shape.positions.iter_mut().for_each(|p| *p = turned(*p));
    shape.normals.iter_mut().flatten().for_each(|n| *n = turned(*n));
    shape.positions.iter_mut().flatten().zip(to.iter().cycle()).for_each(|(p, to)| *p += to);
    shape
}

/// Adds the triangles of `more`, which has the same attributes and material.
pub(super) fn append(shape: &mut Primitive, more: Primitive) {
    let base = shape.positions.len() as u32;
    shape.positions.extend(more.positions);
    shape.normals.get_or_insert_default().extend(more.normals.unwrap_or_default());
    shape.uvs[0].get_or_insert_default().extend(more.uvs[0].as_deref().unwrap_or_default());
    shape.triangles.extend(more.triangles.iter().map(|t| t.map(|v| v + base)));
}

fn unit(v: Vector) -> Vector {
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    v.map(|x| x / length)
}

fn distance(a: [f32; 2], b: [f32; 2]) -> f32 {
    ((a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1])).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every triangle's winding agrees with its corners' normals, which are unit.
    fn check(name: &str, shape: &Primitive) {
        let normals = shape.normals.as_ref().unwrap();
        assert!(!shape.triangles.is_empty() && normals.len() == shape.positions.len(), "{name}");
        for t in &shape.triangles {
            let [a, b, c] = t.map(|v| shape.positions[v as usize]);
            let (u, v): (Vector, Vector) = (std::array::from_fn(|k| b[k] - a[k]), std::array::from_fn(|k| c[k] - a[k]));
            let face = unit([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]);
            for n in t.map(|v| normals[v as usize]) {
                let dot = |p: Vector, q: Vector| p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
                assert!((dot(n, n) - 1.0).abs() < 1e-5 && dot(n, face) > 0.3, "{name}: {t:?} {n:?} {face:?}");
            }
        }
    }

    #[test]
    fn shapes_face_outward_with_unit_normals() {
        let cup =
            [[0.0, 0.0], [0.1, 0.0], [0.1, 0.0], [0.12, 0.2], [0.12, 0.2], [0.1, 0.2], [0.1, 0.2], [0.08, 0.02], [0.04, 0.01], [0.0, 0.01]];
        check("lathe", &lathe(&cup, 24, 0));
        check("sphere", &sphere(0.2, 24, 0));
        check("ring", &ring(0.3, 0.05, 32, 12, 0));
        check("cuboid", &cuboid([-1.0, 0.0, 2.0], [1.0, 2.0, 3.0], 0));
        check("sheet", &sheet([0.0; 3], [0.0, 0.0, -1.0], [0.0, 2.0, 0.0], 0));
        check("leaf", &leaf(0.7, 0.4, 0.5, 0.08, 0));
        check("placed", &placed(cuboid([0.0; 3], [1.0; 3], 0), 30.0, [1.0, 2.0, 3.0]));
    }

    #[test]
    fn the_hole_is_where_it_was_asked_for() {
        let wall = sheet_with_hole([0.0; 3], [4.0, 0.0, 0.0], [0.0, 2.0, 0.0], [[0.25, 0.5], [0.25, 0.75]], 0);
        check("wall", &wall);
        let area: f32 = wall
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|v| wall.positions[v as usize]);
                let inside = [0, 1].map(|k| (a[k] + b[k] + c[k]) / 3.0);
                assert!(!((1.0..2.0).contains(&inside[0]) && (0.5..1.5).contains(&inside[1])), "{inside:?}");
                0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])).abs()
            })
            .sum();
        assert!((area - 7.0).abs() < 1e-5);
    }
}
