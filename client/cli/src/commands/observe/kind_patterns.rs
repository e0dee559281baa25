//! The kinds of a file's states by patterns of their names: `--kinds 'temperature.*=continuous,visits-?=count'`.
//!
//! Invariant: the first pattern that fits a name decides. A state that exists with another kind ends the command before
//! anything is sent or withdrawn; a state that no pattern fits is left to its usual kind.

use std::{
    collections::{BTreeSet, HashMap},
    fmt,
    path::Path,
    str::FromStr,
};

use tidemap_client::maps::{StateName, StateShape, StatedReporting};
use tidemap_formats::observation_file::{ObservationColumns, RowItem, RowRules};

use super::{
    super::{
        Session,
        predict::names::{self, matches},
        shell_word::quoted,
        state::KindArg,
        usage,
    },
    feed,
    next_steps::NextSteps,
};
use crate::progress::status_line;

/// Maximum number of states whose kinds are set by patterns.
const STATES_MAX: usize = 10_000;

/// A categorical state with any number of labels.
const LABELLED: StateShape = StateShape::Categorical(0);

/// Patterns of names with the kinds of the states that fit.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct KindPatterns(Vec<(String, StateShape)>);

impl FromStr for KindPatterns {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let pair = |part: &str| {
            let right = || format!("{part:?} is not PATTERN=KIND, as in 'temperature.*=continuous'");
            let (pattern, kind) = part.rsplit_once('=').ok_or_else(right)?;
            if pattern.is_empty() {
                return Err(right());
            }
            let kind: KindArg = kind.trim().parse().map_err(|error| format!("{part:?}: {error}"))?;
            let shape = match kind {
                KindArg::Single(shape) => shape,
                KindArg::Categorical => LABELLED,
                KindArg::Vector => return Err(format!("{part:?}: vectors need a file of positions of their own")),
            };
            Ok((pattern.to_owned(), shape))
        };
        text.split(',').map(pair).collect::<Result<_, _>>().map(Self)
    }
}

impl fmt::Display for KindPatterns {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        let pairs: Vec<String> = self.0.iter().map(|(pattern, shape)| format!("{pattern}={}", shape.name())).collect();
        to.write_str(&pairs.join(","))
    }
}

/// The states of a file that patterns fit, with their kinds, in the order of their names.
#[derive(Debug)]
pub(super) struct KindPlan(Vec<(String, StateShape)>);

impl KindPatterns {
    /// The patterns, each with whether the values of its states are labels.
    pub(super) fn labelled(&self) -> Vec<(Vec<char>, bool)> {
        self.0.iter().map(|(pattern, shape)| (pattern.chars().collect(), *shape == LABELLED)).collect()
    }

    fn position(&self, name: &str) -> Option<usize> {
        let name: Vec<char> = name.chars().collect();
        self.0.iter().position(|(pattern, _)| matches(&pattern.chars().collect::<Vec<_>>(), &name))
    }

    /// Plans the kinds of the states of a file. A pattern that no state fits is reported.
    ///
    /// # Errors
    /// A state exists with another kind, or its kind does not fit its reporting; the file cannot be read twice.
    pub(super) async fn plan(
        &self,
        session: &Session,
        (map, file): (&str, &Path),
        rules: &RowRules,
        stated: Option<StatedReporting>,
        steps: &NextSteps<'_>,
    ) -> anyhow::Result<KindPlan> {
        if !file.is_file() {
            return Err(usage(
                "--kinds reads the file twice, so it needs a file: add the states with state add --kind",
            ));
        }
        if let Some(stated) = stated
            && let Some((pattern, shape)) = self.0.iter().find(|(_, shape)| !shape.may_report(stated.for_new()))
        {
            let (kind, option) = (shape.name(), stated.kind().name());
            return Err(usage(format!("--kinds '{pattern}={kind}' does not go with --{option}")));
        }
        let mut fitting = vec![0_usize; self.0.len()];
        let mut kinds = Vec::new();
        for name in states_of(file, rules)? {
            let Some(at) = self.position(&name) else { continue };
            fitting[at] += 1;
            kinds.push((name, self.0[at].1));
        }
        for ((pattern, _), _) in self.0.iter().zip(&fitting).filter(|(_, count)| **count == 0) {
            status_line(&format!("--kinds: no state of {} fits '{pattern}'", feed::display_name(file)));
        }
        let plan = KindPlan(kinds);
        if let Some((name, shape, found)) = plan.other(&known_shapes(session, map).await?) {
            anyhow::bail!(
                "state {name:?} exists and is of kind {}, not {}. Nothing was sent. A kind never changes: leave the state \
                 out of --kinds, or {}",
                found.name(),
                shape.name(),
                steps.erase_first(name)
            );
        }
        Ok(plan)
    }
}

