//! CSV files of observations: `time,state,value` with a header, one row for each line; or `time,state,x,y`, with an
//! optional `z`, for positions. [`traversals`] reads files of traversals in the same way.
//!
//! Invariant: row n of a file always has the number n and gives the same observation, even if it is invalid; an
//! interrupted transfer relies on it to continue. At most one line is in memory. After the end of a file was seen, the
//! reader does not read on, even if the file grows.

mod fields;
pub mod landmarks;
mod rules;
pub mod sightings;
pub mod traversals;

use std::{
    borrow::Cow,
    io::{self, BufRead},
};

pub use fields::split as split_row;
pub use rules::{InvalidRule, Meaning, RowRules};

use rules::FileTimes;
use tidemap_map::name::StateName;
use tidemap_model::{Dimensions, Position, RowKind, StateKind};

/// Maximum length of a line. Three fields need far less; a file without line ends must not fill the memory.
const LINE_BYTES_MAX: usize = 64 * 1024;

/// Why a file cannot be read.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of each variant names its fields")]
pub enum RowError {
    /// An I/O error.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// An empty file.
    #[error("it is empty: the first line must be the header {0}")]
    Empty(&'static str),
    /// A column is missing.
    #[error("column {column:?} is missing: the header must name {}, but is {header:?}", needed(.column))]
    MissingColumn { column: String, header: String },
    /// Columns that are not separated by commas.
    #[error(
        "its columns are separated by {}, not by commas, in the header {header:?}: write it with commas, for example \
         with tr '{}' ',' < FILE > NEW, where numbers have no comma (0.5, not 0,5)",
        separator_name(*.separator), separator.escape_default()
    )]
    Separator { separator: char, header: String },
    /// A column appears twice.
    #[error("column {column:?} appears twice in the header {header:?}")]
    DoubleColumn { column: String, header: String },
    /// Positions instead of values.
    #[error(
        "it has positions, columns x and y: use a file of single values, where each axis is a state, NAME/x and so on"
    )]
    Positions,
}

fn separator_name(separator: char) -> &'static str {
    match separator {
        ';' => "semicolons",
        '\t' => "tabs",
        _ => "bars",
    }
}

/// The separator of the columns of a header that has no commas; `None`: it has one column.
fn other_separator(header: &str) -> Option<char> {
    let others = || [';', '\t', '|'].into_iter();
    others().find(|&separator| !header.contains(',') && header.contains(separator))
}

/// The columns that a header needs together with this one.
fn needed(column: &str) -> &'static str {
    match column {
        "x" | "y" => "time, state, x and y",
        "place" | "seen" => "time, place and seen",
        "name" | "number" | "u_px" | "v_px" | "descriptor" => "place, name, u_px, v_px and descriptor",
        "from" | "to" | "start" | "end" | "success" => "from, to, start, end and success",
        _ => "time, state and value",
    }
}

/// The place of a row in its file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RowPlace {
    /// Number of the row, from 1, without header and blank lines.
    pub number: u64,
    /// Number of the line, from 1.
    pub line: u64,
    /// Whether the line has a line end. The last line of a file may lack it.
    pub has_end: bool,
}

/// A header.
pub struct CsvHeader<'a> {
    text: &'a str,
    /// Names of the columns, in lower case.
    names: Vec<String>,
}

impl CsvHeader<'_> {
    /// The index of a required column, which must be unique.
    fn column(&self, column: &str) -> Result<usize, RowError> {
        let mut places = self.names.iter().enumerate().filter(|(_, name)| *name == column).map(|(place, _)| place);
        match (places.next(), places.next()) {
            (Some(place), None) => Ok(place),
            (None, _) => Err(RowError::MissingColumn { column: column.to_owned(), header: shown(self.text) }),
            (Some(_), Some(_)) => Err(RowError::DoubleColumn { column: column.to_owned(), header: shown(self.text) }),
        }
    }

    fn has(&self, column: &str) -> bool {
        self.names.iter().any(|name| name == column)
    }
}

