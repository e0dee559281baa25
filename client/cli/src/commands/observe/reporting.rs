//! Compares the stated reporting of a file's states with the reporting in the map.
//!
//! Invariant: where they differ, nothing has been sent or withdrawn.

use std::{collections::HashSet, path::Path};

use tidemap_client::maps::StatedReporting;
use tidemap_formats::observation_file::{ObservationColumns, RowItem, RowRules};

use super::{
    super::{Session, predict::names},
    feed,
    next_steps::NextSteps,
};

/// Maximum number of states that are compared.
const STATES_MAX: usize = 10_000;

/// Refuses a file with states that exist with another reporting: its rows would be refused one by one, or change
/// nothing if they were sent before. A pipe can be read only once, and is not checked.
///
/// # Errors
/// A state is reported otherwise; the file or the states cannot be read.
pub(super) async fn check(
    session: &Session,
    (map, file): (&str, &Path),
    rules: &RowRules,
    stated: StatedReporting,
    steps: &NextSteps<'_>,
) -> anyhow::Result<()> {
    if !file.is_file() {
        return Ok(());
    }
    let others: Vec<(String, StatedReporting)> = names::states(session, map)
        .await?
        .into_iter()
        .filter(|state| !stated.fits(state.reporting.for_new()))
        .map(|state| (state.name, state.reporting))
        .collect();
    if others.is_empty() {
        return Ok(());
    }
    let mut named: HashSet<String> = HashSet::new();
    let (mut rows, _) = feed::reader::<ObservationColumns>(file, rules)?;
    // A fault of a row is reported when the row is sent.
    while let Ok(Some(item)) = rows.next_item() {
        if let RowItem::Row(row) = item
            && !named.contains(&row.state)
        {
            named.insert(row.state);
        }
        if named.len() > STATES_MAX {
            break;
        }
    }
    let mut wrong = others.iter().filter(|(name, _)| named.contains(name));
    let Some((name, found)) = wrong.next() else { return Ok(()) };
    let more = match wrong.count() {
        0 => String::new(),
        count => format!(", and {count} more states are reported otherwise"),
    };
    anyhow::bail!(
        "state {name:?} exists and is reported by {found}, not by {stated}{more}. Nothing was sent. How a state is \
         reported never changes: {}",
        steps.erase_first(name)
    )
}
