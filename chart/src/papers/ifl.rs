//! The tables and figures of \[IFL\], made with its own algorithm on a scene's visibility.
//!
//! | here | there |
//! |---|---|
//! | lines 6, 9, 11 of Algorithm 1, share of the blocks that are not hidden | Table 1 |
//! | blocks with 1, 4, 16, 256 samples | Table 2 |
//! | points a second, bytes, transitions per partial block | Table 3 |
//! | relative L2 of the surface itself: DCT as sampled, Haar with as many coefficients | Fig. 2 |
//! | points between lit and hidden under one lit texel: none with binary visibility | Fig. 3 (its grayscale parts need visibility that is not binary) |
//! | PSNR of colours at points, paper mode and Haar at 1 % of the coefficients | Fig. 5 |
//!
//! Surfaces are the paper's, on every point of the sample that faces the eye and sees anything: Lambert, and Phong of four exponents. A view takes
//! the place of a frame of its fly-by.

use crate::clock::thread_nanoseconds;
use crate::views::ChartView;
use prelight_bake::error::BakeError;
use prelight_bake::progress::{Progress, Stage, check};
use prelight_runtime::asset::Asset;
use prelight_runtime::baseline::haar_triple::{HaarProjector, HaarTree, VisibilityTree, kept_coefficients, triple_product_of_one};
use prelight_runtime::baseline::ifl::light::{cardinal, node_position};
use prelight_runtime::baseline::ifl::{IflLight, IflVisibility, Phong};
use prelight_runtime::baseline::ifl::{Statistics, samples, shade};
use prelight_runtime::block_product::SimdPath;
use prelight_runtime::block_product::visibility::open_words;
use prelight_runtime::draw::image::Image;
use prelight_runtime::draw::metrics::compare;
use prelight_runtime::environment::LightCubemap;
use prelight_runtime::sphere::cubemap::{BLOCK_SIDE, BLOCK_TEXELS, row_major_from_hilbert, texel_direction, texel_unit_direction};
use serde::{Deserialize, Serialize};

/// Rounds of timing after the first.
const ROUNDS: usize = 5;
/// Points of a patch that are held against the sum over texels, and given to Haar.
const COMPARED: usize = 2;
/// Share of the coefficients that Haar keeps, as in the paper.
const HAAR_SHARE: f64 = 0.01;

/// The surfaces: name, and what they are.
pub const SURFACES: [(&str, Phong); 5] = [
    ("Lambert", Phong { kd: 0.8, ks: 0.0, exponent: 0.0 }),
    ("Phong 10", Phong { kd: 0.4, ks: 0.4, exponent: 10.0 }),
    ("Phong 50", Phong { kd: 0.4, ks: 0.4, exponent: 50.0 }),
    ("Phong 200", Phong { kd: 0.4, ks: 0.4, exponent: 200.0 }),
    ("Phong 1000", Phong { kd: 0.4, ks: 0.4, exponent: 1000.0 }),
];

/// Everything of one surface over all views under one light.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PaperRow {
    /// Environment.
    pub environment: String,
    /// Surface.
    pub surface: String,
    /// Points × views.
    pub points: u64,
    /// Percent of the blocks that are not hidden, lines 6, 9 and 11.
    pub lines: [f64; 3],
    /// Percent of them with 1, 4, 16 and 256 samples.
    pub samples: [f64; 4],
    /// CPU time of one thread.
    pub ns_per_point: f64,
    /// Masks, counts and positions.
    pub bytes_per_point: f64,
    /// The same with positions as varints.
    pub varint_bytes_per_point: f64,
    /// Transitions per partial block.
    pub transitions_per_block: f64,
    /// Share of non-zero coefficients that the sampled surface has, percent of the texels; mean.
    pub density: f64,
    /// Relative L2 of the surface as it is sampled, against its value at texels.
    pub dct_relative_l2: f64,
    /// The same of as many Haar coefficients, chosen by √area·|c| as everywhere here.
    pub haar_relative_l2: f64,
    /// PSNR of colours at points.
    pub psnr_db: Option<f64>,
    /// The same of Haar triple products.
    pub haar_psnr_db: Option<f64>,
}

