//! Exploration of synthetic recordings with known results, and of the recorded apartment.
#![allow(clippy::unwrap_used)]

use std::path::{Path, PathBuf};

use tidemap_model::{catalogue::ModelKind, selector::Blend};

use super::*;
use crate::explore::protocol::parse;

const PROTOCOL: &str = "name: flat
world: flat.txt
slot: 30m
exploration: 0.25
seeds: 3
weeks: [2, 3]
strategies: [round-robin, online-error]
models: [mean, spectral+persistence, presence]
out: results
";

fn protocol(text: &str) -> PlacesProtocol {
    match parse(text, "stem", Path::new("lab")) {
        Ok(ExploreProtocol::Places(protocol)) => protocol,
        Ok(wanted) => panic!("{wanted:?}"),
        Err(error) => panic!("{error}"),
    }
}

/// In bed until seven, in the kitchen until nine, out until six, then on the sofa until eleven; every day alike.
fn regular(days: usize) -> PlaceRecording {
    let mut rows = String::new();
    for day in 0..days {
        let start = day * 1440;
        for (from, until, place) in
            [(0, 420, "bed"), (420, 540, "kitchen"), (540, 1080, "out"), (1080, 1380, "sofa"), (1380, 1440, "bed")]
        {
            rows.push_str(&format!("{} {} {place}\n", start + from, start + until));
        }
    }
    PlaceRecording::parse(&rows, 30).unwrap()
}

fn error(outcome: &Exploration, strategy: VisitStrategy, model: &str, days: std::ops::Range<usize>) -> f64 {
    let result = outcome.results.iter().find(|result| result.strategy == strategy && result.model.name() == model);
    100.0 * result.unwrap_or_else(|| panic!("{} {model}", strategy.name())).error(days).mean
}

#[test]
fn a_protocol_is_read_and_has_defaults() {
    let read = protocol(PROTOCOL);
    assert_eq!((read.world, read.out), (PathBuf::from("lab/flat.txt"), PathBuf::from("lab/results")));
    assert_eq!((read.slot_minutes, read.seeds, read.weeks), (30, 3, Some((2, 3))));
    assert_eq!(read.strategies, [VisitStrategy::RoundRobin, VisitStrategy::OnlineError]);
    assert_eq!(read.models[1], BeliefModel::Each { kind: ModelKind::Spectral, blend: Blend::Persistence });
    let least = protocol("world: w\nstrategies: greedy\nmodels: presence\nout: o\n");
    assert_eq!((least.name.as_str(), least.slot_minutes, least.seeds, least.weeks), ("stem", 10, 5, None));
    assert_eq!((least.explorations, least.worths), (vec![0.5], vec![VisitWorth::Entropy]));
}

#[test]
fn what_is_wrong_in_a_protocol_is_named() {
    for (from, to, message) in [
        (
            "slot: 30m",
            "slot: 7m",
            "line 3: slot is \"7m\": it has to be whole minutes that divide the day, such as 10m",
        ),
        ("slot: 30m", "slot: 90s", "line 3: slot is \"90s\""),
        ("slot: 30m", "slot: 2d", "line 3: slot is \"2d\""),
        ("exploration: 0.25", "exploration: 1.5", "line 4: exploration is \"1.5\""),
        ("exploration: 0.25", "exploration: []", "line 4: exploration is \"[]\": it has to be the share of slots"),
        ("exploration: 0.25", "exploration: [0.25, half]", "line 4: exploration is \"half\""),
        (
            "exploration: 0.25",
            "exploration: [0.25, 0.250]",
            "line 4: exploration is \"0.250\": it has to be each share",
        ),
        ("seeds: 3", "seeds: 0", "line 5: seeds is \"0\": it has to be a whole number from 1 to 1000"),
        ("weeks: [2, 3]", "weeks: [3, 2]", "line 6: weeks is \"2\": it has to be the first and the last week"),
        ("weeks: [2, 3]", "weeks: [0, 2]", "line 6: weeks is \"0\""),
        ("weeks: [2, 3]", "weeks: 2", "line 6: weeks is \"2\""),
        (
            "online-error]",
            "clever]",
            "line 7: strategies is \"clever\": it has to be one of: round-robin, random, greedy",
        ),
        ("presence]", "persistence+persistence]", "line 8: models is \"persistence+persistence\""),
        (
            "presence]",
            "presence]\ninformation: [ral, more]",
            "line 9: information is \"more\": it has to be one of: entropy",
        ),
        ("presence]", "mean]", "line 8: models is \"mean\": it has to be each once"),
        ("name: flat", "nam: flat", "line 1"),
        ("world: flat.txt\n", "", "key world is missing: write the file of the world"),
        ("models: [mean, spectral+persistence, presence]\n", "", "key models is missing: write a list of models"),
    ] {
        assert!(PROTOCOL.contains(from), "{from}");
        let refused = parse(&PROTOCOL.replace(from, to), "stem", Path::new("")).expect_err(to).to_string();
        assert!(refused.starts_with(message) || refused.contains("nam"), "{refused}");
    }
    let refused = parse(&PROTOCOL.replace("0.25", ".nan"), "stem", Path::new("")).expect_err("no number").to_string();
    assert!(refused.contains("`.nan`") && refused.contains("line 4"), "{refused}");
}

