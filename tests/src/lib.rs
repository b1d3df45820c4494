//! Scenes and paths that the tests of this package share.

pub mod corpus;
pub mod forge;
pub mod fuzzed;
pub mod imports;
pub mod mutate;
pub mod recipe;

use prelight_bake::bake::{Baked, bake};
use prelight_bake::options::BakeOptions;
use prelight_bake::progress::Silent;
pub use prelight_chart::stability::scenes::{cuboid, options, quad, scene, sphere, still_life};
use prelight_runtime::asset::Asset;
use prelight_scene::Scene;
use prelight_store::Store;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Real input beside the repository, where it is there; says loudly when it is not.
pub fn shared(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared").join(name);
    if !path.exists() {
        eprintln!("SKIPPED: {name} is not beside the repository");
    }
    path.exists().then_some(path)
}

/// Bakes into a store, silently.
pub fn bake_into(scene: &Scene, options: &BakeOptions, store: &Path) -> Baked {
    let store = Store::open_or_create(store).expect("a fresh folder");
    bake(scene, options, &store, &Silent).expect("nothing is wrong with the scene")
}

/// Bakes at an edge length and opens what was baked. The folder may go once this returns: its files are mapped.
pub fn baked_asset(scene: &Scene, edge_length: f32) -> Arc<Asset> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let baked = bake_into(scene, &options(scene, edge_length), folder.path());
    let store = Store::open(folder.path()).expect("just written");
    let manifest = baked.seal(Default::default(), &store).expect("room on the disk");
    Arc::new(Asset::open(manifest, &store).expect("just sealed"))
}
