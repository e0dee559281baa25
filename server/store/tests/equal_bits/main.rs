//! One log gives equal digests after every update: with each set of vector instructions that the machine has, on one
//! and two threads, with sums and tiles in memory and on the disk, and after starts in the middle of the log.
//!
//! Invariant: nothing else in this process chooses instructions.

mod world;

use std::{
    collections::BTreeMap,
    sync::{Arc, atomic::AtomicU64, mpsc},
};

use tidemap_grid::spec::{GridSpec, SensorNoise};
use tidemap_map::{
    event::{Digest, Event},
    history::HistoryPiece,
    live_map::LiveMap,
    name::MapName,
    snapshot::MapSnapshot,
    spec::MapSpec,
    training::{ReadingsRequest, StateReadings},
    update::UpdateWork,
};
use tidemap_model::{EnabledModels, InstructionSet, OrderCriterion, Periodicities, Sample, Zone};
use tidemap_store::{MapLog, Store, StoreOptions, digest};

const DAY_NANOS: i64 = 86_400_000_000_000;

/// The observations that updates have learned, by generation.
#[derive(Clone, Debug, Default)]
struct Learned(BTreeMap<u64, Arc<HistoryPiece>>);

impl StateReadings for Learned {
    fn readings(&self, wanted: &[ReadingsRequest]) -> Result<Vec<Vec<Sample>>, String> {
        let of_state = |wanted: &ReadingsRequest| {
            let pieces = self.0.values().flat_map(|piece| &piece.states);
            let samples = pieces.filter(|(state, _)| *state == wanted.state).flat_map(|(_, samples)| samples);
            let mut found: Vec<Sample> =
                samples.copied().filter(|sample| sample.utc_nanos >= wanted.from_nanos).collect();
            found.sort_by_key(|sample| sample.utc_nanos);
            found
        };
        Ok(wanted.iter().map(of_state).collect())
    }
}

/// A map that applies a log.
struct Replica {
    map: LiveMap,
    learned: Learned,
    pool: rayon::ThreadPool,
    digests: BTreeMap<u64, Digest>,
}

impl Replica {
    fn new(spec: &Arc<MapSpec>, threads: usize) -> Replica {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        let map = LiveMap::new(Arc::clone(spec));
        Replica { map, learned: Learned::default(), pool, digests: BTreeMap::new() }
    }

    /// Applies an event; gives what an update made. `prepare` may change how it runs.
    fn apply(
        &mut self,
        position: u64,
        event: &Event,
        prepare: impl FnOnce(UpdateWork) -> UpdateWork,
    ) -> Option<MapSnapshot> {
        let work = self.map.apply(position, event).expect("fits")?;
        let generation = work.start().generation;
        // The history is as a daemon has it: the readings of all updates before.
        let mut before = self.learned.clone();
        before.0.retain(|known, _| *known < generation);
        let work = prepare(work.with_readings(Arc::new(before)));
        let result = self.pool.install(|| work.run(&AtomicU64::new(0))).expect("readable");
        let snapshot = self.map.finish_update(result);
        for piece in &snapshot.history {
            self.learned.0.insert(piece.generation, Arc::clone(piece));
        }
        let found = digest(&snapshot).expect("readable");
        let before = self.digests.insert(generation, found);
        assert!(before.is_none_or(|before| before == found), "an update that is repeated gives another digest");
        Some(snapshot)
    }
}

/// The digests of all generations, in memory.
fn digests(spec: &Arc<MapSpec>, events: &[Event], threads: usize) -> Vec<Digest> {
    let mut replica = Replica::new(spec, threads);
    for (position, event) in (1..).zip(events) {
        replica.apply(position, event, |work| work);
    }
    replica.digests.into_values().collect()
}

fn append(log: &MapLog, event: &Event) -> u64 {
    let (sender, receiver) = mpsc::channel();
    log.append(event, Box::new(move |result| sender.send(result).expect("waiting"))).expect("appends");
    receiver.recv().expect("answered").expect("durable")
}

