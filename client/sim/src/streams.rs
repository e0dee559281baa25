//! An office floor with two streams of people that turn at noon.
//!
//! Two parallel corridors, joined by three short ones, 40 m × 16 m in all. In the morning people walk east through the
//! southern corridor and west through the northern one; after noon they walk back. They keep to the inner side of their
//! corridor both ways. The southern corridor is busy early and late, the northern one around noon. A few people wander
//! anywhere. Nobody comes at weekends, and each day has more or fewer people than the habit.
//!
//! Invariant: pure. The walks of a day depend on the seed and the day only. Day 0 is a Monday; days have 86,400 s.

use rand::{Rng as _, RngCore as _, SeedableRng as _, rngs::SmallRng};

/// Open rectangles: lower and upper corner, metres.
const OPEN: [[[f64; 2]; 2]; 5] = [
    [[0.0, 1.0], [40.0, 5.0]],
    [[0.0, 11.0], [40.0, 15.0]],
    [[0.0, 1.0], [4.0, 15.0]],
    [[18.0, 1.0], [22.0, 15.0]],
    [[36.0, 1.0], [40.0, 15.0]],
];
/// Middle of the southern and of the northern corridor, metres.
const MIDDLES_M: [f64; 2] = [3.0, 13.0];
/// The y coordinate of the stream of each corridor, metres.
const STREAMS_M: [f64; 2] = [4.0, 12.0];
/// Standard deviation across a stream, metres.
const SPREAD_M: f64 = 0.3;
/// People an hour in the busiest hours.
const BUSIEST: f64 = 40.0;
/// The busy hours of the southern and of the northern corridor, with their share of [`BUSIEST`].
const BUSY: [[(f64, f64, f64); 3]; 2] = [
    [(7.0, 10.0, 1.0), (10.0, 16.0, 0.15), (16.0, 19.0, 1.0)],
    [(7.0, 10.0, 0.15), (10.0, 15.0, 1.0), (15.0, 19.0, 0.15)],
];
/// People an hour who wander.
const WANDERERS: f64 = 4.0;
const NOON_SECS: f64 = 43_200.0;

/// An office floor with streams of people.
#[derive(Clone, Copy, Debug)]
pub struct StreamOffice {
    seed: u64,
}

/// A person who walks straight from one place to another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StreamWalk {
    /// The begin of the walk, seconds of the day.
    pub start_secs: f64,
    /// The end of the walk, seconds of the day.
    pub end_secs: f64,
    /// The place where the walk begins, x and y in metres.
    pub from_m: [f64; 2],
    /// The place where the walk ends, x and y in metres.
    pub to_m: [f64; 2],
}

impl StreamWalk {
    /// The place of the person at a second of the day; `None` before and after the walk.
    pub fn at(&self, secs: f64) -> Option<[f64; 2]> {
        let share = (secs - self.start_secs) / (self.end_secs - self.start_secs);
        (0.0..=1.0).contains(&share).then(|| [0, 1].map(|axis| self.from_m[axis] + share * self.along(axis)))
    }

    /// The direction of the walk in radians, counter-clockwise from the x axis.
    pub fn direction_rad(&self) -> f64 {
        self.along(1).atan2(self.along(0))
    }

    fn along(&self, axis: usize) -> f64 {
        self.to_m[axis] - self.from_m[axis]
    }
}

/// A person that a sensor detects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetectedWalk {
    /// Seconds of the day.
    pub secs: f64,
    /// The place, x and y in metres, with the sensor's noise.
    pub place_m: [f64; 2],
    /// The direction of movement in radians, with the sensor's noise.
    pub direction_rad: f64,
}

impl StreamOffice {
    /// The size of the floor, x and y in metres; its lower corner is (0, 0).
    pub const SIZE_M: [f64; 2] = [40.0, 16.0];

    /// A floor; a different `seed` gives different walks with the same habits.
    pub fn new(seed: u64) -> Self {
        Self { seed }
    }

    /// Whether a place is open, and not inside a wall.
    pub fn is_open(place_m: [f64; 2]) -> bool {
        let holds = |[low, high]: &[[f64; 2]; 2]| (0..2).all(|axis| (low[axis]..high[axis]).contains(&place_m[axis]));
        OPEN.iter().any(holds)
    }

    /// The walks of a day, ascending by their start.
    pub fn walks(&self, day: i64) -> Vec<StreamWalk> {
        let key =
            [1, day as u64].into_iter().fold(self.seed, |key, part| SmallRng::seed_from_u64(key ^ part).next_u64());
        let mut random = SmallRng::seed_from_u64(key);
        let mut walks = Vec::new();
        if day.rem_euclid(7) < 5 {
            let busy = random.random_range(0.8..1.2);
            for (corridor, hours) in BUSY.iter().enumerate() {
                for &(from, until, share) in hours {
                    let starts = arrivals(&mut random, from * 3_600.0, until * 3_600.0, busy * share * BUSIEST);
                    walks.extend(starts.into_iter().map(|start| stream_walk(&mut random, corridor, start)));
                }
            }
            let starts = arrivals(&mut random, 25_200.0, 68_400.0, WANDERERS);
            walks.extend(starts.into_iter().map(|start| wander(&mut random, start)));
        }
        walks.sort_by(|one, other| one.start_secs.total_cmp(&other.start_secs));
        walks
    }

