//! One tile on one day of an update: scores its changed cells and continues their sums.
//!
//! Invariant: scores use the models from before the day; sums and models change at its end.

use tidemap_model::special::square;
use tidemap_model::{
    CellSums, DayScores, LearnedReadings, LocalDay, ORDER_MAX, OrderCriterion, OrderErrors, OrderWatch, PhasorSum,
    ScoreSums, SpectralModel,
};

use super::{
    super::{
        day::DayTile,
        fade::{DayFactors, GroupFade},
        fold::{Chunk, Cursor, fold_toggles, run_length},
        index::{TILE_CELLS, TileId},
        mask::Mask,
        observation_runs::ObservationRuns,
        observed_times::ObservedTimes,
        outcome::TileOutcome,
        sensor_sums::{GroupSums, SensorWeights},
        sensors::Weights,
        tile::{CellModel, Group, TileData, TileModel, TileSums},
    },
    looks::{GroupScoring, LookChunk, Scratch},
    observed::{DayToggles, SplitGroup, part_by_spectrum, split_groups},
    rules::Rules,
    shared_sums::{Gains, Times},
};

/// From a record of this length on, the components of a cell must be supported. A shorter record can hardly support a
/// rhythm yet, and a cell, unlike a named state, has no histogram that predicts meanwhile: the errors on new days alone
/// decide (T-RO section IV.B). In the simulated office that halves the error after two weeks.
const SUPPORT_NANOS: u64 = 27 * 86_400_000_000_000;

/// Each additional component needs this many more observed hours: with few observations, noise fits any of them.
const HOURS_PER_COMPONENT: f64 = 8.0;
/// With fewer observed hours than this, only the mean is used.
const HOURS_OF_MEAN: f64 = 8.0;

/// A tile that an update changes.
#[derive(Debug)]
pub(super) struct BusyTile {
    pub(super) id: TileId,
    pub(super) data: TileData,
    /// The outcome for the tile since the update began.
    pub(super) outcome: TileOutcome,
}

/// A cell that has a spectrum, with its data of the day.
#[derive(Debug, Default)]
struct CellDay {
    /// Toggles of the occupied bit.
    toggles: Vec<u32>,
    /// The position up to which the toggles are added to the sums.
    cursor: Cursor,
    /// The position up to which the toggles are scored.
    scored_to: Cursor,
    /// The split group.
    group: usize,
    /// Number of readings of the day that are newer than all before; 0 without earlier readings.
    scored: u64,
    scores: ScoreSums,
    /// Σβ over the occupied readings of the day, each with its weight.
    occupied_weight: f64,
    /// The sum over the occupied readings of a day that came late, and the weight of each reading.
    late: Option<(PhasorSum, f64)>,
}

/// A group with its data of the day.
#[derive(Debug)]
struct GroupDay {
    scoring: GroupScoring,
    /// The factors that the day applies to the weights of the group's readings.
    factors: DayFactors,
}

/// One tile on one day.
#[derive(Debug)]
pub(super) struct TileDay {
    day: LocalDay,
    tile: BusyTile,
    observed: Vec<(Vec<u32>, Mask)>,
    split: Vec<SplitGroup>,
    groups: Vec<GroupDay>,
    cells: Vec<CellDay>,
    /// The indices of the cells that are scored, by group.
    by_group: Vec<u16>,
    /// Number of scans that saw the tile.
    scans: usize,
}

