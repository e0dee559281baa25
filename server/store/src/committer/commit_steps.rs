//! The steps of one group commit, for who wants to follow them.
//!
//! Invariant: a follower hears of each group that it was told of once more: written, then durable or failed.

use std::{fmt, sync::OnceLock};

use crate::MapId;

/// A step of a group of records.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommitStep {
    /// All its records are written, and `fdatasync` begins.
    Written,
    /// It is durable.
    Durable,
    /// It is not durable, and its records are refused.
    Failed,
}

/// Hears the steps of one group. It is called by the committer's thread, and must be quick.
pub type GroupFollower = Box<dyn FnMut(CommitStep) + Send>;
/// Hears that a group begins, of this map, with so many records of so many bytes.
pub type CommitFollower = Box<dyn Fn(MapId, usize, u64) -> GroupFollower + Send + Sync>;

/// Who follows the commits of a store, if anybody does.
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
