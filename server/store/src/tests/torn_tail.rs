//! The end of a log after a power cut, and damage that only resembles one.

use std::fs;

use tidemap_layout::log::{FrameHeader, SEGMENT_HEADER_LENGTH};

use super::example::{Example, content, copy, fill, segment};
use crate::{Mode, OpenError, Repair, check};

/// Offsets of the frames in a segment, and its length.
fn frames(bytes: &[u8]) -> Vec<usize> {
    let mut offsets = vec![SEGMENT_HEADER_LENGTH];
    while let Some(header) = FrameHeader::decode(&bytes[offsets[offsets.len() - 1]..]) {
        offsets.push(offsets[offsets.len() - 1] + header.frame_length());
    }
    offsets
}

/// The repairs of cut records without the number of their last zeros.
fn without_zeros(repairs: Vec<Repair>) -> Vec<Repair> {
    let without = |repair| match repair {
        Repair::TornTail { file, bytes, .. } => Repair::TornTail { file, bytes, zero_bytes: 0 },
        repair => repair,
    };
    repairs.into_iter().map(without).collect()
}

fn expect_corrupt(example: &Example, directory: &std::path::Path, position: u64) {
    let before = content(&directory.join("maps"));
    match example.check(directory) {
        Err(OpenError::CorruptLog { position: found, .. }) => assert_eq!(found, position),
        Err(other) => panic!("expected a corrupt log, not {other}"),
        Ok(_) => panic!("a corrupt log was opened"),
    }
    assert!(content(&directory.join("maps")) == before, "a refused log was changed");
}

#[test]
fn the_last_record_cut_at_every_byte_is_dropped_whole() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let mut example = fill(directory.path(), 7, &[], 64 << 20);
    let file = segment(directory.path());
    let good = fs::read(&file).expect("readable");
    let offsets = frames(&good);
    assert_eq!(offsets.len(), 8);
    example.end = 6;
    let torn = |bytes| Repair::TornTail { file: file.clone(), bytes, zero_bytes: 0 };
    for length in offsets[6]..good.len() {
        fs::write(&file, &good[..length]).expect("writable");
        let opened = example.check(directory.path()).expect("opens");
        let bytes = (length - offsets[6]) as u64;
        let expected = if bytes == 0 { vec![] } else { vec![torn(bytes)] };
        // A cut may leave a byte or two of zeros, which are all that is left of the record.
        let found = without_zeros(opened.repairs);
        assert_eq!(found, expected, "length {length}");
        assert_eq!(fs::metadata(&file).expect("there").len(), offsets[6] as u64);
    }
}

#[test]
fn a_sector_that_was_never_written_is_a_torn_tail() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let mut example = fill(directory.path(), 7, &[], 64 << 20);
    let file = segment(directory.path());
    let good = fs::read(&file).expect("readable");
    let offsets = frames(&good);
    example.end = 6;
    // The zeros begin at the record's start, and at each sector within it, and reach to the next sector or to the end.
    let mut starts = vec![offsets[6]];
    starts.extend((offsets[6] + 1..good.len()).filter(|offset| offset % 512 == 0));
    for start in starts {
        let mut bad = good.clone();
        let end = ((start / 512 + 1) * 512).min(good.len());
        bad[start..end].fill(0);
        fs::write(&file, &bad).expect("writable");
        example.check(directory.path()).expect("opens");
    }
    // A length that reached the disk before any byte did.
    let mut longer = good[..offsets[6]].to_vec();
    longer.resize(offsets[6] + 2000, 0);
    fs::write(&file, &longer).expect("writable");
    // It is not known whether records were there that had been acknowledged, and the finding states so.
    let known = "the last 2000 bytes are zero; records that were there may have been acknowledged";
    let finding = check(directory.path(), Mode::Look).expect("checks").findings.pop().expect("a finding");
    assert_eq!(finding.problem, known);
    let repairs = example.check(directory.path()).expect("opens").repairs;
    assert_eq!(repairs, [Repair::TornTail { file, bytes: 2000, zero_bytes: 2000 }]);
    assert!(repairs[0].to_string().ends_with(known), "{}", repairs[0]);
    assert_eq!(check(directory.path(), Mode::Look).expect("checks").findings, []);
}

