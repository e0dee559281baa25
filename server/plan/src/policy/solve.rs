//! Solves a policy slot by slot, from the last.
//!
//! With w the width of a slot, success p, duration d and recovery r, the value of taking an edge at v in slot k is p ·
//! V(to, k + d/w) + (1 - p) · V(v, k + (d + r)/w), V linear between whole numbers; for times, p·d + (1 - p)·(d + r) is
//! added. The part that is the value of v itself in slot k is moved to the left side, so that a choice depends on at
//! most one other node of the slot. Invariant: slots after the current one are solved.

use std::{cmp::Reverse, collections::BinaryHeap};

use tidemap_map::topology::{NOMINAL_MAX_SECS, NodeId, Topology};

use super::{
    POLICY_STATES_MAX, PolicyAction, PolicyEntry, PolicyError, PolicyObjective, PolicyOptions, PolicyTable,
    settle::{ChoiceByNode, SlotChoice, SlotChoices, evaluate, settle},
};
use crate::route::{EdgeForecast, Forecasts, Network, check_forecast, expected_secs};

/// Finds the best policy for a target. `until` is called for each slot and at intervals within it; `true` stops the
/// work.
///
/// # Errors
/// [`PolicyError`].
pub fn solve_policy(
    topology: &Topology,
    target: NodeId,
    options: &PolicyOptions,
    forecasts: &mut impl Forecasts,
    mut until: impl FnMut() -> bool,
) -> Result<PolicyTable, PolicyError> {
    check(options)?;
    let network = Network::new(topology);
    let (count, slots) = (network.nodes.len(), options.slots);
    if count.saturating_mul(slots) > POLICY_STATES_MAX {
        return Err(PolicyError::TooManyStates { nodes: count, slots });
    }
    let goal = network.index_of(target).ok_or(PolicyError::UnknownNode(target.0))?;
    let mut solver = Solver::new(&network, goal, options);
    for slot in (0..slots).rev() {
        if until() {
            return Err(PolicyError::Stopped { left: slot + 1, slots });
        }
        solver.solve(slot, forecasts, &mut until)?;
    }
    let entries = solver.entries;
    Ok(PolicyTable { target, slot_secs: options.slot_secs, slots, nodes: network.nodes, entries })
}

fn check(options: &PolicyOptions) -> Result<(), PolicyError> {
    let slots = options.slots as f64;
    let max = NOMINAL_MAX_SECS;
    let range = [
        ("the width of a slot", options.slot_secs, (1e-3..=max).contains(&options.slot_secs), "0.001 s", max),
        ("the recovery", options.recovery_secs, (0.0..=max).contains(&options.recovery_secs), "0 s", max),
        ("the number of slots", slots, options.slots >= 1, "1", POLICY_STATES_MAX as f64),
    ];
    match range.into_iter().find(|range| !range.2) {
        Some((what, found, _, least, max)) => {
            Err(PolicyError::Range { what, found, expected: format!("{least} to {max}") })
        }
        None => Ok(()),
    }
}

/// Choices whose probability to reach the target differs by at most this are equal.
const TIE: f64 = 1e-12;
/// Number of forecasts between two calls of the stop function.
const EDGES_PER_CHECK: usize = 256;
/// The edge number that means waiting.
const WAIT: u32 = u32::MAX;

/// Seconds.
const TIME: usize = 0;
/// Minus the probability to reach the target.
const REACH: usize = 1;
/// The number of attempts, which breaks ties, so that a robot waits instead of moving back and forth.
const ATTEMPTS: usize = 2;

/// The state of the solver.
pub(super) struct Solver<'a> {
    network: &'a Network<'a>,
    target: usize,
    options: &'a PolicyOptions,
    /// The entries, slot by slot and node by node.
    pub entries: Vec<PolicyEntry>,
    /// Expected attempts, in the same order.
    attempts: Vec<f64>,
}

