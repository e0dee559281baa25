//! Three daemons on a simulated engine, clock and disk, with faults by seed.
//!
//! These must hold: acknowledged records are in the log, no sequence number of a producer occurs twice, an epoch has
//! one writer, and the logs are equal. `TIDEMAP_CLUSTER_SEEDS` is the number of seeds, `TIDEMAP_CLUSTER_SEED` tries one
//! seed and prints more.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex},
    time::Duration,
};

use bytes::Bytes;
use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};
use tidemap_map::event::Event;
use tidemap_store::{
    Fork,
    simulation::{Fault, SimulatedDisk},
};
use tokio::{
    sync::oneshot,
    time::{Instant, sleep, timeout},
};

use super::{Planted, ReplicaRole, Shortening, shorten};
use crate::{
    engine::Engine as _,
    message::GroupPart,
    simulated::{EngineFaults, PlantedDefects, Simulation},
};

mod contest;
mod daemon;
mod durability;

use daemon::{Ask, Daemon};

const UID: u64 = 0x7EA_2026;
const DAEMONS: usize = 3;
const PRODUCERS: usize = 3;
/// Seeds of the short form. `make durability` tries thousands.
const SEEDS: u64 = 200;

/// The events that daemons and producers have seen.
#[derive(Default)]
struct Seen {
    /// By epoch: its writer.
    writers: BTreeMap<u64, String>,
    /// By producer: the highest number that was acknowledged.
    acknowledged: BTreeMap<String, u64>,
    violations: Vec<String>,
    /// By epoch: the position at which it begins.
    begins: BTreeMap<u64, u64>,
}

impl Seen {
    fn writes(&mut self, name: &str, epoch: u64, position: u64) {
        let other = self.writers.entry(epoch).or_insert_with(|| name.to_owned());
        if other != name {
            self.violations.push(format!("{other} and {name} both wrote in epoch {epoch}"));
        }
        self.begins.insert(epoch, position);
    }

    fn acknowledged(&mut self, producer: &str, sequence: u64, epoch: u64, position: u64) {
        let known = self.acknowledged.entry(producer.to_owned()).or_default();
        *known = sequence.max(*known);
        if let Some((newer, begin)) = self.begins.range(epoch + 1..).find(|&(_, &begin)| begin < position) {
            let text =
                format!("position {position} was acknowledged in epoch {epoch}, and epoch {newer} began at {begin}");
            self.violations.push(text);
        }
    }
}

/// A machine: its disk, and its daemon while it runs.
struct Machine {
    name: String,
    disk: SimulatedDisk,
    daemon: Option<Daemon>,
    forked: Option<oneshot::Receiver<u64>>,
    forks: Vec<Fork>,
    /// Logs that were replaced by copies and that had records which the copies did not have.
    replaced: usize,
    /// Time of the next start of the daemon.
    starts: Option<Instant>,
}

/// The mode of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    /// Faults that a quorum survives: nothing may be lost and nothing may fork.
    Survivable,
    /// The engine may forget and fork: an acknowledged record is in the log, or in a fork that is reported.
    Forgetful,
}

struct World {
    engine: Simulation,
    machines: Vec<Machine>,
    seen: Arc<Mutex<Seen>>,
    random: SmallRng,
    planted: Planted,
    /// Whether a writer may welcome producers while another daemon writes and it has not noticed this yet: leases
    /// prevent that.
    welcomes_late: bool,
}

impl World {
    fn new(seed: u64, mode: Mode) -> World {
        let faults = match mode {
            Mode::Survivable => EngineFaults::survivable(),
            Mode::Forgetful => EngineFaults::all(),
        };
        World::of(seed, faults, DAEMONS)
    }

    fn of(seed: u64, faults: EngineFaults, daemons: usize) -> World {
        let machine = |index: usize| Machine {
            name: format!("daemon-{index}"),
            disk: daemon::new_disk(seed * 10 + index as u64),
            daemon: None,
            forked: None,
            forks: Vec::new(),
            replaced: 0,
            starts: None,
        };
        World {
            engine: Simulation::new(seed, faults),
            machines: (0..daemons).map(machine).collect(),
            seen: Arc::default(),
            random: SmallRng::seed_from_u64(seed),
            planted: Planted::Nothing,
            welcomes_late: false,
        }
    }

