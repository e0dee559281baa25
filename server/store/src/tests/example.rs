//! A data directory with known content, and a check of that content.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::{Arc, LazyLock, mpsc},
};

use prost::Message;
use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};
use tidemap_layout::site::TableRow;
use tidemap_map::{
    event::{Envelope, Event, NewState, Observations, OffsetRun, SequenceSpan, StateKind, UpdateCause, UpdateStart},
    ids::{ProducerId, RefusalReason, StateId},
    name::{MapName, ProducerKey, StateName},
    site::{Location, Site, SiteEdit},
    snapshot::{ContentMark, MapSnapshot, ProducerMark, StateSnapshot},
    spec::MapSpec,
};
use tidemap_model::{
    EnabledModels, LocalDay, OrderErrors, OrderErrorsParts, Periodicities, Persistence, PersistenceParts, Recent,
    Sample, SpectralModel, StateModel, TrainedModel, UpdateRules, Zone,
    catalogue::{ModelKind, TRAINED_AT_NIGHT},
    models::Readings,
};

use crate::{AppendError, MapId, MapLog, OpenError, OpenedMap, Source, Store, StoreOptions};

pub(crate) const STORE_ID: &str = "00112233445566778899aabbccddeeff";
const HOUR_NANOS: i64 = 3_600_000_000_000;

pub(crate) fn options() -> StoreOptions {
    StoreOptions { new_store_id: STORE_ID.to_owned(), ..StoreOptions::default() }
}

pub(crate) fn spec(name: &str) -> MapSpec {
    MapSpec {
        zone: Zone::named("Europe/Prague").expect("known"),
        periodicities: Periodicities::harmonics(24 * HOUR_NANOS, 130).expect("valid"),
        created_nanos: 1_700_000_000_000_000_000,
        ..MapSpec::new(MapName::new(name).expect("valid"))
    }
}

/// An event that is a function of its position.
pub(crate) fn event(position: u64) -> Event {
    let mut random = SmallRng::seed_from_u64(position);
    if position.is_multiple_of(5) {
        let cut_nanos = position as i64 * HOUR_NANOS;
        return Event::UpdateStart(UpdateStart { generation: position / 5, cut_nanos, cause: UpdateCause::Midnight });
    }
    if position % 11 == 4 {
        return Event::EditSite(SiteEdit::SetLocation(location_name(position), location(&mut random, 3)));
    }
    let count = random.random_range(1..40);
    let is_first = position == 1;
    Event::Observations(
        Envelope {
            producer: ProducerId(0),
            new_producer: is_first.then(|| ProducerKey::new("robot", "door").expect("valid").into()),
            incarnation: 1,
            span: SequenceSpan { first: position * 100, last: position * 100 + 60, content_crc: random.random() },
            received_nanos: position as i64 * HOUR_NANOS,
            refused: vec![(position * 100 + 60, RefusalReason::Value)],
        },
        Observations {
            new_states: (0..if is_first { 3 } else { 0 })
                .map(|id| {
                    NewState::sampled(
                        StateId(id),
                        StateName::new(&format!("state {id}")).expect("valid"),
                        StateKind::Probability,
                    )
                })
                .collect(),
            states: (0..count).map(|_| StateId(random.random_range(0..3))).collect(),
            times_nanos: (0..count as i64).map(|i| position as i64 * HOUR_NANOS + i * 1_000_000_000).collect(),
            values: (0..count).map(|_| f64::from(random.random_range(0..2_u8))).collect(),
            offsets: vec![OffsetRun { count, offset_secs: 3600 }],
            failures: Vec::new(),
            runs: Vec::new(),
        },
    )
}

fn location_name(number: u64) -> StateName {
    StateName::new(&format!("room {number} {}", "x".repeat(100))).expect("valid")
}

fn location(random: &mut SmallRng, states: u32) -> Location {
    let seen = (0..states).filter(|id| *id == 0 || random.random()).map(StateId).collect();
    Location {
        states: seen,
        cells: Vec::new(),
        position_m: random.random_bool(0.5).then(|| [random.random(), -random.random::<f64>()]),
    }
}

/// A site whose number of records in the index depends on the position, down to none.
fn site(position: u64, states: usize) -> Site {
    let mut random = SmallRng::seed_from_u64(position ^ 0x517E);
    let mut site = Site::default();
    if position.is_multiple_of(4) || states == 0 {
        return site;
    }
    site.apply(&SiteEdit::Charger(Some([random.random(), 1.5])), states).expect("valid");
    for visit in 0..position % 5 * 30 {
        let at_m = [random.random_range(-9.0..9.0), random.random_range(-9.0..9.0)];
        let visit = SiteEdit::Visit { at_m, reached: random.random(), utc_nanos: visit as i64 };
        site.apply(&visit, states).expect("valid");
    }
    for number in 0..position % 7 * 20 {
        let location = location(&mut random, states as u32);
        site.apply(&SiteEdit::SetLocation(location_name(number), location), states).expect("valid");
    }
    site
}

