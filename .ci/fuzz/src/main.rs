//! Mutates the corpus of each fuzz target for some seconds and says what came of it.
//!
//! ```text
//! prelight-fuzz-run SECONDS [FIRST] [TARGET...]      a line a target: name, seconds, runs, crashes
//! ```
//!
//! `FIRST` is the first seed, 0 unless given; the seed of a run is all that its bytes depend on. What panics, or takes more than
//! [`PATIENCE`], is kept in the folder for temporary files, and its seed is said on stderr. Built as tests are: with checks of overflow.

use prelight_tests::corpus::{mutation, seeds};
use prelight_tests::fuzzed::{TARGETS, Target};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// A run that takes longer hangs, also on a machine that has much else to do.
const PATIENCE: Duration = Duration::from_secs(300);

/// Crashes of one target after which it is left: they are the same one mostly.
const ENOUGH: u64 = 20;

/// Seed of the run under way, and when it began in milliseconds since the start.
static SEED: AtomicU64 = AtomicU64::new(0);
static BEGAN: AtomicU64 = AtomicU64::new(u64::MAX);

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1).peekable();
    let Some(seconds) = arguments.next().and_then(|text| text.parse().ok()) else {
        eprintln!("usage: prelight-fuzz-run SECONDS [FIRST] [TARGET...]");
        return ExitCode::from(2);
    };
    let first = arguments.peek().and_then(|text| text.parse().ok());
    if first.is_some() {
        arguments.next();
    }
    let wanted: Vec<String> = arguments.collect();
    let start = Instant::now();
    std::thread::spawn(move || watch(start));
    let mut crashes = 0;
    for target in TARGETS.iter().filter(|(name, _)| wanted.is_empty() || wanted.iter().any(|wanted| wanted == name)) {
        crashes += run(*target, first.unwrap_or(0), Duration::from_secs(seconds), start);
    }
    if crashes == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Ends the process when a run takes too long: nothing else can be done about it.
fn watch(start: Instant) {
    loop {
        std::thread::sleep(Duration::from_secs(1));
        let began = BEGAN.load(Ordering::SeqCst);
        if began != u64::MAX && start.elapsed() > Duration::from_millis(began) + PATIENCE {
            eprintln!("hangs at seed {}", SEED.load(Ordering::SeqCst));
            std::process::exit(1);
        }
    }
}

/// Runs one target; its crashes.
fn run((name, target): Target, first: u64, time: Duration, start: Instant) -> u64 {
    let (seeds, begin, mut runs, mut crashes) = (seeds(name), Instant::now(), 0u64, 0u64);
    while begin.elapsed() < time && crashes < ENOUGH {
        let seed = first.wrapping_add(runs);
        let bytes = mutation(&seeds, seed);
        SEED.store(seed, Ordering::SeqCst);
        BEGAN.store(start.elapsed().as_millis() as u64, Ordering::SeqCst);
        if catch_unwind(AssertUnwindSafe(|| target(&bytes))).is_err() {
            crashes += 1;
            let path = std::env::temp_dir().join(format!("prelight-fuzz-{name}-{seed}"));
            let kept = std::fs::write(&path, &bytes).map_or("nowhere".to_string(), |()| path.display().to_string());
            eprintln!("{name}: seed {seed} panics; the bytes are in {kept}");
        }
        BEGAN.store(u64::MAX, Ordering::SeqCst);
        runs += 1;
    }
    println!("{name},{:.0},{runs},{crashes}", begin.elapsed().as_secs_f64());
    crashes
}
