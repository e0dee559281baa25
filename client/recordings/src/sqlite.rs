//! Tables of an SQLite database file: their rows, in the order of their numbers. Only what reading needs.
//!
//! Invariant: the file may hold anything. A walk takes no more pages than the file has, so it ends whatever the pages
//! refer to; it holds one path of pages and one row in memory. A page that the file should have and has not gives
//! [`io::ErrorKind::UnexpectedEof`].

use std::io::{self, Read, Seek, SeekFrom};

use self::{
    row::{Value, varint},
    statement::columns,
};
use crate::recording::{MESSAGE_BYTES_MAX, RecordingError};

pub(crate) mod row;
mod statement;

pub(crate) use self::row::TableRow;

/// The first bytes of an SQLite database.
pub(crate) const MAGIC: &[u8; 16] = b"SQLite format 3\0";

const HEADER_BYTES: usize = 100;
/// SQLite itself allows no deeper trees.
const DEPTH_MAX: usize = 20;
/// A recording has about ten tables and indexes.
const TABLES_MAX: usize = 1000;
const SCHEMA_BYTES_MAX: usize = 1 << 20;
/// A row has a message, and some numbers.
const ROW_BYTES_MAX: usize = MESSAGE_BYTES_MAX + 1024;
const INTERIOR: u8 = 5;
const LEAF: u8 = 13;

/// A database, open for reading.
pub(crate) struct Database<R> {
    source: R,
    file_bytes: u64,
    page_bytes: usize,
    /// Bytes of a page without those that are reserved at its end.
    usable_bytes: usize,
    pages: u64,
    /// Whether newer pages may stand in a second file, the write-ahead log.
    has_log: bool,
    pages_read: u64,
    tables: Vec<Table>,
}

/// A table: where it begins, and its columns.
#[derive(Clone)]
pub(crate) struct Table {
    name: String,
    root: u32,
    columns: Vec<String>,
    /// The column that is an alias of the row number.
    pub(crate) row_number_column: Option<usize>,
}

impl Table {
    /// Index of the column of this name; SQL ignores case.
    pub(crate) fn column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| column.eq_ignore_ascii_case(name))
    }
}

/// A place in a walk through a table.
pub(crate) struct TableWalk {
    stack: Vec<Level>,
    /// The numbers of pages that are still to be entered, the next one last.
    pages_left: u64,
    next: Option<u32>,
}

struct Level {
    page: Vec<u8>,
    number: u32,
    /// The offset of the page's own header: after the file's header in the first page.
    header: usize,
    cells: usize,
    cell: usize,
}

fn broken(text: String) -> RecordingError {
    RecordingError::Broken(text)
}

impl<R: Read + Seek> Database<R> {
    /// Reads the header and the list of tables.
    pub(crate) fn open(mut source: R) -> Result<Self, RecordingError> {
        let file_bytes = source.seek(SeekFrom::End(0))?;
        source.seek(SeekFrom::Start(0))?;
        let mut header = [0; HEADER_BYTES];
        source.read_exact(&mut header)?;
        if header[..16] != *MAGIC {
            return Err(RecordingError::Unknown("the file is no SQLite database of format 3".to_owned()));
        }
        let page_bytes = match u16::from_be_bytes([header[16], header[17]]) {
            1 => 65_536,
            bytes => usize::from(bytes),
        };
        let usable_bytes = page_bytes.saturating_sub(usize::from(header[20]));
        if !page_bytes.is_power_of_two() || page_bytes < 512 || usable_bytes < 480 {
            return Err(broken(format!(
                "the database states pages of {page_bytes} bytes, {usable_bytes} of them usable"
            )));
        }
        if be_u32(&header, 56) > 1 {
            return Err(RecordingError::Unknown(
                "the database holds its text as UTF-16; rosbag2 writes UTF-8, and only that is read".to_owned(),
            ));
        }
        // The number of pages counts only if the program that changed the file last updated it.
        let stated = u64::from(be_u32(&header, 28));
        let is_stated = stated > 0 && be_u32(&header, 24) == be_u32(&header, 92);
        let pages = if is_stated { stated } else { file_bytes.div_ceil(page_bytes as u64) };
        let has_log = header[18] == 2 || header[19] == 2;
        let tables = Vec::new();
        let mut database = Self { source, file_bytes, page_bytes, usable_bytes, pages, has_log, pages_read: 0, tables };
        database.read_tables()?;
        Ok(database)
    }

