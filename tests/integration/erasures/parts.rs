//! The observations of a producer, or of an interval, are withdrawn: the map is as if they had never been made.

use tidemap_client::{Client, updates::Erasure};
use tidemap_tests::tokens::Tokens;
use tonic::Code;

use super::*;

/// A value that only the lost robot observes.
fn lost_marks() -> Vec<Vec<u8>> {
    vec![BED.to_le_bytes().to_vec()]
}

fn observe_as(daemon: &Daemon, producer: &str, text: &str) -> Outcome {
    tidemap_reading(daemon, ["observe", "home", "-", "--producer", producer, "--label", "day"], text)
}

/// Three weeks with an update after each, and two days that are pending; the lost robot saw the door, and a bed.
fn send_both(daemon: &Daemon, models: &str, with_lost: bool) {
    tidemap(daemon, ["map", "create", "home", "--models", models]).table();
    for (days, is_learned) in [(7, true), (14, true), (DAYS, true), (DAYS + 2, false)] {
        observe_as(daemon, "good", &door(0..days)).table();
        if with_lost {
            observe_as(daemon, "lost", &seen_by_lost(days)).table();
        }
        if is_learned {
            let until = (START_SECS + days * 86_400 - 6 * 3600).to_string();
            tidemap(daemon, ["update", "home", "--until", until.as_str()]).table();
        }
    }
}

fn seen_by_lost(days: i64) -> String {
    times(0..days).fold("time,state,value\n".to_owned(), |mut text, time| {
        let _ = writeln!(text, "{},door,{BED}\n{},bed-77113,0", time + 700, time + 800);
        text
    })
}

fn lost() -> Erasure {
    Erasure { producer: Some("lost".to_owned()), ..Erasure::default() }
}

