//! The experiment on a small recording whose scores follow by hand, on wrong recordings, and on the first days of a
//! real one.
//!
//! Invariant: the small recording has one rhythm, so that the pattern that a model has to learn is certain.

#![allow(clippy::unwrap_used)]

use std::{fs, path::Path};

use tempfile::{TempDir, tempdir};

use super::{
    ACTIVITY_MODELS, ActivityClassifier, ActivityComparison, ActivityModel, ActivityProtocol, DayTrend,
    recording::ActivityRecording, run, write,
};

/// Three days: asleep in room 1 until 8 h, then at work in room 2, and with no known activity after 22 h.
fn small() -> TempDir {
    let folder = tempdir().unwrap();
    let day =
        |of_hour: fn(usize) -> usize| (0..1440).map(|minute| format!("{}\n", of_hour(minute / 60))).collect::<String>();
    let activities = day(|hour| match hour {
        0..8 => 1,
        8..22 => 2,
        _ => 0,
    });
    let places = day(|hour| if hour < 8 { 1 } else { 2 });
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    write("activity_names.txt", "None\nSleep\nWork \nEat\n");
    write("activity_15days.txt", &activities.repeat(3));
    write("location_15days.txt", &places.repeat(3));
    write("confusion.txt", "1 0 0 0\n0 0.5 0.3 0.2\n0 0.1 0.9 0\n0 0 0 1\n");
    folder
}

fn protocol(folder: &Path, models: &[&str]) -> ActivityProtocol {
    ActivityProtocol {
        folder: folder.to_owned(),
        seeds: 1,
        first_seed: 0,
        classifiers: vec![ActivityClassifier::Strong],
        models: models.iter().map(|name| name.parse().unwrap()).collect(),
        days: None,
    }
}

fn scores(protocol: &ActivityProtocol) -> ActivityComparison {
    run(protocol, &|_, _| {}).unwrap()
}

/// The score of a day, counted from 0.
fn day(outcome: &ActivityComparison, setting: usize, day: usize) -> f64 {
    outcome.settings[setting].day(day).unwrap().mean
}

#[test]
fn without_a_prior_the_score_is_what_the_classifier_gives_the_true_activity() {
    let folder = small();
    let classifiers = vec![ActivityClassifier::Weak, ActivityClassifier::Measured];
    let outcome = scores(&ActivityProtocol { classifiers, ..protocol(folder.path(), &["even"]) });
    // Eight hours at 0.5 and fourteen at 0.9; two hours without a known activity are left out.
    let measured = (8.0 * 0.5 + 14.0 * 0.9) / 22.0;
    for of_day in 0..3 {
        assert!((day(&outcome, 0, of_day) - 0.2).abs() < 1e-12, "{outcome:?}");
        assert!((day(&outcome, 2, of_day) - measured).abs() < 1e-12, "{outcome:?}");
    }
}

#[test]
fn the_first_day_has_an_even_prior_and_the_days_after_it_what_was_recognised() {
    let folder = small();
    let outcome = scores(&protocol(folder.path(), &["even", "mean", "histogram:24", "auto"]));
    for setting in 0..outcome.settings.len() {
        assert!((day(&outcome, setting, 0) - 0.8).abs() < 1e-12, "{setting}");
    }
    let last = |setting: usize| day(&outcome, setting, 2);
    let (even, by_place, mean, hours, auto) = (last(0), last(1), last(2), last(4), last(6));
    // A mean predicts that nobody eats, a histogram predicts when somebody works.
    assert!(even < mean && mean < hours && hours > 0.97, "{mean} {hours}");
    assert!(auto > mean && auto > 0.95, "{mean} {auto}");
    assert!(by_place > 0.9, "each room has its activity: {by_place}");
}

#[test]
fn the_strong_classifier_takes_known_activities_for_each_other_alike() {
    let folder = small();
    let recording = ActivityRecording::read(folder.path()).unwrap();
    let matrix = ActivityClassifier::Strong.matrix(&recording);
    let expected = [[1.0, 0.0, 0.0, 0.0], [0.0, 0.8, 0.1, 0.1], [0.0, 0.1, 0.8, 0.1], [0.0, 0.1, 0.1, 0.8]];
    for (row, expected) in matrix.iter().flatten().zip(expected.iter().flatten()) {
        assert!((row - expected).abs() < 1e-12, "{matrix:?}");
    }
    assert_eq!(ActivityClassifier::Measured.matrix(&recording)[1], [0.0, 0.5, 0.3, 0.2]);
    assert_eq!(recording.names[2], "Work");
}

#[test]
fn a_seed_decides_what_is_recognised() {
    let folder = small();
    let of_seed =
        |first_seed| day(&scores(&ActivityProtocol { first_seed, ..protocol(folder.path(), &["mean"]) }), 0, 2);
    assert_eq!(of_seed(1), of_seed(1));
    assert_ne!(of_seed(1), of_seed(2));
}

