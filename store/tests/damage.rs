//! Damaged files: every flipped bit and every cut is noticed before a wrong byte is handed out, and putting the chunks again mends it.
#![cfg(feature = "fs")]

mod support;

use prelight_manifests::Descriptor;
use prelight_store::{ChunkSource, Mapping, Store, StoreError, StoreOptions};
use std::path::{Path, PathBuf};
use support::Shard;

const SEED: u64 = 11;

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() { files.extend(self::files(&path)) } else { files.push(path) }
    }
    files.sort();
    files
}

/// A store with one shard, and a way to bring back its files.
struct Patient {
    dir: tempfile::TempDir,
    shard: Shard,
    healthy: Vec<(PathBuf, Vec<u8>)>,
}

impl Patient {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let shard = Shard::new(SEED);
        shard.publish(&Store::open_or_create(dir.path()).unwrap()).unwrap();
        let healthy = files(dir.path()).into_iter().map(|path| (path.clone(), std::fs::read(path).unwrap())).collect();
        Patient { dir, shard, healthy }
    }

    /// Everything as it was, nothing besides.
    fn restore(&self) {
        for path in files(self.dir.path()) {
            std::fs::remove_file(path).unwrap();
        }
        self.healthy.iter().for_each(|(path, bytes)| std::fs::write(path, bytes).unwrap());
    }

    fn open(&self, mapping: Mapping) -> Store {
        StoreOptions::new().mapping(mapping).open(self.dir.path()).unwrap()
    }

    /// The damaged file, and which chunks of the shard it holds.
    fn file(&self, folder: &str, nth: usize) -> (&Path, &[u8]) {
        let below = self.dir.path().join(folder);
        let (path, bytes) = self.healthy.iter().filter(|(path, _)| path.starts_with(&below)).nth(nth).unwrap();
        (path, bytes)
    }

    /// No wrong byte comes out. Whether the damage was noticed: by an error for some chunk, or as a problem of the store.
    fn examine(&self, mapping: Mapping, what: &str) -> bool {
        let store = self.open(mapping);
        let mut noticed = !store.problems().is_empty();
        noticed |= store.lookup(&self.shard.key).unwrap() != Some(self.shard.record());
        for (descriptor, bytes) in self.shard.descriptors().iter().zip(&self.shard.payloads) {
            match store.chunk(descriptor) {
                Ok(chunk) => assert!(chunk[..] == bytes[..], "{what}: a wrong byte came out"),
                Err(StoreError::Corrupt { digest, .. } | StoreError::Missing { digest, .. }) => {
                    assert_eq!(digest, descriptor.digest, "{what}");
                    noticed = true;
                }
                Err(other) => panic!("{what}: {other}"),
            }
        }
        noticed
    }

    /// Publishing the shard again makes it whole, in this process and the next.
    fn heal(&self, what: &str) {
        let store = self.open(Mapping::Auto);
        self.shard.descriptors().iter().for_each(|descriptor| drop(store.chunk(descriptor))); // finds what is corrupt
        self.shard.publish(&store).unwrap();
        self.shard.assert_whole(&store);
        let reopened = self.open(Mapping::Auto);
        let known = reopened.problems();
        self.shard.assert_whole(&reopened);
        assert_eq!(reopened.problems(), known, "{what}: a place known to be corrupt was tried again");
        assert_eq!(reopened.stats().unwrap().bad_chunks, 0, "{what}");
    }
}

/// Positions in an object: every third of the header (unit tests flip them all), of the first and of the last bytes, some between.
fn positions(len: usize) -> impl Iterator<Item = usize> {
    (0..len).filter(move |&i| if i < 160 || i + 30 > len { i % 3 == 0 } else { i % (len / 30) == 0 })
}

