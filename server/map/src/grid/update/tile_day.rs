//! One tile on one day of an update: its changed cells are scored and their sums go on.
//!
//! Invariant: what is scored is predicted by the models as they were before the day; sums and models change at its end.

use std::sync::Arc;

use tidemap_model::{CellSums, LocalDay, MAX_ORDER, OrderCriterion, OrderErrors, PhasorSum, ScoreSums, SpectralModel};

use super::{
    super::{
        day::DayTile,
        index::{TILE_CELLS, TileId},
        mask::Mask,
        sightings::Sightings,
        tile::{CellModel, Group, TileModel, TileSums},
    },
    CHUNK, GridOutcome, Rules, SUMMED_GROUPS_MAX, Working,
    observed::{DayToggles, Refined, refine, split_by_spectrum},
    pattern::{Chunk, Gains, Times, fold_toggles},
};

/// Sightings of a tile may take as much memory as this many sums for each group without one. Tests, whose sums are short,
/// keep sightings for some days.
const SIGHTINGS_PER_SUM: usize = if cfg!(test) { 4 } else { 1 };

/// A cell that has a spectrum, on the day.
#[derive(Debug, Default)]
struct CellDay {
    /// Toggles of the occupied bit.
    toggles: Vec<u32>,
    at: usize,
    is_on: bool,
    /// The refined group.
    group: usize,
    /// Readings of the day that are newer than all before, where there are any before.
    scored: u64,
    scores: ScoreSums,
}

/// How a group's cells are scored on the day.
#[derive(Debug)]
struct GroupDay {
    /// All scans before the first that counts are no newer than what is known; `None`: nothing is scored.
    newer_than: Option<i64>,
    /// Whether every scan of the pattern counts.
    all: bool,
    at: usize,
    is_on: bool,
    weights: Vec<f64>,
    /// Scans of the chunk that count.
    scored: u64,
}

/// One tile on one day.
#[derive(Debug)]
pub(super) struct TileDay {
    id: TileId,
    working: Working,
    observed: Vec<(Vec<u32>, Mask)>,
    refined: Vec<Refined>,
    groups: Vec<GroupDay>,
    cells: Vec<CellDay>,
    /// Number of scans that saw the tile.
    scans: usize,
}

impl TileDay {
    pub(super) fn new(
        id: TileId,
        mut working: Working,
        tile: &DayTile,
        ranges: &[(u32, u32)],
        times: &Times,
        rules: &Rules,
    ) -> TileDay {
        let toggles = DayToggles::new(tile, ranges);
        let refined = refine_working(&mut working, &toggles, rules);
        begin_spectra(&mut working, &toggles, rules);
        let mut groups: Vec<GroupDay> = Vec::with_capacity(refined.len());
        for group in &refined {
            let last_nanos = group.before.and_then(|before| working.model.groups.get(before)).map(|g| g.last_nanos);
            let toggles = group.toggles.and_then(|index| toggles.observed.get(index)).map(|(toggles, _)| toggles);
            let newer_than = last_nanos.filter(|_| toggles.is_some());
            let all_newer = newer_than.is_some_and(|last| times.all.first_nanos > last);
            let all = all_newer && toggles.is_some_and(|toggles| toggles.as_slice() == [0]);
            groups.push(GroupDay { newer_than, all, at: 0, is_on: false, weights: Vec::new(), scored: 0 });
        }
        let mut group_of = [usize::MAX; TILE_CELLS];
        for (index, group) in refined.iter().enumerate() {
            for cell in group.cells.cells() {
                group_of[usize::from(cell)] = index;
            }
        }
        let mut occupied = toggles.occupied.into_iter().peekable();
        let mut cells = Vec::with_capacity(working.model.cells.len());
        for model in &working.model.cells {
            while occupied.next_if(|(cell, _)| *cell < model.cell).is_some() {}
            let toggles = occupied.next_if(|(cell, _)| *cell == model.cell).map_or(Vec::new(), |(_, toggles)| toggles);
            let group = group_of.get(usize::from(model.cell)).copied().unwrap_or(usize::MAX);
            cells.push(CellDay { toggles, group, ..CellDay::default() });
        }
        TileDay { id, working, observed: toggles.observed, refined, groups, cells, scans: times.utc_nanos.len() }
    }

