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

/// A period for people: `7 d`, `24 h`, `45 min`. Up to 36 hours it is in hours.
pub(crate) fn period(secs: f64) -> String {
    let (value, unit) = match secs {
        secs if secs > 36.0 * 3600.0 => (secs / 86_400.0, "d"),
        secs if secs >= 3600.0 => (secs / 3600.0, "h"),
        secs if secs >= 60.0 => (secs / 60.0, "min"),
        secs => (secs, "s"),
    };
    let text = format!("{value:.2}");
    format!("{} {unit}", text.trim_end_matches('0').trim_end_matches('.'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn periods_are_readable() {
        for (secs, text) in [
            (604_800.0, "7 d"),
            (302_400.0, "3.5 d"),
            (86_400.0, "24 h"),
            (100_800.0, "28 h"),
            (43_200.0, "12 h"),
            (60_480.0, "16.8 h"),
            (86_400.0 / 7.0, "3.43 h"),
            (1_800.0, "30 min"),
            (90.0, "1.5 min"),
            (30.0, "30 s"),
        ] {
            assert_eq!(period(secs), text);
        }
    }
}
