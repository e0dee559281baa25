//! The ways between the places of tasks, for each slot of a day.
//!
//! Invariant: a leg is the cheapest way by the forecasts of its slot's middle, by expected seconds plus a cost for
//! possible failures; its numbers are finite. A leg from a place to itself takes no time.

use std::{cmp::Reverse, collections::BinaryHeap};

use tidemap_map::topology::{NodeId, Topology};
use tidemap_model::{EarlyStop, StopSignal};

use super::TASK_SLOTS_MAX;
use crate::route::{ForecastError, Forecasts, Network, check_forecast, expected_secs};

/// Maximum of edges times slots, and of places times slots times edges.
const FORECASTS_MAX: usize = 4_000_000;
const STEPS_MAX: usize = 2_000_000_000;

/// A way from one place to another, for one slot of departure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leg {
    /// Expected seconds, repeated attempts included.
    pub secs: f64,
    /// Probability that nothing fails.
    pub success: f64,
}

/// The options for the choice of ways.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LegOptions {
    /// Length of a slot, in seconds, above 0.
    pub slot_secs: f64,
    /// Number of slots, at least 1.
    pub slots: usize,
    /// The additional time of a failed attempt, in seconds, at least 0.
    pub recovery_secs: f64,
    /// The cost of a failure beyond its time, in seconds, at least 0; 0 chooses the fastest ways.
    pub failure_cost_secs: f64,
}

