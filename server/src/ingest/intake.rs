//! Checks the observations of one stream, in the stream's own task, before its map's writer sees them.
//!
//! Invariant: sequence numbers go up by one; what was taken before is skipped, a gap ends the stream. An observation
//! that is wrong is refused by itself and uses up its number.

use tidemap_map::{event::RefusalReason, name::StateName};
use tidemap_proto::convert::{
    InvalidField,
    columns::{DecodedColumns, decode},
};
use tidemap_proto::v1::ObservationBatch;

use super::protocol::{Batch, Refused};

const DETAIL_CHARS_MAX: usize = 200;
/// Bytes of a stream's table per name that it may hold: the longest name of ASCII characters. Names that are not valid
/// are kept too, for the CRC, and are as long as a message allows.
const TABLE_BYTES_PER_NAME: usize = 128;
/// Bytes that a table may take however few names it may hold.
const TABLE_BYTES_LEAST: usize = 1 << 20;

/// Why a message ends its stream.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum IntakeError {
    /// The message is malformed.
    #[error(transparent)]
    Invalid(#[from] InvalidField),
    /// The message, or the stream with it, is over a limit.
    #[error("{what}: {got} is more than the {max} that {setting} allows")]
    Limit {
        /// What there is too much of.
        what: &'static str,
        /// How much was sent.
        got: u64,
        /// How much is allowed.
        max: u64,
        /// Which setting or rule says so.
        setting: &'static str,
    },
    /// A sequence number leaps.
    #[error("first_sequence {got} leaves a gap: {expected} is the next sequence number of this stream")]
    OutOfSequence {
        /// The one sent.
        got: u64,
        /// The one expected.
        expected: u64,
    },
}

#[derive(Debug)]
struct TableEntry {
    raw: String,
    refusal: Option<String>,
}

/// One stream's table of names, sequence and running CRC.
#[derive(Debug)]
pub struct Intake {
    table: Vec<TableEntry>,
    table_bytes: usize,
    next_sequence: u64,
    content_crc: u32,
    max_batch: usize,
    max_table: usize,
    rows: Vec<u8>,
}

impl Intake {
    /// A stream of which everything up to `durable_sequence`, with this CRC, was taken.
    #[must_use]
    pub fn new(durable_sequence: u64, content_crc: u32, max_batch: usize, max_table: usize) -> Self {
        Self {
            table: Vec::new(),
            table_bytes: 0,
            next_sequence: durable_sequence + 1,
            content_crc,
            max_batch,
            max_table,
            rows: Vec::new(),
        }
    }

    /// Checks a message. `None`: nothing of it is new.
    ///
    /// # Errors
    /// What ends the stream; nothing of the message was taken.
    pub fn take(&mut self, message: ObservationBatch) -> Result<Option<Batch>, IntakeError> {
        let first = message.first_sequence;
        if first == 0 {
            return Err(InvalidField::new("first_sequence", "0 is not a sequence number: the first is 1").into());
        }
        if first > self.next_sequence {
            return Err(IntakeError::OutOfSequence { got: first, expected: self.next_sequence });
        }
        let mut columns =
            message.observations.ok_or_else(|| InvalidField::new("observations", "missing: send at least 1"))?;
        let names = std::mem::take(&mut columns.new_states);
        self.check_limits(columns.time_deltas.len(), &names)?;
        let columns = decode(columns)?;
        let count = columns.values.len() as u64;
        let last = first.checked_add(count - 1).filter(|last| *last < u64::MAX);
        let last = last.ok_or_else(|| InvalidField::new("first_sequence", format!("{first} is too large")))?;
        let new_names = self.extend_table(names);
        let skip = usize::try_from(self.next_sequence - first).unwrap_or(usize::MAX);
        if last < self.next_sequence && new_names.is_empty() {
            return Ok(None);
        }
        let mut batch = self.check(&columns, skip.min(columns.values.len()));
        batch.new_names = new_names;
        batch.last_sequence = last.max(self.next_sequence - 1);
        self.next_sequence = batch.last_sequence + 1;
        batch.content_crc = self.content_crc;
        Ok(Some(batch))
    }

    /// Checks sizes before anything is unpacked or kept.
    fn check_limits(&self, observations: usize, names: &[String]) -> Result<(), IntakeError> {
        let bytes = self.table_bytes + names.iter().map(String::len).sum::<usize>();
        let max_bytes = self.max_table.saturating_mul(TABLE_BYTES_PER_NAME).max(TABLE_BYTES_LEAST);
        for (what, got, max, setting) in [
            ("observations of one message", observations, self.max_batch, "setting max_batch_observations"),
            ("states of one stream", self.table.len() + names.len(), self.max_table, "setting max_states_per_map"),
            ("bytes of one stream's states' names", bytes, max_bytes, "setting max_states_per_map"),
        ] {
            if got > max {
                return Err(IntakeError::Limit { what, got: got as u64, max: max as u64, setting });
            }
        }
        Ok(())
    }

