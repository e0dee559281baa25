//! Grids, scans and history as functions of a seed.

use std::sync::Arc;

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};
use tidemap_grid::{
    day::{GridDay, ScanTime},
    fade::GroupFade,
    index::{CellBox, TileId, TileIndex},
    live_tile::{Away, LiveTile},
    mask::{Mask, TileMasks},
    observation_runs::{CellRuns, DayRuns, ObservationRuns},
    observed_times::ObservedTimes,
    scan::{CellRef, LoggedScan, ScanSource, Scans},
    sensor_sums::{SensorSums, SensorWeights, WeightedSums},
    sensors::{ProducerSensor, SensorId, Weights},
    snapshot::{FutureScan, GridSnapshot},
    spec::{GridSpec, Retention, SensorNoise},
    tile::{CellModel, Group, ModelSlot, SumsSlot, TileModel, TileSums},
};
use tidemap_map::{
    event::{Envelope, Event, SequenceSpan},
    history::{
        HistoryDay, HistoryPiece, OutlierComponent, OutlierModel,
        origins::{OriginRun, Origins},
    },
    ids::{NewProducer, ProducerId, RefusalReason, StateId},
    name::ProducerKey,
    snapshot::MapSnapshot,
    spec::MapSpec,
};
use tidemap_model::{
    Component, DayScores, GapSample, HoursSeen, LocalDay, OrderErrors, OrderErrorsParts, OrderWatch, Periodicities,
    PhasorSum, Sample, SpectralModel,
};

use super::example;

pub(crate) const DAY_NANOS: i64 = 86_400_000_000_000;

/// A map with a grid and few periodicities.
pub(crate) fn spec(name: &str) -> MapSpec {
    MapSpec {
        periodicities: Periodicities::list(vec![7 * DAY_NANOS, DAY_NANOS, DAY_NANOS / 2]).expect("valid"),
        grid: Some(GridSpec {
            origin_m: [-1.5, 0.0, 0.25],
            sensor: SensorNoise { hit: 0.9, false_alarm: 0.05, prior: 0.3 },
            retention: Retention::Forever,
            ..GridSpec::new(0.1)
        }),
        ..example::spec(name)
    }
}

fn mask(random: &mut SmallRng) -> Mask {
    match random.random_range(0..4) {
        0 => Mask::EMPTY,
        1 => Mask::FULL,
        _ => Mask(std::array::from_fn(|_| random.random::<u64>() & random.random::<u64>())),
    }
}

pub(crate) fn masks(random: &mut SmallRng) -> TileMasks {
    TileMasks::clipped(mask(random), mask(random))
}

/// An event of scans; the numbers follow from `number`.
pub(crate) fn scans(number: u64, random: &mut SmallRng) -> Event {
    let tiles = random.random_range(1..30);
    let mut scans = Vec::new();
    for scan in 0..random.random_range(0..20_i64) {
        let cells = |random: &mut SmallRng| {
            let mut cells: Vec<CellRef> =
                (0..random.random_range(0..30)).map(|_| CellRef(random.random_range(0..tiles * 512))).collect();
            cells.sort_unstable();
            cells.dedup();
            cells
        };
        let seen: Arc<[TileId]> = (0..tiles).map(TileId).filter(|_| random.random_bool(0.8)).collect();
        scans.push(LoggedScan {
            utc_nanos: number as i64 * 1_000_000_000_000 + scan * 1_000_000_000 + random.random_range(0..3),
            offset_secs: if scan > 10 { 3600 } else { 7200 },
            source: ScanSource::Cells,
            seen: random.random_bool(0.3).then_some(seen),
            observed_flips: if random.random_bool(0.3) { cells(random) } else { Vec::new() },
            occupied_flips: if random.random_bool(0.7) { cells(random) } else { Vec::new() },
        });
    }
    Event::Scans(
        Envelope {
            producer: ProducerId(0),
            new_producer: random.random_bool(0.3).then(|| NewProducer {
                key: ProducerKey::new("robot", "lidar").expect("valid"),
                sensor: random
                    .random_bool(0.5)
                    .then(|| ProducerSensor { hit: random.random_range(0.5..1.0), false_alarm: 0.25 }),
                introduced_by: String::new(),
            }),
            incarnation: random.random(),
            span: SequenceSpan { first: number * 100, last: number * 100 + 60, content_crc: random.random() },
            received_nanos: random.random(),
            refused: vec![(number * 100 + 3, RefusalReason::Frame), (number * 100 + 5, RefusalReason::TileLimit)],
        },
        Scans {
            new_tiles: (0..random.random_range(0..5))
                .map(|_| TileIndex { x: random.random(), y: random.random_range(-3..3), z: 0 })
                .collect(),
            scans,
            shown: shown(random),
        },
    )
}