impl TileDay {
    pub(super) fn new(
        mut tile: BusyTile,
        (day, of_day): (LocalDay, &DayTile),
        ranges: &[(u32, u32)],
        times: &Times,
        rules: &Rules,
    ) -> TileDay {
        let toggles = DayToggles::new(of_day, ranges);
        let working = &mut tile.data;
        if times.weighted.is_some() || rules.half_life.is_some() {
            working.model.keep_weights(rules.half_life.is_some());
        }
        let split = split_groups_of(working, &toggles, rules);
        begin_spectra(working, &toggles, rules);
        let mut groups: Vec<GroupDay> = Vec::with_capacity(split.len());
        for group in &split {
            let last_nanos = group.before.and_then(|before| working.model.groups.get(before)).map(|g| g.last_nanos);
            let toggles = group.toggles.and_then(|index| toggles.observed.get(index)).map(|(toggles, _)| toggles);
            let newer_than = last_nanos.filter(|_| toggles.is_some());
            let all_newer = newer_than.is_some_and(|last| times.all.first_nanos > last);
            let all = all_newer && toggles.is_some_and(|toggles| toggles.as_slice() == [0]);
            let factors = toggles.map_or(DayFactors::EQUAL, |_| factors_of(&working.model, group, day, rules));
            groups.push(GroupDay { scoring: GroupScoring { newer_than, all, cursor: Cursor::default() }, factors });
        }
        let mut group_of = [usize::MAX; TILE_CELLS];
        for (index, group) in split.iter().enumerate() {
            for cell in group.cells.cells() {
                group_of[usize::from(cell)] = index;
            }
        }
        let mut occupied = toggles.occupied.into_iter().peekable();
        let mut cells = Vec::with_capacity(working.model.cells.len());
        for (index, model) in working.model.cells.iter().enumerate() {
            while occupied.next_if(|(cell, _)| *cell < model.cell).is_some() {}
            let toggles = occupied.next_if(|(cell, _)| *cell == model.cell).map_or(Vec::new(), |(_, toggles)| toggles);
            let group = group_of.get(usize::from(model.cell)).copied().unwrap_or(usize::MAX);
            let mut occupied_weight = working.model.sensors.as_ref().map_or(0.0, |_| times.weigh(&toggles).beta);
            let factors = groups.get(group).map_or(DayFactors::EQUAL, |group| group.factors);
            let mut late = None;
            if factors != DayFactors::EQUAL {
                if let Some(sum) = working.sums.cells.get_mut(index) {
                    sum.scale(factors.known);
                }
                if let Some(known) = working.model.sensors.as_mut().and_then(|sensors| sensors.occupied.get_mut(index))
                {
                    *known *= factors.known;
                }
                occupied_weight *= factors.of_day;
                late = (factors.of_day != 1.0).then(|| (PhasorSum::zero(&rules.periodicities), factors.of_day));
            }
            cells.push(CellDay { toggles, group, occupied_weight, late, ..CellDay::default() });
        }
        let group_of = |&index: &u16| cells.get(usize::from(index)).map_or(usize::MAX, |cell: &CellDay| cell.group);
        let is_scored =
            |index: &u16| groups.get(group_of(index)).is_some_and(|group| group.scoring.newer_than.is_some());
        let mut by_group: Vec<u16> = (0..).take(cells.len()).filter(is_scored).collect();
        by_group.sort_by_key(group_of);
        TileDay { day, tile, observed: toggles.observed, split, groups, cells, by_group, scans: times.utc_nanos.len() }
    }

    /// The toggles of the cells whose sums must be complete; may contain duplicates.
    pub(super) fn toggles(&self) -> impl Iterator<Item = &Vec<u32>> {
        let summed = self.split.iter().filter(|group| group.is_summed);
        summed.filter_map(|group| self.observed.get(group.toggles?)).map(|(toggles, _)| toggles)
    }

    /// Whether any cell is scored.
    pub(super) fn is_scored(&self) -> bool {
        !self.by_group.is_empty()
    }

    /// Scores some scan blocks by the models from before the day.
    pub(super) fn score(&mut self, chunk: &LookChunk<'_>, rules: &Rules) {
        let TileDay { tile, observed, split, groups, cells, by_group, .. } = self;
        let with_wrong = rules.criterion == OrderCriterion::ZeroOne;
        let mut scratch = Scratch::default();
        let group_of = |index: u16| cells.get(usize::from(index)).map_or(usize::MAX, |cell| cell.group);
        let same_groups: Vec<&[u16]> = by_group.chunk_by(|&one, &next| group_of(one) == group_of(next)).collect();
        for same in same_groups {
            let index =
                same.first().and_then(|&index| cells.get(usize::from(index))).map_or(usize::MAX, |cell| cell.group);
            let Some(group) = groups.get_mut(index) else { continue };
            let toggles = split.get(index).and_then(|split| observed.get(split.toggles?));
            let toggles = toggles.map_or(&[][..], |(toggles, _)| toggles.as_slice());
            let mut readings = group.scoring.readings(toggles, chunk, &mut scratch);
            for &index in same {
                let index = usize::from(index);
                let (Some(day), Some(model)) = (cells.get_mut(index), tile.data.model.cells.get(index)) else {
                    continue;
                };
                let Some(readings) = &mut readings else {
                    day.scored_to.skip(&day.toggles, chunk);
                    continue;
                };
                let of_cell = readings.of_cell(&day.toggles, &mut day.scored_to);
                model.spectral.score_readings(&chunk.phasors, of_cell, &mut day.scores, with_wrong);
                day.scored += readings.scored;
            }
        }
    }