/// One point of the sample.
struct Point {
    normal: [f32; 3],
    position: [f32; 3],
    seen: IflVisibility,
    /// Open bits and tree of those that are compared.
    compared: Option<(Vec<u64>, VisibilityTree)>,
}

/// Makes the rows of one light.
///
/// # Errors
/// [`BakeError::Cancelled`].
pub fn paper_rows(
    asset: &Asset,
    sample: &[usize],
    views: &[ChartView],
    (name, light): (&str, &LightCubemap),
    progress: &dyn Progress,
) -> Result<Vec<PaperRow>, BakeError> {
    let stage = Stage::begin(progress, "paper", Some((views.len() * SURFACES.len()) as u64), "tables");
    let n = light.face_resolution;
    let points = points(asset, sample, n);
    let (prepared, haar_light) = (IflLight::new(light), HaarTree::from_light(light, kept_coefficients(n, HAAR_SHARE)));
    let mut work: Vec<Work> = SURFACES.iter().map(|_| Work::default()).collect();
    for view in views {
        for ((_, surface), work) in SURFACES.iter().zip(&mut work) {
            check(progress)?;
            work.count(&points, view, surface, &prepared);
            work.compare(&points, view, surface, light, &prepared, &haar_light);
            stage.advance(1);
        }
    }
    for round in 0..=ROUNDS {
        for ((_, surface), work) in SURFACES.iter().zip(&mut work) {
            check(progress)?;
            let (mut sum, mut n_points) = ([0.0f32; 3], 0u64);
            let start = thread_nanoseconds();
            for view in views {
                for (point, v) in facing(&points, view) {
                    let colour = shade(SimdPath::detect(), &prepared, &point.seen, surface, point.normal, v, &mut Statistics::default());
                    (0..3).for_each(|c| sum[c] += colour[c]);
                    n_points += 1;
                }
            }
            let spent = thread_nanoseconds() - start;
            std::hint::black_box(sum);
            if round > 0 {
                work.ns.push(spent / n_points.max(1) as f64);
            }
        }
    }
    SURFACES.iter().zip(work).map(|((surface, _), work)| work.row(name, surface, &points)).collect()
}

fn points(asset: &Asset, sample: &[usize], n: usize) -> Vec<Point> {
    let mut points = Vec::new();
    let mut open = vec![0; open_words(n)];
    for patch in sample.iter().map(|patch| &asset.patches()[*patch]) {
        let (position, surfaces, visibility) = (patch.points().position, patch.surfaces(), patch.visibility());
        let mut compared = 0;
        for i in 0..visibility.len() {
            let point = visibility.point(i);
            if point.is_blind() {
                continue;
            }
            point.to_open_bits(n, &mut open);
            let is_compared = compared < COMPARED;
            compared += 1;
            points.push(Point {
                normal: surfaces.normal[i],
                position: position[i],
                seen: IflVisibility::new(n, &open),
                compared: is_compared.then(|| (open.clone(), VisibilityTree::new(n, &point))),
            });
        }
    }
    points
}

/// Points that face the eye, and the directions toward it.
fn facing<'a>(points: &'a [Point], view: &'a ChartView) -> impl Iterator<Item = (&'a Point, [f32; 3])> {
    points.iter().filter_map(|point| {
        let v: [f32; 3] = std::array::from_fn(|k| view.camera.eye[k] - point.position[k]);
        let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let length = dot(v, v).sqrt();
        (dot(v, point.normal) > 0.0).then(|| (point, v.map(|x| x / length)))
    })
}

#[derive(Default)]
struct Work {
    statistics: Statistics,
    points: u64,
    ns: Vec<f64>,
    test: Vec<[f32; 3]>,
    haar: Vec<[f32; 3]>,
    truth: Vec<[f32; 3]>,
    /// Squared errors of DCT and Haar against the surface, its square, coefficients, texels.
    surface: [f64; 5],
}

impl Work {
    fn count(&mut self, points: &[Point], view: &ChartView, surface: &Phong, light: &IflLight) {
        for (point, v) in facing(points, view) {
            shade(SimdPath::detect(), light, &point.seen, surface, point.normal, v, &mut self.statistics);
            self.points += 1;
        }
    }

