//! Tests scans from encoded messages to the map: applied, refused, rolled back, repeated and read again.

use tidemap_grid::{
    index::{CellIndex, TileIndex},
    mask::{Mask, TileMasks},
};
use tidemap_proto::{
    convert::scans::{ScanLimits, TileTable, batch, content_crc, split},
    v1,
};

use super::*;
use crate::intake::{Intake, IntakeLimits, tests::TakeSent as _};

const MINUTE: i64 = HOUR / 60;
const LIMITS: IntakeLimits =
    IntakeLimits { batch: 100, table: 10, scans: ScanLimits { batch_scans: 100, points: 5000, tiles: 30 } };

pub(super) fn grid() -> GridSpec {
    GridSpec { retention: Retention::Forever, ..GridSpec::new(1.0) }
}

pub(super) fn masks(observed: &[u16], occupied: &[u16]) -> TileMasks {
    let set = |cells: &[u16]| {
        let mut mask = Mask::EMPTY;
        cells.iter().for_each(|&cell| mask.insert(cell));
        mask
    };
    TileMasks::new(set(observed), set(occupied)).expect("occupied cells are observed")
}

pub(super) fn tile(x: i32) -> TileIndex {
    TileIndex { x, y: 0, z: 0 }
}

pub(super) type Shown = Vec<(TileIndex, TileMasks)>;

/// A stream of scans, with the state of both sides.
pub(super) struct Scanner {
    pub(super) robot: Robot,
    intake: Intake,
    encoder: TileTable,
    crc: u32,
}

pub(super) async fn scanner(handle: &MapHandle, name: &str, nightly: bool) -> Scanner {
    let robot = hello(handle, name, 0, nightly).await.expect("accepted");
    let opened = robot.opened.clone();
    let intake = Intake::new(opened.durable_sequence, opened.content_crc, LIMITS, handle.spec.grid.as_ref());
    Scanner { robot, intake, encoder: TileTable::default(), crc: opened.content_crc }
}

impl Scanner {
    /// Hands a message over.
    fn send_message(&mut self, handle: &MapHandle, message: v1::ScanBatch) {
        self.intake.begin_sent_scans(message).expect("well formed");
        while let Some(batch) = self.intake.next_scans().expect("well formed") {
            let permit = || Arc::new(Semaphore::new(1)).try_acquire_owned().expect("free");
            let budget = vec![permit(), permit()];
            self.robot.sent = batch.span.last;
            assert!(handle.send(Command::StreamData {
                session: self.robot.opened.session,
                data: StreamData::Scans(batch, budget)
            }));
        }
    }

    /// Sends scans without waiting.
    pub(super) fn send(&mut self, handle: &MapHandle, scans: &[(i64, Shown)]) {
        let first = self.robot.sent + 1;
        let times: Vec<i64> = scans.iter().map(|(time, _)| *time).collect();
        let encoded: Vec<_> = scans.iter().map(|(_, shown)| self.encoder.encode(shown).expect("tiles")).collect();
        for (time, scan) in times.iter().zip(&encoded) {
            self.crc = content_crc(self.crc, *time, scan.digest);
        }
        for piece in split(batch(first, &times, encoded), 4096) {
            self.send_message(handle, piece);
        }
    }

    /// Waits until all sent scans are acknowledged; returns the refusals.
    pub(super) async fn settled(&mut self) -> Vec<(u64, RefusalReason)> {
        let mut all = Vec::new();
        loop {
            match self.robot.events.recv().await {
                Some(SessionEvent::Ack { durable_sequence, refused }) => {
                    all.extend(refused.iter().map(|refused| (refused.sequence, refused.reason)));
                    if durable_sequence == self.robot.sent {
                        return all;
                    }
                }
                other => panic!("{other:?}"),
            }
        }
    }

    async fn show(&mut self, handle: &MapHandle, scans: &[(i64, Shown)]) -> Vec<(u64, RefusalReason)> {
        self.send(handle, scans);
        self.settled().await
    }
}

