//! Daemons with planted faults, such as one that acknowledges before it syncs. The kills and the power cuts must catch
//! them; if they do not, they prove nothing about the real one either.

use std::{path::Path, process::Command};

use tempfile::tempdir;
use tidemap_tests::{
    binaries,
    daemon::Launch,
    disk::Unavailable,
    feed::Feed,
    herd::{Herd, Manner},
    oracle::{Oracle, Violation},
    rounds,
};

use super::{
    kill::{Rounds, rounds_of_kills},
    power_cut::power_cuts,
};

/// Rounds within which the fault must be found.
const ROUNDS_MAX: u32 = 12;

fn caught(result: Result<(), Violation>) {
    match result {
        Err(violation) if violation.is_loss() => println!("caught: {violation}"),
        Err(violation) => panic!("something else than a loss was found: {violation}"),
        Ok(()) => panic!("the planted fault was not found in {ROUNDS_MAX} rounds: these tests cannot fail"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_kills_catch_a_daemon_that_acknowledges_too_early() {
    let seed = rounds::seed("durability_kills_catch_a_daemon_that_acknowledges_too_early");
    let data = tempdir().expect("a folder");
    let launch = Launch::on(data.path()).program(binaries::tidemapd_with_planted_fault());
    caught(rounds_of_kills(&launch, Rounds { count: ROUNDS_MAX, updates: false }, seed).await);
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_power_cuts_catch_a_daemon_that_acknowledges_too_early() {
    let seed = rounds::seed("durability_power_cuts_catch_a_daemon_that_acknowledges_too_early");
    let program = binaries::tidemapd_with_planted_fault();
    match power_cuts(|data| Launch::on(data).program(program.clone()), ROUNDS_MAX, seed).await {
        Ok(result) => caught(result),
        Err(Unavailable(reason)) => println!("SKIPPED: {reason}"),
    }
}

/// Whether kills, with updates meanwhile, find a daemon with this fault: a loss, other answers, or no start.
fn is_found_by_kills(fault: &'static str, seed: u64) -> bool {
    let rounds = std::thread::spawn(move || {
        let data = tempdir().expect("a folder");
        let launch = Launch::on(data.path()).program(binaries::tidemapd_with_planted_fault());
        let launch = launch.setting("planted_fault", fault).setting("segment_bytes", 1 << 16);
        let runtime = tokio::runtime::Runtime::new().expect("a runtime");
        runtime.block_on(rounds_of_kills(&launch, Rounds { count: ROUNDS_MAX, updates: true }, seed))
    });
    // What the rounds do not expect at all, such as a daemon that does not start, is a panic.
    !matches!(rounds.join(), Ok(Ok(())))
}

/// Whether a daemon with this fault goes on acknowledging while every sync fails.
async fn acknowledges_without_sync(fault: &str) -> bool {
    let data = tempdir().expect("a folder");
    let launch = Launch::on(data.path()).program(binaries::tidemapd_with_planted_fault());
    let launch = launch.setting("planted_fault", fault);
    let mut oracle = Oracle::new("office", Feed::new(3), 2);
    super::create_map(&launch.start(), &oracle).await;
    let inject = ["-e", "trace=fdatasync", "-e", "inject=fdatasync:error=EIO:when=20+"];
    let daemon = launch.clone().under(super::strace(Path::new("/dev/null"), &inject)).start();
    let manner = Manner { until: 3_000, ..Manner::default() };
    let errors = Herd::start(&daemon.client(), &oracle, manner, 1).settle(&mut oracle).await;
    errors.is_empty()
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_every_planted_fault_is_found() {
    let seed = rounds::seed("durability_every_planted_fault_is_found");
    let by_kills = ["lost-tail", "short-read", "doubled", "skipped", "flipped-bit", "swapped"];
    for fault in by_kills {
        let found = tokio::task::spawn_blocking(move || is_found_by_kills(fault, seed)).await.expect("no panic");
        assert!(found, "{fault} was not found in {ROUNDS_MAX} rounds: these tests cannot fail");
        println!("caught: {fault}");
    }
    match super::can_trace() {
        Ok(()) => {
            for fault in ["ignored-sync-error", "no-sync"] {
                assert!(acknowledges_without_sync(fault).await, "{fault} is not in the program");
                println!("caught: {fault}");
            }
        }
        Err(reason) => println!("SKIPPED: {reason}"),
    }
}

/// The fault's warning, which is in every program that can have the fault.
const WARNING: &str = "this daemon loses acknowledged observations";

fn has_warning(program: &Path) -> bool {
    let status = Command::new("grep").args(["-qF", WARNING]).arg(program).status();
    status.expect("grep is there").success()
}

#[test]
fn the_fault_is_in_no_program_but_its_own() {
    assert!(has_warning(&binaries::tidemapd_with_planted_fault()), "this test cannot fail: the warning has changed");
    for program in [binaries::tidemapd(), binaries::tidemap()] {
        assert!(!has_warning(&program), "{} has the planted fault", program.display());
    }
}
