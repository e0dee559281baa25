//! Short-term forecasts from the newest readings of a state, and the weight of these forecasts.
//!
//! A state of two values is a hidden chain that a sensor reads with errors. The rates of the chain, the errors of the
//! sensor and the time for which the state keeps a value are learned day by day, the errors only if nobody has stated
//! them. A filter over the recent readings then gives the probability that the state is 1 now and later. For other
//! values the forecast is the newest value. The forecast is blended into a prediction with a weight by lead time, which
//! is learned from the errors that both would have made. See [`recent`] for the data that an observation changes at
//! once.
//!
//! Invariant: the learned data depends on the readings, their times and the stated sensor alone and takes constant
//! memory; each day is scored before it is learned. A blended probability lies in `[0,1]`, and at long lead times it is
//! the prediction itself.

use crate::{
    Sample,
    models::{Moment, markov_chain::likelihood::Transitions},
};

mod ahead;
mod dwell;
mod fields;
mod filter;
mod lead_time;
mod learn;
mod noise;
mod recent;
mod sensor;
#[cfg(test)]
mod tests;

use ahead::Ahead;
use dwell::Dwells;
use lead_time::LeadTimeWeights;
pub use noise::SensorNoise;
pub use recent::{Recent, RecentSpan, SPANS_MAX};
pub use sensor::{InvalidStateSensor, StateSensor};

/// The rates of a two-state chain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// α: changes from 0 to 1 per second of being 0; above 0.
    pub rise_per_sec: f64,
    /// β: changes from 1 to 0 per second of being 1; above 0.
    pub fall_per_sec: f64,
}

impl Default for Rates {
    /// One rise and one fall in an hour at each value.
    fn default() -> Rates {
        Rates { rise_per_sec: 1.0 / 3600.0, fall_per_sec: 1.0 / 3600.0 }
    }
}

impl Rates {
    /// The rates with a sum α + β and a share π.
    fn of((sum, share): (f64, f64)) -> Rates {
        Rates { rise_per_sec: sum * share, fall_per_sec: sum * (1.0 - share) }
    }

    /// α + β: the influence of a known value falls to 1/e in the time 1/(α + β).
    pub fn sum(self) -> f64 {
        self.rise_per_sec + self.fall_per_sec
    }

    /// π = α/(α + β), the share of the time in which the state is 1.
    pub fn share(self) -> f64 {
        self.rise_per_sec / self.sum()
    }

    /// The probability of 1 after a time Δ, from the probability b before it: π + (b - π)·e^(-(α+β)Δ).
    fn after(self, before: f64, secs: f64) -> f64 {
        self.share() + (before - self.share()) * libm::exp(-self.sum() * secs)
    }
}

/// The newest learned reading: UTC nanoseconds and value.
type Newest = (i64, f64);

/// A prediction for the newest reading by a model without it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownAtNewest {
    /// The prediction for the time of the newest reading.
    pub predicted: f64,
    /// Whether updates have learned the newest reading.
    pub is_learned: bool,
}

/// The learned data for short-term forecasts of a state; see the top of the file.
#[derive(Clone, Debug, PartialEq)]
pub struct Belief {
    /// Whether every learned reading was 0 or 1.
    has_two_values: bool,
    /// The sensor, where one was stated; its errors are not learned then.
    sensor: Option<StateSensor>,
    newest: Option<Newest>,
    recent: Recent,
    /// Counts of successive readings, where readings are taken as the true values.
    seen: Transitions,
    /// The rates that make these counts most likely.
    seen_rates: Rates,
    /// Expected counts of successive hidden values.
    hidden: Transitions,
    hidden_rates: Rates,
    /// Expected number of readings at each hidden value, and of the wrong readings among them.
    errors: noise::ErrorSums,
    noise: SensorNoise,
    /// The log-likelihood that sensor noise has gained on readings before they were learned, in nats; it fades.
    gain: f64,
    days: u32,
    dwells: Dwells,
    /// The weights of a newest reading that no update has learned, and of one that the last update has learned: its
    /// deviation is then part of the prediction already.
    weights: [LeadTimeWeights; 2],
}

