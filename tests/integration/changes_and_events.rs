//! States that report changes and events, as a smart home exports them, queried as its owner does.

use std::{fmt::Write as _, fs};

use tempfile::tempdir;
use tidemap_tests::{
    cli::{tidemap, tidemap_reading},
    daemon::{Daemon, Launch},
};

/// Monday 2025-02-03, midnight in Casablanca, where clocks change on 23 February.
const START_SECS: i64 = 1_738_537_200;
const STEP_SECS: i64 = 300;
const DAYS: i64 = 28;

/// When a sensor is on, in seconds from the start: office from nine to five, kitchen at noon, lamp at night.
fn is_on(sensor: &str, secs: i64) -> bool {
    let (day, minute) = (secs.div_euclid(86_400), secs.rem_euclid(86_400) / 60);
    // The times differ a little from day to day.
    let late = (day * 37 + 11) % 23;
    match sensor {
        "binary_sensor.office" => day % 7 < 5 && (540 + late..1_020 + late).contains(&minute),
        "binary_sensor.kitchen" => (720 - late..780).contains(&minute),
        _ => (1_200 + late..1_410).contains(&minute),
    }
}

const SENSORS: [&str; 3] = ["binary_sensor.office", "binary_sensor.kitchen", "light.lamp"];

/// Civil time of Casablanca, which sets its clocks back by an hour on 2025-02-23 at 03:00.
fn civil(secs: i64) -> String {
    let offset = if START_SECS + secs < 1_740_276_000 { 3_600 } else { 0 };
    let local = START_SECS + secs + offset;
    let (days, of_day) = (local.div_euclid(86_400), local.rem_euclid(86_400));
    // 2025-02-03 is day 20,122.
    let (month, day) = if days < 20_148 { (2, days - 20_119) } else { (3, days - 20_147) };
    format!("2025-{month:02}-{day:02} {:02}:{:02}:{:02}", of_day / 3_600, of_day / 60 % 60, of_day % 60)
}

/// The export: rows at changes only; the lamp is out of reach for two days.
fn export() -> String {
    let mut text = "entity_id,state,last_changed,attributes\n".to_owned();
    let is_away = |sensor: &str, secs: i64| sensor == "light.lamp" && (10 * 86_400..12 * 86_400).contains(&secs);
    let word = |sensor: &str, secs: i64| match (is_away(sensor, secs), is_on(sensor, secs)) {
        (true, _) => "unavailable",
        (_, true) => "on",
        (_, false) => "off",
    };
    for secs in (0..DAYS * 86_400).step_by(60) {
        for sensor in SENSORS {
            if secs == 0 || word(sensor, secs) != word(sensor, secs - 60) {
                let _ = writeln!(text, "{sensor},{},{},x", word(sensor, secs), civil(secs));
            }
        }
    }
    text
}

/// The sensors as a robot would read them, every five minutes.
fn sampled(days: std::ops::Range<i64>) -> String {
    let mut text = "time,state,value\n".to_owned();
    for secs in (days.start * 86_400..days.end * 86_400).step_by(STEP_SECS as usize) {
        for sensor in SENSORS {
            if days.start > 0 || sensor != "light.lamp" || !(10 * 86_400..12 * 86_400).contains(&secs) {
                let _ = writeln!(text, "{},{sensor},{}", START_SECS + secs, u8::from(is_on(sensor, secs)));
            }
        }
    }
    text
}

fn mean(numbers: &[f64]) -> f64 {
    numbers.iter().sum::<f64>() / numbers.len() as f64
}

fn map(daemon: &Daemon, name: &str) {
    tidemap(daemon, ["map", "create", name, "--time-zone", "Africa/Casablanca", "--clock", "simulated"]).table();
}

