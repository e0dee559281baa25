//! The file of an update on a disk that is full, fails or loses power: what is found was noted, and the update goes on.

use std::{io::ErrorKind, path::Path, sync::Arc};

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};
use tidemap_map::{
    grid::progress::{DoneTile, UpdateJournal as _},
    spec::MapSpec,
};

use super::disk::{Fault, SimulatedDisk};
use crate::{
    disk::Disk,
    tests::{
        grid_example::spec,
        update_file::{IDENTITY, done, newest, note, open},
    },
};

const FOLDER: &str = "/checkpoints";

fn new_disk(seed: u64) -> SimulatedDisk {
    let disk = SimulatedDisk::new(SmallRng::seed_from_u64(seed));
    disk.create_folder(Path::new(FOLDER)).expect("created");
    disk.sync_folder(Path::new("/")).expect("synced");
    disk
}

fn as_dyn(disk: &SimulatedDisk) -> Arc<dyn Disk> {
    Arc::new(disk.clone())
}

fn found(disk: &SimulatedDisk, spec: &MapSpec) -> Vec<DoneTile> {
    let mut tiles = open(&as_dyn(disk), Path::new(FOLDER), spec, &IDENTITY).resume();
    tiles.sort_by_key(|tile| tile.tile);
    tiles
}

/// What may be found of these notes: the newest of those up to any of them.
fn is_a_beginning(found: &[DoneTile], notes: &[DoneTile]) -> bool {
    (0..=notes.len()).any(|count| newest(&notes[..count]) == found)
}

/// Notes tiles by two runs, the second of which goes on where the first was killed. Gives the notes.
fn run(disk: &SimulatedDisk, spec: &MapSpec) -> Vec<DoneTile> {
    let mut notes = Vec::new();
    for of_run in 0..2 {
        let file = open(&as_dyn(disk), Path::new(FOLDER), spec, &IDENTITY);
        for day in 0..3 {
            let tiles: Vec<DoneTile> = (0..3).map(|tile| done(tile, of_run * 3 + day, spec, &[])).collect();
            note(&file, &tiles);
            notes.extend(tiles);
        }
    }
    notes
}

#[test]
fn a_full_or_failing_disk_at_any_call_costs_the_file_and_nothing_else() {
    let spec = spec("office");
    let disk = new_disk(1);
    let start = disk.calls();
    let notes = run(&disk, &spec);
    let calls = disk.calls() - start;
    assert_eq!(found(&disk, &spec), newest(&notes));
    assert!(calls >= 7, "{calls}");
    for kind in [ErrorKind::StorageFull, ErrorKind::Other] {
        for (call, is_sticky) in (0..calls).flat_map(|call| [(call, false), (call, true)]) {
            let disk = new_disk(call as u64);
            disk.set_fault(Some(Fault { call: call + disk.calls(), kind, is_sticky }));
            let notes = run(&disk, &spec);
            disk.set_fault(None);
            if kind == ErrorKind::StorageFull && is_sticky {
                assert_eq!(disk.list(Path::new(FOLDER)).expect("there"), [""; 0], "call {call}: space is free again");
            }
            // The second run may have begun anew.
            let found = found(&disk, &spec);
            let is_right = is_a_beginning(&found, &notes) || is_a_beginning(&found, &notes[9..]);
            assert!(is_right, "{kind:?}, call {call}, sticky: {is_sticky}");
        }
    }
}

#[test]
fn what_a_power_cut_leaves_is_what_was_noted_up_to_somewhere() {
    let spec = spec("office");
    let mut found_some = 0;
    for seed in 0..300 {
        let disk = new_disk(seed);
        let mut random = SmallRng::seed_from_u64(seed);
        let notes = run(&disk, &spec);
        if random.random() {
            // The name and some of the bytes were written by chance.
            disk.sync_folder(Path::new(FOLDER)).expect("synced");
        }
        let disk = disk.power_cut();
        let found = found(&disk, &spec);
        assert!(is_a_beginning(&found, &notes), "seed {seed}");
        found_some += usize::from(!found.is_empty());
    }
    assert!(found_some > 20, "too little was found: {found_some}");
}
