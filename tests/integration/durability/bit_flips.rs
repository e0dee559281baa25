//! Single bits that flip while the daemon is stopped: the answers stay the same, or the daemon reports the damage and
//! does not start. No damage goes unnoticed.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use rand::{Rng as _, rngs::SmallRng};
use tempfile::tempdir;
use tidemap_tests::{
    answers,
    daemon::Launch,
    disk,
    feed::Feed,
    herd::{Herd, Manner},
    oracle::{Oracle, producer_name, run_update, settled},
    rounds,
};

use super::create_map;

const PRODUCERS: usize = 3;

/// The kind of a file; bits are flipped equally often in each kind.
fn kind(file: &Path) -> Option<&'static str> {
    let name = file.file_name()?.to_str()?;
    match name {
        "MANIFEST" => Some("manifest"),
        "MAP" => Some("map"),
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
    for until in [1_200, 2_400] {
        let manner = Manner { until, nightly: true, ..Manner::default() };
        assert_eq!(Herd::start(&daemon.client(), &oracle, manner, until).settle(&mut oracle).await, []);
        run_update(&daemon.client(), "office", None).await;
        daemon.stop_in_order();
        daemon = launch.start();
    }
    let tail = Manner { until: 2_700, ..Manner::default() };
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

#[tokio::test(flavor = "multi_thread")]
async fn durability_a_flipped_bit_is_harmless_or_reported() {
    let seed = rounds::seed("durability_a_flipped_bit_is_harmless_or_reported");
    let mut random = rounds::draws(seed);
    let work = tempdir().expect("a folder");
    let data = work.path().join("data");
    fill(&data).await;

    let producers: Vec<String> = (0..PRODUCERS).map(producer_name).collect();
    let sound = work.path().join("sound");
    disk::copy_folder(&data, &sound);
    let daemon = Launch::on(&sound).start();
    settled(&daemon.client()).await;
    let expected = answers::all(&daemon, &producers).await;
    daemon.stop_in_order();
    assert!(expected.len() > 30, "there is something to compare: {expected:?}");

    let mut by_kind: BTreeMap<&str, Vec<PathBuf>> = BTreeMap::new();
    for file in disk::files(&data) {
        let empty = fs::metadata(data.join(&file)).expect("a file").len() == 0;
        if let Some(kind) = kind(&file).filter(|_| !empty) {
            by_kind.entry(kind).or_default().push(file);
        }
    }
    let kinds: Vec<&str> = by_kind.keys().copied().collect();
    assert_eq!(kinds, ["checkpoint", "index", "log", "manifest", "map"]);
    let mut outcomes: BTreeMap<(&str, bool), u32> = BTreeMap::new();
    for round in 0..rounds::count("TIDEMAP_FLIPS", 60) {
        let kind = kinds[round as usize % kinds.len()];
        let files = &by_kind[kind];
        let file = &files[random.random_range(0..files.len())];
        let copy = work.path().join("flipped");
        disk::copy_folder(&data, &copy);
        let bit = flip(&copy.join(file), &mut random);
        if kind == "checkpoint" {
            // With a valid index no checkpoint is read.
            fs::remove_dir_all(copy.join("index")).expect("the index can be removed");
        }
        let what = format!("bit {bit} of {}", file.display());
        let served = match Launch::on(&copy).try_start() {
            Ok(daemon) => {
                settled(&daemon.client()).await;
                let unavailable = daemon.client().all_maps().await.expect("listed").1;
                let found = if unavailable.is_empty() { answers::all(&daemon, &producers).await } else { Vec::new() };
                let log = daemon.stop_in_order();
                if let Some(map) = unavailable.first() {
                    assert!(!log.contains("panicked"), "{what}: {log}");
                    assert!(!map.reason.is_empty() && log.contains("map unavailable"), "{what}: {log}");
                    *outcomes.entry((kind, false)).or_default() += 1;
                    fs::remove_dir_all(&copy).expect("a copy can be removed");
                    continue;
                }
                assert!(!log.contains("panicked"), "{what}: {log}");
                for (expected, found) in expected.iter().zip(&found) {
                    assert_eq!(found, expected, "{what}: other answers in silence");
                }
                assert_eq!(found.len(), expected.len(), "{what}: answers are missing");
                true
            }
            Err(exit) => {
                assert_eq!(exit.code(), Some(65), "{what}: {exit}");
                let name = file.file_name().expect("a name").to_string_lossy();
                assert!(exit.stderr.contains("damaged") && exit.stderr.contains(&*name), "{what}: {exit}");
                assert!(!exit.stderr.contains("panicked"), "{what}: {exit}");
                false
            }
        };
        *outcomes.entry((kind, served)).or_default() += 1;
        fs::remove_dir_all(&copy).expect("a copy can be removed");
    }
    for ((kind, served), count) in outcomes {
        println!("{kind}: {count} {}", if served { "served as before" } else { "refused at start, or set aside" });
    }
}
