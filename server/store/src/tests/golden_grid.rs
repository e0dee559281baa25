//! The map of `golden.rs` with a grid: scans of two sensors, learned tiles, and history.

use std::sync::Arc;

use tidemap_grid::{
    day::{GridDay, ScanTime},
    fade::GroupFade,
    index::{CellBox, CellIndex, TileId, TileIndex},
    live_tile::{Away, LiveTile},
    mask::{Mask, TileMasks},
    observation_runs::{CellRuns, DayRuns, ObservationRuns},
    observed_times::ObservedTimes,
    scan::{CellRef, LoggedScan, ScanSource, Scans},
    sensor_sums::{SensorSums, SensorWeights, WeightedSums},
    sensors::{ProducerSensor, SensorId, Weights},
    snapshot::{FutureScan, GridSnapshot},
    spec::{GridSpec, Retention, SensorNoise},
    standing::Standing,
    tile::{CellModel, Group, ModelSlot, SumsSlot, TileModel, TileSums},
    tile_odds::TileOdds,
};
use tidemap_map::{
    event::{Envelope, Event, SequenceSpan, UpdateCause, UpdateStart},
    history::{
        HistoryDay, HistoryPiece, OutlierComponent, OutlierModel,
        origins::{OriginRun, Origins},
    },
    ids::{NewProducer, ProducerId, RefusalReason, StateId},
    name::{MapName, ProducerKey},
    snapshot::{MapSnapshot, ProducerMark},
    spec::MapSpec,
};
use tidemap_model::{
    Component, DayScores, GapSample, LocalDay, OrderCriterion, OrderErrors, OrderErrorsParts, OrderWatch,
    Periodicities, PhasorSum, Sample, SpectralModel, Zone,
};

use super::golden::Golden;

fn spec() -> MapSpec {
    MapSpec {
        zone: Zone::named("Europe/Prague").expect("known"),
        periodicities: Periodicities::list(vec![604_800_000_000_000, 86_400_000_000_000]).expect("valid"),
        criterion: OrderCriterion::ZeroOne,
        created_nanos: 1_700_000_000_123_456_789,
        grid: Some(GridSpec {
            is_flat: true,
            origin_m: [-1.5, 0.0, 0.1],
            extent: Some(CellBox { min: CellIndex { x: -80, y: 0, z: 0 }, max: CellIndex { x: 800, y: 640, z: 1 } }),
            sensor: SensorNoise { hit: 0.9, false_alarm: 0.05, prior: 0.3 },
            retention: Retention::Duration(31 * 86_400_000_000_000),
            half_life_nanos: Some(60 * 86_400_000_000_000),
            ..GridSpec::new(0.05)
        }),
        models: super::golden::models(),
        ..MapSpec::new(MapName::new("warehouse").expect("valid"))
    }
}

fn cells(range: std::ops::Range<u16>) -> Mask {
    let mut mask = Mask::EMPTY;
    range.for_each(|cell| mask.insert(cell));
    mask
}

fn shown(observed: std::ops::Range<u16>, occupied: std::ops::Range<u16>) -> TileMasks {
    TileMasks::new(cells(observed), cells(occupied)).expect("valid")
}

fn refs(tile: u32, cells: impl Iterator<Item = u16>) -> Vec<CellRef> {
    cells.map(|cell| CellRef::new(TileId(tile), cell)).collect()
}

/// The sensor of the second producer.
const SENSOR: ProducerSensor = ProducerSensor { hit: 0.75, false_alarm: 0.125 };

