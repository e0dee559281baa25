//! Follows the shared log: compares the logs, then takes in the records that others append, and watches the lease.
//!
//! Invariant: a message is taken in only if it follows the log of this daemon; otherwise the logs are compared again.

use std::time::Duration;

use tidemap_map::event::Event;
use tidemap_store::ForeignGroupError;
use tokio::{sync::oneshot, time::Instant};

use super::{
    compare::{CompareError, READ_BACK, READ_BACK_FOLLOWING, Relation},
    driver::{Driver, Next, PROBE, READ_BYTES},
    events::{ReplicaEvent, ReplicaRole, ReplicaStatus},
    settings::Order,
};
use crate::{
    catalogue,
    engine::{Bucket, Engine, EngineError, Message},
};

/// Time for which a read waits for the next message. The lease is read between these reads.
pub(super) const READ_PATIENCE: Duration = Duration::from_millis(250);
/// Number of times that a follower reads the lease within the time that a lease lasts.
pub(super) const CHECKS_PER_LEASE: u32 = 12;
/// Interval at which a daemon reads a lease that is about to be handed over to it.
const SHORT_CHECK_INTERVAL: Duration = Duration::from_millis(20);
/// Pause after an error of the engine.
const PAUSE: Duration = Duration::from_millis(100);
/// Candidates take a lease one after the other.
const RANK_STEP: Duration = Duration::from_millis(500);

/// The comparison of the end of the stream with the end of the own log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StreamEnd {
    /// The stream ends where the own log ends.
    Own,
    /// The stream has more than this daemon has read.
    More,
    /// The stream has less, or another record there.
    Lost,
}

impl<E: Engine> Driver<E> {
    /// Sets whether the map needs a copy of another daemon's map.
    fn set_needs_copy(&self, relation: &Result<Relation, CompareError>) {
        let needs_copy = matches!(relation, Ok(Relation::Behind { .. }));
        let set = |status: &mut ReplicaStatus| std::mem::replace(&mut status.needs_copy, needs_copy) != needs_copy;
        let is_new = self.shared.status.send_if_modified(set) && needs_copy;
        if is_new && matches!(relation, Ok(Relation::Behind { differs: true, .. })) {
            metrics::counter!("tidemap_cluster_forks_total").increment(1);
            tracing::error!(
                map = %self.settings.key(), end = self.shared.log.end().position,
                "FORKED: the own log of this daemon has records that the shared log does not have, and the shared log \
                 no longer has what they follow. The map's old folder, which is set aside, has these records. tidemap \
                 cannot add them to the map"
            );
        }
    }

    /// Compares the logs until this one is a beginning of the shared one.
    pub(super) async fn align(&mut self) -> Next {
        self.role(ReplicaRole::Starting);
        self.assembly.clear();
        while !self.is_stopping() {
            let mut is_ahead = false;
            let read_back = if self.has_read_back { READ_BACK_FOLLOWING } else { READ_BACK };
            let relation = self.relation(read_back).await;
            self.has_read_back |= relation.is_ok();
            self.set_needs_copy(&relation);
            match relation {
                Ok(Relation::Holds { last_sequence, .. }) => {
                    self.last_sequence = last_sequence;
                    if !self.lets_others_write() {
                        self.trouble(None);
                    }
                    return Next::Follow;
                }
                Ok(Relation::Ahead { end, .. }) => {
                    is_ahead = true;
                    self.role(ReplicaRole::Ahead);
                    self.trouble(Some(format!(
                        "the shared log ends at position {} and has lost the records that this daemon holds up to {}",
                        end.position,
                        self.shared.log.end().position
                    )));
                }
                Ok(Relation::Forked { common }) => return Next::Forked(common),
                Ok(Relation::Behind { from, .. }) => self.trouble(Some(format!(
                    "the shared log begins behind position {from}, and this daemon's log ends at {}, or differs \
                     before: it needs a copy from another daemon",
                    self.shared.log.end().position
                ))),
                Ok(Relation::Unknown { end }) => self.trouble(Some(format!(
                    "the shared log ends at position {end}, and this daemon's log begins behind it: another daemon has \
                     to append what the shared log has lost"
                ))),
                Err(CompareError::Engine(EngineError::Missing(what))) => {
                    self.trouble(Some(format!("the engine has no {what}")));
                    self.make_stream().await;
                }
                Err(error) => self.trouble(Some(error.to_string())),
            }
            // A daemon whose log is longer may append the records that the shared log has forgotten, as its writer.
            if is_ahead && let Some(revision) = self.check_lease().await {
                return Next::TakeOver(revision);
            }
            self.pause(PAUSE).await;
        }
        Next::Stop
    }

