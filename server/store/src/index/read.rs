//! Reading the index: whether the rows of a map are whole, and the data that they publish.
//!
//! Invariant: nothing is given out before the mark of its map was found clean; each row is checked by itself, and all
//! together by number and sum. The models of tiles are read one by one when they are needed, and checked then.

use std::{ops::Range, sync::Arc, thread};

use prost::Message as _;
use tidemap_grid::{
    index::TileId,
    snapshot::GridSnapshot,
    tile::{ColdTile, ModelSlot, SumsSlot, TileSource},
};
use tidemap_layout::{
    grid as layout_grid,
    index::{GENERATIONS, Mark, StateRow, decode_value, item_key, map_key},
    map as layout, site as layout_site,
};
use tidemap_map::{
    snapshot::{MapSnapshot, StateSnapshot},
    spec::MapSpec,
};

use tidemap_model::Periodicities;

use super::{
    KnownRows, Trees,
    cells::IndexedCells,
    rows::{self, ItemRows, Kind, Sum},
};
use crate::{
    failure::ReadFailure,
    record::{published, snapshot as record, spec, tables, tile},
};

/// States are decoded by this many threads at most.
const THREADS_MAX: usize = 4;
/// Fewer states are decoded by one thread.
const STATES_PER_THREAD: usize = 2_000;

/// The mark of a map.
pub(super) enum MarkState {
    /// There is no mark.
    Nothing,
    /// Rows are not completely written.
    Unfinished,
    /// The rows are whole if they agree with the mark; with its bytes.
    Clean(Box<Mark>, sled::IVec),
}

/// The mark of a map.
pub(super) fn mark(trees: &Trees, map: u32) -> Result<MarkState, ReadFailure> {
    let key = map_key(map);
    let Some(value) = trees.generations.get(key)? else {
        return Ok(MarkState::Nothing);
    };
    let payload = decode_value(GENERATIONS, &key, &value).ok_or("the mark of a map is damaged")?;
    let mark = Mark::decode(payload).map_err(|_| "the mark of a map is not a message")?;
    let is_clean = !mark.dirty && mark.snapshot.is_some() && mark.totals.len() == Kind::ALL.len();
    Ok(if is_clean { MarkState::Clean(Box::new(mark), value) } else { MarkState::Unfinished })
}

/// The maps that have a mark.
pub(super) fn marked(trees: &Trees) -> Result<Vec<u32>, ReadFailure> {
    let keys = trees.generations.iter().keys();
    // A key of another length is no map's; what is wrong with it is found where rows are checked.
    let maps = keys.filter_map(|key| key.map(|key| key.as_ref().try_into().ok().map(u32::from_be_bytes)).transpose());
    Ok(maps.collect::<sled::Result<_>>()?)
}

/// Maximum number of items of a kind.
fn limit(mark: &Mark, kind: Kind) -> u32 {
    let snapshot = mark.snapshot.unwrap_or_default();
    let grid = mark.grid.clone().unwrap_or_default();
    match kind {
        Kind::States => snapshot.states,
        Kind::Producers => snapshot.producers,
        Kind::Tiles => grid.tiles,
        Kind::Cells => grid.models,
        Kind::Tables => snapshot.table_rows,
    }
}

/// Reads all items of a kind, in order of their numbers, and compares them with the mark.
fn each(
    trees: &Trees,
    map: u32,
    mark: &Mark,
    kind: Kind,
    mut take: impl FnMut(ItemRows) -> Result<(), ReadFailure>,
) -> Result<Vec<Sum>, ReadFailure> {
    let limit = limit(mark, kind);
    let mut sums = Vec::new();
    for item in rows::items(kind, trees.of(kind).scan_prefix(map_key(map))) {
        let item = item?;
        if item.number >= limit {
            return Err(format!("there are more rows in {} than the mark of their map states", kind.name()).into());
        }
        sums.resize(item.number as usize, Sum::default());
        sums.push(item.sum);
        take(item)?;
    }
    compare(mark, map, kind, &sums)?;
    Ok(sums)
}

fn compare(mark: &Mark, map: u32, kind: Kind, sums: &[Sum]) -> Result<(), ReadFailure> {
    if mark.totals.get(kind as usize).copied().unwrap_or_default() == rows::total(sums) {
        return Ok(());
    }
    Err(format!("rows of map number {map} in {} are missing, stale or too many", kind.name()).into())
}

/// Reads all rows of a map and compares them with its mark, without keeping them.
pub(super) fn check(trees: &Trees, map: u32, mark: &Mark) -> Result<KnownRows, ReadFailure> {
    let mut known = KnownRows::default();
    for kind in Kind::ALL {
        known.put(kind, each(trees, map, mark, kind, |_| Ok(()))?);
    }
    Ok(known)
}

