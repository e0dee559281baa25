//! The explorer's knowledge of the places: a model that learns from visits.
//!
//! Invariant: a probability for a slot uses earlier observations only, and the model of the last midnight.

use tidemap_model::{
    Sample,
    catalogue::ModelKind,
    models::{CannotTrain, MarkovChain, Moment, Presence, PresenceOptions, Readings, TemporalModel},
    selector::Blend,
};

mod learner;

use learner::{Learner, SHORT_TERM, kinds};

/// A model of the places.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BeliefModel {
    /// Every place separately, by a model of one state; [`Blend::Memory`] is by the rates of the short-term memory's
    /// chain, with the model's p(t) for the chain's constant (RAS 2017, eq. 6).
    #[allow(missing_docs, reason = "see the types")]
    Each { kind: ModelKind, blend: Blend },
    /// A model of all places together: the person is at exactly one of them.
    Presence,
}

impl BeliefModel {
    /// All models, in the order of the documentation.
    pub fn all() -> impl Iterator<Item = BeliefModel> {
        let plain = kinds().map(|kind| BeliefModel::Each { kind, blend: Blend::None });
        let blended = [Blend::Persistence, Blend::Memory].into_iter().flat_map(|blend| {
            let kinds = kinds().filter(|&kind| kind != SHORT_TERM);
            kinds.map(move |kind| BeliefModel::Each { kind, blend })
        });
        plain.chain(blended).chain([BeliefModel::Presence])
    }

    /// The name of the model in protocols.
    pub fn name(self) -> String {
        match self {
            BeliefModel::Each { kind, blend } => format!("{}{}", kind.name(), blend.suffix()),
            BeliefModel::Presence => "presence".to_owned(),
        }
    }
}

/// The slots of the world.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slots {
    /// Number of slots in a day.
    pub per_day: usize,
    /// Length of a slot.
    pub nanos: i64,
}

impl Slots {
    /// The middle of a slot; slots are counted from the start of the world, 1970-01-01T00:00, a Thursday.
    pub(super) fn middle(self, slot: usize) -> Moment {
        Moment { utc_nanos: slot as i64 * self.nanos + self.nanos / 2, offset_secs: 0 }
    }
}

/// The knowledge of all places.
pub(super) struct Belief {
    slots: Slots,
    /// The current slot; none before the first.
    now: Option<usize>,
    places: Vec<PlaceBelief>,
    presence: Option<Presence>,
    blend: Blend,
    remembers: bool,
}

/// The knowledge of one place.
struct PlaceBelief {
    learner: Learner,
    readings: Vec<Sample>,
    persistence: tidemap_model::Persistence,
    /// The short-term memory of RAS 2017, section 4.2, if it is used.
    chain: Option<MarkovChain>,
    /// The predictions of the model for each slot of the current day.
    today: Vec<Known>,
}

/// The prediction for a place at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Known {
    /// The probability that the person is there.
    pub probability: f64,
    /// The effective number of half-hour bins behind the probability; `None` if the model does not count them.
    pub looks: Option<f64>,
}

impl Default for Known {
    /// The prediction before any observation.
    fn default() -> Known {
        Known { probability: 0.5, looks: Some(0.0) }
    }
}

impl Belief {
    /// An untrained model; `remembers` adds a short-term memory.
    pub(super) fn new(model: BeliefModel, places: usize, slots: Slots, remembers: bool) -> Result<Belief, CannotTrain> {
        let (kind, blend) = match model {
            BeliefModel::Each { kind, blend } => (kind, blend),
            BeliefModel::Presence => (ModelKind::Mean, Blend::None),
        };
        let presence = match model {
            BeliefModel::Presence => Some(Presence::new(PresenceOptions::new(places, slots.per_day))?),
            BeliefModel::Each { .. } => None,
        };
        let place = || PlaceBelief {
            learner: Learner::new(kind),
            readings: Vec::new(),
            persistence: tidemap_model::Persistence::default(),
            chain: None,
            today: vec![Known::default(); slots.per_day],
        };
        let remembers = remembers || kind == SHORT_TERM || blend == Blend::Memory;
        let places = (0..places).map(|_| place()).collect();
        Ok(Belief { slots, now: None, places, presence, blend, remembers })
    }

