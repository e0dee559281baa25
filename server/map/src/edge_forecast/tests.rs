//! Forecasts of edges, from little evidence and from much.

use std::sync::{Arc, atomic::AtomicU64};

use proptest::prelude::*;
use tidemap_model::{
    Periodicities, Sample,
    selector::{Blend, ModelKind},
};

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
/// Monday, 5 January 1970.
const MONDAY: i64 = 4 * 24;

/// A map without reports.
fn empty() -> LiveMap {
    LiveMap::new(Arc::new(MapSpec {
        periodicities: Periodicities::harmonics(24 * HOUR, 12).expect("valid"),
        ..MapSpec::new(MapName::new("office").expect("valid"))
    }))
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

/// The forecasts of a map after an update that learned reports of the way from A to B.
fn edges(reports: &[(i64, bool)], selector: ModelSelector) -> EdgeForecasts {
    let end = reports.last().map_or(1, |(hour, _)| hour + 1);
    EdgeForecasts::new(learned(driven(reports), end * HOUR), 1.0, selector)
}

/// The forecasts for some hours after these reports, by the default model.
fn forecasts(reports: &[(i64, bool)], hours: impl IntoIterator<Item = i64>) -> Vec<EdgeForecast> {
    let edges = edges(reports, ModelSelector::default());
    hours.into_iter().map(|hour| edges.forecast(there(&edges.view), hour * HOUR)).collect()
}

fn there(view: &MapView) -> &Edge {
    edge(view, "a", "b")
}

fn edge<'a>(view: &'a MapView, from: &str, to: &str) -> &'a Edge {
    let topology = view.site().topology();
    let id = |name: &str| topology.node_named(name).expect("a node").id;
    topology.edge_between(id(from), id(to), None).expect("an edge")
}

#[test]
fn an_edge_that_was_never_driven_is_like_the_edges_of_its_map_and_unsure() {
    // One in four fails.
    let reports: Vec<(i64, bool)> = (0..400).map(|hour| (hour, hour % 4 > 0)).collect();
    let edges = edges(&reports, ModelSelector::default());
    let back = edges.forecast(edge(&edges.view, "b", "a"), 401 * HOUR);
    // The mean of the reports, and of ten that passed nine times.
    assert!((back.success - 309.0 / 410.0).abs() < 1e-9, "{back:?}");
    assert!((back.duration_secs - 20.0).abs() < 0.5 && back.evidence == EVIDENCE_MIN, "{back:?}");
    let unknown = EdgeForecasts::new(Arc::new(driven(&[]).publish()), 0.5, ModelSelector::default());
    let forecast = unknown.forecast(there(&unknown.view), HOUR);
    assert!((forecast.success - 0.9).abs() < 1e-12 && (forecast.duration_secs - 24.0).abs() < 1e-9, "{forecast:?}");
}

#[test]
fn an_edge_that_always_failed_is_tried_again_some_day() {
    let reports: Vec<(i64, bool)> = (0..2_000).map(|hour| (hour, false)).collect();
    for forecast in forecasts(&reports, [2_001, 2_012]) {
        assert!(forecast.success >= LEARNED_SUCCESS_MIN && forecast.success < 0.02, "{forecast:?}");
    }
}

#[test]
fn a_door_that_is_shut_at_weekends_is_known_to_be_after_four_weeks() {
    for (weeks, highest) in [(4, 0.03), (20, 0.01)] {
        let open = |hour: i64| (hour - MONDAY).rem_euclid(168) < 5 * 24;
        let reports: Vec<(i64, bool)> = (MONDAY..MONDAY + weeks * 168)
            .filter(|hour| hour % 24 >= 7 && hour % 24 < 19)
            .map(|hour| (hour, open(hour)))
            .collect();
        let next = MONDAY + weeks * 168;
        let found = forecasts(&reports, [10, 5 * 24 + 10, 5 * 24 + 17].map(|hour| next + hour));
        assert!(found[0].success > 0.97, "{weeks} weeks, Monday: {:?}", found[0]);
        for shut in &found[1..] {
            assert!(shut.success <= highest, "{weeks} weeks, Saturday: {shut:?}");
        }
    }
}

#[test]
fn an_edge_that_fails_at_any_time_is_not_shunned_at_the_hours_at_which_it_did() {
    // Eight weeks of reports, one each hour; one in fifty fails, in no order.
    let is_mishap = |hour: i64| (hour * 7_919 + hour / 24 * 31) % 50 == 0;
    let reports: Vec<(i64, bool)> = (0..56 * 24).map(|hour| (hour, !is_mishap(hour))).collect();
    let found = forecasts(&reports, 56 * 24..57 * 24);
    let least = found.iter().map(|forecast| forecast.success).fold(1.0, f64::min);
    assert!(least > 0.9, "{least}");
}

#[test]
fn reports_of_other_hours_alone_do_not_make_an_edge_certain() {
    // Fifteen reports, all at ten in the morning of working days, all of one kind.
    let days = (0..21).filter(|day| (day + 3) % 7 < 5).take(15);
    for passes in [false, true] {
        let reports: Vec<(i64, bool)> = days.clone().map(|day| (24 * day + 10, passes)).collect();
        let found = forecasts(&reports, [22 * 24 + 10, 22 * 24 + 3]);
        let value = f64::from(u8::from(passes));
        assert!((found[0].success - value).abs() < 0.1, "{value}: {:?}", found[0]);
        // At night the forecast is nearer to the mean of the map, of which ten reports are of no edge.
        let mean = (9.0 + 15.0 * value) / 25.0;
        if passes {
            assert!(found[1].success < found[0].success, "{found:?}");
        } else {
            assert!(found[1].success > 0.4 * mean, "{found:?}");
        }
        assert!(found[1].evidence < found[0].evidence / 4.0, "few reports make a wide interval");
    }
}

