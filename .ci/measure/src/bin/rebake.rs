//! An experiment: seeded edits of single objects of a real scene, each baked into the store of the unedited one.
//!
//! ```text
//! cargo run --release -p prelight-measure --bin rebake -- SCENE [--points N] [--edits 20] [--moves 20] [--clean-every 1] [--seed 1] [--base DIR]
//! ```
//!
//! Prints per edit the share of other objects' live tiles that was redone, the share whose bits truly changed, and the time against a
//! clean bake; then the sums and percentiles of sideways moves, which have marks. Fails if a rebaked digest is not the clean bake's.
//! Time is processor time of all threads for planning, looking up, tracing and sealing, which other people's jobs disturb less than wall time;
//! reading the file and copying the store are left out. `--base` keeps the unedited scene's store for the next run.

#[allow(dead_code, reason = "the tests use all of it")]
#[path = "../../../../bake/tests/support/edits.rs"]
mod edits;

use edits::{Edit, Random, apply, size};
use prelight_bake::bake::{Baked, bake};
use prelight_bake::block_product::visibility::patch::candidates;
use prelight_bake::block_product::visibility::patch::{PatchInputs, Shadowing, stale_tiles};
use prelight_bake::cost::counts::Counts;
use prelight_bake::options::BakeOptions;
use prelight_bake::points::plan_object;
use prelight_bake::progress::Silent;
use prelight_bake::reach::layer::{MAX_LAYERS, layers};
use prelight_bake::reach::pieces::Pieces;
use prelight_bake::reach::tile::TileTable;
use prelight_bake::settings::Settings;
use prelight_bake::trace::Occluders;
use prelight_scene::Scene;
use prelight_scene::input::SceneInput;
use prelight_scene::world::World;
use prelight_store::Store;
use rustix::time::ClockId;
use std::path::{Path, PathBuf};

const MEMORY: u64 = 8 << 30;

/// Edits of the first run, in turn.
const KINDS: [Edit; 7] = [Edit::Move, Edit::Turn, Edit::Scale, Edit::Delete, Edit::Duplicate, Edit::Material, Edit::Opacity];

struct Arguments {
    scene: String,
    points: Option<u64>,
    edits: usize,
    moves: usize,
    clean_every: usize,
    seed: u64,
    base: Option<PathBuf>,
}

fn arguments() -> Arguments {
    let mut arguments = Arguments { scene: String::new(), points: None, edits: 20, moves: 20, clean_every: 1, seed: 1, base: None };
    let mut rest = std::env::args().skip(1);
    while let Some(argument) = rest.next() {
        if argument == "--base" {
            arguments.base = rest.next().map(PathBuf::from);
            continue;
        }
        let mut number = || rest.next().and_then(|n| n.parse::<u64>().ok()).unwrap_or_else(|| panic!("{argument} takes a number"));
        match argument.as_str() {
            "--points" => arguments.points = Some(number()),
            "--edits" => arguments.edits = number() as usize,
            "--moves" => arguments.moves = number() as usize,
            "--clean-every" => arguments.clean_every = number().max(1) as usize,
            "--seed" => arguments.seed = number(),
            _ => arguments.scene = argument,
        }
    }
    assert!(!arguments.scene.is_empty(), "name a scene");
    arguments
}

/// Bakes and says how long it took.
fn timed(scene: &Scene, options: &BakeOptions, store: &Store) -> (Baked, f64) {
    let start = processor_seconds(ClockId::ProcessCPUTime);
    let baked = bake(scene, options, store, &Silent).expect("the scene bakes");
    (baked, processor_seconds(ClockId::ProcessCPUTime) - start)
}

fn copy_folder(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).expect("a folder can be made");
    for entry in std::fs::read_dir(from).expect("a folder can be listed").map(|entry| entry.expect("an entry")) {
        let target = to.join(entry.file_name());
        match entry.path().is_dir() {
            true => copy_folder(&entry.path(), &target),
            false => drop(std::fs::copy(entry.path(), target).expect("a file can be copied")),
        }
    }
}

struct Row {
    what: String,
    tiles: prelight_bake::bake::TileStats,
    seconds: f64,
    clean: f64,
}

