//! The changes of a map that are requested outside of streams: new states, and edits of the site.
//!
//! Invariant: the reply is sent after the change is durable and published.

use tidemap_map::{
    event::{Reporting, StateSensor, StateShape, StatedReporting},
    name::StateName,
    site::{InvalidEdit, SiteEdit},
};
use tidemap_proto::convert::vectors::DeclaredState;
use tidemap_store::AppendError;
use tokio::sync::oneshot;

use crate::role::NotWriter;

/// A state to add.
#[derive(Debug)]
pub struct AddState {
    /// The state to add.
    pub state: DeclaredState,
    /// The client that sends the request, by its name in the shares; empty if it has no share of its own.
    pub client: String,
    /// The reply, sent after the state is durable and published.
    pub reply: oneshot::Sender<Result<(), AddStateError>>,
}

/// The reason why a map has no room for another state, or for other tiles.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the variants and fields")]
pub enum NoRoom {
    #[error("the map has {max} states, as many as setting max_states_per_map allows")]
    States { max: usize },
    #[error(
        "{client} has added {max} states since the daemon opened the map, half of the free places, and the \
         rest is for other clients: raise setting max_states_per_map"
    )]
    StatesOfClient { client: String, max: usize },
    #[error("the map has {max} tiles, as many as setting max_tiles_per_map allows")]
    Tiles { max: usize },
    #[error(
        "{client} has added {max} tiles since the daemon opened the map, half of the free places, and the \
         rest is for other clients: raise setting max_tiles_per_map"
    )]
    TilesOfClient { client: String, max: usize },
    #[error(
        "the states of this map that report changes or events would mean more than {max} readings a day: report this \
         one with a longer step (--hold-step)"
    )]
    Readings { max: u64 },
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the variants and fields")]
pub enum AddStateError {
    #[error(
        "state {name:?} exists and is {found}, not {requested}: the kind of a state never changes",
        name = .name.as_str(), found = .found.with_article(), requested = .requested.with_article()
    )]
    OtherKind { name: StateName, found: StateShape, requested: StateShape },
    #[error(
        "state {name:?} exists with {has}, not {requested}: the sensor of a state never changes; add the state before \
         its first observation, or under another name",
        name = .name.as_str(), has = found.map_or("no stated sensor".to_owned(), |found| found.to_string())
    )]
    OtherSensor { name: StateName, found: Option<StateSensor>, requested: StateSensor },
    #[error(
        "state {name:?} exists and is reported by {found}, not by {requested}: how a state is reported never changes; \
         add the state before its first observation, or erase it first",
        name = .name.as_str()
    )]
    OtherReporting { name: StateName, found: Reporting, requested: StatedReporting },
    #[error(
        "state {name:?} exists with other labels: the labels of a state never change; add them under another name, or \
         erase the state first",
        name = .name.as_str()
    )]
    OtherLabels { name: StateName },
    #[error(transparent)]
    NoRoom(#[from] NoRoom),
    #[error(transparent)]
    NotWriter(#[from] NotWriter),
    #[error(transparent)]
    Storage(#[from] AppendError),
    #[error("the map is closing")]
    Closing,
}

/// Producers that give their places up.
#[derive(Debug)]
pub struct ForgetProducers {
    /// Name of the producer.
    pub producer: String,
    /// The label of the producers; `None`: all labels.
    pub label: Option<String>,
    /// The reply, sent after the change is durable: the number of keys that have given their places up.
    pub reply: oneshot::Sender<Result<u64, ForgetError>>,
}

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the variants and fields")]
pub enum ForgetError {
    #[error("the map has no producer {producer:?}{}: tidemap producer list shows those it has", match .label {
        Some(label) => format!(" with label {label:?}"),
        None => String::new(),
    })]
    Unknown { producer: String, label: Option<String> },
    #[error("producer {producer:?} sends to the map now, with label {label:?}: stop its stream first")]
    Streaming { producer: String, label: String },
    #[error(
        "{forgotten} producer keys of the map are forgotten, and at most {max} may be: raise setting max_producers_per_map"
    )]
    TooMany { forgotten: usize, max: usize },
    #[error(transparent)]
    NotWriter(#[from] NotWriter),
    #[error(transparent)]
    Storage(#[from] AppendError),
    #[error("the map is closing")]
    Closing,
}

/// An edit of the site.
#[derive(Debug)]
pub struct EditSite {
    /// The change.
    pub edit: SiteEdit,
    /// The reply, sent after the edit is durable and published.
    pub reply: oneshot::Sender<Result<(), EditSiteError>>,
}

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the variants and fields")]
pub enum EditSiteError {
    #[error(transparent)]
    Invalid(#[from] InvalidEdit),
    #[error(transparent)]
    NotWriter(#[from] NotWriter),
    #[error(transparent)]
    Storage(#[from] AppendError),
    #[error("the map is closing")]
    Closing,
}
