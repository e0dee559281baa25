//! Applies observations and scans to a map.
//!
//! Invariant: an event that is inconsistent with the events before is refused; any other event advances its producer's
//! mark, whatever else it contains.

use std::sync::Arc;
use tidemap_grid::scan::Scans;

use super::LiveMap;
use crate::{
    directory::StateInfo,
    event::{Envelope, NewState, Observations, Reporting, StateKind},
    ids::{NewProducer, ProducerId},
    live_state::Delivery,
    pending::Origin,
    snapshot::{CONTENT_MARKS_MAX, ContentMark, ProducerMark},
    view::{LIVE_CHUNK, LiveState},
};

impl LiveMap {
    pub(super) fn add_producer(&mut self, mark: ProducerMark) {
        if let Some(grid) = &mut self.grid {
            grid.add_sensor(mark.sensor);
        }
        self.forgotten += usize::from(mark.is_forgotten);
        let id = ProducerId(u32::try_from(self.producers.len()).unwrap_or(u32::MAX));
        self.producer_ids.insert(mark.key.clone(), id);
        self.producers.push(mark);
    }

    pub(super) fn add_state(&mut self, info: StateInfo) {
        let reporting = info.reporting;
        let id = self.directory.push(info);
        if reporting.may_end() {
            self.with_rows.push(id);
            self.row_readings_a_day = self.row_readings_a_day.saturating_add(reporting.readings_a_day());
        }
        self.live.push(LiveState::default());
        self.live_dirty.resize(self.live.len().div_ceil(LIVE_CHUNK), true);
        if let Some(dirty) = self.live_dirty.last_mut() {
            *dirty = true;
        }
    }

    /// Advances a producer's mark.
    fn advance(&mut self, event: &Envelope) -> Result<(), String> {
        let span = event.span;
        if let Some(NewProducer { key, sensor, introduced_by }) = &event.new_producer {
            if event.producer.0 as usize != self.producers.len() || self.producer_ids.contains_key(key) {
                return Err(format!("producer {} is not new", event.producer.0));
            }
            if let Some(sensor) = sensor {
                let grid = self.grid.as_ref().ok_or("its producer has a sensor, and the map has no grid")?;
                grid.may_have(*sensor, std::iter::empty()).map_err(|error| error.to_string())?;
            }
            let (key, sensor) = (key.clone(), *sensor);
            self.add_producer(ProducerMark {
                key,
                incarnation: 0,
                durable_sequence: 0,
                content_crc: 0,
                sensor,
                received_nanos: event.received_nanos,
                newest_nanos: 0,
                recent: Vec::new(),
                has_scans: false,
                is_forgotten: false,
                introduced_by: introduced_by.clone(),
            });
        }
        let mark =
            self.producers.get_mut(event.producer.0 as usize).ok_or("it names an unknown producer".to_owned())?;
        if span.first != mark.durable_sequence + 1 || span.is_empty() {
            let before = mark.durable_sequence;
            return Err(format!("its sequence {}..={} does not follow {before}", span.first, span.last));
        }
        if mark.durable_sequence > 0 {
            if mark.recent.len() + 1 >= CONTENT_MARKS_MAX {
                mark.recent.remove(0);
            }
            mark.recent.push(ContentMark { sequence: mark.durable_sequence, crc: mark.content_crc });
        }
        self.forgotten -= usize::from(std::mem::take(&mut mark.is_forgotten));
        mark.incarnation = mark.incarnation.max(event.incarnation);
        mark.durable_sequence = span.last;
        mark.content_crc = span.content_crc;
        mark.received_nanos = event.received_nanos;
        Ok(())
    }

    /// Producers give their places up. If one of them comes back, an older instance of it is fenced.
    pub(super) fn forget_producers(&mut self, producers: &[ProducerId]) -> Result<(), String> {
        if let Some(unknown) = producers.iter().find(|id| id.0 as usize >= self.producers.len()) {
            return Err(format!("it forgets producer {}, which is unknown", unknown.0));
        }
        for id in producers {
            if let Some(mark) = self.producers.get_mut(id.0 as usize).filter(|mark| !mark.is_forgotten) {
                mark.is_forgotten = true;
                mark.incarnation = mark.incarnation.saturating_add(1);
                mark.recent = Vec::new();
                self.forgotten += 1;
            }
        }
        Ok(())
    }

