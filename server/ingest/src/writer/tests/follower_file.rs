//! Tests a follower that reads the groups of a writer's log from its files. It has the same content after every update,
//! for any division of the groups into events, and for any point of a restart.

use std::{collections::BTreeMap, fs, path::PathBuf};

use tidemap_grid::mask::TileMasks;
use tidemap_map::{
    event::{Digest, Dimensions, Event, Position, RowKind, StateShape, StatedReporting},
    live_state::LiveState,
    site::SiteEdit,
};
use tidemap_model::{EnabledModels, StateKind, StateModel};
use tidemap_proto::convert::vectors::DeclaredState;
use tidemap_store::{GroupLog, RecordGroup};

use super::{
    replicas::{Replica, compared, keep_busy},
    scans::{grid, masks, picture, scanner, tile},
    training::{copy, files},
    *,
};
use crate::protocol::{AddState, EditSite, NewName};

const DAY: i64 = 24 * HOUR;
/// Trained models are due after a week.
const ROUNDS: u64 = 8;
const PER_ROUND: usize = 48;

pub(super) fn spec() -> MapSpec {
    MapSpec { retention: Retention::Forever, models: EnabledModels::ALL, ..spec_with(Some(grid())) }
}

fn open(dir: &Path) -> Replica {
    Replica::open_with(dir, &spec(), None, |context| context.max_states = 40)
}

/// The content of a map after an update, as far as readers see it.
#[derive(Debug, PartialEq)]
pub(super) struct Shown {
    position: u64,
    pub(super) generation: u64,
    digest: Digest,
    marks: Vec<ProducerMark>,
    states: Vec<(StateName, LiveState, StateModel)>,
    pending: u64,
    site: tidemap_map::site::Site,
    scans: u64,
    cells: u64,
}

pub(super) async fn shown(replica: &Replica, generation: u64) -> Shown {
    let digest = replica.digest(generation).await.digest;
    let view = replica.handle.view();
    let state = |info: &tidemap_map::view::StateInfo| {
        let id = view.find(info.name.as_str()).expect("its name");
        (info.name.clone(), view.live(id), view.model(id).clone())
    };
    let (_, scans, cells) = picture(&replica.handle);
    Shown {
        position: view.position(),
        generation: view.generation(),
        digest,
        marks: replica.marks().await,
        states: view.infos().map(state).collect(),
        pending: view.pending(),
        site: view.site().clone(),
        scans,
        cells,
    }
}

/// The files of a folder of the only map, by name.
fn contents(dir: &Path, folder: &str) -> BTreeMap<String, Vec<u8>> {
    let name = |path: &Path| path.file_name().and_then(|name| name.to_str()).expect("a name").to_owned();
    let files = files(&dir.join("maps/00000001").join(folder));
    files.iter().map(|path| (name(path), fs::read(path).expect("readable"))).collect()
}

/// The data that the writer has left.
struct Written {
    /// The content after each update.
    shown: Vec<Shown>,
    /// The checkpoints of all updates.
    checkpoints: BTreeMap<String, Vec<u8>>,
    history: BTreeMap<String, Vec<u8>>,
    groups: Vec<RecordGroup>,
}

fn named(name: &str, shape: StateShape, reporting: Option<StatedReporting>) -> Option<NewName> {
    Some(NewName { name: StateName::new(name).expect("valid"), shape: Some(shape), reporting })
}

