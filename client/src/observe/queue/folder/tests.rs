//! Numbers, restarts, torn ends, limits and the state of the daemon, with real files.

use std::{collections::BTreeMap, error::Error, fs, path::PathBuf};

use proptest::prelude::*;
use tempfile::{TempDir, tempdir};

use super::*;

const MEGABYTE: u64 = 1 << 20;
const STREAM: [&str; 3] = ["office", "robot", ""];

type Checked = Result<(), Box<dyn Error>>;

fn opened(folder: &TempDir, bytes_max: u64) -> Result<QueueFolder, QueueError> {
    QueueFolder::open(folder.path(), bytes_max, STREAM)
}

fn everything(queue: &QueueFolder) -> Result<BTreeMap<u64, Vec<u8>>, QueueError> {
    let (mut found, mut at) = (BTreeMap::new(), None);
    let counts = queue.counts();
    for number in counts.first..=counts.last {
        let (raw, following) = queue.read(at, number)?.ok_or(QueueError::Closed)?;
        found.insert(number, raw);
        at = Some(following);
    }
    Ok(found)
}

/// The segments, in order.
fn files(folder: &TempDir) -> Vec<PathBuf> {
    let all = fs::read_dir(folder.path()).expect("a folder").map(|entry| entry.expect("an entry").path());
    let mut found: Vec<PathBuf> = all.filter(|path| path.to_string_lossy().contains(".queue")).collect();
    found.sort();
    found
}

#[test]
fn records_keep_their_numbers_through_restarts() -> Checked {
    let folder = tempdir()?;
    let queue = opened(&folder, MEGABYTE)?;
    for value in 1..=3 {
        assert_eq!(queue.append(&[value; 10])?, u64::from(value));
    }
    queue.close()?;
    let again = opened(&folder, MEGABYTE)?;
    assert_eq!(again.append(b"four")?, 4);
    let expected = [(1, vec![1; 10]), (2, vec![2; 10]), (3, vec![3; 10]), (4, b"four".to_vec())];
    assert_eq!(everything(&again)?, BTreeMap::from(expected));
    assert_eq!(again.read(None, 3)?.map(|(raw, _)| raw), Some(vec![3; 10]));
    assert_eq!((again.read(None, 5)?, again.read(None, 0)?), (None, None));
    Ok(())
}

#[test]
fn acknowledged_records_go_and_their_numbers_do_not_come_back() -> Checked {
    let folder = tempdir()?;
    let queue = opened(&folder, 1600)?;
    queue.linked(0)?;
    for _ in 0..50 {
        let number = queue.append(&[7; 200])?;
        queue.acknowledged(number)?;
    }
    assert!(queue.counts().bytes < 500, "{:?}", queue.counts());
    queue.close()?;
    assert_eq!(opened(&folder, 1600)?.append(b"y")?, 51);
    Ok(())
}

#[test]
fn a_full_queue_refuses_the_newest_and_keeps_the_oldest() -> Checked {
    let folder = tempdir()?;
    let queue = opened(&folder, 1000)?;
    queue.linked(0)?;
    for value in 0..9 {
        queue.append(&[value; 100])?;
    }
    assert_eq!(queue.append(&[9; 100]), Err(QueueError::Full { bytes: 972, bytes_max: 1000 }));
    assert_eq!((everything(&queue)?.get(&1), queue.counts().last), (Some(&vec![0; 100]), 9));
    let bytes = files(&folder).iter().map(|path| path.metadata().map_or(0, |metadata| metadata.len())).sum::<u64>();
    assert_eq!(bytes, 972);
    queue.acknowledged(3)?;
    assert_eq!(queue.append(&[9; 100])?, 10);
    Ok(())
}

#[test]
fn a_changed_bit_in_the_last_record_is_cut_off_and_counted() -> Checked {
    let folder = tempdir()?;
    let queue = opened(&folder, MEGABYTE)?;
    queue.append(b"one")?;
    queue.append(b"two")?;
    queue.close()?;
    let path = files(&folder).remove(0);
    let mut raw = fs::read(&path)?;
    *raw.last_mut().ok_or("bytes")? ^= 4;
    fs::write(&path, raw)?;
    let again = opened(&folder, MEGABYTE)?;
    assert_eq!((everything(&again)?, again.counts().cut_bytes), (BTreeMap::from([(1, b"one".to_vec())]), 11));
    Ok(())
}

