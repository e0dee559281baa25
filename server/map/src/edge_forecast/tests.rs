//! Forecasts of edges, from little evidence and from much.

use std::sync::{Arc, atomic::AtomicU64};

use proptest::prelude::*;
use tidemap_model::{Periodicities, Sample, selector::Blend};

use super::*;
use crate::{
    event::{Envelope, Event, NewState, Observations, SequenceSpan, UpdateCause},
    ids::ProducerId,
    live_map::LiveMap,
    name::{EdgeName, MapName, ProducerKey, StateName},
    site::SiteEdit,
    spec::MapSpec,
    topology::{EdgeEnds, NewEdge, NewNode, TopologyEdit},
    traversal::Traversal,
};

const HOUR: i64 = 3_600_000_000_000;
const PRIOR: EdgePrior = EdgePrior { success: 0.8, speed_m_per_s: 0.5, pace: 1.0 };

fn at(hour: i64) -> Moment {
    Moment { utc_nanos: hour * HOUR, offset_secs: 0 }
}

fn record(extent: Extent, reports: &[(i64, f64)]) -> EdgeRecord {
    let sample = |&(hour, value): &(i64, f64)| Sample { utc_nanos: hour * HOUR, offset_secs: 0, value };
    let samples: Vec<Sample> = reports.iter().map(sample).collect();
    let mut table = HourTable::default();
    table.add(&samples);
    let by_hour = (!reports.is_empty()).then(|| near_hours(&table));
    let hour_uniformity = hour_uniformity::hour_uniformity(&table, PRIOR.success);
    EdgeRecord { extent, tried: reports.len() as f64, travelled: 0.0, by_hour, hour_uniformity }
}

#[test]
fn an_edge_that_was_never_driven_is_as_edges_of_its_map_are_and_unsure() {
    let edge = record(Extent::metres(4.0), &[]);
    let forecast = edge.forecast(&PRIOR, f64::NAN, f64::NAN, at(9));
    assert!((forecast.success - 0.8).abs() < 1e-12 && (forecast.duration_secs - 8.0).abs() < 1e-12, "{forecast:?}");
    assert!(forecast.evidence <= PRIOR_REPORTS, "{forecast:?}");
    let nominal = record(Extent::secs(14.0), &[]).forecast(&PRIOR, 0.0, 0.0, at(9));
    assert!((nominal.duration_secs - 14.0).abs() < 1e-12, "{nominal:?}");
}

#[test]
fn an_edge_that_always_failed_is_tried_again_some_day() {
    let reports: Vec<(i64, f64)> = (0..2_000).map(|hour| (hour, 0.0)).collect();
    let forecast = record(Extent::secs(9.0), &reports).forecast(&PRIOR, 0.0, 1.0, at(2_001));
    assert!(forecast.success >= LEARNED_SUCCESS_MIN && forecast.success < 0.02, "{forecast:?}");
}

#[test]
fn a_door_that_is_shut_at_night_is_known_to_be_although_its_model_forgot() {
    // Four weeks of reports: the edge was tried each hour by day and passed; at night only in the first three nights,
    // and was shut.
    let by_day = (0..28).flat_map(|day| (7..20).map(move |hour| (24 * day + hour, 1.0)));
    let at_night = (0..3).flat_map(|day| [0, 1, 2, 3, 4, 5, 22, 23].map(move |hour| (24 * day + hour, 0.0)));
    let reports: Vec<(i64, f64)> = by_day.chain(at_night).collect();
    let edge = record(Extent::secs(9.0), &reports);
    let expected = |hour: i64| edge.forecast(&PRIOR, 0.94, 1.0, at(28 * 24 + hour));
    assert!(expected(12).success > 0.97, "{:?}", expected(12));
    assert!(expected(2).success < 0.6, "{:?}", expected(2));
    assert!(expected(2).evidence < expected(12).evidence / 4.0, "few reports make a wide interval");
}

#[test]
fn an_edge_that_fails_at_any_time_is_not_shunned_at_the_hours_at_which_it_did() {
    // Eight weeks of reports, one each hour; one in fifty fails, in no order.
    let is_mishap = |hour: i64| (hour * 7_919 + hour / 24 * 31) % 50 == 0;
    let reports: Vec<(i64, f64)> = (0..56 * 24).map(|hour| (hour, f64::from(u8::from(!is_mishap(hour))))).collect();
    let edge = record(Extent::secs(9.0), &reports);
    let least = (0..168).map(|hour| edge.forecast(&PRIOR, 0.98, 1.0, at(56 * 24 + hour)).success).fold(1.0, f64::min);
    assert!(least > 0.95, "{least}");
}

