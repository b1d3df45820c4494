//! How progress looks: a bar on a terminal, a line every few seconds elsewhere, JSON events, or nothing.
//!
//! The work only counts (one atomic add per step). A thread of its own looks at the count and draws, so a stage that hangs still shows
//! that it does, and drawing never slows the work.

use super::escape::shown;
use super::interrupt;
use super::output::{Stdout, talk, talk_marked, talk_raw};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use prelight_bake::Progress;
use prelight_manifests::version::EVENT_VERSION;
use serde_json::{Value, json};
use std::fmt::Write;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock};
use std::time::{Duration, Instant};

/// What to show while the work runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// A bar on stderr.
    Bar,
    /// Lines on stderr.
    Lines,
    /// One JSON event a line, on stdout (`--json`) or stderr (`--progress json`).
    Events {
        /// Else stderr.
        to_stdout: bool,
    },
    /// No progress; messages and warnings as usual.
    None,
}

impl Look {
    /// Time between two looks at the count. A reader of events wants a sign of life each second, a log file does not.
    fn interval(self) -> Duration {
        match self {
            Look::Bar => Duration::from_millis(100),
            Look::Events { .. } => Duration::from_secs(1),
            Look::Lines | Look::None => Duration::from_secs(5),
        }
    }
}

/// The current stage.
struct Running {
    name: String,
    /// The name with the scene's number before it.
    label: String,
    unit: String,
    total: Option<u64>,
    start: Instant,
    bar: Option<ProgressBar>,
    spoke: bool,
}

struct Shared {
    look: Look,
    /// `--json`: messages and warnings become events too.
    json: bool,
    quiet: bool,
    stdout: Arc<Stdout>,
    done: AtomicU64,
    stage: Mutex<Option<Running>>,
    seconds: Mutex<Vec<(String, f64)>>,
    stop: Mutex<bool>,
    wake: Condvar,
    drawing: AtomicBool,
    scope: Mutex<Option<Scope>>,
    deadline: OnceLock<Instant>,
    /// Raised from outside when the work in progress is out of date.
    stale: Arc<AtomicBool>,
}

/// One of several scenes that are worked on one after the other.
#[derive(Clone, Debug)]
pub struct Scope {
    /// The scene as given.
    pub scene: String,
    /// From 1.
    pub number: usize,
    /// How many there are.
    pub of: usize,
}

/// The command's [`Progress`].
pub struct Reporter {
    shared: Arc<Shared>,
    ticker: Option<std::thread::JoinHandle<()>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

impl Reporter {
    /// Starts the drawing thread, unless there is nothing to draw.
    pub fn new(look: Look, json: bool, quiet: bool, stdout: Arc<Stdout>) -> Self {
        let shared = Arc::new(Shared {
            look,
            json,
            quiet,
            stdout,
            done: AtomicU64::new(0),
            stage: Mutex::new(None),
            seconds: Mutex::new(Vec::new()),
            stop: Mutex::new(false),
            wake: Condvar::new(),
            drawing: AtomicBool::new(true),
            scope: Mutex::new(None),
            deadline: OnceLock::new(),
            stale: Arc::default(),
        });
        let ticker = (look != Look::None).then(|| {
            let shared = shared.clone();
            std::thread::spawn(move || shared.tick_until_stopped())
        });
        Reporter { shared, ticker }
    }

    /// Seconds of each stage so far, in order of their first beginning; repeats of a name are added up.
    pub fn stage_seconds(&self) -> Vec<(String, f64)> {
        lock(&self.shared.seconds).clone()
    }

    /// Names the scene that stages, messages and events belong to from here on.
    pub fn set_scope(&self, scope: Option<Scope>) {
        *lock(&self.shared.scope) = scope;
    }

    /// Work is to stop at this time. The first time given stays.
    pub fn set_deadline(&self, deadline: Instant) {
        let _ = self.shared.deadline.set(deadline);
    }

    /// Whether the deadline has come.
    pub fn is_late(&self) -> bool {
        self.shared.deadline.get().is_some_and(|deadline| Instant::now() >= *deadline)
    }

