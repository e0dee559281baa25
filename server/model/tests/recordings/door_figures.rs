//! The figures of an independent implementation on the office door of RA-L 2019, learned from `train.csv` in the zone
//! Europe/London. The tests of the library and of the daemon include this file.
//!
//! Invariant: errors are mean squared errors, with five digits after the point.

/// The orders of [`ERRORS`].
pub(crate) const ORDERS: [usize; 7] = [0, 1, 2, 3, 5, 10, 15];

/// For each file, the number of observations and the error of each of the [`ORDERS`].
pub(crate) const ERRORS: [(&str, f64, [f64; 7]); 5] = [
    ("train.csv", 96_480.0, [0.10418, 0.08797, 0.08290, 0.07886, 0.07336, 0.06623, 0.06262]),
    ("week1.csv", 10_020.0, [0.09041, 0.07968, 0.07317, 0.06892, 0.06864, 0.06652, 0.06502]),
    ("week2.csv", 10_080.0, [0.07722, 0.07048, 0.06826, 0.06614, 0.06961, 0.07333, 0.07124]),
    ("week3.csv", 10_080.0, [0.08351, 0.07580, 0.07506, 0.07378, 0.07327, 0.07059, 0.06866]),
    ("week4.csv", 8_640.0, [0.09121, 0.08078, 0.07304, 0.06750, 0.06325, 0.05400, 0.05212]),
];

/// The greatest difference of an error or an amplitude from these figures.
pub(crate) const TOLERANCE: f64 = 0.0002;

/// Period in seconds and amplitude of the strongest components.
pub(crate) const COMPONENTS: [(f64, f64); 5] =
    [(86_400.0, 0.1773), (604_800.0, 0.0898), (21_600.0, 0.0808), (302_400.0, 0.0764), (75_600.0, 0.0682)];