    /// Adds a chunk to the sums of occupied readings.
    pub(super) fn fold(&mut self, chunk: &Chunk<'_>) {
        let occupied_rows = chunk.weighted.map_or(chunk.rows, |weighted| &weighted.beta);
        for (day, sum) in self.cells.iter_mut().zip(&mut self.tile.data.sums.cells) {
            if self.groups.get(day.group).is_some() {
                let sum = day.late.as_mut().map_or(sum, |(late, _)| late);
                fold_toggles(&day.toggles, &mut day.cursor, sum, occupied_rows, chunk);
            }
        }
    }

    /// Replaces the tile's groups by the groups after the day.
    pub(super) fn regroup(&mut self, gains: &mut Gains, times: &Times, rules: &Rules) {
        let TileData { model, sums } = &mut self.tile.data;
        let changed = model.changed();
        let mut groups = Vec::with_capacity(self.split.len());
        let mut group_sums = Vec::with_capacity(self.split.len());
        let mut weights = Vec::with_capacity(model.sensors.as_ref().map_or(0, |_| self.split.len()));
        let mut fades = Vec::with_capacity(rules.half_life.map_or(0, |_| self.split.len()));
        for (split, of_day) in self.split.iter().zip(&self.groups) {
            let factors = of_day.factors;
            let before = split.before.and_then(|before| Some((*model.groups.get(before)?, sums.group(before)?)));
            let toggles = split.toggles.and_then(|index| self.observed.get(index)).map(|(toggles, _)| toggles);
            let counted = toggles.map(|toggles| times.count(toggles));
            let gain = toggles.filter(|_| split.is_summed).and_then(|toggles| gains.gain(toggles));
            if model.sensors.is_some() {
                let mut weight = split.before.map_or_else(Weights::default, |before| model.weights(before));
                weight *= factors.known;
                let mut gained = toggles.map_or_else(Weights::default, |toggles| times.weigh(toggles));
                gained *= factors.of_day;
                weight += gained;
                weights.push(weight);
            }
            let known = before.as_ref().map(|(group, _)| *group);
            let observed =
                before.as_ref().and_then(|(group, sums)| Some((sums.times.clone()?, Some(group.last_nanos))));
            let (known_times, last_nanos) = observed.unwrap_or_else(|| (gains.no_times(), None));
            let of_group = match toggles {
                Some(toggles) => gains.observe(known_times, gain, (times, toggles), last_nanos, factors),
                None => known_times,
            };
            let sum = match (before, gain) {
                (Some((_, sum)), Some(gain)) => gains.add_to(sum, gain, factors),
                (Some((_, sum)), None) => sum,
                (None, Some(gain)) => gains.sum(gain, rules),
                (None, None) => gains.zero(rules),
            };
            let mut group = known.unwrap_or_default();
            if let Some(counted) = counted {
                group.first_nanos = counted.first_nanos.min(known.map_or(i64::MAX, |group| group.first_nanos));
                group.last_nanos = counted.last_nanos.max(known.map_or(i64::MIN, |group| group.last_nanos));
                group.observations += counted.observations;
                if !(split.cells & changed).is_empty() {
                    group.seen = of_group.hours_seen();
                }
            }
            if rules.half_life.is_some() {
                let mut fade = fade_of(model, split).unwrap_or_else(|| GroupFade::new(self.day));
                if let Some(counted) = counted {
                    fade.weight = fade.weight * factors.known + counted.observations as f64 * factors.of_day;
                    fade.day = fade.day.max(self.day);
                }
                if split.is_summed {
                    fade.sum_day = fade.day;
                }
                fades.push(fade);
            }
            groups.push(Group { cells: split.cells, ..group });
            group_sums.push(GroupSums { times: Some(of_group), ..sum });
        }
        model.groups = groups;
        if let Some(known) = &mut model.sensors {
            known.groups = weights;
            known.fades = fades;
        }
        sums.set_groups(group_sums);
        self.keep_runs(times, rules);
    }

