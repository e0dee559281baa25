//! A grid after an update, in a checkpoint.
//!
//! A set of cells of a tile is 64 bytes, the first cell in the lowest bit of the first; an empty set has no bytes. A
//! list of cells holds the number of places between each cell and the one before, as varints. Sets of tiles have the
//! encoding of [`super::event`].
//!
//! Invariant: a double is kept as its bits, little-endian, so that every bit is preserved.

/// The header of a grid.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Grid {
    /// Number of tiles.
    #[prost(uint32, tag = "1")]
    pub tiles: u32,
    /// Number of tiles, from the first, that have a model and sums.
    #[prost(uint32, tag = "2")]
    pub models: u32,
    /// Number of days.
    #[prost(uint32, tag = "3")]
    pub days: u32,
    /// Number of scans whose time is in the future.
    #[prost(uint32, tag = "4")]
    pub ahead: u32,
    /// Number of acknowledged scans.
    #[prost(uint64, tag = "5")]
    pub scans: u64,
    /// Number of observations of single cells in these scans.
    #[prost(uint64, tag = "6")]
    pub cell_observations: u64,
    /// The set of the tiles of the last scan in the log.
    #[prost(bytes = "vec", tag = "7")]
    pub last_seen: Vec<u8>,
    /// Time at which the first of the scans in `days` and `ahead` was received, or an earlier time; absent if there are
    /// none.
    #[prost(sint64, optional, tag = "8")]
    pub received_nanos: Option<i64>,
    /// The cells that the scans of the grid are pictures of; absent if no scan states them.
    #[prost(message, optional, tag = "9")]
    pub shown: Option<super::map::CellBox>,
}

/// The current state of a tile, after the newest scans.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Tile {
    /// Index along x.
    #[prost(sint32, tag = "1")]
    pub x: i32,
    /// Index along y.
    #[prost(sint32, tag = "2")]
    pub y: i32,
    /// Index along z.
    #[prost(sint32, tag = "3")]
    pub z: i32,
    /// Cells of the tile that its last scan in the log observed.
    #[prost(bytes = "vec", tag = "4")]
    pub arrival_observed: Vec<u8>,
    /// Cells of the tile that are occupied in its last scan in the log.
    #[prost(bytes = "vec", tag = "5")]
    pub arrival_occupied: Vec<u8>,
    /// Cells that were ever observed.
    #[prost(bytes = "vec", tag = "6")]
    pub known: Vec<u8>,
    /// Cells whose newest reading is occupied.
    #[prost(bytes = "vec", tag = "7")]
    pub occupied: Vec<u8>,
    /// Cells observed by the newest scan.
    #[prost(bytes = "vec", tag = "8")]
    pub current: Vec<u8>,
    /// Time of the newest scan.
    #[prost(sint64, tag = "9")]
    pub newest_nanos: i64,
    /// Number of scans that were newer than all scans before.
    #[prost(uint64, tag = "10")]
    pub scans: u64,
    /// Known cells that the newest scan did not observe: a list of cells, each with the time of its last observation
    /// before `newest_nanos`, as a zigzag varint, and its pairs of successive observations, as a varint.
    #[prost(bytes = "vec", tag = "11")]
    pub away: Vec<u8>,
    /// Offsets of pairs from scans: a list of cells, each with a zigzag varint.
    #[prost(bytes = "vec", tag = "12")]
    pub offsets: Vec<u8>,
    /// Sums of rates of change: a list of cells, each with a double.
    #[prost(bytes = "vec", tag = "13")]
    pub change_rates: Vec<u8>,
    /// Whether a model and sums follow; otherwise both are empty.
    #[prost(bool, tag = "14")]
    pub has_model: bool,
    /// Number of the sensor of the newest scan: 0 for the sensor of the map; the other sensors are numbered in the
    /// order in which their first producers appear in the log.
    #[prost(uint32, tag = "15")]
    pub sensor: u32,
    /// The sensor that last observed each cell of `away`, a byte each, in the order of `away`; empty: the sensor of the
    /// map for all cells.
    #[prost(bytes = "vec", tag = "16")]
    pub away_sensors: Vec<u8>,
    /// The newest evidence for each source of scans, the sources ascending.
    #[prost(message, repeated, tag = "17")]
    pub odds: Vec<SourceOdds>,
}

