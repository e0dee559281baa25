//! What `gaps.rs` promises.

use super::*;

const HOUR: u64 = 3_600 * SEC_NANOS;

fn gaps(of: impl IntoIterator<Item = u64>) -> Gaps {
    let mut gaps = Gaps::default();
    of.into_iter().for_each(|nanos| gaps.observe(nanos));
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
    // A third of the gaps is long, in a fixed pattern.
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
