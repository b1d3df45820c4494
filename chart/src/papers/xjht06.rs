//! The tables of \[XJHT06\]: a light in few squares, and what objects that move take of it, each beside the block product.
//!
//! | here | there |
//! |---|---|
//! | seconds of the tree, light misplaced by one constant a region, misfit of Eq. 7 of the paper's fit and of ours | Fig. 6, "2 minutes" |
//! | relative L2 at points of 10, 30, 60 and 100 squares, both fits; cuts at a point by τ | Figs. 9, 10; "error-driven" of its future work |
//! | the block product on the same points: error and time | none |
//! | what movers take where the scene has them: L2 of diffuse light with shares, and with movers left out | Figs. 12 to 14 |
//!
//! Truth at points is the sum over texels, of movers the traced bits. Times are of one thread's CPU. Seeing a point costs the sums over
//! all texels here, so that
//! every K has exact visibility; the figure is told apart from that of the squares.

use crate::clock::{process_seconds, thread_nanoseconds};
use crate::views::ChartView;
use prelight_bake::error::BakeError;
use prelight_bake::progress::{Progress, Stage, check};
use prelight_bake::trace::{OccluderOptions, Occluders, Scratch, TraceOrigin};
use prelight_runtime::asset::Asset;
use prelight_runtime::baseline::pixel_product;
use prelight_runtime::block_product::visibility::open_words;
use prelight_runtime::block_product::{Accuracy, Light, SimdPath, shade_diffuse, shade_lobes};
use prelight_runtime::brdf::Lobe;
use prelight_runtime::environment::LightCubemap;
use prelight_runtime::light::{Glossy, PointLobe};
use prelight_runtime::relight::Relighter;
use prelight_runtime::sphere::cubemap::texel_unit_direction;
use prelight_runtime::sphere::disc::disc_from_direction;
use prelight_runtime::sphere::frame::{dot, tangents};
use prelight_runtime::square_light::brdf::{SquareLobe, Tables};
use prelight_runtime::square_light::product::{Seen, SquareLight};
use prelight_runtime::square_light::{Fit, Square, Tree};
use prelight_scene::Scene;
use prelight_scene::chunks::scene_from_asset;
use prelight_scene::world::World;
use serde::{Deserialize, Serialize};
use std::fmt::Write;

/// Squares of the fixed cuts.
pub const SQUARES: [usize; 4] = [10, 30, 60, 100];
/// Thresholds of the cuts at a point.
pub const TAUS: [f32; 3] = [0.1, 0.03, 0.01];
/// Regions from which cuts at a point start.
const BASE: usize = 30;
/// Squares that a point may ask at most.
const MOST: usize = 512;
/// Points that are compared, at most.
const POINTS: usize = 160;
/// Turns at which Eq. 7 places a square.
const TURNS: usize = 4;

/// A light as squares.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LightRow {
    /// Environment.
    pub environment: String,
    /// CPU seconds of the tree with all its cuts.
    pub tree_seconds: f64,
    /// Share of the energy that one constant a region misplaces, 30 and 100 regions.
    pub misplaced: [f64; 2],
    /// Misfit of Eq. 7 of 30 squares, summed, over ∫ L² dω: the paper's fit (area and centre of the region), and by energy.
    pub misfit: [f64; 2],
}

/// One surface under one light over all views.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SurfaceRow {
    /// Environment.
    pub environment: String,
    /// Surface.
    pub surface: String,
    /// Points × views.
    pub points: u64,
    /// Relative L2 by [`SQUARES`] with the area fit.
    pub area_fit: [f64; 4],
    /// Relative L2 by [`SQUARES`] with the energy fit.
    pub energy_fit: [f64; 4],
    /// CPU time per point of 30 squares, what the point sees taken as known.
    pub ns_30: f64,
    /// Relative L2 by [`TAUS`]; empty of diffuse light.
    pub cut: Vec<f64>,
    /// Squares asked a point by [`TAUS`].
    pub evaluations: Vec<f64>,
    /// Relative L2 of the block product.
    pub block_product: f64,
    /// CPU time of the block product per point, display accuracy.
    pub block_product_ns: f64,
}

/// What movers take, where the scene has them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MoverRow {
    /// Environment.
    pub environment: String,
    /// Points that a mover takes something of, by the traced bits.
    pub points: u64,
    /// Share of their light that movers take.
    pub taken: f64,
    /// Relative L2 of their diffuse light by shares.
    pub share: f64,
    /// Relative L2 with movers left out.
    pub left_out: f64,
    /// CPU microseconds per point whose share was computed.
    pub us_per_point: f64,
    /// Bytes of the fields.
    pub field_bytes: u64,
}

