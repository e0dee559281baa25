//! The kinds of the states of a file, to find invalid values before the daemon refuses them.
//!
//! Invariant: a row is reported as invalid only if every daemon would refuse it. Files of probabilities and of
//! positions cause no requests.

use std::collections::HashMap;

use tidemap_client::{
    Client,
    maps::{StateKind, StateShape},
};
use tonic::Code;

use tidemap_formats::observation_file::ObservationRow;

/// Maximum number of states whose kind is requested: an invalid file must not cause a request per row.
const ASKED_MAX: usize = 10_000;

/// The known kinds of the states of a map.
pub(crate) struct Kinds {
    client: Client,
    map: String,
    /// The kind that the user gave for all states of the file.
    given: Option<StateShape>,
    /// None if the daemon could not report it: an angle or a vector, of which it describes the axes alone.
    known: HashMap<String, Option<StateShape>>,
}

impl Kinds {
    pub(crate) fn new(client: Client, map: String, given: Option<StateShape>) -> Self {
        Self { client, map, given, known: HashMap::new() }
    }

    /// Why a row is invalid, if it is.
    pub(crate) async fn wrong(&mut self, row: &ObservationRow) -> Option<String> {
        if !row.is_read || row.position.is_some() || row.label.is_some() {
            return row.wrong.clone();
        }
        let kind = match self.given {
            Some(kind) => kind,
            None if row.wrong.is_none() => return None,
            None => self.kind(&row.state).await?,
        };
        match kind {
            _ if kind.allows(row.value) => None,
            // The row states that no value is known.
            _ if row.value.is_nan() && row.wrong.is_none() => None,
            // The reader's message quotes the file.
            StateShape::Scalar(StateKind::Probability) => row.wrong.clone(),
            _ => Some(format!("value {} is not {}", row.value, kind.expected())),
        }
    }

    /// The kind of a state; `None` if it is unknown.
    async fn kind(&mut self, state: &str) -> Option<StateShape> {
        if let Some(&kind) = self.known.get(state) {
            return kind;
        }
        if self.known.len() >= ASKED_MAX {
            return None;
        }
        let kind = match self.client.describe_model(&self.map, state).await {
            Ok(model) => Some(model.kind.into()),
            // A new state.
            Err(error) if error.code() == Some(Code::NotFound) => Some(StateShape::default()),
            // The failure is cached, too: otherwise each row would send a request again.
            Err(_) => None,
        };
        self.known.insert(state.to_owned(), kind);
        kind
    }
}
