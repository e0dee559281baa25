//! Each operation of a daemon's disk is once the last one before a kill or a power cut. Afterwards all acknowledged
//! records of the shared log are there, in order, once.
//!
//! `TIDEMAP_SIMULATED_SEEDS` is the number of hundreds of seeds, from `TIDEMAP_SEED` on; `make durability` and `make
//! soak` set them.

use tidemap_store::{LogPoint, RecordGroup};

use super::*;
use crate::message::Assembly;

const STEPS: usize = 24;

/// The daemon whose disk fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Scene {
    /// The disk of the only daemon fails, while the engine forgets its last messages: this disk alone has all records.
    Alone,
    /// The disk of the writer fails, and another daemon takes its place.
    Writer,
    /// The disk of a daemon that follows fails.
    Follower,
}

impl Scene {
    fn daemons(self) -> usize {
        if self == Scene::Alone { 1 } else { 2 }
    }

    /// The daemon whose disk fails: the first one writes.
    fn failing(self) -> usize {
        usize::from(self == Scene::Follower)
    }
}

impl World {
    /// Requests an update from all daemons, one of which may write.
    async fn update(&self) {
        for index in 0..self.machines.len() {
            if self.ask(index, Ask::Update).await.is_some() {
                return;
            }
        }
    }

    async fn work(&mut self, steps: usize, is_over: impl Fn() -> bool) {
        for step in 0..steps {
            if is_over() {
                return;
            }
            if step % 2 == 1 {
                self.update().await;
            }
            self.produce(step % PRODUCERS).await;
            sleep(Duration::from_millis(self.random.random_range(1..60))).await;
        }
    }

    /// The machine of a daemon ends. Its recovery ends too, once, at some operation of the disk.
    async fn end(&mut self, index: usize, scene: Scene) -> Result<(), String> {
        if let Some(mut daemon) = self.machines[index].daemon.take() {
            daemon.tasks.shutdown().await;
        }
        if scene == Scene::Alone {
            self.engine.forget("tm", self.random.random_range(0..4));
        }
        let ended = |disk: &SimulatedDisk, is_power_cut| if is_power_cut { disk.power_cut() } else { disk.kill() };
        let mut disk = ended(&self.machines[index].disk, self.random.random_bool(0.7));
        let call = disk.calls() + self.random.random_range(0..8);
        disk.set_fault(Some(Fault { call, kind: std::io::ErrorKind::Other, is_sticky: true }));
        drop(daemon::open_disk(&disk));
        disk = ended(&disk, self.random.random());
        drop(daemon::open_disk(&disk)?);
        self.machines[index].disk = disk;
        Ok(())
    }
}

/// The groups of the shared log, and where it ends.
fn shared_log(world: &World) -> Result<(Vec<RecordGroup>, LogPoint), String> {
    let (mut assembly, mut groups, mut end) = (Assembly::default(), Vec::new(), LogPoint::BEGINNING);
    for message in world.engine.present("tm") {
        let Some(part) = GroupPart::decode(&message.content)? else { continue };
        // A group that does not follow is part of no log.
        if let Some(group) = assembly.push(part).filter(|group| group.before == end) {
            end = group.after;
            groups.push(group);
        }
    }
    Ok((groups, end))
}

/// Checks that acknowledged records are in the shared log. Returns its end, and the producers' numbers in it.
fn check_shared(world: &World) -> Result<(LogPoint, BTreeMap<String, u64>), String> {
    let (groups, end) = shared_log(world)?;
    let mut marks: BTreeMap<String, u64> = BTreeMap::new();
    let mut names = BTreeMap::new();
    for (position, event) in groups.iter().flat_map(|group| group.events().unwrap_or_default()) {
        let Some(envelope) = event.envelope() else { continue };
        if let Some(new) = &envelope.new_producer {
            names.insert(envelope.producer, new.key.producer().to_owned());
        }
        let mark = marks.entry(names[&envelope.producer].clone()).or_default();
        if envelope.span.first != *mark + 1 {
            return Err(format!("position {position}: {} after {mark}", envelope.span.first));
        }
        *mark = envelope.span.last;
    }
    let seen = world.seen.lock().expect("sound");
    if let Some(violation) = seen.violations.first() {
        return Err(violation.clone());
    }
    for (producer, acknowledged) in &seen.acknowledged {
        if marks.get(producer).is_none_or(|mark| mark < acknowledged) {
            return Err(format!("{producer}: {acknowledged} was acknowledged, {marks:?} is there"));
        }
    }
    Ok((end, marks))
}