    fn start(&mut self, index: usize) {
        let machine = &mut self.machines[index];
        let (sender, forked) = oneshot::channel();
        let client = self.engine.client(&machine.name);
        let rank = index as u32;
        machine.daemon =
            Some(Daemon::start(&machine.name, rank, &machine.disk, client, &self.seen, sender, self.planted));
        machine.forked = Some(forked);
        machine.starts = None;
    }

    async fn kill(&mut self, index: usize, is_power_cut: bool) {
        let machine = &mut self.machines[index];
        if let Some(mut daemon) = machine.daemon.take() {
            daemon.tasks.shutdown().await;
        }
        machine.disk = if is_power_cut { machine.disk.power_cut() } else { machine.disk.kill() };
        let away = Duration::from_millis(self.random.random_range(0..8000));
        machine.starts = Some(Instant::now() + away);
    }

    /// Sets forks aside, and starts the daemons that are due.
    async fn repair_and_start(&mut self) {
        for index in 0..self.machines.len() {
            let machine = &mut self.machines[index];
            if machine.starts.is_some_and(|at| at <= Instant::now()) {
                self.start(index);
                continue;
            }
            let needs_copy = |daemon: &Daemon| daemon.log.status().borrow().needs_copy;
            if machine.daemon.as_ref().is_some_and(needs_copy) {
                self.copy_from_another(index).await;
                continue;
            }
            let Some(common) = machine.forked.as_mut().and_then(|forked| forked.try_recv().ok()) else { continue };
            let Some(mut daemon) = machine.daemon.take() else { continue };
            daemon.tasks.shutdown().await;
            machine.forks.extend(daemon.store.set_fork_aside(daemon.map, common).expect("nothing is deleted"));
            drop(daemon);
            machine.disk = machine.disk.kill();
            self.start(index);
        }
    }

    /// Puts a copy of another daemon's log in the place of one that the shared log has left behind.
    async fn copy_from_another(&mut self, index: usize) {
        let is_sound = |role| matches!(role, ReplicaRole::Following | ReplicaRole::Writing);
        let mut others = self.machines.iter().filter_map(|machine| machine.daemon.as_ref());
        let Some(donor) = others.find(|daemon| is_sound(daemon.log.status().borrow().role)) else { return };
        let (source, given) = (donor.store.copy_source(donor.map).expect("readable"), donor.records());
        let machine = &mut self.machines[index];
        let Some(mut daemon) = machine.daemon.take() else { return };
        daemon.tasks.shutdown().await;
        let own = daemon.records();
        machine.replaced += usize::from(!given.starts_with(&own));
        let take = || {
            let mut copy = daemon.store.begin_copy(&daemon::spec(), UID, Some(daemon.map))?;
            let total = source.total();
            source.into_iter().try_for_each(|part| copy.take(&part?))?;
            copy.check(total)?;
            copy.install()
        };
        // A full disk cannot take a copy: it is tried again.
        let _ = take();
        drop(daemon);
        machine.disk = machine.disk.kill();
        self.start(index);
    }

    /// Removes from the stream the records that two daemons have, as the writer does.
    async fn shorten(&self) {
        let daemons = self.machines.iter().filter_map(|machine| Some((machine.name.clone(), machine.daemon.as_ref()?)));
        let mut ends: Vec<u64> = daemons.clone().map(|(_, daemon)| daemon.end().position).collect();
        ends.sort_unstable();
        let is_writing = |daemon: &Daemon| daemon.log.status().borrow().role == ReplicaRole::Writing;
        let Some((name, _)) = daemons.clone().find(|(_, daemon)| is_writing(daemon)) else { return };
        let Some(&covered) = ends.iter().rev().nth(1) else { return };
        let shortening = Shortening { map: UID, stream: "tm".to_owned(), covered, keep_bytes: 0 };
        // An engine that does not reply is called again later.
        let _ = shorten(&self.engine.client(&name), &shortening).await;
    }

