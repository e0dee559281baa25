//! Messages against bytes laid out by hand, and against any bytes.

use proptest::prelude::*;

use super::*;
use crate::layout;

type Outcome = Result<(), Box<dyn std::error::Error>>;

const TEXT: &str = "uint8 a\nfloat64 b\nstring name\nint16[] many\nfloat64[2] pair\nInner[] inner\nstd_msgs/Empty none\n\
                    bool last\n====================\nMSG: t/Inner\nint8 x\nint64 y";

fn values(big_endian: bool, packed: bool) -> Vec<u8> {
    let mut bytes: Vec<u8> = if packed { vec![] } else { vec![0, u8::from(!big_endian), 0, 0] };
    let start = bytes.len();
    let mut put = |align: usize, little: &[u8]| {
        while !packed && !(bytes.len() - start).is_multiple_of(align) {
            bytes.push(0xee);
        }
        let mut value = little.to_vec();
        if big_endian {
            value.reverse();
        }
        bytes.extend(value);
    };
    put(1, &[7]);
    put(8, &1.5_f64.to_le_bytes());
    put(4, &(if packed { 2_u32 } else { 3 }).to_le_bytes());
    put(1, b"h");
    put(1, b"i");
    if !packed {
        put(1, &[0]);
    }
    put(4, &2_u32.to_le_bytes());
    put(2, &(-1_i16).to_le_bytes());
    put(2, &300_i16.to_le_bytes());
    put(8, &2.0_f64.to_le_bytes());
    put(8, &3.0_f64.to_le_bytes());
    put(4, &1_u32.to_le_bytes());
    put(1, &(-5_i8).to_le_bytes());
    put(8, &(1_i64 << 40).to_le_bytes());
    if !packed {
        put(1, &[0]);
    }
    put(1, &[1]);
    bytes
}

#[test]
fn values_are_read_from_ros_1_and_from_cdr_of_both_orders() -> Outcome {
    let layout = layout::of_type("t/Outer", TEXT, &Encoding::Cdr)?;
    let cases = [
        (Encoding::Ros1, values(false, true)),
        (Encoding::Cdr, values(false, false)),
        (Encoding::Cdr, values(true, false)),
    ];
    for (encoding, bytes) in cases {
        let message = read(&layout, &encoding, &bytes)?;
        let at = |path: &str| Path::parse(path).ok().and_then(|path| path.value_in(&message));
        assert_eq!(at("a").and_then(|value| value.integer()), Some(7));
        assert_eq!(at("b").and_then(|value| value.number()), Some(1.5));
        assert_eq!(at("name").and_then(|value| value.text()), Some("hi".to_owned()));
        let many = at("many").and_then(|value| value.numbers()).map(|numbers| numbers.floats().collect::<Vec<_>>());
        assert_eq!(many, Some(vec![-1.0, 300.0]));
        assert_eq!(at("pair[1]").and_then(|value| value.number()), Some(3.0));
        assert_eq!(at("pair[2]"), None);
        assert_eq!(at("inner[0].y").and_then(|value| value.integer()), Some(1 << 40));
        assert_eq!(at("last"), Some(Value::Bool(true)));
    }
    Ok(())
}

#[test]
fn a_path_is_checked_against_the_layout() -> Outcome {
    let layout = layout::of_type("t/Outer", TEXT, &Encoding::Cdr)?;
    let wrong = |path: &str| {
        Path::parse(path).and_then(|path| path.field_in(&layout).map(|_| ())).err().map(|error| error.to_string())
    };
    assert_eq!(wrong("inner[0].y"), None);
    assert_eq!(wrong("pair"), None);
    for (path, words) in [
        ("inner.y", "such as inner[0]"),
        ("pair[2]", "2 elements"),
        ("a[0]", "no array"),
        ("b.x", "no field \"x\""),
        ("c", "it has a, b, name"),
        ("a..b", "is no field"),
        ("", "is no field"),
    ] {
        assert!(wrong(path).is_some_and(|text| text.contains(words)), "{path}: {:?}", wrong(path));
    }
    Ok(())
}

#[test]
fn a_message_of_many_empty_values_is_refused() -> Outcome {
    let layout = layout::of_type("t/Many", "string[] names", &Encoding::Cdr)?;
    let mut bytes = vec![0, 1, 0, 0];
    let count = u32::try_from(VALUES_MAX)? + 1;
    bytes.extend(count.to_le_bytes());
    bytes.resize(bytes.len() + 4 * (VALUES_MAX + 1), 0);
    assert_eq!(read(&layout, &Encoding::Cdr, &bytes), Err(MessageError::TooManyValues));
    let none = layout::of_type("t/None", "std_msgs/Empty[] none", &Encoding::Cdr)?;
    assert_eq!(read(&none, &Encoding::Ros1, &u32::MAX.to_le_bytes()), Err(MessageError::TooManyValues));
    Ok(())
}

