//! Presence: the place, out of several, where a person or an object is now.
//!
//! Models of single states are independent of each other. If exactly one state is 1 at a time, as with one person in
//! the rooms of a flat, observing one room informs about all: a person in the kitchen is not in the bedroom, and a
//! person who is not in the kitchen is more likely in the bedroom. This model is a hidden Markov chain over the places,
//! in steps of a slot of the day, whose rates of change depend on the time of the day. It is trained on observations of
//! one place at a time by expectation-maximisation (L. Baum et al., "A maximization technique occurring in the
//! statistical analysis of probabilistic functions of Markov chains", 1970). Invariant: the probabilities of all places
//! are in `[0,1]` and sum to 1 (to 1e-9); the history is bounded.

use std::collections::VecDeque;

use super::CannotTrain;

mod learning;

#[cfg(test)]
mod tests;

/// Maximum number of slots of history; older slots are forgotten. It is one and a half years of slots of ten minutes.
const HISTORY_MAX: usize = 80_000;

/// The options of a [`Presence`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PresenceOptions {
    /// Number of places, 2 to [`PresenceOptions::PLACES_MAX`].
    pub places: usize,
    /// Slots of a day, 1 to [`PresenceOptions::SLOTS_MAX`].
    pub slots_per_day: usize,
    /// Standard deviation of the circular Gaussian that smooths the rates of change over the time of day, in slots, 0
    /// to a quarter of the slots of a day.
    pub smoothing_slots: f64,
    /// The weight, in slots, of the rates over all times of day as prior of each time of day, and of the prior of these
    /// rates; above 0 to 1e6.
    pub prior_slots: f64,
    /// Steps of expectation-maximisation in each call of [`Presence::learn`], 1 to 100; each continues from the
    /// previous result.
    pub steps: usize,
}

impl PresenceOptions {
    /// The maximum number of places.
    pub const PLACES_MAX: usize = 64;
    /// The maximum number of slots of a day: one a minute.
    pub(crate) const SLOTS_MAX: usize = 1440;

    /// Defaults for the given numbers of places and slots: rates are smoothed over an hour, and shrunk with a weight of
    /// five slots.
    pub fn new(places: usize, slots_per_day: usize) -> PresenceOptions {
        PresenceOptions {
            places,
            slots_per_day,
            smoothing_slots: slots_per_day as f64 / 24.0,
            prior_slots: 5.0,
            steps: 3,
        }
    }

    fn check(&self) -> Result<(), CannotTrain> {
        let wrong = |parameter, found, expected| Err(CannotTrain::Parameter { parameter, found, expected });
        if !(2..=Self::PLACES_MAX).contains(&self.places) {
            return wrong("places", self.places as f64, "2 to 64");
        }
        if !(1..=Self::SLOTS_MAX).contains(&self.slots_per_day) {
            return wrong("slots of a day", self.slots_per_day as f64, "1 to 1440");
        }
        if !(0.0..=self.slots_per_day as f64 / 4.0).contains(&self.smoothing_slots) {
            return wrong("smoothing width in slots", self.smoothing_slots, "0 to a quarter of the slots of a day");
        }
        if !(f64::MIN_POSITIVE..=1e6).contains(&self.prior_slots) {
            return wrong("prior slots", self.prior_slots, "a number above 0, at most 1e6");
        }
        if !(1..=100).contains(&self.steps) {
            return wrong("steps", self.steps as f64, "1 to 100");
        }
        Ok(())
    }
}

/// One observation of one place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct PresenceObservation {
    place: usize,
    there: bool,
}

/// A past slot or the present one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct PresenceSlot {
    of_day: usize,
    observation: Option<PresenceObservation>,
}

/// The place of a person or object, from observations of one place at a time; see the module's head.
///
/// Time advances slot by slot: [`Presence::advance`], then at most one [`Presence::observe`]. [`Presence::learn`]
/// learns the rates of change from all observations so far; between two calls the rates are constant.
#[derive(Clone, Debug, PartialEq)]
pub struct Presence {
    options: PresenceOptions,
    /// For each slot of the day: the probability of each place, for each place of the slot before.
    transitions: Vec<f64>,
    history: VecDeque<PresenceSlot>,
    /// The probabilities in the first slot that is kept, before its observation.
    initial: Vec<f64>,
    /// The probabilities in the present slot.
    belief: Vec<f64>,
}

