//! A recording that was read: its states, the readings to learn, and the readings to predict.
//!
//! Invariant: thinning changes what is learned, never what is asked or compared with.

use std::collections::BTreeMap;

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};
use tidemap_model::{LocalDay, Sample, StateKind, Zone};

use super::lead::HOUR_NANOS;

/// Share of the readings that a thinned recording keeps.
const KEPT: f64 = 0.05;
const THINNING_SEED: u64 = 5;
/// Maximum number of readings of a state that are predicted on a day.
const ASKED_A_DAY_MAX: usize = 144;
/// Maximum number of days on which readings are predicted.
const ASKED_DAYS_MAX: usize = 60;

/// A state as it is read.
#[derive(Clone, Debug)]
pub(super) struct ReadState {
    /// Its name in the map.
    pub(super) name: String,
    /// The meaning of its values.
    pub(super) kind: StateKind,
    /// The readings, ascending by time.
    pub(super) samples: Vec<Sample>,
}

/// States that are scored together: one unit of one recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct UnitGroup {
    /// The states in words: the name of a single one, or a number with a unit.
    pub(super) label: String,
    /// The kind of all its states.
    pub(super) kind: StateKind,
}

/// A state of a recording.
#[derive(Clone, Debug)]
pub(super) struct RecordedState {
    /// Its name in the map.
    pub(super) name: String,
    /// The meaning of its values.
    pub(super) kind: StateKind,
    /// The index of its group.
    pub(super) group: usize,
    /// All readings, ascending by time.
    pub(super) samples: Vec<Sample>,
}

impl RecordedState {
    /// The mean of all readings in the hour around a reading.
    pub(super) fn mean_of_hour(&self, at: Sample) -> f64 {
        let before = |nanos: i64| self.samples.partition_point(|sample| sample.utc_nanos < nanos);
        let of_hour = &self.samples[before(at.utc_nanos - HOUR_NANOS / 2)..before(at.utc_nanos + HOUR_NANOS / 2)];
        of_hour.iter().map(|sample| sample.value).sum::<f64>() / of_hour.len() as f64
    }
}

/// A recording.
#[derive(Clone, Debug)]
pub(super) struct ReadRecording {
    /// The name in results.
    pub(super) name: &'static str,
    /// The time zone by whose clocks people live there.
    pub(super) zone: Zone,
    /// The states.
    pub(super) states: Vec<RecordedState>,
    /// The groups of the states.
    pub(super) groups: Vec<UnitGroup>,
    /// The readings that are predicted, by local day: the index of the state, and the reading.
    pub(super) asked: BTreeMap<LocalDay, Vec<(usize, Sample)>>,
}

impl ReadRecording {
    /// A recording whose last `test_days` local days are asked. `unit`: the unit of all states together; none if each
    /// has its own.
    pub(super) fn new(
        name: &'static str,
        unit: Option<&str>,
        zone: Zone,
        test_days: i32,
        read: Vec<ReadState>,
    ) -> ReadRecording {
        let groups = match (unit, &read[..]) {
            (Some(unit), [first, _, ..]) => {
                vec![UnitGroup { label: format!("{} {unit}", read.len()), kind: first.kind }]
            }
            (Some(unit), [one]) => vec![UnitGroup { label: unit.to_owned(), kind: one.kind }],
            _ => read.iter().map(|state| UnitGroup { label: state.name.clone(), kind: state.kind }).collect(),
        };
        let state = |(index, ReadState { name, kind, samples }): (usize, ReadState)| {
            let group = if unit.is_some() { 0 } else { index };
            RecordedState { name, kind, group, samples }
        };
        let states: Vec<RecordedState> = read.into_iter().enumerate().map(state).collect();
        let asked = asked(&states, test_days);
        ReadRecording { name, zone, states, groups, asked }
    }

    /// The number of nights from the first reading of each state to its last: how much there is to learn.
    pub(super) fn nights(&self) -> i32 {
        let ends = self.states.iter().filter_map(|state| state.samples.first().zip(state.samples.last()));
        ends.map(|(first, last)| last.local_day().0 - first.local_day().0).sum()
    }

    /// The readings of each state that are learned: all, or a random share of them.
    pub(super) fn learned(&self, is_thinned: bool) -> Vec<Vec<Sample>> {
        let mut random = SmallRng::seed_from_u64(THINNING_SEED);
        let mut is_kept = |_: &&Sample| !is_thinned || random.random::<f64>() < KEPT;
        self.states.iter().map(|state| state.samples.iter().filter(&mut is_kept).copied().collect()).collect()
    }
}

/// The readings that are predicted: evenly spread over the test days, and over the readings of a day.
fn asked(states: &[RecordedState], test_days: i32) -> BTreeMap<LocalDay, Vec<(usize, Sample)>> {
    let last = states.iter().filter_map(|state| state.samples.last()).map(Sample::local_day).max();
    let first = LocalDay(last.unwrap_or_default().0 - test_days + 1);
    let mut days: BTreeMap<LocalDay, Vec<Vec<Sample>>> = BTreeMap::new();
    for (index, state) in states.iter().enumerate() {
        for sample in state.samples.iter().rev().take_while(|sample| sample.local_day() >= first) {
            days.entry(sample.local_day()).or_insert_with(|| vec![Vec::new(); states.len()])[index].push(*sample);
        }
    }
    let days: Vec<(LocalDay, Vec<Vec<Sample>>)> = days.into_iter().collect();
    let of_day = |(day, samples): &(LocalDay, Vec<Vec<Sample>>)| {
        let of_state = |(index, samples): (usize, &Vec<Sample>)| {
            let ascending: Vec<Sample> = samples.iter().rev().copied().collect();
            spread(&ascending, ASKED_A_DAY_MAX).map(|sample| (index, *sample)).collect::<Vec<_>>()
        };
        (*day, samples.iter().enumerate().flat_map(of_state).collect())
    };
    spread(&days, ASKED_DAYS_MAX).map(of_day).collect()
}

/// At most `max` items, evenly spread.
fn spread<T>(items: &[T], max: usize) -> impl Iterator<Item = &T> {
    let count = items.len().min(max);
    (0..count).map(move |number| &items[number * items.len() / count])
}
