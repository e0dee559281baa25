//! Comparing predictions with given observations, which are not learned.
//!
//! A request takes a bounded number of states. More states make further requests, each with its portion of the states;
//! the results stand in the order of the states' first appearance. Each request compares with the generation that is
//! published when it begins.
//!
//! Invariant: observations are sent in messages of bounded size; none is kept here after its message is full.

use std::collections::{HashMap, HashSet};

use tidemap_proto::{
    convert::query::selector_to_wire,
    v1::{self, EvaluateStatesRequest, evaluate_states_request::Message},
};
use tokio::{sync::mpsc, task::JoinHandle};
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;

use super::{ModelKind, ModelSelector, ORDER_MAX, selector_of};
use crate::{
    connection::Client,
    error::Error,
    observe::columns::{BatchLimits, Entry, StreamTable, declare_labels, fitting, pack},
};

/// Limits of one message of the daemon.
const LIMITS: BatchLimits = BatchLimits { observations: 4096, bytes: 1 << 20 };
const QUEUED_MESSAGES: usize = 2;
/// Limits of one request of the daemon: states, and states times models and orders.
const STATES_MAX: usize = 10_000;
const SUMS_MAX: usize = 1_000_000;
/// Maximum number of requests at once: half of the requests that a connection takes. The last request takes all further
/// states, and the daemon reports its limit.
const PORTIONS_MAX: usize = 32;

/// A request for a comparison.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EvaluateOptions {
    /// Name of the map.
    pub map: String,
    /// The models; the spectral model without an order means every order up to `max_order`.
    pub models: Vec<ModelSelector>,
    /// Greatest order; 15 if absent.
    pub max_order: Option<u32>,
}

/// The errors of a model on a state.
#[derive(Clone, Debug, PartialEq)]
pub struct StateEvaluation {
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
    /// Mean surprise of the labels of a categorical state, bits; absent for other states.
    pub log_loss_bits: Option<f64>,
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
    pub evaluations: Vec<StateEvaluation>,
    /// The models that could not be compared.
    pub unavailable: Vec<Unavailable>,
}

/// A comparison in progress.
#[derive(Debug)]
pub struct Evaluator {
    client: Client,
    header: v1::EvaluateHeader,
    /// Maximum number of states of one portion.
    states_per_portion: usize,
    portions: Vec<StatePortion>,
    /// The portion of each state, and its index in the portion.
    places: HashMap<Box<str>, (usize, u32)>,
}

/// One request, with its portion of the states.
#[derive(Debug)]
struct StatePortion {
    requests: mpsc::Sender<EvaluateStatesRequest>,
    answer: JoinHandle<Result<v1::EvaluateStatesResponse, Status>>,
    entries: Vec<Entry>,
    names: Vec<Box<str>>,
    /// The names that are names of labels.
    labels: HashSet<Box<str>>,
    table: StreamTable,
}

impl Client {
    /// Starts a comparison.
    #[must_use]
    pub fn evaluate(&self, options: EvaluateOptions) -> Evaluator {
        let orders = options.max_order.map_or(ORDER_MAX, |order| order as usize) + 1;
        let rows = |model: &ModelSelector| match model.order {
            None if model.kind == ModelKind::Spectral => orders,
            _ => 1,
        };
        let rows = if options.models.is_empty() { orders } else { options.models.iter().map(rows).sum() };
        let header = v1::EvaluateHeader {
            map: options.map,
            models: options.models.into_iter().map(selector_to_wire).collect(),
            max_order: options.max_order,
        };
        Evaluator {
            client: self.clone(),
            portions: vec![StatePortion::begin(self, &header)],
            header,
            states_per_portion: (SUMS_MAX / rows.max(1)).clamp(1, STATES_MAX),
            places: HashMap::new(),
        }
    }
}

impl Evaluator {
    /// Adds an observation; its time is at least 0. `false`: the daemon accepts no more, and [`Evaluator::finish`]
    /// returns the reason.
    pub async fn add(&mut self, state: &str, time_nanos: i64, value: f64) -> bool {
        self.add_to(state, time_nanos, value, false).await
    }

