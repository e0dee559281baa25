//! Writing what a generation publishes to the index.
//!
//! Invariant: the mark is dirty and durable before the first row changes, and clean only after the last is durable.

use std::sync::Arc;

use prost::Message as _;
use tidemap_grid::tile::ModelSlot;
use tidemap_layout::index::{GENERATIONS, GridMark, Mark, encode_value, map_key, part_key};
use tidemap_map::snapshot::MapSnapshot;

use super::{
    KnownRows, Trees,
    rows::{self, IndexRow, Kind, Sum},
};
use crate::{
    failure::ReadFailure,
    record::{snapshot as record, spec, tables as record_tables},
};

/// Rows in one batch of sled; larger batches hold its lock for too long.
const BATCH_ROWS: usize = 32;
/// Bytes in one batch of sled.
const BATCH_BYTES: usize = 64 << 10;

/// Rows of one tree that are collected until there are enough.
#[derive(Default)]
pub(super) struct RowBatch {
    batch: sled::Batch,
    rows: usize,
    bytes: usize,
}

impl RowBatch {
    pub(super) fn insert(&mut self, tree: &sled::Tree, key: &[u8], value: Vec<u8>) -> Result<(), ReadFailure> {
        self.rows += 1;
        self.bytes += key.len() + value.len();
        self.batch.insert(key, value);
        self.apply_if_full(tree)
    }

    fn remove(&mut self, tree: &sled::Tree, key: &[u8]) -> Result<(), ReadFailure> {
        self.rows += 1;
        self.batch.remove(key);
        self.apply_if_full(tree)
    }

    fn apply_if_full(&mut self, tree: &sled::Tree) -> Result<(), ReadFailure> {
        if self.rows >= BATCH_ROWS || self.bytes >= BATCH_BYTES { self.apply(tree) } else { Ok(()) }
    }

    pub(super) fn apply(&mut self, tree: &sled::Tree) -> Result<(), ReadFailure> {
        let full = std::mem::take(self);
        if full.rows == 0 { Ok(()) } else { Ok(tree.apply_batch(full.batch)?) }
    }
}

fn set_mark(trees: &Trees, map: u32, mark: &Mark) -> Result<(), ReadFailure> {
    let key = map_key(map);
    let value = encode_value(GENERATIONS, &key, &mark.encode_to_vec());
    trees.generations.insert(key, value)?;
    trees.flush()
}

/// Removes all rows of a map except the mark.
fn clear(trees: &Trees, map: u32) -> Result<(), ReadFailure> {
    for kind in Kind::ALL {
        let tree = trees.of(kind);
        let mut collected = RowBatch::default();
        for key in tree.scan_prefix(map_key(map)).keys() {
            collected.remove(tree, &key?)?;
        }
        collected.apply(tree)?;
    }
    Ok(())
}

/// Writes the items of one tree.
struct Writer<'trees> {
    tree: &'trees sled::Tree,
    map: u32,
    collected: RowBatch,
    sums: Vec<Sum>,
}

impl Writer<'_> {
    /// Writes the rows of an item if they differ from those that are there.
    fn write(&mut self, item: u32, rows: Vec<IndexRow>) -> Result<(), ReadFailure> {
        let at = item as usize;
        if self.sums.len() <= at {
            self.sums.resize(at + 1, Sum::default());
        }
        let sum = Sum::of(&rows);
        let before = std::mem::replace(&mut self.sums[at], sum);
        if before == sum {
            return Ok(());
        }
        for row in rows {
            self.collected.insert(self.tree, &row.key, row.value)?;
        }
        for part in sum.records..before.records {
            // Parts are numbered in 16 bits.
            self.collected.remove(self.tree, &part_key(self.map, item, part as u16))?;
        }
        Ok(())
    }

    /// Removes the items from a number on.
    fn clear_from(&mut self, first: u32) -> Result<(), ReadFailure> {
        for item in first..u32::try_from(self.sums.len()).unwrap_or(u32::MAX) {
            self.write(item, Vec::new())?;
        }
        self.sums.truncate(first as usize);
        Ok(())
    }

    fn finish(mut self) -> Result<Vec<Sum>, ReadFailure> {
        self.collected.apply(self.tree)?;
        Ok(self.sums)
    }
}

