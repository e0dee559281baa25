//! Times views in an office, at one time and over a day, and tours through it.
//!
//! `cargo bench -p tidemap-plan --bench views`. The range of the sensor is 4 m, 360° x 90°, in cells of 0.1 m. "hall"
//! is an unobstructed view.

use std::{
    hint::black_box,
    ops::ControlFlow,
    sync::{Arc, LazyLock},
};

use criterion::{Criterion, criterion_group, criterion_main};
use tidemap_grid::{
    index::{CellBox, CellIndex},
    spec::GridSpec,
};
use tidemap_map::reachability::Reachability;
use tidemap_model::StopSignal;
use tidemap_plan::{
    predicted::{Lattice, PredictedTimes},
    tour::{TourQuestion, plan_tour, plan_tour_with},
    view::{Fan, Scene, SceneOptions, Sensor, TimedScene, ViewLimits, ViewScorer, Viewpoint, view_many},
};

use crate::office::{Office, SIZE, TIMES};

#[path = "views/office.rs"]
mod office;

fn lattice(size: [i32; 3]) -> Arc<Lattice> {
    let spec = GridSpec::new(0.1);
    let region = CellBox { min: CellIndex::default(), max: CellIndex { x: size[0], y: size[1], z: size[2] } };
    Arc::new(Lattice::new(&spec, region, 1 << 24).expect("small"))
}

static DAY: LazyLock<PredictedTimes> = LazyLock::new(|| {
    let office = Office::new();
    PredictedTimes::from_fn(lattice(SIZE), TIMES, |cell, time| office.probability(cell, time)).expect("times")
});

fn looks(c: &mut Criterion) {
    let mut group = c.benchmark_group("look");
    let sensor = Sensor::default();
    let hall = PredictedTimes::from_fn(lattice([100, 100, 100]), 1, |_, _| Some(0.3)).expect("a time");
    let scene = Scene::new(&hall.at(0).expect("a time"), &SceneOptions::default()).expect("valid");
    group.bench_function("rays", |b| b.iter(|| Fan::new(&sensor, scene.lattice(), 0.0)));
    let fan = Fan::new(&sensor, scene.lattice(), 0.0).expect("valid");
    println!("hall: {} rays, {} nodes, {} cells", fan.rays(), fan.len(), fan.cells());
    let mut scorer = ViewScorer::new(&fan);
    group.bench_function("hall", |b| b.iter(|| scorer.view(&scene, &fan, CellIndex { x: 50, y: 50, z: 50 })));
    let office = Office::new();
    let day = &*DAY;
    let scene = Scene::new(&day.at(48).expect("a time"), &SceneOptions::default()).expect("valid");
    let fan = Fan::new(&sensor, scene.lattice(), 0.0).expect("valid");
    println!("office: {} rays, {} nodes, {} cells", fan.rays(), fan.len(), fan.cells());
    let mut scorer = ViewScorer::new(&fan);
    let viewpoints = office.viewpoints(500, day, &sensor);
    let cells: Vec<CellIndex> = viewpoints.iter().filter_map(|at| scene.stand(&sensor, at).ok()).collect();
    group.bench_function("office_500", |b| {
        b.iter(|| cells.iter().map(|&at| scorer.view(&scene, &fan, at).information_bits).sum::<f64>());
    });
    group.finish();
}

fn day(c: &mut Criterion) {
    let mut group = c.benchmark_group("day");
    group.sample_size(10);
    let (office, sensor) = (Office::new(), Sensor::default());
    let day = &*DAY;
    let viewpoints = office.viewpoints(500, day, &sensor);
    println!("{} cells, {} vary, {} viewpoints, {TIMES} times", day.lattice().held(), day.varying(), viewpoints.len());
    group.bench_function("scene_96", |b| b.iter(|| TimedScene::new(day, &SceneOptions::default(), StopSignal::NEVER)));
    let scene = TimedScene::new(day, &SceneOptions::default(), StopSignal::NEVER).expect("valid");
    let run = |viewpoints: &[Viewpoint]| {
        let mut sum = 0.0;
        let outcome = view_many(&scene, &sensor, viewpoints, ViewLimits::default(), StopSignal::NEVER, |_, view| {
            sum += view.into_iter().flatten().flatten().sum::<f64>();
            ControlFlow::Continue(())
        });
        outcome.expect("little work");
        sum
    };
    group.bench_function("views_500_times_96", |b| b.iter(|| run(black_box(&viewpoints))));
    let single = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    group.bench_function("views_500_times_96_one_thread", |b| {
        b.iter(|| {
            let mut sum = 0.0;
            single.install(|| {
                let outcome =
                    view_many(&scene, &sensor, &viewpoints, ViewLimits::default(), StopSignal::NEVER, |_, view| {
                        sum += view.into_iter().flatten().flatten().sum::<f64>();
                        ControlFlow::Continue(())
                    });
                outcome.expect("little work");
            });
            sum
        });
    });
    group.finish();
}

fn tours(c: &mut Criterion) {
    let mut group = c.benchmark_group("tour");
    group.sample_size(20);
    let grid = DAY.at(48).expect("a time");
    let reachability = Reachability::default();
    for (name, goals, spacing_m) in
        [("6_goals", 6, 0.5), ("12_goals", 12, 0.5), ("6_goals_of_500", 6, 0.325), ("6_goals_of_many", 6, 0.2)]
    {
        let question = TourQuestion { start_m: [10.0, 6.4], goals, spacing_m, ..TourQuestion::default() };
        let tour = plan_tour(&grid, &reachability, &question, StopSignal::NEVER).expect("valid");
        println!(
            "{name}: {} goals of {} candidates, {:.0} bits, {:.0} m",
            tour.steps.len(),
            tour.candidates,
            tour.information_bits,
            tour.length_m
        );
        group.bench_function(name, |b| b.iter(|| plan_tour(&grid, &reachability, &question, StopSignal::NEVER)));
        let fan = Fan::new(&question.sensor, grid.lattice(), 0.0).expect("valid");
        let with_rays = format!("{name}_rays_at_hand");
        group.bench_function(with_rays, |b| {
            b.iter(|| plan_tour_with(&fan, &grid, &reachability, &question, StopSignal::NEVER));
        });
    }
    group.finish();
}

criterion_group!(benches, looks, day, tours);
criterion_main!(benches);
