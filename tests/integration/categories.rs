//! Categorical states from outside: a label of several, as rows of a file and as JSON; what is expected of all labels
//! together; a classification that is learned once, and survives a kill.

use std::fmt::Write as _;

use serde_json::{Value, json};
use tempfile::tempdir;
use tidemap_tests::{
    cli::{self, Outcome, Table},
    daemon::{Daemon, Launch},
    web::{Answer, call},
};

const START_SECS: i64 = 1_735_776_000;
const HOUR: i64 = 3600;
const DAYS: i64 = 8;

fn tidemap(daemon: &Daemon, line: &str) -> Outcome {
    cli::tidemap(daemon, line.split(' '))
}

fn observe(daemon: &Daemon, text: &str, more: &str) -> Outcome {
    let line = format!("observe home - --producer watch --label rows {more}");
    cli::tidemap_reading(daemon, line.trim().split(' '), text)
}

/// The activity of a person at an hour of the day.
fn activity(hour: i64) -> &'static str {
    match hour {
        0..=6 | 23 => "sleep",
        8 | 12 | 19 => "eat",
        _ => "work",
    }
}

fn rows() -> String {
    (0..DAYS * 24 * 6).fold("time,state,value\n".to_owned(), |mut text, slot| {
        let _ = writeln!(text, "{},activity,{}", START_SECS + 600 * slot, activity(slot / 6 % 24));
        text
    })
}

/// A map that has learned eight days of activities.
fn learned(daemon: &Daemon) {
    tidemap(daemon, "map create home --time-zone UTC --clock simulated").table();
    let added = tidemap(daemon, "state add home activity --kind categorical --labels sleep,eat,work").table();
    assert_eq!((added.column("kind"), added.column("labels")), (vec!["categorical"], vec!["sleep eat work"]));
    let sent = observe(daemon, &rows(), "--kind categorical").table();
    assert_eq!((sent.number("accepted"), sent.number("refused")), ((DAYS * 24 * 6) as f64, 0.0));
    tidemap(daemon, "update home").table();
}

/// A time on the day after the last.
fn after(hour: i64) -> i64 {
    START_SECS + DAYS * 24 * HOUR + hour * HOUR + HOUR / 2
}

/// Probabilities of a label, by time.
fn of_label(table: &Table, label: &str) -> Vec<f64> {
    let rows = table.column("state").into_iter().zip(table.numbers("probability"));
    rows.filter(|(state, _)| *state == format!("activity/{label}")).map(|(_, probability)| probability).collect()
}

fn likeliest(table: &Table) -> String {
    let rows = table.column("label").into_iter().zip(table.numbers("probability"));
    rows.max_by(|(_, one), (_, other)| one.total_cmp(other)).expect("labels").0.to_owned()
}

#[test]
fn labels_are_predicted_together() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    learned(&daemon);
    let times: Vec<i64> = (0..24).map(after).collect();
    let at = times.iter().map(ToString::to_string).collect::<Vec<_>>().join(",");
    for model in ["auto", "mean", "latest", "spectral", "histogram:24", "ensemble", "auto+memory"] {
        let table = tidemap(&daemon, &format!("predict home activity --at {at} --model {model}")).table();
        let labels = ["sleep", "eat", "work"].map(|label| of_label(&table, label));
        for at in 0..24 {
            let sum: f64 = labels.iter().map(|shares| shares[at]).sum();
            assert!((sum - 1.0).abs() < 1e-9, "{model} at hour {at}: {sum}");
        }
    }
    let table = tidemap(&daemon, &format!("predict home activity --at {at}")).table();
    let labels = ["sleep", "eat", "work"].map(|label| (label, of_label(&table, label)));
    for hour in 0..24 {
        let expected =
            labels.iter().max_by(|(_, one), (_, other)| one[hour].total_cmp(&other[hour])).expect("labels").0;
        assert_eq!(expected, activity(hour as i64), "hour {hour}");
    }
    let shares: Vec<f64> = labels.iter().map(|(_, shares)| shares[3]).collect();
    let entropy: f64 = shares.iter().map(|share| -share * share.log2()).sum();
    let shown = table.numbers("entropy_bits")[3];
    assert!((shown - entropy).abs() < 1e-9, "{shown} and {entropy}");
    let worth = tidemap(&daemon, &format!("info home --at {} --state activity", after(3))).table();
    assert!((worth.number("entropy_bits") - entropy).abs() < 1e-9, "{worth:?}");
    let models = tidemap(&daemon, "model show home activity").table();
    let chosen = models.column("model");
    assert_eq!(chosen.len(), 3);
    assert!(chosen.iter().all(|model| *model == chosen[0]), "one model for all labels: {chosen:?}");
}