#[test]
fn no_flipped_bit_of_an_object_lets_a_wrong_byte_out() {
    let patient = Patient::new();
    for nth in 0..2 {
        let (path, good) = patient.file("objects", nth);
        for (n, i) in positions(good.len()).enumerate() {
            let what = format!("{} byte {i}", path.display());
            let mut bytes = good.to_vec();
            bytes[i] ^= 1 << (n % 8);
            std::fs::write(path, &bytes).unwrap();
            let mapping = if n % 2 == 0 { Mapping::Auto } else { Mapping::Never };
            assert!(patient.examine(mapping, &what), "{what}: not noticed");
            assert!(!path.exists(), "{what}: a corrupt object is moved aside");
            if n % 16 == 0 {
                patient.heal(&what);
            }
            patient.restore();
        }
    }
}

#[test]
fn no_flipped_bit_of_a_pack_lets_a_wrong_byte_out() {
    let patient = Patient::new();
    let (path, good) = patient.file("packs", 0);
    let entries = prelight_store::pack::parse(good).unwrap();
    assert_eq!(entries.len(), 3);
    let is_padding = |i: usize| {
        let inside = entries.iter().any(|entry| entry.range().contains(&(i as u64)));
        !inside && (64..good.len() - 4 * 64).contains(&i)
    };
    for (n, i) in (0..good.len()).step_by(7).enumerate() {
        let what = format!("pack byte {i}");
        let mut bytes = good.to_vec();
        bytes[i] ^= 1 << (n % 8);
        std::fs::write(path, &bytes).unwrap();
        let mapping = if n % 2 == 0 { Mapping::Auto } else { Mapping::Never };
        // Zeros between chunks carry nothing; all else must be noticed.
        assert!(patient.examine(mapping, &what) || is_padding(i), "{what}: not noticed");
        assert!(path.exists(), "{what}: a pack with other chunks stays");
        if n % 16 == 0 {
            patient.heal(&what);
        }
        patient.restore();
    }
}

#[test]
fn cut_zeroed_and_lengthened_files_are_noticed_and_mended() {
    let patient = Patient::new();
    for (folder, nth) in [("objects", 0), ("objects", 1), ("packs", 0), ("ledger", 0)] {
        let (path, good) = patient.file(folder, nth);
        let lengths = [0, 1, 63, 64, 100, 128, 129, 200, good.len() / 2, good.len() - 64, good.len() - 1];
        let cuts = lengths.iter().filter(|&&len| len < good.len()).map(|&len| good[..len].to_vec());
        let longer = [good, &[0; 64]].concat();
        for bytes in cuts.chain([vec![0; good.len()], longer]) {
            let what = format!("{folder} {nth}, {} of {} bytes", bytes.len(), good.len());
            std::fs::write(path, &bytes).unwrap();
            assert!(patient.examine(Mapping::Auto, &what), "{what}: not noticed");
            patient.heal(&what);
            patient.restore();
            std::fs::write(path, &bytes).unwrap();
            assert!(patient.examine(Mapping::Never, &what), "{what}: not noticed");
            patient.restore();
        }
    }
}

#[test]
fn a_zero_length_object_is_replaced_by_put_without_having_been_read() {
    let patient = Patient::new();
    for nth in 0..2 {
        std::fs::write(patient.file("objects", nth).0, b"").unwrap();
    }
    let store = patient.open(Mapping::Auto);
    assert_eq!(store.lookup(&patient.shard.key).unwrap(), None, "an incomplete record is no hit");
    let report = patient.shard.publish(&store).unwrap();
    assert_eq!((report.chunks_new, report.chunks_reused), (2, 3));
    patient.shard.assert_whole(&store);
}

