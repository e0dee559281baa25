//! The cost of a grid: scans in the log, a checkpoint of many changed cells, a day of history. Bytes are printed.
//!
//! The day is hard to compress: flips are drawn at random, and times have nanoseconds.

use std::{hint::black_box, path::Path, sync::Arc, sync::mpsc, time::Duration, time::Instant};

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};
use tidemap_grid::{
    index::{TileId, TileIndex},
    scan::{CellRef, LoggedScan, ScanSource, Scans},
    spec::{GridSpec, Retention},
};
use tidemap_map::{
    event::{Envelope, Event, SequenceSpan, UpdateCause, UpdateStart},
    ids::ProducerId,
    live_map::LiveMap,
    name::{MapName, ProducerKey},
    snapshot::MapSnapshot,
    spec::MapSpec,
};
use tidemap_model::Periodicities;
use tidemap_store::{AppendError, MapId, MapLog, OpenedMap, Store, StoreOptions};

const SCANS: u64 = 17_200;
const PER_EVENT: u64 = 64;
const TILES: u32 = 300;
/// Cells that change, in each tile.
const CHANGING: u32 = 50;
const FLIPS: usize = 35;
const START_NANOS: i64 = 1_700_006_400_000_000_000;

fn spec() -> MapSpec {
    MapSpec {
        periodicities: Periodicities::harmonics(604_800_000_000_000, 168).expect("valid"),
        grid: Some(GridSpec { retention: Retention::Forever, ..GridSpec::new(0.1) }),
        ..MapSpec::new(MapName::new("bench").expect("valid"))
    }
}

/// One day of scans, in events.
fn events(random: &mut SmallRng, flips_per_scan: usize) -> Vec<Event> {
    let mut events = Vec::new();
    for first in (1..=SCANS).step_by(PER_EVENT as usize) {
        let count = PER_EVENT.min(SCANS + 1 - first);
        let mut scans = Vec::new();
        for number in first..first + count {
            let mut flips: Vec<CellRef> = (0..flips_per_scan)
                .map(|_| {
                    let (tile, cell) = (random.random_range(0..TILES), random.random_range(0..CHANGING));
                    CellRef::new(TileId(tile), (cell * 7) as u16)
                })
                .collect();
            flips.sort_unstable();
            flips.dedup();
            let jitter = random.random_range(0..1_000_000_000);
            let is_first = number == 1;
            let all = || (0..TILES * 512).map(CellRef).collect();
            scans.push(LoggedScan {
                utc_nanos: START_NANOS + number as i64 * 5_000_000_000 + jitter,
                offset_secs: 0,
                source: ScanSource::Cells,
                seen: is_first.then(|| (0..TILES).map(TileId).collect()),
                observed_flips: if is_first { all() } else { Vec::new() },
                occupied_flips: if is_first { Vec::new() } else { flips },
            });
        }
        events.push(Event::Scans(
            Envelope {
                producer: ProducerId(0),
                new_producer: (first == 1).then(|| ProducerKey::new("robot", "lidar").expect("valid").into()),
                incarnation: 1,
                span: SequenceSpan { first, last: first + count - 1, content_crc: 0 },
                received_nanos: START_NANOS + SCANS as i64 * 5_000_000_000,
                refused: Vec::new(),
            },
            Scans {
                new_tiles: if first == 1 {
                    (0..TILES as i32).map(|i| TileIndex { x: i % 20, y: i / 20, z: 0 }).collect()
                } else {
                    Vec::new()
                },
                scans,
                ..Scans::default()
            },
        ));
    }
    events
}

fn open(directory: &Path) -> (Store, MapId, OpenedMap) {
    let options = StoreOptions { new_store_id: "00".repeat(16), ..StoreOptions::default() };
    let store = Store::open(directory, options).expect("opens");
    let map = store.maps().first().map_or_else(|| store.create_map(&spec()).expect("creates"), |(map, _)| *map);
    let opened = store.open_map(map, &spec()).expect("opens");
    (store, map, opened)
}

/// Appends events; returns the time spent in the calls.
fn append(log: &MapLog, events: &[Event]) -> Duration {
    let (sender, receiver) = mpsc::channel::<Result<u64, AppendError>>();
    let mut calls = Duration::ZERO;
    for event in events {
        let sender = sender.clone();
        let start = Instant::now();
        log.append(black_box(event), Box::new(move |result| sender.send(result).expect("waiting"))).expect("queued");
        calls += start.elapsed();
    }
    for _ in events {
        receiver.recv().expect("answered").expect("durable");
    }
    calls
}