    fn extend_table(&mut self, names: Vec<String>) -> Vec<Option<StateName>> {
        let mut checked = Vec::with_capacity(names.len());
        for raw in names {
            let (name, refusal) = match StateName::new(&raw) {
                Ok(name) => (Some(name), None),
                Err(error) => (None, Some(format!("state {error}"))),
            };
            self.table_bytes += raw.len();
            self.table.push(TableEntry { raw, refusal });
            checked.push(name);
        }
        checked
    }

    fn check(&mut self, columns: &DecodedColumns, skip: usize) -> Batch {
        let new = columns.values.len() - skip;
        let mut batch = Batch {
            first_sequence: self.next_sequence,
            table_indices: Vec::with_capacity(new),
            times_nanos: Vec::with_capacity(new),
            values: Vec::with_capacity(new),
            ..Batch::default()
        };
        self.rows.clear();
        for i in skip..columns.values.len() {
            let (index, time, value) = (columns.state_indices[i], columns.times_nanos[i], columns.values[i]);
            let entry = self.table.get(index as usize);
            self.rows.extend_from_slice(entry.map_or(b"", |entry| entry.raw.as_bytes()));
            self.rows.extend_from_slice(&time.to_le_bytes());
            self.rows.extend_from_slice(&value.to_le_bytes());
            let refusal = match entry {
                Some(TableEntry { refusal: None, .. }) if time >= 0 && (0.0..=1.0).contains(&value) => None,
                _ => Some(refuse(entry, index, self.table.len(), time, value)),
            };
            let offset = i - skip;
            match refusal {
                None => {
                    if !batch.refused.is_empty() {
                        batch.kept.push(u32::try_from(offset).unwrap_or(u32::MAX));
                    }
                    batch.table_indices.push(index);
                    batch.times_nanos.push(time);
                    batch.values.push(value);
                }
                Some((reason, detail)) => {
                    if batch.refused.is_empty() {
                        batch.kept.extend(0..u32::try_from(offset).unwrap_or(u32::MAX));
                    }
                    let detail = detail.chars().take(DETAIL_CHARS_MAX).collect();
                    batch.refused.push(Refused { sequence: self.next_sequence + offset as u64, reason, detail });
                }
            }
        }
        self.content_crc = crc32c::crc32c_append(self.content_crc, &self.rows);
        batch
    }
}

fn refuse(entry: Option<&TableEntry>, index: u32, table_len: usize, time: i64, value: f64) -> (RefusalReason, String) {
    match entry {
        None => {
            let text = format!("state index {index} is beyond the stream's table of {table_len} names");
            (RefusalReason::StateIndex, text)
        }
        Some(TableEntry { refusal: Some(text), .. }) => (RefusalReason::StateName, text.clone()),
        Some(_) if time < 0 => (RefusalReason::Time, format!("time {time} ns is before 1970")),
        Some(_) => (RefusalReason::Value, format!("value {value} is not between 0 and 1")),
    }
}

#[cfg(test)]
mod tests {
    use tidemap_proto::convert::columns::encode;

    use super::*;

    fn message(first: u64, names: &[&str], indices: &[u32], times: &[i64], values: &[f64]) -> ObservationBatch {
        let names = names.iter().map(|name| (*name).to_owned()).collect();
        ObservationBatch { first_sequence: first, observations: Some(encode(times, indices, values, names)) }
    }

    fn intake() -> Intake {
        Intake::new(0, 0, 4, 3)
    }

    #[test]
    fn numbers_go_up_by_one_and_known_ones_are_skipped() {
        let mut intake = intake();
        let batch = intake.take(message(1, &["a"], &[0, 0], &[1, 2], &[0.0, 1.0])).expect("fine").expect("new");
        assert_eq!((batch.first_sequence, batch.last_sequence), (1, 2));
        assert!(intake.take(message(1, &[], &[0, 0], &[1, 2], &[0.0, 1.0])).expect("fine").is_none());
        let batch = intake.take(message(2, &[], &[0, 0], &[2, 3], &[1.0, 0.5])).expect("fine").expect("new");
        assert_eq!((batch.first_sequence, batch.last_sequence, batch.times_nanos.as_slice()), (3, 3, [3].as_slice()));
        let leap = intake.take(message(5, &[], &[0], &[1], &[0.0]));
        assert_eq!(leap.expect_err("a gap"), IntakeError::OutOfSequence { got: 5, expected: 4 });
        assert!(intake.take(message(0, &[], &[0], &[1], &[0.0])).is_err());
    }