    fn compare(&mut self, points: &[Point], view: &ChartView, surface: &Phong, light: &LightCubemap, prepared: &IflLight, haar: &HaarTree) {
        let n = light.face_resolution;
        let order = row_major_from_hilbert(n);
        let mut projector = HaarProjector::new(n);
        let mut lobe = HaarTree::flat(n);
        for (point, v) in facing(points, view) {
            let Some((open, tree)) = &point.compared else { continue };
            let values = values(surface, point.normal, v, n);
            let mut truth = [0.0f64; 3];
            for (texel, value) in values.iter().enumerate().filter(|(texel, _)| open[texel / 64] >> (texel % 64) & 1 == 1) {
                (0..3).for_each(|c| truth[c] += value * f64::from(light.flux[texel][c]));
            }
            self.truth.push(truth.map(|x| x as f32));
            self.test.push(shade(SimdPath::detect(), prepared, &point.seen, surface, point.normal, v, &mut Statistics::default()));
            let hilbert: Vec<f32> = (0..values.len()).map(|p| values[p / (n * n) * n * n + order[p % (n * n)] as usize] as f32).collect();
            let black = vec![0.0; hilbert.len()];
            projector.project([&hilbert, &black, &black], kept_coefficients(n, HAAR_SHARE), &mut lobe);
            self.haar.push(triple_product_of_one(haar, tree, &lobe));
            let (sampled, coefficients) = sampled(surface, point.normal, v, n);
            projector.project([&hilbert, &black, &black], coefficients.max(6), &mut lobe);
            let expanded = lobe.expand();
            for (p, value) in hilbert.iter().enumerate() {
                let exact = f64::from(*value);
                let texel = p / (n * n) * n * n + order[p % (n * n)] as usize;
                self.surface[0] += (sampled[texel] - exact).powi(2);
                self.surface[1] += (f64::from(expanded[0][p]) - exact).powi(2);
                self.surface[2] += exact * exact;
            }
            self.surface[3] += coefficients as f64;
            self.surface[4] += values.len() as f64;
        }
    }

    fn row(&self, environment: &str, surface: &str, points: &[Point]) -> Result<PaperRow, BakeError> {
        let Statistics { open, constant, texels, samples, .. } = self.statistics;
        let blocks = (open + constant + texels).max(1) as f64;
        let percent = |count: u64| 100.0 * count as f64 / blocks;
        let n_points = points.len().max(1) as f64;
        let total = |bytes: &dyn Fn(&IflVisibility) -> usize| points.iter().map(|point| bytes(&point.seen) as f64).sum::<f64>();
        let partial = total(&|seen| seen.counts.len()).max(1.0);
        let mut ns = self.ns.clone();
        ns.sort_by(f64::total_cmp);
        let image = |pixels: &[[f32; 3]]| Image { width: pixels.len(), height: 1, pixels: pixels.to_vec() };
        let decibels = |test: &[[f32; 3]]| match test {
            [] => Ok(None),
            test => compare(&image(test), &image(&self.truth), &[], None, None).map(|metrics| metrics.mask.psnr_db),
        };
        let relative = |error: f64| (error / self.surface[2].max(f64::MIN_POSITIVE)).sqrt();
        Ok(PaperRow {
            environment: environment.to_string(),
            surface: surface.to_string(),
            points: self.points,
            lines: [open, constant, texels].map(percent),
            samples: samples.map(percent),
            ns_per_point: ns.get(ns.len() / 2).copied().unwrap_or(0.0),
            bytes_per_point: total(&IflVisibility::bytes) / n_points,
            varint_bytes_per_point: total(&IflVisibility::varint_bytes) / n_points,
            transitions_per_block: total(&|seen| seen.positions.len()) / partial,
            density: 100.0 * self.surface[3] / self.surface[4].max(1.0),
            dct_relative_l2: relative(self.surface[0]),
            haar_relative_l2: relative(self.surface[1]),
            psnr_db: decibels(&self.test)?,
            haar_psnr_db: decibels(&self.haar)?,
        })
    }
}

fn mirror_of(n: [f32; 3], v: [f32; 3]) -> ([f64; 3], [f64; 3]) {
    let (n, v) = (n.map(f64::from), v.map(f64::from));
    let dot = n[0] * v[0] + n[1] * v[1] + n[2] * v[2];
    (n, std::array::from_fn(|k| 2.0 * dot * n[k] - v[k]))
}