    /// Creates the stream again, which the engine has lost, unless the map was deleted.
    async fn make_stream(&mut self) {
        let (engine, settings) = (&self.engine, &self.settings);
        if !matches!(catalogue::is_deleted(engine, settings.map).await, Ok(false)) {
            return;
        }
        match engine.create_stream(&settings.stream, settings.engine_replicas).await {
            Ok(()) => {
                tracing::warn!(stream = settings.stream, "the engine had lost the stream of a map: it is made again");
            }
            Err(error) => self.trouble(Some(error.to_string())),
        }
    }

    /// Reads the lease at intervals; returns its revision when this daemon may take it.
    async fn check_lease(&mut self) -> Option<u64> {
        let now = Instant::now();
        let is_announced = self.lease_watch.is_announced_to(&self.settings.member);
        let interval = if is_announced { SHORT_CHECK_INTERVAL } else { self.settings.lease / CHECKS_PER_LEASE };
        if self.lease_checked.is_some_and(|checked| now.saturating_duration_since(checked) < interval) {
            return None;
        }
        self.lease_checked = Some(now);
        let entry = match self.engine.get(Bucket::Writers, &self.settings.key()).await {
            Ok(entry) => entry,
            Err(error) => {
                self.trouble(Some(error.to_string()));
                return None;
            }
        };
        let now = Instant::now();
        self.lease_watch.note(entry.as_ref(), now);
        let lease = self.lease_watch.lease().map(|(_, lease)| lease.writer.clone());
        if let Some(writer) = lease.filter(|writer| !writer.is_empty() && *writer != self.settings.member) {
            self.set_writer(Some(writer));
        }
        let rank = (*self.rank.borrow())?;
        let patience = match &entry {
            // For a new map, a daemon waits only for the candidates before it.
            None => RANK_STEP * rank,
            Some(_) => self.settings.lease + RANK_STEP * rank,
        };
        self.lease_watch.may_take(&self.settings.member, patience, now)
    }

    async fn relation_is_lost(&mut self) -> Result<bool, CompareError> {
        let relation = self.relation(READ_BACK_FOLLOWING).await?;
        // An incomplete group may follow it.
        Ok(!matches!(relation, Relation::Holds { has_more: false, .. }))
    }

    /// Whether the stream ends at the last message that this daemon has read, and with the record that this daemon has
    /// there.
    pub(super) async fn probe(&mut self) -> Result<StreamEnd, CompareError> {
        let requested = Instant::now();
        let ends = self.engine.ends(&self.settings.stream).await?;
        if ends.last < self.last_sequence {
            return Ok(StreamEnd::Lost);
        }
        if ends.last > self.last_sequence {
            // Once this daemon has read up to there, it has the whole log as of this moment.
            self.end_received = Some((requested, ends.last));
            if let Some(part) = self.part_up_to(ends.last, self.last_sequence + 1).await? {
                self.sees_end(part.after.position);
            }
            return Ok(StreamEnd::More);
        }
        let own = self.shared.log.end();
        if ends.last > 0 && ends.first <= ends.last && self.probed_stamp != Some((own, ends.stamp)) {
            // A part that is not the last one of its group, or a void message, is compared once more.
            let last = self.part_at(ends.last).await?;
            if last.is_none_or(|part| part.after != own) && self.relation_is_lost().await? {
                return Ok(StreamEnd::Lost);
            }
            self.probed_stamp = Some((own, ends.stamp));
        }
        if !self.lets_others_write() {
            self.trouble(None);
        }
        self.note_contact(own.position, requested);
        Ok(StreamEnd::Own)
    }

