//! Changes of what is known of the place, one at a time.
//!
//! Invariant: who asks for a change is answered when it is durable and the view shows it. At most one is on its way into
//! the log, so that the next is checked against what it leads to.

use std::collections::VecDeque;

use tidemap_map::event::Event;
use tokio::sync::oneshot;

use super::{
    super::protocol::{EditSite, EditSiteError},
    Flight, Writer,
};

/// Whom to tell what became of it.
pub(super) type Edited = oneshot::Sender<Result<(), EditSiteError>>;

/// Those who change the site.
#[derive(Debug, Default)]
pub(super) struct Edits {
    waiting: VecDeque<EditSite>,
    is_in_flight: bool,
    /// Their changes are durable, and not yet public.
    done: Vec<Edited>,
}

impl Edits {
    /// Whether a change is on its way into the log.
    pub(super) fn is_in_flight(&self) -> bool {
        self.is_in_flight
    }
}

impl Writer {
    pub(super) fn edit_site(&mut self, edit: EditSite) {
        self.edits.waiting.push_back(edit);
        self.go_on_editing();
    }

    /// Hands the next change to the log, unless one is on its way.
    pub(super) fn go_on_editing(&mut self) {
        while !self.edits.is_in_flight
            && let Some(EditSite { edit, reply }) = self.edits.waiting.pop_front()
        {
            if reply.is_closed() {
                continue;
            }
            let checked = if self.stopping.is_some() {
                Err(EditSiteError::Closing)
            } else if let Some(error) = &self.failing {
                Err(EditSiteError::Storage(error.clone()))
            } else {
                let checked = self.map.site().check(&edit, self.map.states());
                checked.and_then(|()| self.sessions.keep_names(&edit, &self.map)).map_err(EditSiteError::Invalid)
            };
            if let Err(error) = checked {
                // Who asked may have gone away.
                let _ = reply.send(Err(error));
                continue;
            }
            self.edits.is_in_flight = true;
            self.launch(Flight::EditSite { event: Event::EditSite(edit), reply });
        }
    }

    /// What was on its way is durable and applied, or has failed.
    pub(super) fn site_edited(&mut self, reply: Edited, result: Result<(), EditSiteError>) {
        self.edits.is_in_flight = false;
        self.sessions.renamed();
        match result {
            Ok(()) => self.edits.done.push(reply),
            // Who asked may have gone away.
            Err(error) => drop(reply.send(Err(error))),
        }
    }

    /// Answers those whose changes are public now.
    pub(super) fn tell_edited(&mut self) {
        for reply in self.edits.done.drain(..) {
            // Who asked may have gone away.
            let _ = reply.send(Ok(()));
        }
    }
}
