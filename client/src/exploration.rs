//! Exploration: information gain, tours, plans of days and slots, and visits.
//!
//! Invariant: information is in bits; a reply that omits a target or a viewpoint is an error.

pub use tidemap_model::InformationMeasure;
pub use tidemap_plan::{
    information::Certainty,
    strategy::{Budget, Strategy},
    tour::{GOALS_MAX, Tour, TourQuestion, TourStep},
    view::{Sensor, Viewpoint},
};
pub use tidemap_proto::convert::exploration::SlotAllowance;
use tidemap_proto::{
    convert::{
        exploration::{
            allowance_to_wire, budget_to_wire, measure_to_wire, planned_tour_from_wire, sensor_to_wire,
            strategy_to_wire, viewpoint_to_wire,
        },
        query::selector_to_wire,
        site::point_to_wire,
        time::{duration, instant, timestamp},
    },
    v1::{self, exploration_service_client::ExplorationServiceClient},
};

use crate::{
    connection::{Client, Connection},
    error::Error,
    queries::ModelSelector,
};

/// Information gain of observing a state, a location or a region, per time.
#[derive(Clone, Debug, PartialEq)]
pub struct Information {
    /// Name of the state or location, or `region`.
    pub target: String,
    /// Sum of the entropies.
    pub entropy_bits: Vec<f64>,
    /// Expected information gain.
    pub information_bits: Vec<f64>,
    /// Number of states, or cells, in the sum.
    pub states: u64,
}

/// Targets of a request for information.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Targets {
    /// Names of states that are probabilities, or cells `cell/X/Y/Z`.
    pub states: Vec<String>,
    /// Names of locations.
    pub locations: Vec<String>,
}

/// The view from a viewpoint.
#[derive(Clone, Debug, PartialEq)]
pub enum View {
    /// Expected information gain at each time, bits; `None` if the viewpoint is probably occupied then.
    Information(Vec<Option<f64>>),
    /// Nothing can be seen at any time; why.
    Blocked(String),
}

/// A request for a tour. `None`: the daemon's default.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TourQuery {
    /// Name of the map.
    pub map: String,
    /// Time of the tour, nanoseconds UTC.
    pub time_nanos: i64,
    /// Maximum number of goals.
    pub count: u32,
    /// Start, metres; by default the map's charger.
    pub start_m: Option<[f64; 2]>,
    /// Whether the robot stays at its last goal.
    pub is_open: bool,
    /// The sensor of the robot.
    pub sensor: Sensor,
    /// The model that predicts the grid.
    pub model: ModelSelector,
    /// Distance between candidate places, metres.
    pub spacing_m: Option<f64>,
    /// Radius of the robot, metres.
    pub robot_radius_m: Option<f64>,
    /// Height of the robot, metres.
    pub robot_height_m: Option<f64>,
    /// Speed, metres per second.
    pub speed_m_per_s: Option<f64>,
    /// Observation time at each goal, nanoseconds.
    pub observing_nanos: Option<i64>,
    /// Time limit of the tour, nanoseconds.
    pub budget_nanos: Option<i64>,
}

/// A request for the plan of a day.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DayQuery {
    /// Name of the map.
    pub map: String,
    /// Local date, as YYYY-MM-DD.
    pub date: String,
    /// Length of a slot, nanoseconds; a quarter of an hour by default.
    pub slot_nanos: Option<i64>,
    /// The amount of exploration; a quarter of the slots by default.
    pub budget: Option<Budget>,
    /// The strategy that selects slots.
    pub strategy: Strategy,
    /// Seed of the random choices.
    pub seed: u64,
    /// Locations to select from; empty: all.
    pub locations: Vec<String>,
    /// The model that predicts.
    pub model: ModelSelector,
    /// The measure of the worth of an observation; for viewpoints, tours and `exactly_one` only RA-L's gain, the
    /// default.
    pub information: InformationMeasure,
    /// Weight of exploration, in [0, 1]; the rest is the weight of the task.
    pub exploration_weight: Option<f64>,
    /// States that a task profits from, one per location.
    pub task_states: Vec<String>,
    /// Viewpoints into the grid, instead of locations; the plan calls them `X,Y`.
    pub viewpoints: Vec<Viewpoint>,
    /// The sensor of the robot at the viewpoints.
    pub sensor: Sensor,
    /// The locations hold one person or object, which is at exactly one of them at any time: one model of all locations
    /// predicts. This is not possible with another model, viewpoints, tours or tasks.
    pub exactly_one: bool,
    /// Instead of locations or viewpoints: a tour in every slot. The value of a slot is the expected information gain
    /// of its tour; the plan calls it `tour`.
    pub tour: Option<DayTour>,
}

