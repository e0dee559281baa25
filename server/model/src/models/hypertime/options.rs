//! The options of training a warped hypertime model.

use crate::models::CannotTrain;

/// The method of clustering in hypertime (RA-L 2019 section III.H).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum HypertimeMethod {
    /// HyT-EM: expectation-maximisation with the given number of Gaussians.
    Em,
    /// HyT-KM: cosine distance on the circles, with more clusters as long as that weakens the periods left in the
    /// error. It judges the mean only: for the shape of a distribution, use HyT-EM with one cluster per peak.
    Km,
}

/// The options of training a hypertime model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HypertimeOptions {
    /// The method of clustering.
    pub method: HypertimeMethod,
    /// Number of clusters (HyT-EM; for a probability, for each of the two values), or the maximum (HyT-KM); 1 to
    /// [`HypertimeOptions::CLUSTERS_MAX`]. Fewer where there are fewer distinct readings.
    pub clusters: usize,
    /// Seed of the starts of the clustering; in a field, also of the draw of readings.
    pub seed: u64,
}

impl HypertimeOptions {
    /// The maximum number of clusters.
    pub const CLUSTERS_MAX: usize = 50;

    pub(super) fn check(&self) -> Result<(), CannotTrain> {
        if (1..=HypertimeOptions::CLUSTERS_MAX).contains(&self.clusters) {
            Ok(())
        } else {
            let (parameter, found) = ("clusters", self.clusters as f64);
            Err(CannotTrain::Parameter { parameter, found, expected: "1 to 50" })
        }
    }
}

impl Default for HypertimeOptions {
    /// HyT-KM with up to ten clusters: it depends least on the seed.
    fn default() -> HypertimeOptions {
        HypertimeOptions { method: HypertimeMethod::Km, clusters: 10, seed: 0 }
    }
}
