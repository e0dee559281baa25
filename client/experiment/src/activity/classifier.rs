//! The classifiers: what they say of each true activity.
//!
//! Invariant: the row of an activity has the likelihood of each activity that the classifier may name.

use super::recording::ActivityRecording;

/// A classifier of activities.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActivityClassifier {
    /// Right with probability 0.8; the rest is shared evenly among the other activities.
    Strong,
    /// Right with probability 0.2.
    Weak,
    /// The matrix of the recording.
    Measured,
}

impl ActivityClassifier {
    /// All, in the order of the results.
    pub const ALL: [Self; 3] = [Self::Strong, Self::Weak, Self::Measured];

    /// Its name on the command line and in results.
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

    /// Its matrix, a row for each true activity.
    pub(super) fn matrix(self, recording: &ActivityRecording) -> Vec<Vec<f64>> {
        match self {
            Self::Strong => even_errors(recording.names.len(), 0.8),
            Self::Weak => even_errors(recording.names.len(), 0.2),
            Self::Measured => recording.confusion.clone(),
        }
    }
}

fn even_errors(labels: usize, right: f64) -> Vec<Vec<f64>> {
    let wrong = (1.0 - right) / (labels - 1) as f64;
    let row = |true_label: usize| (0..labels).map(|label| if label == true_label { right } else { wrong }).collect();
    (0..labels).map(row).collect()
}
