//! Tests the properties of `gaps.rs`.

use super::*;

const HOUR: u64 = 3_600 * SEC_NANOS;

fn gaps(times_nanos: impl IntoIterator<Item = u64>) -> Gaps {
    let mut gaps = Gaps::default();
    times_nanos.into_iter().for_each(|nanos| gaps.observe(nanos));
    gaps
}

#[test]
fn few_gaps_are_known_exactly() {
    assert_eq!((gaps([]).median_nanos(), gaps([]).regular_nanos()), (0, None));
    assert_eq!(gaps([5 * HOUR]).median_nanos(), 5 * HOUR);
    assert_eq!(gaps([5 * HOUR, HOUR, 3 * HOUR]).median_nanos(), 3 * HOUR);
    assert_eq!(gaps((1..=16).rev().map(|hours| hours * HOUR)).median_nanos(), 8 * HOUR);
    assert_eq!(gaps([u64::MAX]).median_nanos(), u64::from(u32::MAX) * SEC_NANOS);
}

#[test]
fn many_gaps_are_a_fair_sample() {
    // Every third gap is long, in a fixed pattern.
    let known = gaps((0..100_000).map(|number| if number % 3 == 0 { 9 * HOUR } else { HOUR }));
    assert_eq!((known.median_nanos(), known.regular_nanos()), (HOUR, Some(HOUR)));
    let long = known.to_parts().kept.iter().filter(|(_, secs)| *secs > 3_600).count();
    assert!((2..=9).contains(&long), "{long}");
}

#[test]
fn regular_readings_may_miss_some_and_have_one_out_of_turn() {
    assert_eq!(gaps([12 * HOUR; 7]).regular_nanos(), None, "too few");
    assert_eq!(gaps([12 * HOUR; 8]).regular_nanos(), Some(12 * HOUR));
    assert_eq!(
        gaps([12, 12, 24, 12, 12, 1, 12, 12, 36, 12].map(|hours| hours * HOUR)).regular_nanos(),
        Some(12 * HOUR)
    );
    assert_eq!(gaps([12, 1, 24, 12, 12, 1, 12, 12, 36, 12].map(|hours| hours * HOUR)).regular_nanos(), None);
    assert_eq!(gaps([0; 10]).regular_nanos(), None);
}

#[test]
fn parts_make_the_same_again_and_what_cannot_be_is_refused() {
    for count in [0, 5, 16, 1_000] {
        let known = gaps((0..count).map(|number| number * HOUR));
        assert_eq!(Gaps::from_parts(known.to_parts()), Ok(known));
    }
    let parts = gaps((0..100).map(|number| number * HOUR)).to_parts();
    assert!(Gaps::from_parts(GapsParts { count: 3, ..parts.clone() }).is_err());
    let swapped = GapsParts { kept: parts.kept.iter().rev().copied().collect(), ..parts.clone() };
    assert!(Gaps::from_parts(swapped).is_err());
    let repeated = GapsParts { kept: vec![parts.kept[0]; 2], ..parts.clone() };
    assert!(Gaps::from_parts(repeated).is_err());
    let late = GapsParts { kept: vec![(100, 1)], ..parts };
    assert!(Gaps::from_parts(late).is_err());
}

#[test]
fn a_sample_that_takes_many_gaps_at_a_time_is_the_same() {
    let nanos = |number: u64| (hash(number) % 90_000) * SEC_NANOS;
    for batches in [&[0_u64, 1, 1, 3, 20, 0, 7, 500, 4_000][..], &[20_000], &[16, 1, 15, 16, 1]] {
        let (mut one, mut other) = (Gaps::default(), GapSample::default());
        for &more in batches {
            let first = other.count();
            (first..first + more).for_each(|number| one.observe(nanos(number)));
            other.observe_many(more, |at| nanos(first + at));
            let kept: Vec<u32> = one.to_parts().kept.iter().map(|&(_, secs)| secs).collect();
            assert_eq!((other.count(), other.kept_secs()), (one.to_parts().count, &kept[..]));
            assert_eq!((other.median_nanos(), other.regular_nanos()), (one.median_nanos(), one.regular_nanos()));
            assert_eq!(GapSample::from_kept(other.count(), other.kept_secs()), Ok(other));
        }
        assert!(GapSample::from_kept(other.count(), &[1; 3]).is_err());
    }
}
