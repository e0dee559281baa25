//! The index: as in format 1, with the site of a map.
//!
//! | tree | key | value |
//! | --- | --- | --- |
//! | `models` | map u32, [`SITE_ITEM`] u32, chunk u16 | up to [`CHUNK_LENGTH`] bytes of a [`super::site::Site`] |
//! | `marks` | map u32 | [`Mark`] |
//!
//! [`CHUNK_LENGTH`]: crate::v1::index::CHUNK_LENGTH
//!
//! Invariant: a mark of format 1 has the same bytes as one of these without a site.

/// Replaces a state's number in the keys of a site's chunks.
pub const SITE_ITEM: u32 = u32::MAX;

/// How far the index of a map goes.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Mark {
    /// While it is set, records are being written and must not be used.
    #[prost(bool, tag = "1")]
    pub dirty: bool,
    /// The snapshot that the records make up.
    #[prost(message, optional, tag = "2")]
    pub snapshot: Option<super::map::Snapshot>,
    /// Number of records of the map, except the mark.
    #[prost(uint64, tag = "3")]
    pub records: u64,
    /// Sum of [`crate::v1::index::fingerprint`] over all records of the map, except the mark.
    #[prost(fixed64, tag = "4")]
    pub fingerprint_sum: u64,
}

#[cfg(test)]
mod tests {
    use prost::Message as _;

    use super::*;
    use crate::tests::format_1;

    #[test]
    fn a_mark_of_format_1_is_the_same() {
        let old = format_1::Mark {
            dirty: true,
            snapshot: Some(format_1::Snapshot { position: 9, ..Default::default() }),
            records: 3,
            fingerprint_sum: u64::MAX,
        };
        let new = Mark::decode(&old.encode_to_vec()[..]).expect("a message");
        assert_eq!(new.encode_to_vec(), old.encode_to_vec());
    }
}
