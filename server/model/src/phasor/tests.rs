//! Tests the properties of `phasor.rs`, against a naive oracle where there is one.

use proptest::prelude::*;
use pulp::Arch;

use super::*;
use crate::InstructionSet;

/// Every instruction set that this machine can run the kernels on.
pub(crate) fn every_arch() -> Vec<Arch> {
    InstructionSet::available().filter_map(InstructionSet::arch).collect()
}

const DAY_NANOS: i64 = 86_400_000_000_000;

fn any_times() -> impl Strategy<Value = Vec<i64>> {
    proptest::collection::vec(prop_oneof![0..i64::MAX, 0..60 * DAY_NANOS, -DAY_NANOS..DAY_NANOS], 0..80)
}

#[track_caller]
fn check_row(table: &PhasorTable, k: u32) {
    let (cos, sin) = table.row(k).expect("a row that the table holds");
    assert_eq!((cos.len(), sin.len()), (table.len(), table.len()));
    for (i, &civil) in table.civil_nanos().iter().enumerate() {
        let turns = table.periodicities().turns(k as usize, civil).unwrap();
        let (exact_sin, exact_cos) = (std::f64::consts::TAU * turns).sin_cos();
        let error = (cos[i] - exact_cos).hypot(sin[i] - exact_sin);
        assert!(error < 1e-11, "periodicity {k} at {civil}: off by {error:e}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn every_entry_is_the_cosine_and_sine_of_its_phase(
        base_nanos in 2_048_000_000_000_i64..3_000_000_000_000_000_000,
        count in prop_oneof![1_u32..200, Just(2048_u32)],
        times in any_times(),
    ) {
        let table = PhasorTable::new(&Periodicities::harmonics(base_nanos, count).unwrap(), &times);
        (0..count).for_each(|k| check_row(&table, k));
        prop_assert!(table.row(count).is_none());
    }

    #[test]
    fn lists_and_chosen_rows_are_as_exact(times in any_times(), chosen in proptest::collection::vec(0_u32..6, 0..5)) {
        let periods = [DAY_NANOS, 1_000_000_000, 7 * DAY_NANOS, 11_234_567_891, 36_525 * DAY_NANOS, 3 * DAY_NANOS];
        let list = Periodicities::list(periods.to_vec()).unwrap();
        let table = PhasorTable::new(&list, &times);
        (0..6).for_each(|k| check_row(&table, k));
        for periodicities in [list, Periodicities::default()] {
            let table = PhasorTable::only(&periodicities, &times, &chosen);
            for k in 0..6 {
                if chosen.contains(&k) { check_row(&table, k) } else { assert!(table.row(k).is_none()) }
            }
        }
    }
}

#[test]
fn a_periodicity_that_does_not_exist_has_phasors_of_zero() {
    let table = PhasorTable::only(&Periodicities::default(), &[1, 2, 3], &[400, 2]);
    assert_eq!(table.row(400), Some((&[0.0; 3][..], &[0.0; 3][..])));
    check_row(&table, 2);
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    (0..42).chain([63, 64, 65, 77]).for_each(check_instruction_sets);
}

fn check_instruction_sets(times: i64) {
    let times: Vec<i64> = (0..times).map(|i| i * i * 987_654_321_012).collect();
    let table = PhasorTable::new(&Periodicities::default(), &times);
    let base_turns: Vec<f64> = times.iter().map(|&t| table.periodicities().turns(0, t).unwrap()).collect();
    let bits = |row: &[f64]| row.iter().map(|entry| entry.to_bits()).collect::<Vec<_>>();
    for arch in every_arch() {
        let (mut cos, mut sin) = (table.cos.clone(), table.sin.clone());
        for k in 0..168 {
            cos.row_mut(k).fill(0.0);
            sin.row_mut(k).fill(0.0);
        }
        arch.dispatch(FillHarmonics { turns: &base_turns, harmonics: 168, cos: &mut cos, sin: &mut sin });
        for k in 0..168 {
            assert_eq!(bits(cos.row(k)), bits(table.cos.row(k)), "{arch:?}");
            assert_eq!(bits(sin.row(k)), bits(table.sin.row(k)), "{arch:?}");
        }
        let (mut cos, mut sin) = (vec![0.0; times.len()], vec![0.0; times.len()]);
        arch.dispatch(FillRow { turns: &base_turns, factor: 41.0, cos: &mut cos, sin: &mut sin });
        let chosen = PhasorTable::only(table.periodicities(), &times, &[40]);
        let (row_cos, row_sin) = chosen.row(40).unwrap();
        assert_eq!((bits(&cos), bits(&sin)), (bits(row_cos), bits(row_sin)), "{arch:?}");
    }
}