/// Sends a day of observations of states of all kinds; for some states, with times in the future.
pub(super) async fn observe(replica: &Replica, round: u64) {
    let mut robot = hello(&replica.handle, "r", round, false).await.expect("accepted");
    let start = NOON - 12 * HOUR - (ROUNDS + 1 - round) as i64 * DAY;
    let changes = StatedReporting::new(RowKind::Changes, None, None).expect("valid");
    let names = vec![
        named("open", StateKind::Probability.into(), None),
        named("speed", StateKind::Continuous.into(), None),
        named("people", StateKind::Count.into(), None),
        named("lamp", StateKind::Probability.into(), Some(changes)),
        named("anna", StateShape::Vector(Dimensions::Two), None),
        named("activity", StateShape::Categorical(2), None),
    ];
    for slot in 0..PER_ROUND as i64 {
        let first = robot.sent + 1;
        robot.sent += 6;
        let number = ((slot * 31 + round as i64 * 17) % 13) as f64;
        let share = number / 13.0;
        let batch = ObservationBatch {
            span: SequenceSpan { first, last: robot.sent, content_crc: 1 },
            new_names: if slot == 0 { names.clone() } else { Vec::new() },
            table_indices: (0..6).collect(),
            times_nanos: vec![start + slot * HOUR / 2; 6],
            values: vec![
                f64::from(u8::from(number > 5.0)),
                number / 7.0,
                number,
                f64::from(u8::from(number > 9.0)),
                0.0,
                0.0,
            ],
            positions: vec![(4, Position::of(&[number, -share]).expect("two"))],
            shares: vec![(5, Box::new([share, 1.0 - share]))],
            ..ObservationBatch::default()
        };
        let permit = || Arc::new(Semaphore::new(1)).try_acquire_owned().expect("free");
        let data = StreamData::Observations(batch, vec![permit(), permit()]);
        assert!(replica.handle.send(Command::StreamData { session: robot.opened.session, data }));
    }
    loop {
        match robot.events.recv().await {
            Some(SessionEvent::Ack { durable_sequence, refused }) => {
                assert_eq!(refused, []);
                if durable_sequence == robot.sent {
                    return;
                }
            }
            other => panic!("{other:?}"),
        }
    }
}

/// Sends a day of scans; returns the tiles of the last scan, by x.
pub(super) async fn scan(replica: &Replica, name: &str, round: u64) -> Vec<(i32, TileMasks)> {
    let mut scanner = scanner(&replica.handle, name, false).await;
    let start = NOON - 12 * HOUR - (ROUNDS + 1 - round) as i64 * DAY;
    let mut last = Vec::new();
    for slot in 0..12u16 {
        let occupied = [(slot * 5 + round as u16) % 8];
        let seen = [(0, masks(&[0, 1, 2, 3, 4, 5, 6, 7], &occupied)), (round as i32, masks(&[9], &[9]))];
        let scan = seen.map(|(x, masks)| (tile(x), masks)).to_vec();
        scanner.send(&replica.handle, &[(start + i64::from(slot) * 2 * HOUR, scan)]);
        last = seen.to_vec();
    }
    assert_eq!(scanner.settled().await, []);
    last
}

pub(super) async fn prepare(replica: &Replica) {
    let (reply, answer) = oneshot::channel();
    let name = StateName::new("activity").expect("valid");
    let labels = ["sleep", "eat"].map(|label| name.label(label).expect("valid")).to_vec();
    let state = DeclaredState { name, shape: StateShape::Categorical(2), labels, sensor: None, reporting: None };
    assert!(replica.handle.send(Command::AddState(AddState { state, client: String::new(), reply })));
    assert_eq!(answer.await, Ok(Ok(())));
    let (reply, answer) = oneshot::channel();
    let edit = SiteEdit::Charger(Some([1.0, 2.0]));
    assert!(replica.handle.send(Command::EditSite(EditSite { edit, reply })));
    assert_eq!(answer.await, Ok(Ok(())));
}

/// A writer that is restarted after every update, so that each has a checkpoint.
async fn write(dir: &Path) -> Written {
    let (mut all, mut checkpoints) = (Vec::new(), BTreeMap::new());
    for round in 1..=ROUNDS {
        let writer = open(dir);
        writer.take_over(round).await;
        if round == 1 {
            prepare(&writer).await;
        }
        observe(&writer, round).await;
        scan(&writer, "scanner", round).await;
        let before = writer.handle.position();
        writer.update();
        // The events of the update: its start and its end.
        writer.reaches(before + 2).await;
        all.push(shown(&writer, round).await);
        writer.stop().await;
        checkpoints.append(&mut contents(dir, "checkpoints"));
    }
    let store = context(dir, NOON).0.store;
    let id = store.maps()[0].0;
    let _opened = store.open_map(id, &spec()).expect("opened");
    let log = store.group_log(id).expect("a log");
    let groups = log.groups(1).expect("readable").map(|group| group.expect("whole")).collect();
    store.close();
    Written { shown: all, checkpoints, history: contents(dir, "history"), groups }
}

/// The time at which a follower is killed and opened again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Restart {
    Never,
    /// The follower is stopped in order, after each update.
    AfterEach,
    /// The follower is killed while an update runs.
    InUpdate,
    /// The follower is killed while an update runs that has ended at the writer.
    InUpdateThatEnded,
}

