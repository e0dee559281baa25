//! Tests a writer that the test drives step by step: what it takes, and what waits.

use super::{
    scans::{Scanner, grid, masks, picture, scanner, tile},
    *,
};

/// A writer that executes command by command.
pub(super) struct Bare {
    pub(super) bench: Bench,
    pub(super) writer: Writer,
    pub(super) inbox: mpsc::Receiver<Command>,
    pub(super) handle: Arc<MapHandle>,
    /// Completions of the log that the writer has not received.
    kept: Vec<Command>,
}

pub(super) fn bare(dir: &Path, now: i64, grid: Option<GridSpec>) -> Bare {
    let bench = bench(dir, now);
    let context = bench.catalog.context().clone();
    let spec = spec_with(grid);
    let id = context.store.create_map(&spec).expect("created");
    let log = Arc::new(context.store.open_map(id, &spec).expect("opened").log);
    let mut map = LiveMap::new(Arc::new(spec));
    let (handle, endpoints) =
        MapHandle::with_endpoints((id, None), Arc::clone(map.spec()), map.publish(), &context.clock);
    let restored = RestoredMap { map, log, is_shared: false, logged: None, unsaved: None, begun: None };
    let (writer, inbox) = build(endpoints, context, id, restored);
    Bare { bench, writer, inbox, handle: Arc::new(handle), kept: Vec::new() }
}

impl Bare {
    /// Executes the received commands, except the completions of the log.
    pub(super) fn take_in(&mut self) {
        for command in self.inbox.try_iter().collect::<Vec<_>>() {
            match command {
                Command::Committed(_) => self.kept.push(command),
                command => self.writer.handle(command),
            }
        }
    }

    /// Continues until a condition holds.
    pub(super) fn go_on(&mut self, until: impl Fn(&Writer) -> bool) {
        for command in std::mem::take(&mut self.kept) {
            self.writer.handle(command);
        }
        self.writer.pump();
        while !until(&self.writer) {
            let command = self.inbox.recv_timeout(Duration::from_secs(60)).expect("something goes on");
            self.writer.handle(command);
            self.writer.pump();
        }
    }

    async fn answered<T>(&mut self, request: impl Future<Output = T>) -> T {
        let mut request = std::pin::pin!(request);
        loop {
            tokio::select! {
                biased;
                answer = &mut request => return answer,
                () = tokio::task::yield_now() => self.take_in(),
            }
        }
    }

    async fn scanner(&mut self, name: &str) -> Scanner {
        let handle = Arc::clone(&self.handle);
        self.answered(scanner(&handle, name, false)).await
    }

    pub(super) async fn robot(&mut self, name: &str) -> Robot {
        let handle = Arc::clone(&self.handle);
        self.answered(hello(&handle, name, 0, false)).await.expect("accepted")
    }

    /// Sends observations, which go to the log or to the backlog.
    pub(super) fn observe(&mut self, robot: &mut Robot, times: Vec<i64>) {
        send(&self.handle, robot, times);
        self.take_in();
    }
}

#[tokio::test]
async fn scans_wait_while_those_on_their_way_take_too_much_memory() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let mut bare = bare(dir.path(), NOON, Some(grid()));
    bare.writer.context.max_pending = PendingLimits { observations: u64::MAX, changes: u64::MAX };
    bare.writer.appends.set_bytes_max(4000);
    let (mut a, mut b) = (bare.scanner("a").await, bare.scanner("b").await);
    let all: Vec<u16> = (0..512).collect();
    for i in 0..20 {
        // Each scan is equal for its stream, but a change for the map.
        a.send(&bare.handle, &[(NOON - HOUR + i, vec![(tile(0), masks(&all, &all))])]);
        b.send(&bare.handle, &[(NOON - HOUR + i, vec![(tile(0), masks(&[1], &[]))])]);
        bare.take_in();
        assert!(bare.writer.appends.bytes() <= 4000 + 5000, "{}", bare.writer.appends.bytes());
    }
    assert!(bare.writer.backlog.len() >= 36, "{}", bare.writer.backlog.len());
    // The end of a stream waits behind its scans, and the next stream of the key waits behind that end.
    assert!(
        bare.handle
            .send(Command::StreamData { session: b.robot.opened.session, data: StreamData::End { clean: true } })
    );
    let (reply, mut answer) = oneshot::channel();
    let (events, _kept) = events::unbounded_channel();
    let key = ProducerKey::new("b", "").expect("valid");
    assert!(bare.handle.send(Command::Hello(Hello {
        client: String::new(),
        key,
        incarnation: 0,
        probe: None,
        takes_over: None,
        nightly: false,
        sensor: None,
        events,
        reply
    })));
    bare.take_in();
    assert!(matches!(bare.writer.backlog.newest(), Some(StreamData::End { .. })));
    assert!(answer.try_recv().is_err());
    bare.go_on(|writer| writer.backlog.is_empty() && writer.appends.is_empty());
    assert_eq!(a.settled().await, []);
    assert_eq!(bare.writer.appends.bytes(), 0);
    assert_eq!(picture(&bare.handle), (vec![(0, masks(&[1], &[]))], 40, 20 * 513));
    let opened = answer.try_recv().expect("an answer").expect("accepted");
    assert_eq!(opened.durable_sequence, 20);
}