fn events() -> Vec<Event> {
    let scan = |nanos: i64, seen: Option<&[u32]>, observed_flips, occupied_flips| LoggedScan {
        utc_nanos: 1_700_000_000_000_000_000 + nanos,
        offset_secs: if nanos < 2_000_000_000 { 3600 } else { 7200 },
        source: if nanos == 1_000_000_000 { ScanSource::Rays { height: 1 } } else { ScanSource::Cells },
        seen: seen.map(|seen| seen.iter().copied().map(TileId).collect()),
        observed_flips,
        occupied_flips,
    };
    let envelope = Envelope {
        producer: ProducerId(0),
        new_producer: Some(ProducerKey::new("robot", "lidar").expect("valid").into()),
        incarnation: 2,
        span: SequenceSpan { first: 1, last: 8, content_crc: 0x1234_5678 },
        received_nanos: 1_700_000_001_000_000_000,
        refused: vec![
            (2, RefusalReason::NoGrid),
            (3, RefusalReason::Scan),
            (5, RefusalReason::Empty),
            (7, RefusalReason::TileLimit),
            (8, RefusalReason::Frame),
        ],
    };
    let scans = Scans {
        new_tiles: vec![TileIndex { x: 0, y: 0, z: 0 }, TileIndex { x: -1, y: 5, z: 0 }],
        scans: vec![
            scan(0, Some(&[0, 1]), [refs(0, 0..64), refs(1, 10..30)].concat(), refs(0, 3..5)),
            scan(1_000_000_000, None, vec![], vec![]),
            scan(3_000_000_000, None, vec![], [refs(0, 4..6), refs(1, 20..21)].concat()),
            scan(4_500_000_000, Some(&[1]), refs(1, 30..31), vec![]),
        ],
        ..Scans::default()
    };
    let cut_nanos = 1_700_000_050_000_000_000;
    let other = Envelope {
        producer: ProducerId(1),
        new_producer: Some(NewProducer {
            key: ProducerKey::new("robot", "camera").expect("valid"),
            sensor: Some(SENSOR),
            introduced_by: String::new(),
        }),
        span: SequenceSpan { last: 1, ..envelope.span },
        refused: Vec::new(),
        ..envelope.clone()
    };
    let of_other = Scans {
        new_tiles: vec![TileIndex { x: 9, y: 9, z: 0 }],
        scans: vec![scan(5_000_000_000, Some(&[2]), refs(2, 0..512), vec![])],
        ..Scans::default()
    };
    vec![
        Event::Scans(envelope, scans),
        Event::Scans(other, of_other),
        Event::UpdateStart(UpdateStart { generation: 1, cut_nanos, cause: UpdateCause::Midnight }),
    ]
}

fn sum(parts: [f64; 4]) -> PhasorSum {
    PhasorSum::from_slice(&spec().periodicities, &parts).expect("finite")
}

fn day() -> GridDay {
    let mut day = GridDay::new(LocalDay(19_676));
    let seen: Arc<[TileId]> = [TileId(0), TileId(1)].into();
    let time = |secs: i64| ScanTime {
        utc_nanos: 1_700_000_100_000_000_000 + secs * 1_000_000_000,
        offset_secs: 3600,
        source: if secs == 500 { ScanSource::Rays { height: -2 } } else { ScanSource::Cells },
        sensor: if secs == 9 { SensorId(1) } else { SensorId::OWN },
    };
    for (secs, first) in [(0, 0), (2, 5), (9, 5), (500, 0)] {
        let scan = day.push(time(secs), &seen);
        day.show(scan, TileId(0), shown(0..64, first..first + 3));
        day.show(scan, TileId(1), shown(first..30, 20..21));
    }
    day.push(time(501), &[TileId(1)].into());
    day
}

/// Observation times of some cells on two days, at equal and at unequal distances.
fn runs() -> ObservationRuns {
    let list = |cells: std::ops::Range<u16>, toggles: &[u32]| CellRuns {
        cells: cells.collect(),
        toggles: toggles.iter().copied().collect(),
    };
    let even = (0..6).map(|scan| 1_700_000_000_000_000_000 + scan * 5_000_000_000).collect();
    let uneven = [1_700_090_000_000_000_000, 1_700_090_000_000_000_007, 1_700_090_099_000_000_000].into();
    let sensors = Some(Arc::new(vec![SensorId(1), SensorId::OWN, SensorId(1)]));
    let days = vec![
        DayRuns { civil_nanos: even, sensors: None, lists: vec![list(0..9, &[0, 2, 5]), list(20..23, &[1])] },
        DayRuns { civil_nanos: uneven, sensors, lists: vec![list(3..4, &[2])] },
    ];
    ObservationRuns::from_days(days).expect("valid")
}

