//! Tests the properties of `instant.rs`.

use proptest::prelude::*;

use super::*;
use crate::{Component, ORDER_MAX};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn predictions_are_those_of_a_single_one(
        mean in 0.0..=1.0,
        parts in proptest::collection::vec((0_u32..200, -0.3..0.3, -0.3..0.3), 0..=ORDER_MAX),
        order in 0_usize..20,
        civil_nanos in any::<i64>(),
    ) {
        let periods: Vec<i64> = (1..=180).map(|k| k * 4_000_000_000_000).collect();
        for periodicities in [Periodicities::default(), Periodicities::list(periods).unwrap()] {
            let components = parts
                .iter()
                .map(|&(periodicity, gamma_re, gamma_im)| Component { periodicity, gamma_re, gamma_im })
                .collect();
            let model = SpectralModel::from_parts(mean, 9, components).unwrap();
            let phasors = InstantPhasors::new(&periodicities, civil_nanos);
            prop_assert_eq!(phasors.civil_nanos(), civil_nanos);
            let (found, expected) =
                (model.predict_at(order, &phasors), model.predict(&periodicities, order, civil_nanos));
            prop_assert_eq!(found.to_bits(), expected.to_bits());
            prop_assert!((0.0..=1.0).contains(&found));
        }
    }
}
