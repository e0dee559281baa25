//! Presence against exact enumeration, and in a simulated flat.

use proptest::prelude::*;

use super::*;

fn model(places: usize, slots: usize) -> Presence {
    Presence::new(PresenceOptions::new(places, slots)).unwrap()
}

#[track_caller]
fn assert_close(found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() < 1e-9, "{found} instead of {expected}");
    }
}

#[test]
fn nothing_known_is_everywhere_alike() {
    let mut presence = model(4, 24);
    assert_close(presence.probabilities(), &[0.25; 4]);
    presence.observe(0, true);
    assert_close(presence.probabilities(), &[0.25; 4]);
    presence.advance(0);
    presence.observe(4, true);
    assert_close(presence.probabilities(), &[0.25; 4]);
}

#[test]
fn an_observation_of_one_place_informs_about_the_others() {
    let mut presence = model(4, 24);
    presence.advance(0);
    presence.observe(1, false);
    assert_close(presence.probabilities(), &[1.0 / 3.0, 0.0, 1.0 / 3.0, 1.0 / 3.0]);
    presence.observe(2, true);
    assert_close(presence.probabilities(), &[0.0, 0.0, 1.0, 0.0]);
    // An impossible observation is accepted.
    presence.observe(2, false);
    assert_close(presence.probabilities(), &[1.0 / 3.0, 1.0 / 3.0, 0.0, 1.0 / 3.0]);
}

#[test]
fn what_was_seen_fades_and_a_forecast_is_where_time_leads() {
    let mut presence = model(2, 24);
    presence.advance(5);
    presence.observe(0, true);
    let ahead = presence.forecast([6, 7]);
    assert_close(&ahead[0], &[0.75, 0.25]);
    assert_close(&ahead[1], &[0.625, 0.375]);
    presence.advance(6);
    assert_close(presence.probabilities(), &ahead[0]);
    presence.advance(7);
    assert_close(presence.probabilities(), &ahead[1]);
}

/// The expected changes, by summing over every path through the places.
fn enumerated_changes(model: &Presence) -> Vec<f64> {
    let (places, slots) = (model.options.places, model.history.len());
    let mut counts = vec![0.0; model.transitions.len()];
    let mut total = 0.0;
    for code in 0..places.pow(slots as u32) {
        let path: Vec<usize> = (0..slots).map(|slot| code / places.pow(slot as u32) % places).collect();
        let change = |slot: usize| (model.history[slot].of_day * places + path[slot - 1]) * places + path[slot];
        let mut weight = model.initial[path[0]];
        weight *= (1..slots).map(|slot| model.transitions[change(slot)]).product::<f64>();
        for (slot, &place) in model.history.iter().zip(&path) {
            if let Some(observation) = slot.observation {
                weight *= f64::from(u8::from((place == observation.place) == observation.there));
            }
        }
        total += weight;
        (1..slots).for_each(|slot| counts[change(slot)] += weight);
    }
    counts.iter().map(|count| count / total).collect()
}

proptest! {
    #[test]
    fn expected_changes_are_those_of_all_paths(
        looks in proptest::collection::vec(proptest::option::of((0..3_usize, any::<bool>())), 1..7),
        rounds in 0..3_usize,
    ) {
        let mut presence = model(3, 2);
        for (slot, observation) in looks.iter().enumerate() {
            presence.advance(slot % 2);
            if let Some((place, there)) = *observation {
                presence.observe(place, there);
            }
        }
        // After learning, the rates are no longer those of the start.
        (0..rounds).for_each(|_| presence.learn());
        let (found, expected) = (presence.expected_changes(), enumerated_changes(&presence));
        for (found, expected) in found.iter().zip(&expected) {
            prop_assert!((found - expected).abs() < 1e-9, "{found} instead of {expected}");
        }
    }

    #[test]
    fn probabilities_always_sum_to_one(
        looks in proptest::collection::vec((0..30_usize, 0..6_usize, any::<bool>(), any::<bool>()), 0..60),
    ) {
        let mut presence = model(5, 24);
        for (slot, place, there, learn) in looks {
            presence.advance(slot);
            presence.observe(place, there);
            presence.observe(place.wrapping_add(1) % 5, there);
            if learn {
                presence.learn();
            }
            for ahead in std::iter::once(presence.probabilities().to_vec()).chain(presence.forecast([slot, 0, 99])) {
                prop_assert!((ahead.iter().sum::<f64>() - 1.0).abs() < 1e-9, "{ahead:?}");
                prop_assert!(ahead.iter().all(|p| (0.0..=1.0).contains(p)), "{ahead:?}");
            }
        }
    }
}

/// A person in place 0 by night, in place 1 by day, and in place 2 for dinner at six.
fn home(slot: usize) -> usize {
    match slot % 24 {
        8..=17 => 1,
        18..=19 => 2,
        _ => 0,
    }
}

#[test]
fn habits_are_learned_from_one_look_at_a_time() {
    let mut options = PresenceOptions::new(3, 24);
    options.smoothing_slots = 0.0;
    let mut presence = Presence::new(options).unwrap();
    for slot in 0..24 * 30 {
        if slot % 24 == 0 {
            presence.learn();
        }
        presence.advance(slot % 24);
        // Observes each place in turn.
        let place = (slot * 5 / 3) % 3;
        presence.observe(place, home(slot) == place);
    }
    presence.learn();
    let ahead = presence.forecast(0..24);
    for (slot, ahead) in ahead.iter().enumerate() {
        assert!(ahead[home(slot)] > 0.5, "{slot}: {ahead:?}");
    }
}

#[test]
fn the_oldest_is_forgotten_and_the_rest_still_known() {
    let mut presence = model(2, 24);
    for slot in 0..HISTORY_MAX + 100 {
        presence.advance(slot % 24);
        presence.observe(0, true);
    }
    assert_eq!(presence.history.len(), HISTORY_MAX);
    assert_close(presence.probabilities(), &[1.0, 0.0]);
    assert!((presence.initial.iter().sum::<f64>() - 1.0).abs() < 1e-9);
}

#[test]
fn options_outside_their_range_are_refused() {
    let usual = PresenceOptions::new(10, 144);
    for options in [
        PresenceOptions { places: 1, ..usual },
        PresenceOptions { places: 65, ..usual },
        PresenceOptions { slots_per_day: 0, ..usual },
        PresenceOptions { slots_per_day: 1441, ..usual },
        PresenceOptions { smoothing_slots: f64::NAN, ..usual },
        PresenceOptions { smoothing_slots: 37.0, ..usual },
        PresenceOptions { prior_slots: 0.0, ..usual },
        PresenceOptions { prior_slots: f64::INFINITY, ..usual },
        PresenceOptions { steps: 0, ..usual },
    ] {
        assert!(matches!(Presence::new(options), Err(CannotTrain::Parameter { .. })), "{options:?}");
    }
}
