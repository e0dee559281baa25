//! The greedy choice of goals, with as few evaluated views as possible.
//!
//! The information of a candidate is bounded by all cells in its reach, from a table of sums, and by its value before
//! others were chosen. Only the candidates with the highest bounds are evaluated, a few at a time.
//!
//! Invariant: the chosen goals and their values equal those of evaluating every candidate in every round, bit by bit.

use std::{
    collections::BinaryHeap,
    sync::{Mutex, PoisonError},
};

use rayon::prelude::*;
use tidemap_grid::index::CellIndex;
use tidemap_model::StopSignal;

use super::question::TourCandidate;
use crate::{
    travel::Column,
    view::{Fan, GROUP_MAX, GroupScorer, Scene},
};

/// Number of candidates that are evaluated at once at first. It is small, because the first batch may suffice. Each
/// further batch has twice as many, because views of a group cost far less than single ones.
const BATCH: usize = 4;

/// Maximum number of candidates that are evaluated at once, for each thread.
const BATCH_MAX: usize = GROUP_MAX;

/// Maximum number of remembered cells of evaluated candidates; beyond it, they are evaluated again.
const KEPT_MAX: usize = 1 << 24;

/// A chosen candidate.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct TourGoal {
    pub candidate: usize,
    /// Expected information of the candidate beyond that of the goals chosen before it, bits.
    pub bits: f64,
    /// Places of the visible cells with information.
    pub seen: Vec<u32>,
}

/// The value of a candidate, or its upper bound.
#[derive(Clone, Copy, Debug, PartialEq)]
struct GainBound {
    value: f64,
    is_exact: bool,
    candidate: usize,
}

impl Eq for GainBound {}

impl Ord for GainBound {
    /// The most valuable comes last; ties: upper bounds, so that they are evaluated, then the first.
    fn cmp(&self, other: &GainBound) -> std::cmp::Ordering {
        let by_value = self.value.total_cmp(&other.value);
        by_value.then(other.is_exact.cmp(&self.is_exact)).then(other.candidate.cmp(&self.candidate))
    }
}

impl PartialOrd for GainBound {
    fn partial_cmp(&self, other: &GainBound) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

/// A choice among candidates.
pub(super) struct GoalSelection<'a> {
    scene: &'a Scene,
    fan: &'a Fan,
    candidates: &'a [TourCandidate],
    /// If this is set, the choice ends early, and must not be used.
    stop: StopSignal<'a>,
    /// By place: whether a chosen goal sees the cell.
    covered: Vec<bool>,
    /// The information of each candidate, or its upper bound.
    bits: Vec<f64>,
    /// [`TourGoal::seen`] of evaluated candidates.
    seen: Vec<Option<Vec<u32>>>,
    kept: usize,
    entries: BinaryHeap<GainBound>,
    scorers: Mutex<Vec<GroupScorer>>,
    /// Number of candidates to evaluate next.
    batch: usize,
}