#[test]
fn labels_are_compared_and_judged_by_their_surprise() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    learned(&daemon);
    let usual = format!("time,state,value\n{},activity,sleep\n{},activity,work\n", after(3), after(10));
    let unusual = format!("time,state,value\n{},activity,eat\n{},activity,sleep\n", after(3), after(10));
    let loss = |text: &str| {
        let outcome = cli::tidemap_reading(&daemon, "evaluate home - --models auto".split(' '), text);
        let table = outcome.table();
        assert_eq!(table.column("state"), ["activity"]);
        (table.number("log_loss_bits"), table.number("error_rate"), table.number("mse"))
    };
    let (of_usual, of_unusual) = (loss(&usual), loss(&unusual));
    assert!(of_usual.0 < 0.1 && of_usual.1 == 0.0 && of_usual.2 < 0.01, "{of_usual:?}");
    assert!(of_unusual.0 > 5.0 && of_unusual.1 == 1.0 && of_unusual.2 > 1.5, "{of_unusual:?}");
    let strange = format!("{usual}{},activity,fly\n", after(11));
    cli::tidemap_reading(&daemon, "evaluate home - --models auto".split(' '), &strange)
        .fails(1, &["row 3 (line 4) is left out: state \"activity\" has no label \"fly\"", "sleep, eat, work"]);
    let line = "observe home - --producer watch --label unusual --kind categorical";
    cli::tidemap_reading(&daemon, line.split(' '), &unusual).table();
    let found = format!("anomalies home activity --model auto --from {} --to {}", after(0), after(23));
    let found = tidemap(&daemon, &found).table();
    assert_eq!(found.column("label"), ["eat", "sleep"]);
    assert!(found.numbers("probability").iter().all(|share| *share <= 0.01), "{found:?}");
}

#[test]
fn what_is_no_label_is_refused_with_the_labels() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    learned(&daemon);
    for (line, words) in [
        ("state add home mood --kind categorical --labels good", "a categorical state has 2 to 64"),
        ("state add home mood --kind categorical --labels good,bad,good", "label \"good\" is named twice"),
        ("state add home mood --kind categorical --labels good,x", "axis of a vector or of an angle"),
        ("state add home activity --kind categorical --labels sleep,eat", "exists with other labels"),
        ("state add home activity", "is a categorical state, not a probability"),
    ] {
        tidemap(&daemon, line).fails(1, &[words]);
    }
    tidemap(&daemon, "state add home mood --labels good,bad").fails(2, &["--labels goes with --kind categorical"]);
    let many = (0..65).map(|label| format!("l{label}")).collect::<Vec<_>>().join(",");
    tidemap(&daemon, &format!("state add home mood --kind categorical --labels {many}")).fails(1, &["65 labels"]);
    tidemap(&daemon, &format!("state add home mood --kind categorical --labels {}", &many[..many.len() - 4])).table();
    let text = format!("time,state,value\n{0},activity,fly\n{0},nowhere,eat\n{0},activity,eat\n", after(8));
    let line = "observe home - --producer watch --label wrong --kind categorical";
    let outcome = cli::tidemap_reading(&daemon, line.split(' '), &text);
    assert_eq!(outcome.table_with(1).number("refused"), 2.0);
    outcome.fails(1, &["has no label \"fly\": its labels are sleep, eat, work", "is added with its labels first"]);
    // A number is no label, and a label no value of a door.
    let line = "observe home - --producer watch --label values";
    cli::tidemap_reading(&daemon, line.split(' '), &format!("time,state,value\n{},activity,1\n", after(8)))
        .fails(1, &["is a categorical state, not a single value"]);
}

