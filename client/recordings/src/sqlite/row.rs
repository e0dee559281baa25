//! A row of a table: its values by column.
//!
//! Invariant: a value is given only where all of its bytes are there.

use crate::recording::RecordingError;

/// A value of a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Value<'a> {
    /// No value.
    Null,
    /// A whole number.
    Integer(i64),
    /// Another number.
    Real(f64),
    /// Text, UTF-8.
    Text(&'a [u8]),
    /// Bytes.
    Bytes(&'a [u8]),
}

/// A row. Its memory serves the next row too.
#[derive(Default)]
pub(crate) struct TableRow {
    number: i64,
    bytes: Vec<u8>,
    stated: u64,
    overflow: u32,
}

impl TableRow {
    pub(super) fn begin(&mut self, number: i64, bytes: &[u8], stated: u64, overflow: u32) {
        self.bytes.clear();
        self.bytes.extend_from_slice(bytes);
        (self.number, self.stated, self.overflow) = (number, stated, overflow);
    }

    pub(super) fn extend(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    /// The number of the row in the table.
    pub(crate) fn number(&self) -> i64 {
        self.number
    }

    /// Length of the row.
    pub(crate) fn bytes_stated(&self) -> u64 {
        self.stated
    }

    /// The first page on which the row continues.
    pub(super) fn overflow(&self) -> u32 {
        self.overflow
    }

    /// The number of bytes that stand in other pages; `None` if that is more than memory can hold.
    pub(super) fn missing(&self) -> Option<usize> {
        usize::try_from(self.stated.saturating_sub(self.bytes.len() as u64)).ok()
    }

    /// The value of a column; NULL if the row is older than the column; `None` if its bytes are not all there yet.
    ///
    /// # Errors
    /// If the row breaks the format.
    pub(crate) fn value(&self, column: usize) -> Result<Option<Value<'_>>, RecordingError> {
        let broken = || RecordingError::Broken(format!("row {} of a table of the database is broken", self.number));
        let is_whole = self.missing() == Some(0);
        let absent = || if is_whole { Err(broken()) } else { Ok(None) };
        let mut rest = self.bytes.as_slice();
        let Some(header_bytes) = varint(&mut rest) else { return absent() };
        let Some(header_bytes) = usize::try_from(header_bytes).ok().filter(|bytes| *bytes as u64 <= self.stated) else {
            return Err(broken());
        };
        let Some(mut kinds) = self.bytes.get(self.bytes.len() - rest.len()..header_bytes) else { return absent() };
        let mut start = header_bytes;
        for _ in 0..column {
            if kinds.is_empty() {
                return Ok(Some(Value::Null));
            }
            let length = varint(&mut kinds).and_then(value_bytes).ok_or_else(broken)?;
            start = start.checked_add(length).ok_or_else(broken)?;
        }
        if kinds.is_empty() {
            return Ok(Some(Value::Null));
        }
        let kind = varint(&mut kinds).ok_or_else(broken)?;
        let end = value_bytes(kind).and_then(|length| start.checked_add(length)).ok_or_else(broken)?;
        if end as u64 > self.stated {
            return Err(broken());
        }
        let Some(bytes) = self.bytes.get(start..end) else { return absent() };
        Ok(Some(match kind {
            0 => Value::Null,
            1..=6 => Value::Integer(integer(bytes)),
            7 => Value::Real(f64::from_bits(integer(bytes).cast_unsigned())),
            8 => Value::Integer(0),
            9 => Value::Integer(1),
            kind if kind % 2 == 0 => Value::Bytes(bytes),
            _ => Value::Text(bytes),
        }))
    }
}

/// Length of a value of a kind; `None` for the kinds that the format keeps for itself.
fn value_bytes(kind: u64) -> Option<usize> {
    match kind {
        0 | 8 | 9 => Some(0),
        1..=4 => usize::try_from(kind).ok(),
        5 => Some(6),
        6 | 7 => Some(8),
        10 | 11 => None,
        kind => usize::try_from((kind - 12) / 2).ok(),
    }
}

/// A number with its sign, the high byte first.
fn integer(bytes: &[u8]) -> i64 {
    let sign = if bytes.first().is_some_and(|byte| *byte >= 0x80) { -1 } else { 0 };
    bytes.iter().fold(sign, |number, byte| number << 8 | i64::from(*byte))
}

/// A number of 1 to 9 bytes: seven bits of each, all eight of the ninth.
pub(super) fn varint(rest: &mut &[u8]) -> Option<u64> {
    let mut number = 0;
    for (index, byte) in rest.iter().take(9).enumerate() {
        let bits = u64::from(*byte);
        if index == 8 || bits < 0x80 {
            *rest = &rest[index + 1..];
            return Some(if index == 8 { number << 8 | bits } else { number << 7 | bits });
        }
        number = number << 7 | (bits & 0x7f);
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number(bytes: &[u8]) -> Option<(u64, usize)> {
        let mut rest = bytes;
        varint(&mut rest).map(|number| (number, rest.len()))
    }

    #[test]
    fn numbers_have_one_to_nine_bytes() {
        assert_eq!(number(&[0x7f, 5]), Some((127, 1)));
        assert_eq!(number(&[0x81, 0x00]), Some((128, 0)));
        assert_eq!(number(&[0xff; 9]), Some((u64::MAX, 0)));
        assert_eq!(number(&[0x80; 8]), None);
        assert_eq!(number(&[]), None);
    }

    #[test]
    fn the_sign_stands_in_the_first_byte() {
        assert_eq!(integer(&[0xff]), -1);
        assert_eq!(integer(&[0x01, 0x00]), 256);
        assert_eq!(integer(&[0x80, 0, 0, 0, 0, 0, 0, 0]), i64::MIN);
    }

    #[test]
    fn a_column_added_later_is_null_and_a_kept_kind_is_broken() {
        let mut row = TableRow::default();
        row.begin(3, &[2, 1, 77], 3, 0);
        assert_eq!(row.value(0).unwrap(), Some(Value::Integer(77)));
        assert_eq!(row.value(1).unwrap(), Some(Value::Null));
        row.begin(3, &[2, 10], 2, 0);
        assert!(row.value(0).is_err());
    }

    #[test]
    fn a_value_whose_end_is_elsewhere_is_not_given() {
        let mut row = TableRow::default();
        row.begin(1, &[3, 1, 24, 7, b'a', b'b'], 10, 9);
        assert_eq!(row.value(0).unwrap(), Some(Value::Integer(7)));
        assert_eq!(row.value(1).unwrap(), None);
        row.extend(b"cdef");
        assert_eq!(row.value(1).unwrap(), Some(Value::Bytes(b"abcdef")));
    }
}
