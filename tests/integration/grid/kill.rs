//! kill -9 while scans stream in and while updates in the time of the data run: the remaining data are those of an
//! undisturbed daemon.

use std::{
    path::Path,
    time::{Duration, Instant},
};

use rand::Rng as _;
use tempfile::tempdir;
use tidemap_client::{
    maps::{GridSummary, Retention},
    observe::{Producer, ProducerOptions, scan::Scan, tiles::Mask},
    queries::{CellPrediction, ModelDescription, ModelKind, WholeGrid},
    updates::{Job, JobCause, JobState},
};
use tidemap_tests::{
    daemon::{Daemon, Launch, lasting_port},
    disk,
    film::Film,
    oracle::{run_update, settled},
    rounds,
};

use super::{MAP, grid, model, new_map, predicted, summary};

/// Small segments, so that some of them are deleted before the end. The address stays the same after each restart.
fn launch(data: &Path) -> Launch {
    let launch = Launch::on(data).setting("segment_bytes", 1 << 16);
    launch.setting("listen", format!("127.0.0.1:{}", lasting_port()))
}

async fn opened(daemon: &Daemon) -> Producer {
    let options = ProducerOptions {
        nightly: true,
        patience: Duration::from_secs(120),
        window: 512,
        ..ProducerOptions::new("camera", "", MAP)
    };
    Producer::open(&daemon.client(), options).await.expect("a Welcome")
}

async fn send(producer: &mut Producer, film: &Film, scans: &[(i64, Vec<Mask>)]) {
    for (time, occupied) in scans {
        producer.send_scan(*time, Scan::Tiles(film.seen(occupied))).await.expect("taken");
    }
}

/// The summary of a map's grid.
struct Answers {
    summary: GridSummary,
    grids: Vec<WholeGrid>,
    models: Vec<ModelDescription>,
}

async fn answers(daemon: &Daemon, film: &Film) -> Answers {
    let (from, to) = (film.time(0), film.time(film.scans() - 1));
    let mut grids = Vec::new();
    for kind in [model(ModelKind::Latest, None), model(ModelKind::Mean, None), model(ModelKind::Auto, None)] {
        grids.push(predicted(daemon, to + 1, kind).await);
    }
    for time in [from + 36_000_000_000_000, to - 50_000_000_000_000, to + 300_000_000_000_000] {
        grids.push(predicted(daemon, time, model(ModelKind::Spectral, Some(2))).await);
    }
    let mut models = Vec::new();
    for cell in film.changing(16).chain(film.still(1_500)) {
        models.push(daemon.client().describe_model(MAP, &film.name(cell)).await.expect("a cell"));
    }
    Answers { summary: summary(daemon).await, grids, models }
}

fn near(one: f64, other: f64) -> bool {
    (one - other).abs() <= 1e-9 * (1.0 + one.abs())
}

fn compare(found: &Answers, expected: &Answers) {
    assert_eq!(found.summary, expected.summary);
    for (at, (found, expected)) in found.grids.iter().zip(&expected.grids).enumerate() {
        assert_eq!(found.header.region, expected.header.region);
        assert_eq!(found.tiles.len(), expected.tiles.len());
        for (one, other) in found.tiles.iter().zip(&expected.tiles) {
            assert_eq!(one.place, other.place);
            for (place, cells) in one.cells.iter().zip(other.cells.iter()).enumerate() {
                let same = match cells {
                    (CellPrediction::Changing(one), CellPrediction::Changing(other)) => (one - other).abs() < 1e-6,
                    (one, other) => one == other,
                };
                assert!(same, "question {at}, tile {:?}, place {place}: {cells:?}", one.place);
            }
        }
    }
    for (one, other) in found.models.iter().zip(&expected.models) {
        let facts = |model: &ModelDescription| {
            let times = (model.first_nanos, model.last_nanos);
            (model.state.clone(), model.order, model.learned_observations, model.observations, times)
        };
        assert_eq!(facts(one), facts(other));
        assert!(near(one.mean, other.mean) && near(one.persistence_tau_secs, other.persistence_tau_secs), "{one:?}");
        assert_eq!(one.components.len(), other.components.len(), "{one:?}\n{other:?}");
        for (one, other) in one.order_errors.iter().zip(&other.order_errors) {
            assert!(near(*one, *other), "{one} and {other}");
        }
    }
}

