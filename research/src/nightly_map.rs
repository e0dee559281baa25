//! A map in memory that one producer observes and that is updated at midnight, as a daemon does it.
//!
//! Invariant: sequence numbers have no gaps, and updates train models on the history of all updates before.

use std::sync::{Arc, atomic::AtomicU64};

use tidemap_map::{
    event::{Envelope, Event, NewState, Observations, SequenceSpan, StateKind, UpdateCause},
    ids::{ProducerId, StateId},
    live_map::{InconsistentEvent, LiveMap},
    name::{ProducerKey, StateName},
    spec::MapSpec,
    update::SumsUnavailable,
    view::MapView,
};

use crate::readings_in_memory::ReadingsInMemory;

/// A map that learns night by night.
#[derive(Debug)]
pub(crate) struct NightlyMap {
    map: LiveMap,
    producer: ProducerKey,
    sequence: u64,
    history: ReadingsInMemory,
}

impl NightlyMap {
    /// An untrained map without states, which this producer observes.
    pub(crate) fn new(spec: MapSpec, producer: ProducerKey) -> NightlyMap {
        let (map, history) = (LiveMap::new(Arc::new(spec)), ReadingsInMemory::default());
        NightlyMap { map, producer, sequence: 0, history }
    }

    pub(crate) fn map(&self) -> &LiveMap {
        &self.map
    }

    /// The view of readers of the map.
    pub(crate) fn view(&mut self) -> MapView {
        self.map.publish()
    }

    /// Applies an event at the next log position.
    pub(crate) fn apply(&mut self, event: &Event) -> Result<(), InconsistentEvent> {
        self.map.apply(self.map.position() + 1, event).map(drop)
    }

    /// Adds a probability, with the next number.
    pub(crate) fn add_probability(&mut self, name: StateName) -> Result<StateId, InconsistentEvent> {
        self.add_state(name, StateKind::Probability)
    }

    /// Adds a state of a kind, with the next number.
    pub(crate) fn add_state(&mut self, name: StateName, kind: StateKind) -> Result<StateId, InconsistentEvent> {
        let id = StateId(self.map.states() as u32);
        self.apply(&Event::AddState(NewState::sampled(id, name, kind)))?;
        Ok(id)
    }

    /// Applies observations, with `numbers` sequence numbers, at least one.
    pub(crate) fn observe(
        &mut self,
        observed: Observations,
        numbers: u64,
        received_nanos: i64,
    ) -> Result<(), InconsistentEvent> {
        let first = self.sequence + 1;
        self.sequence += numbers;
        let envelope = Envelope {
            producer: ProducerId(0),
            new_producer: (first == 1).then(|| self.producer.clone().into()),
            incarnation: 1,
            span: SequenceSpan { first, last: self.sequence, content_crc: 0 },
            received_nanos,
            refused: Vec::new(),
        };
        self.apply(&Event::Observations(envelope, observed))
    }

    /// Learns the observations before midnight.
    pub(crate) fn update<E>(&mut self, midnight_nanos: i64) -> Result<(), E>
    where
        E: From<InconsistentEvent> + From<SumsUnavailable>,
    {
        let start = self.map.plan_update(Some(midnight_nanos), midnight_nanos, UpdateCause::Midnight);
        let work = self.map.apply(self.map.position() + 1, &Event::UpdateStart(start))?;
        if let Some(work) = work {
            let learned = work.with_readings(Arc::new(self.history.clone())).run(&AtomicU64::new(0))?;
            self.history.keep(self.map.finish_update(learned).history);
        }
        Ok(())
    }
}