/// The last state of each tile, in the order of the log, and counters.
pub(super) fn picture(handle: &MapHandle) -> (Vec<(i32, TileMasks)>, u64, u64) {
    let view = handle.view();
    let grid = view.grid().expect("a grid");
    let tiles = (-20..20).filter_map(|x| Some((x, grid.live(grid.find(tile(x))?)?.arrival)));
    (tiles.collect(), grid.scans(), grid.cell_observations())
}

#[tokio::test]
async fn scans_reach_the_map_and_outlive_a_restart() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let before = {
        let bench = bench(dir.path(), NOON);
        let handle = create_with(&bench, Some(grid())).await;
        let mut scanner = scanner(&handle, "r", false).await;
        let full = TileMasks::clipped(Mask::FULL, masks(&[7], &[7]).occupied());
        let scans = [
            (NOON - 3 * MINUTE, vec![(tile(0), masks(&[1, 2], &[2])), (tile(3), full)]),
            (NOON - 2 * MINUTE, vec![(tile(0), masks(&[1, 2], &[])), (tile(3), full)]),
            (NOON - MINUTE, vec![(tile(3), masks(&[5], &[5]))]),
        ];
        assert_eq!(scanner.show(&handle, &scans).await, []);
        let picture = picture(&handle);
        assert_eq!(picture.0, [(0, masks(&[1, 2], &[])), (3, masks(&[5], &[5]))]);
        assert_eq!((picture.1, picture.2), (3, 2 * 514 + 1));
        bench.catalog.stop().await;
        bench.catalog.context().store.close();
        (picture, scanner.crc)
    };
    let bench = bench(dir.path(), NOON);
    let handle = bench.catalog.get("office").expect("there");
    assert_eq!(picture(&handle), before.0);
    // A new stream continues after the durable scans, with a table of its own.
    let mut scanner = scanner(&handle, "r", false).await;
    assert_eq!((scanner.robot.opened.durable_sequence, scanner.crc), (3, before.1));
    assert_eq!(scanner.show(&handle, &[(NOON, vec![(tile(0), masks(&[1, 2], &[1]))])]).await, []);
    assert_eq!(picture(&handle).0, [(0, masks(&[1, 2], &[1])), (3, masks(&[5], &[5]))]);
}

#[tokio::test]
async fn two_streams_show_the_same_cells_and_the_last_one_counts() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench(dir.path(), NOON);
    let handle = create_with(&bench, Some(grid())).await;
    let (mut a, mut b) = (scanner(&handle, "a", false).await, scanner(&handle, "b", false).await);
    for i in 0..20u16 {
        let time = NOON - HOUR + i64::from(i) * MINUTE;
        a.send(&handle, &[(time, vec![(tile(0), masks(&[1, 2, i], &[2])), (tile(1), masks(&[9], &[]))])]);
        b.send(&handle, &[(time + 1, vec![(tile(0), masks(&[2, 3], &[3])), (tile(2), masks(&[i], &[i]))])]);
    }
    assert_eq!((a.settled().await, b.settled().await), (Vec::new(), Vec::new()));
    let (tiles, scans, _) = picture(&handle);
    assert_eq!(tiles, [(0, masks(&[2, 3], &[3])), (1, masks(&[9], &[])), (2, masks(&[19], &[19]))]);
    assert_eq!(scans, 40);
    let view = handle.view();
    let cell = CellIndex { x: 1, y: 0, z: 0 };
    let of_cell = view.grid().expect("a grid").describe(cell).expect("readable").expect("known");
    assert_eq!(of_cell.observations, 20, "seen by one of them alone");
}

