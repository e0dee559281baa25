//! The ends of updates in a log that daemons share: what an update has made gets a digest. The writer tells it to the
//! log, and a follower compares it with its own.
//!
//! Invariant: a writer begins no update before the log says what the one before has made. The map's thread computes no
//! digest.

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
use crate::ingest::{
    digests::{DigestStatus, DigestVerdict, Digests},
    protocol::Command,
};

/// The digests of the map, and whether one is computed.
pub(super) struct UpdateEnds {
    digests: Digests,
    is_computing: bool,
    status: watch::Sender<Option<DigestStatus>>,
}

impl UpdateEnds {
    /// `logged`: what the log says of its last update, where it does.
    pub(super) fn new(logged: Option<UpdateDone>, status: watch::Sender<Option<DigestStatus>>) -> Self {
        Self { digests: Digests::new(logged), is_computing: false, status }
    }

    /// Whether a digest is computed.
    pub(super) fn is_computing(&self) -> bool {
        self.is_computing
    }

    /// Whether the log does not say yet that an update has ended here.
    fn is_owed(&self) -> bool {
        self.is_computing || self.digests.owed().is_some()
    }

    fn publish(&self) {
        self.status.send_replace(self.digests.status());
    }
}

impl Writer {
    /// An update begins.
    pub(super) fn begin_digest(&mut self, generation: u64) {
        self.ends.digests.begin(generation);
    }

    /// Whether the log still has to be told of an update, before the next one begins.
    pub(super) fn owes_update_end(&self) -> bool {
        self.follower.is_shared() && self.ends.is_owed()
    }

    /// Computes the digest of what an update has made in a thread of its own. Nobody needs it where the log is this
    /// daemon's alone.
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
            // Without a writer nobody compares it.
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
                self.tell_verdict(generation, verdict);
            }
            Err(reason) => self.no_digest(generation, &reason),
        }
    }

    /// The log says what the writer's update has made.
    pub(super) fn read_digest(&mut self, done: UpdateDone) {
        let verdict = self.ends.digests.read(done);
        self.tell_verdict(done.generation, verdict);
    }

    fn tell_verdict(&self, generation: u64, verdict: Option<DigestVerdict>) {
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

    /// As the writer: tells the log what the last update has made, unless that is in flight.
    pub(super) fn say_update_end(&mut self) {
        let is_writer = self.follower.is_shared() && self.follower.is_writing();
        if !is_writer || self.appends.is_update_ending() || !self.updates.may_start(Instant::now()) {
            return;
        }
        if let Some(done) = self.ends.digests.owed() {
            self.append(InFlight::UpdateDone { event: Event::UpdateDone(done) });
        }
    }

    /// The log says what this daemon has told it.
    pub(super) fn update_end_said(&mut self, event: &Event) {
        if let Event::UpdateDone(done) = event {
            self.ends.digests.said(*done);
            self.ends.publish();
        }
    }
}
