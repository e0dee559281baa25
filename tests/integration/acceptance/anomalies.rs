//! Anomalies of the door: found in the past, and watched while a second process observes.

use std::{
    fs,
    io::{BufRead as _, BufReader, Read as _},
    process::{Child, Stdio},
    sync::mpsc,
    thread,
    time::{Duration, Instant},
};

use rustix::process::{Pid, kill_process};
use tidemap_tests::{
    cli::{self, Table},
    daemon::Signal,
    recordings,
};

use super::Door;

/// Timeout of a row.
const WITHIN: Duration = Duration::from_secs(60);
const NANOS: i64 = 1_000_000_000;

/// `tidemap anomalies … --watch`, as a process.
struct Watch {
    child: Child,
    lines: mpsc::Receiver<String>,
}

impl Watch {
    /// Waits until the watch has begun.
    fn start(door: &Door, args: &[&str]) -> Self {
        let args = ["anomalies", "door"].iter().chain(args).chain(&["--watch"]);
        let mut command = cli::command(&door.daemon.grpc, args);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("a process");
        let stdout = child.stdout.take().expect("a pipe");
        let (sender, lines) = mpsc::channel();
        thread::spawn(move || {
            BufReader::new(stdout).lines().map_while(Result::ok).for_each(|line| drop(sender.send(line)));
        });
        let watch = Self { child, lines };
        assert_eq!(watch.line(), "time,state,value,probability");
        watch
    }

    fn line(&self) -> String {
        self.lines.recv_timeout(WITHIN).expect("a line")
    }

    fn interrupt(&self) {
        let pid = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw).expect("a process has a number");
        kill_process(pid, Signal::INT).expect("it runs");
    }

    /// Waits for its end: exit status, the unread lines, and stderr.
    fn end(mut self) -> (Option<i32>, Vec<String>, String) {
        let since = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().expect("a child can be waited for") {
                break status;
            }
            assert!(since.elapsed() < WITHIN, "it does not end");
            thread::sleep(Duration::from_millis(5));
        };
        let mut stderr = String::new();
        self.child.stderr.take().expect("a pipe").read_to_string(&mut stderr).expect("text");
        (status.code(), self.lines.iter().collect(), stderr)
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        // The process may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The anomalies among readings, computed from `predict` at their times.
fn naive(door: &Door, readings: &[(i64, f64)], confidence: f64, model: &str) -> Vec<Vec<String>> {
    let work = tempfile::tempdir().expect("a folder");
    let file = work.path().join("times.csv");
    let times: String = readings.iter().map(|(time, _)| format!("{}\n", time / NANOS)).collect();
    fs::write(&file, format!("time\n{times}")).expect("a file");
    let file = file.to_str().expect("a path that is text");
    let predicted = door.tidemap(["predict", "door", "door", "--times", file, "--model", model]).table();
    assert_eq!(predicted.rows.len(), readings.len());
    let (texts, numbers) = (predicted.column("probability"), predicted.numbers("probability"));
    let rows = readings.iter().zip(texts).zip(numbers);
    rows.filter(|((reading, _), p)| if reading.1 < 0.5 { *p >= confidence } else { *p <= 1.0 - confidence })
        .map(|(((time, value), text), _)| vec![(time / NANOS).to_string(), value.to_string(), text.to_owned()])
        .collect()
}

fn anomalies(door: &Door, args: &[&str]) -> Table {
    let table = door.tidemap(["anomalies", "door", "door"].iter().chain(args).copied()).table();
    assert_eq!(table.columns, ["time", "value", "probability"]);
    table
}

#[test]
fn anomalies_are_the_observations_that_predictions_of_their_times_contradict() {
    let Some(door) = Door::new("Europe/London") else { return };
    door.learn();
    // 2016-01-11 to 02-08: four weeks of the ten.
    let (from, to) = ("2016-01-11T00:00:00Z", "1454889600");
    let mut readings = recordings::rows(&door.file("train.csv"));
    readings.retain(|(time, _)| (1_452_470_400 * NANOS..1_454_889_600 * NANOS).contains(time));
    assert!(readings.len() > 30_000, "{}", readings.len());
    for (confidence, model, is_unsure) in [
        ("0.99", "auto", true),
        ("0.9", "spectral", true),
        ("0.9", "histogram:week", false),
        ("0.99", "histogram:week", true),
    ] {
        let args = ["--confidence", confidence, "--from", from, "--to", to, "--model", model];
        let found = anomalies(&door, &args);
        let expected = naive(&door, &readings, confidence.parse().expect("a number"), model);
        assert!(is_unsure || expected.len() > 20, "{model}: {}", expected.len());
        assert!(expected.len() < readings.len() / 50, "{model}: {}", expected.len());
        assert_eq!(found.rows, expected, "{model} at {confidence}");
    }
    assert_eq!(anomalies(&door, &["--from", from, "--to", to, "--model", "auto"]), {
        anomalies(&door, &["--confidence", "0.99", "--from", from, "--to", to, "--model", "auto"])
    });
    assert_eq!(anomalies(&door, &["--from", "0", "--to", "1", "--model", "auto"]).rows, Vec::<Vec<String>>::new());
}