#[test]
fn a_world_has_one_place_in_every_minute() {
    let world = PlaceRecording::parse("0 700 a\n700 1440 b\n1440 2000 a\n", 10).unwrap();
    assert_eq!((world.days(), world.slots()), (1, 144));
    assert_eq!((world.seen(69), world.seen(70)), (0, 1));
    assert_eq!(world.slot(144), [0_u8; 0]);
    for (text, wrong) in [
        ("0 1440 a\n1441 2880 b\n", "begins at minute 1441, and the row before ends at 1440"),
        ("0 1440 a\n1440 1440 b\n", "ends at minute 1440: it has to be after 1440"),
        ("0 99999999999 a\n", "it has to be after 0, and at most"),
        ("0 x a\n", "\"x\" is no minute"),
        ("-1 4 a\n", "\"-1\" is no minute"),
        ("0 4\n", "is no row: write FROM UNTIL PLACE"),
        ("0 4 a b\n", "is no row"),
    ] {
        let (line, found) = PlaceRecording::parse(text, 10).expect_err(text);
        assert!(line.is_some() && found.contains(wrong), "{found}");
    }
    for (text, wrong) in [
        ("", "at least two places"),
        ("0 1440 a\n", "at least two places, and this has 1"),
        ("0 10 a\n10 20 b\n", "it has 20 minutes"),
    ] {
        assert!(matches!(PlaceRecording::parse(text, 10), Err((None, found)) if found.contains(wrong)), "{text}");
    }
}

#[test]
fn of_a_regular_life_all_but_the_surprise_is_learned() {
    let outcome = explore(&regular(28), &protocol(PROTOCOL), &|_, _| ()).unwrap();
    let late = |plan, model| error(&outcome, plan, model, 21..28);
    // If a person is in no place for most of the time, the mean predicts that no one is anywhere.
    assert!(late(VisitStrategy::RoundRobin, "mean") > 15.0);
    // In turn, each place is seen at the same times every day, and events at other times stay unknown.
    assert!(late(VisitStrategy::RoundRobin, "presence") > 10.0);
    let best = late(VisitStrategy::OnlineError, "presence");
    assert!(best < 5.0, "{best}");
    for result in &outcome.results {
        assert!((result.visits_per_day - 12.0).abs() < 1e-12, "{}", result.visits_per_day);
        assert_eq!((result.days.len(), result.days[0].len()), (3, 28));
    }
}

#[test]
fn nothing_is_known_before_it_is_seen() {
    // Without a visit a state is not predicted to be on: one place of four is wrong in every minute, forever.
    let text = PROTOCOL.replace("exploration: 0.25", "exploration: 0");
    let outcome = explore(&regular(21), &protocol(&text), &|_, _| ()).unwrap();
    for result in &outcome.results {
        assert!((result.error(0..21).mean - 0.25).abs() < 1e-12, "{} {:?}", result.model.name(), result.error(0..21));
    }
    // Later data changes no earlier result.
    let all = "round-robin, random, greedy, monte-carlo, novelty-driven, online, online-error";
    let models = "mean, persistence, spectral, histogram, calibrated, spectral+persistence, spectral+memory, presence";
    let text = PROTOCOL
        .replace("round-robin, online-error", all)
        .replace("mean, spectral+persistence, presence", models)
        .replace("seeds: 3", "seeds: 1");
    let (short, long) = (regular(7), regular(9));
    let run = |world: &PlaceRecording| explore(world, &protocol(&text), &|_, _| ()).unwrap();
    for (short, long) in run(&short).results.iter().zip(run(&long).results) {
        assert_eq!(short.days[0], long.days[0][..7]);
    }
}

#[test]
fn a_seed_repeats_and_another_differs() {
    let text = PROTOCOL.replace("round-robin, online-error", "monte-carlo").replace("mean, spectral+persistence, ", "");
    let run = || explore(&regular(5), &protocol(&text), &|_, _| ()).unwrap().results.remove(0);
    let (first, again) = (run(), run());
    assert_eq!(first.days, again.days);
    assert_ne!(first.days[0], first.days[1]);
    assert!(first.error(0..5).standard_error.unwrap() > 0.0);
}

