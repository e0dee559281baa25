//! Bags that the tests write.
//!
//! Invariant: a written bag can be read by a strict reader, unless a test states otherwise.

use std::io::Write;

use proptest::prelude::*;

use super::*;
use crate::testing::{KeptMessages, check_cut};

/// Chunks of messages: connection, seconds and nanoseconds, bytes.
pub(crate) type Chunks = Vec<Vec<(u32, (u32, u32), Vec<u8>)>>;

pub(crate) struct BagWriter {
    pub(crate) compression: &'static str,
    /// Bytes that an entry of an index is stated to have.
    pub(crate) entry_bytes: usize,
    pub(crate) is_closed: bool,
    pub(crate) encryptor: &'static str,
}

impl Default for BagWriter {
    fn default() -> Self {
        Self { compression: "none", entry_bytes: 12, is_closed: true, encryptor: "" }
    }
}

fn header(fields: &[(&str, &[u8])]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for (name, value) in fields {
        bytes.extend(u32::try_from(name.len() + 1 + value.len()).unwrap().to_le_bytes());
        bytes.extend(name.as_bytes());
        bytes.push(b'=');
        bytes.extend(*value);
    }
    bytes
}

fn record(fields: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for part in [&header(fields)[..], data] {
        bytes.extend(u32::try_from(part.len()).unwrap().to_le_bytes());
        bytes.extend(part);
    }
    bytes
}

fn connection(id: u32) -> Vec<u8> {
    let topic = format!("/topic_{id}");
    let latching: &[u8] = if id == 1 { b"1" } else { b"0" };
    let about = header(&[
        ("topic", topic.as_bytes()),
        ("type", b"std_msgs/Bool"),
        ("md5sum", b"8b94c1b53db61fb6aed406028ad6332a"),
        ("message_definition", b"bool data"),
        ("latching", latching),
    ]);
    record(&[("op", &[OP_CONNECTION]), ("conn", &id.to_le_bytes()), ("topic", topic.as_bytes())], &about)
}

impl BagWriter {
    pub(crate) fn write(&self, chunks: &Chunks) -> Vec<u8> {
        let mut known: Vec<u32> = Vec::new();
        let (mut body, mut infos) = (Vec::new(), Vec::new());
        for messages in chunks {
            let mut plain = Vec::new();
            let mut counts: Vec<(u32, usize)> = Vec::new();
            for (id, (secs, nanos), data) in messages {
                if !known.contains(id) {
                    known.push(*id);
                    plain.extend(connection(*id));
                }
                let time = [secs.to_le_bytes(), nanos.to_le_bytes()].concat();
                plain.extend(record(&[("op", &[OP_MESSAGE]), ("conn", &id.to_le_bytes()), ("time", &time)], data));
                match counts.iter_mut().find(|(known, _)| known == id) {
                    Some((_, count)) => *count += 1,
                    None => counts.push((*id, 1)),
                }
            }
            let size = u32::try_from(plain.len()).unwrap().to_le_bytes();
            let fields = [("op", &[OP_CHUNK][..]), ("compression", self.compression.as_bytes()), ("size", &size)];
            body.extend(record(&fields, &self.packed(&plain)));
            for (id, count) in counts {
                body.extend(self.index(id, count));
            }
            infos.extend(record(&[("op", &[OP_CHUNK_INFO]), ("ver", &1_u32.to_le_bytes())], &[0; 8]));
        }
        let first = |position: u64| {
            let chunks = u32::try_from(if self.is_closed { chunks.len() } else { 0 }).unwrap().to_le_bytes();
            let position = position.to_le_bytes();
            let encryptor = self.encryptor.as_bytes();
            let fields = [("op", &[OP_BAG][..]), ("index_pos", &position), ("chunk_count", &chunks)];
            record(&[&fields[..], &[("encryptor", encryptor)]].concat(), &[b' '; 50])
        };
        let mut bytes = MAGIC.to_vec();
        let position = if self.is_closed { (bytes.len() + first(0).len() + body.len()) as u64 } else { 0 };
        bytes.extend(first(position));
        bytes.extend(body);
        if self.is_closed {
            known.iter().for_each(|id| bytes.extend(connection(*id)));
            bytes.extend(infos);
        }
        bytes
    }

