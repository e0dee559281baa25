//! Decimal numbers without floats.
//!
//! Invariant: a number is read exactly or refused.

/// `digits` · 10^`exponent`, negated where `negative`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Decimal {
    pub(super) negative: bool,
    pub(super) digits: i128,
    pub(super) exponent: i32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum InvalidDecimal {
    Malformed,
    /// Does not fit in i64 after scaling.
    TooLarge,
    /// Not a whole number after scaling.
    TooFine,
}

/// Maximum number of significant digits; more are never meant as a time or a duration.
const DIGITS_MAX: usize = 30;

impl Decimal {
    /// Reads `12`, `-1.5`, and `1.4585184e9` as written by spreadsheets and numerical programs.
    pub(super) fn parse(text: &str) -> Result<Self, InvalidDecimal> {
        let (negative, rest) = match text.as_bytes().first() {
            Some(b'-') => (true, &text[1..]),
            Some(b'+') => (false, &text[1..]),
            _ => (false, text),
        };
        let (mantissa, exponent) = match rest.split_once(['e', 'E']) {
            Some((mantissa, exponent)) => {
                let exponent: i32 = exponent.parse().map_err(|_| InvalidDecimal::Malformed)?;
                (mantissa, exponent.clamp(-1000, 1000))
            }
            None => (rest, 0),
        };
        let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
        if whole.is_empty() || !whole.bytes().chain(fraction.bytes()).all(|byte| byte.is_ascii_digit()) {
            return Err(InvalidDecimal::Malformed);
        }
        let whole = whole.trim_start_matches('0');
        let fraction = fraction.trim_end_matches('0');
        if whole.len() + fraction.len() > DIGITS_MAX {
            return Err(if whole.len() > DIGITS_MAX { InvalidDecimal::TooLarge } else { InvalidDecimal::Malformed });
        }
        let digits =
            whole.bytes().chain(fraction.bytes()).fold(0, |sum: i128, byte| sum * 10 + i128::from(byte - b'0'));
        let fraction_digits = i32::try_from(fraction.len()).map_err(|_| InvalidDecimal::Malformed)?;
        Ok(Self { negative, digits, exponent: exponent - fraction_digits })
    }

    /// The number times 10^`power`, if that is an integer that fits in i64; ignores the sign.
    pub(super) fn scaled(self, power: i32) -> Result<i64, InvalidDecimal> {
        let mut digits = self.digits;
        if digits == 0 {
            return Ok(0);
        }
        let mut exponent = self.exponent + power;
        while exponent < 0 {
            if digits % 10 != 0 {
                return Err(InvalidDecimal::TooFine);
            }
            digits /= 10;
            exponent += 1;
        }
        while exponent > 0 {
            if digits > i128::from(i64::MAX) {
                return Err(InvalidDecimal::TooLarge);
            }
            digits *= 10;
            exponent -= 1;
        }
        i64::try_from(digits).map_err(|_| InvalidDecimal::TooLarge)
    }
}
