//! Tests the samples that traversals have for the states of their edges, and which failed traversals are kept.

use proptest::prelude::*;

use super::*;
use crate::topology::{EdgeEnds, NewEdge, NewNode, TopologyEdit};

const SEC: i64 = 1_000_000_000;

fn edge(action: &str) -> EdgeName {
    EdgeName::new("Hall", "Lab", action).expect("valid")
}

fn traversal(start_nanos: i64, end_nanos: i64, success: bool) -> Traversal {
    Traversal { edge: edge(""), start_nanos, end_nanos, success, reason: "stuck".to_owned() }
}

#[test]
fn a_success_gives_the_speed_or_the_pace() {
    let trip = traversal(10 * SEC, 14 * SEC, true);
    let both = Extent { length_m: Some(6.0), nominal_secs: Some(3.0) };
    assert_eq!(trip.samples(both), Ok(vec![(EdgeState::Success, 1.0), (EdgeState::Speed, 1.5)]));
    assert_eq!(trip.samples(Extent::metres(2.0)), Ok(vec![(EdgeState::Success, 1.0), (EdgeState::Speed, 0.5)]));
    assert_eq!(trip.samples(Extent::secs(2.0)), Ok(vec![(EdgeState::Success, 1.0), (EdgeState::Pace, 0.5)]));
    assert_eq!(trip.failure(), None);
}

#[test]
fn a_failure_is_stored_as_failed() {
    for end in [10 * SEC, 14 * SEC] {
        let trip = traversal(10 * SEC, end, false);
        assert_eq!(trip.samples(Extent::metres(6.0)), Ok(vec![(EdgeState::Success, 0.0)]));
        let failure = trip.failure().expect("it failed");
        assert_eq!((failure.edge, failure.start_nanos, failure.end_nanos), (edge(""), 10 * SEC, end));
        assert_eq!(failure.reason, "stuck");
    }
}

#[test]
fn times_that_make_no_sense_are_errors() {
    let day = TRAVERSAL_MAX_NANOS;
    assert_eq!(traversal(5, 5 + day, true).check(), Ok(()));
    for (wrong, words) in [
        (traversal(-1, 5, true), "-1 ns is before 1970"),
        (traversal(7, 6, false), "end 6 ns is before start 7 ns"),
        (traversal(7, 7, true), "both 7 ns"),
        (traversal(5, 6 + day, false), "more than a day"),
        (traversal(0, i64::MAX, true), "more than a day"),
        (traversal(i64::MIN, i64::MAX, true), "before 1970"),
    ] {
        let error = wrong.samples(Extent::metres(1.0)).expect_err("wrong").to_string();
        assert!(error.contains(words), "{error}");
    }
    let error = traversal(0, 1, true).samples(Extent::metres(1e7)).expect_err("too fast").to_string();
    assert!(error.contains("speed would be 1") && error.contains("0.000000001 s"), "{error}");
}

#[test]
fn the_states_of_an_edge_follow_its_names_and_its_extent() {
    let name = |name: &str| StateName::new(name).expect("valid");
    let node = |text: &str| TopologyEdit::AddNode(NewNode { name: name(text), pose: None, dwell_secs: None });
    let ends = |action: Option<&str>| EdgeEnds {
        from: name("Hall"),
        to: name("Lab"),
        action: action.map(name),
        both_ways: false,
    };
    let mut topology = Topology::new();
    for edit in [
        node("Hall"),
        node("Lab"),
        TopologyEdit::AddEdge(NewEdge { ends: ends(None), extent: Extent::metres(3.0) }),
        TopologyEdit::AddEdge(NewEdge { ends: ends(Some("door")), extent: Extent::secs(3.0) }),
    ] {
        topology = topology.edited(&edit).expect("valid");
    }
    let found = |action: &str| topology.edge_named(&edge(action)).expect("there").clone();
    let (plain, door) = (found(""), found("door"));
    assert_eq!(success_state(&topology, &plain).expect("known").as_str(), "edge/Hall/Lab");
    assert_eq!(success_state(&topology, &door).expect("known").as_str(), "edge/Hall/Lab/door");
    let (what, state) = travel_state(&topology, &plain).expect("known");
    assert_eq!((what, state.as_str()), (EdgeState::Speed, "speed/Hall/Lab"));
    let (what, state) = travel_state(&topology, &door).expect("known");
    assert_eq!((what, state.as_str()), (EdgeState::Pace, "pace/Hall/Lab/door"));
    assert!(success_state(&Topology::new(), &plain).is_err());
    for unknown in [edge("lift"), EdgeName::new("Lab", "Hall", "").expect("valid")] {
        assert!(matches!(topology.edge_named(&unknown), Err(TopologyError::UnknownEdge(_))));
    }
    let attic = EdgeName::new("Hall", "Attic", "").expect("valid");
    assert_eq!(topology.edge_named(&attic), Err(TopologyError::UnknownNode("Attic".to_owned())));
}

