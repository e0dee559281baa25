//! The sled database in `index/`: what the newest generation of each map publishes, without the sums it is made of.
//!
//! | tree | key | value |
//! | --- | --- | --- |
//! | [`STATES`] | map u32, state u32, part u16 | part of a [`StateRow`] |
//! | [`TILES`] | map u32, tile u32, part u16 | part of a [`super::grid::Tile`]: cells known, and their last values |
//! | [`CELLS`] | map u32, tile u32, part u16 | part of a [`super::grid::TileModel`]: the models of a tile's cells |
//! | [`SITES`] | map u32, 0 u32, part u16 | part of a [`super::site::Site`] |
//! | [`PRODUCERS`] | map u32, producer u32, part u16 | part of a [`super::map::Producer`] |
//! | [`GENERATIONS`] | map u32 | [`Mark`] |
//!
//! Numbers in keys are big-endian, so that they sort. A message is cut into parts of [`PART_LENGTH`] bytes, from 0. A
//! value is [`encode_value`]'s: a version, a checksum over tree, key and payload, and the payload.
//!
//! Invariant: no value is longer than 4 KB, because sled keeps long ones in files that it never syncs.
//!
//! [`encode_value`]: crate::v1::index::encode_value

/// Name of the tree of states.
pub const STATES: &str = "published.states";
/// Name of the tree of tiles as the newest scans before the cut show them.
pub const TILES: &str = "published.tiles";
/// Name of the tree of the models of tiles.
pub const CELLS: &str = "published.cells";
/// Name of the tree of sites.
pub const SITES: &str = "published.sites";
/// Name of the tree of producers.
pub const PRODUCERS: &str = "published.producers";
/// Name of the tree of marks.
pub const GENERATIONS: &str = "published.generations";

/// Most bytes of a message in one value.
pub const PART_LENGTH: usize = 3840;

/// One state: what readers need of it.
#[derive(Clone, PartialEq, prost::Message)]
pub struct StateRow {
    /// The state without `spectrum`, and without `alternatives.hours`.
    #[prost(message, optional, tag = "1")]
    pub state: Option<super::map::State>,
    /// The 480 doubles of `alternatives.hours`, each as the varint of its bits in the reverse order of bytes; empty
    /// where there are no alternatives. Small numbers are short.
    #[prost(bytes = "vec", tag = "2")]
    pub hours: Vec<u8>,
}

/// The rows of one tree.
#[derive(Clone, Copy, PartialEq, Eq, prost::Message)]
pub struct Total {
    /// Their number.
    #[prost(uint64, tag = "1")]
    pub records: u64,
    /// Bytes of their keys and values.
    #[prost(uint64, tag = "2")]
    pub bytes: u64,
    /// Sum of [`crate::v1::index::fingerprint`] over their values.
    #[prost(fixed64, tag = "3")]
    pub fingerprint_sum: u64,
}

/// What a generation publishes of a grid besides its tiles.
#[derive(Clone, Copy, PartialEq, Eq, prost::Message)]
pub struct GridMark {
    /// Number of tiles.
    #[prost(uint32, tag = "1")]
    pub tiles: u32,
    /// Number of tiles with a model; the first ones.
    #[prost(uint32, tag = "2")]
    pub models: u32,
    /// Scans acknowledged.
    #[prost(uint64, tag = "3")]
    pub scans: u64,
    /// Observations of single cells in them.
    #[prost(uint64, tag = "4")]
    pub cell_observations: u64,
}

/// The generation of a map that the rows make up.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Mark {
    /// While it is set, rows are being written and must not be used.
    #[prost(bool, tag = "1")]
    pub dirty: bool,
    /// The generation.
    #[prost(message, optional, tag = "2")]
    pub snapshot: Option<super::map::Snapshot>,
    /// Its grid, where the map has one.
    #[prost(message, optional, tag = "3")]
    pub grid: Option<GridMark>,
    /// The rows of the trees of states, tiles, cells, sites and producers, in this order.
    #[prost(message, repeated, tag = "4")]
    pub totals: Vec<Total>,
}
