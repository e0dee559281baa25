//! CSV files of sightings: `time,place,seen`, and optionally `out_of_view`, and `from_m` and `to_m` for parts of edges.
//! Names of landmarks are separated by `;`.
//!
//! Invariant: as for observations. A row that cannot be read becomes a sighting before 1970, which the daemon refuses.
//! A row that can be read is not checked here.

use tidemap_model::time::parse_time;

use super::{CsvHeader, Layout, RowError, RowPlace, RowRules, fields, shown};

/// Separates the names of landmarks in a field.
const SEPARATOR: char = ';';

/// A row of sightings.
#[derive(Clone, Debug, PartialEq)]
pub struct SightingRow {
    /// The place of the row in the file.
    pub at: RowPlace,
    /// The node, or the edge as `A/B[/ACTION]`.
    pub place: String,
    /// Part of the edge, metres from its beginning.
    pub part_m: [Option<f64>; 2],
    /// The time of the sighting, nanoseconds UTC.
    pub time_nanos: i64,
    /// Names of the landmarks that it saw.
    pub seen: Vec<String>,
    /// Names of those out of view.
    pub out_of_view: Vec<String>,
    /// Why the row could not be read.
    pub wrong: Option<String>,
}

/// The columns of sightings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SightingColumns {
    time: usize,
    place: usize,
    seen: usize,
    out_of_view: Option<usize>,
    part: [Option<usize>; 2],
    count: usize,
}

impl Layout for SightingColumns {
    const HEADER: &'static str = "time,place,seen";
    type Item = SightingRow;

    fn new(header: &CsvHeader<'_>, _: &RowRules) -> Result<(Self, Vec<usize>), RowError> {
        let maybe = |column: &'static str| header.has(column).then(|| header.column(column)).transpose();
        let columns = Self {
            time: header.column("time")?,
            place: header.column("place")?,
            seen: header.column("seen")?,
            out_of_view: maybe("out_of_view")?,
            part: [maybe("from_m")?, maybe("to_m")?],
            count: header.names.len(),
        };
        let Self { time, place, seen, out_of_view, part, .. } = columns;
        let used = [time, place, seen].into_iter().chain(out_of_view).chain(part.into_iter().flatten()).collect();
        Ok((columns, used))
    }

    fn row(&mut self, line: &[u8], at: RowPlace) -> (SightingRow, bool) {
        match self.read(line, at) {
            Ok(row) => (row, true),
            Err(wrong) => {
                let (place, part_m, seen, out_of_view) = Default::default();
                (SightingRow { at, place, part_m, time_nanos: -1, seen, out_of_view, wrong: Some(wrong) }, false)
            }
        }
    }

    fn at(row: &SightingRow) -> RowPlace {
        row.at
    }
}

fn names(field: &str) -> Vec<String> {
    field.split(SEPARATOR).map(str::trim).filter(|name| !name.is_empty()).map(str::to_owned).collect()
}

fn metres(what: &str, field: &str) -> Result<Option<f64>, String> {
    let text = field.trim();
    if text.is_empty() {
        return Ok(None);
    }
    text.parse().map(Some).map_err(|_| format!("{what} {:?} is not a number of metres", shown(text)))
}

impl SightingColumns {
    fn read(&self, line: &[u8], at: RowPlace) -> Result<SightingRow, String> {
        let fields = fields(line, self.count)?;
        let part = |what: &str, column: Option<usize>| column.map_or(Ok(None), |column| metres(what, &fields[column]));
        Ok(SightingRow {
            at,
            place: fields[self.place].trim().to_owned(),
            part_m: [part("from_m", self.part[0])?, part("to_m", self.part[1])?],
            time_nanos: parse_time(&fields[self.time]).map_err(|wrong| format!("time {wrong}"))?,
            seen: names(&fields[self.seen]),
            out_of_view: self.out_of_view.map_or_else(Vec::new, |column| names(&fields[column])),
            wrong: None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observation_file::read_rows;

    fn read(text: &str) -> Result<Vec<SightingRow>, RowError> {
        read_rows::<SightingColumns>(text)
    }

    #[test]
    fn names_are_separated_and_columns_come_in_any_order() -> Result<(), RowError> {
        let rows = read("place,seen,out_of_view,from_m,to_m,time\nhall/lab,12; 7,,1.5,,10\nhall,,3,,,11\n")?;
        let row = |number, line| RowPlace { number, line, has_end: true };
        let first = SightingRow {
            at: row(1, 2),
            place: "hall/lab".to_owned(),
            part_m: [Some(1.5), None],
            time_nanos: 10_000_000_000,
            seen: vec!["12".to_owned(), "7".to_owned()],
            out_of_view: vec![],
            wrong: None,
        };
        let second = SightingRow {
            at: row(2, 3),
            place: "hall".to_owned(),
            part_m: [None, None],
            time_nanos: 11_000_000_000,
            seen: vec![],
            out_of_view: vec!["3".to_owned()],
            wrong: None,
        };
        assert_eq!(rows, [first, second]);
        Ok(())
    }

    #[test]
    fn what_cannot_be_read_gives_the_reason() -> Result<(), RowError> {
        let wrong = |text: &str| -> Result<Option<String>, RowError> { Ok(read(text)?.remove(0).wrong) };
        assert_eq!(
            wrong("time,place,seen,from_m\n1,a/b,,x\n")?.as_deref(),
            Some("from_m \"x\" is not a number of metres")
        );
        assert!(wrong("time,place,seen\nnever,a,\n")?.is_some_and(|wrong| wrong.starts_with("time ")));
        assert!(read("time,place\n1,a\n").is_err());
        Ok(())
    }
}
