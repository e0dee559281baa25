//! The resources that clients share, and the amount of each that one client may take. They are counted only here.
//!
//! A client is the holder of a token, or an address that shows none. A daemon that passes a request on names the
//! original client ([`client::Client`]). A resource that is refused beyond a bound is a [`Share`]; a resource for which
//! clients wait is a [`waited::WaitedShare`].
//!
//! Invariant: nothing is taken beyond a bound, and a taken part is given back when its [`Taken`] is dropped. A client
//! may take only a part of each share. Clients without a token take nothing from clients with one.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, PoisonError},
};

use tidemap_store::MapId;

pub mod client;
#[cfg(test)]
mod table;
pub mod waited;

use client::Client;

use crate::config::Settings;

/// Bounds of requests that need no token: these are small and end at once.
const OPEN_REQUESTS: (usize, usize) = (128, 16);
/// Bounds of large requests as JSON, which are converted one after the other.
const LARGE_JSON: (usize, usize) = (32, 4);
/// Bounds of the bytes of large requests that arrive at the same time.
const LARGE_REQUESTS_BYTES: (usize, usize) = (64 << 20, 32 << 20);
/// Bounds of requested updates that have not ended. A map lets 16 wait, which is more than one client has.
const UPDATES: (usize, usize) = (1024, 8);

/// A bounded resource.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Share {
    /// Requests.
    Requests,
    /// Requests that need no token, from clients that have shown none.
    Open,
    /// Watches of health, which may last for long.
    HealthWatches,
    /// Large requests as JSON.
    LargeJson,
    /// Bytes of large requests.
    LargeBytes,
    /// Streams of observations that have not sent their hello.
    Hellos,
    /// Streams of observations.
    Streams,
    /// Bytes of the tables of tiles and of unfinished scans of streams.
    TableBytes,
    /// Watches of anomalies.
    Watches,
    /// Trained models that evaluations hold.
    TrainedModels,
    /// Requested updates.
    Updates,
}

impl Share {
    /// Whether the holder of this share ends by itself soon, so that a repetition is useful.
    pub fn ends_soon(self) -> bool {
        matches!(self, Self::Requests | Self::Open | Self::LargeJson | Self::LargeBytes)
    }
}

/// The bounds of the shares that have settings: the total, and the part of one client.
#[derive(Clone, Copy, Debug)]
pub struct ShareLimits {
    /// Requests that run at once.
    pub requests: (usize, usize),
    /// Open streams of observations.
    pub streams: (usize, usize),
    /// Watches of anomalies.
    pub watches: (usize, usize),
    /// The total; a client has half of it.
    pub table_bytes: usize,
    /// The total; a client has half of it.
    pub trained_models: usize,
}

impl ShareLimits {
    /// The bounds by the settings.
    pub fn of(settings: &Settings) -> Self {
        Self {
            requests: (settings.max_requests, settings.max_requests_per_client),
            streams: (settings.max_streams, settings.max_streams_per_client),
            watches: (settings.max_watches, settings.max_watches_per_client),
            table_bytes: settings.max_stream_tables_bytes,
            trained_models: settings.max_trained_models,
        }
    }
}

/// The part of one client, or of one map, where no setting gives it.
pub fn half(total: usize) -> usize {
    (total / 2).max(1)
}

/// The holder whose bound is reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bound {
    /// One client.
    Client,
    /// The clients of one map.
    Map,
    /// All clients.
    All,
}

/// There is no room in a share.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{max} are in use, which is the maximum of {name}: try again when some have ended")]
pub struct ShareFull {
    /// The share.
    pub share: Share,
    /// The holder whose bound is reached.
    pub bound: Bound,
    /// The bound.
    pub max: usize,
    /// Name of the bounded resource, for people.
    pub name: &'static str,
}

