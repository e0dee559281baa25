//! Times the plan of a day of tasks.
//!
//! `cargo bench -p tidemap-plan --bench tasks`: 10, 12, 30 and 100 tasks at places in a square, in 96 slots of a
//! quarter of an hour, half of them with values that change over the day.
#![allow(clippy::unwrap_used)]

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use rand::{Rng, SeedableRng, rngs::SmallRng};
use tidemap_model::StopSignal;
use tidemap_plan::tasks::{DayTask, Leg, LegTable, TaskDay, TaskValue, plan_tasks};

const SLOTS: usize = 96;

fn world(count: usize, seed: u64) -> (Vec<DayTask>, LegTable) {
    let mut random = SmallRng::seed_from_u64(seed);
    let mut at = || (random.random_range(0.0..600.0_f64), random.random_range(0.0..600.0_f64));
    let at: Vec<(f64, f64)> = (0..=count).map(|_| at()).collect();
    let legs = LegTable::new((900.0, SLOTS), count + 1, |slot, from, to| {
        let secs = (at[from].0 - at[to].0).hypot(at[from].1 - at[to].1);
        let rhythm = (slot as f64 / SLOTS as f64 * std::f64::consts::TAU + to as f64).cos();
        Some(Leg { secs: secs * (1.2 + 0.2 * rhythm), success: 0.8 - 0.15 * rhythm })
    });
    let tasks = (1..=count).map(|place| {
        let from_secs = f64::from(random.random_range(7..14_u8)) * 3_600.0;
        let until_secs = from_secs + f64::from(random.random_range(1..6_u8)) * 3_600.0;
        let value = if place % 2 == 0 {
            TaskValue::Fixed(random.random_range(1.0..5.0))
        } else {
            TaskValue::BySlot((0..SLOTS).map(|_| random.random_range(0.0..5.0)).collect())
        };
        let duration_secs = random.random_range(300.0..1_200.0);
        DayTask { place, from_secs, until_secs, duration_secs, value, persists: false }
    });
    (tasks.collect(), legs.unwrap())
}

fn plans(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("tasks");
    group.sample_size(10);
    for count in [10, 12, 30, 100] {
        let (tasks, legs) = world(count, 1);
        let day = TaskDay { tasks: &tasks, legs: &legs, start: 0, ready_secs: 6.0 * 3_600.0 };
        let plan = plan_tasks(&day, StopSignal::NEVER).unwrap();
        println!("{count} tasks: {} planned, proven: {}", plan.steps.len(), plan.is_proven);
        group.bench_function(BenchmarkId::from_parameter(count), |bench| {
            bench.iter(|| black_box(plan_tasks(&day, StopSignal::NEVER).unwrap().expected_value));
        });
    }
    group.finish();
}

criterion_group!(benches, plans);
criterion_main!(benches);
