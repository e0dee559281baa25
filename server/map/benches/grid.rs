//! An occupancy grid on the day of T-RO 2017, section VI: 416 tiles, 17,200 scans, 600,000 changes, 168 periodicities.
//!
//! Run it with `cargo bench -p tidemap-map --bench grid`. The update of the first day accumulates and trains; the
//! update of the second day also scores, with models of 15 components. Updates run on one thread.

use std::{hint::black_box, sync::Arc, sync::atomic::AtomicU64};

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use tidemap_grid::{
    index::TileId,
    log_head::LogHead,
    spec::{GridSpec, Retention},
};
use tidemap_map::{
    event::{Event, UpdateCause},
    live_map::LiveMap,
    snapshot::MapSnapshot,
    spec::MapSpec,
    update::UpdateWork,
};
use tidemap_model::{
    InstantPhasors,
    selector::{Blend, ModelKind, ModelSelector},
};

use crate::office::{CELLS, DAY_NANOS, FLIPS, Office, SCANS, TILES, apply, spec};

#[path = "grid/office.rs"]
mod office;

/// Number of scans of an event.
const BATCH: usize = 100;

fn learn(map: &mut LiveMap, day: i64) -> UpdateWork {
    let cut_nanos = (day + 1) * DAY_NANOS;
    let start = map.plan_update(Some(cut_nanos), cut_nanos, UpdateCause::Midnight);
    apply(map, &Event::UpdateStart(start)).expect("an update")
}

fn finish(map: &mut LiveMap, work: UpdateWork) -> MapSnapshot {
    map.finish_update(work.run(&AtomicU64::new(0)).expect("in memory"))
}

/// A map that has learned a day, and the map's update.
fn full(spec: &Arc<MapSpec>, before: Option<&MapSnapshot>, events: &[Event], day: i64) -> (LiveMap, UpdateWork) {
    let mut map = match before {
        Some(snapshot) => LiveMap::restore(Arc::clone(spec), snapshot.clone()),
        None => LiveMap::new(Arc::clone(spec)),
    };
    for event in events {
        apply(&mut map, event);
    }
    let work = learn(&mut map, day);
    (map, work)
}

fn day(c: &mut Criterion) {
    let (spec, keeping) = (spec(Retention::None), spec(Retention::Forever));
    let forgetting = Arc::new(MapSpec {
        grid: spec.grid.clone().map(|grid| GridSpec { half_life_nanos: Some(60 * DAY_NANOS), ..grid }),
        ..MapSpec::clone(&spec)
    });
    let mut office = Office::new();
    let mut map = LiveMap::new(Arc::clone(&spec));
    let sent = office.day(0);
    let first = Office::events(&mut map, &sent, BATCH);
    let work = learn(&mut map, 0);
    let snapshot = finish(&mut map, work);
    let mut second_map = LiveMap::restore(Arc::clone(&spec), snapshot.clone());
    let second = Office::events(&mut second_map, &office.day(1), BATCH);
    let work = learn(&mut second_map, 1);
    let learned = finish(&mut second_map, work);
    report(&learned, second_map);
    let (mut map, work) = full(&forgetting, None, &first, 0);
    let forgotten = finish(&mut map, work);
    let (mut map, work) = full(&forgetting, Some(&forgotten), &second, 1);
    print!("with a half-life: ");
    let work = finish(&mut map, work);
    report(&work, map);

    let mut group = c.benchmark_group("grid_day");
    group.sample_size(10);
    group.throughput(Throughput::Elements(SCANS as u64));
    let opened = || {
        let mut map = LiveMap::new(Arc::clone(&spec));
        apply(&mut map, &first[0]);
        map.publish();
        map
    };
    group.bench_function("apply", |b| {
        b.iter_batched_ref(
            opened,
            |map| first[1..].iter().for_each(|event| _ = apply(map, event)),
            BatchSize::PerIteration,
        );
    });
    group.bench_function("apply_and_publish_each_100", |b| {
        b.iter_batched_ref(
            || (opened(), Vec::with_capacity(1)),
            |(map, views)| {
                for event in &first[1..] {
                    apply(map, event);
                    views.clear();
                    views.push(map.publish());
                }
            },
            BatchSize::PerIteration,
        );
    });
    let empty = LiveMap::new(Arc::clone(&spec));
    let grid = empty.grid().expect("a grid");
    group.bench_function("front", |b| {
        b.iter_batched_ref(
            || (LogHead::new(grid), Office::source()),
            |(front, source)| {
                for scan in &sent {
                    let _ = black_box(front.take(grid, 1, source, scan, 0, TILES));
                }
            },
            BatchSize::PerIteration,
        );
    });
    group.throughput(Throughput::Elements(FLIPS as u64));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    for (name, spec, before, events, day) in [
        ("update_accumulate", &spec, None, &first, 0),
        ("update_score_too", &spec, Some(&snapshot), &second, 1),
        ("update_score_with_half_life", &forgetting, Some(&forgotten), &second, 1),
        ("update_score_and_keep_history", &keeping, Some(&snapshot), &second, 1),
    ] {
        group.bench_function(name, |b| {
            b.iter_batched(
                || full(spec, before, events, day),
                |(map, work)| (map, pool.install(|| work.run(&AtomicU64::new(0)))),
                BatchSize::PerIteration,
            );
        });
    }
    group.finish();
    predict(c, &spec, learned);
}

