//! The parts of a recording: topics, and messages with the times at which they were recorded.
//!
//! Invariant: a reader hands out messages one by one, in the order of the file. It holds at most one block of the file
//! and one message in memory, each within the limits of this file, whatever a length in the file states.

use std::{io, sync::Arc};

/// Maximum number of bytes of a message.
pub const MESSAGE_BYTES_MAX: usize = 32 << 20;
/// Maximum number of bytes of a block of messages, such as a chunk of MCAP, as it is stored.
pub const BLOCK_BYTES_MAX: usize = 32 << 20;
/// Maximum number of bytes of a block once it is decompressed.
pub const UNPACKED_BYTES_MAX: usize = 64 << 20;
/// Maximum number of topics of a recording, or of its connections if one topic has several.
pub const TOPICS_MAX: usize = 10_000;
/// Maximum number of bytes of all definitions of a recording's messages.
pub const DEFINITION_BYTES_MAX: usize = 4 << 20;

/// The layout of the bytes of a topic's messages.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Encoding {
    /// The layout of ROS 1.
    Ros1,
    /// CDR, as ROS 2 lays them out.
    Cdr,
    /// JSON, with its schema in the language of JSON Schema.
    Json(Arc<str>),
    /// Protobuf, with its schema: a set of file descriptors.
    Protobuf(Arc<[u8]>),
    /// Another layout, by the name that the recording gives it. Its messages are counted, not read.
    Other(String),
    /// A layout that the recording does not describe; the text states why. Its messages are counted, not read.
    Unreadable(String),
}

/// A topic of a recording, or one of its connections if a recording lists several publishers apart.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Topic {
    /// Name of the topic, such as `/scan`.
    pub name: String,
    /// Type of its messages without the folder of ROS 2, such as `sensor_msgs/LaserScan`.
    pub type_name: String,
    /// The layout of the bytes of its messages.
    pub encoding: Encoding,
    /// Definition of its messages in the language of `.msg` files, with the definitions of the types inside behind
    /// lines of `=`; empty if the recording has none.
    pub definition: String,
    /// Whether the topic is latched, or transient local: its last message holds for late subscribers.
    pub is_latched: bool,
}

/// A message of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecordedMessage<'a> {
    /// Index of its topic among the topics that the reader has found, in the order in which it found them.
    pub topic: usize,
    /// The time of recording, nanoseconds since 1970.
    pub recorded_nanos: i64,
    /// The bytes of the message.
    pub data: &'a [u8],
}

/// Takes the messages of a recording.
pub trait Sink {
    /// Takes a topic; its index is the number of topics before it. Returns whether its messages are wanted: a reader
    /// may pass over the others.
    fn topic(&mut self, topic: &Topic) -> bool;

    /// Takes a message of a wanted topic. `position`: how many bytes of the file have been read.
    ///
    /// # Errors
    /// An error ends the reading, as [`RecordingError::Stopped`].
    fn message(&mut self, message: RecordedMessage<'_>, position: u64) -> Result<(), Stopped>;

    /// Receives a part of the file that is too long to be read, and that is passed over.
    fn passed_over(&mut self, _why: &RecordingError) {}
}

/// The receiver wants no more messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stopped;

/// The end of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ending {
    /// The file ends as its format requires.
    Whole,
    /// The file is cut off; everything before was read. The text states where.
    CutOff(String),
}

/// The kinds of files of recordings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A bag of ROS 1, format 2.0.
    Bag,
    /// MCAP.
    Mcap,
    /// SQLite, as rosbag2 writes it.
    Sqlite,
}

/// Why a recording cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file cannot be read.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The file is of no known kind. The text states what it probably is and what to do.
    #[error("{0}")]
    Unknown(String),
    /// The file breaks its format; the text states where and how.
    #[error("{0}")]
    Broken(String),
    /// A part of the file is longer than the limit.
    #[error("{what} has {bytes} bytes; at most {max} are read")]
    TooLarge {
        /// The part, and where it is.
        what: String,
        /// The size of the part, bytes.
        bytes: u64,
        /// The limit.
        max: usize,
    },
    /// The receiver of the messages wanted no more.
    #[error("the reading was stopped")]
    Stopped,
}

impl From<Stopped> for RecordingError {
    fn from(Stopped: Stopped) -> Self {
        Self::Stopped
    }
}
