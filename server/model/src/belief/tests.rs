//! The promises of `belief.rs`, tested on simulated states.

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};

use super::{
    ahead::Ahead,
    dwell::Survival,
    filter,
    lead_time::{LeadTimeWeights, Scored},
    noise, *,
};

const SEC: i64 = 1_000_000_000;

/// Readings of a state that keeps 0 and 1 for times drawn by `dwell`, at gaps drawn by `gap`, with errors.
fn simulate(
    seed: u64,
    count: usize,
    dwell: impl Fn(bool, &mut SmallRng) -> f64,
    gap: impl Fn(&mut SmallRng) -> f64,
    wrong: f64,
) -> Vec<Sample> {
    let mut random = SmallRng::seed_from_u64(seed);
    let (mut now, mut value, mut until) = (0.0, false, 0.0);
    let mut samples = Vec::with_capacity(count);
    for _ in 0..count {
        now += gap(&mut random);
        while until <= now {
            value = !value;
            until += dwell(value, &mut random).max(1.0);
        }
        let read = value != (random.random::<f64>() < wrong);
        samples.push(Sample { utc_nanos: (now * 1e9) as i64, offset_secs: 0, value: f64::from(u8::from(read)) });
    }
    samples
}

fn exponential(mean: f64, random: &mut SmallRng) -> f64 {
    -mean * (1.0 - random.random::<f64>()).ln()
}

/// Learns readings day by day, each predicted by the mean before it.
fn learned(samples: &[Sample]) -> Belief {
    learned_by(Belief::new(true), samples)
}

fn learned_by(mut belief: Belief, samples: &[Sample]) -> Belief {
    let (mut sum, mut count) = (0.0, 0.0);
    for day in samples.chunk_by(|one, next| one.local_day() == next.local_day()) {
        let mean = if count > 0.0 { sum / count } else { 0.5 };
        let predict = |samples: &[Sample]| vec![mean; samples.len()];
        belief.learn_day(day, (count > 0.0).then_some(&predict), 0.25);
        sum += day.iter().map(|sample| sample.value).sum::<f64>();
        count += day.len() as f64;
    }
    belief
}

fn not_learned(predicted: f64) -> KnownAtNewest {
    KnownAtNewest { predicted, is_learned: false }
}

/// The forecast at a lead time; the prediction is always p.
fn blended(belief: &Belief, samples: &[Sample], p: f64, lead_secs: i64) -> f64 {
    let mut recent = Recent::default();
    samples.iter().for_each(|sample| recent.observe(sample.utc_nanos, sample.value));
    let last = samples.last().unwrap();
    let mut out = [p];
    let at = Moment { utc_nanos: last.utc_nanos + lead_secs * SEC, offset_secs: 0 };
    belief.blend_into(&recent, (last.utc_nanos, last.value), not_learned(p), &[at], &mut out);
    out[0]
}

#[test]
fn the_rates_of_a_chain_are_found_whatever_the_gaps() {
    for (low, high, gap) in [(7200.0, 1800.0, 60.0), (7200.0, 1800.0, 2700.0), (20_000.0, 5000.0, 600.0)] {
        let dwell = |is_one, random: &mut SmallRng| exponential(if is_one { high } else { low }, random);
        let belief = learned(&simulate(1, 20_000, dwell, |random| exponential(gap, random), 0.0));
        let rates = belief.rates_of_readings().unwrap();
        let sum = 1.0 / low + 1.0 / high;
        assert!((rates.sum() / sum - 1.0).abs() < 0.1, "{low} {high} {gap}: {rates:?}");
        assert!((rates.share() - high / (low + high)).abs() < 0.03, "{low} {high} {gap}: {rates:?}");
        assert_eq!(belief.noise(), SensorNoise::default(), "{low} {high} {gap}");
    }
}

#[test]
fn the_errors_of_a_sensor_are_found() {
    let dwell = |is_one, random: &mut SmallRng| exponential(if is_one { 7200.0 } else { 10_800.0 }, random);
    let belief = learned(&simulate(2, 20_000, dwell, |random| exponential(60.0, random), 0.1));
    let SensorNoise { miss, false_alarm } = belief.noise();
    assert!((miss - 0.1).abs() < 0.02 && (false_alarm - 0.1).abs() < 0.02, "{:?}", belief.noise());
    let sum = 1.0 / 7200.0 + 1.0 / 10_800.0;
    assert!((belief.rates().sum() / sum - 1.0).abs() < 0.2, "{:?}", belief.rates());
}