#[test]
fn results_have_a_row_for_each_setting_and_each_of_its_days_activities_and_hours() {
    let (folder, out) = (small(), tempdir().unwrap());
    let outcome = scores(&ActivityProtocol { days: Some(2), ..protocol(folder.path(), &["mean"]) });
    write(&outcome, out.path()).unwrap();
    let lines = |name: &str| fs::read_to_string(out.path().join(name)).unwrap().lines().count();
    assert_eq!((lines("results.csv"), lines("days.csv")), (3, 5));
    // Two days are too few for the mean of the days from the seventh on, and for a trend.
    assert_eq!((lines("activities.csv"), lines("hours.csv")), (1, 1));
    let results = fs::read_to_string(out.path().join("results.csv")).unwrap();
    let expected =
        "classifier,model,place,score,standard_error,slope,p_value\nstrong,mean,no,,,,\nstrong,mean,yes,,,,\n";
    assert_eq!(results, expected);
}

#[test]
fn a_recording_that_does_not_match_itself_is_refused_with_file_and_line() {
    let refused = |name: &str, text: &str| {
        let folder = small();
        fs::write(folder.path().join(name), text).unwrap();
        ActivityRecording::read(folder.path()).unwrap_err().to_string()
    };
    let wrong = |name: &str, text: &str, parts: &[&str]| {
        let message = refused(name, text);
        assert!(message.contains(name) && parts.iter().all(|part| message.contains(part)), "{message}");
    };
    wrong("activity_names.txt", "None\nSleep\n", &["2 names"]);
    wrong("activity_15days.txt", "1\n9\n", &["line 2", "from 0 to 3"]);
    wrong("activity_15days.txt", "1\n2\n", &["2 minutes", "1440"]);
    wrong("location_15days.txt", "kitchen\n", &["line 1", "kitchen"]);
    wrong("location_15days.txt", &"1\n".repeat(1440), &["1440 minutes", "4320"]);
    wrong("confusion.txt", "1 0 0 0\n0 0 0 0\n", &["line 2"]);
    wrong("confusion.txt", "1 0 0 0\n", &["1 rows", "4"]);
    let folder = small();
    let many = ActivityProtocol { days: Some(4), ..protocol(folder.path(), &["even"]) };
    assert_eq!(run(&many, &|_, _| {}).unwrap_err().to_string(), "the recording has 3 days, and not 4");
}

#[test]
fn errors_that_fall_have_a_slope_below_0_and_a_low_p_value() {
    let falling: Vec<f64> = (0..10).map(|day| 1.0 - 0.05 * f64::from(day)).collect();
    let trend = DayTrend::new(&falling).unwrap();
    assert!((trend.slope + 0.05).abs() < 1e-12 && trend.p_value < 0.001, "{trend:?}");
    let level = DayTrend::new(&[0.5; 10]).unwrap();
    assert_eq!((level.slope, level.p_value), (0.0, 1.0));
    // No order of three days is steeper than the two that rise or fall: 2 of 6.
    let few = DayTrend::new(&[0.3, 0.2, 0.1]).unwrap();
    assert!((few.p_value - 1.0 / 3.0).abs() < 0.05, "{few:?}");
    assert_eq!(DayTrend::new(&[0.3, 0.2]), None);
}

#[test]
fn models_have_names_and_those_without_a_rhythm_to_learn_are_refused() {
    for name in ACTIVITY_MODELS {
        let model: ActivityModel = name.parse().unwrap();
        assert_eq!(model.to_string().parse::<ActivityModel>(), Ok(model), "{name}");
    }
    for wrong in ["spectral", "spectral:16", "latest", "persistence", "poisson", "mean+memory", "uniform", "odd"] {
        let message = wrong.parse::<ActivityModel>().unwrap_err().to_string();
        assert!(message.contains(wrong) && message.contains("auto"), "{message}");
    }
}

#[test]
fn time_and_place_help_a_classifier_in_a_real_flat() {
    let Some(folder) = crate::tests::recordings("activity") else { return };
    let models = ["even", "mean", "auto"];
    let outcome = scores(&ActivityProtocol { days: Some(4), ..protocol(&folder, &models) });
    let last = |setting: usize| day(&outcome, setting, 3);
    let (even, mean, auto) = (last(0), last(2), last(4));
    assert!((even - 0.8).abs() < 1e-9, "{even}");
    assert!(even < mean && mean < auto, "{even} {mean} {auto}");
    for (model, name) in models.iter().enumerate() {
        assert!(last(2 * model + 1) > last(2 * model), "the place helps {name}");
    }
}