/// The newest evidence of a source about the cells of a tile.
#[derive(Clone, PartialEq, prost::Message)]
pub struct SourceOdds {
    /// The source: 0 for scans that state cells, 129 plus the height for rays.
    #[prost(sint32, tag = "1")]
    pub source: i32,
    /// The log odds of cells for which they are not 0, in steps of 1/32: a list of cells, each with a signed byte.
    #[prost(bytes = "vec", tag = "2")]
    pub cells: Vec<u8>,
}

/// The learned model of a tile.
#[derive(Clone, PartialEq, prost::Message)]
pub struct TileModel {
    /// Observation groups.
    #[prost(message, repeated, tag = "1")]
    pub groups: Vec<Group>,
    /// Cells whose readings were all occupied.
    #[prost(bytes = "vec", tag = "2")]
    pub always_occupied: Vec<u8>,
    /// Cells that have changed.
    #[prost(message, repeated, tag = "3")]
    pub cells: Vec<Cell>,
}

/// A group of cells that were observed at the same times.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Group {
    #[prost(bytes = "vec", tag = "1")]
    pub cells: Vec<u8>,
    /// Number of observations of each cell.
    #[prost(uint64, tag = "2")]
    pub observations: u64,
    /// Time of the first observation.
    #[prost(sint64, tag = "3")]
    pub first_nanos: i64,
    /// Time of the last observation.
    #[prost(sint64, tag = "4")]
    pub last_nanos: i64,
    /// Sum of α over the observations. Present in all groups of a tile or in none; if in none, all observations are of
    /// the sensor of the map.
    #[prost(fixed64, optional, tag = "5")]
    pub alpha_bits: Option<u64>,
    /// Sum of β over the observations; present where `alpha_bits` is.
    #[prost(fixed64, optional, tag = "6")]
    pub beta_bits: Option<u64>,
    /// With a half-life: total weight of the observations. Present in all groups of a tile or in none.
    #[prost(fixed64, optional, tag = "7")]
    pub weight_bits: Option<u64>,
    /// With a half-life: the latest local day that was learned, in days since 1970-01-01.
    #[prost(sint32, optional, tag = "8")]
    pub day: Option<i32>,
    /// With a half-life: the latest local day in the sums of the group.
    #[prost(sint32, optional, tag = "9")]
    pub sum_day: Option<i32>,
    /// Evidence for each hour of weekdays, then of weekends, a byte each. Empty: every hour is known.
    #[prost(bytes = "vec", tag = "10")]
    pub seen: Vec<u8>,
}

/// The model of a cell.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Cell {
    #[prost(uint32, tag = "1")]
    pub cell: u32,
    /// Number of occupied readings.
    #[prost(uint64, tag = "2")]
    pub occupied: u64,
    #[prost(fixed64, tag = "3")]
    pub mean_bits: u64,
    /// Number of observations that the model was trained on.
    #[prost(uint64, tag = "4")]
    pub observations: u64,
    /// Components, strongest first: index of the periodicity u32, real and imaginary part as doubles.
    #[prost(bytes = "vec", tag = "5")]
    pub components: Vec<u8>,
    /// Number of components in force.
    #[prost(uint32, tag = "6")]
    pub order: u32,
    /// Faded sums of errors, orders 0 to 15, as doubles.
    #[prost(bytes = "vec", tag = "7")]
    pub error_sums: Vec<u8>,
    /// Last local day recorded in the errors, in days since 1970-01-01.
    #[prost(sint32, optional, tag = "8")]
    pub errors_last_day: Option<i32>,
    /// Sum of β over the occupied readings. Present if the groups have sums of α and β.
    #[prost(fixed64, optional, tag = "9")]
    pub occupied_weight_bits: Option<u64>,
    /// The local day on which the change alarm of the cell was raised, if it is on.
    #[prost(sint32, optional, tag = "10")]
    pub alarm_day: Option<i32>,
}