    /// Does the same as [`Evaluator::add`], for a categorical state: adds the label that held.
    pub async fn add_label(&mut self, state: &str, time_nanos: i64, label: &str) -> bool {
        self.add_to(&format!("{state}/{label}"), time_nanos, 1.0, true).await
    }

    async fn add_to(&mut self, state: &str, time_nanos: i64, value: f64, is_label: bool) -> bool {
        let (portion, index) = match self.places.get(state) {
            Some(&place) => place,
            None => self.place(state, is_label),
        };
        let Some(portion) = self.portions.get_mut(portion) else { return false };
        portion.entries.push(Entry { state: index, time_nanos: time_nanos.max(0), value, position: None });
        portion.entries.len() < LIMITS.observations || portion.send().await
    }

    /// The place of a new state, in the last portion or a new one.
    fn place(&mut self, state: &str, is_label: bool) -> (usize, u32) {
        let is_full = |portion: &StatePortion| portion.names.len() >= self.states_per_portion;
        if self.portions.len() < PORTIONS_MAX && self.portions.last().is_none_or(is_full) {
            self.portions.push(StatePortion::begin(&self.client, &self.header));
        }
        let last = self.portions.len() - 1;
        let portion = &mut self.portions[last];
        let place = (last, u32::try_from(portion.names.len()).unwrap_or(u32::MAX));
        portion.names.push(state.into());
        if is_label {
            portion.labels.insert(state.into());
        }
        self.places.insert(state.into(), place);
        place
    }

    /// Sends the remaining observations and waits for the result.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map or state does not exist.
    pub async fn finish(self) -> Result<Comparison, Error> {
        let mut whole = Comparison::default();
        for portion in self.portions {
            let answer = portion.finish().await?.map_err(|status| self.client.error(&status))?;
            whole.evaluations.extend(answer.evaluations.into_iter().map(from_wire));
            for missing in answer.unavailable {
                let (model, reason) = (selector_of(missing.model), missing.reason);
                let known = whole.unavailable.iter_mut().find(|known| known.model == model && known.reason == reason);
                match known {
                    Some(known) => known.states.extend(missing.states),
                    None => whole.unavailable.push(Unavailable { model, reason, states: missing.states }),
                }
            }
        }
        Ok(whole)
    }
}

impl StatePortion {
    fn begin(client: &Client, header: &v1::EvaluateHeader) -> Self {
        let (requests, outgoing) = mpsc::channel(QUEUED_MESSAGES);
        // A new channel has room.
        let _ = requests.try_send(EvaluateStatesRequest { message: Some(Message::Header(header.clone())) });
        let mut service = client.query_service();
        let answer = tokio::spawn(async move {
            let response = service.evaluate_states(ReceiverStream::new(outgoing)).await?;
            Ok(response.into_inner())
        });
        Self {
            requests,
            answer,
            entries: Vec::new(),
            names: Vec::new(),
            labels: HashSet::new(),
            table: StreamTable::default(),
        }
    }

    async fn send(&mut self) -> bool {
        let mut rest = self.entries.as_slice();
        while !rest.is_empty() {
            let count = fitting(rest.iter(), &self.names, &self.table, LIMITS);
            let (piece, after) = rest.split_at(count);
            let mut columns = pack(piece, &self.names, &mut self.table);
            declare_labels(&mut columns, |name| self.labels.contains(name));
            let message = Message::Observations(columns);
            if self.requests.send(EvaluateStatesRequest { message: Some(message) }).await.is_err() {
                return false;
            }
            rest = after;
        }
        self.entries.clear();
        true
    }

    async fn finish(mut self) -> Result<Result<v1::EvaluateStatesResponse, Status>, Error> {
        self.send().await;
        let Self { requests, answer, .. } = self;
        drop(requests);
        answer.await.map_err(|_| Error::Protocol("the comparison was interrupted"))
    }
}

fn from_wire(evaluation: v1::Evaluation) -> StateEvaluation {
    StateEvaluation {
        state: evaluation.state,
        model: selector_of(evaluation.model),
        observations: evaluation.observations,
        mean_squared_error: evaluation.mean_squared_error,
        error_rate: evaluation.error_rate,
        log_loss_bits: evaluation.log_loss_bits,
    }
}