    /// While this flag is raised, work in progress is to stop because its inputs have changed.
    pub fn stale(&self) -> Arc<AtomicBool> {
        self.shared.stale.clone()
    }

    /// Ends the open stage, so that its bar makes room for a line.
    pub fn end_stage(&self) {
        self.shared.end();
    }

    /// A result of its own, before the summary: a line on stdout; nothing with `--json`, which has an event for it.
    pub fn result(&self, line: &str) {
        if !self.shared.json {
            self.shared.end();
            self.shared.stdout.line(&shown(line));
        }
    }

    /// What to do about the warning before it; programs find it in the summary.
    pub fn help(&self, text: &str) {
        if !self.shared.json && !self.shared.quiet {
            self.shared.say(&format!("  {}", super::style::help()), text);
        }
    }

    /// An event of its own kind: a line of `--json`, nothing without.
    pub fn event(&self, event: Value) {
        if self.shared.json {
            self.shared.event(event);
        }
    }

    /// Ends the stage that an error left open and stops drawing, so that what is printed next stands alone.
    pub fn finish(&mut self) {
        self.shared.end();
        *lock(&self.shared.stop) = true;
        self.shared.drawing.store(false, Ordering::Relaxed);
        self.shared.wake.notify_all();
        if let Some(ticker) = self.ticker.take() {
            let _ = ticker.join();
        }
    }
}

impl Drop for Reporter {
    fn drop(&mut self) {
        self.finish();
    }
}

impl Shared {
    fn tick_until_stopped(&self) {
        let mut stop = lock(&self.stop);
        while !*stop {
            (stop, _) = self.wake.wait_timeout(stop, self.look.interval()).unwrap_or_else(|poisoned| poisoned.into_inner());
            if !*stop {
                self.tick();
            }
        }
    }

    fn tick(&self) {
        let mut stage = lock(&self.stage);
        let Some(running) = stage.as_mut() else { return };
        let done = self.done.load(Ordering::Relaxed);
        match self.look {
            Look::Bar => {
                if let Some(bar) = &running.bar {
                    bar.set_position(done);
                    bar.tick();
                }
            }
            // A stage shorter than one interval says nothing at all.
            Look::Lines if running.start.elapsed() >= self.look.interval() => {
                running.spoke = true;
                talk(&running.line(done));
            }
            Look::Events { .. } => self.event(running.event("progress", done)),
            Look::Lines | Look::None => {}
        }
    }

    fn begin(&self, name: &str, total: Option<u64>, unit: &str) {
        self.end();
        let mut stage = lock(&self.stage);
        self.done.store(0, Ordering::Relaxed);
        let label = match &*lock(&self.scope) {
            Some(scope) => format!("{}/{} {name}", scope.number, scope.of),
            None => name.to_string(),
        };
        let bar = (self.look == Look::Bar && self.drawing.load(Ordering::Relaxed)).then(|| new_bar(&label, total, unit));
        let running = Running { name: name.into(), label, unit: unit.into(), total, start: Instant::now(), bar, spoke: false };
        if let Look::Events { .. } = self.look {
            self.event(json!({ "event": "begin", "stage": name, "total": total, "unit": unit }));
        }
        *stage = Some(running);
    }

    fn end(&self) {
        let Some(running) = lock(&self.stage).take() else { return };
        let (done, seconds) = (self.done.load(Ordering::Relaxed), running.start.elapsed().as_secs_f64());
        if let Some(bar) = &running.bar {
            bar.finish_and_clear();
        }
        match self.look {
            Look::Events { .. } => self.event(running.event("end", done)),
            Look::Lines if running.spoke => {
                // A stage that counts nothing says no more than how long it took.
                let what = if done == 0 { String::new() } else { format!("{} {} in ", group(done), running.unit) };
                talk(&format!("{}: {what}{}", running.label, clock(seconds)));
            }
            _ => {}
        }
        let mut all = lock(&self.seconds);
        match all.iter_mut().find(|(name, _)| *name == running.name) {
            Some((_, sum)) => *sum += seconds,
            None => all.push((running.name, seconds)),
        }
    }