/// Writes the rows that differ from `before`, or all rows if `before` is unknown.
pub(super) fn save(
    trees: &Trees,
    map: u32,
    snapshot: &MapSnapshot,
    before: Option<KnownRows>,
) -> Result<KnownRows, ReadFailure> {
    set_mark(trees, map, &Mark { dirty: true, ..Mark::default() })?;
    let grid = snapshot.grid.as_ref();
    // States, producers and tiles are only added; after any other change all rows are written again.
    let counts = [snapshot.states.len(), grid.map_or(0, |grid| grid.tiles.len()), snapshot.producers.len()];
    let fits = |known: &KnownRows| {
        let kinds = [Kind::States, Kind::Tiles, Kind::Producers];
        kinds.iter().zip(counts).all(|(&kind, count)| known.of(kind).len() <= count)
    };
    let mut before = match before.filter(fits) {
        Some(before) => before,
        None => {
            clear(trees, map)?;
            KnownRows::default()
        }
    };
    let mut writer =
        |kind: Kind| Writer { tree: trees.of(kind), map, collected: RowBatch::default(), sums: before.take(kind) };
    let mut states = writer(Kind::States);
    for (id, state) in (0..).zip(&snapshot.states) {
        states.write(id, rows::of_state(map, id, state))?;
    }
    let mut producers = writer(Kind::Producers);
    for (id, producer) in (0..).zip(&snapshot.producers) {
        producers.write(id, rows::of_producer(map, id, producer))?;
    }
    let mut tables = writer(Kind::Tables);
    let mut table_rows = 0;
    for row in record_tables::rows(&snapshot.site) {
        tables.write(table_rows, rows::of_table_row(map, table_rows, &row))?;
        table_rows += 1;
    }
    tables.clear_from(table_rows)?;
    let (mut tiles, mut cells) = (writer(Kind::Tiles), writer(Kind::Cells));
    let mut models = std::mem::take(&mut before.models);
    if let Some(grid) = grid {
        for (id, live) in (0..).zip(&grid.tiles) {
            tiles.write(id, rows::of_tile(map, id, live)?)?;
        }
        models.resize_with(grid.models.len(), Default::default);
        for ((id, slot), known) in (0..).zip(&grid.models).zip(&mut models) {
            let is_there = cells.sums.len() > id as usize;
            let model = match slot {
                ModelSlot::Resident(model) if std::ptr::eq(known.as_ptr(), Arc::as_ptr(model)) => continue,
                // The model has left memory after it was saved, here and in a checkpoint.
                ModelSlot::Cold(_) if is_there => continue,
                slot => slot.get().map_err(|error| ReadFailure::of_text(error.to_string()))?,
            };
            cells.write(id, rows::of_cells(map, id, &model))?;
            *known = Arc::downgrade(&model);
        }
    }
    before.put(Kind::States, states.finish()?);
    before.put(Kind::Producers, producers.finish()?);
    before.put(Kind::Tables, tables.finish()?);
    before.put(Kind::Tiles, tiles.finish()?);
    before.put(Kind::Cells, cells.finish()?);
    before.models = models;
    trees.flush()?;
    // There are at most as many tiles as 32 bits can number.
    let grid = grid.map(|grid| GridMark {
        tiles: grid.tiles.len() as u32,
        models: grid.models.len() as u32,
        scans: grid.scans,
        cell_observations: grid.cell_observations,
        shown: spec::encode_shown(&grid.shown),
    });
    let snapshot = Some(record::encode(snapshot));
    set_mark(trees, map, &Mark { dirty: false, snapshot, grid, totals: before.totals() })?;
    Ok(before)
}

/// Removes everything of a map.
pub(super) fn purge(trees: &Trees, map: u32) -> Result<(), ReadFailure> {
    set_mark(trees, map, &Mark { dirty: true, ..Mark::default() })?;
    clear(trees, map)?;
    trees.generations.remove(map_key(map))?;
    trees.flush()
}
