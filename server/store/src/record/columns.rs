//! Columns of a batch of observations: states, times and values, each encoded by itself.
//!
//! This code runs for every observation, so each column is one pass over a slice. Invariant: a column has as many items
//! as its count, or a single item if all are equal.

use tidemap_layout::event::{VALUES_BITS, VALUES_DOUBLES, VALUES_FLOATS};
use tidemap_model::VALUE_MAX;

use super::{
    Invalid, runs,
    varint::{push_varint, take_varint, unzigzag, zigzag},
};

pub(super) const LENGTH: Invalid = "a column does not have the length that its count requires";

fn all_equal<T: PartialEq>(items: &[T]) -> bool {
    items.windows(2).all(|pair| pair[0] == pair[1])
}

/// Encodes numbers as varints; a single varint if all are equal.
pub(super) fn encode_numbers<T: Copy + PartialEq>(items: &[T], number: impl Fn(T) -> u64) -> Vec<u8> {
    let items = if all_equal(items) { &items[..items.len().min(1)] } else { items };
    let mut out = Vec::with_capacity(items.len() * 2 + 8);
    for &item in items {
        push_varint(&mut out, number(item));
    }
    out
}

/// Reads the output of [`encode_numbers`]; the caller limits `count`.
pub(super) fn decode_numbers<T: Copy>(
    mut bytes: &[u8],
    count: usize,
    item: impl Fn(u64) -> Result<T, Invalid>,
) -> Result<Vec<T>, Invalid> {
    if count == 0 {
        return if bytes.is_empty() { Ok(Vec::new()) } else { Err(LENGTH) };
    }
    let mut items = Vec::with_capacity(count);
    items.push(item(take_varint(&mut bytes)?)?);
    if bytes.is_empty() {
        return Ok(vec![items[0]; count]);
    }
    while items.len() < count {
        items.push(item(take_varint(&mut bytes)?)?);
    }
    if bytes.is_empty() { Ok(items) } else { Err(LENGTH) }
}

/// Encodes the numbers of states.
pub(super) fn encode_states<T: Copy + PartialEq>(states: &[T], number: impl Fn(T) -> u32) -> Vec<u8> {
    encode_numbers(states, |state| u64::from(number(state)))
}

pub(super) fn decode_states<T: Copy>(bytes: &[u8], count: usize, item: impl Fn(u32) -> T) -> Result<Vec<T>, Invalid> {
    decode_numbers(bytes, count, |number| {
        u32::try_from(number).map(&item).map_err(|_| "the number of a state is too large")
    })
}

/// Times: the first, the unit of the differences, and the differences.
pub(super) struct Times<Bytes> {
    pub(super) first_nanos: i64,
    pub(super) unit_nanos: u64,
    pub(super) differences: Bytes,
}

fn greatest_common_divisor(mut a: u64, mut b: u64) -> u64 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

/// The greatest common divisor; 0 if all are 0.
fn common_divisor(differences: &[i64]) -> u64 {
    let mut divisor = 0;
    for difference in differences {
        if divisor == 1 {
            break;
        }
        divisor = greatest_common_divisor(difference.unsigned_abs(), divisor);
    }
    divisor
}

/// The greatest common divisor; 1 if all are 0, or if the divisor does not fit.
pub(super) fn unit(differences: &[i64]) -> i64 {
    i64::try_from(common_divisor(differences)).unwrap_or(1).max(1)
}

/// Encodes times, which must not be negative, so that no difference overflows.
pub(super) fn encode_times(nanos: &[i64]) -> Result<Times<Vec<u8>>, Invalid> {
    if nanos.iter().any(|&nanos| nanos < 0) {
        return Err("a time is before 1970");
    }
    let differences: Vec<i64> = nanos.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let unit_nanos = common_divisor(&differences);
    let divisor = unit(&differences);
    let differences = encode_numbers(&differences, |difference| zigzag(difference / divisor));
    Ok(Times { first_nanos: nanos.first().copied().unwrap_or(0), unit_nanos, differences })
}

/// Encodes times, with the lengths of the runs of equal differences if these make the column shorter.
pub(super) fn encode_times_in_runs(nanos: &[i64]) -> Result<(Times<Vec<u8>>, Vec<u8>), Invalid> {
    let times = encode_times(nanos)?;
    let differences: Vec<i64> = nanos.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let divisor = unit(&differences);
    let (firsts, lengths) = runs::encode(&differences, i64::eq);
    let firsts = encode_numbers(&firsts, |difference| zigzag(difference / divisor));
    if firsts.len() + lengths.len() < times.differences.len() {
        Ok((Times { differences: firsts, ..times }, lengths))
    } else {
        Ok((times, Vec::new()))
    }
}

/// Reads the output of [`encode_times_in_runs`]; the caller limits `count`.
pub(super) fn decode_times_in_runs(times: &Times<&Vec<u8>>, lengths: &[u8], count: usize) -> Result<Vec<i64>, Invalid> {
    if lengths.is_empty() {
        return decode_times(times, count);
    }
    let lengths = runs::decode(lengths, count.saturating_sub(1))?;
    let firsts = decode_differences(times, lengths.len())?;
    sum_times(times.first_nanos, &runs::expand(&firsts, &lengths), count)
}

pub(super) fn decode_times(times: &Times<&Vec<u8>>, count: usize) -> Result<Vec<i64>, Invalid> {
    sum_times(times.first_nanos, &decode_differences(times, count.saturating_sub(1))?, count)
}

const TIME_RANGE: Invalid = "a time is outside its range";

