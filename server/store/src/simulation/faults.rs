//! A full disk or a failing one at every single call: every acknowledged record is on the disk.

use std::{io::ErrorKind, sync::mpsc};

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};

use super::{
    disk::{Fault, SimulatedDisk},
    machine::Machine,
};
use crate::{AppendError, tests::example::event};

/// A run that does a bit of everything. Returns the number of calls and what went wrong.
fn run(fault: Option<Fault>, goes_on: bool) -> (usize, Vec<AppendError>) {
    let mut random = SmallRng::seed_from_u64(7);
    let mut machine = Machine::new(SimulatedDisk::new(SmallRng::seed_from_u64(8)));
    machine.start().expect("starts");
    machine.create_map();
    machine.disk.set_fault(fault.map(|fault| Fault { call: fault.call + machine.disk.calls(), ..fault }));
    let start = machine.disk.calls();
    let mut errors = Vec::new();
    for step in 0..30 {
        match step % 10 {
            3 => machine.save(&mut random),
            6 if step == 6 => machine.create_map(),
            _ => {
                let failed = machine.append(&mut random);
                // After a disk failure the process ends, and unacknowledged writes may be found again.
                if !failed.iter().any(|error| matches!(error, AppendError::Poisoned { .. })) {
                    machine.roll_back();
                }
                errors.extend(failed);
            }
        }
    }
    let calls = machine.disk.calls() - start;
    if goes_on {
        // Space is freed without a restart.
        machine.disk.set_fault(None);
        machine.roll_back();
        assert_eq!(machine.append(&mut random), [], "{fault:?}");
        assert_eq!(machine.append(&mut random), [], "{fault:?}");
    }
    let is_power_cut = random.random();
    machine.restart(is_power_cut).unwrap_or_else(|error| panic!("{fault:?}: {error}"));
    machine.restart(true).unwrap_or_else(|error| panic!("{fault:?}: {error}"));
    assert_eq!(machine.append(&mut random), [], "{fault:?}");
    (calls, errors)
}

#[test]
fn a_full_disk_at_any_call_refuses_and_goes_on_when_there_is_space() {
    let (calls, errors) = run(None, true);
    assert!(calls > 50, "too little was tried: {calls}");
    assert_eq!(errors, []);
    let mut refused = 0;
    for call in 0..calls {
        for is_sticky in [false, true] {
            let (_, errors) = run(Some(Fault { call, kind: ErrorKind::StorageFull, is_sticky }), true);
            let expected = |error: &AppendError| matches!(error, AppendError::DiskFull | AppendError::AfterFailure);
            assert!(errors.iter().all(expected), "call {call}: {errors:?}");
            refused += errors.len();
        }
    }
    assert!(refused > calls, "too little was refused: {refused}");
}

#[test]
fn a_failing_disk_at_any_call_is_never_trusted_again() {
    let (calls, _) = run(None, false);
    let mut poisoned = 0;
    for call in 0..calls {
        for is_sticky in [false, true] {
            let (_, errors) = run(Some(Fault { call, kind: ErrorKind::Other, is_sticky }), false);
            let expected = |error: &AppendError| matches!(error, AppendError::Poisoned { .. });
            assert!(errors.iter().all(expected), "call {call}: {errors:?}");
            poisoned += usize::from(!errors.is_empty());
        }
    }
    assert!(poisoned > calls / 2, "too little has failed: {poisoned}");
}

#[test]
fn what_depends_on_a_failed_append_fails_until_the_writer_resumes() {
    let mut machine = Machine::new(SimulatedDisk::new(SmallRng::seed_from_u64(8)));
    machine.start().expect("starts");
    machine.create_map();
    let (sender, receiver) = mpsc::channel();
    let log = machine.maps[0].log.clone().expect("open");
    let append = |number: u64| {
        let sender = sender.clone();
        log.append(&event(number), Box::new(move |result| sender.send((number, result)).expect("received")))
    };
    let (call, kind) = (machine.disk.calls(), ErrorKind::StorageFull);
    machine.disk.set_fault(Some(Fault { call, kind, is_sticky: false }));
    append(1).expect("queued");
    let first = machine.committer.take_now();
    // Queued before the first append fails, committed when there is space again.
    append(2).expect("queued");
    machine.committer.commit(first);
    assert_eq!(append(3), Err(AppendError::AfterFailure));
    machine.committer.commit(machine.committer.take_now());
    assert_eq!(append(4), Err(AppendError::AfterFailure));
    log.resume();
    append(5).expect("queued");
    machine.committer.commit(machine.committer.take_now());
    let answers: Vec<_> = receiver.try_iter().collect();
    assert_eq!(answers, [(1, Err(AppendError::DiskFull)), (2, Err(AppendError::AfterFailure)), (5, Ok(1))]);
    assert_eq!(log.end(), 1);
}
