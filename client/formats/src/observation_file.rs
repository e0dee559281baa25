//! Files of observations: `time,state,value`, one row a line, with a header; or `time,state,x,y` and perhaps `z`, where
//! they are positions. Files of [`traversals`] are read alike.
//!
//! Invariant: the n-th row of a file has the number n, whether it can be read or not, and the same row always gives the
//! same observation; only so can an interrupted transfer go on where it was. No more than one line is in memory. Once
//! the file has ended it is not read again, whatever is appended meanwhile.

mod fields;
pub mod traversals;

use std::io::{self, BufRead};

use fields::split;
use tidemap_map::name::StateName;
use tidemap_map::time::parse_time;
use tidemap_model::{Dimensions, Position, StateKind};

/// Longest line. Three fields need far less; a file without line ends must not fill the memory.
const LINE_BYTES_MAX: usize = 64 * 1024;

/// Why a file cannot be read at all.
#[derive(Debug, thiserror::Error)]
pub enum RowError {
    /// Reading failed.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// Nothing there.
    #[error("it is empty: the first line must be the header {0}")]
    Empty(&'static str),
    /// A column is missing.
    #[error("column {column:?} is missing: the header must name {}, but is {header:?}", needed(.column))]
    MissingColumn {
        /// Which.
        column: &'static str,
        /// The header found, shortened.
        header: String,
    },
    /// A column appears twice.
    #[error("column {column:?} appears twice in the header {header:?}")]
    DoubleColumn {
        /// Which.
        column: &'static str,
        /// The header found, shortened.
        header: String,
    },
    /// There are positions where values are needed.
    #[error(
        "it has positions, columns x and y: use a file of single values, where each axis is a state, NAME/x and so on"
    )]
    Positions,
}

/// What a header has to name beside this column.
fn needed(column: &str) -> &'static str {
    match column {
        "x" | "y" => "time, state, x and y",
        "from" | "to" | "start" | "end" | "success" => "from, to, start, end and success",
        _ => "time, state and value",
    }
}

/// Where a row stands in its file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RowPlace {
    /// Its number, from 1; the header and blank lines do not count.
    pub number: u64,
    /// Its line, from 1.
    pub line: u64,
    /// Whether the line has an end. The last one of a file may lack it.
    pub has_end: bool,
}

/// A header.
pub struct CsvHeader<'a> {
    text: &'a str,
    /// Names of the columns, in small letters.
    names: Vec<String>,
}

impl CsvHeader<'_> {
    /// The place of a column that has to be there, once.
    fn column(&self, column: &'static str) -> Result<usize, RowError> {
        let mut places = self.names.iter().enumerate().filter(|(_, name)| *name == column).map(|(place, _)| place);
        match (places.next(), places.next()) {
            (Some(place), None) => Ok(place),
            (None, _) => Err(RowError::MissingColumn { column, header: shown(self.text) }),
            (Some(_), Some(_)) => Err(RowError::DoubleColumn { column, header: shown(self.text) }),
        }
    }

    fn has(&self, column: &str) -> bool {
        self.names.iter().any(|name| name == column)
    }
}

/// What the rows of a file are.
pub trait Layout: Sized {
    /// The usual header.
    const HEADER: &'static str;
    /// A row.
    type Record: std::fmt::Debug;

    /// From the header, with the places of the columns that are used.
    fn new(header: &CsvHeader<'_>) -> Result<(Self, Vec<usize>), RowError>;

    /// The row of a line, and whether all of it could be read.
    fn row(&self, line: &[u8], at: RowPlace) -> (Self::Record, bool);

    /// Where a row stands.
    fn at(row: &Self::Record) -> RowPlace;
}

/// A row of observations.
#[derive(Clone, Debug)]
pub struct ObservationRow {
    /// Its number, from 1; the header and blank lines do not count.
    pub number: u64,
    /// Its line, from 1.
    pub line: u64,
    /// Name of the state; empty where it could not be read.
    pub state: String,
    /// Time; 0 where it could not be read.
    pub time_nanos: i64,
    /// Value; NaN, which no daemon accepts, where anything of the row could not be read. One that is out of range is
    /// kept as it is: what is sent, and its checksum, is what the file says.
    pub value: f64,
    /// The position in a file of positions, where there is no value; as there, its coordinates are NaN where anything
    /// of the row could not be read.
    pub position: Option<Position>,
    /// What could not be read, or why it is no observation of a probability.
    pub wrong: Option<String>,
    /// Whether all of it could be read. What is wrong then is the value, and states of other kinds may have it.
    pub is_read: bool,
    /// Whether the line has an end. The last one of a file may lack it.
    pub has_end: bool,
}

/// What comes next in a file.
#[derive(Clone, Debug)]
pub enum RowItem<T = ObservationRow> {
    /// A row.
    Row(T),
    /// A last line without an end that makes no row, or that may be the beginning of another one: somebody is still
    /// writing it, or was interrupted.
    Torn {
        /// Its line.
        line: u64,
        /// Its text, shortened.
        text: String,
    },
}

/// Where the columns of observations are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ObservationColumns {
    time: usize,
    state: usize,
    value: usize,
    axes: [usize; 3],
    /// Of positions; `None` where there are values.
    dimensions: Option<Dimensions>,
    count: usize,
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
    /// The end was seen. Read on, a file that grows would go on in the middle of its last line.
    ended: bool,
    lines_must_end: bool,
}

