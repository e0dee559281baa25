//! Checks the observations, scans and traversals of one stream, in the stream's own task, before the map's writer gets
//! them.
//!
//! Invariant: sequence numbers go up by one. Observations that were taken before are skipped; a gap ends the stream. An
//! invalid observation is refused alone and uses up its number. If a name has no declared kind, the map's writer checks
//! its values, because it has the state.

use std::ops::RangeInclusive;

use tidemap_grid::spec::GridSpec;
use tidemap_map::{
    event::{Dimensions, Position, SequenceSpan, StateKind, StateShape, StatedReporting},
    ids::RefusalReason,
    name::StateName,
    snapshot::ContentMark,
};
use tidemap_model::LABELS;
use tidemap_proto::convert::{
    InvalidField, OverLimit,
    columns::DecodedColumns,
    labels::{invalid_shares, shares, shares_of},
    observe::ObservationMessage,
    scans::{ScanError, ScanLimits},
    sequences::check_end,
    vectors::positions,
};

use super::protocol::{NewName, ObservationBatch, RefusedObservation};

mod cast_table;
pub mod early;
mod known_content;
mod reports;
mod scans;
#[cfg(test)]
pub(crate) mod tests;

use known_content::KnownContent;
use scans::ScanIntake;

const DETAIL_CHARS_MAX: usize = 200;
/// Maximum number of observations of labels in one message: each becomes up to 64 observations in the event.
const LABELS_MAX: usize = 4096;
/// Bytes of a stream's table per name: the longest name of ASCII characters. Invalid names are kept too, for the CRC,
/// and may be as long as a message.
const TABLE_BYTES_PER_NAME: usize = 128;
/// Bytes that a table may take even if it may hold only few names.
const TABLE_BYTES_MIN: usize = 1 << 20;

/// The reason why a message ends its stream.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the variants and fields")]
pub enum IntakeError {
    #[error(transparent)]
    Invalid(#[from] InvalidField),
    #[error(transparent)]
    Limit(#[from] OverLimit),
    #[error("first_sequence {got} leaves a gap: {expected} is the next sequence number of this stream")]
    OutOfSequence { got: u64, expected: u64 },
    #[error(
        "observations {first} to {last} differ from those that were accepted with these numbers before: a sequence \
         number identifies one observation for ever. Nothing was counted twice; number new observations from {next}"
    )]
    DataMismatch { first: u64, last: u64, next: u64 },
}

impl From<ScanError> for IntakeError {
    fn from(error: ScanError) -> Self {
        match error {
            ScanError::Invalid(field) => Self::Invalid(field),
            ScanError::Limit(limit) => Self::Limit(limit),
        }
    }
}

/// The limits of one stream.
#[derive(Clone, Copy, Debug)]
pub struct IntakeLimits {
    /// Maximum number of observations of one message.
    pub batch: usize,
    /// Maximum number of names of the stream.
    pub table: usize,
    /// The limits of scans.
    pub scans: ScanLimits,
}

#[derive(Debug)]
struct TableEntry {
    raw: String,
    refusal: Option<String>,
    /// The declared shape.
    shape: Option<StateShape>,
}

/// The observations of a message that have more than one number, each with its index; ascending.
#[derive(Debug, Default)]
struct ManyNumbers {
    positions: Vec<(u32, Position)>,
    shares: Vec<(u32, Box<[f64]>)>,
}

/// Reads these observations in order.
struct ManyNumbersReader<'a> {
    positions: &'a [(u32, Position)],
    shares: &'a [(u32, Box<[f64]>)],
}

impl ManyNumbers {
    fn from(&self, first: usize) -> ManyNumbersReader<'_> {
        let is_before = |place: u32| (place as usize) < first;
        ManyNumbersReader {
            positions: &self.positions[self.positions.partition_point(|(place, _)| is_before(*place))..],
            shares: &self.shares[self.shares.partition_point(|(place, _)| is_before(*place))..],
        }
    }
}

impl<'a> ManyNumbersReader<'a> {
    /// The position or the shares of the next observation.
    fn at(&mut self, i: usize) -> (Option<Position>, Option<&'a [f64]>) {
        let position = self.positions.split_first().filter(|((place, _), _)| *place as usize == i);
        let position = position.map(|((_, position), rest)| {
            self.positions = rest;
            *position
        });
        let shares = self.shares.split_first().filter(|((place, _), _)| *place as usize == i);
        let shares = shares.map(|((_, shares), rest)| {
            self.shares = rest;
            &**shares
        });
        (position, shares)
    }
}

