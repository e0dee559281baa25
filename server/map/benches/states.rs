//! A night of 10,000 named states that were read once a minute, on two threads.
//!
//! Run it with `cargo bench -p tidemap-map --bench states`. The update scores and learns a day of 1,440 readings of
//! each state: with no calibrated model to train, and with as many as an update trains, each on twelve weeks of
//! minutes. Each case is measured once, because a night takes seconds. The readings of earlier updates come from
//! memory; the benches of the store measure the reading of files.

use std::{
    sync::{Arc, atomic::AtomicU64},
    time::Instant,
};

use tidemap_map::{
    event::{Envelope, Event, NewState, Observations, OffsetRun, SequenceSpan, StateKind, UpdateCause},
    ids::{ProducerId, StateId},
    live_map::LiveMap,
    name::{MapName, ProducerKey, StateName},
    spec::MapSpec,
    training::{ReadingsRequest, StateReadings},
};
use tidemap_model::{Sample, catalogue::NIGHTLY_WINDOW_NANOS};

const STATES: u32 = 10_000;
const MINUTE: i64 = 60_000_000_000;
const DAY: i64 = 1440 * MINUTE;
/// Number of days, with a reading an hour, before the nights that are measured: then every state is due.
const BEFORE: i64 = 7;

/// The state is open from about nine to five on weekdays, and shut for some minutes now and then.
fn value(state: u32, minute: i64) -> f64 {
    let (day, of_day) = (minute.div_euclid(1440), minute.rem_euclid(1440));
    let seed = (u64::from(state) << 40) ^ (minute / 7).unsigned_abs().wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let shut = (seed ^ (seed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 60 == 0;
    let opens = 480 + i64::from(state % 90);
    f64::from(u8::from((day + 3).rem_euclid(7) < 5 && (opens..opens + 480).contains(&of_day) && !shut))
}

/// Twelve weeks of minutes before a night, equal for all states.
#[derive(Debug)]
struct Weeks(Vec<Sample>);

impl StateReadings for Weeks {
    fn readings(&self, wanted: &[ReadingsRequest]) -> Result<Vec<Vec<Sample>>, String> {
        Ok(vec![self.0.clone(); wanted.len()])
    }
}

fn samples(state: u32, minutes: impl Iterator<Item = i64>) -> Vec<Sample> {
    let sample = |minute| Sample { utc_nanos: minute * MINUTE, offset_secs: 0, value: value(state, minute) };
    minutes.map(sample).collect()
}

fn apply(map: &mut LiveMap, event: &Event) -> Option<tidemap_map::update::UpdateWork> {
    map.apply(map.position() + 1, event).expect("consistent")
}

/// Applies the observations of a day, at a fixed interval in minutes.
fn observe(map: &mut LiveMap, day: i64, step: i64) {
    for state in 0..STATES {
        let key = ProducerKey::new("bench", "").expect("valid");
        let known = map.producer(&key).map(|(_, mark)| mark.durable_sequence);
        let is_new = map.states() as u32 <= state;
        let samples = samples(state, (day * 1440..(day + 1) * 1440).step_by(step as usize));
        let first_sequence = known.unwrap_or(0) + 1;
        let new = NewState::sampled(
            StateId(state),
            StateName::new(&format!("state {state}")).expect("valid"),
            StateKind::Probability,
        );
        let envelope = Envelope {
            producer: ProducerId(0),
            new_producer: known.is_none().then(|| key.into()),
            incarnation: 1,
            span: SequenceSpan {
                first: first_sequence,
                last: first_sequence + samples.len() as u64 - 1,
                content_crc: 0,
            },
            received_nanos: (day + 1) * DAY,
            refused: Vec::new(),
        };
        let event = Observations {
            new_states: if is_new { vec![new] } else { Vec::new() },
            states: vec![StateId(state); samples.len()],
            times_nanos: samples.iter().map(|sample| sample.utc_nanos).collect(),
            values: samples.iter().map(|sample| sample.value).collect(),
            offsets: vec![OffsetRun { count: samples.len() as u32, offset_secs: 0 }],
            failures: Vec::new(),
            runs: Vec::new(),
        };
        apply(map, &Event::Observations(envelope, event));
    }
}

/// The CPU time of this process so far, in seconds to the hundredth; it is a better measure than the clock where the
/// machine is busy.
fn cpu_secs() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    after_name.split_whitespace().skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / 100.0
}

/// Runs the update after a day; returns its seconds.
fn update(map: &mut LiveMap, pool: &rayon::ThreadPool, day: i64, readings: Option<Arc<dyn StateReadings>>) -> f64 {
    let cut = (day + 1) * DAY;
    let start = Event::UpdateStart(map.plan_update(Some(cut), cut, UpdateCause::Midnight));
    let mut work = apply(map, &start).expect("an update");
    if let Some(readings) = readings {
        work = work.with_readings(readings);
    }
    let (started, cpu) = (Instant::now(), cpu_secs());
    let result = pool.install(|| work.run(&AtomicU64::new(0))).expect("in memory");
    let (secs, cpu) = (started.elapsed().as_secs_f64(), cpu_secs() - cpu);
    let outcome = result.training_outcome().clone();
    map.finish_update(result);
    println!("day {day}: {secs:.2} s, {cpu:.2} s of CPU, {} models trained, {} wait", outcome.trained, outcome.waiting);
    secs
}

fn main() {
    let spec = MapSpec::new(MapName::new("bench").expect("valid"));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().expect("threads");
    let mut map = LiveMap::new(Arc::new(spec));
    // The night comes after twelve weeks, of which this map has seen the last.
    let first = NIGHTLY_WINDOW_NANOS / DAY;
    for day in first..first + BEFORE {
        observe(&mut map, day, 60);
        update(&mut map, &pool, day, None);
    }
    let night = first + BEFORE;
    observe(&mut map, night, 1);
    let without = update(&mut map, &pool, night, None);
    observe(&mut map, night + 1, 1);
    let weeks = samples(7, (night + 1) * 1440 - NIGHTLY_WINDOW_NANOS / MINUTE..(night + 1) * 1440);
    let with = update(&mut map, &pool, night + 1, Some(Arc::new(Weeks(weeks))));
    println!("{STATES} states, a day of minutes each: {without:.1} s without training, {with:.1} s with");
}