/// The tour of each slot of a day.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DayTour {
    /// Maximum number of goals of a tour, 1 to 100.
    pub goals: u32,
    /// The start and end of the robot's tour; the charger of the map by default.
    pub start_m: Option<[f64; 2]>,
}

/// The strategy that selects a location for the current slot.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum SlotStrategy {
    /// The most uncertain location.
    #[default]
    Online,
    /// The planned location, unless recent observations at another location contradict the model.
    Novelty {
        /// The planned location.
        planned: String,
    },
    /// At random, in proportion to the expected information gain.
    MonteCarlo,
    /// The location where most states are expected to be predicted wrongly.
    OnlineError,
}

/// A request for the slot that begins now. `None`: the daemon's default.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SlotQuery {
    /// Name of the map.
    pub map: String,
    /// Middle of the slot, nanoseconds UTC.
    pub time_nanos: i64,
    /// The strategy that selects the location.
    pub strategy: SlotStrategy,
    /// Locations to select from; empty: all.
    pub locations: Vec<String>,
    /// The model that predicts.
    pub model: Option<ModelSelector>,
    /// The measure of information; see [`DayQuery::information`].
    pub information: InformationMeasure,
    /// Whether exactly one location holds the object; see [`DayQuery::exactly_one`].
    pub exactly_one: bool,
    /// Seed of the random choices.
    pub seed: u64,
    /// Length of a slot, nanoseconds, with [`SlotQuery::exactly_one`] or an allowance; a quarter of an hour by default.
    pub slot_nanos: Option<i64>,
    /// A daily allowance of visits; `None`: every slot is used. Only with [`SlotStrategy::Online`] and
    /// [`SlotStrategy::OnlineError`].
    pub allowance: Option<SlotAllowance>,
}

/// The location for a slot.
#[derive(Clone, Debug, PartialEq)]
pub struct SlotChoice {
    /// The location; `None`: the robot rests because of its allowance.
    pub location: Option<String>,
    /// Worth of an observation there, bits.
    pub information_bits: f64,
    /// Information gain if everything is as observed recently; only with [`SlotStrategy::Novelty`].
    pub surprise_bits: Option<f64>,
}

/// A square of 0.5 m that robots tried to reach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReachedPlace {
    /// The centre: x, y in metres.
    pub at_m: [f64; 2],
    /// Share of the last five attempts that succeeded.
    pub reachability: f64,
    /// Number of attempts counted, 1 to 5.
    pub attempts: u32,
    /// Time of the newest attempt, nanoseconds UTC.
    pub last_nanos: i64,
}

/// A slot of a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct DaySlot {
    /// The start, nanoseconds UTC.
    pub start_nanos: i64,
    /// The location to observe; `None`: rest.
    pub location: Option<String>,
    /// Worth of an observation there, bits.
    pub information_bits: f64,
}

/// The request for the plan of a day, without tasks.
pub(crate) fn day_request(query: DayQuery) -> v1::PlanDayRequest {
    v1::PlanDayRequest {
        map: query.map,
        date: query.date,
        slot: query.slot_nanos.map(duration),
        strategy: strategy_to_wire(query.strategy).into(),
        seed: query.seed,
        locations: query.locations,
        model: (!query.exactly_one).then(|| selector_to_wire(query.model)),
        exactly_one: query.exactly_one,
        information: measure_to_wire(query.information).into(),
        certainty: None,
        exploration_weight: query.exploration_weight,
        task_states: query.task_states,
        sensor: (!query.viewpoints.is_empty()).then(|| sensor_to_wire(query.sensor)),
        viewpoints: query.viewpoints.iter().map(viewpoint_to_wire).collect(),
        budget: query.budget.map(budget_to_wire),
        tour: query.tour.map(|tour| v1::PlanTourRequest {
            count: tour.goals,
            start: tour.start_m.map(point_to_wire),
            ..v1::PlanTourRequest::default()
        }),
        ..v1::PlanDayRequest::default()
    }
}

