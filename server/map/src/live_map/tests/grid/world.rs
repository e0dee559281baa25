//! A small world: some robots that scan some tiles, the map that takes their scans, and the oracle.
//!
//! Invariant: the map receives only the messages that a stream would send; the oracle receives the tiles that the
//! robots have seen.

use std::sync::{Arc, atomic::AtomicU64};

use tidemap_grid::{
    live::LiveGrid,
    log_head::{LogHead, TooManyTiles},
    scan::Scans,
    sensors::ProducerSensor,
    spec::{Evidence, GridSpec, Retention, SensorNoise},
    update::rules::UpdateLimits,
};
use tidemap_model::{LocalDay, OrderCriterion, Periodicities, Sample, Zone};

use super::robot::{Robot, SENSORS, Seen, random};
use super::{
    oracle::{Oracle, Read},
    scans::ScanOracle,
};

use crate::{
    event::{Envelope, Event, SequenceSpan, UpdateCause},
    ids::{NewProducer, ProducerId, RefusalReason},
    live_map::LiveMap,
    name::MapName,
    snapshot::MapSnapshot,
    spec::MapSpec,
    update::UpdateWork,
};

pub(crate) const SECOND: i64 = 1_000_000_000;
pub(crate) const HOUR: i64 = 3600 * SECOND;
/// Saturday evenings before clocks go forward in London, and before they go back.
const EVENINGS: [i64; 2] = [1_711_828_800 * SECOND, 1_729_972_800 * SECOND];

/// Limits of updates that small worlds often reach.
pub(crate) const SMALL: UpdateLimits =
    UpdateLimits { chunk_scans: 3, summed_groups_max: 2, runs_per_sum: 4, batch_cells_min: 2, batch_cells_max: 4 };

/// The world.
pub(crate) struct World {
    rng: u64,
    pub(crate) spec: Arc<MapSpec>,
    pub(crate) map: LiveMap,
    front: LogHead,
    robots: Vec<Robot>,
    pub(crate) oracle: Oracle,
    pub(crate) scans: ScanOracle,
    log: Vec<Event>,
    pub(crate) snapshot: Option<MapSnapshot>,
    running: Option<UpdateWork>,
    /// The time of the server's clock.
    now_nanos: i64,
    max_tiles: usize,
    pub(crate) limits: UpdateLimits,
}

pub(crate) fn spec(rng: &mut u64) -> MapSpec {
    let sensor = match random(rng, 3) {
        0 => SensorNoise { hit: 0.83, false_alarm: 0.07, prior: 0.37 },
        _ => SensorNoise::default(),
    };
    let is_noisy = sensor != SensorNoise::default();
    MapSpec {
        zone: Zone::named("Europe/London").expect("known"),
        periodicities: match random(rng, 4) {
            0 => Periodicities::list(vec![5 * HOUR, 24 * HOUR, 70_000 * SECOND]).expect("valid"),
            _ => Periodicities::harmonics(36 * HOUR, 20).expect("valid"),
        }, // Without noise, predictions of exactly 0.5 occur; rounding decides their side.
        criterion: if is_noisy && random(rng, 2) == 0 { OrderCriterion::ZeroOne } else { OrderCriterion::SquaredError },
        grid: Some(GridSpec {
            sensor,
            retention: Retention::Forever,
            evidence: Evidence::Readings,
            ..GridSpec::new(0.1)
        }),
        ..MapSpec::new(MapName::new("world").expect("valid"))
    }
}

impl World {
    pub(crate) fn new(seed: u64) -> World {
        let mut rng = seed;
        let mut spec = spec(&mut rng);
        // Half of the worlds have a half-life, of hours to some days.
        let mut choice = seed.rotate_left(17);
        if let (Some(grid), 0) = (&mut spec.grid, random(&mut choice, 2)) {
            grid.half_life_nanos = [3, 20, 96].map(|hours| Some(hours * HOUR))[random(&mut choice, 3)];
        }
        let half_life_nanos = spec.grid.as_ref().and_then(|grid| grid.half_life_nanos);
        let half_life_days = half_life_nanos.map(|nanos| nanos as f64 / (24 * HOUR) as f64);
        let spec = Arc::new(spec);
        let map = LiveMap::new(Arc::clone(&spec));
        let front = LogHead::new(map.grid().expect("a grid"));
        // A third of the worlds have the map's own sensor alone.
        let mut choice = !seed;
        let others = if random(&mut choice, 3) == 0 { 0 } else { SENSORS.len() };
        let mut sensor = || SENSORS[..others].get(random(&mut choice, others + 1)).copied();
        let robots = (0..1 + random(&mut rng, 3)).map(|id| Robot::new(id, sensor(), &mut rng)).collect();
        World {
            oracle: Oracle::new(&spec.periodicities, spec.criterion, half_life_days),
            scans: ScanOracle::default(),
            spec,
            map,
            front,
            robots,
            log: Vec::new(),
            snapshot: None,
            running: None,
            now_nanos: EVENINGS[random(&mut rng, 2)],
            max_tiles: 3,
            limits: SMALL,
            rng,
        }
    }

