//! Files of observations: `time,state,value`, one row a line, with a header; or `time,state,x,y` and perhaps `z`, where
//! they are positions.
//!
//! Invariant: the n-th row of a file has the number n, whether it can be read or not, and the same row always gives the
//! same observation; only so can an interrupted transfer go on where it was. No more than one line is in memory. Once the
//! file has ended it is not read again, whatever is appended meanwhile.

mod fields;

use std::io::{self, BufRead};

use fields::split;
use tidemap::time::parse_time;
use tidemap_model::{Dimensions, Position, StateKind};

/// Longest line. Three fields need far less; a file without line ends must not fill the memory.
const LINE_BYTES_MAX: usize = 64 * 1024;
/// Most characters of a state's name; a longer one cannot even be sent to be refused.
const STATE_CHARS_MAX: usize = 128;

/// Why a file cannot be read at all.
#[derive(Debug, thiserror::Error)]
pub enum RowsError {
    /// Reading failed.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// Nothing there.
    #[error("it is empty: the first line must be the header time,state,value")]
    Empty,
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
    if matches!(column, "x" | "y") { "time, state, x and y" } else { "time, state and value" }
}

/// A row of the file.
#[derive(Clone, Debug)]
pub struct Row {
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
    /// The position in a file of positions, where there is no value; as there, its coordinates are NaN where anything of the
    /// row could not be read.
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
pub enum Item {
    /// A row.
    Row(Row),
    /// A last line without an end that makes no row, or that may be the beginning of another one: somebody is still
    /// writing it, or was interrupted.
    Torn {
        /// Its line.
        line: u64,
        /// Its text, shortened.
        text: String,
    },
}

/// Where the columns are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Columns {
    time: usize,
    state: usize,
    value: usize,
    axes: [usize; 3],
    /// Of positions; `None` where there are values.
    dimensions: Option<Dimensions>,
    count: usize,
}

/// Reads a file of observations row by row.
#[derive(Debug)]
pub struct Rows<R> {
    reader: R,
    columns: Columns,
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

impl<R: BufRead> Rows<R> {
    /// Reads the header.
    pub fn new(reader: R) -> Result<Self, RowsError> {
        let columns = Columns { time: 0, state: 0, value: 0, axes: [0; 3], dimensions: None, count: 0 };
        let mut rows = Self {
            reader,
            columns,
            ignored: Vec::new(),
            line: 0,
            number: 0,
            bytes: 0,
            buffer: Vec::new(),
            ended: false,
            lines_must_end: false,
        };
        rows.read_line()?.ok_or(RowsError::Empty)?;
        let text = String::from_utf8_lossy(&rows.buffer);
        let header = text.strip_prefix('\u{feff}').unwrap_or(&text);
        let names: Vec<String> = split(header).unwrap_or_default().iter().map(|name| name.to_lowercase()).collect();
        let column = |column: &'static str| {
            let mut places = names.iter().enumerate().filter(|(_, name)| *name == column).map(|(place, _)| place);
            match (places.next(), places.next()) {
                (Some(place), None) => Ok(place),
                (None, _) => Err(RowsError::MissingColumn { column, header: shown(header) }),
                (Some(_), Some(_)) => Err(RowsError::DoubleColumn { column, header: shown(header) }),
            }
        };
        let (time, state) = (column("time")?, column("state")?);
        let has = |name: &str| names.iter().any(|column| column == name);
        let dimensions = (!has("value") && (has("x") || has("y"))).then_some(if has("z") {
            Dimensions::Three
        } else {
            Dimensions::Two
        });
        let (mut value, mut axes) = (0, [0; 3]);
        let mut used = vec![time, state];
        match dimensions {
            None => {
                value = column("value")?;
                used.push(value);
            }
            Some(dimensions) => {
                for (place, axis) in axes.iter_mut().zip(dimensions.axes()) {
                    *place = column(axis)?;
                    used.push(*place);
                }
            }
        }
        rows.columns = Columns { time, state, value, axes, dimensions, count: names.len() };
        rows.ignored = (0..).zip(&names).filter(|(i, _)| !used.contains(i)).map(|(_, name)| name.clone()).collect();
        Ok(rows)
    }

    /// Makes every last line without an end a torn one, even where it makes a row: for a source whose writer may be cut
    /// off anywhere, as 1 of 10 or 0 of 0.5.
    pub fn lines_must_end(mut self) -> Self {
        self.lines_must_end = true;
        self
    }

    /// Refuses a file of positions.
    pub fn values_only(self) -> Result<Self, RowsError> {
        if self.has_positions() { Err(RowsError::Positions) } else { Ok(self) }
    }

