//! Landmarks: the table of a map's landmarks, and binary descriptors of image features with their places in the image.
//!
//! Invariant: a descriptor has 1 to 64 bytes; descriptors of different lengths are never compared.

use std::{fmt, str::FromStr};

mod error;
mod table;
#[cfg(test)]
mod tests;

pub use error::LandmarkError;
pub use table::{DescriptorKind, Landmark, LandmarkEdit, LandmarkKind, LandmarkPlace, Landmarks, LandmarksAtPlace};

/// Maximum number of landmarks of a place: a sighting is an observation of each.
pub const LANDMARKS_AT_PLACE_MAX: usize = 4_096;
/// Maximum number of landmarks of a map.
pub const LANDMARKS_MAX: usize = 4_000_000;
/// Maximum number of bytes of the velocity profile of an edge.
pub const PROFILE_BYTES_MAX: usize = 64 << 10;
/// Maximum number of bytes of all velocity profiles of a map.
pub const PROFILES_BYTES_MAX: usize = 256 << 20;
/// Maximum number of characters of the name of a kind of descriptors.
pub const DESCRIPTOR_KIND_CHARS_MAX: usize = 128;
/// Maximum distance of an image position from the corner of the image, pixels.
pub(crate) const PIXEL_MAX: f64 = 1e6;
/// Number of values in the covariance of a position in an image: uu, uv, vv, pixels².
pub const IMAGE_COVARIANCE: usize = 3;
/// Number of values in the covariance of a pose: the upper triangle of the 6×6 matrix of x, y, z (m) and the turns
/// about them (rad), by rows.
pub const POSE_COVARIANCE: usize = 21;

/// Maximum number of bytes of a descriptor.
pub const DESCRIPTOR_BYTES_MAX: usize = 64;
const WORDS: usize = DESCRIPTOR_BYTES_MAX / 8;

/// The binary descriptor of an image feature, as a detector such as BRIEF, ORB, TEBLID or GRIEF computes it. Two of one
/// length are compared by the number of bits in which they differ (Hamming distance).
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Descriptor {
    /// The bytes in little-endian words, padded with zeros.
    words: [u64; WORDS],
    length: u8,
}

/// The reason why something is no descriptor.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DescriptorError {
    /// The descriptor has another number of bytes.
    #[error("a descriptor of {found} bytes: it must have 1 to {DESCRIPTOR_BYTES_MAX}")]
    Length {
        /// Number of bytes.
        found: usize,
    },
    /// A text is not hexadecimal, two digits a byte.
    #[error("{0:?} is not hexadecimal: write two digits for each byte, such as 0af3")]
    Digits(String),
}

impl Descriptor {
    /// A descriptor of 1 to 64 bytes.
    ///
    /// # Errors
    /// [`DescriptorError`]
    pub fn new(bytes: &[u8]) -> Result<Descriptor, DescriptorError> {
        let found = bytes.len();
        let Some(length) = u8::try_from(found).ok().filter(|_| (1..=DESCRIPTOR_BYTES_MAX).contains(&found)) else {
            return Err(DescriptorError::Length { found });
        };
        let mut words = [0; WORDS];
        for (word, bytes) in words.iter_mut().zip(bytes.chunks(8)) {
            *word = bytes.iter().rev().fold(0, |word, &byte| word << 8 | u64::from(byte));
        }
        Ok(Descriptor { words, length })
    }

    /// The bytes that it was made of.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        self.words.iter().flat_map(|word| word.to_le_bytes()).take(self.len()).collect()
    }

    /// Number of bytes.
    #[must_use]
    #[allow(clippy::len_without_is_empty)] // It is never empty.
    pub fn len(&self) -> usize {
        self.length.into()
    }

    /// The words of the descriptor, padded with zeros: the distance of two descriptors is the number of bits in which
    /// these differ.
    #[must_use]
    pub fn words(&self) -> &[u64] {
        self.words.get(..self.len().div_ceil(8)).unwrap_or(&self.words)
    }
}

impl FromStr for Descriptor {
    type Err = DescriptorError;

    /// A descriptor in hexadecimal digits, two for each byte.
    fn from_str(text: &str) -> Result<Descriptor, DescriptorError> {
        let digits: Option<Vec<u8>> = text.chars().map(|digit| digit.to_digit(16).map(|digit| digit as u8)).collect();
        let digits = digits.filter(|digits| digits.len().is_multiple_of(2));
        let digits = digits.ok_or_else(|| DescriptorError::Digits(text.chars().take(40).collect()))?;
        let bytes: Vec<u8> =
            digits.chunks(2).map(|pair| pair.iter().fold(0, |byte, digit| byte << 4 | digit)).collect();
        Descriptor::new(&bytes)
    }
}

impl fmt::Display for Descriptor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.to_bytes().iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for Descriptor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// An image feature: its position in an image, and its appearance as a descriptor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageFeature {
    /// Pixels to the right.
    pub u_px: f64,
    /// Pixels down.
    pub v_px: f64,
    /// The appearance of the feature.
    pub descriptor: Descriptor,
}