impl<'a> GoalSelection<'a> {
    pub(super) fn new(
        scene: &'a Scene,
        fan: &'a Fan,
        candidates: &'a [TourCandidate],
        stop: StopSignal<'a>,
    ) -> GoalSelection<'a> {
        let bits = bounds(scene, fan, candidates);
        let mut choice = GoalSelection {
            scene,
            fan,
            candidates,
            stop,
            covered: vec![false; scene.lattice().held()],
            bits,
            seen: vec![None; candidates.len()],
            kept: 0,
            entries: BinaryHeap::new(),
            scorers: Mutex::default(),
            batch: BATCH,
        };
        choice.entries = (0..candidates.len()).map(|candidate| choice.entry(candidate, false)).collect();
        choice
    }

    /// The best `count` goals, in the order of choice; fewer if the others have no information.
    pub(super) fn choose(&mut self, goals: usize) -> Vec<TourGoal> {
        let mut chosen = Vec::new();
        while chosen.len() < goals && !self.stop.is_set() {
            self.settle();
            let Some(best) = self.entries.pop().filter(|best| best.value > 0.0) else { break };
            let candidate = best.candidate;
            let seen = self.seen[candidate].take();
            let seen = seen.unwrap_or_else(|| self.see(&[candidate]).pop().unwrap_or_default().1);
            chosen.push(TourGoal { candidate, bits: self.bits[candidate], seen });
            if let Some(goal) = chosen.last() {
                self.suppress(goal);
            }
        }
        chosen
    }

    fn entry(&self, candidate: usize, is_exact: bool) -> GainBound {
        let value = self.bits[candidate] * self.candidates[candidate].reachability;
        GainBound { value, is_exact, candidate }
    }

    /// Evaluates candidates until the best is known.
    fn settle(&mut self) {
        let threads = rayon::current_num_threads().max(1);
        while !self.stop.is_set() {
            let (mut known, mut unseen) = (Vec::new(), Vec::new());
            while unseen.len() < self.batch
                && let Some(best) = self.entries.peek().filter(|best| !best.is_exact && best.value > 0.0)
            {
                let candidate = best.candidate;
                self.entries.pop();
                if self.seen[candidate].is_some() {
                    known.push(candidate);
                    if known.len() >= BATCH {
                        break;
                    }
                } else {
                    unseen.push(candidate);
                }
            }
            if known.is_empty() && unseen.is_empty() {
                return;
            }
            let again = |&candidate: &usize| {
                let seen = self.seen[candidate].as_deref().unwrap_or_default();
                (candidate, self.new_bits(seen))
            };
            let again: Vec<(usize, f64)> = known.par_iter().map(again).collect();
            for (candidate, bits) in again {
                self.bits[candidate] = bits;
                self.entries.push(self.entry(candidate, true));
            }
            if unseen.is_empty() {
                continue;
            }
            self.batch = (2 * self.batch).min(BATCH_MAX * threads);
            let group = unseen.len().div_ceil(threads).min(GROUP_MAX);
            let new: Vec<Vec<(f64, Vec<u32>)>> = unseen.par_chunks(group).map(|group| self.see(group)).collect();
            for (candidate, (bits, seen)) in unseen.into_iter().zip(new.into_iter().flatten()) {
                self.bits[candidate] = bits;
                self.entries.push(self.entry(candidate, true));
                if self.kept + seen.len() <= KEPT_MAX {
                    self.kept += seen.len();
                    self.seen[candidate] = Some(seen);
                }
            }
        }
    }

    /// The information of cells that no chosen goal sees.
    fn new_bits(&self, seen: &[u32]) -> f64 {
        let new = seen.iter().map(|&place| place as usize).filter(|&place| !self.covered[place]);
        new.fold(0.0, |bits, place| bits + self.scene.bits_at(place))
    }

    /// Evaluates at most [`GROUP_MAX`] candidates: their new information and [`TourGoal::seen`].
    fn see(&self, candidates: &[usize]) -> Vec<(f64, Vec<u32>)> {
        let scorers = || self.scorers.lock().unwrap_or_else(PoisonError::into_inner);
        let known = scorers().pop();
        let mut scorer = known.unwrap_or_default();
        let cells: Vec<CellIndex> = candidates.iter().map(|&candidate| self.candidates[candidate].cell).collect();
        let mut views = vec![(0.0, Vec::new()); cells.len()];
        scorer.each(self.scene, self.fan, &cells, self.stop, |number, place| {
            let bits = self.scene.bits_at(place);
            if bits > 0.0 {
                let (sum, seen) = &mut views[number];
                seen.push(place as u32);
                if !self.covered[place] {
                    *sum += bits;
                }
            }
        });
        scorers().push(scorer);
        views.iter_mut().for_each(|(_, seen)| seen.shrink_to_fit());
        views
    }

    /// Cells that a goal sees have no further information: the values of the candidates around it become bounds.
    fn suppress(&mut self, goal: &TourGoal) {
        for &place in &goal.seen {
            self.covered[place as usize] = true;
        }
        let cell = self.candidates[goal.candidate].cell;
        let [reach_x, reach_y, _] = self.fan.reach();
        let mut entries = std::mem::take(&mut self.entries).into_vec();
        for entry in &mut entries {
            let other = self.candidates[entry.candidate].cell;
            let is_near =
                other.x.abs_diff(cell.x) as usize <= 2 * reach_x && other.y.abs_diff(cell.y) as usize <= 2 * reach_y;
            entry.is_exact &= !is_near;
        }
        self.entries = entries.into();
    }
}

/// Upper bound of the information of each candidate: the sum over the cells in its reach, plus rounding.
fn bounds(scene: &Scene, fan: &Fan, candidates: &[TourCandidate]) -> Vec<f64> {
    let lattice = scene.lattice();
    let (region, [width, depth, _], reach) = (lattice.region(), lattice.size(), fan.reach());
    let Some(z) = candidates.first().map(|candidate| candidate.cell.z) else { return Vec::new() };
    let reach_z = i32::try_from(reach[2]).unwrap_or(i32::MAX);
    let layers =
        region.min.z.max(z.saturating_sub(reach_z))..region.max.z.min(z.saturating_add(reach_z).saturating_add(1));
    // The sums over all columns with a lower x and a lower y.
    let mut sums = vec![0.0; (width + 1) * (depth + 1)];
    for z in layers {
        for (row, y) in (1..).zip(region.min.y..region.max.y) {
            let Some(start) = lattice.place(CellIndex { x: region.min.x, y, z }) else { continue };
            for (column, place) in (1..=width).zip(start..) {
                sums[row * (width + 1) + column] += scene.bits_at(place);
            }
        }
    }
    for row in 1..=depth {
        let mut along = 0.0;
        for column in 1..=width {
            let at = row * (width + 1) + column;
            along += sums[at];
            sums[at] = along + sums[at - width - 1];
        }
    }
    let bound = |candidate: &TourCandidate| {
        let Column { x, y } = candidate.column;
        let (left, right) = (x.saturating_sub(reach[0]), (x + reach[0] + 1).min(width));
        let (low, high) = (y.saturating_sub(reach[1]), (y + reach[1] + 1).min(depth));
        let at = |row: usize, column: usize| sums[row * (width + 1) + column];
        let within = at(high, right) - at(low, right) - at(high, left) + at(low, left);
        // The value is a difference of sums over the whole region.
        (within + 1e-9 * at(depth, width)).max(0.0)
    };
    candidates.iter().map(bound).collect()
}