fn predict(c: &mut Criterion, spec: &Arc<MapSpec>, learned: MapSnapshot) {
    let mut map = LiveMap::restore(Arc::clone(spec), learned);
    let view = map.publish();
    let grid = view.grid().expect("a grid");
    let at = 2 * DAY_NANOS + DAY_NANOS / 3;
    let phasors = InstantPhasors::new(&spec.periodicities, at);
    let mut group = c.benchmark_group("grid_predict");
    group.throughput(Throughput::Elements((TILES * 512) as u64));
    let spectral = |order, blend| ModelSelector { kind: ModelKind::Spectral, order: Some(order), blend };
    for (name, selector) in [
        ("default", ModelSelector::default()),
        ("order_2", spectral(2, Blend::None)),
        ("order_15", spectral(15, Blend::None)),
        ("persistence", spectral(2, Blend::Persistence)),
    ] {
        group.bench_function(name, |b| {
            b.iter(|| {
                for tile in (0..TILES as u32).map(TileId) {
                    black_box(grid.predict_tile(tile, at, &phasors, selector)).expect("in memory");
                }
            });
        });
    }
    group.finish();
}

/// Measures tiles whose cells are each observed at different times, as at the edge of sight: every cell is a group.
fn flicker(c: &mut Criterion) {
    const SOME: usize = 16;
    let spec = spec(Retention::None);
    let mut map = LiveMap::new(Arc::clone(&spec));
    let events = Office::events(&mut map, &Office::new().flickering_day(SOME, 2_000), BATCH);
    let work = learn(&mut map, 0);
    let snapshot = finish(&mut map, work);
    let sums: usize = snapshot.grid.iter().flat_map(|grid| &grid.sums).map(|sums| sums.bytes()).sum();
    println!("flickering: sums {} B a tile", sums / SOME);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let mut group = c.benchmark_group("grid_flicker");
    group.sample_size(10);
    group.throughput(Throughput::Elements(SOME as u64));
    group.bench_function("update_16_tiles", |b| {
        b.iter_batched(
            || full(&spec, None, &events, 0),
            |(map, work)| (map, pool.install(|| work.run(&AtomicU64::new(0)))),
            BatchSize::PerIteration,
        );
    });
    group.finish();
}

/// Measures the memory of tiles that a robot sees on its rounds, each time other cells of them, after some days.
fn patrol(_: &mut Criterion) {
    const SOME: usize = 16;
    let spec = spec(Retention::None);
    let (mut map, mut office) = (LiveMap::new(Arc::clone(&spec)), Office::new());
    for day in 0..112 {
        Office::events(&mut map, &office.patrol_day(day, SOME, 10, 50), BATCH);
        let work = learn(&mut map, day);
        let snapshot = finish(&mut map, work);
        if (day + 1) % 14 == 0 {
            let sums: usize = snapshot.grid.iter().flat_map(|grid| &grid.sums).map(|sums| sums.bytes()).sum();
            println!("patrol, day {}: sums and runs {} B a tile", day + 1, sums / SOME);
        }
    }
}

/// Reports the memory of the grid.
fn report(learned: &MapSnapshot, mut map: LiveMap) {
    let view = map.publish();
    let grid = view.grid().expect("a grid");
    let tiles = || (0..TILES as u32).map(TileId);
    let live: usize = tiles().filter_map(|tile| grid.live(tile)).map(|tile| tile.bytes()).sum();
    let models: Vec<_> = tiles().filter_map(|tile| grid.model(tile).ok()).collect();
    let model: usize = models.iter().map(|model| model.bytes()).sum();
    let changed: usize = models.iter().map(|model| model.cells.len()).sum();
    let sums: usize = learned.grid.iter().flat_map(|grid| &grid.sums).map(|sums| sums.bytes()).sum();
    let orders = models.iter().flat_map(|model| &model.cells).map(|cell| usize::from(cell.order)).sum::<usize>();
    println!("{changed} of {CELLS} cells changed, mean order {:.1}", orders as f64 / changed as f64);
    println!("live {} B a tile", live / TILES);
    println!("models {} B a changed cell, sums {} B (shared ones counted each)", model / changed, sums / changed);
}

criterion_group!(benches, day, flicker, patrol);
criterion_main!(benches);
