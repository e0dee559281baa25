//! Options of the training of a calibrated model.

use crate::models::CannotTrain;

/// The options of training a [`Calibrated`] model.
///
/// The defaults were chosen by rolling origin on ten weeks of one office door: of the settings whose error was within
/// half a percent of the lowest, the one with the longest memory, then the least caution. The error is flat around this
/// choice.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibratedOptions {
    /// Standard deviation of the Gaussian that smooths each day over time of day, in seconds, 0 to 86,400.
    pub smoothing_secs: f64,
    /// Standard deviation of the Gaussian that smooths the broad daily profile, in seconds, 0 to 86,400. The time of
    /// day is shrunk towards that profile if there is little data.
    pub broad_smoothing_secs: f64,
    /// The time in days, above 0, with which days lose weight: a day that is `a` days older than the newest counts
    /// 1/(1 + a/memory). Infinite: all have equal weight.
    pub memory_days: f64,
    /// The factor above 0 by which a tier is shrunk more towards the one before than by the credibility formula; 1 is
    /// Bühlmann's formula. More than 1 allows for routines that do not last.
    pub caution: f64,
    /// The factor of `caution` for the last tier, the days of the week.
    pub day_of_week_caution: f64,
}

impl Default for CalibratedOptions {
    fn default() -> CalibratedOptions {
        CalibratedOptions {
            smoothing_secs: 300.0,
            broad_smoothing_secs: 3600.0,
            memory_days: 14.0,
            caution: 8.0,
            day_of_week_caution: 2.0,
        }
    }
}

impl CalibratedOptions {
    pub(super) fn check(&self) -> Result<(), CannotTrain> {
        let day = "0 to 86400 seconds";
        for (parameter, found) in
            [("smoothing_secs", self.smoothing_secs), ("broad_smoothing_secs", self.broad_smoothing_secs)]
        {
            if !(0.0..=86_400.0).contains(&found) {
                return Err(CannotTrain::Parameter { parameter, found, expected: day });
            }
        }
        for (parameter, found) in [
            ("memory_days", self.memory_days),
            ("caution", self.caution),
            ("day_of_week_caution", self.day_of_week_caution),
        ] {
            if found.is_nan() || found <= 0.0 {
                return Err(CannotTrain::Parameter { parameter, found, expected: "a number above 0" });
            }
        }
        Ok(())
    }
}
