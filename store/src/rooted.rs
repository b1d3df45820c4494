//! A rooted path lies inside a folder that the store works in, and knows where that folder ends.
//!
//! The folder itself (the store's root, or the folder beside which a pack is written) was chosen by a person and may be a link. Nothing below
//! it may: [`crate::os`] goes from the root down one real folder after the other, and fails at the first thing that is none. All
//! paths in a store are of this kind, so none of its calls to the system can leave the folder.

use std::ffi::OsStr;
use std::io::{Error, ErrorKind};
use std::ops::Deref;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

/// A path below a root. Reads as the whole path where one is shown.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct RootedPath {
    root: Arc<Path>,
    path: PathBuf,
}

impl RootedPath {
    /// The root itself.
    pub fn root(path: &Path) -> Self {
        RootedPath { root: path.into(), path: path.to_path_buf() }
    }

    /// A file that a person named, in its folder.
    pub fn given(path: &Path) -> Self {
        let folder = path.parent().unwrap_or(Path::new(""));
        RootedPath { root: folder.into(), path: path.to_path_buf() }
    }

    /// A name below this one.
    pub fn join(&self, name: impl AsRef<Path>) -> Self {
        RootedPath { root: self.root.clone(), path: self.path.join(name) }
    }

    /// Another name in the same folder.
    pub fn sibling(&self, name: &str) -> Self {
        RootedPath { root: self.root.clone(), path: self.path.with_file_name(name) }
    }

    /// The folder that holds it; `None` for the root.
    pub fn parent(&self) -> Option<Self> {
        let path = self.path.parent().filter(|_| !self.is_root())?;
        Some(RootedPath { root: self.root.clone(), path: path.to_path_buf() })
    }

    pub fn is_root(&self) -> bool {
        self.path == *self.root
    }

    /// The root as the system takes it: an empty path is the current folder.
    pub fn root_path(&self) -> &Path {
        if self.root.as_os_str().is_empty() { Path::new(".") } else { &self.root }
    }

    /// The names from the root down to it.
    ///
    /// # Errors
    /// When one of them is no name (`..`, or a path from the top).
    pub fn names(&self) -> Result<Vec<&OsStr>, Error> {
        let outside = || Error::new(ErrorKind::InvalidInput, "the path leaves the folder");
        let below = self.path.strip_prefix(&self.root).map_err(|_| outside())?;
        let name = |component| if let Component::Normal(name) = component { Ok(name) } else { Err(outside()) };
        below.components().map(name).collect()
    }
}

impl Deref for RootedPath {
    type Target = Path;

    fn deref(&self) -> &Path {
        &self.path
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rooted_path_never_leaves_its_root() {
        let root = RootedPath::root(Path::new("a/store"));
        assert!(root.is_root() && root.parent().is_none() && root.names().unwrap().is_empty());
        assert_eq!(root.join("packs").join("x.pack").names().unwrap(), ["packs", "x.pack"]);
        for name in ["../x", "packs/../../x", "/etc/passwd", ".."] {
            assert!(root.join(name).names().is_err(), "{name}");
        }
        assert_eq!(RootedPath::given(Path::new("room.prelight")).names().unwrap(), ["room.prelight"]);
        assert_eq!(RootedPath::given(Path::new("room.prelight")).root_path(), Path::new("."));
    }
}
