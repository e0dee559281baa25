//! Checks that predictions equal those of the grid, cell by cell.

use std::sync::{
    Arc,
    atomic::{AtomicU64, AtomicUsize, Ordering},
};

use tidemap_grid::{
    index::{CellBox, CellIndex, TileIndex},
    log_head::{LogHead, StreamScan, StreamTiles},
    scan::ScanSource,
    scan::Scans,
    spec::{GridSpec, Retention},
};
use tidemap_map::{
    event::{Envelope, Event, SequenceSpan, UpdateCause},
    ids::ProducerId,
    live_map::LiveMap,
    name::{MapName, ProducerKey},
    spec::MapSpec,
    view::MapView,
};
use tidemap_model::{
    EarlyStop, InstantPhasors, StopSignal, Zone,
    selector::{Blend, ModelKind, ModelSelector},
};

use super::*;

const HOUR: i64 = 3_600_000_000_000;

pub(crate) fn spec(is_flat: bool) -> GridSpec {
    GridSpec { is_flat, origin_m: [0.7, -0.3, 0.2], ..GridSpec::new(0.1) }
}

fn map_spec(grid: Option<GridSpec>) -> Arc<MapSpec> {
    Arc::new(MapSpec {
        zone: Zone::named("Europe/London").unwrap(),
        retention: Retention::None,
        grid,
        ..MapSpec::new(MapName::new("room").unwrap())
    })
}

fn apply(map: &mut LiveMap, event: &Event) -> Option<tidemap_map::update::UpdateWork> {
    map.apply(map.position() + 1, event).unwrap()
}

/// Two tiles, observed hourly for ten days. The first half of the first tile's cells is never observed. Some of the
/// other cells are occupied by day, some always.
fn learned(grid: GridSpec) -> MapView {
    let mut map = LiveMap::new(map_spec(Some(grid)));
    let mut front = LogHead::new(map.grid().unwrap());
    let mut source = StreamTiles::default();
    source.push(TileIndex { x: 0, y: 0, z: 0 });
    source.push(TileIndex { x: 2, y: 1, z: 0 });
    let envelope = Envelope {
        producer: ProducerId(0),
        new_producer: Some(ProducerKey::new("robot", "").unwrap().into()),
        incarnation: 1,
        span: SequenceSpan { first: 1, last: 240, content_crc: 0 },
        received_nanos: 300 * HOUR,
        refused: Vec::new(),
    };
    let mut scans = Scans::default();
    for hour in 0..240_i64 {
        let mut sent = StreamScan {
            utc_nanos: hour * HOUR,
            source: ScanSource::Cells,
            seen: Arc::from([0, 1]),
            observed_flips: Vec::new(),
            occupied_flips: Vec::new(),
        };
        if hour == 0 {
            sent.observed_flips = (256..1024).collect();
            sent.occupied_flips = (900..910).collect();
        }
        if [8, 17].contains(&(hour % 24)) {
            sent.occupied_flips.extend([300, 301, 700]);
        }
        let taken = front.take(map.grid().unwrap(), 1, &mut source, &sent, 0, 10).unwrap();
        scans.new_tiles.extend(taken.new_tiles);
        scans.scans.push(taken.scan);
    }
    apply(&mut map, &Event::Scans(envelope, scans));
    let start = map.plan_update(Some(240 * HOUR), 300 * HOUR, UpdateCause::Midnight);
    let work = apply(&mut map, &Event::UpdateStart(start)).unwrap();
    map.finish_update(work.run(&AtomicU64::new(0)).unwrap());
    map.publish()
}

fn times() -> Vec<i64> {
    (0..24).map(|hour| (240 + hour) * HOUR + 1).collect()
}

fn options(kind: ModelKind, blend: Blend) -> PredictOptions {
    PredictOptions { selector: ModelSelector { kind, order: Some(2), blend }, ..PredictOptions::default() }
}

#[test]
fn each_cell_is_as_in_the_grid_at_each_time() {
    let view = learned(spec(false));
    let grid = view.grid().unwrap();
    for kind in [ModelKind::Spectral, ModelKind::Mean, ModelKind::Latest] {
        for blend in [Blend::None, Blend::Persistence] {
            let options = options(kind, blend);
            let day = PredictedTimes::new(&view, &times(), &options, StopSignal::NEVER).unwrap();
            let differ = kind == ModelKind::Spectral || (blend == Blend::Persistence && kind != ModelKind::Latest);
            assert_eq!(day.varying(), if differ { 3 } else { 0 }, "{kind} {blend:?}");
            assert_eq!(day.lattice().size(), [24, 16, 8]);
            for (time, utc_nanos) in times().into_iter().enumerate() {
                let (alone, at) =
                    (PredictedGrid::new(&view, utc_nanos, &options, StopSignal::NEVER).unwrap(), day.at(time).unwrap());
                let civil = view.moments(&[utc_nanos])[0].civil_nanos();
                let phasors = InstantPhasors::new(&view.spec().periodicities, civil);
                let mut known = 0;
                for (index, id) in grid.tiles_in(&grid.bounds()) {
                    let tile = grid.predict_tile(id, utc_nanos, &phasors, options.selector).unwrap();
                    for place in 0..512 {
                        let of_grid = tile.known.contains(place).then(|| tile.probabilities[usize::from(place)]);
                        assert_eq!(alone.probability(index.cell(place)), of_grid);
                        assert_eq!(at.probability(index.cell(place)), of_grid);
                        known += usize::from(of_grid.is_some());
                    }
                }
                assert_eq!(known, 768);
                assert_eq!(alone.probabilities().iter().filter(|p| !p.is_nan()).count(), 768);
            }
            assert!(day.at(24).is_none());
        }
    }
}