impl Row {
    fn redone(&self) -> f64 {
        100.0 * self.tiles.redone as f64 / self.tiles.known.max(1) as f64
    }

    fn changed(&self) -> f64 {
        100.0 * self.tiles.changed as f64 / self.tiles.known.max(1) as f64
    }

    fn time(&self) -> f64 {
        100.0 * self.seconds / self.clean
    }
}

struct Experiment<'a> {
    base: &'a Scene,
    options: &'a BakeOptions,
    store: &'a Path,
    work: &'a Path,
    clean_seconds: f64,
}

impl Experiment<'_> {
    fn edit(&self, edit: Edit, random: &mut Random, check: bool) -> Row {
        let diagonal = {
            let sizes: Vec<f64> = self.base.objects.iter().map(size).collect();
            sizes.iter().copied().fold(0.0, f64::max)
        };
        // Something that a person would pick up: 3 cm to a third of the largest thing.
        let movable = |object: &usize| (0.03..0.35 * diagonal).contains(&size(&self.base.objects[*object]));
        let objects: Vec<usize> = (0..self.base.objects.len()).filter(movable).collect();
        let mut scene = self.base.clone();
        let what = apply(&mut scene, objects[random.below(objects.len())], edit, random);
        let mut options = self.options.clone();
        options.points.resize(scene.objects.len(), self.options.points[0]);
        let folder = self.work.join("edited");
        let _ = std::fs::remove_dir_all(&folder);
        copy_folder(self.store, &folder);
        let (rebaked, seconds) = timed(&scene, &options, &Store::open(&folder).expect("the copied store opens"));
        let mut clean = self.clean_seconds;
        if check {
            let folder = self.work.join("clean");
            let _ = std::fs::remove_dir_all(&folder);
            let (expected, seconds) = timed(&scene, &options, &Store::open_or_create(&folder).expect("a new store"));
            assert_eq!(rebaked.asset_digest, expected.asset_digest, "{what}: a rebake is not the clean bake");
            clean = seconds;
        }
        let row = Row { what, tiles: rebaked.stats.tiles, seconds, clean };
        let stages: Vec<String> = rebaked.stats.seconds.iter().map(|(stage, seconds)| format!("{stage} {seconds:.2}")).collect();
        let checked = if check { "digest equal" } else { "" };
        println!(
            "{:>7.2} % redone {:>7.2} % changed {:>6.1} % new {:>6.1} % of clean time ({:.2} s; wall {})  {}  {checked}",
            row.redone(),
            row.changed(),
            100.0 * row.tiles.new as f64 / row.tiles.live as f64,
            row.time(),
            row.seconds,
            stages.join(", "),
            row.what
        );
        row
    }
}

fn percentile(values: impl Iterator<Item = f64>, share: f64) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted[((sorted.len() - 1) as f64 * share).round() as usize]
}