    /// Adds the day to the observation runs of cells without complete sums. Completes all sums instead if that takes
    /// less memory.
    fn keep_runs(&mut self, times: &Times, rules: &Rules) {
        let TileData { model, sums } = &mut self.tile.data;
        let others: Vec<(usize, &SplitGroup)> =
            self.split.iter().enumerate().filter(|(_, group)| !group.is_summed).collect();
        if others.is_empty() {
            return;
        }
        let cells = others.iter().fold(Mask::EMPTY, |all, (_, group)| all | group.cells);
        let sensors = times.weighted.as_ref().map(|weighted| &weighted.ids);
        let observed = self.observed.iter().map(|(toggles, alike)| (toggles, *alike & cells));
        sums.runs.push(&times.civil_nanos, sensors, observed);
        if sums.runs.bytes() > others.len() * rules.limits.runs_per_sum * 16 * rules.periodicities.len() {
            let groups: Vec<(usize, u16)> =
                others.into_iter().filter_map(|(index, group)| Some((index, group.cells.first()?))).collect();
            complete(model, sums, &groups, rules);
            sums.runs = ObservationRuns::default();
        }
    }

    /// Chooses orders and trains the models again.
    pub(super) fn retrain(mut self, times: &Times, rules: &Rules) -> BusyTile {
        let mut outcome = TileOutcome::default();
        for (toggles, cells) in &self.observed {
            outcome.observations += u64::from(cells.count()) * run_length(toggles, self.scans);
        }
        let TileData { model, sums } = &mut self.tile.data;
        let TileModel { groups, cells, sensors, .. } = model;
        let watches = &mut sums.watches;
        for (index, ((cell, sum), of_day)) in cells.iter_mut().zip(&mut sums.cells).zip(&self.cells).enumerate() {
            if let Some((late, weight)) = &of_day.late {
                sum.add_scaled(late, *weight);
            }
            let sum = &*sum;
            let observed = self.split.get(of_day.group).and_then(|group| self.observed.get(group.toggles?));
            let (Some(group), Some(group_sum)) = (groups.get(of_day.group), sums.groups.get(of_day.group)) else {
                continue;
            };
            let (Some((observed, _)), Some(group_day)) = (observed, self.groups.get(of_day.group)) else { continue };
            let (Some(group_times), Some(watch)) = (sums.times.get(of_day.group), watches.get_mut(index)) else {
                continue;
            };
            let span_nanos = group.last_nanos.abs_diff(group.first_nanos);
            if of_day.scored > 0 {
                of_day.score(self.day, cell, watch, (span_nanos, group_times.hours, rules), &mut outcome);
            }
            cell.occupied += run_length(&of_day.toggles, self.scans);
            watch.fade(group_day.factors.known);
            let changes = times.changes(observed, &of_day.toggles, group_day.scoring.newer_than, watch.last());
            watch.learn(changes.count, changes.rate_sum, changes.last);
            let (units, weight) = of_day.weigh(cell, group, sensors, index);
            let weighted = sums.sensors.as_ref().and_then(|sensors| sensors.groups.get(of_day.group)?.as_ref());
            let all = weighted.map(|weighted| {
                let mut all = sum.clone();
                all.add(&weighted.alpha);
                all
            });
            let sums = CellSums {
                observations: group.observations,
                weight,
                mean: units / weight,
                a: all.as_ref().unwrap_or(sum),
                b: group_sum,
                span_nanos,
                gap_nanos: group_times.gap_nanos(),
                levels: rules.levels,
            };
            retrain_cell(cell, watch, sums, group_times, rules);
        }
        self.tile.outcome.add(&outcome);
        self.tile
    }
}

/// Trains the model of a cell again, and chooses its order.
fn retrain_cell(
    cell: &mut CellModel,
    watch: &mut OrderWatch,
    sums: CellSums<'_>,
    group_times: &ObservedTimes,
    rules: &Rules,
) {
    cell.spectral = SpectralModel::train_on_sums(sums, &rules.periodicities);
    let readings = LearnedReadings {
        pairs: group_times.gaps.count(),
        span_secs: sums.span_nanos as f64 / 1e9,
        observed_hours: group_times.hours,
        mean: sums.mean,
        difference: rules.levels.1 - rules.levels.0,
        remembered: sums.weight / sums.observations.max(1) as f64,
    };
    watch.support(&cell.spectral, &rules.periodicities, readings);
    cell.set_order(watch, sums.span_nanos, group_times.hours);
    cell.alarm_day = watch.alarm().alarm_day();
}