    /// The times at which cells of the tile were observed whose sums are to be whole; some may come twice.
    pub(super) fn toggles(&self) -> impl Iterator<Item = &Vec<u32>> {
        let summed = self.refined.iter().filter(|group| group.is_summed);
        summed.filter_map(|group| self.observed.get(group.toggles?)).map(|(toggles, _)| toggles)
    }

    /// Works off one chunk: scores it, then adds it to the sums of occupied readings.
    pub(super) fn fold(&mut self, chunk: &Chunk<'_>, rules: &Rules) {
        for (group, refined) in self.groups.iter_mut().zip(&self.refined) {
            let toggles = refined.toggles.and_then(|index| self.observed.get(index)).map(|(toggles, _)| toggles);
            group.weigh(toggles.map_or(&[], Vec::as_slice), chunk);
        }
        let with_wrong = rules.criterion == OrderCriterion::ZeroOne;
        let (free, occupied, mut mixed) = ([rules.levels.0; CHUNK], [rules.levels.1; CHUNK], [0.0; CHUNK]);
        let length = chunk.utc_nanos.len();
        let end = chunk.first + length;
        let cells = self.cells.iter_mut().zip(&self.working.model.cells).zip(&mut self.working.sums.cells);
        for ((day, model), sum) in cells {
            let Some(group) = self.groups.get(day.group) else { continue };
            let weights = (!group.all).then_some(group.weights.as_slice());
            if group.scored > 0 {
                let toggles = day.toggles.get(day.at).is_some_and(|&toggle| (toggle as usize) < end);
                let values = match (toggles, day.is_on) {
                    (true, _) => {
                        fill(&mut mixed[..length], &day.toggles, day.at, day.is_on, chunk.first, rules.levels);
                        &mixed[..length]
                    }
                    (false, true) => &occupied[..length],
                    (false, false) => &free[..length],
                };
                model.spectral.score_run_values(chunk.phasors, values, weights, &mut day.scores, with_wrong);
                day.scored += group.scored;
            }
            fold_toggles(&day.toggles, &mut day.at, &mut day.is_on, sum, chunk);
        }
    }

    /// Gives the tile its groups as they are after the day.
    pub(super) fn regroup(&mut self, gains: &mut Gains, times: &Times, rules: &Rules) {
        let Working { model, sums } = &mut self.working;
        let mut groups = Vec::with_capacity(self.refined.len());
        let mut group_sums = Vec::with_capacity(self.refined.len());
        for refined in &self.refined {
            let before = refined.before.and_then(|before| Some((*model.groups.get(before)?, sums.groups.get(before)?)));
            let toggles = refined.toggles.and_then(|index| self.observed.get(index)).map(|(toggles, _)| toggles);
            let counted = toggles.map(|toggles| times.count(toggles));
            let gain = toggles.filter(|_| refined.is_summed).and_then(|toggles| gains.gain(toggles));
            let sum = match (before, gain) {
                (Some((_, sum)), Some(gain)) => gains.add_to(sum, gain),
                (Some((_, sum)), None) => Arc::clone(sum),
                (None, Some(gain)) => gains.sum(gain, rules),
                (None, None) => gains.zero(rules),
            };
            let mut group = before.map_or_else(Group::default, |(group, _)| group);
            if let Some(counted) = counted {
                group.first_nanos = counted.first_nanos.min(before.map_or(i64::MAX, |(group, _)| group.first_nanos));
                group.last_nanos = counted.last_nanos.max(before.map_or(i64::MIN, |(group, _)| group.last_nanos));
                group.observations += counted.observations;
            }
            groups.push(Group { cells: refined.cells, ..group });
            group_sums.push(sum);
        }
        model.groups = groups;
        sums.groups = group_sums;
        self.keep_sightings(times, rules);
    }

