//! Forecasts: the probability of 1 by lead time after the newest reading.
//!
//! For known dwells the forecast is a renewal process: the present dwell lasts or ends; after a change a dwell begins
//! with age 0. Invariant: probabilities lie in `[0,1]`.

use super::{
    Rates,
    dwell::Survival,
    filter::{Hypothesis, STEPS_PER_DWELL},
};

/// Number of steps of a curve.
const STEPS: usize = 96;
/// A curve ends after this many mean dwells at both values; from there on it is constant.
const END: f64 = 16.0;

/// The forecasts from the newest readings for the time after them.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Ahead {
    /// The newest value at all lead times.
    Constant(f64),
    /// A chain, and the probability of 1 at the newest reading.
    Chain(Rates, f64),
    /// Curves with short steps and with long ones.
    Curves([Curve; 2]),
}

impl Ahead {
    pub(super) fn constant(value: f64) -> Ahead {
        Ahead::Constant(value)
    }

    pub(super) fn of_chain(rates: Rates, now: f64) -> Ahead {
        Ahead::Chain(rates, now)
    }

    /// The forecasts for a state with known dwells, up to a lead time.
    pub(super) fn of_dwells(survivals: &[Survival; 2], known: &[Hypothesis], longest_secs: f64) -> Ahead {
        let mean = survivals.each_ref().map(Survival::mean_secs);
        let short = mean[0].min(mean[1]) / (2.0 * STEPS_PER_DWELL);
        let needed = (longest_secs / short).ceil().clamp(1.0, STEPS as f64) as usize;
        let fine = Curve::new(survivals, known, short, needed);
        let end = longest_secs.min(END * (mean[0] + mean[1]));
        let coarse = if end > short * STEPS as f64 {
            Curve::new(survivals, known, end / STEPS as f64, STEPS)
        } else {
            fine.clone()
        };
        Ahead::Curves([fine, coarse])
    }

    /// The probability of 1, or the value, at a lead time in seconds, at least 0.
    pub(super) fn at(&self, lead_secs: f64) -> f64 {
        match self {
            Ahead::Constant(value) => *value,
            Ahead::Chain(rates, now) => rates.after(*now, lead_secs),
            Ahead::Curves([fine, coarse]) => fine.at(lead_secs).unwrap_or_else(|| coarse.at_or_end(lead_secs)),
        }
    }
}

/// The probability of 1 at equal steps of time.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Curve {
    step_secs: f64,
    ones: Vec<f64>,
}

impl Curve {
    fn new(survivals: &[Survival; 2], known: &[Hypothesis], step_secs: f64, steps: usize) -> Curve {
        // The survival of a dwell that begins in the middle of a step, at the end of this step and of later ones.
        let lasting = survivals.each_ref().map(|survival| -> Vec<f64> {
            let later = (1..=steps).map(|step| survival.at((step as f64 + 0.5) * step_secs));
            std::iter::once(1.0).chain(later).collect()
        });
        // The probability that the state has not changed since now, by value and step.
        let mut unchanged = [vec![0.0; steps + 1], vec![0.0; steps + 1]];
        for hypothesis in known {
            let value = usize::from(hypothesis.is_one);
            let per = hypothesis.weight / survivals[value].at(hypothesis.age_secs);
            for (step, sum) in unchanged[value].iter_mut().enumerate() {
                *sum += per * survivals[value].at(hypothesis.age_secs + step as f64 * step_secs);
            }
        }
        // Entries into each value in each step.
        let mut entries = [vec![0.0; steps + 1], vec![0.0; steps + 1]];
        let mut ones = Vec::with_capacity(steps + 1);
        ones.push(unchanged[1][0]);
        for step in 1..=steps {
            for value in 0..2 {
                let left = unchanged[1 - value][step - 1] - unchanged[1 - value][step];
                let (before, lasting) = (&entries[1 - value][1..step], &lasting[1 - value]);
                let again: f64 = before
                    .iter()
                    .enumerate()
                    .map(|(at, entered)| entered * (lasting[step - at - 2] - lasting[step - at - 1]))
                    .sum();
                entries[value][step] = left + again;
            }
            let stayed: f64 =
                entries[1][1..=step].iter().enumerate().map(|(at, entered)| entered * lasting[1][step - at]).sum();
            ones.push((unchanged[1][step] + stayed).clamp(0.0, 1.0));
        }
        Curve { step_secs, ones }
    }

    /// The probability at a lead time; `None` beyond the end of the curve.
    fn at(&self, lead_secs: f64) -> Option<f64> {
        let place = lead_secs / self.step_secs;
        let step = place as usize;
        let (before, after) = (self.ones.get(step)?, self.ones.get(step + 1)?);
        Some(before + (after - before) * (place - step as f64))
    }

    fn at_or_end(&self, lead_secs: f64) -> f64 {
        self.at(lead_secs).unwrap_or_else(|| self.ones.last().copied().unwrap_or(0.5))
    }
}
