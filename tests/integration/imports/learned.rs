//! An import ends with an update, and states what the map has learned.
//!
//! Invariant: the import succeeds, whatever becomes of the update.

use std::{
    fs,
    io::{BufRead as _, BufReader},
    process::{Child, Stdio},
};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use tidemap_tests::{
    cli,
    daemon::{Daemon, Launch},
    tokens::Tokens,
};

use super::{Bag, START_NANOS, drive, started, words, written};

fn updates(daemon: &Daemon, map: &str) -> f64 {
    words(daemon, &format!("map show {map}")).table().number("updates")
}

/// Observations and scans that wait for the first update, and the command that learns them.
fn not_learned(daemon: &Daemon, map: &str) -> (Value, Value, Value) {
    let shown = words(daemon, &format!("--output json map show {map}"));
    let rows: Value = serde_json::from_str(&shown.stdout).expect("JSON");
    let cell = |name: &str| rows[0][name].clone();
    (cell("not_learned"), cell("not_learned_scans"), cell("learn_with"))
}

#[test]
fn an_import_ends_with_an_update_that_learns_all_of_it() {
    let (folder, daemon) = started();
    let file = written(&folder, "drive.bag", &drive(30), usize::MAX);
    let line = format!("import room {} --producer robot-1", file.display());
    let first = words(&daemon, &line);
    first.table();
    let learned = "map \"room\" has learned 30 scans and 30 observations, in ";
    assert!(first.stderr.contains(learned), "{}", first.stderr);
    assert_eq!(not_learned(&daemon, "room"), (0.into(), 0.into(), Value::Null));
    assert_eq!(updates(&daemon, "room"), 1.0);

    let again = words(&daemon, &line);
    again.table();
    assert!(again.stderr.contains("map \"room\" has nothing new to learn"), "{}", again.stderr);
    assert_eq!(updates(&daemon, "room"), 1.0);

    // The part of the night before was learned at midnight.
    let nightly = words(&daemon, &line.replace("room", "nights").replace("import", "import --nightly"));
    nightly.table();
    assert!(nightly.stderr.contains("map \"nights\" has learned 30 scans"), "{}", nightly.stderr);
}

#[test]
fn an_import_without_an_update_leaves_it_to_the_user() {
    let (folder, daemon) = started();
    let file = written(&folder, "drive.bag", &drive(30), usize::MAX);
    let import = words(&daemon, &format!("import room {} --producer robot-1 --no-update", file.display()));
    import.table();
    assert!(!import.stderr.contains("learn"), "{}", import.stderr);
    assert_eq!(updates(&daemon, "room"), 0.0);
    assert_eq!(not_learned(&daemon, "room"), (30.into(), 30.into(), "tidemap update room".into()));
    let shown = words(&daemon, "--output table map show room");
    let advice = "not learned yet: 30 scans and 30 observations. There are no predictions before the first update: \
                  tidemap update room";
    assert!(shown.stderr.contains(advice), "{}", shown.stderr);

    words(&daemon, "update room").table();
    assert_eq!(not_learned(&daemon, "room"), (0.into(), 0.into(), Value::Null));
    assert!(!words(&daemon, "--output table map show room").stderr.contains("not learned"));
    // An update has learned something now: what comes later only waits.
    let more = written(&folder, "more.bag", &drive(31), usize::MAX);
    words(&daemon, &format!("import room {} --producer robot-2 --no-update", more.display())).table();
    assert_eq!(not_learned(&daemon, "room"), (31.into(), 31.into(), Value::Null));
    words(&daemon, "map create empty").table();
    assert_eq!(not_learned(&daemon, "empty"), (0.into(), Value::Null, Value::Null));
}

#[test]
fn a_producer_that_may_not_run_updates_imports_all_the_same() {
    let folder = tempfile::tempdir().expect("a folder");
    let tokens = Tokens::of(folder.path());
    let [admin, robot] = [(&["admin"][..], "admin"), (&["observer"], "robot")].map(|(roles, name)| {
        let path = folder.path().join(name);
        fs::write(&path, tokens.create(roles, &[])).expect("a file");
        path.display().to_string()
    });
    let daemon = Launch::on(&folder.path().join("data")).setting("tokens_file", tokens.path.display()).start();
    words(&daemon, &format!("--token-file {admin} map create room --grid resolution=0.1,flat,frame=odom")).table();
    let file = written(&folder, "drive.bag", &drive(10), usize::MAX);
    let import = words(&daemon, &format!("--token-file {robot} import room {} --producer robot-1", file.display()));
    import.table();
    for part in ["everything is imported", "may not run updates", "tidemap update room"] {
        assert!(import.stderr.contains(part), "{part}: {}", import.stderr);
    }
}

/// An import that waits for an update of the map, which runs already.
fn waiting(daemon: &Daemon, file: &str) -> (Child, BufReader<std::process::ChildStderr>) {
    let mut command = cli::command(&daemon.grpc, ["import", "heavy", file, "--producer", "robot-2"]);
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("the command");
    let mut stderr = BufReader::new(child.stderr.take().expect("piped"));
    let mut line = String::new();
    while !line.contains("of map \"heavy\" is running: the update follows it") {
        line.clear();
        assert!(stderr.read_line(&mut line).expect("text") > 0, "it ended without a wait");
    }
    (child, stderr)
}

fn rest(mut child: Child, mut stderr: impl std::io::Read) -> (Option<i32>, String) {
    let mut text = String::new();
    stderr.read_to_string(&mut text).expect("text");
    (child.wait().expect("an end").code(), text)
}

#[test]
fn an_import_whose_update_has_to_wait_or_is_lost_has_succeeded() {
    let (folder, daemon) = started();
    words(&daemon, "map create heavy --clock simulated").table();
    // Each row represents almost a million readings: the update takes minutes.
    let rows: Vec<String> = (0..20).flat_map(|door| [format!("0,d{door},1"), format!("950000,d{door},0")]).collect();
    let rows_file = folder.path().join("heavy.csv");
    fs::write(&rows_file, format!("time,state,value\n{}\n", rows.join("\n"))).expect("written");
    let hold = "--producer robot-1 --changes --hold-max 11d --hold-step 1s";
    words(&daemon, &format!("observe heavy {} {hold}", rows_file.display())).table();
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    runtime.block_on(async { daemon.client().run_update("heavy", None).await }).expect("an update");

    let mut bag = Bag::default();
    (0..10).for_each(|step| bag.bool("/door", START_NANOS + step, step % 2 == 0));
    let file = written(&folder, "door.bag", &bag, usize::MAX).display().to_string();
    let (child, stderr) = waiting(&daemon, &file);
    kill_process(Pid::from_child(&child), Signal::INT).expect("it runs");
    let (code, text) = rest(child, stderr);
    assert_eq!(code, Some(130), "{text}");
    assert!(text.contains("the import is complete, and the daemon continues the update: tidemap job watch"), "{text}");

    let (child, stderr) = waiting(&daemon, &file);
    daemon.kill();
    let (code, text) = rest(child, stderr);
    assert_eq!(code, Some(0), "{text}");
    for part in ["everything is imported, but the update did not succeed", "To learn it: tidemap update heavy"] {
        assert!(text.contains(part), "{part}: {text}");
    }
}
