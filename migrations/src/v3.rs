//! Format 3, frozen: everything of format 2 as it is there, and these additions.
//!
//! | where | addition |
//! | --- | --- |
//! | [`super::v1::log::FrameKind`] | `W`, an [`Epoch`]; `D`, an [`UpdateDone`]; `F`, a [`ForgetProducers`] |
//! | folder of a map | [`FORKS_FOLDER`]: records that the shared log does not have, as segments `POSITION-N.log` |
//! | folder of a map | [`SHARED_FILE`], of a map of a cluster only: its number there, as 16 hexadecimal digits |
//!
//! The step from format 2 rewrites nothing: it makes older programs refuse the folder, which would not understand the
//! records.
//!
//! Invariant: nothing in this module changes meaning, tag, name or size; `golden.rs` in `tidemap-store` holds it.

#![allow(missing_docs, reason = "fields whose name says it all")]

/// The number of this format.
pub const FORMAT: u32 = 3;

/// Name of the file that makes a map one of a cluster.
pub const SHARED_FILE: &str = "SHARED";

/// Name of the folder of forks.
pub const FORKS_FOLDER: &str = "forks";

/// Producers that will not come back give their places up.
#[derive(Clone, PartialEq, prost::Message)]
pub struct ForgetProducers {
    /// Numbers of the producers.
    #[prost(uint32, repeated, tag = "1")]
    pub producers: Vec<u32>,
}

/// A daemon becomes the writer of a shared log.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Epoch {
    /// Counts the writers of the log, from 1.
    #[prost(uint64, tag = "1")]
    pub epoch: u64,
    /// Name of the daemon.
    #[prost(string, tag = "2")]
    pub writer: String,
    /// Version of the daemon.
    #[prost(string, tag = "3")]
    pub version: String,
    /// Number of the maths of its updates.
    #[prost(uint32, tag = "4")]
    pub maths: u32,
}

/// The writer has ended an update.
#[derive(Clone, PartialEq, prost::Message)]
pub struct UpdateDone {
    #[prost(uint64, tag = "1")]
    pub generation: u64,
    /// Checksum of what the update made.
    #[prost(fixed64, tag = "2")]
    pub digest: u64,
    /// Number of the maths of the update.
    #[prost(uint32, tag = "3")]
    pub maths: u32,
}
