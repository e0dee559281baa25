//! Traversals that robots report, and failed traversals.
//!
//! Invariant: an invalid traversal is refused on its own, with a reason for programs and one in words.

use tidemap_map::{
    ids::RefusalReason,
    name::{EdgeName, EdgeState},
    traversal::{EdgeFailure, Traversal, TraversalError, kept_reason},
};

use super::{
    InvalidField,
    topology::{edge_name_from_wire, edge_name_to_wire},
};
use crate::v1;

/// Advice how to find a valid edge.
const WAY_OUT: &str = "the map's topology lists the existing ones, and can be loaded again";

/// Bytes of a traversal's texts.
pub(super) fn text_bytes(traversal: &v1::Traversal) -> usize {
    let v1::Traversal { from, to, action, reason, .. } = traversal;
    [from, to, action, reason].map(String::len).iter().sum()
}

/// A checked traversal. Whether the edge exists is not checked.
///
/// # Errors
/// The reason for programs, and the reason in words.
pub fn traversal_from_wire(wire: &v1::Traversal) -> Result<Traversal, (RefusalReason, String)> {
    let v1::Traversal { from, to, action, start_nanos, end_nanos, success, reason } = wire;
    let edge = EdgeName::new(from, to, action).map_err(|error| unknown_edge(&error))?;
    let (start_nanos, end_nanos, success) = (*start_nanos, *end_nanos, *success);
    let traversal = Traversal { edge, start_nanos, end_nanos, success, reason: kept_reason(reason) };
    traversal.check().map_err(|error| refusal_of(&error))?;
    Ok(traversal)
}

/// A traversal for the wire.
#[must_use]
pub fn traversal_to_wire(traversal: &Traversal) -> v1::Traversal {
    let Traversal { edge: EdgeName { from, to, action }, start_nanos, end_nanos, success, reason } = traversal;
    v1::Traversal {
        from: from.as_str().to_owned(),
        to: to.as_str().to_owned(),
        action: action.as_ref().map_or_else(String::new, |action| action.as_str().to_owned()),
        start_nanos: *start_nanos,
        end_nanos: *end_nanos,
        success: *success,
        reason: reason.clone(),
    }
}

/// Maximum number of bytes of a traversal on the wire in addition to its texts.
const TRAVERSAL_BYTES_EXTRA: usize = 64;

/// A report of a traversal as a robot or a file sends it: names and times are not checked. The daemon replies to an
/// invalid report with a refusal, so that its sequence number is used up.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TraversalReport {
    /// Name of the node where the edge begins.
    pub from: String,
    /// Name of the node where it ends.
    pub to: String,
    /// The robot's action that traversed the edge; empty: the usual one.
    pub action: String,
    /// When the robot entered the edge, nanoseconds UTC.
    pub start_nanos: i64,
    /// When the robot arrived or gave up, nanoseconds UTC.
    pub end_nanos: i64,
    /// Whether the robot arrived.
    pub success: bool,
    /// Reason of the failure, in words: the printable part of the first 200 characters. May be empty.
    pub reason: String,
}

impl TraversalReport {
    /// Why the report is invalid, as far as this is known without the map. The daemon refuses it for the same reason.
    #[must_use]
    pub fn wrong(&self) -> Option<String> {
        traversal_from_wire(&report_to_wire(self)).err().map(|(_, text)| text)
    }

    /// The report for the wire, with the reason as the daemon keeps it.
    #[must_use]
    pub fn to_report(&self) -> v1::Report {
        v1::Report { report: Some(v1::report::Report::Traversal(report_to_wire(self))) }
    }
}

/// A traversal for the wire, with the reason as the daemon keeps it.
#[must_use]
pub(super) fn report_to_wire(report: &TraversalReport) -> v1::Traversal {
    let TraversalReport { from, to, action, start_nanos, end_nanos, success, reason } = report.clone();
    let reason = kept_reason(&reason);
    v1::Traversal { from, to, action, start_nanos, end_nanos, success, reason }
}

/// Maximum number of bytes of a traversal in a message.
#[must_use]
pub(super) fn wire_bytes(traversal: &v1::Traversal) -> usize {
    TRAVERSAL_BYTES_EXTRA + text_bytes(traversal)
}

/// The refusal of an edge that the map does not have.
#[must_use]
pub fn unknown_edge(error: &dyn std::error::Error) -> (RefusalReason, String) {
    (RefusalReason::Edge, format!("{error}; {WAY_OUT}"))
}

/// The refusal of an invalid traversal.
#[must_use]
pub fn refusal_of(error: &TraversalError) -> (RefusalReason, String) {
    let reason = match error {
        TraversalError::TooFast { .. } => RefusalReason::Value,
        TraversalError::Before1970(_)
        | TraversalError::Backwards { .. }
        | TraversalError::NoTime(_)
        | TraversalError::TooLong { .. } => RefusalReason::Time,
    };
    (reason, error.to_string())
}