impl<'a> Solver<'a> {
    pub(super) fn new(network: &'a Network<'a>, target: usize, options: &'a PolicyOptions) -> Solver<'a> {
        let nothing = PolicyEntry { action: PolicyAction::Nothing, expected_secs: f64::INFINITY, reach: 0.0 };
        let states = network.nodes.len() * options.slots;
        Solver { network, target, options, entries: vec![nothing; states], attempts: vec![0.0; states] }
    }

    /// Solves a slot; later slots must be solved.
    pub(super) fn solve(
        &mut self,
        slot: usize,
        forecasts: &mut impl Forecasts,
        until: &mut impl FnMut() -> bool,
    ) -> Result<(), PolicyError> {
        let at_secs = (slot as f64 + 0.5) * self.options.slot_secs;
        let mut open: Vec<Option<EdgeForecast>> = Vec::with_capacity(self.network.edges.len());
        for (index, edge) in self.network.edges.iter().enumerate() {
            if index % EDGES_PER_CHECK == EDGES_PER_CHECK - 1 && until() {
                return Err(PolicyError::Stopped { left: slot + 1, slots: self.options.slots });
            }
            let forecast = if self.network.from(index) == self.target { None } else { forecasts.at(edge, at_secs) };
            if let Some(forecast) = &forecast {
                check_forecast(forecast, || self.network.edge_name(index))?;
            }
            open.push(forecast);
        }
        // The values of the next slot are good initial values.
        let next: Vec<[f64; 3]> = (0..self.network.nodes.len()).map(|node| self.value(node, slot + 1)).collect();
        let mut values = [TIME, REACH, ATTEMPTS].map(|part| next.iter().map(|value| value[part]).collect::<Vec<f64>>());
        values[REACH][self.target] = -1.0;
        let (choices, picked) = if self.is_last_for_ever(slot) {
            let picked = self.for_ever(&open, &mut values);
            let choices = self.choices(slot, &open, |edge, from| picked[from] == Some(edge));
            let picked = choices.firsts();
            evaluate(&choices, REACH, &picked, &mut values[REACH]);
            (choices, picked)
        } else {
            let choices = self.choices(slot, &open, |_, _| true);
            let mut is_best = vec![true; choices.all.len()];
            if self.options.objective == PolicyObjective::Reach {
                settle(&choices, REACH, &mut values[REACH], &is_best);
                choices.narrow(REACH, &values[REACH], |_| TIE, &mut is_best);
            }
            settle(&choices, TIME, &mut values[TIME], &is_best);
            choices.narrow(TIME, &values[TIME], |secs| TIE * (1.0 + secs.abs()), &mut is_best);
            let picked = settle(&choices, ATTEMPTS, &mut values[ATTEMPTS], &is_best);
            if self.options.objective == PolicyObjective::Time {
                evaluate(&choices, REACH, &picked, &mut values[REACH]);
            }
            (choices, picked)
        };
        self.keep(slot, &choices, &picked, &values);
        Ok(())
    }

    fn keep(&mut self, slot: usize, choices: &SlotChoices, picked: &ChoiceByNode, values: &[Vec<f64>; 3]) {
        let count = self.network.nodes.len();
        for node in 0..count {
            let action = match picked[node].map(|choice| choices.all[choice as usize].edge) {
                _ if node == self.target => PolicyAction::Arrived,
                None => PolicyAction::Nothing,
                Some(WAIT) => PolicyAction::Wait,
                Some(edge) => PolicyAction::Take(self.network.edges[edge as usize].id),
            };
            let (secs, reach) = (values[TIME][node].max(0.0), (0.0 - values[REACH][node]).clamp(0.0, 1.0));
            let (action, reach) = match self.options.objective {
                PolicyObjective::Time if secs.is_infinite() => (PolicyAction::Nothing, 0.0),
                PolicyObjective::Reach if reach == 0.0 => (PolicyAction::Nothing, 0.0),
                _ => (action, reach),
            };
            self.entries[slot * count + node] = PolicyEntry { action, expected_secs: secs, reach };
            self.attempts[slot * count + node] = values[ATTEMPTS][node];
        }
    }

    /// The values of a node at the beginning of a slot, by part; after the last slot the stationary or the final
    /// values.
    fn value(&self, node: usize, slot: usize) -> [f64; 3] {
        let (count, last) = (self.network.nodes.len(), self.options.slots - 1);
        let at = slot.min(last) * count + node;
        let PolicyEntry { expected_secs, reach, .. } = self.entries[at];
        let is_over = slot > last;
        match self.options.objective {
            _ if node == self.target => [0.0, if is_over { 0.0 } else { -reach }, 0.0],
            PolicyObjective::Reach if is_over => [0.0; 3],
            PolicyObjective::Time if is_over => [expected_secs, 0.0, self.attempts[at]],
            _ => [expected_secs, -reach, self.attempts[at]],
        }
    }

    /// The choices at each node: edges that `is_taken` accepts by index and start, with finite values.
    fn choices(
        &self,
        slot: usize,
        open: &[Option<EdgeForecast>],
        is_taken: impl Fn(u32, usize) -> bool,
    ) -> SlotChoices {
        let count = self.network.nodes.len();
        let mut choices = SlotChoices { all: Vec::new(), first: vec![0] };
        for node in 0..count {
            if node != self.target {
                for edge in self.network.leaving(node) {
                    let Some(forecast) = open[edge].filter(|_| is_taken(edge as u32, node)) else { continue };
                    let choice = self.taken(slot, edge, &forecast);
                    // An infinite expected time may still reach the target, which the last slot's policy does not
                    // cover.
                    if choice.known[TIME].is_finite() || self.is_last_for_ever(slot) {
                        choices.all.push(choice);
                    }
                }
                let mut known = self.value(node, slot + 1);
                if known[TIME].is_finite() && !self.is_last_for_ever(slot) {
                    known[TIME] += self.options.slot_secs;
                    choices.all.push(SlotChoice { known, leak: 1.0, to: node as u32, edge: WAIT });
                }
            }
            choices.first.push(choices.all.len() as u32);
        }
        choices
    }

    /// Whether the forecasts of a slot hold for ever.
    fn is_last_for_ever(&self, slot: usize) -> bool {
        self.options.objective == PolicyObjective::Time && slot + 1 == self.options.slots
    }

    fn taken(&self, slot: usize, edge: usize, forecast: &EdgeForecast) -> SlotChoice {
        let &PolicyOptions { slot_secs, slots, recovery_secs, objective } = self.options;
        let (from, to) = (self.network.from(edge), self.network.to(edge));
        let EdgeForecast { success, duration_secs, .. } = *forecast;
        let failed_secs = duration_secs + recovery_secs;
        let left_secs = (slots - slot) as f64 * slot_secs;
        let spent = |secs: f64| if objective == PolicyObjective::Reach { secs.min(left_secs) } else { secs };
        let mut known = [success * spent(duration_secs), 0.0, 1.0];
        let mut share = 0.0;
        let there = Landing::after(duration_secs / slot_secs);
        if to == self.target {
            known[REACH] -= if duration_secs <= left_secs { success } else { 0.0 };
        } else {
            share = success * self.land(there, slot, to, success, &mut known);
        }
        // The share that does not return to this node in this slot, and the leak, computed without subtracting nearly
        // equal numbers.
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
        SlotChoice { known, leak: leak.clamp(f64::EPSILON, 1.0), to: to as u32, edge: edge as u32 }
    }

    /// Adds the value of arriving at a node in later slots with a probability; returns the share that arrives in this
    /// slot.
    fn land(&self, landing: Landing, slot: usize, node: usize, probability: f64, known: &mut [f64; 3]) -> f64 {
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

    /// Least expected times if the forecasts of the last slot hold for ever, with their edges: repeated attempts cost
    /// as on a route, so this is Dijkstra's search from the target.
    fn for_ever(&self, open: &[Option<EdgeForecast>], values: &mut [Vec<f64>; 3]) -> Vec<Option<u32>> {
        let count = self.network.nodes.len();
        let [secs, _, attempts] = values;
        secs.fill(f64::INFINITY);
        let mut picked = vec![None; count];
        let mut is_done = vec![false; count];
        let mut queue = BinaryHeap::new();
        secs[self.target] = 0.0;
        // Times as bits, which have the same order for non-negative numbers.
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
                    attempts[from] = attempts[node] + 1.0 / forecast.success;
                    queue.push(Reverse((found.to_bits(), from)));
                }
            }
        }
        picked
    }
}

/// The position of a time between the beginnings of slots.
#[derive(Clone, Copy, Debug)]
struct Landing {
    /// Whole slots.
    slots: usize,
    /// Fraction of the next slot, in `[0,1)`; above 0 within the first, so that time always advances.
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
