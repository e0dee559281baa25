//! Comparing predictions with given observations, which are not learned.
//!
//! Invariant: observations are sent in messages of bounded size; none is kept here after its message is full.

use std::collections::HashMap;

use tidemap_proto::{
    convert::query::selector_to_wire,
    v1::{self, EvaluateStatesRequest, evaluate_states_request::Message},
};
use tokio::{sync::mpsc, task::JoinHandle};
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;

use super::{ModelSelector, selector_of};
use crate::{
    connection::Client,
    error::Error,
    observe::columns::{BatchLimits, Entry, StreamTable, fitting, pack},
};

/// Limits of one message of the daemon.
const LIMITS: BatchLimits = BatchLimits { observations: 4096, bytes: 1 << 20 };
const QUEUED_MESSAGES: usize = 2;

/// A request for a comparison.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EvaluateOptions {
    /// Name of the map.
    pub map: String,
    /// The models; the spectral one without an order stands for every order up to `max_order`.
    pub models: Vec<ModelSelector>,
    /// Greatest order; 15 if absent.
    pub max_order: Option<u32>,
}

/// How well a model predicted a state.
#[derive(Clone, Debug, PartialEq)]
pub struct Evaluation {
    /// Name of the state.
    pub state: String,
    /// The model, with its order or parameter filled in.
    pub model: ModelSelector,
    /// Number of observations compared.
    pub observations: u64,
    /// Mean squared error, in the square of the values' unit.
    pub mean_squared_error: f64,
    /// Share of observations on the other side of 0.5 than their prediction; absent for other kinds than probabilities.
    pub error_rate: Option<f64>,
}

/// A model that could not be compared for some states.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unavailable {
    /// The model, with its parameter filled in.
    pub model: ModelSelector,
    /// Reason in words.
    pub reason: String,
    /// Names of the states.
    pub states: Vec<String>,
}

/// The result of a comparison.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Comparison {
    /// The evaluations, by state in the order of first appearance, then by model, then by order.
    pub evaluations: Vec<Evaluation>,
    /// The models that could not be compared.
    pub unavailable: Vec<Unavailable>,
}

/// A comparison in progress.
#[derive(Debug)]
pub struct Evaluator {
    client: Client,
    requests: mpsc::Sender<EvaluateStatesRequest>,
    answer: JoinHandle<Result<v1::EvaluateStatesResponse, Status>>,
    entries: Vec<Entry>,
    names: Vec<Box<str>>,
    indices: HashMap<Box<str>, u32>,
    table: StreamTable,
}

impl Client {
    /// Starts a comparison.
    #[must_use]
    pub fn evaluate(&self, options: EvaluateOptions) -> Evaluator {
        let header = v1::EvaluateHeader {
            map: options.map,
            models: options.models.into_iter().map(selector_to_wire).collect(),
            max_order: options.max_order,
        };
        let (requests, outgoing) = mpsc::channel(QUEUED_MESSAGES);
        // A new channel has room.
        let _ = requests.try_send(EvaluateStatesRequest { message: Some(Message::Header(header)) });
        let mut service = self.query_service();
        let answer = tokio::spawn(async move {
            let response = service.evaluate_states(ReceiverStream::new(outgoing)).await?;
            Ok(response.into_inner())
        });
        Evaluator {
            client: self.clone(),
            requests,
            answer,
            entries: Vec::new(),
            names: Vec::new(),
            indices: HashMap::new(),
            table: StreamTable::default(),
        }
    }
}

impl Evaluator {
    /// Adds an observation; its time is at least 0. `false`: the daemon accepts no more, and [`Evaluator::finish`]
    /// returns the reason.
    pub async fn add(&mut self, state: &str, time_nanos: i64, value: f64) -> bool {
        let index = match self.indices.get(state) {
            Some(&index) => index,
            None => {
                let index = u32::try_from(self.names.len()).unwrap_or(u32::MAX);
                self.names.push(state.into());
                self.indices.insert(state.into(), index);
                index
            }
        };
        self.entries.push(Entry { state: index, time_nanos: time_nanos.max(0), value, position: None });
        self.entries.len() < LIMITS.observations || self.send().await
    }

    async fn send(&mut self) -> bool {
        let mut rest = self.entries.as_slice();
        while !rest.is_empty() {
            let count = fitting(rest.iter(), &self.names, &self.table, LIMITS);
            let (piece, after) = rest.split_at(count);
            let message = Message::Observations(pack(piece, &self.names, &mut self.table));
            if self.requests.send(EvaluateStatesRequest { message: Some(message) }).await.is_err() {
                return false;
            }
            rest = after;
        }
        self.entries.clear();
        true
    }

    /// Sends the remaining observations and waits for the result.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map or state does not exist.
    pub async fn finish(mut self) -> Result<Comparison, Error> {
        self.send().await;
        let Self { client, requests, answer, .. } = self;
        drop(requests);
        let answer = answer.await.map_err(|_| Error::Protocol("the comparison was interrupted"))?;
        let answer = answer.map_err(|status| client.error(&status))?;
        let unavailable = answer.unavailable.into_iter().map(|missing| Unavailable {
            model: selector_of(missing.model),
            reason: missing.reason,
            states: missing.states,
        });
        Ok(Comparison {
            evaluations: answer.evaluations.into_iter().map(from_wire).collect(),
            unavailable: unavailable.collect(),
        })
    }
}

fn from_wire(evaluation: v1::Evaluation) -> Evaluation {
    Evaluation {
        state: evaluation.state,
        model: selector_of(evaluation.model),
        observations: evaluation.observations,
        mean_squared_error: evaluation.mean_squared_error,
        error_rate: evaluation.error_rate,
    }
}
