//! What an update has done comes back whole or not at all, and only to the same update.

use std::{
    collections::{BTreeMap, HashSet},
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};
use tidemap_map::{
    grid::{
        index::TileId,
        progress::{DoneTile, TileNote, TileOutcome, UpdateIdentity, UpdateJournal as _},
        tile::{TileModel, TileSums},
    },
    snapshot::MapSnapshot,
    spec::MapSpec,
};
use tidemap_model::{LocalDay, PhasorSum};

use super::{
    example::{append, event, options},
    grid_example::{learned, snapshot, spec, sum},
};
use crate::{
    MapId, Report, Store,
    disk::{Disk, RealDisk},
    update_file::UpdateFile,
};

const MAP: MapId = MapId(1);
pub(crate) const IDENTITY: UpdateIdentity =
    UpdateIdentity { generation: 7, position: 70, cut_nanos: -5, content: 0xC0FFEE };

pub(crate) fn open(disk: &Arc<dyn Disk>, folder: &Path, spec: &MapSpec, identity: &UpdateIdentity) -> UpdateFile {
    UpdateFile::open(Arc::clone(disk), folder, MAP, &spec.periodicities, identity)
}

fn open_real(folder: &Path, spec: &MapSpec, identity: &UpdateIdentity) -> UpdateFile {
    open(&(Arc::new(RealDisk) as Arc<dyn Disk>), folder, spec, identity)
}

/// What a tile becomes on a day; `shared` is what it may share with others.
pub(crate) fn done(tile: u32, through: i32, spec: &MapSpec, shared: &[Arc<PhasorSum>]) -> DoneTile {
    let mut random = SmallRng::seed_from_u64(u64::from(tile) << 32 | u64::from(through.cast_unsigned()));
    let (model, sums) = learned(spec, &mut random, shared, 3);
    let outcome = TileOutcome {
        observations: random.random(),
        scored: random.random(),
        squared_errors: std::array::from_fn(|_| random.random()),
        squared_error_in_force: random.random(),
        squared_error_chosen: random.random(),
    };
    DoneTile { tile: TileId(tile), through: LocalDay(through), model, sums, outcome }
}

fn as_note(done: &DoneTile) -> TileNote<'_> {
    let DoneTile { tile, through, model, sums, outcome } = done;
    TileNote { tile: *tile, through: *through, model, sums, outcome }
}

pub(crate) fn note(file: &UpdateFile, tiles: &[DoneTile]) {
    file.note(&tiles.iter().map(as_note).collect::<Vec<_>>());
}

/// The newest of each tile, by tile.
pub(crate) fn newest(tiles: &[DoneTile]) -> Vec<DoneTile> {
    let newest: BTreeMap<TileId, &DoneTile> = tiles.iter().map(|tile| (tile.tile, tile)).collect();
    newest.into_values().cloned().collect()
}

/// What a file has, by tile.
pub(crate) fn found(file: &UpdateFile) -> Vec<DoneTile> {
    let mut tiles = file.resume();
    assert_eq!(tiles.len(), file.resumed());
    assert_eq!(file.resume(), [], "asked once");
    tiles.sort_by_key(|tile| tile.tile);
    tiles
}

fn distinct(tiles: &[DoneTile]) -> usize {
    tiles.iter().flat_map(|tile| &tile.sums.groups).map(Arc::as_ptr).collect::<HashSet<_>>().len()
}

/// A folder with the file of a few notes; where each note ends in it.
struct Example {
    spec: MapSpec,
    folder: tempfile::TempDir,
    path: PathBuf,
    notes: Vec<DoneTile>,
    ends: Vec<usize>,
    /// Where the first record ends.
    start: usize,
}