    async fn disturb(&mut self) {
        let index = self.random.random_range(0..DAEMONS);
        let name = self.machines[index].name.clone();
        match self.random.random_range(0..14) {
            0 | 1 => self.kill(index, false).await,
            2 => self.kill(index, true).await,
            3 => {
                // Stops the calls of the daemon, as SIGSTOP does; its tasks go on.
                self.engine.freeze(&name);
                sleep(Duration::from_millis(self.random.random_range(100..6000))).await;
                self.engine.thaw(&name);
            }
            4 => {
                self.engine.cut_off(&name);
                sleep(Duration::from_millis(self.random.random_range(100..6000))).await;
                self.engine.join(&name);
            }
            5 => {
                for index in 0..DAEMONS {
                    self.kill(index, index == 1).await;
                }
            }
            6 => {
                let disk = self.machines[index].disk.clone();
                let fault = Fault { call: disk.calls(), kind: std::io::ErrorKind::StorageFull, is_sticky: true };
                disk.set_fault(Some(fault));
                sleep(Duration::from_millis(self.random.random_range(100..15_000))).await;
                disk.set_fault(None);
            }
            7 => {
                // A stranger publishes a message that is not a record.
                let client = self.engine.client("stranger");
                if let Ok(ends) = client.ends("tm").await {
                    let content = Bytes::from_static(b"hello");
                    let _ = client.append_if("tm", ends.last, content, Duration::from_millis(500)).await;
                }
            }
            8..12 => self.shorten().await,
            _ => {
                let successor = self.random.random_bool(0.5).then(|| format!("daemon-{}", (index + 1) % DAEMONS));
                if let Some(daemon) = &self.machines[index].daemon {
                    let _ = timeout(Duration::from_secs(3), daemon.handle.hand_over(successor)).await;
                }
            }
        }
    }

    /// Whether all daemons follow or write, with equal logs.
    fn is_settled(&self) -> bool {
        let logs: Vec<_> = self.machines.iter().filter_map(|machine| machine.daemon.as_ref()).collect();
        let settled = |role| matches!(role, ReplicaRole::Following | ReplicaRole::Writing);
        logs.len() == self.machines.len()
            && logs.iter().all(|daemon| {
                let status = daemon.log.status();
                let status = status.borrow();
                settled(status.role) && status.position == status.shared_position && daemon.end() == logs[0].end()
            })
            && logs.iter().any(|daemon| daemon.log.status().borrow().role == ReplicaRole::Writing)
    }

    /// Waits until all daemons follow or write.
    async fn settle(&mut self) -> Result<(), String> {
        let begun = Instant::now();
        while !self.is_settled() {
            if begun.elapsed() > Duration::from_secs(180) {
                return Err("not settled after three minutes".to_owned());
            }
            self.repair_and_start().await;
            sleep(Duration::from_millis(100)).await;
        }
        Ok(())
    }

    /// The reply of a daemon to a producer; `None`: there was none in time, or the daemon does not write.
    async fn ask(&self, index: usize, ask: impl FnOnce(oneshot::Sender<Option<u64>>) -> Ask) -> Option<u64> {
        let daemon = self.machines[index].daemon.as_ref()?;
        let (reply, answer) = oneshot::channel();
        daemon.ask(ask(reply)).await;
        timeout(Duration::from_secs(3), answer).await.ok()?.ok()?
    }

    /// A producer sends once to some daemon.
    async fn produce(&mut self, producer: usize) {
        let mut random = self.random.clone();
        self.produce_by(&mut random, producer).await;
        self.random = random;
    }

    async fn produce_by(&self, random: &mut SmallRng, producer: usize) {
        let name = format!("robot-{producer}");
        let index = random.random_range(0..self.machines.len());
        let welcome = name.clone();
        let Some(durable) = self.ask(index, |reply| Ask::Welcome(welcome, reply)).await else { return };
        let known = self.seen.lock().expect("sound").acknowledged.get(&name).copied().unwrap_or(0);
        if durable < known && !self.welcomes_late {
            // With engines that forget, the writer of this epoch may be gone, and its records with it.
            self.seen
                .lock()
                .expect("sound")
                .violations
                .push(format!("{name}: {known} was acknowledged, {durable} is there"));
        }
        for burst in 0..random.random_range(1..4_u64) {
            let count = random.random_range(1..6);
            let first = durable + 1 + burst * 5;
            let observed = name.clone();
            if self.ask(index, |reply| Ask::Observe(observed, first, count, reply)).await
                != Some(first + u64::from(count) - 1)
                || count != 5
            {
                return;
            }
        }
    }
}