fn times() -> Arc<ObservedTimes> {
    let mut gaps = GapSample::default();
    gaps.observe_many(30, |gap| gap * 1_500_000_000);
    Arc::new(ObservedTimes { gaps, hours: 12.5, by_hour: ObservedTimes::spread(12.5) })
}

fn watch() -> OrderWatch {
    let squared = std::array::from_fn(|order| 9.0 - order as f64 / 4.0);
    let mut watch = OrderWatch::of_constant(Some(true));
    let mut errors = OrderErrors::default();
    for day in 19_670..19_673 {
        let scores = DayScores { errors: &squared, squared: &squared, scored: 20, order: 2, unit: 0.5 };
        watch.score(LocalDay(day), &spec().periodicities, &mut errors, scores);
    }
    watch.learn(7, 0.375, Some(false));
    watch
}

fn learned() -> (TileModel, TileSums) {
    let group = |range, observations| Group {
        cells: cells(range),
        observations,
        first_nanos: 1_700_000_000_000_000_000,
        last_nanos: 1_700_000_004_500_000_000,
        ..Group::default()
    };
    let component = Component { periodicity: 1, gamma_re: 0.125, gamma_im: -0.1 };
    let mut sums = [0.0; 16];
    sums[0] = 2.5;
    sums[15] = 0.1;
    let errors = OrderErrorsParts { sums, last_day: Some(LocalDay(19_675)) };
    let cell = |cell, components| CellModel {
        cell,
        occupied: 2,
        spectral: SpectralModel::from_parts(0.4, 4, components).expect("valid"),
        order: 1,
        errors: OrderErrors::from_parts(errors).expect("valid"),
        alarm_day: None,
    };
    let model = TileModel {
        groups: vec![group(0..40, 4), group(40..64, 3)],
        always_occupied: cells(10..12),
        cells: vec![cell(4, vec![component]), cell(50, vec![])],
        sensors: Some(Box::new(SensorWeights {
            groups: vec![Weights { alpha: 1.5, beta: 2.25 }, Weights { alpha: 0.5, beta: 3.0 }],
            occupied: vec![1.25, 0.75],
            fades: [3.5, 2.75]
                .map(|weight| GroupFade { weight, day: LocalDay(19_675), sum_day: LocalDay(19_670) })
                .to_vec(),
        })),
    };
    let weighted =
        WeightedSums { alpha: Arc::new(sum([0.5, 0.25, -0.125, 0.0])), beta: Arc::new(sum([1.5, 1.25, -1.125, 1.0])) };
    let sums = TileSums {
        groups: vec![Arc::new(sum([1.0, 2.0, -3.0, 0.1])), Arc::new(sum([-0.0, 0.2, 0.3, 0.4]))],
        cells: vec![sum([5.0, 6.0, 7.0, 8.0]), sum([0.5, 0.6, 0.7, 0.8])],
        runs: runs(),
        times: vec![times(), Arc::default()],
        watches: vec![watch(), OrderWatch::of_constant(None)],
        standing: Standing::from_sources(vec![
            (ScanSource::Cells, cells(0..3)),
            (ScanSource::Rays { height: 8 }, cells(3..5)),
        ])
        .expect("two sources"),
        sensors: Some(Box::new(SensorSums { groups: vec![Some(weighted), None] })),
    };
    (model, sums)
}

