//! Schedules visits: which place in which slot.

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};
use tidemap_model::{INFORMATION_CERTAINTY, entropy_bits};

use super::{Budget, GAIN_MAX, IOTA_BITS, NOVELTY_FACTOR, Strategy, StrategyError, draw, gains::Gains};

/// The place to visit in each slot; `None` for slots without a visit.
///
/// # Errors
/// [`StrategyError`] if the budget does not fit the slots.
pub fn schedule(
    strategy: Strategy,
    gains: &Gains,
    budget: Budget,
    seed: u64,
) -> Result<Vec<Option<usize>>, StrategyError> {
    let (slots, places) = (gains.slots(), gains.places());
    let visits = budget.visits(slots)?;
    let mut random = SmallRng::seed_from_u64(seed);
    let visits_of_slots = match strategy {
        Strategy::RoundRobin { visited } => {
            let mut turn = (visited % places as u64) as usize;
            let visit = |slot: usize| {
                let is_visit = (slot + 1) * visits / slots > slot * visits / slots;
                is_visit.then(|| {
                    let place = turn;
                    turn = (turn + 1) % places;
                    place
                })
            };
            (0..slots).map(visit).collect()
        }
        Strategy::Random => by_chance(
            &mut random,
            budget,
            visits,
            slots,
            |_, _| 1.0,
            places,
            |ratio| {
                if ratio > 0.0 { places as f64 * (1.0 - ratio) / ratio } else { 0.0 }
            },
        ),
        Strategy::MonteCarlo => {
            let weight = |slot, place| gains.at(slot, place) + IOTA_BITS;
            let rest = |ratio| rest_that_keeps_the_ratio(gains, ratio);
            by_chance(&mut random, budget, visits, slots, weight, places, rest)
        }
        Strategy::Greedy => greedy(&mut random, gains, visits),
    };
    debug_assert_eq!(visits_of_slots.len(), slots, "a plan has one row per slot");
    debug_assert!(visits_of_slots.iter().flatten().all(|&place| place < places), "{visits_of_slots:?}");
    Ok(visits_of_slots)
}

/// The weight of no visit, w, for which the expected number of visits is the ratio times the slots: the root of
/// Σ S/(S + w) = e·m over the m slots, where S is the sum of a slot's gains, each plus ι. `ratio` is above 0.
fn rest_that_keeps_the_ratio(gains: &Gains, ratio: f64) -> f64 {
    /// Halvings of the bracket: below the resolution of f64.
    const STEPS: usize = 64;
    let of_slot = |slot: usize| gains.slot(slot).iter().map(|gain| gain + IOTA_BITS).sum::<f64>();
    let sums: Vec<f64> = (0..gains.slots()).map(of_slot).collect();
    let odds = (1.0 - ratio) / ratio;
    // The bracket: the root if all slots were like the poorest slot, and if all were like the richest.
    let mut least = sums.iter().copied().fold(f64::INFINITY, f64::min) * odds;
    let mut highest = sums.iter().copied().fold(0.0, f64::max) * odds;
    let wanted = ratio * sums.len() as f64;
    for _ in 0..STEPS {
        // Gains differ by orders of magnitude, so this is the geometric mean; for a ratio of 1 the mean is 0.
        let middle = least.sqrt() * highest.sqrt();
        let expected: f64 = sums.iter().map(|sum| sum / (sum + middle)).sum();
        if expected > wanted { least = middle } else { highest = middle }
    }
    least.sqrt() * highest.sqrt()
}

/// Draws slots and places in proportion to weights. With a ratio each slot is drawn independently, against the weight
/// of no visit.
fn by_chance(
    random: &mut SmallRng,
    budget: Budget,
    visits: usize,
    slots: usize,
    weight: impl Fn(usize, usize) -> f64,
    places: usize,
    rest: impl Fn(f64) -> f64,
) -> Vec<Option<usize>> {
    let mut plan = vec![None; slots];
    match budget {
        Budget::Ratio(ratio) if ratio > 0.0 => {
            let rest = rest(ratio);
            for (slot, visit) in plan.iter_mut().enumerate() {
                let weights = std::iter::once(rest).chain((0..places).map(|place| weight(slot, place)));
                *visit = draw::index(random, weights).checked_sub(1);
            }
        }
        Budget::Ratio(_) => {}
        Budget::Visits(_) => {
            let of_slots: Vec<f64> =
                (0..slots).map(|slot| (0..places).map(|place| weight(slot, place)).sum()).collect();
            for slot in draw::distinct(random, &of_slots, visits) {
                if let Some(visit) = plan.get_mut(slot) {
                    *visit = Some(draw::index(random, (0..places).map(|place| weight(slot, place))));
                }
            }
        }
    }
    plan
}

fn greedy(random: &mut SmallRng, gains: &Gains, visits: usize) -> Vec<Option<usize>> {
    let best: Vec<Option<(usize, f64)>> =
        (0..gains.slots()).map(|slot| draw::largest(random, gains.slot(slot))).collect();
    let mut ranked: Vec<(f64, u64, usize)> = best
        .iter()
        .enumerate()
        .map(|(slot, best)| (best.map_or(0.0, |(_, gain)| gain), random.random(), slot))
        .collect();
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut plan = vec![None; gains.slots()];
    for (_, _, slot) in ranked.into_iter().take(visits) {
        plan[slot] = best[slot].map(|(place, _)| place);
    }
    plan
}

/// Chooses the place again by the present gains of all places in the slot: the best place, or with random strategies a
/// place drawn in proportion to gain plus [`IOTA_BITS`]. Strategies that ignore gains, and empty gains, keep `planned`.
pub fn choose(strategy: Strategy, planned: usize, gains_now: &[f64], seed: u64) -> usize {
    let mut random = SmallRng::seed_from_u64(seed);
    match strategy {
        Strategy::RoundRobin { .. } | Strategy::Random => planned,
        Strategy::Greedy => draw::largest(&mut random, gains_now).map_or(planned, |(place, _)| place),
        Strategy::MonteCarlo if gains_now.is_empty() => planned,
        Strategy::MonteCarlo => {
            draw::index(&mut random, gains_now.iter().map(|gain| gain.clamp(0.0, GAIN_MAX) + IOTA_BITS))
        }
    }
}

/// A place to visit instead of the planned one, because recent observations contradict the model there: of the places
/// where [`surprise_bits`](crate::location::surprise_bits) is at least [`NOVELTY_FACTOR`] times the model's
/// expectation, the place with the largest difference (RAS 2017, eq. 12). `None` where there is none. Pairs are (I', I)
/// of each place.
pub fn novel(places: impl IntoIterator<Item = (f64, f64)>) -> Option<usize> {
    let mut best: Option<(usize, f64)> = None;
    for (place, (surprise, expected)) in places.into_iter().enumerate() {
        let more = surprise - expected;
        // The surprise limits probabilities to the certainty, so the compared value must do so, too.
        let is_novel = surprise >= NOVELTY_FACTOR * expected.max(entropy_bits(INFORMATION_CERTAINTY));
        if is_novel && best.is_none_or(|(_, highest)| more > highest) {
            best = Some((place, more));
        }
    }
    best.map(|(place, _)| place)
}

/// The place with the largest gain, and that gain; ties are broken by the seed. `None` without places.
pub fn best(gains_now: &[f64], seed: u64) -> Option<(usize, f64)> {
    draw::largest(&mut SmallRng::seed_from_u64(seed), gains_now)
}
