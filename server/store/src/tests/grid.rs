//! Maps with a grid: their checkpoints, shared sums, and tiles that are not in memory.

use std::{collections::HashSet, fs, path::Path, sync::Arc};

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};
use tidemap_grid::{
    index::TileId,
    mask::Mask,
    snapshot::GridSnapshot,
    tile::{CellModel, ColdTile, Group, ModelSlot, SumsSlot, TileModel, TileSource, TileSums, TileUnavailable},
};
use tidemap_map::{snapshot::MapSnapshot, spec::MapSpec};
use tidemap_model::{OrderErrors, OrderWatch, Periodicities, PhasorSum, SpectralModel};

use super::{
    example::{self, append, event},
    grid_example::{DAY_NANOS, snapshot, spec, sum},
    is_full,
};
use crate::{MapId, OpenedMap, Repair, Source, Store, StoreError, StoreOptions};

const MAP: MapId = MapId(1);

fn options(tile_cache_bytes: u64, checkpoints_kept: usize) -> StoreOptions {
    StoreOptions { tile_cache_bytes, checkpoints_kept, ..example::options() }
}

/// A directory with the map, its log up to `end`, and these snapshots.
fn fill(directory: &Path, spec: &MapSpec, snapshots: &[MapSnapshot]) {
    let store = Store::open(directory, example::options()).expect("opens");
    assert_eq!(store.create_map(spec).expect("creates"), MAP);
    let opened = store.open_map(MAP, spec).expect("opens");
    assert_eq!(opened.source, Source::Empty);
    for position in 1..=20 {
        append(&opened.log, &event(position)).expect("appends");
    }
    for snapshot in snapshots {
        assert!(store.save(MAP, snapshot).expect("saves").is_some());
    }
}

fn reopen(directory: &Path, spec: &MapSpec, options: StoreOptions) -> (Store, OpenedMap) {
    let store = Store::open(directory, options).expect("opens");
    assert_eq!(store.maps(), [(MAP, spec.clone())]);
    let opened = store.open_map(MAP, spec).expect("opens");
    (store, opened)
}

fn grid_of(snapshot: &MapSnapshot) -> &GridSnapshot {
    snapshot.grid.as_ref().expect("has a grid")
}

/// Number of tiles in memory, and number of different sums that their groups have.
fn resident(grid: &GridSnapshot) -> (usize, usize) {
    let sums: Vec<&Arc<TileSums>> = grid
        .sums
        .iter()
        .filter_map(|slot| if let SumsSlot::Resident(sums) = slot { Some(sums) } else { None })
        .collect();
    let shared: HashSet<_> = sums.iter().flat_map(|sums| &sums.groups).map(Arc::as_ptr).collect();
    let models = grid.models.iter().filter(|slot| matches!(slot, ModelSlot::Resident(_))).count();
    assert_eq!(models, sums.len());
    (models, shared.len())
}

#[test]
fn a_grid_comes_back_with_what_its_tiles_share() {
    for seed in 5..=20 {
        let directory = tempfile::tempdir().expect("temporary directory");
        let spec = spec("office");
        let saved = snapshot(&spec, seed, 1 + seed as u32 % 7);
        fill(directory.path(), &spec, std::slice::from_ref(&saved));
        let (_store, opened) = reopen(directory.path(), &spec, options(1 << 30, 2));
        assert_eq!((opened.source, opened.repairs), (Source::Checkpoint, vec![]));
        let found = opened.snapshot.expect("saved");
        assert_eq!(found, saved);
        assert_eq!(resident(grid_of(&found)), resident(grid_of(&saved)), "seed {seed}");
    }
}

