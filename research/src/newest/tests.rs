//! Models are compared by lead time, and on the data that they have learned.

#![allow(clippy::unwrap_used)]

use std::{fmt::Write as _, fs, path::Path};

use tempfile::TempDir;
use tidemap_formats::table::Format;

use crate::{
    Ahead, Comparison, ModelResult, summary,
    tests::{DAY, MONDAY, STEP, protocol, ran, recording},
    write,
};

const HOUR_NANOS: i64 = 3_600_000_000_000;

/// A door that is open for 23 of every 59 quarter hours, whatever the time of day: only the newest reading predicts it.
fn wandering(first_day: i64, days: i64) -> String {
    let mut text = "time,state,value\n".to_owned();
    for time in (first_day * DAY..(first_day + days) * DAY).step_by(STEP as usize) {
        let is_open = (17..40).contains(&(time / STEP % 59));
        writeln!(text, "{},door,{}", MONDAY + time, u8::from(is_open)).unwrap();
    }
    text
}

const PROTOCOL: &str = "\
zone: UTC
train: train.csv
test: [one.csv, two.csv]
ahead: [next, 1h, 2d]
models: [mean, mean+persistence, mean+memory, latest, persistence, average+memory]
out: out
";

fn folder(recording: impl Fn(i64, i64) -> String) -> TempDir {
    let folder = TempDir::new().unwrap();
    for (name, first_day, days) in [("train.csv", 0, 28), ("one.csv", 28, 7), ("two.csv", 35, 7)] {
        fs::write(folder.path().join(name), recording(first_day, days)).unwrap();
    }
    folder
}

fn result<'a>(outcome: &'a Comparison, label: &str, ahead: Ahead) -> &'a ModelResult {
    let wanted = |model: &&ModelResult| model.label == label && model.ahead == Some(ahead);
    outcome.models.iter().find(wanted).unwrap()
}

#[test]
fn the_newest_reading_helps_shortly_after_it_and_not_long_after() {
    let folder = folder(wandering);
    let outcome = ran(folder.path(), PROTOCOL);
    let lags = [Ahead::Next, Ahead::Nanos(HOUR_NANOS), Ahead::Nanos(48 * HOUR_NANOS)];
    let labels: Vec<(Ahead, &str)> =
        outcome.models.iter().map(|model| (model.ahead.unwrap(), model.label.as_str())).collect();
    let models = ["mean", "mean+persistence", "mean+memory", "latest", "persistence", "average+memory"];
    let expected: Vec<_> = lags.iter().flat_map(|&lag| models.map(|label| (lag, label))).collect();
    assert_eq!(labels, expected);
    let mse = |label, lag| result(&outcome, label, lag).score.mse();
    for blended in ["mean+persistence", "mean+memory", "persistence"] {
        let [next, hour, days] = lags.map(|lag| mse(blended, lag) / mse("mean", lag));
        assert!(next < 0.5 && next < hour && hour < 0.95 && days > 0.99, "{blended}: {next} {hour} {days}");
    }
    // The mean predicts the same value at any lead time.
    assert_eq!(mse("mean", lags[0]), mse("mean", lags[2]));
    // The newest reading alone is wrong at each of the changes: two in 59 readings.
    assert!((mse("latest", lags[0]) - 2.0 / 59.0).abs() < 0.01, "{}", mse("latest", lags[0]));
    assert!((mse("latest", lags[1]) - 8.0 / 59.0).abs() < 0.01, "{}", mse("latest", lags[1]));
    for model in &outcome.models {
        let loss = model.score.log_loss();
        assert!(loss > 0.0 && loss < -(1e-3_f64).ln(), "{}: {loss}", model.label);
        // The difference is to the mean at the same lead time.
        let mean = model.difference.map_or(0.0, |difference| difference.mean);
        assert!((model.score.mse() - mse("mean", model.ahead.unwrap()) - mean).abs() < 1e-12);
    }
    assert_eq!(outcome.pairs.len(), 3 * 15);
    let lag = |index: usize| outcome.models[index].ahead;
    assert!(outcome.pairs.iter().all(|pair| lag(pair.model) == lag(pair.other)));
}

