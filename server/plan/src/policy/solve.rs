//! Slot by slot, from the last: what each choice is worth, and the best.
//!
//! With w the width of a slot, success p, duration d and recovery r, taking an edge at v in slot k is worth
//! p · V(to, k + d/w) + (1 - p) · V(v, k + (d + r)/w), V straight between whole numbers; for times, p·d + (1 - p)·(d + r) is
//! added. What of this is the value of v itself in slot k is brought to the left side, so that a choice depends on no more than
//! one other node of the slot. Invariant: slots after the one at hand are solved.

use std::{cmp::Reverse, collections::BinaryHeap};

use super::{
    PolicyAction, PolicyEntry, PolicyObjective, PolicyOptions,
    settle::{Choices, Picked, evaluate, settle},
};
use crate::route::{EdgeForecast, ForecastError, Forecasts, Network, expected_secs};

/// Choices whose probability to reach the target differs by no more are equal.
const TIE: f64 = 1e-12;
/// The edge of a choice to wait.
const WAIT: u32 = u32::MAX;

/// Something to do at a node in a slot.
#[derive(Clone, Copy, Debug)]
pub(super) struct Choice {
    /// What is known of its worth: time, and probability to miss the target less 1, so that less is better of both.
    pub known: [f64; 2],
    /// How much of its worth is not the value of `to` in this slot, above 0, at most 1.
    pub leak: f64,
    pub to: u32,
    /// Index of the edge, or [`WAIT`].
    edge: u32,
}

const TIME: usize = 0;
const REACH: usize = 1;

/// A policy in the making.
pub(super) struct Solver<'a> {
    network: &'a Network<'a>,
    target: usize,
    options: &'a PolicyOptions,
    /// Slot by slot, node by node.
    pub entries: Vec<PolicyEntry>,
}