/// The surface at every texel, row-major.
fn values(surface: &Phong, n: [f32; 3], v: [f32; 3], face_resolution: usize) -> Vec<f64> {
    let (r, (n, mirror)) = (face_resolution, mirror_of(n, v));
    let unit = |t: usize| texel_unit_direction(r, t / (r * r), t % r, t / r % r).map(f64::from);
    (0..6 * r * r).map(|texel| surface.value(n, mirror, unit(texel))).collect()
}

/// The surface as Appendix A samples it, at every texel, row-major, and how many coefficients that took: those of blocks below the horizon are zero.
fn sampled(surface: &Phong, n: [f32; 3], v: [f32; 3], face_resolution: usize) -> (Vec<f64>, usize) {
    let (r, (n, mirror)) = (face_resolution, mirror_of(n, v));
    let side = r / BLOCK_SIDE;
    let mut out = vec![0.0; 6 * r * r];
    let mut coefficients = 0;
    for block in 0..6 * side * side {
        let (face, x0, y0) = (block / (side * side), block % side * BLOCK_SIDE, block / side % side * BLOCK_SIDE);
        // Between texels: the direction is linear along the face.
        let at = |x: f64, y: f64| {
            let (a, b) = (texel_direction(r, face, 0, 0).map(f64::from), texel_direction(r, face, 1, 1).map(f64::from));
            let (main, u) = (face / 2, (face / 2 + 1) % 3);
            let d: [f64; 3] = std::array::from_fn(|k| {
                let steps = if k == u { x0 as f64 + x } else { y0 as f64 + y };
                if k == main { a[k] } else { a[k] + (b[k] - a[k]) * steps }
            });
            let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
            (d.map(|x| x / length), surface.value(n, mirror, d.map(|x| x / length)))
        };
        let (centre, _) = at(7.5, 7.5);
        let cosine = mirror[0] * centre[0] + mirror[1] * centre[1] + mirror[2] * centre[2];
        let count = samples(surface.lobe(), cosine as f32);
        let l = count.isqrt();
        let nodes: Vec<f64> = (0..count).map(|k| at(node_position(l, k % l), node_position(l, k / l)).1).collect();
        if nodes.iter().all(|value| *value == 0.0) {
            continue;
        }
        coefficients += count;
        let side: Vec<[f64; BLOCK_SIDE]> = (0..l).map(|k| cardinal(l, k)).collect();
        for p in 0..BLOCK_TEXELS {
            let (x, y) = (p % BLOCK_SIDE, p / BLOCK_SIDE);
            let value = if count == BLOCK_TEXELS { nodes[p] } else { (0..count).map(|k| nodes[k] * side[k % l][x] * side[k / l][y]).sum() };
            out[face * r * r + (y0 + y) * r + x0 + x] = value;
        }
    }
    (out, coefficients)
}

/// Share of the points that are neither lit nor hidden when one texel shines, over a few texels: 0 with binary visibility, which is why the edge of
/// such a shadow is as ragged as the mesh (\[IFL\] Fig. 3b).
pub fn partly_lit(asset: &Asset, sample: &[usize]) -> f64 {
    let n = asset.manifest().content.face_resolution as usize;
    let points = points(asset, sample, n);
    let surface = Phong { kd: 1.0, ks: 0.0, exponent: 0.0 };
    let nothing_hides = IflVisibility::new(n, &vec![u64::MAX; open_words(n)]);
    let (mut between, mut all) = (0u64, 0u64);
    for texel in [n * n / 3, 2 * n * n + n * n / 2 + n / 2, 4 * n * n + n * n / 5] {
        let mut light = LightCubemap::black(n);
        light.flux[texel] = [1.0; 3];
        let prepared = IflLight::new(&light);
        for point in &points {
            let lit = |seen: &IflVisibility| {
                shade(SimdPath::detect(), &prepared, seen, &surface, point.normal, point.normal, &mut Statistics::default())[0]
            };
            let (lit, whole) = (lit(&point.seen), lit(&nothing_hides));
            between += u64::from(lit > 1e-3 * whole && lit < 0.999 * whole);
            all += 1;
        }
    }
    between as f64 / all.max(1) as f64
}

