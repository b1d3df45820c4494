//! A contestant that no crate of this repository knows is charted like the others: a row in the table, a series in the chart.

use prelight_bake::progress::Silent;
use prelight_bake::reference::{ReferenceOptions, render_reference};
use prelight_bake::trace::{OccluderOptions, Occluders};
use prelight_chart::cell::{Cells, ChartLight, Place};
use prelight_chart::contestant::{Contestant, PatchLight, Shot};
use prelight_chart::page::plots;
use prelight_chart::picture::PictureView;
use prelight_chart::row::{Row, mark_fronts, to_csv};
use prelight_chart::stability::scenes::{baked, quad, scene};
use prelight_chart::svg::COLOURS;
use prelight_chart::truth::KeptReference;
use prelight_chart::views::ChartView;
use prelight_chart::{Contestants, Entrant, Motion, measure};
use prelight_runtime::asset::AssetPatch;
use prelight_runtime::draw::camera::Camera;
use prelight_runtime::environment::{LightCubemap, sky};
use prelight_scene::world::World;
use std::sync::Arc;

/// A contestant with one irradiance at every point, along its normal: a share of the light's mean.
struct Toy;

impl Contestant for Toy {
    type Budget = f32;
    type Tables = ();
    type Patch = ();
    type Light = [f32; 3];
    type Buffers = ();

    fn name(&self) -> &str {
        "toy"
    }

    fn budgets(&self) -> Vec<f32> {
        vec![0.5, 1.0]
    }

    fn label(&self, share: &f32) -> String {
        format!("{} %", 100.0 * share)
    }

    fn tables(&self, _: &f32, _: usize) {}

    fn buffers(&self, _: usize) {}

    fn convert(&self, (): &(), _: &AssetPatch) {}

    fn bytes(&self, patch: &AssetPatch, (): &()) -> usize {
        12 * patch.points.len()
    }

    fn prepare(&self, share: &f32, light: &LightCubemap) -> [f32; 3] {
        let total = |c: usize| light.flux.iter().map(|flux| flux[c]).sum::<f32>();
        std::array::from_fn(|c| 0.25 * share * total(c))
    }

    fn shade(&self, light: &[f32; 3], shot: &Shot<'_, ()>, (): &mut (), out: &mut PatchLight) -> f64 {
        for (irradiance, normal) in out.irradiance.iter_mut().zip(shot.patch.surfaces().normal) {
            *irradiance = light.map(|e| normal.map(|n| e * n));
        }
        0.0
    }
}

const SIZE: [usize; 2] = [24, 16];

/// All rows, still and under a light that moves, of a sheet over a floor; and how many moving pictures there were.
fn charted(contestants: &Contestants) -> (Vec<Row>, Vec<Row>, usize) {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(vec![
        ("floor", quad([-0.5, 0.0, -0.5], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], 0)),
        ("board", quad([-0.2, 0.3, -0.2], [0.0, 0.0, 0.3], [0.3, 0.0, 0.0], 0)),
    ]);
    let asset = baked(&scene, 0.25, folder.path(), &Silent).unwrap();
    let environment = sky([0.5, 0.5, 0.6]);
    let cubemap = LightCubemap::from_environment(&environment, 64);
    let light = ChartLight { name: "day".to_string(), environment, cubemap };
    let camera = Camera::upright([1.0, 0.8, 1.0], [0.0, 0.1, 0.0], 45.0).unwrap();
    let view = ChartView { name: "corner".to_string(), camera, held_back: false };
    let picture = PictureView::new(&asset, &camera, SIZE, 1).unwrap();

    let world = World::build(&scene);
    let occluders = Occluders::build(&world, &scene.textures, OccluderOptions::default());
    let options = ReferenceOptions { width: SIZE[0], height: SIZE[1], samples_per_pixel: 8, ..ReferenceOptions::default() };
    let images = render_reference(&scene, &world, &occluders, &light.environment, &camera, &options, &Silent).unwrap();
    let reference = KeptReference { images, cpu_seconds: 1.0 };

    let cells = Cells {
        asset: &asset,
        sample: measure::sample(&asset, 32),
        entrants: contestants.entrants_of(&asset),
        size: SIZE,
        samples: 1,
        bake_seconds: 1.0,
    };
    let place = Place { light: &light, view: &view, picture: &picture, reference: &reference };
    let mut stills: Vec<Row> = cells.stills(&place, &Silent).unwrap().into_iter().map(|(row, _)| row).collect();
    mark_fronts(&mut stills);
    let moving = cells.moving(&place, Motion::Light, &stills, &Silent).unwrap();
    let drawn = cells.moving_pictures(&place, Motion::Light, &Silent).unwrap().len();
    (stills, moving, drawn)
}

#[test]
fn a_contestant_from_outside_gets_rows_in_the_table_and_a_series_in_the_chart() {
    let contestants = Contestants::built_in().with(Arc::new(Toy));
    let (stills, moving, drawn) = charted(&contestants);
    let names = |rows: &[Row]| rows.iter().map(|row| format!("{} {}", row.technique, row.budget)).collect::<Vec<_>>();
    // What the asset has no lobes for is left out; the others stand in the order of the list.
    let expected = [
        "block_product tolerance 0.3",
        "block_product display, 0.02",
        "block_product fine, 0.001",
        "block_product tolerance 0.0001",
        "block_product tolerance 0",
        "pixel_sums all texels",
        "haar_triple 1 %",
        "haar_triple 10 %",
        "sh_product 25 coefficients",
        "sh_product 100 coefficients",
        "toy 50 %",
        "toy 100 %",
    ];
    assert_eq!(names(&stills), expected);
    assert_eq!(names(&moving), expected);
    // Two loose accuracies, 25 harmonics and the toy at both budgets.
    assert_eq!(drawn, 5);

    let error = |row: &Row| row.points_relative_l2.unwrap();
    let toy = &stills[10..];
    assert!(toy.iter().all(|row| row.bytes_per_point == 12.0 && row.unbiased_relative_l2.is_some() && row.projection_ns == 0.0), "{toy:?}");
    assert!(error(&stills[4]) < 1e-4 && toy.iter().all(|row| error(row) > 0.05), "{toy:?}");
    assert!(moving.iter().all(|row| row.temporal_max.is_some() && row.prepare_seconds > 0.0), "{moving:?}");

    let csv = to_csv(&["1", "machine", "scene", "digest", "24", "16"].map(str::to_string), &stills);
    assert_eq!(csv.lines().filter(|line| line.contains(",toy,")).count(), 2);
    let palette = contestants.palette();
    let colour = palette.colour("toy");
    assert!(COLOURS.contains(&colour) && contestants.names().filter(|name| palette.colour(name) == colour).eq(["toy"]));
    for (name, svg) in plots(&stills, &palette) {
        assert!(svg.contains(&format!("stroke=\"{colour}\" stroke-opacity=\"0.35\"")), "{name} has a line of the toy's");
        assert!(svg.contains(">toy</text>") && svg.contains("toy, 50 %"), "{name} names the toy");
    }
}

#[test]
fn a_list_holds_only_whom_it_was_given() {
    let entrants: Vec<Arc<dyn Entrant>> = Contestants::new().with(Arc::new(Toy)).entrants(64);
    let named: Vec<(&str, &str)> = entrants.iter().map(|entrant| (entrant.name(), entrant.budget())).collect();
    assert_eq!(named, [("toy", "50 %"), ("toy", "100 %")]);
}