impl TableEntry {
    /// Whether the state may have the position or the shares, or the value if there are none, as far as is known here.
    /// NaN is the value of a state that reports changes or events.
    fn may_have(
        &self,
        value: f64,
        position: Option<Position>,
        shares: Option<&[f64]>,
        reporting: Option<StatedReporting>,
    ) -> bool {
        match (position, shares) {
            (Some(position), _) => position.invalid_coordinate().is_none(),
            (None, Some(shares)) => invalid_shares(shares).is_none(),
            (None, None) if self.is_label() => value == 1.0,
            (None, None) if value.is_nan() => reporting.is_none_or(|stated| stated.for_new().may_end()),
            (None, None) => self.expected_shape().allows(value),
        }
    }

    /// Whether the name is a label, so that its observation means that this label holds.
    fn is_label(&self) -> bool {
        self.shape == Some(StateShape::Categorical(0))
    }

    /// The shape that the values must have, as far as is known here.
    fn expected_shape(&self) -> StateShape {
        self.shape.unwrap_or(StateShape::Scalar(StateKind::Continuous))
    }

    fn dimensions(&self) -> Option<Dimensions> {
        match self.shape {
            Some(StateShape::Vector(dimensions)) => Some(dimensions),
            _ => None,
        }
    }
}

/// The names, sequence and running CRC of one stream.
#[derive(Debug)]
pub struct Intake {
    table: Vec<TableEntry>,
    table_bytes: usize,
    next_sequence: u64,
    content_crc: u32,
    known: KnownContent,
    /// Whether any name of the table is a vector.
    has_vectors: bool,
    limits: IntakeLimits,
    /// Observations with earlier times are refused.
    earliest_nanos: i64,
    /// The reporting of the states that the stream has stated.
    reporting: Option<StatedReporting>,
    rows: Vec<u8>,
    scans: ScanIntake,
}

impl Intake {
    /// A stream whose observations up to `durable_sequence` were taken, with this CRC, for a map with this grid.
    pub fn new(durable_sequence: u64, content_crc: u32, limits: IntakeLimits, grid: Option<&GridSpec>) -> Self {
        Self {
            table: Vec::new(),
            table_bytes: 0,
            has_vectors: false,
            next_sequence: durable_sequence + 1,
            content_crc,
            known: KnownContent::default(),
            limits,
            earliest_nanos: 0,
            reporting: None,
            rows: Vec::new(),
            scans: ScanIntake::new(grid, limits.scans),
        }
    }

    /// Adds the known running CRCs, ascending. Repeated observations are compared with these CRCs.
    pub fn with_known_content(mut self, marks: Vec<ContentMark>) -> Self {
        self.known = KnownContent::new(marks);
        self
    }

    /// Lets the stream refuse observations before this time, nanoseconds UTC.
    pub fn with_earliest_time(mut self, earliest_nanos: i64) -> Self {
        self.earliest_nanos = earliest_nanos;
        self
    }

    /// Sets the reporting of the states that the stream has stated.
    pub fn with_reporting(mut self, reporting: Option<StatedReporting>) -> Self {
        self.reporting = reporting;
        self
    }

    /// Maximum number of observations of one message.
    pub fn batch_max(&self) -> usize {
        self.limits.batch
    }

    /// Memory of the stream's table of tiles and its unfinished scan, in bytes, approximately.
    pub fn held_bytes(&self) -> usize {
        self.scans.held_bytes()
    }

    /// Checks a message. `None`: the message has nothing new.
    ///
    /// # Errors
    /// Errors that end the stream; nothing of the message was taken.
    pub fn take(&mut self, message: ObservationMessage) -> Result<Option<ObservationBatch>, IntakeError> {
        let ObservationMessage { sequences, shapes, mut columns } = message;
        self.check_sequences(&sequences)?;
        let (first, last) = sequences.into_inner();
        self.check_no_open_scan("batch", "observations")?;
        let names = columns.take_names();
        self.check_limits(columns.observations(), &names)?;
        let (coordinates, shares) = (columns.take_coordinates(), columns.take_shares());
        let columns = columns.unpack()?;
        let new_names = self.extend_table(names, shapes);
        let numbers = self.numbers(&columns, &coordinates, &shares)?;
        let skip = usize::try_from(self.next_sequence - first).unwrap_or(usize::MAX);
        let skip = skip.min(columns.values.len());
        self.check_known(first, &columns, &numbers, skip)?;
        if last < self.next_sequence && new_names.is_empty() {
            return Ok(None);
        }
        let mut batch = self.check(&columns, &numbers, skip);
        batch.new_names = new_names;
        batch.span.last = last.max(self.next_sequence - 1);
        self.next_sequence = batch.span.last + 1;
        batch.span.content_crc = self.content_crc;
        self.known.took(self.next_sequence - 1, self.content_crc);
        Ok(Some(batch))
    }