/// Terms per block of Phong 200 at the first point that faces a view, the six faces side by side: the map of \[IFL\] Fig. 2.
pub fn terms_svg(asset: &Asset, sample: &[usize], view: &ChartView) -> Option<String> {
    const CELL: usize = 24;
    let r = asset.manifest().content.face_resolution as usize;
    let points = points(asset, sample, r);
    let (point, v) = facing(&points, view).next()?;
    let (_, mirror) = mirror_of(point.normal, v);
    let side = r / BLOCK_SIDE;
    let (width, height) = (6 * (side * CELL + CELL), side * CELL + 2 * CELL);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" font-size=\"10\">\n"
    );
    for block in 0..6 * side * side {
        let (face, bx, by) = (block / (side * side), block % side, block / side % side);
        // The centre of a block is the corner of its middle four texels.
        let corner = |step: usize| texel_direction(r, face, bx * BLOCK_SIDE + 7 + step, by * BLOCK_SIDE + 7 + step);
        let centre: [f64; 3] = std::array::from_fn(|k| 0.5 * f64::from(corner(0)[k] + corner(1)[k]));
        let length = (centre[0] * centre[0] + centre[1] * centre[1] + centre[2] * centre[2]).sqrt();
        let cosine = (mirror[0] * centre[0] + mirror[1] * centre[1] + mirror[2] * centre[2]) / length;
        let above = centre.iter().zip(point.normal).map(|(c, n)| c * f64::from(n)).sum::<f64>() > 0.0;
        let count = if above { samples(Some(200.0), cosine as f32) } else { 0 };
        let colour = match count {
            0 => "#eeeeee",
            1 => "#b8cfe5",
            4 => "#6d9ec9",
            16 => "#e0a458",
            _ => "#c8553d",
        };
        let (x, y) = (face * (side + 1) * CELL + bx * CELL, CELL + by * CELL);
        out += &format!("<rect x=\"{x}\" y=\"{y}\" width=\"{CELL}\" height=\"{CELL}\" fill=\"{colour}\" stroke=\"#ffffff\"/>\n");
        out += &format!("<text x=\"{}\" y=\"{}\">{count}</text>\n", x + 6, y + 16);
    }
    Some(out + "<text x=\"4\" y=\"14\">DCT terms per block, Phong 200; faces +X -X +Y -Y +Z -Z; 0: below the horizon</text>\n</svg>\n")
}

/// The tables as text.
pub fn paper_text(rows: &[PaperRow], partly_lit: f64) -> String {
    let mut text = String::from(
        "[IFL] in paper mode. Percent of blocks that are not hidden; colours at points against the sum over the same texels.\n\n\
         environment      surface       line 6  line 9 line 11 |    1     4    16   256 | ns/point   Mpt/s | bytes varint trans/block | coeff %  DCT err Haar err |  PSNR Haar 1 %\n",
    );
    for row in rows {
        let db = |value: Option<f64>| value.map_or("-".to_string(), |db| format!("{db:.1}"));
        let [six, nine, eleven] = row.lines;
        let [one, four, sixteen, all] = row.samples;
        text += &format!(
            "{:<16} {:<12} {six:>7.1} {nine:>7.1} {eleven:>7.1} | {one:>5.1} {four:>5.1} {sixteen:>5.1} {all:>5.1} | {:>8.0} {:>7.2} | {:>5.0} {:>6.0} {:>11.1} | {:>7.2} {:>8.4} {:>8.4} | {:>5} {:>8}\n",
            row.environment,
            row.surface,
            row.ns_per_point,
            1e3 / row.ns_per_point.max(1e-9),
            row.bytes_per_point,
            row.varint_bytes_per_point,
            row.transitions_per_block,
            row.density,
            row.dct_relative_l2,
            row.haar_relative_l2,
            db(row.psnr_db),
            db(row.haar_psnr_db),
        );
    }
    text += "\nTable 1: lines. Table 2: samples. Table 3: rate of one thread, bytes, transitions. Fig. 2: share of coefficients and errors of the surface.\n";
    text += &format!(
        "Fig. 3: {:.1} % of the points are partly lit by one texel; visibility here is binary. Fig. 5: PSNR.\n",
        100.0 * partly_lit
    );
    text
}