/// Segments of the log, by name.
fn segments(data: &Path) -> Vec<String> {
    let logs = disk::files(data).into_iter().filter(|file| file.extension().is_some_and(|ending| ending == "log"));
    logs.map(|file| file.display().to_string()).collect()
}

async fn generation(daemon: &Daemon) -> u64 {
    daemon.client().map(MAP).await.expect("the map").last_update.generation
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_grid_survives_kills_while_scans_stream_and_updates_run() {
    let film = Film::new(6, 2_000);
    let scans: Vec<(i64, Vec<Mask>)> = film.run().collect();
    let undisturbed = tempdir().expect("a folder");
    let expected = {
        let daemon = launch(undisturbed.path()).start();
        daemon.client().create_map(new_map(grid(Retention::None))).await.expect("a new map");
        let mut producer = opened(&daemon).await;
        send(&mut producer, &film, &scans).await;
        producer.close().await.expect("durable");
        run_update(&daemon.client(), MAP, None).await;
        answers(&daemon, &film).await
    };
    assert_eq!((expected.summary.scans, expected.summary.pending_scans), (12_000, 0));
    assert_eq!(expected.summary.cell_observations, 12_000 * 8_192);
    assert!(expected.models.iter().any(|model| model.order > 0), "something is learned");

    let mut random = rounds::draws(rounds::seed("durability_grid_survives_kills_while_scans_stream_and_updates_run"));
    let data = tempdir().expect("a folder");
    let launch = launch(data.path());
    let mut daemon = launch.start();
    daemon.client().create_map(new_map(grid(Retention::None))).await.expect("a new map");
    let mut producer = opened(&daemon).await;
    let (mut next, mut last_generation) = (0, 0);
    for kill in 0..10 {
        // Every other kill comes soon after a midnight, when an update runs or is saved.
        let day = kill / 2 + 1;
        let until = if kill % 2 == 0 {
            film.scans_of(day) - random.random_range(200..1_500)
        } else {
            film.scans_of(day) + random.random_range(100..500)
        };
        send(&mut producer, &film, &scans[next..until]).await;
        next = until;
        if kill % 2 == 1 {
            producer.flush().await.expect("durable");
        }
        tokio::time::sleep(Duration::from_millis(random.random_range(0..400))).await;
        let seen = generation(&daemon).await;
        let acknowledged = producer.progress().durable_sequence;
        let exit = daemon.kill();
        assert!(!exit.stderr.contains("panicked"), "{exit}");
        // Sometimes a new producer object continues at the number in the daemon's Welcome; otherwise the same one
        // reconnects by itself.
        let kept = (kill % 3 == 1).then_some(producer);
        daemon = launch.start();
        settled(&daemon.client()).await;
        let now = generation(&daemon).await;
        assert!(now >= seen && now >= last_generation, "generation {now} after {seen}");
        last_generation = now;
        producer = match kept {
            Some(kept) => kept,
            None => {
                let opened = opened(&daemon).await;
                let durable = opened.progress().durable_sequence;
                assert!(durable >= acknowledged, "{acknowledged} were acknowledged, and {durable} are there");
                assert!(durable <= until as u64);
                assert_eq!(summary(&daemon).await.scans, durable, "each scan counts once");
                next = usize::try_from(durable).expect("a few");
                opened
            }
        };
    }
    send(&mut producer, &film, &scans[next..]).await;
    producer.close().await.expect("durable");
    run_update(&daemon.client(), MAP, None).await;
    assert!(generation(&daemon).await > last_generation);
    compare(&answers(&daemon, &film).await, &expected);
    daemon.stop_in_order();

    // Records that checkpoints cover are deleted from the log, so the map is opened from checkpoints.
    let left = segments(data.path());
    let first = left.first().expect("a log");
    assert!(!first.contains("00000000000000000000"), "the first segment of the log is still there: {left:?}");
    let daemon = launch.start();
    compare(&answers(&daemon, &film).await, &expected);
    daemon.kill();
    compare(&answers(&launch.start(), &film).await, &expected);
}

#[tokio::test(flavor = "multi_thread")]
async fn grid_history_that_was_imported_waits_for_the_night_after_a_restart_too() {
    let film = Film::new(2, 100);
    let scans: Vec<(i64, Vec<Mask>)> = film.run().collect();
    let data = tempdir().expect("a folder");
    let mut daemon = Launch::on(data.path()).start();
    daemon.client().create_map(new_map(grid(Retention::None))).await.expect("a new map");
    let midnight = film.time(film.scans_of(1));
    for (restart, scans) in [&scans[..130], &scans[130..160], &scans[160..]].into_iter().enumerate() {
        let mut camera = super::producer(&daemon, "camera").await;
        send(&mut camera, &film, scans).await;
        camera.flush().await.expect("durable");
        // The update is queued behind other due updates.
        run_update(&daemon.client(), MAP, Some(midnight)).await;
        let jobs = daemon.client().jobs().await.expect("jobs");
        let others: Vec<_> = jobs.iter().filter(|job| job.cause != JobCause::Request).collect();
        assert!(others.is_empty(), "after restart {restart} half a day was folded in: {others:?}");
        assert_eq!(generation(&daemon).await, restart as u64 + 1);
        daemon.stop_in_order();
        daemon = Launch::on(data.path()).start();
    }
    assert_eq!(summary(&daemon).await.pending_scans, 100, "what came after midnight");
}

/// Waits until a condition holds.
async fn until(what: &str, is_so: impl Fn() -> bool) {
    let since = Instant::now();
    while !is_so() {
        assert!(since.elapsed() < Duration::from_secs(120), "still waiting for {what}");
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
}

const REPEATED: &str = "an update is repeated";

/// Kills a daemon as soon as it runs an update.
async fn kill_in_update(daemon: Daemon) {
    loop {
        let jobs = daemon.client().jobs().await.expect("jobs");
        if jobs.iter().any(|job| job.state == JobState::Running) {
            daemon.kill();
            return;
        }
        assert!(!jobs.iter().any(Job::has_ended), "the update was over before it was seen to run");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_grid_update_that_was_killed_is_run_again() {
    let film = Film::new(24, 1_000);
    let scans: Vec<(i64, Vec<Mask>)> = film.run().collect();
    // Everything waits for one update of all days.
    let launch = |data: &Path| launch(data).setting("update_threads", 1);
    let filled = async |data: &Path| {
        let daemon = launch(data).start();
        daemon.client().create_map(new_map(grid(Retention::Forever))).await.expect("a new map");
        let options = ProducerOptions::new("camera", "", MAP);
        let mut producer = Producer::open(&daemon.client(), options).await.expect("a Welcome");
        send(&mut producer, &film, &scans).await;
        producer.close().await.expect("durable");
        daemon
    };
    let undisturbed = tempdir().expect("a folder");
    let expected = {
        let daemon = filled(undisturbed.path()).await;
        run_update(&daemon.client(), MAP, None).await;
        answers(&daemon, &film).await
    };
    assert_eq!((expected.summary.scans, expected.summary.pending_scans), (24_000, 0));

    let data = tempdir().expect("a folder");
    let daemon = filled(data.path()).await;
    daemon.client().run_update(MAP, None).await.expect("the map is there");
    kill_in_update(daemon).await;

    // The start repeats the update, and is killed while it does.
    let again = launch(data.path()).spawn();
    until("the update to run again", || again.stderr().contains(REPEATED)).await;
    again.kill();

    // Until the update has ended, replies come from the generation before it, whether it still runs or not.
    let daemon = launch(data.path()).start();
    let early = predicted(&daemon, film.time(1), model(ModelKind::Latest, None)).await;
    assert_eq!(early.tiles.len(), expected.grids[0].tiles.len());
    let mut camera = opened(&daemon).await;
    assert_eq!(camera.progress().durable_sequence, film.scans() as u64);
    camera.close().await.expect("nothing was sent");
    let jobs = daemon.client().jobs().await.expect("jobs");
    assert_eq!(jobs.iter().map(|job| job.cause).collect::<Vec<_>>(), [JobCause::Request], "the one that is repeated");
    settled(&daemon.client()).await;
    compare(&answers(&daemon, &film).await, &expected);
    assert_eq!(generation(&daemon).await, 1);
    // The learned models are saved by then.
    daemon.stop_in_order();
    let daemon = launch(data.path()).start();
    compare(&answers(&daemon, &film).await, &expected);
    let stderr = daemon.stop_in_order();
    assert!(!stderr.contains(REPEATED), "{stderr}");
}
