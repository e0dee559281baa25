//! Sends a group to the engine until its outcome is known.
//!
//! Invariant: a group counts as sent only if the stream has it at the expected place. An unknown outcome is found out,
//! never assumed.

use std::time::Duration;

use bytes::Bytes;
use tokio::time::sleep;

use super::driver::Driver;
use crate::engine::{AppendIfError, Engine, EngineError};

/// Pause before a message is sent again.
const PAUSE: Duration = Duration::from_millis(50);

/// The outcome of sending a group.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Sent {
    /// The stream has the group.
    Done,
    /// The stream does not have the group, because somebody else has appended.
    Deposed,
    /// The stream does not have the group. It has also lost messages before the group.
    Forgotten,
    /// The stream does not have the group, because it is full.
    Full(String),
    /// The daemon stops; whether the stream has the group is not known.
    Stopped,
}

/// The content of the stream where a message was expected.
enum InStream {
    Mine,
    Nothing,
    Other,
    Shorter,
}

impl<E: Engine> Driver<E> {
    /// Sends the messages of a group behind the last one that is known.
    pub(super) async fn send(&mut self, messages: &[Bytes]) -> Sent {
        for message in messages {
            match self.send_message(message).await {
                Sent::Done => {}
                other => return other,
            }
        }
        Sent::Done
    }

    async fn send_message(&mut self, message: &Bytes) -> Sent {
        let expected = self.last_sequence;
        loop {
            let sent =
                self.engine.append_if(&self.settings.stream, expected, message.clone(), self.settings.patience).await;
            match sent {
                Ok(sequence) if sequence == expected + 1 => {
                    self.last_sequence = sequence;
                    self.trouble(None);
                    return Sent::Done;
                }
                // The engine has ignored the condition. The message counts as not sent, whatever follows it.
                Ok(_) => return Sent::Forgotten,
                Err(AppendIfError::NotExpected) => match self.find_sent(message, expected).await {
                    Ok(InStream::Mine) => {
                        self.last_sequence = expected + 1;
                        self.trouble(None);
                        return Sent::Done;
                    }
                    Ok(InStream::Other) => return Sent::Deposed,
                    Ok(InStream::Shorter) => return Sent::Forgotten,
                    Ok(InStream::Nothing) => {}
                    Err(error) => self.trouble(Some(error.to_string())),
                },
                Err(AppendIfError::Engine(EngineError::Full(reason))) => {
                    self.trouble(Some(format!("the stream of the map is full: {reason}")));
                    return Sent::Full(reason);
                }
                // The message can be sent again with the same condition: this can succeed only once.
                Err(AppendIfError::Engine(error)) => {
                    self.trouble(Some(error.to_string()));
                    if matches!(self.engine.ends(&self.settings.stream).await, Err(EngineError::Missing(_))) {
                        return Sent::Forgotten;
                    }
                }
            }
            if self.is_stopping() {
                return Sent::Stopped;
            }
            sleep(PAUSE).await;
        }
    }

    /// The content of the stream behind the message `expected`.
    async fn find_sent(&self, message: &Bytes, expected: u64) -> Result<InStream, EngineError> {
        let stream = &self.settings.stream;
        let last = self.engine.ends(stream).await?.last;
        if last < expected {
            return Ok(InStream::Shorter);
        }
        if last == expected {
            return Ok(InStream::Nothing);
        }
        match self.engine.read(stream, expected + 1).await? {
            Some(found) if found.content == *message => Ok(InStream::Mine),
            Some(_) => Ok(InStream::Other),
            // The message was purged, or was forgotten meanwhile.
            None => Ok(InStream::Nothing),
        }
    }
}
