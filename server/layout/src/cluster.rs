//! The additional data of a map of a cluster: records of its shared log, and files in its folder.
//!
//! | place | content |
//! | --- | --- |
//! | log | `W`, an [`Epoch`]; `D`, an [`UpdateDone`] |
//! | folder of a map | [`FORKS_FOLDER`]: records that the shared log does not have, as segments `POSITION-N.log` |
//! | folder of a map | [`SHARED_FILE`], only in a map of a cluster: its number there, as 16 hexadecimal digits |
//!
//! Invariant: the invariant of [`super`] holds here too.

/// Name of the file that makes a map a map of a cluster.
pub const SHARED_FILE: &str = "SHARED";

/// Name of the folder of forks.
pub const FORKS_FOLDER: &str = "forks";

/// A daemon becomes the writer of a shared log.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Epoch {
    /// Number of the writer of the log, from 1.
    #[prost(uint64, tag = "1")]
    pub epoch: u64,
    /// Name of the daemon.
    #[prost(string, tag = "2")]
    pub writer: String,
    /// Version of the daemon.
    #[prost(string, tag = "3")]
    pub version: String,
    /// Version number of the mathematics of the writer's updates.
    #[prost(uint32, tag = "4")]
    pub maths: u32,
}

/// The writer has ended an update.
#[derive(Clone, PartialEq, prost::Message)]
pub struct UpdateDone {
    #[prost(uint64, tag = "1")]
    pub generation: u64,
    /// Checksum of the result of the update.
    #[prost(fixed64, tag = "2")]
    pub digest: u64,
    /// Version number of the mathematics of the update.
    #[prost(uint32, tag = "3")]
    pub maths: u32,
}