/// The digests of a map in a store that is closed and opened every `events_between` events; every third generation is
/// saved, and the rest of the log is applied again. `bytes`: the memory for sums of states, and for tiles.
fn digests_of_store(spec: &Arc<MapSpec>, events: &[Event], events_between: usize, bytes: u64) -> Vec<Digest> {
    let directory = tempfile::tempdir().expect("temporary directory");
    let mut replica = Replica::new(spec, 2);
    for (number, part) in events.chunks(events_between).enumerate() {
        let options = StoreOptions {
            tile_cache_bytes: bytes,
            spectrum_cache_bytes: bytes,
            new_store_id: "0123456789abcdef0123456789abcdef".to_owned(),
            ..StoreOptions::default()
        };
        let store = Store::open(directory.path(), options).expect("opens");
        if number == 0 {
            store.create_map(spec).expect("creates");
        }
        let map = store.maps().first().expect("one map").0;
        let opened = store.open_map(map, spec).expect("opens");
        let covered = opened.snapshot.as_ref().map_or(0, |snapshot| snapshot.position);
        assert!(number == 0 || covered > 0 || events_between < events.len() / 3, "nothing was saved");
        replica.map = match opened.snapshot {
            Some(snapshot) => {
                let before = replica.digests.get(&snapshot.generation);
                assert_eq!(digest(&snapshot).ok().as_ref(), before, "what was saved is read back");
                LiveMap::restore(Arc::clone(spec), snapshot)
            }
            None => LiveMap::new(Arc::clone(spec)),
        };
        let with_room = |work: UpdateWork| work.with_room(store.spectrum_room(map));
        for item in opened.replay {
            let (position, event) = item.expect("readable");
            if position <= covered {
                replica.map.recover_pending(position, &event).expect("fits");
            } else {
                replica.apply(position, &event, with_room);
            }
        }
        for event in part {
            let position = append(&opened.log, event);
            if let Some(snapshot) = replica.apply(position, event, with_room)
                && snapshot.generation % 3 == 1
            {
                store.save(map, &snapshot).expect("saves");
            }
        }
    }
    replica.digests.into_values().collect()
}

fn spec(name: &str) -> MapSpec {
    MapSpec {
        zone: Zone::named("Europe/London").expect("known"),
        models: EnabledModels::ALL,
        grid: Some(GridSpec { sensor: SensorNoise { hit: 0.9, false_alarm: 0.05, prior: 0.3 }, ..GridSpec::new(0.1) }),
        ..MapSpec::new(MapName::new(name).expect("valid"))
    }
}

#[track_caller]
fn compare(what: &str, found: &[Digest], expected: &[Digest]) {
    let names = |digests: &[Digest]| digests.iter().map(Digest::to_string).collect::<Vec<_>>();
    assert_eq!(names(found), names(expected), "{what}");
}

/// Compares all sets of instructions of this machine with the first; gives the digests.
fn compare_instructions(spec: &Arc<MapSpec>, events: &[Event]) -> Vec<Digest> {
    let mut expected: Option<Vec<Digest>> = None;
    for set in InstructionSet::ALL {
        if let Err(reason) = set.choose() {
            println!("SKIPPED {set}: {reason}");
            continue;
        }
        let found = digests(spec, events, 1);
        println!("{set}: {} generations, the last {}", found.len(), found.last().expect("one"));
        compare(set.name(), &found, expected.get_or_insert_with(|| found.clone()));
    }
    expected.expect("scalar")
}

#[test]
fn one_log_gives_equal_bits_whatever_the_machine() {
    const DAYS: i64 = 8;
    let spec_of_week = Arc::new(spec("week"));
    let events = world::log(&spec_of_week, DAYS);
    let expected = compare_instructions(&spec_of_week, &events);
    assert_eq!(expected.len() as i64, DAYS);
    compare("two threads", &digests(&spec_of_week, &events, 2), &expected);
    compare("in memory, with starts", &digests_of_store(&spec_of_week, &events, 90, 1 << 30), &expected);
    compare("on the disk, with starts", &digests_of_store(&spec_of_week, &events, 61, 0), &expected);

    let spec_of_list = Arc::new(MapSpec {
        periodicities: Periodicities::list(vec![7 * DAY_NANOS, DAY_NANOS, DAY_NANOS / 2, DAY_NANOS / 7])
            .expect("valid"),
        criterion: OrderCriterion::ZeroOne,
        half_life_nanos: Some(5 * DAY_NANOS),
        grid: spec("list").grid.map(|grid| GridSpec { half_life_nanos: Some(3 * DAY_NANOS), ..grid }),
        ..spec("list")
    });
    let events = world::log(&spec_of_list, 5);
    let expected = compare_instructions(&spec_of_list, &events);
    compare("a list, on the disk, with starts", &digests_of_store(&spec_of_list, &events, 40, 0), &expected);
}