impl<'a> Solver<'a> {
    pub fn new(network: &'a Network<'a>, target: usize, options: &'a PolicyOptions) -> Solver<'a> {
        let nothing = PolicyEntry { action: PolicyAction::Nothing, expected_secs: f64::INFINITY, reach: 0.0 };
        Solver { network, target, options, entries: vec![nothing; network.nodes.len() * options.slots] }
    }

    fn entry(&self, node: usize, slot: usize) -> &PolicyEntry {
        &self.entries[slot * self.network.nodes.len() + node]
    }

    /// Solves a slot, those after it being solved.
    pub fn solve(&mut self, slot: usize, forecasts: &mut impl Forecasts) -> Result<(), ForecastError> {
        let at_secs = (slot as f64 + 0.5) * self.options.slot_secs;
        let mut open: Vec<Option<EdgeForecast>> = Vec::with_capacity(self.network.edges.len());
        for (index, edge) in self.network.edges.iter().enumerate() {
            let forecast = if self.network.from(index) == self.target { None } else { forecasts.at(edge, at_secs) };
            if let Some(forecast) = &forecast {
                forecast.check(|| self.network.edge_name(index))?;
            }
            open.push(forecast);
        }
        let count = self.network.nodes.len();
        // The last slot's values stand in for this one's.
        let later = (slot + 1).min(self.options.slots - 1);
        let mut secs: Vec<f64> = (0..count).map(|node| self.secs(node, slot + 1)).collect();
        let mut reach: Vec<f64> = (0..count).map(|node| -self.entry(node, later).reach).collect();
        (secs[self.target], reach[self.target]) = (0.0, -1.0);
        let (choices, picked) = match self.options.objective {
            PolicyObjective::Time if slot + 1 == self.options.slots => {
                let picked = self.for_ever(&open, &mut secs);
                let choices = self.choices(slot, &open, |edge, from| picked[from] == Some(edge));
                let picked: Picked =
                    (0..count).map(|node| choices.of(node).next().map(|choice| choice as u32)).collect();
                evaluate(&choices, REACH, &picked, &mut reach);
                (choices, picked)
            }
            PolicyObjective::Time => {
                let choices = self.choices(slot, &open, |_, _| true);
                let picked = settle(&choices, TIME, &mut secs, |_| true);
                evaluate(&choices, REACH, &picked, &mut reach);
                (choices, picked)
            }
            PolicyObjective::Reach => {
                let choices = self.choices(slot, &open, |_, _| true);
                settle(&choices, REACH, &mut reach, |_| true);
                let mut is_best = vec![false; choices.all.len()];
                for node in 0..count {
                    for choice in choices.of(node) {
                        is_best[choice] = choices.worth(choice, REACH, &reach) <= reach[node] + TIE;
                    }
                }
                let picked = settle(&choices, TIME, &mut secs, |choice| is_best[choice]);
                (choices, picked)
            }
        };
        self.keep(slot, &choices, &picked, &secs, &reach);
        Ok(())
    }

    fn keep(&mut self, slot: usize, choices: &Choices, picked: &Picked, secs: &[f64], reach: &[f64]) {
        let count = self.network.nodes.len();
        for node in 0..count {
            let entry = &mut self.entries[slot * count + node];
            let action = match picked[node].map(|choice| choices.all[choice as usize].edge) {
                _ if node == self.target => PolicyAction::Arrived,
                None => PolicyAction::Nothing,
                Some(WAIT) => PolicyAction::Wait,
                Some(edge) => PolicyAction::Take(self.network.edges[edge as usize].id),
            };
            let found =
                PolicyEntry { action, expected_secs: secs[node].max(0.0), reach: (0.0 - reach[node]).clamp(0.0, 1.0) };
            *entry = match self.options.objective {
                PolicyObjective::Time if found.expected_secs.is_infinite() => {
                    PolicyEntry { action: PolicyAction::Nothing, reach: 0.0, ..found }
                }
                PolicyObjective::Reach if found.reach == 0.0 => PolicyEntry { action: PolicyAction::Nothing, ..found },
                _ => found,
            };
        }
    }

    /// Expected seconds from a node at the beginning of a slot.
    fn secs(&self, node: usize, slot: usize) -> f64 {
        let last = self.options.slots - 1;
        match self.options.objective {
            _ if node == self.target => 0.0,
            PolicyObjective::Reach if slot > last => 0.0,
            _ => self.entry(node, slot.min(last)).expected_secs,
        }
    }

    /// The same, and the probability to reach the target, which at the end of the last slot is 0, less than 0.
    fn value(&self, node: usize, slot: usize) -> [f64; 2] {
        let reach = if slot < self.options.slots { self.entry(node, slot).reach } else { 0.0 };
        [self.secs(node, slot), -reach]
    }

    /// What there is to do at each node; edges that `is_taken` by index and start, and what has a finite worth.
    fn choices(&self, slot: usize, open: &[Option<EdgeForecast>], is_taken: impl Fn(u32, usize) -> bool) -> Choices {
        let count = self.network.nodes.len();
        let mut choices = Choices { all: Vec::new(), first: vec![0] };
        for node in 0..count {
            if node != self.target {
                for edge in self.network.leaving(node) {
                    let Some(forecast) = open[edge].filter(|_| is_taken(edge as u32, node)) else { continue };
                    let choice = self.taken(slot, edge, &forecast);
                    // To be left with what never ends may still reach the target, which the last slot's policy does not say.
                    if choice.known[TIME].is_finite() || self.is_last_for_ever(slot) {
                        choices.all.push(choice);
                    }
                }
                let [secs, reach] = self.value(node, slot + 1);
                if secs.is_finite() && !self.is_last_for_ever(slot) {
                    let known = [secs + self.options.slot_secs, reach];
                    choices.all.push(Choice { known, leak: 1.0, to: node as u32, edge: WAIT });
                }
            }
            choices.first.push(choices.all.len() as u32);
        }
        choices
    }

    /// Whether a slot is the one whose forecasts stay.
    fn is_last_for_ever(&self, slot: usize) -> bool {
        self.options.objective == PolicyObjective::Time && slot + 1 == self.options.slots
    }

    fn taken(&self, slot: usize, edge: usize, forecast: &EdgeForecast) -> Choice {
        let &PolicyOptions { slot_secs, slots, recovery_secs, objective } = self.options;
        let (from, to) = (self.network.from(edge), self.network.to(edge));
        let EdgeForecast { success, duration_secs, .. } = *forecast;
        let failed_secs = duration_secs + recovery_secs;
        let left_secs = (slots - slot) as f64 * slot_secs;
        let spent = |secs: f64| if objective == PolicyObjective::Reach { secs.min(left_secs) } else { secs };
        let mut known = [success * spent(duration_secs), 0.0];
        let mut share = 0.0;
        let there = Landing::after(duration_secs / slot_secs);
        if to == self.target {
            known[REACH] -= if duration_secs <= left_secs { success } else { 0.0 };
        } else {
            share = success * self.land(there, slot, to, success, &mut known);
        }
        // What does not come back to this node in this slot, and the leak, without taking nearly equal numbers from each other.
        let failure = 1.0 - success;
        let mut failed = failure;
        if failure > 0.0 {
            known[TIME] += failure * spent(failed_secs);
            let back = Landing::after(failed_secs / slot_secs);
            if self.land(back, slot, from, failure, &mut known) > 0.0 {
                failed = failure * back.beyond;
            }
        }
        let rest = success + failed;
        let leak = if share > 0.0 { (success * there.beyond + failed) / rest } else { 1.0 };
        let known = known.map(|known| known / rest);
        Choice { known, leak: leak.clamp(f64::EPSILON, 1.0), to: to as u32, edge: edge as u32 }
    }

    /// Adds the worth of landing at a node in later slots with a probability; returns how much of it lands in this one.
    fn land(&self, landing: Landing, slot: usize, node: usize, probability: f64, known: &mut [f64; 2]) -> f64 {
        let mut own = 0.0;
        for (slots, share) in [(landing.slots, 1.0 - landing.beyond), (landing.slots.saturating_add(1), landing.beyond)]
        {
            if share == 0.0 {
                continue;
            }
            if slots == 0 {
                own = share;
                continue;
            }
            let value = self.value(node, slot.saturating_add(slots));
            for (known, value) in known.iter_mut().zip(value) {
                *known += probability * share * value;
            }
        }
        own
    }

    /// Least expected times where the forecasts of the last slot stay for ever, and the edges that lead to them: to fail and try
    /// again costs as on a route, so this is Dijkstra's search from the target.
    fn for_ever(&self, open: &[Option<EdgeForecast>], secs: &mut [f64]) -> Vec<Option<u32>> {
        let count = self.network.nodes.len();
        secs.fill(f64::INFINITY);
        let mut picked = vec![None; count];
        let mut is_done = vec![false; count];
        let mut queue = BinaryHeap::new();
        secs[self.target] = 0.0;
        // Times as bits: those of numbers that are not negative have their order.
        queue.push(Reverse((0_u64, self.target)));
        while let Some(Reverse((bits, node))) = queue.pop() {
            if std::mem::replace(&mut is_done[node], true) {
                continue;
            }
            for edge in self.network.arriving(node) {
                let Some(forecast) = open[edge] else { continue };
                let own = expected_secs(forecast.success, forecast.duration_secs, self.options.recovery_secs);
                let (from, found) = (self.network.from(edge), f64::from_bits(bits) + own);
                if !is_done[from] && found < secs[from] {
                    secs[from] = found;
                    picked[from] = Some(edge as u32);
                    queue.push(Reverse((found.to_bits(), from)));
                }
            }
        }
        picked
    }
}

/// Where a time lies between the beginnings of slots.
#[derive(Clone, Copy, Debug)]
struct Landing {
    /// Whole slots.
    slots: usize,
    /// How far into the next, in `[0,1)`; above 0 within the first, so that time never stands still.
    beyond: f64,
}

impl Landing {
    fn after(slots: f64) -> Landing {
        let whole = slots.floor();
        let beyond = slots - whole;
        if whole == 0.0 {
            return Landing { slots: 0, beyond: beyond.max(f64::EPSILON) };
        }
        Landing { slots: whole as usize, beyond }
    }
}
