//! Erasing some of the observations of states: what is read before the map is written again.
//!
//! Invariant: nothing is changed here. The same files give the same result, so that a start repeats an erasure exactly.

use std::collections::{BTreeMap, BTreeSet};

use tidemap_layout::lists::ErasedPart;
use tidemap_map::{
    erasure::{Decision, NotErasable, Relearning, Selection, StateErasure, Survey},
    event::Event,
    ids::{ProducerId, StateId},
    name::{NAME_CHARS_MAX, ProducerKey},
    snapshot::{MapSnapshot, StateSnapshot},
};

use super::{Erased, Rewrite};
use crate::error::{EraseError, OpenError};

/// About the maximum number of observations that are in memory at once while states are learned anew: 100 MB.
const RELEARNED_OBSERVATIONS: u64 = 4_000_000;
/// Maximum number of states that are learned anew at once.
const RELEARNED_STATES: usize = 2_000;

/// The producers of a map.
#[derive(Debug, Default)]
struct Producers {
    /// The keys of the producers, by their ids, and whether they have sent scans.
    known: BTreeMap<ProducerId, (ProducerKey, bool)>,
    /// Whether the grid has any scans.
    has_scans: bool,
}

impl Producers {
    fn new(snapshot: Option<&MapSnapshot>) -> Self {
        let marks = snapshot.into_iter().flat_map(|snapshot| &snapshot.producers);
        let known = (0..).map(ProducerId).zip(marks).map(|(id, mark)| (id, (mark.key.clone(), mark.has_scans)));
        let grid = snapshot.and_then(|snapshot| snapshot.grid.as_ref());
        Self { known: known.collect(), has_scans: grid.is_some_and(|grid| grid.scans > 0) }
    }

    fn event(&mut self, event: &Event) {
        let Some(envelope) = event.envelope() else { return };
        if let Some(new) = &envelope.new_producer {
            self.known.entry(envelope.producer).or_insert_with(|| (new.key.clone(), false));
        }
        if let Event::Scans(..) = event
            && let Some((_, has_scans)) = self.known.get_mut(&envelope.producer)
        {
            (*has_scans, self.has_scans) = (true, true);
        }
    }

    /// Refuses a selection that has scans.
    fn check(&self, selection: &Selection) -> Result<(), EraseError> {
        if selection.states.is_some() || !self.has_scans {
            return Ok(());
        }
        let Some(selected) = &selection.producers else { return Err(EraseError::HasScans { producer: None }) };
        match selected.iter().filter_map(|id| self.known.get(id)).find(|(_, has_scans)| *has_scans) {
            Some((key, _)) => Err(EraseError::HasScans { producer: Some(key.clone()) }),
            None => Ok(()),
        }
    }

    /// Keys under which the sequences of producers stay, so that their own keys are new.
    fn withdrawn(&self, producers: &[u32]) -> BTreeMap<ProducerId, ProducerKey> {
        let mut used: BTreeSet<ProducerKey> = self.known.values().map(|(key, _)| key.clone()).collect();
        let mut keys = BTreeMap::new();
        for id in producers.iter().copied().map(ProducerId) {
            let Some((key, _)) = self.known.get(&id) else { continue };
            let other = (1_u64..).find_map(|number| {
                let label = format!("withdrawn {number}: {}", key.label());
                let label: String = label.chars().take(NAME_CHARS_MAX).collect();
                ProducerKey::new(key.producer(), label.trim_end()).ok().filter(|key| !used.contains(key))
            });
            if let Some(other) = other {
                used.insert(other.clone());
                keys.insert(id, other);
            }
        }
        keys
    }
}

impl Rewrite<'_> {
    /// The erasure of a part, with its states learned anew.
    pub(super) fn part(
        &self,
        snapshot: Option<&MapSnapshot>,
        states: Vec<StateId>,
        part: &ErasedPart,
    ) -> Result<(StateErasure, Erased), EraseError> {
        let selection = Selection {
            states: (!states.is_empty()).then(|| states.into_iter().collect()),
            producers: (!part.producers.is_empty()).then(|| part.producers.iter().copied().map(ProducerId).collect()),
            from_nanos: part.from_nanos,
            to_nanos: part.to_nanos,
        };
        let mut survey = Survey::new(selection.clone(), snapshot);
        let mut producers = Producers::new(snapshot);
        let generation = snapshot.map_or(0, |snapshot| snapshot.generation);
        self.history().each_generation(generation, None, |piece, _| survey.history(piece))?;
        let (position, replay_from) = snapshot.map_or((0, 1), |snapshot| (snapshot.position, snapshot.replay_from));
        for entry in self.events(position, replay_from.max(1))? {
            let (at, event) = entry?;
            if at >= replay_from {
                survey.event(at, &event);
                producers.event(&event);
            }
        }
        producers.check(&selection)?;
        let decision = match survey.decide() {
            // The order still has a sequence to forget.
            Err(NotErasable::Nothing) if part.forgets => Decision::default(),
            decision => decision?,
        };
        let erased = Erased { states: decision.states, observations: decision.observations };
        let (emptied, keys) = match part.forgets {
            true => (Vec::new(), producers.withdrawn(&part.producers)),
            false => (decision.emptied.clone(), BTreeMap::new()),
        };
        let relearned = self.relearn(snapshot, &selection, &decision)?;
        let erasure = StateErasure::of_part(emptied, selection, decision, relearned).with_keys(keys);
        Ok((erasure, erased))
    }

    fn relearn(
        &self,
        snapshot: Option<&MapSnapshot>,
        selection: &Selection,
        decision: &Decision,
    ) -> Result<BTreeMap<StateId, StateSnapshot>, EraseError> {
        let mut relearned = BTreeMap::new();
        let Some(snapshot) = snapshot else { return Ok(relearned) };
        let of_snapshot = |id: &StateId| Some((*id, snapshot.states.get(id.0 as usize)?.clone()));
        let mut rest: Vec<(StateId, StateSnapshot)> = decision.relearned.iter().filter_map(of_snapshot).collect();
        while !rest.is_empty() {
            let mut observations = 0_u64;
            let batch = rest.iter().take(RELEARNED_STATES).take_while(|(_, state)| {
                observations = observations.saturating_add(state.observations);
                observations <= RELEARNED_OBSERVATIONS
            });
            let later = rest.split_off(batch.count().max(1));
            let ids: Vec<StateId> = rest.iter().map(|(id, _)| *id).collect();
            let mut relearning = Relearning::new(self.spec, selection, decision, rest);
            self.history().each_generation(snapshot.generation, Some(&ids), |piece, to_nanos| {
                relearning.history(piece, to_nanos);
            })?;
            let learned = relearning
                .learn()
                .map_err(|error| OpenError::Damaged { file: self.history().folder, reason: error.to_string() })?;
            relearned.extend(learned);
            rest = later;
        }
        Ok(relearned)
    }
}