/// The kind of rows of a file.
pub trait Layout: Sized {
    /// The usual header.
    const HEADER: &'static str;
    /// A row.
    type Item: std::fmt::Debug;

    /// The layout of a header, with the indices of the columns that it uses.
    fn new(header: &CsvHeader<'_>, rules: &RowRules) -> Result<(Self, Vec<usize>), RowError>;

    /// The row of a line, and whether it could be read completely.
    fn row(&mut self, line: &[u8], at: RowPlace) -> (Self::Item, bool);

    /// The place of a row.
    fn at(row: &Self::Item) -> RowPlace;
}

/// A row of observations.
#[derive(Clone, Debug)]
pub struct ObservationRow {
    /// Number of the row, from 1, without header and blank lines.
    pub number: u64,
    /// Number of the line, from 1.
    pub line: u64,
    /// Name of the state; empty if it could not be read.
    pub state: String,
    /// Time; 0 if it could not be read.
    pub time_nanos: i64,
    /// Value; if a part of the row could not be read, a value that the daemon refuses: NaN, or infinity where NaN means
    /// that no value is known. A value out of range is kept: the transfer and its checksum must match the file.
    pub value: f64,
    /// The value was a word.
    pub is_word: bool,
    /// The value was a label of a categorical state: the value is 1.
    pub label: Option<String>,
    /// The position, in a file of positions; its coordinates are NaN if any part of the row could not be read.
    pub position: Option<Position>,
    /// Why the row could not be read, or is no valid observation of a probability.
    pub wrong: Option<String>,
    /// Whether the row could be read completely. An error is then in its value, which may be valid for other state
    /// kinds.
    pub is_read: bool,
    /// Whether the line has a line end. The last line of a file may lack it.
    pub has_end: bool,
}

/// The next item of a file.
#[derive(Clone, Debug)]
pub enum RowItem<T = ObservationRow> {
    /// A row.
    Row(T),
    /// A last line without a line end that is no complete row, or may be the start of another row: it is still being
    /// written, or the writer was interrupted.
    Torn {
        /// Number of the line.
        line: u64,
        /// The text of the row, shortened.
        text: String,
    },
}

/// The columns of observations.
#[derive(Clone, Debug)]
pub struct ObservationColumns {
    time: usize,
    state: usize,
    /// `None`: each row is one event.
    value: Option<usize>,
    axes: [usize; 3],
    /// The dimensions of positions; none for values.
    dimensions: Option<Dimensions>,
    count: usize,
    rules: RowRules,
    times: FileTimes,
}

/// Reads a file row by row.
#[derive(Debug)]
pub struct RowReader<R, L = ObservationColumns> {
    reader: R,
    layout: L,
    ignored: Vec<String>,
    line: u64,
    number: u64,
    bytes: u64,
    buffer: Vec<u8>,
    /// The end was seen. Reading on would continue in the middle of the last line of a growing file.
    ended: bool,
    lines_must_end: bool,
}

/// The end of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LineEnd {
    Newline,
    EndOfFile,
}

impl<R: BufRead> RowReader<R> {
    /// Reads the header of a file of observations.
    pub fn new(reader: R) -> Result<Self, RowError> {
        Self::open(reader)
    }

    /// Refuses a file of positions.
    pub fn values_only(self) -> Result<Self, RowError> {
        if self.layout.has_positions() { Err(RowError::Positions) } else { Ok(self) }
    }
}

impl<R: BufRead, L: Layout> RowReader<R, L> {
    /// Reads the header.
    pub fn open(reader: R) -> Result<Self, RowError> {
        Self::open_with(reader, &RowRules::default())
    }