/// The surfaces.
fn surfaces() -> [(&'static str, Lobe<'static>); 6] {
    [
        ("diffuse", Lobe::None),
        ("Phong 10", Lobe::Phong { exponent: 10.0 }),
        ("Phong 50", Lobe::Phong { exponent: 50.0 }),
        ("Phong 200", Lobe::Phong { exponent: 200.0 }),
        ("GGX .3", Lobe::Ggx { alpha: [0.3; 2] }),
        ("GGX .1", Lobe::Ggx { alpha: [0.1; 2] }),
    ]
}

/// One point that is compared.
struct Point {
    position: [f32; 3],
    normal: [f32; 3],
    open: Vec<u64>,
}

/// Sums of squares of differences and of truths.
#[derive(Clone, Copy, Default)]
struct Error([f64; 2]);

impl Error {
    fn add(&mut self, found: [f32; 3], truth: [f64; 3]) {
        (0..3).for_each(|c| self.0[0] += (f64::from(found[c]) - truth[c]).powi(2));
        self.0[1] += dot(truth, truth);
    }

    fn relative_l2(self) -> f64 {
        if self.0[1] > 0.0 { (self.0[0] / self.0[1]).sqrt() } else { 0.0 }
    }
}

/// Misfit of one square for the region of a node, ∫ (L − I)² by Eq. 7: the mean over the turns of the square, channels summed.
pub fn misfit(tree: &Tree, node: u32, square: &Square) -> f64 {
    let (region, n, omega) = (tree.moments(node), tree.face_resolution(), f64::from(square.solid_angle()));
    let (x, y) = tangents(square.centre);
    let mut inside = [0.0f64; 3];
    tree.for_each_texel(node, |texel| {
        let at = texel as usize;
        let d = texel_unit_direction(n, at / (n * n), at % n, at / n % n);
        let p = disc_from_direction([dot(x, d), dot(y, d), dot(square.centre, d)]);
        let energy = tree.moments(texel).energy;
        for turn in 0..TURNS {
            let (sine, cosine) = (std::f32::consts::FRAC_PI_8 * turn as f32).sin_cos();
            let turned = [cosine * p[0] + sine * p[1], cosine * p[1] - sine * p[0]];
            if turned.iter().all(|c| c.abs() <= square.half_side) {
                (0..3).for_each(|c| inside[c] += energy[c] / TURNS as f64);
            }
        }
    });
    (0..3)
        .map(|c| {
            let intensity = region.energy[c] / omega;
            region.square[c] - 2.0 * intensity * inside[c] + intensity * region.energy[c]
        })
        .sum()
}

/// The light's own figures.
pub fn light_row(name: &str, light: &LightCubemap) -> LightRow {
    let start = thread_nanoseconds();
    let tree = Tree::build(light);
    let tree_seconds = 1e-9 * (thread_nanoseconds() - start);
    let cut = tree.base_cut(30);
    let all: f64 = tree.moments(tree.root()).square.iter().sum();
    let sum = |fit: Fit| cut.iter().zip(tree.squares(&cut, fit)).map(|(node, square)| misfit(&tree, *node, &square)).sum::<f64>();
    let misfit = [Fit::Area, Fit::Energy].map(|fit| if all > 0.0 { sum(fit) / all } else { 0.0 });
    let misplaced = [tree.misplaced(&cut), tree.misplaced(&tree.base_cut(100))];
    LightRow { environment: name.to_string(), tree_seconds, misplaced, misfit }
}

/// Points of the sample's patches that see anything, spread evenly.
fn points(asset: &Asset, sample: &[usize], n: usize) -> Vec<Point> {
    let mut points = Vec::new();
    for patch in sample.iter().map(|patch| &asset.patches()[*patch]) {
        let (position, normal, visibility) = (patch.points().position, patch.points().normal, patch.visibility());
        let step = (visibility.len() * sample.len()).div_ceil(POINTS).max(1);
        for i in (0..visibility.len()).step_by(step).filter(|i| !visibility.point(*i).is_blind()) {
            let mut open = vec![0; open_words(n)];
            visibility.point(i).to_open_bits(n, &mut open);
            points.push(Point { position: position[i], normal: normal[i], open });
        }
    }
    points
}

