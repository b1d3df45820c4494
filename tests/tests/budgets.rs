//! Budgets of error: the planner's choice is the cheapest that meets them, says where it cannot, and holds under other lights.

use prelight_bake::bake::{BakeStats, bake};
use prelight_bake::budget::candidates::{MARGIN, ObjectInput, ObjectSearch, grid_index};
use prelight_bake::budget::{Choice, Directions, PlaceSet, Probes, choose};
use prelight_bake::points::buried::BuriedProbe;
use prelight_bake::progress::Silent;
use prelight_bake::trace::{OccluderOptions, Occluders};
use prelight_manifests::quality::Shades;
use prelight_scene::Scene;
use prelight_scene::world::World;
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

/// A floor, and a box over it.
fn small() -> Scene {
    scene(vec![
        ("floor", quad([-0.6, 0.0, -0.6], [0.0, 0.0, 1.2], [1.2, 0.0, 0.0], 0)),
        ("box", cuboid([-0.4, 0.1, -0.3], [-0.1, 0.45, 0.0], 1)),
    ])
}

const EDGE: f32 = 0.05;
/// By how much what is refined by bits may differ from what is refined by gray, whose edges are split by a half of a texel, not its centre; and a bake in
/// gray from its forecast at the finest borders.
const REFINED_BY_BITS: f64 = 0.1;

fn chosen(scene: &Scene, budget: f64) -> Vec<Choice> {
    let world = World::build(scene);
    let occluders = Occluders::build(&world, &scene.textures, OccluderOptions::default());
    let params = options(scene, EDGE).points;
    let (budgets, pinned) = (vec![Some(budget); scene.objects.len()], vec![None; scene.objects.len()]);
    choose(scene, &world, &occluders, &params, &budgets, &pinned, &Directions::LADDER[..1], &Silent).unwrap().1
}

/// What several tests ask about.
fn at_a_tenth() -> &'static Vec<Choice> {
    static CHOICES: OnceLock<Vec<Choice>> = OnceLock::new();
    CHOICES.get_or_init(|| chosen(&room(), 0.1))
}

#[test]
fn a_tighter_budget_takes_more_points_and_the_shaded_floor_more_than_the_open_sheet() {
    let scene = room();
    let choices: Vec<Vec<Choice>> = vec![chosen(&scene, 0.3), at_a_tenth().clone()];
    for (loose, tight) in choices.iter().zip(&choices[1..]) {
        assert!(loose.iter().zip(tight).all(|(loose, tight)| loose.points <= tight.points));
    }
    for choice in choices.iter().flatten() {
        println!(
            "{}: {} m, {} points, {:.4} of {}",
            choice.object, choice.params.edge_length, choice.points, choice.predicted, choice.budget
        );
        assert_eq!(choice.is_declared, choice.predicted > MARGIN * choice.budget);
    }
    let (floor, sheet) = (&choices[1][0], &choices[1][3]);
    assert!(floor.points > 4 * sheet.points, "{floor:?} {sheet:?}");
    assert!(!sheet.is_declared);
}

#[test]
fn an_impossible_budget_is_declared_with_its_floor() {
    let choices = chosen(&small(), 1e-4);
    let floor = &choices[0];
    assert!(floor.is_declared && floor.predicted > 1e-3, "{floor:?}");
}

#[test]
fn choices_do_not_depend_on_threads_or_on_what_is_never_seen() {
    let on = |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| chosen(&small(), 0.1));
    let one = on(1);
    assert_eq!(one, on(3));
    let mut more = small();
    let inside = scene(vec![("inside", cuboid([-0.3, 0.2, -0.2], [-0.2, 0.3, -0.1], 1))]);
    more.objects.extend(inside.objects);
    assert_eq!(one[..], chosen(&more, 0.1)[..2]);
}

