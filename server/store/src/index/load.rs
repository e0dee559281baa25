//! Reading a map's snapshot from the index.
//!
//! Invariant: each record is checked by itself, and all together by number and sum, before any is used.

use prost::Message;
use tidemap_map::spec::MapSpec;
use tidemap_migrations::{
    v1::index::{MARKS, MODELS, STATES, decode_value, item_key, map_key},
    v2::{
        FITS_CHUNK, HOURS_CHUNK, PROFILE_CHUNK,
        index::{Mark, SITE_ITEM},
        map as v2, site as v2_site,
    },
};

use super::{Damage, IndexContent, KnownRows, Trees, rows::Sum};
use crate::record::{site as record_site, snapshot as record};

fn payload<'value, M: Message + Default>(tree: &str, key: &[u8], value: &'value [u8]) -> Result<M, Damage> {
    let payload: &'value [u8] =
        decode_value(tree, key, value).ok_or_else(|| format!("a record in {tree} is damaged or in the wrong place"))?;
    M::decode(payload).map_err(|_| format!("a record in {tree} is not a message"))
}

/// The field of a state's message that the chunk with this key belongs to.
fn column<'state>(message: &'state mut v2::State, key: &[u8]) -> Result<&'state mut Vec<u8>, &'static str> {
    const STRAY: &str = "a record in models belongs to nothing";
    let chunk = key.last_chunk::<2>().map_or(0, |&chunk| u16::from_be_bytes(chunk));
    if chunk < HOURS_CHUNK {
        return Ok(&mut message.spectrum);
    }
    let known = message.alternatives.as_mut().ok_or(STRAY)?;
    if chunk < PROFILE_CHUNK {
        return Ok(&mut known.hours);
    }
    if chunk >= FITS_CHUNK {
        return Ok(&mut known.fits);
    }
    Ok(&mut known.calibrated.as_mut().ok_or(STRAY)?.profile)
}

pub(super) fn load(trees: &Trees, map: u32, spec: &MapSpec) -> Result<(IndexContent, Option<KnownRows>), Damage> {
    let text = |error: sled::Error| error.to_string();
    let prefix = map_key(map);
    let Some(value) = trees.marks.get(prefix).map_err(text)? else { return Ok((IndexContent::Nothing, None)) };
    let mark: Mark = payload(MARKS, &prefix, &value)?;
    let Some(header) = mark.snapshot.filter(|_| !mark.dirty) else { return Ok((IndexContent::Unfinished, None)) };

    let mut written = KnownRows::default();
    let mut producers = Vec::new();
    // The key of the mark is the prefix alone.
    for entry in trees.marks.range(item_key(map, 0)..=item_key(map, u32::MAX)) {
        let (key, value) = entry.map_err(text)?;
        let message: v2::Producer = payload(MARKS, &key, &value)?;
        producers.push(record::decode_producer(producers.len(), &message)?);
        let mut sum = Sum::default();
        sum.add_value(&value);
        written.producers.push(sum);
    }

    let mut states = Vec::new();
    let mut chunks = trees.models.scan_prefix(prefix).peekable();
    for entry in trees.states.scan_prefix(prefix) {
        let (key, value) = entry.map_err(text)?;
        let mut message: v2::State = payload(STATES, &key, &value)?;
        let mut sum = Sum::default();
        sum.add_value(&value);
        // The chunks of a state begin with its key and follow each other in both trees' order.
        let is_of_state = |entry: &sled::Result<(sled::IVec, sled::IVec)>| {
            entry.as_ref().map_or(true, |(chunk_key, _)| chunk_key.starts_with(&key))
        };
        while let Some(entry) = chunks.next_if(is_of_state) {
            let (key, value) = entry.map_err(text)?;
            let bytes = decode_value(MODELS, &key, &value).ok_or("a record in models is damaged")?;
            column(&mut message, &key)?.extend_from_slice(bytes);
            sum.add_value(&value);
        }
        states.push(record::decode_state(states.len(), &message, &spec.periodicities)?);
        written.states.push(sum);
    }

    let mut site = Vec::new();
    for entry in chunks {
        let (key, value) = entry.map_err(text)?;
        if !key.starts_with(&item_key(map, SITE_ITEM)) {
            return Err("a record in models belongs to nothing".to_owned());
        }
        site.extend_from_slice(decode_value(MODELS, &key, &value).ok_or("a record in models is damaged")?);
        written.site.add_value(&value);
    }

    if written.total() != (Sum { records: mark.records, fingerprint: mark.fingerprint_sum }) {
        return Err(format!("records of map number {map} are missing, stale or too many"));
    }
    let site = v2_site::Site::decode(&site[..]).map_err(|_| "the site is not a message")?;
    let site = record_site::decode(&site, states.len())?;
    let snapshot = record::decode(&header, producers, states, site)?;
    Ok((IndexContent::Snapshot(Box::new(snapshot)), Some(written)))
}