/// Appends the bytes of a traversal that `Welcome.content_crc` covers.
pub(super) fn append_content(traversal: &v1::Traversal, bytes: &mut Vec<u8>) {
    let v1::Traversal { from, to, action, start_nanos, end_nanos, success, reason } = traversal;
    for (place, part) in [EdgeState::Success.prefix(), from, to, action].into_iter().enumerate() {
        if place == 3 && part.is_empty() {
            continue;
        }
        if place > 0 {
            bytes.push(b'/');
        }
        bytes.extend_from_slice(part.as_bytes());
    }
    bytes.extend_from_slice(&start_nanos.to_le_bytes());
    bytes.extend_from_slice(&end_nanos.to_le_bytes());
    bytes.push(u8::from(*success));
    bytes.extend_from_slice(reason.as_bytes());
}

/// A failed traversal for the wire.
#[must_use]
pub fn failure_to_wire(failure: &EdgeFailure) -> v1::EdgeFailure {
    let EdgeFailure { edge, start_nanos, end_nanos, reason } = failure;
    let edge = Some(edge_name_to_wire(edge));
    v1::EdgeFailure { edge, start_nanos: *start_nanos, end_nanos: *end_nanos, reason: reason.clone() }
}

/// A failed traversal from the wire.
///
/// # Errors
/// An edge without a valid name.
pub fn failure_from_wire(failure: v1::EdgeFailure) -> Result<EdgeFailure, InvalidField> {
    let v1::EdgeFailure { edge, start_nanos, end_nanos, reason } = failure;
    Ok(EdgeFailure { edge: edge_name_from_wire("edge", edge.as_ref())?, start_nanos, end_nanos, reason })
}

/// Whether a failed traversal belongs to the requested edge, or to the opposite direction if both are requested.
#[must_use]
pub fn is_of(failure: &EdgeFailure, wanted: &v1::EdgeEnds) -> bool {
    let EdgeName { from, to, action } = &failure.edge;
    let ends = (from.as_str(), to.as_str());
    let is_there = ends == (&wanted.from, &wanted.to) || (wanted.both_ways && ends == (&wanted.to, &wanted.from));
    is_there && action.as_ref().map_or("", |action| action.as_str()) == wanted.action
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wire() -> v1::Traversal {
        let text = |text: &str| text.to_owned();
        v1::Traversal {
            from: text("Hall"),
            to: text("Lab"),
            action: text("door"),
            start_nanos: 5,
            end_nanos: 9,
            success: false,
            reason: text("stuck"),
        }
    }

    #[test]
    fn a_traversal_comes_back() {
        let usual = v1::Traversal { action: String::new(), success: true, ..wire() };
        for wire in [wire(), usual] {
            assert_eq!(traversal_to_wire(&traversal_from_wire(&wire).expect("right")), wire);
        }
    }

    #[test]
    fn what_is_wrong_has_a_reason() {
        for (wrong, reason, words) in [
            (v1::Traversal { from: "a/b".to_owned(), ..wire() }, RefusalReason::Edge, "\"a/b\""),
            (v1::Traversal { to: String::new(), ..wire() }, RefusalReason::Edge, "the map's topology"),
            (v1::Traversal { start_nanos: -1, ..wire() }, RefusalReason::Time, "before 1970"),
            (v1::Traversal { end_nanos: 4, ..wire() }, RefusalReason::Time, "before start"),
            (v1::Traversal { end_nanos: i64::MAX, ..wire() }, RefusalReason::Time, "a day"),
        ] {
            let (found, text) = traversal_from_wire(&wrong).expect_err("wrong");
            assert_eq!(found, reason, "{text}");
            assert!(text.contains(words), "{text}");
        }
    }

    #[test]
    fn the_content_is_the_documented_bytes() {
        let mut bytes = Vec::new();
        append_content(&wire(), &mut bytes);
        append_content(&v1::Traversal { action: String::new(), success: true, ..wire() }, &mut bytes);
        let times = [5_i64.to_le_bytes(), 9_i64.to_le_bytes()].concat();
        let expected: [&[u8]; 8] =
            [b"edge/Hall/Lab/door", &times, &[0], b"stuck", b"edge/Hall/Lab", &times, &[1], b"stuck"];
        assert_eq!(bytes, expected.concat());
    }

    #[test]
    fn failures_are_requested_by_edge() {
        let failure = traversal_from_wire(&wire()).expect("right").failure().expect("it failed");
        let there = failure_to_wire(&failure).edge.expect("an edge");
        assert!(is_of(&failure, &there));
        let back = v1::EdgeEnds { from: there.to.clone(), to: there.from.clone(), ..there.clone() };
        assert!(!is_of(&failure, &back));
        assert!(is_of(&failure, &v1::EdgeEnds { both_ways: true, ..back }));
        assert!(!is_of(&failure, &v1::EdgeEnds { action: String::new(), ..there }));
    }
}
