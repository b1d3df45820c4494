//! Ctrl-C: the first asks the work to stop where it can resume, the second ends the process at once. SIGTERM counts the same.

use super::exit::ExitCode;
use super::output::talk;
use std::sync::atomic::{AtomicU32, Ordering};

static SIGNALS: AtomicU32 = AtomicU32::new(0);

/// Installs the handler. Once per process.
pub fn install() {
    let handler = || {
        if SIGNALS.fetch_add(1, Ordering::SeqCst) == 0 {
            talk("\ninterrupted: finishing what is in flight; once more ends at once");
        } else {
            std::process::exit(ExitCode::Interrupted as i32);
        }
    };
    // Without a handler the first Ctrl-C ends at once, which is safe too: chunks are written before records.
    let _ = ctrlc::set_handler(handler);
}

/// Whether the user asked to stop.
pub fn requested() -> bool {
    SIGNALS.load(Ordering::Relaxed) > 0
}
