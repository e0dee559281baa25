//! Running a replica: it compares its log with the shared one, follows it, becomes its writer and stops being it.
//!
//! Invariant: what is told to the map's thread is in the shared log for good and in this daemon's own log.

use std::{sync::Arc, time::Duration};

use tidemap_map::event::Event;
use tidemap_store::{AppendError, ForeignGroupError, LogPoint};
use tokio::{
    sync::{mpsc, oneshot, watch},
    time::{Instant, timeout},
};

use super::{
    Order, ReplicaEvent, ReplicaListener, ReplicaRole, ReplicaSettings,
    compare::{CompareError, LOOK_BACK, LOOK_BACK_FOLLOWING, Relation},
    lease_keeper::LeaseKeeper,
};
use crate::{
    engine::{Bucket, Engine, Message},
    lease::LeaseWatch,
    message::Assembly,
    shared_log::Shared,
};

/// Bytes that are read from the stream at once.
pub(super) const READ_BYTES: usize = 8 << 20;
/// How long a read waits for the next message. The lease is looked at between reads.
const READ_PATIENCE: Duration = Duration::from_millis(250);
/// Pause after an error of the engine.
const PAUSE: Duration = Duration::from_millis(100);
/// How often the end of the stream is asked for.
pub(super) const PROBE: Duration = Duration::from_secs(1);
/// Candidates take a lease one after the other.
const RANK_STEP: Duration = Duration::from_millis(500);

/// What a replica does next.
#[derive(Debug)]
pub(super) enum Next {
    Align,
    Follow,
    TakeOver(u64),
    Write,
    Forked(u64),
    Stop,
}

/// What is found at the end of the stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Probe {
    /// What this daemon has.
    End,
    /// More than this daemon has read.
    More,
    /// Less, or another record.
    Lost,
}

/// A replica that runs.
pub(super) struct Driver<E: Engine> {
    pub(super) engine: E,
    pub(super) settings: ReplicaSettings,
    pub(super) shared: Arc<Shared>,
    pub(super) listener: ReplicaListener,
    pub(super) orders: mpsc::UnboundedReceiver<Order>,
    /// An order that came while the replica waited for something else.
    pub(super) order: Option<Order>,
    stopping: watch::Receiver<bool>,
    rank: watch::Receiver<Option<u32>>,
    /// Number of the last message whose records the own log has, or that is known to hold none.
    pub(super) last_sequence: u64,
    pub(super) assembly: Assembly,
    pub(super) epoch: u64,
    pub(super) lease_watch: LeaseWatch,
    lease_looked: Option<Instant>,
    /// The own end and the stamp of the stream's last message when they were last found to be equal.
    probed_stamp: Option<(LogPoint, u64)>,
    /// The lease, between taking the log over and writing it.
    pub(super) keeper: Option<LeaseKeeper>,
}

impl<E: Engine> Driver<E> {
    pub(super) fn new(
        engine: E,
        settings: ReplicaSettings,
        shared: Arc<Shared>,
        listener: ReplicaListener,
        orders: mpsc::UnboundedReceiver<Order>,
        stopping: watch::Receiver<bool>,
        rank: watch::Receiver<Option<u32>>,
    ) -> Driver<E> {
        Driver {
            engine,
            settings,
            shared,
            listener,
            orders,
            order: None,
            stopping,
            rank,
            last_sequence: 0,
            assembly: Assembly::default(),
            epoch: 0,
            lease_watch: LeaseWatch::default(),
            lease_looked: None,
            probed_stamp: None,
            keeper: None,
        }
    }

    /// The order that waits, if one does.
    pub(super) fn next_order(&mut self) -> Option<Order> {
        self.order.take().or_else(|| self.orders.try_recv().ok())
    }

    pub(super) async fn run(mut self) {
        let mut next = Next::Align;
        loop {
            if self.is_stopping() && !matches!(next, Next::Write) {
                next = Next::Stop;
            }
            next = match next {
                Next::Align => self.align().await,
                Next::Follow => self.follow().await,
                Next::TakeOver(revision) => self.take_over(revision).await,
                Next::Write => self.write().await,
                Next::Forked(common) => {
                    self.role(ReplicaRole::Forked);
                    self.trouble(Some(format!(
                        "this daemon holds records behind position {common} that the shared log does not have"
                    )));
                    (self.listener)(ReplicaEvent::Forked { common });
                    return;
                }
                Next::Stop => {
                    self.shared.close(&AppendError::Closed);
                    return;
                }
            };
        }
    }