#[test]
fn directions_are_as_fine_as_the_budgets_ask_and_never_finer_than_what_is_pinned() {
    let scene = small();
    let world = World::build(&scene);
    let occluders = Occluders::build(&world, &scene.textures, OccluderOptions::default());
    let params = options(&scene, EDGE).points;
    let found = |budget: f64, allowed: &[Directions]| {
        choose(&scene, &world, &occluders, &params, &[Some(budget), None], &[None; 2], allowed, &Silent).unwrap()
    };
    let (loose, choices) = found(0.5, &Directions::LADDER);
    assert_eq!((loose, choices.len(), choices[0].object), (Directions::LADDER[0], 1, 0));
    assert_eq!(found(0.02, &Directions::LADDER).0, Directions::LADDER[1]);
    let (pinned, choices) = found(0.005, &Directions::LADDER[..1]);
    assert_eq!(pinned, Directions::LADDER[0]);
    // What is declared says what directions have of it.
    assert!(choices[0].is_declared && choices[0].at_points > 0.005, "{choices:?}");
}

fn question<'a>(subject: &ObjectInput<'a>, probes: &'a Probes, drawn: PlaceSet) -> ObjectSearch<'a> {
    ObjectSearch::new(subject, probes, Directions::LADDER[0], subject.places(probes, drawn)).unwrap()
}

#[test]
fn an_object_that_bits_keep_from_its_budget_is_planned_in_gray_unless_its_shades_are_pinned() {
    let scene = small();
    let world = World::build(&scene);
    let occluders = Occluders::build(&world, &scene.textures, OccluderOptions::default());
    let (steering, solids) = (Probes::steering(64), BuriedProbe::new(&scene, &world));
    let mut options = options(&scene, EDGE);
    let params = options.points.clone();
    let subject = ObjectInput { scene: &scene, world: &world, occluders: &occluders, solids: &solids, object: 0, own: params[0] };
    let planned = |budget: f64, pinned: [Option<Shades>; 2]| {
        let budgets = [Some(budget), Some(0.5)];
        choose(&scene, &world, &occluders, &params, &budgets, &pinned, &Directions::LADDER[..1], &Silent).unwrap().1
    };
    // Below what any candidate in bits comes to: what is taken is within a quarter of the least.
    let floor = planned(1e-4, [Some(Shades::Binary), None])[0].predicted;
    let budget = 0.75 * floor / MARGIN;
    let found = |pinned| planned(budget, pinned);
    let (free, bits) = (found([None; 2]), found([Some(Shades::Binary), None]));
    let at_points = question(&subject, &steering, PlaceSet::Steering).point_error().judged(0..steering.lights.len());
    println!("budget {budget:.4}, bits alone {at_points:.4}\n{:?}\n{:?}", free[0], bits[0]);
    assert!(bits[0].is_declared && bits[0].shades == Shades::Binary && bits[0].at_points == at_points);
    assert!(!free[0].is_declared && free[0].shades == Shades::Gray6 && free[0].at_points == 0.0);
    assert_eq!(free[1], bits[1], "what one object takes is nothing to another");

    // Refined by bits and traced in gray: nearly what is refined by gray, as the bake does it, comes to.
    let (length, border) = grid_index(&params[0], &free[0].params).expect("one of the candidates");
    let gray = Directions { shades: Shades::Gray6, ..Directions::LADDER[0] };
    let [same, elsewhere] = [PlaceSet::Steering, PlaceSet::HeldBack].map(|drawn| {
        let mut question = ObjectSearch::new(&subject, &steering, gray, subject.places(&steering, drawn)).unwrap();
        question.candidate(length, border).unwrap().predicted
    });
    assert!((same - free[0].predicted).abs() < REFINED_BY_BITS * free[0].predicted, "{same} {:?}", free[0]);
    options.points[0] = free[0].params;
    options.visibility = vec![free[0].shades];
    options.rebake.only = Some(vec![true, false]);
    let mut probes = Probes::held_back(64);
    let n = probes.n_held_back();
    probes.extend(Probes::steering(64));
    options.rebake.measure = Some(Arc::new(probes));
    let folder = tempfile::tempdir().unwrap();
    let stats = bake(&scene, &options, &Store::open_or_create(folder.path()).unwrap(), &Silent).unwrap().stats;
    let sums = &stats.errors[0].sums;
    let (held_back, steered) = (sums.judged(0..n), sums.expected(n..sums.truth.len()));
    println!("steered {steered:.4}, held back {held_back:.4}, {} points", stats.points);
    assert!((steered - elsewhere).abs() < REFINED_BY_BITS * elsewhere, "{steered} {elsewhere}");
    assert!(held_back <= 1.5 * budget, "{held_back} {budget}");
}