fn toward(point: &Point, view: &ChartView) -> Option<[f32; 3]> {
    let v: [f32; 3] = std::array::from_fn(|k| view.camera.eye[k] - point.position[k]);
    let length = dot(v, v).sqrt();
    (dot(v, point.normal) > 0.0).then(|| v.map(|x| x / length))
}

fn whole(glossy: Glossy) -> [f32; 3] {
    std::array::from_fn(|c| glossy[0][c] + glossy[1][c])
}

/// Errors and times of all surfaces under one light.
///
/// # Errors
/// [`BakeError::Cancelled`].
pub fn surface_rows(
    asset: &Asset,
    sample: &[usize],
    views: &[ChartView],
    (name, light): (&str, &LightCubemap),
    progress: &dyn Progress,
) -> Result<Vec<SurfaceRow>, BakeError> {
    let stage = Stage::begin(progress, "paper", Some(surfaces().len() as u64), "surfaces");
    let points = points(asset, sample, light.face_resolution);
    let lights = [Fit::Area, Fit::Energy].map(|fit| SquareLight::new(Tree::build(light), fit));
    let seen: Vec<Seen> = (points.iter())
        .map(|point| {
            let mut seen = Seen::default();
            lights[0].see(&point.open, point.normal, &mut seen);
            seen
        })
        .collect();
    let (prepared, tables) = (Light::prepare(light), Tables::default());
    let mut rows = Vec::new();
    for (surface, lobe) in surfaces() {
        check(progress)?;
        let mut row = SurfaceRow { environment: name.to_string(), surface: surface.to_string(), ..SurfaceRow::default() };
        match lobe {
            Lobe::None => diffuse_row(&mut row, &points, &seen, &lights, light),
            _ => glossy_row(&mut row, lobe, (&points[..], &seen[..]), views, &lights, (light, &tables)),
        }
        block_product(&mut row, asset, sample, lobe, views, (&prepared, light));
        rows.push(row);
        stage.advance(1);
    }
    Ok(rows)
}

fn diffuse_row(row: &mut SurfaceRow, points: &[Point], seen: &[Seen], lights: &[SquareLight; 2], light: &LightCubemap) {
    let mut errors = [[Error::default(); 4]; 2];
    let cuts = SQUARES.map(|k| lights[0].tree().base_cut(k));
    for (point, seen) in points.iter().zip(seen) {
        let truth = pixel_product::diffuse(light, &point.open).map(|e| dot(e, point.normal.map(f64::from)).max(0.0));
        for (squares, errors) in lights.iter().zip(&mut errors) {
            cuts.iter().zip(errors).for_each(|(cut, error)| error.add(squares.irradiance(cut, seen, point.normal), truth));
        }
    }
    let start = thread_nanoseconds();
    let sum: f32 = points.iter().zip(seen).map(|(point, seen)| lights[1].irradiance(&cuts[1], seen, point.normal)[1]).sum();
    std::hint::black_box(sum);
    row.ns_30 = (thread_nanoseconds() - start) / points.len().max(1) as f64;
    row.points = points.len() as u64;
    [row.area_fit, row.energy_fit] = errors.map(|errors| errors.map(Error::relative_l2));
}

fn glossy_row(
    row: &mut SurfaceRow,
    lobe: Lobe<'static>,
    (points, seen): (&[Point], &[Seen]),
    views: &[ChartView],
    lights: &[SquareLight; 2],
    (light, tables): (&LightCubemap, &Tables),
) {
    let (mut errors, mut cut_errors, mut asked) = ([[Error::default(); 4]; 2], [Error::default(); 3], [0usize; 3]);
    let cuts = SQUARES.map(|k| lights[0].tree().base_cut(k));
    let base = lights[0].tree().base_cut(BASE);
    let (mut n, mut spent, mut sum) = (0u64, 0.0, 0.0);
    for view in views {
        for (point, seen) in points.iter().zip(seen) {
            let Some(v) = toward(point, view) else { continue };
            let at = PointLobe { lobe, normal: point.normal, tangent: [0.0; 3] };
            let Some(asked_lobe) = SquareLobe::new(&at, tables, v) else { continue };
            let [first, rest] = pixel_product::lobe(light, &point.open, &at, v);
            let truth = std::array::from_fn(|c| first[c] + rest[c]);
            for (squares, errors) in lights.iter().zip(&mut errors) {
                cuts.iter().zip(errors).for_each(|(cut, error)| error.add(whole(squares.glossy(cut, seen, &asked_lobe)), truth));
            }
            for (k, tau) in TAUS.into_iter().enumerate() {
                let found = lights[1].glossy_by_need(&base, seen, &asked_lobe, tau, MOST);
                cut_errors[k].add(whole(found.glossy), truth);
                asked[k] += found.evaluations;
            }
            let start = thread_nanoseconds();
            sum += whole(lights[1].glossy(&cuts[1], seen, &asked_lobe))[1];
            spent += thread_nanoseconds() - start;
            n += 1;
        }
    }
    std::hint::black_box(sum);
    row.points = n;
    row.ns_30 = spent / n.max(1) as f64;
    [row.area_fit, row.energy_fit] = errors.map(|errors| errors.map(Error::relative_l2));
    row.cut = cut_errors.map(Error::relative_l2).to_vec();
    row.evaluations = asked.map(|asked| asked as f64 / n.max(1) as f64).to_vec();
}

