//! Results on stdout, in the format that the user chose.
//!
//! Invariant: nothing else writes to stdout. Unprintable characters, such as an ESC in a name of a recording, do not
//! reach a terminal; files and other programs get CSV as it is.

use std::{
    borrow::Cow,
    io::{self, BufWriter, IsTerminal as _, Write},
};

use clap::{
    ValueEnum,
    builder::{PossibleValue, PossibleValuesParser, TypedValueParser},
};
use tidemap_formats::table::{Format, printable};

/// How tables show times.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TimeArg {
    /// Day and clock in the time zone of the map
    Local,
    /// Day and clock in UTC
    Utc,
    /// Unix seconds, as in CSV and JSON
    Unix,
    /// Nanoseconds since 1970
    Ns,
}

/// A table on a terminal, CSV otherwise.
pub fn default_format() -> Format {
    if io::stdout().is_terminal() { Format::Table } else { Format::Csv }
}

/// Reads `--output`.
pub fn format_parser() -> impl TypedValueParser<Value = Format> {
    let values = [
        PossibleValue::new("table").help("Aligned columns, for people"),
        PossibleValue::new("json").help("An array of objects, one a line"),
        PossibleValue::new("csv").help("Comma-separated, with a header"),
    ];
    PossibleValuesParser::new(values).map(|name| match name.as_str() {
        "table" => Format::Table,
        "json" => Format::Json,
        _ => Format::Csv,
    })
}

/// The destination of results.
pub type Stdout = BufWriter<Results<io::Stdout>>;

/// Stdout, for results.
pub fn stdout() -> Stdout {
    let stdout = io::stdout();
    let is_terminal = stdout.is_terminal();
    BufWriter::with_capacity(64 * 1024, Results { writer: stdout, is_terminal, cut: Vec::new() })
}

/// Writes a text where results go.
///
/// # Errors
/// Stdout cannot be written.
pub fn print(text: &str) -> io::Result<()> {
    let mut out = stdout();
    out.write_all(text.as_bytes())?;
    out.flush()
}

/// A text as a terminal may show it: unprintable characters except line ends and tabulators are escaped.
pub fn for_terminal(text: &str) -> Cow<'_, str> {
    if !text.contains(['\n', '\t']) {
        return printable(text);
    }
    let pieces = text.split_inclusive(['\n', '\t']);
    let shown = pieces.map(|piece| match piece.strip_suffix(['\n', '\t']) {
        Some(rest) => format!("{}{}", printable(rest), &piece[rest.len()..]),
        None => printable(piece).into_owned(),
    });
    Cow::Owned(shown.collect())
}

/// A writer of results, which may be a terminal.
#[derive(Debug)]
pub struct Results<W> {
    writer: W,
    is_terminal: bool,
    /// The beginning of a character whose rest was not written yet.
    cut: Vec<u8>,
}

impl<W: Write> Write for Results<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if !self.is_terminal {
            return self.writer.write(bytes);
        }
        self.cut.extend_from_slice(bytes);
        // A character has at most four bytes; a byte that cannot begin one is shown as the replacement character.
        let whole = match std::str::from_utf8(&self.cut) {
            Err(error) if error.error_len().is_none() => error.valid_up_to(),
            _ => self.cut.len(),
        };
        let rest = self.cut.split_off(whole);
        let text = std::mem::replace(&mut self.cut, rest);
        self.writer.write_all(for_terminal(&String::from_utf8_lossy(&text)).as_bytes())?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(is_terminal: bool, pieces: &[&[u8]]) -> Vec<u8> {
        let mut results = Results { writer: Vec::new(), is_terminal, cut: Vec::new() };
        pieces.iter().try_for_each(|piece| results.write_all(piece)).expect("a vector takes all");
        results.writer
    }

    #[test]
    fn a_terminal_gets_no_control_characters_and_a_file_gets_all() {
        let text = "topic\tn\n/a\u{1b}[2J\u{202e}b\u{9b}é\r\n";
        let shown = "topic\tn\n/a\\u{1b}[2J\\u{202e}b\\u{9b}é\\u{d}\n";
        for cut in 0..text.len() {
            let (before, after) = text.as_bytes().split_at(cut);
            assert_eq!(String::from_utf8_lossy(&written(true, &[before, after])), shown, "cut at {cut}");
            assert_eq!(written(false, &[before, after]), text.as_bytes());
        }
        assert_eq!(written(true, &[b"a\xffb"]), "a\u{fffd}b".as_bytes());
    }
}
