//! Exact learned observations: kept as long as the retention demands, found again, and never wrong.

use std::{fs, path::Path, path::PathBuf, sync::Arc};

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};
use tidemap_grid::{day::GridDay, index::TileId, spec::Retention};
use tidemap_map::{
    history::{
        HistoryDay, HistoryPiece,
        origins::{OriginRun, Origins},
    },
    ids::{ProducerId, StateId},
    snapshot::MapSnapshot,
    spec::MapSpec,
    training::ReadingsRequest,
};
use tidemap_model::Sample;

use super::{
    example::options,
    grid_example::{DAY_NANOS, piece, snapshot, spec},
    is_full,
};
use crate::{History, HistoryError, HistorySizes, MapId, Repair, Store};

const MAP: MapId = MapId(1);

fn pieces(count: u64) -> Vec<Arc<HistoryPiece>> {
    let mut random = SmallRng::seed_from_u64(77);
    (1..=count).map(|generation| Arc::new(piece(generation, 19_000 + generation as i32, &mut random))).collect()
}

/// A store whose map has saved these pieces, in as many saves.
fn fill(directory: &Path, spec: &MapSpec, pieces: &[Arc<HistoryPiece>]) -> Store {
    let store = Store::open(directory, options()).expect("opens");
    store.create_map(spec).expect("creates");
    for (number, piece) in pieces.iter().enumerate() {
        let snapshot = MapSnapshot {
            history: vec![Arc::clone(piece)],
            newest_nanos: piece.to_nanos,
            cut_nanos: piece.to_nanos + 1,
            ..snapshot(spec, number as u64 + 3, 2)
        };
        store.save(MAP, &snapshot).expect("saves");
    }
    store
}

fn names(directory: &Path) -> Vec<String> {
    let folder = directory.join("maps/00000001/history");
    let Ok(entries) = fs::read_dir(folder) else { return Vec::new() };
    let mut names: Vec<String> =
        entries.map(|entry| entry.expect("entry").file_name().into_string().expect("text")).collect();
    names.sort();
    names
}

/// The origins of the first observations of one producer.
fn of_one(count: u32) -> Origins {
    Origins { runs: vec![OriginRun { producer: ProducerId(0), first: 1, count }], ..Origins::default() }
}

fn days(history: &History, from: i64, to: i64, tiles: Option<Vec<TileId>>) -> Result<Vec<HistoryDay>, HistoryError> {
    history.grid_days(from, to, tiles).collect()
}

/// A state's observations in a range, from the pieces.
fn expected(pieces: &[Arc<HistoryPiece>], id: StateId, from: i64, to: i64) -> Vec<Sample> {
    let states = pieces.iter().flat_map(|piece| &piece.states).filter(|(state, _)| *state == id);
    let mut samples: Vec<Sample> = states
        .flat_map(|(_, samples)| samples)
        .filter(|sample| (from..to).contains(&sample.utc_nanos))
        .copied()
        .collect();
    samples.sort_by_key(|sample| sample.utc_nanos);
    samples
}

/// A day with only the tiles of a set.
fn restricted(day: &HistoryDay, tiles: &[TileId]) -> HistoryDay {
    let mut outliers = GridDay::new(day.outliers.day);
    outliers.scans.clone_from(&day.outliers.scans);
    outliers.presence.clone_from(&day.outliers.presence);
    for (id, tile) in day.outliers.tiles().filter(|(id, _)| tiles.contains(id)) {
        outliers.put(id, tile.clone());
    }
    for run in &mut outliers.presence {
        run.seen = run.seen.iter().copied().filter(|tile| tiles.contains(tile)).collect();
    }
    let models = day.models.iter().filter(|(tile, _)| tiles.contains(tile)).cloned().collect();
    HistoryDay { outliers, models }
}

#[test]
fn observations_of_a_state_are_found_again_by_time() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let pieces = pieces(4);
    let history = fill(directory.path(), &spec("office"), &pieces).history(MAP).expect("known");
    let start = 19_001 * DAY_NANOS;
    for (from, to) in [(0, i64::MAX), (start + DAY_NANOS / 2, start + 2 * DAY_NANOS), (5, 5), (i64::MAX, 0)] {
        for id in [0, 1, 3, 4, 5].map(StateId) {
            let found = history.state(id, from, to).expect("readable");
            assert_eq!(found, expected(&pieces, id, from, to), "{id:?} from {from} to {to}");
        }
    }
}

