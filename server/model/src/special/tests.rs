//! Tests quantiles against known values and closed forms.

use super::*;

#[test]
fn the_normal_quantile_has_its_known_values() {
    let known = [
        (0.0, 0.0),
        (0.5, 0.674_489_750_196_081_7),
        (0.9, 1.644_853_626_951_472_2),
        (0.95, 1.959_963_984_540_054),
        (0.99, 2.575_829_303_548_900_4),
        (0.999_999, 4.891_638_475_698_83),
    ];
    for (level, z) in known {
        let found = normal_upper_quantile((1.0 - level) / 2.0);
        assert!((found - z).abs() < 1e-10, "{level}: {found}");
    }
}

#[test]
fn the_normal_quantile_inverts_the_tail() {
    for step in 0..=800 {
        let z = f64::from(step) / 100.0;
        let found = normal_upper_quantile(normal_tail(z));
        assert!((found - z).abs() < 1e-12, "{z}: {found}");
    }
}

#[test]
fn quantiles_are_those_in_closed_form() {
    for q in [0.001_f64, 0.05, 0.3, 0.5, 0.95, 0.999] {
        for a in [0.1_f64, 0.7, 1.0, 4.0, 60.0] {
            assert!((beta_quantile(a, 1.0, q) - q.powf(1.0 / a)).abs() < 1e-11, "Beta({a}, 1) at {q}");
            assert!((beta_quantile(1.0, a, q) - (1.0 - (1.0 - q).powf(1.0 / a))).abs() < 1e-11, "Beta(1, {a}) at {q}");
        }
        // Beta(1/2, 1/2) is the arcsine distribution.
        let arcsine = (std::f64::consts::FRAC_PI_2 * q).sin().powi(2);
        assert!((beta_quantile(0.5, 0.5, q) - arcsine).abs() < 1e-10, "arcsine at {q}");
        // Beta(2, 2) has the distribution function 3x² - 2x³.
        let x = beta_quantile(2.0, 2.0, q);
        assert!((3.0 * x * x - 2.0 * x * x * x - q).abs() < 1e-11, "Beta(2, 2) at {q}");
    }
}

#[test]
fn the_log_gamma_function_is_that_of_libm() {
    for step in 1..4_000 {
        let x = 0.001 * 1.005_f64.powi(step);
        let (found, known) = (ln_gamma(x), libm::lgamma(x));
        assert!((found - known).abs() < 1e-9 * known.abs().max(1.0), "{x}: {found} instead of {known}");
    }
}

#[test]
fn the_digamma_function_has_its_known_values() {
    // ψ(1) is minus Euler's constant, and ψ(1/2) is -γ - 2 ln 2.
    for (x, known) in [(1.0, -0.577_215_664_901_532_9), (0.5, -1.963_510_026_021_423_5), (10.0, 2.251_752_589_066_721)]
    {
        assert!((digamma(x) - known).abs() < 1e-9, "{x}: {}", digamma(x));
    }
}
