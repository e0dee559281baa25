//! The additions and edits of clients: states before their first observation, and the site.
//!
//! Invariant: a client gets its reply when its change is durable and the view shows it, also where another client has
//! added the state. At most one edit of the site is in flight, so that the next is checked against its result.

use std::collections::VecDeque;

use tidemap_map::event::Event;
use tokio::sync::oneshot;

use super::{
    Writer,
    appends::{InFlight, Reply},
};
use crate::protocol::{AddState, AddStateError, EditSite, EditSiteError, ForgetError, ForgetProducers};

#[cfg(test)]
mod tests;

/// Requests without a reply yet.
#[derive(Debug, Default)]
pub(super) struct Edits {
    /// Additions of states that are in flight for another client.
    waiting_states: Vec<AddState>,
    /// Replies for states that are durable and not public yet.
    added: Vec<Reply<AddStateError>>,
    waiting_edits: VecDeque<EditSite>,
    is_in_flight: bool,
    /// Replies for edits that are durable and not public yet.
    edited: Vec<Reply<EditSiteError>>,
    /// Replies for producers whose places are durably free, and not public yet, each with the number of places.
    forgotten: Vec<(u64, oneshot::Sender<Result<u64, ForgetError>>)>,
}

impl Edits {
    /// Whether an edit of the site is in flight.
    pub(super) fn is_in_flight(&self) -> bool {
        self.is_in_flight
    }

    /// The next edit of the site whose client still waits, unless one is in flight.
    fn next(&mut self) -> Option<EditSite> {
        if self.is_in_flight {
            return None;
        }
        while let Some(edit) = self.waiting_edits.pop_front() {
            if !edit.reply.is_closed() {
                return Some(edit);
            }
        }
        None
    }

    /// Sends the replies to the clients whose changes are public now.
    pub(super) fn published(&mut self) {
        // A client may have gone away.
        for reply in self.added.drain(..) {
            let _ = reply.send(Ok(()));
        }
        for reply in self.edited.drain(..) {
            let _ = reply.send(Ok(()));
        }
        for (count, reply) in self.forgotten.drain(..) {
            let _ = reply.send(Ok(count));
        }
    }
}

impl Writer {
    pub(super) fn add_state(&mut self, add: AddState) {
        if add.reply.is_closed() {
            return;
        }
        let event = if self.stopping.is_some() {
            Err(AddStateError::Closing)
        } else if let Some(refused) = self.not_writer() {
            Err(refused.into())
        } else if let Some(error) = self.appends.failure() {
            Err(AddStateError::Storage(error.clone()))
        } else {
            self.sessions.add_state(&add.state, &add.client, &self.map)
        };
        match event {
            Ok(Some(new)) => {
                self.append(InFlight::AddState { event: Event::AddState(new), client: add.client, reply: add.reply });
            }
            Ok(None) if self.map.shape(add.state.name.as_str()).is_some() => self.edits.added.push(add.reply),
            // The state is in flight for another client, and that append may fail.
            Ok(None) => self.edits.waiting_states.push(add),
            // The client may have gone away.
            Err(error) => drop(add.reply.send(Err(error))),
        }
    }

    /// A state is durable and applied.
    pub(super) fn state_added(&mut self, event: &Event, client: &str, reply: Reply<AddStateError>) {
        if let Event::AddState(new) = event {
            self.sessions.state_added(new, client);
        }
        self.edits.added.push(reply);
    }

    /// Checks again the states that were in flight for another client.
    pub(super) fn continue_adding(&mut self) {
        for add in std::mem::take(&mut self.edits.waiting_states) {
            self.add_state(add);
        }
    }

    /// Hands to the log the event that producers give their places up.
    pub(super) fn forget_producers(&mut self, forget: ForgetProducers) {
        let found = if self.stopping.is_some() {
            Err(ForgetError::Closing)
        } else if let Some(refused) = self.not_writer() {
            Err(refused.into())
        } else if let Some(error) = self.appends.failure() {
            Err(ForgetError::Storage(error.clone()))
        } else {
            self.sessions.forgettable(&forget, &self.map)
        };
        match found {
            Ok(producers) => {
                let (count, event) = (producers.len() as u64, Event::ForgetProducers(producers));
                self.append(InFlight::ForgetProducers { event, count, reply: forget.reply });
            }
            // The client may have gone away.
            Err(error) => drop(forget.reply.send(Err(error))),
        }
    }

    /// Producers have durably given their places up.
    pub(super) fn producers_forgotten(&mut self, count: u64, reply: oneshot::Sender<Result<u64, ForgetError>>) {
        self.edits.forgotten.push((count, reply));
    }

    pub(super) fn edit_site(&mut self, edit: EditSite) {
        self.edits.waiting_edits.push_back(edit);
        self.continue_editing();
    }

    /// Hands the next edit of the site to the log, unless one is in flight.
    pub(super) fn continue_editing(&mut self) {
        while let Some(EditSite { edit, reply }) = self.edits.next() {
            let checked = if self.stopping.is_some() {
                Err(EditSiteError::Closing)
            } else if let Some(refused) = self.not_writer() {
                Err(refused.into())
            } else if let Some(error) = self.appends.failure() {
                Err(EditSiteError::Storage(error.clone()))
            } else {
                let checked = self.map.site().check(&edit, self.map.states());
                checked.and_then(|()| self.sessions.keep_names(&edit, &self.map)).map_err(EditSiteError::Invalid)
            };
            if let Err(error) = checked {
                // The client may have gone away.
                let _ = reply.send(Err(error));
                continue;
            }
            self.edits.is_in_flight = true;
            self.append(InFlight::EditSite { event: Event::EditSite(edit), reply });
        }
    }

    /// The edit in flight is durable and applied, or has failed.
    pub(super) fn site_edited(&mut self, reply: Reply<EditSiteError>, result: Result<(), EditSiteError>) {
        self.edits.is_in_flight = false;
        self.sessions.renamed();
        match result {
            Ok(()) => self.edits.edited.push(reply),
            // The client may have gone away.
            Err(error) => drop(reply.send(Err(error))),
        }
    }
}
