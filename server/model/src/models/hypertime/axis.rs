//! Standardises a coordinate, so that distances along it are comparable with those on a circle.
//!
//! Invariant: for all finite observed numbers, standardised ones are finite and bounded.

use crate::InvalidParts;
use crate::special::square;

/// The bound of standardised coordinates, far beyond anything observed.
const FARTHEST: f64 = 1e6;

/// The scale of one coordinate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HypertimeAxis {
    /// The mean of the readings, which is subtracted.
    pub centre: f64,
    /// The standard deviation, the divisor of the scale; above 0.
    pub scale: f64,
    /// Least number observed.
    pub low: f64,
    /// Greatest number observed.
    pub high: f64,
}

impl HypertimeAxis {
    /// The axis of finite numbers, at least one.
    pub(super) fn of(numbers: impl Iterator<Item = f64> + Clone) -> HypertimeAxis {
        let (low, high) = numbers
            .clone()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), number| (low.min(number), high.max(number)));
        // The numbers are divided by the greatest, so that squares cannot overflow.
        let greatest = low.abs().max(high.abs()).max(f64::MIN_POSITIVE);
        let count = numbers.clone().count() as f64;
        let mean = numbers.clone().map(|number| number / greatest).sum::<f64>() / count;
        let squares: f64 = numbers.map(|number| square(number / greatest - mean)).sum();
        let deviation = (squares / count).sqrt();
        // If numbers are equal or nearly equal, their magnitude is the scale.
        let size = if greatest > f64::MIN_POSITIVE { greatest } else { 1.0 };
        let scale = if deviation > 1e-12 { deviation * greatest } else { size };
        HypertimeAxis { centre: (mean * greatest).clamp(low, high), scale: scale.max(f64::MIN_POSITIVE), low, high }
    }

    pub(super) fn standard(&self, number: f64) -> f64 {
        // The numbers are halved first, because the difference of two great numbers may be infinite.
        ((0.5 * number - 0.5 * self.centre) / self.scale * 2.0).clamp(-FARTHEST, FARTHEST)
    }

    /// Undoes the standardisation, limited to the observed range.
    pub(super) fn observed(&self, standard: f64) -> f64 {
        (self.centre + standard * self.scale).clamp(self.low, self.high)
    }

    /// The width of a cell along the axis, standardised.
    pub(super) fn standard_width(&self, width: f64) -> f64 {
        (width / self.scale).min(FARTHEST)
    }

    pub(super) fn check(&self) -> Result<(), InvalidParts> {
        InvalidParts::check("axis.low", self.low, f64::MIN..=f64::MAX)?;
        InvalidParts::check("axis.high", self.high, self.low..=f64::MAX)?;
        InvalidParts::check("axis.centre", self.centre, self.low..=self.high)?;
        InvalidParts::check("axis.scale", self.scale, f64::MIN_POSITIVE..=f64::MAX)
    }
}

/// Standardises each number by its axis.
pub(super) fn standardised(numbers: &[f64], axes: &[HypertimeAxis]) -> Vec<f64> {
    numbers.iter().zip(axes).map(|(&number, axis)| axis.standard(number)).collect()
}
