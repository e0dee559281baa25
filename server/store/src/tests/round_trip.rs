//! Written values are read back bit by bit.

use std::sync::Arc;

use proptest::{collection::vec, option, prelude::*};
use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};
use tidemap_grid::{index::CellIndex, sensors::ProducerSensor};
use tidemap_layout::{log::FrameKind, topology::Topology};
use tidemap_map::{
    event::{
        Digest, Dimensions, Envelope, Epoch, Event, Hold, NewState, Observations, OffsetRun, Reporting, SequenceSpan,
        StateKind, StateShape, UpdateCause, UpdateDone, UpdateStart,
    },
    ids::{NewProducer, ProducerId, RefusalReason, StateId},
    name::{EdgeName, MapName, ProducerKey, StateName},
    site::{Location, Site, SiteEdit},
    snapshot::StateSnapshot,
    spec::MapSpec,
    topology::{EdgeEnds, Extent, NewEdge, NewNode, NodePose, TopologyEdit},
    traversal::{EdgeFailure, kept_reason},
};
use tidemap_model::{EnabledModels, OrderCriterion, Periodicities, Persistence, Sample, StateModel, StateSensor, Zone};

use super::example::{snapshot, spec, spoiled, state};
use crate::record::{self, tables};

fn values() -> impl Strategy<Value = Vec<f64>> {
    let binary = prop_oneof![Just(0.0), Just(1.0)];
    prop_oneof![
        vec(binary, 0..700),
        (0.0..=1.0, 0..40_usize).prop_map(|(value, count)| vec![value; count]),
        (prop_oneof![Just(0.0), Just(1.0), Just(-0.0)], 0..40_usize).prop_map(|(value, count)| vec![value; count]),
        vec((0..=1000_u16).prop_map(|thousandth| f64::from(f32::from(thousandth) / 1000.0)), 0..100),
        vec(prop_oneof![-1e12..=1e12, Just(1e12), Just(-0.0), (0..1000_u32).prop_map(f64::from)], 0..100),
        vec(prop_oneof![0.0..=1.0, Just(-0.0), Just(f64::MIN_POSITIVE), Just(1.0 - f64::EPSILON)], 0..100),
    ]
}

fn times(count: usize) -> impl Strategy<Value = Vec<i64>> {
    prop_oneof![
        vec(0..=i64::MAX, count),
        vec(0..1_000_000_i64, count).prop_map(|secs| secs.iter().map(|sec| sec * 1_000_000_000).collect()),
        (0..1_000_000_i64, 0..1_000_000_i64)
            .prop_map(move |(start, step)| (0..count as i64).map(|i| start + i * step).collect()),
    ]
}

fn observations() -> impl Strategy<Value = Event> {
    let columns = values().prop_flat_map(|values| {
        let count = values.len();
        let states = prop_oneof![
            vec(any::<u32>(), count),
            vec(0..300_u32, count),
            any::<u32>().prop_map(move |state| vec![state; count])
        ];
        (states, times(count), Just(values), 0..=count as u32, any::<(i32, i32)>())
    });
    let key = option::of(("[a-zü]{1,9}", "[a-zü]{0,9}", option::of((0.5..=1.0, 0.0..0.5))));
    let refused = vec((0..1000_u64, 0..7_u8), 0..20);
    let numbers = any::<(u32, u64, u64, u32, u32, i64)>();
    (columns, key, refused, numbers, vec("[a-zü ]{1,20}", 0..5), failures()).prop_map(
        |(columns, key, refused, numbers, names, failures)| {
            let (states, times_nanos, values, split, offsets) = columns;
            let (producer, incarnation, first, length, content_crc, received_nanos) = numbers;
            let rest = values.len() as u32 - split;
            let mut sequence = 0;
            Event::Observations(
                Envelope {
                    producer: ProducerId(producer),
                    new_producer: key.map(|(producer, label, sensor)| NewProducer {
                        key: ProducerKey::new(&producer, &label).expect("valid"),
                        sensor: sensor.map(|(hit, false_alarm)| ProducerSensor { hit, false_alarm }),
                        introduced_by: if label.is_empty() { String::new() } else { "token 1".to_owned() },
                    }),
                    incarnation,
                    span: SequenceSpan { first, last: first.saturating_add(u64::from(length)), content_crc },
                    received_nanos,
                    refused: refused
                        .into_iter()
                        .map(|(step, reason)| {
                            sequence += step;
                            let reason = match reason {
                                0 => RefusalReason::Value,
                                1 => RefusalReason::Time,
                                2 => RefusalReason::StateName,
                                3 => RefusalReason::StateIndex,
                                4 => RefusalReason::StateLimit,
                                5 => RefusalReason::Landmark,
                                6 => RefusalReason::Edge,
                                _ => RefusalReason::StateKind,
                            };
                            (sequence, reason)
                        })
                        .collect(),
                },
                Observations {
                    new_states: (0..)
                        .zip(names)
                        .map(|(id, name)| {
                            NewState::sampled(StateId(id), StateName::new(&name).expect("valid"), shape(id as usize))
                        })
                        .chain(states_of_places())
                        .collect(),
                    states: states.into_iter().map(StateId).collect(),
                    times_nanos,
                    values,
                    offsets: vec![
                        OffsetRun { count: split, offset_secs: offsets.0 },
                        OffsetRun { count: rest, offset_secs: offsets.1 },
                    ],
                    failures,
                    runs: Vec::new(),
                },
            )
        },
    )
}

