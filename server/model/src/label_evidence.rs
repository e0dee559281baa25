//! Which of a few labels holds, such as the activity of a person: joins the output of a classifier with priors.
//!
//! The posterior of a label is proportional to the likelihood of the classifier's output if the label held, times the
//! prior of the label at the time (Krajník et al., "Frequency Map Enhancement", 2016, section VIII). If the place is
//! known, it gives a second prior: the probability of the place for the label, p(place | label). So the overall
//! frequency of a label counts once, in the temporal prior, and not again for the place. The temporal priors are
//! predictions of temporal models, one for each label. The spatial priors are from the counts of [`LabelPlaces`]. No
//! prior ever excludes a label: both are at least [`PRIOR_MIN`].
//!
//! Invariant: a posterior has a probability for each label, from 0 to 1, and they sum to 1 within rounding; missing
//! evidence is refused, not guessed.

use std::ops::RangeInclusive;

/// The least prior of a label.
pub const PRIOR_MIN: f64 = 0.001;
/// The allowed number of labels.
pub const LABELS: RangeInclusive<usize> = 2..=64;

/// The reason why evidence was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum InvalidEvidence {
    /// Too few or too many labels.
    #[error("{found} labels, but there have to be {min} to {max}", min = LABELS.start(), max = LABELS.end())]
    Labels { found: usize },
    /// Two parts of the evidence have different numbers of labels.
    #[error("{what} has {found} values for {expected} labels")]
    Length { what: &'static str, expected: usize, found: usize },
    /// A value is not finite, or outside the range that its meaning allows.
    #[error("{what} of label {label} is {found}, but has to be {right}")]
    Value { what: &'static str, label: usize, found: f64, right: &'static str },
    /// All likelihoods are 0.
    #[error("the likelihood of every label is 0, so that no label explains the observation")]
    NothingPossible,
    /// A label or a place that does not exist.
    #[error("{what} {found} does not exist: there are {count}, counted from 0")]
    Unknown { what: &'static str, found: usize, count: usize },
}

/// The evidence for each label at a time and place.
#[derive(Clone, Copy, Debug)]
pub struct LabelEvidence<'a> {
    /// For each label, the likelihood of what was observed if the label held; any scale, 0 or more.
    pub likelihoods: &'a [f64],
    /// For each label, its probability at the time, as temporal models predict it. They need not sum to 1.
    pub temporal: &'a [f64],
    /// For each label, the probability of being at this place while it holds; `None` if the place is not known.
    pub spatial: Option<&'a [f64]>,
}

impl LabelEvidence<'_> {
    /// The probability of each label.
    ///
    /// # Errors
    /// [`InvalidEvidence`] if lengths differ, a value is outside its range, or all likelihoods are 0.
    pub fn posterior(&self) -> Result<Vec<f64>, InvalidEvidence> {
        let labels = self.likelihoods.len();
        if !LABELS.contains(&labels) {
            return Err(InvalidEvidence::Labels { found: labels });
        }
        check("the likelihood", self.likelihoods, labels, f64::MAX, "a finite number of at least 0")?;
        check("the temporal prior", self.temporal, labels, 1.0, PROBABILITY)?;
        if let Some(spatial) = self.spatial {
            check("the spatial prior", spatial, labels, 1.0, PROBABILITY)?;
        }
        let highest = self.likelihoods.iter().copied().fold(0.0, f64::max);
        if highest <= 0.0 {
            return Err(InvalidEvidence::NothingPossible);
        }
        // The likelihoods have any scale. The highest becomes 1, so that the sum neither overflows nor vanishes.
        let weight = |label: usize| {
            let spatial = self.spatial.map_or(1.0, |spatial| spatial[label].max(PRIOR_MIN));
            self.likelihoods[label] / highest * self.temporal[label].max(PRIOR_MIN) * spatial
        };
        let mut posterior: Vec<f64> = (0..labels).map(weight).collect();
        let sum: f64 = posterior.iter().sum();
        posterior.iter_mut().for_each(|probability| *probability /= sum);
        Ok(posterior)
    }
}