/// A follower, and the folder of its data.
struct Follower {
    dir: PathBuf,
    replica: Replica,
    log: GroupLog,
}

impl Follower {
    fn open(dir: PathBuf) -> Self {
        let replica = open(&dir);
        let log = replica.context.store.group_log(replica.id).expect("a log");
        Self { dir, replica, log }
    }

    /// Appends groups from the end of its own log up to a position, and sends their events in pieces.
    async fn follow(&self, groups: &[RecordGroup], to: u64, piece: usize) {
        let from = self.log.end().position;
        for group in groups.iter().filter(|group| group.before.position >= from && group.after.position <= to) {
            let events = self.log.append_group(group).expect("appended");
            for events in events.chunks(piece) {
                self.replica.send_events(events.to_vec()).await.expect("applied");
            }
        }
        assert_eq!(self.log.end().position, to, "groups end there");
    }

    /// Opens the data that a kill leaves, while the update thread is busy.
    async fn killed(self, generation: u64) -> Self {
        let dir = self.dir.with_extension(format!("killed {generation}"));
        copy(&self.dir.join("maps"), &dir.join("maps"));
        fs::copy(self.dir.join("MANIFEST"), dir.join("MANIFEST")).expect("copied");
        self.replica.handle.stop(Ending::Shutdown).await;
        Self::open(dir)
    }
}

/// Position of the start of an update.
fn start_of(groups: &[RecordGroup], generation: u64) -> u64 {
    let events = groups.iter().flat_map(|group| group.events().expect("valid"));
    let is_start = |event: &Event| matches!(event, Event::UpdateStart(start) if start.generation == generation);
    events.into_iter().find(|(_, event)| is_start(event)).expect("it is there").0
}

async fn follow(written: &Written, dir: PathBuf, piece: usize, restart: Restart) {
    let mut follower = Follower::open(dir);
    let mut checkpoints = BTreeMap::new();
    for (generation, expected) in (1..).zip(&written.shown) {
        let killed_behind = match restart {
            Restart::InUpdate => Some(start_of(&written.groups, generation)),
            Restart::InUpdateThatEnded => Some(expected.position),
            Restart::Never | Restart::AfterEach => None,
        };
        if let Some(position) = killed_behind.filter(|_| generation == ROUNDS / 2 || generation == ROUNDS) {
            let busy = keep_busy(&follower.replica.context);
            follower.follow(&written.groups, position, piece).await;
            assert_eq!(follower.replica.handle.generation(), generation - 1);
            follower = follower.killed(generation).await;
            drop(busy);
        }
        follower.follow(&written.groups, expected.position, piece).await;
        compared(&follower.replica, generation, true).await;
        assert_eq!(&shown(&follower.replica, generation).await, expected, "{restart:?} {piece}");
        if restart == Restart::AfterEach {
            let Follower { dir, replica, log } = follower;
            drop(log);
            replica.stop().await;
            checkpoints.append(&mut contents(&dir, "checkpoints"));
            follower = Follower::open(dir);
        }
    }
    let Follower { dir, replica, log } = follower;
    drop(log);
    replica.stop().await;
    checkpoints.append(&mut contents(&dir, "checkpoints"));
    let newest = written.checkpoints.keys().next_back().expect("a checkpoint");
    assert!(checkpoints.contains_key(newest));
    if restart == Restart::AfterEach {
        assert_eq!(checkpoints.len(), written.checkpoints.len());
    }
    for (name, content) in &checkpoints {
        assert!(written.checkpoints[name] == *content, "{name} differs: {restart:?} {piece}");
    }
    assert!(written.history == contents(&dir, "history"), "the history differs: {restart:?} {piece}");
}

#[tokio::test]
async fn a_follower_holds_what_the_writer_holds_after_every_update() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let written = write(&dir.path().join("writer")).await;
    assert!(written.groups.iter().any(|group| group.records() > 1), "groups of several records");
    // There is history of states, and of scans.
    assert_eq!((written.shown.len() as u64, written.history.len() as u64), (ROUNDS, 2 * ROUNDS));
    let ways = [
        (usize::MAX, Restart::Never),
        (1, Restart::AfterEach),
        (3, Restart::InUpdate),
        (usize::MAX, Restart::InUpdateThatEnded),
    ];
    for (number, (piece, restart)) in ways.into_iter().enumerate() {
        follow(&written, dir.path().join(format!("follower {number}")), piece, restart).await;
    }
}
