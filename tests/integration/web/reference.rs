//! The JSON interface as programs and people find it: times in both forms, the page `/docs`, and the guide's examples
//! in other languages.

use std::{fs, path::Path, process::Command};

use serde_json::json;
use tempfile::tempdir;
use tidemap_client::maps::NewMap;
use tidemap_tests::{
    daemon::Launch,
    web::{call, request},
};

/// 28 January 2025, ten o'clock, UTC.
const SECS: i64 = 1_738_058_400;

#[tokio::test(flavor = "multi_thread")]
async fn times_are_dates_or_nanoseconds_and_seconds_are_refused_where_clocks_are_real() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).setting("http_write", true).start();
    for (name, has_real_clock) in [("home", true), ("simulated", false)] {
        let map = NewMap { name: name.to_owned(), has_real_clock, ..NewMap::default() };
        daemon.client().create_map(map).await.expect("a new map");
    }
    let date = "2025-01-28T10:00:00Z";
    let report = |map: &str, time| {
        let request =
            json!({ "map": map, "producer": "me", "readings": [{ "state": "door", "value": 1, "time": time }] });
        call(&daemon.http, "ObservationService/Report", &[], &request)
    };
    let predict = |map: &str, times| {
        let request = json!({ "map": map, "states": ["door"], "timesNanos": times });
        call(&daemon.http, "QueryService/PredictStates", &[], &request)
    };
    for (time, expected) in [(json!(date), "1"), (json!((SECS + 1) * 1_000_000_000), "2")] {
        let taken = report("home", time);
        assert_eq!((taken.code, taken.json()["durableSequence"].as_str()), (200, Some(expected)), "{}", taken.text());
    }
    let one_and_same = [json!([date]), json!([(SECS * 1_000_000_000).to_string()]), json!([SECS * 1_000_000_000])];
    let answers = one_and_same.map(|times| predict("home", times));
    assert!(answers.iter().all(|answer| answer.code == 200 && answer.body == answers[0].body), "{answers:?}");

    for (times, guess) in [
        (json!([SECS]), "was it meant in seconds, as 2025-01-28T10:00:00Z?"),
        (json!([date, (SECS * 1_000).to_string()]), "meant in milliseconds"),
        (json!([SECS * 1_000_000]), "meant in microseconds"),
        (json!([0]), "before 1990"),
    ] {
        let refused = predict("home", times.clone());
        let text = refused.text();
        assert!(refused.code == 400 && text.contains(guess) && text.contains("timesNanos: time"), "{times}: {text}");
        // Simulations begin at 0, and a map that is not there is not there.
        report("simulated", json!(1));
        assert_eq!(predict("simulated", times.clone()).code, 200, "{times}");
        assert_eq!(predict("nowhere", times).code, 404);
    }
    let single = report("home", json!(SECS));
    assert!(single.code == 400 && single.text().contains("time: time 1738058400 ns"), "{}", single.text());
    let meant = predict("home", json!(["1971-01-01T00:00:00Z"]));
    assert_eq!(meant.code, 200, "a date is what was meant: {}", meant.text());
    let wrong = predict("home", json!(["2025-01-28T10:00:00"]));
    assert!(wrong.code == 400 && wrong.text().contains("timesNanos: "), "{}", wrong.text());
}

#[test]
fn the_interface_is_shown_as_a_page_that_needs_no_other_host() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    let page = request(&daemon.http, "GET", "/docs", &[], b"");
    assert_eq!((page.code, page.headers["content-type"].as_str()), (200, "text/html; charset=utf-8"));
    let policy = &page.headers["content-security-policy"];
    assert!(policy.contains("default-src 'none'") && policy.contains("style-src 'self'"), "{policy}");
    let text = page.text();
    let document = request(&daemon.http, "GET", "/api/v1/openapi.json", &[], b"").json();
    for path in document["paths"].as_object().expect("paths").keys() {
        assert!(text.contains(&format!(" {path}</code>")), "{path}");
    }
    assert!(!text.contains("<script") && !text.contains("src=") && !text.contains("href=\"http"), "from elsewhere");
    let style = request(&daemon.http, "GET", "/docs/style.css", &[], b"");
    assert_eq!((style.code, style.headers["content-type"].as_str()), (200, "text/css; charset=utf-8"));
}

/// The block of a language in the guide's page of the wire.
fn example(language: &str) -> String {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/src/wire.md");
    let text = fs::read_to_string(page).expect("the page");
    let (_, rest) = text.split_once(&format!("```{language}\n")).expect("a block");
    rest.split_once("\n```").expect("its end").0.to_owned()
}

#[test]
fn the_example_in_javascript_runs() {
    let work = tempdir().expect("a folder");
    let daemon = Launch::on(&work.path().join("data")).setting("http_write", true).start();
    let program = work.path().join("example.mjs");
    fs::write(&program, example("js")).expect("written");
    let node = Command::new("node").arg(&program).env("TIDEMAP_HTTP", &daemon.http).output();
    let Ok(output) = node else {
        println!("SKIPPED: the example in JavaScript; node is not installed");
        return;
    };
    let shown = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let lines: Vec<&str> = shown.lines().collect();
    assert_eq!((lines.len(), lines[0]), (3, "durable up to number 1"), "{shown}");
    assert!(lines[1].starts_with("2025-01-28T10:00:00Z: 0.") && lines[2].starts_with("2025-01-28T22:00:00Z: 0."));
}

/// Go is not run here: its example sends the requests of the one in JavaScript.
#[test]
fn the_example_in_go_calls_what_there_is() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    let document = request(&daemon.http, "GET", "/api/v1/openapi.json", &[], b"").json();
    let text = example("go");
    assert!(text.contains("\"QueryService/PredictStates\"") && text.contains("/api/v1/"));
    assert!(document["paths"]["/api/v1/QueryService/PredictStates"]["post"].is_object());
    let schemas = &document["components"]["schemas"];
    for field in ["map", "states", "timesNanos"] {
        assert!(text.contains(&format!("\"{field}\"")), "{field}");
        assert!(schemas["PredictStatesRequest"]["properties"][field].is_object(), "{field}");
    }
    // Go reads names without regard to case.
    for field in ["FirstTimeIndex", "Probabilities"] {
        let name = format!("{}{}", field[..1].to_lowercase(), &field[1..]);
        assert!(text.contains(field) && schemas["PredictStatesResponse"]["properties"][&name].is_object(), "{name}");
    }
}
