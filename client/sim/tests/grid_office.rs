//! The contract of the grid office: a reproducible stream from which every scan can be rebuilt, with the requested
//! number of changes and with routines that can be learned.
//!
//! Invariant: no test depends on speed.

use std::collections::BTreeSet;

use jiff::civil::date;
use tidemap_sim::{GridOffice, GridOfficeError, GridOfficeOptions, GridScan, GridStream};

const DAY_NANOS: i64 = 86_400 * 1_000_000_000;
const HOUR_NANOS: i64 = DAY_NANOS / 24;

/// An office of a third of the published size, seen every five minutes.
fn coarse() -> GridOfficeOptions {
    GridOfficeOptions { cells: 71_000, changing_cells: 5_000, scans_per_day: 288, ..Default::default() }
}

fn office(options: &GridOfficeOptions) -> GridOffice {
    GridOffice::new(options).expect("options within their ranges")
}

/// The tile masks that a consumer keeps.
struct Rebuilt(Vec<[u64; 8]>);

impl Rebuilt {
    fn new(office: &GridOffice) -> Self {
        Self(vec![[0; 8]; office.tiles().len()])
    }

    fn take(&mut self, scan: GridScan<'_>) {
        for &flip in scan.occupied_flips {
            self.0[flip as usize / 512][flip as usize % 512 / 64] ^= 1 << (flip % 64);
        }
    }

    fn filled(&self, address: u32) -> bool {
        self.0[address as usize / 512][address as usize % 512 / 64] >> (address % 64) & 1 == 1
    }
}

fn checksum(office: &GridOffice, days: u32) -> u64 {
    let mut sum = 0xcbf2_9ce4_8422_2325_u64;
    let mut add = |value: u64| sum = (sum ^ value).wrapping_mul(0x0100_0000_01b3);
    let mut stream = GridStream::new(office, days);
    while let Some(scan) = stream.next() {
        add(scan.utc_nanos.cast_unsigned());
        add(u64::from(scan.view));
        scan.occupied_flips.iter().for_each(|&flip| add(u64::from(flip)));
    }
    sum
}

#[test]
fn options_give_one_stream_everywhere() {
    let options = GridOfficeOptions { views: 3, dwell_scans: 2, ..coarse() };
    let sum = checksum(&office(&options), 2);
    assert_eq!(sum, checksum(&office(&options), 2));
    assert_ne!(sum, checksum(&office(&GridOfficeOptions { seed: 2, ..options.clone() }), 2));
    // A change of the world changes this number, and makes measurements incomparable with earlier ones.
    assert_eq!(sum, 13_298_770_175_966_086_974, "the stream differs from that of earlier versions");
}

#[test]
fn what_is_rebuilt_from_the_stream_is_true() {
    // Clocks go forward on the third day.
    for (views, dwell_scans) in [(1, 1), (5, 1), (4, 30)] {
        let options = GridOfficeOptions { first_day: date(2025, 3, 28), views, dwell_scans, ..coarse() };
        let office = office(&options);
        let changing = |slots: &[u32]| -> Vec<u32> {
            office.changing_cells().iter().copied().filter(|cell| slots.contains(&(cell / 512))).collect()
        };
        let changing_of_view: Vec<Vec<u32>> = (0..views).map(|view| changing(office.view_slots(view))).collect();
        let mut rebuilt = Rebuilt::new(&office);
        let mut stream = GridStream::new(&office, 4);
        let mut number = 0_usize;
        while let Some(scan) = stream.next() {
            rebuilt.take(scan);
            // Different cells in each scan: one of any kind, and four that change.
            let slots = office.view_slots(scan.view);
            let slot = slots[number * 7 % slots.len()];
            let changing = &changing_of_view[scan.view as usize];
            let some = (0..4).filter_map(|nth| changing.get((number * 31 + nth * 977) % changing.len().max(1)));
            let places = some.copied().chain([slot * 512 + (number * 11 % 512) as u32]);
            for place in places {
                let truth = office.truth(place / 512, place % 512, scan.utc_nanos);
                assert_eq!(rebuilt.filled(place), truth, "cell {place} in scan {number}, {views} views");
            }
            number += 1;
        }
        assert_eq!(number, 4 * 288);
    }
}

