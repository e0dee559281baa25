//! Tests on the office door of RA-L 2019: ten weeks to learn from, four to predict. The expected figures come from an
//! independent implementation. The tests are skipped without the recordings.

#![allow(clippy::unwrap_used)]

use std::path::Path;

#[path = "recordings/door_figures.rs"]
mod door_figures;
#[path = "recordings/folder.rs"]
mod folder;
use door_figures::{COMPONENTS, ERRORS, ORDERS, TOLERANCE};
use folder::recordings;

use tidemap_model::catalogue::ModelKind;
use tidemap_model::{
    Accumulator, LocalDay, ORDER_MAX, OrderCriterion, OrderErrors, Periodicities, Sample, SpectralModel, StateModel,
    Zone, evaluate,
    models::{Calibrated, CalibratedOptions, Readings},
};

/// The rows `time,state,value` of a recording, as observed in a zone.
fn read(folder: &Path, name: &str, zone: &Zone) -> Vec<Sample> {
    let text = std::fs::read_to_string(folder.join(name)).unwrap();
    let mut offsets = zone.offset_cache();
    text.lines()
        .skip(1)
        .map(|row| {
            let mut fields = row.split(',');
            let utc_nanos = fields.next().unwrap().parse::<i64>().unwrap() * 1_000_000_000;
            let value = fields.nth(1).unwrap().parse().unwrap();
            Sample { utc_nanos, offset_secs: offsets.offset_secs(utc_nanos), value }
        })
        .collect()
}

fn trained(samples: &[Sample]) -> SpectralModel {
    let week = Periodicities::default();
    let mut accumulator = Accumulator::new(&week);
    accumulator.add(&week, samples);
    SpectralModel::train(&accumulator, &week)
}

#[track_caller]
fn check_mse(model: &SpectralModel, samples: &[Sample], orders: &[usize], expected: &[f64]) {
    let found = evaluate(model, &Periodicities::default(), samples, ORDER_MAX);
    for (&order, &expected) in orders.iter().zip(expected) {
        let mse = found[order].mse();
        assert!((mse - expected).abs() <= TOLERANCE, "order {order}: {mse:.5}, expected {expected:.5}");
    }
}

#[test]
fn predictions_are_as_good_as_the_reference() {
    let Some(folder) = recordings("door") else { return };
    let london = Zone::named("Europe/London").unwrap();
    let model = trained(&read(&folder, "train.csv", &london));
    for (name, _, expected) in ERRORS {
        check_mse(&model, &read(&folder, name, &london), &ORDERS, &expected);
    }
}

#[test]
fn the_door_has_a_daily_and_a_weekly_rhythm() {
    let Some(folder) = recordings("door") else { return };
    let model = trained(&read(&folder, "train.csv", &Zone::named("Europe/London").unwrap()));
    for (component, (period_secs, amplitude)) in model.components().iter().zip(COMPONENTS) {
        let found = Periodicities::default().period_secs(component.periodicity as usize);
        assert!((found - period_secs).abs() < 1e-6, "{found}, expected {period_secs}");
        assert!((component.amplitude() - amplitude).abs() <= 0.00006, "{}", component.amplitude());
    }
}

#[test]
fn a_map_in_utc_misses_the_change_to_summer_time() {
    let Some(folder) = recordings("door") else { return };
    let utc = Zone::utc();
    let model = trained(&read(&folder, "train.csv", &utc));
    for (name, expected) in [("week2.csv", 0.06884), ("week3.csv", 0.07562), ("week4.csv", 0.07402)] {
        check_mse(&model, &read(&folder, name, &utc), &[2], &[expected]);
    }
}

