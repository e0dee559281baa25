//! Forks of a map of this daemon, for operators: the content of a fork, compared with the map, and its records to send
//! again.
//!
//! Invariant: the numbers of a producer or a state that the fork added are those of the fork. The numbers of one that
//! both the fork and the map had before are those of the map.

use std::{
    collections::{BTreeMap, HashMap},
    sync::Arc,
    time::Duration,
};

use tidemap_ingest::{
    catalog::CatalogError,
    cluster::operations::OperationError,
    handle::MapHandle,
    protocol::{Command, KnownProducer},
};
use tidemap_map::{
    event::{Event, NewState, SequenceSpan, StateShape},
    ids::{ProducerId, StateId},
    name::{ProducerKey, StateName},
    snapshot::ProducerMark,
    view::MapView,
};
use tidemap_proto::{
    convert::forks::{
        ForkedProducer, ForkedState, added_state_to_wire, forked_observations_to_wire, forked_parts_to_wire,
        forked_producer_to_wire, left_to_wire,
    },
    v1::{self, read_fork_response::Part},
};
use tidemap_store::{Fork, MapId, Store};
use tokio::sync::oneshot;

use super::{replies::ReplySink, status::RpcError};

/// Maximum time in which the thread of a map must list its producers.
const PRODUCERS_WITHIN: Duration = Duration::from_secs(1);
/// Number of observations in one reply.
const OBSERVATIONS_AT_ONCE: usize = 2048;

/// The producers of a map, by their number in it; empty if the map does not answer.
pub(super) async fn known_producers(handle: &MapHandle) -> BTreeMap<ProducerId, KnownProducer> {
    let (reply, known) = oneshot::channel();
    let answer = async { if handle.send(Command::ListProducers(reply)) { known.await.ok() } else { None } };
    let known = tokio::time::timeout(PRODUCERS_WITHIN, answer).await.ok().flatten().unwrap_or_default();
    known.into_iter().map(|producer| (producer.id, producer)).collect()
}

/// The number up to which the map has the same observations as the fork, in a part of a producer's sequence. A producer
/// that began anew has sent other observations with these numbers.
fn known_to(mark: &ProducerMark, incarnation: u64, span: SequenceSpan) -> u64 {
    let at_last = mark.content_marks().into_iter().find(|content| content.sequence == span.last);
    let is_same = at_last.map_or(mark.incarnation == incarnation, |content| content.crc == span.content_crc);
    if is_same { span.last.min(mark.durable_sequence) } else { 0 }
}

/// The names of the producers and states of a fork. One that is new in the fork may have another number in the map.
#[derive(Default)]
struct ForkNames {
    producers: HashMap<ProducerId, ProducerKey>,
    states: HashMap<StateId, ForkedState>,
}

impl ForkNames {
    /// Adds the producers and states that an event adds.
    fn learn(&mut self, event: &Event) {
        let new_states: &[NewState] = match event {
            Event::Observations(_, event) => &event.new_states,
            Event::AddState(new) => std::slice::from_ref(new),
            _ => &[],
        };
        self.states.extend(new_states.iter().map(|new| (new.id, ForkedState::from(new))));
        if let Some(envelope) = event.envelope()
            && let Some(new) = &envelope.new_producer
        {
            self.producers.insert(envelope.producer, new.key.clone());
        }
    }

    /// The name and the label of a producer.
    fn producer(&self, id: ProducerId, known: &BTreeMap<ProducerId, KnownProducer>) -> (String, String) {
        let key = self.producers.get(&id).or_else(|| known.get(&id).map(|known| &known.mark.key));
        key.map_or_else(
            || (format!("number {}", id.0), String::new()),
            |key| (key.producer().to_owned(), key.label().to_owned()),
        )
    }

