//! How uncertain a prediction is, and what observing it would teach.
//!
//! Information is in bits throughout. Invariant: no answer is NaN or negative.

/// The certainty that is left after an observation, p_c of RA-L eq. 3.
pub const INFORMATION_CERTAINTY: f64 = 0.95;

/// Entropy of a binary state with probability `p`, in bits, 0 to 1. Outside `[0,1]` counts as the nearer
/// end, and NaN, of which nothing is known, as 0.5.
pub fn entropy_bits(p: f64) -> f64 {
    let p = if p.is_nan() { 0.5 } else { p.clamp(0.0, 1.0) };
    // x·log2 x tends to 0 with x; evaluated it would be NaN.
    let term = |x: f64| if x > 0.0 { -x * x.log2() } else { 0.0 };
    term(p) + term(1.0 - p)
}

/// Information expected from observing a state that is predicted with probability `p`, in bits:
/// H(p) - H(certainty), never below 0 (RA-L eq. 3). `p` is clipped to `[0.05,0.95]`.
pub fn information_gain_bits(p: f64, certainty: f64) -> f64 {
    (entropy_bits(p.clamp(0.05, 0.95)) - entropy_bits(certainty)).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-12
    }

    #[test]
    fn entropy_has_its_known_values() {
        assert!(close(entropy_bits(0.5), 1.0));
        assert!(close(entropy_bits(0.25), 0.811_278_124_459_132_8));
        assert!(close(entropy_bits(0.05), 0.286_396_957_115_956_4));
        assert!(close(entropy_bits(0.0), 0.0));
        assert!(close(entropy_bits(1.0), 0.0));
        assert!(close(entropy_bits(0.3), entropy_bits(0.7)));
    }

    #[test]
    fn information_gain_has_its_known_values() {
        let gain = |p| information_gain_bits(p, INFORMATION_CERTAINTY);
        assert!(close(gain(0.5), 1.0 - 0.286_396_957_115_956_4));
        assert!(close(gain(0.25), 0.811_278_124_459_132_8 - 0.286_396_957_115_956_4));
        assert!(close(gain(0.0), 0.0));
        assert!(close(gain(0.97), 0.0));
        assert!(close(information_gain_bits(0.1, 0.5), 0.0));
    }

    proptest::proptest! {
        #[test]
        fn neither_is_ever_nan_or_negative(p in proptest::num::f64::ANY, certainty in proptest::num::f64::ANY) {
            for bits in [entropy_bits(p), information_gain_bits(p, certainty)] {
                proptest::prop_assert!((0.0..=1.0 + 1e-12).contains(&bits), "{bits}");
            }
        }
    }
}