#[tokio::test]
async fn refused_scans_use_up_their_numbers_and_are_remembered() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench(dir.path(), NOON);
    let handle = create_with(&bench, Some(grid())).await;
    let mut robot = scanner(&handle, "r", false).await;
    let many: Shown = (0..21).map(|x| (tile(x), masks(&[1], &[]))).collect();
    let scans = [
        (NOON - 9, vec![(tile(0), masks(&[1, 2], &[2]))]),
        // More tiles than the map allows.
        (NOON - 8, many),
        (-5, vec![(tile(0), masks(&[1, 2, 3], &[3]))]),
        (NOON - 7, vec![(tile(0), masks(&[1, 2, 3], &[3]))]),
        (NOON - 6, vec![(tile(0), TileMasks::default())]),
        (NOON - 5, vec![(tile(0), masks(&[1, 2, 3, 4], &[3]))]),
    ];
    let refused = robot.show(&handle, &scans).await;
    let reasons = [(2, RefusalReason::TileLimit), (3, RefusalReason::Time), (5, RefusalReason::Empty)];
    assert_eq!(refused, reasons);
    assert_eq!(picture(&handle), (vec![(0, masks(&[1, 2, 3, 4], &[3]))], 3, 2 + 3 + 4));
    // These times are in the future: the maximum number of tiles wait.
    let ahead: Vec<_> = (0..300).map(|i| (NOON + HOUR + i, vec![(tile(0), masks(&[1], &[]))])).collect();
    let mut refused = Vec::new();
    for some in ahead.chunks(60) {
        refused.extend(robot.show(&handle, some).await);
    }
    assert!(!refused.is_empty() && refused.iter().all(|(_, reason)| *reason == RefusalReason::Time));
    assert_eq!(robot.show(&handle, &[(NOON, vec![(tile(0), masks(&[8], &[8]))])]).await, []);
    assert_eq!(picture(&handle).0, [(0, masks(&[8], &[8]))]);
}

#[tokio::test]
async fn a_map_without_a_grid_takes_no_scan() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench(dir.path(), NOON);
    let handle = create(&bench).await;
    let mut robot = scanner(&handle, "r", false).await;
    let scans = [(NOON - 2, vec![(tile(0), masks(&[1], &[]))]), (NOON - 1, vec![(tile(0), masks(&[1], &[1]))])];
    let refused = robot.show(&handle, &scans).await;
    assert_eq!(refused, [(1, RefusalReason::NoGrid), (2, RefusalReason::NoGrid)]);
    let again = hello(&handle, "r", robot.robot.opened.incarnation, false).await.expect("a reconnection");
    assert_eq!((again.opened.durable_sequence, again.opened.content_crc), (2, robot.crc));
}

#[tokio::test]
async fn a_new_stream_that_sends_known_scans_again_has_them_remembered() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench(dir.path(), NOON);
    let handle = create_with(&bench, Some(grid())).await;
    let mut first = scanner(&handle, "r", false).await;
    let scans: Vec<_> =
        (0..6u16).map(|i| (NOON - 9 + i64::from(i), vec![(tile(0), masks(&[1, 2, i], &[2]))])).collect();
    first.show(&handle, &scans[..4]).await;
    assert!(
        handle
            .send(Command::StreamData { session: first.robot.opened.session, data: StreamData::End { clean: false } })
    );
    let mut second = scanner(&handle, "r", false).await;
    assert_eq!(second.robot.opened.durable_sequence, 4);
    // Encodes the scans from the third on, two of which are known.
    let encoded: Vec<_> = scans[2..].iter().map(|(_, shown)| second.encoder.encode(shown).expect("tiles")).collect();
    let times: Vec<i64> = scans[2..].iter().map(|(time, _)| *time).collect();
    second.send_message(&handle, batch(3, &times, encoded));
    assert_eq!(second.settled().await, []);
    assert_eq!(second.robot.sent, 6);
    assert_eq!(picture(&handle), (vec![(0, masks(&[1, 2, 5], &[2]))], 6, 3 + 2 + 2 + 3 + 3 + 3));
}

