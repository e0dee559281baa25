//! The published data of a generation, as rows of the index.
//!
//! Invariant: equal content gives equal rows, so an unchanged state or tile is not written again.

use prost::Message;
use tidemap_grid::{live_tile::LiveTile, tile::TileModel};
use tidemap_layout::{
    index::{
        CELLS, PART_LENGTH, PRODUCERS, STATES, TABLES, TILES, Total, decode_value, encode_value, fingerprint, part_key,
    },
    site::TableRow,
};
use tidemap_map::snapshot::{ProducerMark, StateSnapshot};

use crate::{
    failure::ReadFailure,
    record::{published, snapshot as record, tile, tile_model},
};

/// A tree of rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    States,
    Tiles,
    Cells,
    Tables,
    Producers,
}

impl Kind {
    /// All, in the order of a mark's totals.
    pub(super) const ALL: [Kind; 5] = [Kind::States, Kind::Tiles, Kind::Cells, Kind::Tables, Kind::Producers];

    /// The name of the tree.
    pub(super) fn name(self) -> &'static str {
        match self {
            Kind::States => STATES,
            Kind::Tiles => TILES,
            Kind::Cells => CELLS,
            Kind::Tables => TABLES,
            Kind::Producers => PRODUCERS,
        }
    }
}

/// One row.
pub(super) struct IndexRow {
    pub(super) key: [u8; 10],
    pub(super) value: Vec<u8>,
}

/// Number and bytes of rows, and the sum of their fingerprints, which does not depend on their order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Sum {
    pub(super) records: u32,
    pub(super) bytes: u32,
    pub(super) fingerprint: u64,
}

impl Sum {
    pub(super) fn add(&mut self, key: &[u8], value: &[u8]) {
        self.records += 1;
        self.bytes += (key.len() + value.len()) as u32;
        self.fingerprint = self.fingerprint.wrapping_add(fingerprint(value));
    }

    pub(super) fn of(rows: &[IndexRow]) -> Sum {
        let mut sum = Sum::default();
        rows.iter().for_each(|row| sum.add(&row.key, &row.value));
        sum
    }
}

/// The sum over some items.
pub(super) fn total(sums: &[Sum]) -> Total {
    let mut total = Total::default();
    for sum in sums {
        total.records += u64::from(sum.records);
        total.bytes += u64::from(sum.bytes);
        total.fingerprint_sum = total.fingerprint_sum.wrapping_add(sum.fingerprint);
    }
    total
}

/// The rows of a message: at least one.
fn parts(kind: Kind, map: u32, item: u32, message: &impl Message) -> Vec<IndexRow> {
    let bytes = message.encode_to_vec();
    let count = bytes.len().div_ceil(PART_LENGTH).max(1);
    let part = |part: usize| {
        let (from, to) = (part * PART_LENGTH, bytes.len().min((part + 1) * PART_LENGTH));
        // A message of 240 MB would have as many parts as there are numbers.
        let key = part_key(map, item, u16::try_from(part).unwrap_or(u16::MAX));
        IndexRow { key, value: encode_value(kind.name(), &key, &bytes[from..to]) }
    };
    (0..count).map(part).collect()
}

/// The rows of a state.
pub(super) fn of_state(map: u32, id: u32, state: &StateSnapshot) -> Vec<IndexRow> {
    parts(Kind::States, map, id, &published::encode(id, state))
}

/// The rows of a tile's known cells and last values.
pub(super) fn of_tile(map: u32, id: u32, live: &LiveTile) -> Result<Vec<IndexRow>, ReadFailure> {
    Ok(parts(Kind::Tiles, map, id, &tile::encode(live, false)?))
}

/// The rows of a tile's models; none for a tile that no update has seen.
pub(super) fn of_cells(map: u32, id: u32, model: &TileModel) -> Vec<IndexRow> {
    if *model == TileModel::default() {
        return Vec::new();
    }
    parts(Kind::Cells, map, id, &tile_model::encode(model))
}

/// The rows of a row of a site.
pub(super) fn of_table_row(map: u32, number: u32, row: &TableRow) -> Vec<IndexRow> {
    parts(Kind::Tables, map, number, row)
}

/// The rows of a producer.
pub(super) fn of_producer(map: u32, id: u32, producer: &ProducerMark) -> Vec<IndexRow> {
    parts(Kind::Producers, map, id, &record::encode_producer(id, producer))
}

/// The rows of one item, read in order.
pub(super) struct ItemRows {
    pub(super) number: u32,
    pub(super) bytes: Vec<u8>,
    pub(super) sum: Sum,
}

impl ItemRows {
    /// The message that the rows make up.
    pub(super) fn message<M: Message + Default>(&self, kind: Kind) -> Result<M, ReadFailure> {
        M::decode(&self.bytes[..])
            .map_err(|_| format!("row {} of {} is not a message", self.number, kind.name()).into())
    }
}

/// Groups the rows of a range of a tree by item. Each row is checked by itself.
pub(super) fn items(
    kind: Kind,
    rows: impl Iterator<Item = sled::Result<(sled::IVec, sled::IVec)>>,
) -> impl Iterator<Item = Result<ItemRows, ReadFailure>> {
    let mut rows = rows.peekable();
    std::iter::from_fn(move || {
        let mut item: Option<ItemRows> = None;
        loop {
            let next = rows.next_if(|row| match (row, &item) {
                (Ok((key, _)), Some(item)) => number(key).is_ok_and(|(number, _)| number == item.number),
                _ => item.is_none(),
            });
            let (key, value) = match next {
                None => return item.map(Ok),
                Some(Err(error)) => return Some(Err(error.into())),
                Some(Ok(row)) => row,
            };
            let of_row = number(&key).and_then(|(number, part)| {
                let payload = decode_value(kind.name(), &key, &value);
                let payload =
                    payload.ok_or_else(|| format!("a row in {} is damaged or in the wrong place", kind.name()))?;
                Ok((number, part, payload))
            });
            let (number, part, payload) = match of_row {
                Ok(row) => row,
                Err(damage) => return Some(Err(damage)),
            };
            let item = item.get_or_insert_with(|| ItemRows { number, bytes: Vec::new(), sum: Sum::default() });
            if item.sum.records != u32::from(part) {
                return Some(Err(format!("a part of row {number} of {} is missing", kind.name()).into()));
            }
            item.bytes.extend_from_slice(payload);
            item.sum.add(&key, &value);
        }
    })
}

/// The number of an item, and of its part.
fn number(key: &[u8]) -> Result<(u32, u16), ReadFailure> {
    let (rest, part) = key.split_last_chunk::<2>().ok_or("a key is too short")?;
    let (_, item) = rest.split_last_chunk::<4>().filter(|(map, _)| map.len() == 4).ok_or("a key has another length")?;
    Ok((u32::from_be_bytes(*item), u16::from_be_bytes(*part)))
}