/// The reason why legs cannot be computed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum LegError {
    /// The map has no such node.
    #[error("there is no node of number {0}")]
    UnknownNode(u32),
    /// A number is out of range.
    #[error("{what} is {found}: expected {expected}")]
    Range { what: &'static str, found: f64, expected: String },
    /// The computation is too large.
    #[error("{edges} edges in {slots} slots for {places} places are too much work; use fewer, longer slots")]
    TooMuch { edges: usize, slots: usize, places: usize },
    /// A forecast is out of range.
    #[error(transparent)]
    Forecast(#[from] ForecastError),
    /// The caller stopped the computation.
    #[error("the ways between the tasks were not ready in time; raise the time limit, or plan fewer tasks")]
    Stopped,
}

impl From<EarlyStop> for LegError {
    fn from(_: EarlyStop) -> Self {
        LegError::Stopped
    }
}

/// The legs between places, by slot.
#[derive(Clone, Debug, PartialEq)]
pub struct LegTable {
    slot_secs: f64,
    slots: usize,
    places: usize,
    /// The legs, by slot, then origin, then destination.
    legs: Vec<Option<Leg>>,
}

impl LegTable {
    /// The table of `leg(slot, from, to)`.
    ///
    /// # Errors
    /// [`LegError::Range`] for a slot without length, no slots or too many, and for legs whose numbers are not times or
    /// probabilities.
    pub fn new(
        (slot_secs, slots): (f64, usize),
        places: usize,
        mut leg: impl FnMut(usize, usize, usize) -> Option<Leg>,
    ) -> Result<LegTable, LegError> {
        check_slots(slot_secs, slots)?;
        let mut legs = Vec::with_capacity(slots * places * places);
        for slot in 0..slots {
            for from in 0..places {
                for to in 0..places {
                    let leg = if from == to { Some(Leg { secs: 0.0, success: 1.0 }) } else { leg(slot, from, to) };
                    if let Some(Leg { secs, success }) = leg {
                        let holds = secs.is_finite() && secs >= 0.0;
                        range("the time of a leg", secs, holds, || "seconds of at least 0".to_owned())?;
                        range("the success of a leg", success, (0.0..=1.0).contains(&success), || "0 to 1".to_owned())?;
                    }
                    legs.push(leg);
                }
            }
        }
        Ok(LegTable { slot_secs, slots, places, legs })
    }

    /// The legs between nodes of a map; the same node may be several places.
    ///
    /// # Errors
    /// [`LegError`].
    pub fn between(
        topology: &Topology,
        nodes: &[NodeId],
        options: &LegOptions,
        forecasts: &mut impl Forecasts,
        stop: StopSignal<'_>,
    ) -> Result<LegTable, LegError> {
        check(options)?;
        let network = Network::new(topology);
        let index = |node: &NodeId| network.index_of(*node).ok_or(LegError::UnknownNode(node.0));
        let at = nodes.iter().map(index).collect::<Result<Vec<_>, _>>()?;
        let (edges, slots, places) = (network.edges.len(), options.slots, at.len());
        let steps = edges.saturating_mul(slots).saturating_mul(places);
        if edges.saturating_mul(slots) > FORECASTS_MAX || steps > STEPS_MAX {
            return Err(LegError::TooMuch { edges, slots, places });
        }
        let mut by_slot = Vec::with_capacity(slots);
        for slot in 0..slots {
            let middle_secs = (slot as f64 + 0.5) * options.slot_secs;
            let mut ahead = Vec::with_capacity(edges);
            for (number, edge) in network.edges.iter().enumerate() {
                if number % 256 == 0 {
                    stop.check()?;
                }
                let Some(forecast) = forecasts.at(edge, middle_secs) else {
                    ahead.push(None);
                    continue;
                };
                check_forecast(&forecast, || network.edge_name(number))?;
                let secs = expected_secs(forecast.success, forecast.duration_secs, options.recovery_secs);
                ahead.push(Some(Leg { secs, success: forecast.success }));
            }
            by_slot.push(at.iter().map(|&from| ways(&network, from, &ahead, options)).collect::<Vec<_>>());
        }
        LegTable::new((options.slot_secs, slots), places, |slot, from, to| {
            by_slot[slot][from][at[to]].map(|leg| Leg { success: whole_percent(leg.success), ..leg })
        })
    }

    /// The leg between places for a departure in a slot; `None`: there is no way.
    pub fn at(&self, from: usize, to: usize, slot: usize) -> Option<Leg> {
        self.legs[(slot * self.places + from) * self.places + to]
    }

    /// Number of places.
    pub fn places(&self) -> usize {
        self.places
    }

    /// Number of slots.
    pub fn slots(&self) -> usize {
        self.slots
    }

    /// Length of a slot, in seconds.
    pub fn slot_secs(&self) -> f64 {
        self.slot_secs
    }

    /// The slot of a time; times before the first are in the first, and times after the last in the last.
    pub(super) fn slot_of(&self, at_secs: f64) -> usize {
        // A negative number becomes 0.
        ((at_secs / self.slot_secs).floor() as usize).min(self.slots - 1)
    }
}

/// A success in whole percents, at least one: no robot should wait for a difference that is below the precision of
/// forecasts.
fn whole_percent(success: f64) -> f64 {
    (success * 100.0).round().max(1.0) / 100.0
}

/// The cheapest ways from a node to all others.
fn ways(network: &Network<'_>, from: usize, ahead: &[Option<Leg>], options: &LegOptions) -> Vec<Option<Leg>> {
    let mut found: Vec<Option<Leg>> = vec![None; network.nodes.len()];
    let mut least = vec![f64::INFINITY; network.nodes.len()];
    least[from] = 0.0;
    found[from] = Some(Leg { secs: 0.0, success: 1.0 });
    // Costs are at least 0, and the bits of such numbers ascend with them.
    let mut open = BinaryHeap::from([Reverse((0.0_f64.to_bits(), from))]);
    while let Some(Reverse((bits, node))) = open.pop() {
        let Some(way) = found[node].filter(|_| bits == least[node].to_bits()) else { continue };
        for edge in network.leaving(node) {
            let Some(Leg { secs, success }) = ahead[edge] else { continue };
            let cost = least[node] + secs + options.failure_cost_secs * -success.ln();
            let to = network.to(edge);
            if cost < least[to] {
                least[to] = cost;
                found[to] = Some(Leg { secs: way.secs + secs, success: way.success * success });
                open.push(Reverse((cost.to_bits(), to)));
            }
        }
    }
    found
}

fn range(what: &'static str, found: f64, holds: bool, expected: impl FnOnce() -> String) -> Result<(), LegError> {
    if holds { Ok(()) } else { Err(LegError::Range { what, found, expected: expected() }) }
}

fn check_slots(slot_secs: f64, slots: usize) -> Result<(), LegError> {
    let is_long = slot_secs.is_finite() && slot_secs > 0.0;
    range("the length of a slot", slot_secs, is_long, || "seconds above 0".to_owned())?;
    let are_few = (1..=TASK_SLOTS_MAX).contains(&slots);
    range("the number of slots", slots as f64, are_few, || format!("1 to {TASK_SLOTS_MAX}"))
}

fn check(options: &LegOptions) -> Result<(), LegError> {
    check_slots(options.slot_secs, options.slots)?;
    for (what, found) in [("the recovery", options.recovery_secs), ("a failure's cost", options.failure_cost_secs)] {
        range(what, found, found.is_finite() && found >= 0.0, || "seconds of at least 0".to_owned())?;
    }
    Ok(())
}
