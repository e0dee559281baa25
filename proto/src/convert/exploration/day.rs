//! Plans of a day: questions and replies.
//!
//! Invariant: checks here need no map; the handler of the request checks how long the day is, and what the map has.

use tidemap_map::name::StateName;
use tidemap_model::{LocalDay, selector::ModelSelector};
use tidemap_plan::{
    day::DayRow,
    information::LookWorth,
    strategy::{Budget, Strategy},
    view::{SceneOptions, Sensor, Viewpoint},
};

use super::{
    TourRequest, budget_from_wire, certainty_from_wire, date_from_wire, measure_from_wire, scene_from_wire,
    sensor_from_wire, slot_from_wire, strategy_from_wire, tour_from_wire, viewpoint_from_wire,
};
use crate::{
    convert::{
        InvalidField,
        query::{check_for_cells, selector_from_wire},
        site::location_names_from_wire,
        time::nanos_from_timestamp,
    },
    v1,
};

/// The targets that the visits of a day observe.
#[derive(Clone, Debug, PartialEq)]
pub enum DayTargets {
    /// Locations, or all of the map if none are named.
    Locations(Vec<StateName>),
    /// Locations, or all of the map if none are named, of which exactly one holds the person or object.
    ExactlyOne(Vec<StateName>),
    /// Views from viewpoints.
    Views {
        /// The viewpoints, at least one.
        viewpoints: Vec<Viewpoint>,
        /// The sensor of the robot.
        sensor: Sensor,
        /// How views are computed from predictions.
        scene: SceneOptions,
    },
    /// A whole tour in each slot.
    Tour(TourRequest),
}

/// The question of a request for a day.
#[derive(Clone, Debug, PartialEq)]
pub struct DayQuestion {
    /// The local day.
    pub day: LocalDay,
    /// Length of a slot, nanoseconds.
    pub slot_nanos: i64,
    /// Number of slots to use.
    pub budget: Budget,
    /// How the slots are selected.
    pub strategy: Strategy,
    /// The model; one that cells have, for views and tours.
    pub selector: ModelSelector,
    /// The worth of an observation of a state.
    pub worth: LookWorth,
    /// Weight of information against the task, 0 to 1; 1: there is no task.
    pub exploration_weight: f64,
    /// The state of the task at each target; empty without a task.
    pub task_states: Vec<String>,
    /// The targets that the visits observe.
    pub targets: DayTargets,
    /// Seed of what is random.
    pub seed: u64,
    /// Whether and how the tasks of the map are planned first.
    pub tasks: Option<DayTasks>,
}

/// How the tasks of a day are planned.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DayTasks {
    /// The local day.
    pub day: LocalDay,
    /// Name of the node where the robot is at first; `None`: that of the charger.
    pub start_node: Option<String>,
    /// Time from which on the robot is ready, nanoseconds UTC; `None`: from the beginning of the day.
    pub ready_nanos: Option<i64>,
}

fn tasks_from_wire(request: &v1::PlanDayRequest, day: LocalDay) -> Result<Option<DayTasks>, InvalidField> {
    let start_node = (!request.start_node.is_empty()).then(|| request.start_node.clone());
    let ready_nanos = request.ready_time.map(|time| nanos_from_timestamp("ready_time", time)).transpose()?;
    let alone = [("start_node", start_node.is_some()), ("ready_time", ready_nanos.is_some())];
    match alone.into_iter().find(|(_, is_given)| *is_given && !request.tasks) {
        Some((field, _)) => Err(InvalidField::new(field, "it is used only with tasks")),
        None => Ok(request.tasks.then_some(DayTasks { day, start_node, ready_nanos })),
    }
}

/// The question of a request for a day.
///
/// # Errors
/// The invalid field.
pub fn day_from_wire(request: v1::PlanDayRequest) -> Result<DayQuestion, InvalidField> {
    let day = date_from_wire("date", &request.date)?;
    let slot_nanos = slot_from_wire(request.slot)?;
    let (budget, strategy) = (budget_from_wire(request.budget), strategy_from_wire("strategy", request.strategy)?);
    let selector = selector_from_wire("model", request.model)?;
    let is_counted = !request.exactly_one && request.viewpoints.is_empty() && request.tour.is_none();
    let worth = LookWorth {
        certainty: certainty_from_wire("certainty", request.certainty)?,
        measure: measure_from_wire("information", request.information, is_counted)?,
    };
    let exploration_weight = request.exploration_weight.unwrap_or(1.0);
    if !(0.0..=1.0).contains(&exploration_weight) {
        let text = format!("{exploration_weight} is not between 0 and 1");
        return Err(InvalidField::new("exploration_weight", text));
    }
    let tasks = tasks_from_wire(&request, day)?;
    let (targets, task_states, seed) = (targets_from_wire(&request, selector)?, request.task_states, request.seed);
    if exploration_weight >= 1.0 && !task_states.is_empty() {
        let text = "they are used only with an exploration_weight below 1";
        return Err(InvalidField::new("task_states", text));
    }
    Ok(DayQuestion {
        day,
        slot_nanos,
        budget,
        strategy,
        selector,
        worth,
        exploration_weight,
        task_states,
        targets,
        seed,
        tasks,
    })
}

