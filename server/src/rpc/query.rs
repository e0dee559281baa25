//! `QueryService`: questions to an immutable view.
//!
//! Invariant: a request is answered from one view, off the async threads, in pieces that wait for the reader, and for a
//! bounded time. Only so many requests compute predictions at once; the others wait for them.

use std::{
    collections::{HashMap, hash_map::Entry},
    sync::Arc,
    time::Duration,
};

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
use tokio::sync::{Semaphore, mpsc};
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
/// Requests that compute predictions at once, at least.
const PREDICTING_LEAST: usize = 4;
/// A request waits this long until others have ended.
const TURN_WITHIN: Duration = Duration::from_secs(30);
/// A reader takes a reply within this time.
const READ_WITHIN: Duration = Duration::from_secs(30);
/// Most sums of errors of one evaluation, one per state, model and order: 24 MB, and a reply that can be sent.
const EVALUATION_SUMS_MAX: usize = 1_000_000;

/// The service.
#[derive(Debug)]
pub struct Queries {
    catalog: Arc<Catalog>,
    max_predictions: u64,
    max_batch: usize,
    /// A permit for each request that may compute predictions.
    predicting: Arc<Semaphore>,
    predicting_max: usize,
}

impl Queries {
    /// Answers with at most so many predictions a request, and takes at most so many observations a message.
    #[must_use]
    pub fn new(catalog: Arc<Catalog>, max_predictions: u64, max_batch: usize) -> Self {
        // Twice the processors: some wait for their readers.
        let processors = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let predicting_max = PREDICTING_LEAST.max(2 * processors);
        Self {
            catalog,
            max_predictions,
            max_batch,
            predicting: Arc::new(Semaphore::new(predicting_max)),
            predicting_max,
        }
    }
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
        let turn = Arc::clone(&self.predicting).acquire_owned();
        let permit = match tokio::time::timeout(TURN_WITHIN, turn).await {
            Ok(permit) => permit.map_err(|_| RpcError::Stopping)?,
            Err(_) => return Err(RpcError::NoTurn { max: self.predicting_max, secs: TURN_WITHIN.as_secs() }.into()),
        };
        let (computed, ready) = mpsc::channel(1);
        let (replies, stream) = mpsc::channel(REPLIES_AHEAD);
        let work = tokio::task::spawn_blocking(move || {
            let _permit = permit;
            predict(&view, &states, &request.times_nanos, selector, &computed);
        });
        tokio::spawn(async move {
            let all_sent = pass_on(ready, &replies, READ_WITHIN).await;
            if work.await.is_err() && all_sent {
                // The reader must not take what it has for everything.
                let _ = tokio::time::timeout(READ_WITHIN, replies.send(Err(RpcError::Stopping.into()))).await;
            }
        });
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
                let states = table.len() + 1;
                check_limit("states", states as u64, STATES_MAX as u64, "one evaluation")?;
                let sums = states.saturating_mul(evaluator.sums_per_state()) as u64;
                check_limit("states times models and orders", sums, EVALUATION_SUMS_MAX as u64, "one evaluation")?;
                table.push(find_state(&view, &name)?);
            }
            let max = self.max_batch as u64;
            let setting = "setting max_batch_observations";
            check_limit("observations of one message", columns.time_deltas.len() as u64, max, setting)?;
            let columns = decode(columns).map_err(RpcError::from)?;
            let mut make = view.sample_maker();
            let mut by_state: HashMap<StateId, Vec<Sample>> = HashMap::new();
            let mut first_seen = Vec::new();
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
                let samples = match by_state.entry(state) {
                    Entry::Occupied(samples) => samples.into_mut(),
                    Entry::Vacant(none) => {
                        first_seen.push(state);
                        none.insert(Vec::new())
                    }
                };
                samples.push(make(time, value));
            }
            evaluator = tokio::task::spawn_blocking(move || {
                evaluator.add(&first_seen, &by_state);
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

/// Hands replies to the reader until all are sent, or the reader is gone or too slow, which the last reply says. Whether
/// all were sent.
async fn pass_on(
    mut ready: mpsc::Receiver<v1::PredictStatesResponse>,
    replies: &mpsc::Sender<Result<v1::PredictStatesResponse, Status>>,
    read_within: Duration,
) -> bool {
    // Its place is taken now: there is none when the reader is slow.
    let Ok(last_word) = replies.clone().reserve_owned().await else { return false };
    while let Some(reply) = ready.recv().await {
        match tokio::time::timeout(read_within, replies.send(Ok(reply))).await {
            Ok(Ok(())) => {}
            Ok(Err(_)) => return false,
            Err(_) => {
                last_word.send(Err(RpcError::SlowReader(read_within.as_secs()).into()));
                return false;
            }
        }
    }
    true
}

/// Computes the replies until all are taken or nobody takes them.
fn predict(
    view: &MapView,
    states: &[StateId],
    times_nanos: &[i64],
    selector: ModelSelector,
    computed: &mpsc::Sender<v1::PredictStatesResponse>,
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
            if computed.blocking_send(reply).is_err() {
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_slow_reader_is_told_and_not_waited_for() {
        let (computed, ready) = mpsc::channel(1);
        let (replies, mut stream) = mpsc::channel(3);
        let passing = tokio::spawn(async move { pass_on(ready, &replies, Duration::from_millis(20)).await });
        while computed.send(v1::PredictStatesResponse::default()).await.is_ok() {}
        assert!(!passing.await.expect("no panic"));
        // What was sent before is still read, and then why there is no more.
        assert!(stream.recv().await.expect("a reply").is_ok());
        assert!(stream.recv().await.expect("a reply").is_ok());
        let end = stream.recv().await.expect("an error").expect_err("too slow");
        assert_eq!(end.code(), tonic::Code::ResourceExhausted);
        assert!(stream.recv().await.is_none());
    }
}
