//! The answers of `predict`: columns, entropy, age, order, persistence, and the three ways to name times.

use std::fs;

use tidemap_tests::{cli, recordings};

use super::Door;

const COLUMNS: [&str; 12] = [
    "time",
    "state",
    "probability",
    "lower",
    "upper",
    "entropy_bits",
    "order",
    "observations",
    "age_secs",
    "model",
    "pending",
    "mass",
];

fn entropy_bits(p: f64) -> f64 {
    [p, 1.0 - p].into_iter().filter(|&p| p > 0.0).map(|p| -p * p.log2()).sum()
}

#[track_caller]
fn near(found: f64, expected: f64) {
    assert!((found - expected).abs() <= 1e-9, "{found}, expected {expected}");
}

#[test]
fn predictions_follow_from_what_was_learned() {
    let Some(door) = Door::new("Europe/London") else { return };
    // Before the first update only the last value is known.
    let rows = "time,state,value\n1451865600,door,1\n1451865660,door,0\n";
    let first = cli::tidemap_reading(&door.daemon, ["observe", "door", "-", "--producer", "first"], rows).table();
    assert_eq!(first.number("accepted"), 2.0);
    let unlearned = door.tidemap(["predict", "door", "door", "--at", "1451865720"]).table();
    assert_eq!(unlearned.columns, COLUMNS);
    assert_eq!(
        unlearned.rows,
        [[
            "1451865720",
            "door",
            "0.19925138036893558",
            "0",
            "1",
            "0.7204283265950056",
            "0",
            "2",
            "60",
            "prior",
            "2",
            "1"
        ]]
    );
    let latest = door.tidemap(["predict", "door", "door", "--at", "1451865720", "--model", "latest"]).table();
    assert_eq!(latest.rows, [["1451865720", "door", "0", "0", "1", "0", "0", "2", "60", "latest", "2", "1"]]);
    door.tidemap(["map", "delete", "door", "--yes"]);
    let created = door.tidemap(["map", "create", "door", "--time-zone", "Europe/London"]).table();
    assert_eq!(created.number("observations"), 0.0);

    door.learn();
    let newest = recordings::rows(&door.file("train.csv")).last().expect("a last row").0 / 1_000_000_000;
    let model = door.tidemap(["model", "show", "door", "door"]).table();
    let (mean, components) = (model.numbers("mean")[0], model.numbers("period_secs"));
    let (amplitudes, phases) = (model.numbers("amplitude"), model.numbers("phase_rad"));
    // In summer, when local time is UTC plus one hour: 2016-04-06 to 08.
    let args = ["predict", "door", "door", "--from", "2016-04-06T00:00:00Z", "--to", "1460073600", "--step", "1h"];
    for order in [0, 1, 2, 15] {
        let text = order.to_string();
        let table = door.tidemap(args.into_iter().chain(["--order", &text])).table();
        assert_eq!(table.rows.len(), 48, "the last time is not included");
        for row in 0..48 {
            let time = table.numbers("time")[row];
            assert_eq!(time, 1_459_900_800.0 + 3_600.0 * row as f64);
            let local = time + 3_600.0;
            let wave = |k: usize| {
                let turns = (local % components[k]) / components[k];
                amplitudes[k] * (std::f64::consts::TAU * turns + phases[k]).cos()
            };
            let expected = (mean + (0..order).map(wave).sum::<f64>()).clamp(0.0, 1.0);
            near(table.numbers("probability")[row], expected);
            near(table.numbers("entropy_bits")[row], entropy_bits(expected));
            assert_eq!(table.numbers("age_secs")[row], time - newest as f64);
        }
        assert!(table.column("order").iter().all(|&found| found == text));
        assert!(table.column("observations").iter().all(|&found| found == "96480"));
        let (lower, upper) = (table.numbers("lower"), table.numbers("upper"));
        for ((p, lower), upper) in table.numbers("probability").into_iter().zip(lower).zip(upper) {
            assert!(0.0 <= lower && lower <= p && p <= upper && upper <= 1.0, "{lower} {p} {upper}");
        }
    }
    let none = door.tidemap(args.into_iter().chain(["--interval", "0"])).table();
    assert!(none.column("lower").iter().chain(&none.column("upper")).all(|bound| bound.is_empty()));
    let in_force = door.tidemap(args.into_iter().chain(["--model", "spectral"])).table();
    assert_eq!(in_force.column("order")[0], model.column("order")[0], "what the update chose");
}