    pub(crate) fn grid(&self) -> &LiveGrid {
        self.map.grid().expect("a grid")
    }

    /// A number below `below`.
    pub(crate) fn draw_number(&mut self, below: usize) -> usize {
        random(&mut self.rng, below)
    }

    /// Makes one random step.
    pub(crate) fn step(&mut self) {
        match random(&mut self.rng, 100) {
            0..74 => {
                let robot = random(&mut self.rng, self.robots.len());
                let batch = 1 + random(&mut self.rng, 6);
                let seen: Vec<Seen> = (0..batch).map(|_| self.draw(robot)).collect();
                self.send(&seen);
            }
            74..84 => {
                let back = random(&mut self.rng, 50) as i64 * HOUR + 1;
                let until = (random(&mut self.rng, 3) > 0).then_some(self.now_nanos - back);
                self.start_update(until);
            }
            84..92 => self.finish_update(),
            92..95 => self.restore(),
            95..97 => self.lose_front(),
            97 => self.max_tiles = 2 + random(&mut self.rng, 2),
            _ => {
                let robot = random(&mut self.rng, self.robots.len());
                let seen = self.draw(robot);
                let sent = self.robots[robot].send(&seen);
                self.robots[robot].source.skip(&sent);
            }
        }
    }

    /// Draws the tiles that a robot sees next.
    fn draw(&mut self, robot: usize) -> Seen {
        let rng = &mut self.rng;
        if random(rng, 4) > 0 {
            self.now_nanos += random(rng, 3 * HOUR as usize) as i64;
        }
        let utc_nanos = match random(rng, 20) {
            0..14 => self.now_nanos,
            14..16 => self.now_nanos - random(rng, 600) as i64 * SECOND,
            16..19 => self.now_nanos - random(rng, 50 * HOUR as usize) as i64,
            _ => self.now_nanos + 301 * SECOND + random(rng, 30 * HOUR as usize) as i64,
        };
        self.robots[robot].observe(robot, utc_nanos, rng)
    }

    /// Scans of all robots.
    pub(crate) fn draw_scans(&mut self, count: usize) -> Vec<Seen> {
        let scans = (0..count).map(|i| self.draw(i % self.robots.len()));
        let mut scans: Vec<Seen> = scans.collect();
        scans.iter_mut().for_each(|scan| scan.utc_nanos = scan.utc_nanos.min(self.now_nanos));
        scans
    }

    pub(crate) fn shuffle(&mut self, scans: &mut [Seen]) {
        for i in (1..scans.len()).rev() {
            scans.swap(i, random(&mut self.rng, i + 1));
        }
    }

    /// Sends scans in batches of this many, or fewer where the robot changes.
    pub(crate) fn send_all(&mut self, scans: &[Seen], batch: usize) {
        self.now_nanos = scans.iter().map(|scan| scan.utc_nanos).fold(self.now_nanos, i64::max);
        for of_robot in scans.chunk_by(|one, next| one.robot == next.robot) {
            of_robot.chunks(batch).for_each(|scans| self.send(scans));
        }
    }

    /// Sends scans, ascending by time, with an update after each local day for whose number from the first day `closes`
    /// is true, and an update of the rest. Robots take turns.
    pub(crate) fn send_by_day(&mut self, scans: &[Seen], batch: usize, closes: impl Fn(usize) -> bool) {
        let zone = self.spec.zone.clone();
        let day_of = |scan: &Seen| zone.day_of(scan.utc_nanos);
        self.now_nanos = scans.iter().map(|scan| scan.utc_nanos).fold(self.now_nanos, i64::max);
        for (number, of_day) in scans.chunk_by(|one, next| day_of(one) == day_of(next)).enumerate() {
            for of_robot in of_day.chunk_by(|one, next| one.robot == next.robot) {
                of_robot.chunks(batch).for_each(|scans| self.send(scans));
            }
            if let Some(last) = of_day.last().filter(|_| closes(number)) {
                self.start_update(Some(zone.midnight_nanos(LocalDay(day_of(last).0 + 1))));
                self.finish_update();
            }
        }
        self.settle();
    }

    /// Whether the learned data of the tiles equals that of another world, to the last bit.
    pub(crate) fn knows_the_same(&self, other: &World) -> bool {
        let known = |world: &World| {
            let grid = world.snapshot.as_ref().and_then(|snapshot| snapshot.grid.as_ref()).expect("updated");
            (grid.models.clone(), grid.sums.clone())
        };
        known(self) == known(other)
    }