#[test]
fn what_comes_within_the_lag_changes_no_prediction() {
    let folder = folder(wandering);
    let predictions = |one: &str| {
        fs::write(folder.path().join("one.csv"), one).unwrap();
        let outcome = ran(folder.path(), PROTOCOL);
        outcome.models.into_iter().map(|model| (model.ahead.unwrap(), model.score.predictions)).collect::<Vec<_>>()
    };
    let usual = wandering(28, 7);
    // The reading at noon of the second day of the first set is another one.
    let at = 96 + 48;
    let (head, tail) = usual.split_once(&format!("{},door,", MONDAY + 29 * DAY + 12 * 3600)).unwrap();
    let flipped = if tail.starts_with('1') { "0" } else { "1" };
    let other = format!("{head}{},door,{flipped}{}", MONDAY + 29 * DAY + 12 * 3600, &tail[1..]);
    for ((ahead, usual), (_, other)) in predictions(&usual).into_iter().zip(predictions(&other)) {
        let lag = match ahead {
            Ahead::Next => 1,
            Ahead::Nanos(nanos) => usize::try_from(nanos / 1_000_000_000 / STEP).unwrap(),
        };
        assert_eq!(usual[0][0][..at + lag], other[0][0][..at + lag], "{ahead}");
    }
    // The reading changes the first prediction for which it is known, of models that use it.
    let (usual, other) = (predictions(&usual), predictions(&other));
    for index in [1, 2, 3, 4, 5] {
        assert_ne!(usual[index].1[0][0][at + 1], other[index].1[0][0][at + 1], "{index}");
        assert_ne!(usual[6 + index].1[0][0][at + 4], other[6 + index].1[0][0][at + 4], "{index}");
    }
}

#[test]
fn the_first_readings_of_a_set_are_predicted_from_the_readings_before_it() {
    let folder = folder(wandering);
    let outcome = ran(folder.path(), PROTOCOL);
    let latest = &result(&outcome, "latest", Ahead::Next).score.predictions;
    let last_of = |text: String| f64::from(u8::from(text.trim_end().ends_with('1')));
    assert_eq!(latest[0][0][0], last_of(wandering(0, 28)));
    assert_eq!(latest[1][0][0], last_of(wandering(28, 7)));
}

#[test]
fn tables_have_a_row_for_each_lag_and_model() {
    let folder = folder(wandering);
    let protocol = protocol(folder.path(), &format!("{PROTOCOL}predictions: 1d\n"));
    let outcome = crate::run(&protocol, &|_, _| ()).unwrap();
    let mut stdout = Vec::new();
    summary(&protocol, &outcome, Format::Csv, &mut stdout).unwrap();
    let results = String::from_utf8(stdout).unwrap();
    let header =
        "model,parameters,ahead,mse,error_rate,log_loss,mse_one,mse_two,difference,lower,upper,p_value,verdict";
    assert_eq!(results.lines().next(), Some(header));
    assert_eq!(results.lines().count(), 1 + 18);
    assert!(results.lines().nth(13).unwrap().starts_with("mean,,2d,"), "{results}");
    write(&protocol, &outcome, folder.path()).unwrap();
    let read = |name: &str| fs::read_to_string(folder.path().join(name)).unwrap();
    assert!(read("pairs.csv").starts_with("model,other,ahead,difference,"));
    assert!(read("pairs.csv").contains("\nmean,latest,1h,"));
    let predictions = read("predictions.csv");
    let header = "time,state,value,ahead,mean,mean+persistence,mean+memory,latest,persistence,average+memory\n";
    assert!(predictions.starts_with(header), "{predictions}");
    assert_eq!(predictions.lines().count(), 1 + 14 * 3);
    assert!(read("comparison.svg").contains(">mean+memory, 1h<"));
}