    /// Reads the header of a file whose rows are read by these rules.
    pub fn open_with(mut reader: R, rules: &RowRules) -> Result<Self, RowError> {
        let mut buffer = Vec::new();
        let (end, bytes) = read_line(&mut reader, &mut buffer)?;
        end.ok_or(RowError::Empty(L::HEADER))?;
        let text = String::from_utf8_lossy(&buffer);
        let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
        let names = split_row(text).unwrap_or_default().iter().map(|name| name.to_lowercase()).collect();
        let header = CsvHeader { text, names };
        let (layout, used) = L::new(&header, rules).map_err(|error| match (&error, other_separator(text)) {
            (RowError::MissingColumn { .. }, Some(separator)) => RowError::Separator { separator, header: shown(text) },
            _ => error,
        })?;
        let ignored = (0..).zip(&header.names).filter(|(place, _)| !used.contains(place));
        let ignored = ignored.map(|(_, name)| name.clone()).collect();
        let ended = end == Some(LineEnd::EndOfFile);
        Ok(Self { reader, layout, ignored, line: 1, number: 0, bytes, buffer, ended, lines_must_end: false })
    }

    /// The layout of the rows.
    pub fn layout(&self) -> &L {
        &self.layout
    }

    /// Treats every last line without a line end as torn, even if it is a valid row: for sources whose writer may be
    /// cut off anywhere, as in 1 of 10 or 0 of 0.5.
    pub fn lines_must_end(mut self) -> Self {
        self.lines_must_end = true;
        self
    }

    /// Columns of the header that the layout ignores.
    pub fn ignored(&self) -> &[String] {
        &self.ignored
    }

    /// Number of bytes read so far.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Whether the next call of [`next_item`](Self::next_item) may block.
    pub fn may_wait(&mut self) -> bool
    where
        R: Buffered,
    {
        !self.reader.has_line()
    }

    /// The next row; `None` at the end.
    pub fn next_item(&mut self) -> Result<Option<RowItem<L::Item>>, RowError> {
        loop {
            if self.ended {
                return Ok(None);
            }
            let (end, bytes) = read_line(&mut self.reader, &mut self.buffer)?;
            self.bytes += bytes;
            self.ended = end != Some(LineEnd::Newline);
            let Some(end) = end else { return Ok(None) };
            self.line += 1;
            if self.buffer.iter().all(|byte| byte.is_ascii_whitespace()) {
                continue;
            }
            let at = RowPlace { number: self.number + 1, line: self.line, has_end: end == LineEnd::Newline };
            let (row, readable) = self.layout.row(&self.buffer, at);
            if !at.has_end && (self.lines_must_end || !readable) {
                return Ok(Some(RowItem::Torn {
                    line: self.line,
                    text: shown(&String::from_utf8_lossy(&self.buffer)),
                }));
            }
            self.number += 1;
            return Ok(Some(RowItem::Row(row)));
        }
    }
}

/// Reads a line into the buffer, without its line end, and returns the number of bytes read; none at the end. Of a line
/// that is too long, only the start is kept.
fn read_line(reader: &mut impl BufRead, buffer: &mut Vec<u8>) -> io::Result<(Option<LineEnd>, u64)> {
    buffer.clear();
    let mut bytes = 0;
    let end = loop {
        let available = match reader.fill_buf() {
            Ok(available) => available,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(error),
        };
        if available.is_empty() {
            break LineEnd::EndOfFile;
        }
        let newline = available.iter().position(|&byte| byte == b'\n');
        let piece = &available[..newline.unwrap_or(available.len())];
        let room = (LINE_BYTES_MAX + 1).saturating_sub(buffer.len());
        buffer.extend_from_slice(&piece[..piece.len().min(room)]);
        let consumed = piece.len() + usize::from(newline.is_some());
        reader.consume(consumed);
        bytes += consumed as u64;
        if newline.is_some() {
            break LineEnd::Newline;
        }
    };
    if bytes == 0 {
        return Ok((None, 0));
    }
    if buffer.last() == Some(&b'\r') {
        buffer.pop();
    }
    Ok((Some(end), bytes))
}

