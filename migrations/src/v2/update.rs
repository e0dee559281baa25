//! What an update of a grid has done so far, in a file of its own.
//!
//! A file is a header, whose position is the generation, an [`Update`], and then tiles, as long as the update runs.
//! There is no trailer: a file ends where the process did. Of each tile come first the [shared
//! sums](super::file::RecordKind::SharedSum) that are new with it, then, where it has them, its model and its sums, and
//! last a [`DoneTile`]. Shared sums are numbered over the whole file. A later record of a tile takes the place of an
//! earlier one.
//!
//! Invariant: what does not lead to a [`DoneTile`] whose checksum fits counts for nothing.

/// Which update it is of. A file of any other is of no use.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Update {
    /// How the records after it are laid out: 1.
    #[prost(uint32, tag = "1")]
    pub layout: u32,
    /// What it publishes.
    #[prost(uint64, tag = "2")]
    pub generation: u64,
    /// Log position of its start.
    #[prost(uint64, tag = "3")]
    pub position: u64,
    /// It takes what is older.
    #[prost(sint64, tag = "4")]
    pub cut_nanos: i64,
    /// Digest of what it takes, and of how it computes.
    #[prost(fixed64, tag = "5")]
    pub content: u64,
    /// Base period, where the periodicities are harmonics; 0 where they are a list.
    #[prost(sint64, tag = "6")]
    pub harmonics_base_nanos: i64,
    /// Number of harmonics; 0 where they are a list.
    #[prost(uint32, tag = "7")]
    pub harmonics_count: u32,
    /// Periods, where they are a list.
    #[prost(sint64, repeated, tag = "8")]
    pub period_nanos: Vec<i64>,
}

/// A tile after one of the update's days.
#[derive(Clone, PartialEq, prost::Message)]
pub struct DoneTile {
    /// Its number.
    #[prost(uint32, tag = "1")]
    pub tile: u32,
    /// The last day that is folded in, in days since 1970-01-01.
    #[prost(sint32, tag = "2")]
    pub through: i32,
    /// Observations of single cells folded in.
    #[prost(uint64, tag = "3")]
    pub observations: u64,
    /// Those that were predicted first and scored.
    #[prost(uint64, tag = "4")]
    pub scored: u64,
    /// Sums of squared errors as doubles, little-endian: those of orders 0 to 15, in force, chosen.
    #[prost(bytes = "vec", tag = "5")]
    pub squared_errors: Vec<u8>,
    /// CRC-32C of all bytes of the file before this record.
    #[prost(fixed32, tag = "6")]
    pub crc_before: u32,
}
