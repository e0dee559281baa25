//! Databases of rosbag2 that the tests write.
//!
//! Invariant: the columns stand in another order than rosbag2 has them, where a test does not need its order.

use std::io::Cursor;

use proptest::prelude::*;
use ruzstd::encoding::{CompressionLevel, compress_to_vec};

use super::*;
use crate::{
    sqlite::tests::{Cell, DatabaseWriter, Rows, text},
    testing::{KeptMessages, check_cut},
};

const TOPICS: &str = "id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL, \
                      offered_qos_profiles TEXT NOT NULL";
const MESSAGES: &str =
    "id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL";

fn topic(id: i64, name: &str, profiles: &str) -> (i64, Vec<Cell>) {
    (id, vec![Cell::Null, text(name), text("std_msgs/msg/Bool"), text("cdr"), text(profiles)])
}

fn message(id: i64, topic: i64, time: i64, data: Vec<u8>) -> (i64, Vec<Cell>) {
    (id, vec![Cell::Null, Cell::Integer(topic), Cell::Integer(time), Cell::Bytes(data)])
}

fn some_topics() -> Rows {
    vec![topic(1, "/door", "- durability: 1"), topic(4, "/scan", "- durability: 2")]
}

fn some_messages() -> Rows {
    (0..30_i64)
        .map(|index| {
            let id = if index % 3 == 0 { 4 } else { 1 };
            message(index + 1, id, (1 << 60) + index, vec![0; 5 + 60 * index.unsigned_abs() as usize])
        })
        .collect()
}

fn some_database() -> DatabaseWriter {
    let mut writer = DatabaseWriter::new();
    writer.table("topics", TOPICS, &some_topics());
    writer.table("messages", MESSAGES, &some_messages());
    writer
}

fn recorded(bytes: &[u8]) -> (KeptMessages, Result<Ending, RecordingError>) {
    let mut kept = KeptMessages::default();
    let ending = read(Cursor::new(bytes), &mut kept);
    (kept, ending)
}

#[test]
fn topics_and_messages_come_in_the_order_of_the_tables() {
    let (kept, ending) = recorded(&some_database().finish());
    assert_eq!(ending.unwrap(), Ending::Whole);
    let door = Topic {
        name: "/door".to_owned(),
        type_name: "std_msgs/Bool".to_owned(),
        encoding: Encoding::Cdr,
        definition: String::new(),
        is_latched: true,
    };
    assert_eq!(kept.topics[0], door);
    assert_eq!((kept.topics[1].name.as_str(), kept.topics[1].is_latched), ("/scan", false));
    assert_eq!(kept.messages.len(), 30);
    for (index, (topic, time, data)) in kept.messages.iter().enumerate() {
        assert_eq!(*topic, usize::from(index % 3 == 0));
        assert_eq!((*time, data.len()), ((1 << 60) + index as i64, 5 + 60 * index));
    }
}

#[test]
fn messages_that_are_not_wanted_or_of_no_topic_are_passed_over() {
    let mut messages = some_messages();
    messages.push(message(99, 77, 5, vec![0; 1000]));
    let mut writer = DatabaseWriter::new();
    writer.table("topics", TOPICS, &some_topics());
    writer.table("messages", MESSAGES, &messages);
    let mut kept = KeptMessages { unwanted: vec!["/door"], ..KeptMessages::default() };
    assert_eq!(read(Cursor::new(writer.finish()), &mut kept).unwrap(), Ending::Whole);
    assert_eq!(kept.messages.len(), 10);
}

#[test]
fn the_sink_can_stop_the_reading() {
    let mut kept = KeptMessages { stop_at: Some(2), ..KeptMessages::default() };
    assert!(matches!(read(Cursor::new(some_database().finish()), &mut kept), Err(RecordingError::Stopped)));
    assert_eq!(kept.messages.len(), 2);
}

#[test]
fn columns_are_found_by_their_names_and_definitions_by_their_types() {
    let mut writer = DatabaseWriter::new();
    let definition = vec![text("ros2msg"), text("bool data"), text("std_msgs/msg/Bool")];
    let other = vec![text("ros2idl"), text("module"), text("std_msgs/msg/Bool")];
    let columns = "encoding TEXT, encoded_message_definition TEXT, topic_type TEXT";
    writer.table("message_definitions", columns, &vec![(1, definition), (2, other)]);
    let row = vec![text("json"), text("std_msgs/msg/Bool"), text("/door"), Cell::Integer(8)];
    writer.table("topics", "serialization_format TEXT, type TEXT, name TEXT, id INTEGER", &vec![(1, row)]);
    let row = vec![Cell::Bytes(vec![9; 2000]), Cell::Integer(5), Cell::Integer(8)];
    writer.table("messages", "data BLOB, timestamp INTEGER, topic_id INTEGER", &vec![(1, row)]);
    let (kept, ending) = recorded(&writer.finish());
    assert_eq!(ending.unwrap(), Ending::Whole);
    assert_eq!(kept.topics[0].definition, "bool data");
    assert_eq!(kept.topics[0].encoding, Encoding::Other("json".to_owned()));
    assert_eq!(kept.messages, [(0, 5, vec![9; 2000])]);
}

#[test]
fn compressed_messages_are_decompressed() {
    let data = [0, 1, 0, 0, 7];
    let mut writer = DatabaseWriter::new();
    writer.table("topics", TOPICS, &some_topics());
    let packed = compress_to_vec(&data[..], CompressionLevel::Fastest);
    writer.table("messages", MESSAGES, &vec![message(1, 1, 5, packed), message(2, 1, 6, vec![0x28, 0xb5, 0x2f, 0xfd])]);
    let (kept, ending) = recorded(&writer.finish());
    assert_eq!(kept.messages, [(0, 5, data.to_vec())]);
    let error = ending.unwrap_err().to_string();
    assert!(error.starts_with("the message in row 2 of the table \"messages\""), "{error}");
}

#[test]
fn other_databases_are_refused() {
    let mut writer = DatabaseWriter::new();
    writer.table("topics", TOPICS, &some_topics());
    let error = recorded(&writer.finish()).1.unwrap_err().to_string();
    assert!(error.contains("none of rosbag2"), "{error}");

    let mut writer = DatabaseWriter::new();
    writer.has_log = true;
    let error = recorded(&writer.finish()).1.unwrap_err().to_string();
    assert!(error.contains("-wal"), "{error}");

    let mut writer = DatabaseWriter::new();
    writer.table("topics", TOPICS, &some_topics());
    writer.table("messages", "id INTEGER PRIMARY KEY, topic_id INTEGER, data BLOB", &Rows::new());
    let error = recorded(&writer.finish()).1.unwrap_err().to_string();
    assert!(error.contains("\"messages\" has no column \"timestamp\""), "{error}");
}

proptest! {
    #[test]
    fn any_cut_gives_the_messages_before_it(cut in any::<usize>()) {
        let bytes = some_database().finish();
        let (whole, _) = recorded(&bytes);
        let (cut, ending) = recorded(&bytes[..cut % bytes.len()]);
        check_cut(&whole, &cut, &ending);
    }

    #[test]
    fn changed_bytes_do_no_harm(changes in proptest::collection::vec((any::<usize>(), any::<u8>()), 1..4)) {
        let mut bytes = some_database().finish();
        for (place, value) in changes {
            let place = place % bytes.len();
            bytes[place] = value;
        }
        let (kept, _) = recorded(&bytes);
        prop_assert!(kept.messages.iter().map(|message| message.2.len()).sum::<usize>() <= bytes.len());
    }
}