    /// Keeps when the cells were observed whose sums are not whole, or makes all sums whole where that takes less.
    fn keep_sightings(&mut self, times: &Times, rules: &Rules) {
        let sums = &mut self.working.sums;
        let others: Vec<(usize, &Refined)> =
            self.refined.iter().enumerate().filter(|(_, group)| !group.is_summed).collect();
        if others.is_empty() {
            return;
        }
        let cells = others.iter().fold(Mask::EMPTY, |all, (_, group)| all | group.cells);
        sums.sightings.push(&times.civil_nanos, self.observed.iter().map(|(toggles, alike)| (toggles, *alike & cells)));
        if sums.sightings.bytes() > others.len() * SIGHTINGS_PER_SUM * 16 * rules.periodicities.len() {
            let groups: Vec<(usize, u16)> =
                others.into_iter().filter_map(|(index, group)| Some((index, group.cells.first()?))).collect();
            complete(sums, &groups, rules);
            sums.sightings = Sightings::default();
        }
    }

    /// Chooses orders and fits the models anew.
    pub(super) fn refit(mut self, day: LocalDay, rules: &Rules) -> ((TileId, Working), GridOutcome) {
        let mut outcome = GridOutcome::default();
        for (toggles, cells) in &self.observed {
            outcome.observations += u64::from(cells.count()) * run_length(toggles, self.scans);
        }
        let Working { model, sums } = &mut self.working;
        for ((cell, sum), of_day) in model.cells.iter_mut().zip(&sums.cells).zip(&self.cells) {
            let observed = self.refined.get(of_day.group).is_some_and(|group| group.toggles.is_some());
            let (Some(group), Some(group_sum)) = (model.groups.get(of_day.group), sums.groups.get(of_day.group)) else {
                continue;
            };
            if !observed {
                continue;
            }
            if of_day.scored > 0 {
                outcome.scored += of_day.scored;
                let before = usize::from(cell.order).min(MAX_ORDER);
                outcome.squared_error_in_force += of_day.scores.squared[before];
                for (total, error) in outcome.squared_errors.iter_mut().zip(&of_day.scores.squared) {
                    *total += error;
                }
                let errors = match rules.criterion {
                    OrderCriterion::SquaredError => &of_day.scores.squared,
                    OrderCriterion::ZeroOne => &of_day.scores.wrong,
                };
                cell.errors.record(day, errors);
                cell.order = u8::try_from(cell.errors.best()).unwrap_or(0);
                outcome.squared_error_chosen += of_day.scores.squared[usize::from(cell.order).min(MAX_ORDER)];
            }
            cell.occupied += run_length(&of_day.toggles, self.scans);
            cell.spectral = SpectralModel::fit_sums(
                CellSums {
                    observations: group.observations,
                    mean: cell.occupied as f64 / group.observations.max(1) as f64,
                    a: sum,
                    b: group_sum,
                    span_nanos: group.last_nanos.abs_diff(group.first_nanos),
                    levels: rules.levels,
                },
                &rules.periodicities,
            );
        }
        ((self.id, self.working), outcome)
    }
}

impl GroupDay {
    /// Sets the weights of a chunk's scans, where not all count: 1 where the group was observed and the scan is newer than what is known.
    fn weigh(&mut self, toggles: &[u32], chunk: &Chunk<'_>) {
        let Some(newer_than) = self.newer_than else { return };
        if self.all {
            self.scored = chunk.utc_nanos.len() as u64;
            return;
        }
        self.weights.resize(chunk.utc_nanos.len(), 0.0);
        fill(&mut self.weights, toggles, self.at, self.is_on, chunk.first, (0.0, 1.0));
        for (weight, &nanos) in self.weights.iter_mut().zip(chunk.utc_nanos) {
            if nanos <= newer_than {
                *weight = 0.0;
            }
        }
        self.scored = self.weights.iter().filter(|weight| **weight > 0.0).count() as u64;
        let end = chunk.first + chunk.utc_nanos.len();
        while toggles.get(self.at).is_some_and(|&toggle| (toggle as usize) < end) {
            (self.at, self.is_on) = (self.at + 1, !self.is_on);
        }
    }
}

/// Writes the value of each scan of a chunk that begins with scan `first`: `levels` of a bit that is clear and set.
fn fill(values: &mut [f64], toggles: &[u32], at: usize, is_on: bool, first: usize, levels: (f64, f64)) {
    let (mut from, mut is_on) = (0, is_on);
    for &toggle in toggles.get(at..).unwrap_or_default() {
        let to = (toggle as usize).saturating_sub(first).min(values.len());
        values[from..to].fill(if is_on { levels.1 } else { levels.0 });
        (from, is_on) = (to, !is_on);
        if to == values.len() {
            return;
        }
    }
    values[from..].fill(if is_on { levels.1 } else { levels.0 });
}

