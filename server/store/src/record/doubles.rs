//! Arrays of doubles as bytes, little-endian, in bulk.
//!
//! Invariant: every bit is preserved.

/// Appends doubles.
pub(crate) fn push(out: &mut Vec<u8>, numbers: &[f64]) {
    let start = out.len();
    out.resize(start + numbers.len() * 8, 0);
    for (bytes, number) in out[start..].as_chunks_mut::<8>().0.iter_mut().zip(numbers) {
        *bytes = number.to_le_bytes();
    }
}

/// Replaces the content of `out` by the doubles of these bytes; an incomplete double at the end is ignored.
pub(crate) fn take(bytes: &[u8], out: &mut Vec<f64>) {
    out.clear();
    out.extend(bytes.as_chunks::<8>().0.iter().map(|&bytes| f64::from_le_bytes(bytes)));
}

/// Whether all doubles of these bytes are finite.
pub(crate) fn are_finite(bytes: &[u8]) -> bool {
    let (numbers, rest) = bytes.as_chunks::<8>();
    rest.is_empty() && numbers.iter().fold(true, |all, &bytes| all & f64::from_le_bytes(bytes).is_finite())
}
