//! Results on stdout, in the format that the user asked for.
//!
//! Invariant: nothing else writes to stdout.

use std::io::{self, BufWriter, IsTerminal as _};

use clap::{
    ValueEnum,
    builder::{PossibleValue, PossibleValuesParser, TypedValueParser},
};
use tidemap_formats::table::Format;

/// How tables show times.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum TimeArg {
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
pub(crate) fn default_format() -> Format {
    if io::stdout().is_terminal() { Format::Table } else { Format::Csv }
}

/// Reads `--output`.
pub(crate) fn format_parser() -> impl TypedValueParser<Value = Format> {
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

/// Where results go.
pub(crate) fn stdout() -> BufWriter<io::Stdout> {
    BufWriter::with_capacity(64 * 1024, io::stdout())
}