    /// Records that a producer has sent an observation of a time. It is recorded only if the map has states with rows:
    /// it determines up to when rows are complete.
    pub(super) fn note_newest_time(&mut self, producer: ProducerId, nanos: i64) {
        if let Some(mark) = self.producers.get_mut(producer.0 as usize).filter(|_| !self.with_rows.is_empty()) {
            mark.newest_nanos = mark.newest_nanos.max(nanos);
        }
    }

    pub(super) fn add_new_state(&mut self, new: &NewState) -> Result<(), String> {
        if new.id.0 as usize != self.directory.len() || self.directory.shape(new.name.as_str()).is_some() {
            return Err(format!("state {:?} is not new", new.name.as_str()));
        }
        for (_, name, kind) in new.states() {
            self.add_state(StateInfo { name, kind, sensor: new.sensor, reporting: new.reporting });
        }
        Ok(())
    }

    /// Refuses values outside the bounds of their states' kinds. Nearly all events have only probabilities, and cost
    /// one pass over their values.
    fn check_values(&self, event: &Observations) -> Result<(), String> {
        let is_probability = |value: &f64| StateKind::Probability.bounds().contains(value);
        if event.values.iter().all(is_probability) {
            return Ok(());
        }
        for (&state, value) in event.states.iter().zip(&event.values) {
            let kind = self.kind(state).unwrap_or_default();
            let is_end = value.is_nan() && self.reporting(state).may_end();
            if !is_end && !kind.bounds().contains(value) {
                return Err(format!("value {value} of state {} is not {}", state.0, kind.expected()));
            }
        }
        Ok(())
    }

    pub(super) fn take_in_scans(&mut self, envelope: &Envelope, event: &Scans) -> Result<(), String> {
        self.grid.as_ref().ok_or("the map has no grid")?.check(event).map_err(|error| error.to_string())?;
        self.advance(envelope)?;
        if let Some(mark) = self.producers.get_mut(envelope.producer.0 as usize) {
            mark.has_scans = true;
        }
        if let Some(grid) = &mut self.grid {
            let sensor = self.producers.get(envelope.producer.0 as usize).and_then(|mark| mark.sensor);
            let newest = grid.apply(event, sensor, envelope.plausible_nanos());
            self.newest_nanos = self.newest_nanos.max(newest.unwrap_or(0));
        }
        if !event.scans.is_empty() {
            self.pending.received(envelope.received_nanos);
        }
        Ok(())
    }

    pub(super) fn apply_observations(
        &mut self,
        position: u64,
        envelope: &Envelope,
        event: &Observations,
    ) -> Result<(), String> {
        self.advance(envelope)?;
        for new in &event.new_states {
            self.add_new_state(new)?;
        }
        self.check_values(event)?;
        let plausible = envelope.plausible_nanos();
        let arrival = Delivery { producer: envelope.producer, received_nanos: envelope.received_nanos };
        let mut newest = 0;
        for (state, sample) in event.samples() {
            let index = state.0 as usize;
            let reporting = if self.with_rows.is_empty() { Reporting::Samples } else { self.reporting(state) };
            let live = self.live.get_mut(index).ok_or_else(|| format!("state {index} is unknown"))?;
            live.observations += 1;
            let from = Origin { position, producer: envelope.producer, number: live.observations };
            self.live_dirty[index / LIVE_CHUNK] = true;
            if sample.utc_nanos <= plausible {
                live.observe_row(reporting, &sample, arrival);
                newest = newest.max(sample.utc_nanos);
                self.pending.push(state, sample, from);
            } else {
                self.pending.push_future(state, sample, from);
            }
        }
        self.newest_nanos = self.newest_nanos.max(newest);
        self.note_newest_time(envelope.producer, newest);
        if !event.states.is_empty() {
            self.pending.received(envelope.received_nanos);
        }
        self.observations += event.states.len() as u64;
        if !event.failures.is_empty() {
            Arc::make_mut(&mut self.site).add_failures(&event.failures);
        }
        if !event.runs.is_empty() {
            Arc::make_mut(&mut self.site).add_runs(&event.runs);
        }
        Ok(())
    }
}
