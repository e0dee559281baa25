//! The secret by which the daemons of a cluster recognise each other, sent in place of a token.
//!
//! Invariant: a daemon without a cluster accepts no secret. A comparison takes equally long whatever was sent, and no
//! message, log or `Debug` shows the secret.

use std::fmt;

use axum::http::{HeaderMap, HeaderValue, header::AUTHORIZATION};
use ring::hmac;
use subtle::ConstantTimeEq as _;

use super::{
    keyring::Denial,
    token_file::{TokenHash, hash},
};

/// A longer text is no secret.
const SECRET_BYTES_MAX: usize = 256;

/// The secret of a cluster.
#[derive(Clone)]
pub struct PeerSecret {
    text: String,
    hash: TokenHash,
}

impl fmt::Debug for PeerSecret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("PeerSecret(..)")
    }
}

impl PeerSecret {
    /// A secret from its text.
    pub fn new(text: String) -> Self {
        let hash = hash(text.as_bytes());
        Self { text, hash }
    }

    /// The text of the secret, for the engine.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The header which proves that a request comes from a daemon that knows the secret; `None` for a secret that
    /// cannot be sent.
    pub fn header(&self) -> Option<HeaderValue> {
        let mut header = HeaderValue::from_str(&format!("Bearer {}", self.text)).ok()?;
        header.set_sensitive(true);
        Some(header)
    }

    fn key(&self) -> hmac::Key {
        hmac::Key::new(hmac::HMAC_SHA256, self.text.as_bytes())
    }

    /// A proof that a text comes from a daemon that knows the secret, in hexadecimal digits. It reveals nothing of the
    /// secret.
    pub(crate) fn proof_of(&self, text: &str) -> String {
        hmac::sign(&self.key(), text.as_bytes()).as_ref().iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// Whether [`PeerSecret::proof_of`] returns this proof for the text.
    pub fn proves(&self, text: &str, proof: &str) -> bool {
        let digit = |digits: &[u8]| u8::from_str_radix(std::str::from_utf8(digits).ok()?, 16).ok();
        let bytes: Option<Vec<u8>> = proof.as_bytes().chunks(2).map(digit).collect();
        let is_proof = |bytes: Vec<u8>| hmac::verify(&self.key(), text.as_bytes(), &bytes).is_ok();
        !self.text.is_empty() && bytes.is_some_and(is_proof)
    }

    /// Whether the sender of these headers knows the secret.
    ///
    /// # Errors
    /// The reason why the sender is refused.
    pub fn check(&self, headers: &HeaderMap) -> Result<(), Denial> {
        let header = headers.get(AUTHORIZATION).ok_or(Denial::Missing)?.as_bytes();
        let (scheme, text) = header.split_at_checked(7).ok_or(Denial::Unknown)?;
        if !scheme.eq_ignore_ascii_case(b"Bearer ") || text.len() > SECRET_BYTES_MAX || self.text.is_empty() {
            return Err(Denial::Unknown);
        }
        if bool::from(self.hash.as_slice().ct_eq(hash(text).as_slice())) { Ok(()) } else { Err(Denial::Unknown) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_who_knows_the_secret_is_another_daemon() {
        let secret = PeerSecret::new("0123abcd".to_owned());
        let with = |value: &str| HeaderMap::from_iter([(AUTHORIZATION, HeaderValue::from_str(value).expect("text"))]);
        assert_eq!(secret.check(&HeaderMap::new()), Err(Denial::Missing));
        for value in ["Bearer 0123abce", "Bearer ", "Basic 0123abcd", "0123abcd"] {
            assert_eq!(secret.check(&with(value)), Err(Denial::Unknown), "{value}");
        }
        let sent = HeaderMap::from_iter([(AUTHORIZATION, secret.header().expect("text"))]);
        assert_eq!(secret.check(&sent), Ok(()));
        assert_eq!(PeerSecret::new(String::new()).check(&with("Bearer ")), Err(Denial::Unknown));
        assert!(!format!("{secret:?}").contains("0123"));
    }
}
