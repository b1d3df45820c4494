//! `prelight shard run` by hand: from the store alone, any number of times, and refused where it makes no sense.

use crate::command::prelight;
use crate::room::{BAKE, digest, done, expected, room, rounds, said};
use prelight_bake::farm::RoundFile;
use prelight_manifests::{ChunkKind, Digest, Dtype};
use prelight_store::{Record, Store};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// The variables by which engines number tasks, taken out of the test's own environment.
fn worker(folder: &Path, store: &str) -> Command {
    let mut command = prelight(folder);
    for (name, _) in prelight_bake::farm::index::VARIABLES {
        command.env_remove(name);
    }
    command.args(["shard", "run", "--store", store]);
    command
}

/// A bake on the engine `external` that waits for somebody to run its first round.
struct Waiting(Child);

impl Drop for Waiting {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn wait_for_round(folder: &Path) -> (Waiting, String) {
    let mut bake = prelight(folder);
    bake.args(BAKE).args(["--engine=external", "--tasks=3"]).stdout(Stdio::null()).stderr(Stdio::null());
    let waiting = Waiting(bake.spawn().unwrap());
    let start = Instant::now();
    while !folder.join(".prelight/store.json").exists() || rounds(folder).is_empty() {
        assert!(start.elapsed() < Duration::from_secs(120), "no round is submitted");
        std::thread::sleep(Duration::from_millis(50));
    }
    let round = rounds(folder)[0]["round"].as_str().unwrap().to_string();
    (waiting, round)
}

#[test]
fn a_worker_needs_only_the_store_and_runs_any_number_of_times() {
    let folder = room();
    let (waiting, round) = wait_for_round(folder.path());
    drop(waiting);
    let shards = rounds(folder.path())[0]["shards"]["of"].as_u64().unwrap();
    assert!(shards >= 3, "{shards}");
    // Elsewhere: another folder, the scene's files gone, another name of the store.
    let elsewhere = tempfile::tempdir().unwrap();
    let store = elsewhere.path().join("a store with blanks");
    std::fs::rename(folder.path().join(".prelight"), &store).unwrap();
    let run = |index: &str, per_task: &str| {
        let mut command = worker(elsewhere.path(), "a store with blanks");
        command.args(["--round", &round, "--shards-per-task", per_task, "--json"]).env("JOB_COMPLETION_INDEX", index);
        command
    };
    let would = done(run("0", "2").arg("--dry-run"));
    assert_eq!((would["shards"]["known"].as_u64(), would["bytes"]["stored"].as_u64()), (Some(0), Some(0)), "{would}");
    // Two at once, twice the same.
    let mut copies: Vec<Child> = (0..2).map(|_| run("0", "2").stdout(Stdio::null()).spawn().unwrap()).collect();
    copies.iter_mut().for_each(|copy| assert_eq!(copy.wait().unwrap().code(), Some(0)));
    let known = done(&mut run("0", "2"));
    assert_eq!((known["shards"]["known"].as_u64(), known["bytes"]["stored"].as_u64()), (Some(2), Some(0)), "{known}");
    let rest = done(run("0", &shards.to_string()).args(["--index-base", "0"]));
    assert_eq!(rest["shards"]["known"], 2, "{rest}");
    let past = done(&mut run("7", &shards.to_string()));
    assert_eq!(past["shards"]["task"], 0, "{past}");
    // Back home the bake takes all of it over.
    std::fs::rename(&store, folder.path().join(".prelight")).unwrap();
    let baked = done(prelight(folder.path()).args(BAKE));
    assert_eq!((digest(&baked), baked["tiles"]["reused"] == baked["tiles"]["total"]), (expected().to_string(), false));
}

#[test]
fn what_makes_no_sense_has_its_exit_code_and_says_what_to_do() {
    let folder = room();
    let (_waiting, round) = wait_for_round(folder.path());
    let other = "ab".repeat(32);
    let cases: [(&[&str], &[(&str, &str)], i32, &str); 8] = [
        (&["--round", &round], &[], 2, "no index of a task"),
        (&["--round", &round], &[("SLURM_ARRAY_TASK_ID", "1"), ("CUE_IFRAME", "2")], 2, "--index-env"),
        (&["--round", &round], &[("SGE_TASK_ID", "undefined")], 2, "no index of a task"),
        (&["--round", &round, "--index-env", "FRAME"], &[("SGE_TASK_ID", "1")], 2, "FRAME"),
        (&["--round", &round, "--index", "0", "--index-base", "-1"], &[], 2, "is no task"),
        (&["--round", &other, "--index", "0"], &[], 3, "has no round"),
        (&["--round", "xyz", "--index", "0"], &[], 2, "not a digest"),
        (&["--round", &round, "--index", "0", "--shards-per-task", "0"], &[], 2, "shards-per-task"),
    ];
    for (arguments, variables, code, part) in cases {
        let (found, words) = said(worker(folder.path(), ".prelight").args(arguments).envs(variables.iter().copied()));
        assert!(found == code && words.contains(part), "{arguments:?}: {found} {words}");
    }
    // An empty mount in the place of the share.
    std::fs::create_dir(folder.path().join("mount")).unwrap();
    let (code, words) = said(worker(folder.path(), "mount").args(["--round", &round, "--index", "0"]));
    assert!(code == 10 && words.contains("is not a prelight store"), "{code} {words}");
    assert_eq!(std::fs::read_dir(folder.path().join("mount")).unwrap().count(), 0);
}

#[test]
fn another_result_of_a_shard_is_kept_and_an_error_of_its_own() {
    let folder = room();
    let (waiting, round) = wait_for_round(folder.path());
    drop(waiting);
    let run = || worker(folder.path(), ".prelight").args(["--round", &round, "--index", "0"]).output().unwrap();
    assert_eq!(run().status.code(), Some(0));
    let store = Store::open(folder.path().join(".prelight")).unwrap();
    let file = RoundFile::read(&round.parse::<Digest>().unwrap(), &store).unwrap();
    let mut writer = store.writer();
    let chunk = writer.put(ChunkKind::Visibility, Dtype::U8, vec![3], b"bad").unwrap();
    writer.record(file.key(0), Record { chunks: vec![chunk], data: vec![0; 32] });
    writer.commit().unwrap();
    let output = run();
    let words = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        output.status.code() == Some(4) && words.contains("two different results") && words.contains(&file.key(0).to_string()),
        "{words}"
    );
    let (code, words) = said(prelight(folder.path()).args(["farm", "status"]));
    assert!(code == 4 && words.contains("two different results"), "{code} {words}");
    assert_eq!(Store::open(folder.path().join(".prelight")).unwrap().lookup_all(&file.key(0)).unwrap().len(), 2, "both are there");
}

#[test]
fn a_command_of_the_users_submits_rounds_to_any_engine() {
    let folder = room();
    let program = env!("CARGO_BIN_EXE_prelight");
    let submit = format!(
        "for i in $(seq 0 $PRELIGHT_LAST_TASK); do AWS_BATCH_JOB_ARRAY_INDEX=$i '{program}' shard run --store \"$PRELIGHT_STORE\" \
         --round $PRELIGHT_ROUND --shards-per-task $PRELIGHT_SHARDS_PER_TASK -q --jobs 1 || exit 1; done"
    );
    let baked = done(prelight(folder.path()).args(BAKE).args(["--engine=external", "--tasks=2", "--submit", &submit]));
    assert_eq!((digest(&baked), baked["tiles"]["baked"].as_u64()), (expected().to_string(), Some(0)));
    let (code, words) = said(prelight(room().path()).args(BAKE).args(["--engine=external", "--submit", "echo no queue >&2; exit 3"]));
    assert!(code == 5 && words.contains("no queue"), "{code} {words}");
}