#[test]
fn many_states_are_found_as_each_is_by_itself() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let pieces = pieces(5);
    let history = fill(directory.path(), &spec("office"), &pieces).history(MAP).expect("known");
    let start = 19_001 * DAY_NANOS;
    // The requests are in any order, one of them twice, one for a state that does not exist.
    let wanted: Vec<ReadingsRequest> =
        [(4, 0), (0, start + DAY_NANOS), (9, 0), (3, i64::MIN), (0, start), (1, i64::MAX)]
            .map(|(state, from_nanos)| ReadingsRequest { state: StateId(state), from_nanos })
            .to_vec();
    for before in [u64::MAX, 4, 0] {
        let history = history.clone().before(before);
        let files = history.state_files().expect("readable");
        let found = files.readings(&wanted).expect("readable");
        assert_eq!(found.len(), wanted.len());
        for (wanted, found) in wanted.iter().zip(&found) {
            let alone = history.state(wanted.state, wanted.from_nanos, i64::MAX).expect("readable");
            assert_eq!(found, &alone, "{wanted:?} before {before}");
        }
        assert_eq!(found[0].is_empty(), before == 0);
        assert!(files.readings(&[]).expect("nothing to read").is_empty());
    }
    // A file that was deleted since, as by retention, counts as absent.
    let files = history.state_files().expect("readable");
    let path = directory.path().join("maps/00000001/history").join(&names(directory.path())[0]);
    history.remove_from_list(std::slice::from_ref(&path)).expect("listed no longer");
    fs::remove_file(&path).expect("removed");
    let without = history.state_files().expect("readable").readings(&wanted).expect("readable");
    assert_eq!(files.readings(&wanted).expect("readable"), without);
    // A damaged file is named.
    let damaged = directory.path().join("maps/00000001/history").join(names(directory.path()).last().expect("a file"));
    fs::write(&damaged, "nothing").expect("written");
    let error = files.readings(&wanted).expect_err("damaged").to_string();
    assert!(error.contains(damaged.file_name().and_then(|name| name.to_str()).expect("text")), "{error}");
}

#[test]
fn days_of_the_grid_are_found_again_by_time_and_tile() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let pieces = pieces(4);
    let history = fill(directory.path(), &spec("office"), &pieces).history(MAP).expect("known");
    let all: Vec<HistoryDay> = pieces.iter().flat_map(|piece| &piece.days).cloned().collect();
    assert_eq!(days(&history, 0, i64::MAX, None).expect("readable"), all);
    for tiles in [vec![], vec![TileId(3)], vec![TileId(4), TileId(0), TileId(99), TileId(4)]] {
        let expected: Vec<HistoryDay> = all.iter().map(|day| restricted(day, &tiles)).collect();
        assert_eq!(days(&history, 0, i64::MAX, Some(tiles)).expect("readable"), expected);
    }
    let start = 19_002 * DAY_NANOS;
    assert_eq!(days(&history, start, start + DAY_NANOS, None).expect("readable"), all[1..2]);
    assert_eq!(days(&history, start - 1, start, None).expect("readable"), []);
}

