//! Tests values over place and time: distributions, and refused input.

use super::*;
use crate::civil::NANOS_PER_SEC;

const BOTH: [HypertimeMethod; 2] = [HypertimeMethod::Em, HypertimeMethod::Km];

fn hour(hour: i64) -> Moment {
    Moment { utc_nanos: hour * 3_600 * NANOS_PER_SEC, offset_secs: 0 }
}

fn options(method: HypertimeMethod, clusters: usize) -> HypertimeOptions {
    HypertimeOptions { method, clusters, seed: 0 }
}

/// A pseudo-random number from -0.5 to 0.5.
fn jitter(index: i64) -> f64 {
    let mixed = (index as u64).wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mixed = (mixed ^ (mixed >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    ((mixed ^ (mixed >> 32)) >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
}

/// People around (2, 0) by day and around (-3, 1) by night; one is detected every hour for 20 days.
fn people() -> Vec<FieldReading> {
    let place = |h: i64| if (6..18).contains(&(h % 24)) { [2.0, 0.0] } else { [-3.0, 1.0] };
    (0..480)
        .map(|h| FieldReading {
            moment: hour(h),
            location: Vec::new(),
            value: vec![place(h)[0] + jitter(h), place(h)[1] + 0.5 * jitter(7 * h)],
        })
        .collect()
}

#[test]
fn events_are_where_they_are_at_that_time_of_day() {
    for method in BOTH {
        let field = HypertimeField::train(&people(), &Periodicities::default(), &options(method, 3)).unwrap();
        assert!(field.periods().iter().any(|period| period.secs() == 86_400.0), "{method:?}: {:?}", field.periods());
        for (at, here, there) in [(12, [2.0, 0.0], [-3.0, 1.0]), (24, [-3.0, 1.0], [2.0, 0.0])] {
            let density = |place| field.density(hour(960 + at), &[], place).unwrap();
            assert!(
                density(&here) > 10.0 * density(&there),
                "{method:?}, {at}:00: {}, {}",
                density(&here),
                density(&there)
            );
            let mean = field.mean(hour(960 + at), &[]).unwrap();
            assert!((mean[0] - here[0]).abs() < 0.5, "{method:?}, {at}:00: {mean:?}");
        }
    }
}

#[test]
fn a_value_depends_on_place_and_time() {
    // The robot is slow in the morning at the one end of a path, and always fast at the other.
    let readings: Vec<FieldReading> = (0..960)
        .map(|half_hour| {
            let place = jitter(half_hour * 3);
            let morning = (14..22).contains(&(half_hour % 48));
            let speed = if place > 0.0 || !morning { 0.9 } else { 0.2 };
            let moment = Moment { utc_nanos: half_hour * 1_800 * NANOS_PER_SEC, offset_secs: 0 };
            FieldReading { moment, location: vec![place], value: vec![speed + 0.05 * jitter(half_hour)] }
        })
        .collect();
    let field = HypertimeField::train(&readings, &Periodicities::default(), &options(HypertimeMethod::Em, 6)).unwrap();
    let mean = |h: i64, place: f64| field.mean(hour(24 * 30 + h), &[place]).unwrap()[0];
    assert!(mean(9, -0.3) < 0.5, "{}", mean(9, -0.3));
    assert!(mean(9, 0.3) > 0.7, "{}", mean(9, 0.3));
    assert!(mean(18, -0.3) > 0.7, "{}", mean(18, -0.3));
}

#[test]
fn a_density_integrates_to_one_and_is_widened_by_a_cell() {
    let readings: Vec<FieldReading> = (0..400)
        .map(|h| FieldReading { moment: hour(h), location: Vec::new(), value: vec![f64::from(jitter(h) > 0.0) * 10.0] })
        .collect();
    for method in BOTH {
        let field = HypertimeField::train(&readings, &Periodicities::default(), &options(method, 2)).unwrap();
        let distribution = field.distribution(hour(5), &[]).unwrap();
        let integral = |width: f64, cell: f64| {
            let cells = (40.0 / width) as i64;
            let middles = (0..cells).map(|index| -15.0 + (index as f64 + 0.5) * width);
            middles.map(|value| width * distribution.density(&[value], &[cell]).unwrap()).sum::<f64>()
        };
        assert!((integral(0.001, 0.0) - 1.0).abs() < 0.01, "{method:?}: {}", integral(0.001, 0.0));
        // The readings' two values are far narrower than a cell of 4.
        assert!((integral(4.0, 4.0) - 1.0).abs() < 0.1, "{method:?}: {}", integral(4.0, 4.0));
        let peak = |cell| distribution.density(&[10.0], &[cell]).unwrap();
        // Two peaks need two clusters, which HyT-KM does not add if they do not improve the mean.
        assert!(method == HypertimeMethod::Km || peak(0.0) > 3.0 * peak(4.0), "{}, {}", peak(0.0), peak(4.0));
    }
}

#[test]
fn a_distribution_has_the_variance_of_its_readings() {
    let readings: Vec<FieldReading> = (0..600)
        .map(|h| FieldReading { moment: hour(h), location: Vec::new(), value: vec![100.0 + 12.0 * jitter(h)] })
        .collect();
    let field = HypertimeField::train(&readings, &Periodicities::default(), &options(HypertimeMethod::Em, 2)).unwrap();
    let distribution = field.distribution(hour(3), &[]).unwrap();
    assert!((distribution.mean()[0] - 100.0).abs() < 1.0);
    assert!((distribution.variance()[0] - 12.0).abs() < 1.5, "{:?}", distribution.variance());
}

#[test]
fn what_cannot_be_trained_or_asked_is_refused() {
    let good = people();
    let parameter = |readings: &[FieldReading], clusters| match HypertimeField::train(
        readings,
        &Periodicities::default(),
        &options(HypertimeMethod::Em, clusters),
    ) {
        Err(CannotTrain::Parameter { parameter, .. }) => parameter,
        other => panic!("{other:?}"),
    };
    let with = |change: fn(&mut FieldReading)| {
        let mut readings = good.clone();
        change(&mut readings[3]);
        readings
    };
    assert_eq!(parameter(&good, 0), "clusters");
    assert_eq!(parameter(&good, 1_000_000), "clusters");
    assert_eq!(parameter(&with(|reading| reading.location.push(1.0)), 1), "location coordinates");
    assert_eq!(parameter(&with(|reading| reading.value.push(1.0)), 1), "value coordinates");
    assert_eq!(parameter(&with(|reading| reading.value[0] = f64::NAN), 1), "reading");
    assert_eq!(parameter(&with(|reading| reading.value[0] = f64::INFINITY), 1), "reading");
    let wide = |value: usize| vec![FieldReading { moment: hour(0), location: vec![0.0; 9], value: vec![0.0; value] }];
    assert_eq!(parameter(&wide(0), 1), "coordinates");
    assert_eq!(parameter(&wide(8), 1), "coordinates");
    assert!(HypertimeField::train(&wide(7), &Periodicities::default(), &options(HypertimeMethod::Em, 1)).is_ok());
    let none = HypertimeField::train(&[], &Periodicities::default(), &HypertimeOptions::default());
    assert_eq!(none, Err(CannotTrain::NoReadings));

    let field = HypertimeField::train(&good, &Periodicities::default(), &options(HypertimeMethod::Em, 1)).unwrap();
    assert_eq!(field.mean(hour(0), &[1.0]), None);
    assert_eq!(field.density(hour(0), &[], &[1.0]), None);
    assert_eq!(field.density(hour(0), &[], &[1.0, f64::NAN]), None);
    let distribution = field.distribution(hour(0), &[]).unwrap();
    assert_eq!(distribution.density(&[0.0, 0.0], &[-1.0, 0.0]), None);
    assert_eq!(distribution.density(&[0.0, 0.0], &[f64::NAN, 0.0]), None);
}

#[test]
fn places_beyond_all_measure_have_an_answer() {
    let readings: Vec<FieldReading> = (0..60)
        .map(|h| FieldReading {
            moment: hour(h),
            location: vec![1e308 * (jitter(h) * 2.0), 7.0],
            value: vec![f64::MIN_POSITIVE * (1.0 + jitter(h)), -1e300],
        })
        .collect();
    for method in BOTH {
        let field = HypertimeField::train(&readings, &Periodicities::default(), &options(method, 4)).unwrap();
        assert_eq!(HypertimeField::from_parts(&field.to_parts()).unwrap(), field);
        for place in [[0.0, 7.0], [f64::MAX, f64::MIN], [1e-300, 1e300]] {
            let mean = field.mean(hour(99), &place).unwrap();
            assert!(mean.iter().all(|number| number.is_finite()), "{mean:?}");
            let density = field.density(hour(99), &place, &[0.0, -1e300]).unwrap();
            assert!(density.is_finite() && density >= 0.0, "{density}");
        }
    }
}

#[test]
fn many_readings_are_thinned_evenly() {
    let kept = super::super::joint::FieldPoint::thinned(100_000, 5);
    assert_eq!(kept.len(), 4_000);
    for (run, &index) in kept.iter().enumerate() {
        assert!((run * 25..(run + 1) * 25).contains(&index), "{run}: {index}");
    }
    assert_eq!(super::super::joint::FieldPoint::thinned(3, 5), [0, 1, 2]);
}
