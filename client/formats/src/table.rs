//! Tables of results: aligned columns for people, CSV and JSON for programs.
//!
//! Invariant: programs get all columns, numbers in full, and times and durations in seconds. The aligned form is for
//! people: it rounds, shows times and durations as people read them, and leaves out columns without information. The
//! aligned form and JSON have no unprintable character of a text; CSV has texts as they are.

pub mod numbers;
mod times;

use std::{
    borrow::Cow,
    io::{self, Write},
};

use comfy_table::{CellAlignment, Table, presets};
use tidemap_model::time::format_secs;

pub use tidemap_map::name::printable;

pub use times::{TimeStyle, offset_text};

/// The format of results.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Aligned columns, for people.
    Table,
    /// An array of objects, one a line.
    Json,
    /// Comma-separated, with a header.
    Csv,
}

/// One value of a result.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// No value.
    Empty,
    /// Text.
    Text(String),
    /// A whole number.
    Count(u64),
    /// Any number.
    Number(f64),
    /// A duration in nanoseconds: seconds for programs; for people in a unit of its own.
    Secs(i64),
    /// A time, nanoseconds since 1970 UTC.
    Time(i64),
    /// Yes or no.
    Flag(bool),
    /// Several values: an array in JSON, else texts with a space between.
    List(Vec<Cell>),
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<u64> for Cell {
    fn from(count: u64) -> Self {
        Self::Count(count)
    }
}

impl From<u32> for Cell {
    fn from(count: u32) -> Self {
        Self::Count(count.into())
    }
}

impl From<f64> for Cell {
    fn from(number: f64) -> Self {
        Self::Number(number)
    }
}

impl Cell {
    /// A value that may be absent.
    pub fn maybe<T: Into<Self>>(value: Option<T>) -> Self {
        value.map_or(Self::Empty, Into::into)
    }

    /// A list of texts.
    pub fn texts<T: Into<String>>(texts: impl IntoIterator<Item = T>) -> Self {
        Self::List(texts.into_iter().map(|text| Self::Text(text.into())).collect())
    }

    /// A duration, or nothing.
    pub fn secs(nanos: Option<i64>) -> Self {
        nanos.map_or(Self::Empty, Self::Secs)
    }

    /// A time, or nothing.
    pub fn time(nanos: Option<i64>) -> Self {
        nanos.map_or(Self::Empty, Self::Time)
    }

    fn exact(&self) -> String {
        match self {
            Self::Empty => String::new(),
            Self::Text(text) => text.clone(),
            Self::Count(count) => count.to_string(),
            Self::Number(number) => number.to_string(),
            Self::Secs(nanos) | Self::Time(nanos) => format_secs(*nanos),
            Self::Flag(flag) => flag.to_string(),
            Self::List(cells) => cells.iter().map(Cell::exact).collect::<Vec<_>>().join(" "),
        }
    }

    fn rounded(&self) -> String {
        match self {
            Self::Number(number) => numbers::number(*number),
            Self::Secs(nanos) => numbers::period(*nanos as f64 / 1e9),
            Self::Flag(flag) => if *flag { "yes" } else { "no" }.to_owned(),
            _ => printable(&self.exact()).into_owned(),
        }
    }

    /// The value in JSON.
    pub fn json(&self) -> String {
        match self {
            Self::Empty => "null".to_owned(),
            Self::Text(text) => json_text(text),
            Self::Number(number) if !number.is_finite() => "null".to_owned(),
            Self::List(cells) => format!("[{}]", cells.iter().map(Cell::json).collect::<Vec<_>>().join(",")),
            _ => self.exact(),
        }
    }

    fn is_numeric(&self) -> bool {
        matches!(self, Self::Count(_) | Self::Number(_) | Self::Secs(_) | Self::Time(_))
    }
}

/// Maximum number of rows that are aligned together; a longer result is printed as several tables.
const TABLE_ROWS_MAX: usize = 10_000;

/// Minimum width of the columns of a live table.
const LIVE_WIDTH_MIN: usize = 14;

/// Writes a table of results row by row.
pub struct TableWriter<W: Write> {
    format: Format,
    columns: Vec<String>,
    writer: W,
    rows: u64,
    waiting: Vec<Vec<Cell>>,
    live: bool,
    times: TimeStyle,
    /// Columns that the aligned form leaves out.
    hidden: &'static [&'static str],
}

/// Writes a table whose rows are at hand.
///
/// # Errors
/// The writer fails.
pub fn write_rows<W: Write, S: AsRef<str>>(
    format: Format,
    columns: &[S],
    rows: impl IntoIterator<Item = Vec<Cell>>,
    writer: W,
) -> io::Result<()> {
    write_rows_at(format, &TimeStyle::Unix, columns, rows, writer)
}