#[test]
fn many_states_and_tiles_are_found_through_the_table() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let sample = |id: u32| Sample { utc_nanos: i64::from(id), offset_secs: 0, value: 1.0 };
    let mut many = HistoryPiece::new(1);
    many.states = (0..20_000).map(|id| (StateId(id * 3), vec![sample(id)])).collect();
    many.origins = vec![of_one(1); many.states.len()];
    let mut random = SmallRng::seed_from_u64(5);
    for number in 0..3 {
        let mut day = GridDay::new(tidemap_model::LocalDay(number));
        let seen: Arc<[TileId]> = (0..5000).map(|tile| TileId(tile * 2)).collect();
        let time = tidemap_grid::day::ScanTime {
            utc_nanos: i64::from(number),
            offset_secs: 0,
            source: tidemap_grid::scan::ScanSource::Cells,
            sensor: tidemap_grid::sensors::SensorId::OWN,
        };
        let scan = day.push(time, &seen);
        for &tile in seen.iter() {
            day.show(scan, tile, super::grid_example::masks(&mut random));
        }
        many.days.push(HistoryDay::plain(day));
    }
    (many.from_nanos, many.to_nanos) = (0, 20_000);
    let many = Arc::new(many);
    let history = fill(directory.path(), &spec("office"), &[Arc::clone(&many)]).history(MAP).expect("known");
    for id in [0, 1, 4095, 4096, 4097, 8192, 12_288, 19_999, 20_000] {
        let found = history.state(StateId(id * 3), 0, i64::MAX).expect("readable");
        assert_eq!(found, (id < 20_000).then(|| sample(id)).into_iter().collect::<Vec<_>>());
        assert_eq!(history.state(StateId(id * 3 + 1), 0, i64::MAX).expect("readable"), []);
    }
    assert_eq!(days(&history, 0, 10, None).expect("readable"), many.days);
    let tiles: Vec<TileId> = [0, 1, 4095 * 2, 4096 * 2, 9998, 9999].map(TileId).to_vec();
    let expected: Vec<HistoryDay> = many.days.iter().map(|day| restricted(day, &tiles)).collect();
    assert_eq!(days(&history, 0, 10, Some(tiles)).expect("readable"), expected);
}

#[test]
fn states_and_the_grid_are_kept_as_long_as_each_is_to_be() {
    let retentions = [Retention::None, Retention::Duration(2 * DAY_NANOS), Retention::Forever];
    let pieces = pieces(6);
    let newest = pieces[5].to_nanos;
    for states in retentions {
        for grid in retentions {
            let directory = tempfile::tempdir().expect("temporary directory");
            let mut spec = MapSpec { retention: states, ..spec("office") };
            spec.grid.as_mut().expect("has a grid").retention = grid;
            let store = fill(directory.path(), &spec, &pieces);
            let kept = |retention, to: &dyn Fn(&HistoryPiece) -> i64| match retention {
                Retention::None => 0,
                Retention::Duration(nanos) => pieces.iter().filter(|piece| to(piece) >= newest - nanos).count(),
                Retention::Forever => pieces.len(),
            };
            let last_sample = |piece: &HistoryPiece| {
                let samples = piece.states.iter().flat_map(|(_, samples)| samples);
                samples.map(|sample| sample.utc_nanos).max().unwrap_or(0)
            };
            let last_scan = |piece: &HistoryPiece| {
                piece.days[0].outliers.scans.iter().map(|scan| scan.utc_nanos).max().unwrap_or(0)
            };
            let names = names(directory.path());
            let count = |part: &str| names.iter().filter(|name| name.ends_with(part)).count();
            let found = (count(".states.tmh"), count(".grid.tmh"));
            assert_eq!(found, (kept(states, &last_sample), kept(grid, &last_scan)), "{states:?} {grid:?}");
            assert_eq!(names.len(), found.0 + found.1);
            // No kept observation is missing.
            let sizes = store.history(MAP).expect("known").sizes().expect("readable");
            assert_eq!(sizes.files, names.len() as u64);
            assert_eq!(store.sizes(MAP).history_bytes, sizes.state_bytes + sizes.grid_bytes);
        }
    }
}

#[test]
fn history_is_kept_for_days_that_updates_have_yet_to_learn() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let pieces = pieces(6);
    let spec = MapSpec { retention: Retention::Duration(2 * DAY_NANOS), ..spec("office") };
    let store = fill(directory.path(), &spec, &pieces[..2]);
    // An import has reached a day far later than the learned days.
    let ahead = MapSnapshot {
        history: vec![Arc::clone(&pieces[2])],
        newest_nanos: pieces[5].to_nanos,
        cut_nanos: pieces[2].to_nanos + 1,
        ..snapshot(&spec, 9, 2)
    };
    store.save(MAP, &ahead).expect("saves");
    let kept = names(directory.path()).iter().filter(|name| name.ends_with(".states.tmh")).count();
    assert_eq!(kept, pieces[..3].iter().filter(|piece| piece.to_nanos >= pieces[2].to_nanos - 2 * DAY_NANOS).count());
    assert!(kept > 1);
}

