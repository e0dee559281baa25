//! The stored form of an ensemble.
//!
//! Invariant: a round trip gives the same ensemble; parts of a wrong length or out of range are refused.

use std::sync::OnceLock;

use super::bins::SLOTS;
use super::outlook::{CLASSES, Class, FAR_MEMBERS, StoredForecast};
use super::pool::MEMBERS;
use super::recall::{DAYS, SeenDay};
use super::rotation::{LONGEST, ROTATIONS};
use super::season::{FiveDays, GAPS, Rhythm};
use super::stack::{FEATURES, PAIRS};
use super::week_table::{LEVELS, PRIORS};
use super::{Ensemble, Recall, Stack, WeekTable, equivalent_bins};
use crate::hours_seen::HOURS;
use crate::{InvalidParts, LocalDay};

/// Hours of a week.
const WEEK: usize = 7 * HOURS;
/// Bytes of a seen day.
const DAY_BYTES: usize = 8 + SLOTS / 2;

/// The parts of an [`Ensemble`], for storage. Every list has a fixed length; `recall` and `residuals` may be empty.
#[derive(Clone, Debug, PartialEq)]
pub struct EnsembleParts {
    /// Sum and number of all half-hour bins.
    pub bins: [f64; 2],
    /// The last learned day.
    pub last_day: Option<LocalDay>,
    /// The table of all history, then the recent table, each: 168 sums, 168 numbers of bins, 24 weights of priors.
    pub tables: [Vec<f32>; 2],
    /// Sums, numbers and newest bins, each by half-hour of weekdays, then of weekends.
    pub alike: Vec<f32>,
    /// The bins of the last 126 days, each day at its number modulo 126: 8 bytes of bits by half-hour, little-endian,
    /// 24 bytes of values.
    pub recall: Vec<u8>,
    /// The residuals of the last 42 days, each day at its number modulo 42: 48 residuals.
    pub residuals: Vec<i8>,
    /// The last day of the residuals.
    pub residuals_day: Option<LocalDay>,
    /// Sums by rotation: 41 of products, 41 of squares.
    pub rotations: Vec<f32>,
    /// Means of five days: first day, mean, number of bins.
    pub five_days: Vec<(i32, f32, f32)>,
    /// The first and the last day of the season.
    pub season_days: [Option<LocalDay>; 2],
    /// Gaps between observed days by class.
    pub gaps: [u32; GAPS.len()],
    /// The rhythm of the year: mean, then cosine and sine of each harmonic.
    pub rhythm: [f64; 7],
    /// The numbers of each stack: 105 sums of squares, 14 of products, 14 weights.
    pub stacks: [Vec<f32>; 2],
    /// The losses of the members.
    pub losses: [f32; MEMBERS],
    /// The lead-time classes.
    pub classes: [ClassParts; CLASSES],
    /// The sums of the correction, then of the dependence.
    pub calibration: [f32; 4],
    /// The smooth table of 48 hours, and the number of bins for which it was computed.
    pub smooth: Option<(Vec<f64>, f64)>,
}

/// A lead-time class, for storage.
#[derive(Clone, Debug, PartialEq)]
pub struct ClassParts {
    /// The losses of the members at long lead times.
    pub losses: [f32; FAR_MEMBERS],
    /// Number of bins explained by the pool, and by the mean.
    pub explained: [f32; 2],
    /// Number of bins.
    pub bins: f32,
    /// The stored forecasts of the two last turns of the class, the newer first.
    pub stored: [Option<StoredForecastParts>; 2],
}

/// The forecasts of the members at the end of a day, for storage.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredForecastParts {
    /// The day at whose end the forecasts were made.
    pub day: LocalDay,
    /// The mean of all bins.
    pub mean: f32,
    /// Forecasts by hour of the week in 255ths: of the table of all history, of the recent table, of the chosen model.
    pub weeks: Vec<u8>,
    /// The rhythm of the year, in the form of [`EnsembleParts::rhythm`].
    pub rhythm: [f64; 7],
}