#[test]
fn swapped_and_foreign_contents_are_not_taken_for_a_chunk() {
    let patient = Patient::new();
    let ((first, first_bytes), (second, second_bytes)) = (patient.file("objects", 0), patient.file("objects", 1));
    std::fs::write(first, second_bytes).unwrap();
    std::fs::write(second, first_bytes).unwrap();
    assert!(patient.examine(Mapping::Auto, "swapped objects"));
    patient.heal("swapped objects");

    patient.restore();
    let pack = patient.file("packs", 0).0;
    for (folder, bytes) in [("packs/x.pack", first_bytes), ("ledger/x.segment", first_bytes), ("objects/zz", b"?")] {
        std::fs::write(patient.dir.path().join(folder), bytes).unwrap();
    }
    assert_eq!(patient.open(Mapping::Auto).problems().len(), 0, "no store writes such names");
    let name = prelight_store::digest_of(b"x");
    for file in [format!("packs/{name}.pack"), format!("ledger/{name}.segment")] {
        std::fs::write(patient.dir.path().join(file), first_bytes).unwrap();
    }
    let store = patient.open(Mapping::Auto);
    patient.shard.assert_whole(&store);
    assert_eq!(store.problems().len(), 2, "{:?}", store.problems());
    std::fs::remove_file(pack).unwrap();
    let small = &patient.shard.descriptors()[0];
    assert!(matches!(patient.open(Mapping::Auto).chunk(small), Err(StoreError::Missing { .. })));
}

#[test]
fn a_pack_that_vanishes_under_an_open_store_is_missing_and_not_corrupt() {
    let patient = Patient::new();
    let store = patient.open(Mapping::Never);
    std::fs::remove_file(patient.file("packs", 0).0).unwrap();
    let small = &patient.shard.descriptors()[0];
    assert!(matches!(store.chunk(small), Err(StoreError::Missing { .. })));
    assert_eq!(store.lookup(&patient.shard.key).unwrap(), None);
}

#[test]
fn a_wrong_length_in_a_descriptor_is_an_error_of_its_own_and_harms_nothing() {
    let patient = Patient::new();
    let store = patient.open(Mapping::Auto);
    for descriptor in patient.shard.descriptors() {
        for bytes in [0, descriptor.bytes - 1, descriptor.bytes + 1, u64::MAX] {
            let wrong = Descriptor { bytes, ..descriptor.clone() };
            assert!(matches!(store.chunk(&wrong), Err(StoreError::Size { .. })));
        }
    }
    patient.shard.assert_whole(&store);
}

#[test]
fn a_corrupt_chunk_is_reported_the_same_by_the_next_process() {
    let patient = Patient::new();
    let (path, good) = patient.file("packs", 0);
    let mut bytes = good.to_vec();
    let place = prelight_store::pack::parse(good).unwrap()[0];
    bytes[place.offset as usize + 130] ^= 4;
    std::fs::write(path, bytes).unwrap();
    let descriptor = patient.shard.descriptors().into_iter().find(|descriptor| descriptor.digest == place.digest).unwrap();
    let report = |store: &Store| match store.chunk(&descriptor) {
        Err(error @ StoreError::Corrupt { .. }) => error.to_string(),
        other => panic!("{other:?}"),
    };
    let first = report(&patient.open(Mapping::Auto));
    let name = path.file_name().unwrap().to_str().unwrap();
    assert!(first.contains(name) && first.contains(&format!("byte {}", place.offset)) && first.contains("help"), "{first}");
    let store = patient.open(Mapping::Auto);
    assert_eq!(report(&store), first);
    assert_eq!(store.lookup(&patient.shard.key).unwrap(), None, "a record with a chunk known to be corrupt is no hit");
}

#[cfg(unix)]
#[test]
fn a_store_that_cannot_be_written_can_be_read_and_says_so_on_put() {
    use std::os::unix::fs::PermissionsExt;
    let patient = Patient::new();
    let tmp = patient.dir.path().join("tmp");
    // A file in place of the folder refuses even the superuser, to whom modes mean nothing.
    std::fs::remove_dir(&tmp).unwrap();
    std::fs::write(&tmp, b"").unwrap();
    std::fs::set_permissions(patient.dir.path(), std::fs::Permissions::from_mode(0o555)).unwrap();
    let store = patient.open(Mapping::Auto);
    patient.shard.assert_whole(&store);
    let error = Shard::new(99).publish(&store).unwrap_err();
    assert!(matches!(error, StoreError::Foreign { .. } | StoreError::Permission { .. }), "{error}");
    std::fs::set_permissions(patient.dir.path(), std::fs::Permissions::from_mode(0o755)).unwrap();
}
