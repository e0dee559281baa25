//! The options of the hall.
//!
//! Invariant: the default drift and noise are those of a robot with a particle filter and a scanner of its price.

use jiff::civil::{Date, date};

/// Size and errors of the patrols of a hall.
#[derive(Clone, Debug, PartialEq)]
pub struct HallOptions {
    /// A different seed gives other times, errors and places of scans, in an equal hall.
    pub seed: u64,
    /// Time zone of the hall's clock.
    pub zone: String,
    /// The first day.
    pub first_day: Date,
    /// Places of a patrol at which both scanners scan; at least 1.
    pub stops: u32,
    /// Beams of a scan.
    pub beams: u32,
    /// Maximum distance of the reported pose from the true pose.
    pub drift_m: f64,
    /// Maximum angle of the reported pose from the true pose.
    pub drift_rad: f64,
    /// Standard deviation of a range.
    pub noise_m: f64,
}

impl Default for HallOptions {
    /// A Monday in London; a pair of scans each two metres.
    fn default() -> Self {
        Self {
            seed: 1,
            zone: "Europe/London".to_owned(),
            first_day: date(2025, 3, 3),
            stops: 60,
            beams: 360,
            drift_m: 0.1,
            drift_rad: 0.003,
            noise_m: 0.015,
        }
    }
}