fn wrong(field: &'static str, found: usize) -> InvalidParts {
    InvalidParts::OutOfRange { field, found: found as f64 }
}

/// Takes the next numbers of a list.
fn take<const N: usize, T: Copy>(list: &mut &[T], field: &'static str) -> Result<[T; N], InvalidParts> {
    let (first, rest) = list.split_first_chunk::<N>().ok_or_else(|| wrong(field, list.len()))?;
    *list = rest;
    Ok(*first)
}

fn finish<T>(list: &[T], field: &'static str) -> Result<(), InvalidParts> {
    if list.is_empty() { Ok(()) } else { Err(wrong(field, list.len())) }
}

fn check_finite(numbers: &[f32], field: &'static str) -> Result<(), InvalidParts> {
    numbers
        .iter()
        .try_for_each(|&number| InvalidParts::check(field, number.into(), f64::from(f32::MIN)..=f32::MAX.into()))
}

fn rhythm_parts(rhythm: &Rhythm) -> [f64; 7] {
    let mut parts = [rhythm.mean; 7];
    parts.iter_mut().skip(1).zip(rhythm.waves.as_flattened()).for_each(|(part, wave)| *part = *wave);
    parts
}

fn rhythm_of(parts: &[f64; 7]) -> Result<Rhythm, InvalidParts> {
    for &part in parts {
        InvalidParts::check("rhythm of the year", part, -1e6..=1e6)?;
    }
    let [mean, waves @ ..] = *parts;
    let mut rhythm = Rhythm { mean, ..Rhythm::UNKNOWN };
    rhythm.waves.as_flattened_mut().copy_from_slice(&waves);
    Ok(rhythm)
}

impl WeekTable {
    fn to_parts(&self) -> Vec<f32> {
        let bins = self.bins.as_flattened();
        [self.sums.as_flattened(), bins, self.weights.as_flattened()].concat()
    }

    fn restore(&mut self, mut parts: &[f32]) -> Result<(), InvalidParts> {
        const FIELD: &str = "week table of an ensemble";
        check_finite(parts, FIELD)?;
        self.sums.as_flattened_mut().copy_from_slice(&take::<WEEK, _>(&mut parts, FIELD)?);
        self.bins.as_flattened_mut().copy_from_slice(&take::<WEEK, _>(&mut parts, FIELD)?);
        self.weights.as_flattened_mut().copy_from_slice(&take::<{ LEVELS * PRIORS }, _>(&mut parts, FIELD)?);
        if self.weights.as_flattened().iter().any(|&weight| weight <= 0.0) {
            return Err(wrong("weights of an ensemble's priors", 0));
        }
        finish(parts, FIELD)
    }
}

impl Stack {
    fn to_parts(&self) -> Vec<f32> {
        [&self.squares[..], &self.products, &self.weights].concat()
    }

    fn restore(&mut self, mut parts: &[f32]) -> Result<(), InvalidParts> {
        const FIELD: &str = "stack of an ensemble";
        check_finite(parts, FIELD)?;
        self.squares = take::<PAIRS, _>(&mut parts, FIELD)?;
        self.products = take::<FEATURES, _>(&mut parts, FIELD)?;
        self.weights = take::<FEATURES, _>(&mut parts, FIELD)?;
        finish(parts, FIELD)
    }
}

impl StoredForecast {
    fn to_parts(&self) -> StoredForecastParts {
        let weeks = [&self.week[..], &self.recent, &self.chosen].concat();
        StoredForecastParts { day: self.day, mean: self.mean, weeks, rhythm: rhythm_parts(&self.rhythm) }
    }

    fn of_parts(parts: &StoredForecastParts) -> Result<StoredForecast, InvalidParts> {
        const FIELD: &str = "stored forecast of an ensemble";
        InvalidParts::check(FIELD, parts.mean.into(), 0.0..=1.0)?;
        let mut weeks = parts.weeks.as_slice();
        let [week, recent, chosen] = [
            take::<WEEK, _>(&mut weeks, FIELD)?,
            take::<WEEK, _>(&mut weeks, FIELD)?,
            take::<WEEK, _>(&mut weeks, FIELD)?,
        ];
        finish(weeks, FIELD)?;
        Ok(StoredForecast { day: parts.day, mean: parts.mean, week, recent, chosen, rhythm: rhythm_of(&parts.rhythm)? })
    }
}