impl Belief {
    /// A belief of a state without readings. `can_have_two_values`: the state is a probability.
    pub fn new(can_have_two_values: bool) -> Belief {
        Belief {
            has_two_values: can_have_two_values,
            sensor: None,
            newest: None,
            recent: Recent::default(),
            seen: Transitions::default(),
            seen_rates: Rates::default(),
            hidden: Transitions::default(),
            hidden_rates: Rates::default(),
            errors: noise::ErrorSums::default(),
            noise: SensorNoise::default(),
            gain: 0.0,
            days: 0,
            dwells: Dwells::default(),
            weights: [LeadTimeWeights::default(); 2],
        }
    }

    /// A copy for readers, without the data that only learning needs. It gives the same forecasts.
    #[must_use]
    pub fn published(&self) -> Belief {
        Belief {
            newest: None,
            recent: Recent::default(),
            hidden: Transitions::default(),
            errors: noise::ErrorSums::default(),
            dwells: self.dwells.published(),
            ..self.clone()
        }
    }

    /// The rates that make the readings most likely, taken as the true values; `None` before the second reading, and
    /// for other values than 0 and 1.
    pub fn rates_of_readings(&self) -> Option<Rates> {
        (self.has_two_values && !self.seen.is_empty()).then_some(self.seen_rates)
    }

    /// The rates of the hidden chain, with the sensor noise that is in use.
    pub fn rates(&self) -> Rates {
        if self.is_noisy() { self.hidden_rates } else { self.seen_rates }
    }

    /// The errors of the sensor: the stated ones, else the learned ones, which are 0 unless they have made new readings
    /// more likely.
    pub fn noise(&self) -> SensorNoise {
        if self.is_noisy() { self.hidden_noise() } else { SensorNoise::default() }
    }

    /// The errors with which the hidden chain is learned.
    fn hidden_noise(&self) -> SensorNoise {
        self.sensor.map_or(self.noise, StateSensor::noise)
    }

    /// Whether readings are treated as noisy readings of a hidden chain.
    fn is_noisy(&self) -> bool {
        self.sensor.is_some() || self.gain > learn::GAIN_MIN
    }

    /// Whether the lengths of dwells are known, and not only the rates.
    pub fn knows_dwells(&self) -> bool {
        self.has_two_values && self.dwells.are_known(self.rates(), self.seen.mean_gap_secs())
    }

    /// Draws predictions towards the forecasts from the newest readings. `recent` and `newest` are those of the state
    /// now; predictions for times before the newest reading stay as they are. `out` is as long as the moments.
    pub fn blend_into(
        &self,
        recent: &Recent,
        (newest_nanos, value): (i64, f64),
        known: KnownAtNewest,
        moments: &[Moment],
        out: &mut [f64],
    ) {
        let lead_times = moments.iter().map(|moment| lead_secs(newest_nanos, moment.utc_nanos));
        let longest = lead_times.clone().flatten().fold(0.0, f64::max);
        let ahead = self.ahead(recent, (newest_nanos, value), longest);
        let deviation = self.reading(ahead.at(0.0)) - known.predicted;
        let weights = self.weights(known.is_learned);
        for (out, lead) in out.iter_mut().zip(lead_times) {
            let Some(lead) = lead.filter(|lead| LeadTimeWeights::is_near(*lead)) else { continue };
            let weights = LeadTimeWeights::at(&weights, lead);
            *out = self.blended(*out, self.reading(ahead.at(lead)) - *out, deviation, weights);
        }
    }