fn decode_differences(times: &Times<&Vec<u8>>, count: usize) -> Result<Vec<i64>, Invalid> {
    let unit = i64::try_from(times.unit_nanos).map_err(|_| TIME_RANGE)?.max(1);
    decode_numbers(times.differences, count, |number| unzigzag(number).checked_mul(unit).ok_or(TIME_RANGE))
}

fn sum_times(first_nanos: i64, differences: &[i64], count: usize) -> Result<Vec<i64>, Invalid> {
    if count == 0 {
        return Ok(Vec::new());
    }
    let mut nanos = Vec::with_capacity(count);
    let mut now = first_nanos;
    nanos.push(now);
    for &difference in differences {
        now = now.checked_add(difference).ok_or(TIME_RANGE)?;
        nanos.push(now);
    }
    if nanos.iter().all(|&nanos| nanos >= 0) { Ok(nanos) } else { Err(TIME_RANGE) }
}

const RANGE: Invalid = "a value is not a number from -1e12 to 1e12";

/// Whether a state of any kind may have the value. Callers check the state's own kind.
fn is_value(value: &f64) -> bool {
    value.abs() <= VALUE_MAX || is_end(value)
}

/// Whether the number is the mark that a row has instead of a value, if no value is known from then on.
fn is_end(value: &f64) -> bool {
    value.to_bits() == f64::NAN.to_bits()
}

/// Encodes values in the smallest lossless encoding.
pub(super) fn encode_values(values: &[f64]) -> Result<(u32, Vec<u8>), Invalid> {
    const ONE: u64 = 1.0_f64.to_bits();
    if !values.iter().all(is_value) {
        return Err(RANGE);
    }
    // The values are compared by bits, because -0.0 equals 0.0.
    let is_same = values.windows(2).all(|pair| pair[0].to_bits() == pair[1].to_bits());
    if values.iter().all(|value| matches!(value.to_bits(), 0 | ONE)) {
        let values = if is_same && values.len() > 8 { &values[..1] } else { values };
        let bytes = values
            .chunks(8)
            .map(|eight| eight.iter().rev().fold(0, |byte, value| byte << 1 | u8::from(value.to_bits() == ONE)));
        return Ok((VALUES_BITS, bytes.collect()));
    }
    let values = if is_same { &values[..1] } else { values };
    if values.iter().all(|&value| f64::from(value as f32).to_bits() == value.to_bits()) {
        Ok((VALUES_FLOATS, values.iter().flat_map(|&value| (value as f32).to_le_bytes()).collect()))
    } else {
        Ok((VALUES_DOUBLES, values.iter().flat_map(|value| value.to_le_bytes()).collect()))
    }
}

/// Encodes values. Returns the encoding, the values, and the lengths of the runs of equal values if these make the
/// column shorter.
pub(super) fn encode_values_in_runs(values: &[f64]) -> Result<(u32, Vec<u8>, Vec<u8>), Invalid> {
    let (encoding, column) = encode_values(values)?;
    let (firsts, lengths) = runs::encode(values, |a, b| a.to_bits() == b.to_bits());
    let (encoding_of_firsts, firsts) = encode_values(&firsts)?;
    if firsts.len() + lengths.len() < column.len() {
        Ok((encoding_of_firsts, firsts, lengths))
    } else {
        Ok((encoding, column, Vec::new()))
    }
}

/// Reads the output of [`encode_values_in_runs`]; the caller limits `count`.
pub(super) fn decode_values_in_runs(
    encoding: u32,
    bytes: &[u8],
    lengths: &[u8],
    count: usize,
) -> Result<Vec<f64>, Invalid> {
    if lengths.is_empty() {
        return decode_values(encoding, bytes, count);
    }
    let lengths = runs::decode(lengths, count)?;
    Ok(runs::expand(&decode_values(encoding, bytes, lengths.len())?, &lengths))
}

pub(super) fn decode_values(encoding: u32, bytes: &[u8], count: usize) -> Result<Vec<f64>, Invalid> {
    let values = match encoding {
        VALUES_BITS => decode_bits(bytes, count)?,
        VALUES_FLOATS => fixed(bytes, count, |four| f64::from(f32::from_le_bytes(four)))?,
        VALUES_DOUBLES => fixed(bytes, count, f64::from_le_bytes)?,
        _ => return Err("the encoding of the values is not known"),
    };
    if values.iter().all(is_value) { Ok(values) } else { Err(RANGE) }
}

fn decode_bits(bytes: &[u8], count: usize) -> Result<Vec<f64>, Invalid> {
    let bit = |byte: u8, index: usize| f64::from((byte >> index) & 1);
    if bytes.len() == 1 && count > 8 {
        return if bytes[0] <= 1 { Ok(vec![bit(bytes[0], 0); count]) } else { Err(LENGTH) };
    }
    if bytes.len() != count.div_ceil(8) {
        return Err(LENGTH);
    }
    if let Some(&last) = bytes.last()
        && !count.is_multiple_of(8)
        && last >> (count % 8) != 0
    {
        return Err("the padding of the values is not zero");
    }
    Ok(bytes.iter().flat_map(|&byte| (0..8).map(move |index| bit(byte, index))).take(count).collect())
}

/// Reads items of N bytes each; a single item if all are equal.
fn fixed<const N: usize>(bytes: &[u8], count: usize, item: impl Fn([u8; N]) -> f64) -> Result<Vec<f64>, Invalid> {
    let (items, rest) = bytes.as_chunks::<N>();
    match items {
        _ if !rest.is_empty() => Err(LENGTH),
        [one] if count > 0 => Ok(vec![item(*one); count]),
        _ if items.len() == count => Ok(items.iter().map(|&bytes| item(bytes)).collect()),
        _ => Err(LENGTH),
    }
}
