//! `ClassifyActivity`: which label of a categorical state holds, from likelihood, temporal prior and spatial prior.
//!
//! A learned activity is stored like other observations: readings of the state and of its state at the place, in one
//! message, so that both are durable or none is.
//!
//! Invariant: the priors are of one view, which is older than the learned readings; a sequence number that the map has
//! is not learned again. A message that the caller may not send adds no state.

use std::sync::Arc;

use tidemap_base::{
    access::{Caller, Role},
    shares::client::Client,
};
use tidemap_ingest::{
    handle::MapHandle,
    protocol::{AddState, AddStateError, Command},
};
use tidemap_map::{label_places::name_at_place, name::StateName, view::MapView};
use tidemap_model::label_evidence::{LabelEvidence, normalise};
use tidemap_proto::{
    convert::{
        classify::{ClassifyQuestion, LabelPosterior, Learning, classification_to_wire, classify_from_wire},
        observe::{StreamMessage, StreamStart, learned_readings, start_of_classification},
        vectors::DeclaredState,
    },
    v1,
};
use tokio::sync::oneshot;
use tonic::Status;

use super::{Observations, report::SentAs};
use crate::{
    guard::current_caller,
    lookup::{check_producer, find_map, find_state},
    permits::run_blocking,
    status::{Problem, RpcError},
};

/// The method name, for the error of a caller that may not learn.
const METHOD: &str = "/tidemap.v1.ObservationService/ClassifyActivity";

impl Observations {
    /// Classifies, and learns if the request sets this.
    pub(super) async fn classify(
        &self,
        request: v1::ClassifyActivityRequest,
    ) -> Result<v1::ClassifyActivityResponse, Status> {
        let handle = find_map(&self.catalog, &request.map).await?;
        let question = classify_from_wire(&request).map_err(RpcError::from)?;
        let start = match question.learning {
            Learning::Nothing => None,
            Learning::Label | Learning::Shares => Some(start_of_classification(&request).map_err(RpcError::from)?),
        };
        if let Some(start) = &start {
            may_learn(&current_caller(), start)?;
        }
        let utc_nanos = question.utc_nanos.unwrap_or_else(|| self.catalog.context().clock.now_nanos());
        let (view, requested) = (handle.view(), question.clone());
        let classified = run_blocking(self.permits.take().await?, move || classified(&view, &requested, utc_nanos));
        let labels = classified.await??;
        let Some(start) = start else { return Ok(classification_to_wire(labels)) };
        let states = self.learned_states(&handle, &question).await?;
        let shares: Vec<(String, f64)> = labels.iter().map(|known| (known.label.clone(), known.probability)).collect();
        let count = states.len() as u64;
        let learned = learned_readings(&states, utc_nanos, question.learning, &shares);
        let sent_as =
            SentAs { map: request.map, start, first_sequence: request.first_sequence, may_differ: Some(count) };
        let items = |first| Ok(StreamMessage::Observations(learned.numbered(first)?));
        let taken = self.take_items(sent_as, items).await?;
        Ok(v1::ClassifyActivityResponse {
            durable_sequence: taken.durable_sequence,
            refused: taken.refused_to_wire(),
            ..classification_to_wire(labels)
        })
    }

    /// The states that learn. The state at the place is added if it does not exist.
    async fn learned_states(
        &self,
        handle: &MapHandle,
        question: &ClassifyQuestion,
    ) -> Result<Vec<StateName>, RpcError> {
        let mut states = vec![question.state.clone()];
        let Some(place) = &question.place else { return Ok(states) };
        let invalid = |error| Problem::Name(error).of("place");
        let at_place = name_at_place(&question.state, place.as_str()).map_err(invalid)?;
        let view = handle.view();
        let (_, shape) = view.shape(question.state.as_str()).ok_or(RpcError::Stopping)?;
        let labels = view.labels(question.state.as_str()).into_iter().map(|(_, label)| at_place.label(label));
        let labels = labels.collect::<Result<Vec<StateName>, _>>().map_err(invalid)?;
        let (reply, added) = oneshot::channel();
        let state = DeclaredState { name: at_place.clone(), shape, labels, sensor: None, reporting: None };
        let is_sent = handle.send(Command::AddState(AddState { state, client: Client::current().share_name(), reply }));
        let added = if is_sent { added.await.ok() } else { None };
        added.unwrap_or(Err(AddStateError::Closing))?;
        states.push(at_place);
        Ok(states)
    }
}

/// Checks that the caller may change the map, and may send as the producer of the request. The session checks this
/// again, but the state at a place is added before it.
fn may_learn(caller: &Caller, start: &StreamStart) -> Result<(), RpcError> {
    match caller {
        caller if caller.has(Role::Observer) => {}
        Caller::Reader => return Err(RpcError::ReadOnly { method: METHOD.to_owned() }),
        _ => return Err(RpcError::NeedsRole { method: METHOD.to_owned(), role: Role::Observer }),
    }
    check_producer(start.key.producer())
}

/// The likelihood and the priors of each label, from a view.
fn classified(
    view: &Arc<MapView>,
    question: &ClassifyQuestion,
    utc_nanos: i64,
) -> Result<Vec<LabelPosterior>, RpcError> {
    let name = question.state.as_str();
    let labels = view.labels(name);
    if labels.is_empty() {
        let state = find_state(view, name)?;
        let (state, kind) = (name.to_owned(), view.kind(state));
        return Err(Problem::NoLabels { state, kind }.of("state").into());
    }
    let mut likelihoods = vec![0.0; labels.len()];
    for (i, (label, likelihood)) in question.likelihoods.iter().enumerate() {
        let Some(at) = labels.iter().position(|(_, known)| known == label) else {
            let (state, label) = (name.to_owned(), label.chars().take(80).collect());
            let labels = labels.iter().map(|(_, label)| (*label).to_owned()).collect();
            return Err(Problem::UnknownLabel { state, label, labels }.of(format!("likelihoods[{i}].label")).into());
        };
        likelihoods[at] = *likelihood;
    }
    let prepared = view.prepare(&[utc_nanos]);
    let mut temporal: Vec<f64> = Vec::with_capacity(labels.len());
    for (id, _) in &labels {
        let mut predicted = [0.0];
        view.predict_into(*id, &prepared, question.selector, &mut predicted);
        temporal.extend(predicted);
    }
    normalise(&mut temporal);
    let spatial = question.place.as_ref().and_then(|place| view.label_prior_at(&question.state, place.as_str()));
    let evidence = LabelEvidence { likelihoods: &likelihoods, temporal: &temporal, spatial: spatial.as_deref() };
    let posterior = evidence.posterior().map_err(|error| Problem::Evidence(error).of("likelihoods"))?;
    let known = |at: usize| LabelPosterior {
        label: labels[at].1.to_owned(),
        probability: posterior[at],
        likelihood: likelihoods[at],
        temporal_prior: temporal[at],
        spatial_prior: spatial.as_ref().map(|spatial| spatial[at]),
    };
    Ok((0..labels.len()).map(known).collect())
}
