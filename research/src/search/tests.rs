//! Searches in synthetic recordings with known results, and in the recorded apartment.
#![allow(clippy::unwrap_used)]

use std::{fs, path::Path};

use tempfile::TempDir;

use super::{protocol::parse, *};
use tidemap_formats::table::Format;

const PROTOCOL: &str = "\
topology: rooms.txt
world: world.txt
first_day: 2024-01-01
start: hall
train_days: 14
models: [mean, histogram]
out: results
";
/// The bed is 10 s from the hall, the kitchen 5 s the other way, and the cellar 7 s behind the kitchen.
const ROOMS: &str =
    "node hall\nnode bed\nnode kitchen\nnode cellar\nlink hall bed 10\nlink hall kitchen 5\nlink kitchen cellar 7\n";

/// In bed until 8:00, out until 18:00, then in the kitchen, from day `cellar_from` on in the cellar instead.
fn world(days: usize, cellar_from: usize) -> String {
    let day = |day: usize| {
        let start = day * 1440;
        let evening = if day < cellar_from { "kitchen" } else { "cellar" };
        format!(
            "{start} {} bed\n{} {} out\n{} {} {evening}\n",
            start + 480,
            start + 480,
            start + 1080,
            start + 1080,
            start + 1440
        )
    };
    (0..days).map(day).collect()
}

fn folder(rooms: &str, world: &str) -> TempDir {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("rooms.txt"), rooms).unwrap();
    fs::write(folder.path().join("world.txt"), world).unwrap();
    folder
}

fn searched(protocol: &str, rooms: &str, world: &str) -> Result<SearchComparison, String> {
    let folder = folder(rooms, world);
    let protocol = parse(protocol, folder.path()).map_err(|error| error.to_string())?;
    run(&protocol, &|_, _| ()).map_err(|error| error.to_string().replace(&*folder.path().to_string_lossy(), "."))
}

fn mean_secs(outcome: &SearchComparison, label: &str) -> f64 {
    outcome.rows.iter().find(|row| row.label == label).unwrap().times.mean_secs()
}

#[test]
fn a_model_of_regular_hours_finds_the_target_as_fast_as_the_oracle() {
    let outcome = searched(PROTOCOL, ROOMS, &world(21, 99)).unwrap();
    // Eight hours in bed and six in the kitchen; there are no searches while the target is out. By shares alone, the
    // kitchen is first: it gains 6/5 in a second, the bed 8/10; the bed follows after 5 + 15 s.
    let best = (8.0 * 10.0 + 6.0 * 5.0) / 14.0;
    assert!((mean_secs(&outcome, "omniscient") - best).abs() < 1e-9);
    assert!((mean_secs(&outcome, "histogram") - best).abs() < 1e-9);
    let shares = (8.0 * 20.0 + 6.0 * 5.0) / 14.0;
    assert!((mean_secs(&outcome, "mean") - shares).abs() < 1e-9);
    let row = &outcome.rows[0];
    assert_eq!((row.label.as_str(), row.times.count()), ("mean", 7 * 14 * 60));
    assert_eq!([0.0, 0.4, 0.5, 1.0].map(|share| row.times.quantile_secs(share)), [5.0, 5.0, 20.0, 20.0]);
    assert!(outcome.trials.is_empty());
}

#[test]
fn parameters_are_tuned_on_training_days_only() {
    for by in ["seconds", "log-loss"] {
        tuned_on_training_days_only(by);
    }
}

fn tuned_on_training_days_only(by: &str) {
    let tuning = format!("[histogram: {{bins: [1, 24]}}]\ntuning: {{folds: 2, fold: 3d, by: {by}}}");
    let protocol = PROTOCOL.replace("[mean, histogram]", &tuning);
    let chosen = |cellar_from| {
        let outcome = searched(&protocol, ROOMS, &world(21, cellar_from)).unwrap();
        let trials: Vec<(Vec<f64>, bool)> =
            outcome.trials.iter().map(|trial| (trial.folds.clone(), trial.is_chosen)).collect();
        (outcome.rows[0].parameters.clone(), trials, mean_secs(&outcome, "histogram"))
    };
    let (parameters, trials, secs) = chosen(99);
    assert_eq!(parameters, "bins=24");
    assert_eq!(
        trials.iter().map(|(folds, chosen)| (folds.len(), *chosen)).collect::<Vec<_>>(),
        [(2, false), (2, true)]
    );
    // Later days change how long searches take, but not the chosen parameters.
    let (same, same_trials, later) = chosen(14);
    assert_eq!((parameters, trials), (same, same_trials));
    assert!(later > secs + 1.0, "{later}");
}

#[test]
fn only_the_days_before_the_first_search_are_training_data() {
    let protocol = PROTOCOL.replace("train_days: 14", "train_days: 10");
    let evening_secs = |cellar_from| {
        let outcome = searched(&protocol, ROOMS, &world(12, cellar_from)).unwrap();
        (mean_secs(&outcome, "histogram") * 14.0 - 8.0 * 10.0) / 6.0
    };
    // Seen in the cellar once, the target is searched there after the kitchen; never seen there, after the bed.
    assert!((evening_secs(9) - 12.0).abs() < 1e-9, "{}", evening_secs(9));
    assert!((evening_secs(10) - 42.0).abs() < 1e-9, "{}", evening_secs(10));
}

