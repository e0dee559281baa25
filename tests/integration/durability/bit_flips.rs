//! Damage of single files while the daemon is stopped: a bit flips, a sector is zeroed, the end is cut off, or the file
//! is gone. The answers stay the same, or the daemon reports the damage. No damage goes unnoticed.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use rand::{Rng as _, rngs::SmallRng};
use tempfile::tempdir;
use tidemap_client::{Client, Error};
use tidemap_tests::{
    answers,
    daemon::{Daemon, Launch},
    disk,
    feed::Feed,
    herd::{Herd, Manner},
    oracle::{Oracle, producer_name, run_update, settled},
    rounds,
    stored_kinds::{self, StoredKinds},
};

use super::create_map;

const PRODUCERS: usize = 3;

/// The reports of the log about an end that was cut off.
const IS_CUT: [&str; 2] = ["had not been written whole", "records that were there may have been acknowledged"];

/// The kind of a file; bits are flipped equally often in each kind.
fn kind(file: &Path) -> Option<&'static str> {
    let name = file.file_name()?.to_str()?;
    match name {
        "MANIFEST" => Some("manifest"),
        "MAP" => Some("map"),
        "MAPS" | "HISTORY" | "NEWEST" | "CHECKPOINTS" => Some("list"),
        _ if name.ends_with(".tmh") => Some("history"),
        _ if name.ends_with(".log") => Some("log"),
        _ if name.ends_with(".tmc") => Some("checkpoint"),
        _ if file.starts_with("index") => Some("index"),
        _ => None,
    }
}

/// Some thousand observations, some updates, a checkpoint, and a tail of the log that no checkpoint covers.
async fn fill(data: &Path) {
    let launch = Launch::on(data).setting("segment_bytes", 1 << 16);
    let mut oracle = Oracle::new("office", Feed::new(77), PRODUCERS);
    let mut daemon = launch.start();
    create_map(&daemon, &oracle).await;
    let mut kinds = StoredKinds::create(&daemon);
    for until in [1_200, 2_400] {
        let senders = kinds.start(&daemon.client(), until / 8);
        kinds.settle(senders).await;
        assert_eq!(kinds.acknowledged(), [until / 8; 6]);
        run_update(&daemon.client(), stored_kinds::MAP, None).await;
        let manner = Manner { until, nightly: true, ..Manner::default() };
        assert_eq!(Herd::start(&daemon.client(), &oracle, manner, until).settle(&mut oracle).await, []);
        run_update(&daemon.client(), "office", None).await;
        daemon.stop_in_order();
        daemon = launch.start();
    }
    let tail = Manner { until: 2_700, ..Manner::default() };
    let senders = kinds.start(&daemon.client(), 320);
    kinds.settle(senders).await;
    assert_eq!(kinds.acknowledged(), [320; 6]);
    assert_eq!(Herd::start(&daemon.client(), &oracle, tail, 3).settle(&mut oracle).await, []);
    daemon.stop_in_order();
}

fn flip(file: &Path, random: &mut SmallRng) -> u64 {
    let mut bytes = fs::read(file).expect("a file can be read");
    let bit = random.random_range(0..bytes.len() as u64 * 8);
    let byte = usize::try_from(bit / 8).expect("within the file");
    bytes[byte] ^= 1 << (bit % 8);
    fs::write(file, bytes).expect("a file can be written");
    bit
}

/// The harm done to a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Harm {
    FlippedBit,
    ZeroedSector,
    Truncation,
    Deletion,
}

