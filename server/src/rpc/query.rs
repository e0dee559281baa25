//! `QueryService`: questions to an immutable view.
//!
//! Invariant: a request is answered from one view, off the async threads, in pieces that wait for the reader.

use std::{collections::HashMap, sync::Arc};

use tidemap_map::{
    event::StateId,
    predict::{ModelKind, ModelSelector},
    view::MapView,
};
use tidemap_model::{Sample, entropy_bits};
use tidemap_proto::{
    convert::{
        InvalidField,
        columns::decode,
        query::{description_to_wire, order_from_wire, selector_from_wire, selector_to_wire},
        time::timestamp,
    },
    v1::{self, query_service_server::QueryService},
};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming};

use super::{map::find_map, status::RpcError};
use crate::{catalog::Catalog, evaluation::Evaluator};

/// Most states of one request.
const STATES_MAX: usize = 10_000;
/// Times whose phasors are held at once: some 10 MB at 168 periodicities.
const TIMES_PER_BLOCK: usize = 4096;
/// Replies computed ahead of the reader.
const REPLIES_AHEAD: usize = 8;

/// The service.
#[derive(Debug)]
pub struct Queries {
    /// The maps.
    pub catalog: Arc<Catalog>,
    /// Most predictions of one request.
    pub max_predictions: u64,
    /// Most observations of one message.
    pub max_batch: usize,
}

/// The state of this name, or an error that lists some that exist.
fn find_state(view: &MapView, name: &str) -> Result<StateId, RpcError> {
    view.find(name).ok_or_else(|| RpcError::UnknownState {
        map: view.spec().name.as_str().to_owned(),
        name: name.chars().take(80).collect(),
        known: view.infos().take(11).map(|info| info.name.as_str().to_owned()).collect(),
    })
}

fn check_limit(what: &'static str, got: u64, max: u64, setting: &'static str) -> Result<(), RpcError> {
    if got > max { Err(RpcError::Limit { what, got, max, setting }) } else { Ok(()) }
}

type Replies = ReceiverStream<Result<v1::PredictStatesResponse, Status>>;

#[tonic::async_trait]
impl QueryService for Queries {
    type PredictStatesStream = Replies;

    async fn predict_states(
        &self,
        request: Request<v1::PredictStatesRequest>,
    ) -> Result<Response<Self::PredictStatesStream>, Status> {
        let request = request.into_inner();
        let view = find_map(&self.catalog, &request.map)?.view();
        if request.states.is_empty() {
            return Err(RpcError::from(InvalidField::new("states", "name at least one state")).into());
        }
        check_limit("states", request.states.len() as u64, STATES_MAX as u64, "one request")?;
        if request.times_nanos.is_empty() {
            return Err(RpcError::from(InvalidField::new("times_nanos", "name at least one time")).into());
        }
        if let Some(index) = request.times_nanos.iter().position(|&nanos| nanos < 0) {
            let text = format!("{} ns is before 1970", request.times_nanos[index]);
            return Err(RpcError::from(InvalidField::new(format!("times_nanos[{index}]"), text)).into());
        }
        let predictions = request.states.len() as u64 * request.times_nanos.len() as u64;
        check_limit("predictions", predictions, self.max_predictions, "setting max_predictions")?;
        let selector = selector_from_wire("model", request.model).map_err(RpcError::from)?;
        let states = request.states.iter().map(|name| find_state(&view, name)).collect::<Result<Vec<_>, _>>()?;
        let (replies, stream) = mpsc::channel(REPLIES_AHEAD);
        tokio::task::spawn_blocking(move || predict(&view, &states, &request.times_nanos, selector, &replies));
        Ok(Response::new(ReceiverStream::new(stream)))
    }

