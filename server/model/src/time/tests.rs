//! Tests times and durations by table, and as round trips.

use proptest::prelude::*;

use super::*;

#[test]
fn times_are_read_exactly() {
    for (text, nanos) in [
        ("0", 0),
        ("-0", 0),
        ("1458518400", 1_458_518_400_000_000_000),
        ("01458518400", 1_458_518_400_000_000_000),
        ("1458518400.", 1_458_518_400_000_000_000),
        ("1458518400.5", 1_458_518_400_500_000_000),
        ("1458518400.123456789", 1_458_518_400_123_456_789),
        ("1458518400.1234567890", 1_458_518_400_123_456_789),
        ("1.4585184e9", 1_458_518_400_000_000_000),
        ("1.4585184E+09", 1_458_518_400_000_000_000),
        ("0.000000001", 1),
        ("9223372036.854775807", i64::MAX),
        ("1970-01-01T00:00:00Z", 0),
        ("2016-03-21T00:00:00Z", 1_458_518_400_000_000_000),
        ("2016-03-21T01:00:00.5+01:00", 1_458_518_400_500_000_000),
        ("2016-03-21 00:00:00Z", 1_458_518_400_000_000_000),
    ] {
        assert_eq!(parse_time(text), Ok(nanos), "{text}");
    }
}

#[test]
fn a_wrong_time_is_named_with_what_is_wrong() {
    for text in ["", "soon", "12:30", "1458518400s", "--1", "1e", ".5", "NaN", "inf", "1 458", "2016-13-01T00:00:00Z"] {
        assert_eq!(parse_time(text), Err(InvalidTime::Malformed(text.to_owned())), "{text}");
    }
    for text in ["2016-03-21", "2016-03-21T00:00:00", "2016-03-21 07:00"] {
        assert_eq!(parse_time(text), Err(InvalidTime::NoOffset(text.to_owned())), "{text}");
    }
    for text in ["-1", "-0.5", "1969-12-31T23:59:59Z"] {
        assert_eq!(parse_time(text), Err(InvalidTime::TooEarly(text.to_owned())), "{text}");
    }
    for text in ["9223372036.854775808", "1458518400000", "1e300", "2263-01-01T00:00:00Z"] {
        assert_eq!(parse_time(text), Err(InvalidTime::TooLate(text.to_owned())), "{text}");
    }
    for text in ["0.0000000001", "1e-10"] {
        assert_eq!(parse_time(text), Err(InvalidTime::TooFine(text.to_owned())), "{text}");
    }
    let message = InvalidTime::TooLate("1458518400000".to_owned()).to_string();
    assert!(message.contains("milliseconds"), "{message}");
}

#[test]
fn times_are_written_in_the_shortest_exact_form() {
    for (nanos, text) in [
        (0, "0"),
        (1_458_518_400_000_000_000, "1458518400"),
        (1_458_518_400_250_000_000, "1458518400.25"),
        (1, "0.000000001"),
        (-1_500_000_000, "-1.5"),
        (i64::MAX, "9223372036.854775807"),
    ] {
        assert_eq!(format_secs(nanos), text);
    }
}

#[test]
fn durations_need_a_number_and_a_unit() {
    for (text, secs) in [("90s", 90), ("15m", 900), ("1h", 3600), ("7d", 604_800), ("2w", 1_209_600), ("1.5h", 5400)] {
        assert_eq!(parse_duration(text), Ok(secs * NANOS_PER_SEC), "{text}");
    }
    assert_eq!(parse_duration("250ms"), Ok(250_000_000));
    for text in ["", "7", "d", "7 d", "7days", "-1h", "1h30m", "h1", "1y"] {
        assert!(matches!(parse_duration(text), Err(InvalidDuration::Malformed(_))), "{text}");
    }
    assert!(matches!(parse_duration("0s"), Err(InvalidDuration::Zero(_))));
    assert!(matches!(parse_duration("106752d"), Err(InvalidDuration::TooLong(_))));
}

#[test]
fn durations_are_written_in_a_unit_that_divides_them() {
    for (text, shown) in [("168h", "7d"), ("36h", "36h"), ("90s", "90s"), ("500ms", "0.5s"), ("120m", "2h")] {
        let nanos = parse_duration(text);
        assert_eq!(nanos.map(format_duration), Ok(shown.to_owned()));
    }
}

proptest! {
    #[test]
    fn a_time_comes_back_as_it_went(nanos in 0..=i64::MAX) {
        prop_assert_eq!(parse_time(&format_secs(nanos)), Ok(nanos));
        prop_assert_eq!(parse_time(&format_rfc3339(nanos)), Ok(nanos));
    }

    #[test]
    fn a_duration_comes_back_as_it_went(nanos in 1..=i64::MAX) {
        prop_assert_eq!(parse_duration(&format_duration(nanos)), Ok(nanos));
    }

    #[test]
    fn no_text_makes_it_panic(text in ".{0,40}") {
        let _ = parse_time(&text);
        let _ = parse_duration(&text);
    }
}
