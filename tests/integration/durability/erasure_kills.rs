//! The daemon is killed inside an erasure, again and again: after each restart the erasure is whole, and nothing else
//! is lost.
//!
//! Invariant: a kill counts only where the erasure was ordered on the disk and not complete.

use std::{
    fmt::Write as _,
    fs,
    path::Path,
    time::{Duration, Instant},
};

use rand::Rng as _;
use tempfile::tempdir;
use tidemap_client::queries::ModelSelector;
use tidemap_tests::{
    cli::{tidemap, tidemap_reading},
    daemon::{Daemon, Launch},
    disk::{copy_folder, files},
    rounds,
};

const START_SECS: i64 = 1_736_121_600;
/// Name of the erased state, which occurs nowhere else.
const ERASED: &str = "anna-90417";
/// Kills that have to be inside an erasure, without the variable.
const KILLS: u32 = 4;
/// Longer than an erasure takes, wherever it is run.
const ERASED_WITHIN: Duration = Duration::from_secs(60);

/// A map with a state to erase and some that stay, with history, a checkpoint, and a log behind it.
fn fill(daemon: &Daemon) {
    tidemap(daemon, ["map", "create", "home"]).table();
    for part in 0..2_i64 {
        for (file, state) in [("people", ERASED), ("doors", "door"), ("lamps", "lamp")] {
            let label = format!("{file}-{part}");
            let rows = (part * 6_000..(part + 1) * 6_000).fold("time,state,value\n".to_owned(), |mut rows, row| {
                let _ = writeln!(rows, "{},{state},{}", START_SECS + 300 * row, row / 7 % 2);
                rows
            });
            tidemap_reading(daemon, ["observe", "home", "-", "--producer", "robot", "--label", &label], &rows).table();
        }
        if part == 0 {
            tidemap(daemon, ["update", "home", "--until", &(START_SECS + 300 * 6_000).to_string()]).table();
        }
    }
}

/// All answers about the states that stay, to the last bit.
async fn others(daemon: &Daemon) -> (Vec<u64>, String) {
    let times: Vec<i64> = (0..200).map(|slot| (START_SECS + slot * 9_011) * 1_000_000_000).collect();
    let states = vec!["door".to_owned(), "lamp".to_owned()];
    let mut answer = daemon.client().predict("home", states, times, ModelSelector::default());
    let mut bits = Vec::new();
    while let Some(run) = answer.next().await.expect("a prediction") {
        bits.extend(run.probabilities.iter().map(|p| p.to_bits()));
    }
    let history = ["reconstruct", "home", "door", "--from", "2025-01-01T00:00:00Z", "--to", "2025-03-01T00:00:00Z"];
    let history = tidemap(daemon, history);
    history.table();
    (bits, history.stdout)
}

async fn is_listed(daemon: &Daemon) -> bool {
    daemon.client().states("home", "").await.expect("listed").0.iter().any(|state| state.name == ERASED)
}

/// Whether an erasure has begun on the disk and is not complete.
fn is_inside(maps: &Path) -> bool {
    let names = fs::read_dir(maps).into_iter().flatten().filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    maps.join("00000001/ERASE").exists() || names.into_iter().any(|name| name != "00000001")
}

/// Waits until the erasure is inside, or until it has come and gone.
fn wait_until_inside(maps: &Path) -> bool {
    let since = Instant::now();
    while since.elapsed() < ERASED_WITHIN {
        if is_inside(maps) {
            return true;
        }
        std::thread::sleep(Duration::from_micros(200));
    }
    false
}

/// Duration of the inner part of an erasure, from its order to its end.
async fn time_inside(launch: &Launch, data: &Path) -> Duration {
    let (daemon, maps) = (launch.start(), data.join("maps"));
    daemon.client().erase("home", ERASED).await.expect("ordered");
    assert!(wait_until_inside(&maps), "the erasure has not begun:\n{}", daemon.process().stderr());
    let since = Instant::now();
    while is_inside(&maps) {
        assert!(since.elapsed() < ERASED_WITHIN, "the erasure does not end:\n{}", daemon.process().stderr());
        std::thread::sleep(Duration::from_micros(200));
    }
    let inside = since.elapsed();
    assert!(!is_listed(&daemon).await);
    daemon.stop_in_order();
    inside
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_a_kill_inside_an_erasure_is_completed_by_the_next_start() {
    let seed = rounds::seed("durability_a_kill_inside_an_erasure_is_completed_by_the_next_start");
    let mut random = rounds::draws(seed);
    let work = tempdir().expect("a folder");
    let (sound, data) = (work.path().join("sound"), work.path().join("data"));
    let (launch, maps) = (Launch::on(&data), data.join("maps"));
    let daemon = Launch::on(&sound).start();
    fill(&daemon);
    let expected = others(&daemon).await;
    daemon.stop_in_order();
    copy_folder(&sound, &data);
    let inside = time_inside(&launch, &data).await;

    let wanted = rounds::count("TIDEMAP_ERASURE_KILLS", KILLS);
    let mut killed = 0;
    for round in 0..wanted * 10 {
        if killed == wanted {
            break;
        }
        fs::remove_dir_all(&data).expect("removable");
        copy_folder(&sound, &data);
        let daemon = launch.start();
        daemon.client().erase("home", ERASED).await.expect("ordered");
        assert!(wait_until_inside(&maps), "round {round}: the erasure has not begun");
        std::thread::sleep(inside.mul_f64(random.random_range(0.0..0.9)));
        daemon.kill();
        let was_inside = is_inside(&maps);
        let daemon = launch.start();
        // The order is on the disk, so that the erasure becomes whole however far it had come.
        assert!(!is_listed(&daemon).await, "round {round}: the order is forgotten");
        let holds = |file: &Path| {
            let bytes = fs::read(data.join(file)).unwrap_or_default();
            bytes.windows(ERASED.len()).any(|window| window == ERASED.as_bytes())
        };
        let left: Vec<_> = files(&data).into_iter().filter(|file| holds(file)).collect();
        assert!(left.is_empty(), "round {round}: {left:?}");
        assert_eq!(fs::read_dir(&maps).expect("readable").count(), 1, "round {round}: leftovers");
        assert!(others(&daemon).await == expected, "round {round}: another state has changed");
        daemon.stop_in_order();
        killed += u32::from(was_inside);
    }
    println!("{killed} kills inside an erasure of {inside:?}");
    assert_eq!(killed, wanted, "too few kills were inside an erasure of {inside:?}");
}
