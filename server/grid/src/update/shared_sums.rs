//! The data that the tiles of a pattern share: the times of its scans, and the sums over them.
//!
//! Invariant: groups with the same history and the same toggles share one sum, whichever tiles and batches they belong
//! to.

use std::{
    collections::{HashMap, HashSet},
    sync::Arc,
};

use tidemap_model::{GapSample, PhasorSum, kind_and_hour};

use super::{
    super::{
        day::GridDay,
        fade::DayFactors,
        fold::{Chunk, Cursor, WeightedScans, fold_toggles, run_length},
        observed_times::ObservedTimes,
        sensor_sums::{GroupSums, WeightedSums},
        sensors::{SensorId, Weights},
    },
    rules::Rules,
};

const HOUR_NANOS: i64 = 3_600_000_000_000;

/// Times of a pattern's scans.
#[derive(Debug)]
pub(super) struct Times {
    pub(super) utc_nanos: Vec<i64>,
    pub(super) civil_nanos: Arc<[i64]>,
    /// The scans in the order of their times; `None` if each is newer than the one before.
    pub(super) by_time: Option<Vec<u32>>,
    /// For each scan, the number of local hours of scans up to its time, less one.
    pub(super) hours: Vec<u32>,
    /// For each of these hours, the kind of day and the hour of the day.
    pub(super) kinds_and_hours: Vec<(usize, usize)>,
    /// The count for all scans.
    pub(super) all: Counted,
    /// The weights of the scans; `None` if all are of the map's own sensor.
    pub(super) weighted: Option<WeightedScans>,
}

impl Times {
    /// The times of the scans in these ranges of a day.
    pub(super) fn new(ranges: &[(u32, u32)], day: &GridDay, rules: &Rules) -> Times {
        let scans: Vec<_> =
            ranges.iter().filter_map(|&(first, end)| day.scans.get(first as usize..end as usize)).flatten().collect();
        let all = Counted {
            observations: scans.len() as u64,
            first_nanos: scans.iter().map(|scan| scan.utc_nanos).min().unwrap_or(i64::MAX),
            last_nanos: scans.iter().map(|scan| scan.utc_nanos).max().unwrap_or(i64::MIN),
        };
        let has_others = scans.iter().any(|scan| scan.sensor != SensorId::OWN);
        let ids = || Arc::new(scans.iter().map(|scan| scan.sensor).collect());
        let weighted = has_others.then(|| WeightedScans::new(ids(), &rules.sensors));
        let utc_nanos = scans.iter().map(|scan| scan.utc_nanos).collect();
        Times::of_scans(utc_nanos, scans.iter().map(|scan| scan.civil_nanos()).collect(), all, weighted)
    }

    /// Makes the times from scans; `all` is the count for all of them.
    pub(super) fn of_scans(
        utc_nanos: Vec<i64>,
        civil_nanos: Arc<[i64]>,
        all: Counted,
        weighted: Option<WeightedScans>,
    ) -> Times {
        let by_time = (!utc_nanos.is_sorted_by(|one, next| one < next)).then(|| {
            let mut scans: Vec<u32> = (0..).take(utc_nanos.len()).collect();
            scans.sort_by_key(|&scan| utc_nanos.get(scan as usize));
            scans
        });
        let (mut hours, mut hour, mut number) = (vec![0; civil_nanos.len()], None, 0);
        let mut kinds_and_hours = Vec::new();
        for place in 0..civil_nanos.len() {
            let scan = by_time.as_ref().map_or(place, |scans| scans[place] as usize);
            let of_scan = Some(civil_nanos[scan].div_euclid(HOUR_NANOS));
            number += u32::from(hour.is_some() && hour != of_scan);
            if hour != of_scan {
                kinds_and_hours.push(kind_and_hour(civil_nanos[scan]));
            }
            hour = of_scan;
            hours[scan] = number;
        }
        Times { utc_nanos, civil_nanos, by_time, hours, kinds_and_hours, all, weighted }
    }