/// A bound, with its name in the refusal.
type Named = (usize, &'static str);

/// The bounds of a share.
struct Bounds {
    client: Named,
    /// Name of the bound of all clients of one map, where the share is divided by maps: a map may take half of what the
    /// other maps leave.
    map: Option<&'static str>,
    all: Named,
    /// Whether clients of this machine without a token have no bound of their own. They could do more harm than taking
    /// all.
    spares_this_machine: bool,
}

/// The parts in use. Clones share them.
#[derive(Clone, Debug)]
pub struct Shares {
    limits: ShareLimits,
    taken: Arc<Mutex<HashMap<Share, Count>>>,
}

#[derive(Debug, Default)]
struct Count {
    total: usize,
    per_client: HashMap<Client, usize>,
    per_map: HashMap<MapId, usize>,
}

fn give_back<K: Eq + std::hash::Hash>(counts: &mut HashMap<K, usize>, key: &K, amount: usize) {
    if let Some(count) = counts.get_mut(key) {
        *count -= amount;
        if *count == 0 {
            counts.remove(key);
        }
    }
}

/// A part of a share, given back when dropped.
#[derive(Debug)]
pub struct Taken {
    share: Share,
    client: Client,
    map: Option<MapId>,
    amount: usize,
    shares: Shares,
}

impl Drop for Taken {
    fn drop(&mut self) {
        self.shares.change(self.share, |count| {
            count.total -= self.amount;
            give_back(&mut count.per_client, &self.client, self.amount);
            if let Some(map) = &self.map {
                give_back(&mut count.per_map, map, self.amount);
            }
        });
    }
}

impl Taken {
    /// Takes more of the same share.
    ///
    /// # Errors
    /// There is no room.
    pub fn grow(&mut self, amount: usize) -> Result<(), ShareFull> {
        let mut more = self.shares.take_of(self.share, &self.client, self.map, amount)?;
        self.amount += std::mem::take(&mut more.amount);
        Ok(())
    }

    /// The taken amount.
    pub fn amount(&self) -> usize {
        self.amount
    }
}

impl Shares {
    /// The shares with these bounds; none is taken.
    pub fn new(limits: ShareLimits) -> Self {
        Self { limits, taken: Arc::default() }
    }

    fn bounds(&self, share: Share) -> Bounds {
        let limits = &self.limits;
        let bounds = |(all, client): (usize, usize), [of_all, of_client]: [&'static str; 2]| Bounds {
            client: (client, of_client),
            map: None,
            all: (all, of_all),
            spares_this_machine: false,
        };
        match share {
            Share::Requests => bounds(limits.requests, ["setting max_requests", "setting max_requests_per_client"]),
            Share::HealthWatches => bounds(
                limits.requests,
                [
                    "setting max_requests, here for watches of health",
                    "setting max_requests_per_client, here for watches of health",
                ],
            ),
            Share::Open => {
                bounds(OPEN_REQUESTS, ["requests without a token", "requests of one client without a token"])
            }
            Share::LargeJson => bounds(LARGE_JSON, ["large requests as JSON", "large requests of one client as JSON"]),
            Share::LargeBytes => {
                bounds(LARGE_REQUESTS_BYTES, ["bytes of large requests", "bytes of large requests of one client"])
            }
            Share::Hellos => self.of_streams([
                "setting max_streams, here for streams that have not sent hello",
                "setting max_streams_per_client, here for streams that have not sent hello",
            ]),
            Share::Streams => self.of_streams(["setting max_streams", "setting max_streams_per_client"]),
            Share::TableBytes => self.of_tables(),
            Share::Watches => Bounds {
                spares_this_machine: true,
                ..bounds(limits.watches, ["setting max_watches", "setting max_watches_per_client"])
            },
            Share::TrainedModels => Bounds {
                spares_this_machine: true,
                ..bounds(
                    (limits.trained_models, half(limits.trained_models)),
                    [
                        "setting max_trained_models, here for those that evaluations hold",
                        "half of setting max_trained_models, here for those that evaluations of one client hold",
                    ],
                )
            },
            Share::Updates => Bounds {
                spares_this_machine: true,
                ..bounds(
                    UPDATES,
                    [
                        "updates that were requested and have not ended",
                        "updates that one client has requested and that have not ended",
                    ],
                )
            },
        }
    }

    fn of_streams(&self, [of_all, of_client]: [&'static str; 2]) -> Bounds {
        let (all, client) = self.limits.streams;
        Bounds { client: (client, of_client), map: None, all: (all, of_all), spares_this_machine: true }
    }

    fn of_tables(&self) -> Bounds {
        let all = self.limits.table_bytes;
        Bounds {
            client: (half(all), "half of setting max_stream_tables_bytes, for the streams of one client"),
            map: Some("half of what other maps leave of setting max_stream_tables_bytes, for the streams of one map"),
            all: (all, "setting max_stream_tables_bytes"),
            spares_this_machine: true,
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
    pub fn take(&self, share: Share, client: &Client, amount: usize) -> Result<Taken, ShareFull> {
        self.take_of(share, client, None, amount)
    }

    /// Takes a part of a share for work on a map.
    ///
    /// # Errors
    /// There is no room.
    pub fn take_for(&self, share: Share, (client, map): (&Client, MapId), amount: usize) -> Result<Taken, ShareFull> {
        self.take_of(share, client, Some(map), amount)
    }

    fn take_of(&self, share: Share, client: &Client, map: Option<MapId>, amount: usize) -> Result<Taken, ShareFull> {
        let bounds = self.bounds(share);
        let is_spared = bounds.spares_this_machine && client.is_of_this_machine();
        self.change(share, |count| {
            let check = |taken: usize, (max, name): Named, bound: Bound| {
                if max.saturating_sub(taken) < amount { Err(ShareFull { share, bound, max, name }) } else { Ok(()) }
            };
            if !is_spared {
                check(count.per_client.get(client).copied().unwrap_or(0), bounds.client, Bound::Client)?;
            }
            if let Some((map, name)) = map.zip(bounds.map) {
                let taken = count.per_map.get(&map).copied().unwrap_or(0);
                // There is always room for another map, for any number of maps at work.
                let left = bounds.all.0.saturating_sub(count.total - taken);
                check(taken, (half(left), name), Bound::Map)?;
            }
            check(count.total, bounds.all, Bound::All)?;
            count.total += amount;
            *count.per_client.entry(client.clone()).or_default() += amount;
            if let Some(map) = map {
                *count.per_map.entry(map).or_default() += amount;
            }
            Ok(())
        })
        .inspect_err(|_| metrics::counter!("tidemap_requests_refused").increment(1))?;
        Ok(Taken { share, client: client.clone(), map, amount, shares: self.clone() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::connections::Peer;

    fn client(last: u8) -> Client {
        Client::Address(Peer::Address([10, 0, 0, last].into()))
    }

    fn shares(requests: (usize, usize)) -> Shares {
        Shares::new(ShareLimits { requests, ..ShareLimits::of(&Settings::default()) })
    }

    fn refusal(taken: Result<Taken, ShareFull>) -> String {
        taken.expect_err("no room").to_string()
    }

    #[test]
    fn requests_beyond_a_bound_are_refused_and_counted_until_they_end() {
        let shares = shares((3, 2));
        let take = |last| shares.take(Share::Requests, &client(last), 1);
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
    fn a_token_is_one_client_wherever_it_comes_from_and_no_other_one_of_its_address() {
        let shares = shares((3, 1));
        let [one, other] = ["one", "other"].map(|id| Client::Token(id.into()));
        let _held = shares.take(Share::Requests, &one, 1).expect("room");
        assert!(refusal(shares.take(Share::Requests, &one, 1)).contains("max_requests_per_client"));
        let _others = [&other, &client(1)].map(|client| shares.take(Share::Requests, client, 1).expect("another"));
    }

    #[test]
    fn programs_of_this_machine_without_a_token_share_the_long_lasting_pools_unbounded() {
        let limits = ShareLimits { watches: (4, 1), ..ShareLimits::of(&Settings::default()) };
        let shares = Shares::new(limits);
        let here = Client::Address(Peer::Address([127, 0, 0, 1].into()));
        let held: Vec<_> = std::iter::from_fn(|| shares.take(Share::Watches, &here, 1).ok()).collect();
        assert_eq!(held.len(), 4);
    }

    #[test]
    fn who_has_shown_no_token_takes_no_place_of_others() {
        let shares = shares((3, 2));
        let open: Vec<_> = std::iter::from_fn(|| shares.take(Share::Open, &client(1), 1).ok()).collect();
        assert_eq!(open.len(), OPEN_REQUESTS.1);
        assert!(shares.take(Share::Open, &client(2), 1).is_ok());
        assert!(shares.take(Share::Requests, &client(1), 1).is_ok());
    }

    #[test]
    fn bytes_grow_within_the_bound_of_a_client_and_are_given_back_together() {
        let shares = shares((3, 2));
        let mut held = shares.take(Share::LargeBytes, &client(1), 10).expect("room");
        held.grow(LARGE_REQUESTS_BYTES.1 - 10).expect("room");
        let refused = held.grow(1).expect_err("no room").to_string();
        assert!(refused.contains("bytes of large requests of one client"), "{refused}");
        assert!(shares.take(Share::LargeBytes, &client(2), 10).is_ok());
        drop(held);
        assert!(shares.change(Share::LargeBytes, |count| count.total == 0 && count.per_client.is_empty()));
    }

    #[test]
    fn the_clients_of_each_map_leave_half_of_what_is_left_of_the_tables_to_other_maps() {
        let shares = shares((3, 2));
        let all = Settings::default().max_stream_tables_bytes;
        let take = |last, map, bytes| shares.take_for(Share::TableBytes, (&client(last), MapId(map)), bytes);
        let _held = [1, 2].map(|last| take(last, 1, all / 4).expect("room"));
        let refused = refusal(take(3, 1, 1));
        assert!(refused.contains("of one map"), "{refused}");
        let _second = take(3, 2, all / 4).expect("half of what the first one leaves");
        assert!(refusal(take(4, 2, 1)).contains("of one map"));
        assert!(take(4, 3, all / 8).is_ok(), "two maps that have all they may leave room for a third");
    }
}