fn report(daemon: &Daemon, readings: &Value) -> Answer {
    let request = json!({ "map": "home", "producer": "robot", "readings": readings });
    call(&daemon.http, "ObservationService/Report", &[], &request)
}

#[test]
fn a_reading_is_a_label_or_a_share_of_each() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).setting("http_write", true).start();
    learned(&daemon);
    let time = "2025-01-10T08:30:00Z";
    let answer = report(
        &daemon,
        &json!([
            { "state": "activity", "label": "eat", "time": time },
            { "state": "activity", "label": "sleep", "time": "2025-01-10T08:40:00Z" },
        ]),
    );
    assert_eq!((answer.code, answer.json()["refused"].clone()), (200, json!([])), "{}", answer.text());
    let shares = |shares: Value| report(&daemon, &json!([{ "state": "activity", "shares": shares, "time": time }]));
    assert_eq!(shares(json!([0.25, 0.5, 0.25])).json()["refused"], json!([]));
    for (wrong, words) in [
        (json!([0.25, 0.5, 0.5]), "the sum 1.25, not 1"),
        (json!([-0.5, 1.0, 0.5]), "share -0.5 is not between 0 and 1"),
        (json!([0.5, 0.5]), "has 3 labels, not 2"),
    ] {
        let answer = shares(wrong).json();
        assert!(answer["refused"][0]["detail"].as_str().is_some_and(|text| text.contains(words)), "{words}: {answer}");
    }
    let both = report(&daemon, &json!([{ "state": "activity", "shares": [1, 0, 0], "label": "sleep" }]));
    assert!(both.code == 400 && both.text().contains("readings[0].label"), "{}", both.text());
    // An observation is one of every label, with one sequence number.
    let kept = |label: &str| {
        let from = after(8) - HOUR;
        let line = format!("reconstruct home activity/{label} --from {from} --to {}", after(9));
        tidemap(&daemon, &line).table().numbers("value")
    };
    assert_eq!((kept("sleep"), kept("eat")), (vec![0.0, 0.25, 1.0], vec![1.0, 0.5, 0.0]));
}

#[test]
fn a_classification_is_learned_once_and_survives_a_kill() {
    let data = tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let daemon = launch.start();
    learned(&daemon);
    let likelihood = "--likelihood sleep=0.3,eat=0.3,work=0.4";
    let classify = |hour: i64| format!("classify home activity --at {} {likelihood}", after(hour));
    assert_eq!(likeliest(&tidemap(&daemon, &classify(3)).table()), "sleep", "the time decides");
    assert_eq!(likeliest(&tidemap(&daemon, &classify(12)).table()), "eat");
    let certain = format!("classify home activity --at {} --likelihood work=1", after(3));
    let certain = tidemap(&daemon, &certain).table();
    assert_eq!(certain.numbers("probability"), [0.0, 0.0, 1.0], "what has no likelihood does not hold");
    for _ in 0..3 {
        let learn = format!("{} --place kitchen --learn --producer robot --sequence 1", classify(12));
        let outcome = tidemap(&daemon, &learn);
        assert!(outcome.stderr.contains("durable up to number 2 of producer robot"), "{}", outcome.stderr);
        assert_eq!(likeliest(&outcome.table()), "eat");
    }
    for hour in [3, 4] {
        let learn = format!("{} --place bedroom --learn shares --producer robot", classify(hour));
        tidemap(&daemon, &learn).table();
    }
    daemon.kill();
    let daemon = launch.start();
    let states = tidemap(&daemon, "state list home").table();
    let counts: Vec<_> = states.column("state").into_iter().zip(states.numbers("observations")).collect();
    let rows = (DAYS * 24 * 6) as f64;
    assert_eq!(counts, [("activity", rows + 3.0), ("activity@kitchen", 1.0), ("activity@bedroom", 2.0)]);
    tidemap(&daemon, "update home").table();
    // By the time alone both are equally likely; the place distinguishes them.
    let at_place = |place: &str| {
        let line = format!("classify home activity --at {} {likelihood} --model mean --place {place}", after(12));
        tidemap(&daemon, &line).table()
    };
    let (kitchen, bedroom) = (at_place("kitchen"), at_place("bedroom"));
    let spatial = |table: &Table, label: usize| table.numbers("spatial_prior")[label];
    assert!(spatial(&kitchen, 1) > spatial(&kitchen, 0) && spatial(&bedroom, 0) > spatial(&bedroom, 1), "{kitchen:?}");
    let probability = |table: &Table, label: usize| table.numbers("probability")[label];
    assert!(probability(&kitchen, 1) > probability(&bedroom, 1), "{kitchen:?} and {bedroom:?}");
    assert_eq!(at_place("garage").column("spatial_prior"), ["", "", ""], "nothing was learned there");
}