#[test]
fn a_bad_record_before_a_durable_one_is_damage() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = fill(directory.path(), 12, &[], 64 << 20);
    let file = segment(directory.path());
    let good = fs::read(&file).expect("readable");
    let offsets = frames(&good);
    for position in 1..12 {
        let mut bad = good.clone();
        bad[offsets[position - 1]..offsets[position]].fill(0);
        fs::write(&file, &bad).expect("writable");
        expect_corrupt(&example, directory.path(), position as u64);
    }
}

#[test]
fn every_flipped_bit_of_the_last_record_is_damage() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = fill(directory.path(), 5, &[], 64 << 20);
    let file = segment(directory.path());
    let good = fs::read(&file).expect("readable");
    let offsets = frames(&good);
    for bit in offsets[4] * 8..good.len() * 8 {
        let mut bad = good.clone();
        bad[bit / 8] ^= 1 << (bit % 8);
        fs::write(&file, &bad).expect("writable");
        expect_corrupt(&example, directory.path(), 5);
    }
}

#[test]
fn an_older_segment_is_never_torn() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = fill(directory.path(), 12, &[], 200);
    let file = segment(directory.path());
    let good = fs::read(&file).expect("readable");
    fs::write(&file, &good[..good.len() - 1]).expect("writable");
    assert!(matches!(example.check(directory.path()), Err(OpenError::CorruptLog { .. })));
    fs::remove_file(&file).expect("removable");
    expect_corrupt(&example, directory.path(), 1);
}

#[test]
fn a_missing_segment_in_the_middle_is_damage() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = fill(directory.path(), 40, &[], 200);
    let folder = directory.path().join("maps/00000001/log");
    let mut names: Vec<_> = fs::read_dir(folder).expect("readable").map(|entry| entry.expect("entry").path()).collect();
    names.sort();
    fs::remove_file(&names[names.len() / 2]).expect("removable");
    assert!(matches!(example.check(directory.path()), Err(OpenError::CorruptLog { .. })));
}

#[test]
fn a_log_that_ends_before_a_known_record_is_damage() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = fill(directory.path(), 12, &[10], 64 << 20);
    let file = segment(directory.path());
    let good = fs::read(&file).expect("readable");
    let offsets = frames(&good);
    fs::write(&file, &good[..offsets[9]]).expect("writable");
    expect_corrupt(&example, directory.path(), 10);
    // Known only from the checkpoint, and only from its name.
    fs::remove_dir_all(directory.path().join("index")).expect("removable");
    expect_corrupt(&example, directory.path(), 10);
    fs::write(directory.path().join("maps/00000001/checkpoints/00000000000000000010.tmc"), "").expect("writable");
    expect_corrupt(&example, directory.path(), 10);
}

#[test]
fn a_segment_that_was_only_begun_is_removed() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = fill(directory.path(), 7, &[], 64 << 20);
    let next = directory.path().join("maps/00000001/log/00000000000000000008.log");
    for length in [0, 1, 31, 32] {
        fs::write(&next, vec![0; length]).expect("writable");
        let opened = example.check(directory.path()).expect("opens");
        assert_eq!(opened.repairs, [Repair::LeftoverRemoved { file: next.clone() }]);
        assert!(!next.exists());
    }
    // A segment with records had been made durable.
    fs::write(&next, vec![0; 33]).expect("writable");
    assert!(matches!(example.check(directory.path()), Err(OpenError::CorruptLog { .. })));
}

#[test]
fn records_of_another_map_or_place_are_damage() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = fill(directory.path(), 7, &[], 64 << 20);
    let file = segment(directory.path());
    let good = fs::read(&file).expect("readable");
    let offsets = frames(&good);
    // A record that comes twice, and a gap.
    let doubled = [&good[..offsets[7]], &good[offsets[6]..offsets[7]]].concat();
    let missing = [&good[..offsets[3]], &good[offsets[4]..]].concat();
    for bad in [doubled, missing] {
        fs::write(&file, &bad).expect("writable");
        assert!(matches!(example.check(directory.path()), Err(OpenError::CorruptLog { .. })));
    }
    // Another log whose records have the same numbers and lengths up to the last.
    let other = tempfile::tempdir().expect("temporary directory");
    copy(directory.path(), other.path());
    fs::write(&file, &good).expect("writable");
    let mut foreign = good.clone();
    foreign[12] ^= 1;
    fs::write(segment(other.path()), foreign).expect("writable");
    assert!(matches!(example.check(other.path()), Err(OpenError::CorruptLog { position: 1, .. })));
}
