//! Exploration: times, sensors, viewpoints, tours, days.
//!
//! Invariant: a zero or absent field has its default; the planner checks the rest.

use tidemap_model::{InformationMeasure, LocalDay, selector::ModelSelector};
use tidemap_plan::{
    day::SLOT_NANOS,
    information::Certainty,
    strategy::{Budget, Strategy},
    tour::{Tour, TourEnd, TourQuestion, TourStep},
    view::{SceneOptions, Sensor, Viewpoint},
};

use super::{
    InvalidField,
    query::{check_for_cells, selector_from_wire},
    site::{point_from_wire, point_to_wire},
    time::{instant_from_wire, nanos_from_duration},
};
use crate::v1;

mod day;
mod information;
mod slot;

pub use day::{DayQuestion, DayTargets, DayTasks, day_from_wire, day_to_wire};
pub use information::{
    InformationQuestion, InformationTargets, TargetInformation, ViewsQuestion, VisitReport, information_from_wire,
    information_to_wire, reachability_to_wire, reached_places_to_wire, view_to_wire, views_from_wire, visit_from_wire,
};
pub use slot::{
    LocationChoice, PlannedSlot, SlotAllowance, SlotModels, SlotQuestion, planned_slot_to_wire, slot_question_from_wire,
};

/// The number, or the default if it is 0.
fn or(value: f64, default: f64) -> f64 {
    if value == 0.0 { default } else { value }
}

/// The certainty that remains after an observation.
///
/// # Errors
/// The certainty is not above 0.5 and below 1.
pub fn certainty_from_wire(field: &str, certainty: Option<f64>) -> Result<Certainty, InvalidField> {
    certainty.map_or_else(|| Ok(Certainty::default()), Certainty::new).map_err(|error| InvalidField::new(field, error))
}

/// A sensor.
#[must_use]
pub fn sensor_from_wire(wire: Option<v1::Sensor>) -> Sensor {
    let (wire, default) = (wire.unwrap_or_default(), Sensor::default());
    Sensor {
        range_m: or(wire.range_m, default.range_m),
        horizontal_fov_rad: or(wire.horizontal_fov_rad, default.horizontal_fov_rad),
        vertical_fov_rad: or(wire.vertical_fov_rad, default.vertical_fov_rad),
        height_m: wire.height_m.unwrap_or(default.height_m),
    }
}

/// A sensor for the wire.
#[must_use]
pub fn sensor_to_wire(sensor: Sensor) -> v1::Sensor {
    let Sensor { range_m, horizontal_fov_rad, vertical_fov_rad, height_m } = sensor;
    v1::Sensor { range_m, horizontal_fov_rad, vertical_fov_rad, height_m: Some(height_m) }
}

/// A viewpoint for the wire.
#[must_use]
pub fn viewpoint_to_wire(viewpoint: &Viewpoint) -> v1::Viewpoint {
    let Viewpoint { x_m, y_m, z_m, yaw_rad } = *viewpoint;
    v1::Viewpoint { x_m, y_m, z_m, yaw_rad }
}

/// A viewpoint.
#[must_use]
pub fn viewpoint_from_wire(wire: &v1::Viewpoint) -> Viewpoint {
    let v1::Viewpoint { x_m, y_m, z_m, yaw_rad } = *wire;
    Viewpoint { x_m, y_m, z_m, yaw_rad }
}

/// How views are computed from predictions.
///
/// # Errors
/// An invalid certainty or threshold.
pub fn scene_from_wire(certainty: Option<f64>, threshold: Option<f64>) -> Result<SceneOptions, InvalidField> {
    let certainty = certainty_from_wire("certainty", certainty)?;
    match threshold.unwrap_or(0.5) {
        threshold if (0.0..=1.0).contains(&threshold) => Ok(SceneOptions { certainty, threshold }),
        wrong => Err(InvalidField::new("threshold", format!("{wrong} is not between 0 and 1"))),
    }
}

/// A tour of a request.
#[derive(Clone, Debug, PartialEq)]
pub struct TourRequest {
    /// Start of the tour: x, y in metres; `None`: at the charger of the map.
    start_m: Option<[f64; 2]>,
    question: TourQuestion,
}

impl TourRequest {
    /// The question of the tour, which starts at the requested place, or else at the charger; `None`: there is neither.
    #[must_use]
    pub fn starting_at(self, charger_m: Option<[f64; 2]>) -> Option<TourQuestion> {
        let start_m = self.start_m.or(charger_m)?;
        Some(TourQuestion { start_m, ..self.question })
    }
}

