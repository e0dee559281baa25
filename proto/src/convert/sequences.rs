//! Sequence numbers of messages.
//!
//! Invariant: the first number of a message is 1 or more. Whether a number is left after the message ([`check_end`]) is
//! checked later, after the place of the message in its stream.

use std::ops::RangeInclusive;

use super::InvalidField;

/// The sequence numbers of a message with `count` of something; at least one number.
///
/// # Errors
/// The first is 0.
pub(super) fn sequences_from_wire(first: u64, count: usize) -> Result<RangeInclusive<u64>, InvalidField> {
    if first == 0 {
        return Err(InvalidField::new("first_sequence", "0 is not a sequence number: the first is 1"));
    }
    Ok(first..=first.saturating_add((count as u64).saturating_sub(1)))
}

/// Checks that there is a sequence number after those of a message.
///
/// # Errors
/// There is none.
pub fn check_end(sequences: &RangeInclusive<u64>) -> Result<(), InvalidField> {
    if *sequences.end() < u64::MAX {
        return Ok(());
    }
    Err(InvalidField::new("first_sequence", format!("{} is too large", sequences.start())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sequence_numbers_begin_at_one_and_end_before_the_last() {
        assert_eq!(sequences_from_wire(1, 3), Ok(1..=3));
        assert_eq!(sequences_from_wire(7, 0), Ok(7..=7));
        assert_eq!(sequences_from_wire(0, 1).expect_err("wrong").field, "first_sequence");
        assert_eq!(check_end(&(1..=u64::MAX - 1)), Ok(()));
        for (first, count) in [(u64::MAX, 1), (u64::MAX - 1, 2), (u64::MAX - 1, 9)] {
            let sequences = sequences_from_wire(first, count).expect("not 0");
            assert_eq!(check_end(&sequences).expect_err("wrong").field, "first_sequence");
        }
    }
}
