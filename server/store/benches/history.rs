//! The reading of history to train models again: twelve weeks of minutes of many states, one history file per night.
//!
//! `cargo bench -p tidemap-store --bench history`. The files are in the page cache. Measured once.

use std::{sync::Arc, time::Instant};

use tidemap_map::{
    event::{Event, UpdateCause},
    history::{
        HistoryPiece,
        origins::{OriginRun, Origins},
    },
    ids::{ProducerId, StateId},
    live_map::LiveMap,
    name::MapName,
    snapshot::MapSnapshot,
    spec::MapSpec,
    training::{ReadingsRequest, TRAINING_READINGS},
};
use tidemap_model::Sample;
use tidemap_store::{MapId, Store, StoreOptions};

const STATES: u32 = 1_000;
const NIGHTS: i64 = 84;
const MINUTE: i64 = 60_000_000_000;

fn piece(night: i64) -> Arc<HistoryPiece> {
    let sample = |state: u32, minute: i64| Sample {
        utc_nanos: (night * 1440 + minute) * MINUTE + i64::from(state) * 1_000_000,
        offset_secs: 3600,
        value: f64::from(u8::from((500 + i64::from(state % 90)..1_000).contains(&minute) && minute % 17 != 3)),
    };
    let samples_of = |state: u32| (StateId(state), (0..1440).map(|minute| sample(state, minute)).collect());
    let run = OriginRun { producer: ProducerId(0), first: night as u64 * 1440 + 1, count: 1440 };
    let origins = Origins { runs: vec![run], ..Origins::default() };
    Arc::new(HistoryPiece {
        from_nanos: night * 1440 * MINUTE,
        to_nanos: (night + 1) * 1440 * MINUTE,
        states: (0..STATES).map(samples_of).collect(),
        origins: vec![origins; STATES as usize],
        ..HistoryPiece::new(night as u64 + 1)
    })
}

fn main() {
    let spec = MapSpec::new(MapName::new("bench").expect("valid"));
    let folder = tempfile::tempdir().expect("temporary folder");
    let options = StoreOptions { new_store_id: "00".repeat(16), ..StoreOptions::default() };
    let store = Store::open(folder.path(), options).expect("a store");
    store.create_map(&spec).expect("created");
    let mut map = LiveMap::new(Arc::new(spec));
    let start = map.plan_update(None, 0, UpdateCause::Request);
    let work = map.apply(1, &Event::UpdateStart(start)).expect("consistent").expect("an update");
    let empty = map.finish_update(work.run(&std::sync::atomic::AtomicU64::new(0)).expect("in memory"));
    for night in 0..NIGHTS {
        store.save(MapId(1), &MapSnapshot { history: vec![piece(night)], ..empty.clone() }).expect("saved");
    }
    let history = store.history(MapId(1)).expect("known");
    println!("{} MB of history", history.sizes().expect("readable").state_bytes >> 20);

    let started = Instant::now();
    let files = history.state_files().expect("readable");
    println!("{NIGHTS} files found in {:.1} ms", started.elapsed().as_secs_f64() * 1e3);
    let batch = (TRAINING_READINGS / (NIGHTS as u64 * 1440)) as usize;
    let wanted: Vec<ReadingsRequest> =
        (0..STATES).map(|state| ReadingsRequest { state: StateId(state), from_nanos: 0 }).collect();
    let started = Instant::now();
    let mut readings = 0;
    for batch in wanted.chunks(batch) {
        readings += files.readings(batch).expect("readable").iter().map(Vec::len).sum::<usize>();
    }
    let secs = started.elapsed().as_secs_f64();
    println!("{readings} readings of {STATES} states, {batch} states at a time: {secs:.2} s on one thread");
}
