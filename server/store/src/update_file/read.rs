//! Reading what an earlier run of an update has left.
//!
//! Invariant: the file is believed up to its last tile that is whole, with all before it; of each tile what was written
//! last. Where any of that cannot be understood, nothing of the file is.

use std::{collections::HashMap, path::Path, sync::Weak};

use tidemap_map::grid::{
    index::TileId,
    progress::{DoneTile, TileOutcome},
};
use tidemap_migrations::v2::{
    file::{RecordKind, UPDATE_MAGIC},
    update as v2,
};
use tidemap_model::{LocalDay, ORDER_MAX, Periodicities, PhasorSum};

use crate::{
    MapId,
    checkpoint::{CheckpointTiles, Places, TilePlace},
    disk::Disk,
    record::doubles,
    record_file::RecordReader,
};

/// What an earlier run has left.
pub(super) struct Found {
    pub(super) tiles: Vec<DoneTile>,
    /// The file's shared sums that these tiles have in memory, by number.
    pub(super) shared: Vec<Weak<PhasorSum>>,
    /// Length of what is believed of the file, and the checksum of its bytes.
    pub(super) length: u64,
    pub(super) crc: u32,
}

/// The tiles of the file of this update. Changes nothing.
pub(super) fn read(
    disk: &dyn Disk,
    path: &Path,
    map: MapId,
    periodicities: &Periodicities,
    update: &v2::Update,
) -> Result<Found, String> {
    let mut reader = RecordReader::open(disk, path, UPDATE_MAGIC, map.0)?;
    let mut buffer = Vec::new();
    let found: v2::Update = reader.long_message(RecordKind::Update, &mut buffer)?;
    if found != *update || reader.header.position != update.generation {
        return Err("it is of another update".to_owned());
    }
    let mut newest: HashMap<u32, (v2::DoneTile, TilePlace)> = HashMap::new();
    let mut shared = Vec::new();
    let (mut length, mut crc) = (reader.offset(), reader.crc_before());
    // What is torn off does not end in a whole tile.
    while let Ok(tile) = next_tile(&mut reader, &mut buffer) {
        shared.extend(tile.shared);
        newest.insert(tile.done.tile, (tile.done, tile.place));
        (length, crc) = (reader.offset(), reader.crc_before());
    }
    let (done, tiles): (Vec<v2::DoneTile>, Vec<TilePlace>) = newest.into_values().unzip();
    let file = disk.read_anywhere(path).map_err(|error| error.to_string())?;
    let places = Places { tiles, shared };
    let source = CheckpointTiles::new(file, path.to_owned(), periodicities.clone(), places, Vec::new());
    let tiles = (0..).map(TileId).zip(done).map(|(place, done)| decode(&source, place, &done));
    let tiles = tiles.collect::<Result<Vec<_>, String>>()?;
    Ok(Found { tiles, shared: source.into_shared(), length, crc })
}

/// Where a tile's records are.
struct TileRecords {
    /// Shared sums that are new with it.
    shared: Vec<u64>,
    place: TilePlace,
    done: v2::DoneTile,
}

/// The next tile that is whole.
fn next_tile(reader: &mut RecordReader, buffer: &mut Vec<u8>) -> Result<TileRecords, String> {
    let (mut shared, mut place) = (Vec::new(), TilePlace::default());
    loop {
        let (kind, offset, crc) = (reader.next_kind()?, reader.offset(), reader.crc_before());
        match kind {
            RecordKind::SharedSum => shared.push(offset),
            RecordKind::TileModel => place.model = offset,
            RecordKind::TileSums => place.sums = offset,
            RecordKind::DoneTile => {
                let done: v2::DoneTile = reader.long_message(kind, buffer)?;
                if done.crc_before != crc {
                    return Err("what is before a tile's end is not what was written".to_owned());
                }
                return Ok(TileRecords { shared, place, done });
            }
            _ => return Err("a record is of another kind than it should".to_owned()),
        }
        reader.long(kind, buffer)?;
    }
}

fn decode(source: &CheckpointTiles, place: TileId, done: &v2::DoneTile) -> Result<DoneTile, String> {
    let (model, sums) = (source.read_model(place)?, source.read_sums(place)?);
    if sums.groups.len() != model.groups.len() || sums.cells.len() != model.cells.len() {
        return Err("the sums of a tile differ in number from its groups and cells".to_owned());
    }
    if !doubles::are_finite(&done.squared_errors) {
        return Err("a sum of errors is not finite".to_owned());
    }
    let mut numbers = Vec::new();
    doubles::take(&done.squared_errors, &mut numbers);
    let errors: [f64; ORDER_MAX + 3] = numbers.try_into().map_err(|_| "the sums of errors are not 18")?;
    let mut squared_errors = [0.0; ORDER_MAX + 1];
    squared_errors.copy_from_slice(&errors[..=ORDER_MAX]);
    let outcome = TileOutcome {
        observations: done.observations,
        scored: done.scored,
        squared_errors,
        squared_error_in_force: errors[ORDER_MAX + 1],
        squared_error_chosen: errors[ORDER_MAX + 2],
    };
    Ok(DoneTile { tile: TileId(done.tile), through: LocalDay(done.through), model, sums, outcome })
}