#[test]
fn a_single_wrong_reading_is_not_believed() {
    let dwell = |is_one, random: &mut SmallRng| exponential(if is_one { 7200.0 } else { 10_800.0 }, random);
    let samples = simulate(3, 20_000, dwell, |_| 60.0, 0.1);
    let belief = learned(&samples);
    let reading = |minute: i64, value| Sample { utc_nanos: minute * 60 * SEC, offset_secs: 0, value };
    let mut ones: Vec<Sample> = (0..20).map(|minute| reading(minute, 1.0)).collect();
    assert!(blended(&belief, &ones, 0.4, 0) > 0.85);
    ones.push(reading(20, 0.0));
    assert!(blended(&belief, &ones, 0.4, 0) > 0.7);
    ones.extend((21..24).map(|minute| reading(minute, 0.0)));
    assert!(blended(&belief, &ones, 0.4, 0) < 0.3);
}

/// The probability to read 1 at the last reading, by the simplest filter.
fn naive_filter(rates: Rates, sensor: StateSensor, samples: &[Sample]) -> f64 {
    let (hit, false_alarm) = (sensor.hit(), sensor.false_alarm());
    let share = rates.rise_per_sec / (rates.rise_per_sec + rates.fall_per_sec);
    let (mut one, mut last) = (share, samples[0].utc_nanos);
    for sample in samples {
        let secs = (sample.utc_nanos - last) as f64 / 1e9;
        one = share + (one - share) * (-(rates.rise_per_sec + rates.fall_per_sec) * secs).exp();
        let [if_one, if_zero] = if sample.value == 1.0 { [hit, false_alarm] } else { [1.0 - hit, 1.0 - false_alarm] };
        one = one * if_one / (one * if_one + (1.0 - one) * if_zero);
        last = sample.utc_nanos;
    }
    one * hit + (1.0 - one) * false_alarm
}

#[test]
fn a_stated_sensor_counts_by_the_rule_of_bayes_from_the_first_reading_on() {
    let readings = [(0, 1.0), (600, 0.0), (1000, 1.0), (1300, 1.0), (9000, 0.0), (9060, 0.0), (9100, 1.0)];
    let samples = readings.map(|(secs, value)| Sample { utc_nanos: secs * SEC, offset_secs: 0, value });
    let dwell = |is_one, random: &mut SmallRng| exponential(if is_one { 7200.0 } else { 10_800.0 }, random);
    // More certain sensors are left out: a reading that is impossible for them still counts as possible, because the
    // probability of a reading is taken as at least 0.001.
    for (hit, false_alarm) in [(0.9, 0.05), (0.99, 0.3), (0.45, 0.01), (0.3, 0.2)] {
        let sensor = StateSensor::new(hit, false_alarm).unwrap();
        // A belief that has learned nothing, and a belief that has learned readings without any error.
        let days = simulate(8, 3000, dwell, |_| 28_800.0, 0.0);
        for belief in [Belief::of_sensor(sensor), learned_by(Belief::of_sensor(sensor), &days)] {
            assert_eq!(belief.noise(), SensorNoise { miss: 1.0 - hit, false_alarm });
            assert!(!belief.knows_dwells());
            for known in 1..=samples.len() {
                let expected = naive_filter(belief.rates(), sensor, &samples[..known]);
                let found = blended(&belief, &samples[..known], 0.4, 0);
                assert!((found - expected).abs() < 1e-12, "{sensor}, {known}: {found} {expected}");
            }
        }
    }
}

#[test]
fn the_rates_behind_a_known_sensor_are_found() {
    let dwell = |is_one, random: &mut SmallRng| exponential(if is_one { 7200.0 } else { 10_800.0 }, random);
    let samples = simulate(9, 20_000, dwell, |random| exponential(60.0, random), 0.1);
    let belief = learned_by(Belief::of_sensor(StateSensor::new(0.9, 0.1).unwrap()), &samples);
    let sum = 1.0 / 7200.0 + 1.0 / 10_800.0;
    assert!((belief.rates().sum() / sum - 1.0).abs() < 0.2, "{:?}", belief.rates());
}