#[tokio::test]
async fn what_fails_on_its_way_is_taken_back() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench(dir.path(), NOON);
    let handle = create_with(&bench, Some(grid())).await;
    let mut a = scanner(&handle, "a", false).await;
    let mut c = scanner(&handle, "c", false).await;
    a.show(&handle, &[(NOON - 9, vec![(tile(0), masks(&[1], &[]))])]).await;
    c.show(&handle, &[(NOON - 9, vec![(tile(0), masks(&[2], &[]))])]).await;
    for round in 0..5 {
        let mut b = hello(&handle, &format!("b{round}"), 0, false).await.expect("accepted");
        let mut d = scanner(&handle, &format!("d{round}"), false).await;
        a.send(&handle, &[(NOON - 8, vec![(tile(0), masks(&[1], &[1])), (tile(4), masks(&[1], &[]))])]);
        // The log refuses a negative time, which intake never passes; the events behind it fail with it.
        send(&handle, &mut b, vec![-1]);
        d.send(&handle, &[(NOON - 7, vec![(tile(0), masks(&[3], &[3])), (tile(5 + round), masks(&[2], &[]))])]);
        assert_eq!(a.settled().await, []);
        assert!(matches!(b.events.recv().await, Some(SessionEvent::End(Ending::Storage(_)))));
        // The scans of this stream came during the failure, or before: the stream ends, or is acknowledged.
        let is_taken = matches!(d.robot.events.recv().await, Some(SessionEvent::Ack { .. }));
        let expected = if is_taken { masks(&[3], &[3]) } else { masks(&[1], &[1]) };
        assert!(picture(&handle).0.contains(&(0, expected)));
        // The log takes nothing before all appends in flight are completed.
        while hello(&handle, "probe", 9, false).await.is_err() {}
        // The other streams continue, with tile ids that the failure has moved.
        assert_eq!(c.show(&handle, &[(NOON - 6, vec![(tile(-1 - round), masks(&[6], &[]))])]).await, []);
        let shown = masks(&[1, 7], &[]);
        assert_eq!(a.show(&handle, &[(NOON - 5, vec![(tile(0), shown), (tile(4), masks(&[1], &[]))])]).await, []);
        assert!(picture(&handle).0.contains(&(0, shown)));
        assert!(picture(&handle).0.contains(&(-1 - round, masks(&[6], &[]))));
    }
}

#[tokio::test]
async fn readings_are_cast_beside_the_tiles_of_the_same_stream() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench(dir.path(), NOON);
    let handle = create_with(&bench, Some(grid())).await;
    let mut robot = scanner(&handle, "r", false).await;
    robot.show(&handle, &[(NOON - 9, vec![(tile(0), masks(&[1, 2], &[2]))])]).await;
    let cloud = |xyz_m: Vec<f32>| {
        let pose = Some(v1::Pose { x_m: 0.5, y_m: 0.5, z_m: 0.5, ..v1::Pose::default() });
        let cloud = v1::PointCloud { pose, xyz_m, ..v1::PointCloud::default() };
        v1::Scan { content: Some(v1::scan::Content::Cloud(cloud)) }
    };
    let message = |first_sequence, scan, continues| v1::ScanBatch {
        first_sequence,
        first_time_nanos: NOON - 8,
        time_deltas: vec![0],
        scans: vec![scan],
        continues,
        ..v1::ScanBatch::default()
    };
    robot.send_message(&handle, message(2, cloud(vec![2.0, 0.0]), true));
    robot.send_message(&handle, message(2, cloud(vec![0.0]), false));
    assert_eq!(robot.settled().await, []);
    assert_eq!(picture(&handle).0, [(0, masks(&[0, 1, 2], &[2]))]);
    robot.send_message(&handle, message(3, cloud(vec![1e9, 0.0, 0.0]), false));
    assert_eq!(robot.settled().await, [(3, RefusalReason::Scan)]);
    // The stream's own tiles are as the stream showed them.
    assert_eq!(robot.show(&handle, &[(NOON - 7, vec![(tile(0), masks(&[1, 2, 3], &[2]))])]).await, []);
    assert_eq!(picture(&handle).0, [(0, masks(&[1, 2, 3], &[2]))]);
}