/// Harms a file; where.
fn harm(harm: Harm, file: &Path, random: &mut SmallRng) -> String {
    let length = fs::metadata(file).expect("a file").len();
    match harm {
        Harm::FlippedBit => format!("bit {}", flip(file, random)),
        Harm::ZeroedSector => {
            let mut bytes = fs::read(file).expect("a file can be read");
            let from = random.random_range(0..bytes.len().div_ceil(512)) * 512;
            let to = bytes.len().min(from + 512);
            bytes[from..to].fill(0);
            fs::write(file, bytes).expect("a file can be written");
            format!("sector at {from}")
        }
        Harm::Truncation => {
            let left = random.random_range(0..length);
            fs::OpenOptions::new().write(true).open(file).and_then(|file| file.set_len(left)).expect("truncated");
            format!("cut to {left} of {length}")
        }
        Harm::Deletion => {
            fs::remove_file(file).expect("a file can be removed");
            "removed".to_owned()
        }
    }
}

async fn history(client: &Client, map: &str, state: &str) -> Result<String, Error> {
    let mut rows = client.reconstruct(map, state, 0, i64::MAX).await?;
    let mut text = String::new();
    while let Some(row) = rows.next().await? {
        text += &format!("{row:?}");
    }
    Ok(text)
}

/// The states, or the labels of categorical states, with their maps.
async fn states(client: &Client) -> Vec<(String, String)> {
    let mut all = Vec::new();
    for map in ["office", stored_kinds::MAP] {
        let (states, _) = client.states(map, "").await.expect("the map is there");
        all.extend(states.iter().flat_map(stored_kinds::parts).map(|part| (map.to_owned(), part)));
    }
    all
}

/// The history of every state, one line each; an error is a line with its text.
async fn histories(daemon: &Daemon) -> Vec<String> {
    let client = daemon.client();
    let mut lines = Vec::new();
    for (map, state) in states(&client).await {
        lines.push(history(&client, &map, &state).await.unwrap_or_else(|error| {
            assert_eq!(error.code(), Some(tonic::Code::DataLoss), "{error}");
            "DATA_LOSS".to_owned()
        }));
    }
    lines
}

/// A sound folder, and the answers of a daemon that opens it.
struct Sound {
    data: PathBuf,
    producers: Vec<String>,
    answers: Vec<String>,
    histories: Vec<String>,
    by_kind: BTreeMap<&'static str, Vec<PathBuf>>,
}

/// The outcome of a damage.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Outcome {
    Harmless,
    Refused,
    /// The daemon serves, and reports the lost data.
    Reported,
}

impl Sound {
    async fn new(work: &Path) -> Self {
        let data = work.join("data");
        fill(&data).await;
        let producers: Vec<String> = (0..PRODUCERS).map(producer_name).collect();
        let sound = work.join("sound");
        disk::copy_folder(&data, &sound);
        let daemon = Launch::on(&sound).start();
        settled(&daemon.client()).await;
        let (answers, histories) = (answers::all(&daemon, &producers).await, histories(&daemon).await);
        daemon.stop_in_order();
        assert!(answers.len() > 30, "there is something to compare: {answers:?}");
        assert!(histories.iter().all(|line| line.len() > 100 && line != "DATA_LOSS"), "{histories:?}");
        let mut by_kind: BTreeMap<&str, Vec<PathBuf>> = BTreeMap::new();
        for file in disk::files(&data) {
            let empty = fs::metadata(data.join(&file)).expect("a file").len() == 0;
            if let Some(kind) = kind(&file).filter(|_| !empty) {
                by_kind.entry(kind).or_default().push(file);
            }
        }
        let kinds: Vec<&str> = by_kind.keys().copied().collect();
        assert_eq!(kinds, ["checkpoint", "history", "index", "list", "log", "manifest", "map"]);
        Self { data, producers, answers, histories, by_kind }
    }