impl KindPlan {
    /// Adds the states that do not exist yet.
    pub(super) async fn add(
        &self,
        session: &Session,
        map: &str,
        stated: Option<StatedReporting>,
    ) -> anyhow::Result<()> {
        let known = known_shapes(session, map).await?;
        for (name, shape) in self.0.iter().filter(|(name, _)| !known.contains_key(name)) {
            if *shape == LABELLED {
                anyhow::bail!(
                    "state {name:?} does not exist. Nothing was sent. Add it with all its labels first: tidemap state add \
                     {map} {} --kind categorical --labels …",
                    quoted(name)
                );
            }
            session.client.add_state(map, name, *shape, None, stated).await?;
        }
        Ok(())
    }

    /// A state that exists with another kind: its name, the kind that it should have and the kind that it has.
    fn other(&self, known: &HashMap<String, StateShape>) -> Option<(&str, StateShape, StateShape)> {
        self.0.iter().find_map(|(name, shape)| {
            let is_same = |found: &StateShape| found == shape || (*shape == LABELLED && found.name() == shape.name());
            let found = known.get(name).filter(|found| !is_same(found))?;
            Some((name.as_str(), *shape, *found))
        })
    }
}

/// The states of a map with their kinds.
async fn known_shapes(session: &Session, map: &str) -> anyhow::Result<HashMap<String, StateShape>> {
    Ok(names::states(session, map).await?.into_iter().map(|state| (state.name, state.shape)).collect())
}

/// The names of the states of a file.
fn states_of(file: &Path, rules: &RowRules) -> anyhow::Result<BTreeSet<String>> {
    let (mut rows, _) = feed::reader::<ObservationColumns>(file, rules)?;
    let mut states = BTreeSet::new();
    // A fault of a row or a name is reported when the row is sent: such rows make no state.
    while let Some(item) = rows.next_item()? {
        let RowItem::Row(row) = item else { continue };
        if row.is_read && !states.contains(&row.state) && StateName::observed(&row.state).is_ok() {
            states.insert(row.state);
        }
        if states.len() > STATES_MAX {
            return Err(usage(format!("--kinds: the file has more than {STATES_MAX} states: give them one --kind")));
        }
    }
    Ok(states)
}

#[cfg(test)]
mod tests {
    use tidemap_client::maps::StateKind;

    use super::*;

    #[test]
    fn the_first_pattern_that_fits_decides() -> Result<(), String> {
        let kinds: KindPatterns = "temperature.*=continuous,visits-?=count,*=probability,a=b=angle".parse()?;
        let shape = |name: &str| kinds.position(name).map(|at| kinds.0[at].1);
        assert_eq!(shape("temperature.hall"), Some(StateKind::Continuous.into()));
        assert_eq!(shape("visits-1"), Some(StateKind::Count.into()));
        assert_eq!(shape("visits-12"), Some(StateKind::Probability.into()));
        assert_eq!(kinds.to_string().parse(), Ok(kinds.clone()), "{kinds}");
        assert_eq!(kinds.0[3], ("a=b".to_owned(), StateShape::Angle), "a name may have the sign");
        let labels: KindPatterns = "activity=categorical".parse()?;
        assert_eq!(
            (labels.labelled(), labels.to_string()),
            (vec![("activity".chars().collect(), true)], "activity=categorical".to_owned())
        );
        let only: KindPatterns = "temp*=continuous".parse()?;
        assert_eq!(only.position("door"), None);
        for (wrong, words) in
            [("", "PATTERN=KIND"), ("=count", "PATTERN=KIND"), ("a=warm", "is not a kind"), ("a=vector", "positions")]
        {
            let error = wrong.parse::<KindPatterns>().expect_err(wrong);
            assert!(error.contains(words), "{wrong}: {error}");
        }
        Ok(())
    }
}
