//! An experiment: what a budget of error predicts under each light beside what the bake reaches and where it loses most, or the planner beside one
//! setting for all objects.
//!
//! ```text
//! cargo run --release -p prelight-measure --bin budget -- SCENE                    # SCENE has a max_error
//! cargo run --release -p prelight-measure --bin budget -- SCENE --contest 0.1,0.05 [--faces 128]
//! ```

use prelight_bake::bake::bake;
use prelight_bake::budget::candidates::{BORDERS, LENGTHS, ObjectInput, ObjectSearch, grid_index};
use prelight_bake::budget::knapsack::{candidates, contest};
use prelight_bake::budget::{Choice, Directions, ObjectError, PlaceSet, Probes, Sums, Tracing, measure_planned};
use prelight_bake::cost::counts::Counts;
use prelight_bake::points::buried::BuriedProbe;
use prelight_bake::progress::Silent;
use prelight_bake::settings::Settings;
use prelight_bake::trace::{OccluderOptions, Occluders};
use prelight_manifests::quality::Shades;
use prelight_scene::Scene;
use prelight_scene::input::SceneInput;
use prelight_scene::world::World;
use prelight_store::Store;
use rayon::prelude::*;
use std::path::Path;
use std::sync::Arc;

const MEMORY: u64 = 8 << 30;
/// Lights and places of each that are listed.
const LISTED: [usize; 2] = [3, 6];

struct Experiment<'a> {
    scene: &'a Scene,
    world: &'a World,
    occluders: &'a Occluders,
    settings: &'a Settings,
}