    #[test]
    fn the_crc_depends_on_content_alone() {
        let mut whole = intake();
        let whole = whole.take(message(1, &["a", "b"], &[0, 1, 0], &[1, 2, 3], &[0.0, 1.0, 0.5]));
        let mut parts = intake();
        parts.take(message(1, &["b", "a"], &[1, 0], &[1, 2], &[0.0, 1.0])).expect("fine");
        let parts = parts.take(message(2, &[], &[0, 1], &[2, 3], &[1.0, 0.5]));
        assert_eq!(whole.expect("fine").expect("new").content_crc, parts.expect("fine").expect("new").content_crc);
        let by_hand = [("a", 1i64, 0f64), ("b", 2, 1.0), ("a", 3, 0.5)].iter().fold(0, |crc, (name, time, value)| {
            let crc = crc32c::crc32c_append(crc, name.as_bytes());
            crc32c::crc32c_append(crc32c::crc32c_append(crc, &time.to_le_bytes()), &value.to_le_bytes())
        });
        let mut again = intake();
        let again = again.take(message(1, &["a", "b"], &[0, 1, 0], &[1, 2, 3], &[0.0, 1.0, 0.5]));
        assert_eq!(again.expect("fine").expect("new").content_crc, by_hand);
    }

    #[test]
    fn a_wrong_observation_does_not_take_its_neighbours_with_it() {
        let mut intake = Intake::new(10, 7, 9, 9);
        let values = [0.5, f64::NAN, 1.0, -0.1, 0.0, 1.5, f64::INFINITY];
        let sent = message(11, &["a", "b/c"], &[0, 0, 1, 0, 9, 0, 0], &[1, 2, 3, 4, 5, 6, 7], &values);
        let batch = intake.take(sent).expect("fine").expect("new");
        assert_eq!(batch.last_sequence, 17);
        assert_eq!(batch.kept, [0]);
        assert_eq!(batch.values, [0.5]);
        let reasons: Vec<_> = batch.refused.iter().map(|refused| (refused.sequence, refused.reason)).collect();
        assert_eq!(
            reasons,
            [
                (12, RefusalReason::Value),
                (13, RefusalReason::StateName),
                (14, RefusalReason::Value),
                (15, RefusalReason::StateIndex),
                (16, RefusalReason::Value),
                (17, RefusalReason::Value),
            ]
        );
        assert!(batch.refused[0].detail.contains("NaN"));
        assert_eq!(batch.new_names.len(), 2);
    }

    #[test]
    fn times_before_1970_are_refused() {
        let mut intake = intake();
        let batch = intake.take(message(1, &["a"], &[0, 0], &[-5, 5], &[0.0, 0.0])).expect("fine").expect("new");
        assert_eq!(batch.refused[0].reason, RefusalReason::Time);
        assert_eq!(batch.kept, [1]);
    }

    #[test]
    fn limits_are_errors_and_nothing_is_taken() {
        let mut intake = intake();
        let over = intake.take(message(1, &["a"], &[0; 5], &[0; 5], &[0.0; 5])).expect_err("5 observations");
        assert!(matches!(over, IntakeError::Limit { got: 5, max: 4, .. }), "{over}");
        assert!(over.to_string().contains("max_batch_observations"), "{over}");
        let over = intake.take(message(1, &["a", "b", "c", "d"], &[0], &[0], &[0.0])).expect_err("4 names");
        assert!(matches!(over, IntakeError::Limit { got: 4, max: 3, .. }), "{over}");
        assert!(intake.take(ObservationBatch { first_sequence: 1, observations: None }).is_err());
        let batch = intake.take(message(1, &["a"], &[0], &[0], &[0.0])).expect("fine").expect("new");
        assert_eq!(batch.first_sequence, 1);
        let edge = intake.take(message(u64::MAX, &[], &[0], &[0], &[0.0]));
        assert!(matches!(edge, Err(IntakeError::OutOfSequence { .. })));
    }

    #[test]
    fn the_bytes_of_a_table_are_bounded() {
        let mut intake = intake();
        // Too long to be valid, and kept all the same.
        let long = "x".repeat(TABLE_BYTES_LEAST / 2);
        for sequence in 1..=2 {
            let batch = intake.take(message(sequence, &[&long], &[0], &[0], &[0.0])).expect("fine").expect("new");
            assert_eq!(batch.refused[0].reason, RefusalReason::StateName);
        }
        let over = intake.take(message(3, &["a"], &[0], &[0], &[0.0])).expect_err("full");
        assert!(matches!(over, IntakeError::Limit { got, max, .. } if got == max + 1), "{over}");
        assert!(intake.take(message(3, &[], &[0], &[0], &[0.0])).is_ok());
    }

    #[test]
    fn names_alone_are_handed_over_without_observations() {
        let mut intake = intake();
        intake.take(message(1, &["a"], &[0], &[1], &[0.0])).expect("fine");
        let batch = intake.take(message(1, &["b"], &[0], &[1], &[0.0])).expect("fine").expect("names");
        assert!(batch.last_sequence < batch.first_sequence);
        assert_eq!((batch.new_names.len(), batch.values.len()), (1, 0));
    }
}