#[test]
fn a_missing_or_damaged_segment_is_an_error_with_advice() -> Checked {
    for damage in ["missing", "changed"] {
        let folder = tempdir()?;
        let queue = opened(&folder, 1600)?;
        for _ in 0..12 {
            queue.append(&[1; 100])?;
        }
        queue.close()?;
        let path = files(&folder).remove(1);
        if damage == "missing" {
            fs::remove_file(path)?;
        } else {
            fs::write(&path, [1; 40])?;
        }
        let error = opened(&folder, 1600).expect_err("a typed error");
        assert!(matches!(error, QueueError::Damaged { .. }), "{error:?}");
        assert!(error.to_string().contains("Move the folder"), "{error}");
    }
    Ok(())
}

#[test]
fn a_changed_record_is_an_error_when_it_is_read() -> Checked {
    let folder = tempdir()?;
    let queue = opened(&folder, MEGABYTE)?;
    queue.append(b"one")?;
    fs::write(files(&folder).remove(0), [0; 11])?;
    assert!(matches!(queue.read(None, 1), Err(QueueError::Damaged { .. })));
    Ok(())
}

#[test]
fn a_power_cut_that_takes_the_end_of_an_unsynced_segment_takes_the_next_one_too() -> Checked {
    let folder = tempdir()?;
    let queue = opened(&folder, 1600)?;
    for value in 0..3 {
        queue.append(&[value; 100])?;
    }
    // Without an end in order, as when the power goes: the files have not got their lasting names.
    drop(queue);
    let all = files(&folder);
    assert_eq!(all.len(), 3);
    fs::write(&all[1], b"")?;
    let again = opened(&folder, 1600)?;
    assert_eq!(everything(&again)?, BTreeMap::from([(1, vec![0; 100])]));
    assert_eq!((again.append(b"new")?, again.counts().cut_bytes), (2, 108));
    Ok(())
}

#[test]
fn two_programs_do_not_share_a_queue() -> Checked {
    let folder = tempdir()?;
    let queue = opened(&folder, MEGABYTE)?;
    assert!(matches!(opened(&folder, MEGABYTE), Err(QueueError::InUse { .. })));
    queue.close()?;
    opened(&folder, MEGABYTE)?.close()?;
    Ok(())
}

#[test]
fn a_queue_of_another_producer_is_an_error() -> Checked {
    let folder = tempdir()?;
    opened(&folder, MEGABYTE)?.close()?;
    let other = QueueFolder::open(folder.path(), MEGABYTE, ["office", "robot-2", ""]);
    assert!(matches!(other, Err(QueueError::OtherStream { .. })), "{other:?}");
    Ok(())
}

#[test]
fn a_damaged_relation_is_an_error_with_advice() -> Checked {
    let folder = tempdir()?;
    opened(&folder, MEGABYTE)?.close()?;
    fs::write(folder.path().join("relation"), b"nonsense")?;
    let error = opened(&folder, MEGABYTE).expect_err("a typed error");
    assert!(error.to_string().contains("Move the folder"), "{error}");
    Ok(())
}

#[test]
fn the_relation_to_the_daemon_survives_restarts() -> Checked {
    let folder = tempdir()?;
    let queue = opened(&folder, MEGABYTE)?;
    queue.append(b"taken before the daemon was reached")?;
    queue.linked(500)?;
    assert_eq!((queue.sequence(1), queue.counts().lost), (501, 0));
    queue.close()?;
    let again = opened(&folder, MEGABYTE)?;
    again.linked(501)?;
    assert_eq!((again.number(501), again.append(b"next")?, again.sequence(2)), (1, 2, 502));
    Ok(())
}

#[test]
fn a_restored_backup_is_counted() -> Checked {
    let folder = tempdir()?;
    let queue = opened(&folder, 1600)?;
    queue.linked(0)?;
    for _ in 0..12 {
        queue.append(&[1; 100])?;
    }
    queue.acknowledged(10)?;
    let first = queue.counts().first;
    assert!(first > 4, "{first}");
    queue.linked(3)?;
    assert_eq!((queue.counts().lost, queue.sequence(first)), (first - 4, 4));
    Ok(())
}

