//! Rows of CSV: observations and traversals, with whole and with torn last lines.
#![no_main]

use std::io::BufReader;

use tidemap_formats::observation_file::{Layout, ObservationColumns, RowReader, traversals::TraversalColumns};

fn read<L: Layout>(bytes: &[u8], lines_must_end: bool) {
    // A small buffer, so that lines cross its end.
    let Ok(reader) = RowReader::<_, L>::open(BufReader::with_capacity(16, bytes)) else { return };
    let mut reader = if lines_must_end { reader.lines_must_end() } else { reader };
    while let Ok(Some(_)) = reader.next_item() {}
}

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Some((first, bytes)) = bytes.split_first() else { return };
    if first & 1 == 0 {
        read::<ObservationColumns>(bytes, first & 2 == 2);
    } else {
        read::<TraversalColumns>(bytes, first & 2 == 2);
    }
});