#[test]
fn the_next_change_of_a_regular_state_is_foreseen() {
    // The state is 0 for about ten minutes, then 1 for about five.
    let dwell = |is_one, random: &mut SmallRng| {
        let mean = if is_one { 300.0 } else { 600.0 };
        mean * (0.97 + 0.06 * random.random::<f64>())
    };
    let samples = simulate(4, 20_000, dwell, |_| 10.0, 0.0);
    let belief = learned(&samples);
    assert!(belief.knows_dwells());
    let change = samples.windows(2).rposition(|pair| pair[0].value == 0.0 && pair[1].value == 1.0).unwrap() + 1;
    let seen = &samples[..=change];
    let at = |lead_secs| blended(&belief, seen, 0.33, lead_secs);
    assert!(at(120) > 0.9 && at(240) > 0.8, "{} {}", at(120), at(240));
    assert!(at(420) < 0.2 && at(600) < 0.2, "{} {}", at(420), at(600));
}

#[test]
fn at_long_lead_times_the_forecast_is_the_prediction() {
    // A chain that forgets within minutes gives no information about tomorrow: there the prediction is better.
    let dwell = |_, random: &mut SmallRng| exponential(600.0, random);
    let samples = simulate(5, 14_400, dwell, |_| 60.0, 0.0);
    let belief = learned(&samples);
    for p in [0.05, 0.9] {
        assert!((blended(&belief, &samples, p, 6 * 86_400) - p).abs() < 0.01);
        assert_eq!(blended(&belief, &samples, p, 7 * 86_400), p);
        assert!((blended(&belief, &samples, p, 0) - samples.last().unwrap().value).abs() < 0.01);
    }
    let before = samples.last().unwrap().utc_nanos - SEC;
    let mut out = [0.3];
    let newest = samples.last().map(|sample| (sample.utc_nanos, sample.value)).unwrap();
    belief.blend_into(
        &Recent::default(),
        newest,
        not_learned(0.3),
        &[Moment { utc_nanos: before, offset_secs: 0 }],
        &mut out,
    );
    assert_eq!(out, [0.3]);
}

#[test]
fn weights_follow_what_has_been_right() {
    let mut weights = LeadTimeWeights::default();
    let scored = |value, predicted, stored| Scored { value, predicted, predicted_now: 0.2, stored, stored_now: 0.9 };
    for _ in 0..100 {
        // The newest value was kept; what it departed by from the routine was carried on; the routine was right.
        weights.add(1, &scored(0.9, 0.1, 0.9), 0.9, 0.25);
        weights.add(3, &scored(0.8, 0.1, 0.9), 0.9, 0.25);
        weights.add(6, &scored(0.1, 0.1, 0.9), 0.1, 0.25);
    }
    let all = weights.weights(3600.0);
    let at = |lead| LeadTimeWeights::at(&all, LeadTimeWeights::lead_secs(lead));
    assert!(at(1)[0] > 0.95 && at(1)[1] < 0.05, "{:?}", at(1));
    // .7 = w₁(.9 - .1) + w₂(.9 - .2)
    assert!((0.8 * at(3)[0] + 0.7 * at(3)[1] - 0.7).abs() < 0.01, "{:?}", at(3));
    assert!(at(6).iter().sum::<f64>() < 0.1, "{:?}", at(6));
    assert!(at(8) <= at(6), "a lead time that was never scored goes by the one before it");
    assert_eq!(LeadTimeWeights::at(&all, 0.0), [1.0, 0.0]);
    assert_eq!(LeadTimeWeights::at(&all, 1e9), [0.0, 0.0]);
}

