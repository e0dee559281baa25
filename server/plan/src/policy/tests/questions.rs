//! The actions of a policy at doors, in short times and at limits.

use tidemap_map::topology::Edge;

use super::*;
use crate::{route::Forecasts, testkit::street};

fn sure(_: &Edge, _: f64) -> Option<EdgeForecast> {
    Some(EdgeForecast { success: 1.0, duration_secs: 10.0, evidence: 9.0 })
}

fn solve(objective: PolicyObjective, at: &mut impl Forecasts) -> PolicyTable {
    let options = PolicyOptions { objective, ..PolicyOptions::default() };
    solve_policy(&street(4), NodeId(3), &options, at, || false).unwrap()
}

#[test]
fn short_edges_are_gone_one_after_another_within_a_slot() {
    let table = solve(PolicyObjective::Time, &mut sure);
    for slot in [0, 50, 95] {
        let entry = table.entry(NodeId(0), slot).unwrap();
        assert!((entry.expected_secs - 30.0).abs() < 1e-9, "{entry:?}");
        assert!(entry.reach > 0.96, "{entry:?}");
        assert!(matches!(entry.action, PolicyAction::Take(_)));
    }
}

#[test]
fn a_robot_waits_for_a_door_and_has_no_way_once_it_is_shut_for_ever() {
    // The door from node 2 to 3 is open in slots 10 to 19.
    let door = &mut |edge: &Edge, at_secs: f64| {
        let is_door = edge.from == NodeId(2) && edge.to == NodeId(3);
        sure(edge, at_secs).filter(|_| !is_door || (9_000.0..18_000.0).contains(&at_secs))
    };
    let table = solve(PolicyObjective::Reach, door);
    let at = |node, slot| table.entry(NodeId(node), slot).unwrap();
    assert_eq!(at(2, 5).action, PolicyAction::Wait);
    // The robot does not move back and forth at the door, though that would lose no time.
    let edge = |node: u32, slot| match at(node, slot).action {
        PolicyAction::Take(edge) => Some(edge.0 % 2),
        _ => None,
    };
    assert!((0..10).all(|slot| edge(0, slot) != Some(1) && edge(1, slot) != Some(1) && edge(2, slot).is_none()));
    assert!((at(2, 5).expected_secs - (5.0 * 900.0 + 10.0)).abs() < 1e-9, "{:?}", at(2, 5));
    assert!(matches!(at(2, 10).action, PolicyAction::Take(_)));
    assert_eq!((at(2, 30).action, at(2, 30).reach), (PolicyAction::Nothing, 0.0));
    assert!((at(2, 30).expected_secs - 66.0 * 900.0).abs() < 1e-6);
    // The last forecast holds: the door is closed.
    let table = solve(PolicyObjective::Time, door);
    let at = |node, slot| table.entry(NodeId(node), slot).unwrap();
    assert_eq!((at(2, 30).action, at(2, 30).expected_secs), (PolicyAction::Nothing, f64::INFINITY));
    assert!((at(2, 19).expected_secs - 10.0).abs() < 1e-9, "{:?}", at(2, 19));
}

#[test]
fn failures_cost_what_they_do_on_a_route() {
    let mut half = |_: &Edge, _: f64| Some(EdgeForecast { success: 0.5, duration_secs: 10.0, evidence: 9.0 });
    let table = solve(PolicyObjective::Time, &mut half);
    // There is one failure on average, of 70 s.
    for slot in [0, 40, 95] {
        let entry = table.entry(NodeId(0), slot).unwrap();
        assert!((entry.expected_secs - 3.0 * 80.0).abs() < 1e-8, "{entry:?}");
    }
}

#[test]
fn extremes_have_sensible_answers() {
    for (success, duration_secs) in [(1e-9, 1e9), (1e-9, 1e-300), (1.0, 1e-300), (1.0, 1e9), (0.5, 900.0)] {
        let mut at = |_: &Edge, _: f64| Some(EdgeForecast { success, duration_secs, evidence: 1.0 });
        for objective in [PolicyObjective::Reach, PolicyObjective::Time] {
            let table = solve(objective, &mut at);
            for entry in (0..96).flat_map(|slot| table.slot(slot).unwrap()) {
                assert!((0.0..=1.0).contains(&entry.reach), "{entry:?}");
                assert!(entry.expected_secs >= 0.0 && entry.expected_secs.is_finite(), "{entry:?}");
            }
        }
    }
}

#[test]
fn a_table_knows_its_nodes_and_slots() {
    let table = solve(PolicyObjective::Reach, &mut sure);
    assert_eq!((table.target(), table.slot_secs(), table.slots()), (NodeId(3), 900.0, 96));
    assert_eq!(table.nodes().len(), 4);
    assert_eq!((table.entry(NodeId(9), 0), table.entry(NodeId(0), 96)), (None, None));
    assert_eq!(table.entry(NodeId(3), 0).unwrap().action, PolicyAction::Arrived);
}

#[test]
fn questions_out_of_range_are_refused() {
    let ask = |options: &PolicyOptions| solve_policy(&street(4), NodeId(3), options, &mut sure, || false);
    let base = PolicyOptions::default();
    for options in [
        PolicyOptions { slot_secs: 0.0, ..base },
        PolicyOptions { slot_secs: f64::NAN, ..base },
        PolicyOptions { slot_secs: f64::INFINITY, ..base },
        PolicyOptions { recovery_secs: -1.0, ..base },
        PolicyOptions { recovery_secs: f64::NAN, ..base },
        PolicyOptions { slots: 0, ..base },
    ] {
        assert!(matches!(ask(&options), Err(PolicyError::Range { .. })), "{options:?}");
    }
    let many = PolicyOptions { slots: 500_001, ..base };
    assert_eq!(ask(&many), Err(PolicyError::TooManyStates { nodes: 4, slots: 500_001 }));
    let stopped = solve_policy(&street(4), NodeId(3), &base, &mut sure, || true);
    assert_eq!(stopped, Err(PolicyError::Stopped { left: 96, slots: 96 }));
    assert_eq!(solve_policy(&street(4), NodeId(9), &base, &mut sure, || false), Err(PolicyError::UnknownNode(9)));
    let mut bad = |_: &Edge, _: f64| Some(EdgeForecast { success: 0.0, duration_secs: 1.0, evidence: 1.0 });
    let error = solve_policy(&street(2), NodeId(0), &base, &mut bad, || false).unwrap_err();
    assert!(error.to_string().contains("n1/n0"), "{error}");
}

#[test]
fn a_policy_that_is_stopped_ends_within_a_slot() {
    let town = street(1_000);
    let options = PolicyOptions { slots: 4, ..PolicyOptions::default() };
    let forecasts = std::cell::Cell::new(0);
    let mut counted = |edge: &Edge, at_secs: f64| {
        forecasts.set(forecasts.get() + 1);
        sure(edge, at_secs)
    };
    let mut calls = 0;
    let until = || {
        calls += 1;
        calls > 3
    };
    let stopped = solve_policy(&town, NodeId(3), &options, &mut counted, until);
    assert_eq!(stopped, Err(PolicyError::Stopped { left: 4, slots: 4 }));
    assert!(forecasts.get() <= 4 * 256, "{}", forecasts.get());
}
