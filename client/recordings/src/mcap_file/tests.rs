//! MCAP files that the tests write.
//!
//! Invariant: whole files come from another implementation of the format; only files that it cannot write are put
//! together here.

use std::{collections::BTreeMap, io::Cursor};

use mcap::{WriteOptions, records::MessageHeader};
use proptest::prelude::*;
use ruzstd::encoding::{CompressionLevel, compress_to_vec};

use super::*;
use crate::testing::{KeptMessages, check_cut};

const PROFILES: &str = "- history: 1\n  durability: 1\n";

/// Ten messages of two topics; chunks of some messages, or none.
fn some_file(has_chunks: bool) -> Vec<u8> {
    let options = WriteOptions::new().compression(None).use_chunks(has_chunks).chunk_size(Some(120));
    let mut writer = mcap::Writer::with_options(Cursor::new(Vec::new()), options).unwrap();
    let metadata = BTreeMap::from([("offered_qos_profiles".to_owned(), PROFILES.to_owned())]);
    let schema = writer.add_schema("std_msgs/msg/Bool", "ros2msg", b"bool data").unwrap();
    let door = writer.add_channel(schema, "/door", "cdr", &metadata).unwrap();
    let schema = writer.add_schema("a_msgs/msg/Other", "ros2idl", b"module a {}").unwrap();
    let other = writer.add_channel(schema, "/other", "protobuf", &BTreeMap::new()).unwrap();
    for index in 0..10_u8 {
        let (channel_id, log_time) = (if index % 3 == 0 { other } else { door }, 1000 + u64::from(index));
        let header = MessageHeader { channel_id, sequence: 0, log_time, publish_time: 5 };
        writer.write_to_known_channel(&header, &[0, 1, 0, 0, index]).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

fn recorded(bytes: &[u8]) -> (KeptMessages, Result<Ending, RecordingError>) {
    let mut kept = KeptMessages::default();
    let ending = read(bytes, &mut kept);
    (kept, ending)
}

fn record(op: u8, parts: &[&[u8]]) -> Vec<u8> {
    let body = parts.concat();
    [&[op][..], &(body.len() as u64).to_le_bytes(), &body].concat()
}

fn counted(text: &[u8]) -> Vec<u8> {
    [&u32::try_from(text.len()).unwrap().to_le_bytes()[..], text].concat()
}

fn channel(id: u16, topic: &str, encoding: &str) -> Vec<u8> {
    let parts = [counted(topic.as_bytes()), counted(encoding.as_bytes()), counted(b"")];
    record(OP_CHANNEL, &[&id.to_le_bytes(), &[0, 0], &parts.concat()])
}

fn message(id: u16, time: u64, data: &[u8]) -> Vec<u8> {
    record(OP_MESSAGE, &[&id.to_le_bytes(), &[0; 4], &time.to_le_bytes(), &[0; 8], data])
}

fn chunk(compression: &str, plain: &[u8], checksum: u32) -> Vec<u8> {
    let stored = match compression {
        "zstd" => compress_to_vec(plain, CompressionLevel::Fastest),
        _ => plain.to_vec(),
    };
    let size = (plain.len() as u64).to_le_bytes();
    let stored_size = (stored.len() as u64).to_le_bytes();
    let name = counted(compression.as_bytes());
    record(OP_CHUNK, &[&[0; 16], &size, &checksum.to_le_bytes(), &name, &stored_size, &stored])
}

fn file(records: &[Vec<u8>]) -> Vec<u8> {
    [&MAGIC[..], &records.concat(), &record(OP_FOOTER, &[&[0; 20]]), &MAGIC[..]].concat()
}

#[test]
fn topics_and_messages_come_in_the_order_of_the_file() {
    for has_chunks in [false, true] {
        let (kept, ending) = recorded(&some_file(has_chunks));
        assert_eq!(ending.unwrap(), Ending::Whole);
        let mut topics = kept.topics.clone();
        topics.sort_by(|one, other| one.name.cmp(&other.name));
        let door = Topic {
            name: "/door".to_owned(),
            type_name: "std_msgs/Bool".to_owned(),
            encoding: Encoding::Cdr,
            definition: "bool data".to_owned(),
            is_latched: true,
        };
        let other = Topic {
            name: "/other".to_owned(),
            type_name: "a_msgs/Other".to_owned(),
            encoding: Encoding::Unreadable(
                "its schema is in \"ros2idl\"; messages in protobuf need one in protobuf".to_owned(),
            ),
            definition: String::new(),
            is_latched: false,
        };
        assert_eq!(topics, [door, other]);
        for (index, (topic, time, data)) in kept.messages.iter().enumerate() {
            let name = if index % 3 == 0 { "/other" } else { "/door" };
            assert_eq!(kept.topics[*topic].name, name);
            assert_eq!((*time, usize::from(data[4])), (1000 + index as i64, index));
        }
        assert_eq!(kept.messages.len(), 10);
    }
}

#[test]
fn messages_that_are_not_wanted_are_passed_over() {
    let mut kept = KeptMessages { unwanted: vec!["/other"], ..KeptMessages::default() };
    read(&some_file(true)[..], &mut kept).unwrap();
    assert_eq!(kept.messages.len(), 6);
}

#[test]
fn the_sink_can_stop_the_reading() {
    let mut kept = KeptMessages { stop_at: Some(2), ..KeptMessages::default() };
    assert!(matches!(read(&some_file(true)[..], &mut kept), Err(RecordingError::Stopped)));
    assert_eq!(kept.messages.len(), 2);
}

#[test]
fn chunks_and_messages_are_decompressed() {
    let data = [0, 1, 0, 0, 7];
    let packed = compress_to_vec(&data[..], CompressionLevel::Fastest);
    let plain = [channel(1, "/door", "cdr"), message(1, 5, &packed), message(1, 6, &data)].concat();
    let (kept, ending) = recorded(&file(&[chunk("zstd", &plain, crc32fast::hash(&plain))]));
    assert_eq!(ending.unwrap(), Ending::Whole);
    assert_eq!(kept.messages, [(0, 5, data.to_vec()), (0, 6, data.to_vec())]);
}

#[test]
fn the_error_of_a_wrong_checksum_names_the_place() {
    let plain = channel(1, "/door", "ros1");
    let error = recorded(&file(&[chunk("", &plain, 77)])).1.unwrap_err().to_string();
    assert!(error.starts_with("the chunk at byte 8 has the checksum"), "{error}");
    assert_eq!(recorded(&file(&[chunk("", &plain, 0)])).1.unwrap(), Ending::Whole);
}

#[test]
fn an_unknown_compression_is_named() {
    let error = recorded(&file(&[chunk("brotli", b"", 0)])).1.unwrap_err().to_string();
    assert!(error.contains("\"brotli\""), "{error}");
}

#[test]
fn the_error_of_a_broken_file_names_the_damage() {
    for (records, text) in [
        (vec![message(3, 5, b"")], "channel 3, which was not described"),
        (vec![channel(1, "/a", "cdr"), channel(1, "/b", "cdr")], "\"/b\"; before it was one of \"/a\""),
        (vec![channel(1, "/a", "cdr"), message(1, u64::MAX, b"")], "after the year 2262"),
        (vec![record(OP_CHANNEL, &[&[1, 0, 5, 0], &counted(b"/a"), &[0; 8]])], "schema 5, which was not described"),
        (vec![record(OP_SCHEMA, &[&[1, 0, 9]])], "the schema at byte 8, or in the chunk there, is shorter"),
        (vec![chunk("", &message(1, 5, b"")[..20], 0)], "ends within its record at byte 0"),
    ] {
        let error = recorded(&file(&records)).1.unwrap_err().to_string();
        assert!(error.contains(text), "{error}");
    }
    let mut bytes = file(&[]);
    *bytes.last_mut().unwrap() = 0;
    assert!(matches!(recorded(&bytes).1, Err(RecordingError::Broken(_))));
}

#[test]
fn a_length_above_the_limit_is_refused_or_passed_over() {
    for op in [OP_MESSAGE, OP_CHUNK] {
        let bytes = [&MAGIC[..], &[op], &[0xff; 8]].concat();
        let (found, ending) = recorded(&bytes);
        assert!(matches!(ending, Ok(Ending::CutOff(_))), "{ending:?}");
        assert_eq!(found.passed_over.len(), 1);
    }
    for op in [OP_SCHEMA, OP_CHANNEL] {
        let bytes = [&MAGIC[..], &[op], &[0xff; 8]].concat();
        assert!(matches!(recorded(&bytes).1, Err(RecordingError::TooLarge { bytes: u64::MAX, .. })));
    }
}

proptest! {
    #[test]
    fn any_cut_gives_the_messages_before_it(has_chunks in any::<bool>(), cut in any::<usize>()) {
        let bytes = some_file(has_chunks);
        let (whole, _) = recorded(&bytes);
        let (cut, ending) = recorded(&bytes[..cut % bytes.len()]);
        check_cut(&whole, &cut, &ending);
    }

    #[test]
    fn a_changed_byte_does_no_harm(has_chunks in any::<bool>(), place in any::<usize>(), with in 1..=255_u8) {
        let mut bytes = some_file(has_chunks);
        let place = place % bytes.len();
        bytes[place] ^= with;
        prop_assert!(recorded(&bytes).0.messages.len() <= 10);
    }

    #[test]
    fn any_bytes_behind_the_magic_do_no_harm(rest in proptest::collection::vec(any::<u8>(), 0..300)) {
        let (kept, _) = recorded(&[&MAGIC[..], &rest].concat());
        prop_assert!(kept.messages.is_empty());
    }
}
