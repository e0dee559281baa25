//! Producers that stream to a cluster while something else harms it, and the checks of the cluster's data then.
//!
//! `tidemap-lanes MAP RECORD PRODUCERS SEED ADDRESS...` reads commands from stdin, one a line, and writes what happens
//! to stdout, one JSON object a line:
//!
//! - `go`: producers stream.
//! - `pause`: they stop when everything is acknowledged.
//! - `check N new|all`: the N-th daemon has everything that was acknowledged, once.
//! - `sums N`: the checksums of all producers, by the writer of the map.
//! - `update N`: requests an update of the N-th daemon up to after everything that was sent.
//! - `alone ADDRESS`: a daemon that is alone gets the same, and learns it.
//! - `compare N ADDRESS`: the models of the N-th daemon are those of the daemon that is alone.
//! - `checked`: later checks with `new` begin here.
//!
//! Each command is answered by `{"event": COMMAND, "wrong": [...]}`. RECORD keeps the producers' marks for the next
//! run.
//!
//! Invariant: commands other than `go` and `pause` are given while producers are paused.

use std::{
    fs,
    io::{self, Write as _},
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use serde_json::{Value, json};
use tidemap_client::{Client, error::Error};
use tidemap_tests::{feed::Feed, lane_oracle as oracle, lanes::Lanes, oracle::Mark};
use tokio::sync::mpsc;

/// Each producer's states.
const STATES: u32 = 4;
/// Time between two observations: five minutes, so that a day of updates comes soon.
const STEP_NANOS: i64 = 300_000_000_000;
const SAVE_EVERY: Duration = Duration::from_secs(1);

/// The data kept for the next run.
struct Record {
    file: PathBuf,
    checked: Vec<u64>,
}

impl Record {
    /// Reads the marks and where the last check ended.
    fn open(file: &Path, producers: usize) -> (Self, Vec<Mark>) {
        let kept: Value =
            fs::read_to_string(file).ok().and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default();
        let number = |what: &str, index: usize| kept[what][index].as_u64().unwrap_or(0);
        let marks = (0..producers).map(|index| {
            let acknowledged = number("acknowledged", index);
            Mark { acknowledged, sent: number("sent", index).max(acknowledged) }
        });
        let checked = (0..producers).map(|index| number("checked", index)).collect();
        (Self { file: file.to_owned(), checked }, marks.collect())
    }

    /// Replaces the file whole.
    fn save(&self, marks: &[Mark]) {
        let acknowledged: Vec<u64> = marks.iter().map(|mark| mark.acknowledged).collect();
        let sent: Vec<u64> = marks.iter().map(|mark| mark.sent).collect();
        let text = json!({ "acknowledged": acknowledged, "sent": sent, "checked": self.checked }).to_string();
        let new = self.file.with_extension("new");
        fs::write(&new, text).and_then(|()| fs::rename(&new, &self.file)).expect("the record can be written");
    }
}

struct Kit {
    lanes: Arc<Lanes>,
    addresses: Vec<String>,
    clients: Vec<Client>,
    record: Record,
}

impl Kit {
    /// The faults found, in words; an answer that did not come is a fault too, until it comes.
    fn wrong(found: Result<Vec<String>, Error>) -> Vec<String> {
        found.unwrap_or_else(|error| vec![format!("no answer: {error}")])
    }

    async fn answer(&mut self, words: &[&str]) -> Vec<String> {
        let (map, feed, marks) = (self.lanes.map.clone(), self.lanes.feed, self.lanes.marks());
        let daemon = |word: &str| word.parse::<usize>().expect("the number of a daemon");
        match *words {
            ["go"] => self.lanes.pause(false),
            ["pause"] => {
                self.lanes.pause(true);
                // Once more after the producers have seen it.
                tokio::time::sleep(Duration::from_millis(100)).await;
                while !self.lanes.are_idle() {
                    tokio::time::sleep(Duration::from_millis(20)).await;
                }
                self.record.save(&self.lanes.marks());
            }
            ["check", which, reach] => {
                let since = if reach == "all" { vec![0; marks.len()] } else { self.record.checked.clone() };
                let client = &self.clients[daemon(which)];
                return Self::wrong(oracle::check(client, &map, &feed, &marks, &since).await);
            }
            ["sums", which] => return oracle::check_sums(&self.addresses[daemon(which)], &map, &feed, &marks).await,
            ["checked"] => {
                self.record.checked = marks.iter().map(|mark| mark.acknowledged).collect();
                self.record.save(&marks);
            }
            ["update", which] => {
                let until = oracle::time_after(&feed, &marks);
                return oracle::update(&self.clients[daemon(which)], &map, until).await.err().into_iter().collect();
            }
            ["alone", address] => {
                let alone = Client::new(address).expect("an address");
                let followed = oracle::follow_alone(&alone, &map, &feed, &marks).await;
                let until = oracle::time_after(&feed, &marks);
                return match followed {
                    Ok(()) => oracle::update(&alone, &map, until).await.err().into_iter().collect(),
                    Err(error) => vec![error],
                };
            }
            ["compare", which, address] => {
                let alone = Client::new(address).expect("an address");
                let size = (marks.len(), feed.states);
                return Self::wrong(oracle::compare(&self.clients[daemon(which)], &alone, &map, size).await);
            }
            _ => return vec![format!("no such command: {words:?}")],
        }
        Vec::new()
    }
}

/// The lines of stdin; the end of it is the end of the program.
fn commands() -> mpsc::UnboundedReceiver<String> {
    let (sender, receiver) = mpsc::unbounded_channel();
    std::thread::spawn(move || {
        for line in io::stdin().lines() {
            let Ok(line) = line else { return };
            if sender.send(line).is_err() {
                return;
            }
        }
    });
    receiver
}

fn print(event: &Value) -> io::Result<()> {
    let mut stdout = io::stdout().lock();
    writeln!(stdout, "{event}")?;
    stdout.flush()
}

#[tokio::main(flavor = "current_thread")]
async fn main() -> io::Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [map, file, producers, seed, addresses @ ..] = words.as_slice() else {
        return Err(io::Error::other("usage: tidemap-lanes MAP RECORD PRODUCERS SEED ADDRESS..."));
    };
    let number = |text: &str| text.parse::<u64>().map_err(io::Error::other);
    let (producers, seed) = (usize::try_from(number(producers)?).map_err(io::Error::other)?, number(seed)?);
    let clients: Result<Vec<Client>, Error> = addresses.iter().map(|address| Client::new(address)).collect();
    let clients = clients.map_err(io::Error::other)?;
    let (record, marks) = Record::open(Path::new(file), producers);
    let feed = Feed { states: STATES, step_nanos: STEP_NANOS, ..Feed::new(seed) };
    let (sender, mut events) = mpsc::unbounded_channel();
    let lanes = Lanes::new(map, feed, marks, sender);
    lanes.start(&clients, seed);
    let mut kit = Kit { lanes, addresses: addresses.to_vec(), clients, record };
    drop(tokio::spawn(async move {
        while let Some(event) = events.recv().await {
            // A reader that is gone ends the program at its end of stdin.
            drop(print(&event));
        }
    }));
    let mut commands = commands();
    let mut save = tokio::time::interval(SAVE_EVERY);
    loop {
        tokio::select! {
            line = commands.recv() => {
                let Some(line) = line else { break };
                let words: Vec<&str> = line.split(' ').collect();
                let wrong = kit.answer(&words).await;
                print(&json!({ "event": words[0], "wrong": wrong }))?;
            }
            _ = save.tick() => kit.record.save(&kit.lanes.marks()),
        }
    }
    kit.record.save(&kit.lanes.marks());
    Ok(())
}
