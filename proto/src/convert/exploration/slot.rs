//! Plans of one slot: questions.
//!
//! Invariant: checks here need no map; the handler of the request checks whether the planned location is one of the
//! given ones.

use tidemap_map::name::StateName;
use tidemap_model::selector::{Blend, ModelSelector};
use tidemap_plan::{information::LookWorth, strategy::Budget};

use super::{allowance_from_wire, certainty_from_wire, measure_from_wire, slot_from_wire};
use crate::{
    convert::{InvalidField, query::selector_from_wire, site::location_names_from_wire, time::instant_from_wire},
    v1,
};

/// How the location of a slot is chosen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LocationChoice {
    /// The location with the most information.
    Information,
    /// The location whose models have the greatest expected error.
    Error,
    /// The planned location, unless another one is far more surprising.
    Novelty {
        /// Name of the planned location.
        planned: String,
    },
    /// At random, in proportion to the information.
    MonteCarlo,
}

/// The visits that a day allows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlotAllowance {
    /// Visits of the whole day.
    pub budget: Budget,
    /// Visits already made.
    pub spent: usize,
}

/// The models of a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SlotModels {
    /// The model of states.
    pub states: ModelSelector,
    /// The model of cells.
    pub cells: ModelSelector,
}

impl SlotModels {
    /// The models of a request that names none.
    fn usual(is_novelty: bool) -> SlotModels {
        let auto = ModelSelector::default();
        match is_novelty {
            // The plan of the day is compared with what was observed since, which must not be in it.
            true => SlotModels { states: auto.long_term(), cells: auto },
            // A cell that was just seen gives little information; its default model has no newest value.
            false => SlotModels { states: auto, cells: ModelSelector { blend: Blend::Persistence, ..auto } },
        }
    }
}

/// The question of a request for a slot.
#[derive(Clone, Debug, PartialEq)]
pub struct SlotQuestion {
    /// Beginning of the slot, nanoseconds UTC.
    pub time_nanos: i64,
    /// Length of the day's slots, nanoseconds.
    pub slot_nanos: i64,
    /// How the location is chosen.
    pub choice: LocationChoice,
    /// The models that predict.
    pub models: SlotModels,
    /// Whether exactly one location holds the person or object, which replaces the model.
    pub exactly_one: bool,
    /// The worth of an observation of a state.
    pub worth: LookWorth,
    /// Locations to choose from; empty: all of the map.
    pub locations: Vec<StateName>,
    /// `None`: every slot may be used.
    pub allowance: Option<SlotAllowance>,
    /// Seed of what is random.
    pub seed: u64,
}

/// The question of a request for a slot.
///
/// # Errors
/// The invalid field.
pub fn slot_question_from_wire(request: v1::PlanSlotRequest) -> Result<SlotQuestion, InvalidField> {
    let time_nanos = instant_from_wire("time", request.time)?;
    let unknown = |_| InvalidField::new("strategy", format!("{} is not known", request.strategy));
    let strategy = v1::SlotStrategy::try_from(request.strategy).map_err(unknown)?;
    let is_novelty = strategy == v1::SlotStrategy::Novelty;
    let models = match request.model {
        None => SlotModels::usual(is_novelty),
        model => {
            let selector = selector_from_wire("model", model)?;
            SlotModels { states: selector, cells: selector }
        }
    };
    if request.exactly_one && request.model.is_some() {
        return Err(InvalidField::new("exactly_one", "it is a model itself: leave out model"));
    }
    let worth = LookWorth {
        certainty: certainty_from_wire("certainty", request.certainty)?,
        measure: measure_from_wire("information", request.information, !request.exactly_one)?,
    };
    if !is_novelty && !request.planned.is_empty() {
        return Err(InvalidField::new("planned", "`planned` needs strategy NOVELTY: leave it empty"));
    }
    let allowance = allowance_of(&request, strategy)?;
    Ok(SlotQuestion {
        time_nanos,
        slot_nanos: slot_from_wire(request.slot)?,
        choice: match strategy {
            v1::SlotStrategy::Unspecified | v1::SlotStrategy::Online => LocationChoice::Information,
            v1::SlotStrategy::OnlineError => LocationChoice::Error,
            v1::SlotStrategy::MonteCarlo => LocationChoice::MonteCarlo,
            v1::SlotStrategy::Novelty => LocationChoice::Novelty { planned: request.planned },
        },
        models,
        exactly_one: request.exactly_one,
        worth,
        locations: location_names_from_wire("locations", &request.locations)?,
        allowance,
        seed: request.seed,
    })
}