    /// Counts the scans at which a bit with these toggles is set, with the times of the first and last.
    pub(super) fn count(&self, toggles: &[u32]) -> Counted {
        if toggles == [0] {
            return self.all;
        }
        let mut counted = Counted { observations: 0, first_nanos: i64::MAX, last_nanos: i64::MIN };
        for run in toggles.chunks(2) {
            let from = run.first().map_or(0, |&from| from as usize);
            let to = run.get(1).map_or(self.utc_nanos.len(), |&to| to as usize);
            for &nanos in self.utc_nanos.get(from..to).unwrap_or_default() {
                counted.observations += 1;
                counted.first_nanos = counted.first_nanos.min(nanos);
                counted.last_nanos = counted.last_nanos.max(nanos);
            }
        }
        counted
    }

    /// The weight of the readings at which a bit with these toggles is set.
    pub(super) fn weigh(&self, toggles: &[u32]) -> Weights {
        match &self.weighted {
            Some(weighted) => weighted.sum(toggles),
            None => Weights::own(run_length(toggles, self.utc_nanos.len())),
        }
    }
}

/// The number of observations of some cells on the day, with the times of the first and the last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Counted {
    pub(super) observations: u64,
    pub(super) first_nanos: i64,
    pub(super) last_nanos: i64,
}

/// B_k over the scans at which some cells were observed on the day.
#[derive(Debug)]
pub(super) struct Contribution {
    toggles: Vec<u32>,
    cursor: Cursor,
    sum: PhasorSum,
    /// The sums G_k and D_k, where some of the scans are of another sensor than the map's own.
    weighted: Option<Box<(PhasorSum, PhasorSum)>>,
}

/// The address of a group's earlier sums, the gain, and their factors as bits.
type SumKey = ([usize; 3], usize, [u64; 2]);

/// The address of a group's earlier times, the gain, the time of the last observation, and the factors as bits.
type TimesKey = (usize, usize, i64, [u64; 2]);

/// Times as a key, by their content.
type TimesContent = (GapSample, u64, [[u32; 24]; 2]);

/// The sums that a day adds (gains), and the results, so that groups with the same history share theirs.
#[derive(Debug, Default)]
pub(super) struct Gains {
    gains: Vec<GroupSums>,
    by_toggles: HashMap<Vec<u32>, usize>,
    zero: Option<Arc<PhasorSum>>,
    /// The results by the address of the group's earlier sums, the gain, and the factors; the earlier sums are kept
    /// alive.
    shared: HashMap<SumKey, (GroupSums, GroupSums)>,
    /// The results for times, by the address of the earlier times, the gain, the last observation and the factors.
    shared_times: HashMap<TimesKey, (Arc<ObservedTimes>, Arc<ObservedTimes>)>,
    no_times: Arc<ObservedTimes>,
    /// Times of groups that share no sum; equal times are kept once. A moving robot sees most cells at different times,
    /// but the gaps between, in whole seconds, are often equal.
    equal_times: HashMap<TimesContent, Arc<ObservedTimes>>,
}

