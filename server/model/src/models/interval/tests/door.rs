//! Tests intervals on the office door of RA-L 2019: the choice of the priors, and the intervals on held-out weeks. They
//! are skipped without the recordings.

use std::collections::BTreeMap;
use std::path::Path;

use super::super::{
    beta::{INTERVAL_PRIOR, IntervalPrior, interval},
    *,
};
use crate::models::{Calibrated, CalibratedOptions, Moment, Readings, TemporalModel};
use crate::{Sample, Zone};

#[path = "../../../../tests/recordings/folder.rs"]
mod folder;
use folder::recordings;

const HOUR_NANOS: i64 = 3_600_000_000_000;

fn read(folder: &Path, name: &str) -> Vec<Sample> {
    let text = std::fs::read_to_string(folder.join(name)).unwrap();
    let mut offsets = Zone::named("Europe/London").unwrap().offset_cache();
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

/// The mean of each observed civil hour, by hours since 1970 local.
fn hourly_means(samples: &[Sample]) -> BTreeMap<i64, f64> {
    let mut hours: BTreeMap<i64, (f64, f64)> = BTreeMap::new();
    for sample in samples {
        let (count, sum) = hours.entry(sample.civil_nanos().div_euclid(HOUR_NANOS)).or_default();
        *count += 1.0;
        *sum += sample.value;
    }
    hours.into_iter().map(|(hour, (count, sum))| (hour, sum / count)).collect()
}

/// Hour of the local week, from Monday 00:00.
fn hour_of_week(hour: i64) -> usize {
    (hour + 72).rem_euclid(168) as usize
}

/// The index of the hour of the day: weekdays from 0, the weekend from 24.
fn cell(hour: i64) -> usize {
    let of_week = hour_of_week(hour);
    of_week % 24 + if of_week >= 120 { 24 } else { 0 }
}

/// The training data of intervals, from some weeks.
struct Learnt {
    model: Calibrated,
    cells: Vec<HourMoments>,
    all: HourMoments,
    /// Mean by hour of the week.
    week: Vec<f64>,
    /// Mean by hour of the day.
    day: Vec<f64>,
}

fn means_by(hours: &BTreeMap<i64, f64>, slots: usize, slot: impl Fn(i64) -> usize) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0); slots];
    for (&hour, mean) in hours {
        sums[slot(hour)].0 += 1.0;
        sums[slot(hour)].1 += mean;
    }
    sums.into_iter().map(|(count, sum)| sum / count).collect()
}

impl Learnt {
    fn from(samples: &[Sample]) -> Learnt {
        let model = Calibrated::train(Readings::new(samples), CalibratedOptions::default()).unwrap();
        let hours = hourly_means(samples);
        let mut cells = vec![HourMoments::default(); 48];
        for (&hour, &mean) in &hours {
            let one = HourMoments { days: 1.0, sum: mean, sum_of_squares: mean * mean };
            cells[cell(hour)] = cells[cell(hour)].and(one);
        }
        let all = cells.iter().fold(HourMoments::default(), |all, &cell| all.and(cell));
        let week = means_by(&hours, 168, hour_of_week);
        let day = means_by(&hours, 24, |hour| hour_of_week(hour) % 24);
        Learnt { model, cells, all, week, day }
    }
}

/// The frequency with which an interval held the mean of its hour, and the width of intervals.
#[derive(Clone, Copy, Debug, Default)]
struct Held {
    hours: f64,
    held: f64,
    width: f64,
}

impl Held {
    fn add(&mut self, interval: Interval, mean: f64) {
        self.hours += 1.0;
        self.held += f64::from(u8::from(interval.contains(mean)));
        self.width += interval.width();
    }

    fn show(self) -> String {
        format!("{:5} hours {:.4} width {:.4}", self.hours, self.held / self.hours, self.width / self.hours)
    }
}

/// The scores by hour of the week, where the state varies and elsewhere; then by hour of the day, in the same order.
type DoorScore = [Held; 4];

fn varies(mean: f64) -> bool {
    (0.05..=0.95).contains(&mean)
}

fn score(learnt: &Learnt, test: &[Sample], borrowed: IntervalPrior, scores: &mut DoorScore) {
    for (hour, mean) in hourly_means(test) {
        // The civil time of the middle of the hour, as if it were UTC: this is enough for a profile of the week.
        let p = learnt.model.predict(Moment { utc_nanos: hour * HOUR_NANOS + HOUR_NANOS / 2, offset_secs: 0 });
        let found = interval(p, learnt.cells[cell(hour)], learnt.all, 0.9, borrowed);
        scores[usize::from(!varies(learnt.week[hour_of_week(hour)]))].add(found, mean);
        scores[2 + usize::from(!varies(learnt.day[hour_of_week(hour) % 24]))].add(found, mean);
    }
}

fn print(name: &str, scores: &DoorScore) {
    for (by, pair) in ["hour of week", "hour of day"].iter().zip(scores.chunks(2)) {
        println!("{name}, by {by}: varying {}, else {}", pair[0].show(), pair[1].show());
    }
}