#[test]
fn results_are_written() {
    let folder = tempfile::tempdir().unwrap();
    let protocol = protocol(PROTOCOL);
    let outcome = explore(&regular(21), &protocol, &|_, _| ()).unwrap();
    write(&protocol, &outcome, folder.path()).unwrap();
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    let results = read("results.csv");
    let header =
        "strategy,model,error_percent,standard_error,weeks_2_3_percent,weeks_2_3_standard_error,visits_per_day";
    assert_eq!(results.lines().next(), Some(header));
    assert_eq!(results.lines().count(), 1 + 6);
    assert_eq!(read("weeks.csv").lines().count(), 1 + 6 * 3);
    let picture = read("exploration.svg");
    assert!(picture.starts_with("<svg") && picture.contains("online-error") && !picture.contains("NaN"), "{picture}");
}

#[test]
fn several_shares_of_slots_are_compared_in_one_run() {
    let text = PROTOCOL.replace("exploration: 0.25", "exploration: [0, 0.25]").replace("seeds: 3", "seeds: 1");
    let (one, both) = (protocol(&PROTOCOL.replace("seeds: 3", "seeds: 1")), protocol(&text));
    let world = regular(21);
    let run = |protocol: &PlacesProtocol| explore(&world, protocol, &|_, _| ()).unwrap();
    let outcome = run(&both);
    let shares: Vec<f64> = outcome.results.iter().map(|result| result.exploration).collect();
    assert_eq!(shares, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.25, 0.25, 0.25, 0.25, 0.25, 0.25]);
    // A share is explored as it would be alone.
    for (result, alone) in outcome.results[6..].iter().zip(run(&one).results) {
        assert_eq!((result.strategy, result.model, &result.days), (alone.strategy, alone.model, &alone.days));
    }
    let folder = tempfile::tempdir().unwrap();
    write(&both, &outcome, folder.path()).unwrap();
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    assert!(read("results.csv").starts_with("exploration,strategy,model,error_percent,"));
    assert!(read("weeks.csv").contains("\n0.25,online-error,presence,3,"));
    assert!(read("exploration.svg").contains("online-error, 0.25"));
}

#[test]
fn measures_of_a_visit_are_compared_in_one_run() {
    let text = PROTOCOL
        .replace("models: [mean, spectral+persistence, presence]", "information: [ral, both]\nmodels: [ensemble, mean]")
        .replace("round-robin, online-error", "greedy")
        .replace("seeds: 3", "seeds: 1");
    let protocol = protocol(&text);
    let outcome = explore(&regular(21), &protocol, &|_, _| ()).unwrap();
    let [gain, gain_of_mean, both, both_of_mean] = &outcome.results[..] else { panic!("{}", outcome.results.len()) };
    assert_eq!((gain.worth.name(), both.worth.name()), ("ral", "both"));
    assert_ne!(gain.days, both.days);
    // The mean counts no bins, so only a place without any observation is worth more.
    assert_eq!(gain_of_mean.model, both_of_mean.model);
    let folder = tempfile::tempdir().unwrap();
    write(&protocol, &outcome, folder.path()).unwrap();
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    assert!(read("results.csv").starts_with("strategy,information,model,error_percent,"));
    assert!(read("results.csv").contains("\ngreedy,both,ensemble,"));
    assert!(read("exploration.svg").contains("greedy, both"));
}

#[test]
fn weeks_that_the_world_does_not_have_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let world = folder.path().join("flat.txt");
    std::fs::write(&world, "0 1440 a\n1440 14400 b\n").unwrap();
    let wanted = PlacesProtocol { world, ..protocol(PROTOCOL) };
    let refused = run(&wanted, &|_, _| ()).unwrap_err().to_string();
    assert_eq!(refused, "weeks 2 to 3 are scored separately, and the world has 1 whole weeks");
    let missing = PlacesProtocol { world: folder.path().join("none.txt"), ..wanted };
    assert!(run(&missing, &|_, _| ()).unwrap_err().to_string().contains("none.txt cannot be read"));
}

/// The flat of RAS 2017, eight of its sixteen weeks.
#[test]
fn of_the_recorded_flat_the_published_order_is_found_and_the_best_pair_is_far_ahead() {
    let Some(folder) = crate::tests::recordings("aruba") else { return };
    let world = folder.join("presence_8weeks.txt");
    let world = world.display();
    let text = format!(
        "world: {world}\nseeds: 2\nweeks: [3, 8]\nstrategies: [round-robin, monte-carlo, online-error]\n\
         models: [mean, spectral, presence]\nout: o\n"
    );
    let outcome = run(&protocol(&text), &|_, _| ()).unwrap();
    let whole = |plan, model| error(&outcome, plan, model, 0..56);
    let spectral = whole(VisitStrategy::MonteCarlo, "spectral");
    assert!((5.5..7.0).contains(&spectral), "{spectral}");
    assert!(spectral < whole(VisitStrategy::RoundRobin, "spectral"), "{spectral}");
    assert!(spectral < whole(VisitStrategy::MonteCarlo, "mean") - 1.0, "{spectral}");
    let best = error(&outcome, VisitStrategy::OnlineError, "presence", 14..56);
    assert!(best < 3.3, "{best}");
}
