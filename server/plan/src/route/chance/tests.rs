//! Intervals close to the normal, and moments of products against sums.

use tidemap_model::special::beta_quantile;

use super::*;

#[test]
fn a_large_beta_is_nearly_normal() {
    let (mean, evidence) = (0.3_f64, 1e6_f64);
    let deviation = (mean * (1.0 - mean) / (evidence + 1.0)).sqrt();
    let Interval { lower, upper } = Chance::new(mean, evidence).interval(0.9);
    assert!((lower - (mean - 1.644_853_6 * deviation)).abs() < 1e-3 * deviation, "{lower}");
    assert!((upper - (mean + 1.644_853_6 * deviation)).abs() < 1e-3 * deviation, "{upper}");
}

#[test]
fn a_product_has_the_moments_of_its_factors() {
    // E[P] and E[P²] of Beta(m n, (1 - m) n) are m and m (m n + 1) / (n + 1).
    let factors = [(0.9_f64, 20.0_f64), (0.5, 3.0), (0.99, 0.5), (1.0, 7.0)];
    let product = factors.iter().fold(Chance::CERTAIN, |all, &(m, n)| all.and(Chance::new(m, n)));
    let mean: f64 = factors.iter().map(|&(m, _)| m).product();
    let square: f64 = factors.iter().map(|&(m, n)| m * (m * n + 1.0) / (n + 1.0)).product();
    let variance = square - mean * mean;
    assert!((product.log_mean.exp() - mean).abs() < 1e-14);
    assert!((product.log_spread.exp_m1() * mean * mean - variance).abs() < 1e-14);
    let evidence = mean * (1.0 - mean) / variance - 1.0;
    let (alpha, beta) = (mean * evidence, (1.0 - mean) * evidence);
    let Interval { lower, upper } = product.interval(0.8);
    assert!((lower - beta_quantile(alpha, beta, 0.1)).abs() < 1e-9);
    assert!((upper - beta_quantile(alpha, beta, 0.9)).abs() < 1e-9);
}

#[test]
fn extremes_stay_in_range() {
    for mean in [1e-9, 1e-3, 0.5, 1.0 - 1e-12, 1.0] {
        for evidence in [1e-300, 1e-9, 1.0, 1e6, 1e300, f64::INFINITY] {
            for confidence in [0.5, 0.9, 1.0 - 1e-12] {
                let mut chance = Chance::CERTAIN;
                for _ in 0..300 {
                    let Interval { lower, upper } = chance.interval(confidence);
                    assert!((0.0..=1.0).contains(&lower) && lower <= upper && upper <= 1.0, "{mean} {evidence}");
                    chance = chance.and(Chance::new(mean, evidence)).and(chance);
                    if chance.log_mean < -1e4 {
                        break;
                    }
                }
            }
        }
    }
    assert_eq!(Chance::new(1.0, 3.0).interval(0.9), Interval { lower: 1.0, upper: 1.0 });
}