    pub(super) fn is_stopping(&self) -> bool {
        *self.stopping.borrow()
    }

    /// Works on the disk beside the tasks of the runtime.
    pub(super) async fn on_disk<T: Send + 'static>(&self, work: impl FnOnce() -> T + Send + 'static) -> T {
        if self.settings.disk_inline {
            return work();
        }
        match tokio::task::spawn_blocking(work).await {
            Ok(value) => value,
            Err(error) => match error.try_into_panic() {
                Ok(panic) => std::panic::resume_unwind(panic),
                // The runtime ends: nobody waits for this task.
                Err(_) => std::future::pending().await,
            },
        }
    }

    pub(super) fn role(&self, role: ReplicaRole) {
        let end = self.shared.log.end().position;
        self.shared.status.send_modify(|status| {
            status.role = role;
            status.position = end;
        });
    }

    pub(super) fn set_writer(&self, writer: Option<String>) {
        self.shared.status.send_modify(|status| status.writer = writer);
    }

    pub(super) fn trouble(&self, trouble: Option<String>) {
        self.shared.status.send_if_modified(|status| {
            let differs = status.trouble != trouble;
            status.trouble = trouble;
            differs
        });
    }

    /// The shared log ends there now.
    pub(super) fn heard_of(&self, position: u64, epoch: u64) {
        let own = self.shared.log.end().position;
        self.shared.status.send_modify(|status| {
            status.shared_position = position;
            status.position = own;
            status.epoch = epoch;
            status.heard = Some(Instant::now());
        });
    }

    /// Waits a little, or for an order to stop.
    async fn pause(&mut self, duration: Duration) {
        let _ = timeout(duration, self.stopping.wait_for(|stopping| *stopping)).await;
    }

    /// Compares the logs until this one is a beginning of the shared one.
    async fn align(&mut self) -> Next {
        self.role(ReplicaRole::Starting);
        self.assembly.clear();
        while !self.is_stopping() {
            let mut is_ahead = false;
            match self.relation(LOOK_BACK).await {
                Ok(Relation::Holds { last_sequence }) => {
                    self.last_sequence = last_sequence;
                    self.trouble(None);
                    return Next::Follow;
                }
                Ok(Relation::Ahead { end, .. }) => {
                    is_ahead = true;
                    self.role(ReplicaRole::Ahead);
                    self.trouble(Some(format!(
                        "the shared log ends at position {} and has forgotten what this daemon holds up to {}",
                        end.position,
                        self.shared.log.end().position
                    )));
                }
                Ok(Relation::Forked { common }) => return Next::Forked(common),
                Ok(Relation::Behind { from }) => self.trouble(Some(format!(
                    "the shared log begins behind position {from}, and this daemon's log ends at {}: it needs the \
                     checkpoint of another daemon",
                    self.shared.log.end().position
                ))),
                Ok(Relation::Unknown { end }) => self.trouble(Some(format!(
                    "the shared log ends at position {end}, and this daemon's log begins behind it: another daemon has \
                     to append what the shared log has forgotten"
                ))),
                Err(error) => self.trouble(Some(error.to_string())),
            }
            // Whoever is ahead may append what the shared log has forgotten, as its writer.
            if is_ahead && let Some(revision) = self.look_at_lease().await {
                return Next::TakeOver(revision);
            }
            self.pause(PAUSE).await;
        }
        Next::Stop
    }

    /// Looks at the lease now and then; gives its revision when this daemon may take it.
    async fn look_at_lease(&mut self) -> Option<u64> {
        let now = Instant::now();
        let interval = self.settings.lease / 12;
        if self.lease_looked.is_some_and(|looked| now.saturating_duration_since(looked) < interval) {
            return None;
        }
        self.lease_looked = Some(now);
        let entry = match self.engine.get(Bucket::Writers, &self.settings.key()).await {
            Ok(entry) => entry,
            Err(error) => {
                self.trouble(Some(error.to_string()));
                return None;
            }
        };
        let now = Instant::now();
        self.lease_watch.look(entry.as_ref(), now);
        let lease = self.lease_watch.lease().map(|(_, lease)| lease.writer.clone());
        if let Some(writer) = lease.filter(|writer| !writer.is_empty()) {
            self.set_writer(Some(writer));
        }
        let rank = (*self.rank.borrow())?;
        let patience = match &entry {
            // A new map waits for nobody but those before.
            None => RANK_STEP * rank,
            Some(_) => self.settings.lease + RANK_STEP * rank,
        };
        self.lease_watch.may_take(&self.settings.member, patience, now)
    }

    async fn relation_is_lost(&mut self) -> Result<bool, CompareError> {
        let relation = self.relation(LOOK_BACK_FOLLOWING).await?;
        Ok(relation != Relation::Holds { last_sequence: self.last_sequence })
    }

    /// Whether the stream ends where this daemon has read it to, and with the record that this daemon has there.
    pub(super) async fn probe(&mut self) -> Result<Probe, CompareError> {
        let ends = self.engine.ends(&self.settings.stream).await?;
        if ends.last < self.last_sequence {
            return Ok(Probe::Lost);
        }
        if ends.last > self.last_sequence {
            return Ok(Probe::More);
        }
        let own = self.shared.log.end();
        if ends.last > 0 && ends.first <= ends.last && self.probed_stamp != Some((own, ends.stamp)) {
            // A part that is not the last, or a void message, is compared once more.
            if self.part_at(ends.last).await?.after != own && self.relation_is_lost().await? {
                return Ok(Probe::Lost);
            }
            self.probed_stamp = Some((own, ends.stamp));
        }
        self.trouble(None);
        self.heard_of(own.position, self.epoch);
        Ok(Probe::End)
    }

    /// Reads the log as others append to it.
    async fn follow(&mut self) -> Next {
        self.role(ReplicaRole::Following);
        let mut probed: Option<Instant> = None;
        while !self.is_stopping() {
            while let Some(order) = self.next_order() {
                if let Order::HandOver(_, done) = order {
                    let _ = done.send(false);
                }
            }
            let (stream, from) = (self.settings.stream.clone(), self.last_sequence + 1);
            match self.engine.read_from(&stream, from, READ_BYTES, READ_PATIENCE).await {
                Ok(messages) if !messages.is_empty() => match self.take_in(messages).await {
                    Ok(true) => {}
                    Ok(false) => return Next::Align,
                    Err(error) => {
                        self.trouble(Some(error.to_string()));
                        self.pause(PAUSE).await;
                        return Next::Align;
                    }
                },
                Ok(_) => {}
                Err(error) => {
                    self.trouble(Some(error.to_string()));
                    self.pause(PAUSE).await;
                }
            }
            let now = Instant::now();
            if probed.is_none_or(|probed| now.saturating_duration_since(probed) >= PROBE) {
                probed = Some(now);
                match self.probe().await {
                    Ok(Probe::Lost) => return Next::Align,
                    Ok(Probe::End) | Ok(Probe::More) => {}
                    Err(error) => self.trouble(Some(error.to_string())),
                }
            }
            if let Some(revision) = self.look_at_lease().await {
                return Next::TakeOver(revision);
            }
        }
        Next::Stop
    }

    /// Takes messages of the stream into the own log and tells the map's thread of them. `false`: they do not follow what
    /// this daemon has, or cannot be written here.
    pub(super) async fn take_in(&mut self, messages: Vec<Message>) -> Result<bool, CompareError> {
        let mut followed = Vec::new();
        let mut is_sound = true;
        for message in messages {
            if message.sequence != self.last_sequence + 1 {
                is_sound = false;
                break;
            }
            let part = self.part(&message)?;
            let epoch = part.epoch;
            if let Some(group) = self.assembly.push(part) {
                let log = self.shared.log.clone();
                match self.on_disk(move || log.append_group(&group)).await {
                    Ok(events) => followed.extend(events),
                    Err(error) => {
                        if !matches!(error, ForeignGroupError::NotNext { .. }) {
                            self.trouble(Some(format!("this daemon cannot follow the shared log: {error}")));
                        }
                        is_sound = false;
                        break;
                    }
                }
                self.epoch = epoch;
            }
            self.last_sequence = message.sequence;
        }
        if !followed.is_empty() {
            let end = self.shared.log.end().position;
            self.heard_of(end, self.epoch);
            self.tell_followed(followed).await;
        }
        Ok(is_sound)
    }

    pub(super) async fn tell_followed(&mut self, events: Vec<(u64, Event)>) {
        for (_, event) in &events {
            if let Event::Epoch(epoch) = event {
                self.set_writer(Some(epoch.writer.clone()));
            }
        }
        let (applied, done) = oneshot::channel();
        (self.listener)(ReplicaEvent::Followed { events, applied });
        // A thread that ends answers nothing.
        let _ = done.await;
    }
}
