//! The names of models, as the command line writes them: `histogram:week:168`, `pergam:3:7d`.
//!
//! Invariant: a name contains the kind and all its parameters. `selector/name.rs` reads it back.

use std::fmt;

use super::ModelKind;
use crate::{models::HistogramCycle, time::format_duration};

impl fmt::Display for ModelKind {
    /// Writes the name as on the command line, with the parameters; a cycle or period that is the default is left out.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())?;
        if let Some(cycle) = self.cycle().filter(|&cycle| cycle != HistogramCycle::Day) {
            write!(f, ":{}", cycle.name())?;
        }
        if let Some(count) = self.count() {
            write!(f, ":{count}")?;
        }
        match self.period_nanos() {
            Some(nanos) if nanos != Self::PERIOD_NANOS => write!(f, ":{}", format_duration(nanos)),
            _ => Ok(()),
        }
    }
}

impl ModelKind {
    /// The forms that names may have, for help texts: `auto, mean, …, histogram[:BINS], …`.
    pub fn forms() -> String {
        let forms = Self::ALL.into_iter().flat_map(|kind| {
            let count = kind.count_limit().map(|limit| {
                let period = if kind.period_nanos().is_some() { "[:PERIOD]" } else { "" };
                format!("[:{}{period}]", limit.noun.to_uppercase())
            });
            let count = count.unwrap_or_default();
            let cycles = kind.cycle().map_or(&[][..], |_| &HistogramCycle::ALL[1..]);
            let cycles = cycles.iter().map(|cycle| format!("{}:{}{count}", kind.name(), cycle.name()));
            std::iter::once(format!("{}{count}", kind.name())).chain(cycles).collect::<Vec<_>>()
        });
        forms.collect::<Vec<_>>().join(", ")
    }
}

/// Names in a sentence, such as `auto, mean or poisson`.
pub(crate) fn listed(names: impl IntoIterator<Item = &'static str>, last: &str) -> String {
    let mut names: Vec<&str> = names.into_iter().collect();
    match names.pop() {
        Some(end) if !names.is_empty() => format!("{} {last} {end}", names.join(", ")),
        end => end.unwrap_or_default().to_owned(),
    }
}
