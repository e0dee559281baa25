//! Joint probabilities: any of several persons, all of several objects.
//!
//! Persons and objects count as independent. Invariant: results are in `[0,1]`.

/// A moment at which all objects are likely to be there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointMoment {
    /// The number of the moment, from 0.
    pub index: usize,
    /// Probability that all objects are there.
    pub probability: f64,
}

/// The reason why a joint probability is undefined.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PolicyError {
    /// A probability is out of range.
    #[error("a probability is {0}: expected 0 to 1")]
    Probability(f64),
    /// The threshold is out of range.
    #[error("the threshold is {0}: expected 0 to 1")]
    Threshold(f64),
}

/// The probability that at least one of several persons is at a place, from the probability of each person, in `[0,1]`;
/// 0 without persons.
pub fn anyone(probabilities: impl IntoIterator<Item = f64>) -> f64 {
    1.0 - probabilities.into_iter().map(|probability| 1.0 - probability.clamp(0.0, 1.0)).product::<f64>()
}

/// The first moment at which all objects of a set are there with a probability above the threshold (Waldo, section
/// VII.B, where it is 0.5). Each item of the series holds the probabilities of the objects at one moment; an empty item
/// has the probability 1. `None` if no moment exceeds the threshold.
///
/// # Errors
/// [`PolicyError`] for values outside `[0,1]`, up to the found moment.
pub fn next_above<P: IntoIterator<Item = f64>>(
    series: impl IntoIterator<Item = P>,
    threshold: f64,
) -> Result<Option<JointMoment>, PolicyError> {
    if !(0.0..=1.0).contains(&threshold) {
        return Err(PolicyError::Threshold(threshold));
    }
    for (index, probabilities) in series.into_iter().enumerate() {
        let mut joint = 1.0;
        for probability in probabilities {
            if !(0.0..=1.0).contains(&probability) {
                return Err(PolicyError::Probability(probability));
            }
            joint *= probability;
        }
        if joint > threshold {
            return Ok(Some(JointMoment { index, probability: joint }));
        }
    }
    Ok(None)
}
