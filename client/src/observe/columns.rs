//! Packing observations into columns.
//!
//! Invariant: what is unpacked is what was packed, bit for bit; a packed message never exceeds the limits it was given.

use tidemap_model::Position;
use tidemap_proto::{
    convert::columns::encode,
    v1::{ObservationColumns, StateKind},
};

/// One observation, its state as an index into the sender's own table of names.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Entry {
    /// Index into the sender's table.
    pub state: u32,
    /// Nanoseconds UTC, at least 0.
    pub time_nanos: i64,
    /// The value; of a position 0.
    pub value: f64,
    /// The position, of a state that is a vector. All entries with one index have as many coordinates, or none.
    pub position: Option<Position>,
}

impl Entry {
    fn coordinates(&self) -> &[f64] {
        self.position.as_ref().map_or(&[], Position::coordinates)
    }
}

/// Upper bounds of what one message may hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BatchLimits {
    /// Observations; a position counts as many as it has coordinates.
    pub observations: usize,
    /// Bytes of the encoded message.
    pub bytes: usize,
}

impl BatchLimits {
    /// Most traversals; each counts as two observations, and one always fits.
    #[must_use]
    pub fn traversals(self) -> usize {
        (self.observations / 2).max(1)
    }
}

/// Most bytes that an observation takes: a delta of 10, an index of 5, a value of 8.
const ENTRY_BYTES_MAX: usize = 23;
/// Bytes that a name takes beside itself, its kind and number of coordinates included, at most.
const NAME_BYTES_EXTRA: usize = 6;
/// Bytes of everything else in a message, at most.
const MESSAGE_BYTES_EXTRA: usize = 128;

/// Which of the sender's states one stream knows already, and under which index.
#[derive(Clone, Debug, Default)]
pub struct StreamTable {
    /// Stream index + 1 by the sender's index; 0 where the stream does not know the state.
    known: Vec<u32>,
    count: u32,
}

impl StreamTable {
    fn knows(&self, state: u32) -> bool {
        self.known.get(state as usize).is_some_and(|&index| index != 0)
    }

    /// The stream's index of a state, and whether it is new.
    fn index(&mut self, state: u32) -> (u32, bool) {
        let slot = state as usize;
        if self.known.len() <= slot {
            self.known.resize(slot + 1, 0);
        }
        if self.known[slot] != 0 {
            return (self.known[slot] - 1, false);
        }
        self.count += 1;
        self.known[slot] = self.count;
        (self.count - 1, true)
    }
}

/// How many of `entries` fit into one message, at least 1 where there is one.
#[must_use]
pub fn fitting<'a>(
    entries: impl Iterator<Item = &'a Entry>,
    names: &[Box<str>],
    table: &StreamTable,
    limits: BatchLimits,
) -> usize {
    let mut bytes = MESSAGE_BYTES_EXTRA;
    let mut count = 0;
    let mut observations = 0;
    for entry in entries.take(limits.observations.max(1)) {
        let coordinates = entry.coordinates().len();
        bytes += ENTRY_BYTES_MAX + size_of_val(entry.coordinates());
        observations += coordinates.max(1);
        // A state that is new and appears twice in the message is counted twice: an upper bound is enough.
        if !table.knows(entry.state) {
            bytes += names.get(entry.state as usize).map_or(0, |name| name.len()) + NAME_BYTES_EXTRA;
        }
        if count > 0 && (bytes > limits.bytes || observations > limits.observations) {
            break;
        }
        count += 1;
    }
    count
}

/// Packs observations, whose times are at least 0, and extends the stream's table by the states that are new to it.
#[must_use]
pub fn pack(entries: &[Entry], names: &[Box<str>], table: &mut StreamTable) -> ObservationColumns {
    let mut new_states = Vec::new();
    let mut new_dimensions = Vec::new();
    let mut state_indices = Vec::with_capacity(entries.len());
    for entry in entries {
        let (index, new) = table.index(entry.state);
        if new {
            new_states.push(names.get(entry.state as usize).map_or_else(String::new, |name| name.to_string()));
            new_dimensions.push(u32::try_from(entry.coordinates().len()).unwrap_or(0));
        }
        state_indices.push(index);
    }
    let times: Vec<i64> = entries.iter().map(|entry| entry.time_nanos).collect();
    let values: Vec<f64> = entries.iter().map(|entry| entry.value).collect();
    let mut columns = encode(&times, &state_indices, &values, new_states);
    if new_dimensions.iter().any(|&dimensions| dimensions > 0) {
        let kind = |&dimensions: &u32| if dimensions > 0 { StateKind::Vector } else { StateKind::Unspecified };
        columns.new_kinds = new_dimensions.iter().map(|dimensions| kind(dimensions).into()).collect();
        columns.new_dimensions = new_dimensions;
    }
    columns.coordinates = entries.iter().flat_map(Entry::coordinates).copied().collect();
    columns
}

#[cfg(test)]
mod tests;