/// The cells that scans state as shown: sometimes none.
fn shown(random: &mut SmallRng) -> CellBox {
    let min: [i32; 3] = std::array::from_fn(|_| random.random_range(-4_000_000..4_000_000));
    let size = if random.random_bool(0.5) { 0 } else { 400 };
    CellBox { min: min.into(), max: min.map(|cell| cell + size).into() }.union(&CellBox::default())
}

/// The highest number of a sensor of a map: mostly 0, its own.
fn highest_sensor(random: &mut SmallRng) -> u8 {
    [0, 0, 3, 255][random.random_range(0..4)]
}

/// One of the sensors up to a number.
fn sensor(highest: u8, random: &mut SmallRng) -> SensorId {
    SensorId(if highest == 0 { 0 } else { random.random_range(0..=highest) })
}

pub(crate) fn live_tile(index: TileIndex, random: &mut SmallRng) -> LiveTile {
    let mut tile = LiveTile::new(index);
    let highest = highest_sensor(random);
    tile.sensor = sensor(highest, random);
    tile.arrival = masks(random);
    tile.current = mask(random);
    tile.newest_nanos = random.random_range(0..i64::MAX);
    tile.scans = random.random_range(0..1_000_000);
    for cell in mask(random).without(tile.current).cells() {
        let last_nanos = tile.newest_nanos.wrapping_sub(random.random_range(0..DAY_NANOS));
        tile.away.push(Away { cell, sensor: sensor(highest, random), last_nanos, pairs: random.random_range(0..1000) });
        tile.known.insert(cell);
    }
    tile.known |= tile.current;
    tile.occupied = tile.known & mask(random);
    for cell in (tile.current & mask(random)).cells().take(20) {
        tile.offsets.push((cell, random.random_range(-1000..1000)));
        tile.change_rates.push((cell, random.random_range(0.0..9.0)));
    }
    tile
}

pub(crate) fn sum(spec: &MapSpec, random: &mut SmallRng) -> PhasorSum {
    let parts: Vec<f64> = (0..2 * spec.periodicities.len()).map(|_| random.random_range(-1e6..1e6)).collect();
    PhasorSum::from_slice(&spec.periodicities, &parts).expect("finite")
}

/// The model and the sums of a tile; `shared` are the sums of groups that it may share.
pub(crate) fn learned(
    spec: &MapSpec,
    random: &mut SmallRng,
    shared: &[Arc<PhasorSum>],
    cells_max: usize,
) -> (TileModel, TileSums) {
    let (mut model, mut sums) = (TileModel::default(), TileSums::default());
    let mut left = Mask::FULL;
    for _ in 0..random.random_range(1..4) {
        let cells = left & mask(random);
        left = left.without(cells);
        model.groups.push(Group {
            cells,
            observations: random.random_range(1..1000),
            first_nanos: random.random(),
            last_nanos: random.random(),
            seen: HoursSeen::of_bins(&looks(random)),
        });
        sums.groups.push(match shared.get(random.random_range(0..shared.len() + 1)) {
            Some(shared) => Arc::clone(shared),
            None => Arc::new(sum(spec, random)),
        });
    }
    let observed = model.observed();
    model.always_occupied = observed & mask(random);
    for cell in observed.cells().filter(|cell| cell % 5 == 0).take(cells_max) {
        let components = (0..random.random_range(0..3)).map(|periodicity| Component {
            periodicity,
            gamma_re: random.random_range(-1.0..1.0),
            gamma_im: random.random_range(-1.0..1.0),
        });
        let components = components.collect();
        let errors = OrderErrorsParts {
            sums: std::array::from_fn(|_| random.random_range(0.0..9.0)),
            last_day: random.random_bool(0.5).then_some(LocalDay(19_000)),
        };
        model.cells.push(CellModel {
            cell,
            occupied: random.random(),
            spectral: SpectralModel::from_parts(random.random(), random.random(), components).expect("valid"),
            order: random.random_range(0..16),
            errors: OrderErrors::from_parts(errors).expect("valid"),
            alarm_day: random.random_bool(0.2).then_some(LocalDay(19_100)),
        });
        sums.cells.push(sum(spec, random));
    }
    sums.times = model.groups.iter().map(|_| Arc::new(times(random))).collect();
    sums.watches = model.cells.iter().map(|_| watch(random)).collect();
    if random.random_bool(0.5) {
        sums.runs = runs(random);
    }
    if random.random_bool(0.4) {
        let mut number = || random.random_range(-1e3..1e3);
        let groups = model.groups.iter().map(|_| Weights { alpha: number(), beta: number() }).collect();
        let occupied = model.cells.iter().map(|_| number()).collect();
        let mut fade = || GroupFade {
            weight: random.random_range(0.0..1e6),
            day: LocalDay(random.random_range(-9..20_000)),
            sum_day: LocalDay(random.random_range(-9..20_000)),
        };
        let fades: Vec<GroupFade> = model.groups.iter().map(|_| fade()).collect();
        let fades = if random.random() { fades } else { Vec::new() };
        model.sensors = Some(Box::new(SensorWeights { groups, occupied, fades }));
        let mut groups: Vec<Option<WeightedSums>> = Vec::new();
        for _ in &model.groups {
            let mut pick = || match shared.get(random.random_range(0..shared.len() + 1)) {
                Some(shared) => Arc::clone(shared),
                None => Arc::new(sum(spec, random)),
            };
            let weighted = WeightedSums { alpha: pick(), beta: pick() };
            groups.push(Some(weighted).filter(|_| random.random_bool(0.6)));
        }
        sums.sensors = Some(Box::new(SensorSums { groups }));
    }
    (model, sums)
}