#[test]
fn an_encoding_that_is_not_read_is_named() -> Outcome {
    let layout = layout::of_type("std_msgs/Bool", "", &Encoding::Cdr)?;
    assert_eq!(read(&layout, &Encoding::Cdr, &[0, 3, 0, 0, 1]), Err(MessageError::Representation([0, 3])));
    let json = read(&layout, &Encoding::Other("json".to_owned()), b"{}");
    assert!(json.is_err_and(|error| error.to_string().contains("json")));
    Ok(())
}

#[test]
fn times_of_both_generations_are_nanoseconds() -> Outcome {
    let ros2 = layout::of_type("std_msgs/Header", "", &Encoding::Cdr)?;
    let mut bytes = vec![0, 1, 0, 0];
    bytes.extend(5_i32.to_le_bytes());
    bytes.extend(7_u32.to_le_bytes());
    bytes.extend([1, 0, 0, 0, 0]);
    let header = read(&ros2, &Encoding::Cdr, &bytes)?;
    assert_eq!(header.field("stamp").and_then(Value::time_nanos), Some(5_000_000_007));
    let ros1 = layout::of_type("t/Stamped", "time stamp", &Encoding::Ros1)?;
    let bytes = [u32::MAX.to_le_bytes(), u32::MAX.to_le_bytes()].concat();
    let stamped = read(&ros1, &Encoding::Ros1, &bytes)?;
    let latest = i64::from(u32::MAX) * 1_000_000_001;
    assert_eq!(stamped.field("stamp").and_then(Value::time_nanos), Some(latest));
    Ok(())
}

proptest! {
    #[test]
    fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..200), cut in 0..100_usize) {
        let layout = layout::of_type("t/Outer", TEXT, &Encoding::Cdr).map_err(|error| TestCaseError::fail(error.to_string()))?;
        for (encoding, whole) in [(Encoding::Ros1, values(false, true)), (Encoding::Cdr, values(false, false))] {
            let _ = read(&layout, &encoding, &bytes);
            let short = whole.get(..whole.len().saturating_sub(cut)).unwrap_or(&whole);
            prop_assert_eq!(read(&layout, &encoding, short).is_ok(), cut == 0);
        }
    }
}

#[test]
fn wide_text_is_read_in_each_form() -> Outcome {
    let layout =
        layout::of_type("t/Wide", "wstring<=9 name\nuint8 mode\nwstring[] words\nfloat64 last", &Encoding::Cdr)?;
    // Each form: the bytes of a letter, and whether the length counts bytes.
    for (size, counts_bytes) in [(4, false), (2, false), (2, true)] {
        let mut bytes = vec![0, 1, 0, 0];
        let align = |bytes: &mut Vec<u8>, size: usize| bytes.resize(4 + (bytes.len() - 4).next_multiple_of(size), 0);
        let text = |bytes: &mut Vec<u8>, text: &str| {
            align(bytes, 4);
            let letters: Vec<u32> = match size {
                4 => text.chars().map(u32::from).collect(),
                _ => text.encode_utf16().map(u32::from).collect(),
            };
            let length = if counts_bytes { letters.len() * size } else { letters.len() };
            bytes.extend(u32::try_from(length).unwrap_or(0).to_le_bytes());
            letters.iter().for_each(|letter| bytes.extend(&letter.to_le_bytes()[..size]));
        };
        text(&mut bytes, "Tür🚪");
        bytes.push(3);
        align(&mut bytes, 4);
        bytes.extend(2_u32.to_le_bytes());
        text(&mut bytes, "a");
        text(&mut bytes, "bcd");
        align(&mut bytes, 8);
        bytes.extend(2.5_f64.to_le_bytes());
        let message = read(&layout, &Encoding::Cdr, &bytes)?;
        assert_eq!(message.field("name").and_then(Value::text).as_deref(), Some("Tür🚪"), "{size} {counts_bytes}");
        assert_eq!(message.field("mode").and_then(Value::integer), Some(3));
        assert_eq!(message.field("last").and_then(Value::number), Some(2.5));
        let words: Option<Vec<_>> =
            message.field("words").and_then(Value::list).map(|words| words.iter().filter_map(Value::text).collect());
        assert_eq!(words, Some(vec!["a".to_owned(), "bcd".to_owned()]));
        bytes.truncate(20);
        assert!(read(&layout, &Encoding::Cdr, &bytes).is_err());
    }
    Ok(())
}