#[test]
fn a_deviation_is_carried_on_where_the_routine_changes_the_value() {
    // The value follows a routine exactly, plus a deviation of the day. It is read every half-hour.
    let routine = |nanos: i64| 20.0 + 5.0 * (nanos as f64 / 86_400e9 * std::f64::consts::TAU).sin();
    let mut random = SmallRng::seed_from_u64(7);
    let mut deviation = 0.0;
    let samples: Vec<Sample> = (0..48 * 60)
        .map(|at: i64| {
            if at % 48 == 0 {
                deviation = 4.0 * (random.random::<f64>() - 0.5);
            }
            let utc_nanos = at * 1800 * SEC;
            Sample { utc_nanos, offset_secs: 0, value: routine(utc_nanos) + deviation }
        })
        .collect();
    let mut belief = Belief::new(false);
    let predict = |samples: &[Sample]| samples.iter().map(|sample| routine(sample.utc_nanos)).collect();
    for (number, day) in samples.chunk_by(|one, next| one.local_day() == next.local_day()).enumerate() {
        belief.learn_day(day, (number > 0).then_some(&predict), 12.5);
    }
    let (mut left, mut all) = (0.0, 0.0);
    for newest in samples.iter().skip(24).step_by(48) {
        let ahead = newest.utc_nanos + 4 * 3600 * SEC;
        let (mut out, deviation) = ([routine(ahead)], newest.value - routine(newest.utc_nanos));
        let now = (newest.utc_nanos, newest.value);
        let at = Moment { utc_nanos: ahead, offset_secs: 0 };
        belief.blend_into(&Recent::default(), now, not_learned(routine(newest.utc_nanos)), &[at], &mut out);
        left += (out[0] - routine(ahead) - deviation).powi(2);
        all += deviation.powi(2);
    }
    assert!(left < 0.2 * all, "{left} of {all}");
    // What is left of the error: in the same day little, on the next day nearly all.
    let share = |is_learned: bool, hours: i64| belief.error_share(0, is_learned, hours * 3600 * SEC);
    let [same_day, next_day, next_week] = [share(false, 1), share(true, 24), share(true, 24 * 7)];
    assert!(same_day < 0.3 && next_day > 0.6 && next_week == 1.0, "{same_day} {next_day}");
}

#[test]
fn numbers_are_the_newest_value_as_far_as_that_was_right() {
    // The value changes every hour, and is read every ten minutes.
    let mut random = SmallRng::seed_from_u64(6);
    let mut value = 20.0;
    let samples: Vec<Sample> = (0..3000)
        .map(|at: i64| {
            if at % 6 == 0 {
                value = 20.0 + 4.0 * (random.random::<f64>() - 0.5);
            }
            Sample { utc_nanos: at * 600 * SEC, offset_secs: 0, value }
        })
        .collect();
    let mut belief = Belief::new(false);
    let predict = |samples: &[Sample]| vec![20.0; samples.len()];
    for (number, day) in samples.chunk_by(|one, next| one.local_day() == next.local_day()).enumerate() {
        belief.learn_day(day, (number > 0).then_some(&predict), 4.0 / 3.0);
    }
    let last = samples.last().unwrap().value;
    let weight = |lead| (blended(&belief, &samples, 20.0, lead) - 20.0) / (last - 20.0);
    assert!(weight(600) > 0.6 && weight(86_400) < 0.2, "{} {}", weight(600), weight(86_400));
}

#[test]
fn the_filter_of_dwells_is_that_of_a_chain_if_dwells_are_exponential() {
    let dwells = |mean: f64| -> Vec<f32> {
        (0..48).map(|at| (-mean * (1.0 - (f64::from(at) + 0.5) / 48.0).ln()) as f32).collect()
    };
    let survivals = [Survival::of(&dwells(3000.0)), Survival::of(&dwells(1500.0))];
    let rates = Rates { rise_per_sec: 1.0 / 3000.0, fall_per_sec: 1.0 / 1500.0 };
    let mut recent = Recent::default();
    for (secs, value) in [(0, 0.0), (60, 0.0), (130, 1.0), (200, 1.0)] {
        recent.observe(secs * SEC, value);
    }
    let noise = SensorNoise { miss: 0.1, false_alarm: 0.05 };
    let (dwelling, chain) =
        (filter::filter_dwells(&survivals, noise, &recent), filter::filter_chain(rates, noise, &recent));
    let (dwelling, chain) = (Ahead::of_dwells(&survivals, &dwelling, 20_000.0), Ahead::of_chain(rates, chain));
    for lead in [0.0, 100.0, 600.0, 3000.0, 20_000.0] {
        let (one, other) = (dwelling.at(lead), chain.at(lead));
        assert!((one - other).abs() < 0.06, "{lead}: {one} {other}");
    }
}

#[test]
fn expected_changes_are_exact_without_errors() {
    let bins = [(0, false), (60 * SEC, false), (120 * SEC, true), (180 * SEC, true)];
    let expected = noise::expect(&bins, Rates::default(), SensorNoise::default());
    assert_eq!(expected.ones, [0.0, 0.0, 1.0, 1.0]);
    let counts: Vec<_> = expected.transitions.by_gap.values().collect();
    assert_eq!(counts.len(), 1);
    assert_eq!([counts[0].low, counts[0].rises, counts[0].falls, counts[0].high], [1.0, 1.0, 0.0, 1.0]);
}