#[test]
fn a_duration_follows_the_length_and_the_reported_speed() {
    let prior = TravelPrior { speed_m_per_s: 0.5, pace: 1.0 };
    let secs = |extent, speed: f64| prior.duration_secs(extent, |_| speed);
    assert!((secs(Extent::metres(20.0), 1.25) - 16.0).abs() < 1e-12);
    assert!((secs(Extent::metres(4.0), 1e9) - 0.4).abs() < 1e-12, "20 times the usual speed at most");
    // The edge has a length and a nominal time. The nominal time, which the maker of the map states, counts until
    // robots report another.
    let both = Extent { length_m: Some(10.0), nominal_secs: Some(40.0) };
    assert!((prior.duration_secs(both, |usual| usual) - 40.0).abs() < 1e-9);
    assert!((prior.duration_secs(Extent::secs(14.0), |usual| usual) - 14.0).abs() < 1e-12);
}

#[test]
fn planners_and_queries_of_a_state_get_one_forecast() {
    // Passed from 7 to 19, failed at 20 and 21; the last reports are not learned.
    let reports: Vec<(i64, bool)> =
        (0..30).flat_map(|day| (7..22).map(move |hour| (24 * day + hour, hour < 20))).collect();
    let mut map = driven(&reports);
    let start = map.plan_update(Some(28 * 24 * HOUR), 30 * 24 * HOUR, UpdateCause::Midnight);
    let work = map.apply(map.position() + 1, &Event::UpdateStart(start)).expect("consistent").expect("an update");
    map.finish_update(work.run(&AtomicU64::new(0)).expect("in memory"));
    let view = Arc::new(map.publish());
    let id = view.find("edge/a/b").expect("the state");
    let selectors = [ModelKind::Auto, ModelKind::Ensemble].into_iter().flat_map(|kind| {
        let blends = [Blend::None, Blend::Memory, Blend::Persistence];
        blends.map(|blend| ModelSelector { kind, blend, ..ModelSelector::default() })
    });
    for selector in selectors {
        let edges = EdgeForecasts::new(Arc::clone(&view), 1.0, selector);
        for hour in 29 * 24..31 * 24 {
            let mut asked = [f64::NAN];
            view.predict_into(id, &view.prepare(&[hour * HOUR]), selector, &mut asked);
            let planned = edges.forecast(there(&view), hour * HOUR).success;
            assert_eq!(planned.to_bits(), asked[0].clamp(LEARNED_SUCCESS_MIN, 1.0 - 1e-9).to_bits(), "{selector:?}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn a_forecast_is_always_one(
        reports in proptest::collection::btree_map(0_i64..5_000, proptest::bool::ANY, 0..60),
        success in proptest::num::f64::ANY,
        hour in 0_i64..100_000,
    ) {
        let reports: Vec<(i64, bool)> = reports.into_iter().collect();
        let edges = edges(&reports, ModelSelector::default());
        let by_caller = edges.forecast_with(there(&edges.view), hour * HOUR, |_, _| success);
        for forecast in [by_caller, edges.forecast(there(&edges.view), hour * HOUR)] {
            prop_assert!((LEARNED_SUCCESS_MIN..1.0).contains(&forecast.success), "{forecast:?}");
            prop_assert!(forecast.evidence > 0.0 && forecast.evidence.is_finite(), "{forecast:?}");
            prop_assert!(forecast.duration_secs > 0.0 && forecast.duration_secs.is_finite(), "{forecast:?}");
        }
    }
}

#[test]
fn edges_are_expected_to_be_as_they_were_reported() {
    // Two weeks of reports: passed each hour from 7 to 19, and failed at 20 and 21.
    let reports: Vec<(i64, bool)> =
        (0..14).flat_map(|day| (7..22).map(move |hour| (24 * day + hour, hour < 20))).collect();
    let view = learned(driven(&reports), 14 * 24 * HOUR);
    let (there, back) = (there(&view), edge(&view, "b", "a"));
    let [edges, recent] = [Blend::None, Blend::Persistence]
        .map(|blend| EdgeForecasts::new(Arc::clone(&view), 1.0, ModelSelector { blend, ..ModelSelector::default() }));
    let at = |hour: i64| (14 * 24 + hour) * HOUR;
    assert!(edges.forecast(there, at(12)).success > 0.95, "{:?}", edges.forecast(there, at(12)));
    assert!(edges.forecast(there, at(20)).success < 0.2, "{:?}", edges.forecast(there, at(20)));
    // The speed is 12 m in 20 s; the assumed speed is 1 m/s.
    assert!((edges.forecast(there, at(12)).duration_secs - 20.0).abs() < 0.5);
    assert_eq!((edges.reports(there.id), edges.reports(back.id)), (14 * 15, 0));
    let unknown = edges.forecast(back, at(12));
    assert!(unknown.evidence == EVIDENCE_MIN && (unknown.duration_secs - 20.0).abs() < 0.5, "{unknown:?}");
    // The last report was a failure at 21:00 of the day before; a minute later the forecast depends on it almost alone.
    let soon = at(-3) + HOUR / 60;
    assert!(recent.forecast(there, soon).success < edges.forecast(there, soon).success, "{soon}");
    let with_model = edges.forecast_with(there, at(20), |id, times| {
        assert_eq!((Some(id), times.moments().len()), (edges.success_states().next(), 1));
        1.0
    });
    assert!(with_model.success > edges.forecast(there, at(20)).success, "the caller's model counts: {with_model:?}");
}
