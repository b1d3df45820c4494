//! A real Slurm, where its programs can be had: three nodes on this machine, each a namespace of processes, so that a kill takes all of a node.
//! Needs root, and of Debian `slurmctld slurmd slurm-client munge`; without them it says SKIPPED.

use crate::command::{prelight, stderr, summary};
use crate::room::{BAKE, digest, expected, room};
use std::fs::{self, File};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const NODES: usize = 3;

/// Daemons of a cluster in a folder of its own; ended with it.
struct Cluster {
    folder: tempfile::TempDir,
    controller: Child,
    munge: Child,
    nodes: Vec<Child>,
}

/// Why there is no Slurm here; `None` where there is one.
fn lacks() -> Option<String> {
    let is_root = fs::metadata("/proc/self").is_ok_and(|metadata| std::os::unix::fs::MetadataExt::uid(&metadata) == 0);
    let has = |program: &str| ["/usr/bin", "/usr/sbin", "/bin", "/sbin"].iter().any(|folder| Path::new(folder).join(program).exists());
    let programs = ["slurmctld", "slurmd", "sbatch", "squeue", "scancel", "scontrol", "sinfo", "munged", "unshare"];
    let missing: Vec<&str> = programs.into_iter().filter(|program| !has(program)).collect();
    match (is_root, missing.is_empty()) {
        (false, _) => Some("not root".to_string()),
        (_, false) => Some(format!("no {}", missing.join(", "))),
        _ => None,
    }
}

fn start(command: &mut Command, log: &Path) -> Child {
    let out = File::create(log).unwrap();
    command.stdin(Stdio::null()).stdout(out.try_clone().unwrap()).stderr(out).spawn().unwrap_or_else(|error| panic!("{command:?}: {error}"))
}

/// Ports that are free now, one after the other.
fn free_ports(n: u16) -> u16 {
    loop {
        let first = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        if first < 60_000 && (first..first + n).all(|port| TcpListener::bind(("127.0.0.1", port)).is_ok()) {
            return first;
        }
    }
}

impl Cluster {
    /// Boots it, or says loudly why it cannot.
    fn boot() -> Option<Self> {
        if let Some(what) = lacks() {
            eprintln!("SKIPPED: a real Slurm: {what}");
            return None;
        }
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        ["munge", "state", "log", "spool", "run"].iter().for_each(|name| fs::create_dir(at(name)).unwrap());
        let mode = |path: PathBuf, mode| fs::set_permissions(path, std::os::unix::fs::PermissionsExt::from_mode(mode)).unwrap();
        mode(folder.path().to_path_buf(), 0o755);
        mode(at("munge"), 0o700);
        let mut key = [0u8; 128];
        std::io::Read::read_exact(&mut File::open("/dev/urandom").unwrap(), &mut key).unwrap();
        fs::write(at("munge/key"), key).unwrap();
        mode(at("munge/key"), 0o400);
        fs::write(at("slurm.conf"), configuration(folder.path(), free_ports(1 + NODES as u16))).unwrap();
        let path = |name: &str| at(name).display().to_string();
        let mut munged = Command::new("munged");
        munged.args(["--force", "--foreground", "--num-threads=2"]);
        munged.args([format!("--key-file={}", path("munge/key")), format!("--socket={}", path("run/munge.sock"))]);
        munged.args([format!("--pid-file={}", path("munge/pid")), format!("--log-file={}", path("log/munged.log"))]);
        let munge = start(munged.arg(format!("--seed-file={}", path("munge/seed"))), &at("log/munged.out"));
        let controller = start_controller(folder.path());
        let nodes = (1..=NODES).map(|node| start_node(folder.path(), node)).collect();
        let cluster = Cluster { folder, controller, munge, nodes };
        cluster.wait_for_idle(NODES);
        Some(cluster)
    }

    fn configuration(&self) -> PathBuf {
        self.folder.path().join("slurm.conf")
    }

