//! Packing, tested by examples and by unpacking as the protocol states.

use proptest::prelude::*;
use prost::Message as _;

use super::*;

fn names(count: u32) -> Vec<Box<str>> {
    (0..count).map(|i| format!("state {i}").into()).collect()
}

fn entry(state: u32, time_nanos: i64, value: f64) -> Entry {
    Entry { state, time_nanos, value, position: None }
}

/// Reads columns as `types.proto` defines them, independently of the packing.
fn unpacked(columns: &ObservationColumns, table: &mut Vec<String>) -> Vec<(String, i64, u64)> {
    table.extend(columns.new_states.iter().cloned());
    let mut time = columns.first_time_nanos;
    let mut read = Vec::new();
    for (i, delta) in columns.time_deltas.iter().enumerate() {
        time += delta * i64::try_from(columns.time_unit_nanos).unwrap_or(0);
        let index = columns.state_indices.get(i).copied().unwrap_or(0);
        let value =
            if columns.values.is_empty() { f64::from((columns.bits[i / 8] >> (i % 8)) & 1) } else { columns.values[i] };
        read.push((table[index as usize].clone(), time, value.to_bits()));
    }
    read
}

#[test]
fn minutes_of_one_door_take_a_byte_and_a_bit_each() {
    let minute = 60_000_000_000;
    let entries: Vec<_> = (0..4096).map(|i| entry(0, i * minute, f64::from(u8::from(i % 3 == 0)))).collect();
    let columns = pack(&entries, &names(1), &mut StreamTable::default());
    assert_eq!(columns.time_unit_nanos, minute.unsigned_abs());
    assert_eq!(columns.time_deltas[..3], [0, 1, 1]);
    assert!(columns.state_indices.is_empty() && columns.values.is_empty());
    assert_eq!(columns.bits[0], 0b0100_1001);
    assert!(columns.encoded_len() < 4096 + 512 + 64, "{}", columns.encoded_len());
}

#[test]
fn a_name_travels_once_per_stream() {
    let mut table = StreamTable::default();
    let first = pack(&[entry(5, 0, 0.0), entry(2, 0, 0.0), entry(5, 0, 0.0)], &names(6), &mut table);
    assert_eq!(first.new_states, ["state 5", "state 2"]);
    assert_eq!(first.state_indices, [0, 1, 0]);
    let second = pack(&[entry(2, 0, 0.0), entry(3, 0, 0.0)], &names(6), &mut table);
    assert_eq!(second.new_states, ["state 3"]);
    assert_eq!(second.state_indices, [1, 2]);
}

#[test]
fn equal_times_have_the_unit_1() {
    let columns = pack(&[entry(0, 7, 1.0), entry(0, 7, 1.0)], &names(1), &mut StreamTable::default());
    assert_eq!((columns.time_unit_nanos, columns.first_time_nanos), (1, 7));
}

#[test]
fn values_other_than_0_and_1_are_kept_bit_for_bit() {
    for value in [0.5, f64::NAN, -0.0, 2.0, f64::INFINITY] {
        let columns = pack(&[entry(0, 0, 1.0), entry(0, 0, value)], &names(1), &mut StreamTable::default());
        assert!(columns.bits.is_empty());
        assert_eq!(columns.values[1].to_bits(), value.to_bits());
    }
}

#[test]
fn long_names_make_messages_of_fewer_observations() {
    let names: Vec<Box<str>> = (0..100).map(|_| "n".repeat(500).into()).collect();
    let entries: Vec<_> = (0..100).map(|i| entry(i, 0, 1.0)).collect();
    let limits = BatchLimits { observations: 4096, bytes: 10_000 };
    let count = fitting(entries.iter(), &names, &StreamTable::default(), limits);
    assert_eq!(count, 18);
    let none = BatchLimits { observations: 0, bytes: 0 };
    assert_eq!(fitting(entries.iter(), &names, &StreamTable::default(), none), 1, "or nothing would ever be sent");
}

fn entries() -> impl Strategy<Value = Vec<Entry>> {
    let value = prop_oneof![Just(0.0), Just(1.0), any::<f64>()];
    let time = prop_oneof![0..=i64::MAX, (0..1_000_000_i64).prop_map(|secs| secs * 1_000_000_000)];
    proptest::collection::vec((0..20_u32, time, value).prop_map(|(s, t, v)| entry(s, t, v)), 1..200)
}

proptest! {
    #[test]
    fn what_is_unpacked_is_what_was_packed(batches in proptest::collection::vec(entries(), 1..4)) {
        let names = names(20);
        let (mut table, mut receiver) = (StreamTable::default(), Vec::new());
        for batch in batches {
            let read = unpacked(&pack(&batch, &names, &mut table), &mut receiver);
            let sent: Vec<_> = batch
                .iter()
                .map(|e| (names[e.state as usize].to_string(), e.time_nanos, e.value.to_bits()))
                .collect();
            prop_assert_eq!(read, sent);
        }
    }

    #[test]
    fn a_message_keeps_to_its_limit_of_bytes(batch in entries(), bytes in 200..4096_usize) {
        let (names, mut table) = (names(20), StreamTable::default());
        let limits = BatchLimits { observations: 100, bytes };
        let mut rest = batch.as_slice();
        while !rest.is_empty() {
            let count = fitting(rest.iter(), &names, &table, limits);
            prop_assert!((1..=100).contains(&count));
            let columns = pack(&rest[..count], &names, &mut table);
            prop_assert!(columns.encoded_len() + 32 <= bytes);
            rest = &rest[count..];
        }
    }
}

#[test]
fn positions_travel_as_coordinates_with_names_for_them() {
    let at = |state, coordinates: &[f64]| Entry { position: Position::of(coordinates), ..entry(state, 0, 0.0) };
    let entries = [at(1, &[1.5, -2.0]), entry(0, 0, 1.0), at(2, &[0.0, 1.0, 2.0]), at(1, &[3.0, 4.0])];
    let mut table = StreamTable::default();
    let columns = pack(&entries, &names(3), &mut table);
    assert_eq!(columns.new_states, ["state 1", "state 0", "state 2"]);
    let vector: i32 = StateKind::Vector.into();
    assert_eq!((columns.new_kinds, columns.new_dimensions), (vec![vector, 0, vector], vec![2, 0, 3]));
    assert_eq!(columns.coordinates, [1.5, -2.0, 0.0, 1.0, 2.0, 3.0, 4.0]);
    assert_eq!((columns.bits.as_ref(), columns.values.len()), (&[0b10][..], 0));
    let again = pack(&entries, &names(3), &mut table);
    assert!(again.new_kinds.is_empty() && again.new_dimensions.is_empty() && again.coordinates.len() == 7);
    // Eight observations, coordinate by coordinate.
    for (limit, count) in [(8, 4), (7, 3), (5, 2), (3, 2), (2, 1), (1, 1)] {
        let limits = BatchLimits { observations: limit, bytes: 1 << 20 };
        assert_eq!(fitting(entries.iter(), &names(3), &StreamTable::default(), limits), count, "{limit}");
    }
}