#[test]
fn a_day_is_generated_without_the_days_before() {
    let options = GridOfficeOptions { first_day: date(2025, 10, 24), views: 3, dwell_scans: 50, ..coarse() };
    let office = office(&options);
    let mut stream = GridStream::new(&office, 4);
    let mut rebuilt = Rebuilt::new(&office);
    for day in 0..4 {
        for slot in 0..office.tiles().len() as u32 {
            assert_eq!(office.shown_before(day, slot), rebuilt.0[slot as usize], "slot {slot} before day {day}");
        }
        for scan in office.day(day).iter() {
            assert_eq!(stream.next(), Some(scan));
            rebuilt.take(scan);
        }
    }
    assert_eq!(stream.next(), None);
}

#[test]
fn the_number_of_changes_is_the_requested_one() {
    for (changes_per_day, seed) in [(40.0, 1), (12.0, 2)] {
        let options = GridOfficeOptions { changes_per_day, seed, ..Default::default() };
        let office = office(&options);
        assert_eq!(office.tiles().len(), 417);
        let changing: BTreeSet<u32> = office.changing_cells().iter().copied().collect();
        assert_eq!(changing.len(), 15_000);
        let mut changed = vec![false; 417 * 512];
        let mut changes = 0;
        let mut stream = GridStream::new(&office, 7);
        stream.next();
        while let Some(scan) = stream.next() {
            assert!(scan.occupied_flips.is_sorted());
            changes += scan.occupied_flips.len();
            scan.occupied_flips.iter().for_each(|&flip| changed[flip as usize] = true);
        }
        let changed: BTreeSet<u32> = (0..417 * 512).filter(|&cell| changed[cell as usize]).collect();
        assert!(changed.is_subset(&changing));
        assert!(changed.len() > 14_000, "{} cells changed", changed.len());
        let mean = changes as f64 / 15_000.0 / 7.0;
        assert!((mean / changes_per_day - 1.0).abs() < 0.1, "{mean} instead of {changes_per_day}");
    }
}

#[test]
fn static_cells_and_changing_cells_are_apart() {
    let office = office(&coarse());
    let still = |address: u32| office.static_occupied(address / 512)[address as usize % 512 / 64] >> (address % 64) & 1;
    assert!(office.changing_cells().iter().all(|&cell| still(cell) == 0));
    let occupied: u32 =
        (0..office.tiles().len() as u32).flat_map(|slot| office.static_occupied(slot)).map(u64::count_ones).sum();
    let share = f64::from(occupied) / (office.tiles().len() as f64 * 512.0);
    assert!((0.1..0.2).contains(&share), "{share}");
}

#[test]
fn views_are_parts_of_the_building_and_scans_keep_to_them() {
    let options = GridOfficeOptions { views: 9, dwell_scans: 4, ..coarse() };
    let office = office(&options);
    let tiles = office.tiles().len();
    let all: Vec<u32> = (0..9).flat_map(|view| office.view_slots(view)).copied().collect();
    assert!(all.iter().copied().eq(0..tiles as u32));
    let mut stream = GridStream::new(&office, 1);
    let mut number = 0;
    while let Some(scan) = stream.next() {
        assert_eq!(scan.view, number / 4 % 9);
        let slots = office.view_slots(scan.view);
        assert!(slots.len().abs_diff(tiles / 9) <= 1);
        assert!(scan.occupied_flips.iter().all(|flip| slots.contains(&(flip / 512))));
        number += 1;
    }
}

#[test]
fn weekends_are_quiet() {
    let office = office(&coarse());
    let flips = |day| office.day(day).iter().skip(1).map(|scan| scan.occupied_flips.len()).sum::<usize>();
    let (friday, saturday, sunday) = (flips(4), flips(5), flips(6));
    assert!(friday > 4 * saturday.max(sunday), "{friday}, {saturday}, {sunday}");
    assert!(saturday.min(sunday) > 0);
}