/// A snapshot that is a function of its position.
pub(crate) fn snapshot(spec: &MapSpec, position: u64, states: usize) -> MapSnapshot {
    let mut random = SmallRng::seed_from_u64(position ^ 0xABCD);
    let site = Arc::new(site(position, states));
    let states = (0..states).map(|id| state(spec, &format!("state {id}"), &mut random)).collect();
    MapSnapshot {
        position,
        replay_from: position.saturating_sub(2).max(1),
        generation: position / 5,
        cut_nanos: position as i64 * HOUR_NANOS,
        newest_nanos: position as i64 * HOUR_NANOS + 5,
        producers: vec![ProducerMark {
            key: ProducerKey::new("robot", "door").expect("valid"),
            incarnation: 1,
            durable_sequence: position * 100,
            content_crc: random.random(),
            sensor: (position % 3 == 1)
                .then_some(tidemap_grid::sensors::ProducerSensor { hit: 0.75, false_alarm: 0.0625 }),
            received_nanos: position as i64 * 7_000_000_000 - 3,
            newest_nanos: position as i64 * 5_000_000_000,
            recent: (0..position % 4)
                .map(|i| ContentMark { sequence: position * 10 + i, crc: i as u32 * 77 })
                .collect(),
            has_scans: position % 3 == 2,
            is_forgotten: position % 4 == 1,
            introduced_by: if position % 2 == 1 { "token 1".to_owned() } else { String::new() },
        }],
        states,
        site,
        grid: None,
        history: Vec::new(),
    }
}

/// Models of every kind, two of each. Trained once, because it takes long.
static TRAINED: LazyLock<Vec<TrainedModel>> = LazyLock::new(|| {
    let trained = [2, 3].map(|every| {
        let sample = |hour: i64| Sample {
            utc_nanos: hour * HOUR_NANOS,
            offset_secs: 3600,
            value: f64::from(u8::from((8..17).contains(&(hour % 24)) && hour % every == 0)),
        };
        let samples: Vec<Sample> = (0..240).map(sample).collect();
        let (state_kind, week) = (StateKind::Probability, Periodicities::default());
        let train = |kind: ModelKind| kind.train(Readings::new(&samples), state_kind, &week).expect("readings");
        TRAINED_AT_NIGHT.into_iter().filter(|kind| kind.supports(state_kind)).map(train).collect::<Vec<_>>()
    });
    trained.into_iter().flatten().collect()
});

pub(crate) fn state(spec: &MapSpec, name: &str, random: &mut SmallRng) -> StateSnapshot {
    let mut model = StateModel::new(&spec.periodicities);
    let samples: Vec<Sample> = (0..random.random_range(0..100_i64))
        .map(|i| Sample {
            utc_nanos: i * HOUR_NANOS,
            offset_secs: 3600,
            value: f64::from(random.random_range(0..2_u8)),
        })
        .collect();
    let half_life_days = random.random_bool(0.5).then_some(3.0);
    let models = EnabledModels::ALL.with_histograms(random.random_bool(0.8));
    let rules = UpdateRules { half_life_days, models, ..spec.update_rules() };
    model.update(&spec.periodicities, rules, samples.clone());
    if !samples.is_empty() {
        let next: Vec<Sample> =
            samples.iter().map(|&sample| Sample { utc_nanos: sample.utc_nanos + 99 * HOUR_NANOS, ..sample }).collect();
        for trained in TRAINED.iter().filter(|_| random.random_bool(0.7)) {
            model = model.with_trained(trained.clone(), LocalDay(4));
        }
        // Some of them have been scored.
        model.update(&spec.periodicities, rules, if random.random_bool(0.5) { next } else { Vec::new() });
    }
    let sums = std::array::from_fn(|_| random.random_range(0.0..9.0));
    let errors = OrderErrors::from_parts(OrderErrorsParts { sums, last_day: Some(LocalDay(19_000)) }).expect("valid");
    let spectral = SpectralModel::from_parts(
        model.spectral().mean(),
        model.spectral().observations(),
        model.spectral().components().to_vec(),
    );
    let (known, belief) = (model.alternatives().cloned(), model.belief().cloned());
    let mut recent = Recent::default();
    samples.iter().for_each(|sample| recent.observe(sample.utc_nanos, sample.value));
    let model = StateModel::from_parts(model.accumulator().clone(), spectral.expect("valid"), 2, errors);
    let model = model.map(|model| match (known, belief) {
        (Some(known), Some(belief)) => model.with_alternatives(known).with_belief(belief),
        _ => model,
    });
    let persistence =
        PersistenceParts { pairs: 7, change_rate_sum: random.random(), last: Some((77, random.random())) };
    StateSnapshot {
        name: StateName::new(name).expect("valid"),
        kind: StateKind::Probability,
        observations: random.random(),
        persistence: Persistence::from_parts(persistence).expect("valid"),
        recent,
        newest_row: None,
        model: Arc::new(model.expect("valid")),
    }
}

