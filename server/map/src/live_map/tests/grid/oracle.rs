//! The naive data of each cell: every single observation, and a model of a single state per cell.
//!
//! Invariant: the oracle has no runs, groups or shared sums.

use std::collections::{BTreeMap, HashMap, HashSet};

use tidemap_grid::{
    index::{CellIndex, TileIndex},
    tile::CellModel,
    view::CellDescription,
};
use tidemap_model::{
    AccumulatorParts, EnabledModels, HoursSeen, LocalDay, MemoryBasis, ORDER_MAX, OrderCriterion, OrderErrors,
    Periodicities, Persistence, Sample, SpectralModel, StateModel, UpdateRules, kind_and_hour,
    selector::{Blend, ModelKind, ModelSelector},
};

/// A reading: the value that it counts as, and the value that was read.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Read {
    pub(crate) sample: Sample,
    pub(crate) is_occupied: bool,
}

/// One cell.
#[derive(Clone, Debug)]
pub(crate) struct CellOracle {
    pending: Vec<Read>,
    future: Vec<Read>,
    taken: Vec<Read>,
    pub(crate) folded: Vec<Read>,
    pub(crate) model: StateModel,
    pub(crate) persistence: Persistence,
    /// Whether two components were equally strong, so that another choice is as good, or readings were scored in one
    /// scan block, which a state scores one by one.
    tied: bool,
    /// The single local hours with a reading that an update has learned: the day, its kind, and the hour.
    hours: Vec<(LocalDay, usize, usize)>,
    half_life_days: Option<f64>,
}

/// The values γ of all periodicities.
pub(crate) fn gammas(parts: &AccumulatorParts) -> Vec<(f64, f64)> {
    let n = if parts.observations == 0 { 1.0 } else { parts.weight };
    let mean = parts.sum / n;
    parts.spectrum.iter().map(|[a, b, c, d]| ((a - mean * c) / n, (b - mean * d) / n)).collect()
}

impl CellOracle {
    fn new(periodicities: &Periodicities) -> CellOracle {
        CellOracle {
            pending: Vec::new(),
            future: Vec::new(),
            taken: Vec::new(),
            folded: Vec::new(),
            model: StateModel::new(periodicities),
            persistence: Persistence::default(),
            tied: false,
            hours: Vec::new(),
            half_life_days: None,
        }
    }

    fn take_before(&mut self, cut_nanos: i64) {
        let is_due = |read: &mut Read| read.sample.utc_nanos < cut_nanos;
        let mut due: Vec<Read> = self.future.extract_if(.., is_due).collect();
        self.pending.extend(&due);
        due.sort_by_key(|read| read.sample.utc_nanos);
        for Read { sample, .. } in due {
            self.persistence.observe(sample.utc_nanos, sample.value);
        }
        self.taken = self.pending.extract_if(.., is_due).collect();
    }

    fn learn(&mut self, looks: &Looks, (criterion, half_life_days): (OrderCriterion, Option<f64>)) {
        let periodicities = &looks.periodicities;
        self.half_life_days = half_life_days;
        let mut taken = std::mem::take(&mut self.taken);
        taken.sort_by_key(|read| read.sample.utc_nanos);
        // Readings are learned day by day, so that ties of each day's model are found.
        for of_day in taken.chunk_by(|one, next| one.sample.local_day() == next.sample.local_day()) {
            let is_shared = of_day.iter().any(|read| looks.has_others(read.sample.civil_nanos()));
            self.tied |= is_shared || self.has_tie(periodicities);
            let rules = UpdateRules { models: EnabledModels::SPECTRAL, ..UpdateRules::from(criterion) };
            self.model.update(periodicities, rules, of_day.iter().map(|read| read.sample).collect());
            self.folded.extend(of_day);
            let hour = |read: &Read| read.sample.civil_nanos().div_euclid(3_600_000_000_000);
            for of_hour in of_day.chunk_by(|one, next| hour(one) == hour(next)) {
                let (kind, hour) = kind_and_hour(of_hour[0].sample.civil_nanos());
                self.hours.push((of_hour[0].sample.local_day(), kind, hour));
            }
            if let Some(half_life_days) = half_life_days {
                self.fade(periodicities, half_life_days);
            }
            if !self.has_changed() {
                self.be_constant(periodicities);
            }
        }
    }