#[test]
fn what_is_no_evidence_is_refused() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    learned(&daemon);
    observe(&daemon, "time,state,value\n1735776000,door,1\n", "--patience 5s").code.expect("an end");
    for (line, words) in [
        ("classify home activity --likelihood fly=1", "has no label \"fly\": its labels are sleep, eat, work"),
        ("classify home activity --likelihood sleep=0,eat=0", "the likelihood of every label is 0"),
        ("classify home activity --likelihood sleep=-1", "the likelihood of label 0 is -1"),
        ("classify home activity --likelihood sleep=1,sleep=2", "label \"sleep\" is named twice"),
        ("classify home activity --likelihood sleep=1 --model calibrated", "has to be trained first"),
        ("classify home nowhere --likelihood sleep=1", "state \"nowhere\" does not exist"),
    ] {
        tidemap(&daemon, line).fails(1, &[words]);
    }
    tidemap(&daemon, "classify home activity --likelihood sleep").fails(2, &["LABEL=NUMBER"]);
}

#[test]
fn a_port_for_reading_classifies_and_learns_nothing() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    learned(&daemon);
    let request = |learn: &str| {
        json!({
            "map": "home", "state": "activity", "learn": learn, "producer": "robot",
            "likelihoods": [{ "label": "eat", "likelihood": 1 }],
        })
    };
    let method = "ObservationService/ClassifyActivity";
    let answer = call(&daemon.http, method, &[], &request("ACTIVITY_LEARNING_NOTHING"));
    assert_eq!(
        (answer.code, answer.json()["labels"][1]["probability"].clone()),
        (200, json!(1.0)),
        "{}",
        answer.text()
    );
    let learn = call(&daemon.http, method, &[], &request("ACTIVITY_LEARNING_LABEL"));
    assert_eq!((learn.code, learn.reason().as_str()), (403, "READ_ONLY"), "{}", learn.text());
}

#[test]
fn a_categorical_state_is_erased_as_a_whole() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    learned(&daemon);
    tidemap(&daemon, "erase home --state activity/eat").fails(1, &["is a part of \"activity\""]);
    let gone = tidemap(&daemon, "erase home --state activity");
    assert_eq!(gone.code, Some(0), "{}", gone.stderr);
    assert_eq!(tidemap(&daemon, "state list home").table().rows, Vec::<Vec<String>>::new());
    tidemap(&daemon, "state add home activity --kind categorical --labels awake,asleep").table();
}

#[test]
fn a_task_is_worth_what_a_label_is_likely() {
    let data = tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let daemon = launch.start();
    learned(&daemon);
    let ways = "node Dock\nnode Kitchen\nlink Dock Kitchen 30\n";
    cli::tidemap_reading(&daemon, "topology load home -".split(' '), ways).table();
    let task = "task add home serve Kitchen --from 09:00 --until 18:00 --duration 30m --value 5 --value-state";
    tidemap(&daemon, &format!("{task} activity/eat/lunch")).fails(1, &["activity/eat/lunch"]);
    let added = tidemap(&daemon, &format!("{task} activity/eat")).table();
    assert_eq!(added.column("value_state"), ["activity/eat"]);
    tidemap(&daemon, "day home --date 2025-01-10 --tasks --start-node Dock --keep").table();
    daemon.kill();
    let daemon = launch.start();
    assert_eq!(tidemap(&daemon, "task list home").table().column("value_state"), ["activity/eat"]);
    let shown = tidemap(&daemon, "plan show home --date 2025-01-10").table();
    let hour = (shown.number("start") - after(0) as f64) / 3_600.0 + 0.5;
    // Within the window, somebody eats from twelve to one only.
    assert!((11.9..13.0).contains(&hour), "{hour}");
}
