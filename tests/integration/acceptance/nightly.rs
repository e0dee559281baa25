//! The nightly update in the time of the data: each day is predicted from the days before it.

use tidemap_client::{
    Client,
    observe::{Producer, ProducerOptions},
    queries::{EvaluateOptions, ModelDescription, ModelSelector},
};
use tidemap_tests::{
    cli,
    daemon::{Daemon, Launch},
    recordings,
};

use super::Door;

const DAY_NANOS: i64 = 86_400_000_000_000;

type Row = (i64, f64);

/// Rows by local day, which in winter is the day in UTC.
fn days(rows: &[Row]) -> Vec<&[Row]> {
    rows.chunk_by(|a, b| a.0.div_euclid(DAY_NANOS) == b.0.div_euclid(DAY_NANOS)).collect()
}

/// Waits until an update has learned everything before this instant.
async fn updated_until(client: &Client, map: &str, nanos: i64) {
    let updated = async {
        while client.map(map).await.expect("the map").last_update.cut_nanos < Some(nanos) {
            tokio::time::sleep(std::time::Duration::from_millis(2)).await;
        }
    };
    tokio::time::timeout(std::time::Duration::from_secs(60), updated).await.expect("the update of the day that closed");
}

async fn mean_squared_error(client: &Client, map: &str, day: &[Row]) -> f64 {
    let models = vec![ModelSelector::default()];
    let mut evaluator = client.evaluate(EvaluateOptions { map: map.to_owned(), models, max_order: None });
    for &(nanos, value) in day {
        assert!(evaluator.add("door", nanos, value).await);
    }
    evaluator.finish().await.expect("an evaluation").evaluations[0].mean_squared_error
}

#[tokio::test(flavor = "multi_thread")]
async fn each_day_is_predicted_from_the_days_before() {
    let Some(door) = Door::new("Europe/London") else { return };
    let client = door.daemon.client();
    let rows = recordings::rows(&door.file("train.csv"));
    let days = days(&rows);
    let options = ProducerOptions { nightly: true, ..ProducerOptions::new("camera", "", "door") };
    let mut producer = Producer::open(&client, options).await.expect("a producer");
    let mut errors = Vec::new();
    for (index, day) in days.iter().enumerate() {
        // The first row of a day closes the day before.
        let (first, rest) = day.split_first().expect("a day has rows");
        producer.send("door", first.0, first.1).await.expect("a row is taken");
        producer.flush().await.expect("a row becomes durable");
        if index > 0 {
            updated_until(&client, "door", first.0.div_euclid(DAY_NANOS) * DAY_NANOS).await;
        }
        if index >= 14 {
            errors.push(mean_squared_error(&client, "door", day).await);
        }
        for &(nanos, value) in rest {
            producer.send("door", nanos, value).await.expect("a row is taken");
        }
    }
    producer.flush().await.expect("everything becomes durable");
    drop(producer);
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    println!("next day: {mean:.5} over {} days", errors.len());
    assert_eq!(days.len() - 14, errors.len());
    // The best order alone has 0.06653.
    assert!((mean - 0.06064).abs() <= 0.0002, "{mean:.5}, expected 0.06064");
    let generations = client.map("door").await.expect("the map").last_update.generation;
    assert_eq!(generations, days.len() as u64 - 1, "one update for each day that closed");

    let by_day = described(&client, "door").await;
    let at_once = from_the_command_line(&door, &client).await;
    assert_eq!((at_once.order, at_once.learned_observations), (by_day.order, by_day.learned_observations));
    // Both learned the same days; their batches and updates had other boundaries.
    for (found, expected) in at_once.order_errors.iter().zip(&by_day.order_errors) {
        assert!((found - expected).abs() <= 1e-9 * expected.max(1.0), "{found}, expected {expected}");
    }
    for (found, expected) in at_once.components.iter().zip(&by_day.components) {
        assert_eq!(found.period_secs, expected.period_secs);
        assert!((found.amplitude - expected.amplitude).abs() <= 1e-9, "{found:?}, expected {expected:?}");
    }
}

