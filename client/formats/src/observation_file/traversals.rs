//! CSV files of traversals: `from,to,start,end,success`, and optionally `action` and `reason`.
//!
//! Invariant: as for observations. A row that cannot be read becomes a traversal that ends before it starts, which the
//! daemon refuses. A row that can be read is not checked here.

use tidemap_map::name::NAME_CHARS_MAX;
use tidemap_model::time::parse_time;

use super::{CsvHeader, Layout, RowError, RowPlace, RowRules, fields, shown};

/// A row of traversals.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TraversalRow {
    /// The place of the row in the file.
    pub at: RowPlace,
    /// Name of the edge's start node.
    pub from: String,
    /// Name of the edge's end node.
    pub to: String,
    /// The action of the traversal; empty: the default action.
    pub action: String,
    /// The start of the traversal, nanoseconds UTC.
    pub start_nanos: i64,
    /// The time of success or failure, nanoseconds UTC.
    pub end_nanos: i64,
    /// Whether the traversal succeeded.
    pub success: bool,
    /// Why it failed.
    pub reason: String,
    /// Why the row could not be read.
    pub wrong: Option<String>,
}

/// The columns of traversals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TraversalColumns {
    from: usize,
    to: usize,
    action: Option<usize>,
    start: usize,
    end: usize,
    success: usize,
    reason: Option<usize>,
    count: usize,
}

/// Parses whether a traversal succeeded: true or false, or 1 or 0.
pub fn parse_success(text: &str) -> Result<bool, String> {
    match text.to_ascii_lowercase().as_str() {
        "true" | "1" => Ok(true),
        "false" | "0" => Ok(false),
        _ => Err(format!("{:?} is neither true nor false", shown(text))),
    }
}

impl Layout for TraversalColumns {
    const HEADER: &'static str = "from,to,start,end,success";
    type Item = TraversalRow;

    fn new(header: &CsvHeader<'_>, _: &RowRules) -> Result<(Self, Vec<usize>), RowError> {
        let maybe = |column: &'static str| header.has(column).then(|| header.column(column)).transpose();
        let columns = Self {
            from: header.column("from")?,
            to: header.column("to")?,
            action: maybe("action")?,
            start: header.column("start")?,
            end: header.column("end")?,
            success: header.column("success")?,
            reason: maybe("reason")?,
            count: header.names.len(),
        };
        let Self { from, to, action, start, end, success, reason, .. } = columns;
        let used = [from, to, start, end, success].into_iter().chain(action).chain(reason).collect();
        Ok((columns, used))
    }

    fn row(&mut self, line: &[u8], at: RowPlace) -> (TraversalRow, bool) {
        match self.read(line, at) {
            Ok(row) => (row, true),
            Err(wrong) => {
                let (from, to, action, reason) = Default::default();
                let (start_nanos, end_nanos, success, wrong) = (0, -1, false, Some(wrong));
                (TraversalRow { at, from, to, action, start_nanos, end_nanos, success, reason, wrong }, false)
            }
        }
    }

    fn at(row: &TraversalRow) -> RowPlace {
        row.at
    }
}

impl TraversalColumns {
    fn read(&self, line: &[u8], at: RowPlace) -> Result<TraversalRow, String> {
        let fields = fields(line, self.count)?;
        let name = |what: &str, place: usize| {
            let chars = fields[place].chars().count();
            if chars > NAME_CHARS_MAX {
                let name = shown(&fields[place]);
                return Err(format!("{what} {name:?} has {chars} characters: at most {NAME_CHARS_MAX} are allowed"));
            }
            Ok(fields[place].to_string())
        };
        let time = |what: &str, place: usize| parse_time(&fields[place]).map_err(|wrong| format!("{what} {wrong}"));
        Ok(TraversalRow {
            at,
            from: name("from", self.from)?,
            to: name("to", self.to)?,
            action: self.action.map_or_else(|| Ok(String::new()), |place| name("action", place))?,
            start_nanos: time("start", self.start)?,
            end_nanos: time("end", self.end)?,
            success: parse_success(&fields[self.success]).map_err(|wrong| format!("success {wrong}"))?,
            reason: self.reason.map_or_else(String::new, |place| fields[place].to_string()),
            wrong: None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observation_file::read_rows;

    fn read(text: &str) -> Result<Vec<TraversalRow>, RowError> {
        read_rows::<TraversalColumns>(text)
    }

    #[test]
    fn columns_come_in_any_order_and_two_are_optional() -> Result<(), RowError> {
        let text = "from,to,action,start,end,success,reason\nHall,Lab,door,10,12.5,False,\"stuck, again\"\n";
        let rows = read(text)?;
        let expected = TraversalRow {
            at: RowPlace { number: 1, line: 2, has_end: true },
            from: "Hall".to_owned(),
            to: "Lab".to_owned(),
            action: "door".to_owned(),
            start_nanos: 10_000_000_000,
            end_nanos: 12_500_000_000,
            success: false,
            reason: "stuck, again".to_owned(),
            wrong: None,
        };
        assert_eq!(rows[0], expected);
        let rows = read("Success,end,start,robot,to,from\n1,12.5,10,r1,Lab,Hall\n")?;
        let usual = TraversalRow { action: String::new(), success: true, reason: String::new(), ..expected };
        assert_eq!(rows[0], usual);
        Ok(())
    }

    #[test]
    fn unreadable_rows_have_an_error() -> Result<(), RowError> {
        let long = "n".repeat(129);
        for (row, words) in [
            ("Hall,Lab,10,12", "has 4 fields, the header has 5"),
            ("Hall,Lab,soon,12,1", "start"),
            ("Hall,Lab,10,,1", "end"),
            ("Hall,Lab,10,12,yes", "success \"yes\" is neither true nor false"),
            (&format!("{long},Lab,10,12,1"), "from \"nnn"),
        ] {
            let rows = read(&format!("from,to,start,end,success\n{row}\n"))?;
            let wrong = rows[0].wrong.as_ref().expect("wrong");
            assert!(wrong.contains(words), "{wrong}");
            assert!(rows[0].end_nanos < rows[0].start_nanos);
        }
        Ok(())
    }

    #[test]
    fn an_invalid_header_is_quoted() {
        let error = |text: &str| read(text).expect_err("wrong").to_string();
        assert!(error("").contains("from,to,start,end,success"));
        let text = error("from,to,start,end\n");
        assert!(text.contains("\"success\"") && text.contains("from, to, start, end and success"), "{text}");
        assert!(error("from,to,from,start,end,success\n").contains("twice"));
    }
}
