//! The refused rows of a file, in a file of their own, where they are corrected and from which they are sent.
//!
//! Invariant: a row there is a row of the file as it was, behind its line and the reason. An existing file is never
//! written over, because it may hold corrections.

use std::{
    collections::BTreeMap,
    fs::File,
    io::{BufRead as _, BufWriter, Write as _},
    path::{Path, PathBuf},
};

use anyhow::Context as _;

use super::opening;
use crate::commands::usage;

/// Maximum number of rows; a file with more of them is probably another kind of file.
const ROWS_MAX: usize = 1_000_000;
/// The columns that are put before the columns of the file.
const NOTES: &str = "line,refused,";

/// Collects the refused rows of a file.
#[derive(Debug)]
pub(crate) struct RefusedRows {
    source: PathBuf,
    target: PathBuf,
    /// Reasons by line.
    reasons: BTreeMap<u64, String>,
    /// Number of rows that are not kept.
    lost: u64,
}

impl RefusedRows {
    /// Rows of `source`, to be written to `target`.
    ///
    /// # Errors
    /// The source cannot be read again, or the target exists.
    pub(crate) fn new(source: &Path, target: &Path) -> anyhow::Result<Self> {
        let shown = target.display();
        if source.as_os_str() == "-" {
            return Err(usage("--refused reads the file again, so it needs a file: stdin is read only once"));
        }
        if target.exists() {
            return Err(usage(format!("--refused {shown}: it exists, and may hold corrections: name a new file")));
        }
        let (source, target) = (source.to_owned(), target.to_owned());
        Ok(Self { source, target, reasons: BTreeMap::new(), lost: 0 })
    }

    /// Takes a refused row.
    pub(crate) fn add(&mut self, line: Option<u64>, reason: &str) {
        match line {
            Some(line) if self.reasons.len() < ROWS_MAX => {
                self.reasons.entry(line).or_insert_with(|| reason.to_owned());
            }
            _ => self.lost += 1,
        }
    }

    /// Counts rows whose lines are not known.
    pub(crate) fn lose(&mut self, rows: u64) {
        self.lost += rows;
    }

    /// Writes the rows, if there are any, and returns advice about them. `command` sends a file.
    pub(crate) fn write(&self, command: &str) -> anyhow::Result<Option<String>> {
        if self.reasons.is_empty() && self.lost == 0 {
            return Ok(None);
        }
        let shown = self.target.display();
        if !self.reasons.is_empty() {
            self.copy().with_context(|| format!("--refused {shown}"))?;
        }
        let lost = match self.lost {
            0 => String::new(),
            lost => format!("; {lost} more are not there, because the connection broke or there are too many"),
        };
        let rows = match self.reasons.len() {
            1 => "refused row".to_owned(),
            rows => format!("{rows} refused rows"),
        };
        Ok(Some(format!(
            "{shown} has the {rows}{lost}. Correct the rows in that file. Then send that file, not the original: {command} {shown}"
        )))
    }

    fn copy(&self) -> anyhow::Result<()> {
        let (mut source, _) = opening::open(&self.source)?;
        let mut target = BufWriter::new(File::create_new(&self.target)?);
        let (mut number, mut line, mut has_notes) = (0_u64, Vec::new(), false);
        loop {
            line.clear();
            if source.read_until(b'\n', &mut line)? == 0 {
                break;
            }
            number += 1;
            let mut row = line.trim_ascii_end();
            if number == 1 {
                row = row.strip_prefix(b"\xef\xbb\xbf".as_slice()).unwrap_or(row);
                has_notes = row.starts_with(NOTES.as_bytes());
            }
            if has_notes {
                row = without_notes(row);
            }
            if number == 1 {
                target.write_all(NOTES.as_bytes())?;
            } else if let Some(reason) = self.reasons.get(&number) {
                write!(target, "{number},\"{}\",", reason.replace('"', "\"\"").replace(['\n', '\r'], " "))?;
            } else {
                continue;
            }
            target.write_all(row)?;
            target.write_all(b"\n")?;
        }
        target.flush()?;
        Ok(())
    }
}

/// A row of an earlier file of refused rows as it was before.
fn without_notes(row: &[u8]) -> &[u8] {
    let comma = |bytes: &[u8]| bytes.iter().position(|&byte| byte == b',');
    let Some(after_line) = comma(row).map(|end| &row[end + 1..]) else { return row };
    let Some(quoted) = after_line.strip_prefix(b"\"") else {
        return comma(after_line).map_or(row, |end| &after_line[end + 1..]);
    };
    let mut at = 0;
    while let Some(quote) = quoted[at..].iter().position(|&byte| byte == b'"') {
        at += quote + 1;
        match quoted.get(at) {
            Some(b'"') => at += 1,
            Some(b',') => return &quoted[at + 1..],
            _ => return row,
        }
    }
    row
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn of_rows(source: &str, reasons: &[(u64, &str)]) -> anyhow::Result<String> {
        let folder = tempfile::tempdir()?;
        let (from, to) = (folder.path().join("a.csv"), folder.path().join("b.csv"));
        fs::write(&from, source)?;
        let mut refused = RefusedRows::new(&from, &to)?;
        for &(line, reason) in reasons {
            refused.add(Some(line), reason);
        }
        let message = refused.write("tidemap observe home")?.unwrap_or_default();
        let rows = if reasons.len() == 1 { "the refused row." } else { "the 2 refused rows." };
        assert!(message.contains(rows), "{message}");
        assert!(RefusedRows::new(&from, &to).is_err(), "it exists now");
        Ok(fs::read_to_string(to)?)
    }

    #[test]
    fn rows_are_as_they_were_behind_line_and_reason() -> anyhow::Result<()> {
        let text = "\u{feff}time,state,value\r\n1,door,0\r\n\r\n2,\"a, b\",x\r\n3,door\r\n";
        let written = of_rows(text, &[(4, "value \"x\" is not a number"), (5, "2 fields")])?;
        let expected = "line,refused,time,state,value\n4,\"value \"\"x\"\" is not a number\",2,\"a, b\",x\n\
                        5,\"2 fields\",3,door\n";
        assert_eq!(written, expected);
        // A row that is still wrong in that file gets its new line and reason, and no second pair of columns.
        assert_eq!(
            of_rows(expected, &[(3, "still, \"2\" fields")])?,
            "line,refused,time,state,value\n3,\"still, \"\"2\"\" fields\",3,door\n"
        );
        Ok(())
    }

    #[test]
    fn without_refused_rows_there_is_no_file() -> anyhow::Result<()> {
        let folder = tempfile::tempdir()?;
        let target = folder.path().join("b.csv");
        assert_eq!(RefusedRows::new(Path::new("a.csv"), &target)?.write("")?, None);
        assert!(!target.exists());
        assert!(RefusedRows::new(Path::new("-"), &target).is_err());
        Ok(())
    }
}
