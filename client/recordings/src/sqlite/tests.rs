//! Databases that the tests write.
//!
//! Invariant: a written database has small pages and narrow trees, so that a few rows need many pages.

use std::io::Cursor;

use proptest::prelude::*;

use super::*;

const PAGE_BYTES: usize = 512;
const CHILDREN: usize = 3;

/// A value that the tests write.
#[derive(Clone, Debug)]
pub(crate) enum Cell {
    Null,
    Integer(i64),
    Text(String),
    Bytes(Vec<u8>),
}

pub(crate) fn text(text: &str) -> Cell {
    Cell::Text(text.to_owned())
}

/// Rows of a table, each with its number.
pub(crate) type Rows = Vec<(i64, Vec<Cell>)>;

fn written_varint(number: u64) -> Vec<u8> {
    if number >> 56 != 0 {
        let mut bytes: Vec<u8> = (0..8).map(|index| (number >> (8 + 7 * (7 - index))) as u8 | 0x80).collect();
        bytes.push(number as u8);
        return bytes;
    }
    let mut bytes = vec![(number & 0x7f) as u8];
    let mut rest = number >> 7;
    while rest > 0 {
        bytes.insert(0, (rest & 0x7f) as u8 | 0x80);
        rest >>= 7;
    }
    bytes
}

fn written_record(cells: &[Cell]) -> Vec<u8> {
    let (mut kinds, mut values) = (Vec::new(), Vec::new());
    for cell in cells {
        match cell {
            Cell::Null => kinds.extend(written_varint(0)),
            Cell::Integer(0) => kinds.extend(written_varint(8)),
            Cell::Integer(1) => kinds.extend(written_varint(9)),
            Cell::Integer(number) => match i16::try_from(*number) {
                Ok(number) => {
                    kinds.extend(written_varint(2));
                    values.extend(number.to_be_bytes());
                }
                Err(_) => {
                    kinds.extend(written_varint(6));
                    values.extend(number.to_be_bytes());
                }
            },
            Cell::Text(text) => {
                kinds.extend(written_varint(13 + 2 * text.len() as u64));
                values.extend(text.bytes());
            }
            Cell::Bytes(bytes) => {
                kinds.extend(written_varint(12 + 2 * bytes.len() as u64));
                values.extend(bytes);
            }
        }
    }
    assert!(kinds.len() < 127);
    [&written_varint(kinds.len() as u64 + 1)[..], &kinds, &values].concat()
}

/// The pages of a database, the first one last.
pub(crate) struct DatabaseWriter {
    pages: Vec<Vec<u8>>,
    schema: Rows,
    pub(crate) has_log: bool,
}

impl DatabaseWriter {
    pub(crate) fn new() -> Self {
        Self { pages: vec![Vec::new()], schema: Vec::new(), has_log: false }
    }

    pub(crate) fn table(&mut self, name: &str, columns: &str, rows: &Rows) {
        let sql = format!("CREATE TABLE {name}({columns})");
        let root = self.tree(rows);
        let cells = vec![text("table"), text(name), text(name), Cell::Integer(i64::from(root)), text(&sql)];
        self.schema.push((self.schema.len() as i64 + 1, cells));
    }

    fn add(&mut self, page: Vec<u8>) -> u32 {
        assert_eq!(page.len(), PAGE_BYTES);
        self.pages.push(page);
        u32::try_from(self.pages.len()).unwrap()
    }

    fn leaf_cell(&mut self, number: i64, cells: &[Cell]) -> Vec<u8> {
        let record = written_record(cells);
        let local = local_bytes(record.len() as u64, PAGE_BYTES);
        let mut next = 0;
        for part in record[local..].chunks(PAGE_BYTES - 4).rev() {
            let mut page = u32::to_be_bytes(next).to_vec();
            page.extend(part);
            page.resize(PAGE_BYTES, 0);
            next = self.add(page);
        }
        let mut cell = written_varint(record.len() as u64);
        cell.extend(written_varint(number.cast_unsigned()));
        cell.extend(&record[..local]);
        if local < record.len() {
            cell.extend(next.to_be_bytes());
        }
        cell
    }

    fn tree(&mut self, rows: &Rows) -> u32 {
        let mut leaves: Vec<(i64, Vec<Vec<u8>>)> = vec![(0, Vec::new())];
        for (number, cells) in rows {
            let cell = self.leaf_cell(*number, cells);
            let last = leaves.last_mut().unwrap();
            let bytes: usize = last.1.iter().map(|cell| cell.len() + 2).sum();
            if 8 + bytes + cell.len() + 2 > PAGE_BYTES {
                leaves.push((*number, vec![cell]));
            } else {
                last.0 = *number;
                last.1.push(cell);
            }
        }
        let mut nodes: Vec<(i64, u32)> =
            leaves.into_iter().map(|(key, cells)| (key, self.add(page(LEAF, 0, &cells, None)))).collect();
        while nodes.len() > 1 {
            nodes = nodes
                .chunks(CHILDREN)
                .map(|children| {
                    let ((last_key, last), others) = children.split_last().unwrap();
                    let cell = |(key, child): &(i64, u32)| {
                        [&child.to_be_bytes()[..], &written_varint(key.cast_unsigned())].concat()
                    };
                    let cells: Vec<Vec<u8>> = others.iter().map(cell).collect();
                    (*last_key, self.add(page(INTERIOR, 0, &cells, Some(*last))))
                })
                .collect();
        }
        nodes[0].1
    }

