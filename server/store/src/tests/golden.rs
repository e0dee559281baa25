//! The bytes of format 1: a data directory with four maps, in `golden/format-1`. From the first release on, a
//! difference here means that existing data directories cannot be read any more: do not change the files in `golden/`
//! then; make a new format.
//!
//! The maps have records of every kind and every table of a site, a grid, states with all data that is learned besides
//! the spectrum, and models of every kind. From the last map a state was erased, and a loss was accepted.

use std::path::{Path, PathBuf};

use tidemap_map::{event::Event, history::HistoryPiece, ids::StateId, snapshot::MapSnapshot, spec::MapSpec};
use tidemap_migrations::{FORMAT, manifest};
use tidemap_model::EnabledModels;

use super::{
    example::{append, content, copy, options},
    golden_events, golden_grid, golden_states, golden_trained,
};
use crate::{Loss, MapId, Source, Store, disk::RealDisk, index::tests_only::rows_checksum, losses};

/// The models of the maps: histograms, the calibrated model and the rate of counts.
pub(super) fn models() -> EnabledModels {
    EnabledModels::from_bits(35).expect("known")
}

/// A map with known content.
pub(super) struct Golden {
    pub(super) spec: MapSpec,
    pub(super) events: Vec<Event>,
    pub(super) snapshot: MapSnapshot,
    /// The checksum over its rows in the index.
    pub(super) rows: u32,
}

fn golden() -> Vec<(MapId, Golden)> {
    let maps = [golden_events::map(), golden_grid::map(), golden_states::map(), golden_trained::map()];
    (1..).map(MapId).zip(maps).collect()
}

pub(super) fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src/tests/golden/format-1")
}

fn loss() -> Loss {
    Loss {
        accepted_nanos: 1_700_000_000_123_456_789,
        file: "maps/00000002/HISTORY".to_owned(),
        problem: "it is missing".to_owned(),
    }
}

/// The files of a directory with their content, except the index and the lock, which hold nothing of their own.
fn files(directory: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let within = |path: PathBuf| path.strip_prefix(directory).expect("within").to_owned();
    let files = content(directory).into_iter().filter_map(|(path, content)| Some((within(path), content?)));
    let is_content = |path: &Path| !path.starts_with("index") && !matches!(path.to_str(), Some("LOCK" | "MANIFEST"));
    files.filter(|(path, _)| is_content(path)).collect()
}

#[test]
fn format_1_is_written_as_it_always_was() {
    let directory = tempfile::tempdir().expect("temporary directory");
    {
        let store = Store::open(directory.path(), options()).expect("opens");
        for (id, Golden { spec, events, snapshot, .. }) in golden() {
            assert_eq!(store.create_map(&spec).expect("creates"), id);
            let log = store.open_map(id, &spec).expect("opens").log;
            for event in events {
                append(&log, &event).expect("appends");
            }
            let erased = golden_trained::erased(&snapshot);
            store.save(id, erased.as_ref().unwrap_or(&snapshot)).expect("saves");
            if erased.is_some() {
                store.erase_states(id, &[StateId(snapshot.states.len() as u32)]).expect("erases");
            }
        }
        losses::record(&RealDisk, directory.path(), loss()).expect("writable");
    }
    let (written, expected) = (files(directory.path()), files(&folder()));
    let names = |files: &[(PathBuf, Vec<u8>)]| files.iter().map(|(path, _)| path.clone()).collect::<Vec<_>>();
    if written != expected {
        let changed = written.iter().filter(|file| !expected.contains(file)).map(|(path, _)| path).collect::<Vec<_>>();
        let kept = directory.keep();
        assert_eq!(names(&written), names(&expected), "other files; what is written now is in {}", kept.display());
        panic!("{changed:?} are not written as they were; what is written now is in {}", kept.display());
    }
    let rows = golden().into_iter().map(|(id, golden)| (rows_checksum(id.0, &golden.snapshot), golden.rows));
    let (found, expected): (Vec<_>, Vec<_>) = rows.unzip();
    assert_eq!(found, expected, "the rows of the index are others: {found:X?}");
}

#[test]
fn format_1_is_read_as_it_always_was() {
    let directory = tempfile::tempdir().expect("temporary directory");
    copy(&folder(), directory.path());
    let before = files(directory.path());
    let found = manifest::read(directory.path(), FORMAT).expect("readable");
    assert_eq!(found.map(|manifest| manifest.format), Some(1));
    let store = Store::open(directory.path(), options()).expect("opens");
    assert_eq!((store.store_id(), store.repairs(), store.trouble()), (super::example::STORE_ID, &[][..], vec![]));
    assert_eq!(store.losses().expect("readable"), [loss()]);
    let maps: Vec<_> = golden().into_iter().map(|(id, golden)| (id, golden.spec)).collect();
    assert_eq!(store.maps(), maps);
    for (id, Golden { spec, events, mut snapshot, .. }) in golden() {
        let opened = store.open_map(id, &spec).expect("opens");
        let pieces = std::mem::take(&mut snapshot.history);
        let from = snapshot.replay_from;
        assert_eq!(opened.source, Source::Checkpoint, "map {}", id.0);
        assert!(opened.snapshot == Some(snapshot), "the snapshot of map {} is another", id.0);
        let replayed: Vec<_> = opened.replay.map(|item| item.expect("readable")).collect();
        let expected: Vec<_> = (1..).zip(events).skip_while(|(position, _)| *position < from).collect();
        assert_eq!(replayed, expected, "map {}", id.0);
        let history = store.history(id).expect("known");
        let mut states: Vec<HistoryPiece> = Vec::new();
        history.each_generation(u64::MAX, None, |piece, _| states.push(piece.clone())).expect("readable");
        let days: Vec<_> = history.grid_days(0, i64::MAX, None).map(|day| day.expect("readable")).collect();
        let of_states = |piece: &HistoryPiece| (piece.generation, piece.states.clone(), piece.origins.clone());
        assert_eq!(
            states.iter().map(of_states).collect::<Vec<_>>(),
            pieces.iter().map(|piece| of_states(piece)).collect::<Vec<_>>()
        );
        assert_eq!(days, pieces.iter().flat_map(|piece| piece.days.clone()).collect::<Vec<_>>());
    }
    drop(store);
    assert!(files(directory.path()) == before, "opening has changed something");
}
