//! A map with one state: it is asked for a day before it learns that day.
//!
//! Invariant: predictions use looks of earlier days only, and are made as a daemon makes them: the value by
//! [`MapView::predict_into`], the intervals by [`MapView::intervals`].

use std::sync::{Arc, atomic::AtomicU64};

use tidemap_map::{
    event::{Envelope, Event, NewState, Observations, SequenceSpan, StateKind, UpdateCause},
    ids::{ProducerId, StateId},
    live_map::LiveMap,
    name::{MapName, ProducerKey, StateName},
    spec::MapSpec,
    view::MapView,
};
use tidemap_model::{HeldInterval, Zone, selector::ModelSelector};

use super::{HabitsError, LEVELS, world::Look};
use crate::readings_in_memory::ReadingsInMemory;

/// The only state of the map.
pub(super) const STATE: StateId = StateId(0);

/// What the map says of a day.
#[derive(Clone, Debug)]
pub(super) struct DayAhead {
    /// The probability of 1 at each time that was asked for.
    pub(super) values: Vec<f64>,
    /// The interval of each hour, for each of [`LEVELS`].
    pub(super) hours: [Vec<HeldInterval>; LEVELS.len()],
}

/// A map that learns night by night.
#[derive(Debug)]
pub(super) struct HabitLearner {
    map: LiveMap,
    sequence: u64,
    history: ReadingsInMemory,
}

impl HabitLearner {
    /// An untrained map with default properties and one state.
    pub(super) fn new(zone: Zone, created_nanos: i64) -> Result<Self, HabitsError> {
        let name = MapName::new("habits").map_err(HabitsError::setting)?;
        let spec = MapSpec { zone, created_nanos, ..MapSpec::new(name) };
        let mut map = LiveMap::new(Arc::new(spec));
        let name = StateName::new("state").map_err(HabitsError::setting)?;
        map.apply(1, &Event::AddState(NewState::sampled(STATE, name, StateKind::Probability)))?;
        Ok(Self { map, sequence: 0, history: ReadingsInMemory::default() })
    }

    /// What readers of the map see.
    pub(super) fn view(&mut self) -> MapView {
        self.map.publish()
    }

    /// Predictions at times in nanoseconds UTC, and of hours, each by its middle.
    pub(super) fn ask(&mut self, times: &[i64], hours: &[i64]) -> DayAhead {
        let (view, auto) = (self.view(), ModelSelector::default());
        let predict = |times: &[i64]| {
            let times = view.prepare(times);
            let mut values = vec![0.0; times.len()];
            view.predict_into(STATE, &times, auto, &mut values);
            (times, values)
        };
        let (middles, of_hours) = predict(hours);
        let hours = LEVELS.map(|level| view.intervals(STATE, middles.moments(), &of_hours, Some(level)));
        DayAhead { values: predict(times).1, hours }
    }

    /// Learns the looks of a day at the midnight that ends it.
    pub(super) fn learn(&mut self, looks: &[Look], midnight_nanos: i64) -> Result<(), HabitsError> {
        if looks.is_empty() {
            return Ok(());
        }
        let key = ProducerKey::new("robot", "").map_err(HabitsError::setting)?;
        let first = self.sequence + 1;
        self.sequence += looks.len() as u64;
        let envelope = Envelope {
            producer: ProducerId(0),
            new_producer: (first == 1).then(|| key.into()),
            incarnation: 1,
            span: SequenceSpan { first, last: self.sequence, content_crc: 0 },
            received_nanos: midnight_nanos,
            refused: Vec::new(),
        };
        let mut event = Observations::default();
        for look in looks {
            event.push(STATE, look.sample);
        }
        self.map.apply(self.map.position() + 1, &Event::Observations(envelope, event))?;
        let start = self.map.plan_update(Some(midnight_nanos), midnight_nanos, UpdateCause::Midnight);
        let work = self.map.apply(self.map.position() + 1, &Event::UpdateStart(start))?;
        if let Some(work) = work {
            let learned = work.with_readings(Arc::new(self.history.clone())).run(&AtomicU64::new(0))?;
            self.history.keep(self.map.finish_update(learned).history);
        }
        Ok(())
    }
}
