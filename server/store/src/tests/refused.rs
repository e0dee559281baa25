//! A refusal of the disk or the machine is no damage: nothing is set aside or rebuilt for it.
//!
//! Invariant: when the disk gives the files again, all is used as it was before.

use std::{
    fs,
    io::{self, Read},
    os::unix::fs::symlink,
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
    thread,
    time::{Duration, Instant},
};

use rustix::io::Errno;

use super::example::{Example, fill, options};
use crate::{
    MapId, Repair, Source, Store, Trouble,
    disk::{Disk, DiskFile, DiskReader, RealDisk},
};

/// The real disk, where reading files whose path contains some words fails.
#[derive(Default)]
struct RefusingDisk {
    refused: Mutex<Option<(PathBuf, Errno)>>,
}

impl RefusingDisk {
    fn check(&self, file: &Path) -> io::Result<()> {
        match &*self.refused.lock().expect("not poisoned") {
            Some((refused, error)) if file.ends_with(refused) => {
                Err(io::Error::from_raw_os_error(error.raw_os_error()))
            }
            _ => Ok(()),
        }
    }
}

impl Disk for RefusingDisk {
    fn create(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        RealDisk.create(file)
    }

    fn open(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        RealDisk.open(file)
    }

    fn read(&self, file: &Path) -> io::Result<Box<dyn Read + Send>> {
        self.check(file)?;
        RealDisk.read(file)
    }

    fn read_anywhere(&self, file: &Path) -> io::Result<Box<dyn DiskReader>> {
        self.check(file)?;
        RealDisk.read_anywhere(file)
    }

    fn length(&self, file: &Path) -> io::Result<u64> {
        RealDisk.length(file)
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<String>> {
        RealDisk.list(folder)
    }

    fn create_folder(&self, folder: &Path) -> io::Result<()> {
        RealDisk.create_folder(folder)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        RealDisk.rename(from, to)
    }

    fn remove(&self, file: &Path) -> io::Result<()> {
        RealDisk.remove(file)
    }

    fn remove_folder(&self, folder: &Path) -> io::Result<()> {
        RealDisk.remove_folder(folder)
    }

    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        RealDisk.sync_folder(folder)
    }
}

/// Names of all files of the maps.
fn names(directory: &Path) -> Vec<PathBuf> {
    let all = super::example::content(&directory.join("maps"));
    all.into_iter().map(|(path, _)| path.strip_prefix(directory).expect("below").to_owned()).collect()
}

fn example(directory: &Path) -> Example {
    fill(directory, 23, &[5, 10, 15], 64 << 20)
}

fn checkpoint(position: u64) -> PathBuf {
    Path::new("checkpoints").join(format!("{position:020}.tmc"))
}

#[test]
fn a_checkpoint_that_the_disk_refuses_stays_and_is_used_again() {
    for error in [Errno::IO, Errno::ACCESS, Errno::MFILE, Errno::NOMEM, Errno::STALE] {
        let directory = tempfile::tempdir().expect("temporary directory");
        let example = example(directory.path());
        let before = names(directory.path());
        let disk = Arc::new(RefusingDisk::default());
        *disk.refused.lock().expect("not poisoned") = Some((checkpoint(15), error));
        {
            let store = Store::open_on(Arc::clone(&disk) as Arc<dyn Disk>, directory.path(), options()).expect("opens");
            match store.open_map(MapId(1), &example.spec) {
                Ok(opened) => {
                    assert_eq!(opened.snapshot.as_ref(), Some(&example.snapshots[1]), "{error}");
                    let is_reported = |repair: &Repair| matches!(repair, Repair::CheckpointNotRead { .. });
                    assert!(opened.repairs.iter().any(is_reported), "{error}: {:?}", opened.repairs);
                    let is_trouble = |trouble: &Trouble| matches!(trouble, Trouble::Damaged { file, .. } if file.ends_with(checkpoint(15)));
                    assert!(store.trouble().iter().any(is_trouble), "{error}: {:?}", store.trouble());
                }
                // The refusal has another reason to check the machine before anything is opened.
                Err(refused) => assert!(refused.is_shortage(), "{error}: {refused}"),
            }
        }
        assert_eq!(names(directory.path()), before, "{error}");
        *disk.refused.lock().expect("not poisoned") = None;
        let opened = example.check(directory.path()).expect("opens");
        assert_eq!(
            (opened.source, opened.snapshot.as_ref()),
            (Source::Checkpoint, example.snapshots.last()),
            "{error}"
        );
    }
}