    fn event(&self, mut event: Value) {
        event["version"] = EVENT_VERSION.into();
        if let Some(scope) = &*lock(&self.scope) {
            event["scene"] = scope.scene.as_str().into();
            event["scene_number"] = scope.number.into();
            event["scenes"] = scope.of.into();
        }
        match self.look {
            Look::Events { to_stdout: false } => talk_raw(&event.to_string()),
            _ => self.stdout.line(&event.to_string()),
        }
    }

    /// A line for people on stderr, above the bar if there is one, behind a mark if that is not empty.
    fn say(&self, mark: &str, line: &str) {
        let say = || if mark.is_empty() { talk(line) } else { talk_marked(mark, line) };
        let stage = lock(&self.stage);
        match stage.as_ref().and_then(|running| running.bar.as_ref()) {
            Some(bar) => bar.suspend(say),
            None => say(),
        }
    }
}

impl Running {
    fn line(&self, done: u64) -> String {
        let seconds = self.start.elapsed().as_secs_f64();
        if done == 0 && self.total.is_none() {
            return format!("{}: {} so far", self.label, clock(seconds));
        }
        let rate = if seconds > 0.0 { done as f64 / seconds } else { 0.0 };
        // Totals that are estimates can be passed; then they say nothing any more.
        let of_total = match self.total.filter(|total| done <= *total) {
            Some(total) => format!("{} of {} {} ({:.0} %)", group(done), group(total), self.unit, percent(done, total)),
            None => format!("{} {}", group(done), self.unit),
        };
        let left = remaining(done, self.total, seconds).filter(|left| *left > 0.0);
        let left = left.map(|left| format!(", about {} left", clock(left))).unwrap_or_default();
        format!("{}: {of_total}, {} a second, {} so far{left}", self.label, short_number(rate), clock(seconds))
    }

    fn event(&self, kind: &str, done: u64) -> Value {
        let seconds = self.start.elapsed().as_secs_f64();
        json!({
            "event": kind,
            "stage": self.name,
            "done": done,
            "total": self.total,
            "unit": self.unit,
            "seconds": seconds,
            "seconds_left": if kind == "end" { None } else { remaining(done, self.total, seconds) },
        })
    }
}

/// Seconds left if the rest goes as fast as what is done; `None` without a total, past it or before the first step.
fn remaining(done: u64, total: Option<u64>, seconds: f64) -> Option<f64> {
    let left = total?.checked_sub(done)?;
    (done > 0).then(|| seconds / done as f64 * left as f64)
}

fn percent(done: u64, total: u64) -> f64 {
    if total == 0 { 100.0 } else { 100.0 * done as f64 / total as f64 }
}

fn new_bar(name: &str, total: Option<u64>, unit: &str) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(total, ProgressDrawTarget::stderr());
    // The unit goes through a template: braces in it would be read as placeholders.
    let unit = unit.replace(['{', '}'], "");
    let template = match total {
        Some(_) => format!("{{prefix:>10}} [{{bar:28}}] {{human_pos}}/{{human_len}} {unit}  {{rate}}/s  {{eta}} left"),
        None => format!("{{prefix:>10}} {{spinner}} {{human_pos}} {unit}  {{rate}}/s  {{elapsed}}"),
    };
    if let Ok(style) = ProgressStyle::with_template(&template) {
        let rate = |state: &ProgressState, out: &mut dyn Write| {
            let _ = out.write_str(&short_number(state.per_sec()));
        };
        let style = style.with_key("rate", rate);
        bar.set_style(style.progress_chars("=> "));
    }
    bar.set_prefix(name.to_string());
    bar
}

impl Progress for Reporter {
    fn begin(&self, stage: &str, total: Option<u64>, unit: &str) {
        self.shared.begin(stage, total, unit);
    }

    fn advance(&self, n: u64) {
        self.shared.done.fetch_add(n, Ordering::Relaxed);
    }

    fn end(&self) {
        self.shared.end();
    }

    fn message(&self, text: &str) {
        if self.shared.json {
            self.shared.event(json!({ "event": "message", "text": text }));
        } else if !self.shared.quiet {
            self.shared.say("", text);
        }
    }

    fn warning(&self, text: &str) {
        if self.shared.json {
            self.shared.event(json!({ "event": "warning", "text": text }));
        } else {
            self.shared.say(&super::style::warning(), text);
        }
    }

