//! Learning a day: first the weights by lead time, then the successive readings, the errors of the sensor and the
//! dwells.
//!
//! The errors of the sensor are estimated by expectation maximisation, with a few passes over the readings of a day and
//! the expected counts of earlier days, so that only counts are kept. They are used once they have made readings more
//! likely that were not yet learned; stated errors are used from the first reading on. Invariant: a day is scored with
//! the data that was learned before it.

use super::{
    Belief, Bin, Newest, Rates, Recent, SensorNoise, bins_after,
    dwell::Dwells,
    lead_secs,
    lead_time::{LeadTimeWeights, Scored},
    noise,
    recent::RecentReplay,
};
use crate::{Sample, StopSignal, models::markov_chain::likelihood::Transitions};

/// Sensor noise is used when it has gained this many nats on readings that were not yet learned.
pub(super) const GAIN_MIN: f64 = 5.0;
/// The share of the gain, and of the expected counts, that remains after a day.
const KEPT: f64 = 0.98;
/// Passes over the readings of the first days, and of later ones.
const FIRST_PASSES: usize = 15;
const PASSES: usize = 2;
const FIRST_DAYS: u32 = 2;
/// The share of the readings of the first day that is learned to score the other readings of the day.
const FIRST_SHARE: f64 = 2.0 / 3.0;
/// At most this many readings of a day are learned.
const BINS_MAX: usize = 20_000;
/// Number of readings of a day from which later readings of it are predicted, beside the last reading of the days
/// before.
const ORIGINS: usize = 15;

/// A prediction for each of some readings.
type Predict<'a> = dyn Fn(&[Sample]) -> Vec<f64> + 'a;

/// A reading that was not yet learned, and its forecast from earlier readings.
struct Target {
    lead: usize,
    secs: f64,
    stored: f64,
    stored_now: f64,
    /// UTC nanoseconds of the newest of the earlier readings.
    since_nanos: i64,
    sample: Sample,
}

impl Belief {
    /// Learns the readings of a day, ascending by time. First the readings are scored; `predict` predicts each of them,
    /// and has not learned them; `None`: nothing was learned before. `unit`: the variance of the state, above 0.
    pub fn learn_day(&mut self, samples: &[Sample], predict: Option<&Predict<'_>>, unit: f64) {
        let newest_before = self.newest.map(|(nanos, _)| nanos);
        let from = samples.partition_point(|sample| newest_before.is_some_and(|before| sample.utc_nanos <= before));
        let newer = &samples[from..];
        if newer.is_empty() {
            return;
        }
        if newer.iter().any(|sample| sample.value != 0.0 && sample.value != 1.0) {
            self.has_two_values = false;
        }
        match predict {
            Some(predict) => self.score(newer, predict, unit),
            None => self.learn_first_day(newer, unit),
        }
        if self.has_two_values {
            self.learn_bins(&bins_after(newest_before, newer));
        }
        self.take_in(newer);
        self.days = self.days.saturating_add(1);
    }

    /// Updates the recent and newest readings, without learning from them.
    fn take_in(&mut self, samples: &[Sample]) {
        let mut recent = RecentReplay::new(self.recent);
        for sample in samples {
            recent.observe(sample.utc_nanos, sample.value);
            if self.newest.is_none_or(|(newest, _)| sample.utc_nanos > newest) {
                self.newest = Some((sample.utc_nanos, sample.value));
            }
        }
        self.recent = *recent.recent();
    }