/// The location to explore in a slot.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedSlot {
    /// Name of the location.
    pub location: String,
    /// The expected information of an observation there, bits.
    pub information_bits: f64,
    /// The surprise of what was observed there, bits; 0 unless the location was chosen by it.
    pub surprise_bits: f64,
}

/// The location to explore in a slot for the wire; `None`: the robot rests.
#[must_use]
pub fn planned_slot_to_wire(planned: Option<PlannedSlot>) -> v1::PlanSlotResponse {
    let slot = |PlannedSlot { location, information_bits, surprise_bits }| v1::PlanSlotResponse {
        location,
        information_bits,
        surprise_bits,
    };
    planned.map_or_else(v1::PlanSlotResponse::default, slot)
}

fn allowance_of(
    request: &v1::PlanSlotRequest,
    strategy: v1::SlotStrategy,
) -> Result<Option<SlotAllowance>, InvalidField> {
    match allowance_from_wire(request.allowance) {
        None if request.spent > 0 || (request.slot.is_some() && !request.exactly_one) => {
            let text = "spent and slot are used only with an allowance: give explore or ratio";
            Err(InvalidField::new("allowance", text))
        }
        None => Ok(None),
        Some(_) if !matches!(strategy, v1::SlotStrategy::Online | v1::SlotStrategy::OnlineError) => {
            let text = "only the strategies online and online-error go by an allowance";
            Err(InvalidField::new("allowance", text))
        }
        Some(budget) => Ok(Some(SlotAllowance { budget, spent: request.spent as usize })),
    }
}

#[cfg(test)]
mod tests {
    use tidemap_model::InformationMeasure;

    use super::*;
    use crate::convert::time::timestamp;

    fn request(strategy: v1::SlotStrategy) -> v1::PlanSlotRequest {
        v1::PlanSlotRequest { time: Some(timestamp(5)), strategy: strategy.into(), ..v1::PlanSlotRequest::default() }
    }

    #[test]
    fn a_plain_slot_goes_by_information_with_the_newest_readings() {
        let question = slot_question_from_wire(request(v1::SlotStrategy::Unspecified)).expect("right");
        assert_eq!(question.choice, LocationChoice::Information);
        assert!(question.models.states.knows_newest() && question.models.cells.is_blended());
        assert!(question.allowance.is_none() && question.locations.is_empty());
        assert_eq!(question.worth.measure, InformationMeasure::RaL);
        let information = v1::InformationMeasure::Both.into();
        let both = v1::PlanSlotRequest { information, ..request(v1::SlotStrategy::Unspecified) };
        assert_eq!(slot_question_from_wire(both).expect("right").worth.measure, InformationMeasure::Both);
        let novel = v1::PlanSlotRequest { planned: "hall".to_owned(), ..request(v1::SlotStrategy::Novelty) };
        let novel = slot_question_from_wire(novel).expect("right");
        assert_eq!(novel.choice, LocationChoice::Novelty { planned: "hall".to_owned() });
        let SlotModels { states, cells } = novel.models;
        assert!(!states.knows_newest() && !states.is_blended() && !cells.is_blended());
    }

    #[test]
    fn what_does_not_go_together_is_named() {
        use v1::{SlotStrategy::*, plan_slot_request::Allowance};
        let field = |request| slot_question_from_wire(request).expect_err("wrong").field;
        let model = Some(v1::ModelSelector::default());
        assert_eq!(field(v1::PlanSlotRequest { time: None, ..request(Online) }), "time");
        assert_eq!(field(v1::PlanSlotRequest { strategy: 99, ..request(Online) }), "strategy");
        assert_eq!(field(v1::PlanSlotRequest { exactly_one: true, model, ..request(Online) }), "exactly_one");
        assert_eq!(field(v1::PlanSlotRequest { planned: "hall".to_owned(), ..request(Online) }), "planned");
        assert_eq!(field(v1::PlanSlotRequest { spent: 1, ..request(Online) }), "allowance");
        assert_eq!(field(v1::PlanSlotRequest { information: 9, ..request(Online) }), "information");
        let information = v1::InformationMeasure::Learn.into();
        assert_eq!(field(v1::PlanSlotRequest { exactly_one: true, information, ..request(Online) }), "information");
        let allowance = Some(Allowance::Explore(3));
        assert_eq!(field(v1::PlanSlotRequest { allowance, ..request(MonteCarlo) }), "allowance");
        assert!(slot_question_from_wire(v1::PlanSlotRequest { allowance, ..request(OnlineError) }).is_ok());
    }
}
