//! A simulated building: two corridors with rooms, a safety door between them that is shut at night, and a part of a
//! corridor in front of the canteen that people block at noon. Each obstacle has a longer detour.
//!
//! ```text
//!   dock          lab1            lab2    store
//!    |             |               |        |
//!   n0 --- n1 --- n2 --- n3 ------ n4 ---- n5          north, 12 m from node to node
//!    |             ¦ safety door                |
//!   lobby          ¦ 20:00 to 6:30 shut      stairs    20 m between the corridors
//!    |             ¦                            |
//!   s0 --- s1 --- s2 --- s3 ~~~~~~ s4 ---- s5          south; ~ blocked at noon on weekdays
//!          |              \        / \
//!        office1           kitchen    office2          through the kitchen it is 34 m instead of 12 m
//! ```
//!
//! Invariant: the condition of an edge at a time depends on the seed, the edge and that time only, so that all robots
//! with one seed meet the same world. Both directions of an edge are equal.

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};
use tidemap_map::{
    name::{InvalidName, StateName},
    topology::{Edge, Extent, NewEdge, NewNode, NodePose, Topology, TopologyEdit},
};

use super::DAY_SECS;

/// Hour of a day, in seconds.
const HOUR: f64 = 3_600.0;
/// The robot's speed without obstacles.
pub(super) const SPEED_M_PER_S: f64 = 0.6;
/// Additional time of a failed attempt.
pub(super) const RECOVERY_SECS: f64 = 60.0;
/// The safety door is open between these times of every day, in seconds.
const DOOR_OPEN: std::ops::Range<f64> = 6.5 * HOUR..20.0 * HOUR;
/// People stand in front of the canteen between these times of a weekday, in seconds.
const NOON: std::ops::Range<f64> = 11.5 * HOUR..13.5 * HOUR;
/// Probability that they block the corridor, drawn for each quarter of an hour.
const BLOCKED: f64 = 0.8;
const QUARTER_SECS: f64 = 900.0;
/// Any other attempt fails with a probability in this range, which is fixed for each edge; drawn for each minute.
const MISHAP: std::ops::Range<f64> = 0.01..0.02;
const MINUTE_SECS: f64 = 60.0;
/// On weekdays corridors are crowded at these times, and robots slower by [`CROWDED_FACTOR`].
const CROWDED: [std::ops::Range<f64>; 3] = [8.0 * HOUR..9.5 * HOUR, 12.0 * HOUR..13.0 * HOUR, 16.5 * HOUR..18.0 * HOUR];
const CROWDED_FACTOR: f64 = 0.7;
/// Speeds differ from their mean by at most this share, drawn for each minute.
const SPREAD: f64 = 0.15;

/// Nodes with their coordinates in metres.
const NODES: [(&str, [f64; 2]); 21] = [
    ("s0", [0.0, 0.0]),
    ("s1", [12.0, 0.0]),
    ("s2", [24.0, 0.0]),
    ("s3", [36.0, 0.0]),
    ("s4", [48.0, 0.0]),
    ("s5", [60.0, 0.0]),
    ("n0", [0.0, 20.0]),
    ("n1", [12.0, 20.0]),
    ("n2", [24.0, 20.0]),
    ("n3", [36.0, 20.0]),
    ("n4", [48.0, 20.0]),
    ("n5", [60.0, 20.0]),
    ("lobby", [0.0, 10.0]),
    ("stairs", [60.0, 10.0]),
    ("kitchen", [42.0, -16.0]),
    ("dock", [0.0, 26.0]),
    ("lab1", [24.0, 26.0]),
    ("lab2", [48.0, 26.0]),
    ("store", [60.0, 26.0]),
    ("office1", [12.0, -6.0]),
    ("office2", [48.0, -6.0]),
];
/// Links: each is an edge in both directions, as long as the distance of its ends.
const LINKS: [(&str, &str); 23] = [
    DOOR,
    CANTEEN,
    ("s0", "s1"),
    ("s1", "s2"),
    ("s2", "s3"),
    ("s4", "s5"),
    ("n0", "n1"),
    ("n1", "n2"),
    ("n2", "n3"),
    ("n3", "n4"),
    ("n4", "n5"),
    ("s0", "lobby"),
    ("lobby", "n0"),
    ("s5", "stairs"),
    ("stairs", "n5"),
    ("s3", "kitchen"),
    ("kitchen", "s4"),
    ("dock", "n0"),
    ("lab1", "n2"),
    ("lab2", "n4"),
    ("store", "n5"),
    ("office1", "s1"),
    ("office2", "s4"),
];
const DOOR: (&str, &str) = ("s2", "n2");
const CANTEEN: (&str, &str) = ("s3", "s4");

/// The subject of a draw.
#[derive(Clone, Copy)]
enum DrawSubject {
    Mishap,
    MishapNow,
    Noon,
    Speed,
}

/// An obstacle on an edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Obstacle {
    Door,
    Crowd,
}

/// A building.
#[derive(Clone, Debug)]
pub(crate) struct Building {
    seed: u64,
    topology: Topology,
}

/// The result of an attempt to traverse an edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Attempt {
    /// The duration of the traversal, including recovery.
    pub secs: f64,
    /// Why it fails; none: it succeeds.
    pub reason: Option<&'static str>,
}