#[test]
#[ignore = "the search by which the borrowed days were chosen: of interest when the intervals change"]
fn what_is_borrowed_comes_from_rolling_origin_on_the_training_weeks() {
    let Some(folder) = recordings("door") else { return };
    let train = read(&folder, "train.csv");
    let folds = folds(&train);
    let mut tried = Vec::new();
    for end in [0.0, 0.0001, 0.001, 0.005, 0.02] {
        for scatter_days in [0.5, 1.0, 2.0, 4.0, 8.0] {
            for doubt_days in [0.5, 1.0, 2.0] {
                let borrowed = IntervalPrior { scatter_days, doubt_days, end };
                let mut scores = DoorScore::default();
                for (learnt, weeks) in &folds {
                    score(learnt, weeks, borrowed, &mut scores);
                }
                print(&format!("{borrowed:?}"), &scores);
                tried.push((borrowed, scores));
            }
        }
    }
    // The prior of one day is fixed for states with few days. Of the other settings, the test chooses those whose
    // intervals hold 90 % within 1 % where the state varies, and of these the narrowest.
    let (chosen, _) = tried
        .iter()
        .filter(|(borrowed, scores)| {
            borrowed.doubt_days == 1.0 && (scores[0].held / scores[0].hours - 0.9).abs() <= 0.01
        })
        .min_by(|(_, a), (_, b)| a[0].width.total_cmp(&b[0].width))
        .unwrap();
    println!("chosen {chosen:?}");
    assert_eq!(*chosen, INTERVAL_PRIOR);
}

/// Shares of hours whose mean an interval held: 08 to 18 h of working days, and elsewhere.
fn shares(learnt: &Learnt, test: &[Sample], level: f64, found: &mut [(f64, f64); 2]) {
    for (hour, mean) in hourly_means(test) {
        let p = learnt.model.predict(Moment { utc_nanos: hour * HOUR_NANOS + HOUR_NANOS / 2, offset_secs: 0 });
        let of_week = hour_of_week(hour);
        let is_active = of_week < 120 && (8..18).contains(&(of_week % 24));
        let held = credible_interval(p, learnt.cells[cell(hour)], learnt.all, level).contains(mean);
        let (hours, sum) = &mut found[usize::from(!is_active)];
        *hours += 1.0;
        *sum += f64::from(u8::from(held));
    }
}

/// Sets of training on the first weeks, three or more, and tests on up to four weeks after.
fn folds(train: &[Sample]) -> Vec<(Learnt, Vec<Sample>)> {
    let week_of = |sample: &Sample| (sample.local_day().0 - train[0].local_day().0) / 7;
    let fold = |origin| {
        let before = train.partition_point(|sample| week_of(sample) < origin);
        let until = train.partition_point(|sample| week_of(sample) < origin + 4);
        (Learnt::from(&train[..before]), train[before..until].to_vec())
    };
    (3..10).map(fold).collect()
}

/// The shares of [`shares`] at a level, over all tests.
fn held<'a>(tests: impl Iterator<Item = (&'a Learnt, &'a [Sample])>, level: f64) -> [f64; 2] {
    let mut found = [(0.0, 0.0); 2];
    tests.for_each(|(learnt, test)| shares(learnt, test, level, &mut found));
    found.map(|(hours, held)| held / hours)
}

#[test]
fn every_level_holds_in_the_folds_of_the_training_weeks() {
    let Some(folder) = recordings("door") else { return };
    let folds = folds(&read(&folder, "train.csv"));
    for level in [0.5, 0.8, 0.9, 0.95] {
        let [active, elsewhere] = held(folds.iter().map(|(learnt, test)| (learnt, test.as_slice())), level);
        println!("{level}: {active:.4} in active hours, {elsewhere:.4} elsewhere");
        assert!((active - level).abs() <= 0.03, "{level}: {active:.4} in active hours");
        assert!(elsewhere >= level, "{level}: {elsewhere:.4} elsewhere");
    }
}

#[test]
#[ignore = "a measurement on the test weeks, which had no part in any choice"]
fn how_often_each_level_holds_on_the_test_weeks() {
    let Some(folder) = recordings("door") else { return };
    let learnt = Learnt::from(&read(&folder, "train.csv"));
    let weeks = ["week1.csv", "week2.csv", "week3.csv", "week4.csv"].map(|name| read(&folder, name));
    for level in [0.5, 0.8, 0.9, 0.95] {
        let [active, elsewhere] = held(weeks.iter().map(|week| (&learnt, week.as_slice())), level);
        println!("{level}: {active:.4} in active hours, {elsewhere:.4} elsewhere");
    }
}

#[test]
fn nine_in_ten_hold_on_weeks_that_had_no_part_in_the_choice() {
    let Some(folder) = recordings("door") else { return };
    let learnt = Learnt::from(&read(&folder, "train.csv"));
    let mut scores = DoorScore::default();
    for name in ["week1.csv", "week2.csv", "week3.csv", "week4.csv"] {
        score(&learnt, &read(&folder, name), INTERVAL_PRIOR, &mut scores);
    }
    print("four weeks", &scores);
    let share = |held: Held| held.held / held.hours;
    for (varying, elsewhere) in [(scores[0], scores[1]), (scores[2], scores[3])] {
        assert!((0.85..=0.95).contains(&share(varying)), "{}", varying.show());
        assert!(share(elsewhere) >= 0.85 && elsewhere.width / elsewhere.hours <= 0.1, "{}", elsewhere.show());
    }
}
