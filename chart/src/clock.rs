//! CPU time: what a busy machine does not stretch. Wall time where the system does not say.

#[cfg(unix)]
fn seconds(clock: rustix::time::ClockId) -> f64 {
    let time = rustix::time::clock_gettime(clock);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// CPU time of this thread, nanoseconds.
#[cfg(unix)]
pub fn thread_nanoseconds() -> f64 {
    1e9 * seconds(rustix::time::ClockId::ThreadCPUTime)
}

/// CPU time of all threads of this process, seconds.
#[cfg(unix)]
pub fn process_seconds() -> f64 {
    seconds(rustix::time::ClockId::ProcessCPUTime)
}

#[cfg(not(unix))]
fn since_start() -> f64 {
    static START: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
    START.get_or_init(std::time::Instant::now).elapsed().as_secs_f64()
}

/// Wall time, nanoseconds.
#[cfg(not(unix))]
pub fn thread_nanoseconds() -> f64 {
    1e9 * since_start()
}

/// Wall time, seconds.
#[cfg(not(unix))]
pub fn process_seconds() -> f64 {
    since_start()
}