    fn is_cancelled(&self) -> bool {
        interrupt::requested() || self.shared.stale.load(Ordering::Relaxed) || self.is_late()
    }
}

/// `1234567` as `1 234 567`.
pub fn group(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::with_capacity(digits.len() * 4 / 3);
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(' ');
        }
        text.push(digit);
    }
    text
}

/// `1 object`, `2 objects`.
pub fn count(number: u64, thing: &str) -> String {
    format!("{} {thing}{}", group(number), if number == 1 { "" } else { "s" })
}

/// Seconds as a person reads them: `0.42 s`, `3.1 s`, `2 min 05 s`, `3 h 07 min`.
pub fn clock(seconds: f64) -> String {
    let whole = seconds.round() as u64;
    match seconds {
        s if s < 1.0 => format!("{s:.2} s"),
        s if s < 59.95 => format!("{s:.1} s"),
        s if s < 3599.5 => format!("{} min {:02} s", whole / 60, whole % 60),
        _ => format!("{} h {:02} min", whole / 3600, whole / 60 % 60),
    }
}

/// Three digits: `0.42`, `17`, `3.2 k`, `1.5 M`.
fn short_number(number: f64) -> String {
    match number {
        n if n >= 999_500.0 => format!("{:.1} M", n / 1e6),
        n if n >= 9_995.0 => format!("{:.1} k", n / 1e3),
        n if n >= 9.95 => format!("{n:.0}"),
        n => format!("{n:.2}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stage_seconds_add_up_by_name_and_survive_an_open_stage() {
        let mut reporter = Reporter::new(Look::None, false, true, Arc::new(Stdout::default()));
        for name in ["trace", "seal", "trace"] {
            reporter.begin(name, Some(2), "tiles");
            reporter.advance(2);
        }
        reporter.finish();
        let names: Vec<String> = reporter.stage_seconds().into_iter().map(|(name, _)| name).collect();
        assert_eq!(names, ["trace", "seal"]);
        assert!(reporter.stage_seconds().iter().all(|(_, seconds)| *seconds >= 0.0));
    }

    #[test]
    fn a_heartbeat_says_how_far_how_fast_and_how_long() {
        let start = Instant::now().checked_sub(Duration::from_secs(10)).expect("the machine is up for ten seconds");
        let (name, label) = ("trace".to_string(), "trace".to_string());
        let mut stage = Running { name, label, unit: "tiles".into(), total: Some(4000), start, bar: None, spoke: false };
        let line = stage.line(1000);
        assert!(line.starts_with("trace: 1 000 of 4 000 tiles (25 %), "), "{line}");
        assert!(line.contains(" a second, 10") && line.contains(" so far, about 30"), "{line}");
        assert!(stage.event("progress", 1000)["seconds_left"].as_f64().is_some_and(|left| (30.0..60.0).contains(&left)));
        assert!(stage.event("end", 4000)["seconds_left"].is_null());
        stage.total = None;
        assert!(stage.line(1000).starts_with("trace: 1 000 tiles, ") && !stage.line(1000).contains("left"));
        assert!(stage.line(0).starts_with("trace: 10") && !stage.line(0).contains("tiles"), "{}", stage.line(0));
    }

    #[test]
    fn numbers_read_well() {
        assert_eq!([0, 1, 2000].map(|n| count(n, "object")), ["0 objects", "1 object", "2 000 objects"]);
        assert_eq!([0, 12, 1234, 1_234_567].map(group), ["0", "12", "1 234", "1 234 567"]);
        assert_eq!([0.419, 3.16, 59.96, 125.0, 11_220.0].map(clock), ["0.42 s", "3.2 s", "1 min 00 s", "2 min 05 s", "3 h 07 min"]);
        assert_eq!(remaining(25, Some(100), 5.0), Some(15.0));
        assert_eq!(remaining(0, Some(100), 5.0), None);
        assert_eq!(remaining(5, None, 5.0), None);
        assert_eq!(remaining(101, Some(100), 5.0), None);
        assert_eq!(percent(0, 0), 100.0);
    }
}
