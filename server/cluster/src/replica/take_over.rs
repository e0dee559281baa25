//! Makes this daemon the writer. It takes the lease, reads the rest of the log, appends the records that the stream has
//! forgotten, and appends the record of the epoch. From that record on, no other writer's append succeeds.
//!
//! Invariant: a writer has everything that the stream has, and everything that another daemon reports to have, unless
//! that daemon stayed away for the time of healing.

use std::{sync::Arc, time::Duration};

use tidemap_map::event::{Epoch, Event};
use tidemap_store::{AppendError, LogPoint, RecordGroup};
use tokio::time::{Instant, sleep};

use super::{
    compare::{CompareError, READ_BACK_FOLLOWING, Relation},
    driver::{Driver, Next, READ_BYTES},
    events::ReplicaRole,
    lease_keeper::{LeaseKeeper, LeaseTerms},
    send::Sent,
};
use crate::{
    engine::{Bucket, Engine, EngineError, SetError},
    lease::Lease,
    member::MemberReport,
    message::encode,
};

/// Pause before a step is tried again.
const PAUSE: Duration = Duration::from_millis(50);

impl<E: Engine> Driver<E> {
    /// Takes the lease, whose revision is known, and then the log.
    pub(super) async fn take_over(&mut self, revision: u64) -> Next {
        self.role(ReplicaRole::TakingOver);
        // The lease claims the epoch before the log records it, so that no other daemon claims it too.
        let epoch = self.lease_watch.lease().map_or(0, |(_, lease)| lease.epoch).max(self.epoch) + 1;
        let lease = Lease { writer: self.settings.member.clone(), epoch, ..Lease::default() };
        let key = self.settings.key();
        let begun = Instant::now();
        let taken = self.engine.set_if(Bucket::Writers, &key, revision, lease.encode()).await;
        self.lease_watch.forget();
        let revision = match taken {
            Ok(revision) => revision,
            Err(SetError::NotExpected) => return Next::Align,
            Err(SetError::Engine(error)) => {
                // The next read of the lease shows whether it was taken.
                self.trouble(Some(error.to_string()));
                return Next::Align;
            }
        };
        let terms = LeaseTerms { key, member: self.settings.member.clone(), epoch, lasts: self.settings.lease };
        let keeper = LeaseKeeper::start(self.engine.clone(), Arc::clone(&self.shared), terms, revision, begun);
        // A daemon that cannot take the log over must not keep others from it.
        let patience = self.settings.heal_wait + 2 * self.settings.lease;
        while !self.is_stopping() && !keeper.is_lost() && !self.lets_others_write() {
            if begun.elapsed() > patience || self.rank.borrow().is_none() {
                self.let_others_write();
                break;
            }
            match self.try_to_take_over(&keeper, begun).await {
                Ok(None) => sleep(PAUSE).await,
                // The next writer may be a daemon that can.
                Ok(Some(next @ (Next::Forked(_) | Next::Align | Next::Stop))) => {
                    keeper.give_back(&self.engine, None).await;
                    return next;
                }
                Ok(Some(next)) => {
                    self.keeper = Some(keeper);
                    return next;
                }
                Err(error) => {
                    self.trouble(Some(error.to_string()));
                    sleep(PAUSE).await;
                }
            }
        }
        if !keeper.is_lost() {
            keeper.give_back(&self.engine, None).await;
        }
        Next::Align
    }

    /// One attempt; `None`: try again.
    async fn try_to_take_over(&mut self, keeper: &LeaseKeeper, begun: Instant) -> Result<Option<Next>, CompareError> {
        match self.relation(READ_BACK_FOLLOWING).await? {
            Relation::Holds { last_sequence, .. } => {
                self.last_sequence = last_sequence;
                self.assembly.clear();
                if !self.catch_up().await? {
                    return Ok(None);
                }
            }
            Relation::Ahead { end, last_sequence } => {
                if !self.may_heal(begun).await? {
                    return Ok(None);
                }
                self.last_sequence = last_sequence;
                self.heal(end).await?;
                // Compare the current content of the stream again.
                return Ok(None);
            }
            Relation::Forked { common } => return Ok(Some(Next::Forked(common))),
            Relation::Behind { .. } | Relation::Unknown { .. } => return Ok(Some(Next::Align)),
        }
        if !self.may_heal(begun).await? {
            return Ok(None);
        }
        #[cfg(test)]
        if self.settings.planted == super::settings::Planted::NoEpoch {
            self.epoch = keeper.epoch();
            return Ok(Some(Next::Write));
        }
        self.append_epoch(keeper).await
    }

    /// Reads the log to its end; returns whether the end was reached.
    async fn catch_up(&mut self) -> Result<bool, CompareError> {
        let last = self.engine.ends(&self.settings.stream).await?.last;
        while self.last_sequence < last && !self.is_stopping() {
            let (stream, from) = (self.settings.stream.clone(), self.last_sequence + 1);
            let messages = self.engine.read_from(&stream, from, READ_BYTES, self.settings.patience).await?;
            if messages.is_empty() || !self.take_in(messages).await? {
                return Ok(false);
            }
        }
        // A group that was never completed stays in the stream, behind the log of this daemon.
        Ok(self.last_sequence == last)
    }

