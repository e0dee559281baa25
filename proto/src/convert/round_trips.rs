//! Values of the domain survive the way to the wire and back.

use proptest::prelude::*;
use tidemap_grid::{
    index::{CellBox, CellIndex},
    spec::{GridSpec, Retention, SensorNoise},
};
use tidemap_map::{
    edge_forecast::EdgeForecast,
    ids::RefusalReason,
    landmark::{Descriptor, ImageFeature, Landmark, LandmarkKind},
    landmark_forecast::PredictedLandmark,
    name::{EdgeName, PlaceName, StateName},
};
use tidemap_model::{
    InformationMeasure, ORDER_MAX, OrderCriterion, Periodicities,
    models::{HistogramCycle, Interval},
    selector::{Blend, ModelKind, ModelSelector},
    time::HALF_LIFE_MIN_NANOS,
};
use tidemap_plan::{
    route::{Certainty, Objective},
    search::{Effort, StopReason},
    strategy::{Budget, Strategy as SlotStrategy},
    view::{Sensor, Viewpoint},
};

use super::{
    exploration::*, grid::*, landmarks::*, map::*, model_kind::*, query::*, route::*, search::*, time::*, topology::*,
};
use crate::v1;

fn kinds() -> impl Strategy<Value = ModelKind> {
    let kind = prop::sample::select(ModelKind::ALL.to_vec());
    let cycle = prop::sample::select(HistogramCycle::ALL.to_vec());
    (kind, cycle, any::<u32>(), ModelKind::PERIODS_NANOS).prop_map(|(kind, cycle, number, period_nanos)| {
        let kind = kind.with_cycle(cycle).with_period(period_nanos);
        kind.count_limit().map_or(kind, |limit| kind.with_count(1 + number % limit.max))
    })
}

#[test]
fn every_kind_of_models_has_its_name_on_the_wire() {
    for kind in ModelKind::ALL {
        let wire = model_kind_to_wire(kind);
        assert_ne!(wire, v1::ModelKind::Unspecified, "{kind}");
        assert_eq!(model_kind_from_wire(wire), Some(kind));
    }
    let on_wire = (0..99).filter_map(|number| v1::ModelKind::try_from(number).ok());
    let known = on_wire.filter(|wire| model_kind_from_wire(*wire).is_some()).count();
    assert_eq!(known, ModelKind::ALL.len());
    assert_eq!(model_kind_from_wire(v1::ModelKind::Unspecified), None);
}

#[test]
fn every_measure_of_information_has_its_name_on_the_wire() {
    for measure in InformationMeasure::ALL {
        let wire = measure_to_wire(measure);
        assert_ne!(wire, v1::InformationMeasure::Unspecified, "{measure:?}");
        assert_eq!(measure_from_wire("information", wire.into(), true), Ok(measure));
    }
    for is_counted in [true, false] {
        assert_eq!(measure_from_wire("information", 0, is_counted), Ok(InformationMeasure::default()));
    }
}

fn retentions() -> impl Strategy<Value = Retention> {
    prop_oneof![Just(Retention::None), Just(Retention::Forever), (1..i64::MAX).prop_map(Retention::Duration)]
}

fn grids() -> impl Strategy<Value = GridSpec> {
    let corner = || (-9_000..9_000_i32, -9_000..9_000_i32, -9_000..9_000_i32);
    let extent = (corner(), (1..99_i32, 1..99_i32, 1..99_i32)).prop_map(|((x, y, z), (width, depth, height))| {
        CellBox { min: CellIndex { x, y, z }, max: CellIndex { x: x + width, y: y + depth, z: z + height } }
    });
    let noise = (0.5..1.0_f64, 0.0..0.5_f64, 0.01..0.99_f64);
    let noise = noise.prop_map(|(hit, false_alarm, prior)| SensorNoise { hit, false_alarm, prior });
    let origin_m = [-1e3..1e3_f64, -1e3..1e3_f64, -1e3..1e3_f64];
    let half_life = prop::option::of(HALF_LIFE_MIN_NANOS..i64::MAX);
    (0.01..9.0_f64, origin_m, prop::option::of(extent), noise, retentions(), half_life).prop_map(
        |(resolution_m, origin_m, extent, sensor, retention, half_life_nanos)| GridSpec {
            origin_m,
            extent,
            sensor,
            retention,
            half_life_nanos,
            ..GridSpec::new(resolution_m)
        },
    )
}

