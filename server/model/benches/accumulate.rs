//! Benchmark of adding observations to one state, against the loop of the published method.
//!
//! `cargo bench -p tidemap-model --bench accumulate`; all times are distinct and irregular.

use std::f64::consts::TAU;
use std::hint::black_box;

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use tidemap_model::{Accumulator, OrderCriterion, Periodicities, Sample, StateModel};

const DAY_NANOS: i64 = 86_400_000_000_000;

/// Irregular times over `days`, about half of the values 0.
fn samples(count: usize, days: i64) -> Vec<Sample> {
    let mut seed = 1_u64;
    (0..count as i64)
        .map(|i| {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let jitter = (seed >> 40) as i64;
            let utc_nanos = 1_451_865_600_000_000_000 + i * (days * DAY_NANOS / count as i64) + jitter;
            let value = if seed >> 63 == 0 { 0.0 } else { (seed >> 11) as f64 / (1_u64 << 53) as f64 };
            Sample { utc_nanos, offset_secs: 0, value }
        })
        .collect()
}

/// T-RO eq. 11 as published: one sincos per observation and periodicity.
fn naive(spectrum: &mut [[f64; 4]], periodicities: &Periodicities, samples: &[Sample]) {
    let omegas: Vec<f64> = (0..periodicities.len()).map(|k| TAU / periodicities.period_secs(k)).collect();
    for sample in samples {
        let t = (sample.civil_nanos() % (7 * DAY_NANOS)) as f64 / 1e9;
        for (entry, omega) in spectrum.iter_mut().zip(&omegas) {
            let (sin, cos) = (omega * t).sin_cos();
            entry[0] += sample.value * cos;
            entry[1] -= sample.value * sin;
            entry[2] += cos;
            entry[3] -= sin;
        }
    }
}

fn accumulate(c: &mut Criterion) {
    let week = Periodicities::default();
    let observed = samples(10_000, 28);
    let mut group = c.benchmark_group("accumulate_168");
    group.throughput(Throughput::Elements(observed.len() as u64));
    group.sample_size(20);
    group.bench_function("harmonics", |b| {
        b.iter_batched(
            || Accumulator::new(&week),
            |mut accumulator| {
                accumulator.add(&week, black_box(&observed));
                accumulator
            },
            BatchSize::SmallInput,
        );
    });
    let list = Periodicities::list((1..=168).map(|k| 7 * DAY_NANOS / k).collect()).expect("a valid list");
    group.bench_function("list", |b| {
        b.iter_batched(
            || Accumulator::new(&list),
            |mut accumulator| {
                accumulator.add(&list, black_box(&observed));
                accumulator
            },
            BatchSize::SmallInput,
        );
    });
    group.bench_function("naive", |b| {
        b.iter(|| {
            let mut spectrum = vec![[0.0; 4]; week.len()];
            naive(&mut spectrum, &week, black_box(&observed));
            spectrum
        });
    });
    group.finish();

    let single = &observed[..1];
    c.bench_function("accumulate_168/single_observation", |b| {
        let mut accumulator = Accumulator::new(&week);
        b.iter(|| accumulator.add(&week, black_box(single)));
    });
}

fn update(c: &mut Criterion) {
    let week = Periodicities::default();
    let history = samples(28 * 288, 28);
    let (before, day) = history.split_at(27 * 288);
    let mut state = StateModel::new(&week);
    state.update(&week, OrderCriterion::SquaredError, before.to_vec());
    let mut group = c.benchmark_group("day_of_288");
    group.throughput(Throughput::Elements(day.len() as u64));
    group.bench_function("accumulate", |b| {
        b.iter_batched_ref(
            || state.accumulator().clone(),
            |accumulator| accumulator.add(&week, black_box(day)),
            BatchSize::SmallInput,
        );
    });
    group.bench_function("update", |b| {
        b.iter_batched_ref(
            || (state.clone(), day.to_vec()),
            |(state, day)| state.update(&week, OrderCriterion::SquaredError, std::mem::take(day)),
            BatchSize::SmallInput,
        );
    });
    group.finish();
}

criterion_group!(benches, accumulate, update);
criterion_main!(benches);
