//! Means over the seeds of an experiment.

/// A mean over seeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeedMean {
    /// The mean.
    pub mean: f64,
    /// The standard error of the mean; none for a single seed.
    pub standard_error: Option<f64>,
}

impl SeedMean {
    /// The mean of one value for each seed.
    pub fn of(values: &[f64]) -> Self {
        let count = values.len().max(1) as f64;
        let mean = values.iter().sum::<f64>() / count;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        let standard_error = (values.len() > 1).then(|| (squares / (count - 1.0) / count).sqrt());
        Self { mean, standard_error }
    }
}