/// The slots of a reply.
pub(crate) fn day_slots(answer: v1::PlanDayResponse) -> Vec<DaySlot> {
    let slot = |slot: v1::DaySlot| DaySlot {
        start_nanos: slot.start_nanos,
        location: Some(slot.location).filter(|location| !location.is_empty()),
        information_bits: slot.information_bits,
    };
    answer.slots.into_iter().map(slot).collect()
}

impl Client {
    pub(crate) fn exploration_service(&self) -> ExplorationServiceClient<Connection> {
        ExplorationServiceClient::new(self.requests())
    }

    /// Information gain of observing states and locations at times (nanoseconds), in their order.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map, state or location does not exist.
    pub async fn information(
        &self,
        map: &str,
        targets: Targets,
        times_nanos: Vec<i64>,
        model: ModelSelector,
    ) -> Result<Vec<Information>, Error> {
        let (wanted, times) = (targets.states.len() + targets.locations.len(), times_nanos.len());
        let request = v1::GetInformationRequest {
            map: map.to_owned(),
            times_nanos,
            states: targets.states,
            locations: targets.locations,
            model: Some(selector_to_wire(model)),
            ..Default::default()
        };
        let answer = self.exploration_service().get_information(request).await;
        let mut replies = answer.map_err(|status| self.error(&status))?.into_inner();
        let mut information = Vec::with_capacity(wanted);
        while let Some(reply) = replies.message().await.map_err(|status| self.error(&status))? {
            let v1::GetInformationResponse { target, entropy_bits, information_bits, states } = reply;
            if entropy_bits.len() != times || information_bits.len() != times {
                return Err(Error::Protocol("information at other times than requested"));
            }
            information.push(Information { target, entropy_bits, information_bits, states });
        }
        if information.len() == wanted {
            Ok(information)
        } else {
            Err(Error::Protocol("information about a target is missing"))
        }
    }

    /// The views of the grid from viewpoints at times (nanoseconds), in their order.
    ///
    /// # Errors
    /// [`Error`]; the code is `FAILED_PRECONDITION` if the map has no grid, `RESOURCE_EXHAUSTED` if it is too much
    /// work.
    pub async fn evaluate_views(
        &self,
        map: &str,
        viewpoints: &[Viewpoint],
        times_nanos: Vec<i64>,
        sensor: Sensor,
        model: ModelSelector,
    ) -> Result<Vec<View>, Error> {
        let times = times_nanos.len();
        let request = v1::EvaluateViewsRequest {
            map: map.to_owned(),
            viewpoints: viewpoints.iter().map(viewpoint_to_wire).collect(),
            times_nanos,
            sensor: Some(sensor_to_wire(sensor)),
            model: Some(selector_to_wire(model)),
            ..Default::default()
        };
        let answer = self.exploration_service().evaluate_views(request).await;
        let mut replies = answer.map_err(|status| self.error(&status))?.into_inner();
        let mut views = Vec::with_capacity(viewpoints.len());
        while let Some(reply) = replies.message().await.map_err(|status| self.error(&status))? {
            if reply.viewpoint as usize != views.len() {
                return Err(Error::Protocol("a viewpoint out of order"));
            }
            views.push(if !reply.reason.is_empty() {
                View::Blocked(reply.reason)
            } else if reply.information_bits.len() == times {
                View::Information(reply.information_bits.into_iter().map(|b| Some(b).filter(|b| !b.is_nan())).collect())
            } else {
                return Err(Error::Protocol("views at other times than requested"));
            });
        }
        if views.len() == viewpoints.len() { Ok(views) } else { Err(Error::Protocol("a viewpoint is missing")) }
    }

    /// Plans the goals of one exploration run.
    ///
    /// # Errors
    /// [`Error`]; the code is `FAILED_PRECONDITION` if the map has no grid, or neither a start nor a charger is set.
    pub async fn plan_tour(&self, query: &TourQuery) -> Result<Tour<String>, Error> {
        let request = v1::PlanTourRequest {
            map: query.map.clone(),
            time: Some(timestamp(query.time_nanos)),
            count: query.count,
            start: query.start_m.map(point_to_wire),
            is_open: query.is_open,
            sensor: Some(sensor_to_wire(query.sensor)),
            model: Some(selector_to_wire(query.model)),
            spacing_m: query.spacing_m.unwrap_or_default(),
            robot_radius_m: query.robot_radius_m,
            robot_height_m: query.robot_height_m.unwrap_or_default(),
            speed_m_per_s: query.speed_m_per_s.unwrap_or_default(),
            observing: query.observing_nanos.map(duration),
            budget: query.budget_nanos.map(duration),
            certainty: None,
        };
        let answer = self.exploration_service().plan_tour(request).await.map_err(|status| self.error(&status))?;
        planned_tour_from_wire(answer.into_inner()).map_err(|_| Error::Protocol("a step of the tour is nowhere"))
    }