fn times(random: &mut SmallRng) -> ObservedTimes {
    let mut gaps = GapSample::default();
    gaps.observe_many(random.random_range(0..40), |gap| gap * 1_500_000_000);
    let by_hour = looks(random).map(|hours| hours.map(|looks| looks as f32));
    ObservedTimes { gaps, hours: random.random_range(0.0..1e4), by_hour }
}

fn looks(random: &mut SmallRng) -> [[f64; 24]; 2] {
    [(); 2].map(|()| [(); 24].map(|()| random.random_range(0.0..40.0)))
}

fn watch(random: &mut SmallRng) -> OrderWatch {
    let squared = std::array::from_fn(|_| random.random_range(0.0..9.0));
    let scores = DayScores { errors: &squared, squared: &squared, scored: 20, order: 2, unit: 1.0 };
    let mut watch = OrderWatch::of_constant([None, Some(false), Some(true)][random.random_range(0..3)]);
    let mut errors = OrderErrors::default();
    for day in 0..random.random_range(0..3) {
        watch.score(LocalDay(19_000 + day), &spec("office").periodicities, &mut errors, scores);
    }
    watch.learn(7, random.random_range(0.0..1.0), None);
    watch
}

/// Observation times of cells on some days, by scans at equal and unequal distances.
fn runs(random: &mut SmallRng) -> ObservationRuns {
    let days = (0..random.random_range(1..4)).map(|_| {
        let mut now: i64 = random.random();
        let (scans, is_even) = (random.random_range(1..30_u32), random.random_bool(0.5));
        let mut next = || {
            now = now.wrapping_add(if is_even { 5_000_000_000 } else { random.random() });
            now
        };
        let civil_nanos = (0..scans).map(|_| next()).collect();
        let list = |cells: Mask| CellRuns {
            cells: cells.cells().collect(),
            toggles: (0..scans).filter(|_| random.random_bool(0.3)).collect(),
        };
        let some = mask(&mut SmallRng::seed_from_u64(u64::from(scans)));
        let others = Mask::FULL.without(some);
        let lists = [some, others].map(list).into();
        // A day with only the map's own sensor has none.
        let highest = highest_sensor(random);
        let ids = (0..scans).map(|scan| if scan == 0 { SensorId(highest) } else { sensor(highest, random) });
        let sensors = (highest > 0).then(|| Arc::new(ids.collect()));
        DayRuns { civil_nanos, sensors, lists }
    });
    ObservationRuns::from_days(days.collect()).expect("valid")
}

/// A day of scans of these tiles.
pub(crate) fn day(day: i32, tiles: u32, random: &mut SmallRng) -> GridDay {
    let mut kept = GridDay::new(LocalDay(day));
    let mut seen: Arc<[TileId]> = Arc::default();
    let highest = highest_sensor(random);
    for scan in 0..random.random_range(1..60_i64) {
        if scan == 0 || random.random_bool(0.2) {
            seen = (0..tiles).map(TileId).filter(|_| random.random_bool(0.6)).collect();
        }
        let utc_nanos = i64::from(day) * DAY_NANOS + scan * 1_000_000_000;
        let (offset_secs, sensor) = (if scan < 30 { 0 } else { 3600 }, sensor(highest, random));
        let number = kept.push(ScanTime { utc_nanos, offset_secs, source: ScanSource::Cells, sensor }, &seen);
        for &tile in seen.iter() {
            if kept.tile(tile).is_none() || random.random_bool(0.3) {
                let shown = match kept.tile(tile) {
                    Some(known) if random.random_bool(0.8) => {
                        let mut occupied = known.last.occupied();
                        (0..5).for_each(|_| occupied.flip(random.random_range(0..512)));
                        TileMasks::clipped(known.last.observed(), occupied)
                    }
                    _ => masks(random),
                };
                kept.show(number, tile, shown);
            }
        }
    }
    kept
}

