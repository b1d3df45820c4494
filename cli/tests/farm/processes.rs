//! `--engine local-processes`: the digest of threads, also when workers are killed.

use crate::command::{prelight, stderr, summary};
use crate::room::{BAKE, digest, done, expected, room, rounds, said};
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

const PROCESSES: [&str; 3] = ["--engine=local-processes", "--tasks=2", "--task-threads=1"];

/// Processes that a process started.
fn children(parent: &Child) -> Vec<u32> {
    let Ok(threads) = std::fs::read_dir(format!("/proc/{}/task", parent.id())) else { return Vec::new() };
    let lists = threads.filter_map(|thread| std::fs::read_to_string(thread.ok()?.path().join("children")).ok());
    lists.flat_map(|list| list.split_whitespace().filter_map(|id| id.parse().ok()).collect::<Vec<_>>()).collect()
}

fn signal(process: u32, name: &str) {
    let _ = std::process::Command::new("kill").args([name, &process.to_string()]).stderr(Stdio::null()).status();
}

#[test]
fn processes_give_the_digest_of_threads_and_the_store_says_what_is_done() {
    let folder = room();
    let baked = done(prelight(folder.path()).args(BAKE).args(PROCESSES));
    assert_eq!(digest(&baked), expected());
    let rounds = rounds(folder.path());
    let names: Vec<&str> = rounds.iter().map(|round| round["technique"].as_str().unwrap()).collect();
    assert!(names.contains(&"block_product") && names.contains(&"vmf_transfer"), "{names:?}");
    assert!(rounds.iter().all(|round| round["shards"]["done"] == round["shards"]["of"] && round["shards"]["of"].as_u64() > Some(0)));
    // Nothing was baked by the process that asked.
    assert_eq!(baked["tiles"]["baked"], 0, "{baked}");
    let logs = said(prelight(folder.path()).args(["farm", "logs"]));
    assert!(logs.0 == 0 && logs.1.contains("task 0: "), "{logs:?}");
    let again = done(prelight(folder.path()).args(BAKE).args(PROCESSES));
    assert_eq!((digest(&again), again["bytes"]["stored"].as_u64()), (expected().to_string(), Some(0)));
}

#[test]
fn a_killed_worker_is_submitted_again_and_one_that_always_fails_is_named_with_its_log() {
    let folder = room();
    let mut bake = prelight(folder.path());
    bake.args(BAKE).args(PROCESSES).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = bake.spawn().unwrap();
    let (mut killed, start) = (Vec::new(), Instant::now());
    while child.try_wait().unwrap().is_none() && killed.len() < 3 {
        for worker in children(&child).into_iter().filter(|worker| !killed.contains(worker)).collect::<Vec<_>>() {
            signal(worker, "-KILL");
            killed.push(worker);
        }
        assert!(start.elapsed() < Duration::from_secs(120), "the bake hangs");
        std::thread::sleep(Duration::from_millis(2));
    }
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(killed.len() >= 3, "{killed:?}");
    assert_eq!(digest(&summary(&output)), expected());
    assert!(String::from_utf8_lossy(&output.stdout).contains("submitted again"));

    let folder = room();
    let (code, words) = said(prelight(folder.path()).args(BAKE).args(PROCESSES).args(["--worker=false", "--tries=1"]));
    assert!(
        code == 5 && words.contains("ran 2 times") && words.contains(".log") && words.contains("run the same command again"),
        "{code} {words}"
    );
    let (code, words) = said(prelight(folder.path()).args(BAKE).args(PROCESSES).arg("--worker=no-such-program"));
    assert!(code == 5 && words.contains("cannot start no-such-program"), "{code} {words}");
    assert_eq!(digest(&done(prelight(folder.path()).args(BAKE).args(PROCESSES))), expected());
}

#[test]
fn a_bake_that_is_asked_to_stop_ends_its_workers_and_goes_on_later() {
    let folder = room();
    let mut bake = prelight(folder.path());
    bake.args(BAKE).args(PROCESSES).stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = bake.spawn().unwrap();
    let start = Instant::now();
    let workers = loop {
        let workers = children(&child);
        if !workers.is_empty() || child.try_wait().unwrap().is_some() {
            break workers;
        }
        assert!(start.elapsed() < Duration::from_secs(120), "no worker starts");
        std::thread::sleep(Duration::from_millis(2));
    };
    assert!(!workers.is_empty());
    signal(child.id(), "-TERM");
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert!(workers.iter().all(|worker| !Path::new(&format!("/proc/{worker}/exe")).exists()), "workers end with the bake");
    assert_eq!(digest(&done(prelight(folder.path()).args(BAKE).args(PROCESSES))), expected());
}