#[test]
fn reports_of_other_hours_alone_do_not_make_an_edge_certain() {
    // Fifteen reports, all at ten in the morning of working days, all of one kind; the model has learned nothing else.
    let days = (0..21).filter(|day| (day + 3) % 7 < 5).take(15);
    for value in [0.0, 1.0] {
        let reports: Vec<(i64, f64)> = days.clone().map(|day| (24 * day + 10, value)).collect();
        let edge = record(Extent::secs(9.0), &reports);
        let expected = |hour: i64| edge.forecast(&PRIOR, value, 1.0, at(22 * 24 + hour)).success;
        // The forecast is near the reports at that hour, and nearer to the map's mean at night.
        assert!((expected(10) - value).abs() < 0.1, "{value}: {}", expected(10));
        let (distance, reported_distance) = ((expected(3) - PRIOR.success).abs(), (value - PRIOR.success).abs());
        assert!(distance < 0.6 * reported_distance, "{value}: {}", expected(3));
    }
}

#[test]
fn a_changed_length_keeps_the_speed() {
    let driven = |length_m| EdgeRecord { travelled: 100.0, ..record(Extent::metres(length_m), &[]) };
    let secs = |length_m| driven(length_m).forecast(&PRIOR, 1.0, 1.25, at(9)).duration_secs;
    assert!((secs(20.0) / secs(10.0) - 2.0).abs() < 1e-12);
    assert!((secs(10.0) - 10.0 / 1.235).abs() < 0.1, "{}", secs(10.0));
    // The edge has a length and a nominal time. The nominal time, which the maker of the map states, counts until
    // robots report another.
    let both = Extent { length_m: Some(10.0), nominal_secs: Some(40.0) };
    assert!((record(both, &[]).forecast(&PRIOR, 1.0, 9.0, at(9)).duration_secs - 40.0).abs() < 1e-9);
}

/// A map without reports.
fn empty() -> LiveMap {
    LiveMap::new(Arc::new(MapSpec {
        periodicities: Periodicities::harmonics(24 * HOUR, 12).expect("valid"),
        ..MapSpec::new(MapName::new("office").expect("valid"))
    }))
}

#[test]
fn a_map_without_reports_has_a_prior() {
    let view = empty().publish();
    let edges = [(Extent::metres(3.0), EdgeStates::default())];
    let prior = EdgePrior::of(&view, edges, 0.7);
    assert!((prior.success - 0.9).abs() < 1e-12 && (prior.speed_m_per_s - 0.7).abs() < 1e-12, "{prior:?}");
    assert!((prior.pace - 1.0).abs() < 1e-12);
    let edge = EdgeRecord::of(&view, Extent::metres(3.0), EdgeStates::default(), &prior);
    assert!((edge.forecast(&prior, 0.5, 0.5, at(0)).success - 0.9).abs() < 1e-12);
}

proptest! {
    #[test]
    fn an_outlook_is_always_one(
        reports in proptest::collection::vec((0_i64..5_000, 0.0..=1.0), 0..60),
        success in proptest::num::f64::ANY,
        travel in proptest::num::f64::ANY,
        length_m in 1e-6..1e7,
        prior in (LEARNED_SUCCESS_MIN..0.999, 1e-3..1e3, 1e-3..1e3),
        hour in -10_000_i64..100_000,
    ) {
        let prior = EdgePrior { success: prior.0, speed_m_per_s: prior.1, pace: prior.2 };
        let forecast = record(Extent::metres(length_m), &reports).forecast(&prior, success, travel, at(hour));
        prop_assert!((LEARNED_SUCCESS_MIN..1.0).contains(&forecast.success), "{forecast:?}");
        prop_assert!(forecast.evidence > 0.0 && forecast.evidence.is_finite(), "{forecast:?}");
        prop_assert!(forecast.duration_secs > 0.0 && forecast.duration_secs.is_finite(), "{forecast:?}");
    }
}