impl Experiment<'_> {
    /// The planner and one setting for all.
    fn contest(&self, budgets: &str, face_resolution: u32) {
        let shades = vec![Shades::Binary; self.scene.objects.len()];
        let all = candidates(self.scene, self.world, self.occluders, &self.settings.unbudgeted, face_resolution, &shades, &Silent)
            .expect("the scene can be planned");
        for budget in budgets.split(',').map(|budget| budget.parse().expect("budgets are numbers")) {
            let of = contest(&all, budget);
            println!("{}", serde_json::to_string(&of).expect("plain numbers"));
        }
    }

    /// Errors of what was chosen under every light, at the places that steered and at others: one line of JSON.
    fn agreement(&self, choice: &Choice) -> String {
        let Experiment { scene, world, occluders, settings } = *self;
        let directions = Directions { face_resolution: settings.options.face_resolution, shades: choice.shades };
        let mut probes = Probes::held_back(directions.face_resolution);
        let n = probes.lights.len();
        probes.extend(Probes::steering(directions.face_resolution));
        let (solids, own) = (BuriedProbe::new(scene, world), settings.unbudgeted[choice.object]);
        let subject = ObjectInput { scene, world, occluders, solids: &solids, object: choice.object, own };
        let (length, border) = grid_index(&own, &choice.params).expect("one of them");
        let [same, other] = [PlaceSet::Steering, PlaceSet::HeldBack].map(|drawn| {
            let mut question =
                ObjectSearch::new(&subject, &probes, directions, subject.places(&probes, drawn)).expect("it was planned before");
            let sums = question.asked(length, border).expect("it was planned before").1;
            (0..probes.lights.len()).map(|i| sums.under(i..i + 1)).collect::<Vec<f64>>()
        });
        serde_json::json!({ "object": scene.objects[choice.object].name, "budget": choice.budget, "declared": choice.is_declared,
            "points": choice.points, "predicted": choice.predicted, "held_back": n, "same": same, "other": other,
            "lights": probes.lights.iter().map(|light| light.name.clone()).collect::<Vec<_>>() })
        .to_string()
    }

    /// What was predicted for an object beside what was reached.
    fn compare(&self, choice: &Choice, error: &ObjectError, probes: &Probes) {
        let Experiment { scene, world, occluders, settings } = *self;
        let (solids, object) = (BuriedProbe::new(scene, world), choice.object);
        let directions = Directions { face_resolution: settings.options.face_resolution, shades: choice.shades };
        let own = settings.unbudgeted[object];
        let subject = ObjectInput { scene, world, occluders, solids: &solids, object, own };
        let places = subject.places(probes, PlaceSet::HeldBack);
        let tracing = Tracing::new(occluders, probes, &solids, own.edge_length, directions);
        let at_points = places.point_error(&tracing);
        let (length, border) = grid_index(&own, &choice.params).expect("one of them");
        let mut question = ObjectSearch::new(&subject, probes, directions, places.clone()).expect("it was planned before");
        let (candidate, predicted) = question.asked(length, border).expect("it was planned before");
        let (n, end) = (probes.n_held_back(), probes.lights.len());
        let name = &scene.objects[object].name;
        println!("{name}: edge length x{}, unrest {}, {} points expected", LENGTHS[length], BORDERS[border], candidate.points);
        let both = |sums: &Sums| format!("steering {:.4}, held back {:.4}", sums.judged(n..end), sums.judged(0..n));
        println!("  predicted: {}\n  baked:     {}\n  at points: {}", both(&predicted), both(&error.sums), both(&at_points));
        for (i, light) in probes.lights.iter().enumerate() {
            let [a, b, c] = [&predicted, &error.sums, &at_points].map(|sums| sums.under(i..i + 1));
            println!("  {:36} predicted {a:.4} baked {b:.4} at points {c:.4}", light.name);
        }
        let (near, _) = question.around(length, border).expect("it was planned before");
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by(|a, b| error.sums.under(*b..*b + 1).total_cmp(&error.sums.under(*a..*a + 1)));
        for light in order.into_iter().take(LISTED[0]) {
            println!("  under {}, of {:.4}:", probes.lights[light].name, error.sums.truth[light]);
            let one = |place: usize| (measure_planned(&near, &places.alone(place), probes, &tracing), place);
            let mut each: Vec<(Sums, usize)> = (0..places.len()).map(one).collect();
            each.sort_by(|a, b| b.0.difference[light].total_cmp(&a.0.difference[light]));
            for (sums, place) in each.iter().take(LISTED[1]) {
                let (at, normal) = places.at(*place);
                println!("    {:.5} of {:.5} at {at:.4?} facing {normal:.2?}", sums.difference[light], sums.truth[light]);
            }
        }
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| arguments.iter().position(|argument| argument == name).map(|at| arguments[at + 1].as_str());
    let input = SceneInput::open(Path::new(arguments.first().expect("name a scene"))).expect("the scene opens");
    let loaded = input.load(MEMORY).expect("the scene loads");
    let (scene, world) = (&loaded.scene, World::build(&loaded.scene));
    let mut settings =
        Settings::resolve(&Counts::default(), &input.manifest, &loaded.knobs, scene, &world, None, MEMORY).expect("the knobs are right");
    let options = OccluderOptions { quality: settings.options.tree, ..OccluderOptions::default() };
    let occluders = Occluders::build(&world, &scene.textures, options);
    if let Some(budgets) = value("--contest") {
        let faces = value("--faces").map_or(64, |faces| faces.parse().expect("a face resolution"));
        return Experiment { scene, world: &world, occluders: &occluders, settings: &settings }.contest(budgets, faces);
    }
    settings.meet_budgets(scene, &world, &Silent).expect("the scene can be planned");
    if arguments.iter().any(|argument| argument == "--agree") {
        let experiment = Experiment { scene, world: &world, occluders: &occluders, settings: &settings };
        let lines: Vec<String> = settings.choices.par_iter().with_max_len(1).map(|choice| experiment.agreement(choice)).collect();
        lines.iter().for_each(|line| println!("{line}"));
        return;
    }
    let mut probes = Probes::held_back(settings.options.face_resolution);
    probes.extend(Probes::steering(settings.options.face_resolution));
    let probes = Arc::new(probes);
    settings.options.rebake.measure = Some(probes.clone());
    let folder = tempfile::tempdir().expect("a temporary folder");
    let store = Store::open_or_create(folder.path()).expect("a new store");
    let baked = bake(scene, &settings.options, &store, &Silent).expect("the scene bakes");
    println!("{} points", baked.stats.points_made);
    let experiment = Experiment { scene, world: &world, occluders: &occluders, settings: &settings };
    for choice in &settings.choices {
        let error = baked.stats.errors.iter().find(|error| error.object == choice.object).expect("all are measured");
        experiment.compare(choice, error, &probes);
    }
}