#[test]
fn results_are_written_with_every_parameter_set() {
    let folder = folder(ROOMS, &world(21, 99));
    let text =
        PROTOCOL.replace("[mean, histogram]", "[mean, histogram: {bins: [1, 24]}]\ntuning: {folds: 2, fold: 3d}");
    let protocol = parse(&text, folder.path()).unwrap();
    let outcome = run(&protocol, &|_, _| ()).unwrap();
    write(&protocol, &outcome, folder.path()).unwrap();
    let read = |name: &str| fs::read_to_string(folder.path().join(name)).unwrap();
    let mut table = Vec::new();
    summary(&outcome, Format::Csv, &mut table).unwrap();
    let results = read("results.csv");
    assert_eq!(results, String::from_utf8(table).unwrap());
    let header = "model,parameters,searches,mean_secs,median_secs,quarter_secs,three_quarters_secs,p90_secs";
    assert_eq!(results.lines().next(), Some(header));
    let labels: Vec<&str> = results.lines().skip(1).filter_map(|line| line.split(',').next()).collect();
    assert_eq!(labels, ["mean", "histogram", "omniscient"]);
    assert_eq!(read("folds.csv").lines().count(), 1 + 2 * 2);
}

#[track_caller]
fn refused(replace: (&str, &str), rooms: &str, world: &str, message: &str) {
    assert!(PROTOCOL.contains(replace.0));
    let found = searched(&PROTOCOL.replace(replace.0, replace.1), rooms, world).unwrap_err();
    assert!(found.contains(message), "{found}");
}

#[test]
fn invalid_searches_are_refused_with_the_allowed_values() {
    let same = ("out: results", "out: results");
    let fine = world(21, 99);
    refused(
        ("train_days: 14", "train_days: 21"),
        ROOMS,
        &fine,
        "21 days are training data, and the world has 21 whole",
    );
    refused(
        ("train_days: 14", "train_days: 0"),
        ROOMS,
        &fine,
        "train_days is \"0\": it has to be a whole number from 1 to 3660",
    );
    refused(("first_day: 2024-01-01", "first_day: Monday"), ROOMS, &fine, "a date such as 2010-11-04");
    refused(("start: hall", "start: attic"), ROOMS, &fine, "attic");
    refused(("start: hall\n", ""), ROOMS, &fine, "key start is missing");
    refused(same, &ROOMS.replace("link kitchen cellar 7\n", ""), &fine, "no way leads from hall to cellar");
    refused(same, &ROOMS.replace("cellar 7", "cellar -7"), &fine, "rooms.txt: ");
    refused(same, &ROOMS.replace("cellar 7", "attic 7"), &fine, "attic");
    refused(same, &fine, &fine, "rooms.txt: line 1: ");
    refused(same, ROOMS, "0 20000 here\n20000 30240 there\n", "none of them is the same");
    refused(same, ROOMS, "0 20160 bed\n20160 30240 out\n", "nobody is at any node");
    let tuning = |text: &'static str| ("out: results", text);
    refused(tuning("out: results\ntuning: {folds: 2, fold: 7d}"), ROOMS, &fine, "all folds are less than train_days");
    refused(tuning("out: results\ntuning: {folds: 1, fold: 30s}"), ROOMS, &fine, "whole minutes");
    refused(tuning("out: results\ntuning: {folds: 1, fold: 1d, by: luck}"), ROOMS, &fine, "by is \"luck\"");
    refused(("histogram]", "average: {calibrated_weight: 2}]"), ROOMS, &fine, "from 0 (the histogram alone) to 1");
    refused(("histogram]", "histogram: {bins: [1, 2]}]"), ROOMS, &fine, "nothing chooses one");
    let missing = parse(PROTOCOL, Path::new("nowhere")).unwrap();
    assert!(run(&missing, &|_, _| ()).unwrap_err().to_string().contains("cannot be read"));
}

/// The apartment of "Waldo", section VII, with the shipped protocol; the published figures, repeated independently.
#[test]
fn of_the_recorded_flat_the_published_times_are_found() {
    let example = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/experiments/aruba-search.yaml"));
    let mut protocol = read(example).unwrap();
    if !protocol.world.exists() {
        println!("SKIPPED: {} is not there", protocol.world.display());
        return;
    }
    let published = [
        ("mean", 47.2, 43.0, 0.1),
        ("fremen-2", 36.6, 15.0, 0.2),
        ("pergam-3", 33.4, 15.0, 0.3),
        ("omniscient", 17.2, 15.0, 0.1),
        // Ours.
        ("day-96-smoothed", 32.83, 15.0, 0.1),
        // Tuned on the first four weeks.
        ("average", 32.83, 15.0, 0.1),
    ];
    protocol.models.retain(|model| published.iter().any(|(label, ..)| *label == model.label));
    let outcome = run(&protocol, &|_, _| ()).unwrap();
    assert_eq!(outcome.rows.len(), published.len());
    for (label, mean, median, near) in published {
        let found = &outcome.rows.iter().find(|row| row.label == label).unwrap().times;
        let (found_mean, found_median) = (found.mean_secs(), found.quantile_secs(0.5));
        println!("{label}: mean {found_mean:.2} s, median {found_median} s of {} searches", found.count());
        assert_eq!(found.count(), 33_403);
        assert!((found_mean - mean).abs() <= near, "{label}: {found_mean}");
        assert_eq!(found_median, median, "{label}");
    }
}