/// The time (nanoseconds UTC), the model and the tour of a request.
///
/// # Errors
/// The invalid field; what depends on the grid is not checked.
pub fn tour_question_from_wire(
    request: &v1::PlanTourRequest,
) -> Result<(i64, ModelSelector, TourRequest), InvalidField> {
    let time_nanos = instant_from_wire("time", request.time)?;
    let selector = selector_from_wire("model", request.model)?;
    check_for_cells("model", selector)?;
    Ok((time_nanos, selector, tour_from_wire(request)?))
}

/// The tour of a request.
///
/// # Errors
/// The invalid field; what depends on the grid is not checked.
fn tour_from_wire(request: &v1::PlanTourRequest) -> Result<TourRequest, InvalidField> {
    let start_m = request.start.map(|start| point_from_wire("start", start)).transpose()?;
    let default = TourQuestion::default();
    let secs = |field: &str, span: Option<prost_types::Duration>| {
        let nanos = span.map(|span| nanos_from_duration(field, span)).transpose()?;
        Ok::<_, InvalidField>(nanos.map(|nanos| nanos as f64 / 1e9))
    };
    let mut travel = default.travel;
    travel.radius_m = request.robot_radius_m.unwrap_or(travel.radius_m);
    travel.z_max_m = or(request.robot_height_m, travel.z_max_m);
    let question = TourQuestion {
        goals: if request.count == 0 { default.goals } else { request.count as usize },
        spacing_m: or(request.spacing_m, default.spacing_m),
        sensor: sensor_from_wire(request.sensor),
        scene: scene_from_wire(request.certainty, None)?,
        travel,
        end: if request.is_open { TourEnd::LastGoal } else { TourEnd::Start },
        speed_m_per_s: or(request.speed_m_per_s, default.speed_m_per_s),
        observation_secs: secs("observing", request.observing)?.unwrap_or(default.observation_secs),
        budget_secs: secs("budget", request.budget)?,
        ..default
    };
    Ok(TourRequest { start_m, question })
}

/// A tour for the wire.
#[must_use]
pub fn tour_to_wire(tour: &Tour) -> v1::PlanTourResponse {
    let step = |step: &TourStep| v1::TourStep {
        at: Some(point_to_wire(step.at_m)),
        information_bits: step.information_bits,
        reachability: step.reachability,
        arrival_secs: step.arrival_secs,
    };
    v1::PlanTourResponse {
        steps: tour.steps.iter().map(step).collect(),
        length_m: tour.length_m,
        duration_secs: tour.duration_secs,
        information_bits: tour.information_bits,
        expected_bits: tour.expected_bits,
        candidates: u32::try_from(tour.candidates).unwrap_or(u32::MAX),
        reason: tour.no_tour.map_or_else(String::new, |reason| reason.to_string()),
        path: tour.path_m.iter().copied().map(point_to_wire).collect(),
    }
}

/// A tour of a reply; the reason of a tour without goals is in words.
///
/// # Errors
/// A goal without a valid place.
pub fn planned_tour_from_wire(reply: v1::PlanTourResponse) -> Result<Tour<String>, InvalidField> {
    let step = |(i, step): (usize, v1::TourStep)| {
        let v1::TourStep { at, information_bits, reachability, arrival_secs } = step;
        let field = format!("steps[{i}].at");
        let at_m = point_from_wire(&field, at.ok_or_else(|| InvalidField::new(&*field, "it is missing"))?)?;
        Ok(TourStep { at_m, information_bits, reachability, arrival_secs })
    };
    let path_point = |(i, at): (usize, v1::Point)| point_from_wire(&format!("path[{i}]"), at);
    Ok(Tour {
        path_m: reply.path.into_iter().enumerate().map(path_point).collect::<Result<_, _>>()?,
        steps: reply.steps.into_iter().enumerate().map(step).collect::<Result<_, _>>()?,
        information_bits: reply.information_bits,
        expected_bits: reply.expected_bits,
        length_m: reply.length_m,
        duration_secs: reply.duration_secs,
        candidates: reply.candidates as usize,
        no_tour: Some(reply.reason).filter(|reason| !reason.is_empty()),
    })
}