/// Observation times of the cells of a tile. The message follows the sums of the tile in the same record.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Sightings {
    /// Days with observations of cells that have no sums for these days, in the order in which the days were learned.
    #[prost(message, repeated, tag = "1")]
    pub days: Vec<SeenDay>,
    /// Times between the observations of each group.
    #[prost(message, repeated, tag = "2")]
    pub times: Vec<GroupTimes>,
    /// Support and change alarm of each changed cell, messages with the fields of `OrderWatchParts` of `tidemap-model`.
    #[prost(bytes = "vec", repeated, tag = "3")]
    pub watches: Vec<Vec<u8>>,
    /// The cells that were last occupied for each source of scans, the sources ascending.
    #[prost(message, repeated, tag = "4")]
    pub standing: Vec<Standing>,
}

/// The cells of a tile that were last occupied for a source of scans.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Standing {
    /// The source: 0 for scans that state cells, 129 plus the height for rays.
    #[prost(sint32, tag = "1")]
    pub source: i32,
    #[prost(bytes = "vec", tag = "2")]
    pub cells: Vec<u8>,
}

/// The times between the observations of a group.
#[derive(Clone, PartialEq, prost::Message)]
pub struct GroupTimes {
    /// Number of gaps.
    #[prost(uint64, tag = "1")]
    pub gaps: u64,
    /// A sample of the gaps, in whole seconds.
    #[prost(uint32, repeated, tag = "2")]
    pub kept_secs: Vec<u32>,
    /// Number of single hours with an observation.
    #[prost(fixed64, tag = "3")]
    pub hours_bits: u64,
    /// Number of single hours with an observation by hour of the day, of weekdays, then of weekends. Empty: evenly
    /// spread.
    #[prost(float, repeated, tag = "4")]
    pub by_hour: Vec<f32>,
}

/// The times at which cells of a tile were observed on one day.
#[derive(Clone, PartialEq, prost::Message)]
pub struct SeenDay {
    /// Number of scans that saw the tile, at least 1.
    #[prost(uint32, tag = "1")]
    pub scans: u32,
    /// Local civil time of the first scan, in nanoseconds since 1970 local.
    #[prost(sint64, tag = "2")]
    pub first_civil_nanos: i64,
    /// Unit of the differences of times.
    #[prost(uint64, tag = "3")]
    pub time_unit_nanos: u64,
    /// Column of differences of times, zigzag, modulo 2^64: `scans` - 1 of them, or one if all are equal.
    #[prost(bytes = "vec", tag = "4")]
    pub times: Vec<u8>,
    /// Lists of cells that the same scans observed, one list after another: number of cells, number of places between
    /// each cell and the one before, number of toggles, number of scans between each toggle and the one before; all as
    /// varints.
    #[prost(bytes = "vec", tag = "5")]
    pub lists: Vec<u8>,
    /// Lengths of the runs of scans of one sensor; empty if all scans are of the sensor of the map.
    #[prost(uint32, repeated, tag = "6")]
    pub sensor_counts: Vec<u32>,
    /// Sensor of each run.
    #[prost(uint32, repeated, tag = "7")]
    pub sensors: Vec<u32>,
}

