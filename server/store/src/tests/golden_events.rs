//! The map of `golden.rs` with events of every kind but scans, and with a site.

use std::sync::Arc;

use tidemap_grid::index::CellIndex;
use tidemap_map::{
    event::{
        Digest, Dimensions, Envelope, Epoch, Event, NewState, Observations, OffsetRun, SequenceSpan, StateKind,
        StateShape, UpdateCause, UpdateDone, UpdateStart,
    },
    ids::{ProducerId, RefusalReason, StateId},
    name::{EdgeName, MapName, ProducerKey, StateName},
    site::{Location, Site, SiteEdit},
    snapshot::{ContentMark, MapSnapshot, ProducerMark, StateSnapshot},
    spec::MapSpec,
    task::TaskRuns,
    topology::{EdgeEnds, Extent, NewEdge, NewNode, NodePose, TopologyEdit},
    traversal::EdgeFailure,
};
use tidemap_model::{
    Accumulator, AccumulatorParts, Component, LocalDay, OrderCriterion, OrderErrors, OrderErrorsParts, Periodicities,
    Persistence, PersistenceParts, Recent, SpectralModel, StateModel, Zone,
};

use super::{golden::Golden, golden_categorical, landmarks, tasks};

fn spec() -> MapSpec {
    MapSpec {
        zone: Zone::named("Europe/Prague").expect("known"),
        periodicities: Periodicities::list(vec![604_800_000_000_000, 86_400_000_000_000]).expect("valid"),
        criterion: OrderCriterion::ZeroOne,
        created_nanos: 1_700_000_000_123_456_789,
        models: super::golden::models(),
        ..MapSpec::new(MapName::new("office").expect("valid"))
    }
}

fn events() -> Vec<Event> {
    let envelope = Envelope {
        producer: ProducerId(0),
        new_producer: Some(ProducerKey::new("robot", "door").expect("valid").into()),
        incarnation: 2,
        span: SequenceSpan { first: 1, last: 12, content_crc: 0x1234_5678 },
        received_nanos: 1_700_000_001_000_000_000,
        refused: vec![(3, RefusalReason::Value), (12, RefusalReason::StateKind)],
    };
    let first = Observations {
        new_states: vec![NewState::sampled(
            StateId(0),
            StateName::new("Küche").expect("valid"),
            StateKind::Probability,
        )],
        states: vec![StateId(0); 10],
        times_nanos: (0..10).map(|i| 1_700_000_000_000_000_000 + i * 1_000_000_000).collect(),
        values: vec![0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0],
        offsets: vec![OffsetRun { count: 4, offset_secs: 3600 }, OffsetRun { count: 6, offset_secs: 7200 }],
        failures: Vec::new(),
        runs: Vec::new(),
    };
    let later = Envelope {
        new_producer: None,
        span: SequenceSpan { first: 13, last: 15, ..envelope.span },
        refused: vec![],
        ..envelope.clone()
    };
    let second = Observations {
        new_states: vec![NewState::sampled(StateId(1), StateName::new("door").expect("valid"), StateKind::Probability)],
        states: vec![StateId(1), StateId(0), StateId(300)],
        times_nanos: vec![5, 1_700_000_100_000_000_000, 7],
        values: vec![0.1, 1.0, -0.0],
        offsets: vec![OffsetRun { count: 3, offset_secs: -16_200 }],
        failures: Vec::new(),
        runs: Vec::new(),
    };
    let floats = Observations { values: vec![0.25; 3], ..second.clone() };
    let cut_nanos = 1_700_000_050_000_000_000;
    let reports = Observations { failures: vec![failure()], runs: vec![tasks::run()], ..floats.clone() };
    let mut events = vec![
        Event::Observations(envelope, first),
        Event::Observations(later.clone(), second),
        Event::UpdateStart(UpdateStart { generation: 1, cut_nanos, cause: UpdateCause::DataTime }),
        Event::Observations(later.clone(), floats),
        Event::Observations(later, reports),
    ];
    let shapes = [
        StateShape::Scalar(StateKind::Continuous),
        StateShape::Scalar(StateKind::Count),
        StateShape::Vector(Dimensions::Two),
        StateShape::Vector(Dimensions::Three),
        StateShape::Angle,
    ];
    let add = |(id, shape): (u32, StateShape)| NewState::sampled(StateId(id), named(shape.name()), shape);
    events.extend((2..).zip(shapes).map(add).map(Event::AddState));
    events.push(Event::AddState(NewState { id: StateId(10), ..golden_categorical::categorical() }));
    events.extend(edits().into_iter().map(Event::EditSite));
    let epoch = Epoch { epoch: 300, writer: "d1".to_owned(), version: "0.1.0".to_owned(), maths: 2 };
    let done = UpdateDone { generation: 7, digest: Digest(0x0102_0304_0506_0708), maths: 1 };
    events.extend([Event::Epoch(epoch), Event::UpdateDone(done), Event::ForgetProducers(vec![ProducerId(0)])]);
    events.extend(
        [UpdateCause::Request, UpdateCause::Midnight, UpdateCause::PendingLimit]
            .map(|cause| Event::UpdateStart(UpdateStart { generation: 2, cut_nanos: -cut_nanos, cause })),
    );
    events
}