fn example(tiles: u32, days: i32) -> Example {
    let spec = spec("office");
    let folder = tempfile::tempdir().expect("temporary directory");
    let mut random = SmallRng::seed_from_u64(3);
    let shared: Vec<Arc<PhasorSum>> = (0..2).map(|_| Arc::new(sum(&spec, &mut random))).collect();
    let path = folder.path().join("update-00000000000000000007.tmu");
    let file = open_real(folder.path(), &spec, &IDENTITY);
    note(&file, &[]);
    let length = || fs::metadata(&path).expect("there").len() as usize;
    let start = length();
    let (mut notes, mut ends) = (Vec::new(), Vec::new());
    for day in 0..days {
        for tile in 0..tiles {
            notes.push(done(tile, 20_000 + day, &spec, &shared));
            note(&file, &notes[notes.len() - 1..]);
            ends.push(length());
        }
    }
    Example { spec, folder, path, notes, ends, start }
}

impl Example {
    /// What must be found where `whole` bytes of the file are as they were written.
    fn expected(&self, whole: usize) -> &[DoneTile] {
        &self.notes[..self.ends.iter().filter(|&&end| end <= whole).count()]
    }

    fn open(&self) -> UpdateFile {
        open_real(self.folder.path(), &self.spec, &IDENTITY)
    }

    /// Gives the file another content.
    fn put(&self, bytes: &[u8]) {
        // Not overwritten: some file systems then wait for the disk. It may be gone already.
        let _ = fs::remove_file(&self.path);
        fs::write(&self.path, bytes).expect("writable");
    }
}

#[test]
fn notes_come_back_with_what_tiles_share_and_are_gone_on_with() {
    let example = example(6, 3);
    let mut all = example.notes.clone();
    for day in 3..6 {
        let file = example.open();
        let found = found(&file);
        assert_eq!(found, newest(&all), "day {day}");
        assert!(distinct(&found) <= distinct(&newest(&all)), "day {day}");
        // What was found is kept as it is by some, as by a group that was not seen.
        let mut more: Vec<DoneTile> = found[..3].to_vec();
        more[1].model = TileModel::default();
        more[1].sums = TileSums::default();
        for (tile, next) in more.iter_mut().zip(20..) {
            tile.through = LocalDay(20_000 + day);
            tile.outcome.scored = next;
        }
        note(&file, &more);
        all.extend(more);
    }
    let length = fs::metadata(&example.path).expect("there").len();
    assert_eq!(found(&example.open()), newest(&all));
    assert_eq!(fs::metadata(&example.path).expect("there").len(), length, "reading changes nothing");
}

#[test]
fn a_torn_end_is_cut_off_at_every_byte() {
    let example = example(2, 2);
    let bytes = fs::read(&example.path).expect("readable");
    assert_eq!(example.ends.last(), Some(&bytes.len()));
    let more = done(1, 20_009, &example.spec, &[]);
    for length in 0..=bytes.len() {
        example.put(&bytes[..length]);
        let file = example.open();
        let expected = example.expected(length);
        assert_eq!(found(&file), newest(expected), "{length} bytes");
        // What cannot be used is not there any more, and what follows is used again.
        note(&file, std::slice::from_ref(&more));
        let expected = [expected, std::slice::from_ref(&more)].concat();
        assert_eq!(found(&example.open()), newest(&expected), "{length} bytes and more");
    }
}

#[test]
fn a_flipped_bit_is_never_believed() {
    let example = example(2, 2);
    let bytes = fs::read(&example.path).expect("readable");
    let mut random = SmallRng::seed_from_u64(4);
    for byte in 0..bytes.len() {
        let bit = byte * 8 + random.random_range(0..8);
        let mut flipped = bytes.clone();
        flipped[bit / 8] ^= 1 << (bit % 8);
        example.put(&flipped);
        let expected = if bit / 8 < example.start { &[] } else { example.expected(bit / 8) };
        assert_eq!(found(&example.open()), newest(expected), "bit {bit}");
    }
}

