//! What a client has seen of a map that daemons share: requests carry it, so that no later reply shows less.
//!
//! Invariant: 16 bytes on the wire, the position and the generation, both big-endian; anything else is no token.

use std::fmt;

use tonic::{
    codegen::http::{HeaderMap, HeaderName, HeaderValue},
    metadata::{Binary, MetadataMap, MetadataValue},
};

/// In a request: the reply must show at least this.
pub const AT_LEAST: HeaderName = HeaderName::from_static("tidemap-at-least-bin");
/// In a reply: it shows at most this.
pub const SHOWN: HeaderName = HeaderName::from_static("tidemap-shown-bin");
/// In a request: `1` if a reply of a daemon that may be far behind is better than none.
pub const ALLOW_STALE: HeaderName = HeaderName::from_static("tidemap-allow-stale");
/// In a request: the daemon that passed it on.
pub const FORWARDED: HeaderName = HeaderName::from_static("tidemap-forwarded");

/// How much of a map was seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReadToken {
    /// Position in the log of the map.
    pub position: u64,
    /// Number of the generation.
    pub generation: u64,
}

/// A header that is no token.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("tidemap-at-least-bin: not the 16 bytes of a position and a generation")]
pub struct InvalidReadToken;

impl fmt::Display for ReadToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "record {} and generation {}", self.position, self.generation)
    }
}

impl ReadToken {
    /// Whether who has seen this has seen all of the other, too.
    #[must_use]
    pub fn reaches(self, other: Self) -> bool {
        self.position >= other.position && self.generation >= other.generation
    }

    /// The most of both.
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        Self { position: self.position.max(other.position), generation: self.generation.max(other.generation) }
    }

    /// The token of a header; `None`: there is none.
    ///
    /// # Errors
    /// It is no token.
    pub fn of(headers: &HeaderMap, name: &HeaderName) -> Result<Option<Self>, InvalidReadToken> {
        let Some(value) = headers.get(name) else { return Ok(None) };
        let one = HeaderMap::from_iter([(name.clone(), value.clone())]);
        let metadata = MetadataMap::from_headers(one);
        let bytes = metadata.get_bin(name.as_str()).and_then(|value| value.to_bytes().ok()).ok_or(InvalidReadToken)?;
        let (position, generation) = bytes.split_first_chunk().ok_or(InvalidReadToken)?;
        let generation = generation.try_into().map_err(|_| InvalidReadToken)?;
        Ok(Some(Self { position: u64::from_be_bytes(*position), generation: u64::from_be_bytes(generation) }))
    }

    /// Puts the token into a header, in the place of one that is there.
    pub fn put(self, headers: &mut HeaderMap, name: HeaderName) {
        let mut bytes = [0; 16];
        bytes[..8].copy_from_slice(&self.position.to_be_bytes());
        bytes[8..].copy_from_slice(&self.generation.to_be_bytes());
        let value = MetadataValue::<Binary>::from_bytes(&bytes);
        // Base64 is always a valid value.
        if let Ok(value) = HeaderValue::from_bytes(value.as_encoded_bytes()) {
            headers.insert(name, value);
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_token_survives_the_wire(position: u64, generation: u64) {
            let token = ReadToken { position, generation };
            let mut headers = HeaderMap::new();
            ReadToken { position: 1, generation: 2 }.put(&mut headers, AT_LEAST);
            token.put(&mut headers, AT_LEAST);
            prop_assert_eq!(ReadToken::of(&headers, &AT_LEAST), Ok(Some(token)));
            prop_assert_eq!(ReadToken::of(&headers, &SHOWN), Ok(None));
        }

        #[test]
        fn the_most_of_two_tokens_reaches_both(a: (u64, u64), b: (u64, u64)) {
            let token = |(position, generation)| ReadToken { position, generation };
            let both = token(a).max(token(b));
            prop_assert!(both.reaches(token(a)) && both.reaches(token(b)));
            prop_assert_eq!(token(a).reaches(token(b)), a.0 >= b.0 && a.1 >= b.1);
        }
    }

    #[test]
    fn other_bytes_are_no_token() {
        for text in ["", "AAAA", "?", "AAAAAAAAAAAAAAAAAAAAAAAA"] {
            let headers = HeaderMap::from_iter([(AT_LEAST, HeaderValue::from_static(text))]);
            assert_eq!(ReadToken::of(&headers, &AT_LEAST), Err(InvalidReadToken), "{text}");
        }
    }

    #[test]
    fn a_token_is_big_endian() {
        let mut headers = HeaderMap::new();
        ReadToken { position: 1, generation: 2 }.put(&mut headers, SHOWN);
        assert_eq!(headers[SHOWN], "AAAAAAAAAAEAAAAAAAAAAg");
    }
}
