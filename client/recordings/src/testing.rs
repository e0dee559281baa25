//! The helpers that the tests of the readers share.
//!
//! Invariant: the data that a reader hands out is kept as it came.

use crate::recording::{Ending, RecordedMessage, RecordingError, Sink, Stopped, Topic};

/// Keeps all that it is given.
#[derive(Default)]
pub(crate) struct KeptMessages {
    pub(crate) topics: Vec<Topic>,
    /// Index of the topic, time and bytes of each message.
    pub(crate) messages: Vec<(usize, i64, Vec<u8>)>,
    /// Topics of these names are not wanted.
    pub(crate) unwanted: Vec<&'static str>,
    /// Stops with this many messages.
    pub(crate) stop_at: Option<usize>,
    pub(crate) position: u64,
    /// The messages about parts that are too long.
    pub(crate) passed_over: Vec<String>,
}

impl Sink for KeptMessages {
    fn topic(&mut self, topic: &Topic) -> bool {
        self.topics.push(topic.clone());
        !self.unwanted.contains(&topic.name.as_str())
    }

    fn passed_over(&mut self, why: &RecordingError) {
        self.passed_over.push(why.to_string());
    }

    fn message(&mut self, message: RecordedMessage<'_>, position: u64) -> Result<(), Stopped> {
        assert!(message.topic < self.topics.len(), "a message of a topic that was not handed out");
        assert!(position >= self.position, "the position goes back");
        self.position = position;
        self.messages.push((message.topic, message.recorded_nanos, message.data.to_vec()));
        if self.stop_at.is_some_and(|count| self.messages.len() >= count) { Err(Stopped) } else { Ok(()) }
    }
}

/// Checks the properties of any cut: an ending that reports the cut, and a prefix of the messages.
pub(crate) fn check_cut(whole: &KeptMessages, cut: &KeptMessages, ending: &Result<Ending, RecordingError>) {
    assert!(matches!(ending, Ok(Ending::CutOff(_))), "{ending:?}");
    assert!(whole.messages.starts_with(&cut.messages), "{} messages are no prefix", cut.messages.len());
}