fn update() -> Event {
    let cut_nanos = START_NANOS + (SCANS as i64 + 2) * 5_000_000_000;
    Event::UpdateStart(UpdateStart { generation: 1, cut_nanos, cause: UpdateCause::Midnight })
}

/// The map after the day, as an update leaves it.
fn snapshot(events: &[Event]) -> MapSnapshot {
    let mut map = LiveMap::new(Arc::new(spec()));
    let mut position = 0;
    for event in events {
        position += 1;
        map.apply(position, event).expect("fits");
    }
    let work = map.apply(position + 1, &update()).expect("fits").expect("an update");
    let result = work.run(&std::sync::atomic::AtomicU64::new(0)).expect("runs");
    map.finish_update(result)
}

fn benches(criterion: &mut Criterion) {
    let mut random = SmallRng::seed_from_u64(1);
    let still = events(&mut random, 0);
    let busy = events(&mut random, FLIPS);
    let flips: u64 = busy.iter().map(flips_of).sum();
    let mut group = criterion.benchmark_group("scans of a day in the log");
    group.sample_size(10);
    for (what, events) in [("still", &still), ("busy", &busy)] {
        let directory = tempfile::tempdir().expect("temporary directory");
        let (store, map, opened) = open(directory.path());
        append(&opened.log, events);
        // The first event observes every cell for the first time.
        let first = {
            let other = tempfile::tempdir().expect("temporary directory");
            let (store, map, opened) = open(other.path());
            append(&opened.log, &events[..1]);
            store.sizes(map).log_bytes
        };
        println!("{what}: {} bytes, the first event {first}; {flips} flips when busy", store.sizes(map).log_bytes);
        drop((store, opened));
        group.throughput(Throughput::Elements(SCANS));
        group.bench_function(format!("{what}: read"), |bencher| {
            bencher.iter_custom(|count| {
                let read = |_| {
                    let (_store, _, opened) = open(directory.path());
                    let start = Instant::now();
                    black_box(opened.replay.map(|item| flips_of(&item.expect("readable").1)).sum::<u64>());
                    start.elapsed()
                };
                (0..count).map(read).sum()
            });
        });
        let directory = tempfile::tempdir().expect("temporary directory");
        let (_store, _, opened) = open(directory.path());
        group.bench_function(format!("{what}: encode and queue"), |bencher| {
            bencher.iter_custom(|count| (0..count).map(|_| append(&opened.log, events)).sum());
        });
    }
    group.finish();

    let mut snapshot = snapshot(&busy);
    let directory = tempfile::tempdir().expect("temporary directory");
    let (store, map, opened) = open(directory.path());
    append(&opened.log, &busy);
    append(&opened.log, &[update()]);
    store.save(map, &snapshot).expect("saves");
    println!("{:?}, history {:?}", store.sizes(map), store.history(map).expect("known").sizes());
    let mut group = criterion.benchmark_group("save of 15,000 changed cells");
    group.sample_size(10);
    group.bench_function("with history", |bencher| bencher.iter(|| store.save(map, &snapshot).expect("saves")));
    snapshot.history.clear();
    group.bench_function("checkpoint alone", |bencher| bencher.iter(|| store.save(map, &snapshot).expect("saves")));
    let history = store.history(map).expect("known");
    group.bench_function("read the day's history", |bencher| {
        bencher.iter(|| {
            history.grid_days(i64::MIN, i64::MAX, None).map(|day| day.expect("readable").models.len()).sum::<usize>()
        });
    });
    group.bench_function("read one tile of it", |bencher| {
        let tile = || Some(vec![TileId(7)]);
        bencher.iter(|| {
            history.grid_days(i64::MIN, i64::MAX, tile()).map(|day| day.expect("readable").models.len()).sum::<usize>()
        });
    });
    drop((opened, store));
    group.bench_function("open", |bencher| bencher.iter(|| open(directory.path()).2.source));
    group.finish();
}

fn flips_of(event: &Event) -> u64 {
    let Event::Scans(_, scans) = event else { return 0 };
    scans.scans.iter().map(|scan| scan.occupied_flips.len() as u64).sum()
}

criterion_group!(grids, benches);
criterion_main!(grids);