#[test]
fn predictions_that_are_stopped_give_nothing() {
    let view = learned(spec(false));
    let calls = AtomicUsize::new(0);
    let predict = |after: usize| {
        calls.store(0, Ordering::Relaxed);
        let is_set = || calls.fetch_add(1, Ordering::Relaxed) >= after;
        let options = options(ModelKind::Spectral, Blend::None);
        PredictedTimes::new(&view, &times(), &options, StopSignal::new(&is_set)).map(|_| ())
    };
    assert_eq!(predict(usize::MAX), Ok(()));
    let questions = calls.load(Ordering::Relaxed);
    assert!(questions > 20, "{questions}");
    for after in [0, 1, questions / 2, questions - 1] {
        assert_eq!(predict(after), Err(PredictError::Stop(EarlyStop)), "{after} of {questions}");
        // At most one more prediction is made for each tile.
        assert!(calls.load(Ordering::Relaxed) <= after + 7, "{after} {calls:?}");
    }
}

#[test]
fn the_region_of_interest_is_the_extent_where_there_is_one() {
    let min = CellIndex { x: -8, y: 0, z: 0 };
    let extent = CellBox { min, max: CellIndex { x: 20, y: 10, z: 6 } };
    let view = learned(GridSpec { extent: Some(extent), ..spec(false) });
    let predict = |region| {
        PredictedGrid::new(&view, 0, &PredictOptions { region, ..PredictOptions::default() }, StopSignal::NEVER)
    };
    let grid = predict(None).unwrap();
    assert_eq!(grid.lattice().region(), extent);
    assert_eq!(grid.probability(min), None);
    let part = CellBox { min: CellIndex { x: 1, y: 1, z: 5 }, max: CellIndex { x: 3, y: 50, z: 50 } };
    let cut = predict(Some(part)).unwrap();
    assert_eq!(cut.lattice().size(), [2, 9, 1]);
    let cell = CellIndex { x: 2, y: 7, z: 5 };
    assert!(cut.probability(cell).is_some());
    assert_eq!(cut.probability(cell), grid.probability(cell));
    let beyond = CellBox { min: CellIndex { x: 30, ..min }, max: CellIndex { x: 40, y: 10, z: 6 } };
    assert_eq!(predict(Some(beyond)).unwrap_err(), PredictError::EmptyRegion);
}

#[test]
fn what_is_too_much_is_refused() {
    let view = learned(spec(false));
    let ask = |options: PredictOptions| {
        PredictedTimes::new(&view, &times(), &options, StopSignal::NEVER).map(|_| ()).unwrap_err()
    };
    let few = PredictOptions { max_cells: 1000, ..PredictOptions::default() };
    assert!(ask(few).to_string().contains("at most 1000"));
    let few = PredictOptions { max_values: 24, ..options(ModelKind::Spectral, Blend::None) };
    assert!(matches!(ask(few), PredictError::TooManyValues { times: 24, max: 24 }));
    let none = PredictedTimes::new(&view, &[], &PredictOptions::default(), StopSignal::NEVER);
    assert_eq!(none.map(|_| ()), Err(PredictError::NoTime));
    let empty = LiveMap::new(map_spec(Some(spec(false)))).publish();
    let answer = PredictedGrid::new(&empty, 0, &PredictOptions::default(), StopSignal::NEVER).map(|_| ());
    assert_eq!(answer, Err(PredictError::EmptyRegion));
    let answer =
        PredictedGrid::new(&LiveMap::new(map_spec(None)).publish(), 0, &PredictOptions::default(), StopSignal::NEVER);
    assert_eq!(answer.map(|_| ()), Err(PredictError::NoGrid));
}

#[test]
fn cells_and_places_lead_to_each_other() {
    for is_flat in [false, true] {
        let min = CellIndex { x: -3, y: 4, z: 0 };
        let region = CellBox { min, max: CellIndex { x: 2, y: 7, z: if is_flat { 1 } else { 3 } } };
        let lattice = Lattice::new(&spec(is_flat), region, 1000).unwrap();
        let places: Vec<usize> = lattice.rows().flatten().collect();
        assert_eq!(places.len() as u128, region.count());
        for place in 0..lattice.held() {
            let cell = lattice.cell(place);
            assert_eq!(cell.is_some(), places.contains(&place));
            if let Some(cell) = cell {
                assert_eq!(lattice.place(cell), Some(place));
                assert_eq!(lattice.cell_at(lattice.centre_m(cell)), Some(cell));
            }
        }
        assert_eq!(lattice.cell_at([f64::NAN, 0.0, 0.0]), None);
        let high = lattice.cell_at([0.55, 0.15, 1e9]);
        assert_eq!(high.is_some(), is_flat);
    }
}

#[test]
fn numbers_from_elsewhere_are_clipped() {
    let region = CellBox { min: CellIndex::default(), max: CellIndex { x: 4, y: 1, z: 1 } };
    let lattice = Arc::new(Lattice::new(&spec(true), region, 1000).unwrap());
    let numbers = [Some(f32::NAN), Some(7.0), Some(-1.0), None];
    let grid = PredictedGrid::from_fn(lattice, |cell| numbers[cell.x as usize]);
    let probabilities: Vec<_> = (0..4).map(|x| grid.probability(CellIndex { x, ..region.min })).collect();
    assert_eq!(probabilities, [None, Some(1.0), Some(0.0), None]);
}