impl Gains {
    /// The contributions of these toggles that are still to be computed.
    pub(super) fn missing<'a>(
        &self,
        toggles: impl Iterator<Item = &'a Vec<u32>>,
        times: &Times,
        rules: &Rules,
    ) -> Vec<Contribution> {
        let mut listed = HashSet::new();
        let missing = toggles.filter(|toggles| !self.by_toggles.contains_key(*toggles) && listed.insert(*toggles));
        missing.map(|toggles| Contribution::new(toggles.clone(), times, rules)).collect()
    }

    /// Adds computed contributions; another batch may already have added them.
    pub(super) fn take(&mut self, contributions: Vec<Contribution>) {
        for Contribution { toggles, sum, weighted, .. } in contributions {
            let next = self.gains.len();
            if *self.by_toggles.entry(toggles).or_insert(next) == next {
                let weighted = weighted.map(|weighted| {
                    let (alpha, beta) = *weighted;
                    WeightedSums { alpha: Arc::new(alpha), beta: Arc::new(beta) }
                });
                self.gains.push(GroupSums { plain: Arc::new(sum), weighted, times: None });
            }
        }
    }

    /// The gain of cells with these toggles, if one was computed.
    pub(super) fn gain(&self, toggles: &Vec<u32>) -> Option<usize> {
        self.by_toggles.get(toggles).copied()
    }

    /// The sums of a group that was not observed before the day.
    pub(super) fn sum(&mut self, index: usize, rules: &Rules) -> GroupSums {
        match self.gains.get(index) {
            Some(gain) => gain.clone(),
            None => self.zero(rules),
        }
    }

    /// The sums of a group without any of its observations; all such groups share them.
    pub(super) fn zero(&mut self, rules: &Rules) -> GroupSums {
        let zero = self.zero.get_or_insert_with(|| Arc::new(PhasorSum::zero(&rules.periodicities)));
        GroupSums { plain: Arc::clone(zero), weighted: None, times: None }
    }

    /// The times of a group that was never observed.
    pub(super) fn no_times(&self) -> Arc<ObservedTimes> {
        Arc::clone(&self.no_times)
    }

    /// The times of a group after the day; `gain`: the gain of its toggles, if there is one.
    pub(super) fn observe(
        &mut self,
        before: Arc<ObservedTimes>,
        gain: Option<usize>,
        (times, toggles): (&Times, &[u32]),
        last_nanos: Option<i64>,
        factors: DayFactors,
    ) -> Arc<ObservedTimes> {
        let observe = |before: &ObservedTimes| times.observe(*before, toggles, last_nanos, factors);
        let Some(gain) = gain else {
            let after = observe(&before);
            return Arc::clone(self.equal_times.entry(after.key()).or_insert_with(|| Arc::new(after)));
        };
        let key = (Arc::as_ptr(&before) as usize, gain, last_nanos.unwrap_or(i64::MIN), factors.to_bits());
        let entry = self.shared_times.entry(key).or_insert_with(|| {
            let after = Arc::new(observe(&before));
            (before, after)
        });
        Arc::clone(&entry.1)
    }

    /// The sums of a group after the day.
    pub(super) fn add_to(&mut self, before: GroupSums, index: usize, factors: DayFactors) -> GroupSums {
        let Some(gain) = self.gains.get(index) else { return before };
        let entry = self.shared.entry((before.addresses(), index, factors.to_bits())).or_insert_with(|| {
            let after = match factors {
                DayFactors::EQUAL => before.plus(gain),
                DayFactors { known, of_day } => before.scaled(known).plus(&gain.scaled(of_day)),
            };
            (before, after)
        });
        entry.1.clone()
    }
}

impl Contribution {
    fn new(toggles: Vec<u32>, times: &Times, rules: &Rules) -> Contribution {
        let zero = || PhasorSum::zero(&rules.periodicities);
        let has_others = times.weighted.as_ref().is_some_and(|scans| scans.has_others(&toggles));
        let weighted = has_others.then(|| Box::new((zero(), zero())));
        Contribution { toggles, cursor: Cursor::default(), sum: zero(), weighted }
    }

    pub(super) fn fold(&mut self, chunk: &Chunk<'_>) {
        let from = self.cursor;
        fold_toggles(&self.toggles, &mut self.cursor, &mut self.sum, chunk.rows, chunk);
        if let (Some((alpha, beta)), Some(rows)) = (self.weighted.as_deref_mut(), chunk.weighted) {
            fold_toggles(&self.toggles, &mut { from }, alpha, &rows.alpha, chunk);
            fold_toggles(&self.toggles, &mut { from }, beta, &rows.beta, chunk);
        }
    }
}
