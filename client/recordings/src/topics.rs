//! The topics that a reader has found.
//!
//! Invariant: at most [`TOPICS_MAX`] topics, whose texts have at most [`DEFINITION_BYTES_MAX`] bytes.

use crate::recording::{DEFINITION_BYTES_MAX, RecordingError, Sink, TOPICS_MAX, Topic};

/// The topics that were found, and the topics that are wanted.
#[derive(Default)]
pub(crate) struct Topics {
    are_wanted: Vec<bool>,
    text_bytes: usize,
}

impl Topics {
    /// Hands a topic to the sink; gives its index.
    pub(crate) fn add(&mut self, topic: &Topic, sink: &mut dyn Sink) -> Result<usize, RecordingError> {
        let index = self.are_wanted.len();
        if index == TOPICS_MAX {
            return Err(RecordingError::Broken(format!(
                "the recording has more than {TOPICS_MAX} topics or connections; no more are read"
            )));
        }
        let added = topic.name.len() + topic.type_name.len() + topic.definition.len();
        self.text_bytes = self.text_bytes.saturating_add(added);
        check_definitions(self.text_bytes)?;
        self.are_wanted.push(sink.topic(topic));
        Ok(index)
    }

    pub(crate) fn is_wanted(&self, index: usize) -> bool {
        self.are_wanted.get(index).copied().unwrap_or(false)
    }
}

/// Refuses definitions longer than the limit.
pub(crate) fn check_definitions(bytes: usize) -> Result<(), RecordingError> {
    if bytes > DEFINITION_BYTES_MAX {
        let what = "the text of all topics and definitions".to_owned();
        return Err(RecordingError::TooLarge { what, bytes: bytes as u64, max: DEFINITION_BYTES_MAX });
    }
    Ok(())
}

/// A type's name without the folder of ROS 2: `sensor_msgs/msg/LaserScan` is `sensor_msgs/LaserScan`.
pub(crate) fn bare_type(name: &str) -> String {
    match name.split_once("/msg/") {
        Some((package, type_name)) => format!("{package}/{type_name}"),
        None => name.to_owned(),
    }
}

/// Whether one of the offered profiles of quality of service keeps the last message for late subscribers. Older
/// recorders write the policy's number, newer ones its name.
pub(crate) fn is_transient_local(profiles: &str) -> bool {
    profiles.split(['\n', ',', '{', '}']).any(|part| {
        let part = part.trim().trim_start_matches("- ").trim_start();
        let value = part.strip_prefix("durability:").map(|value| value.trim().trim_matches(['"', '\'']));
        matches!(value, Some("1" | "transient_local"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_folder_of_ros_2_is_dropped() {
        assert_eq!(bare_type("sensor_msgs/msg/LaserScan"), "sensor_msgs/LaserScan");
        assert_eq!(bare_type("sensor_msgs/LaserScan"), "sensor_msgs/LaserScan");
        assert_eq!(bare_type(""), "");
    }

    #[test]
    fn transient_local_is_found_by_number_and_by_name() {
        assert!(is_transient_local("- history: 3\n  durability: 1\n  deadline:"));
        assert!(is_transient_local("- durability: transient_local"));
        assert!(is_transient_local("[{history: 1, durability: 1}]"));
        assert!(!is_transient_local("- history: 1\n  depth: 1\n  durability: 2"));
        assert!(!is_transient_local("- durability: 11\n  liveliness: 1"));
    }
}
