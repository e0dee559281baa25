//! Daemons that depose one another all the time, because their leases are worth nothing: the fence alone decides.

use super::*;

/// Duration of the contest.
const CONTEST: Duration = Duration::from_secs(40);

impl World {
    /// A producer that sends until the time is over.
    async fn produce_until(&self, producer: usize, seed: u64, end: Instant) {
        let mut random = SmallRng::seed_from_u64(seed);
        while Instant::now() < end {
            self.produce_by(&mut random, producer).await;
            sleep(Duration::from_millis(random.random_range(20..400))).await;
        }
    }
}

async fn contest(seed: u64, defects: PlantedDefects) -> Result<String, String> {
    let faults = EngineFaults { chances: Vec::new(), ..EngineFaults::survivable() };
    let mut world = World::of(seed, faults, DAEMONS);
    // A writer does not notice that another one writes: only leases prevent it from welcoming producers then.
    world.welcomes_late = true;
    world.engine.plant(PlantedDefects { useless_leases: true, ..defects });
    let client = world.engine.client("operator");
    client.create_stream("tm", 3).await.map_err(|error| error.to_string())?;
    client.create_buckets(3).await.map_err(|error| error.to_string())?;
    for index in 0..DAEMONS {
        world.start(index);
    }
    let end = Instant::now() + CONTEST;
    let producer = |producer| world.produce_until(producer, seed * 10 + producer as u64, end);
    tokio::join!(producer(0), producer(1), producer(2));
    world.engine.plant(PlantedDefects::default());
    world.settle().await?;
    let outcome = check(&world, Mode::Survivable);
    for machine in &mut world.machines {
        if let Some(mut daemon) = machine.daemon.take() {
            daemon.tasks.shutdown().await;
        }
    }
    outcome
}

fn simulate_contest(seed: u64, defects: PlantedDefects) -> Result<String, String> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build().expect("made");
    runtime.block_on(contest(seed, defects))
}

#[test]
fn nothing_is_lost_without_leases() {
    for seed in seeds(2500).into_iter().step_by(100) {
        let outcome = simulate_contest(seed, PlantedDefects::default());
        println!("seed {seed}: {}", outcome.unwrap_or_else(|error| panic!("seed {seed}: {error}")));
    }
}

/// Behaves like nats-server 2.9.10 where an append names the last message of its subject instead of the stream's.
#[test]
fn a_fence_that_lets_two_messages_in_at_one_position_is_caught() {
    let defects = PlantedDefects { two_at_one_position: true, ..PlantedDefects::default() };
    let caught = (1..=50).find_map(|seed| simulate_contest(seed, defects).err().map(|error| (seed, error)));
    let (seed, error) = caught.expect("a planted defect is caught");
    println!("caught by seed {seed}: {error}");
}
