//! Classifications: which label of a categorical state holds.
//!
//! Invariant: a reply has all labels of the state, in their order.

use tidemap_proto::{
    convert::{query::selector_to_wire, time::timestamp},
    v1::{self, observation_service_client::ObservationServiceClient},
};

use crate::{connection::Client, error::Error, queries::ModelSelector};

pub use tidemap_proto::convert::classify::Learning;

/// A request to classify one reading.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClassifyRequest {
    /// The categorical state.
    pub state: String,
    /// The time of the observation, nanoseconds UTC; `None`: now.
    pub time_nanos: Option<i64>,
    /// Labels with the likelihood of the observation under each; labels that are not here have likelihood 0.
    pub likelihoods: Vec<(String, f64)>,
    /// The place of the observation.
    pub place: Option<String>,
    /// The model of the temporal prior.
    pub model: ModelSelector,
    /// The producer and number with which the answer is learned; `None`: nothing is learned.
    pub learn: Option<LearnAs>,
}

/// The way in which the map learns a classification: its form, producer, label and number.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LearnAs {
    /// The likeliest label, or the probabilities.
    pub what: Learning,
    /// The name of the producer.
    pub producer: String,
    /// The label of the producer's sequence.
    pub label: String,
    /// The number of the first reading; `None`: the next one.
    pub first_sequence: Option<u64>,
}

/// The posterior of one label, with the factors that it is computed from.
#[derive(Clone, Debug, PartialEq)]
pub struct ClassifiedLabel {
    /// The label.
    pub label: String,
    /// The probability that it holds.
    pub probability: f64,
    /// The likelihood of the label, as in the request.
    pub likelihood: f64,
    /// The probability of the label from the time alone.
    pub temporal_prior: f64,
    /// The probability of being at the place while it holds; `None`: not known.
    pub spatial_prior: Option<f64>,
}

/// A classification.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Classification {
    /// All labels, in their order.
    pub labels: Vec<ClassifiedLabel>,
    /// With learning: all readings up to this number are durable or refused.
    pub durable_sequence: u64,
    /// With learning: why readings were refused.
    pub refusals: Vec<String>,
}

impl Client {
    /// Computes which label of a categorical state holds, from likelihoods and the times and places that the map has
    /// learned; learns the answer if the request has `learn`.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map or the state does not exist, `INVALID_ARGUMENT` if a label is
    /// unknown, `PERMISSION_DENIED` if the token may not learn.
    pub async fn classify(&self, map: &str, request: ClassifyRequest) -> Result<Classification, Error> {
        let ClassifyRequest { state, time_nanos, likelihoods, place, model, learn } = request;
        let likelihood = |(label, likelihood)| v1::LabelLikelihood { label, likelihood };
        let learn = learn.unwrap_or_default();
        let request = v1::ClassifyActivityRequest {
            map: map.to_owned(),
            state,
            time: time_nanos.map(timestamp),
            likelihoods: likelihoods.into_iter().map(likelihood).collect(),
            place: place.unwrap_or_default(),
            model: Some(selector_to_wire(model)),
            learn: match learn.what {
                Learning::Nothing => v1::ActivityLearning::Nothing,
                Learning::Label => v1::ActivityLearning::Label,
                Learning::Shares => v1::ActivityLearning::Shares,
            }
            .into(),
            producer: learn.producer,
            producer_label: learn.label,
            first_sequence: learn.first_sequence.unwrap_or(0),
        };
        let reply = ObservationServiceClient::new(self.requests()).classify_activity(request).await;
        let reply = reply.map_err(|status| self.error(&status))?.into_inner();
        let label = |known: v1::ClassifiedLabel| ClassifiedLabel {
            label: known.label,
            probability: known.probability,
            likelihood: known.likelihood,
            temporal_prior: known.temporal_prior,
            spatial_prior: known.spatial_prior,
        };
        Ok(Classification {
            labels: reply.labels.into_iter().map(label).collect(),
            durable_sequence: reply.durable_sequence,
            refusals: reply.refused.into_iter().map(|refusal| refusal.detail).collect(),
        })
    }
}
