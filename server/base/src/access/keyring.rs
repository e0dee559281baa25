//! The tokens that are valid now.
//!
//! Invariant: a comparison takes the same time whatever the token is, also for an unknown token. Work for a token ends
//! when the token is revoked or changed, or has expired.

use std::{collections::HashMap, path::PathBuf, sync::Arc, time::Duration};

use axum::http::{HeaderMap, header::AUTHORIZATION};
use subtle::ConstantTimeEq as _;
use tokio::sync::watch;

use super::{
    Caller,
    token_file::{self, PREFIX, Token, TokenFileError, TokenHash, hash},
};
use crate::clock::{Clock as _, SystemClock};

/// Interval at which work for a token that expires reads the clock, which may also be set.
const CHECK_INTERVAL: Duration = Duration::from_secs(2);
/// A longer text is no token.
const TOKEN_BYTES_MAX: usize = 256;
/// The hash with which an unknown token is compared.
const NO_HASH: TokenHash = [0; 32];

type ById = HashMap<String, Arc<Token>>;

/// The reason why a request has no caller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Denial {
    /// The request has no token.
    Missing,
    /// The token of the request is not among the tokens of the file.
    Unknown,
    /// The token of the request was valid until a time that has passed.
    Expired,
}

/// The tokens of a file. Clones share them.
#[derive(Clone, Debug)]
pub struct Keyring {
    path: Arc<PathBuf>,
    tokens: Arc<watch::Sender<Arc<ById>>>,
}

impl Keyring {
    /// Reads the tokens of a file.
    ///
    /// # Errors
    /// See [`TokenFileError`].
    pub fn open(path: PathBuf) -> Result<Self, TokenFileError> {
        let tokens = Arc::new(watch::Sender::new(Arc::new(read(&path)?)));
        Ok(Self { path: Arc::new(path), tokens })
    }

    /// Reads the file again.
    ///
    /// # Errors
    /// See [`TokenFileError`]; the tokens stay as they were.
    pub fn reload(&self) -> Result<(), TokenFileError> {
        self.tokens.send_replace(Arc::new(read(&self.path)?));
        Ok(())
    }

    /// The caller who sent these headers.
    ///
    /// # Errors
    /// There is no token, or it is not valid.
    pub fn caller(&self, headers: &HeaderMap) -> Result<Caller, Denial> {
        let header = headers.get(AUTHORIZATION).ok_or(Denial::Missing)?.as_bytes();
        let (scheme, text) = header.split_at_checked(7).ok_or(Denial::Unknown)?;
        if !scheme.eq_ignore_ascii_case(b"Bearer ") || text.len() > TOKEN_BYTES_MAX {
            return Err(Denial::Unknown);
        }
        let given = hash(text);
        let tokens = Arc::clone(&self.tokens.borrow());
        let id = std::str::from_utf8(text).ok().and_then(|text| text.strip_prefix(PREFIX)?.split_once('_'));
        let found = id.and_then(|(id, _)| tokens.get(id));
        let kept = found.map_or(&NO_HASH, |token| &token.hash);
        let is_equal = bool::from(kept.as_slice().ct_eq(given.as_slice()));
        match found {
            Some(token) if is_equal && token.has_expired(SystemClock.now_nanos()) => Err(Denial::Expired),
            Some(token) if is_equal => Ok(Caller::Holder(Arc::clone(token))),
            _ => Err(Denial::Unknown),
        }
    }

    /// Ready when the token of a caller is no longer valid as it was, within [`CHECK_INTERVAL`] of its end; never for a
    /// caller without one.
    pub async fn revoked(self, caller: Caller) {
        let Caller::Holder(token) = caller else { return std::future::pending().await };
        let mut tokens = self.tokens.subscribe();
        loop {
            let is_valid = tokens.borrow_and_update().get(&token.id) == Some(&token);
            if !is_valid || token.has_expired(SystemClock.now_nanos()) {
                return;
            }
            tokio::select! {
                changed = tokens.changed() => if changed.is_err() {
                    return;
                },
                () = tokio::time::sleep(CHECK_INTERVAL), if token.expires_secs.is_some() => {}
            }
        }
    }
}

fn read(path: &std::path::Path) -> Result<ById, TokenFileError> {
    let tokens = token_file::read(path)?;
    metrics::gauge!("tidemap_tokens").set(tokens.len() as f64);
    Ok(tokens.into_iter().map(|token| (token.id.clone(), Arc::new(token))).collect())
}