/// Writes a table whose rows are at hand, with times in a style.
///
/// # Errors
/// The writer fails.
pub fn write_rows_at<W: Write, S: AsRef<str>>(
    format: Format,
    times: &TimeStyle,
    columns: &[S],
    rows: impl IntoIterator<Item = Vec<Cell>>,
    writer: W,
) -> io::Result<()> {
    let mut table = TableWriter::new(format, columns, writer).with_times(times);
    rows.into_iter().try_for_each(|row| table.row(row))?;
    table.finish()
}

/// Writes one row as an aligned table with a line for each column; values that are absent are left out.
///
/// # Errors
/// The writer fails.
pub fn write_upright<W: Write, S: AsRef<str>>(
    times: &TimeStyle,
    columns: &[S],
    row: &[Cell],
    mut writer: W,
) -> io::Result<()> {
    let mut lines = Vec::with_capacity(row.len());
    for (column, cell) in columns.iter().zip(row).filter(|(_, cell)| !cell.exact().is_empty()) {
        let mut header = printable(column.as_ref()).into_owned();
        let shown = times.column(&mut header, &[cell]).and_then(|texts| texts.into_iter().next());
        let header = if matches!(cell, Cell::Secs(_)) { without_unit(&header).to_owned() } else { header };
        lines.push((header, shown.unwrap_or_else(|| cell.rounded())));
    }
    let width = lines.iter().map(|(header, _)| header.chars().count()).max().unwrap_or(0);
    lines.iter().try_for_each(|(header, text)| writeln!(writer, "{header:<width$}  {text}"))
}

impl<W: Write> TableWriter<W> {
    /// A table that is written to `writer`.
    pub fn new<S: AsRef<str>>(format: Format, columns: &[S], writer: W) -> Self {
        let columns = columns.iter().map(|column| column.as_ref().to_owned()).collect();
        Self { format, columns, writer, rows: 0, waiting: Vec::new(), live: false, times: TimeStyle::Unix, hidden: &[] }
    }

    /// Shows the times of an aligned table in a style.
    pub fn with_times(self, times: &TimeStyle) -> Self {
        Self { times: times.clone(), ..self }
    }

    /// Leaves columns out of the aligned form.
    pub fn hiding(self, hidden: &'static [&'static str]) -> Self {
        Self { hidden, ..self }
    }

    /// A live table: the header is written at once and each row immediately. Columns are not aligned as a whole then,
    /// and in JSON each row has its own line.
    pub fn live(mut self) -> io::Result<Self> {
        self.live = true;
        match self.format {
            Format::Table => {
                let header: Vec<String> = self.columns.iter().map(|name| printable(name).into_owned()).collect();
                self.write_line(&header)?;
            }
            Format::Csv => self.write_header()?,
            Format::Json => {}
        }
        self.writer.flush()?;
        Ok(self)
    }

    /// Adds a row with a value for each column.
    pub fn row(&mut self, cells: Vec<Cell>) -> io::Result<()> {
        debug_assert_eq!(cells.len(), self.columns.len());
        match self.format {
            Format::Table if self.live => {
                let cells: Vec<String> = cells.iter().map(|cell| self.times.line(cell)).collect();
                self.write_line(&cells)?;
            }
            Format::Table => {
                self.waiting.push(cells);
                if self.waiting.len() == TABLE_ROWS_MAX {
                    self.write_table()?;
                }
            }
            Format::Csv => {
                if self.rows == 0 && !self.live {
                    self.write_header()?;
                }
                let fields: Vec<String> = cells.iter().map(Cell::exact).collect();
                self.write_csv(&fields)?;
            }
            Format::Json => {
                let separator: &[u8] = if self.live { b"," } else { b",\n " };
                self.writer.write_all(if self.rows == 0 { b"[" } else { separator })?;
                let object = object(self.columns.iter().map(String::as_str).zip(cells.iter().map(Cell::json)));
                self.writer.write_all(object.as_bytes())?;
                if self.live {
                    self.writer.write_all(b"\n")?;
                }
            }
        }
        self.rows += 1;
        if self.live { self.writer.flush() } else { Ok(()) }
    }

    /// Writes the rest; without this call the result is incomplete.
    pub fn finish(mut self) -> io::Result<()> {
        match self.format {
            Format::Table | Format::Csv if self.live => {}
            Format::Table if self.rows == 0 || !self.waiting.is_empty() => self.write_table()?,
            Format::Table => {}
            Format::Csv if self.rows == 0 => {
                self.write_header()?;
            }
            Format::Csv => {}
            Format::Json => self.writer.write_all(if self.rows == 0 { b"[]\n" } else { b"]\n" })?,
        }
        self.writer.flush()
    }

    /// Writes a line of a live table.
    fn write_line(&mut self, cells: &[String]) -> io::Result<()> {
        let cells: Vec<String> = cells.iter().map(|cell| format!("{cell:<LIVE_WIDTH_MIN$}")).collect();
        writeln!(self.writer, "{}", cells.join("  ").trim_end())
    }

    fn write_header(&mut self) -> io::Result<()> {
        let header = self.columns.clone();
        self.write_csv(&header)
    }

    fn write_csv(&mut self, fields: &[String]) -> io::Result<()> {
        let quoted = |field: &String| match field.contains([',', '"', '\n', '\r']) {
            true => format!("\"{}\"", field.replace('"', "\"\"")),
            false => field.clone(),
        };
        let fields: Vec<String> = fields.iter().map(quoted).collect();
        writeln!(self.writer, "{}", fields.join(","))
    }

    fn write_table(&mut self) -> io::Result<()> {
        let mut table = Table::new();
        table.load_preset(presets::NOTHING);
        let rows: Vec<Vec<Cell>> = self.waiting.drain(..).collect();
        let mut header = Vec::with_capacity(self.columns.len());
        let mut texts: Vec<Vec<String>> = vec![Vec::with_capacity(self.columns.len()); rows.len()];
        let mut numeric = Vec::with_capacity(self.columns.len());
        for (column, name) in self.columns.iter().enumerate() {
            let cells: Vec<&Cell> = rows.iter().map(|row| &row[column]).collect();
            let is_empty = !cells.is_empty() && cells.iter().all(|cell| **cell == Cell::Empty);
            if is_empty || self.hidden.contains(&name.as_str()) {
                continue;
            }
            let mut name = printable(name).into_owned();
            let times = self.times.column(&mut name, &cells);
            numeric.push(times.is_none() && cells.iter().any(|cell| cell.is_numeric()));
            let shown = times.unwrap_or_else(|| at_the_point(&cells));
            add_unit(&mut name);
            let are_durations = cells.iter().any(|cell| matches!(cell, Cell::Secs(_)));
            header.push(if are_durations { without_unit(&name).to_owned() } else { name });
            texts.iter_mut().zip(shown).for_each(|(row, text)| row.push(text));
        }
        table.set_header(&header);
        table.add_rows(texts);
        for (column, numeric) in table.column_iter_mut().zip(numeric) {
            column.set_padding((0, 2));
            if numeric {
                column.set_cell_alignment(CellAlignment::Right);
            }
        }
        self.writer.write_all(table.trim_fmt().as_bytes())?;
        self.writer.write_all(b"\n")
    }
}

