//! A map as a list of observations.
//!
//! Invariant: nothing is accumulated: every answer is computed from all observations.

use std::{collections::BTreeMap, f64::consts::TAU};

const SECOND_NANOS: i64 = 1_000_000_000;
const HARMONICS: u32 = 168;
const WEEK_SECS: i64 = 7 * 86_400;
const COMPONENTS_MAX: usize = 15;
/// Times between readings that are kept.
const GAPS_KEPT: usize = 16;

/// An observation that was accepted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Accepted {
    pub state: usize,
    pub nanos: i64,
    pub value: f64,
    /// The update that learned it.
    pub learned_in: Option<u64>,
}

/// An observation that a producer sent, accepted or not.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Sent {
    pub state: String,
    pub nanos: i64,
    pub value: f64,
}

/// A coefficient 2γ of a candidate period.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Coefficient {
    pub harmonic: u32,
    pub re: f64,
    pub im: f64,
}

impl Coefficient {
    pub(crate) fn amplitude(&self) -> f64 {
        self.re.hypot(self.im)
    }
}

/// A map.
#[derive(Debug)]
pub(crate) struct NaiveMap {
    /// Hours to add to UTC; the zones used have no summer time.
    pub offset_hours: i64,
    /// In the order of first appearance.
    pub states: Vec<String>,
    pub observations: Vec<Accepted>,
    pub producers: BTreeMap<String, Vec<Sent>>,
    pub generation: u64,
    pub cut_nanos: i64,
}

impl NaiveMap {
    pub(crate) fn new(offset_hours: i64) -> Self {
        let (states, observations) = (Vec::new(), Vec::new());
        Self { offset_hours, states, observations, producers: BTreeMap::new(), generation: 0, cut_nanos: 0 }
    }

    /// A producer's next observation became durable.
    pub(crate) fn take(&mut self, producer: &str, sent: &Sent) {
        self.producers.entry(producer.to_owned()).or_default().push(sent.clone());
        if !(0.0..=1.0).contains(&sent.value) {
            return;
        }
        let state = self.states.iter().position(|name| *name == sent.state).unwrap_or_else(|| {
            self.states.push(sent.state.clone());
            self.states.len() - 1
        });
        self.observations.push(Accepted { state, nanos: sent.nanos, value: sent.value, learned_in: None });
    }

    /// An update learns the observations before `until`, or all.
    pub(crate) fn update(&mut self, until_nanos: Option<i64>) {
        let newest = self.observations.iter().map(|o| o.nanos).max().unwrap_or(0);
        self.cut_nanos = self.cut_nanos.max(until_nanos.unwrap_or(newest + 1));
        self.generation += 1;
        for observation in self.observations.iter_mut().filter(|o| o.learned_in.is_none()) {
            observation.learned_in = (observation.nanos < self.cut_nanos).then_some(self.generation);
        }
    }

    pub(crate) fn pending(&self) -> u64 {
        self.observations.iter().filter(|o| o.learned_in.is_none()).count() as u64
    }

    pub(crate) fn count(&self, state: usize) -> u64 {
        self.observations.iter().filter(|o| o.state == state).count() as u64
    }

    pub(crate) fn folded(&self, state: usize) -> Vec<Accepted> {
        self.observations.iter().copied().filter(|o| o.state == state && o.learned_in.is_some()).collect()
    }

    pub(crate) fn mean(&self, state: usize) -> f64 {
        let folded = self.folded(state);
        if folded.is_empty() {
            return 0.5;
        }
        folded.iter().map(|o| o.value).sum::<f64>() / folded.len() as f64
    }

    /// The observation with the greatest time; ties: the first.
    pub(crate) fn latest(&self, state: usize) -> Option<(i64, f64)> {
        let mut latest: Option<(i64, f64)> = None;
        for o in self.observations.iter().filter(|o| o.state == state) {
            if latest.is_none_or(|(nanos, _)| o.nanos > nanos) {
                latest = Some((o.nanos, o.value));
            }
        }
        latest
    }

    /// T-RO eq. 12 with a prior of one hour that weighs as one pair.
    pub(crate) fn tau_secs(&self, state: usize) -> f64 {
        let (mut last, mut pairs, mut rate): (Option<(i64, f64)>, f64, f64) = (None, 0.0, 0.0);
        for o in self.observations.iter().filter(|o| o.state == state) {
            if let Some((nanos, value)) = last {
                if o.nanos <= nanos {
                    continue;
                }
                pairs += 1.0;
                rate += (o.value - value).abs() / ((o.nanos - nanos) as f64 / 1e9);
            }
            last = Some((o.nanos, o.value));
        }
        (1.0 + pairs) / (1.0 / 3_600.0 + rate)
    }

    /// A sample of the times between successive learned readings in whole seconds, shortest first: of all such times
    /// those with the sixteen lowest hashes of their numbers. Readings that are learned late bound none.
    fn gaps_secs(&self, state: usize) -> Vec<i64> {
        let mut folded = self.folded(state);
        folded.sort_by_key(|o| (o.learned_in, o.nanos));
        let (mut gaps, mut newest) = (Vec::new(), None);
        for o in &folded {
            if let Some(newest) = newest.filter(|&newest| o.nanos > newest) {
                let secs = (o.nanos - newest + SECOND_NANOS / 2) / SECOND_NANOS;
                gaps.push((split_mix(gaps.len() as u64), secs));
            }
            newest = newest.max(Some(o.nanos));
        }
        gaps.sort_unstable();
        let mut kept: Vec<i64> = gaps.into_iter().take(GAPS_KEPT).map(|(_, secs)| secs).collect();
        kept.sort_unstable();
        kept
    }

