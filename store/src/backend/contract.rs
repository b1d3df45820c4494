//! What every backend promises, said once and held against each.

use super::{Backend, Folder, InMemory, is_file};
use crate::StoreError;
use std::collections::BTreeSet;
use std::sync::Arc;

/// Runs a claim over every backend, each new and empty.
fn check(claim: impl Fn(&dyn Backend)) {
    let dir = tempfile::tempdir().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let backends: [Arc<dyn Backend>; 3] =
        [Arc::new(Folder::new(dir.path(), true)), Arc::new(Folder::new(folder.path(), false)), Arc::new(InMemory::default())];
    for backend in backends {
        backend.make().unwrap();
        claim(&*backend);
    }
}

#[test]
fn a_saved_name_has_its_bytes_whole_and_in_parts() {
    check(|backend| {
        let bytes: Vec<u8> = (0..200).collect();
        backend.save("bad/x.txt", &bytes).unwrap();
        assert_eq!(backend.load("bad/x.txt", 200).unwrap(), Some(bytes.clone()));
        let mut blob = backend.open("bad/x.txt").unwrap().unwrap();
        assert_eq!(blob.len(), 200);
        assert_eq!(blob.read(64..200).unwrap().unwrap().as_ref(), &bytes[64..]);
        let mut part = [0; 10];
        assert!(blob.read_at(190, &mut part).unwrap() && part == bytes[190..]);
        for start in [191, 200, 201, u64::MAX] {
            assert!(!blob.read_at(start, &mut part).unwrap(), "{start}");
        }
        assert!(blob.read(1..201).unwrap().is_none() && blob.read(0..u64::MAX).unwrap().is_none());
        assert_eq!(backend.look("bad/x.txt").unwrap().unwrap().len(), 200);
        assert!(is_file(backend, "bad/x.txt").unwrap());
        backend.save("bad/x.txt", b"other").unwrap();
        assert_eq!(backend.load("bad/x.txt", 200).unwrap().unwrap(), b"other");
    });
}

#[test]
fn what_was_opened_stays_when_its_name_gets_other_bytes_or_goes() {
    check(|backend| {
        backend.save("packs/a", &[7; 100]).unwrap();
        let (mut blob, map) = (backend.open("packs/a").unwrap().unwrap(), backend.map("packs/a"));
        backend.save("packs/a", &[8; 50]).unwrap();
        assert!(backend.remove("packs/a").unwrap() && !backend.remove("packs/a").unwrap());
        assert_eq!(blob.read(0..100).unwrap().unwrap().as_ref(), [7; 100]);
        assert!(map.is_none_or(|map| (*map).as_ref() == [7; 100]));
    });
}

#[test]
fn a_name_that_nothing_has_is_none_and_no_error() {
    check(|backend| {
        assert!(backend.open("packs/a").unwrap().is_none() && backend.map("packs/a").is_none());
        assert!(backend.load("packs/a", 10).unwrap().is_none() && backend.look("packs/a").unwrap().is_none());
        assert!(!is_file(backend, "packs/a").unwrap() && !backend.remove("packs/a").unwrap());
        assert!(backend.list("packs").unwrap().is_empty() && backend.list("nowhere").unwrap().is_empty());
    });
}

#[test]
fn a_file_longer_than_its_bound_is_damaged() {
    check(|backend| {
        backend.save("roots/a", &[1; 11]).unwrap();
        assert!(backend.load("roots/a", 11).unwrap().is_some());
        assert!(matches!(backend.load("roots/a", 10), Err(StoreError::Damaged { .. })));
    });
}

#[test]
fn the_first_of_several_that_make_a_name_counts() {
    check(|backend| {
        backend.save_new("store.json", b"one").unwrap();
        backend.save_new("store.json", b"two").unwrap();
        assert_eq!(backend.load("store.json", 10).unwrap().unwrap(), b"one");
    });
}

#[test]
fn names_are_listed_by_folder_in_order_and_objects_below_their_folders() {
    check(|backend| {
        for name in ["packs/b", "packs/a", "objects/ab/x", "objects/aa/y", "roots/r"] {
            backend.save(name, b"").unwrap();
        }
        assert_eq!(backend.list("packs").unwrap(), ["packs/a", "packs/b"]);
        assert_eq!(backend.list("objects").unwrap(), ["objects/aa/y", "objects/ab/x"]);
        assert_eq!(backend.list_anything("roots").unwrap(), ["roots/r"]);
        backend.move_aside("packs/a", "bad/a.object").unwrap();
        assert_eq!(backend.list("packs").unwrap(), ["packs/b"]);
        assert_eq!(backend.list("bad").unwrap(), ["bad/a.object"]);
    });
}

#[test]
fn what_is_staged_has_no_name_before_it_is_published_and_goes_with_its_stage() {
    check(|backend| {
        let folders = ["packs", "objects", "ledger", "roots"];
        let names = || folders.iter().flat_map(|folder| backend.list(folder).unwrap()).collect::<BTreeSet<_>>();
        let mut stage = backend.stage().unwrap();
        stage.write("segment", &[b"seg", b"ment"]).unwrap();
        stage.sync_last().unwrap();
        let mut pack = stage.append("pack").unwrap();
        pack.write(b"one ").unwrap();
        pack.write(b"two").unwrap();
        pack.flush().unwrap();
        stage.sync(&["pack".to_string(), "segment".to_string()]).unwrap();
        assert!(names().is_empty());
        stage.publish("pack", "objects/ab/x").unwrap();
        assert_eq!(names(), BTreeSet::from(["objects/ab/x".to_string()]));
        backend.sync_folders(&BTreeSet::from(["objects/ab".to_string()])).unwrap();
        drop((pack, stage));
        assert_eq!(backend.load("objects/ab/x", 10).unwrap().unwrap(), b"one two");
        assert_eq!(names().len(), 1);
    });
}

#[test]
fn a_published_file_takes_the_place_of_one_of_its_name() {
    check(|backend| {
        for bytes in [b"one", b"two"] {
            let mut stage = backend.stage().unwrap();
            stage.write("root", &[bytes]).unwrap();
            stage.publish("root", "roots/r").unwrap();
        }
        assert_eq!(backend.load("roots/r", 10).unwrap().unwrap(), b"two");
        assert!(backend.stage().unwrap().publish("root", "roots/r").is_err(), "nothing was staged");
    });
}
