//! The von Mises distribution on a circle: its concentration around a direction.
//!
//! Its log-density falls with the cosine distance, as in RA-L 2019 section III.H: κ(cos Δ - 1) plus a constant.
//! Invariant: concentrations are between 0 and [`CONCENTRATION_MAX`], and everything here is finite.

use crate::special::square;

/// A deviation of about 1.3°, five minutes of a day.
pub(super) const CONCENTRATION_MAX: f64 = 2_000.0;

/// e^-κ I_0(κ), by the polynomials of Abramowitz and Stegun 9.8.1 and 9.8.2, to 2e-7.
fn scaled_bessel_0(kappa: f64) -> f64 {
    if kappa <= 3.75 {
        let t = square(kappa / 3.75);
        let series = [1.0, 3.515_622_9, 3.089_942_4, 1.206_749_2, 0.265_973_2, 0.036_076_8, 0.004_581_3];
        polynomial(&series, t) * libm::exp(-kappa)
    } else {
        let series = [
            0.398_942_28,
            0.013_285_92,
            0.002_253_19,
            -0.001_575_65,
            0.009_162_81,
            -0.020_577_06,
            0.026_355_37,
            -0.016_476_33,
            0.003_923_77,
        ];
        polynomial(&series, 3.75 / kappa) / kappa.sqrt()
    }
}

/// e^-κ I_1(κ), by Abramowitz and Stegun 9.8.3 and 9.8.4.
fn scaled_bessel_1(kappa: f64) -> f64 {
    if kappa <= 3.75 {
        let t = square(kappa / 3.75);
        let series = [0.5, 0.878_905_94, 0.514_988_69, 0.150_849_34, 0.026_587_33, 0.003_015_32, 0.000_324_11];
        kappa * polynomial(&series, t) * libm::exp(-kappa)
    } else {
        let series = [
            0.398_942_28,
            -0.039_880_24,
            -0.003_620_18,
            0.001_638_01,
            -0.010_315_55,
            0.022_829_67,
            -0.028_953_12,
            0.017_876_54,
            -0.004_200_59,
        ];
        polynomial(&series, 3.75 / kappa) / kappa.sqrt()
    }
}

/// Coefficients from the constant one up.
fn polynomial(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, coefficient| sum * x + coefficient)
}

/// The logarithm of 2π e^-κ I_0(κ), the divisor of a density e^(κ(cos Δ - 1)).
pub(super) fn log_normaliser(kappa: f64) -> f64 {
    libm::log(std::f64::consts::TAU * scaled_bessel_0(kappa))
}

/// The likeliest concentration for a mean resultant length between 0 and 1: κ with I_1(κ)/I_0(κ) = R. The iteration
/// starts from Banerjee et al., "Clustering on the unit hypersphere using von Mises-Fisher distributions", JMLR 2005,
/// eq. 4.4.
pub(super) fn concentration(resultant: f64) -> f64 {
    let resultant = resultant.clamp(0.0, 1.0 - 1e-9);
    let squared = resultant * resultant;
    let mut kappa = (resultant * (2.0 - squared) / (1.0 - squared)).min(CONCENTRATION_MAX);
    for _ in 0..3 {
        let ratio = scaled_bessel_1(kappa) / scaled_bessel_0(kappa);
        // A'(κ) = 1 - A/κ - A², a half at 0.
        let slope = if kappa > 1e-3 { 1.0 - ratio / kappa - ratio * ratio } else { 0.5 };
        if slope > 1e-6 {
            kappa = (kappa - (ratio - resultant) / slope).clamp(0.0, CONCENTRATION_MAX);
        }
    }
    kappa
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_density_on_the_circle_integrates_to_one() {
        for kappa in [0.0, 0.5, 3.7, 3.8, 40.0, CONCENTRATION_MAX] {
            let steps = 100_000;
            let sum: f64 = (0..steps)
                .map(|step| std::f64::consts::TAU * f64::from(step) / f64::from(steps))
                .map(|angle| libm::exp(kappa * (libm::cos(angle) - 1.0) - log_normaliser(kappa)))
                .sum();
            let integral = sum * std::f64::consts::TAU / f64::from(steps);
            assert!((integral - 1.0).abs() < 1e-5, "κ = {kappa}: {integral}");
        }
    }

    #[test]
    fn the_concentration_has_the_resultant_it_was_made_of() {
        for resultant in [0.0, 0.01, 0.3, 0.7, 0.95, 0.999] {
            let kappa = concentration(resultant);
            let found = scaled_bessel_1(kappa) / scaled_bessel_0(kappa);
            assert!((found - resultant).abs() < 1e-4, "{resultant}: κ = {kappa}, {found}");
        }
        assert!(concentration(1.0) <= CONCENTRATION_MAX);
    }
}