    /// One robot's scans reach the map together.
    fn send(&mut self, seen: &[Seen]) {
        let Some(robot) = seen.first().map(|seen| seen.robot) else { return };
        let stream = &mut self.robots[robot];
        let known = self.map.producer(&stream.key).map(|(id, mark)| (id, mark.durable_sequence));
        let new_id = ProducerId(u32::try_from(self.map.producers()).expect("few"));
        let first_sequence = known.map_or(0, |(_, sequence)| sequence) + 1;
        let of_grid = self.spec.grid.as_ref().expect("a grid").sensor;
        let grid = self.map.grid().expect("a grid");
        let sensor = stream.sensor.and_then(|sensor| grid.may_have(sensor, std::iter::empty()).expect("a sensor"));
        let noise = sensor.map_or(of_grid, |ProducerSensor { hit, false_alarm }| SensorNoise {
            hit,
            false_alarm,
            prior: of_grid.prior,
        });
        let levels = noise.levels();
        let mut envelope = Envelope {
            producer: known.map_or(new_id, |(id, _)| id),
            new_producer: known.is_none().then(|| NewProducer {
                key: stream.key.clone(),
                sensor,
                introduced_by: String::new(),
            }),
            incarnation: 1,
            span: SequenceSpan { first: first_sequence, last: first_sequence + seen.len() as u64 - 1, content_crc: 3 },
            received_nanos: self.now_nanos,
            refused: Vec::new(),
        };
        let mut event = Scans::default();
        for (sequence, scan) in (first_sequence..).zip(seen) {
            let sent = stream.send(scan);
            let offset_secs = self.spec.zone.offset_secs(scan.utc_nanos);
            let grid = self.map.grid().expect("a grid");
            let id = robot as u64 + 1;
            match self.front.take(grid, id, &mut stream.source, &sent, offset_secs, self.max_tiles) {
                Ok(taken) => {
                    event.new_tiles.extend(taken.new_tiles);
                    event.scans.push(taken.scan);
                }
                Err(TooManyTiles) => {
                    envelope.refused.push((sequence, RefusalReason::TileLimit));
                    continue;
                }
            }
            let is_ahead = scan.utc_nanos > envelope.plausible_nanos();
            self.scans.take(scan, offset_secs, sensor, is_ahead);
            self.oracle.scan(scan.utc_nanos + i64::from(offset_secs) * SECOND);
            for &(tile, masks) in &scan.tiles {
                for cell in masks.observed().cells() {
                    let is_occupied = masks.occupied().contains(cell);
                    let value = if is_occupied { levels.1 } else { levels.0 };
                    let sample = Sample { utc_nanos: scan.utc_nanos, offset_secs, value };
                    self.oracle.observe(tile, cell, Read { sample, is_occupied }, is_ahead);
                }
            }
        }
        self.apply(Event::Scans(envelope, event));
    }

    fn apply(&mut self, event: Event) {
        let position = self.map.position() + 1;
        let work = self.map.apply(position, &event).expect("consistent");
        self.log.push(event);
        if let Some(work) = work {
            self.running = Some(work.with_limits(self.limits));
        }
    }

    fn start_update(&mut self, until_nanos: Option<i64>) {
        if self.running.is_none() {
            let start = self.map.plan_update(until_nanos, self.now_nanos, UpdateCause::Request);
            self.apply(Event::UpdateStart(start));
            self.oracle.start_update(start.cut_nanos);
            self.scans.start_update(start.cut_nanos);
        }
    }

    fn finish_update(&mut self) {
        let Some(work) = self.running.take() else { return };
        let result = work.run(&AtomicU64::new(0)).expect("in memory");
        self.oracle.finish_update();
        let outcome = *result.grid_outcome().expect("a grid");
        let snapshot = self.map.finish_update(result);
        let grid = self.map.grid().expect("a grid");
        self.scans.finish_update(&outcome, &snapshot.history, &self.spec.periodicities, grid);
        self.snapshot = Some(snapshot);
    }

    /// Runs an update of all pending scans.
    pub(crate) fn settle(&mut self) {
        self.finish_update();
        self.start_update(None);
        self.finish_update();
    }

    /// Restarts the daemon from the last snapshot and the log; streams connect again.
    pub(crate) fn restore(&mut self) {
        let (known, from, generation) =
            self.snapshot.as_ref().map_or((0, 1, 0), |known| (known.position, known.replay_from, known.generation));
        self.map = match self.snapshot.clone() {
            Some(snapshot) => LiveMap::restore(Arc::clone(&self.spec), snapshot),
            None => LiveMap::new(Arc::clone(&self.spec)),
        };
        assert_eq!((self.map.position(), generation), (known, self.map.publish().generation()));
        let was_running = self.running.take().is_some();
        for (position, event) in (1..).zip(&self.log).filter(|(position, _)| *position >= from) {
            if position <= known {
                self.map.recover_pending(position, event).expect("consistent");
            } else if let Some(work) = self.map.apply(position, event).expect("consistent") {
                assert!(was_running && self.running.is_none());
                self.running = Some(work.with_limits(self.limits));
            }
        }
        assert_eq!(self.running.is_some(), was_running);
        self.lose_front();
    }

    fn lose_front(&mut self) {
        self.front = LogHead::new(self.map.grid().expect("a grid"));
        self.robots.iter_mut().for_each(|robot| robot.source.forget_tiles());
    }
}
