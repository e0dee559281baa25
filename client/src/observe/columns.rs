//! Packs observations into columns.
//!
//! Invariant: unpacking returns exactly what was packed; a packed message never exceeds its limits.

use tidemap_model::Position;
use tidemap_proto::{
    convert::columns::encode,
    v1::{ObservationColumns, StateKind},
};

/// One observation; its state is an index into the sender's table of names.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Entry {
    /// Index into the sender's table.
    pub state: u32,
    /// Nanoseconds UTC, at least 0.
    pub time_nanos: i64,
    /// The value; 0 for a position.
    pub value: f64,
    /// The position of a vector. All entries of a state have the same number of coordinates, or none.
    pub position: Option<Position>,
}

impl Entry {
    fn coordinates(&self) -> &[f64] {
        self.position.as_ref().map_or(&[], Position::coordinates)
    }
}

/// Limits of one message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BatchLimits {
    /// Maximum number of observations; a position counts once for each coordinate.
    pub observations: usize,
    /// Maximum number of bytes of the encoded message.
    pub bytes: usize,
}

impl BatchLimits {
    /// Maximum number of reports other than sightings; each counts as two observations, and one always fits.
    #[must_use]
    pub fn reports(self) -> usize {
        (self.observations / 2).max(1)
    }
}

/// Maximum number of bytes of an observation: a delta of 10, an index of 5, a value of 8.
const ENTRY_BYTES_MAX: usize = 23;
/// Maximum number of bytes of a name in addition to its text, including kind and number of coordinates.
const NAME_BYTES_EXTRA: usize = 6;
/// Maximum number of bytes of everything else in a message.
const MESSAGE_BYTES_EXTRA: usize = 128;

/// The states of the sender that one stream knows, and their indices there.
#[derive(Clone, Debug, Default)]
pub struct StreamTable {
    /// Index in the stream + 1, by the sender's index; 0 if the stream does not know the state.
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

/// Number of `entries` that fit into one message, at least 1 if there is one.
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
        // A new state that appears twice in the message is counted twice: an upper bound is enough.
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

/// Packs observations (their times are at least 0), and adds new states to the table of the stream.
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

/// Declares new names as labels of categorical states.
pub fn declare_labels(columns: &mut ObservationColumns, is_label: impl Fn(&str) -> bool) {
    if !columns.new_states.iter().any(|name| is_label(name)) {
        return;
    }
    columns.new_kinds.resize(columns.new_states.len(), 0);
    let named = columns.new_kinds.iter_mut().zip(&columns.new_states);
    named.filter(|(_, name)| is_label(name)).for_each(|(kind, _)| *kind = StateKind::Categorical.into());
}

#[cfg(test)]
mod tests;