proptest! {
    #[test]
    fn models_come_back(kind in kinds(), order in 0..=ORDER_MAX, has_order: bool, blend in 0..=Blend::ALL.len()) {
        let order = Some(order).filter(|_| has_order && kind.has_order());
        let selector = ModelSelector { kind, order, blend: Blend::ALL.get(blend).copied().unwrap_or_default() };
        prop_assert_eq!(selector_from_wire("model", Some(selector_to_wire(selector))), Ok(selector));
    }

    #[test]
    fn grids_come_back(grid in grids()) {
        prop_assert_eq!(grid_from_wire(grid_to_wire(&grid)), Ok(grid));
    }

    #[test]
    fn retentions_come_back(retention in retentions()) {
        let wire = Some(retention_to_wire(retention));
        prop_assert_eq!(retention_from_wire("retention", wire, Retention::None), Ok(retention));
    }

    #[test]
    fn periodicities_come_back(base_secs in 3_600..1_000_000_i64, count in 1..200_u32, hours in 1..99_i64) {
        let harmonics = Periodicities::harmonics(base_secs * 1_000_000_000, count);
        let list = Periodicities::list((1..5).map(|k| k * hours * 3_600_000_000_000).collect());
        for definition in [harmonics, list].into_iter().flatten().map(|set| set.definition().clone()) {
            let back = periodicities_from_wire(Some(periodicities_to_wire(&definition)));
            prop_assert_eq!(back.map(|set| set.definition().clone()), Ok(definition));
        }
    }

    #[test]
    fn times_come_back(nanos in 0..i64::MAX) {
        prop_assert_eq!(instant_from_wire("time", Some(timestamp(nanos))), Ok(nanos));
        prop_assert_eq!(span(Some(duration(nanos))), Some(nanos));
    }

    #[test]
    fn viewpoints_come_back(
        x_m in -1e3..1e3,
        y_m in -1e3..1e3,
        z_m in prop::option::of(-9.0..9.0),
        size in 0.1..3.0,
    ) {
        let viewpoint = Viewpoint { x_m, y_m, z_m, yaw_rad: size };
        prop_assert_eq!(viewpoint_from_wire(&viewpoint_to_wire(&viewpoint)), viewpoint);
        let sensor = Sensor { range_m: size, horizontal_fov_rad: size, vertical_fov_rad: size, height_m: size };
        prop_assert_eq!(sensor_from_wire(Some(sensor_to_wire(sensor))), sensor);
    }

    #[test]
    fn budgets_come_back(visits in 0..1_000_usize, ratio in 0.0..1.0) {
        for budget in [Budget::Visits(visits), Budget::Ratio(ratio)] {
            prop_assert_eq!(budget_from_wire(Some(budget_to_wire(budget))), budget);
        }
    }
}

fn name(text: &str) -> StateName {
    StateName::new(text).expect("valid")
}

#[test]
fn predictions_of_edges_come_back() {
    let node = |name: &str, id| v1::TopologyNode { name: name.to_owned(), id, ..v1::TopologyNode::default() };
    let ends = v1::EdgeEnds { from: "A".to_owned(), to: "B".to_owned(), ..v1::EdgeEnds::default() };
    let edge = v1::TopologyEdge { ends: Some(ends), length_m: Some(2.0), id: 7, ..v1::TopologyEdge::default() };
    let network = v1::GetTopologyResponse { nodes: vec![node("A", 1), node("B", 2)], edges: vec![edge] };
    let topology = topology_from_wire(&network).expect("valid");
    assert_eq!(topology_to_wire(&topology), network);
    let forecast = EdgeForecast { success: 0.75, evidence: 8.0, duration_secs: 12.5 };
    let success = Interval { lower: 0.5, upper: 0.875 };
    let edges = topology.edges().map(|edge| prediction_to_wire((&topology, edge), forecast, success, 3)).collect();
    let expected = EdgePrediction {
        edge: EdgeName { from: name("A"), to: name("B"), action: None },
        success: 0.75,
        success_interval: [0.5, 0.875],
        duration_secs: 12.5,
        reports: 3,
    };
    assert_eq!(predictions_from_wire(v1::PredictEdgesResponse { edges }), Ok(vec![expected]));
}

