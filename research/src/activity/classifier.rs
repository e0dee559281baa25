//! The classifiers: their answers for each true activity.
//!
//! A minute without a known activity is no error of a classifier: it names "no activity" there and nowhere else, as the
//! measured classifier does.
//!
//! Invariant: the row of an activity has the likelihood of each activity that the classifier may name.

use super::recording::ActivityRecording;

/// A classifier of activities.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActivityClassifier {
    /// Right with probability 0.8; the rest is shared evenly among the other known activities.
    Strong,
    /// Right with probability 0.2.
    Weak,
    /// The matrix of the recording.
    Measured,
}

impl ActivityClassifier {
    /// All, in the order of the results.
    pub const ALL: [Self; 3] = [Self::Strong, Self::Weak, Self::Measured];

    /// The name of the classifier on the command line and in results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Strong => "strong",
            Self::Weak => "weak",
            Self::Measured => "measured",
        }
    }

    /// The classifier of a name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|classifier| classifier.name() == name)
    }

    /// The matrix of the classifier, a row for each true activity.
    pub(super) fn matrix(self, recording: &ActivityRecording) -> Vec<Vec<f64>> {
        match self {
            Self::Strong => even_errors(recording.names.len(), 0.8),
            Self::Weak => even_errors(recording.names.len(), 0.2),
            Self::Measured => recording.confusion.clone(),
        }
    }
}

/// The matrix of a classifier that takes all known activities for each other alike; the first is the unknown one.
fn even_errors(labels: usize, right: f64) -> Vec<Vec<f64>> {
    let wrong = (1.0 - right) / (labels - 2) as f64;
    let cell = |true_label: usize, label: usize| match (true_label, label) {
        (0, 0) => 1.0,
        (0, _) | (_, 0) => 0.0,
        _ if label == true_label => right,
        _ => wrong,
    };
    (0..labels).map(|true_label| (0..labels).map(|label| cell(true_label, label)).collect()).collect()
}
