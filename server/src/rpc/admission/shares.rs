//! What requests hold while they are under way, by kind, of one client and in total.
//!
//! Invariant: nothing is taken beyond a bound, and all that was taken is given back when its [`Taken`] is dropped. Who
//! has shown no token takes nothing of those who have.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, PoisonError},
};

use super::RequestLimits;
use crate::{connections::Peer, rpc::status::RpcError};

/// Bounds of requests that need no token: they are small and end at once.
const OPEN_REQUESTS: usize = 128;
const OPEN_REQUESTS_PER_CLIENT: usize = 16;
/// Bounds of large requests as JSON, which are converted one after the other.
const LARGE_JSON: usize = 32;
const LARGE_JSON_PER_CLIENT: usize = 4;
/// Bounds of the bytes of large requests that arrive at the same time.
const LARGE_REQUESTS_BYTES: usize = 64 << 20;
const LARGE_REQUESTS_BYTES_PER_CLIENT: usize = 32 << 20;

/// What is bounded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Share {
    /// Requests.
    Requests,
    /// Requests that need no token, of those who have shown none.
    Open,
    /// Watches of health, which may last for long.
    HealthWatches,
    /// Large requests as JSON.
    LargeJson,
    /// Bytes of large requests.
    LargeBytes,
}

/// What is under way. Clones share it.
#[derive(Clone, Debug)]
pub(super) struct Shares {
    limits: RequestLimits,
    taken: Arc<Mutex<HashMap<Share, Count>>>,
}

#[derive(Debug, Default)]
struct Count {
    total: usize,
    per_client: HashMap<Peer, usize>,
}

/// A part of a share, given back when dropped.
#[derive(Debug)]
pub(crate) struct Taken {
    share: Share,
    peer: Peer,
    amount: usize,
    shares: Shares,
}

impl Drop for Taken {
    fn drop(&mut self) {
        self.shares.change(self.share, |count| {
            count.total -= self.amount;
            if let Some(of_client) = count.per_client.get_mut(&self.peer) {
                *of_client -= self.amount;
                if *of_client == 0 {
                    count.per_client.remove(&self.peer);
                }
            }
        });
    }
}

impl Taken {
    /// Takes more of the same.
    ///
    /// # Errors
    /// There is no room.
    pub(super) fn grow(&mut self, amount: usize) -> Result<(), RpcError> {
        let mut more = self.shares.take(self.share, self.peer, amount)?;
        self.amount += std::mem::take(&mut more.amount);
        Ok(())
    }
}

impl Shares {
    pub(super) fn new(limits: RequestLimits) -> Self {
        Self { limits, taken: Arc::default() }
    }

    /// The bounds of a client and of all, each with what the refusal calls it.
    fn bounds(&self, share: Share) -> [(usize, &'static str); 2] {
        let RequestLimits { total, per_client } = self.limits;
        match share {
            Share::Requests => [(per_client, "setting max_requests_per_client"), (total, "setting max_requests")],
            Share::HealthWatches => [
                (per_client, "setting max_requests_per_client, here for watches of health"),
                (total, "setting max_requests, here for watches of health"),
            ],
            Share::Open => [
                (OPEN_REQUESTS_PER_CLIENT, "requests of one client without a token"),
                (OPEN_REQUESTS, "requests without a token"),
            ],
            Share::LargeJson => [
                (LARGE_JSON_PER_CLIENT, "large requests of one client as JSON"),
                (LARGE_JSON, "large requests as JSON"),
            ],
            Share::LargeBytes => [
                (LARGE_REQUESTS_BYTES_PER_CLIENT, "bytes of large requests of one client"),
                (LARGE_REQUESTS_BYTES, "bytes of large requests"),
            ],
        }
    }

    fn change<T>(&self, share: Share, change: impl FnOnce(&mut Count) -> T) -> T {
        let mut taken = self.taken.lock().unwrap_or_else(PoisonError::into_inner);
        let count = taken.entry(share).or_default();
        let result = change(count);
        if share == Share::Requests {
            metrics::gauge!("tidemap_requests").set(count.total as f64);
        }
        result
    }

    /// Takes a part of a share.
    ///
    /// # Errors
    /// There is no room.
    pub(super) fn take(&self, share: Share, peer: Peer, amount: usize) -> Result<Taken, RpcError> {
        let [of_client, of_all] = self.bounds(share);
        let refused = self.change(share, |count| {
            let client = count.per_client.get(&peer).copied().unwrap_or(0);
            let over = |taken: usize, (max, _): (usize, _)| max.saturating_sub(taken) < amount;
            if over(client, of_client) {
                return Some(of_client);
            }
            if over(count.total, of_all) {
                return Some(of_all);
            }
            count.total += amount;
            *count.per_client.entry(peer).or_default() += amount;
            None
        });
        match refused {
            None => Ok(Taken { share, peer, amount, shares: self.clone() }),
            Some((max, bound)) => {
                metrics::counter!("tidemap_requests_refused").increment(1);
                Err(RpcError::TooManyRequests { max, bound })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn peer(last: u8) -> Peer {
        Peer::Address([10, 0, 0, last].into())
    }

    fn refusal(taken: Result<Taken, RpcError>) -> String {
        taken.expect_err("no room").to_string()
    }

    #[test]
    fn requests_beyond_a_bound_are_refused_and_counted_until_they_end() {
        let shares = Shares::new(RequestLimits { total: 3, per_client: 2 });
        let take = |last| shares.take(Share::Requests, peer(last), 1);
        let taken: Vec<_> = (0..2).map(|_| take(1).expect("admitted")).collect();
        let refused = refusal(take(1));
        assert!(refused.contains("max_requests_per_client"), "{refused}");
        let other = take(2).expect("another client");
        let refused = refusal(take(3));
        assert!(refused.contains("max_requests:"), "{refused}");
        drop((taken, other));
        assert!(take(3).is_ok());
        assert!(shares.change(Share::Requests, |count| count.total == 0 && count.per_client.is_empty()));
    }

    #[test]
    fn who_has_shown_no_token_takes_no_place_of_others() {
        let shares = Shares::new(RequestLimits { total: 3, per_client: 2 });
        let open: Vec<_> = std::iter::from_fn(|| shares.take(Share::Open, peer(1), 1).ok()).collect();
        assert_eq!(open.len(), OPEN_REQUESTS_PER_CLIENT);
        assert!(shares.take(Share::Open, peer(2), 1).is_ok());
        assert!(shares.take(Share::Requests, peer(1), 1).is_ok());
    }

    #[test]
    fn bytes_grow_within_the_bound_of_a_client_and_are_given_back_together() {
        let shares = Shares::new(RequestLimits { total: 3, per_client: 2 });
        let mut held = shares.take(Share::LargeBytes, peer(1), 10).expect("room");
        held.grow(LARGE_REQUESTS_BYTES_PER_CLIENT - 10).expect("room");
        let refused = held.grow(1).expect_err("no room").to_string();
        assert!(refused.contains("bytes of large requests of one client"), "{refused}");
        assert!(shares.take(Share::LargeBytes, peer(2), 10).is_ok());
        drop(held);
        assert!(shares.change(Share::LargeBytes, |count| count.total == 0 && count.per_client.is_empty()));
    }
}
