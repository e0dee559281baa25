//! The records of a snapshot as keys and values of the index.
//!
//! Invariant: equal states give equal records, so an unchanged state is not written again.

use prost::Message as _;
use tidemap_map::{
    site::Site,
    snapshot::{ProducerMark, StateSnapshot},
};
use tidemap_migrations::{
    v1::index::{CHUNK_LENGTH, MARKS, MODELS, STATES, chunk_key, encode_value, fingerprint, item_key},
    v2::{FITS_CHUNK, HOURS_CHUNK, PROFILE_CHUNK, index::SITE_ITEM},
};

use crate::record::{site as record_site, snapshot as record};

/// The tree of a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Tree {
    States,
    Models,
    Marks,
}

/// One record.
pub(super) struct IndexRow {
    pub(super) tree: Tree,
    pub(super) key: Vec<u8>,
    pub(super) value: Vec<u8>,
}

/// Number of records and the sum of their fingerprints, which does not depend on their order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Sum {
    pub(super) records: u64,
    pub(super) fingerprint: u64,
}

impl Sum {
    pub(super) fn add_value(&mut self, value: &[u8]) {
        self.add(Sum { records: 1, fingerprint: fingerprint(value) });
    }

    pub(super) fn add(&mut self, other: Sum) {
        self.records += other.records;
        self.fingerprint = self.fingerprint.wrapping_add(other.fingerprint);
    }
}

/// The sum over some rows.
pub(super) fn sum(rows: &[IndexRow]) -> Sum {
    let mut sum = Sum::default();
    for row in rows {
        sum.add_value(&row.value);
    }
    sum
}

/// The records of a state: one for the state, then its spectrum, hours, calibrated profile and other fits in chunks.
pub(super) fn of_state(map: u32, id: u32, state: &StateSnapshot) -> Vec<IndexRow> {
    let mut message = record::encode_state(id, state);
    let spectrum = std::mem::take(&mut message.spectrum);
    let mut known = message.alternatives.as_mut();
    let hours = known.as_mut().map(|known| std::mem::take(&mut known.hours)).unwrap_or_default();
    let fits = known.as_mut().map(|known| std::mem::take(&mut known.fits)).unwrap_or_default();
    let calibrated = known.and_then(|known| known.calibrated.as_mut());
    let profile = calibrated.map(|fit| std::mem::take(&mut fit.profile)).unwrap_or_default();
    let key = item_key(map, id).to_vec();
    let value = encode_value(STATES, &key, &message.encode_to_vec());
    let chunks = [(0, &spectrum), (HOURS_CHUNK, &hours), (PROFILE_CHUNK, &profile), (FITS_CHUNK, &fits)];
    let chunks = chunks.into_iter().flat_map(|(first, bytes)| (first..).zip(bytes.chunks(CHUNK_LENGTH)));
    let chunks = chunks.map(|(chunk, bytes)| {
        let key = chunk_key(map, id, chunk).to_vec();
        IndexRow { tree: Tree::Models, value: encode_value(MODELS, &key, bytes), key }
    });
    std::iter::once(IndexRow { tree: Tree::States, key, value }).chain(chunks).collect()
}

/// The records of a site; none for an empty site.
pub(super) fn of_site(map: u32, site: &Site) -> Vec<IndexRow> {
    let bytes = record_site::encode(site).map(|message| message.encode_to_vec()).unwrap_or_default();
    let chunk = |(chunk, bytes): (u16, &[u8])| {
        let key = chunk_key(map, SITE_ITEM, chunk).to_vec();
        IndexRow { tree: Tree::Models, value: encode_value(MODELS, &key, bytes), key }
    };
    (0..).zip(bytes.chunks(CHUNK_LENGTH)).map(chunk).collect()
}

/// The record of a producer.
pub(super) fn of_producer(map: u32, id: u32, producer: &ProducerMark) -> Vec<IndexRow> {
    let key = item_key(map, id).to_vec();
    let value = encode_value(MARKS, &key, &record::encode_producer(id, producer).encode_to_vec());
    vec![IndexRow { tree: Tree::Marks, key, value }]
}
