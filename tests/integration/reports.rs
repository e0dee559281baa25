//! Single readings in one request: durable when answered, in sequence, repeated without harm if they are numbered.

use serde_json::{Value, json};
use tempfile::tempdir;
use tidemap_client::maps::NewMap;
use tidemap_tests::{
    daemon::{Daemon, Launch},
    stream::{RawStream, columns, hello},
    web::{Answer, call},
};

async fn daemon(data: &std::path::Path) -> Daemon {
    let daemon = Launch::on(data).setting("http_write", true).start();
    let map = NewMap { name: "home".to_owned(), ..NewMap::default() };
    daemon.client().create_map(map).await.expect("a new map");
    daemon
}

fn report(address: &str, readings: &Value, first_sequence: u64) -> Answer {
    let request = json!({
        "map": "home", "producer": "robot", "readings": readings, "firstSequence": first_sequence.to_string(),
    });
    call(address, "ObservationService/Report", &[], &request)
}

fn observations(daemon: &Daemon) -> String {
    let map = call(&daemon.http, "MapService/GetMap", &[], &json!({ "name": "home" })).json();
    map["map"]["observations"].as_str().expect("a count").to_owned()
}

#[tokio::test(flavor = "multi_thread")]
async fn readings_are_durable_when_they_are_answered() {
    let data = tempdir().expect("a folder");
    let running = daemon(data.path()).await;
    let readings = json!([
        { "state": "door", "value": 1.0, "time": "2026-03-21T10:00:00Z" },
        { "state": "people", "value": 3.0, "kind": "STATE_KIND_COUNT", "time": "2026-03-21T09:00:00.5Z" },
        { "state": "anna", "position": [1.5, -2.0], "time": "2026-03-21T11:00:00Z" },
        { "state": "door", "value": 7.0, "time": "2026-03-21T12:00:00Z" },
        { "state": "door", "value": 0.0 },
    ]);
    let answer = report(&running.http, &readings, 0);
    assert_eq!(answer.code, 200, "{}", answer.text());
    let answer = answer.json();
    assert_eq!(answer["durableSequence"], "5");
    assert_eq!(answer["refused"].as_array().map(Vec::len), Some(1), "{answer}");
    assert_eq!(
        (&answer["refused"][0]["sequence"], &answer["refused"][0]["reason"]),
        (&json!("4"), &json!("REFUSAL_REASON_VALUE"))
    );
    running.kill();
    let running = Launch::on(data.path()).setting("http_write", true).start();
    // A position is an observation of each of its axes.
    assert_eq!(observations(&running), "5");
    let times =
        json!({ "map": "home", "state": "door", "fromTime": "2026-03-21T00:00:00Z", "toTime": "2026-03-22T00:00:00Z" });
    let kept = call(&running.http, "QueryService/Reconstruct", &[], &times);
    assert!(kept.text().contains("1774087200000000000"), "{}", kept.text());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_numbered_report_is_taken_once() {
    let data = tempdir().expect("a folder");
    let daemon = daemon(data.path()).await;
    let readings = json!([{ "state": "door", "value": 1.0, "time": "2026-03-21T10:00:00Z" }]);
    for _ in 0..3 {
        let answer = report(&daemon.http, &readings, 1).json();
        assert_eq!(answer["durableSequence"], "1", "{answer}");
    }
    assert_eq!(observations(&daemon), "1");
    let next = report(&daemon.http, &readings, 0).json();
    assert_eq!(next["durableSequence"], "2", "without a number it is a new one: {next}");
    let gap = report(&daemon.http, &readings, 9);
    assert_eq!((gap.code, gap.reason().as_str()), (400, "OUT_OF_SEQUENCE"), "{}", gap.text());
}

#[tokio::test(flavor = "multi_thread")]
async fn reports_of_one_producer_wait_for_each_other() {
    let data = tempdir().expect("a folder");
    let daemon = daemon(data.path()).await;
    std::thread::scope(|scope| {
        for thread in 0..4 {
            let address = daemon.http.as_str();
            scope.spawn(move || {
                for _ in 0..5 {
                    let readings = json!([{ "state": format!("door{thread}"), "value": 1.0 }]);
                    let answer = report(address, &readings, 0);
                    assert_eq!(answer.code, 200, "{}", answer.text());
                }
            });
        }
    });
    assert_eq!(observations(&daemon), "20");
    // A stream keeps its key as long as it lives.
    let (mut stream, _) = RawStream::open(&daemon.grpc, hello("robot", "home")).await.expect("a Welcome");
    let readings = json!([{ "state": "door", "value": 1.0 }]);
    let answer = report(&daemon.http, &readings, 0);
    assert_eq!((answer.code, answer.reason().as_str()), (409, "ALREADY_STREAMING"), "{}", answer.text());
    stream.batch(21, columns(&["door"], &[(0, 1_000, 1.0)])).await;
    stream.acknowledged(21).await.expect("taken");
}

#[tokio::test(flavor = "multi_thread")]
async fn mistakes_name_the_reading() {
    let data = tempdir().expect("a folder");
    let daemon = daemon(data.path()).await;
    for (readings, words) in [
        (json!([]), "readings: there is none"),
        (json!([{ "state": "a", "position": [1.0] }]), "readings[0].position"),
        (json!([{ "state": "a", "value": 1 }, { "state": "a", "position": [1.0, 2.0] }]), "readings[1].kind"),
        (json!([{ "state": "a", "time": "1915-01-01T00:00:00Z" }]), "readings[0].time"),
        (json!(vec![json!({ "state": "a" }); 1001]), "1000"),
    ] {
        let answer = report(&daemon.http, &readings, 0);
        assert!((400..500).contains(&answer.code) && answer.text().contains(words), "{words}: {}", answer.text());
    }
    assert_eq!(observations(&daemon), "0");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_list_of_producers_contains_who_sent_and_when() {
    let data = tempdir().expect("a folder");
    let running = daemon(data.path()).await;
    let list = |daemon: &Daemon| tidemap_tests::cli::tidemap(daemon, ["producer", "list", "home"]).table();
    assert_eq!(list(&running).column("producer"), Vec::<String>::new());
    let before = std::fs::metadata(data.path()).and_then(|folder| folder.modified()).expect("a time");
    let (mut stream, _) = RawStream::open(&running.grpc, hello("robot-2", "home")).await.expect("a Welcome");
    stream.batch(1, columns(&["door"], &[(0, 1_000, 1.0), (0, 2_000, 0.0)])).await;
    stream.acknowledged(2).await.expect("taken");
    let answer = report(&running.http, &json!([{ "state": "door", "value": 1.0 }]), 0);
    assert_eq!(answer.code, 200, "{}", answer.text());
    let table = list(&running);
    assert_eq!(table.column("producer"), ["robot", "robot-2"]);
    assert_eq!(table.column("connected"), ["no", "yes"]);
    assert_eq!(table.numbers("observations"), [1.0, 2.0]);
    let since = before.duration_since(std::time::UNIX_EPOCH).expect("after 1970").as_secs_f64();
    assert!(table.numbers("received").iter().all(|&at| (since - 1.0..since + 600.0).contains(&at)), "{table:?}");
    // The time of receipt outlives the checkpoint and the daemon.
    tidemap_tests::cli::tidemap(&running, ["update", "home"]).table();
    drop(stream);
    running.stop_in_order();
    let running = Launch::on(data.path()).setting("http_write", true).start();
    let later = list(&running);
    assert_eq!(later.column("received"), table.column("received"));
    assert_eq!(later.column("connected"), ["no", "no"]);
    tidemap_tests::cli::tidemap(&running, ["producer", "list", "attic"]).fails(1, &["attic"]);
    let failed = tidemap_tests::cli::tidemap(&running, ["producer", "list", "attic", "--output", "json"]);
    let error: Value = serde_json::from_str(failed.stderr.trim()).expect("an error as JSON");
    assert_eq!(error["error"]["code"], "NOT_FOUND");
    assert!(error["error"]["message"].as_str().is_some_and(|text| text.contains("attic")), "{error}");
}