    /// The detections of the cameras on a day: each person once a second, ascending by time.
    pub fn detections(&self, day: i64) -> Vec<DetectedWalk> {
        let key =
            [2, day as u64].into_iter().fold(self.seed, |key, part| SmallRng::seed_from_u64(key ^ part).next_u64());
        let mut random = SmallRng::seed_from_u64(key);
        let mut found = Vec::new();
        for walk in self.walks(day) {
            let mut secs = walk.start_secs;
            while let Some(place) = walk.at(secs) {
                let place_m = place.map(|coordinate| coordinate + 0.1 * bell(&mut random));
                let direction_rad = walk.direction_rad() + 0.15 * bell(&mut random);
                found.push(DetectedWalk { secs, place_m, direction_rad });
                secs += 1.0;
            }
        }
        found.sort_by(|one, other| one.secs.total_cmp(&other.secs));
        found
    }
}

/// The sum of four uniform draws: nearly normal, with standard deviation 1, and bounded.
fn bell(random: &mut SmallRng) -> f64 {
    (0..4).map(|_| random.random_range(-1.0..1.0)).sum::<f64>() / 1.155
}

/// Poisson arrivals, by exponential gaps.
fn arrivals(random: &mut SmallRng, from_secs: f64, until_secs: f64, per_hour: f64) -> Vec<f64> {
    let mut times = Vec::new();
    let mut now = from_secs;
    loop {
        now -= (1.0 - random.random::<f64>()).ln() * 3_600.0 / per_hour;
        if now >= until_secs {
            return times;
        }
        times.push(now);
    }
}

fn speed(random: &mut SmallRng) -> f64 {
    1.2 + 0.15 * bell(random)
}

/// A walk through a corridor, with its stream.
fn stream_walk(random: &mut SmallRng, corridor: usize, start_secs: f64) -> StreamWalk {
    let goes_east = (corridor == 0) == (start_secs < NOON_SECS);
    let y = STREAMS_M[corridor] + SPREAD_M * bell(random);
    let (from, to) = if goes_east { (1.0, 39.0) } else { (39.0, 1.0) };
    let end_secs = start_secs + 38.0 / speed(random);
    StreamWalk { start_secs, end_secs, from_m: [from, y], to_m: [to, y] }
}

/// A walk along or across a corridor, anywhere.
fn wander(random: &mut SmallRng, start_secs: f64) -> StreamWalk {
    let (from_m, to_m) = if random.random_bool(0.5) {
        let y = MIDDLES_M[random.random_range(0..2)] + random.random_range(-1.8..1.8);
        ([random.random_range(1.0..39.0), y], [random.random_range(1.0..39.0), y])
    } else {
        let x = [2.0, 20.0, 38.0][random.random_range(0..3)] + random.random_range(-1.8..1.8);
        ([x, random.random_range(1.5..14.5)], [x, random.random_range(1.5..14.5)])
    };
    let length = (to_m[0] - from_m[0]).hypot(to_m[1] - from_m[1]).max(1.0);
    StreamWalk { start_secs, end_secs: start_secs + length / speed(random), from_m, to_m }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_day_depends_on_the_seed_and_the_day_only() {
        let office = StreamOffice::new(1);
        assert_eq!(office.detections(2), StreamOffice::new(1).detections(2));
        assert_ne!(office.walks(2), office.walks(3));
        assert_ne!(office.walks(2), StreamOffice::new(2).walks(2));
    }

    #[test]
    fn nobody_comes_at_weekends_and_nobody_walks_through_walls() {
        let office = StreamOffice::new(3);
        assert!(office.walks(5).is_empty() && office.walks(6).is_empty());
        for day in 0..5 {
            for walk in office.walks(day) {
                assert!((0..=10).all(|step| {
                    let secs = walk.start_secs + (walk.end_secs - walk.start_secs) * f64::from(step) / 10.0;
                    walk.at(secs).is_none_or(StreamOffice::is_open)
                }));
            }
        }
        assert!(!StreamOffice::is_open([10.0, 8.0]) && StreamOffice::is_open([20.0, 8.0]));
    }

    #[test]
    fn the_streams_turn_at_noon() {
        let office = StreamOffice::new(4);
        let mut through = [[0, 0], [0, 0]];
        for walk in (0..5)
            .flat_map(|day| office.walks(day))
            .filter(|walk| walk.from_m[1] == walk.to_m[1] && walk.from_m[1] < 8.0)
        {
            through[usize::from(walk.start_secs > NOON_SECS)][usize::from(walk.to_m[0] > walk.from_m[0])] += 1;
        }
        let [[west_early, east_early], [west_late, east_late]] = through;
        assert!(east_early > 5 * west_early && west_late > 5 * east_late, "{through:?}");
        assert!(east_early > 300, "{through:?}");
    }
}
