//! The profile of the week in tiers, each shrunk towards the one before by credibility.
//!
//! A tier's estimate from n days, x̄, and the tier before, p, are combined as (n x̄ + κ p)/(n + κ), κ = caution · s²/a.
//! Here s² is the variance between days that the tier treats as alike, and a the squared difference of its true profile
//! from the tier before, both estimated by moments over all slots (Bühlmann 1967; with unequal weights, Bühlmann and
//! Straub, "Glaubwürdigkeit für Schadensätze", 1970). Invariant: every estimate is a weighted mean, so it lies in
//! `[0,1]`.

use super::CalibratedOptions;
use super::slots::{DAYS_OF_WEEK, DaySums, SLOTS_PER_DAY, SlotSums, WeekSums};
use crate::special::square;

/// The first day of the weekend.
const SATURDAY: usize = 5;

/// A profile of the day for each group of days.
type Profiles = Vec<Vec<f64>>;

/// The sums of one group's days, per slot of the day.
type GroupSums = Vec<DaySums>;

/// The predicted value in each slot of the week, Monday first, in `[0,1]`.
pub(super) fn profile(sums: &SlotSums, options: CalibratedOptions) -> Vec<f64> {
    let CalibratedOptions { caution, day_of_week_caution, .. } = options;
    let broad = group(&sums.broad, 0, DAYS_OF_WEEK);
    let fine = group(&sums.fine, 0, DAYS_OF_WEEK);
    let kinds = [group(&sums.fine, 0, SATURDAY), group(&sums.fine, SATURDAY, DAYS_OF_WEEK)];
    let days: Vec<GroupSums> = (0..DAYS_OF_WEEK).map(|day| group(&sums.fine, day, day + 1)).collect();

    let mean = overall_mean(&fine);
    // The variance has the greatest value that is possible for values in [0,1].
    let before_any = Spread { alike: 0.25 };
    // The two profiles of all days compare slots. The broad profile contains some of each slot's own days; ignoring
    // this errs towards the broad profile.
    let flat = vec![vec![mean; SLOTS_PER_DAY]];
    let (broad_day, spread) = refine(&[broad], &flat, |_, _| 1.0 / SLOTS_PER_DAY as f64, before_any, caution);
    let (day, spread) = refine(std::slice::from_ref(&fine), &broad_day, |_, _| 0.0, spread, caution);
    let before = vec![day[0].clone(); kinds.len()];
    let (kind, spread) = refine(&kinds, &before, |kind, slot| share(kinds[kind][slot], fine[slot]), spread, caution);
    let kind_of = |day: usize| usize::from(day >= SATURDAY);
    let before: Profiles = (0..DAYS_OF_WEEK).map(|day| kind[kind_of(day)].clone()).collect();
    let of_kind = |day: usize, slot: usize| share(days[day][slot], kinds[kind_of(day)][slot]);
    let (week, _) = refine(&days, &before, of_kind, spread, day_of_week_caution);
    week.concat()
}

/// The sums over some days of the week.
fn group(sums: &[WeekSums], from: usize, to: usize) -> GroupSums {
    sums.iter().map(|week| week[from..to].iter().fold(DaySums::default(), |all, &day| all.and(day))).collect()
}

fn overall_mean(sums: &[DaySums]) -> f64 {
    let days: f64 = sums.iter().map(|slot| slot.days()).sum();
    sums.iter().map(|slot| slot.days() * slot.mean()).sum::<f64>() / days.max(f64::MIN_POSITIVE)
}

/// The share of this part in the mean of all.
fn share(part: DaySums, all: DaySums) -> f64 {
    if all.days() > 0.0 { (part.days() / all.days()).min(1.0) } else { 0.0 }
}

/// The variance between days that a tier treats as alike.
#[derive(Clone, Copy)]
struct Spread {
    /// Variance s² between such days, in a slot, pooled over all.
    alike: f64,
}

/// The next tier: for each group a profile, shrunk towards the group's profile in the tier before.
///
/// `share` is the share of the group itself in the tier before, in a slot: to that extent they agree by construction.
fn refine(
    groups: &[GroupSums],
    before: &Profiles,
    share: impl Fn(usize, usize) -> f64,
    spread_before: Spread,
    caution: f64,
) -> (Profiles, Spread) {
    // Σ over slots of squared deviations between days, and of their degrees of freedom, per group.
    let scatter: Vec<(f64, f64)> = groups
        .iter()
        .map(|slots| {
            let sums = (0.0, 0.0);
            slots.iter().fold(sums, |(squares, free), slot| (squares + slot.deviations(), free + slot.freedom()))
        })
        .collect();
    let (squares, free) = scatter.iter().fold((0.0, 0.0), |all, group| (all.0 + group.0, all.1 + group.1));
    // The priors have the weight of one day each: the prior of a group is its tier, that of a tier is the one before.
    let borrowed = SLOTS_PER_DAY as f64;
    let alike = (squares + borrowed * spread_before.alike) / (free + borrowed);
    let alike_in: Vec<f64> =
        scatter.iter().map(|&(squares, free)| (squares + borrowed * alike) / (free + borrowed)).collect();

    let (mut departure, mut weight) = (0.0, 0.0);
    for ((group, slots), before) in groups.iter().enumerate().zip(before) {
        for (slot, (sums, before)) in slots.iter().zip(before).enumerate() {
            let own = 1.0 - share(group, slot);
            // The part that the scatter of days alone explains is subtracted.
            departure += sums.days() * square(sums.mean() - before) - own * sums.share_seen() * alike_in[group];
            weight += own * sums.days();
        }
    }
    let true_departure = if weight > 0.0 { (departure / weight).max(0.0) } else { 0.0 };

    let refined = groups
        .iter()
        .zip(before)
        .zip(&alike_in)
        .map(|((slots, before), alike)| {
            slots
                .iter()
                .zip(before)
                .map(|(&sums, &before)| credible(sums, before, caution * alike, true_departure))
                .collect()
        })
        .collect();
    (refined, Spread { alike })
}

/// (n x̄ + κ p)/(n + κ), κ = `alike`/`departure`, multiplied out so that a value of 0 in either is no exception.
fn credible(sums: DaySums, before: f64, alike: f64, departure: f64) -> f64 {
    let own = sums.days() * departure;
    let all = own + alike;
    // If there are no days, or days never differ and the tier equals the one before, both ends are equal.
    if own <= 0.0 || !all.is_finite() { before } else { (own * sums.mean() + alike * before) / all }
}
