//! Groups of records that are written here and decided about elsewhere, and groups of other daemons.

use std::{
    path::Path,
    sync::{Arc, Mutex},
};

use rand::{SeedableRng as _, rngs::SmallRng};
use tidemap_map::event::Event;

use super::example::{event, options, snapshot, spec};
use crate::{
    AppendError, ForeignGroupError, ForkError, GroupLog, LogPoint, MapId, RecordGroup, Store, StoreOptions,
    simulation::{self, SimulatedDisk},
};

type Answers = Arc<Mutex<Vec<Result<u64, AppendError>>>>;

/// A daemon with one map.
struct Daemon {
    store: Store,
    map: MapId,
    log: GroupLog,
    answers: Answers,
}

impl Daemon {
    fn new() -> Daemon {
        let disk = SimulatedDisk::new(SmallRng::seed_from_u64(1));
        simulation::make_directory(&disk);
        let store =
            simulation::open(&disk, StoreOptions { segment_bytes: 900, ..options() }).expect("a new disk has a store");
        let map = store.create_map(&spec("office")).expect("created");
        let mut daemon = Daemon { log: open(&store, map), store, map, answers: Answers::default() };
        daemon.answers = Answers::default();
        daemon
    }

    /// Writes events as one group and ends it with this outcome.
    fn append(
        &self,
        positions: std::ops::RangeInclusive<u64>,
        outcome: Result<(), AppendError>,
    ) -> Option<RecordGroup> {
        let queued = positions.filter_map(|position| {
            let answers = Arc::clone(&self.answers);
            self.log.queue(&event(position), Box::new(move |answer| answers.lock().expect("sound").push(answer))).ok()
        });
        let written = self.log.write(queued.collect()).ok()?;
        self.log.sync(&written).expect("durable");
        let records = written.records().clone();
        self.log.end_group(written, outcome);
        Some(records)
    }

    fn answers(&self) -> Vec<Result<u64, AppendError>> {
        std::mem::take(&mut *self.answers.lock().expect("sound"))
    }

    fn groups(&self, from: u64) -> Vec<RecordGroup> {
        self.log.groups(from).expect("there").map(|group| group.expect("sound")).collect()
    }

    fn reopen(&mut self) -> Vec<(u64, Event)> {
        self.store.inner().close_log(self.map);
        let opened = self.store.open_map(self.map, &spec("office")).expect("opens");
        let events = opened.replay.map(|entry| entry.expect("sound")).collect();
        self.log = self.store.group_log(self.map).expect("open");
        events
    }
}

fn open(store: &Store, map: MapId) -> GroupLog {
    store.open_map(map, &spec("office")).expect("opens");
    store.group_log(map).expect("open")
}

fn events(positions: std::ops::RangeInclusive<u64>) -> Vec<(u64, Event)> {
    positions.map(|position| (position, event(position))).collect()
}

#[test]
fn a_group_that_is_decided_against_is_not_in_the_log() {
    let mut daemon = Daemon::new();
    daemon.append(1..=3, Ok(())).expect("written");
    assert_eq!(daemon.answers(), [Ok(1), Ok(2), Ok(3)]);
    let before = daemon.log.end();
    let moved = AppendError::NotWriter { writer: None };
    let refused = daemon.append(4..=5, Err(moved.clone())).expect("written");
    assert_eq!(daemon.answers(), [Err(moved.clone()), Err(moved)]);
    assert_eq!((daemon.log.end(), refused.before), (before, before));
    // Appends fail until the map's thread has undone what depends on the failed one.
    assert_eq!(daemon.append(4..=4, Ok(())), None);
    daemon.log.resume();
    let other = daemon.append(6..=6, Ok(())).expect("written");
    assert_eq!((daemon.answers(), other.before), (vec![Ok(4)], before));
    assert_eq!(daemon.reopen(), [events(1..=3), vec![(4, event(6))]].concat());
}

#[test]
fn groups_of_another_daemon_make_equal_logs() {
    let (first, mut second) = (Daemon::new(), Daemon::new());
    let mut next = 1;
    for records in [1, 3, 2, 5, 1, 1, 4, 8, 2] {
        let group = first.append(next..=next + records - 1, Ok(())).expect("written");
        assert_eq!(group.events().expect("sound"), events(next..=next + records - 1));
        assert_eq!(second.log.append_group(&group).expect("follows"), events(next..=next + records - 1));
        next += records;
        assert_eq!(first.log.end(), second.log.end());
    }
    assert_eq!(first.groups(1), second.groups(1));
    // Reads from the group that holds the record, whatever segment it is in.
    for position in 1..next {
        let groups = second.groups(position);
        assert!(groups[0].before.position < position && position <= groups[0].after.position);
        assert_eq!(groups.last().map(|group| group.after), Some(second.log.end()));
        assert_eq!(second.log.chain_at(position).expect("readable"), first.log.chain_at(position).expect("readable"));
    }
    assert_eq!(second.log.chain_at(0).expect("readable"), Some(LogPoint::BEGINNING.chain));
    assert_eq!(second.log.chain_at(next).expect("readable"), None, "behind the end");
    assert_eq!(second.reopen(), events(1..=next - 1));
}