    fn packed(&self, plain: &[u8]) -> Vec<u8> {
        match self.compression {
            "bz2" => {
                let mut encoder = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::fast());
                encoder.write_all(plain).unwrap();
                encoder.finish().unwrap()
            }
            "lz4" => {
                let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
                encoder.write_all(plain).unwrap();
                encoder.finish().unwrap()
            }
            _ => plain.to_vec(),
        }
    }

    fn index(&self, id: u32, count: usize) -> Vec<u8> {
        let stated = u32::try_from(count).unwrap().to_le_bytes();
        let fields = [("op", &[OP_INDEX][..]), ("ver", &1_u32.to_le_bytes()), ("conn", &id.to_le_bytes())];
        let mut bytes = record(&[&fields[..], &[("count", &stated)]].concat(), &[]);
        bytes.truncate(bytes.len() - 4);
        bytes.extend(u32::try_from(count * self.entry_bytes).unwrap().to_le_bytes());
        // Times of 2010, as headers' lengths far too long.
        (0..count).for_each(|_| bytes.extend([0x93, 0x87, 0x76, 0x4c, 1, 2, 3, 4, 0, 0, 0, 0]));
        bytes
    }
}

fn some_chunks() -> Chunks {
    vec![
        vec![(0, (10, 5), vec![1]), (1, (10, 6), vec![0; 40]), (0, (11, 0), vec![])],
        vec![(1, (12, 999_999_999), vec![9, 9]), (7, (13, 0), vec![3])],
        vec![(0, (14, 0), vec![2])],
    ]
}

fn recorded(bytes: &[u8]) -> (KeptMessages, Result<Ending, RecordingError>) {
    let mut kept = KeptMessages::default();
    let ending = read(bytes, &mut kept);
    (kept, ending)
}

#[test]
fn topics_and_messages_come_in_the_order_of_the_file() {
    for compression in ["none", "bz2", "lz4"] {
        let (kept, ending) = recorded(&BagWriter { compression, ..BagWriter::default() }.write(&some_chunks()));
        assert_eq!(ending.unwrap(), Ending::Whole, "{compression}");
        let names: Vec<&str> = kept.topics.iter().map(|topic| topic.name.as_str()).collect();
        assert_eq!(names, ["/topic_0", "/topic_1", "/topic_7"]);
        let latched: Vec<bool> = kept.topics.iter().map(|topic| topic.is_latched).collect();
        assert_eq!(latched, [false, true, false]);
        assert_eq!(kept.topics[0].type_name, "std_msgs/Bool");
        assert_eq!(kept.topics[0].definition, "bool data");
        assert_eq!(kept.topics[0].encoding, Encoding::Ros1);
        let times: Vec<(usize, i64)> = kept.messages.iter().map(|message| (message.0, message.1)).collect();
        let secs = |secs: i64| secs * SECOND_NANOS;
        let wanted = [(0, secs(10) + 5), (1, secs(10) + 6), (0, secs(11)), (1, secs(13) - 1), (2, secs(13))];
        assert_eq!(times, [&wanted[..], &[(0, secs(14))]].concat());
        assert_eq!(kept.messages[3].2, [9, 9]);
    }
}

#[test]
fn an_index_whose_length_is_wrong_is_passed_over() {
    for entry_bytes in [8, 16, 20] {
        let (kept, ending) = recorded(&BagWriter { entry_bytes, ..BagWriter::default() }.write(&some_chunks()));
        assert_eq!(ending.unwrap(), Ending::Whole, "{entry_bytes}");
        assert_eq!(kept.messages.len(), 6, "{entry_bytes}");
    }
}

#[test]
fn a_bag_that_was_not_closed_gives_all_its_messages() {
    let (kept, ending) = recorded(&BagWriter { is_closed: false, ..BagWriter::default() }.write(&some_chunks()));
    assert!(matches!(ending.unwrap(), Ending::CutOff(text) if text.contains("did not close")));
    assert_eq!(kept.messages.len(), 6);
}

