//! Expectation-maximisation of the rates of change.
//!
//! Invariant: after each step every row of rates is positive and sums to 1 (to 1e-9).

use super::{Presence, condition, normalise};
use crate::special::square;

impl Presence {
    /// The probabilities in each kept slot, from the observations up to that slot.
    pub(super) fn filtered(&self) -> Vec<Vec<f64>> {
        let mut beliefs: Vec<Vec<f64>> = Vec::with_capacity(self.history.len());
        for slot in &self.history {
            let mut belief = match beliefs.last() {
                Some(before) => self.stepped(before, slot.of_day),
                None => self.initial.clone(),
            };
            if let Some(observation) = slot.observation {
                condition(&mut belief, observation);
            }
            beliefs.push(belief);
        }
        beliefs
    }

    /// Makes one step: computes the expected number of changes at each time of day with the present rates, then the
    /// rates from those numbers.
    pub(super) fn improve(&mut self) {
        let counts = self.expected_changes();
        let (places, slots) = (self.options.places, self.options.slots_per_day);
        let size = places * places;
        let prior = self.options.prior_slots;

        let mut all = vec![0.0; size];
        for of_slot in counts.chunks(size) {
            add(&mut all, of_slot, 1.0);
        }
        // The prior of a place without data: staying is as likely as leaving; the destination follows the usual places.
        let mut usual: Vec<f64> =
            (0..places).map(|to| 1.0 + all.iter().skip(to).step_by(places).sum::<f64>()).collect();
        normalise(&mut usual);
        for (from, row) in all.chunks_mut(places).enumerate() {
            for (to, (rate, usual)) in row.iter_mut().zip(&usual).enumerate() {
                *rate += prior * 0.5 * (usual + if from == to { 1.0 } else { 0.0 });
            }
            normalise(row);
        }
        let kernel = kernel(self.options.smoothing_slots, slots);
        for (slot, rates) in self.transitions.chunks_mut(size).enumerate() {
            rates.copy_from_slice(&all);
            rates.iter_mut().for_each(|rate| *rate *= prior);
            for (distance, &weight) in kernel.iter().enumerate() {
                let after = (slot + distance) % slots;
                add(rates, &counts[after * size..][..size], weight);
                if distance > 0 {
                    let before = (slot + slots - distance) % slots;
                    add(rates, &counts[before * size..][..size], weight);
                }
            }
            rates.chunks_mut(places).for_each(normalise);
        }
    }

    /// The expected number of changes by slot of the day, then by place before and place after, staying included
    /// (forward-backward algorithm).
    pub(super) fn expected_changes(&self) -> Vec<f64> {
        let places = self.options.places;
        let size = places * places;
        let forward = self.filtered();
        let mut counts = vec![0.0; self.options.slots_per_day * size];
        // The likelihood of the following observations for each place, up to a common factor.
        let mut backward = vec![1.0; places];
        let mut joint = vec![0.0; size];
        for (slot, before) in self.history.iter().skip(1).zip(&forward).rev() {
            if let Some(observation) = slot.observation {
                condition(&mut backward, observation);
            }
            let rates = self.transitions_into(slot.of_day);
            let mut explained = Vec::with_capacity(places);
            for ((joint, rates), &before) in joint.chunks_mut(places).zip(rates.chunks(places)).zip(before) {
                let mut of_place = 0.0;
                for ((joint, &rate), &after) in joint.iter_mut().zip(rates).zip(&backward) {
                    of_place += rate * after;
                    *joint = before * rate * after;
                }
                explained.push(of_place);
            }
            let total: f64 = joint.iter().sum();
            if total > 0.0 {
                add(&mut counts[slot.of_day * size..][..size], &joint, 1.0 / total);
            }
            backward = explained;
            normalise(&mut backward);
        }
        counts
    }
}

fn add(sums: &mut [f64], terms: &[f64], weight: f64) {
    for (sum, term) in sums.iter_mut().zip(terms) {
        *sum += weight * term;
    }
}

/// Weights by distance in slots: up to three standard deviations, and up to half the circle.
fn kernel(width_slots: f64, slots: usize) -> Vec<f64> {
    let reach = ((3.0 * width_slots).ceil() as usize).min((slots - 1) / 2);
    let weight =
        |distance: usize| if distance == 0 { 1.0 } else { libm::exp(-0.5 * square(distance as f64 / width_slots)) };
    (0..=reach).map(weight).collect()
}
