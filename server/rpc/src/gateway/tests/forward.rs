//! Many reads with tokens, while the writer changes and followers lag: no reply shows less than its token.
//!
//! Each event of the log adds one state, so that the number of states shows what a reply contains, whatever its token
//! is. `TIDEMAP_TOKEN_READS` is the number of reads.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};
use tidemap_ingest::protocol::Command;
use tidemap_map::event::Event;
use tidemap_store::{AppendError, Done, EventLog};
use tokio::{sync::oneshot, task::JoinSet};

use super::*;

const NAMES: [&str; 3] = ["a", "b", "c"];
const READERS: usize = 40;

/// A log in memory: one member may append.
struct CommonLog(Mutex<(Vec<Event>, &'static str)>);

/// The log as one member uses it to append.
struct LogOfMember {
    log: Arc<CommonLog>,
    member: &'static str,
}

impl CommonLog {
    fn end(&self) -> u64 {
        self.0.lock().expect("not poisoned").0.len() as u64
    }

    /// From now on only this member may append; returns the end of the log at this moment.
    fn give_to(&self, member: &'static str) -> u64 {
        let mut state = self.0.lock().expect("not poisoned");
        state.1 = member;
        state.0.len() as u64
    }

    fn between(&self, after: u64, last: u64) -> Vec<(u64, Event)> {
        let events = &self.0.lock().expect("not poisoned").0;
        (after + 1..=last).map(|position| (position, events[position as usize - 1].clone())).collect()
    }
}

impl EventLog for LogOfMember {
    fn append(&self, event: &Event, done: Done) -> Result<(), AppendError> {
        let mut state = self.log.0.lock().expect("not poisoned");
        if state.1 != self.member {
            return Err(AppendError::NotWriter { writer: Some(state.1.to_owned()) });
        }
        state.0.push(event.clone());
        let position = state.0.len() as u64;
        drop(state);
        done(Ok(position));
        Ok(())
    }

    fn resume(&self) {}

    fn end(&self) -> u64 {
        self.log.end()
    }

    fn tail_bytes(&self) -> u64 {
        0
    }

    fn is_current(&self) -> bool {
        self.log.0.lock().expect("not poisoned").1 == self.member
    }
}

/// Members with their log, and the highest token that anybody has.
struct Members {
    members: Vec<Member>,
    log: Arc<CommonLog>,
    highest: Mutex<ReadToken>,
    is_over: AtomicBool,
}

impl Members {
    async fn start(ignores_seen: bool) -> Arc<Self> {
        let log = Arc::new(CommonLog(Mutex::new((Vec::new(), NAMES[0]))));
        let mut members = Vec::new();
        for name in NAMES {
            let making =
                Making { restored_first_bytes: u64::MAX, access: Access::Anybody, max_states: 1_000_000, ignores_seen };
            let dir = tempfile::tempdir().expect("temporary folder");
            let (member, _) = Member::make(name, dir, making).await;
            member.catalog.create_on(spec(), Arc::new(LogOfMember { log: Arc::clone(&log), member: name }));
            members.push(member);
        }
        for member in &members {
            members.iter().zip(NAMES).for_each(|(other, name)| member.knows(name, &other.address));
        }
        for member in &members[1..] {
            member.notify(ReplicaEvent::Following { writer: Some(NAMES[0].to_owned()) }).await;
        }
        members[0].notify(ReplicaEvent::Writing { epoch: 1 }).await;
        Arc::new(Self { members, log, highest: Mutex::default(), is_over: AtomicBool::new(false) })
    }

    fn highest(&self) -> ReadToken {
        *self.highest.lock().expect("not poisoned")
    }

    fn saw(&self, token: ReadToken) {
        let mut highest = self.highest.lock().expect("not poisoned");
        *highest = highest.max(token);
    }

    /// Passes the events of the log up to a log position to a follower.
    async fn feed(&self, index: usize, fed: &mut u64, last: u64) {
        let events = self.log.between(*fed, last);
        let (applied, is_applied) = oneshot::channel();
        self.members[index].handle().send(Command::Replica(ReplicaEvent::Followed { events, applied }));
        is_applied.await.expect("applied");
        *fed = last;
    }

    /// Feeds followers late, and lets another member write now and then. The old writer may notice it late.
    async fn disturb(&self, seed: u64) {
        let mut random = SmallRng::seed_from_u64(seed);
        let (mut fed, mut stalled, mut writer, mut epoch) = ([0; 3], [Instant::now(); 3], 0, 1);
        while !self.is_over.load(Ordering::Relaxed) {
            tokio::time::sleep(Duration::from_millis(random.random_range(1..12))).await;
            for index in (0..3).filter(|&index| index != writer) {
                if stalled[index] > Instant::now() {
                    continue;
                }
                if random.random_bool(0.008) {
                    // This is longer than a request waits.
                    stalled[index] = Instant::now() + Duration::from_millis(random.random_range(50..400));
                }
                let last = random.random_range(fed[index]..=self.log.end());
                self.feed(index, &mut fed[index], last).await;
            }
            if !random.random_bool(0.03) {
                continue;
            }
            let (old, new) = (writer, (writer + random.random_range(1..3)) % 3);
            let end = self.log.give_to(NAMES[new]);
            fed[old] = end;
            self.feed(new, &mut fed[new], end).await;
            epoch += 1;
            self.members[new].notify(ReplicaEvent::Writing { epoch }).await;
            tokio::time::sleep(Duration::from_millis(random.random_range(0..300))).await;
            for index in (0..3).filter(|&index| index != new) {
                self.members[index].notify(ReplicaEvent::Following { writer: Some(NAMES[new].to_owned()) }).await;
            }
            writer = new;
        }
    }

    async fn add_states(&self, seed: u64) {
        let mut random = SmallRng::seed_from_u64(seed);
        for number in 0.. {
            if self.is_over.load(Ordering::Relaxed) {
                return;
            }
            tokio::time::sleep(Duration::from_millis(random.random_range(1..15))).await;
            // A state that is refused is added under another name.
            if let Ok(added) = self.members[random.random_range(0..3)].add_state(&format!("state-{number}")).await {
                self.saw(shown(added.metadata()));
            }
        }
    }

    /// Reads from any member until all readers together have this many replies. Each reply is compared with its token.
    async fn read(&self, seed: u64, tally: &Tally, reads: u64) -> Result<(), String> {
        let mut random = SmallRng::seed_from_u64(seed);
        let mut clients = Vec::new();
        for member in &self.members {
            clients.push(member.maps().await);
        }
        let mut own = ReadToken::default();
        while tally.answered.load(Ordering::Relaxed) < reads {
            let wanted = if random.random_bool(0.3) { self.highest() } else { own };
            let index = random.random_range(0..3);
            let is_behind = self.members[index].handle().shown().position < wanted.position;
            let mut request = tonic::Request::new(v1::GetMapRequest { name: "office".to_owned() });
            mark(&mut request, Some(wanted));
            let reply = match clients[index].get_map(request).await {
                Ok(reply) => reply,
                Err(status) if status.code() == Code::Unavailable => {
                    tally.refused.fetch_add(1, Ordering::Relaxed);
                    continue;
                }
                Err(status) => return Err(format!("{status:?}")),
            };
            let stamp = shown(reply.metadata());
            let states = reply.into_inner().map.expect("a map").states;
            if !stamp.reaches(wanted) || states < wanted.position {
                return Err(format!(
                    "{} shows {states} states and reports {stamp}, and {wanted} was seen",
                    NAMES[index]
                ));
            }
            own = own.max(stamp);
            self.saw(stamp);
            tally.answered.fetch_add(1, Ordering::Relaxed);
            tally.behind.fetch_add(u64::from(is_behind), Ordering::Relaxed);
        }
        Ok(())
    }
}

/// The outcomes of all reads.
#[derive(Debug, Default)]
struct Tally {
    answered: AtomicU64,
    /// The number of answers of members that were behind the token when they received the request.
    behind: AtomicU64,
    refused: AtomicU64,
}

/// The oracle: views go only forward under a token. Returns the counts of the reads, or the first reply that shows
/// less.
async fn views_go_only_forward(ignores_seen: bool, reads: u64) -> Result<Arc<Tally>, String> {
    let members = Members::start(ignores_seen).await;
    let tally = Arc::new(Tally::default());
    let (mut readers, mut others) = (JoinSet::new(), JoinSet::new());
    for seed in 0..READERS as u64 {
        let (members, tally) = (Arc::clone(&members), Arc::clone(&tally));
        readers.spawn(async move { members.read(seed, &tally, reads).await });
    }
    let disturbed = Arc::clone(&members);
    others.spawn(async move { disturbed.disturb(1).await });
    let written = Arc::clone(&members);
    others.spawn(async move { written.add_states(2).await });
    let mut outcome = Ok(());
    while let Some(reader) = readers.join_next().await {
        outcome = outcome.and(reader.expect("a reader"));
        if outcome.is_err() {
            break;
        }
    }
    readers.shutdown().await;
    members.is_over.store(true, Ordering::Relaxed);
    while let Some(other) = others.join_next().await {
        other.expect("no panic");
    }
    outcome.map(|()| tally)
}

fn reads() -> u64 {
    std::env::var("TIDEMAP_TOKEN_READS").map_or(3000, |text| text.parse().expect("TIDEMAP_TOKEN_READS is a number"))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_reply_shows_less_than_its_token_while_writers_change_and_followers_lag() {
    let reads = reads();
    let tally = views_go_only_forward(false, reads).await.expect("no reply shows less");
    println!("{tally:?}");
    assert!(tally.behind.load(Ordering::Relaxed) > reads / 50, "too few reads were of what lags: {tally:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_gateway_that_ignores_tokens_is_caught() {
    let caught = views_go_only_forward(true, 3000).await.expect_err("a planted defect is caught");
    assert!(caught.contains("was seen"), "{caught}");
}
