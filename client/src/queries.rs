//! Predictions, models, anomalies and history of a map.
//!
//! Invariant: predictions come in the requested order: by state, then by time.

mod anomalies;
mod cell_alarms;
mod evaluate;
mod flow;
mod grid;
mod places;
mod positions;
mod predict;
mod reconstruct;
mod surprises;

pub use anomalies::{Anomalies, Anomaly, AnomalyWatch, Judgement, Watched, WatchedPlaces};
pub use cell_alarms::{CellAlarm, CellAlarms};
pub use evaluate::{Comparison, EvaluateOptions, Evaluator, StateEvaluation, Unavailable};
pub use flow::{AvoidedPeople, FlowForecast, FlowRaster, FlowSource, Flows, PositionRegion};
pub use grid::{
    CellPrediction, GridHeader, GridOutput, GridPrediction, GridQuery, PredictedTile, TILE_EDGE, WholeGrid,
};
pub use places::{PlacePrediction, PlacePredictions, PlaceQuery};
pub use positions::{PositionForecast, PositionQuery, Positions, PositionsHeader};
pub use predict::{PredictionRun, Predictions, age_nanos};
pub use reconstruct::Reconstruction;
pub use surprises::{SurpriseQuery, Surprising};
pub use tidemap_model::{
    KEPT_CONFIDENCE, ORDER_MAX, StateKind, SurpriseRun,
    selector::{Blend, InvalidModel, ModelKind, ModelSelector},
};

use tidemap_proto::{
    convert::{map::kind_from_wire, query::selector_from_wire, time::instant},
    v1::{self, query_service_client::QueryServiceClient},
};

use crate::{
    connection::{Client, Connection, REPLY_BYTES_MAX},
    error::Error,
};

/// The description of the model of one state.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelDescription {
    /// Name of the state.
    pub state: String,
    /// The kind of the values of the state.
    pub kind: StateKind,
    /// Mean of the learned values; if there are none: 0.5 for a probability, else 0.
    pub mean: f64,
    /// Number of observations that updates have learned.
    pub learned_observations: u64,
    /// Number of acknowledged observations, including those not yet learned.
    pub observations: u64,
    /// Number of components that predictions use.
    pub order: u32,
    /// Strongest first; predictions use the first `order`.
    pub components: Vec<SpectralComponent>,
    /// Faded sum of errors of each order, by which updates select the order; in the unit of `model_errors`.
    pub order_errors: Vec<f64>,
    /// Time constant of the persistence.
    pub persistence_tau_secs: f64,
    /// Newest value.
    pub last_value: Option<f64>,
    /// Time of the newest observation.
    pub last_nanos: Option<i64>,
    /// Time of the oldest learned observation.
    pub first_nanos: Option<i64>,
    /// The model that updates selected: a member of the ensemble, or the only model with which `auto` predicts.
    pub chosen: ModelSelector,
    /// Faded sums of squared errors, one for each observation, of the models from which updates select: in the square
    /// of the unit of the values; with the criterion zero-one, the number of values on the wrong side of 0.5.
    pub model_errors: Vec<(ModelSelector, f64)>,
    /// The local date, YYYY-MM-DD, from which recent errors differ from their history.
    pub change_date: Option<String>,
}

/// One term amplitude · cos(2π t / period + phase), t in seconds of local civil time since 1970-01-01T00:00.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpectralComponent {
    /// Period.
    pub period_secs: f64,
    /// In the unit of the state.
    pub amplitude: f64,
    /// In (-π, π].
    pub phase_rad: f64,
}

/// The model of a reply; a kind that this version does not know counts as `auto`.
fn selector_of(model: Option<v1::ModelSelector>) -> ModelSelector {
    selector_from_wire("model", model).unwrap_or_default()
}

impl Client {
    fn query_service(&self) -> QueryServiceClient<Connection> {
        QueryServiceClient::new(self.requests()).max_decoding_message_size(REPLY_BYTES_MAX)
    }

    /// The description of the model of one state.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map or state does not exist.
    pub async fn describe_model(&self, map: &str, state: &str) -> Result<ModelDescription, Error> {
        let request = v1::DescribeModelRequest { map: map.to_owned(), state: state.to_owned() };
        let response = self.query_service().describe_model(request).await.map_err(|status| self.error(&status))?;
        let model = response.into_inner();
        let component = |component: v1::SpectralComponent| SpectralComponent {
            period_secs: component.period_secs,
            amplitude: component.amplitude,
            phase_rad: component.phase_rad,
        };
        Ok(ModelDescription {
            kind: kind_from_wire(model.kind()).unwrap_or_default(),
            state: model.state,
            mean: model.mean,
            learned_observations: model.learned_observations,
            observations: model.observations,
            order: model.order,
            components: model.components.into_iter().map(component).collect(),
            order_errors: model.order_errors,
            persistence_tau_secs: model.persistence_tau_secs,
            last_value: model.last_value,
            last_nanos: instant(model.last_time),
            first_nanos: instant(model.first_time),
            chosen: selector_of(model.chosen),
            model_errors: model
                .model_errors
                .into_iter()
                .map(|error| (selector_of(error.model), error.error_sum))
                .collect(),
            change_date: Some(model.change_date).filter(|date| !date.is_empty()),
        })
    }
}