    fn read_tables(&mut self) -> Result<(), RecordingError> {
        let schema = Table { name: String::new(), root: 1, columns: Vec::new(), row_number_column: None };
        let (mut walk, mut row) = (self.walk(&schema), TableRow::default());
        while self.next(&mut walk, &mut row)? {
            if self.tables.len() == TABLES_MAX {
                return Err(broken(format!("the database has more than {TABLES_MAX} tables")));
            }
            if row.bytes_stated() > SCHEMA_BYTES_MAX as u64 {
                let what = "the description of a table".to_owned();
                return Err(RecordingError::TooLarge { what, bytes: row.bytes_stated(), max: SCHEMA_BYTES_MAX });
            }
            self.complete(&mut walk, &mut row)?;
            let text = |column| match row.value(column) {
                Ok(Some(Value::Text(text))) => Some(String::from_utf8_lossy(text).into_owned()),
                _ => None,
            };
            if text(0).as_deref() != Some("table") {
                continue;
            }
            let (Some(name), Some(sql), Some(Value::Integer(root))) = (text(1), text(4), row.value(3)?) else {
                continue;
            };
            let Ok(root) = u32::try_from(root) else { continue };
            let (columns, row_number_column) = columns(&sql);
            self.tables.push(Table { name, root, columns, row_number_column });
        }
        Ok(())
    }

    /// The table of this name.
    pub(crate) fn table(&self, name: &str) -> Option<Table> {
        self.tables.iter().find(|table| table.name.eq_ignore_ascii_case(name)).cloned()
    }

    /// Whether the newest rows may stand in a second file.
    pub(crate) fn has_log(&self) -> bool {
        self.has_log
    }

    /// Length of the file, and the length that its header states.
    pub(crate) fn lengths(&self) -> (u64, u64) {
        (self.file_bytes, self.pages.saturating_mul(self.page_bytes as u64))
    }

    /// The number of bytes that have been read.
    pub(crate) fn bytes_read(&self) -> u64 {
        self.pages_read.saturating_mul(self.page_bytes as u64)
    }

    /// Begins a walk through a table.
    pub(crate) fn walk(&self, table: &Table) -> TableWalk {
        TableWalk { stack: Vec::new(), pages_left: self.pages, next: Some(table.root) }
    }

    /// Goes to the next row; `false` behind the last. The row may lack its end, until [`Database::complete`].
    pub(crate) fn next(&mut self, walk: &mut TableWalk, row: &mut TableRow) -> Result<bool, RecordingError> {
        loop {
            if let Some(number) = walk.next.take() {
                self.enter(walk, number)?;
            }
            let Some(level) = walk.stack.last_mut() else { return Ok(false) };
            let is_leaf = level.page[level.header] == LEAF;
            if level.cell < level.cells {
                let cell = level.cell;
                level.cell += 1;
                let start = level.cell_start(cell, self.usable_bytes)?;
                if is_leaf {
                    self.usable_row(level, start, row)?;
                    return Ok(true);
                }
                // The child's number stands before the key.
                let child = level.page.get(start..start + 4).map(|bytes| be_u32(bytes, 0));
                walk.next = Some(child.ok_or_else(|| level.broken("has a cell beyond its end"))?);
            } else if !is_leaf && level.cell == level.cells {
                level.cell += 1;
                walk.next = Some(be_u32(&level.page, level.header + 8));
            } else {
                walk.stack.pop();
            }
        }
    }

    fn enter(&mut self, walk: &mut TableWalk, number: u32) -> Result<(), RecordingError> {
        if walk.stack.len() == DEPTH_MAX {
            return Err(broken(format!("a table of the database is deeper than {DEPTH_MAX} pages, at page {number}")));
        }
        let mut page = Vec::new();
        self.page(walk, number, &mut page)?;
        let header = if number == 1 { HEADER_BYTES } else { 0 };
        let kind = page[header];
        if kind != LEAF && kind != INTERIOR {
            return Err(broken(format!(
                "page {number} of the database is of kind {kind}; pages of tables are 5 or 13"
            )));
        }
        let cells = usize::from(u16::from_be_bytes([page[header + 3], page[header + 4]]));
        let level = Level { page, number, header, cells, cell: 0 };
        if level.pointers() + 2 * cells > self.usable_bytes {
            return Err(level.broken(&format!("states {cells} cells, more than its bytes can hold")));
        }
        walk.stack.push(level);
        Ok(())
    }