    async fn evaluate_states(
        &self,
        request: Request<Streaming<v1::EvaluateStatesRequest>>,
    ) -> Result<Response<v1::EvaluateStatesResponse>, Status> {
        let mut stream = request.into_inner();
        let Some(v1::evaluate_states_request::Message::Header(header)) =
            stream.message().await?.and_then(|request| request.message)
        else {
            let error = InvalidField::new("header", "the first message of the stream must be the header");
            return Err(RpcError::from(error).into());
        };
        let view = find_map(&self.catalog, &header.map)?.view();
        let max_order = header.max_order.map(|order| order_from_wire("header.max_order", order)).transpose();
        let max_order = max_order.map_err(RpcError::from)?.unwrap_or(tidemap_model::MAX_ORDER);
        let mut models = Vec::with_capacity(header.models.len());
        for (i, model) in header.models.into_iter().enumerate() {
            models.push(selector_from_wire(&format!("header.models[{i}]"), Some(model)).map_err(RpcError::from)?);
        }
        if models.is_empty() {
            models.push(ModelSelector { kind: ModelKind::Spectral, ..ModelSelector::default() });
        }
        check_limit("models", models.len() as u64, 64, "one request")?;
        let mut evaluator = Evaluator::new(Arc::clone(&view), models, max_order);
        let mut table: Vec<StateId> = Vec::new();
        while let Some(request) = stream.message().await? {
            let Some(v1::evaluate_states_request::Message::Observations(mut columns)) = request.message else {
                let error = InvalidField::new("observations", "every message after the first must have them");
                return Err(RpcError::from(error).into());
            };
            for name in std::mem::take(&mut columns.new_states) {
                check_limit("states", table.len() as u64 + 1, STATES_MAX as u64, "one evaluation")?;
                table.push(find_state(&view, &name)?);
            }
            let columns = decode(columns, self.max_batch).map_err(RpcError::from)?;
            let mut make = view.sample_maker();
            let mut by_state: HashMap<StateId, Vec<Sample>> = HashMap::new();
            for i in 0..columns.values.len() {
                let (index, time, value) = (columns.state_indices[i], columns.times_nanos[i], columns.values[i]);
                let Some(&state) = table.get(index as usize) else {
                    let text = format!("{index} is beyond the stream's table of {} names", table.len());
                    return Err(RpcError::from(InvalidField::new("observations.state_indices", text)).into());
                };
                if time < 0 {
                    let text = format!("{time} ns is before 1970");
                    return Err(RpcError::from(InvalidField::new("observations.times", text)).into());
                }
                if !(0.0..=1.0).contains(&value) {
                    let text = format!("value {value} is not between 0 and 1");
                    return Err(RpcError::from(InvalidField::new("observations.values", text)).into());
                }
                by_state.entry(state).or_default().push(make(time, value));
            }
            evaluator = tokio::task::spawn_blocking(move || {
                evaluator.add(&table_order(&by_state), &by_state);
                evaluator
            })
            .await
            .map_err(|_| RpcError::Stopping)?;
        }
        let evaluations = evaluator.rows().map(|(state, model, evaluation)| v1::Evaluation {
            state: state.to_owned(),
            model: Some(selector_to_wire(model)),
            observations: evaluation.observations,
            mean_squared_error: evaluation.mse(),
            error_rate: evaluation.error_rate(),
        });
        Ok(Response::new(v1::EvaluateStatesResponse { evaluations: evaluations.collect() }))
    }

    async fn describe_model(
        &self,
        request: Request<v1::DescribeModelRequest>,
    ) -> Result<Response<v1::DescribeModelResponse>, Status> {
        let request = request.into_inner();
        let view = find_map(&self.catalog, &request.map)?.view();
        let id = find_state(&view, &request.state)?;
        Ok(Response::new(description_to_wire(&view, id).unwrap_or_default()))
    }
}

/// States in a fixed order, so that rows do not depend on hashing.
fn table_order(by_state: &HashMap<StateId, Vec<Sample>>) -> Vec<StateId> {
    let mut order: Vec<StateId> = by_state.keys().copied().collect();
    order.sort_unstable();
    order
}

/// Computes and sends the replies until all are sent or the reader is gone.
fn predict(
    view: &MapView,
    states: &[StateId],
    times_nanos: &[i64],
    selector: ModelSelector,
    replies: &mpsc::Sender<Result<v1::PredictStatesResponse, Status>>,
) {
    for (block, times) in times_nanos.chunks(TIMES_PER_BLOCK).enumerate() {
        let prepared = view.prepare(times);
        for (state_index, &id) in states.iter().enumerate() {
            let mut probabilities = vec![0.0; times.len()];
            view.predict_into(id, &prepared, selector, &mut probabilities);
            let live = view.live(id);
            let reply = v1::PredictStatesResponse {
                state_index: u32::try_from(state_index).unwrap_or(u32::MAX),
                first_time_index: u32::try_from(block * TIMES_PER_BLOCK).unwrap_or(u32::MAX),
                entropies_bits: probabilities.iter().map(|&probability| entropy_bits(probability)).collect(),
                probabilities,
                lower: Vec::new(),
                upper: Vec::new(),
                order: u32::try_from(selector.order_for(view.model(id))).unwrap_or(u32::MAX),
                observations: live.observations,
                last_time: live.persistence.last().map(|(nanos, _)| timestamp(nanos)),
            };
            if replies.blocking_send(Ok(reply)).is_err() {
                return;
            }
        }
    }
}