/// Number of scans at which a bit is set.
fn run_length(toggles: &[u32], scans: usize) -> u64 {
    let end = u32::try_from(scans).unwrap_or(u32::MAX);
    toggles.chunks(2).map(|run| u64::from(run.get(1).unwrap_or(&end).saturating_sub(run[0]))).sum()
}

/// Refines the groups of a tile by a day. Where there are too many for a sum each, those with and those without a
/// spectrum are parted, and the sums of cells that get one on the day are made whole.
fn refine_working(working: &mut Working, toggles: &DayToggles, rules: &Rules) -> Vec<Refined> {
    let refined = refine(&working.model.groups, &toggles.observed);
    let is_new = working.model.groups.len() <= SUMMED_GROUPS_MAX && refined.len() > SUMMED_GROUPS_MAX;
    if working.sums.sightings.is_empty() && !is_new {
        return refined;
    }
    let Working { model, sums } = working;
    let changed = model.changed();
    let changing = changing(model, toggles);
    let mut to_complete = Vec::new();
    for index in 0..model.groups.len() {
        let (Some(group), Some(sum)) = (model.groups.get(index).copied(), sums.groups.get(index).map(Arc::clone))
        else {
            continue;
        };
        let is_whole = !(group.cells & changed).is_empty() || sums.sightings.is_empty();
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
        sums.groups.push(sum);
    }
    complete(sums, &to_complete, rules);
    split_by_spectrum(refine(&model.groups, &toggles.observed), changed | changing)
}

/// Makes the sums of groups whole, each given with a cell of it.
fn complete(sums: &mut TileSums, groups: &[(usize, u16)], rules: &Rules) {
    if groups.is_empty() || sums.sightings.is_empty() {
        return;
    }
    let cells: Vec<u16> = groups.iter().map(|&(_, cell)| cell).collect();
    for (&(index, _), mut sum) in groups.iter().zip(sums.sightings.sums(&cells, &rules.periodicities)) {
        if let Some(before) = sums.groups.get_mut(index) {
            sum.add(before);
            *before = Arc::new(sum);
        }
    }
}

/// Cells without a spectrum that have now shown both values.
fn changing(model: &TileModel, toggles: &DayToggles) -> Mask {
    let changed = model.changed();
    let was_free = model.observed().without(model.always_occupied).without(changed);
    let ever_occupied = toggles.ever_occupied | model.always_occupied;
    let ever_free = toggles.ever_free | was_free;
    (ever_occupied & ever_free).without(changed)
}

/// Gives a spectrum to the cells that show another value than ever before, and notes those that never have.
fn begin_spectra(working: &mut Working, toggles: &DayToggles, rules: &Rules) {
    let Working { model, sums } = working;
    let changing = changing(model, toggles);
    for cell in changing.cells() {
        let before = model.groups.iter().position(|group| group.cells.contains(cell));
        let before = before.and_then(|at| Some((*model.groups.get(at)?, sums.groups.get(at)?)));
        let zero = || PhasorSum::zero(&rules.periodicities);
        let (occupied, sum, spectral) = match before {
            None => (0, zero(), SpectralModel::default()),
            Some((group, sum)) if model.always_occupied.contains(cell) => {
                (group.observations, PhasorSum::clone(sum), constant(rules.levels.1, group.observations))
            }
            Some((group, _)) => (0, zero(), constant(rules.levels.0, group.observations)),
        };
        let at = model.cells.partition_point(|known| known.cell < cell);
        let errors = OrderErrors::default();
        model.cells.insert(at, CellModel { cell, occupied, spectral, order: 0, errors });
        sums.cells.insert(at, sum);
    }
    model.always_occupied =
        (model.always_occupied | toggles.ever_occupied).without(toggles.ever_free).without(model.changed());
}

/// The model of a cell that has only shown one value.
fn constant(level: f64, observations: u64) -> SpectralModel {
    // A level is a probability, and no component is none too many.
    SpectralModel::from_parts(level, observations, Vec::new()).unwrap_or_default()
}