impl Class {
    fn to_parts(&self) -> ClassParts {
        let stored = self.stored.each_ref().map(|stored| stored.as_ref().map(|stored| stored.to_parts()));
        ClassParts { losses: self.losses, explained: self.explained, bins: self.bins, stored }
    }

    fn of_parts(parts: &ClassParts) -> Result<Class, InvalidParts> {
        let numbers = parts.losses.iter().chain(&parts.explained).chain([&parts.bins]);
        for &number in numbers {
            InvalidParts::check("errors at a lead time", number.into(), 0.0..=f32::MAX.into())?;
        }
        let stored = |stored: &Option<StoredForecastParts>| {
            stored.as_ref().map(|stored| StoredForecast::of_parts(stored).map(Box::new)).transpose()
        };
        let stored = [stored(&parts.stored[0])?, stored(&parts.stored[1])?];
        Ok(Class { losses: parts.losses, explained: parts.explained, bins: parts.bins, stored })
    }
}

fn recall_of(bytes: &[u8], last: Option<LocalDay>) -> Result<Recall, InvalidParts> {
    let (days, rest) = bytes.as_chunks::<DAY_BYTES>();
    let day = |bytes: &[u8; DAY_BYTES]| {
        let (mut seen, mut values) = ([0; 8], [0; SLOTS / 2]);
        seen.copy_from_slice(&bytes[..8]);
        values.copy_from_slice(&bytes[8..]);
        SeenDay { seen: u64::from_le_bytes(seen), values }
    };
    let recall = Recall::from_days(days.iter().map(day).collect(), last).filter(|_| rest.is_empty());
    recall.ok_or_else(|| wrong("bins of the last days", bytes.len()))
}

impl Ensemble {
    /// The parts to store.
    pub fn to_parts(&self) -> EnsembleParts {
        let alike = [&self.alike.sums, &self.alike.bins, &self.alike.last];
        let bytes = |day: &SeenDay| day.seen.to_le_bytes().into_iter().chain(day.values).collect::<Vec<u8>>();
        EnsembleParts {
            bins: [self.sum, self.bins],
            last_day: self.recall.last(),
            tables: [self.all.to_parts(), self.recent.to_parts()],
            alike: alike.into_iter().flat_map(|kinds| kinds.as_flattened()).copied().collect(),
            recall: self.recall.days().iter().flat_map(bytes).collect(),
            residuals: self.rotation.residuals.as_flattened().to_vec(),
            residuals_day: self.rotation.last,
            rotations: [self.rotation.products, self.rotation.squares].concat(),
            five_days: self.season.five_days.iter().map(|days| (days.day, days.mean, days.bins)).collect(),
            season_days: [self.season.first, self.season.last],
            gaps: self.season.gaps,
            rhythm: rhythm_parts(&self.season.rhythm),
            stacks: self.stacks.each_ref().map(Stack::to_parts),
            losses: self.pool.losses,
            classes: self.outlook.classes.each_ref().map(Class::to_parts),
            calibration: {
                let [[one, two], [three, four]] = [self.calibration.departures, self.calibration.neighbours];
                [one, two, three, four]
            },
            smooth: self.smooth.map(|smooth| (smooth.as_flattened().to_vec(), self.smooth_bins)),
        }
    }

