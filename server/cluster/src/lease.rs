//! The lease of a map is a hint: it names the writer of the map. The holder raises the counter. A daemon that has seen
//! no change for long enough by its own clock may take the lease.
//!
//! Invariant: a wrong lease costs time, never data: the condition of the append decides who writes.

use std::time::Duration;

use bytes::Bytes;
use serde::{Deserialize, Serialize};
use tokio::time::Instant;

use crate::engine::KeyEntry;

/// The value of a lease.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Lease {
    /// The daemon that holds the lease; empty once it is given back.
    pub writer: String,
    /// The epoch in which the daemon writes; in a lease that was given back, the last epoch.
    pub epoch: u64,
    /// Number of renewals.
    pub counter: u64,
    /// The daemon that takes the lease next, where the writer hands over. While the writer still has the lease, this is
    /// an announcement: the successor then reads the lease more often.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub successor: Option<String>,
}

impl Lease {
    /// Encodes the lease as the value of a key.
    #[must_use]
    pub fn encode(&self) -> Bytes {
        serde_json::to_vec(self).unwrap_or_default().into()
    }

    /// Decodes the value of a key; a value that cannot be read counts as a lease of nobody.
    #[must_use]
    pub fn decode(value: &[u8]) -> Lease {
        serde_json::from_slice(value).unwrap_or_default()
    }
}

/// The last state of a lease that a daemon has read.
#[derive(Debug, Default)]
pub struct LeaseWatch {
    seen: Option<(u64, Lease, Instant)>,
}

impl LeaseWatch {
    /// Records the lease that the engine returned at `now`; `None`: there is no lease.
    pub fn note(&mut self, entry: Option<&KeyEntry>, now: Instant) {
        let revision = entry.map_or(0, |entry| entry.revision);
        if self.seen.as_ref().is_none_or(|(seen, ..)| *seen != revision) {
            let lease = entry.map_or_else(Lease::default, |entry| Lease::decode(&entry.value));
            self.seen = Some((revision, lease, now));
        }
    }

    /// Forgets the lease, because it may have changed meanwhile.
    pub fn forget(&mut self) {
        self.seen = None;
    }

    /// The lease as it was read last, with its revision.
    #[must_use]
    pub fn lease(&self) -> Option<(u64, &Lease)> {
        self.seen.as_ref().map(|(revision, lease, _)| (*revision, lease))
    }

    /// Whether the writer is about to hand over to this daemon.
    #[must_use]
    pub fn is_announced_to(&self, member: &str) -> bool {
        let successor = self.lease().and_then(|(_, lease)| lease.successor.as_deref());
        successor == Some(member)
    }

    /// The revision on which a daemon may take the lease: the holder has given it back, to this daemon or to any, or
    /// nobody has renewed it for `patience`.
    #[must_use]
    pub fn may_take(&self, member: &str, patience: Duration, now: Instant) -> Option<u64> {
        let (revision, lease, since) = self.seen.as_ref()?;
        let waited = now.saturating_duration_since(*since);
        let is_mine = lease.writer == member;
        let is_for_me = lease.successor.as_ref().is_none_or(|successor| successor == member);
        let is_free = lease.writer.is_empty() && *revision > 0 && is_for_me;
        (is_mine || is_free || waited >= patience).then_some(*revision)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(revision: u64, writer: &str, successor: Option<&str>) -> KeyEntry {
        let lease =
            Lease { writer: writer.to_owned(), epoch: 1, counter: revision, successor: successor.map(str::to_owned) };
        KeyEntry { value: lease.encode(), revision }
    }

    #[tokio::test(start_paused = true)]
    async fn a_lease_is_free_when_it_has_not_changed_for_the_patience() {
        let (mut watch, patience) = (LeaseWatch::default(), Duration::from_secs(3));
        let start = Instant::now();
        assert_eq!(watch.may_take("b", patience, start), None, "nothing is known");
        watch.note(Some(&entry(4, "a", None)), start);
        watch.note(Some(&entry(4, "a", None)), start + patience / 2);
        assert_eq!(watch.may_take("b", patience, start + patience / 2), None);
        assert_eq!(watch.may_take("b", patience, start + patience), Some(4));
        watch.note(Some(&entry(5, "a", None)), start + patience);
        assert_eq!(watch.may_take("b", patience, start + patience), None, "it was renewed");
        assert_eq!(watch.may_take("a", patience, start + patience), Some(5), "its own");
    }

    #[tokio::test(start_paused = true)]
    async fn a_lease_that_is_handed_over_is_for_its_successor() {
        let (mut watch, patience) = (LeaseWatch::default(), Duration::from_secs(3));
        let now = Instant::now();
        watch.note(Some(&entry(6, "a", Some("c"))), now);
        assert_eq!(watch.may_take("c", patience, now), None, "the writer still has it");
        assert!(watch.is_announced_to("c") && !watch.is_announced_to("b"));
        watch.note(Some(&entry(7, "", Some("c"))), now);
        assert_eq!(watch.may_take("b", patience, now), None);
        assert_eq!(watch.may_take("c", patience, now), Some(7));
        assert_eq!(watch.may_take("b", patience, now + patience), Some(7), "the successor did not take it");
        watch.note(Some(&entry(8, "", None)), now);
        assert_eq!(watch.may_take("b", patience, now), Some(8), "for any");
    }
}