/// Mean squared errors of the next day, from the fifteenth day on: mean over days, over observations.
fn next_day_errors(days: &[Vec<Sample>], mut next_order: impl FnMut(LocalDay, &StateModel) -> usize) -> (f64, f64) {
    let week = Periodicities::default();
    let mut state = StateModel::new(&week);
    let (mut mean_sum, mut squared_sum, mut days_scored, mut scored) = (0.0, 0.0, 0.0, 0.0);
    for (index, day) in days.iter().enumerate() {
        let order = next_order(day[0].local_day(), &state);
        let outcome = state.update(&week, OrderCriterion::SquaredError, day.clone());
        if index >= 14 {
            let observations = outcome.scored as f64;
            mean_sum += outcome.squared_errors[order] / observations;
            squared_sum += outcome.squared_errors[order];
            days_scored += 1.0;
            scored += observations;
        }
    }
    (mean_sum / days_scored, squared_sum / scored)
}

/// Mean squared errors of the next day, from the fifteenth day on, over observations: of the best order, and of the
/// model in force. If `is_trained` is false, the calibrated model is never trained.
fn next_day_in_force(samples: &[Sample], is_trained: bool) -> (f64, f64, StateModel) {
    let week = Periodicities::default();
    let mut state = StateModel::new(&week);
    let (mut of_order, mut of_model, mut scored) = (0.0, 0.0, 0.0);
    let mut seen = 0;
    for (index, day) in samples.chunk_by(|a, b| a.local_day() == b.local_day()).enumerate() {
        let order = state.order();
        let outcome = state.update(&week, OrderCriterion::SquaredError, day.to_vec());
        seen += day.len();
        if is_trained && state.is_training_due(ModelKind::Calibrated) {
            let model = Calibrated::train(Readings::new(&samples[..seen]), CalibratedOptions::default()).unwrap();
            state = state.with_trained(model, day[0].local_day());
        }
        if index >= 14 {
            of_order += outcome.squared_errors[order];
            of_model += outcome.squared_error_in_force;
            scored += outcome.scored as f64;
        }
    }
    (of_order / scored, of_model / scored, state)
}

#[test]
fn the_chosen_model_predicts_the_next_day() {
    let Some(folder) = recordings("door") else { return };
    let samples = read(&folder, "train.csv", &Zone::named("Europe/London").unwrap());
    let (of_order, without, _) = next_day_in_force(&samples, false);
    let (_, with, state) = next_day_in_force(&samples, true);
    println!(
        "next day: chosen order {of_order:.5}, chosen among spectrum and histograms {without:.5}, and calibrated {with:.5}; \
         at last {:?}",
        state.choice()
    );
    // On this door histograms and spectrum are equally good, within noise.
    assert!(without <= 0.0675, "{without:.5}, order {of_order:.5}");
    assert!(with < of_order && with < without, "{with:.5}, order {of_order:.5}, without {without:.5}");
}

#[test]
fn the_chosen_order_predicts_the_next_day() {
    let Some(folder) = recordings("door") else { return };
    let samples = read(&folder, "train.csv", &Zone::named("Europe/London").unwrap());
    let days: Vec<Vec<Sample>> =
        samples.chunk_by(|a, b| a.local_day() == b.local_day()).map(<[Sample]>::to_vec).collect();

    let (by_day, by_observation) = next_day_errors(&days, |_, state| state.order());
    // The rule without memory chooses the order that was best on the last day alone.
    let mut earlier = OrderErrors::default();
    let (last_day_alone, _) = next_day_errors(&days, |_, state| {
        let faded = earlier
            .last_day()
            .zip(state.errors().last_day())
            .map_or(0.0, |(before, now)| if now > before { 0.93 } else { 1.0 });
        let mut day_errors = [0.0; ORDER_MAX + 1];
        for (order, error) in day_errors.iter_mut().enumerate() {
            *error = state.errors().sums()[order] - earlier.sums()[order] * faded;
        }
        earlier = *state.errors();
        let mut last_day = OrderErrors::default();
        last_day.record(LocalDay(0), &day_errors);
        last_day.best()
    });
    println!(
        "next day: {by_day:.5} over days, {by_observation:.5} over observations, last day alone {last_day_alone:.5}"
    );
    assert!(by_day <= 0.0675, "{by_day:.5}");
    assert!(by_observation <= 0.0675, "{by_observation:.5}");
    assert!(by_day < last_day_alone - 0.005, "{by_day:.5}, last day alone {last_day_alone:.5}");
}
