//! The ensemble of a state of continuous values or counts as a message, and back.
//!
//! Invariant: every number is read back bit by bit. The constructor of the ensemble checks lengths and numbers.

use tidemap_migrations::v1::ensemble as v1;
use tidemap_model::{LocalDay, NumberEnsembleParts};

use super::doubles;

pub(crate) fn encode(parts: &NumberEnsembleParts) -> v1::NumberEnsemble {
    let mut numbers = Vec::new();
    doubles::push(&mut numbers, &parts.numbers);
    let turns = |days: &Vec<LocalDay>| v1::Turns { days: days.iter().map(|day| day.0).collect() };
    v1::NumberEnsemble {
        last_day: parts.last_day.map(|day| day.0),
        numbers,
        seen: parts.seen.clone(),
        turns: parts.kept_days.iter().map(turns).collect(),
    }
}

pub(crate) fn decode(message: &v1::NumberEnsemble) -> NumberEnsembleParts {
    let mut numbers = Vec::new();
    doubles::take(&message.numbers, &mut numbers);
    let days = |turns: &v1::Turns| turns.days.iter().copied().map(LocalDay).collect();
    NumberEnsembleParts {
        last_day: message.last_day.map(LocalDay),
        numbers,
        seen: message.seen.clone(),
        kept_days: message.turns.iter().map(days).collect(),
    }
}
