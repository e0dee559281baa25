//! How a warped hypertime model is fitted.

use crate::models::CannotFit;

/// How clusters in hypertime are found (RA-L 2019 section III.H).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum HypertimeMethod {
    /// HyT-EM: expectation-maximisation of as many Gaussians as asked for.
    Em,
    /// HyT-KM: cosine distance on the circles, and more clusters for as long as that leaves weaker periods in the
    /// error. It goes by the mean alone: for the shape of a distribution, ask HyT-EM for as many clusters as it has
    /// peaks.
    Km,
}

/// How a hypertime model is fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HypertimeOptions {
    /// How the clusters are found.
    pub method: HypertimeMethod,
    /// How many clusters (HyT-EM; of a probability, for each of the two values), or at most how many (HyT-KM); from 1
    /// to [`HypertimeOptions::CLUSTERS_MAX`]. Fewer where there are fewer distinct readings.
    pub clusters: usize,
    /// What the starts of the clustering and the readings left out are drawn from.
    pub seed: u64,
}

impl HypertimeOptions {
    /// The most clusters that may be asked for.
    pub const CLUSTERS_MAX: usize = 50;

    pub(super) fn check(&self) -> Result<(), CannotFit> {
        if (1..=HypertimeOptions::CLUSTERS_MAX).contains(&self.clusters) {
            Ok(())
        } else {
            let (parameter, found) = ("clusters", self.clusters as f64);
            Err(CannotFit::Parameter { parameter, found, expected: "1 to 50" })
        }
    }
}

impl Default for HypertimeOptions {
    /// HyT-KM with up to ten clusters: it depends least on the seed.
    fn default() -> HypertimeOptions {
        HypertimeOptions { method: HypertimeMethod::Km, clusters: 10, seed: 0 }
    }
}
