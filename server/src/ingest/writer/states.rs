//! States that are added before anything is observed of them.
//!
//! Invariant: who adds a state is answered when it is durable and the view shows it, also where somebody else has added it.

use tidemap_map::event::Event;
use tokio::sync::oneshot;

use super::{
    super::protocol::{AddState, AddStateError},
    Flight, Writer,
};

/// Whom to tell what became of it.
pub(super) type Added = oneshot::Sender<Result<(), AddStateError>>;

/// Those who add states.
#[derive(Debug, Default)]
pub(super) struct Adds {
    /// Their states are on their way into the log for somebody else.
    waiting: Vec<AddState>,
    /// Their states are durable, and not yet public.
    added: Vec<Added>,
}

impl Writer {
    pub(super) fn add_state(&mut self, add: AddState) {
        if add.reply.is_closed() {
            return;
        }
        let event = if self.stopping.is_some() {
            Err(AddStateError::Closing)
        } else if let Some(error) = &self.failing {
            Err(AddStateError::Storage(error.clone()))
        } else {
            self.sessions.add_state(&add.name, add.shape, &self.map)
        };
        match event {
            Ok(Some(new)) => {
                self.launch(Flight::AddState { event: Event::AddState(new), reply: add.reply });
            }
            Ok(None) if self.map.shape(add.name.as_str()).is_some() => self.adds.added.push(add.reply),
            // On its way into the log, which may fail.
            Ok(None) => self.adds.waiting.push(add),
            // Who asked may have gone away.
            Err(error) => drop(add.reply.send(Err(error))),
        }
    }

    pub(super) fn state_added(&mut self, event: &Event, reply: Added) {
        if let Event::AddState(new) = event {
            self.sessions.state_added(new);
        }
        self.adds.added.push(reply);
    }

    /// Looks again at states that were on their way for somebody else.
    pub(super) fn go_on_adding(&mut self) {
        for add in std::mem::take(&mut self.adds.waiting) {
            self.add_state(add);
        }
    }

    /// Answers those whose states are public now.
    pub(super) fn tell_added(&mut self) {
        for reply in self.adds.added.drain(..) {
            // Who asked may have gone away.
            let _ = reply.send(Ok(()));
        }
    }
}
