//! Writing a history file.
//!
//! Invariant: the keys of the table ascend, and every observation belongs to one of them.

use std::path::Path;

use tidemap_grid::index::TileId;
use tidemap_layout::{
    file::{FileHeader, HISTORY_MAGIC, RecordKind, Trailer},
    grid as layout,
    history::{ENTRIES_MAX, ENTRY_LENGTH, End, Entry},
};
use tidemap_map::history::{HistoryDay, HistoryPiece, origins::Origins};

use super::Part;
use crate::{
    MapId,
    disk::Disk,
    error::{StoreError, store_io},
    record::{
        Invalid, day,
        history::{SAMPLES_MAX, encode_models, encode_samples},
    },
    record_file::RecordWriter,
};

const NO_ORIGINS: Invalid = "it does not name the producer of a state";

enum WriteError {
    Io(std::io::Error),
    Invalid(Invalid),
}

impl From<std::io::Error> for WriteError {
    fn from(error: std::io::Error) -> WriteError {
        WriteError::Io(error)
    }
}

impl From<Invalid> for WriteError {
    fn from(reason: Invalid) -> WriteError {
        WriteError::Invalid(reason)
    }
}

/// Key of a day; the tiles of it follow.
pub(super) fn day_key(day: u64) -> u64 {
    day << 32
}

/// Key of a tile of a day.
pub(super) fn tile_key(day: u64, tile: u32) -> u64 {
    (day << 32) + 1 + u64::from(tile)
}

/// Writes one part; the file is durable when this returns, its name is not.
pub(super) fn write(
    disk: &dyn Disk,
    path: &Path,
    map: MapId,
    piece: &HistoryPiece,
    part: Part,
) -> Result<Trailer, StoreError> {
    let write = || -> Result<Trailer, WriteError> {
        let header = FileHeader { magic: HISTORY_MAGIC, map: map.0, position: piece.generation };
        let mut out = Out { writer: RecordWriter::create(disk, path, &header)?, entries: Vec::new() };
        let (from_nanos, to_nanos) = bounds(piece, part);
        let days = match part {
            Part::States => {
                out.states(piece)?;
                0
            }
            Part::Grid => {
                for (number, day) in (0..).zip(&piece.days) {
                    out.day(number, day)?;
                }
                piece.days.len() as u64
            }
        };
        Ok(out.finish(|table, entries| End { table, entries, from_nanos, to_nanos, days })?)
    };
    write().map_err(|error| match error {
        WriteError::Io(error) => store_io(path)(error),
        WriteError::Invalid(reason) => StoreError::InvalidSnapshot { map, reason: format!("its history: {reason}") },
    })
}

/// The smallest and the greatest time of a part.
fn bounds(piece: &HistoryPiece, part: Part) -> (i64, i64) {
    let states = piece.states.iter().flat_map(|(_, samples)| samples).map(|sample| sample.utc_nanos);
    let scans = piece.days.iter().flat_map(|day| &day.outliers.scans).map(|scan| scan.utc_nanos);
    let bounds = |times: &mut dyn Iterator<Item = i64>| {
        times.fold((i64::MAX, i64::MIN), |(from, to), nanos| (from.min(nanos), to.max(nanos)))
    };
    match part {
        Part::States => bounds(&mut { states }),
        Part::Grid => bounds(&mut { scans }),
    }
}

struct Out {
    writer: RecordWriter,
    entries: Vec<Entry>,
}

impl Out {
    /// The next record of the file has this key.
    fn begin(&mut self, key: u64) -> Result<(), Invalid> {
        if self.entries.last().is_some_and(|before| before.key >= key) {
            return Err("states, days or tiles do not ascend");
        }
        self.entries.push(Entry { key, offset: self.writer.offset(), records: 0 });
        Ok(())
    }

    fn put(&mut self, kind: RecordKind, message: &impl prost::Message) -> Result<(), WriteError> {
        self.writer.long(kind, &message.encode_to_vec())?;
        if let Some(entry) = self.entries.last_mut() {
            entry.records += 1;
        }
        Ok(())
    }

    fn states(&mut self, piece: &HistoryPiece) -> Result<(), WriteError> {
        let mut states: Vec<_> = piece.states.iter().enumerate().collect();
        states.sort_by_key(|(_, (id, _))| *id);
        for (at, (id, samples)) in states {
            let origins = piece.origins.get(at).ok_or(NO_ORIGINS)?;
            self.begin(u64::from(id.0))?;
            for (number, chunk) in samples.chunks(SAMPLES_MAX).enumerate() {
                let part = |all: &Origins| match samples.len() == chunk.len() {
                    true => all.clone(),
                    false => all.part(number * SAMPLES_MAX, chunk.len()),
                };
                let message = encode_samples(*id, chunk, &part(origins))?;
                self.put(RecordKind::StateSamples, &message)?;
            }
        }
        Ok(())
    }

    fn day(&mut self, number: u64, day: &HistoryDay) -> Result<(), WriteError> {
        let scans = &day.outliers;
        let models = |tile: u32| {
            let at = day.models.binary_search_by_key(&tile, |(tile, _)| tile.0).ok();
            at.and_then(|at| day.models.get(at)).map(|(_, models)| &models[..])
        };
        let mut tiles: Vec<u32> = scans.tiles().map(|(tile, _)| tile.0).collect();
        tiles.extend(day.models.iter().map(|(tile, _)| tile.0));
        tiles.sort_unstable();
        tiles.dedup();
        self.begin(day_key(number))?;
        self.put(RecordKind::Day, &day::encode(scans, tiles.len())?)?;
        for tile in tiles {
            self.begin(tile_key(number, tile))?;
            let of_day = scans.tile(TileId(tile));
            let message = layout::DayTile {
                tile,
                scans: of_day.map(day::encode_tile).transpose()?,
                models: encode_models(models(tile).unwrap_or_default())?,
            };
            self.put(RecordKind::DayTile, &message)?;
        }
        Ok(())
    }

    fn finish(mut self, end: impl Fn(u64, u64) -> End) -> std::io::Result<Trailer> {
        let table = self.writer.offset();
        for entries in self.entries.chunks(ENTRIES_MAX) {
            let mut bytes = Vec::with_capacity(entries.len() * ENTRY_LENGTH);
            bytes.extend(entries.iter().flat_map(Entry::encode));
            self.writer.raw(RecordKind::Table, &[], &bytes)?;
        }
        let end = end(table, self.entries.len() as u64);
        self.writer.raw(RecordKind::End, &[], &end.encode())?;
        self.writer.finish()
    }
}