    /// Learns two thirds of the first day and scores the rest with them, so that a state has weights and noise after
    /// its first day.
    fn learn_first_day(&mut self, samples: &[Sample], unit: f64) {
        let (first, rest) = samples.split_at((samples.len() as f64 * FIRST_SHARE) as usize);
        if first.is_empty() || rest.is_empty() {
            return;
        }
        let mean = first.iter().map(|sample| sample.value).sum::<f64>() / first.len() as f64;
        let mut judge = self.clone();
        judge.take_in(first);
        if judge.has_two_values {
            let (bins, newest) = (bins_after(None, first), judge.newest.take());
            judge.learn_bins(&bins);
            judge.newest = newest;
            let was_noisy = self.is_noisy();
            self.gain = judge.gained(&bins_after(newest.map(|(nanos, _)| nanos), rest));
            if self.is_noisy() != was_noisy {
                // The dwells depend on which readings were wrong.
                let learned = Belief { gain: self.gain, ..self.clone() };
                let (recent, newest) = (judge.recent, judge.newest);
                judge = learned;
                judge.learn_bins(&bins);
                (judge.recent, judge.newest) = (recent, newest);
            }
        }
        // Nothing was learned before.
        judge.newest = None;
        judge.score_lead_times(rest, &|samples| vec![mean; samples.len()], unit);
        self.weights = judge.weights;
    }

    /// The log-likelihood that sensor noise gains on readings that were not learned, in nats. 0 for stated noise, which
    /// is not scored.
    fn gained(&self, bins: &[Bin]) -> f64 {
        if self.hidden.is_empty() || self.sensor.is_some() {
            return 0.0;
        }
        let likelihood = |rates: Rates, noise: SensorNoise| noise::log_likelihood(bins, 1, rates, noise);
        likelihood(self.hidden_rates, self.noise) - likelihood(self.seen_rates, SensorNoise::default())
    }

    /// Scores the noise of the sensor and the weights by lead time on readings that are not yet learned.
    fn score(&mut self, newer: &[Sample], predict: &Predict<'_>, unit: f64) {
        if self.has_two_values {
            let was_noisy = self.is_noisy();
            self.gain = self.gain * KEPT + self.gained(&bins_after(self.newest.map(|(nanos, _)| nanos), newer));
            if self.is_noisy() != was_noisy {
                // The dwells depend on which readings were wrong.
                self.dwells = Dwells::default();
            }
        }
        self.score_lead_times(newer, predict, unit);
    }

    /// Scores the weights by lead time.
    fn score_lead_times(&mut self, newer: &[Sample], predict: &Predict<'_>, unit: f64) {
        let targets = self.targets(newer);
        // Targets of one origin follow one another.
        let origins: Vec<Sample> = targets
            .chunk_by(|one, next| one.since_nanos == next.since_nanos)
            .map(|targets| Sample { utc_nanos: targets[0].since_nanos, ..targets[0].sample })
            .collect();
        let samples: Vec<Sample> = targets.iter().map(|target| target.sample).collect();
        let (predictions, at_origins) = (predict(&samples), predict(&origins));
        let weights = [false, true].map(|is_learned| self.weights(is_learned));
        self.weights.iter_mut().for_each(LeadTimeWeights::fade);
        let learned_nanos = self.newest.map(|(nanos, _)| nanos);
        let mut origin = 0;
        for (target, predicted) in targets.iter().zip(predictions) {
            if origins[origin].utc_nanos != target.since_nanos {
                origin += 1;
            }
            let scored = Scored {
                value: target.sample.value,
                predicted,
                predicted_now: at_origins[origin],
                stored: target.stored,
                stored_now: target.stored_now,
            };
            let is_learned = usize::from(Some(target.since_nanos) == learned_nanos);
            let weights = LeadTimeWeights::at(&weights[is_learned], target.secs);
            let [kept, carried] = scored.features();
            let blended = self.blended(predicted, kept, carried, weights);
            self.weights[is_learned].add(target.lead, &scored, blended, unit);
        }
    }

    /// The readings on which the weights are scored: those after the newest learned reading, and after some readings of
    /// the day, by a lead time.
    fn targets(&self, newer: &[Sample]) -> Vec<Target> {
        let mut targets = Vec::new();
        let (mut recent, mut newest) = (RecentReplay::new(self.recent), self.newest);
        if let Some(newest) = newest {
            self.targets_from(recent.recent(), newest, newer, &mut targets);
        }
        let mut next = 0;
        for (at, sample) in newer.iter().enumerate() {
            recent.observe(sample.utc_nanos, sample.value);
            if newest.is_none_or(|(nanos, _)| sample.utc_nanos > nanos) {
                newest = Some((sample.utc_nanos, sample.value));
            }
            if at * ORIGINS >= next * newer.len() {
                next += 1;
                if let Some(newest) = newest {
                    self.targets_from(recent.recent(), newest, &newer[at + 1..], &mut targets);
                }
            }
        }
        targets
    }

