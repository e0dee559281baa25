//! The uniform variant of the spectral model on two regular weeks of a real door, and its answers where readings are
//! missing.

use std::fs;

use tidemap_tests::{cli::Table, recordings};

use super::Door;

const NANOS: i64 = 1_000_000_000;
const WEEK_SECS: i64 = 604_800;

/// The two weeks from Monday, 2016-01-11: a reading every minute.
fn two_weeks(door: &Door) -> Vec<(i64, f64)> {
    let from = 1_452_470_400;
    let mut readings = recordings::rows(&door.file("train.csv"));
    readings.retain(|(time, _)| (from * NANOS..(from + 2 * WEEK_SECS) * NANOS).contains(time));
    assert_eq!(readings.len(), 20_160);
    readings.into_iter().map(|(time, value)| (time / NANOS, value)).collect()
}

fn learn(door: &Door, map: &str, readings: &[(i64, f64)]) {
    let work = tempfile::tempdir().expect("a folder");
    let file = work.path().join("two-weeks.csv");
    let rows: String = readings.iter().map(|(time, value)| format!("{time},door,{value}\n")).collect();
    fs::write(&file, format!("time,state,value\n{rows}")).expect("a file");
    let spec = ["--time-zone", "UTC", "--period-base", "14d", "--period-count", "672"];
    door.tidemap(["map", "create", map].iter().chain(&spec).copied()).table();
    let sent = door.tidemap(["observe", map, file.to_str().expect("text"), "--producer", "camera"]).table();
    assert_eq!(sent.number("accepted"), readings.len() as f64);
    door.tidemap(["update", map]).table();
}

fn predicted(door: &Door, map: &str, model: &str, order: &str, (from, to): (i64, i64)) -> Table {
    let (from, to) = (from.to_string(), to.to_string());
    let args = ["predict", map, "door", "--model", model, "--order", order];
    door.tidemap(args.iter().chain(&["--from", &from, "--to", &to, "--step", "1m"]).copied()).table()
}

#[test]
fn from_the_same_readings_it_answers_as_the_spectral_model_and_recalls_what_that_misses() {
    let Some(door) = Door::new("Europe/London") else { return };
    let readings = two_weeks(&door);
    let (first, last) = (readings[0].0, readings[readings.len() - 1].0);
    learn(&door, "regular", &readings);
    for order in ["0", "1", "2", "3"] {
        let predictions = |model, times| predicted(&door, "regular", model, order, times);
        // The week after: only the rhythms are known.
        let later = (last + 60, last + 60 + WEEK_SECS);
        let (uniform, spectral) = (predictions("uniform", later), predictions("spectral", later));
        assert!(uniform.column("order").iter().all(|found| *found == order));
        for (found, expected) in uniform.numbers("probability").into_iter().zip(spectral.numbers("probability")) {
            assert!((found - expected).abs() < 1e-6, "order {order}: {found}, {expected}");
        }
        // The learned weeks: outliers are stored as read, so every reading is reproduced exactly.
        let past = (first, last + 60);
        let (uniform, spectral) = (predictions("uniform", past), predictions("spectral", past));
        let mut outliers = 0;
        let pairs = uniform.numbers("probability").into_iter().zip(spectral.numbers("probability"));
        for ((time, value), (found, expected)) in readings.iter().zip(pairs) {
            if (expected - 0.5).abs() < 1e-6 {
                continue;
            }
            assert_eq!(found >= 0.5, *value >= 0.5, "order {order} at {time}");
            if (expected >= 0.5) == (*value >= 0.5) {
                assert!((found - expected).abs() < 1e-6, "order {order} at {time}: {found}, {expected}");
            } else {
                assert_eq!(found, *value, "order {order} at {time}");
                outliers += 1;
            }
        }
        println!("order {order}: {outliers} of {} readings are outliers", readings.len());
        assert!((100..10_000).contains(&outliers), "order {order}: {outliers}");
    }
    // Anomalies are judged by the rhythms alone, not by stored outliers.
    let (from, to) = (first.to_string(), (last + 1).to_string());
    let args = ["anomalies", "regular", "door", "--confidence", "0.8", "--from", &from, "--to", &to];
    let [uniform, spectral] = ["uniform", "spectral"]
        .map(|model| door.tidemap(args.iter().chain(&["--model", model]).copied()).table().rows.len());
    println!("anomalies: {uniform} by uniform, {spectral} by spectral");
    assert!(uniform > 0 && uniform.abs_diff(spectral) * 20 < spectral, "{uniform} {spectral}");
    // All readings are observed at once, for a comparison.
    let week = door.file("week1.csv");
    let table = door.tidemap(["evaluate", "regular", week.to_str().expect("text"), "--models", "uniform"]).table();
    assert_eq!((table.column("model"), table.rows.len()), (vec!["uniform"], 1));
    assert!(table.numbers("mse")[0] < 0.25, "{table:?}");
}

#[test]
fn irregular_readings_are_refused_with_what_was_found_and_what_to_use() {
    let Some(door) = Door::new("Europe/London") else { return };
    let mut readings = two_weeks(&door);
    let gap = readings[700].0;
    readings.drain(670..700);
    learn(&door, "gaps", &readings);
    let words = ["uniform", "60 s apart", &gap.to_string(), "1860 s after", "spectral"];
    door.tidemap(["predict", "gaps", "door", "--at", "1460000000", "--model", "uniform"]).fails(1, &words);
    let week = door.file("week1.csv");
    let args = ["evaluate", "gaps", week.to_str().expect("text"), "--models", "uniform,mean"];
    let compared = door.tidemap(args);
    assert_eq!(compared.table_with(1).column("model"), ["mean"]);
    assert!(compared.stderr.contains("uniform is left out of door") && compared.stderr.contains("60 s apart"));
    door.tidemap(["predict", "gaps", "door", "--at", "1460000000", "--model", "uniform", "--order", "16"])
        .fails(2, &["--order", "16"]);
}

#[test]
fn a_mixture_may_have_another_period() {
    let Some(door) = Door::new("Europe/London") else { return };
    let readings = two_weeks(&door);
    learn(&door, "door2", &readings);
    let week = door.file("week1.csv");
    let args = ["evaluate", "door2", week.to_str().expect("text"), "--models", "pergam:5,pergam:5:1d,pergam:5:7d"];
    let table = door.tidemap(args).table();
    // A day is reproduced without a period.
    assert_eq!(table.column("model"), ["pergam:5", "pergam:5:7d"]);
    let errors = table.numbers("mse");
    assert!(errors.iter().all(|error| (0.01..0.3).contains(error)) && errors[0] != errors[1], "{table:?}");
    let ask = |model| door.tidemap(["predict", "door2", "door", "--at", "1460000000", "--model", model]);
    ask("pergam:5:7d").table();
    ask("pergam:5:1s").fails(2, &["pergam:5:1s", "1m to 366d"]);
    ask("histogram:24:7d").fails(2, &["histogram:24:7d", "only pergam"]);
    ask("pergam:7d").fails(2, &["pergam:7d"]);
}
