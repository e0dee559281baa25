//! The promises of `flows.rs`, on a short run.

use super::*;

fn short() -> FlowComparison {
    let protocol = FlowsProtocol { seeds: 1, first_seed: 0, weeks: 2, tested: 1 };
    run(&protocol, &|_, _| {}).expect("a comparison")
}

#[test]
fn streams_are_predicted_and_avoided_better_with_time() {
    let found = short();
    let [timeless, spectral] = &found.scores[..] else { panic!("two models") };
    assert!(spectral.squared_error < 0.85 * timeless.squared_error, "{found:?}");
    assert!(spectral.direction_nats > timeless.direction_nats + 0.1, "{found:?}");
    let [shortest, _, avoiding] = &found.trips[..] else { panic!("three ways") };
    assert_eq!((shortest.trips, avoiding.trips), (5 * 24, 5 * 24));
    assert!(avoiding.near_secs <= 0.5 * shortest.near_secs, "{found:?}");
    assert!(avoiding.metres <= 1.1 * shortest.metres, "{found:?}");
    let mut table = Vec::new();
    summary(&found, tidemap_formats::table::Format::Csv, &mut table).expect("a table");
    assert_eq!(String::from_utf8(table).expect("text").lines().count(), 4);
}