/// One run with faults; returns the log after they have ended.
async fn run(seed: u64, mode: Mode, planted: Planted, defects: PlantedDefects) -> Result<String, String> {
    let mut world = World::new(seed, mode);
    world.planted = planted;
    world.engine.plant(defects);
    let client = world.engine.client("operator");
    while client.create_stream("tm", 3).await.is_err() || client.create_buckets(3).await.is_err() {}
    for index in 0..DAEMONS {
        world.start(index);
    }
    let begun = Instant::now();
    let chaos = Duration::from_secs(25);
    let mut next_fault = begun + Duration::from_secs(3);
    while begun.elapsed() < chaos {
        world.repair_and_start().await;
        if Instant::now() >= next_fault {
            world.disturb().await;
            next_fault = Instant::now() + Duration::from_millis(world.random.random_range(300..5000));
        }
        let producer = world.random.random_range(0..PRODUCERS);
        world.produce(producer).await;
        sleep(Duration::from_millis(world.random.random_range(1..120))).await;
    }
    world.engine.set_faults(EngineFaults::none());
    world.engine.make_room("tm");
    let calm = Instant::now();
    while !world.is_settled() {
        world.repair_and_start().await;
        sleep(Duration::from_millis(100)).await;
        if calm.elapsed() > Duration::from_secs(180) {
            let states = world.machines.iter().map(|machine| {
                let status = machine.daemon.as_ref().map(|daemon| daemon.log.status().borrow().clone());
                format!("{}: {status:?}", machine.name)
            });
            let parts = world.engine.present("tm");
            let parts =
                parts.iter().filter_map(|message| Some((message.sequence, GroupPart::decode(&message.content).ok()??)));
            let parts =
                parts.map(|(at, part)| format!("{at}: epoch {}, {:?} to {:?}", part.epoch, part.before, part.after));
            return Err(format!(
                "not settled after three minutes:\n{}\n{}",
                states.collect::<Vec<_>>().join("\n"),
                parts.collect::<Vec<_>>().join("\n")
            ));
        }
    }
    let outcome = check(&world, mode);
    if outcome.is_err() && std::env::var_os("TIDEMAP_CLUSTER_SEED").is_some() {
        println!("{}", world.engine.history().join("\n"));
    }
    for machine in &mut world.machines {
        if let Some(mut daemon) = machine.daemon.take() {
            daemon.tasks.shutdown().await;
        }
    }
    outcome
}

fn check(world: &World, mode: Mode) -> Result<String, String> {
    let seen = world.seen.lock().expect("sound");
    let daemons: Vec<&Daemon> = world.machines.iter().filter_map(|machine| machine.daemon.as_ref()).collect();
    let logs: Vec<_> = daemons.iter().map(|daemon| daemon.records()).collect();
    if logs.iter().any(|log| *log != logs[0]) {
        return Err("the logs differ".to_owned());
    }
    // In the log, the numbers of each producer are consecutive.
    let (mut ends, mut names, mut epoch) = (BTreeMap::new(), BTreeMap::new(), 0);
    for (position, event) in &logs[0] {
        match event {
            Event::Epoch(record) => {
                if record.epoch <= epoch {
                    return Err(format!("position {position}: epoch {} after {epoch}", record.epoch));
                }
                if seen.writers.get(&record.epoch).is_some_and(|writer| *writer != record.writer) {
                    return Err(format!("epoch {} is {}'s, and another wrote in it", record.epoch, record.writer));
                }
                epoch = record.epoch;
            }
            event => {
                let envelope = event.envelope().expect("of a producer");
                if let Some(new) = &envelope.new_producer {
                    names.insert(envelope.producer, new.key.producer().to_owned());
                }
                let end = ends.entry(envelope.producer).or_insert(0);
                if envelope.span.first != *end + 1 {
                    return Err(format!("position {position}: {} after {end}", envelope.span.first));
                }
                *end = envelope.span.last;
            }
        }
    }
    let there: BTreeMap<&str, u64> = names.iter().map(|(id, name)| (name.as_str(), ends[id])).collect();
    let forks: Vec<&Fork> = world.machines.iter().flat_map(|machine| &machine.forks).collect();
    let named = forks.iter().filter(|fork| fork.groups > 1).count();
    if mode == Mode::Survivable {
        for (producer, acknowledged) in &seen.acknowledged {
            if there.get(producer.as_str()).copied().unwrap_or(0) < *acknowledged {
                return Err(format!("{producer}: {acknowledged} was acknowledged, {there:?} is there"));
            }
        }
        if named > 0 {
            return Err(format!("forks: {forks:?}"));
        }
        if let Some(violation) = seen.violations.first() {
            return Err(violation.clone());
        }
    } else if forks.is_empty() && world.machines.iter().all(|machine| machine.replaced == 0) {
        for (producer, acknowledged) in &seen.acknowledged {
            if there.get(producer.as_str()).copied().unwrap_or(0) < *acknowledged {
                return Err(format!(
                    "{producer}: {acknowledged} was acknowledged, {there:?} is there, and nothing forked"
                ));
            }
        }
    }
    let first = world.engine.present("tm").first().map_or(0, |message| message.sequence);
    Ok(format!(
        "{} records, {epoch} epochs, {} acknowledged, {} forks, {} replaced, the stream begins at {first}",
        logs[0].len(),
        seen.acknowledged.values().sum::<u64>(),
        forks.len(),
        world.machines.iter().map(|machine| machine.replaced).sum::<usize>(),
    ))
}

