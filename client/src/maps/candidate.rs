//! Models from which the nightly update of a map selects.
//!
//! Invariant: a name reads back as the model that it was written from.

use std::str::FromStr;

use tidemap_proto::v1::ModelKind;

/// A model from which updates can select.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Candidate {
    /// FreMEn; always included, order 0 is the mean.
    Spectral,
    /// Histograms of day and week.
    Histogram,
    /// A profile of day and week.
    Calibrated,
    /// Periodic mixture of Gaussians over the day; for probabilities only.
    Pergam,
    /// Warped hypertime, by expectation maximisation.
    HypertimeEm,
    /// Warped hypertime, by k-means.
    HypertimeKm,
    /// The rate of counts, a mean with rhythms; for counts only.
    Poisson,
}

/// A text that does not name such a model.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?} is not a model that the nightly update chooses among: use spectral, histogram, calibrated, poisson, \
     pergam, hypertime-em or hypertime-km, or all"
)]
pub struct InvalidCandidate(pub String);

impl Candidate {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::Spectral,
        Self::Histogram,
        Self::Calibrated,
        Self::Poisson,
        Self::Pergam,
        Self::HypertimeEm,
        Self::HypertimeKm,
    ];

    /// Name, as on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Spectral => "spectral",
            Self::Histogram => "histogram",
            Self::Calibrated => "calibrated",
            Self::Pergam => "pergam",
            Self::HypertimeEm => "hypertime-em",
            Self::HypertimeKm => "hypertime-km",
            Self::Poisson => "poisson",
        }
    }

    fn kind(self) -> ModelKind {
        match self {
            Self::Spectral => ModelKind::Spectral,
            Self::Histogram => ModelKind::Histogram,
            Self::Calibrated => ModelKind::Calibrated,
            Self::Pergam => ModelKind::Pergam,
            Self::HypertimeEm => ModelKind::HypertimeEm,
            Self::HypertimeKm => ModelKind::HypertimeKm,
            Self::Poisson => ModelKind::Poisson,
        }
    }

    pub(super) fn to_wire(self) -> i32 {
        self.kind().into()
    }

    /// `None` for a model that this version does not know.
    pub(super) fn from_wire(kind: i32) -> Option<Self> {
        Self::ALL.into_iter().find(|candidate| candidate.to_wire() == kind)
    }
}

impl FromStr for Candidate {
    type Err = InvalidCandidate;

    fn from_str(text: &str) -> Result<Self, InvalidCandidate> {
        let found = Self::ALL.into_iter().find(|candidate| candidate.name() == text);
        found.ok_or_else(|| InvalidCandidate(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_read_back_and_others_are_told_what_there_is() {
        for candidate in Candidate::ALL {
            assert_eq!(candidate.name().parse(), Ok(candidate));
            assert_eq!(Candidate::from_wire(candidate.to_wire()), Some(candidate));
        }
        for text in ["mean", "", "fremen", "pergam:3"] {
            let error = text.parse::<Candidate>().expect_err(text).to_string();
            assert!(error.contains(&format!("{text:?}")) && error.contains("hypertime-km"), "{error}");
        }
        assert_eq!(Candidate::from_wire(0), None);
    }
}
