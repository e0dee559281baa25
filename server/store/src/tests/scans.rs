//! Scans in the log: exact, small, and safe for any payload.

use std::sync::Arc;

use proptest::{collection::vec, prelude::*};
use prost::Message as _;
use rand::{SeedableRng as _, rngs::SmallRng};
use tidemap_grid::{
    index::TileId,
    scan::{CellRef, LoggedScan, ScanSource, Scans},
};
use tidemap_layout::{event as layout, log::FrameKind};
use tidemap_map::{
    event::{Envelope, Event, SequenceSpan},
    ids::ProducerId,
};

use super::grid_example::scans;
use crate::{SCANS_MAX, record};

fn decode(message: &layout::Scans) -> Result<Event, &'static str> {
    record::event::decode(FrameKind::Scans, &message.encode_to_vec())
}

fn event_of(scans: Vec<LoggedScan>) -> Event {
    Event::Scans(
        Envelope {
            producer: ProducerId(3),
            new_producer: None,
            incarnation: 1,
            span: SequenceSpan { first: 1, last: 256, content_crc: 77 },
            received_nanos: 1_700_000_000_000_000_000,
            refused: Vec::new(),
        },
        Scans { new_tiles: Vec::new(), scans, ..Scans::default() },
    )
}

fn still(count: i64) -> Vec<LoggedScan> {
    let scan = |number: i64| LoggedScan {
        utc_nanos: 1_700_000_000_000_000_000 + number * 100_000_000 + number % 7,
        offset_secs: 3600,
        source: ScanSource::Cells,
        seen: (number == 0).then(|| (0..5000).map(TileId).collect()),
        observed_flips: Vec::new(),
        occupied_flips: Vec::new(),
    };
    (0..count).map(scan).collect()
}

proptest! {
    #[test]
    fn scans_come_back(seed in any::<u64>(), number in 1..1000_u64) {
        let event = scans(number, &mut SmallRng::seed_from_u64(seed));
        let (kind, payload) = record::event::encode(&event).expect("valid");
        prop_assert_eq!(kind, FrameKind::Scans);
        prop_assert_eq!(record::event::decode(kind, &payload), Ok(event));
    }

    #[test]
    fn extreme_times_cells_and_sets_come_back(
        times in vec(0..=i64::MAX, 1..20),
        cells in vec(any::<u32>(), 0..20),
        tiles in vec(0..CellRef::TILES_MAX, 0..20),
    ) {
        let mut flips: Vec<CellRef> = cells.into_iter().map(CellRef).collect();
        flips.sort_unstable();
        flips.dedup();
        let mut seen: Vec<TileId> = tiles.into_iter().map(TileId).collect();
        seen.sort_unstable();
        seen.dedup();
        let scan = |(number, utc_nanos): (usize, i64)| LoggedScan {
            utc_nanos,
            offset_secs: i32::MIN,
            source: ScanSource::Cells,
            seen: (number % 2 == 0).then(|| seen[number.min(seen.len())..].into()),
            observed_flips: flips.clone(),
            occupied_flips: flips.iter().copied().rev().take(number).rev().collect(),
        };
        let event = event_of(times.into_iter().enumerate().map(scan).collect());
        let (kind, payload) = record::event::encode(&event).expect("valid");
        prop_assert_eq!(record::event::decode(kind, &payload), Ok(event));
    }

    #[test]
    fn a_changed_payload_is_read_or_refused(seed in any::<u64>(), at in any::<prop::sample::Index>(), byte in any::<u8>()) {
        let event = scans(7, &mut SmallRng::seed_from_u64(seed));
        let (kind, mut payload) = record::event::encode(&event).expect("valid");
        let at = at.index(payload.len());
        payload[at] = byte;
        if let Ok(found) = record::event::decode(kind, &payload) {
            // Any value that decodes can be encoded again.
            prop_assert!(record::event::encode(&found).is_ok());
        }
    }
}

#[test]
fn a_scan_in_which_nothing_changed_takes_a_few_bytes() {
    let length = |count| record::event::encode(&event_of(still(count))).expect("valid").1.len();
    let (few, many) = (length(1), length(257));
    assert!(few < 60, "{few} bytes");
    assert!(many - few <= 256 * 5, "{} bytes for 256 scans", many - few);
}

#[test]
fn what_could_not_be_read_back_is_refused() {
    let good = still(3);
    let change = |change: fn(&mut LoggedScan)| {
        let mut scans = good.clone();
        change(&mut scans[1]);
        record::event::encode(&event_of(scans))
    };
    assert!(change(|_| {}).is_ok());
    assert!(change(|scan| scan.utc_nanos = -1).is_err());
    assert!(change(|scan| scan.observed_flips = vec![CellRef(5), CellRef(5)]).is_err());
    assert!(change(|scan| scan.occupied_flips = vec![CellRef(5), CellRef(4)]).is_err());
    assert!(change(|scan| scan.seen = Some(Arc::new([TileId(2), TileId(1)]))).is_err());
    let many = vec![good[1].clone(); SCANS_MAX + 1];
    assert!(record::event::encode(&event_of(many)).is_err());
    let Event::Scans(mut envelope, scans) = event_of(Vec::new()) else { unreachable!("scans") };
    envelope.span.last = 0;
    assert!(record::event::encode(&Event::Scans(envelope, scans)).is_err());
}

#[test]
fn counts_that_nothing_stands_behind_are_refused() {
    let good = layout::Scans { last_sequence: 1, ..layout::Scans::default() };
    assert!(decode(&good).is_ok());
    let one = layout::Scans {
        count: 1,
        offset_counts: vec![1],
        offset_secs: vec![0],
        observed_counts: vec![0],
        occupied_counts: vec![0],
        ..good.clone()
    };
    assert!(decode(&one).is_ok());
    let longest = vec![0xFF, 0xFF, 0xFF, 0xFF, 0x0F];
    for bad in [
        layout::Scans { count: u32::MAX, offset_counts: vec![u32::MAX], ..one.clone() },
        layout::Scans { observed_counts: longest.clone(), ..one.clone() },
        layout::Scans { occupied_counts: longest.clone(), occupied_flips: vec![1], ..one.clone() },
        // A set of four thousand million tiles, and one with as many ranges.
        layout::Scans { seen: [&[0, 1, 0][..], &longest].concat(), ..one.clone() },
        layout::Scans { seen: [&[0][..], &longest].concat(), ..one.clone() },
        layout::Scans { seen: vec![1, 0], ..one.clone() },
        layout::Scans { new_tiles: longest.clone(), ..one.clone() },
        layout::Scans { offset_secs: vec![], ..one.clone() },
        layout::Scans { observed_flips: vec![1], ..one.clone() },
    ] {
        assert!(decode(&bad).is_err(), "{bad:?}");
    }
    // Sets that each cost three bytes and all hold eight million tiles.
    let mut seen = vec![0, 1, 0, 0xFE, 0xFF, 0xFF, 0x03];
    seen.extend([0, 0].repeat(1000));
    let count = 1001;
    let column = vec![0];
    let bomb = layout::Scans {
        count,
        times: column.clone(),
        offset_counts: vec![count],
        seen,
        observed_counts: column.clone(),
        occupied_counts: column,
        ..one
    };
    assert_eq!(decode(&bomb), Err("the sets of tiles are larger than the limit"));
}