fn simulate(seed: u64, mode: Mode, planted: Planted, defects: PlantedDefects) -> Result<String, String> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build().expect("made");
    runtime.block_on(run(seed, mode, planted, defects))
}

/// The seeds to try.
fn seeds(default: u64) -> Vec<u64> {
    let number = |name| std::env::var(name).ok().and_then(|text: String| text.parse().ok());
    match number("TIDEMAP_CLUSTER_SEED") {
        Some(seed) => vec![seed],
        None => (1..=number("TIDEMAP_CLUSTER_SEEDS").unwrap_or(default)).collect(),
    }
}

fn try_seeds(mode: Mode, default: u64) {
    let seeds = seeds(default);
    let mut failed = Vec::new();
    for &seed in &seeds {
        let outcome = simulate(seed, mode, Planted::Nothing, PlantedDefects::default());
        if seeds.len() == 1 {
            println!("{outcome:?}");
        }
        if let Err(error) = outcome {
            failed.push(format!("seed {seed}: {error}"));
        }
    }
    assert!(failed.is_empty(), "{} of {} seeds:\n{}", failed.len(), seeds.len(), failed.join("\n"));
}

#[test]
fn nothing_that_was_acknowledged_is_lost_by_faults_that_a_quorum_survives() {
    try_seeds(Mode::Survivable, SEEDS);
}

#[test]
fn what_the_engine_forgets_is_appended_again_or_set_aside() {
    try_seeds(Mode::Forgetful, SEEDS);
}

/// Tries seeds until one shows a defect.
#[track_caller]
fn catch(mode: Mode, planted: Planted, defects: PlantedDefects) {
    let caught = (1..=200).find_map(|seed| {
        let run = std::panic::catch_unwind(|| simulate(seed, mode, planted, defects));
        // A log that no longer fits its map stops the thread of the map.
        match run {
            Ok(Ok(_)) => None,
            Ok(Err(error)) => Some(format!("seed {seed}: {error}")),
            Err(_) => Some(format!("seed {seed}: a panic")),
        }
    });
    println!("{planted:?} {defects:?} is caught by {}", caught.expect("a planted defect is caught"));
}

#[test]
fn a_missing_fence_is_caught() {
    let defects = PlantedDefects { ignore_expected: true, ..PlantedDefects::default() };
    catch(Mode::Survivable, Planted::Nothing, defects);
}

#[test]
fn an_end_of_the_log_that_is_read_from_a_server_that_lags_is_caught() {
    let defects = PlantedDefects { stale_reads: true, ..PlantedDefects::default() };
    catch(Mode::Survivable, Planted::Nothing, defects);
}

#[test]
fn an_acknowledgement_before_the_own_disk_is_caught() {
    catch(Mode::Forgetful, Planted::AckBeforeSync, PlantedDefects::default());
}

#[test]
fn a_missing_record_of_the_epoch_is_caught() {
    catch(Mode::Survivable, Planted::NoEpoch, PlantedDefects::default());
}