fn named(name: &str) -> StateName {
    StateName::new(name).expect("valid")
}

fn failure() -> EdgeFailure {
    EdgeFailure {
        edge: EdgeName::new("Hall", "Lab", "drive").expect("valid"),
        start_nanos: 1_700_000_000_000_000_000,
        end_nanos: 1_700_000_020_000_000_000,
        reason: "the door was closed".to_owned(),
    }
}

/// One edit of every kind. After all of them every table of the site has rows.
fn edits() -> Vec<SiteEdit> {
    let pose = NodePose { x_m: 1.5, y_m: -2.0, yaw_rad: 0.75 };
    let node = |name: &str| NewNode { name: named(name), pose: Some(pose), dwell_secs: Some(12.5) };
    let bare = |name: &str| NewNode { name: named(name), pose: None, dwell_secs: None };
    let edge = |from: &str, to: &str, both_ways| NewEdge {
        ends: EdgeEnds { from: named(from), to: named(to), action: Some(named("drive")), both_ways },
        extent: Extent { length_m: Some(7.25), nominal_secs: None },
    };
    let link = NewEdge { ends: EdgeEnds::link(named("Lab"), named("Lift")), extent: Extent::secs(31.0) };
    let location = |position_m| Location {
        states: vec![StateId(0), StateId(1)],
        cells: vec![CellIndex { x: -3, y: 0, z: 2 }, CellIndex { x: 4, y: 5, z: 0 }],
        position_m,
    };
    let visit = |reached, utc_nanos| SiteEdit::Visit { at_m: [2.25, -7.5], reached, utc_nanos };
    let nodes = vec![node("Hall"), bare("Lab")];
    let topology = [
        TopologyEdit::Load { nodes, edges: vec![edge("Hall", "Lab", true)], replaces: true },
        TopologyEdit::AddNode(node("Shed")),
        TopologyEdit::AddNode(bare("Stairs")),
        TopologyEdit::SetNode(NewNode { dwell_secs: None, ..node("Shed") }),
        TopologyEdit::RenameNode { from: named("Shed"), to: named("Lift") },
        TopologyEdit::RemoveNode(named("Stairs")),
        TopologyEdit::AddEdge(link.clone()),
        TopologyEdit::SetExtent(NewEdge { extent: Extent { length_m: Some(9.0), nominal_secs: Some(40.0) }, ..link }),
        TopologyEdit::RemoveEdge(EdgeEnds { both_ways: false, ..edge("Lab", "Hall", false).ends }),
    ];
    let site = [
        SiteEdit::Charger(None),
        SiteEdit::Charger(Some([0.5, -1.25])),
        SiteEdit::SetLocation(named("kitchen"), location(Some([3.0, -0.5]))),
        SiteEdit::SetLocation(named("corner"), location(None)),
        SiteEdit::RemoveLocation(named("corner")),
        visit(true, 1_700_000_000_000_000_000),
        visit(false, 1_700_000_060_000_000_000),
    ];
    let place = |name| TopologyEdit::AddNode(bare(name));
    let way = NewEdge { ends: EdgeEnds::link(named("a"), named("b")), extent: Extent::metres(5.0) };
    let places = [place("a"), place("b"), TopologyEdit::AddEdge(way)];
    let edits = site.into_iter().chain(topology.into_iter().chain(places).map(SiteEdit::Topology));
    // The first edit of the landmarks loads their places, which are here already.
    let edits = edits.chain(landmarks::edits().into_iter().skip(1));
    edits.chain(tasks::edits().into_iter().map(SiteEdit::Task)).chain([tasks::area()]).collect()
}

