//! Strategies against their definitions.

use proptest::prelude::{Just, any, prop, prop_assert, prop_assert_eq, prop_oneof, proptest};
use proptest::strategy::Strategy as _;

use super::*;

const SEEDS: u64 = 20_000;

fn uneven(slots: usize, places: usize) -> Gains {
    Gains::of(slots, places, |slot, place| ((slot * 7 + place * 3) % 11) as f64 / 10.0).unwrap()
}

fn visits(plan: &[Option<usize>]) -> usize {
    plan.iter().flatten().count()
}

/// Number of times that each place was scheduled in a slot over many seeds; the first is no visit.
fn counts(strategy: Strategy, gains: &Gains, budget: Budget, slot: usize) -> Vec<f64> {
    let mut counts = vec![0.0; gains.places() + 1];
    for seed in 0..SEEDS {
        let plan = schedule(strategy, gains, budget, seed).unwrap();
        counts[plan[slot].map_or(0, |place| place + 1)] += 1.0;
    }
    counts
}

/// Pearson's statistic; its mean is the number of classes less one, its standard deviation the root of twice that.
#[track_caller]
fn assert_distributed(counts: &[f64], probabilities: &[f64]) {
    let total: f64 = counts.iter().sum();
    let mut statistic = 0.0;
    for (count, p) in counts.iter().zip(probabilities) {
        if *p > 0.0 {
            statistic += (count - total * p).powi(2) / (total * p);
        } else {
            assert!(*count < 0.5, "{counts:?} {probabilities:?}");
        }
    }
    let freedom = probabilities.iter().filter(|p| **p > 0.0).count() as f64 - 1.0;
    assert!(statistic < freedom + 5.0 * (2.0 * freedom).sqrt(), "{statistic} {counts:?} {probabilities:?}");
}

#[test]
fn monte_carlo_keeps_the_ratio_and_the_proportions_of_equation_11() {
    // A flat: a visit gains little at night and much at noon.
    let flat = Gains::of(144, 10, |slot, place| {
        let noon = (slot as f64 / 144.0 * std::f64::consts::TAU).cos().mul_add(-0.5, 0.5);
        noon.powi(4) * ((place * 3 % 7) as f64 / 6.0) + if slot == 70 { 40.0 } else { 0.0 }
    })
    .unwrap();
    for wanted in [0.5, 0.25, 0.02, 0.98] {
        let days = 300;
        let visits_of = |seed| visits(&schedule(Strategy::MonteCarlo, &flat, Budget::Ratio(wanted), seed).unwrap());
        let share = (0..days).map(visits_of).sum::<usize>() as f64 / (days as f64 * 144.0);
        // Three standard errors of a mean of 43,200 draws are below 0.01.
        assert!((share - wanted).abs() <= 0.01, "{wanted}: {share}");
    }
    // Slots are drawn in the odds of their gains, and places of a slot in proportion.
    let gains = uneven(6, 4);
    let sum = |slot: usize| gains.slot(slot).iter().map(|gain| gain + IOTA_BITS).sum::<f64>();
    let rest_share = |slot: usize| {
        let drawn = counts(Strategy::MonteCarlo, &gains, Budget::Ratio(0.3), slot);
        drawn[0] / SEEDS as f64
    };
    let (first, last) = (rest_share(0), rest_share(5));
    let rest = [first / (1.0 - first) * sum(0), last / (1.0 - last) * sum(5)];
    assert!((rest[0] / rest[1] - 1.0).abs() < 0.1, "{rest:?}");
    let mut weights = vec![rest[0]];
    weights.extend(gains.slot(0).iter().map(|gain| gain + IOTA_BITS));
    let total: f64 = weights.iter().sum();
    let expected: Vec<f64> = weights.iter().map(|weight| weight / total).collect();
    assert_distributed(&counts(Strategy::MonteCarlo, &gains, Budget::Ratio(0.3), 0), &expected);
}

#[test]
fn one_of_several_slots_is_drawn_in_proportion_to_what_it_promises() {
    let gains = Gains::of(3, 1, |slot, _| slot as f64 * 2.0).unwrap();
    let sum = 6.0 + 3.0 * IOTA_BITS;
    let mut taken = [0.0; 3];
    for seed in 0..SEEDS {
        let plan = schedule(Strategy::MonteCarlo, &gains, Budget::Visits(1), seed).unwrap();
        taken[plan.iter().position(Option::is_some).unwrap()] += 1.0;
    }
    assert_distributed(&taken, &[IOTA_BITS / sum, (2.0 + IOTA_BITS) / sum, (4.0 + IOTA_BITS) / sum]);
}

#[test]
fn where_nothing_can_be_gained_the_ratio_is_still_kept() {
    let gains = Gains::of(4, 10, |_, _| 0.0).unwrap();
    let mut expected = vec![0.05; 11];
    expected[0] = 0.5;
    assert_distributed(&counts(Strategy::MonteCarlo, &gains, Budget::Ratio(0.5), 2), &expected);
}

