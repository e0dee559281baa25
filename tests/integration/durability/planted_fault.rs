//! A daemon that acknowledges before it syncs. The kills and the power cuts must catch it; if they do not, they
//! prove nothing about the real one either.

use std::{path::Path, process::Command};

use tempfile::tempdir;
use tidemap_tests::{binaries, daemon::Launch, disk::Unavailable, oracle::Violation, rounds};

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