    /// Whether no other daemon reports a longer log than this one's, or none has come for long enough.
    async fn may_heal(&self, begun: Instant) -> Result<bool, EngineError> {
        if begun.elapsed() >= self.settings.heal_wait {
            return Ok(true);
        }
        let own = self.shared.log.end().position;
        let reports = self.engine.list(Bucket::Members).await?;
        let is_longer = |(name, report): (&String, MemberReport)| {
            *name != self.settings.member && report.logs.get(&self.settings.map).is_some_and(|&end| end > own)
        };
        let reports = reports.iter().filter_map(|(name, entry)| Some((name, MemberReport::decode(&entry.value)?)));
        Ok(!reports.into_iter().any(is_longer))
    }

    /// Appends again the records that the stream has forgotten: all records behind its end, from this daemon's own log.
    async fn heal(&mut self, end: LogPoint) -> Result<(), CompareError> {
        let log = self.shared.log.clone();
        let open = move || {
            // An empty stream may begin with any record: checkpoints contain the records before it.
            let first = if end == LogPoint::BEGINNING { log.first_position()? } else { end.position + 1 };
            log.groups(first)
        };
        let mut groups = self.on_disk(open).await?;
        tracing::warn!(
            map = %self.settings.key(), from = end.position + 1, to = self.shared.log.position(),
            "the shared log had lost records: they are appended again"
        );
        loop {
            let (group, rest) = self.on_disk(move || (groups.next(), groups)).await;
            groups = rest;
            let Some(group) = group.transpose()? else { return Ok(()) };
            if group.before.position < end.position {
                // The forgotten part begins within a group of this log. This cannot happen, because a group is appended
                // whole.
                return Ok(());
            }
            for (_, event) in group.events().unwrap_or_default() {
                if let Event::Epoch(record) = event {
                    self.epoch = self.epoch.max(record.epoch);
                }
            }
            let messages = encode(&group, self.settings.map, self.epoch);
            if self.send(&messages).await != Sent::Done {
                return Ok(());
            }
            metrics::counter!("tidemap_cluster_healed_records_total").increment(group.records());
            self.sees_end(group.after.position);
        }
    }

    /// Whether all daemons that read the stream find the end of the own log in it.
    async fn is_in_log(&mut self, keeper: &LeaseKeeper) -> bool {
        while !self.is_stopping() && !keeper.is_lost() {
            match self.relation(READ_BACK_FOLLOWING).await {
                // The records behind it are of the next writer.
                Ok(relation) => return matches!(relation, Relation::Holds { has_more: false, .. }),
                Err(error) => self.trouble(Some(error.to_string())),
            }
            sleep(PAUSE).await;
        }
        false
    }

    /// Appends the record of the epoch. `None`: somebody else has appended, or it could not be written here.
    async fn append_epoch(&mut self, keeper: &LeaseKeeper) -> Result<Option<Next>, CompareError> {
        let epoch = keeper.epoch();
        if epoch <= self.epoch {
            // Another daemon has written in the epoch that this one has claimed: that daemon has the lease.
            return Ok(Some(Next::Align));
        }
        let event = Event::Epoch(Epoch {
            epoch,
            writer: self.settings.member.clone(),
            version: self.settings.version.clone(),
            maths: self.settings.maths,
        });
        self.shared.log.resume();
        let log = self.shared.log.clone();
        let written = self
            .on_disk(move || {
                let queued = log.queue(&event, Box::new(|_| {})).ok()?;
                let written = log.write(vec![queued]).ok()?;
                let synced = log.sync(&written);
                Some((written, synced, event))
            })
            .await;
        let Some((written, synced, event)) = written else {
            self.trouble(Some("this daemon's own log cannot be written: another daemon replaces it".to_owned()));
            self.let_others_write();
            return Ok(None);
        };
        let records: RecordGroup = written.records().clone();
        let sent = match &synced {
            Ok(()) => self.send(&encode(&records, self.settings.map, epoch)).await,
            Err(_) => Sent::Stopped,
        };
        let outcome = match (&sent, synced) {
            (_, Err(error)) => Err(error),
            (Sent::Done, _) => Ok(()),
            (Sent::Full(reason), _) => Err(AppendError::StreamFull(reason.clone())),
            _ => Err(AppendError::NotWriter { writer: None }),
        };
        let (log, is_in) = (self.shared.log.clone(), outcome.is_ok());
        self.on_disk(move || log.end_group(written, outcome)).await;
        if !is_in {
            return Ok(if self.is_stopping() { Some(Next::Stop) } else { None });
        }
        self.epoch = epoch;
        self.note_contact(records.after.position, Instant::now());
        self.report_followed(vec![(records.after.position, event)]).await;
        // An engine that forgets may have had another message under the expected number. Then the epoch is void for all
        // daemons that read the log, and so are all records after it.
        if !self.is_in_log(keeper).await {
            return Ok(Some(Next::Align));
        }
        self.set_writer(Some(self.settings.member.clone()));
        Ok(Some(Next::Write))
    }
}
