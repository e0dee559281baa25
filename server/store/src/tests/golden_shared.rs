//! The bytes of the records of shared logs.

use tidemap_layout::log::FrameKind;
use tidemap_map::event::{Digest, Epoch, Event, UpdateDone};

use crate::record::event;

#[test]
fn records_of_shared_logs_are_written_as_they_always_were_and_come_back() {
    let epoch = Epoch { epoch: 300, writer: "d1".to_owned(), version: "0.1.0".to_owned(), maths: 2 };
    let done = UpdateDone { generation: 7, digest: Digest(0x0102_0304_0506_0708), maths: 1 };
    for (record, kind, bytes) in [
        (Event::Epoch(epoch), FrameKind::Epoch, "\x08\u{ac}\x02\x12\x02d1\x1a\x050.1.0\x20\x02"),
        (Event::UpdateDone(done), FrameKind::UpdateDone, "\x08\x07\x11\x08\x07\x06\x05\x04\x03\x02\x01\x18\x01"),
    ] {
        let written = event::encode(&record).expect("valid");
        let expected: Vec<u8> = bytes.chars().map(|byte| byte as u8).collect();
        assert_eq!(written, (kind, expected), "{record:?}");
        assert_eq!(event::decode(kind, &written.1), Ok(record));
    }
}