#[test]
fn a_tile_whose_sums_are_longer_than_a_record_comes_back() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let periodicities = Periodicities::harmonics(DAY_NANOS, 2048).expect("valid");
    let spec = MapSpec { periodicities, ..spec("office") };
    let mut random = SmallRng::seed_from_u64(1);
    let mut saved = snapshot(&spec, 10, 1);
    let cell = |cell| CellModel {
        cell,
        occupied: 1,
        spectral: SpectralModel::default(),
        order: 0,
        errors: OrderErrors::default(),
        alarm_day: None,
    };
    let group = Group { cells: Mask::FULL, observations: 2, first_nanos: 0, last_nanos: 1, ..Group::default() };
    let model = TileModel {
        groups: vec![group],
        always_occupied: Mask::EMPTY,
        cells: (0..70).map(cell).collect(),
        sensors: None,
    };
    let sums = TileSums {
        groups: vec![Arc::new(sum(&spec, &mut random))],
        cells: (0..70).map(|_| sum(&spec, &mut random)).collect(),
        times: vec![Arc::default()],
        watches: vec![OrderWatch::default(); 70],
        ..TileSums::default()
    };
    let grid = saved.grid.as_mut().expect("has a grid");
    grid.models = vec![ModelSlot::Resident(Arc::new(model))];
    grid.sums = vec![SumsSlot::Resident(Arc::new(sums))];
    fill(directory.path(), &spec, std::slice::from_ref(&saved));
    for bytes in [0, 1 << 30] {
        let (_store, opened) = reopen(directory.path(), &spec, options(bytes, 2));
        assert_eq!(opened.snapshot.as_ref(), Some(&saved));
    }
}

#[test]
fn the_index_has_what_a_grid_publishes_and_is_built_again_where_it_is_lost() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let spec = spec("office");
    let saved = [snapshot(&spec, 10, 3), snapshot(&spec, 15, 4)];
    fill(directory.path(), &spec, &saved);
    let newest = saved[1].published();
    for bytes in [1 << 30, 0] {
        let store = Store::open(directory.path(), options(bytes, 2)).expect("opens");
        assert_eq!(store.published(MapId(1), &spec).as_ref(), Some(&newest), "before the map is open");
    }
    fs::remove_dir_all(directory.path().join("index")).expect("removable");
    let (store, opened) = reopen(directory.path(), &spec, options(0, 2));
    assert_eq!((opened.source, opened.snapshot.as_ref()), (Source::Checkpoint, saved.last()));
    assert!(matches!(opened.repairs[..], [Repair::IndexRebuilt { .. }]), "{:?}", opened.repairs);
    assert_eq!(store.published(MapId(1), &spec).as_ref(), Some(&newest), "from tiles that are not in memory");
    drop((store, opened));
    let (store, opened) = reopen(directory.path(), &spec, options(1 << 30, 2));
    assert_eq!(opened.repairs, []);
    // A tile of the generation before is not given out as one of this.
    let before = store.published(MapId(1), &spec).expect("whole");
    store.save(MapId(1), &snapshot(&spec, 20, 5)).expect("saves");
    assert_eq!(store.published(MapId(1), &spec), Some(snapshot(&spec, 20, 5).published()));
    let tiles = &before.grid.expect("has a grid").models;
    assert!(tiles.iter().all(|tile| tile.get().is_err()));
}

#[test]
fn each_save_leaves_the_rows_of_its_generation() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let spec = spec("office");
    let store = Store::open(directory.path(), options(1 << 30, 2)).expect("opens");
    let map = store.create_map(&spec).expect("creates");
    let mut opened = Some(store.open_map(map, &spec).expect("opens"));
    let mut random = SmallRng::seed_from_u64(7);
    let mut store = Some(store);
    let mut tiles = 3;
    for position in 1..40_u64 {
        if random.random_bool(0.2) {
            (store, opened) = (None, None);
        }
        let open = store.get_or_insert_with(|| Store::open(directory.path(), options(1 << 30, 2)).expect("opens"));
        opened.get_or_insert_with(|| open.open_map(map, &spec).expect("opens"));
        // Sometimes fewer: then all rows are written again.
        tiles = (tiles + random.random_range(0..3_u32)).saturating_sub(random.random_range(0..3)).max(1);
        let mut saved = snapshot(&spec, 0, tiles);
        let mut other = snapshot(&spec, position, tiles);
        let (grid, others) = (saved.grid.as_mut().expect("a grid"), other.grid.take().expect("a grid"));
        for (tile, (model, sums)) in others.models.into_iter().zip(others.sums).enumerate() {
            if random.random_bool(0.3) {
                (grid.models[tile], grid.sums[tile]) = (model, sums);
            }
        }
        open.save(map, &saved).expect("saves");
        assert_eq!(open.published(map, &spec), Some(saved.published()), "{position}");
    }
}

