//! The data of a state that readers need, as a message, and back: without the sums from which it is computed, and with
//! a short encoding of hours.
//!
//! Invariant: every number is read back bit by bit.

use tidemap_layout::index::StateRow;
use tidemap_map::snapshot::StateSnapshot;
use tidemap_model::{AlternativesParts, Periodicities};

use super::{
    fields,
    snapshot::{self, SpectrumIn},
    varint::{push_varint, take_varint},
};

/// The row of a state, without the data that readers do not need.
pub(crate) fn encode(id: u32, state: &StateSnapshot) -> StateRow {
    let published =
        StateSnapshot { name: state.name.clone(), model: std::sync::Arc::new(state.model.published()), ..*state };
    let mut known = published.model.alternatives().map(|known| known.to_parts());
    let mut hours = Vec::new();
    for number in known.as_mut().map(|known| std::mem::take(&mut known.hours).numbers()).unwrap_or_default() {
        // The last bytes of small numbers, and of halves of them, are 0.
        push_varint(&mut hours, number.to_bits().swap_bytes());
    }
    // The published state has no spectrum, so no spectrum can be unreadable.
    let message = snapshot::encode_state_with(id, &published, published.model.accumulator().to_parts(), known);
    StateRow { state: Some(message), hours }
}

/// Decodes the state of a row, which must have the number `id`.
pub(crate) fn decode(id: usize, row: StateRow, periodicities: &Periodicities) -> Result<StateSnapshot, String> {
    let mut message = row.state.ok_or("a row has no state")?;
    match &mut message.alternatives {
        Some(known) => {
            let mut bytes = &row.hours[..];
            let mut numbers = Vec::new();
            while !bytes.is_empty() {
                numbers.push(f64::from_bits(take_varint(&mut bytes)?.swap_bytes()));
            }
            fields::append_list(known, AlternativesParts::HOURS, &numbers);
        }
        None if row.hours.is_empty() => {}
        None => return Err("a row has hours of an untrained state".to_owned()),
    }
    snapshot::decode_state(id, &message, periodicities, SpectrumIn::Nowhere)
}
