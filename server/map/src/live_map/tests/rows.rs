//! Tests states that report changes and events: their learned data, and their current values.

use tidemap_model::{Hold, Sample};

use super::*;
use crate::{ids::NewProducer, row_samples::RequestedReadings};

mod bounded;
mod late;

const MINUTE: i64 = 60_000_000_000;
const DAY: i64 = 24 * HOUR;
/// The first day is a Monday.
const MONDAY: i64 = 4 * DAY;

fn hold(max: i64, step: i64) -> Hold {
    Hold::new((max / 1_000_000_000) as u32, (step / 1_000_000_000) as u32).expect("valid")
}

/// A map with a state, and its next log position.
struct Home {
    map: LiveMap,
    position: u64,
    sequence: u64,
}

impl Home {
    fn new(kind: StateKind, reporting: Reporting) -> Home {
        let mut map = LiveMap::new(spec());
        let name = StateName::new("door").expect("valid");
        let new = NewState { id: StateId(0), name, shape: kind.into(), labels: Vec::new(), sensor: None, reporting };
        map.apply(1, &Event::AddState(new)).expect("fits");
        Home { map, position: 1, sequence: 0 }
    }

    /// Sends rows, which arrive `late` after the last of them.
    fn observe(&mut self, rows: &[(i64, f64)], late: i64) {
        let mut observations = Observations::default();
        for &(utc_nanos, value) in rows {
            observations.push(StateId(0), Sample { utc_nanos, offset_secs: 0, value });
        }
        let newest = rows.iter().map(|(nanos, _)| *nanos).max().unwrap_or(0);
        let first = self.sequence + 1;
        self.sequence += rows.len() as u64;
        let key = ProducerKey::new("gateway", "").expect("valid");
        let envelope = Envelope {
            producer: ProducerId(0),
            new_producer: (first == 1).then_some(NewProducer { key, sensor: None, introduced_by: String::new() }),
            incarnation: 1,
            span: SequenceSpan { first, last: self.sequence, content_crc: 1 },
            received_nanos: newest + late,
            refused: Vec::new(),
        };
        self.position += 1;
        self.map.apply(self.position, &Event::Observations(envelope, observations)).expect("fits");
    }

    fn update(&mut self, until: i64) {
        let start = self.map.plan_update(Some(until), until, UpdateCause::Request);
        self.position += 1;
        let work = self.map.apply(self.position, &Event::UpdateStart(start)).expect("fits").expect("work");
        let result = work.run(&AtomicU64::new(0)).expect("in memory");
        self.map.finish_update(result);
    }

    fn predict(&mut self, now: Option<i64>, at: i64, selector: &str) -> f64 {
        let view = self.map.publish();
        let view = now.map_or_else(|| view.clone(), |now| view.as_of(now));
        let mut out = [0.0];
        let selector: ModelSelector = selector.parse().expect("a model");
        view.predict_into(StateId(0), &view.prepare(&[at]), selector, &mut out);
        out[0]
    }
}

/// A door that opens at nine and closes at five, for some days.
fn office_hours(days: i64) -> Vec<(i64, f64)> {
    (0..days).flat_map(|day| [(MONDAY + day * DAY + 9 * HOUR, 1.0), (MONDAY + day * DAY + 17 * HOUR, 0.0)]).collect()
}