#[test]
fn tiles_beyond_the_memory_allowed_are_read_where_they_are() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let spec = spec("office");
    let saved = snapshot(&spec, 15, 12);
    let (all, _) = resident(grid_of(&saved));
    fill(directory.path(), &spec, std::slice::from_ref(&saved));
    let mut before = all + 1;
    for bytes in [1 << 30, 40_000, 10_000, 1, 0] {
        let (_store, opened) = reopen(directory.path(), &spec, options(bytes, 2));
        let found = opened.snapshot.expect("saved");
        let (tiles, _) = resident(grid_of(&found));
        assert!(tiles <= before, "{bytes} bytes");
        before = tiles;
        assert_eq!(found, saved, "{bytes} bytes");
    }
    assert_eq!(before, 0);
}

#[test]
fn sums_read_at_the_same_time_are_shared() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let spec = spec("office");
    let saved = snapshot(&spec, 15, 12);
    fill(directory.path(), &spec, std::slice::from_ref(&saved));
    let (store, opened) = reopen(directory.path(), &spec, options(0, 2));
    let mut found = opened.snapshot.expect("saved");
    let grid = found.grid.as_mut().expect("has a grid");
    for slot in &mut grid.sums {
        *slot = SumsSlot::Resident(slot.get().expect("readable"));
    }
    for slot in &mut grid.models {
        *slot = ModelSlot::Resident(slot.get().expect("readable"));
    }
    assert_eq!(resident(grid), resident(grid_of(&saved)));
    // The tiles that a save returns share sums with those in memory.
    let source = store.save(MAP, &found).expect("saves").expect("a source");
    let grid = grid_of(&found);
    for (id, slot) in (0..).zip(&grid.sums) {
        let (cold, sums) = (source.sums(TileId(id)).expect("readable"), slot.get().expect("in memory"));
        assert_eq!(cold, sums);
        assert!(cold.groups.iter().zip(&sums.groups).all(|(one, other)| Arc::ptr_eq(one, other)));
        assert_eq!(source.model(TileId(id)), grid.models[id as usize].get());
    }
    assert_eq!(source.model(TileId(999)), Ok(Arc::default()));
    assert_eq!(source.sums(TileId(999)), Ok(Arc::default()));
}

#[test]
fn a_checkpoint_is_read_after_it_was_superseded() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let spec = spec("office");
    let saved = snapshot(&spec, 10, 9);
    fill(directory.path(), &spec, std::slice::from_ref(&saved));
    let (store, opened) = reopen(directory.path(), &spec, options(0, 1));
    let mut cold = opened.snapshot.expect("saved");
    // Copied from checkpoint to checkpoint, with some tiles changed in memory.
    for position in 11..15 {
        cold.position = position;
        let grid = cold.grid.as_mut().expect("has a grid");
        let changed = position as usize % 3;
        grid.models[changed] = ModelSlot::Resident(grid.models[changed].get().expect("readable"));
        grid.sums[changed] = SumsSlot::Resident(grid.sums[changed].get().expect("readable"));
        let source = store.save(MAP, &cold).expect("saves").expect("a source");
        for (id, (model, sums)) in (0..).zip(grid_of(&saved).models.iter().zip(&grid_of(&saved).sums)) {
            assert_eq!((source.model(TileId(id)), source.sums(TileId(id))), (model.get(), sums.get()));
        }
    }
    let names: Vec<_> = fs::read_dir(directory.path().join("maps/00000001/checkpoints"))
        .expect("readable")
        .map(|entry| entry.expect("entry").file_name())
        .collect();
    assert_eq!(names, ["00000000000000000014.tmc"], "what it was loaded from is gone");
    assert_eq!(cold.grid, saved.grid);
    drop((opened.log, opened.replay, store));
    let (_store, opened) = reopen(directory.path(), &spec, options(1 << 30, 1));
    let found = opened.snapshot.expect("saved");
    assert_eq!(found.grid, saved.grid);
    let distinct = |grid: &GridSnapshot| {
        let sums: HashSet<Vec<u64>> = grid
            .sums
            .iter()
            .flat_map(|slot| slot.get().expect("readable").groups.clone())
            .map(|sum| sum.as_slice().iter().map(|part| part.to_bits()).collect())
            .collect();
        sums.len()
    };
    assert_eq!(resident(grid_of(&found)).1, distinct(grid_of(&saved)), "copies are still shared");
}

