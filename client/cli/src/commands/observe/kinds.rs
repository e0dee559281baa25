//! What the values of a file's states may be.
//!
//! Invariant: a row is called wrong only where no daemon would accept it; where that is not known, the daemon is left to
//! say. Files of probabilities and of positions ask for nothing.

use std::collections::HashMap;

use tidemap_client::{Client, maps::StateKind};
use tonic::Code;

use tidemap_formats::observation_file::ObservationRow;

/// States that are asked for, at most: a file of garbage must not become as many requests.
const ASKED_MAX: usize = 10_000;

/// What is known of the states of a map.
pub(crate) struct Kinds {
    client: Client,
    map: String,
    /// What was said of all states of the file.
    said: Option<StateKind>,
    known: HashMap<String, StateKind>,
}

impl Kinds {
    /// Nothing known yet.
    pub(crate) fn new(client: Client, map: String, said: Option<StateKind>) -> Self {
        Self { client, map, said, known: HashMap::new() }
    }

    /// What is wrong with a row, if anything is.
    pub(crate) async fn wrong(&mut self, row: &ObservationRow) -> Option<String> {
        if !row.is_read || row.position.is_some() {
            return row.wrong.clone();
        }
        let kind = match self.said {
            Some(kind) => kind,
            None if row.wrong.is_none() => return None,
            None => self.kind(&row.state).await?,
        };
        match kind.invalid_reason(row.value) {
            // In the words of the file.
            Some(_) if kind == StateKind::Probability => row.wrong.clone(),
            invalid_reason => invalid_reason.map(|expected| format!("value {} is not {expected}", row.value)),
        }
    }

    /// The kind of a state; `None` where it cannot be had.
    async fn kind(&mut self, state: &str) -> Option<StateKind> {
        if let Some(&kind) = self.known.get(state) {
            return Some(kind);
        }
        if self.known.len() >= ASKED_MAX {
            return None;
        }
        let kind = match self.client.describe_model(&self.map, state).await {
            Ok(model) => model.kind,
            // It would be new.
            Err(error) if error.code() == Some(Code::NotFound) => StateKind::default(),
            Err(_) => return None,
        };
        self.known.insert(state.to_owned(), kind);
        Some(kind)
    }
}
