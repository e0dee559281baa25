//! Lower bounds on the remaining cost, from each node to the goal.
//!
//! Invariant: if the least costs of the edges hold, no path to the goal within the span costs less.

use std::{cmp::Reverse, collections::BinaryHeap};

use super::{ForecastError, Forecasts, cost::Cost, forecast_cache::ForecastCache, network::Network};

/// The half width of the sampled times of an edge, as a share of the duration of a good path.
const REACH: f64 = 0.25;

/// The source of the least cost of an edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Source {
    /// Known bounds.
    Known,
    /// This number of forecasts.
    Sampled(u32),
    /// This number of forecasts around the time at which a good path reaches the edge.
    About {
        samples: u32,
        /// The cost of the good path, which takes the whole span.
        cost: Cost,
    },
}

/// Least costs over a span of time.
#[derive(Clone, Debug)]
pub(super) struct ToGo {
    /// The least cost from each node to the goal; infinite without a path.
    pub least: Vec<Cost>,
    /// The minimum of both cost parts over the edges into each node.
    into: Vec<Cost>,
}

impl ToGo {
    /// No bounds: all least costs are 0.
    pub(super) fn nothing(network: &Network) -> ToGo {
        ToGo { least: vec![Cost::ZERO; network.nodes.len()], into: vec![Cost::ZERO; network.nodes.len()] }
    }

    /// Dijkstra's search, from the goal back. Lexicographic sums of least parts are lower bounds: a path whose first
    /// part is more than their sum is worse, whatever its second part, and otherwise each of its edges has its least
    /// first part.
    ///
    /// Bounds stop at `limit`: paths beyond it are useless.
    pub(super) fn find<F: Forecasts>(
        network: &Network,
        cache: &mut ForecastCache<F>,
        goal: usize,
        span: (f64, f64),
        source: Source,
        limit: Cost,
    ) -> Result<ToGo, ForecastError> {
        let count = network.nodes.len();
        let mut least = vec![Cost::INFINITE; count];
        let mut into = vec![Cost::INFINITE; count];
        let mut is_done = vec![false; count];
        let mut open = BinaryHeap::new();
        least[goal] = Cost::ZERO;
        open.push(Reverse((Cost::ZERO, goal)));
        while let Some(Reverse((cost, node))) = open.pop() {
            if std::mem::replace(&mut is_done[node], true) {
                continue;
            }
            if cost.is_beyond(limit) {
                // All other nodes cost at least as much, or have no path.
                return Ok(ToGo {
                    least: least.into_iter().map(|found| found.min(cost)).collect(),
                    into: capped(into),
                });
            }
            for edge in network.arriving(node) {
                let own = match source {
                    Source::Known => cache.known_least(edge, span.0, span.1),
                    Source::Sampled(samples) => cache.sampled_least(edge, span.0, span.1, samples)?,
                    Source::About { samples, cost: good } => {
                        let (from_secs, to_secs) = about(span, share(cost, good));
                        cache.sampled_least(edge, from_secs, to_secs, samples)?
                    }
                };
                into[node] = into[node].least(own);
                let (from, found) = (network.from(edge), cost.plus(own));
                if !is_done[from] && found < least[from] {
                    least[from] = found;
                    open.push(Reverse((found, from)));
                }
            }
        }
        Ok(ToGo { least, into: capped(into) })
    }

    /// The least cost of an edge into a node and the path from there to the goal.
    pub(super) fn through(&self, node: usize) -> Cost {
        self.into[node].plus(self.least[node])
    }
}

/// A cost as a share of another, in `[0,1]`.
fn share(part: Cost, all: Cost) -> f64 {
    let (part, all) = if all.first > 0.0 { (part.first, all.first) } else { (part.then, all.then) };
    if all > 0.0 { (part / all).clamp(0.0, 1.0) } else { 0.0 }
}

/// The times of a span around the one at which a share of it is left.
fn about((from_secs, to_secs): (f64, f64), left: f64) -> (f64, f64) {
    let middle_secs = to_secs - left * (to_secs - from_secs);
    let reach_secs = REACH * (to_secs - from_secs);
    ((middle_secs - reach_secs).max(from_secs), middle_secs + reach_secs)
}

/// There are no bounds for edges into unreached nodes.
fn capped(mut into: Vec<Cost>) -> Vec<Cost> {
    into.iter_mut().filter(|cost| cost.first.is_infinite()).for_each(|cost| *cost = Cost::ZERO);
    into
}