/// A map of one link, with A and B 12 m apart, and with these reports of the way there.
fn driven(reports: &[(i64, bool)]) -> LiveMap {
    let mut map = empty();
    let name = |name| StateName::new(name).expect("valid");
    let node = |text| NewNode { name: name(text), pose: None, dwell_secs: None };
    let link = NewEdge { ends: EdgeEnds::link(name("a"), name("b")), extent: Extent::metres(12.0) };
    let load = TopologyEdit::Load { nodes: vec![node("a"), node("b")], edges: vec![link], replaces: true };
    map.apply(1, &Event::EditSite(SiteEdit::Topology(load))).expect("a topology");
    let edge = EdgeName::new("a", "b", "").expect("valid");
    for (sequence, &(hour, success)) in (1..).zip(reports) {
        let (start, end) = (hour * HOUR, hour * HOUR + HOUR / 180);
        let driven =
            Traversal { edge: edge.clone(), start_nanos: start, end_nanos: end, success, reason: String::new() };
        let envelope = Envelope {
            producer: ProducerId(0),
            new_producer: (sequence == 1).then(|| ProducerKey::new("robot", "").expect("valid").into()),
            incarnation: 1,
            span: SequenceSpan { first: sequence, last: sequence, content_crc: 0 },
            received_nanos: end,
            refused: Vec::new(),
        };
        let failures = driven.failure().into_iter().collect();
        let mut event = Observations { failures, ..Observations::default() };
        for (what, value) in driven.samples(Extent::metres(12.0)).expect("sensible") {
            let name = edge.state(what);
            let id = map.find(name.as_str()).unwrap_or_else(|| {
                let id = StateId(u32::try_from(map.states() + event.new_states.len()).expect("few"));
                event.new_states.push(NewState::sampled(id, name, what.kind()));
                id
            });
            event.push(id, Sample { utc_nanos: start, offset_secs: 0, value });
        }
        map.apply(map.position() + 1, &Event::Observations(envelope, event)).expect("consistent");
    }
    map
}

fn learned(mut map: LiveMap, cut_nanos: i64) -> Arc<MapView> {
    let start = map.plan_update(Some(cut_nanos), cut_nanos, UpdateCause::Midnight);
    let work = map.apply(map.position() + 1, &Event::UpdateStart(start)).expect("consistent").expect("an update");
    map.finish_update(work.run(&AtomicU64::new(0)).expect("in memory"));
    Arc::new(map.publish())
}

#[test]
fn edges_are_expected_to_be_as_they_were_reported() {
    // Two weeks of reports: passed each hour from 7 to 19, and failed at 20 and 21.
    let reports: Vec<(i64, bool)> =
        (0..14).flat_map(|day| (7..22).map(move |hour| (24 * day + hour, hour < 20))).collect();
    let view = learned(driven(&reports), 14 * 24 * HOUR);
    let topology = view.site().topology();
    let edge = |from, to| {
        let id = |name: &str| topology.node_named(name).expect("a node").id;
        topology.edge_between(id(from), id(to), None).expect("an edge")
    };
    let (there, back) = (edge("a", "b"), edge("b", "a"));
    let [edges, recent] =
        [Blend::None, Blend::Persistence].map(|blend| EdgeForecasts::new(Arc::clone(&view), 1.0, blend));
    let at = |hour: i64| (14 * 24 + hour) * HOUR;
    assert!(edges.forecast(there, at(12)).success > 0.95, "{:?}", edges.forecast(there, at(12)));
    assert!(edges.forecast(there, at(20)).success < 0.2, "{:?}", edges.forecast(there, at(20)));
    // The speed is 12 m in 20 s; the assumed speed is 1 m/s.
    assert!((edges.forecast(there, at(12)).duration_secs - 20.0).abs() < 0.5);
    assert_eq!((edges.reports(there.id), edges.reports(back.id)), (14 * 15, 0));
    let unknown = edges.forecast(back, at(12));
    assert!(unknown.evidence <= PRIOR_REPORTS && (unknown.duration_secs - 20.0).abs() < 0.5, "{unknown:?}");
    // The last report was a failure at 21:00 of the day before; a minute later the forecast depends on it almost alone.
    let soon = at(-3) + HOUR / 60;
    assert!(recent.forecast(there, soon).success < edges.forecast(there, soon).success, "{soon}");
    let with_model = edges.forecast_with(there, at(20), |id, times| {
        assert_eq!((Some(id), times.moments().len()), (edges.success_states().next(), 1));
        1.0
    });
    assert!(with_model.success > edges.forecast(there, at(20)).success, "the caller's model counts: {with_model:?}");
}
