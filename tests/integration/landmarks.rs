//! Landmarks from outside: sightings are learned exactly once, also through a kill; the times at which landmarks are
//! visible; and the place of a robot by the landmarks that it sees.
//!
//! Invariant: the expected answers follow from the files that were sent, never from the daemon's answers.

use std::fmt::Write as _;

use tidemap_client::observe::{Producer, ProducerOptions, SightingReport, TraversalReport};
use tidemap_tests::{
    cli::{self, Outcome, tidemap},
    daemon::{Daemon, Launch},
    oracle,
};

/// A Monday in winter, when London has UTC.
const START_SECS: i64 = 1_451_865_600;
const HOUR_SECS: i64 = 3_600;
const DAYS: i64 = 14;

/// Landmarks of two nodes: by day the windows are seen, at night the lamps. Those of the lab are the negatives.
const LANDMARKS: &str = "place,name,u_px,v_px,descriptor,along_m
hall,window,100,50,00000000000000ff,
hall,curtain,160,60,000000000000ff00,
hall,lamp,300,40,0000000000ff0000,
hall,switch,330,90,00000000ff000000,
lab,window,120,50,ffffffffffffff00,
lab,lamp,280,40,ffffffffff00ffff,
hall/lab,sign,40,70,0f0f0f0f0f0f0f0f,1.5
hall/lab,arrow,50,70,0f0f0f0f0f0f0ff0,4.5
";

/// A daemon with a hall and a lab 6 m away, and their landmarks.
fn started() -> (tempfile::TempDir, Launch, Daemon) {
    let data = tempfile::tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let daemon = launch.start();
    tidemap(&daemon, ["map", "create", "office", "--time-zone", "Europe/London"]).table();
    cli::tidemap_reading(&daemon, ["topology", "load", "office", "-"], "node hall\nnode lab\nnode attic\n").table();
    tidemap(&daemon, ["topology", "edit", "link", "office", "hall", "lab", "--length", "6"]).table();
    let added = add(&daemon, LANDMARKS).table();
    assert_eq!(added.column("place"), ["hall", "lab", "hall/lab"]);
    assert_eq!(added.numbers("landmarks"), [4.0, 2.0, 2.0]);
    (data, launch, daemon)
}

fn add(daemon: &Daemon, text: &str) -> Outcome {
    cli::tidemap_reading(daemon, ["landmark", "add", "office", "-", "--descriptors", "test-64"], text)
}

/// Hourly sightings from both nodes. From eight to eighteen the windows are seen, at other hours the lamps; the curtain
/// is never seen; a door hides the switch.
fn sightings() -> String {
    let mut rows = "time,place,seen,out_of_view\n".to_owned();
    for hour in 0..DAYS * 24 {
        let time = START_SECS + hour * HOUR_SECS;
        let seen = if (8..18).contains(&(hour % 24)) { "window" } else { "lamp" };
        writeln!(rows, "{time},hall,{seen},switch").expect("memory");
        writeln!(rows, "{},lab,{seen},", time + 60).expect("memory");
    }
    rows
}

fn observe(daemon: &Daemon, text: &str) -> Outcome {
    cli::tidemap_reading(daemon, ["landmark", "observe", "office", "-", "--producer", "robot", "--label", "log"], text)
}

/// Invalid rows, and the reason.
const BAD: [(&str, &str); 5] = [
    ("1451865600,cellar,window,", "\"cellar\""),
    ("1451865600,attic,window,", "\"attic\" has no landmarks"),
    ("1451865600,hall,door,", "\"hall\" has no landmark \"door\""),
    ("1451865600,hall,window,window", "named twice"),
    ("soon,hall,window,", "time"),
];

fn at(hour: i64) -> String {
    (START_SECS + (DAYS * 24 + hour) * HOUR_SECS).to_string()
}

/// The most probable landmark of the hall at an hour of the day after the last, and its probability.
fn likeliest(daemon: &Daemon, hour: i64) -> (String, f64) {
    let table = tidemap(daemon, ["landmark", "predict", "office", "hall", "--at", &at(hour), "--count", "1"]).table();
    (table.column("landmark")[0].to_owned(), table.numbers("probability")[0])
}

fn counts(daemon: &Daemon) -> Vec<(String, u64)> {
    let table = tidemap(daemon, ["state", "list", "office"]).table();
    let states = table.column("state").into_iter().map(str::to_owned);
    states.zip(table.numbers("observations").into_iter().map(|count| count as u64)).collect()
}