impl Presence {
    /// An untrained model: all places are equally likely, and staying is as likely as leaving.
    ///
    /// # Errors
    /// [`CannotTrain`] where an option is outside its range.
    pub fn new(options: PresenceOptions) -> Result<Presence, CannotTrain> {
        options.check()?;
        let places = options.places;
        let anywhere = 1.0 / places as f64;
        let mut transitions = vec![0.5 * anywhere; options.slots_per_day * places * places];
        for (at, transition) in transitions.iter_mut().enumerate() {
            if at / places % places == at % places {
                *transition += 0.5;
            }
        }
        let anywhere = vec![anywhere; places];
        let (initial, belief) = (anywhere.clone(), anywhere);
        Ok(Presence { options, transitions, history: VecDeque::new(), initial, belief })
    }

    /// Advances to the next slot, `slot_of_day`; numbers beyond the day wrap around. A day may repeat or skip slots,
    /// for example when the clocks change.
    pub fn advance(&mut self, slot_of_day: usize) {
        let of_day = slot_of_day % self.options.slots_per_day;
        if !self.history.is_empty() {
            self.belief = self.stepped(&self.belief, of_day);
        }
        self.history.push_back(PresenceSlot { of_day, observation: None });
        if self.history.len() > HISTORY_MAX {
            self.forget_first();
        }
    }

    /// Adds an observation of one place in the present slot. A second one in the same slot updates the probabilities,
    /// but only the last is learned. An unknown place, or an observation before the first slot, changes nothing.
    pub fn observe(&mut self, place: usize, there: bool) {
        if place >= self.options.places {
            return;
        }
        if let Some(slot) = self.history.back_mut() {
            let observation = PresenceObservation { place, there };
            slot.observation = Some(observation);
            condition(&mut self.belief, observation);
        }
    }

    /// The probability of each place in the present slot, from all observations so far.
    pub fn probabilities(&self) -> &[f64] {
        &self.belief
    }

    /// The probability of each place in each of the following slots, given by their numbers in the day, without further
    /// observations.
    pub fn forecast(&self, slots_of_day: impl IntoIterator<Item = usize>) -> Vec<Vec<f64>> {
        let mut belief = self.belief.clone();
        let on = |slot: usize| {
            belief = self.stepped(&belief, slot % self.options.slots_per_day);
            belief.clone()
        };
        slots_of_day.into_iter().map(on).collect()
    }

    /// Learns the rates of change from all kept observations, and recomputes the present probabilities. Takes time
    /// proportional to the number of kept slots times the square of the number of places.
    pub fn learn(&mut self) {
        for _ in 0..self.options.steps {
            self.improve();
        }
        if let Some(belief) = self.filtered().pop() {
            self.belief = belief;
        }
    }

    /// The rates into the slot of a day: one row for each place in the slot before.
    fn transitions_into(&self, slot_of_day: usize) -> &[f64] {
        let size = self.options.places * self.options.places;
        &self.transitions[slot_of_day * size..(slot_of_day + 1) * size]
    }

    fn stepped(&self, belief: &[f64], slot_of_day: usize) -> Vec<f64> {
        let mut next = vec![0.0; belief.len()];
        for (&before, row) in belief.iter().zip(self.transitions_into(slot_of_day).chunks(belief.len())) {
            for (next, &rate) in next.iter_mut().zip(row) {
                *next += before * rate;
            }
        }
        normalise(&mut next);
        next
    }

    /// Forgets the oldest slot; the initial probabilities of the next slot keep its information.
    fn forget_first(&mut self) {
        if let Some(slot) = self.history.pop_front() {
            if let Some(observation) = slot.observation {
                condition(&mut self.initial, observation);
            }
            if let Some(second) = self.history.front() {
                self.initial = self.stepped(&self.initial, second.of_day);
            }
        }
    }
}

/// Updates the probabilities by an observation. An observation that contradicts them replaces them.
fn condition(belief: &mut [f64], observation: PresenceObservation) {
    for (place, p) in belief.iter_mut().enumerate() {
        if (place == observation.place) != observation.there {
            *p = 0.0;
        }
    }
    let total: f64 = belief.iter().sum();
    if total < f64::MIN_POSITIVE {
        for (place, p) in belief.iter_mut().enumerate() {
            *p = if (place == observation.place) == observation.there { 1.0 } else { 0.0 };
        }
    }
    normalise(belief);
}

fn normalise(values: &mut [f64]) {
    let total: f64 = values.iter().sum();
    if total > 0.0 {
        values.iter_mut().for_each(|value| *value /= total);
        // The check excludes numbers so small that they have lost digits.
        debug_assert!(
            total < f64::MIN_POSITIVE || (values.iter().sum::<f64>() - 1.0).abs() < 1e-9,
            "probabilities sum to 1: {values:?}"
        );
    }
}
