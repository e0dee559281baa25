//! Tests the properties of `cell.rs`, against the model trained on the same observations.

use proptest::prelude::*;

use super::*;
use crate::{Accumulator, ORDER_MAX, PhasorTable, RunningSums, Sample};

const DAY_NANOS: i64 = 86_400_000_000_000;

/// The sums A and B of runs, computed in the way of a grid.
fn sums_of_runs(periodicities: &Periodicities, observed: &[(i64, bool)]) -> (PhasorSum, PhasorSum) {
    let times: Vec<i64> = observed.iter().map(|(civil, _)| *civil).collect();
    let mut running = RunningSums::new(periodicities);
    running.extend_chunk(&PhasorTable::new(periodicities, &times));
    let (mut a, mut b, mut at) = (PhasorSum::zero(periodicities), PhasorSum::zero(periodicities), 0);
    for run in observed.chunk_by(|first, second| first.1 == second.1) {
        if run[0].1 {
            a.add_difference(running.row(at + run.len()), running.row(at));
        }
        at += run.len();
    }
    b.add_difference(running.row(at), running.row(0));
    (a, b)
}

fn any_periodicities() -> impl Strategy<Value = Periodicities> {
    prop_oneof![
        Just(Periodicities::default()),
        (1_u32..300).prop_map(|count| Periodicities::harmonics(7 * DAY_NANOS, count).unwrap()),
        (1_i64..70)
            .prop_map(|count| Periodicities::list((1..=count).map(|k| k * 3_000_000_000_000).collect()).unwrap()),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn the_model_is_that_of_the_same_observations(
        periodicities in any_periodicities(),
        days in 1_i64..20,
        spread in proptest::collection::vec((0.0..1.0, any::<bool>()), 1..150),
        levels in (0.0..=1.0, 0.0..=1.0),
    ) {
        let mut observed: Vec<(i64, bool)> =
            spread.iter().map(|(at, occupied)| ((at * (days * DAY_NANOS) as f64) as i64, *occupied)).collect();
        observed.sort_unstable();
        let level = |occupied: bool| if occupied { levels.1 } else { levels.0 };
        let samples: Vec<Sample> =
            observed.iter().map(|&(at, occupied)| Sample { utc_nanos: at, offset_secs: 0, value: level(occupied) }).collect();
        let mut accumulator = Accumulator::new(&periodicities);
        accumulator.add(&periodicities, &samples);
        let expected = SpectralModel::train(&accumulator, &periodicities);

        let (a, b) = sums_of_runs(&periodicities, &observed);
        let found = SpectralModel::train_on_sums(
            CellSums {
                observations: observed.len() as u64,
                weight: observed.len() as f64,
                mean: observed.iter().filter(|(_, occupied)| *occupied).count() as f64 / observed.len() as f64,
                a: &a,
                b: &b,
                span_nanos: accumulator.span_nanos(),
                gap_nanos: (0, 0),
                levels,
            },
            &periodicities,
        );
        prop_assert_eq!(found.observations(), expected.observations());
        prop_assert!((found.mean() - expected.mean()).abs() < 1e-9);
        // Rounding may swap equally strong components and leave traces of components that are zero.
        let strength = |model: &SpectralModel, rank: usize| model.components().get(rank).map_or(0.0, Component::amplitude);
        for rank in 0..ORDER_MAX {
            prop_assert!((strength(&found, rank) - strength(&expected, rank)).abs() < 1e-9, "rank {rank}");
        }
        let per_observation = 1.0 / accumulator.observations() as f64;
        for component in found.components() {
            let k = component.periodicity as usize;
            prop_assert!(periodicities.is_eligible(k, accumulator.span_nanos()));
            let [a_re, a_im, b_re, b_im] = accumulator.spectrum()[k];
            let re = (a_re - accumulator.mean() * b_re) * per_observation;
            let im = (a_im - accumulator.mean() * b_im) * per_observation;
            prop_assert!((component.gamma_re - re).hypot(component.gamma_im - im) < 1e-9);
        }
    }
}

/// The model of sums that have these real parts, and imaginary parts of 0.
fn of_real_parts(periodicities: &Periodicities, real: &[f64], observations: u64) -> SpectralModel {
    let mut parts = vec![0.0; 2 * real.len()];
    parts[..real.len()].copy_from_slice(real);
    let a = PhasorSum::from_slice(periodicities, &parts).unwrap();
    let b = PhasorSum::zero(periodicities);
    let (span_nanos, levels) = (u64::MAX, (0.2, 0.7));
    let weight = observations as f64;
    SpectralModel::train_on_sums(
        CellSums { observations, weight, mean: 0.5, a: &a, b: &b, span_nanos, gap_nanos: (0, 0), levels },
        periodicities,
    )
}

#[test]
fn the_strongest_come_first_and_equal_ones_by_index() {
    let week = Periodicities::default();
    let indices = |real: &[f64]| -> Vec<u32> {
        of_real_parts(&week, real, 10).components().iter().map(|component| component.periodicity).collect()
    };
    assert_eq!(indices(&[3.0; 168]), (0..15).collect::<Vec<u32>>());
    let ascending: Vec<f64> = (0..168).map(f64::from).collect();
    assert_eq!(indices(&ascending), (153..168).rev().collect::<Vec<u32>>());
    let mut three = [0.0; 168];
    (three[167], three[3], three[90]) = (-2.0, 1.0, 2.0);
    assert_eq!(indices(&three), [90, 167, 3]);
    assert!(indices(&[0.0; 168]).is_empty());
}

#[test]
fn nothing_observed_is_never_updated() {
    let week = Periodicities::default();
    assert_eq!(of_real_parts(&week, &[0.0; 168], 0), SpectralModel::default());
}

#[test]
fn every_instruction_set_chooses_the_same() {
    let periodicities = Periodicities::harmonics(7 * DAY_NANOS, 133).unwrap();
    let real: Vec<f64> = (0..133).map(|k| f64::from(k * 37 % 71) - 20.0).collect();
    let expected = of_real_parts(&periodicities, &real, 100);
    let parts: Vec<f64> = real.iter().copied().chain([0.0; 133]).collect();
    let (a, b) = (PhasorSum::from_slice(&periodicities, &parts).unwrap(), PhasorSum::zero(&periodicities));
    let sums = CellSums {
        observations: 100,
        weight: 100.0,
        mean: 0.5,
        a: &a,
        b: &b,
        span_nanos: u64::MAX,
        gap_nanos: (0, 0),
        levels: (0.2, 0.7),
    };
    let mut first = None;
    for arch in crate::phasor::every_arch() {
        let mut strongest = Strongest::new();
        arch.dispatch(CellTraining {
            sums: &sums,
            scale: 0.005,
            span_nanos: u64::MAX,
            resolved_nanos: 0,
            periodicities: &periodicities,
            strongest: &mut strongest,
        });
        let found = strongest.into_components(&Periodicities::default());
        assert_eq!(found.len(), expected.components().len());
        for (found, expected) in found.iter().zip(expected.components()) {
            assert_eq!(found.periodicity, expected.periodicity);
            assert!((found.gamma_re - expected.gamma_re).abs() < 1e-12);
        }
        let bits = |component: &Component| (component.gamma_re.to_bits(), component.gamma_im.to_bits());
        let bits: Vec<_> = found.iter().map(bits).collect();
        assert_eq!(first.get_or_insert_with(|| bits.clone()), &bits, "{arch:?}");
    }
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    for count in (1..42).chain([63, 64, 65, 129]) {
        let periodicities = Periodicities::harmonics(7 * DAY_NANOS, count).unwrap();
        let parts = |pace: f64| -> PhasorSum {
            let parts: Vec<f64> = (0..2 * count).map(|k| 9.0 * (pace * f64::from(k)).sin()).collect();
            PhasorSum::from_slice(&periodicities, &parts).unwrap()
        };
        let (a, b) = (parts(0.7), parts(1.9));
        let (span_nanos, gap_nanos, levels) = (u64::MAX, (0, 0), (0.1, 0.9));
        let sums = CellSums { observations: 90, weight: 87.3, mean: 0.31, a: &a, b: &b, span_nanos, gap_nanos, levels };
        let mut first = None;
        for arch in crate::phasor::every_arch() {
            let mut strongest = Strongest::new();
            let (sums, scale, periodicities, kept) = (&sums, 0.8 / 87.3, &periodicities, &mut strongest);
            arch.dispatch(CellTraining { sums, scale, span_nanos, resolved_nanos: 0, periodicities, strongest: kept });
            let found = strongest.into_components(periodicities);
            assert_eq!(found.len(), ORDER_MAX.min(count as usize));
            let bits = |one: &Component| (one.periodicity, one.gamma_re.to_bits(), one.gamma_im.to_bits());
            let bits: Vec<_> = found.iter().map(bits).collect();
            assert_eq!(first.get_or_insert_with(|| bits.clone()), &bits, "{arch:?}, {count} periodicities");
        }
    }
}
