//! Reads the rows of a file, or of stdin, on a thread of its own, and reports invalid rows.
//!
//! Invariant: the memory for rows that are read in advance is bounded, whatever the size of the file. A row that
//! arrives on stdin is passed on at once.

use std::{
    collections::{HashMap, HashSet},
    io::{BufReader, Read},
    path::Path,
    thread,
};

use anyhow::Context as _;
use tokio::sync::mpsc;

pub(crate) use super::opening::display_name;
use super::{opening, refused::RefusedRows};
use crate::progress::Bar;
use tidemap_formats::observation_file::{
    Layout, ObservationColumns, ObservationRow, RowError, RowItem, RowReader, RowRules,
};

const CHUNK_ROWS: usize = 1024;
const CHUNKS_AHEAD: usize = 4;
/// Refusals that are reported one by one.
const REPORTED_MAX: u64 = 20;
/// The maximum number of these refusals that differ in their numbers only.
const ALIKE_MAX: u64 = 3;

/// Rows that were read together.
#[derive(Debug)]
pub(crate) struct RowChunk<T = ObservationRow> {
    pub(crate) rows: Vec<T>,
    /// Line and text of a last line that was cut off.
    pub(crate) torn: Option<(u64, String)>,
    /// A last line that is a valid row, but has no line end.
    pub(crate) unended: Option<u64>,
    /// Bytes of the file read so far.
    pub(crate) bytes: u64,
}

impl<T> Default for RowChunk<T> {
    fn default() -> Self {
        Self { rows: Vec::new(), torn: None, unended: None, bytes: 0 }
    }
}

/// A file that is being read.
#[derive(Debug)]
pub(crate) struct Feed<L: Layout = ObservationColumns> {
    /// An error is the last entry.
    pub(crate) rows: RowChunks<L::Item>,
    /// Size of the file; `None` for pipes.
    pub(crate) total_bytes: Option<u64>,
    pub(crate) layout: L,
}

pub(crate) type RowChunks<T> = mpsc::Receiver<Result<RowChunk<T>, RowError>>;

/// Opens a file, or stdin if the path is `-`, and reads its header.
pub(crate) fn open<L>(path: &Path, rules: &RowRules) -> anyhow::Result<Feed<L>>
where
    L: Layout<Item: Send> + Clone + Send + 'static,
{
    let (mut rows, total_bytes) = reader::<L>(path, rules)?;
    if path.as_os_str() == "-" {
        // The writer of a pipe may be killed in the middle of a line. A file without its last line end was probably
        // saved that way.
        rows = rows.lines_must_end();
    }
    if !rows.ignored().is_empty() {
        crate::progress::status_line(&format!(
            "{}: not used: column {}",
            display_name(path),
            rows.ignored().join(", ")
        ));
    }
    let layout = rows.layout().clone();
    let (sender, receiver) = mpsc::channel(CHUNKS_AHEAD);
    thread::Builder::new().name("rows".to_owned()).spawn(move || read(rows, &sender)).context("thread")?;
    Ok(Feed { rows: receiver, total_bytes, layout })
}

/// The rows of a file, and its size.
pub(crate) fn reader<L: Layout>(
    path: &Path,
    rules: &RowRules,
) -> anyhow::Result<(RowReader<opening::RowSource, L>, Option<u64>)> {
    let (source, total_bytes) = opening::open(path)?;
    Ok((RowReader::open_with(source, rules).with_context(|| display_name(path))?, total_bytes))
}

/// Reads until the end, an error, or until the receiver is closed.
fn read<R: Read, L: Layout>(
    mut rows: RowReader<BufReader<R>, L>,
    sender: &mpsc::Sender<Result<RowChunk<L::Item>, RowError>>,
) {
    let mut chunk = RowChunk::default();
    loop {
        let item = rows.next_item();
        chunk.bytes = rows.bytes();
        let last = match item {
            Ok(Some(RowItem::Row(row))) => {
                let at = L::at(&row);
                chunk.unended = (!at.has_end).then_some(at.line);
                chunk.rows.push(row);
                false
            }
            Ok(Some(RowItem::Torn { line, text })) => {
                chunk.torn = Some((line, text));
                false
            }
            Ok(None) => true,
            Err(error) => {
                let _ = sender.blocking_send(Ok(chunk));
                let _ = sender.blocking_send(Err(error));
                return;
            }
        };
        if last || chunk.rows.len() >= CHUNK_ROWS || rows.may_wait() {
            let gone = sender.blocking_send(Ok(std::mem::take(&mut chunk))).is_err();
            if gone || last {
                return;
            }
        }
    }
}

/// Reports invalid rows or scans: each reason once; if reasons differ only in their numbers, the first of them; then
/// the number of the others.
#[derive(Debug)]
pub(crate) struct RefusalReport {
    bar: Bar,
    noun: &'static str,
    verb: &'static str,
    wrong: u64,
    reported: u64,
    torn: bool,
    kept: Option<RefusedRows>,
    /// Reasons that were reported.
    printed: HashSet<String>,
    /// The number of reports for each reason, with all digits removed.
    alike: HashMap<String, u64>,
}

