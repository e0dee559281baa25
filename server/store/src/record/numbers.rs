//! The ensemble of a state of continuous values or counts as a message, and back.
//!
//! Invariant: every number is read back bit by bit. The constructor of the ensemble checks lengths and numbers.

use tidemap_layout::ensemble as layout;
use tidemap_model::{LocalDay, NumberEnsembleParts};

use super::doubles;

pub(crate) fn encode(parts: &NumberEnsembleParts) -> layout::NumberEnsemble {
    let mut numbers = Vec::new();
    doubles::push(&mut numbers, &parts.numbers);
    let turns = |days: &Vec<LocalDay>| layout::Turns { days: days.iter().map(|day| day.0).collect() };
    layout::NumberEnsemble {
        last_day: parts.last_day.map(|day| day.0),
        numbers,
        seen: parts.seen.clone(),
        turns: parts.kept_days.iter().map(turns).collect(),
    }
}

pub(crate) fn decode(message: &layout::NumberEnsemble) -> NumberEnsembleParts {
    let mut numbers = Vec::new();
    doubles::take(&message.numbers, &mut numbers);
    let days = |turns: &layout::Turns| turns.days.iter().copied().map(LocalDay).collect();
    NumberEnsembleParts {
        last_day: message.last_day.map(LocalDay),
        numbers,
        seen: message.seen.clone(),
        kept_days: message.turns.iter().map(days).collect(),
    }
}