/// How a line ended.
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
    pub fn open(mut reader: R) -> Result<Self, RowError> {
        let mut buffer = Vec::new();
        let (end, bytes) = read_line(&mut reader, &mut buffer)?;
        end.ok_or(RowError::Empty(L::HEADER))?;
        let text = String::from_utf8_lossy(&buffer);
        let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
        let names = split(text).unwrap_or_default().iter().map(|name| name.to_lowercase()).collect();
        let header = CsvHeader { text, names };
        let (layout, used) = L::new(&header)?;
        let ignored = (0..).zip(&header.names).filter(|(place, _)| !used.contains(place));
        let ignored = ignored.map(|(_, name)| name.clone()).collect();
        let ended = end == Some(LineEnd::EndOfFile);
        Ok(Self { reader, layout, ignored, line: 1, number: 0, bytes, buffer, ended, lines_must_end: false })
    }

    /// What its rows are.
    pub fn layout(&self) -> &L {
        &self.layout
    }

    /// Makes every last line without an end a torn one, even where it makes a row: for a source whose writer may be cut
    /// off anywhere, as 1 of 10 or 0 of 0.5.
    pub fn lines_must_end(mut self) -> Self {
        self.lines_must_end = true;
        self
    }

    /// ObservationColumns of the header that are not used.
    pub fn ignored(&self) -> &[String] {
        &self.ignored
    }

    /// Bytes read so far.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Whether the next row may have to be waited for.
    pub fn may_wait(&mut self) -> bool
    where
        R: Buffered,
    {
        !self.reader.has_line()
    }

    /// The next row; `None` at the end.
    pub fn next(&mut self) -> Result<Option<RowItem<L::Record>>, RowError> {
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

/// Reads a line into the buffer, without its end, and gives the bytes read; `None` at the end. Of a line that is too
/// long, only the beginning is kept.
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

/// The fields of a line, which are as many as those of the header.
fn fields(line: &[u8], count: usize) -> Result<Vec<std::borrow::Cow<'_, str>>, String> {
    if line.len() > LINE_BYTES_MAX {
        return Err(format!("the line is longer than {LINE_BYTES_MAX} bytes"));
    }
    let text = str::from_utf8(line).map_err(|_| format!("{:?} is not UTF-8", shown(&String::from_utf8_lossy(line))))?;
    let fields = split(text).map_err(|wrong| format!("{:?}: {wrong}", shown(text)))?;
    if fields.len() != count {
        return Err(format!("{:?} has {} fields, the header has {count}", shown(text), fields.len()));
    }
    Ok(fields)
}

impl Layout for ObservationColumns {
    const HEADER: &'static str = "time,state,value";
    type Record = ObservationRow;

    fn new(header: &CsvHeader<'_>) -> Result<(Self, Vec<usize>), RowError> {
        let (time, state) = (header.column("time")?, header.column("state")?);
        let dimensions = (!header.has("value") && (header.has("x") || header.has("y"))).then_some(if header.has("z") {
            Dimensions::Three
        } else {
            Dimensions::Two
        });
        let (mut value, mut axes) = (0, [0; 3]);
        let mut used = vec![time, state];
        match dimensions {
            None => {
                value = header.column("value")?;
                used.push(value);
            }
            Some(dimensions) => {
                for (place, axis) in axes.iter_mut().zip(dimensions.axes()) {
                    *place = header.column(axis)?;
                    used.push(*place);
                }
            }
        }
        Ok((Self { time, state, value, axes, dimensions, count: header.names.len() }, used))
    }

    fn row(&self, line: &[u8], RowPlace { number, line: line_number, has_end }: RowPlace) -> (ObservationRow, bool) {
        let mut row = ObservationRow {
            number,
            line: line_number,
            state: String::new(),
            time_nanos: 0,
            value: f64::NAN,
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

impl ObservationColumns {
    /// Whether the rows are positions.
    pub fn has_positions(&self) -> bool {
        self.dimensions.is_some()
    }

    /// Fills in what can be read; the value last, so that it stays NaN where anything else is wrong. Gives what is
    /// wrong with a row that can be read but that no daemon accepts.
    fn fill(&self, line: &[u8], row: &mut ObservationRow) -> Result<Option<String>, String> {
        let ObservationColumns { time, state, value, axes, dimensions, count } = *self;
        let fields = fields(line, count)?;
        let (chars, chars_max) = (fields[state].chars().count(), StateName::chars_max(&fields[state]));
        // A longer one cannot even be sent to be refused.
        if chars <= chars_max {
            row.state = fields[state].to_string();
        }
        row.time_nanos = parse_time(&fields[time]).map_err(|wrong| format!("time {wrong}"))?;
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
        let number: f64 = fields[value]
            .parse()
            .map_err(|_| format!("value {:?} is not a number: use 0, 1 or anything between", shown(&fields[value])))?;
        // Minus zero is zero to everybody but the checksum.
        row.value = number + 0.0;
        // The daemon says so, too, but its refusals are lost with a connection that breaks.
        let in_range = (0.0..=1.0).contains(&number);
        Ok((!in_range).then(|| format!("value {} is not between 0 and 1", shown(&fields[value]))))
    }
}

/// A reader that can tell whether a whole line is there already.
pub trait Buffered {
    /// Whether a line can be read without waiting for whoever writes it.
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

#[cfg(test)]
mod tests;
