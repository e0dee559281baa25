//! Writing a map's snapshot to the index.
//!
//! Invariant: the mark is dirty and durable before the first record changes, and clean only after the last is durable.

use prost::Message as _;
use tidemap_map::snapshot::MapSnapshot;
use tidemap_migrations::{
    v1::index::{MARKS, chunk_key, encode_value, map_key},
    v2::{HOURS_CHUNK, index::Mark},
};

use super::{
    Damage, KnownRows, Trees,
    rows::{self, IndexRow, Sum, Tree},
};
use crate::record::snapshot as record;

/// Records in one batch of sled; larger batches hold its lock for too long.
const BATCH_RECORDS: usize = 32;
/// Bytes in one batch of sled.
const BATCH_BYTES: usize = 64 << 10;

/// Rows that are collected for the trees.
#[derive(Default)]
struct Batches {
    states: sled::Batch,
    models: sled::Batch,
    marks: sled::Batch,
    records: usize,
    bytes: usize,
}

impl Batches {
    fn push(&mut self, trees: &Trees, row: IndexRow) -> Result<(), Damage> {
        self.records += 1;
        self.bytes += row.key.len() + row.value.len();
        let batch = match row.tree {
            Tree::States => &mut self.states,
            Tree::Models => &mut self.models,
            Tree::Marks => &mut self.marks,
        };
        batch.insert(row.key, row.value);
        if self.records >= BATCH_RECORDS || self.bytes >= BATCH_BYTES { self.apply(trees) } else { Ok(()) }
    }

    fn apply(&mut self, trees: &Trees) -> Result<(), Damage> {
        let full = std::mem::take(self);
        trees.states.apply_batch(full.states).map_err(|error| error.to_string())?;
        trees.models.apply_batch(full.models).map_err(|error| error.to_string())?;
        trees.marks.apply_batch(full.marks).map_err(|error| error.to_string())
    }
}

impl KnownRows {
    /// The sum over everything.
    pub(super) fn total(&self) -> Sum {
        let mut total = Sum::default();
        for &sum in self.states.iter().chain(&self.producers).chain([&self.site]) {
            total.add(sum);
        }
        total
    }
}

fn set_mark(trees: &Trees, map: u32, mark: &Mark) -> Result<(), Damage> {
    let key = map_key(map);
    trees.marks.insert(key, encode_value(MARKS, &key, &mark.encode_to_vec())).map_err(|error| error.to_string())?;
    trees.flush()
}

/// Removes all records of a map except the mark.
fn clear(trees: &Trees, map: u32) -> Result<(), Damage> {
    let prefix = map_key(map);
    for tree in [&trees.states, &trees.models, &trees.marks] {
        let mut batch = sled::Batch::default();
        let mut records = 0;
        for key in tree.scan_prefix(prefix).keys() {
            let key = key.map_err(|error| error.to_string())?;
            if key.len() == prefix.len() {
                continue;
            }
            batch.remove(key);
            records += 1;
            if records == BATCH_RECORDS {
                tree.apply_batch(std::mem::take(&mut batch)).map_err(|error| error.to_string())?;
                records = 0;
            }
        }
        tree.apply_batch(batch).map_err(|error| error.to_string())?;
    }
    Ok(())
}

/// Writes the records that differ from `before`, or all records if `before` is unknown.
pub(super) fn save(
    trees: &Trees,
    map: u32,
    snapshot: &MapSnapshot,
    before: Option<KnownRows>,
) -> Result<KnownRows, Damage> {
    set_mark(trees, map, &Mark { dirty: true, ..Mark::default() })?;
    let site = rows::of_site(map, &snapshot.site);
    // States and producers are only added; after any other change all records are written again.
    let before = before.filter(|before| {
        before.states.len() <= snapshot.states.len()
            && before.producers.len() <= snapshot.producers.len()
            && before.site.records <= site.len() as u64
    });
    let mut before = match before {
        Some(before) => before,
        None => {
            clear(trees, map)?;
            KnownRows::default()
        }
    };
    let mut batches = Batches::default();
    for (id, state) in (0..).zip(&snapshot.states) {
        let rows = rows::of_state(map, id, state);
        let keys: Vec<Vec<u8>> = rows.iter().map(|row| row.key.clone()).collect();
        if write_changed(trees, &mut batches, &mut before.states, id, rows)? {
            remove_others(trees, &keys, map, id)?;
        }
    }
    for (id, producer) in (0..).zip(&snapshot.producers) {
        let rows = rows::of_producer(map, id, producer);
        write_changed(trees, &mut batches, &mut before.producers, id, rows)?;
    }
    let sum = rows::sum(&site);
    if sum != before.site {
        before.site = sum;
        for row in site {
            batches.push(trees, row)?;
        }
    }
    batches.apply(trees)?;
    trees.flush()?;
    let total = before.total();
    let mark = Mark {
        dirty: false,
        snapshot: Some(record::encode(snapshot)),
        records: total.records,
        fingerprint_sum: total.fingerprint,
    };
    set_mark(trees, map, &mark)?;
    Ok(before)
}

/// Removes the chunks of a state's models that are not among `keys`. The chunks of a spectrum are never removed.
fn remove_others(trees: &Trees, keys: &[Vec<u8>], map: u32, state: u32) -> Result<(), Damage> {
    let text = |error: sled::Error| error.to_string();
    for key in trees.models.range(chunk_key(map, state, HOURS_CHUNK)..=chunk_key(map, state, u16::MAX)).keys() {
        let key = key.map_err(text)?;
        if !keys.iter().any(|kept| kept[..] == key[..]) {
            trees.models.remove(key).map_err(text)?;
        }
    }
    Ok(())
}

/// Writes the rows of one item if their sum has changed. Returns whether the item existed before with another sum.
fn write_changed(
    trees: &Trees,
    batches: &mut Batches,
    sums: &mut Vec<Sum>,
    id: u32,
    rows: Vec<IndexRow>,
) -> Result<bool, Damage> {
    let sum = rows::sum(&rows);
    let was_there = match sums.get_mut(id as usize) {
        Some(before) if *before == sum => return Ok(false),
        Some(before) => {
            *before = sum;
            true
        }
        None => {
            sums.push(sum);
            false
        }
    };
    for row in rows {
        batches.push(trees, row)?;
    }
    Ok(was_there)
}

/// Removes everything of a map.
pub(super) fn purge(trees: &Trees, map: u32) -> Result<(), Damage> {
    set_mark(trees, map, &Mark { dirty: true, ..Mark::default() })?;
    clear(trees, map)?;
    trees.marks.remove(map_key(map)).map_err(|error| error.to_string())?;
    trees.flush()
}
