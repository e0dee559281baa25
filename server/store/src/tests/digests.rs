//! The digest of a generation: what is in it, what is not, and that it does not depend on where things are held.

use std::sync::Arc;

use tidemap_grid::{
    index::TileId,
    snapshot::GridSnapshot,
    tile::{ModelSlot, SumsSlot, TileSums},
};
use tidemap_map::{event::Digest, site::Site, snapshot::MapSnapshot, spec::MapSpec};
use tidemap_model::PhasorSum;

use super::{
    example,
    grid_example::{snapshot, spec},
};
use crate::{MapId, Store, StoreOptions, digest};

const TILES: u32 = 40;

fn digest_of(snapshot: &MapSnapshot) -> Digest {
    digest(snapshot).expect("readable")
}

fn halves(digest: Digest) -> (u32, u32) {
    ((digest.0 >> 32) as u32, digest.0 as u32)
}

/// The grid, changed by `change`.
fn with_grid(snapshot: &MapSnapshot, change: impl FnOnce(&mut GridSnapshot)) -> MapSnapshot {
    let mut changed = snapshot.clone();
    change(changed.grid.as_mut().expect("a grid"));
    changed
}

/// The first tile with sums of changed cells, and these sums.
fn some_sums(grid: &GridSnapshot) -> (usize, TileSums) {
    let of_slot = |slot: &SumsSlot| TileSums::clone(&*slot.get().expect("in memory"));
    let mut all = grid.sums.iter().map(of_slot).enumerate();
    all.find(|(_, sums)| !sums.cells.is_empty() && !sums.groups.is_empty()).expect("some")
}

/// The sum with the last bit of one of its numbers changed.
fn one_bit_off(spec: &MapSpec, sum: &PhasorSum) -> PhasorSum {
    let mut parts = sum.as_slice().to_vec();
    parts[1] = f64::from_bits(parts[1].to_bits() ^ 1);
    PhasorSum::from_slice(&spec.periodicities, &parts).expect("finite")
}

#[test]
fn a_bit_anywhere_but_the_grid_changes_the_upper_half() {
    let before = snapshot(&spec("office"), 10, TILES);
    let (all_else, grid) = halves(digest_of(&before));
    assert!(grid != 0 && all_else != 0);
    let mut changed = vec![before.clone(); 7];
    changed[0].generation += 1;
    changed[1].cut_nanos += 1;
    changed[2].producers[0].durable_sequence += 1;
    changed[3].states.swap(0, 1);
    changed[4].states[0].observations += 1;
    changed[5].states[0].model = Arc::clone(&before.states[1].model);
    changed[6].site = Arc::new(Site::default());
    for (number, changed) in changed.iter().enumerate() {
        let (other, same) = halves(digest_of(changed));
        assert!(other != all_else && same == grid, "change {number}");
    }
    assert_eq!(halves(digest_of(&MapSnapshot { grid: None, ..before })), (all_else, 0));
}

#[test]
fn a_bit_of_the_grid_changes_the_lower_half() {
    let spec = spec("office");
    let before = snapshot(&spec, 10, TILES);
    let (all_else, grid) = halves(digest_of(&before));
    let (at, sums) = some_sums(before.grid.as_ref().expect("a grid"));
    let put = |sums: TileSums| with_grid(&before, |grid| grid.sums[at] = SumsSlot::Resident(Arc::new(sums)));
    let (mut of_cell, mut of_group) = (sums.clone(), sums.clone());
    of_cell.cells[0] = one_bit_off(&spec, &sums.cells[0]);
    of_group.groups[0] = Arc::new(one_bit_off(&spec, &sums.groups[0]));
    let without_model = |grid: &mut GridSnapshot| grid.models[at] = ModelSlot::default();
    let a_scan = |grid: &mut GridSnapshot| Arc::make_mut(&mut grid.tiles[3]).scans += 1;
    let changed = [
        put(of_cell),
        put(of_group),
        with_grid(&before, without_model),
        with_grid(&before, a_scan),
        with_grid(&before, |grid| grid.scans += 1),
        with_grid(&before, |grid| grid.last_seen = [TileId(1)].into()),
    ];
    for (number, changed) in changed.iter().enumerate() {
        let (same, other) = halves(digest_of(changed));
        assert!(same == all_else && other != grid, "change {number}");
    }
}

#[test]
fn what_waits_for_a_later_update_and_history_are_not_in_it() {
    let before = snapshot(&spec("office"), 10, TILES);
    assert!(before.grid.as_ref().is_some_and(|grid| !grid.days.is_empty()), "nothing waits");
    let mut later = with_grid(&before, |grid| {
        (grid.days, grid.future, grid.received_nanos) = (Vec::new(), Vec::new(), Some(77));
    });
    (later.replay_from, later.history) = (0, Vec::new());
    assert_eq!(digest_of(&later), digest_of(&before));
}

#[test]
fn sums_that_are_shared_in_memory_count_as_those_that_are_not() {
    let before = snapshot(&spec("office"), 10, TILES);
    let apart = with_grid(&before, |grid| {
        for slot in &mut grid.sums {
            let mut sums = TileSums::clone(&*slot.get().expect("in memory"));
            sums.groups.iter_mut().for_each(|group| *group = Arc::new(PhasorSum::clone(group)));
            *slot = SumsSlot::Resident(Arc::new(sums));
        }
    });
    assert_eq!(digest_of(&apart), digest_of(&before));
}

#[test]
fn a_snapshot_that_is_read_back_has_the_digest_that_it_was_saved_with() {
    let spec = spec("office");
    let before = snapshot(&spec, 0, TILES);
    for (tile_cache_bytes, spectrum_cache_bytes) in [(0, 0), (4_000, 9_000), (1 << 30, 1 << 30)] {
        let directory = tempfile::tempdir().expect("temporary directory");
        let options = || StoreOptions { tile_cache_bytes, spectrum_cache_bytes, ..example::options() };
        {
            let store = Store::open(directory.path(), options()).expect("opens");
            assert_eq!(store.create_map(&spec).expect("creates"), MapId(1));
            store.save(MapId(1), &before).expect("saves");
        }
        let store = Store::open(directory.path(), options()).expect("opens");
        let restored = store.open_map(MapId(1), &spec).expect("opens").snapshot.expect("saved");
        assert_eq!(digest_of(&restored), digest_of(&before), "{tile_cache_bytes} bytes");
    }
}

#[test]
fn a_digest_is_written_in_sixteen_hexadecimal_digits() {
    assert_eq!(Digest(0xA_0000_002B).to_string(), "0000000a0000002b");
}