/// The fields of a line; their number must be equal to the number of columns in the header.
fn fields(line: &[u8], count: usize) -> Result<Vec<std::borrow::Cow<'_, str>>, String> {
    if line.len() > LINE_BYTES_MAX {
        return Err(format!("the line is longer than {LINE_BYTES_MAX} bytes"));
    }
    let text = str::from_utf8(line).map_err(|_| format!("{:?} is not UTF-8", shown(&String::from_utf8_lossy(line))))?;
    let fields = split_row(text).map_err(|wrong| format!("{:?}: {wrong}", shown(text)))?;
    if fields.len() != count {
        return Err(format!("{:?} has {} fields, the header has {count}", shown(text), fields.len()));
    }
    Ok(fields)
}

impl Layout for ObservationColumns {
    const HEADER: &'static str = "time,state,value";
    type Item = ObservationRow;

    fn new(header: &CsvHeader<'_>, rules: &RowRules) -> Result<(Self, Vec<usize>), RowError> {
        let [time_name, state_name, value_name] = &rules.columns;
        let value_name = value_name.as_deref();
        let time = header.column(time_name.as_deref().unwrap_or("time"))?;
        let state = header.column(state_name.as_deref().unwrap_or("state"))?;
        let has_value = value_name.is_some() || header.has("value");
        let dimensions = (!has_value && (header.has("x") || header.has("y"))).then_some(if header.has("z") {
            Dimensions::Three
        } else {
            Dimensions::Two
        });
        let (mut value, mut axes) = (None, [0; 3]);
        let mut used = vec![time, state];
        match dimensions {
            // Without a value, an event is one.
            None if rules.kind == RowKind::Events && !has_value => {}
            None => {
                let place = header.column(value_name.unwrap_or("value"))?;
                value = Some(place);
                used.push(place);
            }
            Some(dimensions) => {
                for (place, axis) in axes.iter_mut().zip(dimensions.axes()) {
                    *place = header.column(axis)?;
                    used.push(*place);
                }
            }
        }
        let (count, rules, times) = (header.names.len(), rules.clone(), FileTimes::default());
        Ok((Self { time, state, value, axes, dimensions, count, rules, times }, used))
    }

    fn row(
        &mut self,
        line: &[u8],
        RowPlace { number, line: line_number, has_end }: RowPlace,
    ) -> (ObservationRow, bool) {
        let mut row = ObservationRow {
            number,
            line: line_number,
            state: String::new(),
            time_nanos: 0,
            value: if self.rules.kind == RowKind::Samples { f64::NAN } else { f64::INFINITY },
            is_word: false,
            label: None,
            position: self.dimensions.and_then(|dimensions| Position::of(&[f64::NAN; 3][..dimensions.count()])),
            wrong: None,
            is_read: false,
            has_end,
        };
        let filled = self.fill(line, &mut row);
        let readable = filled.is_ok();
        row.is_read = readable;
        row.wrong = filled.unwrap_or_else(Some);
        (row, readable)
    }

    fn at(row: &ObservationRow) -> RowPlace {
        RowPlace { number: row.number, line: row.line, has_end: row.has_end }
    }
}

impl ObservationRow {
    /// The name under which it is sent: of a label its own, `STATE/LABEL`.
    #[must_use]
    pub fn name_sent(&self) -> Cow<'_, str> {
        match &self.label {
            Some(label) => format!("{}/{label}", self.state).into(),
            None => Cow::from(&self.state),
        }
    }
}

impl ObservationColumns {
    /// Whether the rows are positions.
    pub fn has_positions(&self) -> bool {
        self.dimensions.is_some()
    }