    /// Harms one file of a kind in a copy of the folder, and starts a daemon on it.
    async fn harmed(&self, copy: &Path, kind: &str, how: Harm, random: &mut SmallRng) -> Outcome {
        let files = &self.by_kind[kind];
        let file = &files[random.random_range(0..files.len())];
        disk::copy_folder(&self.data, copy);
        let what = format!("{}: {how:?}, {}", file.display(), harm(how, &copy.join(file), random));
        if kind == "checkpoint" {
            // With a valid index no checkpoint is read.
            fs::remove_dir_all(copy.join("index")).expect("the index can be removed");
        }
        let daemon = match Launch::on(copy).try_start() {
            Ok(daemon) => daemon,
            Err(exit) => {
                assert!(!exit.stderr.contains("panicked"), "{what}: {exit}");
                assert_eq!(exit.code(), Some(65), "{what}: {exit}");
                let name = file.file_name().expect("a name").to_string_lossy();
                assert!(exit.stderr.contains(&*name), "{what}: {exit}");
                return Outcome::Refused;
            }
        };
        settled(&daemon.client()).await;
        let unavailable = daemon.client().all_maps().await.expect("listed").1;
        if let Some(map) = unavailable.first() {
            let log = daemon.stop_in_order();
            assert!(!log.contains("panicked"), "{what}: {log}");
            assert!(!map.reason.is_empty() && log.contains("map unavailable"), "{what}: {log}");
            return Outcome::Refused;
        }
        let (answers, histories) = (answers::all(&daemon, &self.producers).await, histories(&daemon).await);
        let log = daemon.stop_in_order();
        assert!(!log.contains("panicked"), "{what}: {log}");
        // A cut or zeroed end of the log cannot be distinguished from a write that a power cut has torn: it is cut off,
        // and the daemon reports it.
        let is_torn = kind == "log" && how != Harm::FlippedBit && IS_CUT.iter().any(|words| log.contains(words));
        if is_torn {
            return Outcome::Reported;
        }
        for (expected, found) in self.answers.iter().zip(&answers) {
            assert_eq!(found, expected, "{what}: other replies without an error");
        }
        assert_eq!(answers.len(), self.answers.len(), "{what}: answers are missing");
        assert_eq!(histories.len(), self.histories.len(), "{what}: states are missing");
        let mut outcome = Outcome::Harmless;
        for (expected, found) in self.histories.iter().zip(&histories) {
            if matches!(kind, "history" | "list") && found == "DATA_LOSS" {
                outcome = Outcome::Reported;
            } else {
                assert_eq!(found, expected, "{what}: another history in silence");
            }
        }
        outcome
    }

    /// Harms files of all kinds in turn.
    async fn rounds(&self, work: &Path, harms: &[Harm], count: u32, random: &mut SmallRng) {
        let kinds: Vec<&str> = self.by_kind.keys().copied().collect();
        let mut outcomes: BTreeMap<(&str, Harm, Outcome), u32> = BTreeMap::new();
        for round in 0..count as usize {
            let (kind, how) = (kinds[round % kinds.len()], harms[round / kinds.len() % harms.len()]);
            let copy = work.join("harmed");
            let outcome = self.harmed(&copy, kind, how, random).await;
            *outcomes.entry((kind, how, outcome)).or_default() += 1;
            fs::remove_dir_all(&copy).expect("a copy can be removed");
        }
        for ((kind, how, outcome), count) in outcomes {
            println!("{kind}, {how:?}: {count} {outcome:?}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_a_flipped_bit_is_harmless_or_reported() {
    let seed = rounds::seed("durability_a_flipped_bit_is_harmless_or_reported");
    let work = tempdir().expect("a folder");
    let sound = Sound::new(work.path()).await;
    let count = rounds::count("TIDEMAP_FLIPS", 24);
    sound.rounds(work.path(), &[Harm::FlippedBit], count, &mut rounds::draws(seed)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_zeroed_cut_and_missing_files_are_harmless_or_reported() {
    let seed = rounds::seed("durability_zeroed_cut_and_missing_files_are_harmless_or_reported");
    let work = tempdir().expect("a folder");
    let sound = Sound::new(work.path()).await;
    let count = rounds::count("TIDEMAP_HARMS", 18);
    let harms = [Harm::ZeroedSector, Harm::Truncation, Harm::Deletion];
    sound.rounds(work.path(), &harms, count, &mut rounds::draws(seed)).await;
}
