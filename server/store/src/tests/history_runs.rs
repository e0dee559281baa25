//! Observations that repeat: stored as runs, read back exactly, and small.
//!
//! Invariant: sizes are those of files on the disk, with their headers and tables.

use std::sync::Arc;

use proptest::{collection::vec, prelude::*};
use prost::Message as _;
use tidemap_grid::spec::Retention;
use tidemap_layout::{event::VALUES_BITS, history::StateSamples};
use tidemap_map::{
    history::{
        HistoryPiece,
        origins::{OriginRun, Origins},
    },
    ids::{ProducerId, StateId},
    snapshot::MapSnapshot,
    spec::MapSpec,
};
use tidemap_model::Sample;

use super::{
    example::options,
    grid_example::{DAY_NANOS, snapshot, spec},
};
use crate::{
    MapId, Store,
    record::history::{decode_samples, encode_samples},
};

const MAP: MapId = MapId(1);
const SECOND: i64 = 1_000_000_000;
const MONDAY: i64 = 20_000 / 7 * 7 * DAY_NANOS + 4 * DAY_NANOS;

fn of_one(first: u64, count: usize) -> Origins {
    let count = u32::try_from(count).expect("few");
    Origins { runs: vec![OriginRun { producer: ProducerId(0), first, count }], ..Origins::default() }
}

fn sample(utc_nanos: i64, value: f64) -> Sample {
    Sample { utc_nanos, offset_secs: 3600, value }
}

/// A door on one day of a clean week, read every second: office hours, a lunch break, and a minute for the cleaner; it
/// stays closed at the weekend.
fn door(day: i64, number: i64) -> Vec<Sample> {
    let open = |second: i64| {
        let second = second - 97 * number;
        let is_office = (28_800..43_200).contains(&second) || (46_800..63_000).contains(&second);
        (day % 7 < 5 && is_office) || (72_000..72_060).contains(&second)
    };
    let value = |second: i64| f64::from(u8::from(open(second)));
    (0..86_400).map(|second| sample(MONDAY + day * DAY_NANOS + second * SECOND, value(second))).collect()
}

/// The bytes on the disk of the pieces, after all has been read back.
fn bytes(pieces: &[HistoryPiece]) -> u64 {
    let directory = tempfile::tempdir().expect("temporary directory");
    let spec = MapSpec { retention: Retention::Forever, ..spec("office") };
    let store = Store::open(directory.path(), options()).expect("opens");
    store.create_map(&spec).expect("creates");
    let history = pieces.iter().cloned().map(Arc::new).collect();
    store.save(MAP, &MapSnapshot { history, ..snapshot(&spec, 3, 2) }).expect("saves");
    let history = store.history(MAP).expect("known");
    for id in pieces.iter().flat_map(|piece| &piece.states).map(|(id, _)| *id) {
        let of_state = pieces.iter().flat_map(|piece| &piece.states).filter(|(state, _)| *state == id);
        let expected: Vec<Sample> = of_state.flat_map(|(_, samples)| samples).copied().collect();
        assert!(history.state(id, 0, i64::MAX).expect("readable") == expected, "state {} is read as another", id.0);
    }
    history.sizes().expect("readable").state_bytes
}

/// Readings of a bit for each bit on the disk (T-RO 2017, equation 16).
fn ratio(readings: u64, bytes: u64) -> f64 {
    readings as f64 / (8.0 * bytes as f64)
}

#[test]
fn a_clean_week_of_a_door_takes_a_hundredth_of_a_bit_a_reading() {
    let mut piece = HistoryPiece::new(1);
    let week: Vec<Sample> = (0..7).flat_map(|day| door(day, 0)).collect();
    piece.origins.push(of_one(1, week.len()));
    piece.states.push((StateId(0), week));
    let bytes = bytes(&[piece]);
    println!("one door, learned at once: {bytes} bytes, 1 : {:.0}", ratio(7 * 86_400, bytes));
    assert!(ratio(7 * 86_400, bytes) >= 100.0, "{bytes} bytes");
}

#[test]
fn a_door_beside_others_takes_as_little_where_every_night_has_its_file() {
    let nightly = |doors: u32| -> u64 {
        let piece = |day: i64| {
            let mut piece = HistoryPiece::new(day as u64 + 1);
            piece.states = (0..doors).map(|id| (StateId(id), door(day, id.into()))).collect();
            piece.origins = vec![of_one(1 + 86_400 * day as u64, 86_400); doors as usize];
            piece
        };
        bytes(&(0..7).map(piece).collect::<Vec<_>>())
    };
    let (one, ten) = (nightly(1), nightly(10));
    println!("one door: {one} bytes, 1 : {:.0}; ten: {ten}, 1 : {:.0}", ratio(604_800, one), ratio(6_048_000, ten));
    // The header, the end and the trailer of the files belong to no door.
    let nine = ten - one;
    println!("nine more doors: {nine} bytes, 1 : {:.0}", ratio(9 * 604_800, nine));
    assert!(ratio(9 * 604_800, nine) >= 100.0, "{nine} bytes");
    assert!(one <= 7 * 256, "a night of one door takes {one} / 7 bytes");
}

