//! The days of a grid's history, one by one.
//!
//! Invariant: one day is in memory at a time, with only the requested tiles.

use std::vec::IntoIter;

use tidemap_grid::{index::TileId, scan::CellRef};
use tidemap_layout::{file::RecordKind, grid as layout, history::Entry};
use tidemap_map::history::HistoryDay;

use super::{
    History, Part,
    file::HistoryFile,
    table::Table,
    write::{day_key, tile_key},
};
use crate::{
    error::HistoryError,
    record::{day, history::decode_models},
    record_file::anywhere,
};

/// Days of a grid's history; made by [`History::grid_days`].
#[derive(Debug)]
pub struct GridDays {
    history: History,
    from_nanos: i64,
    to_nanos: i64,
    /// Ascending.
    tiles: Option<Vec<TileId>>,
    /// Generations still to read; `None` before the first.
    generations: Option<IntoIter<u64>>,
    /// The generation that is being read, and its next day.
    current: Option<(u64, u64)>,
    has_failed: bool,
}

impl GridDays {
    pub(super) fn new(history: History, from_nanos: i64, to_nanos: i64, mut tiles: Option<Vec<TileId>>) -> GridDays {
        if let Some(tiles) = &mut tiles {
            tiles.sort_unstable();
            tiles.dedup();
        }
        GridDays { history, from_nanos, to_nanos, tiles, generations: None, current: None, has_failed: false }
    }

    fn next_day(&mut self) -> Result<Option<HistoryDay>, HistoryError> {
        loop {
            let (generation, day) = match self.current {
                Some(current) => current,
                None => match self.next_generation()? {
                    Some(generation) => (generation, 0),
                    None => return Ok(None),
                },
            };
            self.current = None;
            // Opened again for each day: a file has few days, and no file stays open between two calls.
            let Some(file) = self.history.open_if_there(generation, Part::Grid, self.from_nanos, self.to_nanos)? else {
                continue;
            };
            if !file.overlaps(self.from_nanos, self.to_nanos) || day >= file.end.days {
                continue;
            }
            self.current = Some((generation, day + 1));
            if let Some(day) = self.read(&file, day)? {
                return Ok(Some(day));
            }
        }
    }

    fn next_generation(&mut self) -> Result<Option<u64>, HistoryError> {
        if self.generations.is_none() {
            let history = &self.history;
            self.generations = Some(history.generations(Part::Grid)?.into_iter());
        }
        Ok(self.generations.as_mut().and_then(Iterator::next))
    }

    /// A day of a file, if it has scans in the range.
    fn read(&self, file: &HistoryFile, number: u64) -> Result<Option<HistoryDay>, HistoryError> {
        let damaged = |reason: &str| file.damaged(reason);
        let mut table = Table::new(file);
        let entry = table.find(day_key(number))?.ok_or_else(|| damaged("a day is missing in its table"))?;
        let head = anywhere::message::<layout::Day>(&*file.file, RecordKind::Day, entry.offset);
        let (head, _) = head.map_err(|failure| file.unread(failure))?;
        let keep = |tile| self.tiles.as_ref().is_none_or(|tiles| tiles.binary_search(&tile).is_ok());
        let mut scans = day::decode(&head, CellRef::TILES_MAX, keep).map_err(damaged)?;
        let range = self.from_nanos..self.to_nanos;
        if !scans.scans.iter().any(|scan| range.contains(&scan.utc_nanos)) {
            return Ok(None);
        }
        let mut models = Vec::new();
        let mut take = |entry: Entry| {
            let read = anywhere::message::<layout::DayTile>(&*file.file, RecordKind::DayTile, entry.offset);
            let (message, _) = read.map_err(|failure| file.unread(failure))?;
            if entry.key != tile_key(number, message.tile) {
                return Err(damaged("its table names another tile than its records"));
            }
            if let Some(shown) = &message.scans {
                let shown = day::decode_tile(shown, head.scans).map_err(damaged)?;
                if message.tile >= head.tiles_end {
                    return Err(damaged("a tile is not known"));
                }
                scans.put(TileId(message.tile), shown);
            }
            let of_tile = decode_models(&message.models).map_err(damaged)?;
            if !of_tile.is_empty() {
                models.push((TileId(message.tile), of_tile));
            }
            Ok(())
        };
        match &self.tiles {
            Some(tiles) => {
                for tile in tiles {
                    if let Some(entry) = table.find(tile_key(number, tile.0))? {
                        take(entry)?;
                    }
                }
            }
            None => table.each(tile_key(number, 0), day_key(number + 1), take)?,
        }
        Ok(Some(HistoryDay { outliers: scans, models }))
    }
}

impl Iterator for GridDays {
    type Item = Result<HistoryDay, HistoryError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.has_failed {
            return None;
        }
        let next = self.next_day();
        self.has_failed = next.is_err();
        next.transpose()
    }
}
