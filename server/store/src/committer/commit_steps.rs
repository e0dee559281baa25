//! The steps of one group commit, for callers that follow them.
//!
//! Invariant: for each group whose beginning a follower received, it receives the further steps: written, then durable
//! or failed.

use std::{fmt, sync::OnceLock};

use crate::MapId;

/// A step of a group of records.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommitStep {
    /// All records of the group are written, and `fdatasync` begins.
    Written,
    /// The group is durable.
    Durable,
    /// The group is not durable, and its records are refused.
    Failed,
}

/// Receives the steps of one group. It is called by the committer's thread, and must be quick.
pub type GroupFollower = Box<dyn FnMut(CommitStep) + Send>;
/// Receives the beginning of a group, of this map, with so many records of so many bytes.
pub type CommitFollower = Box<dyn Fn(MapId, usize, u64) -> GroupFollower + Send + Sync>;

/// The follower of the commits of a store, if there is one.
#[derive(Default)]
pub(crate) struct Followed(OnceLock<CommitFollower>);

impl fmt::Debug for Followed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Followed").field(&self.0.get().is_some()).finish()
    }
}

impl Followed {
    /// Takes the follower; a second one is not taken.
    pub(crate) fn set(&self, follower: CommitFollower) {
        // The first stays.
        let _ = self.0.set(follower);
    }

    pub(super) fn begin(&self, map: u32, sizes: impl Iterator<Item = usize>) -> Option<GroupFollower> {
        let follower = self.0.get()?;
        let (records, bytes) = sizes.fold((0, 0), |(records, bytes), size| (records + 1, bytes + size as u64));
        Some(follower(MapId(map), records, bytes))
    }
}
