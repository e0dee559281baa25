//! Which rhythms of cells are used: a week is learned in weeks, noise has no rhythm, and a cell is judged as a named
//! state.
//!
//! Each day is sent and learned as by the daemon. Invariant: all random values are drawn from seeds.

use tidemap_model::{
    EnabledModels, InstantPhasors, OrderWatch, Periodicities, Sample, StateModel, UpdateRules, selector::ModelSelector,
};

use crate::{
    index::{TileId, TileIndex},
    live::LiveGrid,
    scan::{CellRef, LoggedScan, ScanSource, Scans},
    tests::{HOUR, SECOND, apply, empty, learn, random},
    tile::CellModel,
    update::rules::UpdateLimits,
    view::GridView,
};

const DAY: i64 = 24 * HOUR;
const MINUTE: i64 = 60 * SECOND;
const TILE: usize = 512;

/// The reading of a cell at a time; called in order of time for each cell.
type Value<'a> = &'a mut dyn FnMut(usize, i64) -> bool;

/// A fixed sensor that sees some cells.
struct Camera {
    grid: LiveGrid,
    periodicities: Periodicities,
    cells: usize,
    shown: Vec<bool>,
    has_scans: bool,
    /// The readings of each cell on the last day.
    of_day: Vec<Vec<Sample>>,
}

impl Camera {
    fn new(cells: usize) -> Camera {
        Camera {
            grid: empty(),
            periodicities: Periodicities::default(),
            cells,
            shown: vec![false; cells],
            has_scans: false,
            of_day: vec![Vec::new(); cells],
        }
    }

    /// Sends the scans of a day and learns it.
    fn learn(&mut self, times: &[i64], value: Value<'_>) {
        let tiles = self.cells.div_ceil(TILE) as u32;
        let is_first = !std::mem::replace(&mut self.has_scans, true);
        let cell_ref = |cell: usize| CellRef::new(TileId((cell / TILE) as u32), (cell % TILE) as u16);
        let mut scans = Vec::new();
        self.of_day.iter_mut().for_each(Vec::clear);
        for (number, &utc_nanos) in times.iter().enumerate() {
            let mut occupied_flips = Vec::new();
            for cell in 0..self.cells {
                let is_occupied = value(cell, utc_nanos);
                if std::mem::replace(&mut self.shown[cell], is_occupied) != is_occupied {
                    occupied_flips.push(cell_ref(cell));
                }
                self.of_day[cell].push(Sample { utc_nanos, offset_secs: 0, value: f64::from(u8::from(is_occupied)) });
            }
            let is_new = is_first && number == 0;
            scans.push(LoggedScan {
                utc_nanos,
                offset_secs: 0,
                source: ScanSource::Cells,
                seen: Some((0..tiles).map(TileId).collect()),
                observed_flips: if is_new { (0..self.cells).map(cell_ref).collect() } else { Vec::new() },
                occupied_flips,
            });
        }
        let cut_nanos = times.last().map_or(0, |last| (last / DAY + 1) * DAY);
        let new_tiles = (0..tiles as i32).map(|x| TileIndex { x, y: 0, z: 0 });
        let new_tiles = if is_first { new_tiles.collect() } else { Vec::new() };
        apply(&mut self.grid, &Scans { new_tiles, scans, ..Scans::default() });
        learn(&mut self.grid, cut_nanos, &self.periodicities, UpdateLimits::default());
    }

    /// The models of the cells that have changed.
    fn models(&self) -> Vec<(usize, CellModel)> {
        let grid = &self.grid;
        let tiles = 0..self.cells.div_ceil(TILE);
        let model =
            |tile: usize| grid.generation.model(TileId(tile as u32)).expect("learned").get().expect("in memory");
        tiles
            .flat_map(|tile| {
                model(tile).cells.clone().into_iter().map(move |cell| (TILE * tile + usize::from(cell.cell), cell))
            })
            .collect()
    }

    fn watch(&self, cell: usize) -> OrderWatch {
        let grid = &self.grid;
        let model = grid.generation.model(TileId((cell / TILE) as u32)).expect("learned").get().expect("in memory");
        let at = model.cells.iter().position(|model| usize::from(model.cell) == cell % TILE).expect("changed");
        grid.sums[cell / TILE].get().expect("in memory").watches[at]
    }

    fn orders(&self) -> Vec<u8> {
        self.models().into_iter().map(|(_, model)| model.order).collect()
    }
}

fn every(step: i64, day: i64) -> Vec<i64> {
    (0..DAY / step).map(|number| day * DAY + number * step).collect()
}

/// A uniform number in [0, 1).
fn uniform(rng: &mut u64) -> f64 {
    random(rng, 1 << 30) as f64 / f64::from(1 << 30)
}

