//! The robot of the hall: its scanners, its way, and the drift of the pose that it reports.
//!
//! Invariant: a patrol depends on its generator of random numbers only.

use rand::{Rng as _, rngs::SmallRng};

use super::{
    options::HallOptions,
    plan::{HallPlan, HallThing, ROUTE_M},
};

const SPEED_MPS: f64 = 0.5;
/// The distance after which the drift has mostly been pulled back.
const DRIFT_LENGTH_M: f64 = 20.0;
/// The upper scanner scans this long after the lower one.
const BETWEEN_SCANNERS_NANOS: i64 = 40_000_000;
/// The exact end of a beam lies this far behind the surface, in the thing itself.
const INTO_THING_M: f64 = 1e-3;

/// A planar scanner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HallScanner {
    /// Name of the scanner.
    pub name: &'static str,
    /// Height above the floor.
    pub height_m: f64,
    /// Range of the scanner.
    pub range_m: f64,
    /// Angle of the first beam.
    pub angle_min_rad: f64,
    /// Angle between the first and the last beam.
    pub field_rad: f64,
}

/// The scanners of the robot.
pub const HALL_SCANNERS: [HallScanner; 2] = [
    HallScanner {
        name: "low",
        height_m: 0.2,
        range_m: 12.0,
        angle_min_rad: -std::f64::consts::PI,
        field_rad: 2.0 * std::f64::consts::PI,
    },
    HallScanner {
        name: "high",
        height_m: 2.0,
        range_m: 20.0,
        angle_min_rad: -0.75 * std::f64::consts::PI,
        field_rad: 1.5 * std::f64::consts::PI,
    },
];

/// A place and a direction on the floor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HallPose {
    /// x and y, metres.
    pub place_m: [f64; 2],
    /// Angle from the x axis, counter-clockwise.
    pub yaw_rad: f64,
}

/// A scan of one scanner.
#[derive(Clone, Debug, PartialEq)]
pub struct HallScan {
    /// When it was made, nanoseconds UTC.
    pub utc_nanos: i64,
    /// The scanner.
    pub scanner: HallScanner,
    /// The true pose of the scanner.
    pub true_pose: HallPose,
    /// The pose that the robot reports.
    pub reported_pose: HallPose,
    /// Angle between two beams.
    pub angle_increment_rad: f64,
    /// Measured range of each beam; infinity: the beam has no return.
    pub ranges_m: Vec<f64>,
    /// The exact end of each beam that has a return, in the thing that it hits.
    pub ends: Vec<Option<[f64; 2]>>,
    /// Whether the table is there.
    pub has_table: bool,
}

/// The scans of one patrol. `has_table` holds the table's times.
pub(super) fn patrol(
    plan: &HallPlan,
    options: &HallOptions,
    start_nanos: i64,
    has_table: impl Fn(i64) -> bool,
    rng: &mut SmallRng,
) -> Vec<HallScan> {
    let mut drift = Drift::new(options, rng);
    let length_m = route_length_m();
    let step_m = length_m / f64::from(options.stops);
    // No two patrols scan at the same places.
    let shift_m = rng.random_range(0.0..step_m);
    let mut scans = Vec::with_capacity(2 * options.stops as usize);
    for stop in 0..options.stops {
        let along_m = shift_m + f64::from(stop) * step_m;
        let utc_nanos = start_nanos + (along_m / SPEED_MPS * 1e9) as i64;
        let true_pose = pose_at(along_m);
        let reported_pose = drift.reported(true_pose);
        for (after, scanner) in (0..).zip(HALL_SCANNERS) {
            let utc_nanos = utc_nanos + after * BETWEEN_SCANNERS_NANOS;
            let beams = Beams { plan, options, scanner, true_pose, has_table: has_table(utc_nanos) };
            scans.push(beams.scan(utc_nanos, reported_pose, rng));
        }
        drift.drive(step_m, rng);
    }
    scans
}

struct Beams<'a> {
    plan: &'a HallPlan,
    options: &'a HallOptions,
    scanner: HallScanner,
    true_pose: HallPose,
    has_table: bool,
}