#[test]
fn random_looks_at_no_gain() {
    let gains = uneven(5, 4);
    let expected = [0.7, 0.075, 0.075, 0.075, 0.075];
    assert_distributed(&counts(Strategy::Random, &gains, Budget::Ratio(0.3), 1), &expected);
}

#[test]
fn greedy_takes_the_best() {
    let gains = Gains::of(4, 3, |slot, place| if place == slot % 3 { 1.0 + slot as f64 } else { 0.5 }).unwrap();
    let plan = schedule(Strategy::Greedy, &gains, Budget::Ratio(0.5), 7).unwrap();
    assert_eq!(plan, [None, None, Some(2), Some(0)]);
}

#[test]
fn greedy_without_a_preference_has_none() {
    let gains = Gains::of(4, 3, |_, _| 1.0).unwrap();
    let expected = [0.5, 1.0 / 6.0, 1.0 / 6.0, 1.0 / 6.0];
    for slot in 0..4 {
        assert_distributed(&counts(Strategy::Greedy, &gains, Budget::Visits(2), slot), &expected);
    }
    assert_distributed(
        &(0..SEEDS).fold(vec![0.0; 3], |mut counts, seed| {
            counts[best(&[1.0, 1.0, 1.0], seed).unwrap().0] += 1.0;
            counts
        }),
        &[1.0 / 3.0; 3],
    );
}

#[test]
fn round_robin_visits_all_alike_and_goes_on_where_it_stopped() {
    let gains = uneven(144, 10);
    let mut seen = [0; 10];
    let mut visited = 0;
    for _ in 0..5 {
        let plan = schedule(Strategy::RoundRobin { visited }, &gains, Budget::Ratio(0.5), 0).unwrap();
        visited += visits(&plan) as u64;
        plan.iter().flatten().for_each(|&place| seen[place] += 1);
        // Slots are interleaved: never two of the same kind in a row.
        assert!(plan.windows(2).all(|pair| pair[0].is_some() != pair[1].is_some()));
    }
    assert_eq!(seen, [36; 10]);
}

#[test]
fn a_visit_is_chosen_again_by_what_is_known_now() {
    assert_eq!(choose(Strategy::Greedy, 0, &[0.1, 0.9, 0.2], 3), 1);
    assert_eq!(choose(Strategy::RoundRobin { visited: 0 }, 2, &[0.1, 0.9, 0.2], 3), 2);
    assert_eq!(choose(Strategy::MonteCarlo, 2, &[], 3), 2);
    let mut counts = vec![0.0; 2];
    (0..SEEDS).for_each(|seed| counts[choose(Strategy::MonteCarlo, 0, &[1.0, 3.0], seed)] += 1.0);
    let sum = 4.0 + 2.0 * IOTA_BITS;
    assert_distributed(&counts, &[(1.0 + IOTA_BITS) / sum, (3.0 + IOTA_BITS) / sum]);
}

#[test]
fn a_surprise_changes_the_visit_and_a_small_one_does_not() {
    use crate::location::{information_bits, surprise_bits};
    let place = |expected: f64, informed: f64| (surprise_bits([(expected, informed)]), information_bits([informed]));
    // The second place: something was just observed there, while the model is certain of the contrary.
    assert_eq!(novel([place(0.0, 0.0), place(0.9, 0.02), place(0.5, 0.5)]), Some(1));
    assert_eq!(novel([place(0.0, 0.0), place(1.0, 1.0), place(0.9, 0.4), place(0.1, 0.0)]), None);
    // The larger of the two differences wins.
    assert_eq!(novel([place(0.6, 0.05), place(0.9, 0.05)]), Some(1));
    assert_eq!(novel([]), None);
}

#[test]
fn a_task_and_learning_share_a_robot_by_their_weight() {
    let information = Gains::of(1, 2, |_, place| if place == 0 { 2.0 } else { 1.0 }).unwrap();
    let task = Gains::of(1, 2, |_, place| if place == 0 { 0.2 } else { 0.9 }).unwrap();
    let at = |weight: f64| information.weighed(&task, weight).unwrap().slot(0).to_vec();
    assert_eq!(at(1.0), [1.0, 0.5]);
    assert_eq!(at(0.0), [0.2, 0.9]);
    assert!((at(0.5)[0] - 0.6).abs() < 1e-12 && (at(0.5)[1] - 0.7).abs() < 1e-12);
    assert_eq!(information.weighed(&task, 1.5), Err(StrategyError::Weight { found: 1.5 }));
    assert!(matches!(information.weighed(&uneven(2, 2), 0.5), Err(StrategyError::Sizes { .. })));
    assert!(matches!(information.weighed(&information, 0.5), Err(StrategyError::Gain { place: 0, .. })));
}

