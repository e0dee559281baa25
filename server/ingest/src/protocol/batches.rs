//! The data that a stream hands to its map's writer: checked observations, scans and reports of a message.
//!
//! Invariant: a refused observation still uses up its sequence number.

use std::sync::Arc;

use tidemap_grid::{
    index::{CellBox, TileIndex},
    log_head::StreamScan,
    scan::ScanSource,
};
use tidemap_map::{
    event::{Position, SequenceSpan, StateShape, StatedReporting},
    ids::RefusalReason,
    name::StateName,
    report::Report,
};

/// A refused observation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RefusedObservation {
    /// Sequence number.
    pub sequence: u64,
    /// The reason for programs.
    pub reason: RefusalReason,
    /// The reason for people.
    pub detail: String,
}

/// A name of a stream's table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NewName {
    /// The name; for an observation of a label, the name of the label's state.
    pub name: StateName,
    /// The shape that the message declares for the state; `None`: not declared.
    pub shape: Option<StateShape>,
    /// The reporting of the state that the stream has stated.
    pub reporting: Option<StatedReporting>,
}

impl From<StateName> for NewName {
    /// A name without a declared shape.
    fn from(name: StateName) -> Self {
        Self { name, shape: None, reporting: None }
    }
}

/// Checked observations of one message, with their states as indices into the stream's table.
#[derive(Debug, Default)]
pub struct ObservationBatch {
    /// The new sequence numbers of the message; may be empty.
    pub span: SequenceSpan,
    /// Names added to the stream's table since the last batch; an invalid name keeps its index.
    pub new_names: Vec<Option<NewName>>,
    /// For each accepted observation: its sequence number minus the first one of `span`. Empty if all were accepted.
    pub kept: Vec<u32>,
    /// For each accepted observation: the index into the stream's table; its name is valid.
    pub table_indices: Vec<u32>,
    /// For each accepted observation: its time, nanoseconds UTC.
    pub times_nanos: Vec<i64>,
    /// For each accepted observation: a value that the declared kind allows, or that any kind allows if none is
    /// declared; NaN for a state that may report changes or events; 0 for a position and for shares.
    pub values: Vec<f64>,
    /// The positions, ascending, each with the index of its observation among the accepted ones, and with the declared
    /// number of coordinates.
    pub positions: Vec<(u32, Position)>,
    /// The shares of labels, ascending, each with the index of its observation among the accepted ones; they sum to 1.
    pub shares: Vec<(u32, Box<[f64]>)>,
    /// The refused observations.
    pub refused: Vec<RefusedObservation>,
}

/// The table of tiles to which a scan refers: a stream has two.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ScanOrigin {
    /// The table that the client extends.
    #[default]
    Stream,
    /// The table of the scans that the server has ray-cast.
    Cast,
}

/// A scan that intake has checked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CheckedScan {
    /// Sequence number.
    pub sequence: u64,
    /// Running CRC up to this scan.
    pub content_crc: u32,
    /// The table to which the slots of the scan refer.
    pub origin: ScanOrigin,
    /// Whether the scan is logged. Other scans are only remembered, because later ones refer to them.
    pub is_taken: bool,
    /// The scan.
    pub scan: StreamScan,
    /// Tiles added to the table before this scan.
    pub new_tiles: Vec<TileIndex>,
    /// Whether the table restarts before these tiles.
    pub restarts: bool,
}

impl Default for CheckedScan {
    fn default() -> Self {
        let scan = StreamScan {
            utc_nanos: 0,
            source: ScanSource::default(),
            seen: Arc::from([]),
            observed_flips: Vec::new(),
            occupied_flips: Vec::new(),
        };
        let origin = ScanOrigin::default();
        Self { sequence: 0, content_crc: 0, origin, is_taken: false, scan, new_tiles: Vec::new(), restarts: false }
    }
}

/// Checked scans of one message, or some of them.
#[derive(Debug, Default)]
pub struct ScanBatch {
    /// The new scans of the message, or of a part of it; may be empty.
    pub span: SequenceSpan,
    /// Tiles added to the client's table before the scans.
    pub new_tiles: Vec<TileIndex>,
    /// The scans, in order.
    pub scans: Vec<CheckedScan>,
    /// The cells that the scans show, within those that the grid may have; empty if the scans do not state them.
    pub shown: CellBox,
    /// The refused scans among the new ones.
    pub refused: Vec<RefusedObservation>,
    /// Memory of the batch, approximately.
    pub bytes: usize,
}

/// Checked reports of one message.
#[derive(Debug, Default)]
pub struct ReportBatch {
    /// The new sequence numbers of the message; not empty.
    pub span: SequenceSpan,
    /// The valid reports with their sequence numbers. The map's writer checks whether edges and landmarks exist.
    pub reports: Vec<(u64, Report)>,
    /// The refused reports.
    pub refused: Vec<RefusedObservation>,
}
