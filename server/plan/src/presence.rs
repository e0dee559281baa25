//! Predicts where a person or an object is, which is at exactly one of several places: [`Presence`] over the slots of
//! days, trained on the readings of the places.
//!
//! Invariant: the probabilities of the places sum to 1 at each time. They use no reading after the first of the times.

use tidemap_model::{
    EarlyStop, StopSignal,
    models::{CannotTrain, Presence, PresenceOptions},
};

/// Readings count for this time before the first time: it is the window of the fits of other models.
pub const READINGS_MAX_NANOS: i64 = 84 * DAY_NANOS;
/// Steps of expectation-maximisation: as many as a nightly learner runs in four nights.
const STEPS: usize = 12;
const DAY_NANOS: i64 = 86_400_000_000_000;

/// A reading of one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Time of the reading, nanoseconds UTC.
    pub utc_nanos: i64,
    /// Index of the place.
    pub place: usize,
    /// Whether the person or object was there.
    pub is_there: bool,
}

/// The reason why there is no presence.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PresenceError {
    /// The number of places or of slots is outside of its range.
    #[error(transparent)]
    CannotTrain(#[from] CannotTrain),
    /// The caller no longer waits for the result.
    #[error(transparent)]
    Stopped(#[from] EarlyStop),
}

/// The probability that the person or object is at each place, at each of the ascending times: a row per place. With
/// no readings, all places are equally likely.
///
/// `slot_nanos` is the length of a slot, a minute to a day; `offset_secs` gives the offset of local time from UTC.
/// Readings after the first of the times, and those that are more than [`READINGS_MAX_NANOS`] older, do not count. The
/// work is proportional to the slots from the first reading to the last time, and to the square of the places. The
/// forecast ends [`READINGS_MAX_NANOS`] after the first time, and stays as it is there.
///
/// # Errors
/// [`PresenceError`]: 2 to 64 places, and slots of at least a minute.
pub fn presence_series(
    places: usize,
    sightings: &[Sighting],
    times_nanos: &[i64],
    slot_nanos: i64,
    offset_secs: impl Fn(i64) -> i32,
    stop: StopSignal<'_>,
) -> Result<Vec<Vec<f64>>, PresenceError> {
    let slot_nanos = slot_nanos.clamp(1, DAY_NANOS);
    let slots_per_day = (DAY_NANOS as u64).div_ceil(slot_nanos.unsigned_abs()) as usize;
    let options = PresenceOptions { steps: 1, ..PresenceOptions::new(places, slots_per_day) };
    let mut presence = Presence::new(options)?;
    let (Some(&first_time), Some(&last_time)) = (times_nanos.first(), times_nanos.last()) else {
        return Ok(vec![Vec::new(); places]);
    };
    let counts = |sighting: &&Sighting| {
        let age = first_time.saturating_sub(sighting.utc_nanos);
        (0..=READINGS_MAX_NANOS).contains(&age)
    };
    let mut known: Vec<Sighting> = sightings.iter().filter(counts).copied().collect();
    known.sort_by_key(|sighting| sighting.utc_nanos);
    let Some(oldest) = known.first() else {
        return Ok(vec![vec![1.0 / places as f64; times_nanos.len()]; places]);
    };
    let local_of_day = |utc_nanos: i64| {
        let offset_nanos = i64::from(offset_secs(utc_nanos)) * 1_000_000_000;
        utc_nanos.saturating_add(offset_nanos).rem_euclid(DAY_NANOS)
    };
    let of_day = |utc_nanos: i64| (local_of_day(utc_nanos) / slot_nanos) as usize;
    // Slots follow each other in elapsed time from the slot with the oldest reading. A day may repeat or skip some, for
    // example when the clocks change.
    let start = oldest.utc_nanos - local_of_day(oldest.utc_nanos) % slot_nanos;
    let slot_at = |utc_nanos: i64| utc_nanos.saturating_sub(start).div_euclid(slot_nanos).max(0);
    let middle = |slot: i64| start.saturating_add(slot.saturating_mul(slot_nanos)).saturating_add(slot_nanos / 2);
    let now = slot_at(first_time);
    let mut rest = known.as_slice();
    for slot in 0..=now {
        if slot % 4096 == 0 {
            stop.check()?;
        }
        presence.advance(of_day(middle(slot)));
        let in_slot = rest.partition_point(|sighting| slot_at(sighting.utc_nanos) <= slot);
        let (seen, later) = rest.split_at(in_slot);
        for sighting in seen {
            presence.observe(sighting.place, sighting.is_there);
        }
        rest = later;
    }
    for _ in 0..STEPS {
        stop.check()?;
        presence.learn();
    }
    stop.check()?;
    let farthest = slot_at(last_time).min(now.saturating_add(READINGS_MAX_NANOS / slot_nanos));
    let forecast = presence.forecast((now + 1..=farthest).map(|slot| of_day(middle(slot))));
    let at = |utc_nanos: i64| match slot_at(utc_nanos).min(farthest) - now {
        ahead if ahead > 0 => forecast.get(ahead as usize - 1).map_or(presence.probabilities(), Vec::as_slice),
        _ => presence.probabilities(),
    };
    Ok((0..places).map(|place| times_nanos.iter().map(|&time| at(time)[place]).collect()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOUR: i64 = 3_600_000_000_000;
    /// Monday 2024-01-01, UTC.
    const MONDAY: i64 = 1_704_067_200_000_000_000;

    /// A person who is at home by night, in the office by day and in the canteen at noon; a robot observes one room
    /// every hour.
    fn place_at(utc_nanos: i64) -> usize {
        match utc_nanos.rem_euclid(DAY_NANOS) / HOUR {
            12 => 2,
            8..18 => 1,
            _ => 0,
        }
    }

    fn weeks(days: i64) -> Vec<Sighting> {
        let look = |hour: i64| {
            let utc_nanos = MONDAY + hour * HOUR + HOUR / 2;
            let place = (hour * 7 % 5 % 3) as usize;
            Sighting { utc_nanos, place, is_there: place_at(utc_nanos) == place }
        };
        (0..24 * days).map(look).collect()
    }

    fn series(sightings: &[Sighting], times: &[i64], offset_secs: i32) -> Vec<Vec<f64>> {
        presence_series(3, sightings, times, HOUR, |_| offset_secs, StopSignal::NEVER).unwrap()
    }

    #[test]
    fn the_routine_of_a_day_is_forecast_and_the_rows_sum_to_one() {
        let midnight = MONDAY + 28 * DAY_NANOS;
        let times: Vec<i64> = (0..24).map(|hour| midnight + hour * HOUR + HOUR / 2).collect();
        for offset_secs in [0, 3600, -5 * 3600] {
            let rows = series(&weeks(28), &times, offset_secs);
            for (at, &time) in times.iter().enumerate() {
                let total: f64 = rows.iter().map(|row| row[at]).sum();
                assert!((total - 1.0).abs() < 1e-9, "{total}");
                let likeliest = (0..3).max_by(|&a, &b| rows[a][at].total_cmp(&rows[b][at]));
                // A predicted change may be one slot early or late.
                let is_near = [time - HOUR, time, time + HOUR].map(place_at).contains(&likeliest.unwrap());
                assert!(is_near, "hour {at}: {:?}", rows.iter().map(|row| row[at]).collect::<Vec<_>>());
            }
            assert!(rows[0][3] > 0.8 && rows[1][10] > 0.6, "{rows:?}");
        }
    }

    #[test]
    fn a_fresh_reading_rules_out_the_other_places() {
        let now = MONDAY + 28 * DAY_NANOS + 10 * HOUR + HOUR / 2;
        let mut known = weeks(28);
        known.push(Sighting { utc_nanos: now, place: 0, is_there: true });
        let rows = series(&known, &[now, now + HOUR], 0);
        assert!(rows[0][0] > 0.99 && rows[1][0] < 0.01, "{rows:?}");
        // A reading after the first of the times changes nothing.
        known.push(Sighting { utc_nanos: now + 1, place: 1, is_there: true });
        assert_eq!(series(&known, &[now, now + HOUR], 0), rows);
    }

    #[test]
    fn without_readings_all_places_are_equally_likely() {
        let old = Sighting { utc_nanos: MONDAY - 2 * READINGS_MAX_NANOS, place: 0, is_there: true };
        for known in [vec![], vec![old]] {
            for row in series(&known, &[MONDAY, i64::MAX], 0) {
                assert!(row.iter().all(|p| (p - 1.0 / 3.0).abs() < 1e-12), "{row:?}");
            }
        }
        assert_eq!(series(&[], &[], 0), vec![Vec::<f64>::new(); 3]);
    }

    #[test]
    fn one_place_or_too_many_and_work_that_nobody_awaits_are_refused() {
        for places in [0, 1, 65] {
            let refused = presence_series(places, &[], &[MONDAY], HOUR, |_| 0, StopSignal::NEVER);
            assert!(matches!(refused, Err(PresenceError::CannotTrain(_))), "{refused:?}");
        }
        let is_set = || true;
        let stopped = presence_series(3, &weeks(1), &[MONDAY + DAY_NANOS], HOUR, |_| 0, StopSignal::new(&is_set));
        assert!(matches!(stopped, Err(PresenceError::Stopped(_))), "{stopped:?}");
    }
}
