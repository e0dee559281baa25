//! One run: every minute is classified, and every midnight the activities recognised on the day are learned.
//!
//! Invariant: the posterior of a minute uses the activities recognised on earlier days only; the true activity decides
//! only the answer of the classifier, and the score.

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};
use tidemap_model::label_evidence::{LabelEvidence, LabelPlaces};

use super::{ActivityError, ActivitySetting, priors::TemporalPriors, recording::ActivityRecording};
use crate::place_recording::DAY_MINUTES;

/// The hours of a day.
pub(super) const HOURS: usize = 24;

/// A sum of posteriors of true activities.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TrueActivity {
    /// Number of minutes.
    pub minutes: u64,
    sum: f64,
}

impl TrueActivity {
    fn add(&mut self, posterior: f64) {
        self.minutes += 1;
        self.sum += posterior;
    }

    /// Adds the minutes of another sum.
    pub(super) fn join(&mut self, other: &TrueActivity) {
        self.minutes += other.minutes;
        self.sum += other.sum;
    }

    /// The mean posterior; none without minutes.
    pub fn score(&self) -> Option<f64> {
        (self.minutes > 0).then(|| self.sum / self.minutes as f64)
    }
}

/// The scores of one run.
#[derive(Clone, Debug, PartialEq)]
pub struct ActivityCourse {
    /// By day, then by the true activity, then by hour of the day.
    scores: Vec<Vec<[TrueActivity; HOURS]>>,
}

impl ActivityCourse {
    /// The sum over minutes of these days, counted from 0, that are wanted by activity and hour.
    pub(super) fn sum(&self, days: std::ops::Range<usize>, is_wanted: impl Fn(usize, usize) -> bool) -> TrueActivity {
        let mut sum = TrueActivity::default();
        for day in self.scores.get(days).unwrap_or_default() {
            for (label, hours) in day.iter().enumerate() {
                let wanted = hours.iter().enumerate().filter(|&(hour, _)| is_wanted(label, hour));
                wanted.for_each(|(_, score)| sum.join(score));
            }
        }
        sum
    }
}

/// Runs a setting with a seed over the first `days` of a recording.
pub(super) fn run(
    recording: &ActivityRecording,
    setting: ActivitySetting,
    seed: u64,
    days: usize,
) -> Result<ActivityCourse, ActivityError> {
    let labels = recording.names.len();
    let matrix = setting.classifier.matrix(recording);
    let mut priors = TemporalPriors::new(setting.model, labels)?;
    let mut random = SmallRng::seed_from_u64(seed);
    let place_count = recording.places.iter().max().map_or(0, |last| last + 1);
    let mut places = LabelPlaces::new(labels, place_count)?;
    let mut scores = Vec::with_capacity(days);
    for day in 0..days {
        let temporal = priors.day(day);
        let spatial: Vec<Option<Vec<f64>>> = (0..place_count).map(|place| places.prior(place)).collect();
        let mut of_day = vec![[TrueActivity::default(); HOURS]; labels];
        let mut recognised = Vec::with_capacity(DAY_MINUTES);
        for minute in 0..DAY_MINUTES {
            let at = day * DAY_MINUTES + minute;
            let (activity, place) = (recording.activities[at], recording.places[at]);
            let evidence = LabelEvidence {
                likelihoods: &matrix[activity],
                temporal: &temporal[minute],
                spatial: spatial[place].as_deref().filter(|_| setting.knows_place),
            };
            let posterior = evidence.posterior()?;
            // The first activity means that none is known.
            if activity > 0 {
                of_day[activity][minute * HOURS / DAY_MINUTES].add(posterior[activity]);
            }
            recognised.push(drawn(&posterior, random.random()));
        }
        for (label, place) in recognised.iter().zip(&recording.places[day * DAY_MINUTES..]) {
            places.add(*label, *place)?;
        }
        if day + 1 < days {
            priors.learn(day, &recognised)?;
        }
        scores.push(of_day);
    }
    Ok(ActivityCourse { scores })
}

/// The label at a share of the distribution, from 0 to 1.
fn drawn(posterior: &[f64], share: f64) -> usize {
    let mut rest = share;
    for (label, probability) in posterior.iter().enumerate() {
        rest -= probability;
        if rest < 0.0 {
            return label;
        }
    }
    // Rounding: the sum may be a little less than 1.
    posterior.iter().rposition(|&probability| probability > 0.0).unwrap_or_default()
}
