//! The store that a verb works on.

use super::{Context, Failure};
use prelight_bake::BakeError;
use prelight_bake::progress::Stage;
use prelight_store::{CheckOptions, CheckReport, Store};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// `--store`, else `.prelight` in the current folder.
pub fn store_folder(context: &Context) -> PathBuf {
    context.store.clone().unwrap_or_else(|| Path::new(".prelight").to_path_buf())
}

/// Opens it; what is wrong with its files is said as warnings.
pub fn open_store(context: &Context) -> Result<Store, Failure> {
    let store = context.store_options().open(store_folder(context))?;
    store.problems().iter().for_each(|problem| context.progress().warning(problem));
    Ok(store)
}

/// Checks it to the end, with progress in bytes; stopped before, it is cancelled.
pub fn check_store(store: &Store, options: &CheckOptions, context: &Context) -> Result<CheckReport, Failure> {
    let stage = Stage::begin(context.progress(), "verify", None, "bytes");
    let told = AtomicU64::new(0);
    let report = store.check(options, &|bytes| {
        stage.advance(bytes.saturating_sub(told.fetch_max(bytes, Ordering::Relaxed)));
        !context.progress().is_cancelled()
    })?;
    if report.finished { Ok(report) } else { Err(BakeError::Cancelled.into()) }
}