#[test]
fn records_that_a_power_cut_took_do_not_hide_new_ones() -> Checked {
    let folder = tempdir()?;
    let queue = opened(&folder, MEGABYTE)?;
    queue.linked(0)?;
    for raw in [b"one", b"two", b"six"] {
        queue.append(raw)?;
    }
    queue.close()?;
    // The daemon has all three; the disk has lost the last.
    let path = files(&folder).remove(0);
    let file = File::options().write(true).open(&path)?;
    file.set_len(file.metadata()?.len() - 1)?;
    let again = opened(&folder, MEGABYTE)?;
    assert_eq!(again.append(b"new")?, 3);
    // It ends before the daemon was reached; another start.
    again.close()?;
    for _ in 0..2 {
        let again = opened(&folder, MEGABYTE)?;
        again.linked(3)?;
        assert_eq!((again.sequence(3), again.read(None, 3)?.map(|(raw, _)| raw)), (4, Some(b"new".to_vec())));
        again.close()?;
    }
    Ok(())
}

#[test]
fn a_closed_queue_changes_nothing() -> Checked {
    let folder = tempdir()?;
    let queue = opened(&folder, MEGABYTE)?;
    queue.linked(0)?;
    queue.append(b"one")?;
    queue.close()?;
    assert_eq!((queue.append(b"two"), queue.linked(0)), (Err(QueueError::Closed), Err(QueueError::Closed)));
    queue.acknowledged(1)?;
    assert_eq!(queue.read(None, 1)?, None);
    let again = opened(&folder, MEGABYTE)?;
    assert_eq!((again.sequence(1), everything(&again)?), (1, BTreeMap::from([(1, b"one".to_vec())])));
    Ok(())
}

/// A step of a random run.
#[derive(Clone, Debug)]
enum Step {
    Append(usize),
    /// The daemon has this part of the records, out of 100.
    Acknowledge(u64),
    Sync,
    Reopen,
    /// The machine stops, and the last segment keeps this part of its unsynced bytes, out of 100.
    Cut(u64),
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let step = prop_oneof![
        6 => (1_usize..300).prop_map(Step::Append),
        2 => (0_u64..=100).prop_map(Step::Acknowledge),
        1 => Just(Step::Sync),
        1 => Just(Step::Reopen),
        1 => (0_u64..=100).prop_map(Step::Cut),
    ];
    proptest::collection::vec(step, 1..80)
}

/// The records that a queue must have, with the sequence number that each must keep.
#[derive(Default)]
struct Expected {
    records: BTreeMap<u64, Vec<u8>>,
    next: u64,
    /// Numbers up to which the daemon has the records.
    durable: u64,
    synced_bytes: u64,
    filled: u8,
}