#[tokio::test]
async fn updates_of_scans_are_saved_with_their_history_and_paged_out() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let day = |day: i64| NOON - 30 * 24 * HOUR + day * 24 * HOUR;
    let scans = |from: i64| -> Vec<(i64, Shown)> {
        let at = |i: i64| (day(from) + i * MINUTE, vec![(tile(0), masks(&[1, 2], if i < 30 { &[2] } else { &[] }))]);
        (0..40).map(at).collect()
    };
    let description = {
        let bench = bench_with(dir.path(), NOON, |context| context.tile_cache_bytes = 1);
        let handle = create_with(&bench, Some(grid())).await;
        let mut robot = scanner(&handle, "r", true).await;
        for from in 0..4 {
            assert_eq!(robot.show(&handle, &scans(from)).await, []);
        }
        // Three days have closed in the time of the data.
        for _ in 0..600 {
            if handle.view().cut_nanos() == Some(day(3) - 12 * HOUR) {
                break;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        let report = bench.jobs.list().iter().find_map(|job| job.report()).expect("a report");
        assert_eq!(report.cells.map(|cells| (cells.changed_cells, cells.tiles)), Some((1, 1)));
        let totals = handle.tile_totals();
        assert_eq!(totals.changed_cells, 1);
        bench.catalog.stop().await;
        bench.catalog.context().store.close();
        describe(&handle)
    };
    let bench = bench_with(dir.path(), NOON, |context| context.tile_cache_bytes = 1);
    let handle = bench.catalog.get("office").expect("there");
    assert_eq!(describe(&handle), description);
    let history = bench.catalog.context().store.history(handle.id).expect("known");
    let kept: u64 =
        history.grid_days(0, i64::MAX, None).map(|days| days.expect("readable").outliers.scans.len() as u64).sum();
    assert_eq!(kept, 120);
    // The data that it learns next is saved, and then read from the disk, by queries and by the next update.
    // Each day has two bins of half an hour.
    for (round, folded) in [(1, 8), (2, 10)] {
        let job = bench.jobs.create(handle.spec.name.clone(), UpdateCause::Request, NOON);
        assert!(handle.send(Command::Update { until_nanos: None, cause: UpdateCause::Request, job: Arc::clone(&job) }));
        for _ in 0..600 {
            if job.has_ended() {
                break;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        // The start may have found a missed midnight, and updated before the request.
        let taken: u64 = bench.jobs.list().iter().map(|job| job.status().observations).sum();
        assert_eq!(taken, 40 * round);
        let view = handle.view();
        let cell = CellIndex { x: 2, y: 0, z: 0 };
        let cell = view.grid().expect("a grid").describe(cell).expect("readable").expect("known");
        assert_eq!((cell.folded, cell.changed), (folded, true));
        if round == 1 {
            let description = describe(&handle);
            for _ in 0..600 {
                if handle.tile_bytes() == 0 {
                    break;
                }
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
            assert_eq!((handle.tile_bytes(), describe(&handle)), (0, description));
            assert_eq!(scanner(&handle, "other", false).await.show(&handle, &scans(5)).await, []);
        }
    }
}

/// The description of a cell, as text.
fn describe(handle: &MapHandle) -> String {
    let view = handle.view();
    let cell = view.grid().expect("a grid").describe(CellIndex { x: 2, y: 0, z: 0 }).expect("readable");
    format!("{} {cell:?}", view.generation())
}

#[tokio::test]
async fn as_many_tiles_wait_for_their_time_as_may_also_after_a_restart_and_no_longer_than_that() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let ahead = |from: i64| -> Vec<(i64, Shown)> {
        (from..from + 90).map(|i| (NOON + HOUR + i, vec![(tile(0), masks(&[1], &[]))])).collect()
    };
    {
        let bench = bench(dir.path(), NOON);
        let handle = create_with(&bench, Some(grid())).await;
        let mut robot = scanner(&handle, "r", false).await;
        assert_eq!(robot.show(&handle, &ahead(0)).await, []);
        // 250 may wait: each scan counts a scan and a tile, and a tile in flight.
        assert_eq!(robot.show(&handle, &ahead(90)).await.len(), 90 - (250 - 2 * 90));
        bench.catalog.stop().await;
        bench.catalog.context().store.close();
    }
    let bench = bench(dir.path(), NOON);
    let handle = bench.catalog.get("office").expect("there");
    let mut robot = scanner(&handle, "r", false).await;
    assert_eq!(robot.show(&handle, &ahead(180)).await.len(), 90, "as many as before");
    bench.clock.0.store(NOON + 2 * HOUR, Ordering::SeqCst);
    let job = bench.jobs.create(handle.spec.name.clone(), UpdateCause::Request, NOON);
    assert!(handle.send(Command::Update { until_nanos: None, cause: UpdateCause::Request, job }));
    ended(&bench, 1).await;
    bench.clock.0.store(NOON, Ordering::SeqCst);
    assert_eq!(robot.show(&handle, &ahead(270)).await, [], "those before have gone in");
}