impl CellDay {
    /// Adds the errors of the day to the errors that choose the cell's order, and to the outcome.
    fn score(
        &self,
        day: LocalDay,
        cell: &mut CellModel,
        watch: &mut OrderWatch,
        (span_nanos, hours, rules): (u64, f64, &Rules),
        outcome: &mut TileOutcome,
    ) {
        let (squared, scored) = (&self.scores.squared, self.scored);
        outcome.scored += scored;
        outcome.squared_error_in_force += squared[usize::from(cell.order).min(ORDER_MAX)];
        for (total, error) in outcome.squared_errors.iter_mut().zip(squared) {
            *total += error;
        }
        let errors = match rules.criterion {
            OrderCriterion::SquaredError => squared,
            OrderCriterion::ZeroOne => &self.scores.wrong,
        };
        let unit = square(rules.levels.1 - rules.levels.0);
        let order = cell.errors.best().min(watch.supported_order());
        let scores = DayScores { errors, squared, scored, order, unit };
        watch.score(day, &rules.periodicities, &mut cell.errors, scores);
        cell.set_order(watch, span_nanos, hours);
        outcome.squared_error_chosen += squared[usize::from(cell.order).min(ORDER_MAX)];
    }

    /// Adds the weight of the day's occupied readings. Returns two weights of the cell's readings: that of the occupied
    /// readings, and that of all readings.
    fn weigh(
        &self,
        cell: &CellModel,
        group: &Group,
        sensors: &mut Option<Box<SensorWeights>>,
        index: usize,
    ) -> (f64, f64) {
        let weight = group.observations.max(1) as f64;
        if let Some(SensorWeights { groups, occupied, fades }) = sensors.as_deref_mut()
            && let (Some(weights), Some(occupied)) = (groups.get(self.group), occupied.get_mut(index))
        {
            *occupied += self.occupied_weight;
            return (weights.alpha + *occupied, fades.get(self.group).map_or(weight, |fade| fade.weight));
        }
        (cell.occupied as f64, weight)
    }
}

/// Splits the groups of a tile by a day. If there are too many groups to keep a sum for each, groups are divided into
/// cells with and without a spectrum, and the sums of cells that get a spectrum on the day are completed.
fn split_groups_of(working: &mut TileData, toggles: &DayToggles, rules: &Rules) -> Vec<SplitGroup> {
    let split = split_groups(&working.model.groups, &toggles.observed);
    let is_new =
        working.model.groups.len() <= rules.limits.summed_groups_max && split.len() > rules.limits.summed_groups_max;
    if working.sums.runs.is_empty() && !is_new {
        return split;
    }
    let TileData { model, sums } = working;
    let changed = model.changed();
    let changing = changing(model, toggles);
    let mut to_complete = Vec::new();
    for index in 0..model.groups.len() {
        let (Some(group), Some(sum)) = (model.groups.get(index).copied(), sums.group(index)) else { continue };
        let is_whole = !(group.cells & changed).is_empty() || sums.runs.is_empty();
        let starting = group.cells & changing;
        let (Some(first), false) = (starting.first(), is_whole) else { continue };
        let rest = group.cells.without(starting);
        if rest.is_empty() {
            to_complete.push((index, first));
            continue;
        }
        model.groups[index].cells = rest;
        to_complete.push((model.groups.len(), first));
        model.groups.push(Group { cells: starting, ..group });
        if let Some(weights) = &mut model.sensors {
            weights.groups.extend(weights.groups.get(index).copied());
            weights.fades.extend(weights.fades.get(index).copied());
        }
        sums.push_group(sum);
    }
    complete(model, sums, &to_complete, rules);
    part_by_spectrum(split_groups(&model.groups, &toggles.observed), changed | changing)
}

/// Completes the sums of groups, each given with one of its cells.
fn complete(model: &mut TileModel, sums: &mut TileSums, groups: &[(usize, u16)], rules: &Rules) {
    if groups.is_empty() || sums.runs.is_empty() {
        return;
    }
    let fades = model.sensors.as_deref_mut().map_or(&mut [][..], |sensors| &mut sensors.fades);
    let cell = |&(index, cell): &(usize, u16)| (cell, fades.get(index).map(|fade: &GroupFade| fade.day));
    let cells: Vec<(u16, Option<LocalDay>)> = groups.iter().map(cell).collect();
    let Rules { half_life, periodicities, sensors, .. } = rules;
    let later = sums.runs.sums(&cells, *half_life, periodicities, sensors, rules.limits.chunk_scans);
    for (&(index, _), later) in groups.iter().zip(later) {
        let Some(mut before) = sums.group(index) else { continue };
        if let (Some(half_life), Some(fade)) = (half_life, fades.get_mut(index)) {
            before = before.scaled(half_life.factor(fade.sum_day, fade.day));
            fade.sum_day = fade.day;
        }
        sums.set_group(index, later.plus(&before));
    }
}