#[test]
fn changes_are_learned_as_the_values_that_hold_between_them() {
    let mut home = Home::new(StateKind::Probability, Reporting::Changes(hold(7 * DAY, 5 * MINUTE)));
    let mut sampled = Home::new(StateKind::Probability, Reporting::Samples);
    for day in 0..14 {
        let rows: Vec<(i64, f64)> = office_hours(15).into_iter().skip(2 * day).take(2).collect();
        home.observe(&rows, HOUR);
        let from = if day == 0 { MONDAY + 9 * HOUR } else { MONDAY + day as i64 * DAY };
        let readings = (from..MONDAY + (day as i64 + 1) * DAY).step_by(5 * MINUTE as usize);
        let open = |at: i64| f64::from(u8::from((9..17).contains(&(at.rem_euclid(DAY) / HOUR))));
        sampled.observe(&readings.map(|at| (at, open(at))).collect::<Vec<_>>(), HOUR);
        // The first row of the next day shows that nothing happened in the night.
        if day < 13 {
            continue;
        }
        home.observe(&office_hours(15)[28..29], HOUR);
        home.update(MONDAY + 14 * DAY);
        sampled.update(MONDAY + 14 * DAY);
    }
    let view = home.map.publish();
    assert_eq!(
        view.model(StateId(0)).accumulator().observations(),
        sampled.map.publish().model(StateId(0)).accumulator().observations()
    );
    assert_eq!((view.live(StateId(0)).observations, view.pending_of(StateId(0))), (29, 1));
    for hour in 0..24 {
        let at = MONDAY + 14 * DAY + hour * HOUR + 30 * MINUTE;
        let (held, expected) = (home.predict(None, at, "ensemble"), sampled.predict(None, at, "ensemble"));
        assert!((held - expected).abs() < 1e-9, "{held} {expected} at {hour}");
        assert!((held - f64::from(u8::from((9..17).contains(&hour)))).abs() < 0.1, "{held} at {hour}");
    }
}

#[test]
fn what_a_sensor_shows_now_is_known_as_long_as_its_last_change_holds() {
    let mut home = Home::new(StateKind::Probability, Reporting::Changes(hold(DAY, 5 * MINUTE)));
    home.observe(&office_hours(7), HOUR / 2);
    home.update(MONDAY + 7 * DAY);
    home.observe(&[(MONDAY + 7 * DAY + 9 * HOUR, 1.0)], 0);
    let now = MONDAY + 7 * DAY + 15 * HOUR;
    let newest = |home: &mut Home, now| home.map.publish().as_of(now).live(StateId(0)).persistence.last();
    assert_eq!(newest(&mut home, now), Some((now, 1.0)));
    // The long-term model does not expect the door to be open in the evening, but it still is.
    let evening = MONDAY + 7 * DAY + 20 * HOUR;
    assert!(home.predict(Some(evening), evening, "ensemble") < 0.2);
    assert!(home.predict(Some(evening), evening, "auto") > 0.8);
    assert_eq!(home.predict(Some(evening), evening - HOUR, "auto"), home.predict(Some(evening), evening, "auto"));
    // A value holds no longer than its maximum time, and not at all in a recording that arrived later.
    assert_eq!(newest(&mut home, now + 5 * DAY), Some((MONDAY + 8 * DAY + 9 * HOUR, 1.0)));
    let mut recording = Home::new(StateKind::Probability, Reporting::Changes(hold(DAY, 5 * MINUTE)));
    recording.observe(&office_hours(7), 30 * DAY);
    let last = MONDAY + 6 * DAY + 17 * HOUR;
    assert_eq!(newest(&mut recording, last + HOUR), Some((last, 0.0)));
    // The sensor is gone.
    home.observe(&[(now, f64::NAN)], 0);
    assert_eq!(newest(&mut home, now + HOUR), Some((now, 1.0)));
}

#[test]
fn the_rows_of_a_snapshot_go_on_where_they_were() {
    let reporting = Reporting::Changes(hold(7 * DAY, 5 * MINUTE));
    let mut whole = Home::new(StateKind::Probability, reporting);
    whole.observe(&office_hours(5), HOUR);
    let start = whole.map.plan_update(Some(MONDAY + 4 * DAY), MONDAY + 9 * DAY, UpdateCause::Request);
    let work = whole.map.apply(3, &Event::UpdateStart(start)).expect("fits").expect("work");
    let snapshot = whole.map.finish_update(work.run(&AtomicU64::new(0)).expect("in memory"));
    whole.position = 3;
    let mut restored = LiveMap::restore(Arc::clone(whole.map.spec()), snapshot);
    let mut observations = Observations::default();
    for (utc_nanos, value) in office_hours(5) {
        observations.push(StateId(0), Sample { utc_nanos, offset_secs: 0, value });
    }
    let key = ProducerKey::new("gateway", "").expect("valid");
    let envelope = Envelope {
        producer: ProducerId(0),
        new_producer: Some(NewProducer { key, sensor: None, introduced_by: String::new() }),
        incarnation: 1,
        span: SequenceSpan { first: 1, last: 10, content_crc: 1 },
        received_nanos: MONDAY + 4 * DAY + 18 * HOUR,
        refused: Vec::new(),
    };
    restored.recover_pending(2, &Event::Observations(envelope, observations)).expect("fits");
    let mut restored = Home { map: restored, position: 3, sequence: 10 };
    for home in [&mut whole, &mut restored] {
        home.observe(&[(MONDAY + 5 * DAY + 9 * HOUR, 1.0)], HOUR);
        home.update(MONDAY + 6 * DAY);
    }
    let [whole, restored] = [whole, restored].map(|mut home| home.map.publish());
    assert_eq!(whole.model(StateId(0)), restored.model(StateId(0)));
    assert_eq!(whole.live(StateId(0)), restored.live(StateId(0)));
}