    /// Compares the observations of a message that were taken before.
    fn check_known(
        &mut self,
        first: u64,
        columns: &DecodedColumns,
        numbers: &ManyNumbers,
        known: usize,
    ) -> Result<(), IntakeError> {
        let mut places = numbers.from(0);
        for (i, sequence) in (first..).take(known).enumerate() {
            let (position, shares) = places.at(i);
            self.rows.clear();
            self.append_row(columns, i, position, shares);
            self.known.repeated(sequence, |crc| crc32c::crc32c_append(crc, &self.rows))?;
        }
        Ok(())
    }

    /// Appends the content of an observation, as the CRC covers it, to the rows.
    fn append_row(&mut self, columns: &DecodedColumns, i: usize, position: Option<Position>, shares: Option<&[f64]>) {
        let entry = self.table.get(columns.state_indices[i] as usize);
        self.rows.extend_from_slice(entry.map_or(b"", |entry| entry.raw.as_bytes()));
        self.rows.extend_from_slice(&columns.times_nanos[i].to_le_bytes());
        let numbers = position.as_ref().map(Position::coordinates).or(shares).unwrap_or(&columns.values[i..=i]);
        numbers.iter().for_each(|number| self.rows.extend_from_slice(&number.to_le_bytes()));
    }

    fn check_sequences(&self, sequences: &RangeInclusive<u64>) -> Result<(), IntakeError> {
        let first = *sequences.start();
        if first > self.next_sequence {
            return Err(IntakeError::OutOfSequence { got: first, expected: self.next_sequence });
        }
        Ok(check_end(sequences)?)
    }

    /// Between the parts of a scan no other data may come.
    fn check_no_open_scan(&self, field: &str, what: &str) -> Result<(), InvalidField> {
        match self.scans.open_sequence() {
            Some(open) => {
                let text = format!("scan {open} is unfinished: its next part must come before {what}");
                Err(InvalidField::new(field, text))
            }
            None => Ok(()),
        }
    }

    /// Checks sizes before anything is unpacked or kept.
    fn check_limits(&self, observations: usize, names: &[String]) -> Result<(), IntakeError> {
        let bytes = self.table_bytes + names.iter().map(String::len).sum::<usize>();
        let max_bytes = self.limits.table.saturating_mul(TABLE_BYTES_PER_NAME).max(TABLE_BYTES_MIN);
        for (what, got, max, setting) in [
            ("observations of one message", observations, self.limits.batch, "setting max_batch_observations"),
            ("states of one stream", self.table.len() + names.len(), self.limits.table, "setting max_states_per_map"),
            ("bytes of one stream's states' names", bytes, max_bytes, "setting max_states_per_map"),
        ] {
            OverLimit::check(what, got, max, setting)?;
        }
        Ok(())
    }

    fn extend_table(&mut self, names: Vec<String>, shapes: Vec<Option<StateShape>>) -> Vec<Option<NewName>> {
        let mut checked = Vec::with_capacity(names.len());
        for (raw, shape) in names.into_iter().zip(shapes) {
            let has_parts = shape.is_some_and(|shape| shape.states() > 1);
            self.has_vectors |= shape.is_some_and(|shape| !shape.is_single());
            let name = match shape {
                Some(StateShape::Categorical(0)) => StateName::labelled(&raw),
                _ => StateName::observed(&raw),
            };
            let name = name.and_then(|name| if has_parts { name.check_vector().map(|()| name) } else { Ok(name) });
            let (name, refusal) = match name {
                Ok(name) => (Some(NewName { name, shape, reporting: self.reporting }), None),
                Err(error) => (None, Some(format!("state {error}"))),
            };
            self.table_bytes += raw.len();
            self.table.push(TableEntry { raw, refusal, shape });
            checked.push(name);
        }
        checked
    }

    /// The positions and the shares of a message, according to the stream's table.
    fn numbers(
        &self,
        columns: &DecodedColumns,
        coordinates: &[f64],
        share_column: &[f64],
    ) -> Result<ManyNumbers, IntakeError> {
        if !self.has_vectors && coordinates.is_empty() && share_column.is_empty() {
            return Ok(ManyNumbers::default());
        }
        let entry = |index: u32| self.table.get(index as usize);
        let positions = positions(&columns.state_indices, coordinates, |index| entry(index)?.dimensions())?;
        let shares = shares(&columns.state_indices, share_column, |index| shares_of(entry(index)?.shape?))?;
        // One position or one distribution always fits.
        let fits = if shares.is_empty() { Dimensions::Three.count() } else { *LABELS.end() };
        let max = self.limits.batch.max(fits);
        let single = columns.values.len() - positions.len() - shares.len();
        let what = "observations of one message, positions counted by their coordinates, and shares by their labels";
        OverLimit::check(what, single + coordinates.len() + share_column.len(), max, "setting max_batch_observations")?;
        let is_label = |index: &&u32| entry(**index).is_some_and(TableEntry::is_label);
        let labels = columns.state_indices.iter().filter(is_label).count();
        OverLimit::check("labels of one message", labels, LABELS_MAX, "one message")?;
        Ok(ManyNumbers { positions, shares })
    }