#[test]
fn sightings_are_learned_exactly_once_and_show_what_is_visible_when() {
    let (_data, launch, daemon) = started();
    let (good, rows) = (sightings(), (DAYS * 48) as u64);
    let text = BAD.iter().fold(good.clone(), |text, (row, _)| text + row + "\n");
    let outcome = observe(&daemon, &text);
    let table = outcome.table_with(1);
    let bad = BAD.len() as u64;
    let numbers = ["read", "accepted", "duplicate", "refused"].map(|column| table.number(column) as u64);
    assert_eq!(numbers, [rows + bad, rows, 0, bad]);
    for (place, (_, words)) in (1..).zip(BAD) {
        let row = format!("row {} (line {})", rows + place, rows + place + 1);
        let line = outcome.stderr.lines().find(|line| line.starts_with(&row));
        let line = line.unwrap_or_else(|| panic!("{}", outcome.stderr));
        assert!(line.contains(words), "{line}");
    }

    daemon.kill();
    let daemon = launch.start();
    oracle::settle(&daemon);
    let looks = (DAYS * 24) as u64;
    let known = counts(&daemon);
    let expected = ["hall/window", "hall/curtain", "hall/lamp", "lab/window", "lab/lamp"];
    assert_eq!(known, expected.map(|landmark| (format!("landmark/{landmark}"), looks)), "the switch was never in view");
    let again = observe(&daemon, &text).table();
    assert_eq!((again.number("duplicate") as u64, again.number("refused") as u64), (rows + bad, 0));
    observe(&daemon, &text.replace("window,switch", "window,")).fails(1, &["differs"]);
    assert_eq!(counts(&daemon), known, "nothing is learned twice");

    tidemap(&daemon, ["update", "office"]).table();
    let check = |daemon: &Daemon| {
        let (noon, night) = (likeliest(daemon, 12), likeliest(daemon, 23));
        assert!(noon.0 == "window" && noon.1 > 0.9, "{noon:?}");
        assert!(night.0 == "lamp" && night.1 > 0.9, "{night:?}");
        let list = tidemap(daemon, ["landmark", "list", "office", "hall"]).table();
        assert_eq!(list.column("landmark"), ["window", "curtain", "lamp", "switch"]);
        let (shares, sightings) = (list.numbers("seen_share"), list.numbers("sightings"));
        assert!((shares[0] - 10.0 / 24.0).abs() < 1e-6 && shares[1] < 1e-6 && shares[3] == 0.5, "{shares:?}");
        assert_eq!(sightings, [looks as f64, looks as f64, looks as f64, 0.0]);
    };
    check(&daemon);
    daemon.stop_in_order();
    let daemon = launch.start();
    check(&daemon);

    let prune = ["landmark", "prune", "office", "--below", "0.1"];
    let dry = tidemap(&daemon, prune.into_iter().chain(["--dry-run"])).table();
    assert_eq!((dry.column("place"), dry.column("landmark")), (vec!["hall"], vec!["curtain"]));
    assert_eq!(tidemap(&daemon, prune).table().rows, dry.rows);
    assert!(tidemap(&daemon, prune).table().rows.is_empty(), "it is gone");
    tidemap(&daemon, ["topology", "edit", "rename-node", "office", "hall", "foyer"]).table();
    let table = tidemap(&daemon, ["landmark", "predict", "office", "foyer", "--at", &at(12), "--count", "1"]).table();
    assert_eq!(table.column("landmark"), ["window"], "what was learned goes with the node");
    assert!(table.numbers("probability")[0] > 0.9);
}

#[test]
fn a_robot_is_found_by_what_is_visible_at_that_time() {
    let (_data, _launch, daemon) = started();
    observe(&daemon, &sightings()).table();
    tidemap(&daemon, ["update", "office"]).table();
    // Turned by 7 pixels; one bit of the window has changed.
    let features =
        "u_px,v_px,descriptor\n107,52,00000000000000fe\n400,200,aaaaaaaaaaaaaaaa\n500,210,5555555555555555\n";
    let locate = |more: &[&str]| {
        let (time, args) = (at(12), ["landmark", "locate", "office", "-", "--count", "1", "--at"]);
        let args = args.into_iter().chain([&*time]).chain(more.iter().copied());
        cli::tidemap_reading(&daemon, args, features)
    };
    let found = locate(&[]).table();
    assert_eq!(found.column("node"), ["hall", "lab"]);
    assert_eq!((found.numbers("votes"), found.numbers("landmarks")), (vec![1.0, 0.0], vec![1.0, 1.0]));
    assert_eq!(found.column("heading_px"), ["7", ""]);
    let probabilities = found.numbers("probability");
    assert!(probabilities[0] > 0.5 && (probabilities.iter().sum::<f64>() - 1.0).abs() < 1e-9, "{probabilities:?}");
    assert_eq!(locate(&["--node", "lab"]).table().column("node"), ["lab"]);
    locate(&["--node", "cellar"]).fails(1, &["\"cellar\"", "hall"]);
    let short = "u_px,v_px,descriptor\n107,52,00fe\n107,52,00ff\n";
    let args = ["landmark", "locate", "office", "-", "--at", "5"];
    cli::tidemap_reading(&daemon, args, short).fails(1, &["descriptors of 8 bytes and of 2 bytes"]);
}