fn cut_at(folder: &TempDir, synced_bytes: u64, part: u64) -> Option<()> {
    let path = files(folder).pop()?;
    let file = File::options().write(true).open(path).ok()?;
    let size = file.metadata().ok()?.len();
    file.set_len(synced_bytes.min(size) + (size.saturating_sub(synced_bytes)) * part / 100).ok()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, ..ProptestConfig::default() })]

    /// In one segment, so that the bytes that a cut may take are those after the last sync.
    #[test]
    fn any_run_keeps_numbers_and_synced_records(steps in steps()) {
        let folder = tempdir().expect("a folder");
        let open = || opened(&folder, MEGABYTE).expect("a queue");
        let mut queue = open();
        queue.linked(0).expect("linked");
        let mut expected = Expected { next: 1, ..Expected::default() };
        for step in steps {
            match step {
                Step::Append(length) => {
                    expected.filled = expected.filled.wrapping_add(1);
                    let raw = vec![expected.filled; length];
                    prop_assert_eq!(queue.append(&raw).expect("room"), expected.next);
                    expected.records.insert(expected.next, raw);
                    expected.next += 1;
                }
                Step::Acknowledge(part) => {
                    let waiting = expected.next - 1 - expected.durable;
                    expected.durable += waiting * part / 100;
                    queue.acknowledged(expected.durable).expect("acknowledged");
                }
                Step::Sync => {
                    queue.sync().expect("synced");
                    expected.synced_bytes = queue.counts().bytes;
                }
                Step::Reopen => {
                    queue.close().expect("closed");
                    queue = open();
                    queue.linked(expected.durable).expect("linked");
                    expected.synced_bytes = queue.counts().bytes;
                }
                Step::Cut(part) => {
                    drop(queue);
                    cut_at(&folder, expected.synced_bytes, part);
                    queue = open();
                    let last = queue.counts().last;
                    expected.records.retain(|&number, _| number <= last);
                    expected.next = last + 1;
                    expected.synced_bytes = queue.counts().bytes;
                    // The daemon may have records that the disk has lost; after this, all have other sequence numbers.
                    let durable = expected.durable;
                    queue.linked(durable).expect("linked");
                    prop_assert!(queue.sequence(expected.next) > i128::from(durable));
                    if durable > last {
                        let shift = queue.sequence(1) - 1;
                        prop_assert_eq!(shift, i128::from(durable - last));
                        // Begins anew, so that numbers and sequence numbers are the same again.
                        return Ok(());
                    }
                }
            }
            let counts = queue.counts();
            prop_assert_eq!(counts.last + 1, expected.next);
            prop_assert!(counts.first <= expected.durable + 1, "{:?}", counts);
            for (number, raw) in everything(&queue).expect("whole") {
                prop_assert_eq!(Some(&raw), expected.records.get(&number));
            }
        }
    }

    #[test]
    fn a_cut_at_any_byte_leaves_the_whole_records_before_it(
        lengths in proptest::collection::vec(1_usize..60, 1..20),
        part in 0.0..1.0_f64,
    ) {
        let folder = tempdir().expect("a folder");
        let queue = opened(&folder, MEGABYTE).expect("a queue");
        for (value, &length) in lengths.iter().enumerate() {
            queue.append(&vec![value as u8; length]).expect("room");
        }
        let whole = everything(&queue).expect("whole");
        queue.close().expect("closed");
        let file = File::options().write(true).open(files(&folder).remove(0)).expect("a segment");
        let cut = (file.metadata().expect("a size").len() as f64 * part) as u64;
        file.set_len(cut).expect("shorter");
        let again = opened(&folder, MEGABYTE).expect("a queue");
        let kept = everything(&again).expect("whole");
        let bytes = |count: usize| lengths.iter().take(count).map(|length| (length + HEAD_BYTES) as u64).sum::<u64>();
        prop_assert!(bytes(kept.len()) <= cut && cut < bytes(kept.len() + 1));
        prop_assert!(kept.iter().all(|(number, raw)| whole.get(number) == Some(raw)));
        prop_assert_eq!(again.append(b"next").expect("room"), kept.len() as u64 + 1);
    }

    #[test]
    fn random_appends_and_acknowledgements_over_many_segments_keep_all_that_waits(
        parts in proptest::collection::vec((1_usize..400, 0_u64..=100), 1..60),
    ) {
        let folder = tempdir().expect("a folder");
        let queue = opened(&folder, 4000).expect("a queue");
        queue.linked(0).expect("linked");
        let (mut kept, mut durable) = (BTreeMap::new(), 0);
        for (step, (length, part)) in parts.into_iter().enumerate() {
            let raw = vec![step as u8; length];
            match queue.append(&raw) {
                Ok(number) => drop(kept.insert(number, raw)),
                Err(error) => prop_assert!(matches!(error, QueueError::Full { .. }), "{:?}", error),
            }
            durable += (queue.counts().last - durable) * part / 100;
            queue.acknowledged(durable).expect("acknowledged");
            prop_assert!(queue.counts().bytes <= 4000);
        }
        drop(queue);
        let again = opened(&folder, 4000).expect("a queue");
        let found = everything(&again).expect("whole");
        let waiting: BTreeMap<_, _> = kept.into_iter().filter(|(number, _)| *number > durable).collect();
        prop_assert!(waiting.iter().all(|(number, raw)| found.get(number) == Some(raw)));
    }
}
