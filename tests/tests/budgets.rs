//! Budgets of error: the planner's choice is the cheapest that meets them, says where it cannot, and holds under other lights.

use prelight_bake::bake::{BakeStats, bake};
use prelight_bake::budget::{Choice, PLACES, Probes, choose, measure_planned};
use prelight_bake::plan::plan_object;
use prelight_bake::progress::Silent;
use prelight_bake::scene::Scene;
use prelight_bake::scene::world::World;
use prelight_bake::trace::{OccluderOptions, Occluders};
use prelight_store::Store;
use prelight_tests::{cuboid, options, quad, scene, sphere};
use std::sync::{Arc, OnceLock};

/// A floor with a ball and a box on it, and a sheet far off that nothing shades.
fn room() -> Scene {
    scene(vec![
        ("floor", quad([-0.6, 0.0, -0.6], [0.0, 0.0, 1.2], [1.2, 0.0, 0.0], 0)),
        ("box", cuboid([-0.4, 0.0, -0.3], [-0.1, 0.35, 0.0], 1)),
        ("ball", sphere([0.2, 0.15, 0.1], 0.15, 24, 16, 1)),
        ("sheet", quad([9.0, 0.0, 9.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], 0)),
    ])
}

const EDGE: f32 = 0.05;

fn chosen(scene: &Scene, budget: f64) -> Vec<Choice> {
    let world = World::build(scene);
    let occluders = Occluders::build(&world, &scene.textures, OccluderOptions::default());
    let params = options(scene, EDGE).points;
    choose(scene, &world, &occluders, &params, &vec![Some(budget); scene.objects.len()], 64, &Silent).unwrap()
}

/// What several tests ask about.
fn at_a_tenth() -> &'static Vec<Choice> {
    static CHOICES: OnceLock<Vec<Choice>> = OnceLock::new();
    CHOICES.get_or_init(|| chosen(&room(), 0.1))
}

#[test]
fn a_tighter_budget_takes_more_points_and_the_shaded_floor_more_than_the_open_sheet() {
    let scene = room();
    let choices: Vec<Vec<Choice>> = vec![chosen(&scene, 0.3), at_a_tenth().clone(), chosen(&scene, 0.03)];
    for (loose, tight) in choices.iter().zip(&choices[1..]) {
        assert!(loose.iter().zip(tight).all(|(loose, tight)| loose.params.edge_length >= tight.params.edge_length));
    }
    for choice in choices.iter().flatten() {
        println!(
            "{}: {} m, {} points, {:.4} of {}",
            choice.object, choice.params.edge_length, choice.points, choice.predicted, choice.budget
        );
        assert_eq!(choice.is_declared, choice.predicted > choice.budget);
        // What is not declared was found below the budget; what is, took the finest there is.
        assert!(!choice.is_declared || choice.params.edge_length == 0.5 * EDGE);
    }
    let (floor, sheet) = (&choices[1][0], &choices[1][3]);
    assert!(floor.params.edge_length < sheet.params.edge_length, "{floor:?} {sheet:?}");
    assert!(!sheet.is_declared);
}

#[test]
fn an_impossible_budget_is_declared_with_its_floor() {
    let choices = chosen(&room(), 1e-4);
    let floor = &choices[0];
    assert!(floor.is_declared && floor.predicted > 1e-3 && floor.params.edge_length == 0.5 * EDGE, "{floor:?}");
}

#[test]
fn choices_do_not_depend_on_threads_or_on_what_is_never_seen() {
    let small = || {
        scene(vec![
            ("floor", quad([-0.6, 0.0, -0.6], [0.0, 0.0, 1.2], [1.2, 0.0, 0.0], 0)),
            ("box", cuboid([-0.4, 0.1, -0.3], [-0.1, 0.45, 0.0], 1)),
        ])
    };
    let on = |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| chosen(&small(), 0.1));
    let one = on(1);
    assert_eq!(one, on(3));
    let mut more = small();
    let inside = scene(vec![("inside", cuboid([-0.3, 0.2, -0.2], [-0.2, 0.3, -0.1], 1))]);
    more.objects.extend(inside.objects);
    assert_eq!(one[..], chosen(&more, 0.1)[..2]);
}

#[test]
fn errors_fall_as_points_are_added_and_budgets_hold_under_held_back_lights() {
    let scene = room();
    let world = World::build(&scene);
    let occluders = Occluders::build(&world, &scene.textures, OccluderOptions::default());
    let steering = Probes::steering(64);
    let error = |length: f32| {
        let params = options(&scene, length).points[0];
        let plan = plan_object(&scene, &world, 0, &params).unwrap();
        measure_planned(&plan, &world, &occluders, length, &steering, PLACES).relative_l2()
    };
    let (coarse, fine) = (error(0.2), error(0.025));
    assert!(fine < 0.6 * coarse && fine > 1e-4, "{coarse} {fine}");

    let choices = at_a_tenth();
    let mut options = options(&scene, EDGE);
    choices.iter().for_each(|choice| options.points[choice.object] = choice.params);
    options.rebake.measure = Some(Arc::new(Probes::held_back(64)));
    let folder = tempfile::tempdir().unwrap();
    let stats: BakeStats = bake(&scene, &options, &Store::open_or_create(folder.path()).unwrap(), &Silent).unwrap().stats;
    assert_eq!(stats.errors.len(), scene.objects.len());
    for (error, choice) in stats.errors.iter().zip(choices) {
        assert_eq!(error.object, choice.object);
        let held_back = error.sums.relative_l2();
        println!("{}: predicted {:.4}, held back {held_back:.4}", choice.object, choice.predicted);
        assert!(choice.is_declared || held_back <= 1.5 * choice.budget, "{choice:?}: {held_back}");
    }
}
