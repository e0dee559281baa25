//! Compares the times and changes of a day with those of single readings.

use proptest::prelude::*;
use tidemap_model::{GapSample, Persistence};

use super::*;
use crate::update::shared_sums::Counted;

fn toggles(bits: &[bool]) -> Vec<u32> {
    let before = std::iter::once(false).chain(bits.iter().copied());
    let flips = before.zip(bits).enumerate().filter(|(_, (before, now))| before != *now);
    flips.map(|(scan, _)| u32::try_from(scan).expect("few")).collect()
}

fn times(utc_nanos: Vec<i64>) -> Times {
    let all = Counted { observations: 0, first_nanos: 0, last_nanos: 0 };
    Times::of_scans(utc_nanos.clone(), utc_nanos.into(), all, None)
}

proptest! {
    #[test]
    fn a_day_is_what_its_single_readings_are(
        steps in prop::collection::vec((0_i64..40, any::<bool>(), any::<bool>()), 1..60),
        order in 0..3,
        last in prop::option::of((-2_000_i64..300, any::<bool>())),
    ) {
        let mut nanos = 0;
        let mut scans: Vec<(i64, bool, bool)> = steps
            .into_iter()
            .map(|(step, observed, occupied)| {
                nanos += 60_000_000_000 * (step + i64::from(order == 0));
                (nanos, observed, observed && occupied)
            })
            .collect();
        if order == 2 {
            // The order of the scans is as if three robots sent an hour each at a time.
            scans.chunks_mut(7).for_each(<[_]>::reverse);
        }
        let times = times(scans.iter().map(|scan| scan.0).collect());
        let observed = toggles(&scans.iter().map(|scan| scan.1).collect::<Vec<_>>());
        let occupied = toggles(&scans.iter().map(|scan| scan.2).collect::<Vec<_>>());
        scans.sort_by_key(|scan| scan.0);
        let last = last.map(|(minutes, value)| (60_000_000_000 * minutes, value));

        let mut naive = Persistence::default();
        let mut gaps = GapSample::default();
        if let Some((nanos, value)) = last {
            naive.observe(nanos, f64::from(u8::from(value)));
        }
        let mut hours: Vec<i64> = Vec::new();
        for &(nanos, _, occupied) in scans.iter().filter(|scan| scan.1) {
            if let Some((before, _)) = naive.last().filter(|(before, _)| nanos > *before) {
                gaps.observe_many(1, |_| nanos.abs_diff(before));
            }
            naive.observe(nanos, f64::from(u8::from(occupied)));
            hours.push(nanos.div_euclid(3_600_000_000_000));
        }
        hours.dedup();

        let last_nanos = last.map(|(nanos, _)| nanos);
        let found = times.observe(ObservedTimes::default(), &observed, last_nanos, DayFactors::EQUAL);
        let mut by_hour = [[0.0; 24]; 2];
        for hour in &hours {
            // 1970-01-01 was a Thursday.
            let is_weekend = (hour.div_euclid(24) + 3).rem_euclid(7) >= 5;
            by_hour[usize::from(is_weekend)][hour.rem_euclid(24) as usize] += 1.0;
        }
        prop_assert_eq!(found, ObservedTimes { gaps, hours: hours.len() as f64, by_hour });
        let changes = times.changes(&observed, &occupied, last_nanos, last.map(|(_, value)| value));
        prop_assert_eq!(changes.rate_sum.to_bits(), naive.to_parts().change_rate_sum.to_bits());
        prop_assert_eq!(changes.last, naive.last().map(|(_, value)| value > 0.5));
    }
}