    /// Whether it is a file of positions.
    pub fn has_positions(&self) -> bool {
        self.columns.dimensions.is_some()
    }

    /// Columns of the header that are not used.
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
    pub fn next(&mut self) -> Result<Option<Item>, RowsError> {
        loop {
            if self.ended {
                return Ok(None);
            }
            let Some(end) = self.read_line()? else { return Ok(None) };
            if self.buffer.iter().all(|byte| byte.is_ascii_whitespace()) {
                continue;
            }
            let (mut row, readable) = self.row(self.number + 1);
            row.has_end = end == LineEnd::Newline;
            if !row.has_end && (self.lines_must_end || !readable) {
                return Ok(Some(Item::Torn { line: self.line, text: shown(&String::from_utf8_lossy(&self.buffer)) }));
            }
            self.number += 1;
            return Ok(Some(Item::Row(row)));
        }
    }

    /// Reads a line into the buffer, without its end. Of a line that is too long, only the beginning is kept.
    fn read_line(&mut self) -> io::Result<Option<LineEnd>> {
        self.buffer.clear();
        let mut started = false;
        let end = loop {
            let available = match self.reader.fill_buf() {
                Ok(available) => available,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) => return Err(error),
            };
            if available.is_empty() {
                self.ended = true;
                break LineEnd::EndOfFile;
            }
            started = true;
            let newline = available.iter().position(|&byte| byte == b'\n');
            let piece = &available[..newline.unwrap_or(available.len())];
            let room = (LINE_BYTES_MAX + 1).saturating_sub(self.buffer.len());
            self.buffer.extend_from_slice(&piece[..piece.len().min(room)]);
            let consumed = piece.len() + usize::from(newline.is_some());
            self.reader.consume(consumed);
            self.bytes += consumed as u64;
            if newline.is_some() {
                break LineEnd::Newline;
            }
        };
        if !started {
            return Ok(None);
        }
        self.line += 1;
        if self.buffer.last() == Some(&b'\r') {
            self.buffer.pop();
        }
        Ok(Some(end))
    }

    /// The row in the buffer, and whether all of it could be read.
    fn row(&self, number: u64) -> (Row, bool) {
        let mut row = Row {
            number,
            line: self.line,
            state: String::new(),
            time_nanos: 0,
            value: f64::NAN,
            position: self.columns.dimensions.and_then(|dimensions| Position::of(&[f64::NAN; 3][..dimensions.count()])),
            wrong: None,
            is_read: false,
            has_end: true,
        };
        let filled = self.fill(&mut row);
        let readable = filled.is_ok();
        row.is_read = readable;
        row.wrong = filled.unwrap_or_else(Some);
        (row, readable)
    }

    /// Fills in what can be read; the value last, so that it stays NaN where anything else is wrong. Gives what is wrong
    /// with a row that can be read but that no daemon accepts.
    fn fill(&self, row: &mut Row) -> Result<Option<String>, String> {
        if self.buffer.len() > LINE_BYTES_MAX {
            return Err(format!("the line is longer than {LINE_BYTES_MAX} bytes"));
        }
        let text = str::from_utf8(&self.buffer)
            .map_err(|_| format!("{:?} is not UTF-8", shown(&String::from_utf8_lossy(&self.buffer))))?;
        let fields = split(text).map_err(|wrong| format!("{:?}: {wrong}", shown(text)))?;
        let Columns { time, state, value, axes, dimensions, count } = self.columns;
        if fields.len() != count {
            return Err(format!("{:?} has {} fields, the header has {count}", shown(text), fields.len()));
        }
        let chars = fields[state].chars().count();
        if chars <= STATE_CHARS_MAX {
            row.state = fields[state].to_string();
        }
        row.time_nanos = parse_time(&fields[time]).map_err(|wrong| format!("time {wrong}"))?;
        if chars > STATE_CHARS_MAX {
            let name = shown(&fields[state]);
            return Err(format!("state {name:?} has {chars} characters: at most {STATE_CHARS_MAX} are allowed"));
        }
        if let Some(dimensions) = dimensions {
            let mut coordinates = Vec::with_capacity(axes.len());
            for (&place, axis) in axes.iter().zip(dimensions.axes()) {
                let number: f64 =
                    fields[place].parse().map_err(|_| format!("{axis} {:?} is not a number", shown(&fields[place])))?;
                coordinates.push(number + 0.0);
            }
            row.position = Position::of(&coordinates);
            let misfit = row.position.and_then(|position| position.misfit());
            return Ok(
                misfit.map(|(axis, number)| format!("{axis} {number} is not {}", StateKind::Continuous.expected()))
            );
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