#[test]
fn records_from_elsewhere_in_the_file_are_not_believed() {
    // As of a disk that has written the end and not the middle.
    let example = example(3, 1);
    let bytes = fs::read(&example.path).expect("readable");
    let (first, second) = (example.ends[0], example.ends[1]);
    for wrong in [
        [&bytes[..first], &bytes[second..]].concat(),
        [&bytes[..second], &bytes[first..second]].concat(),
        [&bytes[..first], &vec![0; second - first], &bytes[second..]].concat(),
    ] {
        example.put(&wrong);
        let expected = if wrong[..second] == bytes[..second] { 2 } else { 1 };
        assert_eq!(found(&example.open()), example.notes[..expected]);
    }
}

#[test]
fn another_update_finds_nothing_and_the_file_is_gone() {
    let content = fs::read(&example(2, 1).path).expect("readable");
    let spec = spec("office");
    let others = [
        (UpdateIdentity { position: 71, ..IDENTITY }, spec.clone()),
        (UpdateIdentity { cut_nanos: -4, ..IDENTITY }, spec.clone()),
        (UpdateIdentity { content: 0, ..IDENTITY }, spec.clone()),
        (IDENTITY, MapSpec { periodicities: super::example::spec("office").periodicities, ..spec.clone() }),
    ];
    for (identity, spec) in others {
        let folder = tempfile::tempdir().expect("temporary directory");
        let path = folder.path().join("update-00000000000000000007.tmu");
        fs::write(&path, &content).expect("writable");
        let file = open_real(folder.path(), &spec, &identity);
        assert_eq!((found(&file), path.exists()), (vec![], false), "{identity:?}");
    }
    let folder = tempfile::tempdir().expect("temporary directory");
    let path = folder.path().join("update-00000000000000000008.tmu");
    fs::write(&path, &content).expect("writable");
    let file = open_real(folder.path(), &spec, &UpdateIdentity { generation: 8, ..IDENTITY });
    assert_eq!((found(&file), path.exists()), (vec![], false), "by another name");
}

#[test]
fn a_file_goes_when_a_checkpoint_has_what_was_learned() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let spec = spec("office");
    let checkpoints = directory.path().join("maps/00000001/checkpoints");
    let names = || {
        let entries = fs::read_dir(&checkpoints).expect("readable");
        let mut names: Vec<String> =
            entries.map(|entry| entry.expect("entry").file_name().into_string().expect("text")).collect();
        names.sort();
        names.retain(|name| !name.ends_with(".tmc"));
        names
    };
    let name = |generation: u64| format!("update-{generation:020}.tmu");
    let generation = {
        let store = Store::open(directory.path(), options()).expect("opens");
        assert_eq!(store.create_map(&spec).expect("creates"), MAP);
        let opened = store.open_map(MAP, &spec).expect("opens");
        append(&opened.log, &event(1)).expect("appends");
        let saved = MapSnapshot { generation: 5, ..snapshot(&spec, 1, 2) };
        let before = store.sizes(MAP);
        for generation in saved.generation - 1..=saved.generation + 1 {
            let file = store.update_file(MAP, &UpdateIdentity { generation, ..IDENTITY }).expect("known");
            note(&file, &[done(1, 20_000, &spec, &[])]);
        }
        assert_eq!(names().len(), 3);
        assert_eq!(store.sizes(MAP), before, "not counted");
        store.save(MAP, &saved).expect("saves");
        assert_eq!(names(), [name(saved.generation + 1)], "of the update that follows");
        saved.generation
    };
    // Stopped between the checkpoint and the removal.
    fs::copy(checkpoints.join(name(generation + 1)), checkpoints.join(name(generation))).expect("copied");
    fs::write(checkpoints.join("update-7.tmu"), "of somebody else").expect("written");
    let store = Store::open(directory.path(), options()).expect("opens");
    let opened = store.open_map(MAP, &spec).expect("opens");
    assert_eq!(opened.reports, [Report::LeftoverRemoved { file: checkpoints.join(name(generation)) }]);
    assert_eq!(names(), [name(generation + 1), "update-7.tmu".to_owned()]);
    let identity = UpdateIdentity { generation: generation + 1, ..IDENTITY };
    assert_eq!(store.update_file(MAP, &identity).expect("known").resumed(), 1);
    assert!(store.update_file(MapId(9), &identity).is_err());
}
