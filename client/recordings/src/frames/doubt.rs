//! Transforms that cannot be those of one robot.
//!
//! Invariant: samples come in the order of time. A robot that is carried, or whose position is corrected, gives no
//! doubt: its transforms jump now and then, not to and fro all the time.

use nalgebra::Isometry3;

use super::{PoseSample, Track, between};

/// A frame jumps if it goes further than this, metres or radians, faster than this a second.
const JUMP_M: f64 = 0.5;
const JUMP_RAD: f64 = 1.0;
const JUMP_SPEED: f64 = 50.0;
/// A frame goes to and fro if it goes further than this, metres, and comes back to a part of that distance within a
/// second.
const FRO_M: f64 = 0.3;
const FRO_SHARE: f64 = 0.3;
const SECOND_NANOS: i64 = 1_000_000_000;
/// Two robots go to and fro in at least one of this many samples.
const ONE_IN: usize = 10;
/// Fewer samples are not judged.
const SAMPLES_MIN: usize = 4;
/// The number of times at which movements in two parents are compared.
const COMPARED: usize = 200;
/// Two robots move differently in more than one of this many compared movements; corrections of a position are fewer.
const DIFFERS_IN: usize = 4;
/// How much two movements of a second differ, metres and radians.
const DIFFERS_M: f64 = 0.2;
const DIFFERS_RAD: f64 = 0.2;

fn distance(one: &PoseSample, other: &PoseSample) -> f64 {
    (one.pose.translation.vector - other.pose.translation.vector).norm()
}

fn elapsed(one: &PoseSample, other: &PoseSample) -> i64 {
    other.time_nanos.saturating_sub(one.time_nanos)
}

/// Whether nothing drives from one sample to the next.
pub(super) fn is_jump(before: &PoseSample, after: &PoseSample) -> bool {
    let secs = elapsed(before, after) as f64 / 1e9;
    let is_fast = |amount: f64, least: f64| amount > least && amount > JUMP_SPEED * secs;
    is_fast(distance(before, after), JUMP_M) || is_fast(before.pose.rotation.angle_to(&after.pose.rotation), JUMP_RAD)
}

/// Why the transforms of a frame cannot be those of one robot; the parent with the most samples comes first.
pub(super) fn reason(child: &str, tracks: &[Track]) -> Option<String> {
    if let Some(track) = tracks.iter().find(|track| goes_to_and_fro(&track.samples)) {
        return Some(format!(
            "{child:?} jumps to and fro in {:?}, as two robots with the same frames do: import each by itself, or leave \
             out a topic of transforms with skip: in a mapping",
            track.parent
        ));
    }
    let (first, others) = tracks.split_first()?;
    let other = others.iter().find(|other| moves_differently(&first.samples, &other.samples))?;
    Some(format!(
        "{child:?} moves differently in {:?} and in {:?}, as two robots with the same frames do: import each by itself, \
         or leave out a topic of transforms with skip: in a mapping",
        first.parent, other.parent
    ))
}

fn goes_to_and_fro(samples: &[PoseSample]) -> bool {
    if samples.len() < SAMPLES_MIN {
        return false;
    }
    let both = samples.windows(2).filter(|pair| {
        let [one, other] = pair else { return false };
        one.time_nanos == other.time_nanos && distance(one, other) > FRO_M
    });
    let returns = samples.windows(3).filter(|three| {
        let [before, there, after] = three else { return false };
        let way = distance(before, there);
        let is_back = distance(before, after) < FRO_SHARE * way && distance(there, after) > FRO_M;
        way > FRO_M && is_back && elapsed(before, after) <= SECOND_NANOS
    });
    (both.count() + returns.count()) * ONE_IN >= samples.len()
}

/// Whether a frame moves differently within two parents. One robot moves the same way in each of them, apart from
/// corrections of its position.
fn moves_differently(one: &[PoseSample], other: &[PoseSample]) -> bool {
    let step = other.len().div_ceil(COMPARED).max(1);
    let (mut compared, mut different) = (0, 0);
    for sample in other.iter().step_by(step) {
        let (start, end) = (sample.time_nanos, sample.time_nanos.saturating_add(SECOND_NANOS));
        let movement = |samples: &[PoseSample]| Some(at(samples, start)?.inverse() * at(samples, end)?);
        let (Some(first), Some(second)) = (movement(one), movement(other)) else { continue };
        compared += 1;
        let apart = (first.translation.vector - second.translation.vector).norm();
        different += usize::from(apart > DIFFERS_M || first.rotation.angle_to(&second.rotation) > DIFFERS_RAD);
    }
    compared >= SAMPLES_MIN && different * DIFFERS_IN > compared
}

/// The pose at a time, between two samples no more than a second apart.
fn at(samples: &[PoseSample], time_nanos: i64) -> Option<Isometry3<f64>> {
    let after = samples.partition_point(|sample| sample.time_nanos < time_nanos);
    let next = samples.get(after)?;
    if next.time_nanos == time_nanos {
        return Some(next.pose);
    }
    let before = samples.get(after.checked_sub(1)?)?;
    (elapsed(before, next) <= SECOND_NANOS).then(|| between(before, next, time_nanos))
}