    /// Plans which slots of a local day to explore, and where.
    ///
    /// # Errors
    /// [`Error`]; the code is `INVALID_ARGUMENT` if the budget does not fit the day or the date is invalid.
    pub async fn plan_day(&self, query: DayQuery) -> Result<Vec<DaySlot>, Error> {
        let answer = self.exploration_service().plan_day(day_request(query)).await;
        Ok(day_slots(answer.map_err(|status| self.error(&status))?.into_inner()))
    }

    /// Plans where to observe in the slot that begins now.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map or location does not exist.
    pub async fn plan_slot(&self, query: SlotQuery) -> Result<SlotChoice, Error> {
        let (strategy, planned) = match query.strategy {
            SlotStrategy::Online => (v1::SlotStrategy::Online, String::new()),
            SlotStrategy::Novelty { planned } => (v1::SlotStrategy::Novelty, planned),
            SlotStrategy::MonteCarlo => (v1::SlotStrategy::MonteCarlo, String::new()),
            SlotStrategy::OnlineError => (v1::SlotStrategy::OnlineError, String::new()),
        };
        let request = v1::PlanSlotRequest {
            map: query.map,
            time: Some(timestamp(query.time_nanos)),
            strategy: strategy.into(),
            planned,
            locations: query.locations,
            model: query.model.map(selector_to_wire),
            certainty: None,
            seed: query.seed,
            allowance: query.allowance.map(|allowance| allowance_to_wire(allowance.budget)),
            spent: query.allowance.map_or(0, |allowance| u32::try_from(allowance.spent).unwrap_or(u32::MAX)),
            slot: query.slot_nanos.map(duration),
            exactly_one: query.exactly_one,
            information: measure_to_wire(query.information).into(),
        };
        let answer = self.exploration_service().plan_slot(request).await.map_err(|status| self.error(&status))?;
        let v1::PlanSlotResponse { location, information_bits, surprise_bits } = answer.into_inner();
        let surprise_bits = (strategy == v1::SlotStrategy::Novelty).then_some(surprise_bits);
        let location = Some(location).filter(|location| !location.is_empty());
        Ok(SlotChoice { location, information_bits, surprise_bits })
    }

    /// Reports whether a robot reached a place, at a time in nanoseconds UTC or now. Returns the share of recent
    /// attempts that succeeded, and their number.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map does not exist.
    pub async fn report_visit(
        &self,
        map: &str,
        at_m: [f64; 2],
        reached: bool,
        time_nanos: Option<i64>,
    ) -> Result<(f64, u32), Error> {
        let request = v1::ReportVisitRequest {
            map: map.to_owned(),
            at: Some(point_to_wire(at_m)),
            reached,
            time: time_nanos.map(timestamp),
        };
        let answer = self.exploration_service().report_visit(request).await.map_err(|status| self.error(&status))?;
        let v1::ReportVisitResponse { reachability, attempts } = answer.into_inner();
        Ok((reachability, attempts))
    }

    /// The places that robots tried to reach, by x and then by y.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map does not exist.
    pub async fn reachability(&self, map: &str) -> Result<Vec<ReachedPlace>, Error> {
        let request = v1::ListReachabilityRequest { map: map.to_owned() };
        let replies = self.exploration_service().list_reachability(request).await;
        let mut replies = replies.map_err(|status| self.error(&status))?.into_inner();
        let mut places = Vec::new();
        while let Some(reply) = replies.message().await.map_err(|status| self.error(&status))? {
            places.extend(reply.places.into_iter().map(|place| ReachedPlace {
                at_m: place.at.map_or([0.0; 2], |at| [at.x_m, at.y_m]),
                reachability: place.reachability,
                attempts: place.attempts,
                last_nanos: instant(place.last_time).unwrap_or_default(),
            }));
        }
        Ok(places)
    }
}
