//! Cosines and sines that have the same bits on every machine, for as long as history is kept.
//!
//! A phase is a 64-bit fraction of a turn, found by integer division; its cosine and sine are a fixed polynomial of
//! multiplications and additions that IEEE 754 rounds in one way only.
//!
//! Invariant: none of these bits ever changes; the tests check some of them. The code must not use a fused
//! multiply-add, a function of the C library, or instructions that are chosen at run time.

use tidemap_model::{Periodicities, PeriodicityDefinition};

/// Units of a turn: 2^64.
const UNITS: f64 = 65_536.0 * 65_536.0 * 65_536.0 * 65_536.0;
const RADIANS_PER_UNIT: f64 = std::f64::consts::TAU / UNITS;

/// Taylor series of (sin x / x - 1) and (cos x - 1) in x², by ascending power from the first.
const SIN: [f64; 7] = [
    -1.0 / 6.0,
    1.0 / 120.0,
    -1.0 / 5_040.0,
    1.0 / 362_880.0,
    -1.0 / 39_916_800.0,
    1.0 / 6_227_020_800.0,
    -1.0 / 1_307_674_368_000.0,
];
const COS: [f64; 7] = [
    -1.0 / 2.0,
    1.0 / 24.0,
    -1.0 / 720.0,
    1.0 / 40_320.0,
    -1.0 / 3_628_800.0,
    1.0 / 479_001_600.0,
    -1.0 / 87_178_291_200.0,
];

/// Phase of a period at a local civil time, in 2^-64 of a turn, rounded down.
pub(super) fn fraction(civil_nanos: i64, period_nanos: i64) -> u64 {
    let period = period_nanos.max(1);
    let within = civil_nanos.rem_euclid(period).unsigned_abs();
    // Less than 2^64, since `within` is less than the period.
    ((u128::from(within) << 64) / u128::from(period.unsigned_abs())) as u64
}

/// Cosine and sine of a fraction of a turn, to 1e-13.
#[inline]
pub(super) fn cos_sin(fraction: u64) -> (f64, f64) {
    // The nearest quarter of a turn, and the remainder: at most an eighth either way.
    let quarter = fraction.wrapping_add(1 << 61) >> 62;
    let rest = fraction.wrapping_sub(quarter << 62).cast_signed();
    let angle = rest as f64 * RADIANS_PER_UNIT;
    let square = angle * angle;
    let cos = 1.0 + square * series(&COS, square);
    let sin = angle + angle * (square * series(&SIN, square));
    match quarter {
        0 => (cos, sin),
        1 => (-sin, cos),
        2 => (-cos, -sin),
        _ => (sin, -cos),
    }
}

#[inline]
fn series(coefficients: &[f64; 7], square: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, coefficient| sum * square + coefficient)
}

/// Phases of some times in the candidate periodicities.
#[derive(Debug)]
pub(super) enum Phases {
    /// Fractions of a turn of the base; harmonic k turns k + 1 times as fast.
    Harmonics { base: Vec<u64>, count: usize },
    /// Local civil times, and the periods.
    List { civil_nanos: Vec<i64>, period_nanos: Vec<i64> },
}

impl Phases {
    pub(super) fn new(periodicities: &Periodicities, civil_nanos: impl Iterator<Item = i64>) -> Phases {
        match periodicities.definition() {
            PeriodicityDefinition::Harmonics { base_nanos, count } => Phases::Harmonics {
                base: civil_nanos.map(|nanos| fraction(nanos, *base_nanos)).collect(),
                count: *count as usize,
            },
            PeriodicityDefinition::List { period_nanos } => {
                Phases::List { civil_nanos: civil_nanos.collect(), period_nanos: period_nanos.clone() }
            }
        }
    }

    /// Number of periodicities.
    pub(super) fn count(&self) -> usize {
        match self {
            Phases::Harmonics { count, .. } => *count,
            Phases::List { period_nanos, .. } => period_nanos.len(),
        }
    }

    /// Number of times.
    pub(super) fn times(&self) -> usize {
        match self {
            Phases::Harmonics { base, .. } => base.len(),
            Phases::List { civil_nanos, .. } => civil_nanos.len(),
        }
    }

