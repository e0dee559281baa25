//! The uncertainty of a prediction.
//!
//! Information is in bits throughout. Invariant: no result is NaN or negative.

/// The certainty that is left after an observation, p_c of RA-L eq. 3.
pub const INFORMATION_CERTAINTY: f64 = 0.95;

/// Entropy of a binary state with probability `p`, in bits, 0 to 1. A `p` outside `[0,1]` counts as the nearer end, and
/// NaN counts as 0.5 (nothing is known).
pub fn entropy_bits(p: f64) -> f64 {
    let p = if p.is_nan() { 0.5 } else { p.clamp(0.0, 1.0) };
    // x·log2 x tends to 0 with x, but its evaluation at 0 would give NaN.
    let term = |x: f64| if x > 0.0 { -x * libm::log2(x) } else { 0.0 };
    let bits = term(p) + term(1.0 - p);
    debug_assert!(bits >= 0.0, "{bits} bits of {p}");
    bits
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

    proptest::proptest! {
        #[test]
        fn entropy_is_never_nan_or_negative(p in proptest::num::f64::ANY) {
            let bits = entropy_bits(p);
            proptest::prop_assert!((0.0..=1.0 + 1e-12).contains(&bits), "{bits}");
        }
    }
}