/// The scans of one local day. The records of the tiles of the day follow.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Day {
    /// The local date, in days since 1970-01-01.
    #[prost(sint32, tag = "1")]
    pub day: i32,
    /// Number of scans.
    #[prost(uint32, tag = "2")]
    pub scans: u32,
    /// Time of the first scan.
    #[prost(int64, tag = "3")]
    pub first_time_nanos: i64,
    /// Unit of the differences of times.
    #[prost(uint64, tag = "4")]
    pub time_unit_nanos: u64,
    /// Column of differences of times: `scans` - 1 of them.
    #[prost(bytes = "vec", tag = "5")]
    pub times: Vec<u8>,
    /// Lengths of the runs of equal UTC offsets.
    #[prost(uint32, repeated, tag = "6")]
    pub offset_counts: Vec<u32>,
    /// Offset of each run.
    #[prost(sint32, repeated, tag = "7")]
    pub offset_secs: Vec<i32>,
    /// Runs of scans that saw the same tiles: the run's length as a varint, and the set of tiles.
    #[prost(bytes = "vec", tag = "8")]
    pub presence: Vec<u8>,
    /// Number of tile records that follow.
    #[prost(uint32, tag = "9")]
    pub tiles: u32,
    /// The greatest tile number in the runs, plus one.
    #[prost(uint32, tag = "10")]
    pub tiles_end: u32,
    /// Lengths of the runs of scans of one sensor; empty if all scans are of the sensor of the map.
    #[prost(uint32, repeated, tag = "11")]
    pub sensor_counts: Vec<u32>,
    /// Sensor of each run.
    #[prost(uint32, repeated, tag = "12")]
    pub sensors: Vec<u32>,
    /// Lengths of the runs of scans of one source; empty if all scans state cells.
    #[prost(uint32, repeated, tag = "13")]
    pub source_counts: Vec<u32>,
    /// Source of each run: 0 for scans that state cells, 129 plus the height for rays.
    #[prost(sint32, repeated, tag = "14")]
    pub sources: Vec<i32>,
}

/// One tile on one day.
#[derive(Clone, PartialEq, prost::Message)]
pub struct DayTile {
    #[prost(uint32, tag = "1")]
    pub tile: u32,
    /// The observations; absent if only models are known.
    #[prost(message, optional, tag = "2")]
    pub scans: Option<DayTileScans>,
    /// Small models of cells, ascending: place u16, mean as a float, number of components u8, for each component the
    /// index of the periodicity u16, real and imaginary part as floats. In history files only.
    #[prost(bytes = "vec", tag = "3")]
    pub models: Vec<u8>,
}

/// The observations of a tile by the scans of one day.
#[derive(Clone, PartialEq, prost::Message)]
pub struct DayTileScans {
    /// Cells observed by the first scan.
    #[prost(bytes = "vec", tag = "1")]
    pub first_observed: Vec<u8>,
    /// Cells occupied in the first scan.
    #[prost(bytes = "vec", tag = "2")]
    pub first_occupied: Vec<u8>,
    /// Flips by bit, for each bit ascending by scan: number of bits between this bit and the one before (bit = 2·place,
    /// plus one for the occupied bit), number of flips less 1, and number of scans between each flip and the one
    /// before; all as varints. Within one scan, flips of observed bits come before flips of occupied bits, both by
    /// place.
    #[prost(bytes = "vec", tag = "3")]
    pub flips: Vec<u8>,
    /// All flips in their order; used instead of `flips` if the flips of one scan have another order. For each flip the
    /// number of scans since the flip before and the bit, numbered as in `flips`, as varints.
    #[prost(bytes = "vec", tag = "4")]
    pub flips_in_order: Vec<u8>,
    /// The masks of the last scan, if they differ from the masks of the first scan after all flips.
    #[prost(message, optional, tag = "5")]
    pub last: Option<Masks>,
}

/// The observation of a tile by a scan.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Masks {
    /// Cells observed.
    #[prost(bytes = "vec", tag = "1")]
    pub observed: Vec<u8>,
    /// Cells occupied.
    #[prost(bytes = "vec", tag = "2")]
    pub occupied: Vec<u8>,
}

/// A scan that waits because its time is too far in the future.
#[derive(Clone, PartialEq, prost::Message)]
pub struct AheadScan {
    #[prost(sint64, tag = "1")]
    pub utc_nanos: i64,
    #[prost(sint32, tag = "2")]
    pub offset_secs: i32,
    /// The numbers of the tiles of the scan, in the order of the scan.
    #[prost(uint32, repeated, tag = "3")]
    pub tiles: Vec<u32>,
    /// For each tile the observed cells and the occupied cells, 64 bytes each.
    #[prost(bytes = "vec", tag = "4")]
    pub masks: Vec<u8>,
    #[prost(uint32, tag = "5")]
    pub sensor: u32,
    /// The source: 0 for a scan that states cells, 129 plus the height for rays.
    #[prost(sint32, tag = "6")]
    pub source: i32,
}