    /// Reads a page. A walk that reads more pages than the file has goes in circles.
    fn page(&mut self, walk: &mut TableWalk, number: u32, into: &mut Vec<u8>) -> Result<(), RecordingError> {
        if number == 0 || u64::from(number) > self.pages {
            let pages = self.pages;
            return Err(broken(format!("the database refers to page {number}; it has the pages 1 to {pages}")));
        }
        let Some(left) = walk.pages_left.checked_sub(1) else {
            return Err(broken(format!("the pages of a table of the database go in circles, at page {number}")));
        };
        walk.pages_left = left;
        let start = (u64::from(number) - 1) * self.page_bytes as u64;
        if start + self.page_bytes as u64 > self.file_bytes {
            return Err(RecordingError::Io(io::ErrorKind::UnexpectedEof.into()));
        }
        self.source.seek(SeekFrom::Start(start))?;
        into.resize(self.page_bytes, 0);
        self.source.read_exact(into)?;
        self.pages_read = self.pages_read.saturating_add(1);
        Ok(())
    }

    /// Takes the part of a row that stands in its leaf.
    fn usable_row(&self, level: &Level, start: usize, row: &mut TableRow) -> Result<(), RecordingError> {
        let beyond = || level.broken("has a cell beyond its end");
        let page = level.page.get(..self.usable_bytes).unwrap_or_default();
        let mut rest = page.get(start..).ok_or_else(beyond)?;
        let length = varint(&mut rest).ok_or_else(beyond)?;
        let number = varint(&mut rest).ok_or_else(beyond)?;
        let local = local_bytes(length, self.usable_bytes);
        let bytes = rest.get(..local).ok_or_else(beyond)?;
        let overflow = if local as u64 == length {
            0
        } else {
            rest.get(local..local + 4).map(|bytes| be_u32(bytes, 0)).ok_or_else(beyond)?
        };
        row.begin(number.cast_signed(), bytes, length, overflow);
        Ok(())
    }

    /// Reads the end of a row, from the pages on which it continues.
    pub(crate) fn complete(&mut self, walk: &mut TableWalk, row: &mut TableRow) -> Result<(), RecordingError> {
        let Some(missing) = row.missing().filter(|_| row.bytes_stated() <= ROW_BYTES_MAX as u64) else {
            let what = format!("row {} of a table of the database", row.number());
            return Err(RecordingError::TooLarge { what, bytes: row.bytes_stated(), max: ROW_BYTES_MAX });
        };
        let (mut missing, mut next, mut page) = (missing, row.overflow(), Vec::new());
        while missing > 0 {
            self.page(walk, next, &mut page)?;
            let count = missing.min(self.usable_bytes - 4);
            row.extend(&page[4..4 + count]);
            missing -= count;
            next = be_u32(&page, 0);
        }
        Ok(())
    }
}

impl Level {
    /// The offset of the list of cells.
    fn pointers(&self) -> usize {
        self.header + if self.page[self.header] == LEAF { 8 } else { 12 }
    }

    fn cell_start(&self, cell: usize, usable_bytes: usize) -> Result<usize, RecordingError> {
        let place = self.pointers() + 2 * cell;
        let start = self.page.get(place..place + 2).map(|bytes| usize::from(u16::from_be_bytes([bytes[0], bytes[1]])));
        match start {
            Some(start) if start >= self.header + 8 && start < usable_bytes => Ok(start),
            _ => Err(self.broken("has a cell beyond its end")),
        }
    }

    fn broken(&self, how: &str) -> RecordingError {
        broken(format!("page {} of the database {how}", self.number))
    }
}

/// The number of bytes of a row that its leaf holds: all of them, or the number that the format's formula gives.
fn local_bytes(length: u64, usable_bytes: usize) -> usize {
    let local_max = usable_bytes - 35;
    let Some(length) = usize::try_from(length).ok().filter(|length| *length > local_max) else {
        return usize::try_from(length).unwrap_or(0);
    };
    let local_min = (usable_bytes - 12) * 32 / 255 - 23;
    let local = local_min + (length - local_min) % (usable_bytes - 4);
    if local <= local_max { local } else { local_min }
}

/// Four bytes at `start`, the high byte first; 0 where they are not all there.
fn be_u32(bytes: &[u8], start: usize) -> u32 {
    let found = bytes.get(start..start + 4).and_then(|bytes| <[u8; 4]>::try_from(bytes).ok());
    found.map_or(0, u32::from_be_bytes)
}

#[cfg(test)]
pub(crate) mod tests;
