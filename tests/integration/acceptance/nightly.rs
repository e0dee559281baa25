//! The nightly update in the time of the data: each day is predicted from the days before it.

use tidemap_client::{
    Client,
    observe::{Producer, ProducerOptions},
    queries::{EvaluateOptions, ModelDescription, ModelSelector},
};
use tidemap_tests::recordings;

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
    assert!((mean - 0.05971).abs() <= 0.0002, "{mean:.5}, expected 0.05971");
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
