//! The store that a verb works on.

use super::{Context, Failure};
use prelight_store::Store;
use std::path::{Path, PathBuf};

/// `--store`, else `.prelight` in the current folder.
pub fn store_folder(context: &Context) -> PathBuf {
    context.store.clone().unwrap_or_else(|| Path::new(".prelight").to_path_buf())
}

/// Opens it; what is wrong with its files is said as warnings.
pub fn open_store(context: &Context) -> Result<Store, Failure> {
    let store = Store::open(store_folder(context))?;
    store.problems().iter().for_each(|problem| context.progress().warning(problem));
    Ok(store)
}