    fn check(&mut self, columns: &DecodedColumns, numbers: &ManyNumbers, skip: usize) -> ObservationBatch {
        let new = columns.values.len() - skip;
        let mut batch = ObservationBatch {
            span: SequenceSpan { first: self.next_sequence, ..SequenceSpan::default() },
            table_indices: Vec::with_capacity(new),
            times_nanos: Vec::with_capacity(new),
            values: Vec::with_capacity(new),
            ..ObservationBatch::default()
        };
        self.rows.clear();
        let mut places = numbers.from(skip);
        for i in skip..columns.values.len() {
            let (index, time, value) = (columns.state_indices[i], columns.times_nanos[i], columns.values[i]);
            let (position, shares) = places.at(i);
            self.append_row(columns, i, position, shares);
            let entry = self.table.get(index as usize);
            let refusal = match entry {
                Some(TableEntry { refusal: None, .. }) if (0..self.earliest_nanos).contains(&time) => {
                    Some((RefusalReason::Time, early::refusal(time)))
                }
                Some(entry)
                    if entry.refusal.is_none()
                        && time >= 0
                        && entry.may_have(value, position, shares, self.reporting) =>
                {
                    None
                }
                _ => Some(refuse(entry, index, self.table.len(), time, (value, position, shares))),
            };
            let offset = i - skip;
            match refusal {
                None => {
                    if !batch.refused.is_empty() {
                        batch.kept.push(u32::try_from(offset).unwrap_or(u32::MAX));
                    }
                    let place = u32::try_from(batch.values.len()).unwrap_or(u32::MAX);
                    batch.positions.extend(position.map(|position| (place, position)));
                    batch.shares.extend(shares.map(|shares| (place, Box::from(shares))));
                    batch.table_indices.push(index);
                    batch.times_nanos.push(time);
                    // All NaNs become the same NaN.
                    let value = if value.is_nan() { f64::NAN } else { value };
                    batch.values.push(if position.is_some() || shares.is_some() { 0.0 } else { value });
                }
                Some((reason, detail)) => {
                    if batch.refused.is_empty() {
                        batch.kept.extend(0..u32::try_from(offset).unwrap_or(u32::MAX));
                    }
                    let detail = shortened(&detail);
                    batch.refused.push(RefusedObservation {
                        sequence: self.next_sequence + offset as u64,
                        reason,
                        detail,
                    });
                }
            }
        }
        self.content_crc = crc32c::crc32c_append(self.content_crc, &self.rows);
        batch
    }
}

fn shortened(detail: &str) -> String {
    detail.chars().take(DETAIL_CHARS_MAX).collect()
}

/// A refusal: a state of that shape cannot have the value.
pub(super) fn refuse_value(value: f64, shape: StateShape) -> (RefusalReason, String) {
    (RefusalReason::Value, format!("value {value} is not {}", shape.expected()))
}

fn refuse(
    entry: Option<&TableEntry>,
    index: u32,
    table_len: usize,
    time: i64,
    (value, position, shares): (f64, Option<Position>, Option<&[f64]>),
) -> (RefusalReason, String) {
    match entry {
        None => {
            let text = format!("state index {index} is beyond the stream's table of {table_len} names");
            (RefusalReason::StateIndex, text)
        }
        Some(TableEntry { refusal: Some(text), .. }) => (RefusalReason::StateName, text.clone()),
        Some(_) if time < 0 => (RefusalReason::Time, format!("time {time} ns is before 1970")),
        Some(_) if shares.is_some() => (RefusalReason::Value, shares.and_then(invalid_shares).unwrap_or_default()),
        Some(entry) if entry.is_label() => {
            let text = format!("value {value} of a label is not 1: send only the true label, or a share of each");
            (RefusalReason::Value, text)
        }
        Some(entry) => match position.and_then(|position| position.invalid_coordinate()) {
            Some((axis, coordinate)) => {
                let expected = StateKind::Continuous.expected();
                (RefusalReason::Value, format!("coordinate {axis} {coordinate} is not {expected}"))
            }
            None => refuse_value(value, entry.expected_shape()),
        },
    }
}