/// A local date.
///
/// # Errors
/// It is not a date, or not written as YYYY-MM-DD.
pub fn date_from_wire(field: &str, date: &str) -> Result<LocalDay, InvalidField> {
    let shown: String = date.chars().take(40).collect();
    LocalDay::parse(date)
        .ok_or_else(|| InvalidField::new(field, format!("{shown:?} is not a date: write it as 2016-03-21")))
}

/// Length of a slot in nanoseconds.
///
/// # Errors
/// The length exceeds i64 nanoseconds.
pub fn slot_from_wire(slot: Option<prost_types::Duration>) -> Result<i64, InvalidField> {
    slot.map_or(Ok(SLOT_NANOS), |slot| nanos_from_duration("slot", slot))
}

/// Reads the budget of slots to explore, by default a quarter of the slots.
#[must_use]
pub fn budget_from_wire(budget: Option<v1::plan_day_request::Budget>) -> Budget {
    match budget {
        Some(v1::plan_day_request::Budget::Explore(visits)) => Budget::Visits(visits as usize),
        Some(v1::plan_day_request::Budget::Ratio(ratio)) => Budget::Ratio(ratio),
        None => Budget::Ratio(0.25),
    }
}

/// The daily allowance of visits; `None`: every slot may be used.
#[must_use]
pub fn allowance_from_wire(allowance: Option<v1::plan_slot_request::Allowance>) -> Option<Budget> {
    allowance.map(|allowance| match allowance {
        v1::plan_slot_request::Allowance::Explore(visits) => Budget::Visits(visits as usize),
        v1::plan_slot_request::Allowance::Ratio(ratio) => Budget::Ratio(ratio),
    })
}

/// A daily allowance, for the wire.
#[must_use]
pub fn allowance_to_wire(budget: Budget) -> v1::plan_slot_request::Allowance {
    match budget {
        Budget::Visits(visits) => v1::plan_slot_request::Allowance::Explore(u32::try_from(visits).unwrap_or(u32::MAX)),
        Budget::Ratio(ratio) => v1::plan_slot_request::Allowance::Ratio(ratio),
    }
}

/// The budget of slots to explore, for the wire.
#[must_use]
pub fn budget_to_wire(budget: Budget) -> v1::plan_day_request::Budget {
    match budget {
        Budget::Visits(visits) => v1::plan_day_request::Budget::Explore(u32::try_from(visits).unwrap_or(u32::MAX)),
        Budget::Ratio(ratio) => v1::plan_day_request::Budget::Ratio(ratio),
    }
}

/// The strategy by which slots are selected, for the wire.
#[must_use]
pub fn strategy_to_wire(strategy: Strategy) -> v1::Strategy {
    match strategy {
        Strategy::MonteCarlo => v1::Strategy::MonteCarlo,
        Strategy::Greedy => v1::Strategy::Greedy,
        Strategy::RoundRobin { .. } => v1::Strategy::RoundRobin,
        Strategy::Random => v1::Strategy::Random,
    }
}

/// Reads the strategy by which slots are selected.
///
/// # Errors
/// The strategy is unknown.
pub fn strategy_from_wire(field: &str, strategy: i32) -> Result<Strategy, InvalidField> {
    match v1::Strategy::try_from(strategy) {
        Ok(v1::Strategy::Unspecified | v1::Strategy::MonteCarlo) => Ok(Strategy::MonteCarlo),
        Ok(v1::Strategy::Greedy) => Ok(Strategy::Greedy),
        Ok(v1::Strategy::RoundRobin) => Ok(Strategy::RoundRobin { visited: 0 }),
        Ok(v1::Strategy::Random) => Ok(Strategy::Random),
        Err(_) => Err(InvalidField::new(field, format!("{strategy} is not known"))),
    }
}

/// A measure of the worth of an observation for the wire.
#[must_use]
pub fn measure_to_wire(measure: InformationMeasure) -> v1::InformationMeasure {
    match measure {
        InformationMeasure::RaL => v1::InformationMeasure::Ral,
        InformationMeasure::Learn => v1::InformationMeasure::Learn,
        InformationMeasure::Both => v1::InformationMeasure::Both,
    }
}