#[test]
fn scans_are_evenly_spaced_when_clocks_change_and_people_follow_the_clock() {
    for (first_day, shift_hours) in [(date(2025, 3, 24), -1.0), (date(2025, 10, 20), 1.0)] {
        let office = office(&GridOfficeOptions { first_day, ..coarse() });
        let mut stream = GridStream::new(&office, 14);
        let start = stream.next().expect("a first scan").utc_nanos;
        let mut last = 0;
        // For the working days in the weeks before and after the change: number of flips, and sum of their hours UTC.
        let mut weeks = [(0.0, 0.0); 2];
        while let Some(scan) = stream.next() {
            let since = scan.utc_nanos - start;
            assert_eq!(since, last + DAY_NANOS / 288);
            last = since;
            let (day, time) = ((since / DAY_NANOS) as usize, since % DAY_NANOS);
            if day % 7 < 5 {
                let flips = scan.occupied_flips.len() as f64;
                weeks[day / 7].0 += flips;
                weeks[day / 7].1 += flips * time as f64 / HOUR_NANOS as f64;
            }
        }
        assert_eq!(last, 14 * DAY_NANOS - DAY_NANOS / 288);
        let [before, after] = weeks.map(|(flips, hours)| hours / flips);
        let moved = after - before;
        assert!((moved - shift_hours).abs() < 0.4, "the hours of changes moved from {before} to {after} UTC");
    }
}

#[test]
fn most_cells_rest_most_of_the_time_and_the_rest_can_be_learned() {
    let office = office(&GridOfficeOptions { scans_per_day: 96, ..coarse() });
    let cells: Vec<u32> = office.changing_cells().iter().copied().step_by(5).collect();
    let per_week = 7 * 96;
    // By time of the week and cell: how often filled in the first three weeks.
    let mut filled = vec![vec![0; cells.len()]; per_week];
    let mut mean = vec![0; cells.len()];
    let (mut still_wrong, mut weekly_wrong) = (0_u32, 0_u32);
    let mut rebuilt = Rebuilt::new(&office);
    let mut stream = GridStream::new(&office, 4 * 7);
    let mut number = 0;
    while let Some(scan) = stream.next() {
        rebuilt.take(scan);
        for (index, &cell) in cells.iter().enumerate() {
            let now = rebuilt.filled(cell);
            if number < 3 * per_week {
                filled[number % per_week][index] += u32::from(now);
                mean[index] += u32::from(now);
            } else {
                still_wrong += u32::from(now != (mean[index] * 2 > 3 * per_week as u32));
                weekly_wrong += u32::from(now != (filled[number % per_week][index] >= 2));
            }
        }
        number += 1;
    }
    let share = |wrong: u32| f64::from(wrong) / (per_week * cells.len()) as f64;
    let (still, weekly) = (share(still_wrong), share(weekly_wrong));
    assert!((0.04..0.08).contains(&still), "a model that knows the mean only fails in {still}");
    assert!(weekly < 0.75 * still, "a model that knows the week fails in {weekly}, one that does not in {still}");
}

#[test]
fn options_out_of_range_are_named() {
    let refused = |options: GridOfficeOptions| GridOffice::new(&options).expect_err("refused").to_string();
    assert!(refused(GridOfficeOptions { zone: "Europe/Lundon".to_owned(), ..coarse() }).contains("Europe/Lundon"));
    assert!(refused(GridOfficeOptions { cells: 0, ..coarse() }).contains("cells"));
    assert!(refused(GridOfficeOptions { views: 140, ..coarse() }).contains("views must be 1 to 139, and is 140"));
    assert!(refused(GridOfficeOptions { changing_cells: 71_000, ..coarse() }).contains("changing_cells"));
    assert!(refused(GridOfficeOptions { scans_per_day: 0, ..coarse() }).contains("scans_per_day"));
    assert!(refused(GridOfficeOptions { dwell_scans: 0, ..coarse() }).contains("dwell_scans"));
    assert!(refused(GridOfficeOptions { first_day: date(-2025, 1, 1), ..coarse() }).contains("first_day"));
    assert!(refused(GridOfficeOptions { changes_per_day: f64::NAN, ..coarse() }).contains("changes_per_day"));
    let quiet = GridOffice::new(&GridOfficeOptions { changes_per_day: 1.0, ..coarse() });
    assert!(matches!(quiet, Err(GridOfficeError::TooQuiet { least, .. }) if least > 1.0));
}

#[test]
fn the_smallest_office_has_one_tile() {
    let options = GridOfficeOptions { cells: 1, changing_cells: 20, views: 1, ..coarse() };
    let office = office(&options);
    assert_eq!(office.tiles().len(), 1);
    assert!(office.day(0).iter().skip(1).any(|scan| !scan.occupied_flips.is_empty()));
}