#[test]
fn what_is_written_again_takes_the_place_of_what_was() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let pieces = pieces(2);
    let spec = spec("office");
    let history = {
        let store = fill(directory.path(), &spec, &pieces);
        // After a crash the log is replayed and the same update learns the same observations again.
        let again = MapSnapshot { history: pieces.clone(), ..snapshot(&spec, 9, 2) };
        store.save(MAP, &again).expect("saves");
        store.history(MAP).expect("known")
    };
    assert_eq!(names(directory.path()).len(), 4);
    let all = expected(&pieces, StateId(3), 0, i64::MAX);
    assert_eq!(history.state(StateId(3), 0, i64::MAX).expect("readable"), all);
}

#[test]
fn a_map_without_history_has_none() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let store = fill(directory.path(), &spec("office"), &[]);
    let history = store.history(MAP).expect("known");
    assert_eq!(history.state(StateId(0), 0, i64::MAX).expect("readable"), []);
    assert_eq!(days(&history, 0, i64::MAX, None).expect("readable"), []);
    assert_eq!(history.sizes().expect("readable"), HistorySizes::default());
    assert!(matches!(store.history(MapId(2)), Err(HistoryError::UnknownMap(MapId(2)))));
    // Empty pieces leave nothing either.
    let empty = MapSnapshot { history: vec![Arc::new(HistoryPiece::new(1))], ..snapshot(&spec("office"), 3, 2) };
    store.save(MAP, &empty).expect("saves");
    assert_eq!(names(directory.path()), Vec::<String>::new());
}

fn file_of(error: &HistoryError) -> Option<&PathBuf> {
    match error {
        HistoryError::Damaged { file, .. } | HistoryError::Missing { file, .. } | HistoryError::Io { file, .. } => {
            Some(file)
        }
        HistoryError::UnknownMap(_) => None,
    }
}

#[test]
fn every_damaged_byte_is_noticed_and_the_file_is_named() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let history = fill(directory.path(), &spec("office"), &pieces(2)).history(MAP).expect("known");
    let mut random = SmallRng::seed_from_u64(3);
    for name in ["00000000000000000002.states.tmh", "00000000000000000002.grid.tmh"] {
        let file = directory.path().join("maps/00000001/history").join(name);
        let good = fs::read(&file).expect("readable");
        let read = || -> Result<(), HistoryError> {
            for id in [0, 3, 4].map(StateId) {
                history.state(id, 0, i64::MAX)?;
            }
            days(&history, 0, i64::MAX, None).map(drop)
        };
        read().expect("good");
        for byte in (0..good.len()).step_by(if is_full() { 1 } else { 5 }) {
            let mut bad = good.clone();
            bad[byte] ^= 1 << random.random_range(0..8);
            fs::write(&file, &bad).expect("writable");
            let error = read().expect_err("damaged");
            assert_eq!(file_of(&error), Some(&file), "byte {byte}: {error}");
        }
        for length in [0, 10, good.len() / 2, good.len() - 1] {
            fs::write(&file, &good[..length]).expect("writable");
            assert_eq!(file_of(&read().expect_err("cut off")), Some(&file));
        }
        fs::write(&file, &good).expect("writable");
    }
}

#[test]
fn an_interrupted_save_of_history_leaves_nothing() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let spec = spec("office");
    drop(fill(directory.path(), &spec, &pieces(1)));
    let left = directory.path().join("maps/00000001/history/00000000000000000009.grid.tmh.new");
    fs::write(&left, "half").expect("writable");
    let store = Store::open(directory.path(), options()).expect("opens");
    let expected = Repair::LeftoverRemoved { file: left.clone() };
    store.history(MAP).expect("known").remove_leftovers(&mut Vec::new()).expect("removable");
    assert!(!left.exists());
    fs::write(&left, "half").expect("writable");
    let mut repairs = Vec::new();
    store.history(MAP).expect("known").remove_leftovers(&mut repairs).expect("removable");
    assert_eq!(repairs, [expected]);
}
