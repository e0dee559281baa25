//! Observations as bytes: the records of the queue.
//!
//! Invariant: a record has all data that sending needs, so that it is sent as the same content on any day.

use prost::Message as _;
use tidemap_grid::{
    index::TileIndex,
    mask::{Mask, TileMasks},
};
use tidemap_proto::{
    convert::{
        grid::{cell_box_from_wire, cell_box_to_wire, pose_from_wire, pose_to_wire},
        scans::MASK_BYTES,
    },
    v1,
};

use crate::observe::{
    occupancy::{GRID_CELLS_MAX, OccupancyGrid},
    scan::Scan,
};

#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct QueuedRecord {
    #[prost(sfixed64, tag = "1")]
    pub(super) time_nanos: i64,
    #[prost(oneof = "RecordContent", tags = "2, 3, 4, 5, 6, 7, 8, 9")]
    pub(super) content: Option<RecordContent>,
}

/// The time of a record, without the rest.
#[derive(Clone, PartialEq, prost::Message)]
struct RecordTime {
    #[prost(sfixed64, tag = "1")]
    time_nanos: i64,
}

#[derive(Clone, PartialEq, prost::Oneof)]
pub(super) enum RecordContent {
    #[prost(message, tag = "2")]
    Value(ValueRecord),
    /// A label by its name, `STATE/LABEL`.
    #[prost(string, tag = "3")]
    Label(String),
    #[prost(message, tag = "4")]
    Position(PositionRecord),
    #[prost(message, tag = "5")]
    Tiles(TilesRecord),
    #[prost(message, tag = "6")]
    Cloud(v1::PointCloud),
    #[prost(message, tag = "7")]
    Ranges(v1::RangeScan),
    #[prost(message, tag = "8")]
    Grid(GridRecord),
    #[prost(message, tag = "9")]
    Report(v1::Report),
}

#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct ValueRecord {
    #[prost(string, tag = "1")]
    pub(super) state: String,
    #[prost(double, tag = "2")]
    pub(super) value: f64,
}

#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct PositionRecord {
    #[prost(string, tag = "1")]
    pub(super) state: String,
    #[prost(double, repeated, tag = "2")]
    pub(super) coordinates: Vec<f64>,
}

/// A scan of tiles, whole.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct TilesRecord {
    /// Index x, y, z of each tile.
    #[prost(sint32, repeated, tag = "1")]
    indices: Vec<i32>,
    /// The masks of each tile.
    #[prost(bytes = "vec", tag = "2")]
    observed: Vec<u8>,
    #[prost(bytes = "vec", tag = "3")]
    occupied: Vec<u8>,
    /// The size of a map.
    #[prost(message, optional, tag = "4")]
    shown: Option<v1::CellBox>,
}

/// A grid with a pose of its own. Most neighbouring cells are alike.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct GridRecord {
    #[prost(message, optional, tag = "1")]
    pose: Option<v1::Pose>,
    #[prost(double, tag = "2")]
    resolution_m: f64,
    #[prost(uint32, tag = "3")]
    width: u32,
    /// Runs of equal cells: the number of cells times 4, and 0 for not seen, 1 for free, 2 for occupied.
    #[prost(uint32, repeated, tag = "4")]
    runs: Vec<u32>,
}

/// Why bytes are no record that can be sent.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum BadRecord {
    #[error("{0} bytes are no record: {1}")]
    Bytes(usize, String),
    #[error("a record without content; does it come from another version?")]
    Empty,
    #[error("a record whose parts do not match")]
    Parts,
}

impl QueuedRecord {
    pub(super) fn new(time_nanos: i64, content: RecordContent) -> Self {
        Self { time_nanos, content: Some(content) }
    }

    /// The record of bytes.
    pub(super) fn read(raw: &[u8]) -> Result<(i64, RecordContent), BadRecord> {
        let record = Self::decode(raw).map_err(|error| BadRecord::Bytes(raw.len(), error.to_string()))?;
        Ok((record.time_nanos, record.content.ok_or(BadRecord::Empty)?))
    }
}

/// The time of a record of the queue; `None`: the bytes are no record.
pub(super) fn time_in(raw: &[u8]) -> Option<i64> {
    RecordTime::decode(raw).ok().map(|record| record.time_nanos)
}

impl From<Scan> for RecordContent {
    fn from(scan: Scan) -> Self {
        match scan {
            Scan::Tiles(tiles) => Self::Tiles(TilesRecord::new(&tiles, None)),
            Scan::Map { tiles, shown } => Self::Tiles(TilesRecord::new(&tiles, Some(cell_box_to_wire(&shown)))),
            Scan::Cloud(cloud) => Self::Cloud(cloud.into()),
            Scan::Ranges(ranges) => Self::Ranges(ranges.into()),
        }
    }
}

impl TilesRecord {
    fn new(tiles: &[(TileIndex, TileMasks)], shown: Option<v1::CellBox>) -> Self {
        Self {
            indices: tiles.iter().flat_map(|(tile, _)| [tile.x, tile.y, tile.z]).collect(),
            observed: tiles.iter().flat_map(|(_, masks)| masks.observed().to_bytes()).collect(),
            occupied: tiles.iter().flat_map(|(_, masks)| masks.occupied().to_bytes()).collect(),
            shown,
        }
    }