/// Error and time of the block product on the whole patches of the sample; errors at every eighth point.
fn block_product(
    row: &mut SurfaceRow,
    asset: &Asset,
    sample: &[usize],
    lobe: Lobe<'static>,
    views: &[ChartView],
    (prepared, light): (&Light, &LightCubemap),
) {
    let (mut error, mut spent, mut n) = (Error::default(), 0.0, 0u64);
    let mut open = vec![0; open_words(light.face_resolution)];
    for patch in sample.iter().map(|patch| &asset.patches()[*patch]) {
        let (visibility, points) = (patch.visibility(), patch.points());
        let at = |i: usize| PointLobe { lobe, normal: points.normal[i], tangent: [0.0; 3] };
        for view in &views[..if lobe == Lobe::None { 1 } else { views.len() }] {
            let (mut irradiance, mut glossy) = (vec![[[0.0; 3]; 3]; visibility.len()], vec![Glossy::default(); visibility.len()]);
            let start = thread_nanoseconds();
            match lobe {
                Lobe::None => shade_diffuse(prepared, &visibility, &mut irradiance),
                _ => {
                    let (path, accuracy, eye) = (SimdPath::detect(), Accuracy::DISPLAY, view.camera.eye);
                    shade_lobes(path, accuracy, prepared, points.position, at, &visibility, eye, &mut glossy);
                }
            }
            spent += thread_nanoseconds() - start;
            n += visibility.len() as u64;
            for i in (0..visibility.len()).step_by(8) {
                let point = Point { position: points.position[i], normal: points.normal[i], open: Vec::new() };
                let Some(v) = toward(&point, view) else { continue };
                visibility.point(i).to_open_bits(light.face_resolution, &mut open);
                let normal = points.normal[i];
                if lobe == Lobe::None {
                    let truth = pixel_product::diffuse(light, &open).map(|e| dot(e, normal.map(f64::from)).max(0.0));
                    error.add(irradiance[i].map(|e| dot(e, normal).max(0.0)), truth);
                } else {
                    let [first, rest] = pixel_product::lobe(light, &open, &at(i), v);
                    error.add(whole(glossy[i]), std::array::from_fn(|c| first[c] + rest[c]));
                }
            }
        }
    }
    row.block_product = error.relative_l2();
    row.block_product_ns = spent / n.max(1) as f64;
}