#[test]
fn what_makes_no_sense_is_refused() {
    assert_eq!(Gains::of(0, 1, |_, _| 0.0), Err(StrategyError::NoSlots));
    assert_eq!(Gains::of(1, 0, |_, _| 0.0), Err(StrategyError::NoPlaces));
    let uncalled = |_, _| -> f64 { panic!("asked for a gain of a matrix that is too large") };
    assert_eq!(Gains::of(96, 1_000_000, uncalled), Err(StrategyError::TooMany { slots: 96, places: 1_000_000 }));
    assert!(matches!(Gains::of(usize::MAX, 2, uncalled), Err(StrategyError::TooMany { .. })));
    for found in [f64::NAN, f64::INFINITY, -0.1] {
        assert!(matches!(Gains::of(1, 1, |_, _| found), Err(StrategyError::Gain { slot: 0, place: 0, .. })));
    }
    let gains = uneven(3, 2);
    for ratio in [f64::NAN, -0.1, 1.1] {
        let refused = schedule(Strategy::Greedy, &gains, Budget::Ratio(ratio), 0);
        assert!(matches!(refused, Err(StrategyError::Ratio { .. })), "{refused:?}");
    }
    let refused = schedule(Strategy::MonteCarlo, &gains, Budget::Visits(4), 0);
    assert_eq!(refused, Err(StrategyError::Budget { visits: 4, slots: 3 }));
    assert_eq!(Allowance::new(3, 4).unwrap_err(), StrategyError::Budget { visits: 4, slots: 3 });
    assert_eq!(Allowance::new(0, 0).unwrap_err(), StrategyError::NoSlots);
}

#[test]
fn an_allowance_learns_when_visits_are_worth_most() {
    let mut allowance = Allowance::new(10, 4).unwrap();
    let gain = |slot: usize| if (3..6).contains(&slot) { 1.0 } else { 0.1 };
    let mut day = || (0..10).map(|slot| allowance.grant(gain(slot))).collect::<Vec<_>>();
    let first = day();
    assert_eq!(first.iter().filter(|granted| **granted).count(), 4);
    // Visits are evenly spread at first, then at the best slots.
    assert!(first[..5].iter().filter(|granted| **granted).count() == 2);
    let second = day();
    assert!(second[3] && second[4] && second[5], "{second:?}");
}

#[test]
fn a_visit_is_worth_it_if_few_later_slots_are_better() {
    let later = [0.9, 0.5, 0.1];
    assert!(is_worth_a_visit(0.6, &later, 2) && !is_worth_a_visit(0.6, &later, 1));
    // Equal gains count half.
    assert!(!is_worth_a_visit(0.5, &[0.5, 0.5], 1) && is_worth_a_visit(0.5, &[0.5], 1));
    assert!(is_worth_a_visit(0.0, &later, 4), "more visits than slots are left");
    assert!(!is_worth_a_visit(1.0, &later, 0) && !is_worth_a_visit(1.0, &[], 0));
    assert!(is_worth_a_visit(0.1, &[f64::NAN], 1));
}

#[test]
fn an_allowance_spreads_visits_that_are_worth_the_same() {
    let mut allowance = Allowance::new(144, 72).unwrap();
    for _ in 0..3 {
        let day: Vec<bool> = (0..144).map(|_| allowance.grant(1.0)).collect();
        let early = day[..72].iter().filter(|granted| **granted).count();
        assert!((34..=38).contains(&early), "{early}");
    }
}

fn strategies() -> impl proptest::strategy::Strategy<Value = Strategy> {
    prop_oneof![
        any::<u64>().prop_map(|visited| Strategy::RoundRobin { visited }),
        Just(Strategy::Random),
        Just(Strategy::Greedy),
        Just(Strategy::MonteCarlo),
    ]
}

proptest! {
    #[test]
    fn a_number_of_visits_is_kept_exactly_and_seeds_repeat(
        strategy in strategies(),
        places in 1..6_usize,
        (slots, count) in (1..40_usize).prop_flat_map(|slots| (Just(slots), 0..=slots)),
        gains in proptest::collection::vec(prop_oneof![Just(0.0), 0.0..1e12_f64], 240),
        seed in any::<u64>(),
    ) {
        let gains = Gains::of(slots, places, |slot, place| gains[slot * places + place]).unwrap();
        let plan = schedule(strategy, &gains, Budget::Visits(count), seed).unwrap();
        prop_assert_eq!(plan.len(), slots);
        prop_assert_eq!(visits(&plan), count);
        prop_assert!(plan.iter().flatten().all(|&place| place < places));
        prop_assert_eq!(&schedule(strategy, &gains, Budget::Visits(count), seed).unwrap(), &plan);
        let none = schedule(strategy, &gains, Budget::Ratio(0.0), seed).unwrap();
        prop_assert_eq!(visits(&none), 0);
        let all = schedule(strategy, &gains, Budget::Ratio(1.0), seed).unwrap();
        prop_assert_eq!(visits(&all), slots);
    }

    #[test]
    fn an_allowance_is_spent_and_never_exceeded(
        (slots, count) in (1..30_usize).prop_flat_map(|slots| (Just(slots), 0..=slots)),
        gains in proptest::collection::vec(prop::num::f64::ANY, 270),
    ) {
        let mut allowance = Allowance::new(slots, count).unwrap();
        for day in gains.chunks_exact(slots) {
            prop_assert_eq!(day.iter().filter(|&&gain| allowance.grant(gain)).count(), count);
        }
    }
}
