//! A machine with a simulated disk that runs a store by hand, one commit at a time, and knows what was acknowledged.

use std::{
    path::Path,
    sync::{Arc, Mutex},
};

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};
use tidemap_grid::snapshot::GridSnapshot;
use tidemap_map::{event::Event, history::HistoryPiece, ids::StateId, snapshot::MapSnapshot, spec::MapSpec};

use super::{DIRECTORY, disk::SimulatedDisk, make_directory};
use crate::{
    AppendError, MapId, MapLog, OpenError, Store, StoreOptions,
    committer::Committer,
    disk::Disk as _,
    index::Index,
    log::segment_position,
    store::open::Parts,
    tests::{
        example::{event, snapshot, spec},
        grid_example,
    },
};

const STATES: usize = 2;

/// One map and its expected contents.
pub(super) struct Known {
    pub(super) map: MapId,
    pub(super) spec: MapSpec,
    pub(super) log: Option<MapLog>,
    /// Events by position, acknowledged: they must never be lost.
    acknowledged: Vec<Event>,
    /// Appended after those and not acknowledged: any first part of them may be found.
    attempted: Vec<Event>,
    snapshots: Vec<MapSnapshot>,
    /// The grid as it was loaded, with tiles that are not in memory.
    loaded: Option<GridSnapshot>,
    /// History given to saves, and whether the save succeeded.
    history: Vec<(Arc<HistoryPiece>, bool)>,
    /// Numbers the events, so that no two are equal.
    next: u64,
}

pub(super) struct Machine {
    pub(super) disk: SimulatedDisk,
    pub(super) committer: Arc<Committer>,
    store: Option<Store>,
    pub(super) maps: Vec<Known>,
    /// Appends acknowledged in all.
    pub(super) acknowledged: u64,
}

/// An event that is only the number's; never an update's start, whose position would matter.
fn numbered(number: u64) -> Event {
    if number % 3 == 2 {
        return grid_example::scans(number, &mut SmallRng::seed_from_u64(number));
    }
    event(number * 5 + 1)
}

impl Machine {
    pub(super) fn new(disk: SimulatedDisk) -> Machine {
        make_directory(&disk);
        Machine { disk, committer: Arc::default(), store: None, maps: Vec::new(), acknowledged: 0 }
    }

    /// Starts the store and opens every map.
    pub(super) fn start(&mut self) -> Result<(), OpenError> {
        self.committer = Arc::default();
        let store = Store::assemble(Parts {
            disk: Arc::new(self.disk.clone()),
            directory: DIRECTORY.into(),
            options: StoreOptions {
                segment_bytes: 1200,
                tile_cache_bytes: 1000,
                spectrum_cache_bytes: 100,
                ..StoreOptions::default()
            },
            store_id: String::new(),
            is_new: false,
            index: Index::none(),
            committer: Arc::clone(&self.committer),
            repairs: Vec::new(),
            lock: None,
        })?;
        let found = store.maps();
        for known in &mut self.maps {
            assert!(found.contains(&(known.map, known.spec.clone())), "a created map is missing");
            known.open(&store)?;
        }
        self.store = Some(store);
        Ok(())
    }

    pub(super) fn create_map(&mut self) {
        let name = format!("map-{}", self.maps.len());
        let spec = if self.maps.len() % 2 == 1 { spec(&name) } else { grid_example::spec(&name) };
        let store = self.store.as_ref().expect("started");
        let Ok(map) = store.create_map(&spec) else { return };
        let (acknowledged, attempted, snapshots, history) = Default::default();
        let mut known =
            Known { map, spec, log: None, acknowledged, attempted, snapshots, loaded: None, history, next: 0 };
        // Reading may fail on a disk with faults; then the next start opens it.
        let _ = known.open(store);
        self.maps.push(known);
    }

    /// Queues some events of random maps and commits them in one round.
    pub(super) fn append(&mut self, random: &mut SmallRng) -> Vec<AppendError> {
        type Answers = Arc<Mutex<Vec<(usize, Result<u64, AppendError>)>>>;
        let answers = Answers::default();
        let mut queued = 0;
        let mut errors = Vec::new();
        let count = self.maps.len();
        for _ in 0..random.random_range(1..8) {
            let index = random.random_range(0..count.max(1));
            let Some(known) = self.maps.get_mut(index) else { break };
            let Some(log) = &known.log else { continue };
            let event = numbered(known.next);
            let answers = Arc::clone(&answers);
            let done = move |result| answers.lock().expect("not poisoned").push((index, result));
            match log.append(&event, Box::new(done)) {
                Ok(()) => {
                    known.next += 1;
                    known.attempted.push(event);
                    queued += 1;
                }
                Err(error) => errors.push(error),
            }
        }
        self.committer.commit(self.committer.take_now());
        let answers = std::mem::take(&mut *answers.lock().expect("not poisoned"));
        assert_eq!(answers.len(), queued, "each append is answered once");
        for (index, answer) in answers {
            let known = &mut self.maps[index];
            match answer {
                Ok(position) => {
                    self.acknowledged += 1;
                    let event = known.attempted.remove(0);
                    known.acknowledged.push(event);
                    assert_eq!(position, known.acknowledged.len() as u64, "positions have no gaps");
                }
                Err(error) => errors.push(error),
            }
        }
        errors
    }

