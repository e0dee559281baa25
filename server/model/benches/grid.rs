//! Benchmark of the cells of an occupancy grid: sums over runs, training, scoring a day, predicting a map.
//!
//! `cargo bench -p tidemap-model --bench grid`; times are distinct and irregular, 168 periodicities.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use tidemap_model::{
    CellSums, Component, InstantPhasors, Periodicities, PhasorSum, PhasorTable, ReadingSums, RunningSums, ScoreSums,
    SpectralModel,
};

const DAY_NANOS: i64 = 86_400_000_000_000;
/// Number of times of a chunk, and of chunks of a day of 17,200 scans.
const TIMES: usize = 512;
const CHUNKS: i64 = 34;
const CELLS: u32 = 1_000;

/// One chunk of irregular times.
fn times(chunk: i64) -> Vec<i64> {
    let mut seed = 1_u64;
    let step = DAY_NANOS / (CHUNKS * TIMES as i64);
    (chunk * TIMES as i64..(chunk + 1) * TIMES as i64)
        .map(|i| {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            1_451_865_600_000_000_000 + i * step + (seed >> 33) as i64 % step
        })
        .collect()
}

/// A model of all 15 orders, different for each seed; predictions leave `[0,1]` if `swing` is large.
fn model(cell: u32, swing: f64) -> SpectralModel {
    let component = |k: u32| Component {
        periodicity: (cell * 7 + 11 * k) % 168,
        gamma_re: swing / f64::from(k + 2),
        gamma_im: 0.01 * swing * f64::from(k),
    };
    SpectralModel::from_parts(0.3, 100, (0..15).map(component).collect()).expect("a valid model")
}

/// Runs of a cell that is occupied now and then.
fn values(cell: u32) -> Vec<f64> {
    (0..TIMES as u32).map(|i| f64::from(u8::from((i / 50 + cell).is_multiple_of(3)))).collect()
}

fn sums(c: &mut Criterion) {
    let week = Periodicities::default();
    let phasors = PhasorTable::new(&week, &times(0));
    let mut running = RunningSums::new(&week);
    let mut group = c.benchmark_group("sums_168");
    group.throughput(Throughput::Elements(TIMES as u64));
    group.bench_function("extend_chunk_512", |b| b.iter(|| running.extend_chunk(black_box(&phasors))));
    group.throughput(Throughput::Elements(1));
    let mut cells = vec![PhasorSum::zero(&week); 10_000];
    let mut seed = 1_usize;
    group.bench_function("add_difference_in_cache", |b| {
        b.iter(|| {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            cells[0].add_difference(running.row((seed >> 33) % 512 + 1), running.row((seed >> 45) % 512));
        });
    });
    group.bench_function("add_difference_of_10000_cells", |b| {
        b.iter(|| {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let cell = (seed >> 20) % 10_000;
            cells[cell].add_difference(running.row((seed >> 33) % 512 + 1), running.row((seed >> 45) % 512));
        });
    });
    group.finish();
}

fn train(c: &mut Criterion) {
    let week = Periodicities::default();
    let mut running = RunningSums::new(&week);
    running.extend_chunk(&PhasorTable::new(&week, &times(0)));
    let mut b_sum = PhasorSum::zero(&week);
    b_sum.add_difference(running.row(TIMES), running.row(0));
    let cells: Vec<PhasorSum> = (0..CELLS as usize)
        .map(|cell| {
            let mut a = PhasorSum::zero(&week);
            for run in 0..5 {
                let start = (cell * 37 + run * 101) % 500;
                a.add_difference(running.row(start + 1 + cell % 11), running.row(start));
            }
            a
        })
        .collect();
    let mut group = c.benchmark_group("train_on_sums_168");
    group.throughput(Throughput::Elements(u64::from(CELLS)));
    for (name, days) in [("all_eligible", 28), ("one_day", 1)] {
        group.bench_function(name, |b| {
            b.iter(|| {
                for a in &cells {
                    let sums = CellSums {
                        observations: 512,
                        weight: 512.0,
                        mean: 0.08,
                        a,
                        b: &b_sum,
                        span_nanos: days * DAY_NANOS as u64,
                        gap_nanos: (0, 0),
                        levels: (0.1, 0.9),
                    };
                    black_box(SpectralModel::train_on_sums(sums, &week));
                }
            });
        });
    }
    group.finish();
}

fn score(c: &mut Criterion) {
    let week = Periodicities::default();
    let phasors = PhasorTable::new(&week, &times(0));
    let weights: Vec<f64> = (0..TIMES).map(|i| f64::from(u8::from(i % 90 < 70))).collect();
    let mut group = c.benchmark_group("score_512_times_16_orders");
    group.throughput(Throughput::Elements(u64::from(CELLS) * TIMES as u64));
    for (name, swing, weights, with_wrong) in [
        ("saturating", 0.2, None, false),
        ("within", 0.01, None, false),
        ("weighted", 0.2, Some(&weights[..]), false),
        ("with_wrong", 0.2, None, true),
    ] {
        let readings = |cell| {
            let mut readings = ReadingSums::default();
            for (i, value) in values(cell).into_iter().enumerate() {
                readings.push(std::iter::once(value).filter(|_| weights.is_none_or(|weights| weights[i] > 0.0)));
            }
            readings
        };
        let cells: Vec<(SpectralModel, ReadingSums)> =
            (0..CELLS).map(|cell| (model(cell, swing), readings(cell))).collect();
        group.bench_with_input(BenchmarkId::from_parameter(name), &cells, |b, cells| {
            b.iter(|| {
                let mut sums = ScoreSums::default();
                for (model, readings) in cells {
                    model.score_readings(&phasors, readings, &mut sums, with_wrong);
                }
                sums
            });
        });
    }
    group.finish();
}

fn predict(c: &mut Criterion) {
    let week = Periodicities::default();
    let cells: Vec<SpectralModel> = (0..CELLS).map(|cell| model(cell, 0.1)).collect();
    let instant = InstantPhasors::new(&week, times(0)[7]);
    let mut out = vec![0.0; cells.len()];
    let mut group = c.benchmark_group("predict_at");
    group.throughput(Throughput::Elements(u64::from(CELLS)));
    for order in [2, 15] {
        group.bench_with_input(BenchmarkId::new("order", order), &order, |b, &order| {
            b.iter(|| {
                for (out, model) in out.iter_mut().zip(&cells) {
                    *out = model.predict_at(order, &instant);
                }
                black_box(&out);
            });
        });
    }
    group.finish();
    let civil_nanos = times(0)[7];
    c.bench_function("instant_phasors_168", |b| b.iter(|| InstantPhasors::new(&week, black_box(civil_nanos))));
}

criterion_group!(benches, sums, train, score, predict);
criterion_main!(benches);