impl RefusalReport {
    /// `noun` and `verb` make the message: a "row" "is refused".
    pub(crate) fn new(bar: Bar, noun: &'static str, verb: &'static str) -> Self {
        Self {
            bar,
            noun,
            verb,
            wrong: 0,
            reported: 0,
            torn: false,
            kept: None,
            printed: HashSet::new(),
            alike: HashMap::new(),
        }
    }

    /// Adds refused rows to `kept`, so that they can be written to a file.
    pub(crate) fn keeping(self, kept: Option<RefusedRows>) -> Self {
        Self { kept, ..self }
    }

    /// The rows that were kept, if a file for them was chosen.
    pub(crate) fn kept(&self) -> Option<&RefusedRows> {
        self.kept.as_ref()
    }

    /// Keeps a row that was refused when it was sent, which is counted already.
    pub(crate) fn was_refused(&mut self, line: u64, why: &str) {
        if let Some(kept) = &mut self.kept {
            kept.add(Some(line), why);
        }
    }

    pub(crate) fn refused(&mut self, number: u64, line: Option<u64>, why: &str) {
        self.wrong += 1;
        if let Some(kept) = &mut self.kept {
            kept.add(line, why);
        }
        if self.is_news(why) {
            self.reported += 1;
            let line = line.map_or_else(String::new, |line| format!(" (line {line})"));
            self.bar.status_line(&format!("{} {number}{line} {}: {why}", self.noun, self.verb));
        }
    }

    /// Whether a reason is to be reported.
    fn is_news(&mut self, why: &str) -> bool {
        if self.reported >= REPORTED_MAX || self.printed.contains(why) {
            return false;
        }
        let without_numbers = why.replace(|letter: char| letter.is_ascii_digit() || "+-.:e".contains(letter), "");
        let alike = self.alike.entry(without_numbers).or_default();
        *alike += 1;
        *alike <= ALIKE_MAX && self.printed.insert(why.to_owned())
    }

    /// Whether a reported reason has these words.
    pub(crate) fn has_reason(&self, words: &str) -> bool {
        self.printed.iter().any(|why| why.contains(words))
    }

    /// Reports a file that was not sent, because it cannot be used.
    pub(crate) fn left_out(&mut self, file: &Path, why: &str) {
        self.wrong += 1;
        if self.reported < REPORTED_MAX {
            self.reported += 1;
            self.bar.status_line(&format!("{} {}: {why}", file.display(), self.verb));
        }
    }

    /// Counts refused rows whose details are lost.
    pub(crate) fn count_refused(&mut self, rows: u64) {
        self.wrong += rows;
        if let Some(kept) = &mut self.kept {
            kept.lose(rows);
        }
    }

    /// Reports a last line that has no line end.
    pub(crate) fn last_line<T>(&mut self, chunk: &RowChunk<T>) {
        if let Some((line, text)) = &chunk.torn {
            self.torn = true;
            let why = "the input ends in it, without a line end";
            self.bar.status_line(&format!("line {line} is incomplete and was left out: {text:?} ({why})"));
        }
        if let Some(line) = chunk.unended {
            self.bar.status_line(&format!("line {line} has no line end and was taken as it is"));
        }
    }

    /// Whether every row was valid.
    pub(crate) fn is_clean(&self) -> bool {
        self.wrong == 0 && !self.torn
    }

    /// Reports the number of refusals that were not reported one by one.
    pub(crate) fn conclude(&self) {
        if self.wrong > self.reported {
            let more = self.wrong - self.reported;
            let nouns = if more == 1 { self.noun.to_owned() } else { format!("{}s", self.noun) };
            self.bar.status_line(&format!("and {more} more {nouns} for the reasons above or like them"));
        }
    }
}

#[test]
fn a_reason_is_reported_once_and_reasons_that_differ_in_numbers_only_some_times() {
    let mut report = RefusalReport::new(Bar::bytes(None), "row", "is refused");
    for number in 1..=10 {
        report.refused(number, None, "value \"ajar\" is not a number");
        report.refused(10 + number, None, &format!("value {number}.5 is not between 0 and 1"));
    }
    assert_eq!((report.wrong, report.reported), (20, 1 + ALIKE_MAX));
    report.refused(21, None, "value \"half\" is not a number");
    assert_eq!(report.reported, 2 + ALIKE_MAX, "another word is another reason");
    assert!(report.has_reason("not between 0 and 1") && !report.has_reason("half-open"));
    for number in 0..2 * REPORTED_MAX {
        let word: String = std::iter::repeat_n('x', number as usize + 1).collect();
        report.refused(100 + number, None, &word);
    }
    assert_eq!(report.reported, REPORTED_MAX);
}
