//! The cost of an append: on the caller's thread, and until it is durable on this disk.
//!
//! Durable figures depend on the disk: the p50 of fdatasync is printed beside them.

use std::{
    hint::black_box,
    sync::mpsc,
    time::{Duration, Instant},
};

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use tidemap_map::{
    event::{Envelope, Event, Observations, OffsetRun, SequenceSpan},
    ids::{ProducerId, StateId},
    name::MapName,
    spec::MapSpec,
};
use tidemap_store::{AppendError, MapLog, Store, StoreOptions};

/// Observations in a batch.
const COUNT: u32 = 4096;
/// Batches that wait for the disk at a time.
const IN_FLIGHT: usize = 64;

fn batch(is_binary: bool) -> Event {
    let numbers = 0..u64::from(COUNT);
    Event::Observations(
        Envelope {
            producer: ProducerId(0),
            new_producer: None,
            incarnation: 1,
            span: SequenceSpan { first: 1, last: u64::from(COUNT), content_crc: 0 },
            received_nanos: 1_700_000_000_000_000_000,
            refused: Vec::new(),
        },
        Observations {
            new_states: Vec::new(),
            states: numbers.clone().map(|i| StateId((i * 7 % 1000) as u32)).collect(),
            times_nanos: numbers.clone().map(|i| 1_700_000_000_000_000_000 + (i * i % 97) as i64 * 1_000_000).collect(),
            values: numbers.map(|i| if is_binary { (i % 2) as f64 } else { (i % 101) as f64 / 100.0 }).collect(),
            offsets: vec![OffsetRun { count: COUNT, offset_secs: 3600 }],
            failures: Vec::new(),
            runs: Vec::new(),
        },
    )
}

/// Appends `count` events; returns the time spent in the calls.
fn append(log: &MapLog, event: &Event, count: u64) -> Duration {
    let (sender, receiver) = mpsc::channel::<Result<u64, AppendError>>();
    let mut calls = Duration::ZERO;
    let mut waiting = 0;
    for _ in 0..count {
        if waiting == IN_FLIGHT {
            receiver.recv().expect("answered").expect("durable");
            waiting -= 1;
        }
        let sender = sender.clone();
        let start = Instant::now();
        let done = Box::new(move |result| sender.send(result).expect("waiting"));
        log.append(black_box(event), done).expect("queued");
        calls += start.elapsed();
        waiting += 1;
    }
    for _ in 0..waiting {
        receiver.recv().expect("answered").expect("durable");
    }
    calls
}

fn benches(criterion: &mut Criterion) {
    let directory = tempfile::tempdir().expect("temporary directory");
    let options = StoreOptions { new_store_id: "00".repeat(16), ..StoreOptions::default() };
    let store = Store::open(directory.path(), options).expect("opens");
    let spec = MapSpec::new(MapName::new("bench").expect("valid"));
    let map = store.create_map(&spec).expect("creates");
    let log = store.open_map(map, &spec).expect("opens").log;
    let mut group = criterion.benchmark_group("append batches of 4096 observations");
    for (what, event) in [("binary", batch(true)), ("doubles", batch(false))] {
        group.throughput(Throughput::Elements(u64::from(COUNT))).sample_size(20);
        group.bench_function(format!("{what}: encode and queue"), |bencher| {
            bencher.iter_custom(|count| append(&log, &event, count));
        });
        group.bench_function(format!("{what}: durable, one at a time"), |bencher| {
            bencher.iter(|| append(&log, &event, 1));
        });
        group.throughput(Throughput::Elements(u64::from(COUNT) * 64));
        group.bench_function(format!("{what}: durable, 64 at a time"), |bencher| {
            bencher.iter(|| append(&log, &event, 64));
        });
    }
    group.finish();
    println!("fdatasync: {:?}, sizes: {:?}", store.sync_stats(), store.sizes(map));
}

criterion_group!(append_batches, benches);
criterion_main!(append_batches);
