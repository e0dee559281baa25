//! An office explored: what is said of it, and that time is worth knowing.
#![allow(clippy::unwrap_used)]

use std::path::{Path, PathBuf};

use super::*;
use crate::experiment::explore::{Wanted, protocol::parse};

const PROTOCOL: &str = "name: office
office:
  days: 4
  tours: 16
  goals: 4
  rooms: 2
  slot: 30m
seeds: 1
out: results
";

fn protocol() -> Protocol {
    match parse(PROTOCOL, "stem", Path::new("lab")) {
        Ok(Wanted::Office(protocol)) => protocol,
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_protocol_is_read_and_has_the_defaults_of_the_paper() {
    let read = protocol();
    assert_eq!((read.days, read.tours, read.goals, read.rooms, read.seeds), (4, 16, 4, 2, 1));
    assert_eq!((read.slots(), read.out, read.explorers.len()), (48, PathBuf::from("lab/results"), 3));
    let Ok(Wanted::Office(least)) = parse("office: {}\nout: o\n", "stem", Path::new("")) else { panic!() };
    assert_eq!((least.name.as_str(), least.days, least.tours, least.goals, least.rooms), ("stem", 5, 24, 6, 4));
    assert_eq!((least.slots(), least.seeds), (96, 5));
}

#[test]
fn what_a_protocol_says_wrongly_is_named() {
    for (from, to, message) in [
        ("days: 4", "days: 0", "line 3: days is \"0\": it has to be a whole number from 1 to 60"),
        ("tours: 16", "tours: 49", "line 4: tours is \"49\": it has to be a whole number from 1 to 48"),
        ("goals: 4", "goals: 16", "line 5: goals is \"16\": it has to be a whole number from 1 to 15"),
        ("rooms: 2", "rooms: 1", "line 6: rooms is \"1\": it has to be a whole number from 2 to 20"),
        ("slot: 30m", "slot: 7m", "line 7: slot is \"7m\": it has to be at least 5m"),
        ("seeds: 1", "models: [mean]", "line 8: models is \"mean\": it has to be left out beside an office"),
        ("seeds: 1", "world: w", "line 8: world is \"w\": it has to be left out"),
        ("out: results\n", "", "key out is missing"),
        ("rooms: 2", "room: 2", "line 6"),
    ] {
        assert!(PROTOCOL.contains(from), "{from}");
        let refused = parse(&PROTOCOL.replace(from, to), "stem", Path::new("")).expect_err(to).to_string();
        assert!(refused.starts_with(message) || refused.contains("unknown field"), "{refused}");
    }
}

/// The statement of RA-L 2016, figure 6: the first day the spatio-temporal model knows less, from the third on more.
#[test]
fn from_the_third_day_on_the_spatio_temporal_model_errs_less() {
    let protocol = Protocol { explorers: vec![Kind::Spatial, Kind::Temporal], ..protocol() };
    let outcome = run(&protocol, &|_, _| ()).unwrap();
    let days = outcome.days(&protocol);
    for day in &days {
        println!("{day:?}");
    }
    let of = |day: usize, kind: Kind| days.iter().find(|found| (found.day, found.kind) == (day, kind)).unwrap();
    for day in &days {
        assert!((day.tours - 16.0).abs() < 1e-12, "{day:?}");
    }
    let (spatial, temporal) = (of(1, Kind::Spatial), of(1, Kind::Temporal));
    assert_eq!((spatial.changes, spatial.discovered), (temporal.changes, temporal.discovered), "the same first day");
    assert_eq!(temporal.worse, 1, "{temporal:?}");
    for day in 3..=4 {
        assert_eq!(of(day, Kind::Temporal).better, 1, "{:?}", of(day, Kind::Temporal));
    }
    let folder = tempfile::tempdir().unwrap();
    write(&protocol, &outcome, folder.path()).unwrap();
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    assert_eq!((read("results.csv").lines().count(), read("slots.csv").lines().count()), (1 + 4 * 2, 1 + 2 * 4 * 48));
    let picture = read("exploration.svg");
    assert!(picture.contains("spatio-temporal") && !picture.contains("NaN"), "{picture}");
}

#[test]
fn the_same_seed_gives_the_same_figures() {
    let protocol = Protocol { days: 2, tours: 3, goals: 2, ..protocol() };
    let (one, other) = (run(&protocol, &|_, _| ()).unwrap(), run(&protocol, &|_, _| ()).unwrap());
    assert_eq!(one.runs, other.runs);
    let longer = run(&Protocol { days: 3, ..protocol }, &|_, _| ()).unwrap();
    let (short, long) = (&one.runs[0], &longer.runs[0]);
    assert!(short.iter().zip(long).all(|(short, long)| short.errors[..] == long.errors[..96]));
}