fn update_start() -> impl Strategy<Value = Event> {
    let cause = prop_oneof![
        Just(UpdateCause::Request),
        Just(UpdateCause::Midnight),
        Just(UpdateCause::DataTime),
        Just(UpdateCause::PendingLimit)
    ];
    (any::<u64>(), any::<i64>(), cause)
        .prop_map(|(generation, cut_nanos, cause)| Event::UpdateStart(UpdateStart { generation, cut_nanos, cause }))
}

/// States whose names have slashes.
fn states_of_places() -> impl Iterator<Item = NewState> {
    let states = [("node/Hall/Anna", StateKind::Count), ("edge/Hall/Lab", StateKind::Probability)];
    let states =
        states.into_iter().chain([("speed/Hall/x", StateKind::Continuous), ("pace/a/b/c", StateKind::Continuous)]);
    states.zip(100..).map(|((name, kind), id)| {
        let name = StateName::stored(name).expect("valid");
        NewState::sampled(StateId(id), name, kind)
    })
}

fn failures() -> impl Strategy<Value = Vec<EdgeFailure>> {
    vec(("[a-zü]{1,9}", "[a-zü]{1,9}", "[a-z]{0,3}", any::<(i64, i64)>(), "[a-zü ]{0,250}"), 0..4).prop_map(
        |failures| {
            let failure = |(from, to, action, times, reason): (String, String, String, (i64, i64), String)| {
                let edge = EdgeName::new(&from, &to, &action).expect("valid");
                EdgeFailure { edge, start_nanos: times.0, end_nanos: times.1, reason: kept_reason(&reason) }
            };
            failures.into_iter().map(failure).collect()
        },
    )
}

/// Any shape of a new state.
fn shape(number: usize) -> StateShape {
    match number % 5 {
        3 => StateShape::Vector(Dimensions::Two),
        4 => StateShape::Vector(Dimensions::Three),
        kind => StateKind::ALL[kind].into(),
    }
}

fn add_state() -> impl Strategy<Value = Event> {
    let durations = option::of((1_u32..86_400, 0_u32..31_536_000, any::<bool>()));
    (any::<u32>(), "[a-zü ]{5,20}", 0..5_usize, option::of((0.5..=1.0, 0.0..0.5)), durations).prop_map(
        |(id, name, kind, sensor, durations)| {
            let (name, shape) = (StateName::new(&name).expect("valid"), shape(kind));
            let sensor = sensor.and_then(|(hit, false_alarm)| StateSensor::new(hit, false_alarm).ok());
            let sensor = sensor.filter(|_| shape.may_have_sensor());
            let hold =
                durations.and_then(|(step, more, are_events)| Some((Hold::new(step + more, step).ok()?, are_events)));
            let reporting = match hold {
                Some((hold, true)) => Reporting::Events(hold),
                Some((hold, false)) => Reporting::Changes(hold),
                None => Reporting::Samples,
            };
            let reporting = if shape.may_report(reporting) { reporting } else { Reporting::Samples };
            Event::AddState(NewState { sensor, reporting, ..NewState::sampled(StateId(id), name, shape) })
        },
    )
}