    /// Like the writers after a failure: forgets what was refused, and continues.
    pub(super) fn roll_back(&mut self) {
        for known in &mut self.maps {
            known.attempted.clear();
            if let Some(log) = &known.log {
                log.resume();
            }
        }
    }

    pub(super) fn save(&mut self, random: &mut SmallRng) {
        let index = random.random_range(0..self.maps.len().max(1));
        let (Some(known), Some(store)) = (self.maps.get_mut(index), &self.store) else { return };
        let position = known.acknowledged.len() as u64;
        let mut snapshot = match &known.spec.grid {
            Some(_) => grid_example::snapshot(&known.spec, position, 2),
            None => snapshot(&known.spec, position, STATES),
        };
        if let Some(loaded) = known.loaded.clone().filter(|_| random.random_bool(0.5)) {
            snapshot.grid = Some(loaded);
        }
        if !known.snapshots.contains(&snapshot) {
            known.snapshots.push(snapshot.clone());
        }
        let generation = known.history.len() as u64 + 1;
        let day = 19_000 + generation as i32;
        let mut piece = grid_example::piece(generation, day, &mut SmallRng::seed_from_u64(generation));
        if known.spec.grid.is_none() {
            piece.days.clear();
        }
        known.history.push((Arc::new(piece), false));
        // The snapshot has the pieces of earlier saves that have failed, too.
        snapshot.history =
            known.history.iter().filter(|(_, is_kept)| !is_kept).map(|(piece, _)| Arc::clone(piece)).collect();
        // Whether the save succeeds or not: the data saved before and the log are still the map.
        if store.save(known.map, &snapshot).is_ok() {
            known.history.iter_mut().for_each(|(_, is_kept)| *is_kept = true);
        }
    }

    /// Maps whose log has lost its beginning to checkpoints.
    pub(super) fn shortened_logs(&self) -> u64 {
        let is_shortened = |known: &&Known| {
            let folder = format!("/data/maps/{:08}/log", known.map.0);
            let names = self.disk.list(Path::new(&folder)).expect("there");
            names.first().is_some_and(|name| segment_position(name) > Some(1))
        };
        self.maps.iter().filter(is_shortened).count() as u64
    }

    /// The process ends, and the machine with it or not; then everything starts again on what is left.
    pub(super) fn restart(&mut self, is_power_cut: bool) -> Result<(), OpenError> {
        self.store = None;
        for known in &mut self.maps {
            known.log = None;
        }
        self.disk = if is_power_cut { self.disk.power_cut() } else { self.disk.kill() };
        self.start()
    }
}

impl Known {
    /// Opens the map and checks that it is what was promised.
    fn open(&mut self, store: &Store) -> Result<(), OpenError> {
        let opened = store.open_map(self.map, &self.spec)?;
        let from = match &opened.snapshot {
            Some(snapshot) => {
                assert!(self.snapshots.contains(snapshot), "a snapshot that was never saved");
                snapshot.replay_from
            }
            None => 1,
        };
        let end = opened.log.end() as usize;
        assert!(end >= self.acknowledged.len(), "acknowledged records are lost");
        let extra = end - self.acknowledged.len();
        assert!(extra <= self.attempted.len(), "there are more records than were appended");
        // Everything found counts from now on, acknowledged or not; the rest is lost for good.
        self.acknowledged.extend(self.attempted.drain(..extra));
        self.attempted.clear();
        let mut expected = from;
        for item in opened.replay {
            let (position, event) = item?;
            assert_eq!(position, expected);
            assert!(event == self.acknowledged[position as usize - 1], "record {position} is another one");
            expected += 1;
        }
        assert_eq!(expected, end as u64 + 1, "the replay ends too early");
        self.log = Some(opened.log);
        self.loaded = opened.snapshot.and_then(|snapshot| snapshot.grid);
        self.check_history(store);
        Ok(())
    }

    /// Checks that the pieces which a save has kept are there, and nothing else than pieces that some save was given.
    fn check_history(&self, store: &Store) {
        let history = store.history(self.map).expect("known");
        // The newest, which a crash may have met.
        for (piece, is_kept) in self.history.iter().rev().take(3) {
            let start = (19_000 + piece.generation as i64) * grid_example::DAY_NANOS;
            let end = start + grid_example::DAY_NANOS;
            let days: Vec<_> = history.grid_days(start, end, None).map(|day| day.expect("readable")).collect();
            assert!(days == piece.days || !is_kept && days.is_empty(), "{} in the grid", piece.generation);
            let found = history.state(StateId(3), start, end).expect("readable");
            let mut samples = piece.states[1].1.clone();
            samples.sort_by_key(|sample| sample.utc_nanos);
            assert!(found == samples || !is_kept && found.is_empty(), "{} of a state", piece.generation);
        }
    }
}
