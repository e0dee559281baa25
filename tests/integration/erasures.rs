//! Data about people is erased: no file holds it, the map is as if it had never been observed, whatever interrupts it.

use std::{fmt::Write as _, fs, path::Path, time::Duration};

use tempfile::tempdir;
use tidemap_client::{
    queries::ModelSelector,
    updates::{JobCause, JobState},
};
use tidemap_tests::{
    cli::{Outcome, tidemap, tidemap_reading},
    daemon::{Daemon, Launch},
    disk::files,
};

mod parts;

/// A Monday.
const START_SECS: i64 = 1_736_121_600;
const DAYS: i64 = 21;
/// The personal data: names, and a value in the bytes of an f64.
const BED: f64 = 0.773_113_077_1;

fn marks() -> Vec<Vec<u8>> {
    vec![b"anna-77113".to_vec(), b"bed-77113".to_vec(), BED.to_le_bytes().to_vec()]
}

/// Files of a folder that hold any of the marks.
fn holding(folder: &Path, marks: &[Vec<u8>]) -> Vec<String> {
    let holds = |bytes: &[u8]| marks.iter().any(|mark| bytes.windows(mark.len()).any(|window| window == &mark[..]));
    let found = files(folder).into_iter().filter(|file| holds(&fs::read(folder.join(file)).unwrap_or_default()));
    found.map(|file| file.display().to_string()).collect()
}

fn times(days: std::ops::Range<i64>) -> impl Iterator<Item = i64> {
    (days.start * 48..days.end * 48).map(|slot| START_SECS + 1800 * slot)
}

fn scalars(state: &str, days: std::ops::Range<i64>, value: impl Fn(i64) -> f64) -> String {
    times(days).fold("time,state,value\n".to_owned(), |mut text, time| {
        let _ = writeln!(text, "{time},{state},{}", value(time));
        text
    })
}

fn door(days: std::ops::Range<i64>) -> String {
    scalars("door", days, |time| f64::from(u8::from((time / 5000) % 3 == 0)))
}

fn beds(days: std::ops::Range<i64>) -> String {
    scalars("bed-77113", days, |_| BED)
}

fn people(days: std::ops::Range<i64>) -> String {
    times(days).fold("time,state,x,y\n".to_owned(), |mut text, time| {
        let _ = writeln!(text, "{time},anna-77113,{},{}", time % 7919, time % 17);
        text
    })
}

fn observe(daemon: &Daemon, label: &str, text: &str) -> Outcome {
    tidemap_reading(daemon, ["observe", "home", "-", "--producer", "robot", "--label", label], text)
}

/// A map with what was learned of three weeks, and a day that is pending.
fn send_weeks(daemon: &Daemon, create: &[&str], with_people: bool) {
    tidemap(daemon, ["map", "create", "home"].iter().chain(create)).table();
    for days in [0..DAYS - 1, DAYS - 1..DAYS] {
        // The people are added before the door, so that its id changes.
        if with_people {
            // Tasks whose value the states multiply, the first before there are states.
            let task = ["task", "add", "home", "greet", "bedside", "--duration", "10m", "--value-state"];
            let state = if days.start == 0 { "bed-77113" } else { "anna-77113/x" };
            tidemap(daemon, task.iter().chain(&[state])).table();
            observe(daemon, "people", &people(0..days.end)).table();
            observe(daemon, "beds", &beds(0..days.end)).table();
        }
        observe(daemon, "doors", &door(0..days.end)).table();
        if with_people {
            // A location of the states, and a plan that observes there and does the task.
            tidemap(daemon, ["location", "set", "home", "corner", "bed-77113", "door"]).table();
            tidemap_reading(
                daemon,
                ["topology", "load", "home", "-"],
                "node bedside\nnode hall\nlink bedside hall 3\n",
            )
            .table();
            let plan = ["day", "home", "--date", "2025-02-01", "--tasks", "--keep", "--start-node", "hall"];
            tidemap(daemon, plan).table();
        }
        if days.start == 0 {
            let until = (START_SECS + days.end * 86_400).to_string();
            tidemap(daemon, ["update", "home", "--until", until.as_str()]).table();
        }
    }
}

