//! A Slurm that is acted by four scripts on the path: what `prelight` asks of it, and what it makes of jobs that are lost, held or named twice.

use crate::command::prelight;
use crate::room::{BAKE, digest, done, expected, room, said};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const SBATCH: &str = r#"#!/bin/bash
# Runs every index at once in the background. Loses those with index 0 the first time where there is a file `lose`.
echo "$@" >> "$ACT/arguments"
[ -e "$ACT/refuse" ] && { echo "sbatch: error: invalid partition specified: gpu" >&2; exit 1; }
for word; do case $word in --array=*) array=${word#*=};; --job-name=*) name=${word#*=};; --output=*) output=${word#*=};; esac; done
script=$(mktemp "$ACT/script.XXXXXX"); cat > "$script"; chmod +x "$script"
IFS=,
for part in $array; do
  for ((i = ${part%-*}; i <= ${part#*-}; i++)); do
    echo "$name $i" >> "$ACT/submitted"
    if [ $i = 0 ] && [ -e "$ACT/lose" ] && ! grep -qx "$name" "$ACT/lost" 2> /dev/null; then echo "$name" >> "$ACT/lost"; continue; fi
    echo > "$ACT/jobs/$name,$i"
    log=${output/\%a/$i}
    [ -e "$ACT/hold" ] || (SLURM_ARRAY_TASK_ID=$i "$script" >> "$log" 2>&1; rm -f "$ACT/jobs/$name,$i") < /dev/null > /dev/null 2>&1 &
  done
done
echo 117
"#;

const SQUEUE: &str = r#"#!/bin/bash
[ -e "$ACT/down" ] && { rm -f "$ACT/down"; echo "slurm_load_jobs error: Unable to contact slurm controller (connect failure)" >&2; exit 1; }
for word; do case $word in --name=*) names=,${word#*=},;; --format=*) format=${word#*=};; esac; done
for job in "$ACT"/jobs/*; do
  [ -e "$job" ] || continue
  job=${job##*/}; name=${job%,*}; index=${job#*,}
  if [ "$format" = %j ]; then echo "$name"; elif [[ $names == *,$name,* ]]; then echo "$name|$index|RUNNING|0:01|None"; fi
done
"#;

const SCANCEL: &str = r#"#!/bin/bash
for word; do case $word in --name=*) echo "${word#*=}" >> "$ACT/cancelled"; rm -f "$ACT/jobs/${word#*=}",*;; esac; done
"#;

const SCONTROL: &str = "#!/bin/bash\necho 'MaxArraySize            = 3'\n";

/// The scripts and what they keep.
struct Act {
    folder: tempfile::TempDir,
}

impl Act {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("jobs")).unwrap();
        for (name, text) in [("sbatch", SBATCH), ("squeue", SQUEUE), ("scancel", SCANCEL), ("scontrol", SCONTROL)] {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            std::fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
        }
        Act { folder }
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.file(name)).unwrap_or_default()
    }

    fn set(&self, name: &str) {
        std::fs::write(self.file(name), "").unwrap();
    }

    fn on(&self, command: &mut Command) {
        let path = format!("{}:{}", self.folder.path().display(), std::env::var("PATH").unwrap_or_default());
        command.env("PATH", path).env("ACT", self.folder.path());
    }

    fn bake(&self, folder: &Path) -> Command {
        let mut command = prelight(folder);
        command.args(BAKE).args(["--engine=slurm", "--tasks=5", "--partition=bake", "--sbatch-arg=--time=10"]);
        self.on(&mut command);
        command
    }
}

#[test]
fn rounds_become_arrays_below_the_limit_and_give_the_digest_of_threads() {
    let (folder, act) = (room(), Act::new());
    assert_eq!(digest(&done(&mut act.bake(folder.path()))), expected());
    let arguments = act.read("arguments");
    let first = arguments.lines().next().unwrap();
    for word in ["--partition=bake", "--time=10", "--requeue", "--cpus-per-task=1", "--array=0-2", "--job-name=prelight-", "-0 "] {
        assert!(first.contains(word), "{word}: {first}");
    }
    assert!(arguments.lines().any(|line| line.contains("--array=0-1") && line.contains("-3 ")), "the second array: {arguments}");
}

#[test]
fn lost_jobs_and_a_controller_that_is_away_cost_time_and_nothing_else() {
    let (folder, act) = (room(), Act::new());
    act.set("lose");
    act.set("down");
    let output = act.bake(folder.path()).output().unwrap();
    let events = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(0), "{events}");
    assert!(events.contains(expected()) && events.contains("submitted again"), "{events}");
    let submitted = act.read("submitted");
    let lost = act.read("lost");
    assert!(lost.lines().count() > 0 && lost.lines().all(|name| submitted.matches(&format!("{name} 0\n")).count() == 2), "{submitted}");

    let (folder, act) = (room(), Act::new());
    act.set("refuse");
    let (code, words) = said(&mut act.bake(folder.path()));
    assert!(code == 5 && words.contains("invalid partition"), "{code} {words}");
}

#[test]
fn stopped_it_ends_its_jobs_or_leaves_them_and_goes_on_with_those_that_are_left() {
    for leave in [false, true] {
        let (folder, act) = (room(), Act::new());
        act.set("hold");
        let mut bake = act.bake(folder.path());
        bake.args(leave.then_some("--leave")).stdout(Stdio::null()).stderr(Stdio::null());
        let mut child = bake.spawn().unwrap();
        let start = Instant::now();
        while act.read("submitted").lines().count() < 5 {
            assert!(start.elapsed() < Duration::from_secs(120), "nothing is submitted");
            std::thread::sleep(Duration::from_millis(10));
        }
        Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap();
        assert_eq!(child.wait().unwrap().code(), Some(130));
        assert_eq!(act.read("cancelled").lines().count(), if leave { 0 } else { 2 });
        let mut cancel = prelight(folder.path());
        act.on(cancel.args(["farm", "cancel", "--json"]));
        if leave {
            // What is in the queue is not submitted a second time.
            let mut child = act.bake(folder.path()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
            std::thread::sleep(Duration::from_secs(4));
            Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap();
            child.wait().unwrap();
            assert_eq!(act.read("submitted").lines().count(), 5);
            assert_eq!(done(&mut cancel)["jobs"].as_array().unwrap().len(), 0, "the second bake ended them");
        } else {
            assert_eq!(done(&mut cancel)["jobs"].as_array().unwrap().len(), 0);
        }
        std::fs::remove_file(act.file("hold")).unwrap();
        assert_eq!(digest(&done(&mut act.bake(folder.path()))), expected());
    }
}
