//! The amount of work of a search for a route. Plans use [`SearchWork::USUAL`]; tests compare it with other values.
//!
//! Invariant: for any amount of work, a result never claims more certainty than it has.

/// The work of a search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SearchWork {
    /// Forecasts are requested at whole multiples of this, in seconds, and paths to a node that arrive within it count
    /// as arriving together. With 0 both are exact.
    pub resolution_secs: f64,
    /// Labels of the attempt at a proof, by the bounds of [`Forecasts::best`](super::Forecasts::best). An edge without
    /// a bound counts as certain to succeed, in no time. So no better route is missed, but on a map of more than about
    /// 15 nodes the labels do not suffice without bounds. Then, and with 0, bounds are sampled.
    pub proof_labels: usize,
    /// Sampled bounds are the best of about this many forecasts of an edge, at least 1, spread evenly over twice the
    /// time of a good route. A route is missed only if an edge of it is better, or open, between the samples only; this
    /// cannot be excluded.
    pub samples: u32,
    /// Maximum number of labels (partial routes) of one search, at least 1; 64 bytes each. With sampled bounds a
    /// quarter of them is tried first; then edges are sampled again, closer to the time at which a good route reaches
    /// them; if that does not suffice, paths count as arriving together within 16 times the resolution, and the result
    /// is [`Certainty::CutOff`](super::Certainty::CutOff). All alternatives together are one search.
    pub labels_max: usize,
    /// The step of departures for an arrival, in seconds, above 0.
    pub arrival_step_secs: f64,
}

impl SearchWork {
    /// The work of every plan.
    pub(crate) const USUAL: SearchWork = SearchWork {
        resolution_secs: 1.0,
        proof_labels: 5_000,
        samples: 4,
        labels_max: 200_000,
        arrival_step_secs: 60.0,
    };
}
