//! Latencies and their quantiles.
//!
//! Invariant: three digits are kept of each latency, up to ten minutes.

use std::time::Duration;

use hdrhistogram::Histogram;
use tidemap_formats::table::Cell;

use super::Figures;

const LATENCY_MAX_MICROS: u64 = 600_000_000;
const DIGITS: u8 = 3;

/// A histogram of latencies.
#[derive(Debug)]
pub(super) struct Latencies(Histogram<u64>);

impl Latencies {
    pub(super) fn new() -> anyhow::Result<Self> {
        Ok(Self(Histogram::new_with_max(LATENCY_MAX_MICROS, DIGITS)?))
    }

    pub(super) fn record(&mut self, latency: Duration) -> anyhow::Result<()> {
        let micros = u64::try_from(latency.as_micros()).unwrap_or(u64::MAX);
        Ok(self.0.record(micros.clamp(1, LATENCY_MAX_MICROS))?)
    }

    pub(super) fn add(&mut self, other: Self) -> anyhow::Result<()> {
        Ok(self.0.add(other.0)?)
    }

    pub(super) fn count(&self) -> u64 {
        self.0.len()
    }

    /// Median, 99th percentile and maximum, in milliseconds, by these names.
    pub(super) fn figures(&self, [p50, p99, max]: [&'static str; 3]) -> Figures {
        let millis = |micros: u64| Cell::from(micros as f64 / 1e3);
        let quantile = |quantile| millis(self.0.value_at_quantile(quantile));
        vec![(p50, quantile(0.5)), (p99, quantile(0.99)), (max, millis(self.0.max()))]
    }
}