/// Reads the published data of a map from its rows; `None` where they are not whole. The models of a grid's tiles are
/// read when they are needed.
pub(super) fn read(trees: &Trees, map: u32, spec: &MapSpec) -> Result<Option<MapSnapshot>, ReadFailure> {
    let MarkState::Clean(mark, raw) = mark(trees, map)? else { return Ok(None) };
    let header = mark.snapshot.ok_or("a mark has no generation")?;
    let mut producers = Vec::new();
    each(trees, map, &mark, Kind::Producers, |item| {
        let message: layout::Producer = item.message(Kind::Producers)?;
        producers.push(record::decode_producer(producers.len(), &message)?);
        Ok(())
    })?;
    let states = read_states(trees, map, &mark, &spec.periodicities)?;
    let mut table_rows: Vec<layout_site::TableRow> = Vec::new();
    each(trees, map, &mark, Kind::Tables, |item| {
        table_rows.push(item.message(Kind::Tables)?);
        Ok(())
    })?;
    let site = tables::site(&table_rows, states.len())?;
    let mut snapshot = record::decode(&header, producers, states, site)?;
    if spec.grid.is_some() != mark.grid.is_some() {
        return Err("it has a grid where its map has none, or none where its map has one".into());
    }
    snapshot.grid = match &mark.grid {
        Some(_) => Some(read_grid(trees, map, spec, &mark, raw)?),
        None => None,
    };
    Ok(Some(snapshot))
}

/// Reads the states with several threads: each decodes a range of their numbers.
fn read_states(
    trees: &Trees,
    map: u32,
    mark: &Mark,
    periodicities: &Periodicities,
) -> Result<Vec<StateSnapshot>, ReadFailure> {
    let count = limit(mark, Kind::States);
    let threads = thread::available_parallelism().map_or(1, usize::from).min(THREADS_MAX);
    let threads = threads.min(count as usize / STATES_PER_THREAD + 1) as u32;
    let each = count.div_ceil(threads);
    let ranges = (0..threads).map(|thread| thread * each..count.min((thread + 1) * each));
    let parts = thread::scope(|scope| {
        let threads: Vec<_> =
            ranges.map(|range| scope.spawn(move || read_range(trees, map, range, periodicities))).collect();
        let joined = threads.into_iter().map(|thread| thread.join().map_err(|_| ReadFailure::from("sled panicked")));
        joined.map(|part| part.and_then(|part| part)).collect::<Result<Vec<_>, ReadFailure>>()
    })?;
    let (mut states, mut sums) = (Vec::with_capacity(count as usize), Vec::with_capacity(count as usize));
    for (of_range, sums_of_range) in parts {
        states.extend(of_range);
        sums.extend(sums_of_range);
    }
    // A row beyond the last number would be in no range.
    let beyond = trees.of(Kind::States).range(item_key(map, count)..=item_key(map, u32::MAX)).next();
    compare(mark, map, Kind::States, if beyond.is_some() { &[] } else { &sums })?;
    Ok(states)
}

fn read_range(
    trees: &Trees,
    map: u32,
    range: Range<u32>,
    periodicities: &Periodicities,
) -> Result<(Vec<StateSnapshot>, Vec<Sum>), ReadFailure> {
    super::panics::catch(|| {
        let mut states = Vec::with_capacity(range.len());
        let mut sums = Vec::with_capacity(range.len());
        let rows = trees.of(Kind::States).range(item_key(map, range.start)..item_key(map, range.end));
        for (number, item) in range.clone().zip(rows::items(Kind::States, rows)) {
            let item = item?;
            let row: StateRow = item.message(Kind::States)?;
            states.push(published::decode(number as usize, row, periodicities)?);
            sums.push(item.sum);
        }
        Ok((states, sums))
    })?
}

fn read_grid(
    trees: &Trees,
    map: u32,
    spec: &MapSpec,
    mark: &Mark,
    raw: sled::IVec,
) -> Result<GridSnapshot, ReadFailure> {
    let of_grid = mark.grid.clone().unwrap_or_default();
    let mut tiles = Vec::new();
    each(trees, map, mark, Kind::Tiles, |item| {
        let message: layout_grid::Tile = item.message(Kind::Tiles)?;
        tiles.push(Arc::new(tile::decode(&message)?));
        Ok(())
    })?;
    if tiles.len() != of_grid.tiles as usize {
        return Err("tiles are missing".into());
    }
    let cells: Arc<dyn TileSource> = Arc::new(IndexedCells::new(trees, map, spec.periodicities.clone(), raw));
    let cold = |tile| ModelSlot::Cold(ColdTile { source: Arc::clone(&cells), tile: TileId(tile) });
    let models: Vec<ModelSlot> = (0..of_grid.models).map(cold).collect();
    Ok(GridSnapshot {
        sums: vec![SumsSlot::default(); models.len()],
        tiles,
        models,
        last_seen: Arc::default(),
        days: Vec::new(),
        future: Vec::new(),
        scans: of_grid.scans,
        cell_observations: of_grid.cell_observations,
        shown: spec::decode_shown(of_grid.shown.as_ref())?,
        received_nanos: None,
    })
}
