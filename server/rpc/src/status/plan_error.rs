//! Errors of requests to explore.
//!
//! Invariant: each error has one gRPC code and one reason.

use tidemap_model::LocalDay;
use tidemap_plan::{
    day::DayError,
    predicted::PredictError,
    presence::PresenceError,
    strategy::StrategyError,
    tasks::{LegError, TaskPlanError},
    tour::{NoTour, TourError},
    view::{SceneError, TooMuchWork},
};
use tonic::Code;

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PlanError {
    #[error(transparent)]
    Predict(#[from] PredictError),
    #[error(transparent)]
    Tour(#[from] TourError),
    #[error(transparent)]
    Look(#[from] TooMuchWork),
    #[error(transparent)]
    Day(#[from] DayError),
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error(transparent)]
    Presence(#[from] PresenceError),
    #[error("no slot of the day has a tour: {0}")]
    NoTour(NoTour),
    #[error(transparent)]
    Task(#[from] TaskPlanError),
    #[error("map {map:?} keeps no plan of {day}: plan the day and keep the plan first")]
    NoPlan { map: String, day: LocalDay },
    #[error(
        "no node is nearest to the charger of the map, no task charges, and no start_node was given: give one, or set the \
         charger of the map"
    )]
    NoStartNode,
    #[error("the map has no charger, and no start was given: give a start, or set the charger of the map")]
    NoStart,
}

impl PlanError {
    pub(super) fn code_and_reason(&self) -> (Code, &'static str) {
        match self {
            Self::Predict(PredictError::NoGrid) => (Code::FailedPrecondition, "NO_GRID"),
            Self::Predict(PredictError::EmptyRegion) => (Code::FailedPrecondition, "NOTHING_OBSERVED"),
            Self::Predict(PredictError::Stop(_))
            | Self::Tour(TourError::Stop(_))
            | Self::Look(TooMuchWork::Stop(_))
            | Self::Scene(SceneError::Stop(_))
            | Self::Presence(PresenceError::Stopped(_)) => (Code::Cancelled, "LEFT"),
            Self::Task(TaskPlanError::Stopped | TaskPlanError::Leg(LegError::Stopped)) => {
                (Code::DeadlineExceeded, "CUT_OFF")
            }
            Self::NoPlan { .. } => (Code::NotFound, "NO_PLAN"),
            Self::NoTour(_) => (Code::FailedPrecondition, "NO_TOUR"),
            Self::NoStart | Self::NoStartNode => (Code::FailedPrecondition, "NO_START"),
            Self::Predict(PredictError::Unavailable(_)) => (Code::Internal, "STORAGE_FAILED"),
            Self::Predict(PredictError::TooManyCells { .. } | PredictError::TooManyValues { .. })
            | Self::Tour(TourError::TooManyCandidates { .. })
            | Self::Look(TooMuchWork::Work { .. })
            | Self::Task(TaskPlanError::TooMany { .. } | TaskPlanError::Leg(LegError::TooMuch { .. }))
            | Self::Day(DayError::Strategy(StrategyError::TooMany { .. })) => (Code::ResourceExhausted, "LIMIT"),
            _ => (Code::InvalidArgument, "INVALID_FIELD"),
        }
    }
}
