//! Names, kinds, producers and refusals, which occur in several kinds of records.
//!
//! Invariant: decoding gives the encoded value, and it has passed the constructors of the domain.

use tidemap_layout::map as layout;
use tidemap_map::{
    event::StateKind,
    ids::{NewProducer, RefusalReason},
    name::{ProducerKey, StateName},
};

use super::{Invalid, sensors};

/// Encodes refusals: the differences of the sequence numbers, and the reasons.
pub(super) fn encode_refused(refused: &[(u64, RefusalReason)]) -> Result<(Vec<u64>, Vec<u32>), Invalid> {
    let mut previous = 0;
    let mut sequences = Vec::with_capacity(refused.len());
    for &(sequence, _) in refused {
        sequences.push(sequence.checked_sub(previous).ok_or("refused sequence numbers do not ascend")?);
        previous = sequence;
    }
    Ok((sequences, refused.iter().map(|&(_, reason)| encode_reason(reason)).collect()))
}

/// Refused sequence numbers with their reasons.
pub(super) fn decode_refused(sequences: &[u64], reasons: &[u32]) -> Result<Vec<(u64, RefusalReason)>, Invalid> {
    if sequences.len() != reasons.len() {
        return Err("the refused sequence numbers differ in number from their reasons");
    }
    let mut sequence = 0_u64;
    let mut refused = Vec::with_capacity(sequences.len());
    for (&difference, &reason) in sequences.iter().zip(reasons) {
        sequence = sequence.checked_add(difference).ok_or("a refused sequence number is too large")?;
        refused.push((sequence, decode_reason(reason)?));
    }
    Ok(refused)
}

pub(super) fn encode_producer_key(key: &ProducerKey) -> layout::ProducerKey {
    layout::ProducerKey { producer: key.producer().to_owned(), label: key.label().to_owned() }
}

pub(super) fn decode_producer_key(key: &layout::ProducerKey) -> Result<ProducerKey, Invalid> {
    ProducerKey::new(&key.producer, &key.label).map_err(|_| "the name of a producer is not valid")
}

pub(super) fn encode_new_producer(new: &NewProducer) -> layout::NewProducer {
    let layout::ProducerKey { producer, label } = encode_producer_key(&new.key);
    layout::NewProducer {
        producer,
        label,
        sensor: sensors::encode(new.sensor),
        introduced_by: new.introduced_by.clone(),
    }
}

pub(super) fn decode_new_producer(new: &layout::NewProducer) -> Result<NewProducer, Invalid> {
    let layout::NewProducer { producer, label, sensor, introduced_by } = new;
    let key = layout::ProducerKey { producer: producer.clone(), label: label.clone() };
    Ok(NewProducer {
        key: decode_producer_key(&key)?,
        sensor: sensors::decode(sensor.as_ref())?,
        introduced_by: introduced_by.clone(),
    })
}

/// A stored name of a state; it may be an axis of a vector.
pub(super) fn decode_state_name(name: &str) -> Result<StateName, Invalid> {
    StateName::stored(name).map_err(|_| "the name of a state is not valid")
}

pub(super) fn encode_kind(kind: StateKind) -> u32 {
    match kind {
        StateKind::Probability => 0,
        StateKind::Continuous => 1,
        StateKind::Count => 2,
    }
}

pub(super) fn decode_kind(kind: u32) -> Result<StateKind, Invalid> {
    match kind {
        0 => Ok(StateKind::Probability),
        1 => Ok(StateKind::Continuous),
        2 => Ok(StateKind::Count),
        _ => Err("the kind of a state is unknown"),
    }
}

/// Kind of a state that is a label of a categorical state: a probability whose name contains the label.
const LABEL: u32 = 3;

/// The kind of a state of a snapshot.
pub(super) fn encode_state_kind(name: &StateName, kind: StateKind) -> u32 {
    if name.as_label().is_some() { LABEL } else { encode_kind(kind) }
}

/// Name and kind of a state of a snapshot.
pub(super) fn decode_state_kind(name: &str, kind: u32) -> Result<(StateName, StateKind), Invalid> {
    if kind != LABEL {
        return Ok((decode_state_name(name)?, decode_kind(kind)?));
    }
    let name = StateName::labelled(name).map_err(|_| "the name of a label is not valid")?;
    Ok((name, StateKind::Probability))
}

fn encode_reason(reason: RefusalReason) -> u32 {
    match reason {
        RefusalReason::Value => 1,
        RefusalReason::Time => 2,
        RefusalReason::StateName => 3,
        RefusalReason::StateIndex => 4,
        RefusalReason::StateLimit => 5,
        RefusalReason::StateKind => 6,
        RefusalReason::NoGrid => 7,
        RefusalReason::Scan => 8,
        RefusalReason::Empty => 9,
        RefusalReason::TileLimit => 10,
        RefusalReason::Frame => 11,
        RefusalReason::Edge => 12,
        RefusalReason::Landmark => 13,
    }
}

fn decode_reason(reason: u32) -> Result<RefusalReason, Invalid> {
    match reason {
        1 => Ok(RefusalReason::Value),
        2 => Ok(RefusalReason::Time),
        3 => Ok(RefusalReason::StateName),
        4 => Ok(RefusalReason::StateIndex),
        5 => Ok(RefusalReason::StateLimit),
        6 => Ok(RefusalReason::StateKind),
        7 => Ok(RefusalReason::NoGrid),
        8 => Ok(RefusalReason::Scan),
        9 => Ok(RefusalReason::Empty),
        10 => Ok(RefusalReason::TileLimit),
        11 => Ok(RefusalReason::Frame),
        12 => Ok(RefusalReason::Edge),
        13 => Ok(RefusalReason::Landmark),
        _ => Err("the reason of a refusal is unknown"),
    }
}