    /// Adds for each lead time the first of the later readings that has this lead time.
    fn targets_from(&self, recent: &Recent, newest: Newest, later: &[Sample], targets: &mut Vec<Target>) {
        let target = |lead: usize| {
            let nanos = newest.0.saturating_add((LeadTimeWeights::lead_secs(lead) * 1e9) as i64);
            // A reading just before also counts, if this lead time is its nearest.
            let at = later.partition_point(|sample| sample.utc_nanos < nanos);
            let sample = later.get(at).or(later.last())?;
            let secs =
                lead_secs(newest.0, sample.utc_nanos).filter(|secs| LeadTimeWeights::nearest(*secs) == Some(lead))?;
            Some((lead, secs, *sample))
        };
        let found: Vec<_> = (0..super::lead_time::LEAD_TIMES).filter_map(target).collect();
        let longest = found.iter().map(|(_, secs, _)| *secs).fold(0.0, f64::max);
        if found.is_empty() {
            return;
        }
        let ahead = self.ahead(recent, newest, longest);
        let stored_now = self.reading(ahead.at(0.0));
        let target = |(lead, secs, sample)| Target {
            lead,
            secs,
            stored: self.reading(ahead.at(secs)),
            stored_now,
            since_nanos: newest.0,
            sample,
        };
        targets.extend(found.into_iter().map(target));
    }

    /// Learns successive readings, noise and dwells.
    fn learn_bins(&mut self, bins: &[Bin]) {
        let bins = &bins[bins.len().saturating_sub(BINS_MAX)..];
        let before = self.newest.map(|(nanos, value)| (nanos, value >= 0.5));
        let all = before.iter().chain(bins);
        for (&(earlier, from), &(later, to)) in all.clone().zip(all.skip(1)) {
            let mut counts = [0.0; 4];
            counts[usize::from(from) * 2 + usize::from(to)] = 1.0;
            self.seen.add_by_octave(later.abs_diff(earlier), counts);
        }
        if self.seen.is_empty() {
            return;
        }
        self.seen_rates = if self.days == 0 {
            Rates::of(self.seen.most_likely(StopSignal::NEVER))
        } else {
            most_likely_near(&self.seen, self.seen_rates)
        };
        let expected = self.learn_noise(bins);
        let gap = self.seen.mean_gap_secs();
        self.dwells.learn(bins, &expected, gap);
    }

    /// Learns the hidden chain and the errors of the sensor. Returns the expected hidden values with the noise that is
    /// in use.
    fn learn_noise(&mut self, bins: &[Bin]) -> noise::Expected {
        let passes = if self.days < FIRST_DAYS { FIRST_PASSES } else { PASSES };
        if self.hidden.is_empty() {
            (self.hidden_rates, self.noise) = (self.seen_rates, SensorNoise::begin());
        }
        self.hidden.scale(KEPT);
        self.errors.scale(KEPT);
        let (mut hidden, mut errors) = (self.hidden.clone(), self.errors);
        for _ in 0..passes {
            let expected = noise::expect(bins, self.hidden_rates, self.hidden_noise());
            (hidden, errors) = (self.hidden.clone(), self.errors);
            hidden.merge(&expected.transitions);
            errors.merge(&expected.errors);
            self.hidden_rates = most_likely_near(&hidden, self.hidden_rates);
            self.noise = if self.sensor.is_some() { SensorNoise::default() } else { errors.noise() };
        }
        (self.hidden, self.errors) = (hidden, errors);
        noise::expect(bins, self.rates(), self.noise())
    }
}

/// The most likely rates, searched for near the rates before.
fn most_likely_near(transitions: &Transitions, before: Rates) -> Rates {
    Rates::of(transitions.most_likely_near((before.sum(), before.share())))
}