#[test]
fn a_smart_home_is_forecast_from_its_export_as_from_readings() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    map(&daemon, "home");
    map(&daemon, "sampled");
    let file = data.path().join("export.csv");
    fs::write(&file, export()).expect("written");
    let path = file.display().to_string();
    let columns = "time=last_changed,state=entity_id,value=state";
    let observe = ["observe", "home", &path, "--producer", "hub", "--changes", "--columns", columns];
    // Times without a zone are ambiguous.
    let refused = tidemap(&daemon, observe);
    assert!(refused.stderr.contains("read such times in the map's zone with --local"), "{}", refused.stderr);
    let again = ["--local", "--label", "export"];
    let sent = tidemap(&daemon, observe.into_iter().chain(again).collect::<Vec<_>>()).table();
    let rows = export().lines().count() as f64 - 1.0;
    assert_eq!(
        (sent.numbers("accepted"), sent.numbers("mapped"), sent.numbers("refused")),
        (vec![rows], vec![rows - 1.0], vec![0.0])
    );
    assert_eq!(sent.numbers("without_value"), [1.0]);
    tidemap_reading(&daemon, ["observe", "sampled", "-", "--producer", "hub"], &sampled(0..DAYS)).table();
    let learned = tidemap(&daemon, ["update", "home"]).table();
    assert_eq!(learned.numbers("observations").iter().sum::<f64>(), rows);
    tidemap(&daemon, ["update", "sampled"]).table();
    let test = data.path().join("test.csv");
    fs::write(&test, sampled(DAYS..DAYS + 7)).expect("written");
    let error = |map: &str| {
        let test = test.display().to_string();
        mean(&tidemap(&daemon, ["evaluate", map, &test, "--models", "auto"]).table().numbers("mse"))
    };
    let (of_changes, of_readings) = (error("home"), error("sampled"));
    assert!(of_changes < 1.02 * of_readings + 1e-4, "{of_changes}, and {of_readings} with readings");
    assert!(of_changes < 0.05, "{of_changes}");
    let states = tidemap(&daemon, ["state", "list", "home"]).table();
    assert_eq!(states.column("reports"), ["changes"; 3]);
    // All states at once, and by a pattern; a column each.
    let wide = tidemap(&daemon, ["predict", "home", "--date", "2025-03-04", "--wide"]).table();
    assert_eq!(wide.numbers("binary_sensor.office").len(), 24);
    let noon = wide.numbers("binary_sensor.office")[12];
    assert!(noon > 0.9, "{noon}");
    let at = ["predict", "home", "binary*", "--at", "2025-03-04T12:30", "--local"];
    assert_eq!(tidemap(&daemon, at).table().column("state"), ["binary_sensor.office", "binary_sensor.kitchen"]);
    let none = ["predict", "home", "door*", "--at", "2025-03-04T12:30", "--local"];
    tidemap(&daemon, none).fails(2, &["fits \"door*\"", "binary_sensor.office"]);
}

#[test]
fn how_a_state_is_reported_never_changes() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    map(&daemon, "home");
    let added = tidemap(&daemon, ["state", "add", "home", "door", "--reports", "changes", "--hold-max", "1d"]).table();
    assert_eq!((added.numbers("hold_max_secs"), added.numbers("hold_step_secs")), (vec![86_400.0], vec![300.0]));
    let rows = "time,state,value\n1738537200,door,open\n1738540800,door,unavailable\n";
    let send = |flags: &[&str], label: &str, rows: &str| {
        let all = ["observe", "home", "-", "--producer", "hub", "--label", label];
        tidemap_reading(&daemon, all.into_iter().chain(flags.iter().copied()).collect::<Vec<_>>(), rows)
    };
    let sent = send(&["--changes"], "one", rows).table();
    assert_eq!((sent.numbers("accepted"), sent.numbers("without_value")), (vec![2.0], vec![1.0]));
    let other = send(&["--changes", "--hold-step", "10m"], "two", rows);
    other.fails(1, &["exists and is reported by changes that hold for 86400 s"]);
    // A file is checked before anything is sent or withdrawn.
    let file = data.path().join("plain.csv");
    fs::write(&file, "time,state,value\n1738537200,lamp,0\n1738540800,lamp,1\n").expect("written");
    let path = file.display().to_string();
    tidemap(&daemon, ["observe", "home", &path, "--producer", "hub"]).table();
    for more in [&["--changes"][..], &["--changes", "--replace"]] {
        let all = ["observe", "home", &path, "--producer", "hub"].into_iter().chain(more.iter().copied());
        tidemap(&daemon, all.collect::<Vec<_>>()).fails(1, &["lamp", "Nothing was sent", "tidemap erase home --state"]);
    }
    let kept = ["reconstruct", "home", "lamp", "--from", "1738537200", "--to", "1738540801"];
    assert_eq!(tidemap(&daemon, kept).table().numbers("value"), [0.0, 1.0]);
    tidemap(&daemon, ["erase", "home", "--state", "lamp"]).table();
    let all = ["observe", "home", &path, "--producer", "hub", "--changes", "--replace"];
    assert_eq!(tidemap(&daemon, all).table().numbers("accepted"), [2.0]);
    send(&["--events"], "three", "time,state\n1738537200,door\n").fails(1, &["door", "a count"]);
    // A state of samples takes no row without a value.
    tidemap(&daemon, ["state", "add", "home", "plain"]).table();
    let refused = send(&[], "four", "time,state,value\n1738537200,plain,unavailable\n");
    refused.fails(1, &["means that there is no value"]);
    let wrong = ["state", "add", "home", "x", "--reports", "events", "--kind", "probability"];
    tidemap(&daemon, wrong).fails(1, &["only a count has events"]);
    tidemap(&daemon, ["state", "add", "home", "x", "--hold-max", "1d"]).fails(2, &["samples neither hold"]);
}