    pub(crate) fn finish(mut self) -> Vec<u8> {
        let schema = std::mem::take(&mut self.schema);
        let cells: Vec<Vec<u8>> = schema.iter().map(|(number, cells)| self.leaf_cell(*number, cells)).collect();
        let mut first = page(LEAF, HEADER_BYTES, &cells, None);
        first[..16].copy_from_slice(MAGIC);
        first[16..18].copy_from_slice(&u16::try_from(PAGE_BYTES).unwrap().to_be_bytes());
        let mode = if self.has_log { 2 } else { 1 };
        first[18..24].copy_from_slice(&[mode, mode, 0, 64, 32, 32]);
        first[28..32].copy_from_slice(&u32::try_from(self.pages.len()).unwrap().to_be_bytes());
        first[59] = 1;
        self.pages[0] = first;
        self.pages.concat()
    }
}

fn page(kind: u8, header: usize, cells: &[Vec<u8>], last: Option<u32>) -> Vec<u8> {
    let mut page = vec![0; PAGE_BYTES];
    page[header] = kind;
    page[header + 3..header + 5].copy_from_slice(&u16::try_from(cells.len()).unwrap().to_be_bytes());
    let mut pointer = header + 8;
    if let Some(last) = last {
        page[pointer..pointer + 4].copy_from_slice(&last.to_be_bytes());
        pointer += 4;
    }
    let mut end = PAGE_BYTES;
    for cell in cells {
        end -= cell.len();
        page[end..end + cell.len()].copy_from_slice(cell);
        page[pointer..pointer + 2].copy_from_slice(&u16::try_from(end).unwrap().to_be_bytes());
        pointer += 2;
        assert!(pointer <= end, "the page is full");
    }
    page
}

fn numbered(rows: usize) -> Rows {
    (0..rows).map(|row| (row as i64, vec![Cell::Null, Cell::Bytes(vec![row as u8; row * 37])])).collect()
}

fn written(rows: &Rows) -> Vec<u8> {
    let mut writer = DatabaseWriter::new();
    writer.table("other", "a", &vec![(1, vec![Cell::Integer(5)])]);
    writer.table("rows", "id INTEGER PRIMARY KEY, data BLOB", rows);
    writer.finish()
}

/// The rows of the table `rows`: their numbers and bytes.
fn rows(bytes: &[u8]) -> Result<Vec<(i64, Vec<u8>)>, RecordingError> {
    let mut database = Database::open(Cursor::new(bytes))?;
    let table = database.table("ROWS").ok_or_else(|| broken("no table".to_owned()))?;
    let (mut walk, mut row, mut found) = (database.walk(&table), TableRow::default(), Vec::new());
    while database.next(&mut walk, &mut row)? {
        database.complete(&mut walk, &mut row)?;

        if let Some(Value::Bytes(bytes)) = row.value(1)? {
            found.push((row.number(), bytes.to_vec()));
        }
    }
    Ok(found)
}

#[test]
fn rows_come_in_the_order_of_their_numbers() {
    for count in [0, 1, 5, 100] {
        let found = rows(&written(&numbered(count))).unwrap();
        let wanted: Vec<(i64, Vec<u8>)> = (0..count).map(|row| (row as i64, vec![row as u8; row * 37])).collect();
        assert_eq!(found, wanted, "{count}");
    }
}

#[test]
fn columns_are_found_whatever_their_case() {
    let database = Database::open(Cursor::new(written(&numbered(1)))).unwrap();
    let table = database.table("Rows").unwrap();
    assert_eq!((table.column("DATA"), table.column("date"), table.row_number_column), (Some(1), None, Some(0)));
    assert!(database.table("messages").is_none());
}

#[test]
fn negative_and_large_row_numbers_are_read() {
    let numbers = [i64::MIN, -1, 0, 127, 128, 1 << 40, i64::MAX];
    let wanted: Vec<(i64, Vec<u8>)> = numbers.iter().map(|number| (*number, vec![7])).collect();
    let table: Rows = numbers.iter().map(|number| (*number, vec![Cell::Null, Cell::Bytes(vec![7])])).collect();
    assert_eq!(rows(&written(&table)).unwrap(), wanted);
}

