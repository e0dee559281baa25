//! Robots that cross the floor, and the people whom they meet.
//!
//! Invariant: a robot knows the model only; whom it meets follows from the walks of the day.

use tidemap_map::topology::{Edge, NOMINAL_MAX_SECS};
use tidemap_model::models::FlowModel;
use tidemap_plan::{
    encounters::{Encounters, NEAR_M},
    route::{EdgeForecast, Forecasts, Objective, RouteOptions, When, plan_routes},
};
use tidemap_sim::{StreamOffice, StreamWalk};

use super::{
    ComparedFlow, FlowsError,
    floor::{Floor, SPEED_M_PER_S},
    moment,
};

/// A trip begins every half hour …
const EVERY_SECS: f64 = 1_800.0;
/// … from 7 to 19 o'clock.
const TRIPS_SECS: [f64; 2] = [25_200.0, 68_400.0];
/// The ends of a trip, in the western and in the eastern short corridor.
const ENDS_M: [[f64; 2]; 2] = [[2.5, 8.5], [37.5, 8.5]];
/// The detour that avoiding one second near a person is worth, seconds.
const ENCOUNTER_COST_SECS: f64 = 10.0;

/// The way in which a robot crosses the floor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Crossing {
    /// On the shortest way.
    Shortest,
    /// Avoiding the encounters that this model expects.
    Avoiding(ComparedFlow),
}

impl Crossing {
    /// All, the baseline first.
    pub const ALL: [Crossing; 3] =
        [Crossing::Shortest, Crossing::Avoiding(ComparedFlow::Timeless), Crossing::Avoiding(ComparedFlow::Spectral)];

    /// The name of the way of crossing in results.
    pub fn name(self) -> &'static str {
        match self {
            Crossing::Shortest => "shortest",
            Crossing::Avoiding(ComparedFlow::Timeless) => "avoiding-timeless",
            Crossing::Avoiding(ComparedFlow::Spectral) => "avoiding-spectral",
        }
    }

    /// The model that expects encounters.
    pub(super) fn model(self) -> Option<ComparedFlow> {
        match self {
            Crossing::Shortest => None,
            Crossing::Avoiding(model) => Some(model),
        }
    }
}

/// The totals of trips.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TripTotals {
    /// Number of trips.
    pub trips: u64,
    /// Length of all trips, metres.
    pub metres: f64,
    /// Seconds that people were near, of all people.
    pub near_secs: f64,
    /// Number of people who were near.
    pub people: u64,
}

impl TripTotals {
    /// Adds other trips.
    pub(super) fn add(&mut self, other: &TripTotals) {
        self.trips += other.trips;
        self.metres += other.metres;
        self.near_secs += other.near_secs;
        self.people += other.people;
    }

    /// Mean of a total over trips.
    pub fn per_trip(&self, total: f64) -> f64 {
        total / self.trips.max(1) as f64
    }
}

/// Edges that never fail, with the encounters that a model expects.
struct FloorForecasts<'a> {
    floor: &'a Floor,
    encounters: Option<Encounters<'a>>,
    day: i64,
}

impl Forecasts for FloorForecasts<'_> {
    fn at(&mut self, edge: &Edge, _at_secs: f64) -> Option<EdgeForecast> {
        Some(EdgeForecast { success: 1.0, evidence: 1e6, duration_secs: secs(edge) })
    }

    fn encounters(&mut self, edge: &Edge, at_secs: f64, duration_secs: f64) -> f64 {
        let [from, to] = self.floor.ends_m(edge);
        let enter = moment(self.day, at_secs);
        self.encounters.as_mut().map_or(0.0, |encounters| encounters.along(from, to, enter, duration_secs))
    }
}

fn secs(edge: &Edge) -> f64 {
    edge.extent.secs_at(SPEED_M_PER_S).min(NOMINAL_MAX_SECS)
}

/// The trips of a day.
pub(super) fn of_day(
    model: Option<&FlowModel>,
    office: &StreamOffice,
    floor: &Floor,
    day: i64,
) -> Result<TripTotals, FlowsError> {
    let walks = office.walks(day);
    let ends = [floor.node(ENDS_M[0])?, floor.node(ENDS_M[1])?];
    let encounter_cost_secs = if model.is_some() { ENCOUNTER_COST_SECS } else { 0.0 };
    let options = RouteOptions { objective: Objective::Time, encounter_cost_secs, ..RouteOptions::default() };
    let mut forecasts = FloorForecasts { floor, encounters: model.map(|model| Encounters::new(model, NEAR_M)), day };
    let mut totals = TripTotals::default();
    let mut start_secs = TRIPS_SECS[0];
    while start_secs < TRIPS_SECS[1] {
        let (from, to) = if totals.trips.is_multiple_of(2) { (ends[0], ends[1]) } else { (ends[1], ends[0]) };
        let when = When::DepartAt(start_secs);
        let plan = plan_routes(floor.topology(), from, to, when, &options, &mut forecasts, || false)?;
        let edges = plan.routes.iter().take(1).flat_map(|route| &route.steps);
        let edges: Vec<&Edge> = edges.filter_map(|step| floor.topology().edge(step.edge).ok()).collect();
        totals.add(&drive(&edges, floor, start_secs, &walks));
        start_secs += EVERY_SECS;
    }
    Ok(totals)
}

/// One trip among the people of the day.
fn drive(edges: &[&Edge], floor: &Floor, start_secs: f64, walks: &[StreamWalk]) -> TripTotals {
    const STEP_SECS: f64 = 0.5;
    let mut totals = TripTotals { trips: 1, ..TripTotals::default() };
    let length: f64 = edges.iter().map(|edge| secs(edge)).sum();
    totals.metres = length * SPEED_M_PER_S;
    // Nobody else is on the floor meanwhile.
    let about: Vec<&StreamWalk> =
        walks.iter().filter(|walk| walk.start_secs <= start_secs + length && walk.end_secs >= start_secs).collect();
    let mut was_near = vec![false; about.len()];
    let mut step = 0.0;
    while step < length {
        let place = place_after(edges, floor, step);
        for (walk, was_near) in about.iter().zip(&mut was_near) {
            let Some(person) = walk.at(start_secs + step) else { continue };
            if (person[0] - place[0]).hypot(person[1] - place[1]) <= NEAR_M {
                totals.near_secs += STEP_SECS;
                *was_near = true;
            }
        }
        step += STEP_SECS;
    }
    totals.people = was_near.iter().filter(|near| **near).count() as u64;
    totals
}

/// The position of the robot some seconds after its start.
fn place_after(edges: &[&Edge], floor: &Floor, after_secs: f64) -> [f64; 2] {
    let mut left = after_secs;
    for edge in edges {
        let duration = secs(edge);
        if left <= duration {
            let [from, to] = floor.ends_m(edge);
            return [0, 1].map(|axis| from[axis] + left / duration * (to[axis] - from[axis]));
        }
        left -= duration;
    }
    edges.last().map_or([f64::NAN; 2], |edge| floor.ends_m(edge)[1])
}