#[test]
fn events_are_learned_as_their_number_in_each_step() {
    let mut home = Home::new(StateKind::Count, Reporting::Events(hold(7 * DAY, HOUR)));
    let events = (0..14).flat_map(|day| (0..4).map(move |n| (MONDAY + day * DAY + 12 * HOUR + n * 10 * MINUTE, 1.0)));
    home.observe(&events.collect::<Vec<_>>(), HOUR);
    home.update(MONDAY + 14 * DAY);
    let at = |hour: i64| MONDAY + 14 * DAY + hour * HOUR;
    let noon = home.predict(None, at(12), "auto");
    assert!(noon > 2.5 && noon < 4.2, "{noon}");
    assert!(home.predict(None, at(3), "auto") < 0.5);
    let view = home.map.publish();
    // The readings are from the first noon to the last, whose hour has not ended.
    assert_eq!(view.model(StateId(0)).accumulator().observations(), 13 * 24);
    assert_eq!((view.live(StateId(0)).observations, view.pending_of(StateId(0))), (56, 0));
}

#[test]
fn no_more_readings_are_made_of_rows_than_requested() {
    let mut home = Home::new(StateKind::Probability, Reporting::Changes(hold(7 * DAY, MINUTE)));
    home.observe(&office_hours(3), HOUR);
    let view = home.map.publish();
    let rows = office_hours(3);
    let within = |hours: std::ops::Range<i64>, at_most| RequestedReadings {
        within_nanos: MONDAY + hours.start * HOUR..MONDAY + hours.end * HOUR,
        at_most,
    };
    let open = |minute: i64| (MONDAY + 16 * HOUR + minute * MINUTE, if minute < 60 { 1.0 } else { 0.0 });
    let two_hours: Vec<(i64, f64)> = (0..120).map(open).collect();
    assert_eq!(view.observed_readings(StateId(0), rows.clone(), &within(16..18, 1_000)), two_hours);
    assert_eq!(view.observed_readings(StateId(0), rows.clone(), &within(16..18, 7)), two_hours[..7]);
    assert_eq!(view.pending_readings(StateId(0), rows.clone(), &within(16..18, 7)), two_hours[..7]);
    home.update(MONDAY + 4 * DAY);
    let view = home.map.publish();
    assert_eq!(view.learned_readings(StateId(0), rows, &within(16..18, 7)), two_hours[..7]);
}

#[test]
fn an_interval_that_cuts_a_step_sees_all_its_events() {
    let mut home = Home::new(StateKind::Count, Reporting::Events(hold(DAY, HOUR)));
    let rows: Vec<(i64, f64)> = (0..30).map(|n| (MONDAY + n * 10 * MINUTE, 1.0)).collect();
    home.observe(&rows, HOUR);
    let view = home.map.publish();
    let within_nanos = MONDAY + 2 * HOUR..MONDAY + 3 * HOUR + 10 * MINUTE;
    let about = view.rows_about(StateId(0), &within_nanos);
    let rows = rows.into_iter().filter(|(nanos, _)| about.contains(nanos)).collect();
    let found = view.observed_readings(StateId(0), rows, &RequestedReadings { within_nanos, at_most: 9 });
    assert_eq!(found, [(MONDAY + 2 * HOUR, 6.0), (MONDAY + 3 * HOUR, 6.0)]);
}
