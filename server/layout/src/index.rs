//! The sled database in `index/`: the data that the newest generation of each map publishes, without the sums from
//! which this data is computed.
//!
//! | tree | key | value |
//! | --- | --- | --- |
//! | [`STATES`] | map u32, state u32, part u16 | part of a [`StateRow`] |
//! | [`TILES`] | map u32, tile u32, part u16 | part of a [`super::grid::Tile`]: cells known, and their last values |
//! | [`CELLS`] | map u32, tile u32, part u16 | part of a [`super::grid::TileModel`]: the models of a tile's cells |
//! | [`TABLES`] | map u32, row u32, part u16 | part of a [`super::site::TableRow`] |
//! | [`PRODUCERS`] | map u32, producer u32, part u16 | part of a [`super::map::Producer`] |
//! | [`GENERATIONS`] | map u32 | [`Mark`] |
//!
//! Numbers in keys are big-endian, so that they sort. A message is cut into parts of [`PART_LENGTH`] bytes, numbered
//! from 0. [`encode_value`] makes a value: a version byte, the CRC-32C of everything else, and the payload. The CRC
//! covers the name of the tree and the key as well, so that a value in the wrong place is detected.
//!
//! Invariant: written data is read back bit by bit, or refused. No value is longer than 4 KB, because sled keeps long
//! values in files that it never syncs.

use super::u32_at;

/// Name of the tree of states.
pub const STATES: &str = "published.states";
/// Name of the tree of tiles in the state after the newest scans before the cut.
pub const TILES: &str = "published.tiles";
/// Name of the tree of the models of tiles.
pub const CELLS: &str = "published.cells";
/// Name of the tree of the rows of sites.
pub const TABLES: &str = "published.tables";
/// Name of the tree of producers.
pub const PRODUCERS: &str = "published.producers";
/// Name of the tree of marks.
pub const GENERATIONS: &str = "published.generations";

/// Most bytes of a message in one value.
pub const PART_LENGTH: usize = 3840;
/// Version of a value.
pub const VALUE_VERSION: u8 = 1;

/// The data of one state that readers need.
#[derive(Clone, PartialEq, prost::Message)]
pub struct StateRow {
    /// The state without `spectrum`, and without `alternatives.hours`.
    #[prost(message, optional, tag = "1")]
    pub state: Option<super::map::State>,
    /// The 480 doubles of `alternatives.hours`, each as the varint of its bits in the reverse order of bytes, so that
    /// small numbers are short. Empty if there are no alternatives.
    #[prost(bytes = "vec", tag = "2")]
    pub hours: Vec<u8>,
}

/// The rows of one tree.
#[derive(Clone, Copy, PartialEq, Eq, prost::Message)]
pub struct Total {
    /// Number of rows.
    #[prost(uint64, tag = "1")]
    pub records: u64,
    /// Number of bytes of the keys and values of the rows.
    #[prost(uint64, tag = "2")]
    pub bytes: u64,
    /// Sum of [`fingerprint`] over the values of the rows.
    #[prost(fixed64, tag = "3")]
    pub fingerprint_sum: u64,
}

/// The published data of a grid in a generation, besides its tiles.
#[derive(Clone, PartialEq, prost::Message)]
pub struct GridMark {
    /// Number of tiles.
    #[prost(uint32, tag = "1")]
    pub tiles: u32,
    /// Number of tiles, from the first, that have a model.
    #[prost(uint32, tag = "2")]
    pub models: u32,
    /// Number of acknowledged scans.
    #[prost(uint64, tag = "3")]
    pub scans: u64,
    /// Number of observations of single cells in these scans.
    #[prost(uint64, tag = "4")]
    pub cell_observations: u64,
    /// The cells that the scans of the grid are pictures of; absent if no scan states them.
    #[prost(message, optional, tag = "5")]
    pub shown: Option<super::map::CellBox>,
}

/// The generation of a map that the rows make up.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Mark {
    /// Whether rows are being written; then they must not be used.
    #[prost(bool, tag = "1")]
    pub dirty: bool,
    /// The generation.
    #[prost(message, optional, tag = "2")]
    pub snapshot: Option<super::map::Snapshot>,
    /// The grid of the map, if it has one.
    #[prost(message, optional, tag = "3")]
    pub grid: Option<GridMark>,
    /// The rows of the trees of states, tiles, cells, tables and producers, in this order.
    #[prost(message, repeated, tag = "4")]
    pub totals: Vec<Total>,
}

/// Key of a map's mark, and the prefix of all its keys.
pub fn map_key(map: u32) -> [u8; 4] {
    map.to_be_bytes()
}

/// Prefix of the keys of a state, tile or producer.
pub fn item_key(map: u32, item: u32) -> [u8; 8] {
    ((u64::from(map) << 32) | u64::from(item)).to_be_bytes()
}

/// Key of a part of a state, tile or producer.
pub fn part_key(map: u32, item: u32, part: u16) -> [u8; 10] {
    let mut key = [0; 10];
    key[..8].copy_from_slice(&item_key(map, item));
    key[8..].copy_from_slice(&part.to_be_bytes());
    key
}

fn checksum(tree: &str, key: &[u8], version: u8, payload: &[u8]) -> u32 {
    let crc = crc32c::crc32c_append(crc32c::crc32c(tree.as_bytes()), key);
    crc32c::crc32c_append(crc32c::crc32c_append(crc, &[version]), payload)
}

/// The value of a payload.
pub fn encode_value(tree: &str, key: &[u8], payload: &[u8]) -> Vec<u8> {
    let mut value = Vec::with_capacity(payload.len() + 5);
    value.push(VALUE_VERSION);
    value.extend_from_slice(&checksum(tree, key, VALUE_VERSION, payload).to_le_bytes());
    value.extend_from_slice(payload);
    value
}

/// The payload of a value; `None` if the value is damaged or in the wrong place.
pub fn decode_value<'value>(tree: &str, key: &[u8], value: &'value [u8]) -> Option<&'value [u8]> {
    let (&version, rest) = value.split_first()?;
    let payload = rest.get(4..)?;
    let sound = version == VALUE_VERSION && u32_at(rest, 0) == checksum(tree, key, version, payload);
    sound.then_some(payload)
}

/// A number for a whole value, whose sum over all records does not depend on their order.
pub fn fingerprint(value: &[u8]) -> u64 {
    // The checksum inside the value covers tree, key and payload; it is spread over 64 bits (the finaliser of
    // SplitMix64), so that sums of different sets of records rarely agree.
    let mut mixed = (u64::from(u32_at(value, 1)) << 32 | value.len() as u64).wrapping_add(0x9E37_79B9_7F4A_7C15);
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    mixed ^ (mixed >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_come_back_only_whole_and_in_their_place() {
        let key = item_key(1, 2);
        let value = encode_value("one", &key, b"payload");
        assert_eq!(decode_value("one", &key, &value), Some(&b"payload"[..]));
        assert_eq!(decode_value("other", &key, &value), None);
        assert_eq!(decode_value("one", &item_key(1, 3), &value), None);
        assert_eq!(decode_value("one", &key, &[]), None);
        for bit in 0..value.len() * 8 {
            let mut bad = value.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(decode_value("one", &key, &bad), None, "bit {bit}");
        }
    }

    #[test]
    fn keys_sort_by_map_then_by_item() {
        assert!(item_key(1, u32::MAX) < item_key(2, 0));
        assert!(part_key(1, 1, u16::MAX) < part_key(1, 2, 0));
        assert!(map_key(1).as_slice() < item_key(1, 0).as_slice());
    }
}