/// Processor seconds of this thread or of all.
fn processor_seconds(clock: ClockId) -> f64 {
    let time = rustix::time::clock_gettime(clock);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// Processor seconds of one thread for all keys of base points.
fn time_keys(scene: &Scene, options: &BakeOptions, store: &Store) -> (f64, u64) {
    let world = World::build(scene);
    let pieces = Pieces::build(scene, &world, &layers(scene, &world, &[]), MAX_LAYERS);
    let nothing = Occluders::default();
    let of = Shadowing { pieces: &pieces, occluders: &nothing, face_resolution: options.face_resolution, shades: &options.visibility };
    println!("{} pieces of {} triangles", pieces.pieces.len(), world.positions.len());
    let (mut seconds, mut points) = (0.0, 0);
    for object in 0..scene.objects.len() {
        let plan = plan_object(scene, &world, object, &options.points[object]).expect("the scene can be planned");
        for patch in &plan.patches {
            let start = processor_seconds(ClockId::ThreadCPUTime);
            let inputs = PatchInputs::new(&of, &plan, patch);
            seconds += processor_seconds(ClockId::ThreadCPUTime) - start;
            let tables: Vec<TileTable> = candidates(store, &inputs).expect("the store can be read").into_iter().map(|c| c.row).collect();
            let start = processor_seconds(ClockId::ThreadCPUTime);
            let (_, stale) = stale_tiles(&of, &inputs, &tables);
            seconds += processor_seconds(ClockId::ThreadCPUTime) - start;
            assert_eq!(stale, 0, "nothing was edited");
            points += u64::from(patch.n_points);
        }
    }
    (seconds, points)
}

fn main() {
    let arguments = arguments();
    let input = SceneInput::open(Path::new(&arguments.scene)).expect("the scene opens");
    let loaded = input.load(MEMORY).expect("the scene loads");
    let world = World::build(&loaded.scene);
    let settings = Settings::resolve(&Counts::default(), &input.manifest, &loaded.knobs, &loaded.scene, &world, arguments.points, MEMORY)
        .expect("the knobs are right");
    let (scene, options) = (&loaded.scene, &settings.options);
    let work = tempfile::tempdir().expect("a temporary folder");
    let folder = arguments.base.clone().unwrap_or_else(|| work.path().join("base"));
    let store = Store::open_or_create(&folder).expect("a new store");
    let (baked, mut clean_seconds) = timed(scene, options, &store);
    let noted = folder.with_extension("seconds");
    match std::fs::read_to_string(&noted).ok().and_then(|text| text.parse().ok()) {
        Some(before) if baked.stats.tiles.traced == 0 => clean_seconds = before,
        _ => std::fs::write(&noted, clean_seconds.to_string()).expect("a file beside the store"),
    }
    let (points, patches) = (baked.stats.points, baked.stats.patches);
    println!("{}: {points} points, {patches} patches, clean bake {clean_seconds:.2} s, stages {:?}", arguments.scene, baked.stats.seconds);
    let (again, seconds) = timed(scene, options, &store);
    assert_eq!((again.asset_digest, again.stats.tiles.traced), (baked.asset_digest, 0));
    println!("nothing edited: {seconds:.2} s, {:.1} % of clean, stages {:?}", 100.0 * seconds / clean_seconds, again.stats.seconds);
    let (seconds, keyed) = time_keys(scene, options, &store);
    println!("keys: {seconds:.2} s of one thread for {keyed} points, {:.2} s a million", 1e6 * seconds / keyed as f64);
    drop(store);

    let experiment = Experiment { base: scene, options, store: &folder, work: work.path(), clean_seconds };
    let mut random = Random(arguments.seed);
    let mut worst: Option<Row> = None;
    for i in 0..arguments.edits {
        let row = experiment.edit(KINDS[i % KINDS.len()], &mut random, i % arguments.clean_every == 0);
        if worst.as_ref().is_none_or(|worst| row.time() > worst.time()) {
            worst = Some(row);
        }
    }
    if let Some(worst) = worst {
        println!("worst of {} edits: {}, {:.1} % of a clean bake", arguments.edits, worst.what, worst.time());
    }
    if arguments.moves == 0 {
        return;
    }
    let moves: Vec<Row> =
        (0..arguments.moves).map(|i| experiment.edit(Edit::Move, &mut random, i % arguments.clean_every == 0 && i != 0)).collect();
    let sum = |of: fn(&Row) -> u64| moves.iter().map(of).sum::<u64>();
    let (redone, changed) = (sum(|row| row.tiles.redone), sum(|row| row.tiles.changed));
    println!(
        "{} moves, others' tiles: redone {redone}, truly changed {changed}: {:.2}x",
        moves.len(),
        redone as f64 / changed.max(1) as f64
    );
    let both = |of: fn(&Row) -> f64| (percentile(moves.iter().map(of), 0.5), percentile(moves.iter().map(of), 0.9));
    let (redone, changed, time) = (both(Row::redone), both(Row::changed), both(Row::time));
    println!("redone % of live tiles: median {:.2}, 90th percentile {:.2} (marks 3 and 8)", redone.0, redone.1);
    println!("truly changed %: median {:.2}, 90th percentile {:.2}", changed.0, changed.1);
    println!("time % of a clean bake: median {:.1}, 90th percentile {:.1} (marks 5 and 12 indoors, 10 and 20 outdoors)", time.0, time.1);
}