/// Checks that each disk has the shared log and the map that results from it. Returns how much was tried.
async fn check_disks(world: &mut World) -> Result<Tried, String> {
    let (end, marks) = check_shared(world)?;
    let acknowledged = world.seen.lock().expect("sound").acknowledged.values().sum();
    let mut tried = Tried { acknowledged, ..Tried::default() };
    for machine in &mut world.machines {
        let mut daemon = machine.daemon.take().ok_or("a daemon does not run")?;
        let own = daemon.end();
        daemon.tasks.shutdown().await;
        if own != end {
            return Err(format!("{} has {own:?}, the shared log {end:?}", machine.name));
        }
        let opened = daemon::open_disk(&machine.disk.power_cut())?;
        let found: BTreeMap<String, u64> = opened
            .map
            .producer_marks()
            .iter()
            .map(|mark| (mark.key.producer().to_owned(), mark.durable_sequence))
            .collect();
        if (opened.map.position(), &found) != (end.position, &marks) {
            return Err(format!("{}: {found:?} at {}, not {marks:?}", machine.name, opened.map.position()));
        }
        tried.updates += opened.generation;
        tried.shortened += usize::from(opened.is_shortened());
    }
    Ok(tried)
}

/// The amount of work of a trial.
#[derive(Clone, Copy, Debug, Default)]
struct Tried {
    /// Number of disk operations up to the fault.
    calls: usize,
    acknowledged: u64,
    updates: u64,
    /// Number of logs whose beginning was deleted, because checkpoints cover it.
    shortened: usize,
}

/// One run, whose disk fails from the operation `cut` on; `None`: it does not fail.
async fn trial(seed: u64, scene: Scene, cut: Option<usize>, planted: Planted) -> Result<Tried, String> {
    let mut world = World::of(seed, EngineFaults::none(), scene.daemons());
    world.planted = planted;
    let client = world.engine.client("operator");
    client.create_stream("tm", 3).await.map_err(|error| error.to_string())?;
    client.create_buckets(3).await.map_err(|error| error.to_string())?;
    for index in 0..scene.daemons() {
        world.start(index);
    }
    world.settle().await?;
    let failing = scene.failing();
    let disk = world.machines[failing].disk.clone();
    let begin = disk.calls();
    if let Some(cut) = cut {
        let fault = Fault { call: begin + cut, kind: std::io::ErrorKind::Other, is_sticky: true };
        disk.set_fault(Some(fault));
    }
    let has_failed = || cut.is_some_and(|cut| disk.calls() > begin + cut);
    world.work(STEPS, has_failed).await;
    let calls = disk.calls() - begin;
    // With a disk that fails, no record is acknowledged that needs the disk.
    world.work(2, || false).await;
    world.end(failing, scene).await?;
    world.start(failing);
    world.work(3, || false).await;
    world.settle().await?;
    Ok(Tried { calls, ..check_disks(&mut world).await? })
}

fn simulate_trial(seed: u64, scene: Scene, cut: Option<usize>, planted: Planted) -> Result<Tried, String> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build().expect("made");
    runtime
        .block_on(trial(seed, scene, cut, planted))
        .map_err(|error| format!("seed {seed}, {scene:?}, operation {cut:?}: {error}"))
}

/// All operations of a scene, or some of them.
fn try_all(scene: Scene) {
    let number = |name| std::env::var(name).ok().and_then(|text: String| text.parse::<u64>().ok());
    let first = number("TIDEMAP_SEED").unwrap_or(1);
    // Few cuts in each ordinary run of all tests.
    let (seeds, apart) = number("TIDEMAP_SIMULATED_SEEDS").map_or((1, 3), |seeds| ((seeds / 100).max(1), 1));
    let (mut tried, mut runs, mut acknowledged) = (Tried::default(), 0, 0);
    for seed in first..first + seeds {
        let whole = simulate_trial(seed, scene, None, Planted::Nothing).unwrap_or_else(|error| panic!("{error}"));
        // Some seeds acknowledge few records; all together have to acknowledge many.
        assert!(whole.calls > 60 && whole.acknowledged > 0, "seed {seed}: too little was tried: {whole:?}");
        acknowledged += whole.acknowledged;
        for cut in (0..whole.calls).step_by(apart) {
            let one =
                simulate_trial(seed, scene, Some(cut), Planted::Nothing).unwrap_or_else(|error| panic!("{error}"));
            tried.calls += one.calls;
            tried.acknowledged += one.acknowledged;
            tried.updates += one.updates;
            tried.shortened += one.shortened;
            runs += 1;
        }
    }
    println!("{scene:?}: {runs} faults, {tried:?}");
    assert!(acknowledged > 20 * seeds, "{acknowledged} acknowledged by {seeds} seeds without a fault: too little");
    assert!(tried.shortened > runs / 10, "too few logs were shortened: {tried:?}");
}

#[test]
fn a_disk_that_holds_all_alone_may_end_at_any_operation() {
    try_all(Scene::Alone);
}

#[test]
fn the_disk_of_a_writer_may_end_at_any_operation() {
    try_all(Scene::Writer);
}

#[test]
fn the_disk_of_a_follower_may_end_at_any_operation() {
    try_all(Scene::Follower);
}

#[test]
fn a_disk_that_is_acknowledged_before_it_has_the_record_is_caught() {
    let caught = (0..200).find_map(|cut| simulate_trial(1, Scene::Alone, Some(cut), Planted::AckBeforeSync).err());
    println!("caught: {}", caught.expect("a planted defect is caught"));
}
