//! Input files, whole, within the memory limit.

use prelight_bake::BakeError;
use prelight_manifests::scene::EnvironmentEntry;
use prelight_manifests::{AssetManifest, ByteSize, ManifestError};
use prelight_runtime::asset::manifest_bytes;
use prelight_runtime::environment::{Environment, Limits, MapOptions};
use prelight_store::Budget;
use std::io::Read;
use std::path::Path;

/// Reads a file of at most `limit` bytes. A file that grows while it is read stops at the limit too.
pub fn read(path: &Path, limit: ByteSize) -> Result<Vec<u8>, BakeError> {
    let input = |source| BakeError::input(path, source);
    let file = std::fs::File::open(path).map_err(input)?;
    let metadata = file.metadata().map_err(input)?;
    if metadata.is_dir() {
        return Err(input(std::io::Error::from(std::io::ErrorKind::IsADirectory)));
    }
    let too_large = |needed: u64| BakeError::Memory { what: format!("reading {}", path.display()), needed, limit: limit.0 };
    if metadata.len() > limit.0 {
        return Err(too_large(metadata.len()));
    }
    let mut bytes = Vec::new();
    file.take(limit.0.saturating_add(1)).read_to_end(&mut bytes).map_err(input)?;
    if bytes.len() as u64 > limit.0 {
        return Err(too_large(bytes.len() as u64));
    }
    Ok(bytes)
}

/// Parses an asset manifest from a file's bytes, if there is memory for what they may become.
pub fn parse_asset(path: &Path, bytes: &[u8], budget: &Budget) -> Result<AssetManifest, BakeError> {
    let name = path.display().to_string();
    let needed = manifest_bytes(bytes);
    let refused = || BakeError::Memory { what: format!("the manifest {name}"), needed, limit: budget.left() };
    let _parsing = budget.charge(needed).ok_or_else(refused)?;
    let text = std::str::from_utf8(bytes).map_err(|_| BakeError::Unsupported {
        what: format!("{name} is not an asset: it is not UTF-8 text"),
        help: "name the .prelight.json file that `prelight bake` wrote".to_string(),
    })?;
    // Nobody writes an asset by hand, so what is expected in a field is no advice yet.
    AssetManifest::parse(&name, text).map_err(|error| match error {
        ManifestError::Range { .. } => {
            BakeError::Unsupported { what: error.to_string(), help: "this asset is damaged or was edited; bake again".to_string() }
        }
        error => error.into(),
    })
}

/// What scene.toml says of an environment's file.
pub fn map_options(entry: &EnvironmentEntry) -> MapOptions {
    MapOptions { projection: entry.projection, layer: entry.layer.clone() }
}

/// Reads and decodes an environment image, and keeps the file's name in front of what a person should know about it.
pub fn read_environment(path: &Path, options: &MapOptions, budget: &Budget) -> Result<(Environment, Vec<String>), BakeError> {
    let name = path.display().to_string();
    let bytes = read(path, ByteSize(budget.left()))?;
    // While it is decoded, the file is there as well.
    let _file = budget.charge(bytes.len() as u64);
    let limits = Limits::sharing(budget);
    let (environment, report) = Environment::decode_as(&name, &bytes, options, &limits)?;
    let warnings = report.warnings().into_iter().map(|warning| format!("{name}: {warning}")).collect();
    Ok((environment, warnings))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_over_the_limit_are_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        std::fs::write(&path, [1u8; 100]).unwrap();
        assert_eq!(read(&path, ByteSize(100)).unwrap().len(), 100);
        assert!(matches!(read(&path, ByteSize(99)), Err(BakeError::Memory { needed: 100, limit: 99, .. })));
        for missing in [folder.path().to_path_buf(), folder.path().join("b")] {
            assert!(matches!(read(&missing, ByteSize(1)), Err(BakeError::Input { .. })), "{}", missing.display());
        }
        if cfg!(target_os = "linux") {
            assert!(matches!(read(Path::new("/dev/zero"), ByteSize(5)), Err(BakeError::Memory { .. })), "an endless file ends");
        }
    }
}