fn grid() -> GridSnapshot {
    let mut first = LiveTile::new(TileIndex { x: 0, y: 0, z: 0 });
    first.arrival = shown(0..64, 3..6);
    first.known = cells(0..70);
    first.occupied = cells(3..6);
    first.current = cells(0..64);
    first.newest_nanos = 1_700_000_003_000_000_000;
    first.scans = 3;
    first.away = (64..70)
        .map(|cell| Away { cell, sensor: SensorId((cell % 2) as u8), last_nanos: 1_699_000_000_000_000_000, pairs: 7 })
        .collect();
    first.offsets = vec![(5, -3), (63, 2)];
    first.change_rates = vec![(4, 0.25), (5, 0.1)];
    let mut odds = Box::new([0; 512]);
    odds[3..6].copy_from_slice(&[112, 27, -64]);
    first.odds = TileOdds::from_sources(vec![(ScanSource::Rays { height: 8 }, odds)]).expect("in range");
    let (model, sums) = learned();
    // The other tile shares a sum with the first, and a third has not been learned.
    let other_model =
        TileModel { groups: vec![model.groups[0]], always_occupied: Mask::EMPTY, cells: vec![], sensors: None };
    let groups = vec![Arc::clone(&sums.groups[0])];
    let other_sums = TileSums { groups, times: vec![Arc::default()], ..TileSums::default() };
    let models = [model, other_model, TileModel::default()];
    let sums = [sums, other_sums, TileSums::default()];
    GridSnapshot {
        tiles: [first, LiveTile::new(TileIndex { x: -1, y: 5, z: 0 }), LiveTile::new(TileIndex { x: 9, y: 9, z: 0 })]
            .map(Arc::new)
            .to_vec(),
        models: models.map(|model| ModelSlot::Resident(Arc::new(model))).to_vec(),
        sums: sums.map(|sums| SumsSlot::Resident(Arc::new(sums))).to_vec(),
        last_seen: [TileId(0), TileId(2)].into(),
        days: vec![day()],
        future: vec![FutureScan {
            time: ScanTime {
                utc_nanos: 1_800_000_000_000_000_000,
                offset_secs: 3600,
                source: ScanSource::Cells,
                sensor: SensorId::OWN,
            },
            tiles: vec![(TileId(1), shown(0..3, 0..1))],
        }],
        scans: 9,
        cell_observations: 321,
        shown: CellBox::default(),
        received_nanos: Some(1_700_000_001_000_000_000),
    }
}

fn piece() -> HistoryPiece {
    let model = OutlierModel {
        cell: 20,
        mean: 0.75,
        components: vec![OutlierComponent { periodicity: 1, gamma_re: 0.25, gamma_im: -0.5 }],
    };
    let sample = |secs: i64, value| Sample { utc_nanos: secs * 1_000_000_000, offset_secs: 3600, value };
    HistoryPiece {
        generation: 1,
        from_nanos: 5_000_000_000,
        to_nanos: 1_700_000_601_000_000_000,
        states: vec![
            (StateId(0), vec![sample(1_700_000_000, 1.0), sample(1_700_000_007, 0.0), sample(5, 1.0)]),
            (StateId(300), vec![sample(1_700_000_000, 0.1)]),
        ],
        origins: vec![
            Origins {
                runs: vec![
                    OriginRun { producer: ProducerId(0), first: 1, count: 2 },
                    OriginRun { producer: ProducerId(1), first: 7, count: 1 },
                ],
                ahead: 1,
                arrived: 9,
                is_early: true,
                is_crowded: false,
            },
            Origins {
                runs: vec![OriginRun { producer: ProducerId(1), first: 1, count: 1 }],
                is_crowded: true,
                ..Origins::default()
            },
        ],
        days: vec![HistoryDay { outliers: day(), models: vec![(TileId(1), vec![model])] }],
    }
}

fn snapshot() -> MapSnapshot {
    MapSnapshot {
        position: 3,
        replay_from: 1,
        generation: 1,
        cut_nanos: 1_700_000_050_000_000_000,
        newest_nanos: 1_700_000_100_000_000_000,
        producers: [("lidar", 8, None), ("camera", 1, Some(SENSOR))]
            .map(|(label, durable_sequence, sensor)| ProducerMark {
                key: ProducerKey::new("robot", label).expect("valid"),
                incarnation: 2,
                durable_sequence,
                content_crc: 0x1234_5678,
                sensor,
                received_nanos: 1_700_000_001_000_000_000,
                newest_nanos: 0,
                recent: Vec::new(),
                has_scans: true,
                is_forgotten: false,
                introduced_by: String::new(),
            })
            .to_vec(),
        states: Vec::new(),
        site: Arc::default(),
        grid: Some(grid()),
        history: vec![Arc::new(piece())],
    }
}

pub(super) fn map() -> Golden {
    Golden { spec: spec(), events: events(), snapshot: snapshot(), rows: 0xEA27_A603 }
}
