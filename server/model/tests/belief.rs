//! Tests predictions from the newest readings, on recordings: features of a room that come and go while a detector
//! errs, and the office door. They are skipped without the recordings.

#![allow(clippy::unwrap_used)]

use std::{io::Read as _, path::Path};

#[path = "recordings/folder.rs"]
mod folder;
use folder::recordings;

use tidemap_model::{
    KnownAtNewest, OrderCriterion, Periodicities, Persistence, Recent, Sample, StateModel, Zone,
    models::{Calibrated, CalibratedOptions, Moment, Readings, TemporalModel as _},
};

const SEC: i64 = 1_000_000_000;

/// The readings of a feature of the room.
fn readings(folder: &Path, name: &str, state: &str) -> Vec<Sample> {
    let mut text = String::new();
    let file = std::fs::File::open(folder.join(name)).unwrap();
    flate2::read::GzDecoder::new(file).read_to_string(&mut text).unwrap();
    rows(&text, state)
}

/// The rows `time,state,value` of a state, in UTC.
fn rows(text: &str, state: &str) -> Vec<Sample> {
    let row = |row: &str| {
        let mut fields = row.split(',');
        let secs: f64 = fields.next()?.parse().ok()?;
        let is_it = fields.next()? == state;
        let sample = Sample { utc_nanos: (secs * 1e9) as i64, offset_secs: 0, value: fields.next()?.parse().ok()? };
        is_it.then_some(sample)
    };
    text.lines().skip(1).filter_map(row).collect()
}

/// Share of right predictions, and mean squared error.
#[derive(Clone, Copy, Debug, Default)]
struct Score {
    count: f64,
    right: f64,
    squares: f64,
}

impl Score {
    fn add(&mut self, predicted: f64, truth: f64) {
        self.count += 1.0;
        self.right += f64::from(u8::from((predicted >= 0.5) == (truth >= 0.5)));
        self.squares += (predicted - truth).powi(2);
    }
}

fn not_learned(predicted: f64) -> KnownAtNewest {
    KnownAtNewest { predicted, is_learned: false }
}

/// The scores of a feature of the room, learned from one recording and tested on another, by lead time in seconds.
fn room(folder: &Path, state: &str, ahead_secs: &[i64]) -> Vec<Score> {
    let periodicities = Periodicities::default();
    let mut model = StateModel::new(&periodicities);
    model.update(&periodicities, OrderCriterion::SquaredError, readings(folder, "train.csv.gz", state));
    let truth = rows(&std::fs::read_to_string(folder.join("test_truth.csv")).unwrap(), state);
    let truth_at = |nanos: i64| truth[truth.partition_point(|row| row.utc_nanos <= nanos) - 1].value;
    let test = readings(folder, "test.csv.gz", state);
    let end = test.last().unwrap().utc_nanos;
    let mut scores = vec![Score::default(); ahead_secs.len()];
    let (mut recent, mut newest) = (Recent::default(), None);
    let mut origin = test[0].utc_nanos;
    for sample in &test {
        while let Some(newest) = newest.filter(|_| sample.utc_nanos > origin) {
            let moments: Vec<Moment> =
                ahead_secs.iter().map(|secs| Moment { utc_nanos: origin + secs * SEC, offset_secs: 0 }).collect();
            let mut out = vec![model.spectral().mean(); moments.len()];
            let known = not_learned(model.spectral().mean());
            model.belief().unwrap().blend_into(&recent, newest, known, &moments, &mut out);
            for ((score, moment), predicted) in scores.iter_mut().zip(&moments).zip(out) {
                if moment.utc_nanos <= end {
                    score.add(predicted, truth_at(moment.utc_nanos));
                }
            }
            origin += 10 * SEC;
        }
        recent.observe(sample.utc_nanos, sample.value);
        newest = Some((sample.utc_nanos, sample.value));
    }
    scores
}

#[test]
fn a_detector_that_errs_is_seen_through() {
    let Some(folder) = recordings("room") else { return };
    let scores = ["l0", "l2"].map(|state| room(&folder, state, &[0, 60, 300]));
    let mean =
        |at: usize, figure: fn(&Score) -> f64| scores.iter().map(|scores| figure(&scores[at])).sum::<f64>() / 2.0;
    let (right, brier) = (|score: &Score| score.right / score.count, |score: &Score| score.squares / score.count);
    assert!(mean(0, right) >= 0.98, "{scores:?}");
    assert!(mean(1, brier) <= 0.07, "{scores:?}");
    assert!(mean(2, brier) <= 0.15, "{scores:?}");
}

#[test]
fn the_newest_reading_of_the_door_counts_by_lag() {
    let Some(folder) = recordings("door") else { return };
    let london = Zone::named("Europe/London").unwrap();
    let mut offsets = london.offset_cache();
    let mut read = |name: &str| {
        let mut rows = rows(&std::fs::read_to_string(folder.join(name)).unwrap(), "door");
        rows.iter_mut().for_each(|sample| sample.offset_secs = offsets.offset_secs(sample.utc_nanos));
        rows
    };
    let periodicities = Periodicities::default();
    let train = read("train.csv");
    let mut model = StateModel::new(&periodicities);
    for week in train.chunk_by(|one, next| (one.local_day().0 + 3) / 7 == (next.local_day().0 + 3) / 7) {
        model.update(&periodicities, OrderCriterion::SquaredError, week.to_vec());
        let seen = &train[..train.partition_point(|sample| sample.utc_nanos <= week.last().unwrap().utc_nanos)];
        let calibrated = Calibrated::train(Readings::new(seen), CalibratedOptions::default());
        model = model.with_trained(calibrated.unwrap(), week.last().unwrap().local_day());
    }
    let test: Vec<Sample> = (1..=4).flat_map(|week| read(&format!("week{week}.csv"))).collect();
    let minutes = [1, 15, 60, 1440];
    let mut scores = [[Score::default(); 3]; 4];
    let (basis, mut recent, mut persistence) = (model.memory_basis(), Recent::default(), Persistence::default());
    for (at, sample) in test.iter().enumerate() {
        recent.observe(sample.utc_nanos, sample.value);
        persistence.observe(sample.utc_nanos, sample.value);
        for (score, ahead) in scores.iter_mut().zip(minutes).filter(|_| at % 15 == 0) {
            let nanos = sample.utc_nanos + ahead * 60 * SEC;
            let Ok(target) = test.binary_search_by_key(&nanos, |sample| sample.utc_nanos) else { continue };
            let (moment, truth) = (test[target].moment(), test[target].value);
            let habit = |at: Moment| match model.chosen(&periodicities) {
                Some(chosen) => chosen.predict(at),
                None => model.spectral().predict(&periodicities, model.order(), at.civil_nanos()),
            };
            let auto = habit(moment);
            let mut blended = [auto];
            let now = not_learned(habit(sample.moment()));
            model.belief().unwrap().blend_into(&recent, persistence.last().unwrap(), now, &[moment], &mut blended);
            score[0].add(auto, truth);
            score[1].add(blended[0], truth);
            score[2].add(persistence.remember(basis, auto, nanos), truth);
        }
    }
    let mse = scores.map(|scores| scores.map(|score| score.squares / score.count));
    for ([auto, believed, remembered], limit) in mse.into_iter().zip([0.0285, 0.0450, 0.0580, 0.0590]) {
        assert!(believed <= limit && believed <= auto + 1e-6 && believed <= remembered + 1e-6, "{mse:?}");
    }
}