impl Beams<'_> {
    fn scan(&self, utc_nanos: i64, reported_pose: HallPose, rng: &mut SmallRng) -> HallScan {
        let HallScanner { height_m, range_m, angle_min_rad, field_rad, .. } = self.scanner;
        let angle_increment_rad = field_rad / f64::from(self.options.beams);
        let (from, plane) = (self.true_pose.place_m, self.plan.plane(height_m, self.has_table));
        let (mut ranges_m, mut ends) = (Vec::new(), Vec::new());
        for beam in 0..self.options.beams {
            let angle_rad = self.true_pose.yaw_rad + angle_min_rad + f64::from(beam) * angle_increment_rad;
            let (sin, cos) = libm::sincos(angle_rad);
            let hit = plane.first_hit(from, [cos, sin]);
            // The draws of a beam are the same whatever it hits.
            let (chance, noise_m) = (rng.random_range(0.0..1.0), self.options.noise_m * bell(rng));
            let returned = hit.filter(|&(thing, hit): &(HallThing, _)| {
                hit.range_m + noise_m < range_m && chance < thing.returns(hit.steepness)
            });
            ranges_m.push(returned.map_or(f64::INFINITY, |(_, hit)| (hit.range_m + noise_m).max(0.0)));
            ends.push(returned.map(|(_, hit)| {
                let range_m = hit.range_m + INTO_THING_M / hit.steepness.max(0.05);
                [from[0] + range_m * cos, from[1] + range_m * sin]
            }));
        }
        let (scanner, true_pose, has_table) = (self.scanner, self.true_pose, self.has_table);
        HallScan { utc_nanos, scanner, true_pose, reported_pose, angle_increment_rad, ranges_m, ends, has_table }
    }
}

/// The error of the reported pose: a slow random walk that is pulled back, as that of a particle filter.
struct Drift<'a> {
    options: &'a HallOptions,
    /// x, y and angle, each from -1 to 1.
    share: [f64; 3],
}

impl<'a> Drift<'a> {
    /// Standard deviation of each share.
    const SPREAD: f64 = 0.4;

    fn new(options: &'a HallOptions, rng: &mut SmallRng) -> Self {
        let mut drift = Self { options, share: [0.0; 3].map(|_| Self::SPREAD * bell(rng)) };
        drift.limit();
        drift
    }

    fn drive(&mut self, distance_m: f64, rng: &mut SmallRng) {
        let kept = libm::exp(-distance_m / DRIFT_LENGTH_M);
        let new = Self::SPREAD * (1.0 - kept * kept).sqrt();
        self.share = self.share.map(|share| share * kept + new * bell(rng));
        self.limit();
    }

    /// Keeps the place within the maximum distance, and the angle within the maximum angle.
    fn limit(&mut self) {
        let [x, y, angle] = self.share;
        let distance = (x * x + y * y).sqrt().max(1.0);
        self.share = [x / distance, y / distance, angle.clamp(-1.0, 1.0)];
    }

    fn reported(&self, true_pose: HallPose) -> HallPose {
        let HallOptions { drift_m, drift_rad, .. } = self.options;
        let place_m = [0, 1].map(|axis| true_pose.place_m[axis] + drift_m * self.share[axis]);
        HallPose { place_m, yaw_rad: true_pose.yaw_rad + drift_rad * self.share[2] }
    }
}

/// A draw with standard deviation 1: the sum of four uniform draws is close to a normal distribution, and bounded.
fn bell(rng: &mut SmallRng) -> f64 {
    (0..4).map(|_| rng.random_range(-1.0..1.0)).sum::<f64>() * 0.75_f64.sqrt()
}

/// The parts of the way, each from a corner to the next.
fn route() -> impl Iterator<Item = ([f64; 2], [f64; 2], f64)> {
    let next = ROUTE_M.into_iter().cycle().skip(1);
    ROUTE_M.into_iter().zip(next).map(|(from, to)| {
        let [x, y] = [0, 1].map(|axis| to[axis] - from[axis]);
        (from, to, (x * x + y * y).sqrt())
    })
}

fn route_length_m() -> f64 {
    route().map(|(.., length_m)| length_m).sum()
}

/// The pose after this distance, with the direction of the way.
fn pose_at(along_m: f64) -> HallPose {
    let mut rest_m = along_m;
    for (from, to, length_m) in route() {
        if rest_m < length_m {
            let place_m = [0, 1].map(|axis| from[axis] + (to[axis] - from[axis]) * rest_m / length_m);
            return HallPose { place_m, yaw_rad: libm::atan2(to[1] - from[1], to[0] - from[0]) };
        }
        rest_m -= length_m;
    }
    HallPose { place_m: ROUTE_M[0], yaw_rad: 0.0 }
}
