//! Messages of ROS 2 as bytes: CDR, version 1, in little-endian order.
//!
//! Invariant: a number stands at a multiple of its size, counted from the end of the four bytes of the header.

const SEC_NANOS: i64 = 1_000_000_000;
/// Plain CDR in little-endian order, without options.
const HEADER: [u8; 4] = [0, 1, 0, 0];

/// A time that ROS 2 cannot express, in nanoseconds since 1970.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the time {0} ns is after 2038-01-19, where the times of ROS 2 end")]
pub struct TooLate(pub i64);

/// A message in progress.
#[derive(Clone, Debug)]
pub struct Cdr(Vec<u8>);

impl Cdr {
    /// Begins a message of about this many bytes.
    #[must_use]
    pub fn with_capacity(bytes: usize) -> Self {
        let mut message = Vec::with_capacity(bytes + HEADER.len());
        message.extend(HEADER);
        Self(message)
    }

    /// Appends a number, aligned to its size.
    pub fn number<const N: usize>(&mut self, bytes: [u8; N]) {
        while !(self.0.len() - HEADER.len()).is_multiple_of(N) {
            self.0.push(0);
        }
        self.0.extend(bytes);
    }

    /// Appends numbers of eight bytes.
    pub fn doubles(&mut self, numbers: &[f64]) {
        numbers.iter().for_each(|number| self.number(number.to_le_bytes()));
    }

    /// Appends numbers of four bytes.
    pub fn floats(&mut self, numbers: &[f32]) {
        numbers.iter().for_each(|number| self.number(number.to_le_bytes()));
    }

    /// Appends a text with its length, which counts the zero at its end.
    pub fn text(&mut self, text: &str) {
        self.count(text.len() + 1);
        self.0.extend(text.as_bytes());
        self.0.push(0);
    }

    /// Appends the number of elements of an array.
    pub fn count(&mut self, count: usize) {
        self.number(u32::try_from(count).unwrap_or(u32::MAX).to_le_bytes());
    }

    /// Appends bytes as they are.
    pub fn bytes(&mut self, bytes: impl IntoIterator<Item = u8>) {
        self.0.extend(bytes);
    }

    /// Appends a time, nanoseconds since 1970.
    ///
    /// # Errors
    /// [`TooLate`].
    pub fn time(&mut self, nanos: i64) -> Result<(), TooLate> {
        let sec = i32::try_from(nanos.div_euclid(SEC_NANOS)).map_err(|_| TooLate(nanos))?;
        let nanosec = u32::try_from(nanos.rem_euclid(SEC_NANOS)).unwrap_or_default();
        self.number(sec.to_le_bytes());
        self.number(nanosec.to_le_bytes());
        Ok(())
    }

    /// The bytes of the message.
    #[must_use]
    pub fn into_bytes(self) -> Vec<u8> {
        self.0
    }
}