#[test]
fn reasons_are_kept_short_and_printable() {
    assert_eq!(kept_reason(" \u{202e} door\nclosed\u{202e} "), "door closed");
    assert_eq!(kept_reason(&"ä".repeat(500)), "ä".repeat(200));
    assert_eq!(kept_reason(""), "");
}

fn failure(start_nanos: i64, reason: usize) -> EdgeFailure {
    EdgeFailure { edge: edge(""), start_nanos, end_nanos: start_nanos, reason: reason.to_string() }
}

#[test]
fn failures_follow_a_node_to_its_new_name() {
    let mut failures = Failures::default();
    failures.add(failure(1, 0));
    let before = failures.clone();
    let name = |name: &str| StateName::new(name).expect("valid");
    failures.rename_node(&name("Attic"), &name("Loft"));
    assert_eq!(failures, before);
    failures.rename_node(&name("Lab"), &name("Loft"));
    assert_eq!(failures.newest_first().next().expect("one").edge.to_string(), "Hall/Loft");
    assert_eq!(before.newest_first().next().expect("one").edge.to_string(), "Hall/Lab");
}

proptest! {
    #[test]
    fn a_kept_reason_is_kept_as_it_is(reason in "\\PC{0,230}|[ a\\n\u{202e}]{0,230}") {
        let kept = kept_reason(&reason);
        prop_assert!(kept.chars().count() <= REASON_CHARS_MAX && !kept.chars().any(unprintable));
        prop_assert_eq!(kept_reason(&kept), kept);
    }

    #[test]
    fn the_newest_failures_are_kept(starts in prop::collection::vec(0_i64..2_000, 0..1_500)) {
        let mut failures = Failures::default();
        for (number, &start) in starts.iter().enumerate() {
            failures.add(failure(start, number));
        }
        let mut expected: Vec<(i64, usize)> = starts.iter().copied().zip(0..).collect();
        expected.sort();
        let expected: Vec<EdgeFailure> =
            expected.into_iter().rev().take(FAILURES_MAX).map(|(start, number)| failure(start, number)).collect();
        prop_assert_eq!(failures.newest_first().cloned().collect::<Vec<_>>(), expected);
    }

    #[test]
    fn whatever_is_reported_is_a_value_of_its_state_or_refused(
        start in any::<i64>(),
        secs in prop_oneof![any::<i64>(), 0_i64..100],
        success in any::<bool>(),
        size in prop_oneof![Just(f64::MIN_POSITIVE), Just(1e9), 0.001_f64..1e7],
        has_length in any::<bool>(),
    ) {
        let extent = if has_length { Extent::metres(size) } else { Extent::secs(size) };
        let trip = traversal(start, start.saturating_add(secs), success);
        if let Ok(samples) = trip.samples(extent) {
            prop_assert_eq!(samples.len(), 1 + usize::from(success));
            prop_assert!(samples.iter().all(|(what, value)| what.kind().allows(*value) && *value >= 0.0));
            prop_assert!(trip.check().is_ok());
        }
    }
}