#[test]
fn a_map_whose_properties_the_disk_refuses_is_not_called_damaged() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = example(directory.path());
    let disk = Arc::new(RefusingDisk::default());
    for (error, stops) in [(Errno::IO, false), (Errno::ACCESS, false), (Errno::NFILE, true)] {
        *disk.refused.lock().expect("not poisoned") = Some((PathBuf::from("MAP"), error));
        match Store::open_on(Arc::clone(&disk) as Arc<dyn Disk>, directory.path(), options()) {
            Ok(store) => {
                let set_aside = store.set_aside().pop().expect("the map cannot be used");
                assert!(set_aside.reason.contains("may be sound") && !stops, "{error}: {}", set_aside.reason);
                assert!(!set_aside.reason.contains("backup"), "{error}: {}", set_aside.reason);
            }
            Err(refused) => assert!(stops && refused.is_shortage(), "{error}: {refused}"),
        }
    }
    example.check(directory.path()).expect("the map is as it was");
}

/// Waits until the index is open again.
fn recovered(store: &Store) -> Vec<Repair> {
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(60) {
        let repairs = store.recover_index();
        if repairs.contains(&Repair::IndexRecovered) {
            return repairs;
        }
        // The open database of sled may take a moment to end.
        thread::sleep(Duration::from_millis(50));
    }
    panic!("the index is not opened again: {:?}", store.trouble());
}

#[test]
fn an_index_that_a_full_disk_refuses_stays_and_is_opened_when_there_is_room() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = example(directory.path());
    let (index, kept) = (directory.path().join("index"), directory.path().join("kept"));
    // A file that is always full, in the place of the database.
    fs::rename(&index, &kept).expect("renamable");
    fs::create_dir(&index).expect("a folder");
    symlink("/dev/full", index.join("db")).expect("a link");
    let store = Store::open(directory.path(), options()).expect("opens");
    // The map is served from its checkpoint and its log.
    let opened = store.open_map(MapId(1), &example.spec).expect("opens");
    assert!(matches!(opened.repairs[..], [Repair::IndexUnavailable { .. }]), "{:?}", opened.repairs);
    let trouble = store.trouble();
    let is_full = matches!(&trouble[..], [Trouble::NoIndex(reason)] if reason.contains("No space left"));
    assert!(is_full, "{trouble:?}");
    assert!(!directory.path().join("index.damaged-1").exists(), "it is not damaged");
    assert_eq!((opened.source, opened.snapshot.as_ref()), (Source::Checkpoint, example.snapshots.last()));
    assert_eq!(store.recover_index(), [], "there is no room yet");

    fs::remove_dir_all(&index).expect("the link");
    fs::rename(&kept, &index).expect("renamable");
    assert_eq!(recovered(&store), [Repair::IndexRecovered], "it has all that it had");
    assert_eq!(store.trouble(), []);
    assert_eq!(store.published(MapId(1), &example.spec), example.snapshots.last().map(|newest| newest.published()));
    drop((opened, store));
    assert_eq!(example.check(directory.path()).expect("opens").repairs, []);
}

#[test]
fn an_index_that_cannot_be_made_is_made_when_there_is_room() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = example(directory.path());
    let index = directory.path().join("index");
    fs::remove_dir_all(&index).expect("removable");
    fs::create_dir(&index).expect("a folder");
    symlink("/dev/full", index.join("db")).expect("a link");
    let store = Store::open(directory.path(), options()).expect("opens");
    let opened = store.open_map(MapId(1), &example.spec).expect("opens");
    assert_eq!(opened.snapshot.as_ref(), example.snapshots.last());
    assert!(matches!(&store.trouble()[..], [Trouble::NoIndex(_)]), "{:?}", store.trouble());
    fs::remove_file(index.join("db")).expect("the link");
    let repairs = recovered(&store);
    assert!(matches!(repairs[..], [Repair::IndexRebuilt { .. }, Repair::IndexRecovered]), "{repairs:?}");
    assert_eq!(store.trouble(), []);
    assert_eq!(store.published(MapId(1), &example.spec), example.snapshots.last().map(|newest| newest.published()));
}