    /// Cosine and sine at each time in periodicity `k`, rounded to f32; none where there is no such periodicity.
    pub(super) fn cos_sin_into(&self, k: usize, cos: &mut Vec<f32>, sin: &mut Vec<f32>) {
        cos.clear();
        sin.clear();
        let mut push = |fraction: u64| {
            let (c, s) = cos_sin(fraction);
            cos.push(c as f32);
            sin.push(s as f32);
        };
        match self {
            Phases::Harmonics { base, count } if k < *count => {
                let factor = k as u64 + 1;
                base.iter().for_each(|base| push(base.wrapping_mul(factor)));
            }
            Phases::List { civil_nanos, period_nanos } => {
                let Some(&period) = period_nanos.get(k) else { return };
                civil_nanos.iter().for_each(|&nanos| push(fraction(nanos, period)));
            }
            Phases::Harmonics { .. } => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WEEK: i64 = 7 * 86_400_000_000_000;

    #[test]
    fn cosine_and_sine_are_right() {
        let mut fraction = 0_u64;
        for _ in 0..100_000 {
            fraction = fraction.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let turns = fraction as f64 / UNITS;
            let (sin, cos) = libm::sincos(std::f64::consts::TAU * turns);
            let found = cos_sin(fraction);
            assert!((found.0 - cos).abs() < 2e-13 && (found.1 - sin).abs() < 2e-13, "{fraction}: {found:?}");
        }
        let exact: Vec<(f64, f64)> = (0..4).map(|quarter| cos_sin(quarter << 62)).collect();
        assert_eq!(exact, [(1.0, 0.0), (-0.0, 1.0), (-1.0, -0.0), (0.0, -1.0)]);
    }

    #[test]
    fn a_fraction_is_the_time_within_the_period() {
        assert_eq!(fraction(0, WEEK), 0);
        assert_eq!(fraction(WEEK / 2, WEEK), 1 << 63);
        assert_eq!(fraction(-WEEK / 4, WEEK), 3 << 62);
        assert_eq!(fraction(3 * WEEK + WEEK / 8, WEEK), 1 << 61);
        assert_eq!(fraction(WEEK - 1, WEEK), u64::MAX - 30_500);
        assert_eq!(fraction(i64::MIN, i64::MAX), u64::MAX - 2);
        assert_eq!(fraction(5, 0), 0);
    }

    #[test]
    fn the_bits_are_those_of_the_first_version() {
        let times = [0, 1_451_865_600_123_456_789, 1_458_518_400_000_000_000, -1, i64::MAX];
        let day_and_hour = Periodicities::list(vec![86_400_000_000_000, 3_600_000_000_001]).expect("valid");
        let [week, list] = [Periodicities::default(), day_and_hour]
            .map(|periodicities| Phases::new(&periodicities, times.into_iter()));
        let bits = |phases: &Phases, k: usize| {
            let (mut cos, mut sin) = (Vec::new(), Vec::new());
            phases.cos_sin_into(k, &mut cos, &mut sin);
            cos.iter().zip(&sin).map(|(cos, sin)| (cos.to_bits(), sin.to_bits())).collect::<Vec<_>>()
        };
        for (phases, k, expected) in [
            (
                &week,
                6,
                [
                    0x3f80_0000_u32,
                    0,
                    0x3f80_0000,
                    0x3716_a05a,
                    0x3f80_0000,
                    0xa0c9_0fdb,
                    0x3f80_0000,
                    0xa9a3_c200,
                    0x3f7f_9b1a,
                    0xbd63_3377,
                ],
            ),
            (
                &week,
                166,
                [
                    0x3f80_0000,
                    0,
                    0xbf66_abfc,
                    0x3ede_0cb7,
                    0xbf66_a5e5,
                    0x3ede_2602,
                    0x3f80_0000,
                    0xabf4_2cb3,
                    0xbf7f_ef95,
                    0xbcb7_5da0,
                ],
            ),
            (
                &list,
                0,
                [
                    0x3f80_0000,
                    0,
                    0x3f80_0000,
                    0x3716_a05a,
                    0x3f80_0000,
                    0,
                    0x3f80_0000,
                    0xa9a3_c16a,
                    0x3f7f_9b1a,
                    0xbd63_3377,
                ],
            ),
            (
                &list,
                1,
                [
                    0x3f80_0000,
                    0,
                    0x3f80_0000,
                    0x3961_3394,
                    0x3f80_0000,
                    0xb53d_d035,
                    0x3f80_0000,
                    0xabf5_a21e,
                    0x3e72_4401,
                    0xbf78_bb72,
                ],
            ),
        ] {
            let expected: Vec<(u32, u32)> = expected.chunks(2).map(|pair| (pair[0], pair[1])).collect();
            assert_eq!(bits(phases, k), expected);
        }
        assert_eq!((bits(&week, 168), bits(&list, 2)), (Vec::new(), Vec::new()));
        let doubles = [1, 0x1234_5678_9abc_def0, 0x9999_9999_9999_9999, u64::MAX].map(cos_sin);
        let expected = [
            (0x3ff0_0000_0000_0000, 0x3c19_21fb_5444_2d18),
            (0x3fec_dbcf_e2ec_20ef, 0x3fdb_a74a_fc0b_0515),
            (0xbfe9_e377_9b97_f4a8, 0xbfe2_cf23_0475_5a5e),
            (0x3ff0_0000_0000_0000, 0xbc19_21fb_5444_2d18),
        ];
        assert_eq!(doubles.map(|(cos, sin)| (cos.to_bits(), sin.to_bits())), expected);
    }
}