#[test]
fn a_missing_reading_costs_a_run_and_not_a_byte_a_reading() {
    let mut day = door(0, 0);
    day.remove(40_000);
    day.remove(1000);
    let message = encode_samples(StateId(0), &day, &of_one(1, day.len())).expect("valid");
    assert!(message.encoded_len() < 100, "{} bytes", message.encoded_len());
    assert_eq!(decode_samples(&message), Ok(day));
}

#[test]
fn records_without_runs_are_read_as_before() {
    // Seconds 0, 1, 2, 4, …, of which the values 1 to 4 and 12 to 15 are 1.
    let times = [2, 2, 4].iter().copied().chain([2; 13]).collect();
    let message = StateSamples {
        state: 7,
        count: 17,
        first_time_nanos: 5 * SECOND,
        time_unit_nanos: 1_000_000_000,
        times,
        value_encoding: VALUES_BITS,
        values: vec![0b0001_1110, 0b1111_0000, 0],
        offset_counts: vec![17],
        offset_secs: vec![3600],
        run_counts: vec![17],
        run_producers: vec![0],
        run_steps: vec![1],
        ..StateSamples::default()
    };
    let expected: Vec<Sample> = (0..17)
        .map(|place| {
            let value = f64::from(u8::from((1..=4).contains(&place) || (12..=15).contains(&place)));
            sample((5 + place + i64::from(place > 2)) * SECOND, value)
        })
        .collect();
    assert_eq!(decode_samples(&message), Ok(expected));
}

#[test]
fn runs_that_are_not_as_long_as_the_column_are_refused() {
    let day = door(0, 0);
    let good = encode_samples(StateId(0), &day, &of_one(1, day.len())).expect("valid");
    assert!(!good.value_runs.is_empty() && good.time_runs.is_empty(), "values in runs, times at equal steps");
    let refused = |change: fn(&mut StateSamples)| {
        let mut bad = good.clone();
        change(&mut bad);
        assert!(decode_samples(&bad).is_err(), "{bad:?}");
    };
    refused(|bad| bad.value_runs.truncate(bad.value_runs.len() - 1));
    refused(|bad| bad.value_runs.push(0));
    refused(|bad| bad.value_runs.push(1));
    refused(|bad| bad.value_runs.extend([0xFF, 0xFF, 0xFF, 0xFF, 0x0F]));
    refused(|bad| bad.value_runs[0] = 0);
    refused(|bad| bad.values.push(0));
    refused(|bad| bad.time_runs = vec![1]);
    refused(|bad| bad.count = 0);
    refused(|bad| bad.count = u32::MAX);
}

/// Runs of equal values and of equal steps, of any kind of value; some are a single reading long.
fn samples() -> impl Strategy<Value = Vec<Sample>> {
    let value = prop_oneof![
        Just(0.0),
        Just(1.0),
        Just(-0.0),
        Just(f64::NAN),
        -1e12..=1e12,
        (0..1000_u16).prop_map(|thousandth| f64::from(f32::from(thousandth) / 1000.0)),
    ];
    let binary = prop_oneof![Just(0.0), Just(1.0)];
    let length = || prop_oneof![1..4_usize, 1..300_usize];
    let values = prop_oneof![vec((value, length()), 1..30), vec((binary, length()), 1..30)];
    let step = prop_oneof![Just(SECOND), Just(0), -SECOND..SECOND];
    (values, vec((step, length()), 1..30), 0..i64::MAX / 2).prop_map(|(values, steps, start)| {
        let values = values.into_iter().flat_map(|(value, length)| std::iter::repeat_n(value, length));
        let steps = steps.into_iter().flat_map(|(step, length)| std::iter::repeat_n(step, length)).cycle();
        // Far enough from 1970 for all steps back.
        let times = steps.scan(start + 100_000 * SECOND, |now, step| {
            *now += step;
            Some(*now)
        });
        times.zip(values).map(|(time, value)| sample(time, value)).collect()
    })
}

proptest! {
    #[test]
    fn any_runs_are_read_back_bit_by_bit(samples in samples()) {
        let message = encode_samples(StateId(3), &samples, &of_one(1, samples.len())).expect("valid");
        let stored = StateSamples::decode(&message.encode_to_vec()[..]).expect("a message");
        let bits = |samples: &[Sample]| -> Vec<_> {
            samples.iter().map(|s| (s.utc_nanos, s.offset_secs, s.value.to_bits())).collect()
        };
        prop_assert_eq!(bits(&decode_samples(&stored).expect("readable")), bits(&samples));
    }
}
