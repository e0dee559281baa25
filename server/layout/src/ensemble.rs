//! The ensembles of states.
//!
//! Invariant: a list of numbers has the length that the model requires; the reader checks that. Lists of singles are
//! IEEE 754 singles of four bytes, little-endian.

/// The learned data of an ensemble of probabilities; absent where the ensemble is not enabled.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Ensemble {
    /// Sum and number of all half-hour bins.
    #[prost(fixed64, repeated, tag = "1")]
    pub bins_bits: Vec<u64>,
    /// The last learned day, in days since 1970-01-01.
    #[prost(sint32, optional, tag = "2")]
    pub last_day: Option<i32>,
    /// Singles of the table of all history: 168 sums, 168 numbers of bins by hour of the week from Monday on, 24
    /// weights of priors.
    #[prost(bytes = "vec", tag = "3")]
    pub all: Vec<u8>,
    /// Singles of the table with a half-life of a week, in the form of `all`.
    #[prost(bytes = "vec", tag = "4")]
    pub recent: Vec<u8>,
    /// Singles by half-hour, first of weekdays, then of weekends: 96 sums, 96 numbers, 96 newest bins, below 0 for
    /// none.
    #[prost(bytes = "vec", tag = "5")]
    pub alike: Vec<u8>,
    /// Values of 126 days, each at its number modulo 126: bits by half-hour in 8 bytes, then 48 values of four bits, in
    /// fourteenths, the earlier in the lower bits. Empty before the first day.
    #[prost(bytes = "vec", tag = "6")]
    pub recall: Vec<u8>,
    /// Residuals of 42 days, each at its number modulo 42: 48 signed bytes. Empty before the first day.
    #[prost(bytes = "vec", tag = "7")]
    pub residuals: Vec<u8>,
    /// The last day of the residuals.
    #[prost(sint32, optional, tag = "8")]
    pub residuals_day: Option<i32>,
    /// Singles by rotation from 2 to 42 days: 41 sums of products, 41 of squares.
    #[prost(bytes = "vec", tag = "9")]
    pub rotations: Vec<u8>,
    /// Means of five days.
    #[prost(message, repeated, tag = "10")]
    pub five_days: Vec<FiveDays>,
    /// The first day of the season.
    #[prost(sint32, optional, tag = "11")]
    pub season_first: Option<i32>,
    /// The last day of the season.
    #[prost(sint32, optional, tag = "12")]
    pub season_last: Option<i32>,
    /// Gaps between observed days, by class.
    #[prost(uint32, repeated, tag = "13")]
    pub gaps: Vec<u32>,
    /// The rhythm of the year: mean, then cosine and sine of three harmonics.
    #[prost(fixed64, repeated, tag = "14")]
    pub rhythm_bits: Vec<u64>,
    /// Singles of the stack that forgets slowly: 105 sums of squares, 14 of products, 14 weights.
    #[prost(bytes = "vec", tag = "15")]
    pub slow_stack: Vec<u8>,
    /// Singles of the stack that forgets fast, in the form of `slow_stack`.
    #[prost(bytes = "vec", tag = "16")]
    pub fast_stack: Vec<u8>,
    /// Singles: the losses of the members.
    #[prost(bytes = "vec", tag = "17")]
    pub losses: Vec<u8>,
    /// The classes of lead times, the shortest first.
    #[prost(message, repeated, tag = "18")]
    pub classes: Vec<Class>,
    /// Singles: sums of the correction, then of the dependence of neighbouring half-hours.
    #[prost(bytes = "vec", tag = "19")]
    pub calibration: Vec<u8>,
    /// The smooth table by hour of weekdays, then of weekends; empty if there is none.
    #[prost(fixed64, repeated, tag = "20")]
    pub smooth_bits: Vec<u64>,
    /// The number of bins for which the smooth table was made.
    #[prost(fixed64, tag = "21")]
    pub smooth_bins_bits: u64,
}

/// The bins of five days.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub struct FiveDays {
    /// The first observed day.
    #[prost(sint32, tag = "1")]
    pub day: i32,
    /// Mean of the bins, the bits of a single.
    #[prost(fixed32, tag = "2")]
    pub mean_bits: u32,
    /// Number of the bins, the bits of a single.
    #[prost(fixed32, tag = "3")]
    pub bins_bits: u32,
}

/// A class of lead times.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Class {
    /// Singles: the losses of the members at these lead times, the numbers of bins explained by the pool and by the
    /// mean, and the number of bins.
    #[prost(bytes = "vec", tag = "1")]
    pub numbers: Vec<u8>,
    /// The forecast that was stored at the last turn of the class.
    #[prost(message, optional, tag = "2")]
    pub newer: Option<StoredForecast>,
    /// The forecast that was stored at the turn before.
    #[prost(message, optional, tag = "3")]
    pub older: Option<StoredForecast>,
}

/// The forecasts of the members for a week, stored at the end of a day.
#[derive(Clone, PartialEq, prost::Message)]
pub struct StoredForecast {
    /// The day at whose end the forecast was stored, in days since 1970-01-01.
    #[prost(sint32, tag = "1")]
    pub day: i32,
    /// The mean of all bins, the bits of a single.
    #[prost(fixed32, tag = "2")]
    pub mean_bits: u32,
    /// Forecasts by hour of the week in 255ths: of the table of all history, of the recent one, of the chosen model.
    #[prost(bytes = "vec", tag = "3")]
    pub weeks: Vec<u8>,
    /// The rhythm of the year, in the form of [`Ensemble::rhythm_bits`].
    #[prost(fixed64, repeated, tag = "4")]
    pub rhythm_bits: Vec<u64>,
}

/// The learned data of an ensemble of continuous values or counts.
#[derive(Clone, PartialEq, prost::Message)]
pub struct NumberEnsemble {
    /// The last learned day, in days since 1970-01-01.
    #[prost(sint32, optional, tag = "1")]
    pub last_day: Option<i32>,
    /// Doubles, little-endian; all values are relative to the first reading. In this order:
    /// - the first reading;
    /// - number, mean and summed squared deviations of all half-hour bins;
    /// - losses of 11 members, and the number of bins of these losses;
    /// - by hour of the day 24 sums and 24 numbers of bins, for each weekday from Monday on, then for weekdays and for
    ///   the weekend in tables with half-lives of 21, 7 and 2 days;
    /// - for the slow and for the fast stack 121 sums of squares, 11 of products, 11 weights;
    /// - by hour of weekdays, then of the weekend: sum of squares and number of errors;
    /// - for each lead-time class, the shortest first: 49 sums of squares, 7 of products, 7 weights, losses of 3
    ///   members and the number of bins of these losses, sum of squares and number of errors, four means of tables at
    ///   the last turn of the class, and four at the turn before;
    /// - for each of 14 days, at its number modulo 14, 48 values by half-hour.
    #[prost(bytes = "vec", tag = "2")]
    pub numbers: Vec<u8>,
    /// One number for each of the 14 days: a bit for each half-hour, set if it has a reading.
    #[prost(fixed64, repeated, tag = "3")]
    pub seen: Vec<u64>,
    /// The turns of the five lead-time classes.
    #[prost(message, repeated, tag = "4")]
    pub turns: Vec<Turns>,
}

/// The last turns of a lead-time class.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Turns {
    /// The days of the turns, the newer first; at most two.
    #[prost(sint32, repeated, tag = "1")]
    pub days: Vec<i32>,
}