#[test]
fn old_readings_are_merged_and_changes_are_kept() {
    let mut recent = Recent::default();
    // The state is 1 for 200 s, then 0 for 100 s, with a wrong reading every ten seconds.
    for second in 0..300_i64 {
        let is_one = (second < 200) != (second % 10 == 9);
        recent.observe(second * SEC, f64::from(u8::from(is_one)));
    }
    assert_eq!(recent.spans().len(), SPANS_MAX);
    let near = |span: &RecentSpan| (span.first_nanos - 200 * SEC).abs() <= 2 * SEC;
    assert!(recent.spans().iter().any(near), "{:?}", recent.spans());
    let before = recent;
    recent.observe(299 * SEC, 1.0);
    recent.observe(10 * SEC, 1.0);
    recent.observe(400 * SEC, 0.5);
    assert_eq!(recent, before);
    assert_eq!(Recent::from_spans(before.spans()), Ok(before));
}

proptest::proptest! {
    #[test]
    fn recent_readings_stay_in_order_and_blends_in_their_bounds(
        readings in proptest::collection::vec((1..100_000_i64, proptest::bool::weighted(0.3)), 1..200),
        p in 0.0..=1.0_f64,
        lead in 0..1_000_000_i64,
    ) {
        let mut now = 0;
        let mut samples = Vec::new();
        for (gap, is_one) in readings {
            now += gap * SEC / 10;
            samples.push(Sample { utc_nanos: now, offset_secs: 0, value: f64::from(u8::from(is_one)) });
        }
        let mut recent = Recent::default();
        samples.iter().for_each(|sample| recent.observe(sample.utc_nanos, sample.value));
        proptest::prop_assert_eq!(Recent::from_spans(recent.spans()), Ok(recent));
        for known in [0, samples.len() / 3] {
            let mut some = Recent::default();
            samples[..known].iter().for_each(|sample| some.observe(sample.utc_nanos, sample.value));
            let mut replay = recent::RecentReplay::new(some);
            samples.iter().for_each(|sample| replay.observe(sample.utc_nanos, sample.value));
            proptest::prop_assert_eq!(*replay.recent(), recent);
        }
        let blended = blended(&learned(&samples), &samples, p, lead);
        proptest::prop_assert!((0.0..=1.0).contains(&blended), "{}", blended);
    }

    #[test]
    fn weights_are_the_nearest_to_what_was_right_within_their_bounds(
        values in proptest::collection::vec(proptest::array::uniform5(-2.0..2.0_f64), 1..30),
    ) {
        let mut weights = LeadTimeWeights::default();
        for &[value, predicted, predicted_now, stored, stored_now] in &values {
            let scored = Scored { value, predicted, predicted_now, stored, stored_now };
            weights.add(0, &scored, predicted, 1.0);
        }
        // The loss that is minimised, with its shrinkage to the weights at the newest reading.
        let trust = (-15.0_f64 / 3600.0).exp();
        let loss = |[kept, carried]: [f64; 2]| {
            let squared_error = |&[value, predicted, predicted_now, stored, stored_now]: &[f64; 5]| {
                (value - predicted - kept * (stored - predicted) - carried * (stored_now - predicted_now)).powi(2)
            };
            values.iter().map(squared_error).sum::<f64>() + 4.0 * (kept + carried - trust).powi(2) + 4.0 * (kept - trust).powi(2)
        };
        let [kept, carried] = weights.weights(3600.0)[0];
        proptest::prop_assert!(kept >= 0.0 && carried >= 0.0 && kept + carried <= 1.0 + 1e-12);
        if kept > 0.0 && carried > 0.0 && kept + carried < 1.0 - 1e-9 {
            for step in [[1e-3, 0.0], [-1e-3, 0.0], [0.0, 1e-3], [0.0, -1e-3]] {
                proptest::prop_assert!(loss([kept, carried]) <= loss([kept + step[0], carried + step[1]]) + 1e-12);
            }
        }
        let share = weights.error_share(15.0);
        proptest::prop_assert!(share > 0.0 && share <= 1.0, "{}", share);
    }
}