#[test]
fn errors_fall_as_points_are_added_and_budgets_hold_under_held_back_lights() {
    let scene = room();
    let world = World::build(&scene);
    let occluders = Occluders::build(&world, &scene.textures, OccluderOptions::default());
    let (steering, solids) = (Probes::steering(64), BuriedProbe::new(&scene, &world));
    let own = options(&scene, EDGE).points[0];
    let subject = ObjectInput { scene: &scene, world: &world, occluders: &occluders, solids: &solids, object: 0, own };
    let mut floor = question(&subject, &steering, PlaceSet::Steering);
    let asked = [(0, 0), (4, 0), (2, 0), (2, 3)];
    let [coarse, fine, plain, bordered] = asked.map(|(length, border)| floor.candidate(length, border).unwrap());
    assert!(fine.predicted < 0.6 * coarse.predicted && fine.predicted > 1e-4, "{coarse:?} {fine:?}");
    println!("{plain:?} {bordered:?}");
    assert!(bordered.predicted < plain.predicted && bordered.points > plain.points, "{plain:?} {bordered:?}");

    let choices = at_a_tenth();
    let mut options = options(&scene, EDGE);
    // What candidates are expected to lose at the places that judge, which chose nothing.
    let elsewhere: Vec<f64> = choices
        .iter()
        .map(|choice| {
            let subject = ObjectInput { object: choice.object, own: options.points[choice.object], ..subject };
            let (length, border) = grid_index(&subject.own, &choice.params).expect("one of the candidates");
            question(&subject, &steering, PlaceSet::HeldBack).candidate(length, border).unwrap().predicted
        })
        .collect();
    choices.iter().for_each(|choice| options.points[choice.object] = choice.params);
    options.visibility = choices.iter().map(|choice| choice.shades).collect();
    let mut probes = Probes::held_back(64);
    let n = probes.n_held_back();
    assert_eq!(n, probes.lights.len());
    probes.extend(Probes::steering(64));
    options.rebake.measure = Some(Arc::new(probes));
    let folder = tempfile::tempdir().unwrap();
    let stats: BakeStats = bake(&scene, &options, &Store::open_or_create(folder.path()).unwrap(), &Silent).unwrap().stats;
    assert_eq!(stats.errors.len(), scene.objects.len());
    let expected: u64 = choices.iter().map(|choice| choice.points).sum();
    // What was expected of borders is an estimate from few places.
    println!("{expected} points expected, {}", stats.points_made);
    assert!((0.3..3.0).contains(&(stats.points_made as f64 / expected as f64)), "{} {expected}", stats.points_made);
    for ((error, choice), elsewhere) in stats.errors.iter().zip(choices).zip(elsewhere) {
        assert_eq!(error.object, choice.object);
        let (held_back, steered) = (error.sums.judged(0..n), error.sums.expected(n..error.sums.truth.len()));
        let grid = error.grid.judged(0..n);
        println!(
            "{}: predicted {:.4}, {elsewhere:.4}, {steered:.4}; held back {held_back:.4}; grid {grid:.4}",
            choice.object, choice.predicted
        );
        // What was refined around places alone is what the bake refines, but for f32 sums in another order; so it is on the ball, which has more
        // vertices than points, where the bake first puts points where stand-ins leak.
        assert!((steered - elsewhere).abs() < 0.02 * elsewhere + 1e-4, "{choice:?}: {elsewhere} {steered}");
        assert!(grid > 0.0 && grid < 0.1, "{grid}");
        assert!(choice.is_declared || held_back <= 1.5 * choice.budget, "{choice:?}: {held_back}");
    }
}
