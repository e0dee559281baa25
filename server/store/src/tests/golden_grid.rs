//! The bytes of format 2: a map with a grid. A difference here means that existing data directories cannot be
//! read any more: do not change the files in `golden/`; make a new format.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use tidemap_grid::{
    day::{GridDay, ScanTime},
    index::{CellBox, CellIndex, TileId, TileIndex},
    live_tile::{Away, LiveTile},
    mask::{Mask, TileMasks},
    scan::{CellRef, LoggedScan, Scans},
    sensors::SensorId,
    snapshot::{FutureScan, GridSnapshot},
    spec::{GridSpec, Retention, SensorNoise},
    tile::{CellModel, Group, ModelSlot, SumsSlot, TileModel, TileSums},
};
use tidemap_map::{
    event::{Envelope, Event, SequenceSpan, UpdateCause, UpdateStart},
    history::{HistoryDay, HistoryPiece, OutlierComponent, OutlierModel},
    ids::{ProducerId, RefusalReason, StateId},
    name::{MapName, ProducerKey},
    snapshot::{MapSnapshot, ProducerMark},
    spec::MapSpec,
};
use tidemap_model::{
    Component, LocalDay, OrderCriterion, OrderErrors, OrderErrorsParts, Periodicities, PhasorSum, Sample,
    SpectralModel, Zone,
};

use super::example::{append, content, copy, options};
use crate::{MapId, Source, Store};

const FILES: [&str; 6] = [
    "MANIFEST",
    "maps/00000001/MAP",
    "maps/00000001/checkpoints/00000000000000000002.tmc",
    "maps/00000001/history/00000000000000000001.grid.tmh",
    "maps/00000001/history/00000000000000000001.states.tmh",
    "maps/00000001/log/00000000000000000001.log",
];

fn golden() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src/tests/golden/format-2")
}

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
            ..GridSpec::new(0.05)
        }),
        ..MapSpec::new(MapName::new("office").expect("valid"))
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

fn events() -> Vec<Event> {
    let scan = |nanos: i64, seen: Option<&[u32]>, observed_flips, occupied_flips| LoggedScan {
        utc_nanos: 1_700_000_000_000_000_000 + nanos,
        offset_secs: if nanos < 2_000_000_000 { 3600 } else { 7200 },
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
    };
    let cut_nanos = 1_700_000_050_000_000_000;
    vec![
        Event::Scans(envelope, scans),
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
        sensor: SensorId::OWN,
    };
    for (secs, first) in [(0, 0), (2, 5), (9, 5), (500, 0)] {
        let scan = day.push(time(secs), &seen);
        day.show(scan, TileId(0), shown(0..64, first..first + 3));
        day.show(scan, TileId(1), shown(first..30, 20..21));
    }
    day.push(time(501), &[TileId(1)].into());
    day
}

fn learned() -> (TileModel, TileSums) {
    let group = |range, observations| Group {
        cells: cells(range),
        observations,
        first_nanos: 1_700_000_000_000_000_000,
        last_nanos: 1_700_000_004_500_000_000,
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
        rang: None,
    };
    let model = TileModel {
        groups: vec![group(0..40, 4), group(40..64, 3)],
        always_occupied: cells(10..12),
        cells: vec![cell(4, vec![component]), cell(50, vec![])],
        sensors: None,
    };
    let sums = TileSums {
        groups: vec![Arc::new(sum([1.0, 2.0, -3.0, 0.1])), Arc::new(sum([-0.0, 0.2, 0.3, 0.4]))],
        cells: vec![sum([5.0, 6.0, 7.0, 8.0]), sum([0.5, 0.6, 0.7, 0.8])],
        ..TileSums::default()
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
        .map(|cell| Away { cell, sensor: SensorId::OWN, last_nanos: 1_699_000_000_000_000_000, pairs: 7 })
        .collect();
    first.offsets = vec![(5, -3), (63, 2)];
    first.change_rates = vec![(4, 0.25), (5, 0.1)];
    let (model, sums) = learned();
    // The other tile shares a sum with the first, and a third has not been learned.
    let other_model =
        TileModel { groups: vec![model.groups[0]], always_occupied: Mask::EMPTY, cells: vec![], sensors: None };
    let other_sums = TileSums { groups: vec![Arc::clone(&sums.groups[0])], cells: vec![], ..TileSums::default() };
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
            time: ScanTime { utc_nanos: 1_800_000_000_000_000_000, offset_secs: 3600, sensor: SensorId::OWN },
            tiles: vec![(TileId(1), shown(0..3, 0..1))],
        }],
        scans: 9,
        cell_observations: 321,
        received_nanos: None,
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
        origins: Vec::new(),
        days: vec![HistoryDay { outliers: day(), models: vec![(TileId(1), vec![model])] }],
    }
}

fn snapshot() -> MapSnapshot {
    MapSnapshot {
        position: 2,
        replay_from: 1,
        generation: 1,
        cut_nanos: 1_700_000_050_000_000_000,
        newest_nanos: 1_700_000_100_000_000_000,
        producers: vec![ProducerMark {
            key: ProducerKey::new("robot", "lidar").expect("valid"),
            incarnation: 2,
            durable_sequence: 8,
            content_crc: 0x1234_5678,
            sensor: None,
            received_nanos: None,
            recent: Vec::new(),
            has_scans: None,
        }],
        states: Vec::new(),
        site: Arc::default(),
        grid: Some(grid()),
        history: vec![Arc::new(piece())],
    }
}

#[test]
fn format_2_is_written_as_it_always_was() {
    let directory = tempfile::tempdir().expect("temporary directory");
    {
        let store = Store::open(directory.path(), options()).expect("opens");
        let map = store.create_map(&spec()).expect("creates");
        let log = store.open_map(map, &spec()).expect("opens").log;
        for event in events() {
            append(&log, &event).expect("appends");
        }
        store.save(map, &snapshot()).expect("saves");
    }
    // The manifest names the present format.
    for file in &FILES[1..] {
        let written = fs::read(directory.path().join(file)).expect("readable");
        let is_same = fs::read(golden().join(file)).ok().as_ref() == Some(&written);
        assert!(is_same, "{file} is not written as it was; what is written now is in {}", directory.keep().display());
    }
}

#[test]
fn format_2_is_read_as_it_always_was() {
    let directory = tempfile::tempdir().expect("temporary directory");
    copy(&golden(), directory.path());
    assert_eq!(content(directory.path()).iter().filter(|(_, content)| content.is_some()).count(), FILES.len());
    let store = Store::open(directory.path(), options()).expect("opens");
    assert_eq!(store.maps(), [(MapId(1), spec())]);
    let opened = store.open_map(MapId(1), &spec()).expect("opens");
    let expected = MapSnapshot { history: Vec::new(), ..snapshot() };
    assert_eq!((opened.source, opened.snapshot), (Source::Checkpoint, Some(expected)));
    let replayed: Vec<_> = opened.replay.map(|item| item.expect("readable")).collect();
    assert_eq!(replayed, (1..).zip(events()).collect::<Vec<_>>());
    let history = store.history(MapId(1)).expect("known");
    let days: Vec<_> = history.grid_days(0, i64::MAX, None).map(|day| day.expect("readable")).collect();
    assert_eq!(days, piece().days);
    for (id, samples) in piece().states {
        let mut samples = samples;
        samples.sort_by_key(|sample| sample.utc_nanos);
        assert_eq!(history.state(id, 0, i64::MAX).expect("readable"), samples);
    }
}