#[test]
fn a_wrong_file_of_landmarks_adds_nothing_and_gives_the_reason() {
    let (_data, _launch, daemon) = started();
    for (rows, words) in [
        ("attic,a,1,2,00,", "8"),
        ("attic,a,1,2,0000000000000001,\nattic,a,1,2,0000000000000001,", "twice"),
        ("attic,a,1,2,0000000000000001,\nattic,b,1,2,xx,", "line 3"),
        ("cellar,a,1,2,0000000000000001,", "cellar"),
        ("attic,a,1,2,0000000000000001,5", "along_m"),
        ("hall/lab,a,1,2,0000000000000001,", "along_m"),
    ] {
        add(&daemon, &format!("place,name,u_px,v_px,descriptor,along_m\n{rows}\n")).fails(1, &[words]);
    }
    let row = "place,name,u_px,v_px,descriptor\nattic,a,1,2,0000000000000001\n";
    let args = ["landmark", "add", "office", "-", "--descriptors", "orb"];
    cli::tidemap_reading(&daemon, args, row).fails(1, &["\"test-64\", not \"orb\""]);
    let places = tidemap(&daemon, ["landmark", "list", "office"]).table();
    assert_eq!(
        (places.column("place"), places.numbers("landmarks")),
        (vec!["hall", "lab", "hall/lab"], vec![4.0, 2.0, 2.0])
    );
    tidemap(&daemon, ["landmark", "remove", "office", "hall", "window", "door"]).fails(1, &["\"door\""]);
    tidemap(&daemon, ["landmark", "predict", "office", "hall", "--at", "5", "--from-m", "1"]).fails(2, &["parts"]);
    tidemap(&daemon, ["landmark", "prune", "office", "--below", "2"]).fails(1, &["at most 1"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_traversal_is_learned_with_the_sighting_on_its_way_or_both_are_refused() {
    let (_data, _launch, daemon) = started();
    let options = ProducerOptions::new("robot", "", "office");
    let mut producer = Producer::open(&daemon.client(), options).await.expect("opens");
    let nanos = |secs: i64| secs * 1_000_000_000;
    let traversal = TraversalReport {
        from: "hall".to_owned(),
        to: "lab".to_owned(),
        start_nanos: nanos(START_SECS),
        end_nanos: nanos(START_SECS + 4),
        success: true,
        ..TraversalReport::default()
    };
    let sighting = SightingReport {
        place: "hall/lab".to_owned(),
        to_m: Some(3.0),
        time_nanos: nanos(START_SECS + 1),
        seen: vec!["sign".to_owned()],
        traversal: Some(traversal.clone()),
        ..SightingReport::default()
    };
    producer.send_sighting(&sighting).await.expect("sent");
    let late = SightingReport { time_nanos: nanos(START_SECS + 5), ..sighting.clone() };
    let back = SightingReport { place: "hall".to_owned(), to_m: None, seen: vec![], ..sighting };
    for wrong in [late, back] {
        producer.send_sighting(&wrong).await.expect("sent");
    }
    producer.close().await.expect("closed");
    let refusals: Vec<String> = producer.take_refusals().into_iter().map(|refusal| refusal.detail).collect();
    assert!(refusals[0].contains("not within the traversal"), "{refusals:?}");
    assert!(refusals[1].contains("both must be of one edge"), "{refusals:?}");
    let counted = tokio::task::block_in_place(|| counts(&daemon));
    let expected = ["landmark/hall/lab/sign", "edge/hall/lab", "speed/hall/lab"];
    assert_eq!(counted, expected.map(|state| (state.to_owned(), 1)));
}

#[tokio::test(flavor = "multi_thread")]
async fn sightings_that_stand_for_more_than_a_record_of_the_log_are_taken_in_parts() {
    let data = tempfile::tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    let long = |number: u32| format!("{number:0>4}{}", "ä".repeat(124));
    tidemap(&daemon, ["map", "create", "office"]).table();
    let nodes: String = (0..3).map(|node| format!("node {}\n", long(node))).collect();
    cli::tidemap_reading(&daemon, ["topology", "load", "office", "-"], &nodes).table();
    let mut landmarks = "place,name,u_px,v_px,descriptor\n".to_owned();
    for node in 0..3 {
        for landmark in 0..4_096 {
            writeln!(landmarks, "{},{},1,2,00ff", long(node), long(landmark)).expect("memory");
        }
    }
    add(&daemon, &landmarks).table();
    let mut producer =
        Producer::open(&daemon.client(), ProducerOptions::new("robot", "", "office")).await.expect("opens");
    for node in 0..3 {
        let sighting =
            SightingReport { place: long(node), time_nanos: START_SECS * 1_000_000_000, ..SightingReport::default() };
        producer.send_sighting(&sighting).await.expect("sent");
    }
    producer.close().await.expect("closed");
    assert!(producer.take_refusals().is_empty());
    let map = daemon.client().map("office").await.expect("the map");
    assert_eq!(map.observations, 3 * 4_096);
    // A landmark without learned sightings is not pruned.
    tokio::task::block_in_place(|| {
        assert!(
            tidemap(&daemon, ["landmark", "prune", "office", "--below", "1", "--min-sightings", "1"])
                .table()
                .rows
                .is_empty()
        );
    });
    daemon.stop_in_order();
}