#[test]
fn landmarks_of_replies_come_back() {
    let descriptor = Descriptor::new(&[0xA5; 32]).expect("valid");
    let kind = LandmarkKind::Image(ImageFeature { u_px: 1.5, v_px: -2.5, descriptor });
    let landmark = Landmark { name: name("window"), kind, covariance: None };
    let known = PredictedLandmark { landmark: &landmark, probability: 0.25, mean: 0.5, sightings: 8, learned: 6 };
    let back = |wire: Option<v1::Landmark>| landmark_from_wire("landmark", &wire.expect("a landmark"));
    let at_time = predicted_landmark_to_wire(&known);
    assert_eq!((at_time.probability, at_time.sightings), (0.25, 8));
    assert_eq!(back(at_time.landmark).as_ref(), Ok(&landmark));
    let by_share = known_landmark_to_wire(&known);
    assert_eq!((by_share.seen_share, by_share.sightings), (0.5, 8));
    assert_eq!(back(by_share.landmark).as_ref(), Ok(&landmark));
    let edge = PlaceName::Edge(EdgeName { from: name("A"), to: name("B"), action: Some(name("door")) });
    for place in [PlaceName::Node(name("A")), edge] {
        let count = landmark_count_to_wire(&place, 5);
        assert_eq!(count.landmarks, 5);
        assert_eq!(whole_place_from_wire("place", count.place.as_ref()).as_ref(), Ok(&place));
        let removed = removed_landmarks_to_wire(&place, &[name("window")]);
        assert_eq!(removed.names, ["window"]);
        assert_eq!(whole_place_from_wire("place", removed.place.as_ref()).as_ref(), Ok(&place));
    }
}

#[test]
fn choices_come_back() {
    let reasons = (1..).map_while(|number| v1::RefusalReason::try_from(number).ok());
    let reasons: Vec<RefusalReason> = reasons.filter_map(refusal_from_wire).collect();
    assert_eq!(reasons.len(), 13);
    assert!(reasons.iter().all(|&reason| refusal_from_wire(refusal_to_wire(reason)) == Some(reason)));
    for criterion in [OrderCriterion::SquaredError, OrderCriterion::ZeroOne] {
        assert_eq!(criterion_from_wire(criterion_to_wire(criterion)), Some(criterion));
    }
    for certainty in [Certainty::Proven, Certainty::WithinResolution, Certainty::Sampled, Certainty::CutOff] {
        assert_eq!(route_certainty_from_wire(route_certainty_to_wire(certainty)), Some(certainty));
    }
    for effort in [Effort::Auto, Effort::Exact, Effort::Heuristic] {
        assert_eq!(effort_from_wire(effort_to_wire(effort)), Some(effort));
    }
    for stopped in [StopReason::Unlikely, StopReason::NotWorthIt, StopReason::OutOfTime] {
        assert_eq!(stop_from_wire(stop_to_wire(stopped)), Some(stopped));
    }
    let round_robin = SlotStrategy::RoundRobin { visited: 0 };
    let by_chance = [SlotStrategy::MonteCarlo, SlotStrategy::Random];
    for strategy in by_chance.into_iter().chain([SlotStrategy::Greedy, round_robin]) {
        assert_eq!(strategy_from_wire("strategy", strategy_to_wire(strategy).into()), Ok(strategy));
    }
    for objective in [Objective::Success, Objective::Time, Objective::Blend { weight: 0.25 }] {
        let (wire, doubt) = objective_to_wire(objective);
        let when = Some(v1::plan_route_request::When::DepartTime(timestamp(0)));
        let request = v1::PlanRouteRequest { objective: wire.into(), doubt, when, ..Default::default() };
        assert_eq!(route_from_wire(&request).map(|question| question.options.objective), Ok(objective));
    }
}
