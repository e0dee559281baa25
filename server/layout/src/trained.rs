//! Models of a state that were trained on its readings, apart from the calibrated model.
//!
//! Invariant: a list of numbers has the length that the model requires; the reader checks that.

/// The models of a state after their last training; a model is absent before its first training.
#[derive(Clone, PartialEq, prost::Message)]
pub struct TrainedModels {
    /// The periodic mixture of Gaussians.
    #[prost(message, optional, tag = "1")]
    pub pergam: Option<Pergam>,
    /// Warped hypertime by expectation-maximisation.
    #[prost(message, optional, tag = "2")]
    pub hypertime_em: Option<Hypertime>,
    /// Warped hypertime by k-means.
    #[prost(message, optional, tag = "3")]
    pub hypertime_km: Option<Hypertime>,
    /// The rate of counts.
    #[prost(message, optional, tag = "4")]
    pub poisson: Option<Poisson>,
}

/// The last training of a model, and the errors of the model since.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub struct Training {
    /// The last local day that the model was trained on, in days since 1970-01-01.
    #[prost(sint32, tag = "1")]
    pub day: i32,
    /// Faded sum of errors; absent before the first day that the model was scored on.
    #[prost(fixed64, optional, tag = "2")]
    pub error_sum_bits: Option<u64>,
}

/// A periodic mixture of Gaussians.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Pergam {
    /// The last training of the model.
    #[prost(message, optional, tag = "1")]
    pub training: Option<Training>,
    /// Period of the mixture, in nanoseconds.
    #[prost(sint64, tag = "2")]
    pub period_nanos: i64,
    /// Weight, mean and standard deviation of each Gaussian; mean and standard deviation are in seconds.
    #[prost(fixed64, repeated, tag = "3")]
    pub gaussians_bits: Vec<u64>,
}

/// The rate of counts, a mean with periodic components.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Poisson {
    /// The last training of the model.
    #[prost(message, optional, tag = "1")]
    pub training: Option<Training>,
    /// Length of a bin.
    #[prost(sint64, tag = "2")]
    pub bin_nanos: i64,
    /// Mean and lowest count of a bin, and number of readings in an observed bin.
    #[prost(fixed64, repeated, tag = "3")]
    pub rate_bits: Vec<u64>,
    /// Indices of the components among the map's periodicities.
    #[prost(uint32, repeated, tag = "4")]
    pub periodicities: Vec<u32>,
    /// Real and imaginary part of each component, in counts of a bin.
    #[prost(fixed64, repeated, tag = "5")]
    pub gammas_bits: Vec<u64>,
}

/// A warped hypertime model.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Hypertime {
    /// The last training of the model.
    #[prost(message, optional, tag = "1")]
    pub training: Option<Training>,
    /// The periods of the model, as divisors of their cycles.
    #[prost(uint32, repeated, tag = "2")]
    pub divisors: Vec<u32>,
    /// For a probability: mean, background, ln of the factors of ones and of zeros. Otherwise empty.
    #[prost(fixed64, repeated, tag = "3")]
    pub odds_bits: Vec<u64>,
    /// For a continuous value or a count: centre, scale, lowest and highest value. Otherwise empty.
    #[prost(fixed64, repeated, tag = "4")]
    pub axis_bits: Vec<u64>,
    /// Clusters of readings that are 1, or of continuous values or counts.
    #[prost(message, repeated, tag = "5")]
    pub clusters: Vec<Cluster>,
    /// Clusters of readings that are 0.
    #[prost(message, repeated, tag = "6")]
    pub zeros: Vec<Cluster>,
    /// For a probability: the factor on the ratio of the densities. Otherwise 0.
    #[prost(fixed64, tag = "7")]
    pub gain_bits: u64,
    /// The cycle that each period divides.
    #[prost(sint64, repeated, tag = "8")]
    pub cycle_nanos: Vec<i64>,
}

/// A cluster in hypertime.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Cluster {
    /// Share of the readings that belong to the cluster.
    #[prost(fixed64, tag = "1")]
    pub weight_bits: u64,
    /// Mean of the cluster, one number per coordinate, as bits of f64.
    #[prost(fixed64, repeated, tag = "2")]
    pub centre_bits: Vec<u64>,
    /// Rows of the lower triangular factor of the covariance of the cluster.
    #[prost(fixed64, repeated, tag = "3")]
    pub factor_bits: Vec<u64>,
    /// Direction on the circle of each period, in radians.
    #[prost(fixed64, repeated, tag = "4")]
    pub directions_bits: Vec<u64>,
    /// Concentration around each of these directions.
    #[prost(fixed64, repeated, tag = "5")]
    pub concentrations_bits: Vec<u64>,
}
