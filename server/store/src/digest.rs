//! The digest of a generation, by which two daemons that apply one log prove that they hold equal bits.
//!
//! Each record is encoded as a checkpoint encodes it, and its CRC-32C is a leaf. The root is a CRC-32C over the leaves
//! in the order of a checkpoint. States and tiles are taken one at a time, so that a large map is not in memory twice.
//!
//! In the digest: number and cut of the generation, position of its start in the log, producers, states with their sums
//! and models, the site, the tiles of the grid with their sums and models. Not in it: what waits for a later update
//! (scans, and the position from which a replay reads observations again), and history, which has files of its own.
//!
//! Invariant: the digest depends on the log up to the start of the update alone: not on where sums and tiles are held,
//! not on which tiles share a sum in memory, and not on when the update ended.

use tidemap_grid::{
    snapshot::GridSnapshot,
    tile::{TileModel, TileSums, TileUnavailable},
};
use tidemap_layout::{file::RecordKind, grid as layout, map as layout_map};
use tidemap_map::{event::Digest, snapshot::MapSnapshot};

use crate::record::{doubles, snapshot as record, spec, tables, tile, tile_model, tile_set};

/// A part of the map cannot be read, or could not be saved either.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a generation has no digest: {0}")]
pub struct NoDigest(String);

impl From<&'static str> for NoDigest {
    fn from(reason: &'static str) -> NoDigest {
        NoDigest(reason.to_owned())
    }
}

impl From<String> for NoDigest {
    fn from(reason: String) -> NoDigest {
        NoDigest(reason)
    }
}

impl From<TileUnavailable> for NoDigest {
    fn from(error: TileUnavailable) -> NoDigest {
        NoDigest(error.to_string())
    }
}

/// The digest of a snapshot: the upper half covers all but the grid, the lower half the grid, 0 without one.
///
/// # Errors
/// [`NoDigest`] where sums or tiles cannot be read from the disk, or the snapshot could not be saved.
pub fn digest(snapshot: &MapSnapshot) -> Result<Digest, NoDigest> {
    let mut leaves = Leaves::default();
    leaves.message(RecordKind::Snapshot, &layout_map::Snapshot { replay_from: 0, ..record::encode(snapshot) });
    for (id, producer) in (0..).zip(&snapshot.producers) {
        leaves.message(RecordKind::Producer, &record::encode_producer(id, producer));
    }
    for (id, state) in (0..).zip(&snapshot.states) {
        let sums = state.model.accumulator().stored_parts()?;
        leaves.message(RecordKind::State, &record::encode_state(id, state, sums));
    }
    for row in tables::rows(&snapshot.site) {
        leaves.message(RecordKind::TableRow, &row);
    }
    let of_grid = snapshot.grid.as_ref().map_or(Ok(0), of_grid)?;
    Ok(Digest(u64::from(leaves.root) << 32 | u64::from(of_grid)))
}

/// The CRC over the leaves so far.
#[derive(Default)]
struct Leaves {
    root: u32,
}

impl Leaves {
    fn message(&mut self, kind: RecordKind, message: &impl prost::Message) {
        self.record(kind, &message.encode_to_vec());
    }

    fn record(&mut self, kind: RecordKind, payload: &[u8]) {
        let mut leaf = [0; 16];
        leaf[..4].copy_from_slice(&(kind as i32).to_le_bytes());
        leaf[4..12].copy_from_slice(&(payload.len() as u64).to_le_bytes());
        leaf[12..].copy_from_slice(&crc32c::crc32c(payload).to_le_bytes());
        self.root = crc32c::crc32c_append(self.root, &leaf);
    }
}

fn of_grid(grid: &GridSnapshot) -> Result<u32, NoDigest> {
    let count = |count: usize| u32::try_from(count).map_err(|_| "a grid has more than can be numbered");
    let mut last_seen = Vec::new();
    tile_set::push_set(&mut last_seen, &[], &grid.last_seen)?;
    let mut leaves = Leaves::default();
    let head = layout::Grid {
        tiles: count(grid.tiles.len())?,
        scans: grid.scans,
        cell_observations: grid.cell_observations,
        last_seen,
        shown: spec::encode_shown(&grid.shown),
        // The observations that wait for a later update are left out.
        ..layout::Grid::default()
    };
    leaves.message(RecordKind::Grid, &head);
    for (index, live) in grid.tiles.iter().enumerate() {
        // `has_model` is left false: the record of the model shows that the tile has one, wherever the model is.
        leaves.message(RecordKind::Tile, &tile::encode(live, false)?);
        if let Some(model) = grid.models.get(index) {
            add_model(&mut leaves, &*model.get()?);
        }
        if let Some(sums) = grid.sums.get(index) {
            add_sums(&mut leaves, &*sums.get()?)?;
        }
    }
    Ok(leaves.root)
}

fn add_model(leaves: &mut Leaves, model: &TileModel) {
    let is_empty = model.groups.is_empty() && model.cells.is_empty() && model.always_occupied.is_empty();
    if !is_empty {
        leaves.message(RecordKind::TileModel, &tile_model::encode(model));
    }
}

/// The sums that a tile shares with others are leaves of each of them: which tiles share theirs in memory is not known
/// after a start as before it.
fn add_sums(leaves: &mut Leaves, sums: &TileSums) -> Result<(), NoDigest> {
    if sums.groups.is_empty() && sums.cells.is_empty() {
        return Ok(());
    }
    let mut bytes = Vec::new();
    for sum in sums.shared() {
        bytes.clear();
        doubles::push(&mut bytes, sum.as_slice());
        leaves.record(RecordKind::SharedSum, &bytes);
    }
    let numbers = vec![0; sums.shared().count()];
    tile_model::encode_sums(&numbers, sums, &mut bytes)?;
    leaves.record(RecordKind::TileSums, &bytes);
    Ok(())
}