fn site() -> Site {
    let mut site = Site::default();
    for edit in edits() {
        site.apply(&edit, 2).expect("valid");
    }
    site.add_failures(&[failure()]);
    let mut runs = TaskRuns::default();
    runs.add(tasks::run());
    let tasks = site.tasks().clone().with_runs(runs);
    site.with_tasks(tasks)
}

fn snapshot() -> MapSnapshot {
    let spec = spec();
    let accumulator = AccumulatorParts {
        observations: 10,
        weight: 10.0,
        sum: 5.0,
        sum_squares: 4.5,
        first_nanos: 1,
        last_nanos: 1_700_000_000_000_000_000,
        spectrum: vec![[0.5, -0.25, 1.5, -1.75], [0.1, 0.2, 0.3, 0.4]],
        short: None,
    };
    let component = Component { periodicity: 1, gamma_re: 0.125, gamma_im: -0.1 };
    let mut sums = [0.0; 16];
    sums[0] = 2.5;
    sums[15] = 0.1;
    let errors = OrderErrorsParts { sums, last_day: Some(LocalDay(19_675)) };
    let model = StateModel::from_parts(
        Accumulator::from_parts(&spec.periodicities, accumulator).expect("valid"),
        SpectralModel::from_parts(0.5, 10, vec![component]).expect("valid"),
        1,
        OrderErrors::from_parts(errors).expect("valid"),
    );
    let persistence =
        PersistenceParts { pairs: 9, change_rate_sum: 0.375, last: Some((1_700_000_009_000_000_000, 1.0)) };
    let persistence = Persistence::from_parts(persistence).expect("valid");
    let state = |name: &str, model: StateModel, persistence| StateSnapshot {
        name: StateName::new(name).expect("valid"),
        kind: StateKind::Probability,
        observations: 10,
        persistence,
        recent: Recent::default(),
        newest_row: None,
        model: Arc::new(model),
    };
    MapSnapshot {
        position: 3,
        replay_from: 2,
        generation: 1,
        cut_nanos: 1_700_000_050_000_000_000,
        newest_nanos: 1_700_000_100_000_000_000,
        producers: vec![ProducerMark {
            key: ProducerKey::new("robot", "door").expect("valid"),
            incarnation: 2,
            durable_sequence: 15,
            content_crc: 0x1234_5678,
            sensor: None,
            received_nanos: 1_700_000_001_000_000_000,
            newest_nanos: 0,
            recent: vec![ContentMark { sequence: 12, crc: 0x9ABC_DEF0 }],
            has_scans: false,
            is_forgotten: false,
            introduced_by: String::new(),
        }],
        states: vec![
            state("Küche", model.expect("valid"), persistence),
            state("door", StateModel::new(&spec.periodicities), Persistence::default()),
        ],
        site: Arc::new(site()),
        grid: None,
        history: Vec::new(),
    }
}

pub(super) fn map() -> Golden {
    Golden { spec: spec(), events: events(), snapshot: snapshot(), rows: 0xCF60_4055 }
}