fn targets_from_wire(request: &v1::PlanDayRequest, selector: ModelSelector) -> Result<DayTargets, InvalidField> {
    let v1::PlanDayRequest { locations, viewpoints, tour, model, task_states, .. } = request;
    let is_plain = model.is_none() && viewpoints.is_empty() && tour.is_none();
    if request.exactly_one && !(is_plain && task_states.is_empty()) {
        let text = "it is a model of locations: leave out model, viewpoints, tour and task_states";
        return Err(InvalidField::new("exactly_one", text));
    }
    if let Some(tour) = tour {
        if !(locations.is_empty() && viewpoints.is_empty()) {
            return Err(InvalidField::new("tour", "request tours, locations or viewpoints, not several of them"));
        }
        check_for_cells("model", selector)?;
        let tour = v1::PlanTourRequest { certainty: request.certainty, ..tour.clone() };
        return Ok(DayTargets::Tour(tour_from_wire(&tour)?));
    }
    if !viewpoints.is_empty() {
        if !locations.is_empty() {
            return Err(InvalidField::new("locations", "request locations or viewpoints, not both"));
        }
        check_for_cells("model", selector)?;
        let viewpoints = viewpoints.iter().map(viewpoint_from_wire).collect();
        let scene = scene_from_wire(request.certainty, None)?;
        return Ok(DayTargets::Views { viewpoints, sensor: sensor_from_wire(request.sensor), scene });
    }
    let locations = location_names_from_wire("locations", locations)?;
    Ok(if request.exactly_one { DayTargets::ExactlyOne(locations) } else { DayTargets::Locations(locations) })
}

/// A day's plan for the wire. `names`: names of the locations, by index.
#[must_use]
pub fn day_to_wire(rows: &[DayRow], names: &[String]) -> v1::PlanDayResponse {
    let slot = |row: &DayRow| v1::DaySlot {
        start_nanos: row.start_nanos,
        location: row.location.and_then(|index| names.get(index).cloned()).unwrap_or_default(),
        information_bits: row.information_bits,
    };
    let explored = rows.iter().filter(|row| row.location.is_some()).count();
    v1::PlanDayResponse {
        slots: rows.iter().map(slot).collect(),
        explored: u32::try_from(explored).unwrap_or(u32::MAX),
        ..v1::PlanDayResponse::default()
    }
}

#[cfg(test)]
mod tests {
    use tidemap_model::InformationMeasure;

    use super::*;

    fn request() -> v1::PlanDayRequest {
        v1::PlanDayRequest { date: "2016-03-21".to_owned(), ..v1::PlanDayRequest::default() }
    }

    #[test]
    fn a_plain_day_is_of_all_locations() {
        let question = day_from_wire(request()).expect("right");
        assert_eq!(question.targets, DayTargets::Locations(Vec::new()));
        assert_eq!((question.exploration_weight, question.strategy), (1.0, Strategy::MonteCarlo));
        assert_eq!(question.worth.measure, InformationMeasure::RaL);
        let information = v1::InformationMeasure::Both.into();
        let both = day_from_wire(v1::PlanDayRequest { information, ..request() }).expect("right");
        assert_eq!(both.worth.measure, InformationMeasure::Both);
        let one = day_from_wire(v1::PlanDayRequest { exactly_one: true, ..request() }).expect("right");
        assert_eq!(one.targets, DayTargets::ExactlyOne(Vec::new()));
    }

    #[test]
    fn targets_that_exclude_each_other_are_named() {
        let field = |request| day_from_wire(request).expect_err("wrong").field;
        let locations = vec!["hall".to_owned()];
        let viewpoints = vec![v1::Viewpoint::default()];
        let tour = Some(v1::PlanTourRequest::default());
        let both = v1::PlanDayRequest { locations: locations.clone(), viewpoints: viewpoints.clone(), ..request() };
        assert_eq!(field(both), "locations");
        assert_eq!(field(v1::PlanDayRequest { locations, tour: tour.clone(), ..request() }), "tour");
        assert_eq!(field(v1::PlanDayRequest { exactly_one: true, viewpoints, ..request() }), "exactly_one");
        assert_eq!(field(v1::PlanDayRequest { exactly_one: true, tour, ..request() }), "exactly_one");
        let information = v1::InformationMeasure::Both.into();
        let views = vec![v1::Viewpoint::default()];
        assert_eq!(field(v1::PlanDayRequest { viewpoints: views, information, ..request() }), "information");
        assert_eq!(field(v1::PlanDayRequest { information: 9, ..request() }), "information");
        let task_states = vec!["door".to_owned()];
        assert_eq!(field(v1::PlanDayRequest { task_states, ..request() }), "task_states");
        assert_eq!(field(v1::PlanDayRequest { exploration_weight: Some(1.5), ..request() }), "exploration_weight");
        assert_eq!(field(v1::PlanDayRequest { date: String::new(), ..request() }), "date");
        assert_eq!(field(v1::PlanDayRequest { start_node: "hall".to_owned(), ..request() }), "start_node");
    }
}