    /// An ensemble from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where a list has a wrong length or a number is outside its range.
    pub fn from_parts(parts: &EnsembleParts) -> Result<Ensemble, InvalidParts> {
        let mut ensemble = Ensemble::new();
        let [sum, bins] = parts.bins;
        InvalidParts::check("number of bins", bins, 0.0..=1e15)?;
        InvalidParts::check("sum of bins", sum, 0.0..=bins * (1.0 + 1e-9))?;
        (ensemble.sum, ensemble.bins) = (sum, bins);
        ensemble.all.restore(&parts.tables[0])?;
        ensemble.recent.restore(&parts.tables[1])?;
        const ALIKE: &str = "days of a kind of an ensemble";
        check_finite(&parts.alike, ALIKE)?;
        let mut alike = parts.alike.as_slice();
        for kinds in [&mut ensemble.alike.sums, &mut ensemble.alike.bins, &mut ensemble.alike.last] {
            kinds.as_flattened_mut().copy_from_slice(&take::<{ 2 * SLOTS }, _>(&mut alike, ALIKE)?);
        }
        finish(alike, ALIKE)?;
        ensemble.recall = recall_of(&parts.recall, parts.last_day)?;
        let (residuals, rest) = parts.residuals.as_chunks::<SLOTS>();
        let complete = residuals.len() == if parts.residuals_day.is_some() { LONGEST } else { 0 };
        if !complete || !rest.is_empty() {
            return Err(wrong("residuals of an ensemble", parts.residuals.len()));
        }
        const ROTATIONS_FIELD: &str = "rotations of an ensemble";
        check_finite(&parts.rotations, ROTATIONS_FIELD)?;
        let mut rotations = parts.rotations.as_slice();
        ensemble.rotation.residuals = residuals.to_vec();
        ensemble.rotation.last = parts.residuals_day;
        ensemble.rotation.products = take::<ROTATIONS, _>(&mut rotations, ROTATIONS_FIELD)?;
        ensemble.rotation.squares = take::<ROTATIONS, _>(&mut rotations, ROTATIONS_FIELD)?;
        finish(rotations, ROTATIONS_FIELD)?;
        let five_days = |&(day, mean, bins): &(i32, f32, f32)| {
            InvalidParts::check("mean of five days", mean.into(), 0.0..=1.0)?;
            InvalidParts::check("bins of five days", bins.into(), f64::MIN_POSITIVE..=f32::MAX.into())?;
            Ok(FiveDays { day, mean, bins })
        };
        ensemble.season.five_days = parts.five_days.iter().map(five_days).collect::<Result<_, InvalidParts>>()?;
        if !ensemble.season.five_days.is_sorted_by_key(|days| days.day) {
            return Err(wrong("order of the means of five days", 0));
        }
        [ensemble.season.first, ensemble.season.last] = parts.season_days;
        ensemble.season.gaps = parts.gaps;
        ensemble.season.rhythm = rhythm_of(&parts.rhythm)?;
        for (stack, parts) in ensemble.stacks.iter_mut().zip(&parts.stacks) {
            stack.restore(parts)?;
        }
        check_finite(&parts.losses, "losses of the members")?;
        ensemble.pool.losses = parts.losses;
        for (class, parts) in ensemble.outlook.classes.iter_mut().zip(&parts.classes) {
            *class = Class::of_parts(parts)?;
        }
        check_finite(&parts.calibration, "calibration of an ensemble")?;
        let [one, two, three, four] = parts.calibration;
        (ensemble.calibration.departures, ensemble.calibration.neighbours) = ([one, two], [three, four]);
        if let Some((values, bins)) = &parts.smooth {
            let mut values = values.as_slice();
            let hours = take::<{ 2 * HOURS }, _>(&mut values, "smooth table")?;
            finish(values, "smooth table")?;
            for value in hours {
                InvalidParts::check("smooth table", value, 0.0..=1.0)?;
            }
            InvalidParts::check("bins of the smooth table", *bins, 0.0..=1e15)?;
            let mut smooth = [[0.0; HOURS]; 2];
            smooth.as_flattened_mut().copy_from_slice(&hours);
            (ensemble.smooth, ensemble.smooth_bins) = (Some(smooth), *bins);
        }
        debug_assert!(ensemble.recall.days().is_empty() || ensemble.recall.days().len() == DAYS);
        ensemble.known = equivalent_bins(&ensemble.all.bins_by_kind());
        ensemble.far = OnceLock::new();
        Ok(ensemble)
    }
}