#[test]
fn values_that_are_no_probabilities_are_blended_without_log_loss() {
    let folder = folder(|first_day, days| {
        let rows = wandering(first_day, days);
        rows.replace(",door,1", ",door,30").replace(",door,0", ",door,10")
    });
    let text = format!("{}kind: continuous\n", PROTOCOL.replace(", latest, persistence, average+memory", ""));
    let protocol = protocol(folder.path(), &text);
    let outcome = crate::run(&protocol, &|_, _| ()).unwrap();
    let mse = |label| result(&outcome, label, Ahead::Next).score.mse();
    assert!(mse("mean+persistence") < 0.5 * mse("mean"), "{} {}", mse("mean+persistence"), mse("mean"));
    let mut stdout = Vec::new();
    summary(&protocol, &outcome, Format::Csv, &mut stdout).unwrap();
    let results = String::from_utf8(stdout).unwrap();
    let row: Vec<&str> = results.lines().nth(1).unwrap().split(',').collect();
    assert_eq!((row[4], row[5]), ("", ""), "{results}");
}

fn errors_by_order(folder: &Path, text: &str) -> (String, Vec<[f64; 3]>) {
    let protocol = protocol(folder, text);
    let outcome = crate::run(&protocol, &|_, _| ()).unwrap_or_else(|error| panic!("{error}"));
    let mut stdout = Vec::new();
    summary(&protocol, &outcome, Format::Csv, &mut stdout).unwrap();
    let rates = |model: &ModelResult| {
        let [train, one] = &model.score.sets[..] else { panic!("two sets") };
        [train.errors.error_rate(), one.errors.error_rate(), model.score.error_rate()]
    };
    (String::from_utf8(stdout).unwrap(), outcome.models.iter().map(rates).collect())
}

#[test]
fn errors_of_what_was_learned_and_of_what_was_not_come_by_order_from_one_run() {
    let folder = folder(|first_day, days| recording(first_day, days, 0));
    let text = "zone: UTC\ntrain: train.csv\ntest: [./train.csv, one.csv]\nlists: each\nout: o\nmodels:\n  \
                - spectral: {order: [0, 1, 3, 7, 15]}\n";
    let (table, errors) = errors_by_order(folder.path(), text);
    let header = "model,parameters,mse,error_rate,mse_train,mse_one,error_rate_train,error_rate_one,difference,";
    assert!(table.starts_with(header), "{table}");
    assert!(table.contains("\nspectral order=7,order=7,"), "{table}");
    // More components describe the training data better (T-RO 2017, figure 5).
    let learned: Vec<f64> = errors.iter().map(|[train, ..]| *train).collect();
    assert!(learned[0] > learned[1] && learned[1] > learned[4], "{learned:?}");
    // The means cover the data that was not learned.
    assert!(errors.iter().all(|[_, one, mean]| one == mean), "{errors:?}");
    // Learning and testing alike, the test set is learned before the next set of `retrain: each`, and once.
    let (again, _) = errors_by_order(folder.path(), &format!("{text}retrain: each\n"));
    assert_eq!(again, table);
}

#[test]
fn an_experiment_may_have_nothing_but_what_was_learned() {
    let folder = folder(|first_day, days| recording(first_day, days, 0));
    let protocol =
        protocol(folder.path(), "zone: UTC\ntrain: train.csv\ntest: train.csv\nout: o\nmodels: [mean, spectral]\n");
    let outcome = crate::run(&protocol, &|_, _| ()).unwrap();
    let mut stdout = Vec::new();
    summary(&protocol, &outcome, Format::Csv, &mut stdout).unwrap();
    let table = String::from_utf8(stdout).unwrap();
    let row: Vec<&str> = table.lines().nth(2).unwrap().split(',').collect();
    // Neither a mean error nor a test of differences: both would seem to be of predictions.
    assert_eq!(row[..4], ["spectral", "", "", ""], "{table}");
    assert!(row[4].parse::<f64>().unwrap() > 0.0 && row[5].parse::<f64>().unwrap() > 0.0, "{table}");
    assert_eq!(row[6..10], ["", "", "", ""], "{table}");
    let picture = crate::picture::draw(&protocol, &outcome);
    assert!(!picture.contains("NaN"), "{picture}");
}