#[test]
fn events_are_counted_and_a_warning_names_changes_sent_as_readings() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    map(&daemon, "home");
    let mut rows = "time,state\n".to_owned();
    for day in 0..14 {
        for event in 0..6 {
            let _ = writeln!(rows, "{},gate", START_SECS + day * 86_400 + 8 * 3_600 + event * 500);
        }
    }
    let sent = tidemap_reading(&daemon, ["observe", "home", "-", "--producer", "hub", "--events"], &rows).table();
    assert_eq!(sent.numbers("accepted"), [84.0]);
    tidemap(&daemon, ["update", "home"]).table();
    let day = tidemap(&daemon, ["predict", "home", "gate", "--date", "2025-02-18"]).table();
    let expected = day.numbers("probability");
    assert!(expected[8] > 4.0 && expected[8] < 6.5 && expected[2] < 0.5, "{expected:?}");
    let mut rows = "time,state,value\n".to_owned();
    for row in 0..40 {
        let _ = writeln!(rows, "{},door,{}", START_SECS + row * 7_200, row % 2);
    }
    let sent = tidemap_reading(&daemon, ["observe", "home", "-", "--producer", "robot"], &rows);
    assert!(sent.stderr.contains("nearly every row differs"), "{}", sent.stderr);
}

#[test]
fn an_evaluation_does_not_depend_on_whether_rows_are_in_order_of_time_or_of_state() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    map(&daemon, "home");
    let add =
        |state| tidemap(&daemon, ["state", "add", "home", state, "--reports", "changes", "--hold-max", "1d"]).table();
    for state in ["a", "b"] {
        add(state);
    }
    // More than fit into one message. Two hours of every day are without rows, and the last value holds.
    let changes = (0..30 * 1440).filter(|minute| minute % 1440 < 1320);
    let row = |minute: i64, state: &str| format!("{},{state},{}\n", START_SECS + minute * 60, minute / 60 % 3 % 2);
    let by_time: String = changes.clone().flat_map(|minute| [row(minute, "a"), row(minute, "b")]).collect();
    let by_state: String =
        ["a", "b"].map(|state| changes.clone().map(|minute| row(minute, state)).collect::<String>()).concat();
    let evaluated = |rows: &str| {
        let rows = format!("time,state,value\n{rows}");
        let found = tidemap_reading(&daemon, ["evaluate", "home", "-", "--models", "mean"], &rows).table();
        (found.numbers("n"), found.numbers("mse"))
    };
    assert_eq!(evaluated(&by_time), evaluated(&by_state));
    assert_eq!(evaluated(&by_time).0, [30.0 * 288.0 - 24.0; 2]);
}