    /// The sums over every single reading, each with its weight by its age.
    fn fade(&mut self, periodicities: &Periodicities, half_life_days: f64) {
        let samples = || self.folded.iter().map(|read| read.sample);
        let newest = samples().map(|sample| sample.local_day().0).max().unwrap_or(0);
        let mut parts = AccumulatorParts {
            observations: self.folded.len() as u64,
            first_nanos: samples().map(|sample| sample.utc_nanos).min().unwrap_or(0),
            last_nanos: samples().map(|sample| sample.utc_nanos).max().unwrap_or(0),
            spectrum: vec![[0.0; 4]; periodicities.len()],
            ..AccumulatorParts::default()
        };
        for sample in samples() {
            let weight = 0.5_f64.powf(f64::from(newest - sample.local_day().0) / half_life_days);
            parts.weight += weight;
            parts.sum += weight * sample.value;
            parts.sum_squares += weight * sample.value.powi(2);
            for (k, sums) in parts.spectrum.iter_mut().enumerate() {
                let cycles = sample.civil_nanos() as f64 / 1e9 / periodicities.period_secs(k);
                let (sin, cos) = (std::f64::consts::TAU * cycles.fract()).sin_cos();
                let added = [sample.value * cos, -sample.value * sin, cos, -sin];
                sums.iter_mut().zip(added).for_each(|(sum, added)| *sum += weight * added);
            }
        }
        parts.weight = parts.weight.min(parts.observations as f64);
        let accumulator = tidemap_model::Accumulator::from_parts(periodicities, parts).expect("valid");
        let gaps = self.model.alternatives().map(|known| known.gaps().clone()).unwrap_or_default();
        let spectral = SpectralModel::train_with_gaps(&accumulator, periodicities, &gaps);
        let (order, errors) = (self.model.best_order(), *self.model.errors());
        self.replace(StateModel::from_parts(accumulator, spectral, order, errors).expect("valid"));
    }

    /// Takes other sums and components; the data about the times of readings stays.
    fn replace(&mut self, model: StateModel) {
        let known = self.model.alternatives().cloned();
        self.model = known.into_iter().fold(model, StateModel::with_alternatives);
    }

    /// Makes the cell a constant: a cell that never changed has the mean of its readings and nothing to be scored,
    /// whatever its readings count as.
    fn be_constant(&mut self, periodicities: &Periodicities) {
        let parts = self.model.accumulator().to_summed_parts(periodicities);
        let mean = parts.sum / parts.weight;
        let spectral = SpectralModel::from_parts(mean, parts.observations, Vec::new()).expect("valid");
        let accumulator = tidemap_model::Accumulator::from_parts(periodicities, parts).expect("its own");
        self.replace(StateModel::from_parts(accumulator, spectral, 0, OrderErrors::default()).expect("valid"));
        self.tied = false;
    }

    /// Whether another component could equally well have been chosen.
    fn has_tie(&self, periodicities: &Periodicities) -> bool {
        let kept = self.model.spectral().components();
        let mut all: Vec<f64> = gammas(&self.model.accumulator().to_summed_parts(periodicities))
            .iter()
            .map(|(re, im)| re.hypot(*im))
            .collect();
        all.sort_by(|a, b| b.total_cmp(a));
        let weakest = kept.last().map_or(0.0, |component| component.amplitude() / 2.0);
        // Components that are not eligible may tie without harm: this check is too careful, and rarely so.
        all.windows(2).any(|pair| pair[0] >= weakest && pair[0] > 1e-9 && pair[0] - pair[1] < 1e-9)
    }

    /// Whether the cell was ever read as both free and occupied.
    pub(crate) fn has_changed(&self) -> bool {
        self.folded.windows(2).any(|pair| pair[0].is_occupied != pair[1].is_occupied)
    }