#[test]
fn pages_that_go_in_circles_are_broken() {
    let mut bytes = written(&numbered(60));
    // The first interior page refers to itself.
    let start = bytes.chunks(PAGE_BYTES).position(|page| page[0] == INTERIOR).unwrap() * PAGE_BYTES;
    let number = u32::try_from(start / PAGE_BYTES + 1).unwrap();
    bytes[start + 8..start + 12].copy_from_slice(&number.to_be_bytes());
    let error = rows(&bytes).unwrap_err().to_string();
    assert!(error.contains("in circles") || error.contains("deeper"), "{error}");
}

#[test]
fn a_row_that_goes_on_in_circles_is_broken() {
    let mut bytes = written(&vec![(1, vec![Cell::Null, Cell::Bytes(vec![1; 30_000])])]);
    let stated = written_varint(written_record(&[Cell::Null, Cell::Bytes(vec![1; 30_000])]).len() as u64);
    let cell = bytes.windows(3).position(|bytes| bytes == stated).unwrap();
    // The stated length has as many bytes in the leaf, and a thousand pages more.
    let mut rest = &stated[..];
    let longer = varint(&mut rest).unwrap() + 1000 * (PAGE_BYTES as u64 - 4);
    bytes[cell..cell + 3].copy_from_slice(&written_varint(longer));
    for (index, page) in bytes.chunks_mut(PAGE_BYTES).enumerate().skip(2).filter(|(_, page)| page[0] != LEAF) {
        page[..4].copy_from_slice(&u32::try_from(index + 1).unwrap().to_be_bytes());
    }
    let error = rows(&bytes).unwrap_err().to_string();
    assert!(error.contains("in circles"), "{error}");
}

#[test]
fn a_page_outside_of_the_file_is_broken_and_a_missing_one_cut_off() {
    let bytes = written(&numbered(60));
    let cut = rows(&bytes[..bytes.len() - PAGE_BYTES]).unwrap_err();
    assert!(matches!(cut, RecordingError::Io(error) if error.kind() == io::ErrorKind::UnexpectedEof));
    let mut bytes = bytes;
    let start = bytes.chunks(PAGE_BYTES).position(|page| page[0] == INTERIOR).unwrap() * PAGE_BYTES;
    bytes[start + 8..start + 12].copy_from_slice(&[1, 0, 0, 0]);
    let error = rows(&bytes).unwrap_err().to_string();
    assert!(error.contains("refers to page 16777216"), "{error}");
}

#[test]
fn headers_that_are_not_read_give_the_reason() {
    let bytes = written(&numbered(1));
    for (place, value, text) in
        [(0, 0, "no SQLite database"), (16, 3, "pages of"), (20, 200, "usable"), (59, 2, "UTF-16")]
    {
        let mut bytes = bytes.clone();
        bytes[place] = value;
        let error = rows(&bytes).unwrap_err().to_string();
        assert!(error.contains(text), "{error}");
    }
}

#[test]
fn a_row_above_the_limit_is_refused_before_it_is_read() {
    let mut bytes = written(&vec![(1, vec![Cell::Null, Cell::Bytes(vec![1; 5_000])])]);
    // The row's length, two bytes long, becomes a length of nine bytes, which overwrites the number of the row.
    let leaf = bytes.chunks(PAGE_BYTES).rposition(|page| page[0] == LEAF && page[4] == 1).unwrap() * PAGE_BYTES;
    let cell = leaf + usize::from(u16::from_be_bytes([bytes[leaf + 8], bytes[leaf + 9]]));
    bytes[cell..cell + 9].copy_from_slice(&[0x80, 0x80, 0x80, 0x80, 0x90, 0x80, 0x80, 0x80, 0x00]);
    assert!(matches!(rows(&bytes), Err(RecordingError::TooLarge { max: ROW_BYTES_MAX, .. })));
}

proptest! {
    #[test]
    fn any_number_comes_back(number in any::<u64>(), shift in 0..64_u32) {
        let number = number >> shift;
        let bytes = written_varint(number);
        prop_assert_eq!(varint(&mut &bytes[..]), Some(number));
    }

    #[test]
    fn changed_bytes_do_no_harm(changes in proptest::collection::vec((any::<usize>(), any::<u8>()), 1..4)) {
        let mut bytes = written(&numbered(20));
        for (place, value) in changes {
            let place = place % bytes.len();
            bytes[place] = value;
        }
        if let Ok(rows) = rows(&bytes) {
            prop_assert!(rows.iter().map(|(_, data)| data.len()).sum::<usize>() <= bytes.len());
        }
    }

    #[test]
    fn any_bytes_behind_the_magic_do_no_harm(rest in proptest::collection::vec(any::<u8>(), 0..2000)) {
        let mut bytes = [&MAGIC[..], &rest].concat();
        if let Some(page) = bytes.get_mut(16..18) {
            page.copy_from_slice(&[2, 0]);
        }
        let _ = rows(&bytes);
    }
}
