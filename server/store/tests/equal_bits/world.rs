//! The log of an office: states of every kind, a grid that two sensors scan, and an update every night.
//!
//! Invariant: a function of the seed and the specification. Some observations come late, some have a time in the
//! future, and some wait for the next update.

use std::sync::{Arc, atomic::AtomicU64};

use tidemap_grid::{
    index::TileIndex,
    log_head::{LogHead, StreamScan, StreamTiles},
    scan::ScanSource,
    scan::Scans,
    sensors::ProducerSensor,
};
use tidemap_map::{
    event::{
        Dimensions, Envelope, Event, Hold, NewState, Observations, Reporting, SequenceSpan, StateKind, StateSensor,
        StateShape, UpdateCause,
    },
    ids::{NewProducer, ProducerId, StateId},
    live_map::LiveMap,
    name::{ProducerKey, StateName},
    spec::MapSpec,
};
use tidemap_model::Sample;
use tidemap_sim::{GridOffice, GridOfficeOptions, Office};

const SECOND: i64 = 1_000_000_000;
const HOUR: i64 = 3600 * SECOND;
const DAY: i64 = 24 * HOUR;
/// Midnight UTC of Monday 3 March 2025, which is that of London.
const FIRST: i64 = 1_740_960_000 * SECOND;
const TILES: u32 = 6;
/// States of the office; those that are made up come after them.
const ROWS: [&str; 4] = ["front door", "bell", "boiler", "lift"];

/// The log written so far.
struct Writer {
    map: LiveMap,
    events: Vec<Event>,
    sequences: [u64; 3],
    head: LogHead,
    tiles: StreamTiles,
    /// Numbers by a linear congruence.
    seed: u64,
}

/// The events of some days.
pub(crate) fn log(spec: &Arc<MapSpec>, days: i64) -> Vec<Event> {
    let map = LiveMap::new(Arc::clone(spec));
    let office = Office::new(7, "Europe/London").expect("known");
    let options = GridOfficeOptions {
        cells: TILES * 512,
        changing_cells: 150,
        scans_per_day: 144,
        changes_per_day: 20.0,
        ..GridOfficeOptions::default()
    };
    let grid = GridOffice::new(&options).expect("valid");
    let mut tiles = StreamTiles::default();
    grid.tiles().iter().for_each(|&[x, y, z]| tiles.push(TileIndex { x, y, z }));
    let head = LogHead::new(map.grid().expect("a grid"));
    let mut writer = Writer { map, events: Vec::new(), sequences: [0; 3], head, tiles, seed: 1 };
    writer.add_states(&office);
    let mut waiting = Vec::new();
    for day in 0..days {
        let mut of_day = writer.readings(&office, day);
        // A part of each day comes after the update that follows the day.
        let late: Vec<(u32, i64, f64)> = of_day.iter().copied().filter(|row| row.1 % 11 == 3).collect();
        of_day.retain(|row| row.1 % 11 != 3);
        of_day.append(&mut waiting);
        waiting = late;
        for part in of_day.chunks(97) {
            writer.observe(part, FIRST + (day + 1) * DAY);
        }
        writer.scan(&grid, day as u32);
        // Now and then an update leaves a part of the day to the next.
        let cut = if day % 4 == 2 { FIRST + day * DAY + 19 * HOUR } else { FIRST + (day + 1) * DAY };
        writer.update(cut, FIRST + (day + 1) * DAY);
    }
    writer.events
}

impl Writer {
    fn apply(&mut self, event: Event) {
        let position = self.map.position() + 1;
        if let Some(work) = self.map.apply(position, &event).expect("fits") {
            self.map.finish_update(work.run(&AtomicU64::new(0)).expect("in memory"));
        }
        self.events.push(event);
    }

