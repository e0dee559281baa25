//! What edges are expected to be, from little evidence and from much.

use std::sync::Arc;

use proptest::prelude::*;
use tidemap_model::{EnabledModels, OrderCriterion, Periodicities, Sample, Zone};

use super::*;
use crate::{grid::spec::Retention, live_map::LiveMap, name::MapName, spec::MapSpec};

const HOUR: i64 = 3_600_000_000_000;
const USUAL: UsualEdge = UsualEdge { success: 0.8, speed_m_per_sec: 0.5, pace: 1.0 };

fn at(hour: i64) -> Moment {
    Moment { utc_nanos: hour * HOUR, offset_secs: 0 }
}

fn record(extent: Extent, reports: &[(i64, f64)]) -> EdgeRecord {
    let sample = |&(hour, value): &(i64, f64)| Sample { utc_nanos: hour * HOUR, offset_secs: 0, value };
    let samples: Vec<Sample> = reports.iter().map(sample).collect();
    let mut table = HourTable::default();
    table.add(&samples);
    let by_hour = (!reports.is_empty()).then(|| near_hours(&table));
    EdgeRecord { extent, tried: reports.len() as f64, travelled: 0.0, by_hour }
}

#[test]
fn an_edge_that_was_never_driven_is_as_edges_of_its_map_are_and_unsure() {
    let edge = record(Extent::metres(4.0), &[]);
    let outlook = edge.outlook(&USUAL, f64::NAN, f64::NAN, at(9));
    assert!((outlook.success - 0.8).abs() < 1e-12 && (outlook.duration_secs - 8.0).abs() < 1e-12, "{outlook:?}");
    assert!(outlook.evidence <= BORROWED, "{outlook:?}");
    let nominal = record(Extent::secs(14.0), &[]).outlook(&USUAL, 0.0, 0.0, at(9));
    assert!((nominal.duration_secs - 14.0).abs() < 1e-12, "{nominal:?}");
}

#[test]
fn an_edge_that_always_failed_is_tried_again_some_day() {
    let reports: Vec<(i64, f64)> = (0..2_000).map(|hour| (hour, 0.0)).collect();
    let outlook = record(Extent::secs(9.0), &reports).outlook(&USUAL, 0.0, 1.0, at(2_001));
    assert!(outlook.success >= LEAST_SUCCESS && outlook.success < 0.02, "{outlook:?}");
}

#[test]
fn a_door_that_is_shut_at_night_is_known_to_be_although_its_model_forgot() {
    // Four weeks: tried each hour by day and passed, at night only in the first three nights, and shut.
    let by_day = (0..28).flat_map(|day| (7..20).map(move |hour| (24 * day + hour, 1.0)));
    let at_night = (0..3).flat_map(|day| [0, 1, 2, 3, 4, 5, 22, 23].map(move |hour| (24 * day + hour, 0.0)));
    let reports: Vec<(i64, f64)> = by_day.chain(at_night).collect();
    let edge = record(Extent::secs(9.0), &reports);
    let expected = |hour: i64| edge.outlook(&USUAL, 0.94, 1.0, at(28 * 24 + hour));
    assert!(expected(12).success > 0.97, "{:?}", expected(12));
    assert!(expected(2).success < 0.6, "{:?}", expected(2));
    assert!(expected(2).evidence < expected(12).evidence / 4.0, "few reports make a wide interval");
}

#[test]
fn a_changed_length_keeps_the_speed() {
    let driven = |length_m| EdgeRecord { travelled: 100.0, ..record(Extent::metres(length_m), &[]) };
    let secs = |length_m| driven(length_m).outlook(&USUAL, 1.0, 1.25, at(9)).duration_secs;
    assert!((secs(20.0) / secs(10.0) - 2.0).abs() < 1e-12);
    assert!((secs(10.0) - 10.0 / 1.235).abs() < 0.1, "{}", secs(10.0));
    // A length and a nominal time: what the maker of the map says, until robots say otherwise.
    let both = Extent { length_m: Some(10.0), nominal_secs: Some(40.0) };
    assert!((record(both, &[]).outlook(&USUAL, 1.0, 9.0, at(9)).duration_secs - 40.0).abs() < 1e-9);
}

#[test]
fn a_map_without_reports_has_a_prior() {
    let spec = MapSpec {
        name: MapName::new("office").expect("valid"),
        zone: Zone::utc(),
        periodicities: Periodicities::harmonics(24 * HOUR, 12).expect("valid"),
        criterion: OrderCriterion::SquaredError,
        created_nanos: 0,
        half_life_nanos: None,
        prior: 0.5,
        retention: Retention::Forever,
        models: EnabledModels::default(),
        grid: None,
    };
    let view = LiveMap::new(Arc::new(spec)).publish();
    let edges = [(Extent::metres(3.0), EdgeStates::default())];
    let usual = UsualEdge::of(&view, edges, 0.7);
    assert!((usual.success - 0.9).abs() < 1e-12 && (usual.speed_m_per_sec - 0.7).abs() < 1e-12, "{usual:?}");
    assert!((usual.pace - 1.0).abs() < 1e-12);
    let edge = EdgeRecord::of(&view, Extent::metres(3.0), EdgeStates::default());
    assert!((edge.outlook(&usual, 0.5, 0.5, at(0)).success - 0.9).abs() < 1e-12);
}

proptest! {
    #[test]
    fn an_outlook_is_always_one(
        reports in proptest::collection::vec((0_i64..5_000, 0.0..=1.0), 0..60),
        success in proptest::num::f64::ANY,
        travel in proptest::num::f64::ANY,
        length_m in 1e-6..1e7,
        usual in (LEAST_SUCCESS..0.999, 1e-3..1e3, 1e-3..1e3),
        hour in -10_000_i64..100_000,
    ) {
        let usual = UsualEdge { success: usual.0, speed_m_per_sec: usual.1, pace: usual.2 };
        let outlook = record(Extent::metres(length_m), &reports).outlook(&usual, success, travel, at(hour));
        prop_assert!((LEAST_SUCCESS..1.0).contains(&outlook.success), "{outlook:?}");
        prop_assert!(outlook.evidence > 0.0 && outlook.evidence.is_finite(), "{outlook:?}");
        prop_assert!(outlook.duration_secs > 0.0 && outlook.duration_secs.is_finite(), "{outlook:?}");
    }
}
