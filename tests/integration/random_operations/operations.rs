//! The operations, applied to the daemon and to the naive model.
//!
//! Invariant: acknowledged observations are in the model. From the observations not acknowledged before a kill, the
//! model takes those that the daemon reports after the restart, which must be a whole number of batches.

use std::{collections::BTreeMap, process::Command};

use rand::{Rng as _, rngs::SmallRng, seq::IteratorRandom as _};
use tempfile::TempDir;
use tidemap_client::{
    maps::NewMap,
    queries::{ModelKind, ModelSelector},
};
use tidemap_tests::{
    binaries,
    daemon::{Daemon, Launch},
    oracle::{run_update, settled},
    rounds,
    stream::{RawStream, columns, hello},
};

use super::naive::{NaiveMap, Sent, check_components};

const MAPS: [&str; 3] = ["office", "lab", "attic"];
const PRODUCERS: [&str; 3] = ["camera", "scitos", "tiago"];
const STATES: [&str; 5] = ["door", "gate", "Küche 2", "window", "lift"];
/// 2021-03-01T00:00:00Z.
const START_NANOS: i64 = 1_614_556_800_000_000_000;
const MINUTE_NANOS: i64 = 60_000_000_000;
/// Ten days of minutes.
const MINUTES: i64 = 10 * 24 * 60;

/// The daemon and the model of it.
pub(crate) struct World {
    random: SmallRng,
    launch: Launch,
    daemon: Option<Daemon>,
    maps: BTreeMap<&'static str, NaiveMap>,
    done: BTreeMap<&'static str, u32>,
    data: TempDir,
}

impl World {
    pub(crate) async fn new(seed: u64) -> Self {
        let data = tempfile::tempdir().expect("a folder");
        let launch = Launch::on(data.path()).setting("segment_bytes", 1 << 16).setting("max_batch_observations", 64);
        let daemon = Some(launch.start());
        let random = rounds::draws(seed);
        let mut world = Self { random, launch, daemon, maps: BTreeMap::new(), done: BTreeMap::new(), data };
        world.create().await;
        world
    }

    fn daemon(&self) -> &Daemon {
        self.daemon.as_ref().expect("the daemon runs")
    }

    fn count(&mut self, what: &'static str) {
        *self.done.entry(what).or_default() += 1;
    }

    pub(crate) fn summary(&self) -> String {
        let counts: Vec<String> = self.done.iter().map(|(what, count)| format!("{count} {what}")).collect();
        counts.join(", ")
    }

    pub(crate) async fn operation(&mut self, number: u32) {
        match self.random.random_range(0..100) {
            0..55 => self.observe().await,
            55..68 => self.update().await,
            68..82 => self.predict().await,
            82..87 => self.create().await,
            87..89 => self.delete().await,
            89..92 => self.stop().await,
            92..95 => self.kill().await,
            _ => self.kill_while_observing().await,
        }
        for (name, map) in &self.maps {
            self.verify_counts(&format!("operation {number}"), name, map).await;
        }
    }