/// A source of tiles outside the store.
#[derive(Debug)]
struct Foreign(Arc<TileModel>, Arc<TileSums>, bool);

impl TileSource for Foreign {
    fn model(&self, _: TileId) -> Result<Arc<TileModel>, TileUnavailable> {
        Ok(Arc::clone(&self.0))
    }

    fn sums(&self, tile: TileId) -> Result<Arc<TileSums>, TileUnavailable> {
        if self.2 { Err(TileUnavailable { tile, reason: "gone".to_owned() }) } else { Ok(Arc::clone(&self.1)) }
    }

    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}

#[test]
fn tiles_of_another_source_are_saved_or_the_save_fails() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let spec = spec("office");
    let saved = snapshot(&spec, 10, 4);
    fill(directory.path(), &spec, std::slice::from_ref(&saved));
    let (store, _opened) = reopen(directory.path(), &spec, options(0, 2));
    for is_gone in [true, false] {
        let mut foreign = saved.clone();
        foreign.position = 11;
        let grid = foreign.grid.as_mut().expect("has a grid");
        let (model, sums) = (grid.models[0].get().expect("there"), grid.sums[0].get().expect("there"));
        let source: Arc<dyn TileSource> = Arc::new(Foreign(model, sums, is_gone));
        grid.models[0] = ModelSlot::Cold(ColdTile { source: Arc::clone(&source), tile: TileId(0) });
        grid.sums[0] = SumsSlot::Cold(ColdTile { source, tile: TileId(0) });
        match store.save(MAP, &foreign) {
            Err(StoreError::InvalidSnapshot { reason, .. }) if is_gone => assert!(reason.contains("gone"), "{reason}"),
            Ok(Some(source)) if !is_gone => assert_eq!(source.sums(TileId(0)), grid_of(&saved).sums[0].get()),
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn a_snapshot_that_could_not_be_read_back_is_refused() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let spec = spec("office");
    fill(directory.path(), &spec, &[]);
    let (store, _opened) = reopen(directory.path(), &spec, options(0, 2));
    let good = snapshot(&spec, 10, 4);
    let other_periodicities = MapSpec { periodicities: Periodicities::harmonics(DAY_NANOS, 5).expect("valid"), ..spec };
    let mut random = SmallRng::seed_from_u64(1);
    let foreign: PhasorSum = sum(&other_periodicities, &mut random);
    type Change = fn(&mut GridSnapshot, PhasorSum);
    let wrong: [(&str, Change); 5] = [
        ("sums are missing", |grid, _| drop(grid.sums.pop())),
        ("more models than tiles", |grid, _| grid.tiles.truncate(1)),
        ("a sum of another length", |grid, sum| {
            let groups = vec![Arc::new(sum)];
            let times = vec![Arc::default()];
            grid.sums[0] = SumsSlot::Resident(Arc::new(TileSums { groups, times, ..TileSums::default() }));
        }),
        ("a model without sums", |grid, _| grid.sums[0] = SumsSlot::default()),
        ("a day out of order", |grid, _| {
            grid.days = vec![tidemap_grid::day::GridDay::new(tidemap_model::LocalDay(5)); 2];
        }),
    ];
    for (what, change) in wrong {
        let mut bad = good.clone();
        change(bad.grid.as_mut().expect("has a grid"), foreign.clone());
        let error = store.save(MAP, &bad).expect_err(what);
        assert!(
            matches!(error, StoreError::InvalidSnapshot { .. } | StoreError::NotReadBack { .. }),
            "{what}: {error}"
        );
    }
    let without = MapSnapshot { grid: None, ..good };
    assert!(matches!(store.save(MAP, &without), Err(StoreError::InvalidSnapshot { .. })));
    assert_eq!(fs::read_dir(directory.path().join("maps/00000001/checkpoints")).expect("there").count(), 0);
}

#[test]
fn every_damaged_byte_of_a_checkpoint_is_noticed() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let spec = spec("office");
    // The snapshot has at least one day and one scan in the future, so that there is a record of every kind.
    let with_all = |snapshot: &MapSnapshot| !grid_of(snapshot).days.is_empty() && !grid_of(snapshot).future.is_empty();
    let position = (5..).find(|&position| with_all(&snapshot(&spec, position, 3))).expect("there is one");
    let saved = [snapshot(&spec, 4, 2), snapshot(&spec, position, 3)];
    fill(directory.path(), &spec, &saved);
    let file = directory.path().join(format!("maps/00000001/checkpoints/{position:020}.tmc"));
    let good = fs::read(&file).expect("readable");
    let mut random = SmallRng::seed_from_u64(3);
    let (store, _opened) = reopen(directory.path(), &spec, options(0, 2));
    for byte in (0..good.len()).step_by(if is_full() { 7 } else { 41 }).chain(0..28) {
        let mut bad = good.clone();
        bad[byte] ^= 1 << random.random_range(0..8);
        fs::write(&file, &bad).expect("writable");
        let (found, damaged) = store.newest_checkpoint(MAP, &spec, if byte % 2 == 0 { 0 } else { 1 << 30 });
        assert_eq!((found.as_ref(), damaged), (Some(&saved[0]), 1), "byte {byte}");
    }
    drop(_opened);
    drop(store);
    let (_store, opened) = reopen(directory.path(), &spec, options(0, 2));
    assert_eq!(opened.snapshot.as_ref(), Some(&saved[0]));
    // The index is of the damaged one.
    let (aside, index) = (&opened.repairs[0], &opened.repairs[1..]);
    assert!(matches!(aside, Repair::CheckpointSetAside { .. }), "{:?}", opened.repairs);
    assert!(matches!(index, [Repair::IndexRebuilt { .. }]), "{:?}", opened.repairs);
}

#[test]
fn a_cold_tile_that_is_damaged_later_is_an_error_that_names_the_file() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let spec = spec("office");
    let saved = snapshot(&spec, 10, 6);
    fill(directory.path(), &spec, std::slice::from_ref(&saved));
    let (store, opened) = reopen(directory.path(), &spec, options(0, 2));
    let found = opened.snapshot.expect("saved");
    let file = directory.path().join("maps/00000001/checkpoints/00000000000000000010.tmc");
    let good = fs::read(&file).expect("readable");
    // The file is written in place, so that the open file is the damaged one.
    fs::write(&file, vec![0x5A; good.len()]).expect("writable");
    let error = grid_of(&found).models[0].get().expect_err("damaged");
    assert!(error.reason.contains("00000000000000000010.tmc"), "{error}");
    assert!(grid_of(&found).sums[0].get().is_err());
    let newer = MapSnapshot { position: 12, ..found };
    assert!(matches!(store.save(MAP, &newer), Err(StoreError::InvalidSnapshot { .. })));
    fs::write(&file, good).expect("writable");
    assert_eq!(newer.grid, saved.grid);
}