/// Monday to Friday; 1970-01-01 was a Thursday.
fn is_working_day(nanos: i64) -> bool {
    (nanos.div_euclid(DAY) + 3).rem_euclid(7) < 5
}

#[test]
fn a_week_is_learned_by_the_fourth() {
    // The cell is free on weekdays and occupied on weekends; the record begins on each day of the week.
    let half_hours: fn(&mut u64, i64) -> Vec<i64> = |_, day| every(30 * MINUTE, day);
    for (first, times) in (0..7).flat_map(|first| [(first, half_hours), (first, random_day)]) {
        let mut camera = Camera::new(2);
        let mut rng = 7;
        for day in first..first + 28 {
            camera.learn(&times(&mut rng, day), &mut |cell, nanos| (cell == 1) == is_working_day(nanos));
        }
        let supported = [0, 1].map(|cell| camera.watch(cell).supported_order());
        assert!(supported.iter().all(|&order| order >= 1), "from day {first}: {supported:?}");
        assert!(camera.orders().iter().all(|&order| order >= 1), "from day {first}: {:?}", camera.orders());
    }
}

#[test]
fn a_period_that_regular_scans_cannot_resolve_is_not_chosen() {
    let mut camera = Camera::new(1);
    for day in 0..56 {
        camera.learn(&every(12 * HOUR, day), &mut |_, nanos| is_working_day(nanos));
    }
    let (_, model) = camera.models().remove(0);
    let longest = model.spectral.components()[0].periodicity;
    assert_eq!(longest, 0, "{:?}", model.spectral.components());
    assert!(model.spectral.components().iter().all(|component| component.periodicity < 7));
}