    /// Trains the models for the day that starts with a slot.
    pub(super) fn midnight(&mut self, slot: usize) -> Result<(), CannotTrain> {
        if let Some(presence) = &mut self.presence {
            presence.learn();
        }
        for place in &mut self.places {
            if self.presence.is_none() {
                place.learner.learn(&place.readings)?;
                let middles: Vec<Moment> =
                    (slot..slot + self.slots.per_day).map(|slot| self.slots.middle(slot)).collect();
                place.today = place.learner.known(&middles);
            }
            if self.remembers && !place.readings.is_empty() {
                place.chain = Some(MarkovChain::train(Readings::new(&place.readings))?);
            }
        }
        Ok(())
    }

    /// Enters a slot; slots must be entered in order.
    pub(super) fn enter(&mut self, slot: usize) {
        self.now = Some(slot);
        if let Some(presence) = &mut self.presence {
            presence.advance(slot % self.slots.per_day);
        }
    }

    /// The predictions for all places at the middle of the current slot.
    pub(super) fn now(&self) -> Vec<Known> {
        let Some(slot) = self.now else { return vec![Known::default(); self.places.len()] };
        match &self.presence {
            Some(presence) => presence.probabilities().iter().map(together).collect(),
            None => self.places.iter().map(|place| self.each(place, slot)).collect(),
        }
    }

    /// The predictions for all places at the middle of each slot of the day that starts with a slot, before that slot
    /// is entered.
    pub(super) fn ahead(&self, slot: usize) -> Vec<Vec<Known>> {
        match &self.presence {
            Some(presence) => {
                let slots = presence.forecast(0..self.slots.per_day);
                slots.iter().map(|places| places.iter().map(together).collect()).collect()
            }
            None => (slot..slot + self.slots.per_day)
                .map(|slot| self.places.iter().map(|place| self.each(place, slot)).collect())
                .collect(),
        }
    }

    fn each(&self, place: &PlaceBelief, slot: usize) -> Known {
        let at = self.slots.middle(slot);
        let known = place.today.get(slot % self.slots.per_day).copied().unwrap_or_default();
        let p = match (&place.chain, place.learner.kind()) {
            (Some(chain), SHORT_TERM) => chain.predict(at),
            _ => known.probability,
        };
        let probability = match (self.blend, &place.chain, place.readings.last()) {
            (Blend::Persistence, ..) => place.persistence.blend(p, at.utc_nanos),
            (Blend::Memory, Some(chain), Some(last)) => {
                let age_secs = at.utc_nanos.abs_diff(last.utc_nanos) as f64 / 1e9;
                let kept = (-age_secs / chain.memory_secs()).exp();
                last.value * kept + p * (1.0 - kept)
            }
            _ => p,
        };
        Known { probability, ..known }
    }

    /// The predictions of the short-term memory at the middle of the current slot; 0.5 where it has no data.
    pub(super) fn expected(&self) -> Vec<f64> {
        let at = self.slots.middle(self.now.unwrap_or(0));
        self.places.iter().map(|place| place.chain.as_ref().map_or(0.5, |chain| chain.predict(at))).collect()
    }

    /// Learns from a visit at the middle of the current slot.
    pub(super) fn observe(&mut self, place: usize, there: bool) {
        let (Some(slot), Some(known)) = (self.now, self.places.get_mut(place)) else { return };
        let at = self.slots.middle(slot);
        let value = f64::from(u8::from(there));
        known.readings.push(Sample { utc_nanos: at.utc_nanos, offset_secs: at.offset_secs, value });
        known.persistence.observe(at.utc_nanos, value);
        if let Some(chain) = &mut known.chain {
            chain.observe(at.utc_nanos, value);
        }
        if let Some(presence) = &mut self.presence {
            presence.observe(place, there);
        }
    }
}

/// The prediction of the model of all places together for one place.
fn together(&probability: &f64) -> Known {
    Known { probability, looks: None }
}