/// Reads the measure of the worth of an observation. `is_counted`: whether observations of the targets are counted.
///
/// # Errors
/// The measure is unknown, or needs observations that are not counted.
pub fn measure_from_wire(field: &str, measure: i32, is_counted: bool) -> Result<InformationMeasure, InvalidField> {
    let unknown = |_| InvalidField::new(field, format!("{measure} is not known"));
    match v1::InformationMeasure::try_from(measure).map_err(unknown)? {
        v1::InformationMeasure::Unspecified | v1::InformationMeasure::Ral => Ok(InformationMeasure::RaL),
        _ if !is_counted => {
            let text = "viewpoints, tours and exactly_one have RAL alone: leave it out";
            Err(InvalidField::new(field, text))
        }
        v1::InformationMeasure::Learn => Ok(InformationMeasure::Learn),
        v1::InformationMeasure::Both => Ok(InformationMeasure::Both),
    }
}

#[cfg(test)]
mod tests {
    use tidemap_plan::tour::{GOALS_MAX, NoTour};

    use super::*;

    #[test]
    fn an_empty_question_has_the_defaults() {
        assert_eq!(sensor_from_wire(None), Sensor::default());
        assert_eq!(sensor_from_wire(Some(v1::Sensor::default())), Sensor::default());
        let tour = tour_from_wire(&v1::PlanTourRequest::default()).expect("right");
        assert_eq!(tour.clone().starting_at(None), None);
        let question = TourQuestion { start_m: [1.0, 2.0], ..TourQuestion::default() };
        assert_eq!(tour.starting_at(Some([1.0, 2.0])), Some(question));
        assert_eq!(strategy_from_wire("strategy", 0), Ok(Strategy::MonteCarlo));
        assert_eq!(slot_from_wire(None), Ok(SLOT_NANOS));
    }

    #[test]
    fn the_comments_of_a_tour_give_the_defaults_of_the_planner() {
        let TourQuestion { goals, spacing_m, travel, speed_m_per_s, observation_secs, .. } = TourQuestion::default();
        let comments = include_str!("../../tidemap/v1/exploration.proto");
        for comment in [
            format!("Maximum number of goals, 1 to {GOALS_MAX}. Default {goals}."),
            format!("Distance between candidate places, metres. 0: the default, {spacing_m}."),
            format!("Radius of the robot, metres. Default {}.", travel.radius_m),
            format!("Height of the robot, metres: obstacles between {} m and this height", travel.z_min_m),
            format!("block it. 0: the default, {}.", travel.z_max_m),
            format!("Speed of the robot, metres per second. 0: the default, {speed_m_per_s}."),
            format!("Observation time at each goal. Default {observation_secs} s."),
        ] {
            assert!(comments.contains(&comment), "{comment}");
        }
    }

    #[test]
    fn a_tour_comes_back_with_its_reason_in_words() {
        let step = TourStep { at_m: [1.0, -2.5], information_bits: 3.0, reachability: 0.5, arrival_secs: 60.0 };
        let tour = |no_tour| Tour {
            steps: vec![step],
            information_bits: 3.0,
            expected_bits: 1.5,
            path_m: vec![[0.0, 0.5], [1.0, -2.5]],
            length_m: 12.0,
            duration_secs: 84.0,
            candidates: 7,
            no_tour,
        };
        let whole = planned_tour_from_wire(tour_to_wire(&tour(None))).expect("right");
        assert_eq!((whole.steps, whole.no_tour), (vec![step], None));
        assert_eq!((whole.expected_bits, whole.length_m, whole.candidates), (1.5, 12.0, 7));
        assert_eq!(whole.path_m, [[0.0, 0.5], [1.0, -2.5]]);
        let none = planned_tour_from_wire(tour_to_wire(&tour(Some(NoTour::NothingToLearn)))).expect("right");
        assert_eq!(none.no_tour, Some(NoTour::NothingToLearn.to_string()));
        let nowhere = v1::PlanTourResponse { steps: vec![v1::TourStep::default()], ..Default::default() };
        assert_eq!(planned_tour_from_wire(nowhere).expect_err("wrong").field, "steps[0].at");
    }

    #[test]
    fn what_is_wrong_is_named() {
        for wrong in [0.5, 1.0, f64::NAN, -3.0] {
            assert_eq!(certainty_from_wire("certainty", Some(wrong)).expect_err("wrong").field, "certainty");
        }
        assert_eq!(scene_from_wire(None, Some(1.5)).expect_err("wrong").field, "threshold");
        assert_eq!(strategy_from_wire("strategy", 5).expect_err("wrong").field, "strategy");
        let date = date_from_wire("date", "21.3.2016").expect_err("wrong");
        assert_eq!(date.field, "date");
        assert!(date.description.contains("21.3.2016"), "{date}");
    }
}