/// Noise: whether each cell is occupied at a time, from the state of its random numbers and its value before.
type Noise = (&'static str, fn(&mut u64, i64) -> Vec<i64>, fn(&mut u64, &mut Chain, i64) -> bool);

/// A two-state chain.
#[derive(Clone, Copy, Default)]
struct Chain {
    is_high: bool,
    change: i64,
}

impl Chain {
    fn at(&mut self, rng: &mut u64, means: [i64; 2], nanos: i64) -> bool {
        while self.change <= nanos {
            self.is_high = !self.is_high;
            let mean = means[usize::from(self.is_high)] as f64;
            self.change += (-mean * (1.0 - uniform(rng)).ln()) as i64;
        }
        self.is_high
    }
}

const NOISES: [Noise; 6] = [
    ("white, every half hour", |_, day| every(30 * MINUTE, day), |rng, _, _| uniform(rng) < 0.3),
    ("white, at random times", random_day, |rng, _, _| uniform(rng) < 0.5),
    ("runs of 2 h", |_, day| every(30 * MINUTE, day), |rng, chain, nanos| chain.at(rng, [2 * HOUR; 2], nanos)),
    (
        "runs of 2 h and 20 min",
        |_, day| every(30 * MINUTE, day),
        |rng, chain, nanos| chain.at(rng, [2 * HOUR, 20 * MINUTE], nanos),
    ),
    ("runs of 12 h", |_, day| every(30 * MINUTE, day), |rng, chain, nanos| chain.at(rng, [12 * HOUR; 2], nanos)),
    ("runs of 2 h, at random times", random_day, |rng, chain, nanos| chain.at(rng, [2 * HOUR; 2], nanos)),
];

fn random_day(rng: &mut u64, day: i64) -> Vec<i64> {
    let mut times: Vec<i64> = (0..24).map(|_| day * DAY + random(rng, 1440) as i64 * MINUTE).collect();
    times.sort_unstable();
    times.dedup();
    times
}

/// For each kind of noise, the number of cells whose model uses a rhythm.
fn false_rhythms(cells: usize) -> Vec<(&'static str, usize)> {
    let found = NOISES.map(|(name, times, value)| {
        let mut camera = Camera::new(cells);
        let mut of_times = 5;
        let mut states: Vec<(u64, Chain)> = (0..cells as u64).map(|cell| (cell, Chain::default())).collect();
        for day in 0..42 {
            let times = times(&mut of_times, day);
            camera.learn(&times, &mut |cell, nanos| {
                let (rng, chain) = &mut states[cell];
                value(rng, chain, nanos)
            });
        }
        let found = camera.orders().iter().filter(|&&order| order >= 1).count();
        println!("{name}: a rhythm in {found} of {cells}");
        (name, found)
    });
    found.to_vec()
}

#[test]
fn noise_has_hardly_ever_a_rhythm() {
    let found = false_rhythms(60);
    let all: usize = found.iter().map(|(_, found)| found).sum();
    assert!(all <= 60 * NOISES.len() / 100, "{found:?}");
}

#[test]
#[ignore = "takes minutes"]
fn noise_has_a_rhythm_in_at_most_one_of_a_hundred_cells() {
    for (name, found) in false_rhythms(10_000) {
        assert!(found <= 100, "{name}: {found}");
    }
}

#[test]
fn a_cell_is_judged_as_a_named_state_with_its_readings() {
    let mut camera = Camera::new(12);
    let mut rng = 17;
    let mut chains = [Chain::default(); 12];
    let mut named = vec![StateModel::new(&camera.periodicities); 12];
    for day in 0..60 {
        let times = if day % 3 == 0 { random_day(&mut rng, day) } else { every(20 * MINUTE, day) };
        camera.learn(&times, &mut |cell, nanos| {
            let hour = nanos.rem_euclid(DAY) / HOUR;
            let noise = chains[cell].at(&mut rng, [(2 + cell as i64) * HOUR, HOUR], nanos);
            match cell % 4 {
                0 => noise,
                1 => (8..17).contains(&hour) && is_working_day(nanos) || uniform(&mut rng) < 0.05,
                2 => is_working_day(nanos) != (uniform(&mut rng) < 0.1),
                // The routine is new after 40 days.
                _ => (if day < 40 { 8..17 } else { 17..23 }).contains(&hour) != (uniform(&mut rng) < 0.02),
            }
        });
        let rules = UpdateRules { models: EnabledModels::SPECTRAL, ..UpdateRules::default() };
        for (state, samples) in named.iter_mut().zip(&camera.of_day) {
            state.update(&camera.periodicities, rules, samples.clone());
        }
        for (cell, model) in camera.models() {
            let (watch, state) = (camera.watch(cell), &named[cell]);
            let known = state.alternatives().expect("trained");
            let at = format!("day {day}, cell {cell}");
            assert_eq!(watch.supported_order(), known.supported_order(), "{at}");
            // Before that, the errors alone decide.
            if day >= 28 {
                assert_eq!(usize::from(model.order), state.order(), "{at}");
            }
            assert_eq!(model.alarm_day, known.alarm().alarm_day(), "{at}");
            let periods = |model: &tidemap_model::SpectralModel| -> Vec<u32> {
                model.components().iter().map(|component| component.periodicity).collect()
            };
            assert_eq!(periods(&model.spectral), periods(state.spectral()), "{at}");
        }
    }
    let rang: Vec<usize> =
        camera.models().iter().filter(|(_, model)| model.alarm_day.is_some()).map(|(cell, _)| *cell).collect();
    assert_eq!(rang, [3, 7, 11], "the cells with a new routine");
}

/// The default predictions of a cell, every half-hour of the day after some days.
fn next_day(camera: &mut Camera, day: i64, cell: usize) -> Vec<f64> {
    let view = GridView::new(&mut camera.grid);
    let at = |half_hour: i64| {
        let nanos = day * DAY + half_hour * 30 * MINUTE;
        let phasors = InstantPhasors::new(&camera.periodicities, nanos);
        let tile = view.predict_tile(TileId((cell / TILE) as u32), nanos, &phasors, ModelSelector::default());
        f64::from(tile.expect("in memory").probabilities[cell % TILE])
    };
    (0..48).map(at).collect()
}

#[test]
fn a_few_daily_scans_make_no_swings() {
    for days in [3, 5, 7, 21] {
        let mut camera = Camera::new(64);
        let mut rng = 7;
        for day in 0..days {
            camera.learn(&[day * DAY + 9 * HOUR], &mut |_, _| random(&mut rng, 2) == 1);
        }
        for cell in 0..64 {
            let answers = next_day(&mut camera, days, cell);
            let swing = answers.iter().copied().fold(0.0, f64::max) - answers.iter().copied().fold(1.0, f64::min);
            assert!(swing < 0.5, "{days} days, cell {cell}: {answers:?}");
        }
    }
}

#[test]
fn hours_without_scans_stay_unknown() {
    let mut camera = Camera::new(2);
    for day in 0..42 {
        let times = [8, 12, 16].map(|hour| day * DAY + hour * HOUR);
        camera.learn(&times, &mut |_, nanos| nanos % DAY / HOUR == 12);
    }
    let answers = next_day(&mut camera, 42, 1);
    for hour in [3, 4, 20, 21] {
        assert!((answers[2 * hour] - 1.0 / 3.0).abs() < 0.1, "{hour} h: {answers:?}");
    }
    assert!(answers[16] < 0.05 && answers[24] > 0.95 && answers[32] < 0.05, "{answers:?}");
    assert!(answers.iter().all(|p| (1e-6..1.0 - 1e-6).contains(p)), "{answers:?}");
}