async fn erase(daemon: &Daemon, state: &str) {
    let job = daemon.client().erase("home", state).await.expect("ordered");
    assert_eq!((job.cause, job.map.as_str()), (JobCause::Erasure, "home"));
    let mut watch = daemon.client().watch_job(job.id).await.expect("known");
    let mut last = job;
    while let Some(job) = watch.next().await.expect("answered") {
        last = job;
    }
    assert_eq!((last.state, last.error.as_str()), (JobState::Done, ""));
}

/// Predictions of the door, to the last bit, and all that is shown of it.
async fn of_door(daemon: &Daemon) -> (Vec<u64>, Vec<String>) {
    let times: Vec<i64> = (0..500).map(|slot| (START_SECS + slot * 6011) * 1_000_000_000).collect();
    let mut answer = daemon.client().predict("home", vec!["door".to_owned()], times, ModelSelector::default());
    let mut bits = Vec::new();
    while let Some(run) = answer.next().await.expect("a prediction") {
        bits.extend(run.probabilities.iter().map(|p| p.to_bits()));
    }
    let shown = [
        vec!["state", "list", "home"],
        vec!["model", "show", "home", "door"],
        vec!["reconstruct", "home", "door", "--from", "2025-01-01T00:00:00Z", "--to", "2025-03-01T00:00:00Z"],
        vec!["predict", "home", "door", "--at", "2025-01-30T10:00:00Z", "--model", "hypertime-em"],
    ];
    let shown = shown.map(|args| {
        let outcome = tidemap(daemon, args);
        outcome.table();
        outcome.stdout
    });
    (bits, shown.to_vec())
}

async fn as_if_never_observed(create: &[&str]) {
    let [data, other, saved] = [(); 3].map(|()| tempdir().expect("a folder"));
    let launch = Launch::on(data.path());
    let daemon = launch.start();
    send_weeks(&daemon, create, true);
    let never = Launch::on(other.path()).start();
    send_weeks(&never, create, false);
    // A model that is kept under the door's id of before.
    of_door(&daemon).await;
    for mark in marks() {
        assert!(!holding(data.path(), &[mark]).is_empty(), "there is nothing to erase");
    }
    daemon.client().create_backup(&saved.path().join("old").display().to_string()).await.expect("made");
    assert!(!holding(saved.path(), &marks()).is_empty());

    let update = daemon.client().jobs().await.expect("jobs").into_iter().find(|job| job.error.is_empty());
    let update = update.expect("an update").id;
    assert!(daemon.client().update_report(update, "").await.is_ok());
    erase(&daemon, "anna-77113").await;
    let report = daemon.client().update_report(update, "").await;
    assert!(report.is_err_and(|error| error.to_string().contains("erased")), "no report names it");
    assert!(holding(data.path(), &marks()[..1]).is_empty(), "{:?}", holding(data.path(), &marks()[..1]));
    tidemap(&daemon, ["erase", "home", "--state", "bed-77113"]).table();
    let left = holding(data.path(), &marks());
    assert!(left.is_empty(), "{left:?}");
    assert_eq!(tidemap(&daemon, ["location", "list", "home"]).table().column("states"), ["door"]);
    let plan = tidemap(&daemon, ["plan", "show", "home", "--date", "2025-02-01"]).table();
    assert!(plan.column("location").contains(&"corner"), "a location is a thing of its own: {:?}", plan.rows);
    assert_eq!(of_door(&daemon).await, of_door(&never).await);
    for folder in ["old", "new"] {
        let folder = saved.path().join(folder);
        daemon.client().create_backup(&folder.display().to_string()).await.expect("made");
        let left = holding(&folder, &marks());
        assert!(left.is_empty(), "{left:?}");
    }

    // The pending observations are learned as in the other daemon.
    for one in [&daemon, &never] {
        tidemap(one, ["update", "home"]).table();
    }
    let learned = of_door(&never).await;
    assert_eq!(of_door(&daemon).await, learned);
    // Sent again, it is not counted again; what is new, is.
    let again = observe(&daemon, "people", &people(0..DAYS)).table();
    assert_eq!((again.number("accepted"), again.number("duplicate")), (0.0, (DAYS * 48) as f64));
    assert_eq!(of_door(&daemon).await, learned);
    daemon.stop_in_order();
    let daemon = launch.start();
    assert_eq!(of_door(&daemon).await, learned);
    let more = observe(&daemon, "people", &people(0..DAYS + 1)).table();
    assert_eq!(more.number("accepted"), 48.0);
    daemon.kill();
    let daemon = launch.start();
    let states = tidemap(&daemon, ["state", "list", "home"]).table();
    assert_eq!(states.column("state"), ["door", "anna-77113"]);
    daemon.stop_in_order();
    let checked =
        std::process::Command::new(tidemap_tests::binaries::tidemapd()).arg("check").arg(data.path()).output();
    assert!(checked.expect("runs").status.success());
}

