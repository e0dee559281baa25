//! A cache of checked and priced forecasts.
//!
//! Invariant: an edge at a time has one forecast for the whole request, in any order of calls: times are rounded before
//! the lookup, so that nearby times do not share results by chance.

use tidemap_map::topology::NOMINAL_MAX_SECS;

use super::{
    ForecastError, Forecasts,
    cost::{Cost, Costing},
    forecast::{check_forecast, expected_secs},
    network::Network,
};

/// Maximum number of cached forecasts, 64 bytes each; then the cache is cleared.
const KEPT_MAX: usize = 2_000_000;

/// The price of an edge that is entered at a time.
#[derive(Clone, Copy, Debug)]
pub(super) struct EdgeCost {
    pub success: f64,
    pub evidence: f64,
    pub duration_secs: f64,
    pub expected_secs: f64,
    pub encounters: f64,
    pub cost: Cost,
}

/// The cached forecasts of edges at times.
pub(super) struct ForecastCache<'a, F> {
    network: &'a Network<'a>,
    forecasts: &'a mut F,
    pub costing: Costing,
    /// The costing of lower bounds, if it differs from that of traversals.
    pub bounds: Option<Costing>,
    resolution_secs: f64,
    /// The cached forecasts of each edge, ascending by time.
    kept: Vec<Vec<(f64, Option<EdgeCost>)>>,
    kept_count: usize,
    is_closed: Vec<bool>,
    /// Number of requested forecasts.
    pub requests: usize,
}

impl<'a, F: Forecasts> ForecastCache<'a, F> {
    pub(super) fn new(network: &'a Network<'a>, forecasts: &'a mut F, costing: Costing, resolution_secs: f64) -> Self {
        let count = network.edges.len();
        let (kept, is_closed) = (vec![Vec::new(); count], vec![false; count]);
        ForecastCache {
            network,
            forecasts,
            costing,
            bounds: None,
            resolution_secs,
            kept,
            kept_count: 0,
            is_closed,
            requests: 0,
        }
    }

    /// The time, rounded to the resolution.
    pub(super) fn rounded(&self, at_secs: f64) -> f64 {
        // Adding 0 makes -0 a 0.
        if self.resolution_secs > 0.0 {
            (at_secs / self.resolution_secs).round() * self.resolution_secs + 0.0
        } else {
            at_secs + 0.0
        }
    }

    /// The arrival, rounded to `join_secs`.
    pub(super) fn joined(&self, at_secs: f64, join_secs: f64) -> f64 {
        if join_secs > self.resolution_secs {
            (at_secs / join_secs).round() * join_secs + 0.0
        } else {
            self.rounded(at_secs)
        }
    }

    /// The price of an edge entered at a time; `None` if it is closed then.
    pub(super) fn at(&mut self, edge: usize, at_secs: f64) -> Result<Option<EdgeCost>, ForecastError> {
        let at_secs = self.rounded(at_secs);
        let place = match self.kept[edge].binary_search_by(|kept| kept.0.total_cmp(&at_secs)) {
            Ok(place) => return Ok(self.kept[edge][place].1),
            Err(place) => place,
        };
        self.requests += 1;
        let found = self.forecasts.at(self.network.edges[edge], at_secs);
        let traversal = match found {
            None => {
                self.is_closed[edge] = true;
                None
            }
            Some(forecast) => {
                check_forecast(&forecast, || self.network.edge_name(edge))?;
                let (success, duration_secs) = (forecast.success, forecast.duration_secs);
                let encounters = self.encounters(edge, at_secs, duration_secs)?;
                Some(EdgeCost {
                    success,
                    evidence: forecast.evidence,
                    duration_secs,
                    expected_secs: expected_secs(success, duration_secs, self.costing.recovery_secs),
                    encounters,
                    cost: self.costing.cost(success, duration_secs, encounters),
                })
            }
        };
        if self.kept_count < KEPT_MAX {
            self.kept[edge].insert(place, (at_secs, traversal));
        } else {
            self.kept.iter_mut().for_each(Vec::clear);
            self.kept[edge].push((at_secs, traversal));
            self.kept_count = 0;
        }
        self.kept_count += 1;
        Ok(traversal)
    }

    fn encounters(&mut self, edge: usize, at_secs: f64, duration_secs: f64) -> Result<f64, ForecastError> {
        let found = self.forecasts.encounters(self.network.edges[edge], at_secs, duration_secs);
        let is_valid = found.is_finite() && found >= 0.0;
        is_valid.then_some(found).ok_or_else(|| ForecastError::Encounters { edge: self.network.edge_name(edge), found })
    }

    /// The least cost of an edge over a span of time by known bounds.
    pub(crate) fn known_least(&mut self, edge: usize, from_secs: f64, to_secs: f64) -> Cost {
        let best = self.forecasts.best(self.network.edges[edge], from_secs, to_secs);
        let success = best.map(|best| best.success).filter(|success| *success > 0.0 && *success < 1.0).unwrap_or(1.0);
        let duration = best.map(|best| best.duration_secs).filter(|secs| (0.0..=NOMINAL_MAX_SECS).contains(secs));
        self.bounds.unwrap_or(self.costing).cost(success, duration.unwrap_or(0.0), 0.0)
    }

    /// The least cost of an edge at about `samples` times that cover a span; infinite if it is closed at all of them.
    /// The times are whole multiples of a power of two, so that spans nearby share them.
    pub(crate) fn sampled_least(
        &mut self,
        edge: usize,
        from_secs: f64,
        to_secs: f64,
        samples: u32,
    ) -> Result<Cost, ForecastError> {
        let (mut least, costing) = (Cost::INFINITE, self.bounds.unwrap_or(self.costing));
        let span_secs = to_secs - from_secs;
        let step_secs = if span_secs > 0.0 { (span_secs / f64::from(samples)).log2().ceil().exp2() } else { 1.0 };
        let first = (from_secs / step_secs).floor();
        let count = ((to_secs / step_secs).ceil() - first) as u32;
        for sample in 0..=count.min(samples + 1) {
            if let Some(found) = self.at(edge, (first + f64::from(sample)) * step_secs)? {
                least = least.least(costing.cost(found.success, found.duration_secs, found.encounters));
            }
        }
        Ok(least)
    }

    /// Number of edges that were closed at a requested time.
    pub(super) fn closed(&self) -> usize {
        self.is_closed.iter().filter(|closed| **closed).count()
    }
}