/// A grid of `tiles` tiles; the last one is untrained.
pub(crate) fn grid(spec: &MapSpec, tiles: u32, random: &mut SmallRng) -> GridSnapshot {
    let shared: Vec<Arc<PhasorSum>> = (0..3).map(|_| Arc::new(sum(spec, random))).collect();
    let mut grid = GridSnapshot {
        tiles: Vec::new(),
        models: Vec::new(),
        sums: Vec::new(),
        last_seen: (0..tiles).map(TileId).filter(|_| random.random_bool(0.5)).collect(),
        days: Vec::new(),
        future: Vec::new(),
        scans: random.random(),
        cell_observations: random.random(),
        shown: shown(random),
        received_nanos: random.random::<bool>().then(|| random.random()),
    };
    for id in 0..tiles {
        let index = TileIndex { x: id as i32 - 2, y: -(id as i32), z: 0 };
        grid.tiles.push(Arc::new(live_tile(index, random)));
        if id + 1 < tiles {
            let is_empty = id == 1;
            let (model, sums) = if is_empty { Default::default() } else { learned(spec, random, &shared, 30) };
            grid.models.push(ModelSlot::Resident(Arc::new(model)));
            grid.sums.push(SumsSlot::Resident(Arc::new(sums)));
        }
    }
    for number in 0..random.random_range(0..3) {
        grid.days.push(day(19_000 + number, tiles, random));
    }
    for _ in 0..random.random_range(0..3) {
        let highest = highest_sensor(random);
        let (utc_nanos, sensor) = (random.random_range(0..i64::MAX), sensor(highest, random));
        let time = ScanTime { utc_nanos, offset_secs: -3600, source: ScanSource::Cells, sensor };
        let shown = (0..tiles).map(|tile| (TileId(tile), masks(random))).collect();
        grid.future.push(FutureScan { time, tiles: shown });
    }
    grid
}

/// A snapshot of a map with a grid, as a function of its position.
pub(crate) fn snapshot(spec: &MapSpec, position: u64, tiles: u32) -> MapSnapshot {
    let mut random = SmallRng::seed_from_u64(position ^ 0x9_81D);
    MapSnapshot { grid: Some(grid(spec, tiles, &mut random)), ..example::snapshot(spec, position, 2) }
}

/// Two producers that took turns, with a gap in the numbers; some of the observations had waited.
fn origins(first: u64, count: usize) -> Origins {
    let mut random = SmallRng::seed_from_u64(first);
    let (mut left, mut number, mut runs) = (u32::try_from(count).expect("few"), first * 1000, Vec::new());
    while left > 0 {
        let count = random.random_range(1..=left);
        runs.push(OriginRun { producer: ProducerId(runs.len() as u32 % 2), first: number, count });
        (left, number) = (left - count, number + u64::from(count) + random.random_range(0..3));
    }
    let ahead = random.random_range(0..=u32::try_from(count).expect("few"));
    let (arrived, is_early) = (u64::from(ahead) * number, random.random());
    Origins { runs, ahead, arrived, is_early, is_crowded: !is_early }
}

/// The observations that a generation has learned: of the states and of the grid on one day.
pub(crate) fn piece(generation: u64, day_number: i32, random: &mut SmallRng) -> HistoryPiece {
    let mut piece = HistoryPiece::new(generation);
    let start = i64::from(day_number) * DAY_NANOS;
    for id in [0, 3, 4] {
        let samples = (0..random.random_range(1..50)).map(|_| Sample {
            utc_nanos: start + random.random_range(0..DAY_NANOS),
            offset_secs: 3600,
            value: f64::from(random.random_range(0..2_u8)),
        });
        piece.states.push((StateId(id), samples.collect()));
    }
    piece.origins =
        piece.states.iter().map(|(id, samples)| origins(generation + u64::from(id.0), samples.len())).collect();
    let outliers = day(day_number, 5, random);
    let modelled: Vec<u32> = (0..5).filter(|_| random.random_bool(0.5)).collect();
    let models = modelled.into_iter().map(|tile| {
        let model = |cell| OutlierModel {
            cell,
            mean: random.random(),
            components: vec![OutlierComponent { periodicity: 7, gamma_re: 0.25, gamma_im: random.random() }],
        };
        (TileId(tile), [3, 300].map(model).to_vec())
    });
    let models = models.collect();
    piece.days.push(HistoryDay { outliers, models });
    let samples = piece.states.iter().flat_map(|(_, samples)| samples).map(|sample| sample.utc_nanos);
    let times = samples.chain(piece.days[0].outliers.scans.iter().map(|scan| scan.utc_nanos));
    (piece.from_nanos, piece.to_nanos) =
        times.fold((i64::MAX, i64::MIN), |(from, to), nanos| (from.min(nanos), to.max(nanos)));
    piece
}
