//! The state of a shared map that a client has seen: requests carry it, so that no later reply shows less.
//!
//! Invariant: 24 bytes on the wire, the number of the map, the position and the generation, all big-endian; anything
//! else is no token. A token of another map, which had the name before, requires nothing.

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

/// The state of a map that a client has seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReadToken {
    /// Number of the map in the cluster; 0: it has none.
    pub map_uid: u64,
    /// Position in the log of the map.
    pub position: u64,
    /// Number of the generation.
    pub generation: u64,
}

/// A header that is no token.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("tidemap-at-least-bin: not the 24 bytes of a map, a position and a generation")]
pub struct InvalidReadToken;

impl fmt::Display for ReadToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "record {} and generation {}", self.position, self.generation)
    }
}

impl ReadToken {
    /// Whether a client that has seen this has seen all of the other, too, or the other is of another map.
    #[must_use]
    pub fn reaches(self, other: Self) -> bool {
        self.map_uid != other.map_uid || (self.position >= other.position && self.generation >= other.generation)
    }

    /// The most of both; the newer one, if it is of another map.
    #[must_use]
    pub fn max(self, newer: Self) -> Self {
        if self.map_uid != newer.map_uid {
            return newer;
        }
        let (position, generation) = (self.position.max(newer.position), self.generation.max(newer.generation));
        Self { position, generation, ..self }
    }

    /// Whether nothing was seen.
    #[must_use]
    pub fn is_nothing(self) -> bool {
        self.position == 0 && self.generation == 0
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
        let (numbers, []) = bytes.as_chunks() else { return Err(InvalidReadToken) };
        let [map_uid, position, generation] = numbers else { return Err(InvalidReadToken) };
        let [map_uid, position, generation] = [map_uid, position, generation].map(|bytes| u64::from_be_bytes(*bytes));
        Ok(Some(Self { map_uid, position, generation }))
    }

    /// Puts the token into a header, in the place of one that is there.
    pub fn put(self, headers: &mut HeaderMap, name: HeaderName) {
        let bytes = [self.map_uid, self.position, self.generation].map(u64::to_be_bytes).concat();
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
        fn a_token_survives_the_wire(map_uid: u64, position: u64, generation: u64) {
            let token = ReadToken { map_uid, position, generation };
            let mut headers = HeaderMap::new();
            ReadToken { map_uid: 3, position: 1, generation: 2 }.put(&mut headers, AT_LEAST);
            token.put(&mut headers, AT_LEAST);
            prop_assert_eq!(ReadToken::of(&headers, &AT_LEAST), Ok(Some(token)));
            prop_assert_eq!(ReadToken::of(&headers, &SHOWN), Ok(None));
        }

        #[test]
        fn the_most_of_two_tokens_reaches_both(a: (u64, u64), b: (u64, u64)) {
            let token = |(position, generation)| ReadToken { map_uid: 7, position, generation };
            let both = token(a).max(token(b));
            prop_assert!(both.reaches(token(a)) && both.reaches(token(b)));
            prop_assert_eq!(token(a).reaches(token(b)), a.0 >= b.0 && a.1 >= b.1);
        }
    }

    #[test]
    fn other_bytes_are_no_token() {
        for text in ["", "AAAA", "?", "AAAAAAAAAAEAAAAAAAAAAg", "AAAAAAAAAAEAAAAAAAAAAgAAAAAAAAADAA"] {
            let headers = HeaderMap::from_iter([(AT_LEAST, HeaderValue::from_static(text))]);
            assert_eq!(ReadToken::of(&headers, &AT_LEAST), Err(InvalidReadToken), "{text}");
        }
    }

    #[test]
    fn a_token_is_big_endian() {
        let mut headers = HeaderMap::new();
        ReadToken { map_uid: 1, position: 2, generation: 3 }.put(&mut headers, SHOWN);
        assert_eq!(headers[SHOWN], "AAAAAAAAAAEAAAAAAAAAAgAAAAAAAAAD");
    }

    #[test]
    fn a_token_of_the_map_that_had_the_name_before_asks_for_nothing_and_is_forgotten() {
        let before = ReadToken { map_uid: 1, position: 500, generation: 9 };
        let now = ReadToken { map_uid: 2, position: 3, generation: 0 };
        assert!(now.reaches(before));
        assert_eq!(before.max(now), now);
        assert!(!now.reaches(ReadToken { map_uid: 2, ..before }));
    }
}