    /// The state that observations name, whose first part has this id.
    fn state(&self, id: StateId, view: &MapView) -> Option<ForkedState> {
        if let Some(new) = self.states.get(&id) {
            return Some(new.clone());
        }
        let name = &view.info(id)?.name;
        let whole = [Some(name.as_str()), name.as_str().rsplit_once('/').map(|(whole, _)| whole)];
        whole.into_iter().flatten().find_map(|whole| {
            let (_, shape) = view.shape(whole).filter(|(first, _)| *first == id)?;
            let labels = match shape {
                StateShape::Categorical(_) => view.labels(whole),
                _ => Vec::new(),
            };
            let labels = labels.into_iter().filter_map(|(id, _)| Some(view.info(id)?.name.clone())).collect();
            Some(ForkedState {
                name: if whole == name.as_str() { name.clone() } else { StateName::new(whole).ok()? },
                shape,
                labels,
            })
        })
    }
}

/// The content of a fork, compared with what the map has by now.
#[derive(Debug, Default)]
pub(super) struct ForkContent {
    /// The observations of each producer, by its name and label.
    producers: BTreeMap<(String, String), ForkedProducer>,
    /// Number of other records that the map does not have.
    other_records: u64,
}

impl ForkContent {
    /// Whether the map has all of it.
    fn is_known(&self) -> bool {
        let is_known = |held: &ForkedProducer| held.known_observations == held.observations;
        self.other_records == 0 && self.producers.values().all(is_known)
    }
}

/// A fork with its content, for the wire.
pub(super) fn fork_to_wire(fork: Fork, content: ForkContent) -> v1::LogFork {
    let producer = |((producer, label), held)| forked_producer_to_wire(producer, label, held);
    v1::LogFork {
        name: fork.name,
        first_position: fork.first,
        last_position: fork.last,
        groups: fork.groups as u64,
        producers: content.producers.into_iter().map(producer).collect(),
        other_records: content.other_records,
    }
}

/// Reads the content of a fork, and compares it with what the map has by now.
///
/// # Errors
/// The fork cannot be read.
pub(super) fn content_of(
    store: &Store,
    map: MapId,
    fork: &Fork,
    (view, known): (&MapView, &BTreeMap<ProducerId, KnownProducer>),
) -> Result<ForkContent, OperationError> {
    let mut content = ForkContent::default();
    let mut names = ForkNames::default();
    for (_, event) in store.fork_events(map, &fork.name)? {
        let Some(envelope) = event.envelope() else {
            names.learn(&event);
            content.other_records += u64::from(match &event {
                Event::AddState(new) => view.shape(new.name.as_str()).is_none_or(|(_, shape)| shape != new.shape),
                Event::EditSite(_) => true,
                // The map has its own epochs and updates.
                _ => false,
            });
            continue;
        };
        names.learn(&event);
        let (producer, label) = names.producer(envelope.producer, known);
        let same = |known: &&KnownProducer| known.mark.key.producer() == producer && known.mark.key.label() == label;
        let mark = known.values().find(same).map(|known| &known.mark);
        let span = envelope.span;
        let known_to = mark.map_or(0, |mark| known_to(mark, envelope.incarnation, span));
        let row = content.producers.entry((producer, label)).or_insert_with(|| ForkedProducer {
            first_sequence: span.first,
            last_sequence: span.last,
            observations: 0,
            known_observations: 0,
        });
        row.last_sequence = span.last;
        row.observations += (span.last + 1).saturating_sub(span.first);
        row.known_observations += (known_to + 1).saturating_sub(span.first);
    }
    Ok(content)
}

/// Removes forks of a single group whose observations the map has completely. A daemon that is lost while a group is
/// decided about leaves such a fork behind, and its producers have sent the observations again. Returns the names of
/// the removed forks.
///
/// # Errors
/// A fork cannot be read or removed.
pub async fn remove_known(store: &Arc<Store>, handle: &MapHandle) -> Result<Vec<String>, CatalogError> {
    let (for_list, id) = (Arc::clone(store), handle.id);
    let Ok(forks) = tidemap_base::task::blocking(move || for_list.forks(id)).await else { return Ok(Vec::new()) };
    let forks: Vec<Fork> = forks?.into_iter().filter(|fork| fork.groups == 1).collect();
    if forks.is_empty() {
        return Ok(Vec::new());
    }
    let (store, view, known) = (Arc::clone(store), handle.view(), known_producers(handle).await);
    let remove = move || {
        let mut removed = Vec::new();
        for fork in forks {
            // A fork that cannot be read stays for the operator.
            let Ok(content) = content_of(&store, id, &fork, (&view, &known)) else { continue };
            if content.is_known() {
                store.remove_fork(id, &fork.name)?;
                removed.push(fork.name);
            }
        }
        Ok(removed)
    };
    tidemap_base::task::blocking(remove).await.unwrap_or(Ok(Vec::new()))
}