/// The fading of the group from which a group was split.
fn fade_of(model: &TileModel, split: &SplitGroup) -> Option<GroupFade> {
    model.sensors.as_ref()?.fades.get(split.before?).copied()
}

/// The factors that a day on which a group is observed applies to the weights of its readings.
fn factors_of(model: &TileModel, split: &SplitGroup, day: LocalDay, rules: &Rules) -> DayFactors {
    let known = rules.half_life.zip(fade_of(model, split));
    known.map_or(DayFactors::EQUAL, |(half_life, fade)| half_life.factors(fade.day, day))
}

/// Cells without a spectrum that have now shown both values.
fn changing(model: &TileModel, toggles: &DayToggles) -> Mask {
    let changed = model.changed();
    let was_free = model.observed().without(model.always_occupied).without(changed);
    let ever_occupied = toggles.ever_occupied | model.always_occupied;
    let ever_free = toggles.ever_free | was_free;
    (ever_occupied & ever_free).without(changed)
}

/// Adds a spectrum for the cells that changed for the first time, and records the cells that never have.
fn begin_spectra(working: &mut TileData, toggles: &DayToggles, rules: &Rules) {
    let TileData { model, sums } = working;
    let changing = changing(model, toggles);
    debug_assert_eq!(sums.watches.len(), model.cells.len(), "each changed cell has its watch");
    for cell in changing.cells() {
        let before = model.groups.iter().position(|group| group.cells.contains(cell));
        let before = before.and_then(|at| Some((at, *model.groups.get(at)?, sums.group(at)?)));
        let zero = || PhasorSum::zero(&rules.periodicities);
        let was_occupied = model.always_occupied.contains(cell);
        let before_value = before.as_ref().map(|_| was_occupied);
        let (mut occupied, mut occupied_weight, mut sum, mut spectral) = (0, 0.0, None, SpectralModel::default());
        if let Some((at, group, group_sums)) = before {
            let levels = model.constant_levels(at, &rules.sensors);
            spectral = constant(if was_occupied { levels.1 } else { levels.0 }, group.observations);
            if was_occupied {
                (occupied, occupied_weight) = (group.observations, model.weights(at).beta);
                sum = Some(PhasorSum::clone(group_sums.beta()));
            }
        }
        let at = model.cells.partition_point(|known| known.cell < cell);
        let errors = OrderErrors::default();
        model.cells.insert(at, CellModel { cell, occupied, spectral, order: 0, errors, alarm_day: None });
        sums.watches.insert(at.min(sums.watches.len()), OrderWatch::of_constant(before_value));
        if let Some(weights) = &mut model.sensors {
            weights.occupied.insert(at.min(weights.occupied.len()), occupied_weight);
        }
        sums.cells.insert(at, sum.unwrap_or_else(zero));
    }
    model.always_occupied =
        (model.always_occupied | toggles.ever_occupied).without(toggles.ever_free).without(model.changed());
}

impl CellModel {
    /// Puts the order in force that has predicted best, limited to the order that the number of observed hours allows
    /// and, once the record is long, to the supported components.
    fn set_order(&mut self, watch: &OrderWatch, span_nanos: u64, hours: f64) {
        let supported = if span_nanos < SUPPORT_NANOS { ORDER_MAX } else { watch.supported_order() };
        let supported = supported.min(((hours - HOURS_OF_MEAN) / HOURS_PER_COMPONENT).max(0.0) as usize);
        self.order = u8::try_from(self.errors.best().min(supported)).unwrap_or(0);
    }
}

/// The model of a cell that has only shown one value.
fn constant(level: f64, observations: u64) -> SpectralModel {
    // The level is a probability, and there are no components, so the parts are valid.
    SpectralModel::from_parts(level, observations, Vec::new()).unwrap_or_default()
}
