//! Hooks of the calling program and faults of the environment, as [`super`] describes them.

use super::FaultPoint;
use std::cell::RefCell;
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

/// Called before every call to the system with the call's name and path; an error is what the call then returns.
pub type CallHook = Arc<dyn Fn(&'static str, &Path) -> io::Result<()> + Send + Sync>;

thread_local! {
    static CALL_HOOK: RefCell<Option<CallHook>> = const { RefCell::new(None) };
}

/// Runs `run` with `hook` seeing every call to the system that this thread makes in it.
pub fn with_call_hook<T>(hook: CallHook, run: impl FnOnce() -> T) -> T {
    struct Restore(Option<CallHook>);
    impl Drop for Restore {
        fn drop(&mut self) {
            CALL_HOOK.set(self.0.take());
        }
    }
    let _restore = Restore(CALL_HOOK.replace(Some(hook)));
    run()
}

/// A call to the system is about to be made.
pub(crate) fn before(call: &'static str, path: &Path) -> io::Result<()> {
    if let Some(fault) = env_fault() {
        fault.before(call, path)?;
    }
    // A hook that calls the system itself is not called again.
    let Some(hook) = CALL_HOOK.take() else { return Ok(()) };
    let result = hook(call, path);
    CALL_HOOK.set(Some(hook));
    result
}

/// `os:CALL:ERROR[:N[:NAME]]` of the environment.
struct EnvFault {
    call: String,
    errno: i32,
    first: u64,
    name: String,
    seen: AtomicU64,
}

impl EnvFault {
    fn parse(text: &str) -> Option<Self> {
        const ERRNOS: [(&str, i32); 7] =
            [("ENOSPC", 28), ("EDQUOT", 122), ("EIO", 5), ("EMFILE", 24), ("EROFS", 30), ("ESTALE", 116), ("ENOENT", 2)];
        let mut parts = text.strip_prefix("os:")?.splitn(4, ':');
        let (call, errno) = (parts.next()?.to_string(), parts.next()?);
        let errno = ERRNOS.iter().find(|(name, _)| *name == errno)?.1;
        let first = parts.next().map_or(Some(1), |n| n.parse().ok())?;
        Some(EnvFault { call, errno, first, name: parts.next().unwrap_or_default().to_string(), seen: AtomicU64::new(0) })
    }

    fn before(&self, call: &str, path: &Path) -> io::Result<()> {
        let meant = (self.call == "*" || self.call == call) && (self.name.is_empty() || path.to_string_lossy().contains(&self.name));
        if meant && self.seen.fetch_add(1, Ordering::Relaxed) + 1 >= self.first {
            return Err(io::Error::from_raw_os_error(self.errno));
        }
        Ok(())
    }
}

fn env_fault() -> Option<&'static EnvFault> {
    static FAULT: OnceLock<Option<EnvFault>> = OnceLock::new();
    FAULT.get_or_init(|| EnvFault::parse(&std::env::var("PRELIGHT_FAULT").ok()?)).as_ref()
}

/// Called at every step; an error stops the publish there.
pub type FaultHook = Arc<dyn Fn(FaultPoint) -> io::Result<()> + Send + Sync>;

#[derive(Clone, Default)]
pub(crate) struct Faults {
    hook: Option<FaultHook>,
    abort_at: Option<(Arc<str>, Arc<AtomicU64>)>,
}

impl Faults {
    pub fn set_hook(&mut self, hook: FaultHook) {
        self.hook = Some(hook);
    }

    /// With what the environment asks for.
    pub fn armed(self) -> Self {
        let abort_at = std::env::var("PRELIGHT_FAULT").ok().map(|text| {
            let (name, times) = text.split_once(':').unwrap_or((&text, "1"));
            (Arc::from(name), Arc::new(AtomicU64::new(times.parse().unwrap_or(1))))
        });
        Faults { abort_at, ..self }
    }

    pub fn pass(&self, point: FaultPoint) -> io::Result<()> {
        if let Some((name, left)) = &self.abort_at
            && **name == *point.name()
            && left.fetch_sub(1, Ordering::Relaxed) == 1
        {
            std::process::abort();
        }
        self.hook.as_ref().map_or(Ok(()), |hook| hook(point))
    }
}