#[tokio::test(flavor = "multi_thread")]
async fn an_erased_state_leaves_nothing_and_the_map_as_if_it_had_never_been() {
    as_if_never_observed(&[]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn so_does_one_of_a_map_with_a_grid() {
    as_if_never_observed(&["--grid", "resolution=0.1"]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_kill_during_an_erasure_leaves_it_complete_or_not_begun() {
    let data = tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let mut daemon = launch.start();
    send_weeks(&daemon, &[], true);
    let before = of_door(&daemon).await.0;
    let mut completed = 0;
    for round in 0..40 {
        let client = daemon.client();
        if client.states("home", "").await.expect("listed").0.iter().all(|state| state.name != "bed-77113") {
            let label = format!("beds-{round}");
            observe(&daemon, &label, &beds(0..DAYS)).table();
            tidemap(&daemon, ["update", "home"]).table();
        }
        let ordered = client.erase("home", "bed-77113").await;
        tokio::time::sleep(Duration::from_micros(500 * round)).await;
        daemon.kill();
        let maps = data.path().join("maps");
        let has_begun = maps.join("00000001/ERASE").exists() || !maps.join("00000001").exists();
        daemon = launch.start();
        let left = holding(data.path(), &marks()[1..]);
        let is_listed =
            daemon.client().states("home", "").await.expect("listed").0.iter().any(|s| s.name == "bed-77113");
        assert_eq!(is_listed, !left.is_empty(), "round {round}: {left:?}");
        assert!(!has_begun || !is_listed, "round {round}: begun, and not completed");
        assert!(ordered.is_ok());
        completed += u32::from(has_begun);
        assert_eq!(fs::read_dir(&maps).expect("readable").count(), 1, "round {round}: leftovers");
        // The door learns more when the beds are observed again: only the first rounds are the same.
        if round == 0 {
            assert_eq!(of_door(&daemon).await.0, before);
        }
    }
    assert!(completed > 3, "too few kills met an erasure: {completed}");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_erased_is_refused_in_words() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    send_weeks(&daemon, &["--grid", "resolution=0.1"], true);
    for (state, words) in [
        ("nobody", vec!["nobody", "door"]),
        ("anna-77113/x", vec!["anna-77113", "axes"]),
        ("cell/1/2/0", vec!["cells", "cannot be erased"]),
    ] {
        tidemap(&daemon, ["erase", "home", "--state", state]).fails(1, &words);
    }
    tidemap(&daemon, ["erase", "house", "--state", "door"]).fails(1, &["house", "home"]);
    assert_eq!(tidemap(&daemon, ["job", "list"]).table().column("cause"), ["request"]);
}