#[test]
fn misuse_of_anomalies_is_an_error() {
    let Some(door) = Door::new("Europe/London") else { return };
    let rows = "time,state,value\n1451865600,door,1\n";
    assert_eq!(cli::tidemap_reading(&door.daemon, ["observe", "door", "-"], rows).table().number("accepted"), 1.0);
    let ask = |args: &[&str]| door.tidemap(["anomalies", "door"].iter().chain(args).copied());
    let times = ["--from", "100", "--to", "200"];
    for (args, words) in [
        (&["door", "--confidence", "0.3"][..], ["--confidence", "above 0.5"]),
        (&["door", "--confidence", "much"], ["--confidence", "above 0.5"]),
        (&["door", "window", "--model", "auto"], ["one state", "--watch"]),
        (&["--model", "auto"], ["one state", "--watch"]),
        (&["door", "--confidence", "0.8"], ["from a confidence of 0.9 on", "--model auto"]),
        (&["door", "--top", "5", "--model", "auto"], ["--top", "--model"]),
    ] {
        ask(&[args, &times].concat()).fails(2, &words);
    }
    ask(&["door", "--from", "100"]).fails(2, &["--to"]);
    ask(&["door", "--from", "200", "--to", "100"]).fails(2, &["--from must be before --to"]);
    ask(&["door", "--watch", "--from", "100", "--to", "200"]).fails(2, &["--watch", "--from"]);
    ask(&["window", "--from", "100", "--to", "200"]).fails(1, &["window", "states here: door"]);
    ask(&["window", "--watch"]).fails(1, &["window", "states here: door"]);
    ask(&["cell/1/2/3", "--watch"]).fails(1, &["has no grid"]);
    for (model, words) in
        [("latest", "newest value"), ("persistence", "newest value"), ("auto+persistence", "newest value")]
    {
        ask(&["door", "--from", "100", "--to", "200", "--model", model]).fails(1, &[words]);
        ask(&["door", "--watch", "--model", model]).fails(1, &[words]);
    }
    ask(&["door", "--watch", "--model", "calibrated"]).fails(1, &["must be trained", "auto, mean or spectral"]);
    door.tidemap(["map", "create", "forgetful", "--retention", "none"]).table();
    cli::tidemap_reading(&door.daemon, ["observe", "forgetful", "-"], rows).table();
    door.tidemap(["anomalies", "forgetful", "door", "--from", "0", "--to", "9", "--model", "auto"])
        .fails(1, &["keeps no history", "retention"]);
    // Unusual runs are kept without history.
    assert!(door.tidemap(["anomalies", "forgetful", "--from", "0", "--to", "9"]).table().rows.is_empty());
}

#[test]
fn a_watch_sees_an_anomaly_that_a_second_process_sends_and_not_what_is_expected() {
    let Some(door) = Door::new("Europe/London") else { return };
    door.learn();
    // In the week after: a time when the door is certainly closed, and one when it may be open.
    let week = door
        .tidemap([
            "predict",
            "door",
            "door",
            "--from",
            "2016-03-14T00:00:00Z",
            "--to",
            "2016-03-21T00:00:00Z",
            "--step",
            "10m",
            "--model",
            "ensemble",
        ])
        .table();
    let (times, texts, numbers) = (week.column("time"), week.column("probability"), week.numbers("probability"));
    let place = |is: fn(f64) -> bool| numbers.iter().position(|&p| is(p)).expect("there is such a time");
    let (maybe, closed) = (place(|p| p > 0.3), place(|p| p <= 0.01));
    let all = Watch::start(&door, &["--confidence", "0.99"]);
    let of_the_door = Watch::start(&door, &["door"]);
    let rows = format!(
        "time,state,value\n{0},door,1\n{1},door,0\n{1},gate,1\n{1},door,1\n{0},door,0\n{1},door,0.7\n",
        times[maybe], times[closed]
    );
    let sent = cli::tidemap_reading(&door.daemon, ["observe", "door", "-", "--producer", "second"], &rows).table();
    assert_eq!(sent.number("accepted"), 6.0);
    for watch in [all, of_the_door] {
        for value in ["1", "0.7"] {
            assert_eq!(watch.line(), format!("{},door,{value},{}", times[closed], texts[closed]));
        }
        watch.interrupt();
        let (code, unread, stderr) = watch.end();
        assert_eq!((code, unread), (Some(130), Vec::<String>::new()), "{stderr}");
    }
    // A watch ends with its map, or with the daemon.
    let watch = Watch::start(&door, &[]);
    door.tidemap(["map", "create", "other"]).table();
    cli::tidemap_reading(&door.daemon, ["observe", "other", "-"], "time,state,value\n1451865600,door,1\n").table();
    door.tidemap(["map", "delete", "door", "--yes"]);
    let (code, unread, stderr) = watch.end();
    assert_eq!((code, unread), (Some(1), Vec::<String>::new()), "{stderr}");
    assert!(stderr.contains("the map was deleted"), "{stderr}");
    door.tidemap(["map", "create", "door"]).table();
    let watch = Watch::start(&door, &[]);
    let log = door.daemon.stop_in_order();
    let (code, _, stderr) = watch.end();
    assert_eq!(code, Some(1), "{stderr}\n{log}");
    assert!(stderr.contains("stopping"), "{stderr}");
}
