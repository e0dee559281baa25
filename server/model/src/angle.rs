//! Angles: values on a circle, in radians.
//!
//! An angle is learned as its cosine and its sine, two continuous values, and predicted as the direction of the two
//! predictions: the mean of 350° and 10° is 0°, not 180° (K. V. Mardia and P. E. Jupp, "Directional Statistics", 2000,
//! section 2.2). Invariant: every angle that this module returns lies in [−π, π).

use std::f64::consts::{PI, TAU};

/// Names of the two states of an angle, in order.
pub const ANGLE_AXES: [&str; 2] = ["cos", "sin"];

/// The greatest magnitude of an observed angle, radians: both [−π, π) and [0, 2π) are in use. Greater ones are refused,
/// because they would mostly be degrees.
pub const ANGLE_MAX_RAD: f64 = TAU;

/// The requirement for an observed angle, for a message that ends "… is not".
pub const ANGLE_EXPECTED: &str = "an angle in radians, from -2π to 2π";

/// Whether an observed angle may have this value; never NaN or infinite.
pub fn allows_angle(angle_rad: f64) -> bool {
    angle_rad.abs() <= ANGLE_MAX_RAD
}

/// Cosine and sine of an angle, with the same digits on every machine.
pub fn cos_sin(angle_rad: f64) -> [f64; 2] {
    let (sin, cos) = libm::sincos(angle_rad);
    [cos, sin]
}

/// The direction of a cosine and a sine, of any length, in [−π, π); 0 where both are 0.
pub fn direction_rad([cos, sin]: [f64; 2]) -> f64 {
    let direction = libm::atan2(sin, cos);
    // The result of atan2 may be +π.
    let direction = if direction < PI { direction } else { -PI };
    debug_assert!((-PI..PI).contains(&direction), "{direction} rad");
    direction
}

/// The greatest distance of an angle from the direction of a cosine and a sine, radians, if the two may be off by these
/// deviations (to first order, across the direction). The result is at most π, which is the whole circle; it is π if
/// there is no direction.
pub fn deviation_of_direction_rad([cos, sin]: [f64; 2], [off_cos, off_sin]: [f64; 2]) -> f64 {
    let length = libm::hypot(cos, sin);
    let across = libm::hypot(sin * off_cos, cos * off_sin) / length;
    // The length counts twice: once for the unit vector, once for the angle that a step across it makes.
    let deviation = across / length;
    if deviation.is_nan() { PI } else { deviation.min(PI) }
}

/// Circular standard deviation of angles whose mean cosine and sine these are, radians: √(−2 ln R), where R is the
/// length of the mean (Mardia and Jupp 2000, section 2.3); at most π, which R = 0.0072 has.
pub fn circular_deviation_rad([cos, sin]: [f64; 2]) -> f64 {
    let deviation = (-2.0 * libm::log(libm::hypot(cos, sin).min(1.0))).sqrt();
    deviation.min(PI)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn mean_rad(angles_deg: &[f64]) -> f64 {
        let sum = |axis: usize| angles_deg.iter().map(|degrees| cos_sin(degrees.to_radians())[axis]).sum::<f64>();
        direction_rad([sum(0), sum(1)])
    }

    #[test]
    fn a_direction_is_as_sure_as_what_is_across_it() {
        assert_eq!(deviation_of_direction_rad([1.0, 0.0], [0.5, 0.1]), 0.1);
        assert_eq!(deviation_of_direction_rad([0.0, -0.5], [0.1, 0.3]), 0.2);
        assert_eq!(deviation_of_direction_rad([0.0, 0.0], [0.1, 0.1]), PI);
        assert_eq!(deviation_of_direction_rad([0.01, 0.0], [0.1, 0.5]), PI, "any direction");
    }

    #[test]
    fn equal_angles_do_not_deviate_and_opposite_ones_are_anywhere() {
        assert_eq!(circular_deviation_rad([0.6, 0.8]), 0.0);
        assert_eq!(circular_deviation_rad([0.0, 0.0]), PI);
        // The circular deviation of a narrow distribution is the usual standard deviation.
        let both = cos_sin(0.1);
        assert!((circular_deviation_rad([both[0], 0.0]) - 0.1).abs() < 1e-3);
    }

    #[test]
    fn angles_on_both_sides_of_zero_average_to_zero() {
        assert!(mean_rad(&[350.0, 10.0]).abs() < 1e-12);
        assert!((mean_rad(&[170.0, 190.0]).abs() - PI).abs() < 1e-12);
        assert!((mean_rad(&[90.0, 100.0]) - 95_f64.to_radians()).abs() < 1e-12);
        assert_eq!(direction_rad([0.0, 0.0]), 0.0);
        assert_eq!(direction_rad([-1.0, 0.0]), -PI);
    }

    #[test]
    fn what_cannot_be_radians_is_refused() {
        for good in [0.0, -PI, PI, TAU, -TAU] {
            assert!(allows_angle(good), "{good}");
        }
        for bad in [6.3, -90.0, 180.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert!(!allows_angle(bad), "{bad}");
        }
    }

    proptest! {
        #[test]
        fn a_direction_is_the_angle_again(angle in -TAU..=TAU, length in 1e-6..1e6_f64) {
            let [cos, sin] = cos_sin(angle);
            let direction = direction_rad([length * cos, length * sin]);
            prop_assert!((-PI..PI).contains(&direction));
            prop_assert!(((direction - angle) / TAU - ((direction - angle) / TAU).round()).abs() < 1e-9);
        }
    }
}