/// Divides shares of labels by their sum, so that they sum to 1, and returns the sum. Shares that are all 0 become
/// equal, and their sum counts as 1.
pub fn normalise(shares: &mut [f64]) -> f64 {
    let sum: f64 = shares.iter().sum();
    if sum > 0.0 && sum.is_finite() {
        shares.iter_mut().for_each(|share| *share /= sum);
        return sum;
    }
    let equal = 1.0 / shares.len().max(1) as f64;
    shares.fill(equal);
    1.0
}

/// Entropy of a distribution over labels, bits.
#[must_use]
pub fn entropy_of_labels_bits(shares: &[f64]) -> f64 {
    shares.iter().filter(|share| **share > 0.0).map(|&share| -share * libm::log2(share)).sum::<f64>().max(0.0)
}

const PROBABILITY: &str = "a probability, from 0 to 1";

fn check(
    what: &'static str,
    values: &[f64],
    labels: usize,
    max: f64,
    right: &'static str,
) -> Result<(), InvalidEvidence> {
    if values.len() != labels {
        return Err(InvalidEvidence::Length { what, expected: labels, found: values.len() });
    }
    // NaN is in no range.
    match values.iter().position(|value| !(0.0..=max).contains(value)) {
        Some(label) => Err(InvalidEvidence::Value { what, label, found: values[label], right }),
        None => Ok(()),
    }
}

/// The number of observations of each label at each place.
#[derive(Clone, Debug, PartialEq)]
pub struct LabelPlaces {
    /// The number of observations by place, then by label.
    counts: Vec<Vec<f64>>,
    /// The number of observations at all places, by label.
    totals: Vec<f64>,
}

impl LabelPlaces {
    /// A table of places without any observation.
    ///
    /// # Errors
    /// [`InvalidEvidence::Labels`] if there are too few or too many labels.
    pub fn new(labels: usize, places: usize) -> Result<Self, InvalidEvidence> {
        if !LABELS.contains(&labels) {
            return Err(InvalidEvidence::Labels { found: labels });
        }
        Ok(Self { counts: vec![vec![0.0; labels]; places], totals: vec![0.0; labels] })
    }

    /// Counts an observation of a label at a place.
    ///
    /// # Errors
    /// [`InvalidEvidence::Unknown`] if there is no such label or place; the observation is then not counted.
    pub fn add(&mut self, label: usize, place: usize) -> Result<(), InvalidEvidence> {
        self.add_many(label, place, 1.0)
    }

    /// Counts observations of a label at a place; their number, at least 0, may have a fraction.
    ///
    /// # Errors
    /// The errors of [`LabelPlaces::add`]; also an error if the number is negative or not finite.
    pub fn add_many(&mut self, label: usize, place: usize, count: f64) -> Result<(), InvalidEvidence> {
        if !(0.0..=f64::MAX).contains(&count) {
            let (what, right) = ("the number of observations", "a finite number of at least 0");
            return Err(InvalidEvidence::Value { what, label, found: count, right });
        }
        let unknown = |what, found, count| InvalidEvidence::Unknown { what, found, count };
        let (labels, places) = (self.totals.len(), self.counts.len());
        let total = self.totals.get_mut(label).ok_or(unknown("label", label, labels))?;
        self.counts.get_mut(place).ok_or(unknown("place", place, places))?[label] += count;
        *total += count;
        Ok(())
    }

    /// For each label, the probability of being at the place while it holds, by Laplace's rule of succession over the
    /// places that have any observation. A place without observations has no prior: it is no evidence for any label.
    pub fn prior(&self, place: usize) -> Option<Vec<f64>> {
        let has_any = |counts: &[f64]| counts.iter().any(|&count| count > 0.0);
        let counts = self.counts.get(place).filter(|counts| has_any(counts))?;
        let places = self.counts.iter().filter(|counts| has_any(counts)).count() as f64;
        Some(counts.iter().zip(&self.totals).map(|(count, total)| (count + 1.0) / (total + places)).collect())
    }
}

#[cfg(test)]
mod tests;
