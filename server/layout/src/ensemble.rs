//! The ensembles of states.
//!
//! Invariant: a list of numbers has the length that the model requires; the reader checks that. Lists of singles are
//! IEEE 754 singles of four bytes, little-endian.

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
