//! Keys and values of the sled database in `index/`. Its rows are those of [`crate::v2::published`].
//!
//! Numbers in keys are big-endian, so that they sort. A value is a version byte, the CRC-32C of everything else, and
//! the payload; the CRC covers the tree's name and the key as well, so a value in the wrong place is detected.
//!
//! Invariant: what is written here is read back bit by bit, or refused.

use super::u32_at;

/// The trees of earlier builds, which held whole snapshots.
pub const OLD_TREES: [&str; 3] = ["states", "models", "marks"];
/// Version of a value.
pub const VALUE_VERSION: u8 = 1;

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

/// The payload of a value, where it is whole and in its place.
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