/// Sends the records of a fork, in its order.
pub(super) fn read_fork(
    store: &Store,
    handle: &MapHandle,
    fork: &str,
    known: &BTreeMap<ProducerId, KnownProducer>,
    sink: &ReplySink<v1::ReadForkResponse>,
) -> Result<(), RpcError> {
    let map = handle.spec.name.as_str();
    let view = handle.view();
    let mut names = ForkNames::default();
    for (_, event) in store.fork_events(handle.id, fork).map_err(OperationError::from)? {
        let before = names.states.len();
        names.learn(&event);
        let new_states: &[NewState] = match &event {
            Event::Observations(_, event) if names.states.len() > before => &event.new_states,
            Event::AddState(new) => std::slice::from_ref(new),
            _ => &[],
        };
        // A request does not add the states that reports add.
        let is_own = |new: &&NewState| StateName::observed(new.name.as_str()).is_ok();
        let mut parts: Vec<Part> =
            new_states.iter().filter(is_own).map(|new| Part::State(added_state_to_wire(map, new))).collect();
        let observations = match &event {
            Event::Observations(envelope, observations) => {
                forked_observations_to_wire(envelope, observations, |id| names.state(id, &view))
            }
            Event::Scans(envelope, _) => left_to_wire(envelope, "a scan"),
            Event::EditSite(_) => {
                parts.push(Part::Other("a change of the site".to_owned()));
                Vec::new()
            }
            // The map has its own updates and epochs.
            Event::AddState(_)
            | Event::UpdateStart(_)
            | Event::Epoch(_)
            | Event::UpdateDone(_)
            | Event::ForgetProducers(_) => Vec::new(),
        };
        if let Some(envelope) = event.envelope() {
            let producer = names.producer(envelope.producer, known);
            let observations = forked_parts_to_wire(producer, envelope, observations, OBSERVATIONS_AT_ONCE);
            parts.extend(observations.map(Part::Observations));
        }
        if !parts.into_iter().all(|part| sink.send(v1::ReadForkResponse { part: Some(part) })) {
            return Ok(());
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use tidemap_map::{name::ProducerKey, snapshot::ContentMark};

    use super::*;

    #[test]
    fn the_map_has_observations_of_a_fork_only_if_the_producer_has_not_begun_anew() {
        let mark = ProducerMark {
            key: ProducerKey::new("robot", "").expect("valid"),
            incarnation: 3,
            durable_sequence: 20,
            content_crc: 0xB,
            sensor: None,
            received_nanos: 0,
            newest_nanos: 0,
            recent: vec![ContentMark { sequence: 15, crc: 0xA }],
            has_scans: false,
            is_forgotten: false,
            introduced_by: String::new(),
        };
        let span = |first, last, content_crc| SequenceSpan { first, last, content_crc };
        assert_eq!(known_to(&mark, 3, span(9, 12, 0)), 12, "it is the producer that the fork knew");
        assert_eq!(known_to(&mark, 3, span(19, 24, 0)), 20, "some came after");
        assert_eq!(known_to(&mark, 2, span(9, 12, 0)), 0, "it began anew, and may have sent others");
        assert_eq!(known_to(&mark, 2, span(9, 15, 0xA)), 15, "it sent the very observations");
        assert_eq!(known_to(&mark, 3, span(19, 20, 0xC)), 0, "the map has others");
    }
}