    fn draw(&mut self, below: u64) -> u64 {
        self.seed = self.seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.seed >> 33) * below) >> 31
    }

    fn envelope(&mut self, producer: u32, count: u64, received_nanos: i64) -> Envelope {
        let sequence = &mut self.sequences[producer as usize];
        let first = *sequence + 1;
        *sequence += count;
        let key = ProducerKey::new(["robot", "lidar", "camera"][producer as usize], "").expect("valid");
        let sensor = (producer == 2).then_some(ProducerSensor { hit: 0.8, false_alarm: 0.1 });
        Envelope {
            producer: ProducerId(producer),
            new_producer: (first == 1).then_some(NewProducer { key, sensor, introduced_by: String::new() }),
            incarnation: 1,
            span: SequenceSpan { first, last: first + count - 1, content_crc: first as u32 },
            received_nanos,
            refused: Vec::new(),
        }
    }

    fn add_states(&mut self, office: &Office) {
        let name = |name: &str| StateName::new(name).expect("valid");
        let hold = Hold::new(7 * 86_400, 600).expect("valid");
        let mut id = 0;
        for (number, state) in office.states().iter().enumerate() {
            // The sensor of some doors is known.
            let sensor = (number % 3 == 1).then(|| StateSensor::new(0.9, 0.05).expect("a sensor"));
            let door = NewState { sensor, ..NewState::sampled(StateId(id), name(state), StateKind::Probability) };
            self.apply(Event::AddState(door));
            id += 1;
        }
        let shapes = [
            ("temperature", StateShape::Scalar(StateKind::Continuous)),
            ("people", StateShape::Scalar(StateKind::Count)),
            ("cat", StateShape::Vector(Dimensions::Two)),
            ("vane", StateShape::Angle),
        ];
        for (state, shape) in shapes {
            self.apply(Event::AddState(NewState::sampled(StateId(id), name(state), shape)));
            id += shape.states() as u32;
        }
        let labels = ["sleeps", "eats", "works"].map(|label| name("cook").label(label).expect("valid")).to_vec();
        let cook = NewState::categorical(StateId(id), name("cook"), labels).expect("sound");
        self.apply(Event::AddState(cook));
        id += 3;
        for (state, kind, reporting) in [
            (ROWS[0], StateKind::Probability, Reporting::Changes(hold)),
            (ROWS[1], StateKind::Count, Reporting::Events(hold)),
            (ROWS[2], StateKind::Continuous, Reporting::Changes(hold)),
            (ROWS[3], StateKind::Probability, Reporting::Samples),
        ] {
            let state = NewState { reporting, ..NewState::sampled(StateId(id), name(state), kind) };
            self.apply(Event::AddState(state));
            id += 1;
        }
    }

    /// State, time and value of each reading of a day, in order of time.
    fn readings(&mut self, office: &Office, day: i64) -> Vec<(u32, i64, f64)> {
        let (from, to) = (FIRST + day * DAY, FIRST + (day + 1) * DAY);
        let mut rows = Vec::new();
        for robot in 0..office.robots().len() {
            rows.extend(office.visits(robot, from, to).map(|(nanos, state, value)| (state as u32, nanos, value)));
        }
        let first = office.states().len() as u32;
        for step in 0..72 {
            let nanos = from + step * DAY / 72 + self.draw(600) as i64 * SECOND;
            let hour = (nanos - from) as f64 / HOUR as f64;
            let turn = std::f64::consts::TAU * hour / 24.0;
            let noise = self.draw(1000) as f64 / 1000.0;
            let is_awake = (7.0..22.0).contains(&hour);
            let eats = if is_awake { 0.25 + noise / 2.0 } else { 0.0 };
            let works = if is_awake { 1.0 - eats } else { 0.0 };
            let angle = turn + noise;
            let values = [
                18.0 - 3.0 * turn.cos() + noise,
                (4.0 * noise * f64::from(u8::from(is_awake))).floor(),
                3.0 * turn.sin() + noise,
                5.0 - noise * 0.1,
                angle.cos(),
                angle.sin(),
                1.0 - eats - works,
                eats,
                works,
            ];
            rows.extend((first..).zip(values).map(|(state, value)| (state, nanos, value)));
            let of_rows = first + values.len() as u32;
            if step % 9 == 4 {
                rows.push((of_rows, nanos + SECOND, f64::from(u8::from(step % 18 == 4))));
                rows.push((of_rows + 2, nanos + SECOND, 40.0 + 10.0 * noise));
            }
            if is_awake && noise > 0.6 {
                rows.push((of_rows + 1, nanos + SECOND, 1.0));
            }
            rows.push((of_rows + 3, nanos + SECOND, f64::from(u8::from(is_awake)) * 0.9 + 0.1 * noise));
        }
        rows.sort_by_key(|&(_, nanos, _)| nanos);
        rows
    }

    fn observe(&mut self, rows: &[(u32, i64, f64)], received_nanos: i64) {
        let mut observations = Observations::default();
        for &(state, utc_nanos, value) in rows {
            observations.push(StateId(state), Sample { utc_nanos, offset_secs: 0, value });
        }
        let envelope = self.envelope(0, rows.len() as u64, received_nanos);
        self.apply(Event::Observations(envelope, observations));
    }

    fn scan(&mut self, office: &GridOffice, day: u32) {
        let seen: Arc<[u32]> = (0..TILES).collect();
        let scans = office.day(day);
        let mut sent: Vec<StreamScan> = scans
            .iter()
            .map(|scan| StreamScan {
                utc_nanos: scan.utc_nanos,
                source: ScanSource::Cells,
                seen: Arc::clone(&seen),
                observed_flips: Vec::new(),
                occupied_flips: scan.occupied_flips.to_vec(),
            })
            .collect();
        if day == 0 {
            sent[0].observed_flips = (0..TILES * 512).collect();
        }
        // Two sensors take turns, and one batch of the morning comes after one of the evening.
        for (number, batch) in sent.chunks(12).enumerate() {
            let producer = 1 + number as u32 % 2;
            let mut event = Scans::default();
            for scan in batch {
                let mut scan = scan.clone();
                if number % 5 == 3 {
                    scan.utc_nanos -= 5 * HOUR;
                }
                let grid = self.map.grid().expect("a grid");
                let taken = self.head.take(grid, 1, &mut self.tiles, &scan, 0, 100).expect("room");
                event.new_tiles.extend(taken.new_tiles);
                event.scans.push(taken.scan);
            }
            let received = FIRST + i64::from(day + 1) * DAY;
            let envelope = self.envelope(producer, batch.len() as u64, received);
            self.apply(Event::Scans(envelope, event));
        }
    }

    fn update(&mut self, until: i64, now: i64) {
        let start = self.map.plan_update(Some(until), now, UpdateCause::Midnight);
        self.apply(Event::UpdateStart(start));
    }
}