/// Appends and waits until it is durable.
pub(crate) fn append(log: &MapLog, event: &Event) -> Result<u64, AppendError> {
    let (sender, receiver) = mpsc::channel();
    log.append(event, Box::new(move |result| sender.send(result).expect("waiting")))?;
    receiver.recv().expect("answered")
}

/// The expected map of the example.
pub(crate) struct Example {
    pub(crate) spec: MapSpec,
    pub(crate) snapshots: Vec<MapSnapshot>,
    pub(crate) end: u64,
}

/// Fills a data directory: a map, `end` records, snapshots at these positions. Closes it.
pub(crate) fn fill(directory: &Path, end: u64, snapshots_at: &[u64], segment_bytes: u64) -> Example {
    let spec = spec("office");
    let store = Store::open(directory, StoreOptions { segment_bytes, ..options() }).expect("opens");
    let map = store.create_map(&spec).expect("creates");
    assert_eq!(map, MapId(1));
    let opened = store.open_map(map, &spec).expect("opens");
    assert_eq!(opened.source, Source::Empty);
    let mut snapshots = Vec::new();
    for position in 1..=end {
        assert_eq!(append(&opened.log, &event(position)), Ok(position));
        if snapshots_at.contains(&position) {
            let snapshot = snapshot(&spec, position, 3);
            store.save(map, &snapshot).expect("saves");
            snapshots.push(snapshot);
        }
    }
    store.close();
    Example { spec, snapshots, end }
}

impl Example {
    /// Opens the directory and checks the map bit by bit. An error is a valid refusal.
    pub(crate) fn check(&self, directory: &Path) -> Result<OpenedMap, OpenError> {
        let store = Store::open(directory, options())?;
        assert_eq!(store.store_id(), STORE_ID);
        if let Some(map) = store.set_aside().pop() {
            assert_eq!(map.name.as_deref(), Some(self.spec.name.as_str()), "{map:?}");
            let file = directory.join("maps/00000001/MAP");
            return Err(OpenError::Damaged { file, reason: map.reason });
        }
        assert_eq!(store.maps(), [(MapId(1), self.spec.clone())]);
        let published = store.published(MapId(1), &self.spec);
        let is_known = |found: &MapSnapshot| self.snapshots.iter().any(|snapshot| snapshot.published() == *found);
        assert!(published.iter().all(is_known), "the index publishes what was never saved");
        let mut opened = store.open_map(MapId(1), &self.spec)?;
        let published = opened.snapshot.as_ref().map(MapSnapshot::published);
        assert_eq!(store.published(MapId(1), &self.spec), published, "the index differs from the generation");
        let from = match &opened.snapshot {
            Some(snapshot) => {
                assert!(self.snapshots.contains(snapshot), "another snapshot than any that was saved");
                snapshot.replay_from
            }
            None => 1,
        };
        let mut expected = from;
        for item in &mut opened.replay {
            let (position, found) = item?;
            assert_eq!(position, expected);
            assert_eq!(found, event(position), "record {position}");
            expected += 1;
        }
        assert_eq!(expected, self.end + 1, "records are missing");
        assert_eq!(opened.log.end(), self.end);
        Ok(opened)
    }
}

/// Copies a directory.
pub(crate) fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("writable");
    for entry in fs::read_dir(from).expect("readable") {
        let entry = entry.expect("readable");
        let target = to.join(entry.file_name());
        if entry.file_type().expect("readable").is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).expect("copied");
        }
    }
}

/// Every file below a directory with its content, and every folder.
pub(crate) fn content(directory: &Path) -> Vec<(PathBuf, Option<Vec<u8>>)> {
    let mut all = Vec::new();
    for entry in fs::read_dir(directory).expect("readable") {
        let path = entry.expect("readable").path();
        if path.is_dir() {
            all.extend(content(&path));
            all.push((path, None));
        } else {
            all.push((path.clone(), Some(fs::read(path).expect("readable"))));
        }
    }
    all.sort();
    all
}

/// The only segment of the example's log.
pub(crate) fn segment(directory: &Path) -> PathBuf {
    directory.join("maps/00000001/log/00000000000000000001.log")
}

/// The rows of a site, one of them changed.
pub(super) fn spoiled<M: Message + Default>(rows: &[TableRow], number: usize, spoil: impl Fn(&mut M)) -> Vec<TableRow> {
    let mut rows = rows.to_vec();
    let mut row = M::decode(&rows[number].row[..]).expect("a row");
    spoil(&mut row);
    rows[number].row = row.encode_to_vec();
    rows
}