    /// 2γ_k of all periods that the observed span with a median gap makes eligible and the readings resolve: they are
    /// neither regular nor in phase with more than half a period. γ_k = (1/n) Σ (s_i − μ)·e^(−jω_k t_i).
    pub(crate) fn coefficients(&self, state: usize) -> Vec<Coefficient> {
        let folded = self.folded(state);
        let (Some(first), Some(last)) = (folded.iter().map(|o| o.nanos).min(), folded.iter().map(|o| o.nanos).max())
        else {
            return Vec::new();
        };
        let gaps = self.gaps_secs(state);
        let median = gaps.get(gaps.len().saturating_sub(1) / 2).copied().unwrap_or(0);
        let is_regular = gaps.len() >= 8 && median > 0 && gaps[1] as f64 >= 0.9 * median as f64;
        let span_secs = (last - first) as f64 / 1e9 + median as f64;
        let in_phase = |&harmonic: &u32| {
            let angles = folded.iter().map(|o| self.angle(harmonic, o.nanos));
            let (re, im) = angles.fold((0.0, 0.0), |(re, im), angle| (re + angle.cos(), im - angle.sin()));
            f64::hypot(re, im) >= 0.98 * folded.len() as f64
        };
        let in_phase_secs = (1..=HARMONICS).find(in_phase).map_or(0.0, |k| WEEK_SECS as f64 / f64::from(k));
        let regular_secs = if is_regular { median as f64 } else { 0.0 };
        let resolved_secs = 1.98 * f64::max(regular_secs, in_phase_secs);
        let mean = self.mean(state);
        let eligible = |&harmonic: &u32| {
            let period_secs = WEEK_SECS as f64 / f64::from(harmonic);
            span_secs >= 0.99 * period_secs && period_secs >= resolved_secs
        };
        let coefficient = |harmonic: u32| {
            let (mut re, mut im) = (0.0, 0.0);
            for o in &folded {
                let (sin, cos) = self.angle(harmonic, o.nanos).sin_cos();
                re += (o.value - mean) * cos;
                im -= (o.value - mean) * sin;
            }
            let n = folded.len() as f64;
            Coefficient { harmonic, re: 2.0 * re / n, im: 2.0 * im / n }
        };
        (1..=HARMONICS).filter(eligible).map(coefficient).collect()
    }

    /// ω_k·t with t the local civil time, reduced to a turn before it becomes a float.
    fn angle(&self, harmonic: u32, nanos: i64) -> f64 {
        let local = i128::from(nanos) + i128::from(self.offset_hours * 3_600) * i128::from(SECOND_NANOS);
        let base = i128::from(WEEK_SECS) * i128::from(SECOND_NANOS);
        let turns = (local * i128::from(harmonic)).rem_euclid(base);
        TAU * turns as f64 / base as f64
    }

    /// The harmonic that a period belongs to.
    pub(crate) fn harmonic(period_secs: f64) -> u32 {
        let harmonic = WEEK_SECS as f64 / period_secs;
        assert!((harmonic - harmonic.round()).abs() < 1e-6, "{period_secs} s is not a week by a whole number");
        (1..=HARMONICS).find(|&k| (f64::from(k) - harmonic).abs() < 0.5).expect("one of the candidates")
    }

    /// The prediction by these components: p(t) = clamp(μ + Σ A_k cos(ω_k t + φ_k)).
    pub(crate) fn predicted(&self, state: usize, components: &[Coefficient], nanos: i64) -> f64 {
        let wave = |c: &Coefficient| {
            let (sin, cos) = self.angle(c.harmonic, nanos).sin_cos();
            c.re * cos - c.im * sin
        };
        (self.mean(state) + components.iter().map(wave).sum::<f64>()).clamp(0.0, 1.0)
    }
}

/// The output of SplitMix64 for a seed.
fn split_mix(seed: u64) -> u64 {
    let z = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Checks that the reported components are the expected ones, strongest first. Components of equal strength, to
/// rounding, may come in any order. Returns the expected ones.
#[track_caller]
pub(crate) fn check_components(what: &str, shown: &[(u32, f64, f64)], all: &[Coefficient]) -> Vec<Coefficient> {
    let mut found = Vec::new();
    for &(harmonic, amplitude, phase_rad) in shown {
        let expected = all.iter().find(|c| c.harmonic == harmonic);
        let expected = expected.unwrap_or_else(|| panic!("{what}: harmonic {harmonic} is not eligible"));
        let (sin, cos) = phase_rad.sin_cos();
        let off = (amplitude * cos - expected.re).hypot(amplitude * sin - expected.im);
        assert!(off <= 4e-9, "{what}: harmonic {harmonic} is ({amplitude}, {phase_rad}), expected {expected:?}");
        found.push(*expected);
    }
    assert!(shown.is_sorted_by(|a, b| a.1 >= b.1 - 1e-9), "{what}: strongest first: {shown:?}");
    let weakest = if shown.len() == COMPONENTS_MAX { shown[COMPONENTS_MAX - 1].1 } else { 0.0 };
    for c in all.iter().filter(|c| !shown.iter().any(|s| s.0 == c.harmonic)) {
        assert!(c.amplitude() <= weakest + 4e-9, "{what}: {c:?} is left out, and stronger than {weakest}");
    }
    found
}