    pub(crate) fn probability(
        &self,
        selector: ModelSelector,
        civil_nanos: i64,
        utc_nanos: i64,
        omega: &Periodicities,
    ) -> f64 {
        let spectral = self.model.spectral();
        let is_default = selector.kind == ModelKind::Auto && selector.order.is_none() && self.has_changed();
        let p = match selector.kind {
            ModelKind::Latest => self.persistence.last().map_or(0.5, |(_, value)| value),
            ModelKind::Mean => spectral.mean(),
            _ => spectral.predict(omega, selector.order.unwrap_or(self.model.best_order()), civil_nanos),
        };
        let p = if is_default { self.hours_seen().at(civil_nanos).temper(spectral.mean(), p) } else { p };
        match selector.blend {
            // A cell has no belief.
            Blend::Persistence => self.persistence.blend(p, utc_nanos),
            Blend::Memory => {
                let basis =
                    MemoryBasis { usual_change: 1.0, mean: spectral.mean(), first_nanos: None, most_likely_secs: None };
                self.persistence.remember(basis, p, utc_nanos)
            }
            Blend::None => p,
        }
    }

    /// How well each hour is known.
    fn hours_seen(&self) -> HoursSeen {
        let newest = self.hours.iter().map(|(day, ..)| day.0).max().unwrap_or(0);
        let mut looks = [[0.0; 24]; 2];
        for &(day, kind, hour) in &self.hours {
            looks[kind][hour] += self.half_life_days.map_or(1.0, |days| 0.5_f64.powf(f64::from(newest - day.0) / days));
        }
        HoursSeen::of_bins(&looks)
    }

    /// Compares the view's description of the cell.
    pub(crate) fn compare(&self, found: &CellDescription, at: &str) {
        let (ours, theirs) = (self.persistence.to_parts(), found.persistence.to_parts());
        assert_eq!((ours.pairs, ours.last), (theirs.pairs, theirs.last), "{at}: persistence");
        near(ours.change_rate_sum, theirs.change_rate_sum, 1e-9 * (1.0 + ours.change_rate_sum), at, "change rates");
        assert_eq!(found.observations, ours.pairs + 1, "{at}: observations");
        assert_eq!(found.folded, self.folded.len() as u64, "{at}: folded");
        assert_eq!(found.first_nanos, self.folded.iter().map(|read| read.sample.utc_nanos).min(), "{at}: first");
        near(found.spectral.mean(), self.model.spectral().mean(), 1e-9, at, "mean");
        assert_eq!(found.spectral.observations(), self.folded.len() as u64, "{at}: observations of the model");
        assert_eq!(found.changed, self.has_changed(), "{at}: changed");
        assert_eq!(found.errors.is_some(), found.changed, "{at}: errors");
    }

    /// Compares a changed cell's components, orders and errors. A choice of the map that is as good as the oracle's
    /// choice becomes the oracle's choice.
    pub(crate) fn compare_model(&mut self, found: &CellModel, periodicities: &Periodicities, at: &str) {
        let parts = self.model.accumulator().to_summed_parts(periodicities);
        let gammas = gammas(&parts);
        let kept = found.spectral.components();
        for component in kept {
            let (re, im) = gammas[component.periodicity as usize];
            near(component.gamma_re, re, 1e-9, at, "real part of γ");
            near(component.gamma_im, im, 1e-9, at, "imaginary part of γ");
        }
        let weakest = if kept.len() < ORDER_MAX { 0.0 } else { kept.last().map_or(0.0, |c| c.amplitude() / 2.0) };
        for component in self.model.spectral().components() {
            let missing = kept.iter().all(|other| other.periodicity != component.periodicity);
            assert!(!missing || component.amplitude() / 2.0 <= weakest + 1e-9, "{at}: {component:?} is missing");
        }
        assert!(kept.is_sorted_by(|one, next| one.amplitude() >= next.amplitude() - 1e-9), "{at}: not in order");
        let (ours, theirs) = (self.model.errors().sums(), found.errors.sums());
        if self.tied {
            near(ours[0], theirs[0], 1e-9 * (1.0 + ours[0]), at, "error of order 0");
        } else {
            for order in 0..=ORDER_MAX {
                let (a, b) = (ours[order], theirs[order]);
                assert!((a - b).abs() < 1e-8 * (1.0 + a), "{at}: error of order {order} is {a}, or {b}");
            }
            let lowest = ours.iter().copied().fold(f64::INFINITY, f64::min);
            let (a, b) = (found.errors.best(), self.model.errors().best());
            let is_tie = |order: usize| (ours[order] - lowest * 1.001).abs() < 1e-7;
            assert!(a == b || is_tie(a.min(b)) || lowest < 1e-7, "{at}: best order {a}, expected {b} by {ours:?}");
            // The supported components are compared for single cells, whose readings count as 0 and 1.
            assert!(usize::from(found.order) <= a, "{at}: order {} of {a}", found.order);
        }
        let spectral = SpectralModel::from_parts(parts.sum / parts.weight, parts.observations, kept.to_vec());
        let accumulator = tidemap_model::Accumulator::from_parts(periodicities, parts).expect("its own");
        let order = usize::from(found.order);
        let model = StateModel::from_parts(accumulator, spectral.expect("valid"), order, found.errors);
        self.replace(model.expect("a valid order"));
        self.tied = false;
    }
}