#[test]
fn messages_that_are_not_wanted_are_passed_over() {
    let mut kept = KeptMessages { unwanted: vec!["/topic_0"], ..KeptMessages::default() };
    read(&BagWriter::default().write(&some_chunks())[..], &mut kept).unwrap();
    assert_eq!(kept.messages.iter().map(|message| message.0).collect::<Vec<_>>(), [1, 1, 2]);
}

#[test]
fn the_sink_can_stop_the_reading() {
    let mut kept = KeptMessages { stop_at: Some(2), ..KeptMessages::default() };
    let ending = read(&BagWriter::default().write(&some_chunks())[..], &mut kept);
    assert!(matches!(ending, Err(RecordingError::Stopped)));
    assert_eq!(kept.messages.len(), 2);
}

#[test]
fn another_version_is_named() {
    let error = recorded(b"#ROSRECORD V1.2\n\x04\x00\x00\x00").1.unwrap_err().to_string();
    assert!(error.contains("format ROSRECORD V1.2;") && error.contains("rosbag fix"), "{error}");
}

#[test]
fn an_encrypted_bag_gives_an_error_with_advice() {
    let writer = BagWriter { encryptor: "rosbag/AesCbcEncryptor", ..BagWriter::default() };
    let error = recorded(&writer.write(&some_chunks())).1.unwrap_err().to_string();
    assert!(error.contains("rosbag/AesCbcEncryptor") && error.contains("rosbag decrypt"), "{error}");
}

#[test]
fn a_message_of_an_unknown_connection_and_a_wrong_size_are_errors() {
    let mut bytes = MAGIC.to_vec();
    let message = record(&[("op", &[OP_MESSAGE]), ("conn", &[5, 0, 0, 0]), ("time", &[0; 8])], &[]);
    bytes.extend(&message);
    let error = recorded(&bytes).1.unwrap_err().to_string();
    assert!(error.starts_with("the record at byte 13") && error.contains("connection 5"), "{error}");

    let mut bytes = MAGIC.to_vec();
    bytes.extend(record(&[("op", &[OP_CHUNK]), ("compression", b"none"), ("size", &[9, 0, 0, 0])], &message));
    let error = recorded(&bytes).1.unwrap_err().to_string();
    assert!(error.contains("states 9"), "{error}");
}

#[test]
fn a_chunk_above_the_limit_is_passed_over() {
    let mut bytes = MAGIC.to_vec();
    bytes.extend(record(&[("op", &[OP_CHUNK]), ("compression", b"none"), ("size", &[9, 0, 0, 0])], &[]));
    let length = bytes.len() - 4;
    bytes[length..].fill(0xff);
    let (found, ending) = recorded(&bytes);
    assert!(matches!(ending, Ok(Ending::CutOff(_))), "{ending:?}");
    assert_eq!(found.passed_over.len(), 1);
    assert!(found.passed_over[0].contains(&format!("at most {BLOCK_BYTES_MAX}")), "{:?}", found.passed_over);
}

proptest! {
    #[test]
    fn any_cut_gives_the_messages_before_it(
        compression in prop_oneof![Just("none"), Just("bz2"), Just("lz4")], cut in any::<usize>(), entry_bytes in 8..24_usize,
    ) {
        let bytes = BagWriter { compression, entry_bytes, ..BagWriter::default() }.write(&some_chunks());
        let (whole, _) = recorded(&bytes);
        let (cut, ending) = recorded(&bytes[..cut % bytes.len()]);
        check_cut(&whole, &cut, &ending);
    }

    #[test]
    fn a_changed_byte_does_no_harm(
        compression in prop_oneof![Just("none"), Just("bz2"), Just("lz4")], place in any::<usize>(), with in 1..=255_u8,
    ) {
        let mut bytes = BagWriter { compression, ..BagWriter::default() }.write(&some_chunks());
        let place = place % bytes.len();
        bytes[place] ^= with;
        let (kept, _) = recorded(&bytes);
        prop_assert!(kept.messages.len() <= 6);
    }

    #[test]
    fn any_bytes_behind_the_magic_do_no_harm(rest in proptest::collection::vec(any::<u8>(), 0..300)) {
        let (kept, _) = recorded(&[&MAGIC[..], &rest].concat());
        prop_assert!(kept.messages.is_empty());
    }
}
