//! Tests that descriptors keep their bytes. The tests of the table of landmarks are in `table.rs`.

mod table;

use proptest::prelude::*;

use super::*;

proptest! {
    #[test]
    fn bytes_come_back_and_words_differ_in_as_many_bits(
        one in prop::collection::vec(any::<u8>(), 1..=64), seed in any::<u64>(),
    ) {
        let other: Vec<u8> = one.iter().enumerate().map(|(at, byte)| byte ^ (seed >> (at % 8 * 8)) as u8).collect();
        let [a, b] = [&one, &other].map(|bytes| Descriptor::new(bytes).expect("of a valid length"));
        prop_assert_eq!((a.to_bytes(), a.len()), (one.clone(), one.len()));
        let bits: u32 = a.words().iter().zip(b.words()).map(|(a, b)| (a ^ b).count_ones()).sum();
        let expected: u32 = one.iter().zip(&other).map(|(a, b)| (a ^ b).count_ones()).sum();
        prop_assert_eq!(bits, expected);
        prop_assert_eq!(a == b, one == other);
        prop_assert_eq!(a.to_string().parse::<Descriptor>(), Ok(a));
    }
}

#[test]
fn descriptors_without_bytes_or_with_too_many_are_refused() {
    assert_eq!(Descriptor::new(&[]), Err(DescriptorError::Length { found: 0 }));
    let message = Descriptor::new(&[0; 65]).expect_err("too long").to_string();
    assert_eq!(message, "a descriptor of 65 bytes: it must have 1 to 64");
    for text in ["0", "0g", ""] {
        assert!(text.parse::<Descriptor>().is_err(), "{text:?}");
    }
}