/// The edit that loads the building into a map.
pub(crate) fn load() -> Result<TopologyEdit, InvalidName> {
    let node = |&(name, [x_m, y_m]): &(&str, [f64; 2])| {
        Ok(NewNode { name: StateName::new(name)?, pose: Some(NodePose { x_m, y_m, yaw_rad: 0.0 }), dwell_secs: None })
    };
    let place = |name: &str| NODES.iter().find(|(other, _)| *other == name).map_or([0.0; 2], |(_, place)| *place);
    let link = |&(a, b): &(&str, &str)| {
        let ([ax, ay], [bx, by]) = (place(a), place(b));
        let ends = tidemap_map::topology::EdgeEnds::link(StateName::new(a)?, StateName::new(b)?);
        Ok(NewEdge { ends, extent: Extent::metres((bx - ax).hypot(by - ay)) })
    };
    Ok(TopologyEdit::Load {
        nodes: NODES.iter().map(node).collect::<Result<_, InvalidName>>()?,
        edges: LINKS.iter().map(link).collect::<Result<_, InvalidName>>()?,
        replaces: true,
    })
}

impl Building {
    /// The building of a map that [`load`] made, with the random events of a seed.
    pub(crate) fn new(seed: u64, topology: Topology) -> Self {
        Self { seed, topology }
    }

    /// The topological map of the building.
    pub(crate) fn topology(&self) -> &Topology {
        &self.topology
    }

    /// Tries to traverse an edge at a time, in seconds since midnight before the first Monday.
    pub(super) fn attempt(&self, edge: &Edge, secs: f64) -> Attempt {
        let (link, obstacle) = self.link(edge);
        let spread = 1.0 + SPREAD * (2.0 * self.draw(DrawSubject::Speed, link, secs / MINUTE_SECS) - 1.0);
        let drive_secs = length_m(edge) / (usual_speed(secs) * spread);
        let mishap = self.draw(DrawSubject::MishapNow, link, secs / MINUTE_SECS) < self.mishap(link);
        let reason = match obstacle {
            Some(Obstacle::Door) if !is_door_open(secs) => Some("safety door shut"),
            Some(Obstacle::Crowd)
                if is_noon(secs) && self.draw(DrawSubject::Noon, link, secs / QUARTER_SECS) < BLOCKED =>
            {
                Some("people in the way")
            }
            _ => mishap.then_some("navigation failed"),
        };
        Attempt { secs: drive_secs + if reason.is_some() { RECOVERY_SECS } else { 0.0 }, reason }
    }

    /// The true probability of a successful traversal at a time, and its mean duration in seconds.
    pub(super) fn truth(&self, edge: &Edge, secs: f64) -> (f64, f64) {
        let (link, obstacle) = self.link(edge);
        let open = match obstacle {
            Some(Obstacle::Door) if !is_door_open(secs) => 0.0,
            Some(Obstacle::Crowd) if is_noon(secs) => 1.0 - BLOCKED,
            _ => 1.0,
        };
        (open * (1.0 - self.mishap(link)), length_m(edge) / usual_speed(secs))
    }

    fn mishap(&self, link: u64) -> f64 {
        MISHAP.start + (MISHAP.end - MISHAP.start) * self.draw(DrawSubject::Mishap, link, 0.0)
    }

    /// A number that both directions of an edge share, and the obstacle on the edge.
    fn link(&self, edge: &Edge) -> (u64, Option<Obstacle>) {
        let link = u64::from(edge.from.0.min(edge.to.0)) << 32 | u64::from(edge.from.0.max(edge.to.0));
        let name = |id| self.topology.node(id).map_or("", |node| node.name.as_str());
        let ends = (name(edge.from), name(edge.to));
        let is = |(a, b): (&str, &str)| ends == (a, b) || ends == (b, a);
        let obstacle = if is(DOOR) {
            Some(Obstacle::Door)
        } else if is(CANTEEN) {
            Some(Obstacle::Crowd)
        } else {
            None
        };
        (link, obstacle)
    }

    /// A number in [0, 1) that is constant during each slot of time.
    fn draw(&self, subject: DrawSubject, link: u64, slot: f64) -> f64 {
        draw(self.seed, [subject as u64, link, slot.max(0.0) as u64]).random()
    }
}

/// A generator for each combination of numbers.
pub(crate) fn draw(seed: u64, key: [u64; 3]) -> SmallRng {
    let key = key.into_iter().fold(seed, |key, part| SmallRng::seed_from_u64(key ^ part).random());
    SmallRng::seed_from_u64(key)
}

fn length_m(edge: &Edge) -> f64 {
    edge.extent.length_m.unwrap_or(0.0)
}

fn usual_speed(secs: f64) -> f64 {
    let is_crowded = is_weekday(secs) && CROWDED.iter().any(|hours| hours.contains(&secs.rem_euclid(DAY_SECS)));
    if is_crowded { SPEED_M_PER_S * CROWDED_FACTOR } else { SPEED_M_PER_S }
}

fn is_weekday(secs: f64) -> bool {
    (secs / DAY_SECS).rem_euclid(7.0) < 5.0
}

fn is_door_open(secs: f64) -> bool {
    DOOR_OPEN.contains(&secs.rem_euclid(DAY_SECS))
}

fn is_noon(secs: f64) -> bool {
    is_weekday(secs) && NOON.contains(&secs.rem_euclid(DAY_SECS))
}
