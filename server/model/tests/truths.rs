//! Tests on simulated truths: the nightly choice on states with a known routine, with every model enabled.
//!
//! Each state is updated day by day, as in the daemon: an update after each day, and models trained on the readings of
//! the last twelve weeks when they are due. The result is the error of the model in force on each day, before it learns
//! that day. Invariant: everything is drawn from seeds, so that every run has the same days.

#![allow(clippy::unwrap_used)]

use tidemap_model::catalogue::{HISTOGRAMS, ModelKind, TRAINED_AT_NIGHT};
use tidemap_model::models::{Readings, TemporalModel};
use tidemap_model::{EnabledModels, LocalDay, ORDER_MAX, Periodicities, Sample, StateKind, StateModel, UpdateRules};

/// A reading every ten minutes.
const SLOT_NANOS: i64 = 600_000_000_000;
const SLOTS: i64 = 144;
/// The training data of the models.
const TRAINING_DAYS: i64 = 84;

/// A pseudo-random number in `[0,1)`.
fn noise(seed: i64) -> f64 {
    let mut mixed = (seed as u64).wrapping_add(0x9E37_79B9_7F4A_7C15);
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((mixed ^ (mixed >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}

fn chance(seed: i64, probability: f64) -> bool {
    noise(seed) < probability
}

fn is_weekday(day: i64) -> bool {
    // 1970-01-01 was a Thursday.
    (day + 3).rem_euclid(7) < 5
}

/// The names of the candidates.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Candidate {
    Mean,
    /// The order that was in force.
    Spectral,
    Histogram(usize),
    Trained(ModelKind),
}

/// Mean squared errors of a day, each of predictions made before it.
#[derive(Clone, Debug)]
struct Day {
    choice: ModelKind,
    order: usize,
    in_force: f64,
    candidates: Vec<(Candidate, f64)>,
}

/// A state with the errors of its days.
struct Run {
    state: StateModel,
    days: Vec<Day>,
}

fn day_of(day: i64, value: &impl Fn(i64, i64) -> f64) -> Vec<Sample> {
    let sample =
        |slot| Sample { utc_nanos: (day * SLOTS + slot) * SLOT_NANOS, offset_secs: 0, value: value(day, slot) };
    (0..SLOTS).map(sample).collect()
}

fn mse(model: &dyn TemporalModel, samples: &[Sample]) -> f64 {
    let sum: f64 = samples.iter().map(|sample| (model.predict(sample.moment()) - sample.value).powi(2)).sum();
    sum / samples.len() as f64
}

/// `days` days of a truth, which gives the value by day and slot of the day.
fn run(kind: StateKind, days: i64, value: impl Fn(i64, i64) -> f64) -> Run {
    let periodicities = Periodicities::default();
    let rules = UpdateRules { models: EnabledModels::ALL.without_ensemble(), ..UpdateRules::default() };
    let mut run = Run { state: StateModel::of_kind(kind), days: Vec::new() };
    let mut seen = Vec::new();
    for day in 0..days {
        let today = day_of(day, &value);
        let before = run.state.clone();
        let outcome = run.state.update(&periodicities, rules, today.clone());
        run.days.push(report(&before, &outcome.squared_errors, outcome.squared_error_in_force, &today));
        seen.extend(today);
        seen.drain(..seen.len().saturating_sub((TRAINING_DAYS * SLOTS) as usize));
        // The daemon does the same: after a change, the old routine is not used.
        let since = run.state.alternatives().and_then(|known| known.training_since());
        seen.retain(|sample: &Sample| since.is_none_or(|since| sample.local_day() >= since));
        for model_kind in TRAINED_AT_NIGHT {
            if run.state.is_training_due(model_kind) {
                let model = model_kind.train(Readings::new(&seen), kind, &periodicities).unwrap();
                run.state = run.state.with_trained(model, LocalDay(day as i32));
            }
        }
    }
    run
}

fn report(before: &StateModel, orders: &[f64; ORDER_MAX + 1], in_force: f64, today: &[Sample]) -> Day {
    let count = today.len() as f64;
    let mut candidates =
        vec![(Candidate::Mean, orders[0] / count), (Candidate::Spectral, orders[before.order()] / count)];
    if let Some(known) = before.alternatives() {
        for (number, kind) in HISTOGRAMS.into_iter().enumerate() {
            let (cycle, bins) = kind.histogram().unwrap();
            let histogram = known.hours().histogram(cycle, bins).unwrap();
            candidates.push((Candidate::Histogram(number), mse(&histogram, today)));
        }
        for kind in TRAINED_AT_NIGHT {
            if let Some((model, _)) = known.trained(kind) {
                candidates.push((Candidate::Trained(kind), mse(model, today)));
            }
        }
    }
    Day { choice: before.choice(), order: before.order(), in_force: in_force / count, candidates }
}

impl Run {
    /// Mean error of the model in force over some days.
    fn in_force(&self, days: std::ops::Range<usize>) -> f64 {
        let days = &self.days[days];
        days.iter().map(|day| day.in_force).sum::<f64>() / days.len() as f64
    }

    /// Mean errors of all candidates over some days, lowest first.
    fn candidates(&self, days: std::ops::Range<usize>) -> Vec<(Candidate, f64)> {
        let days = &self.days[days];
        let all = days[0].candidates.iter().map(|&(candidate, _)| candidate);
        let mut errors: Vec<(Candidate, f64)> = all
            .map(|wanted| {
                let of_day = |day: &Day| day.candidates.iter().find(|(found, _)| *found == wanted).unwrap().1;
                (wanted, days.iter().map(of_day).sum::<f64>() / days.len() as f64)
            })
            .collect();
        errors.sort_by(|one, other| one.1.total_cmp(&other.1));
        errors
    }

    fn error_of(&self, wanted: Candidate, days: std::ops::Range<usize>) -> f64 {
        self.candidates(days).into_iter().find(|(found, _)| *found == wanted).unwrap().1
    }

    /// The model in force is as good as the best of all, within a share.
    fn assert_right(&self, days: std::ops::Range<usize>, share: f64) {
        let (in_force, candidates) = (self.in_force(days.clone()), self.candidates(days));
        assert!(in_force <= candidates[0].1 * (1.0 + share), "{in_force} in force, {candidates:?}");
    }

    /// The model in force is better than some by a factor.
    fn assert_beats(&self, days: std::ops::Range<usize>, factor: f64, wrong: &[Candidate]) {
        for &wrong in wrong {
            let (in_force, error) = (self.in_force(days.clone()), self.error_of(wrong, days.clone()));
            assert!(in_force * factor < error, "{in_force} in force, {wrong:?} {error}");
        }
    }

    /// Asserts that from the first week on the mean was in force, on all days.
    fn assert_mean(&self) {
        for (number, day) in self.days.iter().enumerate().skip(7) {
            assert_eq!((day.choice, day.order), (ModelKind::Spectral, 0), "day {number}");
        }
    }
}

fn flag(value: bool) -> f64 {
    f64::from(u8::from(value))
}

const PERGAM: Candidate = Candidate::Trained(ModelKind::PERGAM);

#[test]
fn one_short_daily_event() {
    // The state is on for half an hour a day, on most days.
    let run =
        run(StateKind::Probability, 70, |day, slot| flag((76..79).contains(&slot) && chance(day * SLOTS + slot, 0.9)));
    run.assert_right(42..70, 0.03);
    run.assert_beats(
        42..70,
        2.0,
        &[Candidate::Mean, Candidate::Spectral, Candidate::Histogram(0), Candidate::Histogram(2)],
    );
}

#[test]
fn two_events_a_day() {
    // Each event is three quarters of an hour long, up to half an hour later and earlier on some days.
    let run = run(StateKind::Probability, 70, |day, slot| {
        let shift = (4.0 * noise(day)) as i64;
        flag((45..49).contains(&(slot - shift)) || (105..110).contains(&(slot + shift)))
    });
    run.assert_right(42..70, 0.03);
    run.assert_beats(42..70, 1.3, &[Candidate::Mean, Candidate::Histogram(0), Candidate::Histogram(2)]);
}

#[test]
fn weekdays_only() {
    let run = run(StateKind::Probability, 70, |day, slot| {
        flag(is_weekday(day) && (54..102).contains(&slot) && chance(day * SLOTS + slot, 0.9))
    });
    run.assert_right(42..70, 0.03);
    run.assert_beats(42..70, 2.0, &[Candidate::Mean, Candidate::Histogram(0), PERGAM]);
}

/// The candidates that weight all days equally: they react late to a level that drifts. A model that follows the last
/// weeks is right.
const LAGGING: [Candidate; 4] =
    [Candidate::Mean, Candidate::Spectral, Candidate::Histogram(0), Candidate::Histogram(2)];

#[test]
fn a_level_that_rises() {
    let rising = run(StateKind::Continuous, 70, |day, slot| 10.0 + 0.1 * day as f64 + noise(day * SLOTS + slot));
    rising.assert_right(42..70, 0.03);
    rising.assert_beats(42..70, 1.4, &LAGGING);
}

#[test]
fn a_state_that_becomes_likelier() {
    let likelier =
        run(StateKind::Probability, 90, |day, slot| flag(chance(day * SLOTS + slot, 0.1 + 0.008 * day as f64)));
    likelier.assert_right(62..90, 0.03);
    likelier.assert_beats(62..90, 1.15, &LAGGING);
}

#[test]
fn an_abrupt_change_of_routine() {
    // The state is on for two hours in the morning, and from the eighth week on as long in the afternoon.
    let change = 56;
    let run = run(StateKind::Probability, 105, |day, slot| {
        let hours = if day < change { 54..66 } else { 96..108 };
        flag(hours.contains(&slot) && chance(day * SLOTS + slot, 0.95))
    });
    let change = change as usize;
    // After two weeks it is far better than models that remember the old routine. After four weeks the rest of the
    // error is mostly noise.
    run.assert_beats(
        change + 14..change + 28,
        4.0,
        &[Candidate::Mean, Candidate::Histogram(0), Candidate::Histogram(2)],
    );
    let (recovered, unavoidable) = (change + 28..change + 49, 12.0 * 0.95 * 0.05 / SLOTS as f64);
    run.assert_right(recovered.clone(), 0.2);
    let recovered = run.in_force(recovered);
    assert!(recovered < 2.5 * unavoidable, "{recovered}, {unavoidable} by chance");
    // The model in force is never much worse than the mean: for four days the change cannot be distinguished from
    // unusual days.
    let (in_force, mean) = (run.in_force(change..change + 14), run.error_of(Candidate::Mean, change..change + 14));
    assert!(in_force < 1.6 * mean, "{in_force}, mean {mean}");
}

#[test]
fn pure_noise_has_the_mean() {
    run(StateKind::Probability, 60, |day, slot| flag(chance(day * SLOTS + slot, 0.4))).assert_mean();
    run(StateKind::Continuous, 60, |day, slot| noise(day * SLOTS + slot)).assert_mean();
}

#[test]
fn what_never_changes_has_the_mean() {
    for (kind, value) in [
        (StateKind::Probability, 0.0),
        (StateKind::Probability, 0.3),
        (StateKind::Probability, 1.0),
        (StateKind::Continuous, -4.7),
        (StateKind::Count, 7.0),
    ] {
        let run = run(kind, 30, |_, _| value);
        run.assert_mean();
        assert!(run.in_force(1..30) < 1e-20, "{kind:?} {value}");
    }
}

/// `cargo test -p tidemap-model --test truths -- --ignored --nocapture`
#[test]
#[ignore = "a measurement"]
fn how_long_a_training_and_a_day_take() {
    let minutes = |days: std::ops::Range<i64>, state_kind: StateKind| -> Vec<Sample> {
        let sample = |minute: i64| {
            let (day, of_day) = (minute.div_euclid(1440), minute.rem_euclid(1440));
            let open = is_weekday(day) && (540..1020).contains(&of_day) && chance(minute / 7, 0.9);
            let value =
                if state_kind == StateKind::Probability { flag(open) } else { 20.0 + flag(open) + noise(minute) };
            Sample { utc_nanos: minute * 60_000_000_000, offset_secs: 0, value }
        };
        (days.start * 1440..days.end * 1440).map(sample).collect()
    };
    for state_kind in [StateKind::Probability, StateKind::Continuous] {
        let (seen, next) =
            (minutes(0..TRAINING_DAYS, state_kind), minutes(TRAINING_DAYS..TRAINING_DAYS + 1, state_kind));
        for kind in TRAINED_AT_NIGHT.into_iter().filter(|kind| kind.supports(state_kind)) {
            let started = std::time::Instant::now();
            let model = kind.train(Readings::new(&seen), state_kind, &Periodicities::default()).unwrap();
            let trained = started.elapsed();
            let started = std::time::Instant::now();
            let error = mse(&model, &next);
            println!(
                "{state_kind:?} {kind:?}: training {trained:?}, a day of minutes {:?}, error {error:.4}",
                started.elapsed()
            );
        }
    }
}
