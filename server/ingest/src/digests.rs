//! Compares the results of a replica's updates with those of the writer's updates, which the log records.
//!
//! The replica's own update may end before or after the log records the end of the writer's update. Only the newest
//! generation of each side is kept: the log begins no update before it has recorded the result of the one before.
//!
//! Invariant: two digests are compared only if they have the same generation and the same maths.

use tidemap_map::event::{Digest, UpdateDone};

/// The result of a comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum DigestVerdict {
    /// The replica has the same bits as the writer.
    Equal,
    /// The replica has other bits than the writer.
    Differs {
        /// The digest of the replica's own update.
        own: Digest,
        /// The digest in the log.
        logged: Digest,
    },
    /// The two updates have different maths, so their bits may differ.
    OtherMaths,
}

/// The newest digest of a replica.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DigestStatus {
    /// The generation of the digest.
    pub generation: u64,
    /// The digest of the replica's own update.
    pub digest: Digest,
    /// Whether the writer's update has the same digest; `None`: there was nothing to compare yet, or the replica is the
    /// writer, or the maths differ.
    pub is_equal: Option<bool>,
}

/// The digests of a replica. A restored replica has no digest of its own until its next update has ended: before, there
/// is nothing to compare.
#[derive(Clone, Debug, Default)]
pub(crate) struct Digests {
    own: Option<UpdateDone>,
    logged: Option<UpdateDone>,
    /// The generation of the last update that has begun.
    begun: u64,
    verdict: Option<DigestVerdict>,
}

impl Digests {
    /// `logged`: the last update whose result the log contains, if it contains one.
    pub(crate) fn new(logged: Option<UpdateDone>) -> Self {
        Self { logged, ..Self::default() }
    }

    /// Records the beginning of an update. The results of earlier updates no longer need to be logged.
    pub(crate) fn begin(&mut self, generation: u64) {
        self.begun = generation;
    }

    /// Records the end of the replica's own update.
    pub(crate) fn made(&mut self, own: UpdateDone) -> Option<DigestVerdict> {
        self.own = Some(own);
        self.verdict = None;
        self.compare()
    }

    /// Records that the log contains the end of the writer's update.
    pub(crate) fn read(&mut self, logged: UpdateDone) -> Option<DigestVerdict> {
        self.logged = Some(logged);
        self.compare()
    }

    /// Records that the log contains the result that this replica, as the writer, has appended.
    pub(crate) fn note_logged(&mut self, logged: UpdateDone) {
        self.logged = Some(logged);
    }

    /// The end of an update that is not in the log yet, and that the writer still has to append.
    pub(crate) fn owed(&self) -> Option<UpdateDone> {
        let logged = self.logged.map_or(0, |logged| logged.generation);
        self.own.filter(|own| own.generation > logged && own.generation >= self.begun)
    }

    /// The newest digest; `None` until an update has ended here.
    pub(crate) fn status(&self) -> Option<DigestStatus> {
        let is_equal = match self.verdict {
            Some(DigestVerdict::Equal) => Some(true),
            Some(DigestVerdict::Differs { .. }) => Some(false),
            Some(DigestVerdict::OtherMaths) | None => None,
        };
        self.own.map(|UpdateDone { generation, digest, .. }| DigestStatus { generation, digest, is_equal })
    }

    fn compare(&mut self) -> Option<DigestVerdict> {
        let (own, logged) = self.own.zip(self.logged).filter(|(own, logged)| own.generation == logged.generation)?;
        let verdict = if own.maths != logged.maths {
            DigestVerdict::OtherMaths
        } else if own.digest == logged.digest {
            DigestVerdict::Equal
        } else {
            DigestVerdict::Differs { own: own.digest, logged: logged.digest }
        };
        self.verdict = Some(verdict);
        Some(verdict)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn done(generation: u64, digest: u64) -> UpdateDone {
        UpdateDone { generation, digest: Digest(digest), maths: 1 }
    }

    fn differs(own: u64, logged: u64) -> DigestVerdict {
        DigestVerdict::Differs { own: Digest(own), logged: Digest(logged) }
    }

    #[test]
    fn digests_of_a_generation_are_compared_when_both_are_known_in_any_order() {
        let mut own_first = Digests::default();
        assert_eq!(own_first.made(done(1, 5)), None);
        assert_eq!(own_first.status().and_then(|status| status.is_equal), None);
        assert_eq!(own_first.read(done(1, 5)), Some(DigestVerdict::Equal));
        let mut log_first = Digests::default();
        assert_eq!(log_first.read(done(1, 5)), None);
        assert_eq!(log_first.status(), None);
        assert_eq!(log_first.made(done(1, 5)), Some(DigestVerdict::Equal));
        for mut digests in [own_first, log_first] {
            let status = DigestStatus { generation: 1, digest: Digest(5), is_equal: Some(true) };
            assert_eq!(digests.status(), Some(status));
            assert_eq!(digests.read(done(2, 6)), None, "of another generation");
            assert_eq!(digests.made(done(2, 7)), Some(differs(7, 6)));
            let status = DigestStatus { generation: 2, digest: Digest(7), is_equal: Some(false) };
            assert_eq!(digests.status(), Some(status));
        }
    }

    #[test]
    fn other_maths_make_no_difference() {
        let mut digests = Digests::default();
        digests.made(done(1, 5));
        assert_eq!(digests.read(UpdateDone { maths: 2, ..done(1, 6) }), Some(DigestVerdict::OtherMaths));
        assert_eq!(digests.status().map(|status| status.is_equal), Some(None));
    }

    #[test]
    fn after_a_restart_nothing_is_compared_that_only_the_log_knows() {
        let mut digests = Digests::new(Some(done(3, 5)));
        assert_eq!((digests.status(), digests.owed()), (None, None));
        // The last update is repeated, because none of its result was saved.
        assert_eq!(digests.made(done(3, 5)), Some(DigestVerdict::Equal));
        let mut saved = Digests::new(None);
        assert_eq!(saved.read(done(3, 5)), None, "the own one was saved, and its digest is not known");
        assert_eq!(saved.made(done(4, 6)), None);
        assert_eq!(saved.read(done(4, 6)), Some(DigestVerdict::Equal));
    }

    #[test]
    fn a_generation_that_is_never_in_the_log_is_forgotten() {
        let mut digests = Digests::default();
        digests.made(done(1, 5));
        assert_eq!(digests.made(done(2, 6)), None);
        assert_eq!(digests.read(done(2, 6)), Some(DigestVerdict::Equal));
    }

    #[test]
    fn a_writer_owes_the_end_of_its_update_until_it_is_in_the_log() {
        let mut digests = Digests::new(Some(done(1, 4)));
        digests.made(done(2, 5));
        assert_eq!(digests.owed(), Some(done(2, 5)));
        digests.note_logged(done(2, 5));
        assert_eq!(digests.owed(), None);
        let status = DigestStatus { generation: 2, digest: Digest(5), is_equal: None };
        assert_eq!(digests.status(), Some(status), "the writer is not compared with itself");
        digests.made(done(3, 6));
        digests.begin(4);
        assert_eq!(digests.owed(), None, "the previous writer did not record it, and the log continues");
        // The previous writer has already logged it.
        digests.read(done(4, 7));
        digests.made(done(4, 7));
        assert_eq!(digests.owed(), None);
    }
}