    /// A prediction with the weights of the newest readings. `kept`: the difference of their forecast from the
    /// prediction; `carried`: the deviation of the newest reading.
    fn blended(&self, predicted: f64, kept: f64, carried: f64, weights: lead_time::Weights) -> f64 {
        let blended = predicted + weights[0] * kept + weights[1] * carried;
        if !self.has_two_values {
            return blended;
        }
        // No surer than with this weight of a reading of 0 or 1.
        let weight = weights[0] + weights[1];
        blended.max(predicted * (1.0 - weight)).min(predicted + (1.0 - predicted) * weight)
    }

    /// Whether the newest reading, at `newest_nanos`, has a weight in the forecast for a time.
    pub fn is_near(newest_nanos: i64, utc_nanos: i64) -> bool {
        lead_secs(newest_nanos, utc_nanos).is_some_and(LeadTimeWeights::is_near)
    }

    /// The expected squared error of a forecast for a time with the newest reading, at `newest_nanos`, in parts of that
    /// of the prediction without it: within `(0,1]`. `is_learned`: updates have learned this reading.
    pub fn error_share(&self, newest_nanos: i64, is_learned: bool, utc_nanos: i64) -> f64 {
        let [other, learned] = self.weights;
        let weights = if is_learned { learned } else { other.and(&learned) };
        lead_secs(newest_nanos, utc_nanos).map_or(1.0, |lead| weights.error_share(lead))
    }

    /// The weights of the newest readings, by lead time. The errors from readings that were learned show how readings
    /// fare at the longest lead times, too.
    fn weights(&self, is_learned: bool) -> [lead_time::Weights; lead_time::LEAD_TIMES] {
        let [other, learned] = &self.weights;
        let weights = other.and(learned).weights(self.trust_secs());
        if is_learned { learned.weights_of_learned(&weights) } else { weights }
    }

    /// The forecasts from the recent readings for the time after the newest one.
    fn ahead(&self, recent: &Recent, (newest_nanos, value): Newest, longest_secs: f64) -> Ahead {
        if !self.has_two_values || recent.newest_nanos() != Some(newest_nanos) {
            return Ahead::constant(value);
        }
        let (rates, noise) = (self.rates(), self.noise());
        match self.dwells.survivals().filter(|_| self.knows_dwells()) {
            Some(survivals) => {
                Ahead::of_dwells(survivals, &filter::filter_dwells(survivals, noise, recent), longest_secs)
            }
            None => Ahead::of_chain(rates, filter::filter_chain(rates, noise, recent)),
        }
    }

    /// The expected reading for a forecast of the state. A prediction is one of the next reading, as all learned data
    /// is of readings: readings that count as errors may also be short changes of the state.
    fn reading(&self, stored: f64) -> f64 {
        if self.has_two_values { self.noise().reading(stored) } else { stored }
    }

    /// For how long the newest readings are trusted while lead times are not yet scored, in seconds.
    fn trust_secs(&self) -> f64 {
        if self.has_two_values { lead_time::TRUSTED_TIMES / self.rates().sum() } else { lead_time::PRIOR_TRUST_SECS }
    }
}

/// Seconds from the newest reading to a time; `None` before it.
fn lead_secs(newest_nanos: i64, utc_nanos: i64) -> Option<f64> {
    (utc_nanos >= newest_nanos).then(|| utc_nanos.abs_diff(newest_nanos) as f64 / 1e9)
}

/// A reading of a state of two values: UTC nanoseconds, and whether it was 1.
type Bin = (i64, bool);

/// The readings after a time, each newer than the one before.
fn bins_after(last_nanos: Option<i64>, samples: &[Sample]) -> Vec<Bin> {
    let mut bins: Vec<Bin> = Vec::with_capacity(samples.len());
    for sample in samples {
        let last = bins.last().map(|(nanos, _)| *nanos).or(last_nanos);
        if last.is_none_or(|last| sample.utc_nanos > last) {
            bins.push((sample.utc_nanos, sample.value >= 0.5));
        }
    }
    bins
}