/// People see the unit of a column whose name does not end in it; names are for programs.
fn add_unit(header: &mut String) {
    if ["x", "y", "z"].contains(&header.as_str()) {
        *header += " (m)";
    }
}

/// The name of a column of durations, which have their units.
fn without_unit(header: &str) -> &str {
    header.strip_suffix("_secs").unwrap_or(header)
}

/// The cells of a column as texts whose decimal points are one below the other, once they are aligned to the right.
fn at_the_point(cells: &[&Cell]) -> Vec<String> {
    let mut texts: Vec<String> = cells.iter().map(|cell| cell.rounded()).collect();
    // An exponent stands apart.
    let places_after_point = |(cell, text): (&&Cell, &String)| {
        let is_decimal = matches!(cell, Cell::Number(_)) && !text.contains('e');
        is_decimal.then(|| text.find('.').map_or(0, |point| text.len() - point))
    };
    let places: Vec<Option<usize>> = cells.iter().zip(&texts).map(places_after_point).collect();
    let widest = places.iter().copied().flatten().max().unwrap_or(0);
    for (text, places) in texts.iter_mut().zip(places) {
        text.extend(std::iter::repeat_n(' ', places.map_or(0, |places| widest - places)));
    }
    texts
}

/// A JSON object of names and JSON values.
pub fn object<'a>(members: impl Iterator<Item = (&'a str, String)>) -> String {
    let members: Vec<String> = members.map(|(name, value)| format!("{}:{value}", json_text(name))).collect();
    format!("{{{}}}", members.join(","))
}

/// A text in JSON, with escapes for all that is not printable.
fn json_text(text: &str) -> String {
    printable_json(&serde_json::Value::from(text).to_string())
}

/// JSON without unprintable characters, which only its texts can have: the same values.
#[must_use]
pub fn printable_json(json: &str) -> String {
    let mut escaped = String::with_capacity(json.len());
    for character in json.chars() {
        let mut buffer = [0; 4];
        match printable(character.encode_utf8(&mut buffer)) {
            Cow::Borrowed(text) => escaped.push_str(text),
            // Line ends between values stay.
            Cow::Owned(_) if character == '\n' => escaped.push('\n'),
            Cow::Owned(_) => {
                escaped.extend(character.encode_utf16(&mut [0; 2]).iter().map(|unit| format!("\\u{unit:04x}")));
            }
        }
    }
    escaped
}

#[cfg(test)]
mod tests;