    /// Reads the log as others append to it.
    pub(super) async fn follow(&mut self) -> Next {
        self.role(ReplicaRole::Following);
        let mut probed: Option<Instant> = None;
        let mut probed_sequence = None;
        while !self.is_stopping() {
            while let Some(order) = self.next_order() {
                if let Order::HandOver(_, done) = order {
                    let _ = done.send(false);
                }
            }
            if let Some(revision) = self.check_lease().await {
                return Next::TakeOver(revision);
            }
            let (stream, from) = (self.settings.stream.clone(), self.last_sequence + 1);
            let is_announced = self.lease_watch.is_announced_to(&self.settings.member);
            let patience = if is_announced { SHORT_CHECK_INTERVAL } else { READ_PATIENCE };
            match self.engine.read_from(&stream, from, READ_BYTES, patience).await {
                Ok(messages) if !messages.is_empty() => match self.take_in(messages).await {
                    Ok(true) => {}
                    Ok(false) => {
                        self.pause(PAUSE).await;
                        return Next::Align;
                    }
                    Err(error) => {
                        self.trouble(Some(error.to_string()));
                        self.pause(PAUSE).await;
                        return Next::Align;
                    }
                },
                Ok(_) => {}
                Err(error) => {
                    let is_gone = matches!(error, EngineError::Missing(_));
                    self.trouble(Some(error.to_string()));
                    self.pause(PAUSE).await;
                    if is_gone {
                        return Next::Align;
                    }
                }
            }
            let now = Instant::now();
            if probed.is_none_or(|probed| now.saturating_duration_since(probed) >= PROBE) {
                probed = Some(now);
                match self.probe().await {
                    Ok(StreamEnd::Lost) => {
                        self.pause(PAUSE).await;
                        return Next::Align;
                    }
                    // The stream has more, and no message of it has arrived since the last probe: it was purged.
                    Ok(StreamEnd::More) if probed_sequence == Some(self.last_sequence) => return Next::Align,
                    Ok(StreamEnd::Own | StreamEnd::More) => probed_sequence = Some(self.last_sequence),
                    Err(error) => self.trouble(Some(error.to_string())),
                }
            }
        }
        Next::Stop
    }

    /// Takes messages of the stream into the own log and sends them to the map's thread. `false`: they do not follow
    /// the log of this daemon, or cannot be written here.
    pub(super) async fn take_in(&mut self, messages: Vec<Message>) -> Result<bool, CompareError> {
        let mut followed = Vec::new();
        let mut taken = Ok(true);
        for message in messages {
            taken = self.take_in_one(&message, &mut followed).await;
            if !matches!(taken, Ok(true)) {
                break;
            }
        }
        // These events are in the own log, whatever failed after them.
        if !followed.is_empty() {
            self.report_followed(followed).await;
            if let Some((requested, _)) = self.end_received.filter(|&(_, last)| self.last_sequence >= last) {
                self.note_contact(self.shared.log.position(), requested);
            }
        }
        taken
    }

    async fn take_in_one(&mut self, message: &Message, followed: &mut Vec<(u64, Event)>) -> Result<bool, CompareError> {
        if message.sequence != self.last_sequence + 1 {
            return Ok(false);
        }
        let Some(part) = self.part(message)? else {
            tracing::warn!(stream = self.settings.stream, message = message.sequence, "a message is not tidemap's");
            self.last_sequence = message.sequence;
            return Ok(true);
        };
        let epoch = part.epoch;
        if let Some(group) = self.assembly.push(part) {
            let log = self.shared.log.clone();
            match self.on_disk(move || log.append_group(&group)).await {
                Ok(events) => followed.extend(events),
                Err(ForeignGroupError::NotNext { .. }) => return Ok(false),
                Err(error) => {
                    self.trouble(Some(format!("this daemon cannot follow the shared log: {error}")));
                    self.let_others_write();
                    return Ok(false);
                }
            }
            self.epoch = epoch;
        }
        self.last_sequence = message.sequence;
        Ok(true)
    }

    pub(super) async fn report_followed(&mut self, events: Vec<(u64, Event)>) {
        for (_, event) in &events {
            if let Event::Epoch(epoch) = event {
                self.set_writer(Some(epoch.writer.clone()));
            }
        }
        let (applied, done) = oneshot::channel();
        (self.listener)(ReplicaEvent::Followed { events, applied });
        let mut stopping = self.stopping.clone();
        // A thread that ends never replies, and a thread that waits for an update replies late.
        tokio::select! {
            _ = done => {}
            _ = stopping.wait_for(|stopping| *stopping) => {}
        }
    }
}