#[tokio::test]
async fn what_waits_at_a_stop_is_not_acknowledged() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let mut bare = bare(dir.path(), NOON, None);
    let mut robot = bare.robot("r").await;
    bare.observe(&mut robot, vec![NOON; 2500]);
    bare.go_on(|writer| writer.appends.are_update_starts());
    bare.observe(&mut robot, vec![NOON]);
    assert_eq!(bare.writer.backlog.len(), 1);
    let (done, _stopped) = oneshot::channel();
    assert!(bare.handle.send(Command::Stop { ending: Ending::Shutdown, done }));
    let Bare { bench: _bench, writer, inbox, kept, .. } = bare;
    assert!(kept.is_empty() || writer.appends.len() == kept.len());
    for command in kept {
        assert!(writer.commands.send(command).is_ok());
    }
    writer.run(&inbox);
    assert_eq!(robot.events.recv().await, Some(SessionEvent::Ack { durable_sequence: 2500, refused: Vec::new() }));
    assert_eq!(robot.events.recv().await, Some(SessionEvent::End(Ending::Shutdown)));
    assert_eq!(robot.events.recv().await, None);
}

#[tokio::test]
async fn observations_wait_for_the_update_that_makes_room() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let mut bare = bare(dir.path(), NOON, None);
    let mut robot = bare.robot("r").await;
    bare.observe(&mut robot, vec![NOON; 2500]);
    bare.go_on(|writer| writer.map.pending() == 2500);
    bare.observe(&mut robot, vec![NOON + 1]);
    bare.observe(&mut robot, vec![NOON + 2]);
    assert_eq!(bare.writer.backlog.len(), 2);
    bare.writer.pump();
    assert_eq!(bare.writer.backlog.len(), 2, "an update makes room");
    bare.go_on(|writer| writer.backlog.is_empty() && writer.appends.is_empty());
    assert_eq!((bare.writer.map.generation(), bare.writer.map.pending()), (1, 2));
}

#[tokio::test]
async fn observations_that_no_update_can_take_yet_make_none_due_and_hold_nothing_up() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let mut bare = bare(dir.path(), NOON + HOUR, None);
    let mut robot = bare.robot("r").await;
    bare.observe(&mut robot, vec![NOON + HOUR; 2500]);
    bare.bench.clock.0.store(NOON, Ordering::SeqCst);
    bare.go_on(|writer| writer.appends.is_empty());
    bare.observe(&mut robot, vec![NOON + HOUR]);
    bare.observe(&mut robot, vec![NOON + HOUR]);
    assert_eq!(bare.writer.backlog.len(), 2);
    bare.writer.pump();
    assert_eq!(bare.writer.backlog.len(), 1, "one at a time");
    bare.go_on(|writer| writer.backlog.is_empty() && writer.appends.is_empty());
    assert_eq!(bare.bench.jobs.list().len(), 0);
    bare.bench.clock.0.store(NOON + HOUR, Ordering::SeqCst);
    bare.go_on(|writer| writer.map.generation() == 1);
    assert_eq!(bare.writer.map.pending(), 0);
}