fn topology_edit() -> impl Strategy<Value = TopologyEdit> {
    let name = || "[a-zü ]{1,20}".prop_map(|name| StateName::new(&name).expect("valid"));
    let pose = option::of([-1e7..=1e7, -1e7..=1e7, -4.0..=4.0]);
    let node = (name(), pose, option::of(0.0..1e9)).prop_map(|(name, pose, dwell_secs)| {
        let pose = pose.map(|[x_m, y_m, yaw_rad]| NodePose { x_m, y_m, yaw_rad });
        NewNode { name, pose, dwell_secs }
    });
    let ends = (name(), name(), option::of(name()), any::<bool>()).prop_map(|(from, to, action, both_ways)| EdgeEnds {
        from,
        to,
        action,
        both_ways,
    });
    let edge = (ends.clone(), option::of(0.1..1e7), option::of(0.1..1e9))
        .prop_map(|(ends, length_m, nominal_secs)| NewEdge { ends, extent: Extent { length_m, nominal_secs } });
    prop_oneof![
        (vec(node.clone(), 0..5), vec(edge.clone(), 0..5), any::<bool>())
            .prop_map(|(nodes, edges, replaces)| TopologyEdit::Load { nodes, edges, replaces }),
        node.clone().prop_map(TopologyEdit::AddNode),
        node.prop_map(TopologyEdit::SetNode),
        name().prop_map(TopologyEdit::RemoveNode),
        (name(), name()).prop_map(|(from, to)| TopologyEdit::RenameNode { from, to }),
        edge.clone().prop_map(TopologyEdit::AddEdge),
        edge.prop_map(TopologyEdit::SetExtent),
        ends.prop_map(TopologyEdit::RemoveEdge),
    ]
}

#[test]
fn a_topological_map_comes_back_with_its_numbers() {
    let name = |text: &str| StateName::new(text).expect("valid");
    let mut site = Site::default();
    let mut edit = |edit| site.apply(&SiteEdit::Topology(edit), 0).expect("valid");
    let pose = Some(NodePose { x_m: -1.5, y_m: 2.0, yaw_rad: 0.25 });
    let node = |text: &str, pose| NewNode { name: name(text), pose, dwell_secs: pose.map(|_| 3.5) };
    let link = |from: &str, to: &str, extent| NewEdge { ends: EdgeEnds::link(name(from), name(to)), extent };
    edit(TopologyEdit::Load {
        nodes: vec![node("a", None), node("b", pose), node("c", None)],
        edges: vec![link("a", "b", Extent::secs(14.5)), link("b", "c", Extent::metres(3.0))],
        replaces: true,
    });
    edit(TopologyEdit::RemoveNode(name("c")));
    let come_back = |site: &Site| tables::site(&tables::rows(site).collect::<Vec<_>>(), 0).expect("readable");
    assert_eq!(come_back(&site), site);
    // Removed items have used their numbers, even if nothing is left.
    let mut edit = |edit| site.apply(&SiteEdit::Topology(edit), 0).expect("valid");
    edit(TopologyEdit::Load { nodes: Vec::new(), edges: Vec::new(), replaces: true });
    assert_eq!(come_back(&site), site);
    let rows: Vec<_> = tables::rows(&site).collect();
    let broken = spoiled(&rows, 0, |topology: &mut Topology| {
        topology.nodes = vec![tidemap_layout::topology::Node { id: 9, name: "x".to_owned(), ..Default::default() }];
    });
    assert!(tables::site(&broken, 0).is_err(), "a number that was never given out");
}

fn edit_site() -> impl Strategy<Value = Event> {
    let place = option::of([-1e7..=1e7, -1e7..=1e7]);
    let cell = any::<(i32, i32, i32)>().prop_map(|(x, y, z)| CellIndex { x, y, z });
    let location =
        (vec(any::<u32>(), 0..20), vec(cell, 0..5), place.clone()).prop_map(|(states, cells, position_m)| Location {
            states: states.into_iter().map(StateId).collect(),
            cells,
            position_m,
        });
    let name = "[a-zü ]{1,20}".prop_map(|name| StateName::new(&name).expect("valid"));
    let edit = prop_oneof![
        topology_edit().prop_map(SiteEdit::Topology),
        place.prop_map(SiteEdit::Charger),
        (name.clone(), location).prop_map(|(name, location)| SiteEdit::SetLocation(name, location)),
        name.prop_map(SiteEdit::RemoveLocation),
        ([-1e7..=1e7, -1e7..=1e7], any::<(bool, i64)>()).prop_map(|(at_m, (reached, utc_nanos))| SiteEdit::Visit {
            at_m,
            reached,
            utc_nanos
        }),
    ];
    edit.prop_map(Event::EditSite)
}

