//! Filters over the recent readings: the probability that the state is 1 now, and since when it has its value.
//!
//! Invariant: probabilities add up to 1; the work is bounded by the number of spans.

use super::{Rates, Recent, SensorNoise, dwell::Survival, dwell::evidence};

/// Maximum number of hypotheses.
const HYPOTHESES_MAX: usize = 16;
/// A gap is divided into at most this many steps.
const STEPS_MAX: usize = 12;
/// Number of steps in the shorter of the two mean dwells.
pub(super) const STEPS_PER_DWELL: f64 = 4.0;
/// After a gap of this many mean dwells at both values, the readings before it have no influence.
const FORGOTTEN: f64 = 8.0;
/// Ages of a dwell without readings, as quantiles of its age at a random time.
const AGES: [f64; 4] = [0.125, 0.375, 0.625, 0.875];

/// A hypothesis: the state has a value since a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hypothesis {
    pub(super) is_one: bool,
    /// Seconds from the last change of the state to now.
    pub(super) age_secs: f64,
    pub(super) weight: f64,
}

/// The probability of 1 at the newest reading, for a chain.
pub(super) fn filter_chain(rates: Rates, noise: SensorNoise, recent: &Recent) -> f64 {
    let (mut one, mut last) = (rates.share(), None::<i64>);
    for span in recent.spans() {
        if let Some(last) = last {
            one = rates.after(one, span.first_nanos.abs_diff(last) as f64 / 1e9);
        }
        let [low, high] = evidence(noise, span.ones, span.zeros);
        let (low, high) = (low - rates.rise_per_sec * span.secs(), high - rates.fall_per_sec * span.secs());
        let likelier = low.max(high);
        let (low, high) = ((1.0 - one) * libm::exp(low - likelier), one * libm::exp(high - likelier));
        one = high / (low + high).max(f64::MIN_POSITIVE);
        last = Some(span.last_nanos());
    }
    one
}

/// The hypotheses at the newest reading, for a state with known dwells.
pub(super) fn filter_dwells(survivals: &[Survival; 2], noise: SensorNoise, recent: &Recent) -> Vec<Hypothesis> {
    let mut known = equilibrium(survivals);
    let mean = survivals.each_ref().map(Survival::mean_secs);
    let step = mean[0].min(mean[1]) / STEPS_PER_DWELL;
    let mut last = None::<i64>;
    for span in recent.spans() {
        if let Some(last) = last {
            let gap = span.first_nanos.abs_diff(last) as f64 / 1e9;
            if gap > FORGOTTEN * (mean[0] + mean[1]) {
                known = equilibrium(survivals);
            } else {
                let steps = ((gap / step).ceil() as usize).clamp(1, STEPS_MAX);
                (0..steps).for_each(|_| pass(&mut known, survivals, gap / steps as f64));
            }
        }
        weigh(&mut known, survivals, evidence(noise, span.ones, span.zeros), span.secs());
        last = Some(span.last_nanos());
    }
    known
}

/// Moves the hypotheses over a time without readings, in which the state may change once under each hypothesis.
fn pass(known: &mut Vec<Hypothesis>, survivals: &[Survival; 2], secs: f64) {
    let mut entered = [0.0; 2];
    for hypothesis in known.iter_mut() {
        let survival = &survivals[usize::from(hypothesis.is_one)];
        let stays = survival.at(hypothesis.age_secs + secs) / survival.at(hypothesis.age_secs);
        entered[usize::from(!hypothesis.is_one)] += hypothesis.weight * (1.0 - stays);
        hypothesis.weight *= stays;
        hypothesis.age_secs += secs;
    }
    for (is_one, weight) in [(false, entered[0]), (true, entered[1])] {
        if weight > 0.0 {
            known.push(Hypothesis { is_one, age_secs: secs / 2.0, weight });
        }
    }
    while known.len() > HYPOTHESES_MAX {
        join_lightest(known);
    }
}

/// Merges the hypothesis with the lowest weight into the one with the same value and the nearest age, or drops it.
fn join_lightest(known: &mut Vec<Hypothesis>) {
    let lightest = known.iter().enumerate().min_by(|one, other| one.1.weight.total_cmp(&other.1.weight));
    let Some(gone) = lightest.map(|(index, _)| index).map(|index| known.swap_remove(index)) else { return };
    let alike = known.iter_mut().filter(|other| other.is_one == gone.is_one);
    let distance = |other: &Hypothesis| libm::log(other.age_secs / gone.age_secs).abs();
    if let Some(nearest) = alike.min_by(|one, other| distance(one).total_cmp(&distance(other))) {
        let weight = nearest.weight + gone.weight;
        if weight > 0.0 {
            nearest.age_secs += (gone.age_secs - nearest.age_secs) * gone.weight / weight;
            nearest.weight = weight;
        }
    }
}

/// Weights the hypotheses with readings within a time in which the state does not change.
fn weigh(known: &mut [Hypothesis], survivals: &[Survival; 2], evidence: [f64; 2], secs: f64) {
    let likelier = evidence[0].max(evidence[1]);
    for hypothesis in known.iter_mut() {
        let value = usize::from(hypothesis.is_one);
        if secs > 0.0 {
            let survival = &survivals[value];
            hypothesis.weight *= survival.at(hypothesis.age_secs + secs) / survival.at(hypothesis.age_secs);
            hypothesis.age_secs += secs;
        }
        hypothesis.weight *= libm::exp(evidence[value] - likelier);
    }
    let sum: f64 = known.iter().map(|hypothesis| hypothesis.weight).sum();
    let count = known.len() as f64;
    let scaled = |weight: f64| if sum > 0.0 { weight / sum } else { 1.0 / count };
    known.iter_mut().for_each(|hypothesis| hypothesis.weight = scaled(hypothesis.weight));
}

/// The hypotheses without readings.
fn equilibrium(survivals: &[Survival; 2]) -> Vec<Hypothesis> {
    let mean = survivals.each_ref().map(Survival::mean_secs);
    let mut known = Vec::with_capacity(HYPOTHESES_MAX + 2);
    for (value, survival) in survivals.iter().enumerate() {
        let weight = mean[value] / (mean[0] + mean[1]) / AGES.len() as f64;
        let ages = ages(survival).into_iter();
        known.extend(ages.map(|age_secs| Hypothesis { is_one: value == 1, age_secs, weight }));
    }
    known
}

/// The quantiles [`AGES`] of the age of a dwell at a random time; the density of this age is proportional to the
/// survival.
fn ages(survival: &Survival) -> [f64; AGES.len()] {
    const POINTS: usize = 64;
    let step = 4.0 * survival.mean_secs() / POINTS as f64;
    let mut sums = [0.0; POINTS];
    let mut sum = 0.0;
    for (at, total) in sums.iter_mut().enumerate() {
        sum += survival.at((at as f64 + 0.5) * step);
        *total = sum;
    }
    AGES.map(|share| (sums.partition_point(|&total| total < share * sum) as f64 + 0.5) * step)
}