#[test]
fn persistence_draws_predictions_to_the_last_value() {
    let Some(door) = Door::new("Europe/London") else { return };
    let rows: String =
        (0..2_000).map(|i| format!("{},door,{}\n", 1_451_865_600 + 600 * i, u8::from(i % 50 > 24))).collect();
    let text = format!("time,state,value\n{rows}");
    assert_eq!(cli::tidemap_reading(&door.daemon, ["observe", "door", "-"], &text).table().number("refused"), 0.0);
    door.tidemap(["update", "door"]).table();
    let json = door.tidemap(["--output", "json", "model", "show", "door", "door"]).stdout;
    let model: serde_json::Value = serde_json::from_str(&json).expect("one JSON object");
    let number = |name: &str| model[name].as_f64().unwrap_or_else(|| panic!("{name} is not in {json}"));
    let (tau, last, last_value) = (number("persistence_tau_secs"), number("last_time"), number("last_value"));
    // T-RO eq. 12: 79 changes in 1,999 pairs that are ten minutes apart, and a prior of one pair with an hour.
    near(tau / 3_600.0, 2_000.0 / (1.0 / 3_600.0 + 79.0 / 600.0) / 3_600.0);
    assert_eq!((last, last_value), (1_451_865_600.0 + 600.0 * 1_999.0, 1.0));
    let times: Vec<String> =
        [-60_000, 0, 60, 3_600, 86_400, 8_640_000].map(|after| (last as i64 + after).to_string()).into();
    let times = times.join(",");
    let ask = |model: &str| door.tidemap(["predict", "door", "door", "--at", &times, "--model", model]).table();
    let (long_term, blended) = (ask("spectral"), ask("spectral+persistence"));
    for ((time, p), found) in
        long_term.numbers("time").iter().zip(long_term.numbers("probability")).zip(blended.numbers("probability"))
    {
        // T-RO eq. 13; before the last observation nothing is blended.
        let weight = if *time < last { 0.0 } else { (-(time - last) / tau).exp() };
        near(found, last_value * weight + p * (1.0 - weight));
    }
    let found = blended.numbers("probability");
    assert_eq!(found[1], 1.0, "at the time of the last observation it is that value");
    near(found[5], long_term.numbers("probability")[5]);
}

#[test]
fn times_are_named_in_three_ways() {
    let Some(door) = Door::new("Europe/London") else { return };
    let rows = "time,state,value\n1451865600,door,1\n1451865660,gate,0\n";
    assert_eq!(cli::tidemap_reading(&door.daemon, ["observe", "door", "-"], rows).table().number("accepted"), 2.0);
    let work = tempfile::tempdir().expect("a folder");
    let file = work.path().join("times.csv");
    fs::write(&file, "time,note\n1451865700.5,a\n1451865705.5,b\n").expect("a file");
    let file = file.to_str().expect("a path that is text");
    let both = ["predict", "door", "gate", "door"];
    let by_list = door.tidemap(both.into_iter().chain(["--at", "1451865700.5,2016-01-04T00:01:45.5Z"]));
    let by_file = door.tidemap(both.into_iter().chain(["--times", file]));
    let by_range =
        door.tidemap(both.into_iter().chain(["--from", "1451865700.5", "--to", "1451865710.5", "--step", "5s"]));
    assert_eq!(by_list.table().column("state"), ["gate", "gate", "door", "door"]);
    assert_eq!(by_list.table().column("time"), ["1451865700.5", "1451865705.5", "1451865700.5", "1451865705.5"]);
    assert_eq!(by_file.table(), by_list.table());
    assert_eq!(by_range.table(), by_list.table());
}
