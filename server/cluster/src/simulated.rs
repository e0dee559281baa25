//! A simulated engine, for tests: three servers, clients with names, and faults that a seed draws or a test requests.
//!
//! Each call sends a request to a task of its own, so that the request goes on when its sender gives up, as in a
//! network. Under tokio's paused clock in a runtime of one thread everything follows from the seed.
//!
//! Invariant: where no amnesia and no split occurred, the engine keeps every promise of [`crate::engine`].

mod faults;
mod stream;
#[cfg(test)]
mod tests;
mod world;

use std::{
    collections::BTreeMap,
    fmt::Debug,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use bytes::Bytes;
use tokio::{
    sync::{Notify, oneshot},
    time::{Instant, sleep, sleep_until, timeout_at},
};

pub use self::{
    faults::{EngineFault, EngineFaults},
    world::{Acknowledged, PlantedDefects},
};
use self::{stream::Kept, world::EngineWorld};
use crate::engine::{
    AppendIfError, Bucket, Engine, EngineError, EngineServer, KeyEntry, MESSAGE_BYTES_MAX, Message, SetError,
    StreamEnds, StreamHealth,
};

/// Patience of the calls that take none as an argument.
pub const PATIENCE: Duration = Duration::from_millis(500);

struct SharedWorld {
    world: Mutex<EngineWorld>,
    /// Wakes the calls that wait for messages, or until they are thawed.
    changed: Notify,
}

impl SharedWorld {
    fn world(&self) -> MutexGuard<'_, EngineWorld> {
        self.world.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The simulated engine from outside: creates clients, requests faults, and shows the history.
#[derive(Clone)]
pub struct Simulation {
    shared: Arc<SharedWorld>,
}

impl Simulation {
    /// A world with its faults. Needs a runtime of tokio, whose clock it starts from.
    pub fn new(seed: u64, faults: EngineFaults) -> Self {
        let world = Mutex::new(EngineWorld::new(seed, faults));
        Self { shared: Arc::new(SharedWorld { world, changed: Notify::new() }) }
    }

    /// A client with a name. Clients of one name share their faults.
    pub fn client(&self, name: &str) -> SimulatedEngine {
        SimulatedEngine { shared: Arc::clone(&self.shared), name: name.to_owned() }
    }

    fn change(&self, change: impl FnOnce(&mut EngineWorld)) {
        change(&mut self.shared.world());
        self.shared.changed.notify_waiters();
    }

    /// Changes the faults that are drawn from now on.
    pub fn set_faults(&self, faults: EngineFaults) {
        self.change(|world| world.faults = faults);
    }

    /// Plants defects, or removes them.
    pub fn plant(&self, defects: PlantedDefects) {
        self.change(|world| world.defects = defects);
    }

    /// Lets the next call of a client have a fault. Several faults go to as many calls, one each.
    pub fn fault_next(&self, client: &str, fault: EngineFault) {
        self.change(|world| world.fault_next(client, fault));
    }

    /// Cuts a client off until [`join`](Self::join).
    pub fn cut_off(&self, client: &str) {
        self.change(|world| world.cut(client, None));
    }

    /// Ends a cut.
    pub fn join(&self, client: &str) {
        self.change(|world| world.join(client));
    }

    /// Freezes a client as SIGSTOP does: its calls neither begin nor end until [`thaw`](Self::thaw). A request that is
    /// already under way arrives.
    pub fn freeze(&self, client: &str) {
        self.change(|world| world.set_frozen(client, true));
    }

    /// Lets a frozen client go on.
    pub fn thaw(&self, client: &str) {
        self.change(|world| world.set_frozen(client, false));
    }

    /// Stops one of the servers 0 to 2.
    pub fn stop_server(&self, server: usize) {
        self.change(|world| world.stop(server, None));
    }

    /// Starts a server again.
    pub fn start_server(&self, server: usize) {
        self.change(|world| world.run(server));
    }

    /// No stream and no bucket has a leader for a while.
    pub fn no_leader(&self, election: Duration) {
        self.change(|world| world.no_leader(election));
    }

    /// A stream has no room until [`make_room`](Self::make_room).
    pub fn fill(&self, stream: &str) {
        self.change(|world| world.fill(stream, None));
    }

    /// A stream has room again.
    pub fn make_room(&self, stream: &str) {
        self.change(|world| {
            if let Some(stream) = world.streams.get_mut(stream) {
                stream.full_until = None;
            }
        });
    }

    /// Lets a stream forget its last messages, and use their numbers again.
    pub fn forget(&self, stream: &str, count: u64) {
        self.change(|world| world.forget(stream, count));
    }

    /// Lets a bucket forget its last writes.
    pub fn forget_keys(&self, bucket: Bucket, count: u64) {
        self.change(|world| world.forget(&stream_of(bucket), count));
    }

    /// Gives a client a stream of its own, which acknowledges what it appends, until [`unite`](Self::unite). Both go on
    /// with equal numbers: a fork.
    pub fn split(&self, stream: &str, client: &str) {
        self.change(|world| world.split(stream, client, Instant::now() + Duration::from_secs(1 << 30)));
    }

    /// Ends a split: the messages that its client has appended since are forgotten.
    pub fn unite(&self, stream: &str) {
        self.change(|world| world.unite(stream));
    }

    /// All appends that were acknowledged to a client, in order of time. Forgotten ones are among them.
    pub fn acknowledged(&self) -> Vec<Acknowledged> {
        self.shared.world().acknowledged.clone()
    }

    /// The current messages of a stream; empty where there is no stream.
    pub fn present(&self, stream: &str) -> Vec<Message> {
        let world = self.shared.world();
        let numbered = world.streams.get(stream).map(|stream| &stream.numbered);
        numbered.into_iter().flat_map(|numbered| numbered.all().filter_map(|(at, _)| numbered.message(at))).collect()
    }

    /// All calls and faults, a line each, with their times.
    pub fn history(&self) -> Vec<String> {
        self.shared.world().history.clone()
    }

    /// Number of times that each fault has occurred.
    pub fn counts(&self) -> BTreeMap<EngineFault, usize> {
        self.shared.world().counts.clone()
    }
}

/// A client of the simulated engine.
#[derive(Clone)]
pub struct SimulatedEngine {
    shared: Arc<SharedWorld>,
    name: String,
}

fn stream_of(bucket: Bucket) -> String {
    format!("KV_{bucket:?}")
}

impl SimulatedEngine {
    /// Waits while the client is frozen.
    async fn thawed(&self) {
        loop {
            let mut changed = std::pin::pin!(self.shared.changed.notified());
            changed.as_mut().enable();
            if !self.shared.world().is_frozen(&self.name) {
                return;
            }
            changed.await;
        }
    }

    /// Sends a request and waits for its reply. `effect` is called again after each change until it returns a result;
    /// the last time, after `wait`, with `true`.
    async fn request<T, E>(&self, patience: Duration, wait: Duration, mut effect: E) -> Result<T, EngineError>
    where
        T: Send + 'static,
        E: FnMut(&mut EngineWorld, bool) -> Option<T> + Send + 'static,
    {
        self.thawed().await;
        let deadline = Instant::now() + patience;
        let passage = self.shared.world().passage(&self.name, patience);
        if passage.is_refused {
            return Err(EngineError::Unavailable("no connection".to_owned()));
        }
        let (sender, receiver) = oneshot::channel();
        if let Some(out) = passage.out {
            let (shared, name) = (Arc::clone(&self.shared), self.name.clone());
            tokio::spawn(async move {
                sleep(out).await;
                let until = Instant::now() + wait;
                let outcome = loop {
                    let mut changed = std::pin::pin!(shared.changed.notified());
                    changed.as_mut().enable();
                    let is_last = Instant::now() >= until;
                    let outcome = effect(&mut shared.world(), is_last);
                    match outcome {
                        Some(outcome) => break outcome,
                        None => drop(timeout_at(until, changed).await),
                    }
                };
                shared.changed.notify_waiters();
                if let Some(back) = passage.back {
                    sleep(back).await;
                    if !shared.world().is_cut(&name) {
                        drop(sender.send(outcome));
                    }
                }
            });
        }
        let outcome = timeout_at(deadline, receiver).await;
        self.thawed().await;
        match outcome {
            Ok(Ok(outcome)) => Ok(outcome),
            _ => {
                sleep_until(deadline).await;
                Err(EngineError::Unknown(format!("no reply within {patience:?}")))
            }
        }
    }

    /// A call that waits for nothing but its reply, and is written into the history.
    async fn call<T, F, E>(&self, what: String, patience: Duration, effect: E) -> Result<T, F>
    where
        T: Debug + Send + 'static,
        F: Debug + From<EngineError> + Send + 'static,
        E: FnOnce(&mut EngineWorld, &str) -> Result<T, F> + Send + 'static,
    {
        let name = self.name.clone();
        let mut effect = Some(effect);
        let once = move |world: &mut EngineWorld, _| Some((effect.take()?)(world, &name));
        let outcome = self.request(patience, Duration::ZERO, once).await;
        let outcome = outcome.unwrap_or_else(|error| Err(error.into()));
        self.shared.world().note(&format!("{}: {what}: {outcome:?}", self.name));
        outcome
    }

    /// Sets or deletes a key under a condition; `expected` is `None` where there is none.
    async fn write_key(
        &self,
        what: String,
        bucket: Bucket,
        key: &str,
        expected: Option<u64>,
        content: Option<Bytes>,
    ) -> Result<u64, SetError> {
        let key = key.to_owned();
        self.call(what, PATIENCE, move |world, client| {
            let ignore_expected = world.defects.ignore_expected || world.defects.useless_leases;
            let name = stream_of(bucket);
            let stream = world.led(&name, client)?;
            let newest = stream.seen_by(client).newest(&key);
            // For a client that creates a key, a deleted key has no revision; for a client that names its revision, it
            // has that one.
            let is_expected = match (expected, newest) {
                (None, _) | (Some(0), None) => true,
                (Some(0), Some((_, kept))) => kept.content.is_none(),
                (Some(expected), newest) => newest.is_some_and(|(revision, _)| revision == expected),
            };
            if !is_expected && !ignore_expected {
                return Err(SetError::NotExpected);
            }
            Ok(world.push(&name, client, Kept { key, content })?)
        })
        .await
    }
}

/// The engine error of a write that has no condition.
fn unconditional(error: SetError) -> EngineError {
    match error {
        SetError::Engine(error) => error,
        SetError::NotExpected => EngineError::Refused("a condition that was not requested".to_owned()),
    }
}

impl Engine for SimulatedEngine {
    async fn create_stream(&self, stream: &str, replicas: usize) -> Result<(), EngineError> {
        let name = stream.to_owned();
        self.call(format!("create {stream}"), PATIENCE, move |world, _| world.create(&name, replicas)).await
    }

    async fn delete_stream(&self, stream: &str) -> Result<(), EngineError> {
        let name = stream.to_owned();
        self.call(format!("delete {stream}"), PATIENCE, move |world, client| match world.led(&name, client) {
            Ok(_) => {
                world.streams.remove(&name);
                Ok(())
            }
            Err(EngineError::Missing(_)) => Ok(()),
            Err(error) => Err(error),
        })
        .await
    }

    async fn append_if(
        &self,
        stream: &str,
        expected_last: u64,
        content: Bytes,
        patience: Duration,
    ) -> Result<u64, AppendIfError> {
        if content.len() > MESSAGE_BYTES_MAX {
            return Err(EngineError::Refused("the message is too large".to_owned()).into());
        }
        let (name, kept) = (stream.to_owned(), Kept { key: String::new(), content: Some(content.clone()) });
        let what = format!("append to {stream} after {expected_last}");
        let outcome = self
            .call(what, patience, move |world, client| {
                if !world.takes_after(&name, client, expected_last)? {
                    return Err(AppendIfError::NotExpected);
                }
                Ok(world.push(&name, client, kept)?)
            })
            .await;
        if let Ok(sequence) = outcome {
            self.shared.world().acknowledge(stream, &self.name, sequence, content);
        }
        outcome
    }

    async fn ends(&self, stream: &str) -> Result<StreamEnds, EngineError> {
        let name = stream.to_owned();
        self.call(format!("ends of {stream}"), PATIENCE, move |world, client| {
            let (stale, runs) = (world.defects.stale_reads, world.runs());
            let stream = world.led(&name, client)?;
            let held = if stale { stream.stale_last(&runs) } else { u64::MAX };
            Ok(stream.seen_by(client).ends(held))
        })
        .await
    }

    async fn read(&self, stream: &str, sequence: u64) -> Result<Option<Message>, EngineError> {
        let name = stream.to_owned();
        self.call(format!("read {sequence} of {stream}"), PATIENCE, move |world, client| {
            let (stale, runs) = (world.defects.stale_reads, world.runs());
            let stream = world.led(&name, client)?;
            let held = if stale { stream.stale_last(&runs) } else { u64::MAX };
            Ok(stream.seen_by(client).message(sequence).filter(|_| sequence <= held))
        })
        .await
    }

    async fn read_from(
        &self,
        stream: &str,
        sequence: u64,
        bytes_max: usize,
        patience: Duration,
    ) -> Result<Vec<Message>, EngineError> {
        let (name, client) = (stream.to_owned(), self.name.clone());
        let effect = move |world: &mut EngineWorld, is_last: bool| {
            let numbered = match world.led(&name, &client) {
                Ok(stream) => stream.seen_by(&client),
                Err(error @ EngineError::Unavailable(_)) => return is_last.then_some(Err(error)),
                Err(error) => return Some(Err(error)),
            };
            let mut messages: Vec<Message> = Vec::new();
            let mut bytes = 0;
            while let Some(message) = numbered.message(sequence + messages.len() as u64) {
                bytes += message.content.len();
                if bytes > bytes_max && !messages.is_empty() {
                    break;
                }
                messages.push(message);
            }
            (is_last || !messages.is_empty()).then_some(Ok(messages))
        };
        // The reply to a wait without a result must come in time, too.
        let wait = patience.saturating_sub(Duration::from_millis(1));
        let messages = match self.request(patience, wait, effect).await {
            Ok(outcome) => outcome?,
            Err(EngineError::Unknown(_)) => Vec::new(),
            Err(error) => return Err(error),
        };
        if let (Some(first), Some(last)) = (messages.first(), messages.last()) {
            let (first, last) = (first.sequence, last.sequence);
            self.shared.world().note(&format!("{}: {first} to {last} of {stream}", self.name));
        }
        Ok(messages)
    }

    async fn purge_before(&self, stream: &str, sequence: u64) -> Result<(), EngineError> {
        let name = stream.to_owned();
        self.call(format!("purge {stream} before {sequence}"), PATIENCE, move |world, client| {
            world.led(&name, client)?.seen_by(client).purge_before(sequence);
            Ok(())
        })
        .await
    }

    async fn health(&self, stream: &str) -> Result<StreamHealth, EngineError> {
        let name = stream.to_owned();
        self.call(format!("health of {stream}"), PATIENCE, move |world, client| {
            let leader = match world.led(&name, client) {
                Ok(stream) => Some(stream.leader),
                Err(EngineError::Unavailable(_)) => None,
                Err(error) => return Err(error),
            };
            let stream = world.streams.get(&name).ok_or_else(|| EngineError::Missing(name.clone()))?;
            let last = stream.numbered.last();
            let followers = stream.held.iter().enumerate().filter(|&(server, _)| Some(server) != leader);
            Ok(StreamHealth {
                leader: leader.map(server_name),
                replicas: stream.replicas,
                followers: followers.map(|(server, &held)| (server_name(server), last.saturating_sub(held))).collect(),
                bytes: stream.numbered.bytes(),
            })
        })
        .await
    }

    async fn servers(&self) -> Result<Vec<EngineServer>, EngineError> {
        self.call("servers".to_owned(), PATIENCE, move |world, _| {
            let running = world.runs().into_iter().enumerate().filter(|&(_, runs)| runs);
            let server = |(server, _)| EngineServer {
                name: server_name(server),
                version: "2.15.1".to_owned(),
                syncs_always: Some(true),
            };
            Ok(running.map(server).collect())
        })
        .await
    }

    async fn create_buckets(&self, replicas: usize) -> Result<(), EngineError> {
        self.call("create the buckets".to_owned(), PATIENCE, move |world, _| {
            let buckets = [Bucket::Members, Bucket::Maps, Bucket::Writers];
            buckets.into_iter().try_for_each(|bucket| world.create(&stream_of(bucket), replicas))
        })
        .await
    }

    async fn get(&self, bucket: Bucket, key: &str) -> Result<Option<KeyEntry>, EngineError> {
        let wanted = key.to_owned();
        self.call(format!("get {key} of {bucket:?}"), PATIENCE, move |world, client| {
            let is_oldest = world.defects.useless_leases && bucket == Bucket::Writers;
            let numbered = world.led(&stream_of(bucket), client)?.seen_by(client);
            let oldest = || numbered.all().find(|(_, kept)| kept.key == wanted);
            let newest = if is_oldest { oldest() } else { numbered.newest(&wanted) };
            Ok(newest.and_then(|(revision, kept)| Some(KeyEntry { value: kept.content.clone()?, revision })))
        })
        .await
    }

    async fn list(&self, bucket: Bucket) -> Result<Vec<(String, KeyEntry)>, EngineError> {
        self.call(format!("list {bucket:?}"), PATIENCE, move |world, client| {
            let numbered = world.led(&stream_of(bucket), client)?.seen_by(client);
            let newest: BTreeMap<_, _> = numbered.all().map(|(revision, kept)| (&kept.key, (revision, kept))).collect();
            let entry = |(key, (revision, kept)): (&String, (u64, &Kept))| {
                Some((key.clone(), KeyEntry { value: kept.content.clone()?, revision }))
            };
            Ok(newest.into_iter().filter_map(entry).collect())
        })
        .await
    }

    async fn set_if(&self, bucket: Bucket, key: &str, expected: u64, value: Bytes) -> Result<u64, SetError> {
        let what = format!("set {key} of {bucket:?} if {expected}");
        self.write_key(what, bucket, key, Some(expected), Some(value)).await
    }

    async fn set(&self, bucket: Bucket, key: &str, value: Bytes) -> Result<u64, EngineError> {
        let what = format!("set {key} of {bucket:?}");
        self.write_key(what, bucket, key, None, Some(value)).await.map_err(unconditional)
    }

    async fn delete_if(&self, bucket: Bucket, key: &str, expected: u64) -> Result<(), SetError> {
        let what = format!("delete {key} of {bucket:?} if {expected}");
        self.write_key(what, bucket, key, Some(expected), None).await.map(drop)
    }
}

fn server_name(server: usize) -> String {
    format!("simulated-{server}")
}