    fn any_map(&mut self) -> Option<&'static str> {
        self.maps.keys().copied().choose(&mut self.random)
    }

    async fn create(&mut self) {
        let Some(name) = MAPS.into_iter().filter(|name| !self.maps.contains_key(name)).choose(&mut self.random) else {
            return;
        };
        let (zone, offset_hours) = if self.random.random() { ("UTC", 0) } else { ("Asia/Tokyo", 9) };
        let map = NewMap { name: name.to_owned(), time_zone: Some(zone.to_owned()), ..NewMap::default() };
        self.daemon().client().create_map(map).await.expect("a new map");
        self.maps.insert(name, NaiveMap::new(offset_hours));
        self.count("maps created");
    }

    async fn delete(&mut self) {
        if self.maps.len() < 2 {
            return;
        }
        let Some(name) = self.any_map() else { return };
        self.daemon().client().delete_map(name).await.expect("the map is there");
        self.maps.remove(name);
        self.count("maps deleted");
    }

    /// Observations at any times, some of them invalid.
    fn draw(&mut self) -> Vec<Sent> {
        let count = self.random.random_range(1..=64);
        let around = self.random.random_range(0..MINUTES);
        let observation = |random: &mut SmallRng| {
            let minute = (around + random.random_range(-200..200)).clamp(0, MINUTES);
            let value = match random.random_range(0..20) {
                0 => 1.25,
                1 => f64::NAN,
                2..5 => random.random(),
                _ => f64::from(u8::from(minute / 720 % 2 == 0)),
            };
            let state = STATES.into_iter().choose(random).expect("there are states").to_owned();
            Sent { state, nanos: START_NANOS + minute * MINUTE_NANOS, value }
        };
        (0..count).map(|_| observation(&mut self.random)).collect()
    }

    /// Opens a producer's stream, and checks its durable sequence number.
    async fn stream(&mut self) -> Option<(&'static str, &'static str, RawStream, u64)> {
        let name = self.any_map()?;
        let producer = PRODUCERS.into_iter().choose(&mut self.random).expect("there are producers");
        let (stream, welcome) = RawStream::open(&self.daemon().grpc, hello(producer, name)).await.expect("a Welcome");
        let known = self.maps[name].producers.get(producer).map_or(0, Vec::len) as u64;
        assert_eq!(welcome.durable_sequence, known, "{producer} at {name}");
        Some((name, producer, stream, known))
    }

    async fn observe(&mut self) {
        let Some((name, producer, mut stream, known)) = self.stream().await else { return };
        // Some known ones are sent again, as after a broken connection.
        let again = if self.random.random_ratio(1, 3) { self.random.random_range(0..=known.min(20)) } else { 0 };
        let map = self.maps.get_mut(name).expect("the map was drawn");
        let before = map.producers.get(producer).map_or(&[][..], Vec::as_slice);
        let mut sent = before[before.len() - usize::try_from(again).expect("a few")..].to_vec();
        let new = self.draw();
        sent.extend(new.iter().cloned());
        sent.truncate(64);
        let new = &new[..sent.len() - usize::try_from(again).expect("a few")];
        send(&mut stream, known + 1 - again, &sent).await;
        let refused = stream.acknowledged(known + new.len() as u64).await.expect("the stream goes on");
        let wrong = (known + 1..).zip(new).filter(|(_, sent)| !(0.0..=1.0).contains(&sent.value));
        let wrong: Vec<u64> = wrong.map(|(sequence, _)| sequence).collect();
        assert_eq!(refused.iter().map(|refusal| refusal.sequence).collect::<Vec<_>>(), wrong);
        stream.close();
        stream.end().await;
        let map = self.maps.get_mut(name).expect("the map was drawn");
        new.iter().for_each(|sent| map.take(producer, sent));
        self.count("batches observed");
    }

    async fn kill_while_observing(&mut self) {
        let Some((name, producer, mut stream, known)) = self.stream().await else { return };
        let batches: Vec<Vec<Sent>> = (0..3).map(|_| self.draw()).collect();
        let mut first = known + 1;
        for batch in &batches {
            send(&mut stream, first, batch).await;
            first += batch.len() as u64;
        }
        tokio::time::sleep(std::time::Duration::from_micros(self.random.random_range(0..6_000))).await;
        self.daemon.take().expect("the daemon runs").kill();
        let mut acknowledged = known;
        while let Ok(message) = stream.reply().await {
            if let tidemap_proto::v1::observe_response::Message::Ack(ack) = message {
                acknowledged = ack.durable_sequence;
            }
        }
        self.daemon = Some(self.launch.start());
        settled(&self.daemon().client()).await;
        let (_, welcome) = RawStream::open(&self.daemon().grpc, hello(producer, name)).await.expect("a Welcome");
        assert!(welcome.durable_sequence >= acknowledged, "LOST: {acknowledged}, {welcome:?}");
        let map = self.maps.get_mut(name).expect("the map was drawn");
        let mut durable = known;
        for batch in batches {
            if durable == welcome.durable_sequence {
                break;
            }
            durable += batch.len() as u64;
            batch.iter().for_each(|sent| map.take(producer, sent));
        }
        assert_eq!(durable, welcome.durable_sequence, "a batch is whole or absent");
        self.verify_all("after a kill under way").await;
        self.count("kills under way");
    }

    async fn update(&mut self) {
        let Some(name) = self.any_map() else { return };
        let until = self.random.random_ratio(1, 3).then(|| {
            // Between two minutes, and never in the future.
            START_NANOS + self.random.random_range(0..=MINUTES) * MINUTE_NANOS + MINUTE_NANOS / 2
        });
        run_update(&self.daemon().client(), name, until).await;
        self.maps.get_mut(name).expect("the map was drawn").update(until);
        self.verify(name).await;
        self.count("updates");
    }

    async fn predict(&mut self) {
        let Some(name) = self.any_map() else { return };
        self.verify(name).await;
        self.count("maps asked");
    }

    async fn stop(&mut self) {
        let mut published = Vec::new();
        for &name in self.maps.keys() {
            published.push((name, self.published(name).await));
        }
        self.daemon.take().expect("the daemon runs").stop_in_order();
        for (name, states) in published {
            self.verify_index(name, &states);
        }
        self.daemon = Some(self.launch.start());
        self.verify_all("after a stop").await;
        self.count("stops");
    }

    /// The learned states of a map: name, mean and number of learned observations, as the index prints them.
    async fn published(&self, name: &str) -> Vec<[String; 3]> {
        let client = self.daemon().client();
        let mut published = Vec::new();
        for state in STATES {
            // A state that was never observed is not there.
            if let Ok(model) = client.describe_model(name, state).await
                && model.learned_observations > 0
            {
                let mean = format!("{:.4}", model.mean);
                published.push([state.to_owned(), mean, model.learned_observations.to_string()]);
            }
        }
        published
    }

    /// The index of a stopped daemon publishes the predictions of the daemon.
    fn verify_index(&self, name: &str, states: &[[String; 3]]) {
        let printed = Command::new(binaries::tidemapd()).arg("index").arg(self.data.path()).arg(name).output();
        let printed = String::from_utf8(printed.expect("runs").stdout).expect("text");
        for [state, mean, learned] in states {
            let row = printed.lines().find_map(|line| line.strip_prefix(state.as_str())?.strip_prefix("  "));
            let row: Vec<&str> = row.unwrap_or_else(|| panic!("{state} is not in {printed}")).split("  ").collect();
            assert_eq!((row[1], row[5]), (mean.as_str(), learned.as_str()), "{name}, {state}: {printed}");
        }
    }

    async fn kill(&mut self) {
        self.daemon.take().expect("the daemon runs").kill();
        self.daemon = Some(self.launch.start());
        settled(&self.daemon().client()).await;
        self.verify_all("after a kill").await;
        self.count("kills");
    }

    pub(crate) async fn verify_all(&mut self, when: &str) {
        let names: Vec<&'static str> = self.maps.keys().copied().collect();
        let found: Vec<String> =
            self.daemon().client().maps().await.expect("maps").into_iter().map(|map| map.name).collect();
        let mut sorted = names.clone();
        sorted.sort_unstable();
        assert_eq!(found, sorted, "{when}");
        for name in names {
            self.verify_counts(when, name, &self.maps[name]).await;
            self.verify(name).await;
        }
    }

    async fn verify_counts(&self, when: &str, name: &str, map: &NaiveMap) {
        let client = self.daemon().client();
        let found = client.map(name).await.expect("the map is there");
        let expected = (map.states.len() as u64, map.observations.len() as u64, map.pending(), map.generation);
        let counts = (found.states, found.observations, found.pending_observations, found.last_update.generation);
        assert_eq!(counts, expected, "{when}: states, observations, pending and generation of {name}");
        let cut = (map.generation > 0).then_some(map.cut_nanos);
        assert_eq!(found.last_update.cut_nanos, cut, "{when}: the cut of {name}");
        let (states, _) = client.states(name, "").await.expect("the map is there");
        let found: Vec<(String, u64)> = states.into_iter().map(|state| (state.name, state.observations)).collect();
        let expected = map.states.iter().enumerate().map(|(i, state)| (state.clone(), map.count(i)));
        assert_eq!(found, expected.collect::<Vec<_>>(), "{when}: the states of {name}");
    }

    /// Models and predictions of all states of a map.
    async fn verify(&mut self, name: &str) {
        let times: Vec<i64> =
            (0..4).map(|_| START_NANOS + self.random.random_range(0..3 * MINUTES) * 7_000_000_001).collect();
        let map = &self.maps[name];
        let client = self.daemon().client();
        for (id, state) in map.states.iter().enumerate() {
            let what = format!("{state:?} of {name}");
            let model = client.describe_model(name, state).await.expect("the state is there");
            let folded = map.folded(id);
            assert_eq!(
                (model.observations, model.learned_observations),
                (map.count(id), folded.len() as u64),
                "{what}"
            );
            near(&what, model.mean, map.mean(id));
            near(&what, model.persistence_tau_secs / 3_600.0, map.tau_secs(id) / 3_600.0);
            assert_eq!(model.last_nanos.zip(model.last_value), map.latest(id), "{what}");
            assert_eq!(model.first_nanos, folded.iter().map(|o| o.nanos).min(), "{what}");
            let shown = model.components.iter().map(|c| (NaiveMap::harmonic(c.period_secs), c.amplitude, c.phase_rad));
            let components = check_components(&what, &shown.collect::<Vec<_>>(), &map.coefficients(id));
            let lowest = model.order_errors.iter().copied().fold(f64::INFINITY, f64::min);
            let best = model.order_errors.iter().position(|&error| error <= lowest * 1.001).expect("there are orders");
            // Fewer if noise would give equally strong components.
            assert!(model.order as usize <= best, "{what}: {} {:?}", model.order, model.order_errors);

            let latest = map.latest(id).map_or(0.5, |(_, value)| value);
            for (kind, order) in [
                (ModelKind::Latest, None),
                (ModelKind::Mean, None),
                (ModelKind::Spectral, Some(3)),
                (ModelKind::Spectral, Some(15)),
                (ModelKind::Ensemble, None),
            ] {
                // Models with similar errors predict together; the naive map has the spectral model only.
                let is_alone = model.model_errors.iter().all(|(other, error)| {
                    other.kind == ModelKind::Spectral || *error > 2.0 * lowest_error(&model.model_errors)
                });
                if kind == ModelKind::Ensemble && !(model.chosen.kind == ModelKind::Spectral && is_alone) {
                    continue;
                }
                let selector = ModelSelector { kind, order, ..ModelSelector::default() };
                let mut runs = client.predict(name, vec![state.clone()], times.clone(), selector);
                let run = runs.next().await.expect("the state is there").expect("predictions");
                // After enough days an ensemble predicts.
                if kind == ModelKind::Ensemble && run.answered_by.is_some_and(|by| by.kind != ModelKind::Spectral) {
                    continue;
                }
                let order = order.unwrap_or(model.order as usize);
                for (&nanos, &found) in times.iter().zip(&run.probabilities) {
                    let used = &components[..order.min(components.len())];
                    let expected = match kind {
                        ModelKind::Latest => latest,
                        ModelKind::Mean => map.mean(id),
                        ModelKind::Spectral | ModelKind::Ensemble => map.predicted(id, used, nanos),
                        other => panic!("{other:?} is not asked for here"),
                    };
                    near(&format!("{selector} of {what} at {nanos}"), found, expected);
                }
            }
        }
    }
}

fn lowest_error(errors: &[(ModelSelector, f64)]) -> f64 {
    errors.iter().map(|(_, error)| *error).fold(f64::INFINITY, f64::min)
}

#[track_caller]
fn near(what: &str, found: f64, expected: f64) {
    assert!((found - expected).abs() <= 1e-7 * expected.abs().max(1.0), "{what}: {found}, expected {expected}");
}

async fn send(stream: &mut RawStream, first: u64, sent: &[Sent]) {
    let mut names: Vec<&str> = Vec::new();
    // Every batch has its own names: the stream's table then holds a name several times, which is allowed.
    let offset = stream.names_sent();
    let mut rows = Vec::new();
    for observation in sent {
        let index = names.iter().position(|name| *name == observation.state).unwrap_or_else(|| {
            names.push(&observation.state);
            names.len() - 1
        });
        rows.push((offset + u32::try_from(index).expect("a few names"), observation.nanos, observation.value));
    }
    stream.batch(first, columns(&names, &rows)).await;
}