pub(crate) fn near(a: f64, b: f64, tolerance: f64, at: &str, what: &str) {
    assert!((a - b).abs() <= tolerance, "{at}: {what} is {a}, or {b}");
}

/// The times of all scans, by scan block.
#[derive(Clone, Debug)]
struct Looks {
    periodicities: Periodicities,
    civil_nanos: HashMap<i64, HashSet<i64>>,
}

impl Looks {
    fn look(&self, civil_nanos: i64) -> i64 {
        civil_nanos.div_euclid(self.periodicities.look_nanos())
    }

    /// Whether the scan block of a scan has scans of other times.
    fn has_others(&self, civil_nanos: i64) -> bool {
        self.civil_nanos.get(&self.look(civil_nanos)).is_some_and(|times| times.len() > 1)
    }
}

/// All cells.
#[derive(Clone, Debug)]
pub(crate) struct Oracle {
    looks: Looks,
    criterion: OrderCriterion,
    half_life_days: Option<f64>,
    pub(crate) cells: BTreeMap<(TileIndex, u16), CellOracle>,
    pub(crate) cell_observations: u64,
}

impl Oracle {
    pub(crate) fn new(periodicities: &Periodicities, criterion: OrderCriterion, half_life_days: Option<f64>) -> Oracle {
        let looks = Looks { periodicities: periodicities.clone(), civil_nanos: HashMap::new() };
        Oracle { looks, criterion, half_life_days, cells: BTreeMap::new(), cell_observations: 0 }
    }

    /// Records that a scan was made, whatever it showed.
    pub(crate) fn scan(&mut self, civil_nanos: i64) {
        self.looks.civil_nanos.entry(self.looks.look(civil_nanos)).or_default().insert(civil_nanos);
    }

    pub(crate) fn observe(&mut self, tile: TileIndex, cell: u16, read: Read, is_ahead: bool) {
        self.cell_observations += 1;
        let periodicities = &self.looks.periodicities;
        let cell = self.cells.entry((tile, cell)).or_insert_with(|| CellOracle::new(periodicities));
        if is_ahead {
            cell.future.push(read);
        } else {
            cell.persistence.observe(read.sample.utc_nanos, read.sample.value);
            cell.pending.push(read);
        }
    }

    pub(crate) fn start_update(&mut self, cut_nanos: i64) {
        self.cells.values_mut().for_each(|cell| cell.take_before(cut_nanos));
    }

    pub(crate) fn finish_update(&mut self) {
        let learn = |cell: &mut CellOracle| cell.learn(&self.looks, (self.criterion, self.half_life_days));
        self.cells.values_mut().for_each(learn);
    }

    /// A cell of which an observation has counted.
    pub(crate) fn known(&self, cell: CellIndex) -> Option<&CellOracle> {
        let (tile, place) = cell.tile();
        self.cells.get(&(tile, place)).filter(|cell| cell.persistence.last().is_some())
    }
}
