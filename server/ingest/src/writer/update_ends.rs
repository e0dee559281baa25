//! The ends of updates in a shared log: the result of an update gets a digest. The writer appends the digest to the
//! log, and a follower compares it with its own.
//!
//! Invariant: a writer begins no update before the log contains the result of the one before. The map's thread computes
//! no digest.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    time::Instant,
};

use tidemap_map::{
    event::{Digest, Event, UpdateDone},
    snapshot::MapSnapshot,
};
use tidemap_model::MATHS;
use tidemap_store::digest;
use tokio::sync::watch;
use tracing::{error, info, warn};

use super::{Writer, appends::InFlight};
use crate::{
    digests::{DigestStatus, DigestVerdict, Digests},
    protocol::Command,
};

/// The digests of the map, and whether a digest is being computed.
pub(super) struct UpdateEnds {
    digests: Digests,
    is_computing: bool,
    status: watch::Sender<Option<DigestStatus>>,
}

impl UpdateEnds {
    /// `logged`: the result of the last update in the log, if the log contains it.
    pub(super) fn new(logged: Option<UpdateDone>, status: watch::Sender<Option<DigestStatus>>) -> Self {
        Self { digests: Digests::new(logged), is_computing: false, status }
    }

    /// Whether a digest is being computed.
    pub(super) fn is_computing(&self) -> bool {
        self.is_computing
    }

    /// Whether the log does not contain yet that an update has ended here.
    fn is_owed(&self) -> bool {
        self.is_computing || self.digests.owed().is_some()
    }

    fn publish(&self) {
        self.status.send_replace(self.digests.status());
    }
}

impl Writer {
    /// Records the beginning of an update.
    pub(super) fn begin_digest(&mut self, generation: u64) {
        self.ends.digests.begin(generation);
    }

    /// Whether the end of an update still has to be logged, before the next one begins.
    pub(super) fn owes_update_end(&self) -> bool {
        self.follower.is_shared() && self.ends.is_owed()
    }

    /// Computes the digest of an update's result in a thread of its own. No digest is needed where the log belongs to
    /// this daemon alone.
    pub(super) fn compute_digest(&mut self, snapshot: &MapSnapshot) {
        if !self.follower.is_shared() {
            return;
        }
        let (commands, generation) = (self.commands.clone(), snapshot.generation);
        let snapshot = MapSnapshot { history: Vec::new(), ..snapshot.clone() };
        let spawned = std::thread::Builder::new().name(format!("digest-{}", self.id.0)).spawn(move || {
            let digest = catch_unwind(AssertUnwindSafe(|| digest(&snapshot).map_err(|error| error.to_string())))
                .unwrap_or_else(|_| Err("computing it panicked; this is a defect of tidemap".to_owned()));
            // Tiles and sums are released before the next update may change them.
            drop(snapshot);
            // Without a writer there is no comparison.
            let _ = commands.send(Command::Digested { generation, digest });
        });
        self.ends.is_computing = spawned.is_ok();
        if let Err(error) = spawned {
            self.no_digest(generation, &error.to_string());
        }
    }

    fn no_digest(&self, generation: u64, reason: &str) {
        warn!(map = %self.map.spec().name, generation, reason, "a generation has no digest: it is not compared");
    }

    pub(super) fn digested(&mut self, generation: u64, digest: Result<Digest, String>) {
        self.ends.is_computing = false;
        match digest {
            Ok(digest) => {
                let verdict = self.ends.digests.made(UpdateDone { generation, digest, maths: MATHS });
                self.report_verdict(generation, verdict);
            }
            Err(reason) => self.no_digest(generation, &reason),
        }
    }

    /// Takes the result of the writer's update from the log.
    pub(super) fn read_digest(&mut self, done: UpdateDone) {
        let verdict = self.ends.digests.read(done);
        self.report_verdict(done.generation, verdict);
    }

    fn report_verdict(&self, generation: u64, verdict: Option<DigestVerdict>) {
        let map = &self.map.spec().name;
        match verdict {
            Some(DigestVerdict::Equal) => metrics::counter!("tidemap_cluster_digests_equal_total").increment(1),
            Some(DigestVerdict::Differs { own, logged }) => {
                metrics::counter!("tidemap_cluster_divergence_total").increment(1);
                error!(%map, generation, %own, %logged, "an update has made other bits than the writer's");
            }
            Some(DigestVerdict::OtherMaths) => {
                info!(%map, generation, "the writer updates with other maths: digests are not compared");
            }
            None => {}
        }
        self.ends.publish();
    }

    /// Appends, as the writer, the result of the last update to the log, unless it is in flight.
    pub(super) fn log_update_end(&mut self) {
        let is_writer = self.follower.is_shared() && self.follower.is_writing();
        if !is_writer || self.appends.is_update_ending() || !self.updates.may_start(Instant::now()) {
            return;
        }
        if let Some(done) = self.ends.digests.owed() {
            self.append(InFlight::UpdateDone { event: Event::UpdateDone(done) });
        }
    }

    /// The log contains the result that this daemon has appended.
    pub(super) fn note_logged_update_end(&mut self, event: &Event) {
        if let Event::UpdateDone(done) = event {
            self.ends.digests.note_logged(*done);
            self.ends.publish();
        }
    }
}
