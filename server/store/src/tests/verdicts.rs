//! A start takes every directory that a check finds sound, and the other way round, whatever is wrong with one file.

use std::{
    fs,
    path::{Path, PathBuf},
};

use tidemap_map::spec::MapSpec;

use super::{
    example::{content, copy, options},
    grid_example::spec,
    missing::with_history,
};
use crate::{Mode, Repair, Store, check};

#[derive(Clone, Copy, Debug)]
enum Harm {
    Cut,
    Emptied,
    Zeroed,
    ZeroedEnd,
    Flipped,
    Missing,
}

const HARMS: [Harm; 6] = [Harm::Cut, Harm::Emptied, Harm::Zeroed, Harm::ZeroedEnd, Harm::Flipped, Harm::Missing];

fn harm(how: Harm, file: &Path) {
    let mut bytes = fs::read(file).expect("readable");
    let half = bytes.len() / 2;
    match how {
        Harm::Cut => bytes.truncate(half),
        Harm::Emptied => bytes.clear(),
        Harm::Zeroed => bytes.fill(0),
        Harm::ZeroedEnd => bytes[half..].fill(0),
        Harm::Flipped => bytes[half] ^= 0x10,
        Harm::Missing => return fs::remove_file(file).expect("removable"),
    }
    fs::write(file, bytes).expect("writable");
}

/// Whether a repair is of something that a kill leaves as well, which is no damage.
fn is_of_a_kill(repair: &Repair) -> bool {
    match repair {
        Repair::TornTail { zero_bytes, .. } => *zero_bytes == 0,
        Repair::LeftoverRemoved { .. } => true,
        Repair::IndexRebuilt { reason, .. } => reason.contains("was being written") || reason.contains("older"),
        _ => false,
    }
}

/// The finding of a start, and of the first round in which it reads its files; `None`: nothing.
fn start_finds(directory: &Path, spec: &MapSpec) -> Option<String> {
    let store = match Store::open(directory, options()) {
        Ok(store) => store,
        Err(error) => return Some(error.to_string()),
    };
    if let Some(map) = store.set_aside().pop() {
        return Some(map.reason);
    }
    if let Err(error) = store.losses() {
        return Some(error.to_string());
    }
    let mut repairs = store.repairs().to_vec();
    for (map, known) in store.maps() {
        assert_eq!(known, *spec, "another map");
        let opened = match store.open_map(map, &known) {
            Ok(opened) => opened,
            Err(error) => return Some(error.to_string()),
        };
        repairs.extend(opened.repairs);
        if let Some(error) = opened.replay.into_iter().find_map(Result::err) {
            return Some(error.to_string());
        }
    }
    if let Some(repair) = repairs.iter().find(|repair| !is_of_a_kill(repair)) {
        return Some(repair.to_string());
    }
    store.scrub(&mut |_| true).expect("a whole round");
    store.trouble().first().map(ToString::to_string)
}

fn check_finds(directory: &Path) -> Option<String> {
    match check(directory, Mode::Look) {
        Ok(checked) => {
            checked.findings.first().map(|finding| format!("{}: {}", finding.file.display(), finding.problem))
        }
        Err(error) => Some(error.to_string()),
    }
}

fn files(directory: &Path) -> Vec<PathBuf> {
    let all = content(directory).into_iter().filter(|(_, bytes)| bytes.as_ref().is_some_and(|bytes| !bytes.is_empty()));
    let all = all.map(|(path, _)| path.strip_prefix(directory).expect("below").to_owned());
    // Nobody needs the lock's file, which a start makes.
    all.filter(|file| !file.ends_with("LOCK")).collect()
}

#[test]
fn a_check_and_a_start_agree_on_every_file_that_is_harmed() {
    let work = tempfile::tempdir().expect("temporary directory");
    let data = work.path().join("data");
    let spec = spec("office");
    drop(with_history(&data, &spec));
    let (checked, started) = (work.path().join("checked"), work.path().join("started"));
    copy(&data, &checked);
    assert_eq!(check_finds(&checked), None);
    assert_eq!(start_finds(&checked, &spec), None);
    let (mut found, mut disagreements) = (0, Vec::new());
    for file in files(&data) {
        for how in HARMS {
            for folder in [&checked, &started] {
                let _ = fs::remove_dir_all(folder);
                copy(&data, folder);
                harm(how, &folder.join(&file));
            }
            let (by_check, by_start) = (check_finds(&checked), start_finds(&started, &spec));
            found += usize::from(by_check.is_some());
            if by_check.is_some() != by_start.is_some() {
                disagreements.push(format!("{} {how:?}: check {by_check:?}, start {by_start:?}", file.display()));
            }
        }
    }
    assert!(disagreements.is_empty(), "{}", disagreements.join("\n"));
    assert!(found > 50, "too little was found: {found}");
}

#[test]
fn a_check_reads_what_was_set_aside_and_the_count_of_erasures_and_changes_nothing() {
    let work = tempfile::tempdir().expect("temporary directory");
    let (data, spec) = (work.path().join("data"), spec("office"));
    drop(with_history(&data, &spec));
    let map = data.join("maps/00000001");
    let segment = fs::read_dir(map.join("log")).expect("readable").find_map(|entry| {
        let path = entry.expect("readable").path();
        path.extension().is_some_and(|extension| extension == "log").then_some(path)
    });
    fs::create_dir(map.join("forks")).expect("writable");
    let fork = map.join("forks/00000000000000000001-1.log");
    fs::copy(segment.expect("a segment"), &fork).expect("copied");
    assert_eq!(check_finds(&data), None, "a sound fork");
    harm(Harm::Flipped, &fork);
    fs::write(map.join("ERASURES"), "often").expect("writable");
    // Whenever sled opens an index, it writes a new snapshot of its own state.
    let kept = |data: &Path| {
        let is_snapshot =
            |path: &Path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("snap."));
        content(data).into_iter().filter(|(path, _)| !is_snapshot(path)).collect::<Vec<_>>()
    };
    let before = kept(&data);
    let found = check(&data, Mode::Look).expect("checked").findings;
    let files: Vec<String> = found.iter().map(|finding| finding.file.display().to_string()).collect();
    assert_eq!(files, ["maps/00000001/forks/00000000000000000001-1.log", "maps/00000001/ERASURES"], "{found:?}");
    assert!(kept(&data) == before, "a check changes nothing");
}
