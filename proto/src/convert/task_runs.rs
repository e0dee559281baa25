//! Runs of tasks that robots report.
//!
//! Invariant: an invalid run is refused on its own, with a reason for programs and one in words.

use tidemap_map::{ids::RefusalReason, name::TaskName, task::TaskRun, traversal::kept_reason};

use super::traversals::refusal_of;
use crate::v1;

/// Bytes of a run's texts.
pub(super) fn text_bytes(wire: &v1::TaskRun) -> usize {
    wire.kind.len() + wire.node.len() + wire.reason.len()
}

/// A checked run of a task.
///
/// # Errors
/// The reason for programs, and the reason in words.
pub fn task_run_from_wire(wire: &v1::TaskRun) -> Result<TaskRun, (RefusalReason, String)> {
    let v1::TaskRun { kind, node, start_nanos, end_nanos, success, intervention, reason } = wire;
    let name = TaskName::new(kind, node).map_err(|error| (RefusalReason::StateName, error.to_string()))?;
    let (start_nanos, end_nanos, success, intervention) = (*start_nanos, *end_nanos, *success, *intervention);
    let run = TaskRun { name, start_nanos, end_nanos, success, intervention, reason: kept_reason(reason) };
    run.check().map_err(|error| refusal_of(&error))?;
    Ok(run)
}

/// Appends the bytes of a run that `Welcome.content_crc` covers.
pub(super) fn append_content(wire: &v1::TaskRun, bytes: &mut Vec<u8>) {
    let v1::TaskRun { kind, node, start_nanos, end_nanos, success, intervention, reason } = wire;
    append([kind, node, reason], [*start_nanos, *end_nanos], [*success, *intervention], bytes);
}

/// Does the same as [`append_content`], for a run that did not come in a stream.
pub(super) fn append_run(run: &TaskRun, bytes: &mut Vec<u8>) {
    let TaskRun { name: TaskName { kind, node }, start_nanos, end_nanos, success, intervention, reason } = run;
    let texts = [kind.as_str(), node.as_str(), reason];
    append(texts, [*start_nanos, *end_nanos], [*success, *intervention], bytes);
}

fn append([kind, node, reason]: [&str; 3], times_nanos: [i64; 2], flags: [bool; 2], bytes: &mut Vec<u8>) {
    bytes.extend_from_slice(format!("task/{kind}/{node}").as_bytes());
    times_nanos.iter().for_each(|time| bytes.extend_from_slice(&time.to_le_bytes()));
    bytes.extend(flags.map(u8::from));
    bytes.extend_from_slice(reason.as_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wire() -> v1::TaskRun {
        v1::TaskRun {
            kind: "clean".to_owned(),
            node: "Hall".to_owned(),
            start_nanos: 5,
            end_nanos: 9,
            success: false,
            intervention: true,
            reason: "stuck".to_owned(),
        }
    }

    #[test]
    fn a_run_has_the_fields_of_the_wire() {
        let run = task_run_from_wire(&wire()).expect("right");
        assert_eq!((run.name.to_string(), run.success, run.intervention), ("clean/Hall".to_owned(), false, true));
        assert_eq!((run.start_nanos, run.end_nanos, run.reason.as_str()), (5, 9, "stuck"));
    }

    #[test]
    fn what_is_wrong_has_a_reason() {
        for (wrong, reason) in [
            (v1::TaskRun { kind: "a/b".to_owned(), ..wire() }, RefusalReason::StateName),
            (v1::TaskRun { node: String::new(), ..wire() }, RefusalReason::StateName),
            (v1::TaskRun { end_nanos: 4, ..wire() }, RefusalReason::Time),
            (v1::TaskRun { start_nanos: -1, ..wire() }, RefusalReason::Time),
        ] {
            assert_eq!(task_run_from_wire(&wrong).expect_err("wrong").0, reason);
        }
    }

    #[test]
    fn the_content_is_the_documented_bytes() {
        let (mut sent, mut requested) = (Vec::new(), Vec::new());
        append_content(&wire(), &mut sent);
        append_run(&task_run_from_wire(&wire()).expect("right"), &mut requested);
        let times = [5_i64.to_le_bytes(), 9_i64.to_le_bytes()].concat();
        assert_eq!(sent, [b"task/clean/Hall".as_slice(), &times, &[0, 1], b"stuck"].concat());
        assert_eq!(requested, sent);
    }
}