    /// Fills in the fields that can be read, the value last, so that it stays NaN if any other field is invalid.
    /// Returns why a readable row is no valid observation.
    fn fill(&mut self, line: &[u8], row: &mut ObservationRow) -> Result<Option<String>, String> {
        let ObservationColumns { time, state, value, axes, dimensions, count, .. } = *self;
        let fields = fields(line, count)?;
        let (chars, chars_max) = (fields[state].chars().count(), StateName::chars_max(&fields[state]));
        // A longer name does not fit into a message.
        if chars <= chars_max {
            row.state = fields[state].to_string();
        }
        row.time_nanos = self.times.read(self.rules.zone.as_ref(), &fields[state], &fields[time])?;
        if chars > chars_max {
            let name = shown(&fields[state]);
            return Err(format!("state {name:?} has {chars} characters: at most {chars_max} are allowed"));
        }
        if let Some(dimensions) = dimensions {
            let mut coordinates = Vec::with_capacity(axes.len());
            for (&place, axis) in axes.iter().zip(dimensions.axes()) {
                let number: f64 =
                    fields[place].parse().map_err(|_| format!("{axis} {:?} is not a number", shown(&fields[place])))?;
                coordinates.push(number + 0.0);
            }
            row.position = Position::of(&coordinates);
            let invalid_coordinate = row.position.and_then(|position| position.invalid_coordinate());
            return Ok(invalid_coordinate
                .map(|(axis, number)| format!("{axis} {number} is not {}", StateKind::Continuous.expected())));
        }
        let Some(value) = value else {
            row.value = 1.0;
            return Ok(None);
        };
        if self.rules.has_labels(&row.state) {
            let label = fields[value].as_ref();
            StateName::new(&row.state).and_then(|name| name.label(label)).map_err(|error| error.to_string())?;
            (row.label, row.value) = (Some(label.to_owned()), 1.0);
            return Ok(None);
        }
        let Some(number) = self.number(&fields[value], row)? else {
            row.value = f64::NAN;
            return Ok(None);
        };
        // Minus zero would change the checksum.
        row.value = number + 0.0;
        // The daemon refuses it, too, but its refusals are lost if the connection breaks.
        if (0.0..=1.0).contains(&number) {
            return Ok(None);
        }
        let text = shown(&fields[value]);
        Ok(Some(match row.is_word {
            true => format!("value {text:?} means {number}, which is not between 0 and 1"),
            false => format!("value {text} is not between 0 and 1"),
        }))
    }
}

impl ObservationColumns {
    /// The number that a text contains or means; `None`: no value is known.
    fn number(&self, text: &str, row: &mut ObservationRow) -> Result<Option<f64>, String> {
        let number: Option<f64> = text.parse().ok();
        if let Some(number) = number.filter(|number| !number.is_nan() || self.rules.kind == RowKind::Samples) {
            return Ok(Some(number));
        }
        match self.rules.meaning(text) {
            Some(Meaning::Value(number)) => {
                row.is_word = true;
                Ok(Some(number))
            }
            Some(Meaning::NoValue) if self.rules.kind != RowKind::Samples => Ok(None),
            Some(Meaning::NoValue) => Err(format!(
                "value {:?} means that there is no value: only changes and events may lack one (--changes, --events)",
                shown(text)
            )),
            None => Err(format!(
                "value {:?} is not a number: use 0, 1 or anything between, or give the meaning of the word, as in \
                 --values {}=1, or send labels with --kind categorical",
                shown(text),
                shown(text)
            )),
        }
    }
}

/// A reader that knows whether a complete line is buffered.
pub trait Buffered {
    /// Whether a line can be read without blocking.
    fn has_line(&self) -> bool;
}

impl<R> Buffered for io::BufReader<R> {
    fn has_line(&self) -> bool {
        self.buffer().contains(&b'\n')
    }
}

fn shown(text: &str) -> String {
    const CHARS_MAX: usize = 60;
    let mut shown: String = text.chars().take(CHARS_MAX).collect();
    if text.chars().nth(CHARS_MAX).is_some() {
        shown.push('…');
    }
    shown
}

/// All rows of a text that has no line cut off.
#[cfg(test)]
fn read_rows<L: Layout>(text: &str) -> Result<Vec<L::Item>, RowError> {
    let mut rows = RowReader::<_, L>::open(text.as_bytes())?;
    let mut read = Vec::new();
    while let Some(item) = rows.next_item()? {
        match item {
            RowItem::Row(row) => read.push(row),
            RowItem::Torn { line, text } => panic!("line {line}: {text}"),
        }
    }
    Ok(read)
}

#[cfg(test)]
mod tests;