#[test]
fn a_group_that_does_not_follow_is_refused() {
    let (first, second) = (Daemon::new(), Daemon::new());
    let groups: Vec<RecordGroup> =
        (1..=3).map(|position| first.append(position..=position, Ok(())).expect("written")).collect();
    let refused = second.log.append_group(&groups[1]).expect_err("a gap");
    assert!(matches!(refused, ForeignGroupError::NotNext { .. }), "{refused}");
    second.log.append_group(&groups[0]).expect("follows");
    let refused = second.log.append_group(&groups[0]).expect_err("again");
    assert!(matches!(refused, ForeignGroupError::NotNext { .. }), "{refused}");
    let mut changed = groups[1].clone();
    let last = changed.frames.len() - 2;
    changed.frames[last] ^= 1;
    let refused = second.log.append_group(&changed).expect_err("damaged");
    assert!(matches!(refused, ForeignGroupError::Invalid(_)), "{refused}");
    let mut longer = groups[1].clone();
    longer.frames.extend_from_slice(&groups[2].frames);
    let refused = second.log.append_group(&longer).expect_err("two groups in one");
    assert!(matches!(refused, ForeignGroupError::Invalid(_)), "{refused}");
    second.log.append_group(&groups[1]).expect("the log is as it was");
}

#[test]
fn a_fork_is_set_aside_and_the_log_goes_on_from_what_both_have() {
    let mut daemon = Daemon::new();
    for position in 1..=12 {
        daemon.append(position..=position, Ok(())).expect("written");
    }
    let common = daemon.log.chain_at(5).expect("readable");
    for position in [4, 9] {
        daemon.store.save(daemon.map, &snapshot(&spec("office"), position, 3)).expect("saved");
    }
    let fork = daemon.store.set_fork_aside(daemon.map, 5).expect("cut").expect("there was one");
    assert_eq!((fork.first, fork.last), (6, 12));
    assert_eq!(daemon.store.forks(daemon.map).expect("readable"), std::slice::from_ref(&fork));
    assert_eq!(daemon.store.fork_events(daemon.map, &fork.name).expect("readable"), events(6..=12));
    let replayed = daemon.reopen();
    assert_eq!(replayed.last(), events(5..=5).last(), "the checkpoint before the fork and the log up to it");
    assert_eq!(daemon.log.end(), LogPoint { position: 5, chain: common.expect("known") });
    // The log forks there again, with other records.
    daemon.append(20..=21, Ok(())).expect("written");
    let again = daemon.store.set_fork_aside(daemon.map, 5).expect("cut").expect("there was one");
    assert_ne!(again.name, fork.name);
    assert_eq!(daemon.store.fork_events(daemon.map, &again.name).expect("readable")[0].1, event(20));
    assert_eq!(daemon.reopen().last(), events(5..=5).last());
    assert_eq!(daemon.store.set_fork_aside(daemon.map, 5).expect("nothing to cut"), None);
    daemon.store.remove_fork(daemon.map, &fork.name).expect("removed");
    assert_eq!(daemon.store.forks(daemon.map).expect("readable"), [again]);
}

#[test]
fn a_fork_before_everything_that_is_kept_changes_nothing() {
    let mut daemon = Daemon::new();
    for position in 1..=30 {
        daemon.append(position..=position, Ok(())).expect("written");
    }
    for position in [18, 25] {
        let mut saved = snapshot(&spec("office"), position, 3);
        saved.replay_from = position + 1;
        daemon.store.save(daemon.map, &saved).expect("saved");
    }
    let error = daemon.store.set_fork_aside(daemon.map, 3).expect_err("the beginning of the log is deleted");
    assert!(matches!(error, ForkError::NothingLeft { common: 3, .. }), "{error}");
    assert!(!error.to_string().contains(Path::new("/data").to_str().expect("text")), "{error}");
    assert_eq!(daemon.reopen().last(), events(30..=30).last());
}