/// What movers take of still points where the scene has them, against traced bits; `None` where nothing moves.
pub fn mover_row(asset: &std::sync::Arc<Asset>, sample: &[usize], (name, light): (&str, &LightCubemap)) -> Option<MoverRow> {
    let moving = |object: usize| asset.objects()[object].moves.is_some();
    if !(0..asset.objects().len()).any(moving) {
        return None;
    }
    let scene = scene_from_asset(asset);
    let objects = (0..scene.objects.len()).filter(|object| moving(*object)).map(|object| scene.objects[object].clone()).collect();
    let movers = Scene { objects, ..scene };
    let occluders = Occluders::build(&World::build(&movers), &movers.textures, OccluderOptions::default());
    let mut relighter = Relighter::new(asset.clone());
    relighter.set_light(light).ok()?;
    let mut wanted = vec![false; asset.n_points()];
    sample.iter().for_each(|patch| wanted[asset.patches()[*patch].points.clone()].fill(true));
    // Once without shares, for everything that frames make once.
    relighter.set_shadows(false);
    relighter.shade_diffuse(Some(&wanted)).ok()?;
    relighter.set_shadows(true);
    let (before, count) = (process_seconds(), relighter.work_counts().shared);
    relighter.shade_diffuse(Some(&wanted)).ok()?;
    let (spent, shared) = (process_seconds() - before, relighter.work_counts().shared - count);
    let n = light.face_resolution;
    let (mut with, mut without, mut light_sum, mut taken) = (Error::default(), Error::default(), 0.0, 0.0);
    let (mut open, mut past, mut scratch, mut touched) = (vec![0; open_words(n)], vec![0; open_words(n)], Scratch::default(), 0);
    for patch in sample.iter().map(|patch| &asset.patches()[*patch]) {
        if (0..asset.objects().len()).any(|object| moving(object) && asset.objects()[object].points.contains(&patch.points.start)) {
            continue;
        }
        let (visibility, points) = (patch.visibility(), patch.points());
        for i in 0..visibility.len() {
            let normal = points.normal[i];
            let origin = std::array::from_fn(|k| points.position[i][k] + 1e-4 * normal[k]);
            occluders.open_texels(&TraceOrigin { origin, normal, base_triangles: &[] }, n, &mut scratch, &mut past);
            visibility.point(i).to_open_bits(n, &mut open);
            let still = pixel_product::diffuse(light, &open).map(|e| dot(e, normal.map(f64::from)).max(0.0));
            let both: Vec<u64> = open.iter().zip(&past).map(|(a, b)| a & b).collect();
            if both == open {
                continue;
            }
            let truth = pixel_product::diffuse(light, &both).map(|e| dot(e, normal.map(f64::from)).max(0.0));
            let share = relighter.shares()[patch.points.start + i].diffuse;
            with.add(std::array::from_fn(|c| still[c] as f32 * share[c]), truth);
            without.add(still.map(|e| e as f32), truth);
            light_sum += still.iter().sum::<f64>();
            taken += still.iter().sum::<f64>() - truth.iter().sum::<f64>();
            touched += 1;
        }
    }
    let fields = asset.manifest().content.objects.iter().filter_map(|object| object.moves.as_ref()?.field.as_ref());
    Some(MoverRow {
        environment: name.to_string(),
        points: touched,
        taken: if light_sum > 0.0 { taken / light_sum } else { 0.0 },
        share: with.relative_l2(),
        left_out: without.relative_l2(),
        us_per_point: 1e6 * spent / shared.max(1) as f64,
        field_bytes: fields.map(|field| field.bytes).sum(),
    })
}

/// The tables as text.
pub fn square_text(lights: &[LightRow], surfaces: &[SurfaceRow], movers: &[MoverRow]) -> String {
    let mut text = String::from("[XJHT06]: a light in few squares; errors are relative L2 at points, in percent.\n\n");
    let _ = writeln!(text, "{:<20} | tree ms | misplaced 30 / 100 | Eq. 7 of 30: area fit / energy fit", "light");
    for row in lights {
        let [first, second] = row.misplaced;
        let (environment, ms, [area, energy]) = (&row.environment, 1e3 * row.tree_seconds, row.misfit);
        let _ = writeln!(text, "{environment:<20} | {ms:>7.1} | {first:>8.3} / {second:<7.3} | {area:.3} / {energy:.3}");
    }
    let four = |errors: &[f64]| errors.iter().map(|error| format!("{:.2}", 100.0 * error)).collect::<Vec<_>>().join("/");
    let _ = writeln!(
        text,
        "\n{:<20} {:<10} | area fit 10/30/60/100 | energy fit 10/30/60/100 | ns of 30 | cut .1/.03/.01 | squares asked | block product, ns",
        "light", "surface"
    );
    for row in surfaces {
        let asked = row.evaluations.iter().map(|n| format!("{n:.0}")).collect::<Vec<_>>().join("/");
        let _ = writeln!(
            text,
            "{:<20} {:<10} | {:<21} | {:<23} | {:>8.0} | {:<14} | {asked:<13} | {:.3}, {:.0}",
            row.environment,
            row.surface,
            four(&row.area_fit),
            four(&row.energy_fit),
            row.ns_30,
            four(&row.cut),
            100.0 * row.block_product,
            row.block_product_ns
        );
    }
    if !movers.is_empty() {
        let _ = writeln!(text, "\n{:<20} | points touched | taken | by shares | left out | us a point | MB of fields", "light");
        for row in movers {
            let (environment, points, us, megabytes) = (&row.environment, row.points, row.us_per_point, row.field_bytes as f64 / 1e6);
            let [taken, share, left] = [row.taken, row.share, row.left_out].map(|part| 100.0 * part);
            let _ = writeln!(
                text,
                "{environment:<20} | {points:>14} | {taken:>5.1} | {share:>9.2} | {left:>8.2} | {us:>10.2} | {megabytes:.2}"
            );
        }
    }
    text
}