    pub(super) fn scan(&self) -> Result<Scan, BadRecord> {
        let (observed, rest) = self.observed.as_chunks::<MASK_BYTES>();
        let (occupied, more) = self.occupied.as_chunks::<MASK_BYTES>();
        let (indices, last) = self.indices.as_chunks::<3>();
        let is_whole = rest.is_empty() && more.is_empty() && last.is_empty();
        if !is_whole || observed.len() != indices.len() || occupied.len() != indices.len() {
            return Err(BadRecord::Parts);
        }
        let masks = observed.iter().zip(occupied);
        let masks = masks
            .map(|(observed, occupied)| TileMasks::clipped(Mask::from_bytes(observed), Mask::from_bytes(occupied)));
        let tiles = indices.iter().map(|&[x, y, z]| TileIndex { x, y, z }).zip(masks).collect();
        Ok(match &self.shown {
            Some(shown) => Scan::Map { tiles, shown: cell_box_from_wire(shown) },
            None => Scan::Tiles(tiles),
        })
    }
}

impl GridRecord {
    /// The record of a grid that was checked.
    pub(super) fn new(grid: &OccupancyGrid) -> Self {
        let code = |cell: &i8| match cell.signum() {
            -1 => 0_u32,
            0 => 1,
            _ => 2,
        };
        let runs = grid.cells.chunk_by(|one, other| one.signum() == other.signum());
        // A checked grid has far fewer cells than 2^30.
        let runs = runs.map(|run| u32::try_from(run.len()).unwrap_or(0) << 2 | run.first().map_or(0, code)).collect();
        let width = u32::try_from(grid.width).unwrap_or(0);
        Self { pose: Some(pose_to_wire(&grid.pose)), resolution_m: grid.resolution_m, width, runs }
    }

    pub(super) fn grid(&self) -> Result<OccupancyGrid, BadRecord> {
        let pose = pose_from_wire("pose", self.pose).map_err(|error| BadRecord::Bytes(0, error.to_string()))?;
        if self.runs.iter().map(|run| u64::from(run >> 2)).sum::<u64>() > GRID_CELLS_MAX as u64 {
            return Err(BadRecord::Parts);
        }
        let mut cells = Vec::new();
        for run in &self.runs {
            let cell = match run & 3 {
                0 => -1,
                1 => 0,
                2 => 1,
                _ => return Err(BadRecord::Parts),
            };
            cells.resize(cells.len() + (run >> 2) as usize, cell);
        }
        Ok(OccupancyGrid { pose, resolution_m: self.resolution_m, width: self.width as usize, cells })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Isometry3;
    use proptest::prelude::*;
    use tidemap_grid::index::{CellBox, CellIndex};

    use super::*;
    use crate::observe::{
        TraversalReport,
        scan::{PointCloud, RangeScan},
    };

    fn again(content: RecordContent) -> RecordContent {
        let raw = QueuedRecord::new(7, content).encode_to_vec();
        assert_eq!(time_in(&raw), Some(7));
        let (time, content) = QueuedRecord::read(&raw).expect("a record");
        assert_eq!(time, 7);
        content
    }

    #[test]
    fn records_are_read_back_as_they_were() {
        let ranges = RangeScan { ranges_m: vec![1.5, f32::INFINITY], max_range_m: 30.0, ..RangeScan::default() };
        let cloud = PointCloud { xyz_m: vec![0.0, 1.0, 2.0], frame_id: "map".to_owned(), ..PointCloud::default() };
        let contents = [
            RecordContent::Value(ValueRecord { state: "dveře".to_owned(), value: 0.1 }),
            RecordContent::Label("door/open".to_owned()),
            RecordContent::Position(PositionRecord { state: "anna".to_owned(), coordinates: vec![1.0, 2.0] }),
            Scan::Ranges(ranges).into(),
            Scan::Cloud(cloud).into(),
            RecordContent::Report(
                TraversalReport { from: "hall".to_owned(), ..TraversalReport::default() }.to_report(),
            ),
        ];
        for content in contents {
            assert_eq!(again(content.clone()), content);
        }
    }

    #[test]
    fn tiles_and_the_size_of_a_map_are_kept() {
        let tile = |x| (TileIndex { x, y: -1, z: 0 }, TileMasks::clipped(Mask([3; 8]), Mask([1; 8])));
        let shown = CellBox { min: CellIndex { x: -8, y: 0, z: 0 }, max: CellIndex { x: 8, y: 1, z: 1 } };
        for scan in [Scan::Tiles(vec![tile(4), tile(-5)]), Scan::Map { tiles: vec![tile(0)], shown }] {
            let RecordContent::Tiles(record) = again(scan.clone().into()) else { panic!("tiles") };
            assert_eq!(record.scan(), Ok(scan));
            let short = TilesRecord { observed: Vec::new(), ..record };
            assert_eq!(short.scan(), Err(BadRecord::Parts));
        }
    }

    #[test]
    fn a_run_that_is_too_long_is_refused() {
        let record = GridRecord { runs: vec![!3; 9], ..GridRecord::default() };
        assert_eq!(record.grid(), Err(BadRecord::Parts));
        assert_eq!(GridRecord { runs: vec![7], ..GridRecord::default() }.grid(), Err(BadRecord::Parts));
    }

    proptest! {
        #[test]
        fn grids_keep_their_cells(cells in proptest::collection::vec(-1_i8..2, 1..200)) {
            let width = cells.len();
            let grid = OccupancyGrid { pose: Isometry3::translation(1.0, 2.0, 0.0), resolution_m: 0.05, width, cells };
            let RecordContent::Grid(record) = again(RecordContent::Grid(GridRecord::new(&grid))) else { panic!("a grid") };
            prop_assert_eq!(record.grid(), Ok(grid));
        }

        #[test]
        fn any_bytes_are_read_without_a_panic(raw in proptest::collection::vec(any::<u8>(), 0..300)) {
            match QueuedRecord::read(&raw) {
                Ok((_, RecordContent::Tiles(record))) => drop(record.scan()),
                Ok((_, RecordContent::Grid(record))) => drop(record.grid()),
                _ => {}
            }
        }
    }
}