    fn ask(&self, program: &str, arguments: &[&str]) -> String {
        let output = Command::new(program).args(arguments).env("SLURM_CONF", self.configuration()).output().unwrap();
        String::from_utf8_lossy(&output.stdout).into_owned()
    }

    fn wait_for_idle(&self, nodes: usize) {
        let begin = Instant::now();
        while self.ask("sinfo", &["-h", "-N", "-t", "idle", "-o", "%N"]).lines().count() < nodes {
            let log = fs::read_to_string(self.folder.path().join("log/slurmctld.log")).unwrap_or_default();
            assert!(begin.elapsed() < Duration::from_secs(60), "the cluster does not come up: {log}");
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    fn bake(&self, folder: &Path) -> Command {
        let mut command = prelight(folder);
        command.args(BAKE).args(["--engine=slurm", "--tasks=8"]).env("SLURM_CONF", self.configuration());
        command
    }

    /// Waits until a task runs on a node.
    fn wait_for_task_on(&self, node: usize, bake: &mut Child) {
        let begin = Instant::now();
        while self.ask("squeue", &["-h", "-t", "R", "-w", &format!("n{node}")]).trim().is_empty() {
            assert!(bake.try_wait().unwrap().is_none(), "the bake is over");
            assert!(begin.elapsed() < Duration::from_secs(90), "no task runs on n{node}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// The machine dies: the daemon of a node, what looks after its tasks, and the tasks.
    fn kill_node(&mut self, node: usize) {
        let child = &mut self.nodes[node - 1];
        child.kill().unwrap();
        child.wait().unwrap();
        self.ask("scontrol", &["update", &format!("nodename=n{node}"), "state=down", "reason=crash"]);
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        for child in self.nodes.iter_mut().chain([&mut self.controller, &mut self.munge]) {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

fn start_controller(folder: &Path) -> Child {
    let mut command = Command::new("slurmctld");
    command.arg("-D").arg("-f").arg(folder.join("slurm.conf")).env("SLURM_CONF", folder.join("slurm.conf"));
    start(&mut command, &folder.join("log/slurmctld.out"))
}

fn start_node(folder: &Path, node: usize) -> Child {
    let mut command = Command::new("unshare");
    command.args(["--pid", "--fork", "--mount-proc", "--kill-child=KILL", "slurmd", "-D", "-N", &format!("n{node}"), "-f"]);
    command.arg(folder.join("slurm.conf")).env("SLURM_CONF", folder.join("slurm.conf"));
    start(&mut command, &folder.join(format!("log/slurmd-n{node}.out")))
}

fn configuration(folder: &Path, port: u16) -> String {
    let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap();
    let host = host.trim().split('.').next().unwrap().to_string();
    let b = folder.display();
    let mut text = format!(
        "ClusterName=bake\nSlurmctldHost={host}(127.0.0.1)\nSlurmUser=root\nSlurmdUser=root\nAuthType=auth/munge\n\
         AuthInfo=socket={b}/run/munge.sock,cred_expire=5\nSlurmctldPort={port}\nStateSaveLocation={b}/state\n\
         SlurmctldPidFile={b}/run/slurmctld.pid\nSlurmctldLogFile={b}/log/slurmctld.log\nSlurmdSpoolDir={b}/spool/%n\n\
         SlurmdPidFile={b}/run/slurmd-%n.pid\nSlurmdLogFile={b}/log/slurmd-%n.log\nProctrackType=proctrack/linuxproc\n\
         TaskPlugin=task/none\nJobAcctGatherType=jobacct_gather/none\nJobCompType=jobcomp/filetxt\nJobCompLoc={b}/log/jobcomp.txt\n\
         AccountingStorageType=accounting_storage/none\nMpiDefault=none\nSelectType=select/cons_tres\nSelectTypeParameters=CR_CPU\n\
         SchedulerType=sched/backfill\nSchedulerParameters=sched_interval=2,bf_interval=2,batch_sched_delay=0\nReturnToService=2\n\
         JobRequeue=1\nSlurmctldTimeout=10\nSlurmdTimeout=5\nMessageTimeout=5\nInactiveLimit=0\nKillWait=2\nMinJobAge=300\n\
         TreeWidth=65533\nSlurmdParameters=config_overrides\n"
    );
    for node in 1..=NODES as u16 {
        let port = port + node;
        text += &format!("NodeName=n{node} NodeHostname={host} NodeAddr=127.0.0.1 Port={port} CPUs=1 RealMemory=1000 State=UNKNOWN\n");
    }
    text + &format!("PartitionName=bake Nodes=n[1-{NODES}] Default=YES MaxTime=INFINITE State=UP OverSubscribe=NO\n")
}

fn spawn(command: &mut Command) -> Child {
    command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

fn ends_as_expected(child: Child, case: &str) {
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{case}: {} {}", String::from_utf8_lossy(&output.stdout), stderr(&output));
    assert_eq!(digest(&summary(&output)), expected(), "{case}");
}

#[test]
fn a_real_slurm_gives_the_digest_of_threads_whatever_dies() {
    let Some(mut cluster) = Cluster::boot() else { return };
    let begin = Instant::now();
    let said = |case: &str| eprintln!("{case}: {:.1} s since the cluster was up", begin.elapsed().as_secs_f64());
    let folder = room();
    ends_as_expected(spawn(&mut cluster.bake(folder.path())), "undisturbed");
    said("undisturbed");

    let folder = room();
    let mut bake = spawn(&mut cluster.bake(folder.path()));
    cluster.wait_for_task_on(2, &mut bake);
    cluster.kill_node(2);
    ends_as_expected(bake, "a machine was killed");
    said("a machine was killed");
    let conf = cluster.folder.path().to_path_buf();
    cluster.nodes[1] = start_node(&conf, 2);
    cluster.wait_for_idle(NODES);

    // A node that looks dead and runs on: its task is run twice.
    let folder = room();
    let mut bake = spawn(&mut cluster.bake(folder.path()));
    cluster.wait_for_task_on(3, &mut bake);
    let daemons = Command::new("pgrep").args(["-f", &format!("slurmd -D -N n3 -f {}", conf.display())]).output().unwrap();
    let daemons: Vec<String> = String::from_utf8_lossy(&daemons.stdout).split_whitespace().map(String::from).collect();
    let signal = |name: &str| Command::new("kill").arg(name).args(&daemons).status().unwrap();
    signal("-STOP");
    ends_as_expected(bake, "a node was cut off");
    signal("-CONT");
    said("a node was cut off");
    cluster.wait_for_idle(NODES);

    // The controller is killed right after the jobs were submitted, and forgets them. It gives their numbers out again and so takes its nodes for
    // broken: who looks after the cluster has to say that they are not.
    let folder = room();
    let mut bake = spawn(&mut cluster.bake(folder.path()));
    cluster.wait_for_task_on(1, &mut bake);
    cluster.controller.kill().unwrap();
    cluster.controller.wait().unwrap();
    std::thread::sleep(Duration::from_secs(2));
    cluster.controller = start_controller(&conf);
    let restarted = Instant::now();
    while bake.try_wait().unwrap().is_none() {
        (1..=NODES).for_each(|node| drop(cluster.ask("scontrol", &["update", &format!("nodename=n{node}"), "state=resume"])));
        if restarted.elapsed() > Duration::from_secs(150) {
            let (queue, nodes) = (cluster.ask("squeue", &[]), cluster.ask("sinfo", &["-R"]));
            bake.kill().unwrap();
            panic!("the bake does not go on: {queue}{nodes}");
        }
        std::thread::sleep(Duration::from_secs(2));
    }
    ends_as_expected(bake, "the controller was killed");
    said("the controller was killed");
}
