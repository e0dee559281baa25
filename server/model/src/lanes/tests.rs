//! Tests the properties of `lanes.rs`.

use super::*;
use crate::phasor::every_arch;

/// The sum of products, each number in the lane of its index modulo eight.
struct Products<'a>(&'a [[f64; LANES]]);

impl EightLanes for Products<'_> {
    type Output = (f64, [f64; LANES]);

    #[inline(always)]
    fn run<S: Simd, const V: usize>(self, simd: S) -> Self::Output {
        let mut sum = Eight::<S, V>::splat(simd, 0.1);
        for numbers in self.0 {
            for (sum, &numbers) in sum.0.iter_mut().zip(S::as_simd_f64s(numbers).0) {
                *sum = simd.mul_add_f64s(numbers, numbers, *sum);
            }
        }
        (sum.sum(simd), sum.store(simd))
    }
}

#[test]
fn every_instruction_set_gives_equal_bits() {
    let numbers: Vec<[f64; LANES]> =
        (0..40).map(|i| std::array::from_fn(|lane| f64::from(8 * i + lane as i32).sin() / 3.0)).collect();
    for count in 0..numbers.len() {
        let mut lanes = [0.1_f64; LANES];
        for numbers in &numbers[..count] {
            for (lane, number) in lanes.iter_mut().zip(numbers) {
                *lane = number.mul_add(*number, *lane);
            }
        }
        let [a, b, c, d, e, f, g, h] = lanes;
        let sum = ((a + e) + (c + g)) + ((b + f) + (d + h));
        for arch in every_arch() {
            let found = arch.dispatch(OnLanes(Products(&numbers[..count])));
            assert_eq!(found.0.to_bits(), sum.to_bits(), "{arch:?}");
            assert_eq!(found.1.map(f64::to_bits), lanes.map(f64::to_bits), "{arch:?}");
        }
    }
}