/// The models after the whole file is sent with `--nightly`.
async fn from_the_command_line(door: &Door, client: &Client) -> ModelDescription {
    door.tidemap(["map", "create", "again", "--time-zone", "Europe/London"]).table();
    let file = door.file("train.csv");
    let args = ["observe", "again", file.to_str().expect("a path that is text"), "--nightly", "--producer", "camera"];
    assert_eq!(door.tidemap(args).table().number("accepted"), 96_480.0);
    let generations = client.map("again").await.expect("the map").last_update.generation;
    assert!(generations > 0, "no update ran");
    described(client, "again").await
}

/// The models after the last day is learned too.
async fn described(client: &Client, map: &str) -> ModelDescription {
    tidemap_tests::oracle::run_update(client, map, None).await;
    client.describe_model(map, "door").await.expect("the door is known")
}

/// The file in parts of that many lines, as CSV.
fn parts(rows: &[&str], lines: usize) -> Vec<String> {
    rows.chunks(lines).map(|rows| format!("time,state,value\n{}\n", rows.join("\n"))).collect()
}

/// Sends parts, each as a file of its own.
fn observe_parts(daemon: &Daemon, map: &str, parts: &[String], after_each: &[&str], options: &[&str]) {
    for (number, part) in parts.iter().enumerate() {
        let label = number.to_string();
        let args = ["observe", map, "-", "--producer", "camera", "--label", &label];
        cli::tidemap_reading(daemon, args.into_iter().chain(options.iter().copied()), part).table();
        if !after_each.is_empty() {
            cli::tidemap(daemon, after_each).table();
        }
    }
    cli::tidemap(daemon, ["update", map]).table();
}

/// The errors of all models, the choice, and the predictions of the next two weeks, with their intervals.
fn learned(daemon: &Daemon, map: &str) -> [String; 2] {
    let shown = cli::tidemap(daemon, ["--output", "json", "model", "show", map, "door"]).stdout;
    let args =
        ["predict", map, "door", "--from", "2016-02-06T00:00:00Z", "--to", "2016-02-20T00:00:00Z", "--step", "20m"];
    let predicted = cli::tidemap(daemon, ["--output", "csv"].into_iter().chain(args)).stdout;
    assert!(predicted.lines().count() > 1000, "{predicted}");
    [shown, predicted]
}

#[test]
fn a_recording_is_learned_alike_at_any_speed_and_in_any_parts() {
    let Some(door) = Door::new("Europe/London") else { return };
    let data = tempfile::tempdir().expect("a folder");
    let small = Launch::on(data.path()).setting("max_pending_observations", 3500).start();
    cli::tidemap(&small, ["map", "create", "early", "--time-zone", "Europe/London"]).table();
    for map in ["days", "once", "calls"] {
        door.tidemap(["map", "create", map, "--time-zone", "Europe/London"]).table();
    }
    let text = std::fs::read_to_string(door.file("train.csv")).expect("the recording");
    // Thirty days of a row each minute.
    let rows: Vec<&str> = text.lines().skip(1).take(30 * 1440).collect();
    let (all, days) = (parts(&rows, rows.len()), parts(&rows, 1440));
    observe_parts(&door.daemon, "days", &days, &["update", "days"], &[]);
    let expected = learned(&door.daemon, "days");
    assert!(expected[0].contains("calibrated"), "{}", expected[0]);
    observe_parts(&door.daemon, "door", &all, &[], &["--nightly"]);
    observe_parts(&door.daemon, "once", &all, &[], &[]);
    // The parts end in the middle of days.
    observe_parts(&door.daemon, "calls", &parts(&rows, 10_000), &[], &["--nightly"]);
    // Updates make room after some days.
    observe_parts(&small, "early", &all, &[], &[]);
    for (daemon, map) in [(&door.daemon, "door"), (&door.daemon, "once"), (&door.daemon, "calls"), (&small, "early")] {
        let found = learned(daemon, map);
        assert_eq!(found[0], expected[0], "{map}");
        for (found, expected) in found[1].lines().zip(expected[1].lines()) {
            assert_eq!(found, expected, "{map}");
        }
    }
    let updates = cli::tidemap(&small, ["map", "show", "early"]).table().number("updates");
    assert!(updates >= 5.0, "{updates}");
}