/// Waits until a start has repeated the last update, if the kill came before it was saved.
async fn updated(daemon: &Daemon) {
    while daemon.client().map("home").await.expect("known").last_update.generation < 3 {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lost_robot_is_withdrawn_as_if_it_had_never_been() {
    let [data, other, saved] = [(); 3].map(|()| tempdir().expect("a folder"));
    let launch = Launch::on(data.path());
    let daemon = launch.start();
    send_both(&daemon, "all", true);
    let never = Launch::on(other.path()).start();
    send_both(&never, "all", false);
    assert!(!holding(data.path(), &lost_marks()).is_empty(), "there is nothing to erase");
    let count = (DAYS + 2) * 48 * 2;

    let erased = tidemap(&daemon, ["erase", "home", "--producer", "lost", "--label", "day"]).table();
    assert_eq!((erased.number("observations"), erased.number("states")), (count as f64, 2.0));
    let left = holding(data.path(), &[lost_marks(), vec![b"bed-77113".to_vec()]].concat());
    assert!(left.is_empty(), "{left:?}");
    assert_eq!(of_door(&daemon).await, of_door(&never).await);
    daemon.client().create_backup(&saved.path().join("new").display().to_string()).await.expect("made");
    assert!(holding(saved.path(), &lost_marks()).is_empty());

    for one in [&daemon, &never] {
        tidemap(one, ["update", "home"]).table();
    }
    let learned = of_door(&never).await;
    assert_eq!(of_door(&daemon).await, learned);
    // Sent again, it is not counted again.
    let again = observe_as(&daemon, "lost", &seen_by_lost(DAYS + 2)).table();
    assert_eq!((again.number("accepted"), again.number("duplicate")), (0.0, count as f64));
    daemon.kill();
    let daemon = launch.start();
    assert_eq!(of_door(&daemon).await, learned);

    // An hour of all producers.
    let hour = [START_SECS + 86_400 * 3, START_SECS + 86_400 * 3 + 3600].map(|secs| secs.to_string());
    let erased = tidemap(&daemon, ["erase", "home", "--from", &hour[0], "--to", &hour[1]]).table();
    assert_eq!(erased.number("observations"), 2.0);
    let seen = tidemap(&daemon, ["reconstruct", "home", "door", "--from", &hour[0], "--to", &hour[1]]).table();
    assert!(seen.column("time").is_empty());
    daemon.stop_in_order();
    let checked =
        std::process::Command::new(tidemap_tests::binaries::tidemapd()).arg("check").arg(data.path()).output();
    assert!(checked.expect("runs").status.success());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_kill_while_a_robot_is_withdrawn_leaves_it_withdrawn_or_not() {
    let data = tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let mut daemon = launch.start();
    send_both(&daemon, "calibrated", true);
    let before = of_door(&daemon).await.0;
    let mut after = None;
    let mut completed = 0;
    // Each kill comes a little later, until one comes too late.
    let mut wait = Duration::from_millis(2);
    for round in 0..60 {
        let ordered = daemon.client().erase_part("home", lost()).await;
        tokio::time::sleep(wait).await;
        wait = wait.mul_f64(1.3);
        daemon.kill();
        let maps = data.path().join("maps");
        let has_begun = maps.join("00000001/ERASE").exists() || !maps.join("00000001").exists();
        daemon = launch.start();
        updated(&daemon).await;
        let now = of_door(&daemon).await.0;
        let is_left = !holding(data.path(), &lost_marks()).is_empty();
        assert_eq!(is_left, now == before, "round {round}: neither the map before nor the map after");
        assert!(!has_begun || !is_left, "round {round}: begun, and not completed");
        assert!(ordered.is_ok());
        completed += u32::from(has_begun);
        assert_eq!(fs::read_dir(&maps).expect("readable").count(), 1, "round {round}: leftovers");
        if !is_left {
            assert_eq!(*after.get_or_insert_with(|| now.clone()), now);
            break;
        }
    }
    assert!(after.is_some() && completed <= 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_corrected_file_is_sent_in_place_of_the_one_before() {
    let [data, work] = [(); 2].map(|()| tempdir().expect("a folder"));
    let daemon = Launch::on(data.path()).start();
    tidemap(&daemon, ["map", "create", "home"]).table();
    let file = work.path().join("monday.csv");
    let rows = |fifth: &str| {
        (0..10).fold("time,state,value\n".to_owned(), |mut text, row| {
            let value = if row == 4 { fifth.to_owned() } else { (row % 2).to_string() };
            let _ = writeln!(text, "{},door,{value}", START_SECS + 3600 * row);
            text
        })
    };
    fs::write(&file, rows("ajar")).expect("written");
    let shown = file.display().to_string();
    let send = |more: &[&str]| {
        let args = ["observe", "home", shown.as_str(), "--producer", "robot"];
        tidemap(&daemon, args.iter().chain(more).copied())
    };
    let command = format!("tidemap observe home --producer robot {shown} --replace");
    send(&[]).fails(1, &["row 5 (line 6)", "--refused FILE", &command]);
    tidemap(&daemon, ["update", "home"]).table();
    fs::write(&file, rows("1")).expect("written");
    send(&[]).fails(1, &["differs", "nothing was sent", &command]);
    let replaced = send(&["--replace"]).table();
    assert_eq!((replaced.number("accepted"), replaced.number("duplicate")), (10.0, 0.0));
    let observed = || tidemap(&daemon, ["state", "list", "home"]).table().number("observations");
    assert_eq!(observed(), 10.0);
    let again = send(&[]).table();
    assert_eq!((again.number("accepted"), again.number("duplicate")), (0.0, 10.0));
    // Rows that only follow at the end continue the sequence.
    fs::write(&file, rows("1") + &format!("{},door,1\n", START_SECS + 90_000)).expect("written");
    let more = send(&[]).table();
    assert_eq!((more.number("accepted"), more.number("duplicate"), observed()), (1.0, 10.0, 11.0));
    // A file that was never sent is sent.
    let other = send(&["--label", "other", "--replace"]).table();
    assert_eq!((other.number("accepted"), observed()), (11.0, 22.0));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_part_that_cannot_be_erased_is_refused_in_words() {
    let data = tempdir().expect("a folder");
    let tokens = Tokens::of(data.path());
    let made = [
        tokens.create(&["admin"], &[]),
        tokens.create(&["operator", "observer", "planner"], &[]),
        tokens.create(&["admin"], &["other-*"]),
        tokens.create(&["admin"], &["short"]),
    ];
    let daemon = Launch::on(&data.path().join("data")).setting("tokens_file", tokens.path.display()).start();
    let [admin, operator, other, scoped] =
        made.map(|token| Client::with_token(&daemon.grpc, &token).expect("loopback needs no TLS"));
    for (name, keeps) in [("home", true), ("short", false)] {
        let retention =
            if keeps { tidemap_client::maps::Retention::Forever } else { tidemap_client::maps::Retention::None };
        let new =
            tidemap_client::maps::NewMap { name: name.to_owned(), retention: Some(retention), ..Default::default() };
        admin.create_map(new).await.expect("a new map");
        let options = tidemap_client::observe::ProducerOptions::new("lost", "day", name);
        let mut producer = tidemap_client::observe::Producer::start(&admin, options);
        for slot in 0..48 {
            producer.send("door", (START_SECS + 1800 * slot) * 1_000_000_000, 1.0).await.expect("sent");
        }
        producer.close().await.expect("durable");
        let job = admin.run_update(name, None).await.expect("ordered");
        let mut watch = admin.watch_job(job.id).await.expect("known");
        while watch.next().await.expect("answered").is_some() {}
    }
    for (refused, code) in [(operator, Code::PermissionDenied), (other, Code::NotFound)] {
        let error = refused.erase_part("home", lost()).await.expect_err("not allowed");
        assert!([Code::PermissionDenied, code].contains(&error.code().expect("a status")), "{error}");
    }
    for (what, code, words) in [
        (Erasure { producer: Some("found".to_owned()), ..Erasure::default() }, Code::NotFound, "tidemap producer list"),
        (Erasure { label: Some("night".to_owned()), ..lost() }, Code::NotFound, "night"),
        (Erasure { state: Some("gate".to_owned()), ..lost() }, Code::NotFound, "gate"),
        (Erasure::default(), Code::InvalidArgument, "name what is to be erased"),
        (Erasure { label: Some("day".to_owned()), ..Erasure::default() }, Code::InvalidArgument, "producer"),
        (Erasure { from_nanos: Some(5), to_nanos: Some(5), ..lost() }, Code::InvalidArgument, "later than"),
        (Erasure { forget_sequence: true, ..lost() }, Code::InvalidArgument, "name producer and label"),
    ] {
        let error = scoped.erase_part("short", what.clone()).await.expect_err("refused");
        assert_eq!(error.code(), Some(code), "{what:?}: {error}");
        assert!(error.to_string().contains(words), "{error}");
    }
    // The history of the map was never kept.
    let job = scoped.erase_part("short", lost()).await.expect("ordered");
    let mut watch = scoped.watch_job(job.id).await.expect("known");
    let mut last = job;
    while let Some(job) = watch.next().await.expect("answered") {
        last = job;
    }
    assert_eq!(last.state, JobState::Failed);
    for words in ["\"door\"", "cannot be learned again", "Erase the state as a whole"] {
        assert!(last.error.contains(words), "{}", last.error);
    }
    assert_eq!(scoped.states("short", "").await.expect("listed").0[0].observations, 48);
}
