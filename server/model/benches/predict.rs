//! Benchmark of predicting many states at many times over shared phasors, against a cosine per component.
//!
//! `cargo bench -p tidemap-model --bench predict`

use std::f64::consts::TAU;
use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use tidemap_model::{Component, Periodicities, PhasorTable, SpectralModel};

const STATES: u32 = 1_000;
const TIMES: i64 = 1_000;
const ORDER: usize = 2;

fn predict(c: &mut Criterion) {
    let week = Periodicities::default();
    let models: Vec<SpectralModel> = (0..STATES)
        .map(|i| {
            let component =
                |k: u32| Component { periodicity: (i * 7 + k) % 168, gamma_re: 0.1, gamma_im: 0.001 * f64::from(k) };
            SpectralModel::from_parts(0.3, 100, (0..5).map(|k| component(31 * k)).collect()).expect("a valid model")
        })
        .collect();
    let civil_nanos: Vec<i64> = (0..TIMES).map(|i| 1_458_518_400_000_000_000 + i * 61_000_000_000).collect();
    let mut out = vec![0.0; civil_nanos.len()];

    let mut group = c.benchmark_group("predict_1000x1000_order_2");
    group.throughput(Throughput::Elements(u64::from(STATES) * TIMES as u64));
    group.sample_size(20);
    group.bench_function("table_and_sweep", |b| {
        b.iter(|| {
            let table = PhasorTable::new(&week, black_box(&civil_nanos));
            for model in &models {
                model.predict_into(ORDER, &table, &mut out);
                black_box(&out);
            }
        });
    });
    group.bench_function("naive", |b| {
        b.iter(|| {
            for model in &models {
                let terms: Vec<(f64, f64, f64)> = model.components()[..ORDER]
                    .iter()
                    .map(|c| (TAU / week.period_secs(c.periodicity as usize), c.amplitude(), c.phase_rad()))
                    .collect();
                for (out, &civil) in out.iter_mut().zip(black_box(&civil_nanos)) {
                    let t = (civil % 604_800_000_000_000) as f64 / 1e9;
                    let p = terms.iter().fold(model.mean(), |p, (omega, a, phase)| p + a * (omega * t + phase).cos());
                    *out = p.clamp(0.0, 1.0);
                }
                black_box(&out);
            }
        });
    });
    group.finish();

    let mut group = c.benchmark_group("phasor_table_168x1000");
    group.throughput(Throughput::Elements(168 * TIMES as u64));
    group.bench_function("new", |b| b.iter(|| PhasorTable::new(&week, black_box(&civil_nanos))));
    group.finish();

    c.bench_function("predict_single/order_2", |b| {
        b.iter(|| models[0].predict(&week, ORDER, black_box(civil_nanos[7])));
    });
}

criterion_group!(benches, predict);
criterion_main!(benches);