fn of_shared_logs() -> impl Strategy<Value = Event> {
    let epoch = (any::<u64>(), ".{0,20}", ".{0,20}", any::<u32>())
        .prop_map(|(epoch, writer, version, maths)| Event::Epoch(Epoch { epoch, writer, version, maths }));
    let done = any::<(u64, u64, u32)>().prop_map(|(generation, digest, maths)| {
        Event::UpdateDone(UpdateDone { generation, digest: Digest(digest), maths })
    });
    prop_oneof![epoch, done]
}

/// Equal to the bit: 0.0 and -0.0 differ.
fn bits(event: &Event) -> Vec<u64> {
    match event {
        Event::Observations(_, observations) => observations.values.iter().map(|value| value.to_bits()).collect(),
        _ => Vec::new(),
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn events_come_back(event in prop_oneof![9 => observations(), 1 => update_start(), 1 => add_state(), 1 => edit_site(), 1 => of_shared_logs()]) {
        let (kind, payload) = record::event::encode(&event).expect("valid");
        let found = record::event::decode(kind, &payload).expect("readable");
        prop_assert_eq!(bits(&found), bits(&event));
        prop_assert_eq!(found, event);
    }

    #[test]
    fn no_payload_panics_or_takes_endless_memory(payload in vec(any::<u8>(), 0..200)) {
        for kind in [
            FrameKind::Observations,
            FrameKind::UpdateStart,
            FrameKind::Scans,
            FrameKind::AddState,
            FrameKind::EditSite,
            FrameKind::Epoch,
            FrameKind::UpdateDone,
        ] {
            let _ = record::event::decode(kind, &payload);
        }
    }

    #[test]
    fn a_changed_payload_is_read_or_refused(event in observations(), at in any::<prop::sample::Index>(), byte in any::<u8>()) {
        let (kind, mut payload) = record::event::encode(&event).expect("valid");
        let at = at.index(payload.len().max(1));
        if let Some(place) = payload.get_mut(at) {
            *place = byte;
        }
        if let Ok(found) = record::event::decode(kind, &payload) {
            // Any value that decodes can be encoded again.
            prop_assert!(record::event::encode(&found).is_ok());
        }
    }

    #[test]
    fn states_come_back(seed in any::<u64>()) {
        let spec = super::example::spec("office");
        let mut random = SmallRng::seed_from_u64(seed);
        let state = state(&spec, "door", &mut random);
        let message = record::snapshot::encode_state(7, &state, state.model.accumulator().to_parts());
        prop_assert_eq!(record::snapshot::decode_state(7, &message, &spec.periodicities, record::snapshot::SpectrumIn::Checkpoint), Ok(state));
        prop_assert!(record::snapshot::decode_state(8, &message, &spec.periodicities, record::snapshot::SpectrumIn::Checkpoint).is_err());
    }

    #[test]
    fn states_of_other_kinds_come_back(seed in any::<u64>(), scale in 1e-3..1e9_f64, is_count: bool) {
        let spec = super::example::spec("office");
        let mut random = SmallRng::seed_from_u64(seed);
        let of_unit = state(&spec, "speed", &mut random);
        let kind = if is_count { StateKind::Count } else { StateKind::Continuous };
        let value = |unit: f64| if is_count { (unit * scale).round() } else { (unit - 0.5) * scale };
        let samples = (0..50_i64).map(|hour| Sample {
            utc_nanos: hour * 3_600_000_000_000,
            offset_secs: 0,
            value: value(random.random()),
        });
        let mut model = StateModel::of_kind(kind);
        model.update(&spec.periodicities, spec.update_rules(), samples.collect());
        let last = value(random.random());
        let mut persistence = Persistence::default();
        persistence.observe(1, value(0.25));
        persistence.observe(2, last);
        let state = StateSnapshot { kind, persistence, model: Arc::new(model), ..of_unit };
        let message = record::snapshot::encode_state(7, &state, state.model.accumulator().to_parts());
        prop_assert_eq!(record::snapshot::decode_state(7, &message, &spec.periodicities, record::snapshot::SpectrumIn::Checkpoint), Ok(state));
        let as_probability = tidemap_layout::map::State { kind: 0, ..message };
        prop_assert!(last <= 1.0 || record::snapshot::decode_state(7, &as_probability, &spec.periodicities, record::snapshot::SpectrumIn::Checkpoint).is_err());
    }

    #[test]
    fn specs_come_back(
        base in 86_400_000_000_000..=604_800_000_000_000_i64,
        count in 1..=100_u32,
        is_list: bool,
        histograms: bool,
        trained in prop::collection::vec(prop::sample::select(&tidemap_model::catalogue::TRAINED_AT_NIGHT[..]), 0..4),
    ) {
        let periodicities = if is_list {
            Periodicities::list((1..=i64::from(count)).map(|k| base / k).collect())
        } else {
            Periodicities::harmonics(base, count)
        };
        let spec = MapSpec { zone: Zone::named(if is_list { "UTC" } else { "America/New_York" }).expect("known"), periodicities: periodicities.expect("valid"), criterion: if is_list { OrderCriterion::ZeroOne } else { OrderCriterion::SquaredError }, created_nanos: base, models: trained.into_iter().fold(
                EnabledModels::SPECTRAL.with_histograms(histograms),
                EnabledModels::with,
            ), ..MapSpec::new(MapName::new("a-b_0").expect("valid")) };
        prop_assert_eq!(record::spec::decode(record::spec::encode(&spec)), Ok(spec));
    }
}

#[test]
fn a_model_that_is_not_known_is_refused() {
    let message = record::spec::encode(&super::example::spec("office"));
    for models in [64, 3 | 64, u32::MAX] {
        let message = tidemap_layout::map::MapSpec { models, ..message.clone() };
        assert_eq!(record::spec::decode(message), Err(format!("models {models} are not all known")));
    }
}

#[test]
fn a_snapshot_comes_back_from_its_parts() {
    let spec = super::example::spec("office");
    let snapshot = snapshot(&spec, 15, 4);
    let message = record::snapshot::encode(&snapshot);
    let site = tables::site(&tables::rows(&snapshot.site).collect::<Vec<_>>(), 4).expect("readable");
    let (producers, states) = (|| snapshot.producers.clone(), || snapshot.states.clone());
    let found = record::snapshot::decode(&message, producers(), states(), site.clone());
    assert_eq!(found.as_ref(), Ok(&snapshot));
    assert!(record::snapshot::decode(&message, vec![], states(), site.clone()).is_err());
    assert!(record::snapshot::decode(&message, producers(), states()[1..].to_vec(), site).is_err());
    assert!(record::snapshot::decode(&message, producers(), states(), Site::default()).is_err());
}

#[test]
fn a_snapshot_has_whole_vectors_or_is_not_believed() {
    let whole = snapshot(&spec("vectors"), 3, 1);
    let with = |states: Vec<StateSnapshot>| {
        let mut changed = whole.clone();
        changed.states = states;
        let message = record::snapshot::encode(&changed);
        let (producers, states) = (changed.producers.clone(), changed.states.clone());
        let decoded = record::snapshot::decode(&message, producers, states, Site::clone(&changed.site));
        assert_eq!(decoded.is_ok(), record::snapshot::check(&changed).is_ok());
        decoded.is_ok()
    };
    let axis = |name: &str, kind| StateSnapshot {
        name: StateName::stored(name).expect("valid"),
        kind,
        ..whole.states[0].clone()
    };
    let axes = |names: &[&str]| with(names.iter().map(|name| axis(name, StateKind::Continuous)).collect());
    for names in [&["a/x", "a/y"][..], &["b", "a/x", "a/y", "a/z", "c"], &["a/x", "a/y", "b/x", "b/y", "b/z"]] {
        assert!(axes(names), "{names:?}");
    }
    for names in [&["a/x"][..], &["a/y"], &["a/x", "a/z"], &["a/x", "b", "a/y"], &["a/x", "b/y"], &["a/x", "a/y", "a"]]
    {
        assert!(!axes(names), "{names:?}");
    }
    assert!(!with(vec![axis("a/x", StateKind::Continuous), axis("a/y", StateKind::Count)]), "no count is a coordinate");
}
