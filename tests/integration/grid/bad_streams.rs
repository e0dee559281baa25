//! Messages of scans that end the stream: each is answered with the reason, nothing of it is kept,
//! and the daemon and other streams continue.

use tidemap_client::maps::GridSpec;
use tidemap_proto::v1::{
    GoodbyeReason, ObserveRequest, PointCloud, ScanBatch, TileScan, observe_request::Message, scan::Content,
};
use tidemap_tests::{
    daemon::{Daemon, Launch},
    stream::{RawStream, columns, hello},
};
use tonic::Code;

use super::{
    MAP,
    bad_scans::{cloud, message, opened, shows},
    new_map, summary,
};

/// The end of a stream, and the expected words of the message.
struct Ending(GoodbyeReason, Code, Vec<&'static str>);

fn malformed(words: &[&'static str]) -> Ending {
    Ending(GoodbyeReason::Invalid, Code::InvalidArgument, words.to_vec())
}

fn over_limit(words: &[&'static str]) -> Ending {
    Ending(GoodbyeReason::Invalid, Code::ResourceExhausted, words.to_vec())
}

fn points(count: usize) -> Content {
    Content::Cloud(cloud(&[0.5, 0.25, 0.125].repeat(count)))
}

fn part(message: ScanBatch) -> ScanBatch {
    ScanBatch { continues: true, ..message }
}

/// Messages after a first good scan, which is number 1 and shows slot 0; the last ends the stream.
fn cases() -> Vec<(&'static str, Vec<Message>, Ending)> {
    const LIMIT: i32 = 1 << 20;
    let scans = |messages: Vec<ScanBatch>| messages.into_iter().map(Message::Scans).collect::<Vec<_>>();
    let one = |message: ScanBatch| vec![Message::Scans(message)];
    let shown = || vec![shows(&[0; 64])];
    let with_tiles = |tiles: &[i32]| one(message(2, tiles, shown()));
    let open = || part(message(2, &[], vec![points(10)]));
    let later = ScanBatch { first_time_nanos: 1, ..message(2, &[], vec![points(10)]) };
    let seventeen = || (0..17).map(|_| shows(&[0; 64])).collect::<Vec<_>>();
    let sixty: Vec<i32> = (1..=64).flat_map(|x| [x, 0, 0]).collect();
    vec![
        ("a tile beyond the limit", with_tiles(&[LIMIT + 1, 0, 0]), malformed(&["new_tiles[0]", "1048577"])),
        ("a tile below it", with_tiles(&[3, 0, 0, 0, -LIMIT - 1, 0]), malformed(&["new_tiles[3]", "-1048577"])),
        ("a tile at the end of i32", with_tiles(&[0, 0, i32::MIN]), malformed(&["new_tiles[0]", "-2147483648"])),
        ("a tile again", with_tiles(&[0, 0, 0]), malformed(&["new_tiles[0]", "0, 0, 0", "already"])),
        ("a tile twice", with_tiles(&[1, 0, 0, 1, 0, 0]), malformed(&["new_tiles[3]", "1, 0, 0", "already"])),
        ("half a tile", with_tiles(&[1, 0]), malformed(&["new_tiles", "2"])),
        ("too many tiles", with_tiles(&sixty), over_limit(&["65", "64", "max_scan_tiles"])),
        ("no scan", one(message(2, &[], vec![])), malformed(&["scans"])),
        ("too many scans", one(message(2, &[], seventeen())), over_limit(&["17", "16", "max_batch_scans"])),
        (
            "times that are missing",
            one(ScanBatch { time_deltas: vec![], ..message(2, &[], shown()) }),
            malformed(&["time_deltas", "0"]),
        ),
        (
            "a unit beyond all times",
            one(ScanBatch { time_unit_nanos: u64::MAX, ..message(2, &[], shown()) }),
            malformed(&["time_unit_nanos", "18446744073709551615"]),
        ),
        ("number 0", one(message(0, &[], shown())), malformed(&["first_sequence", "0"])),
        (
            "a gap",
            one(message(4, &[], shown())),
            Ending(GoodbyeReason::OutOfSequence, Code::OutOfRange, vec!["4", "2"]),
        ),
        ("a cloud too large", one(message(2, &[], vec![points(101)])), over_limit(&["101", "100", "max_scan_points"])),
        (
            "a cloud that grows too large",
            scans(vec![part(message(2, &[], vec![points(60)])), message(2, &[], vec![points(60)])]),
            over_limit(&["120", "100", "max_scan_points"]),
        ),
        (
            "a scan that goes on with an earlier number",
            scans(vec![open(), message(1, &[], vec![points(10)])]),
            malformed(&["first_sequence", "1", "scan 2"]),
        ),
        (
            "a scan that goes on with a later number",
            scans(vec![open(), message(3, &[], vec![points(10)])]),
            Ending(GoodbyeReason::OutOfSequence, Code::OutOfRange, vec!["3", "2"]),
        ),
        ("a scan that goes on at another time", scans(vec![open(), later]), malformed(&["time", "1", "scan 2"])),
        (
            "a scan that goes on as another kind",
            scans(vec![open(), message(2, &[], shown())]),
            malformed(&["content", "scan 2", "kind"]),
        ),
        (
            "observations within a scan",
            vec![Message::Scans(open()), Message::Batch(observation(2))],
            malformed(&["scan 2", "observations"]),
        ),
    ]
}

fn observation(first_sequence: u64) -> tidemap_proto::v1::ObservationBatch {
    let observations = Some(columns(&["door"], &[(0, 1_000, 1.0)]));
    tidemap_proto::v1::ObservationBatch { first_sequence, observations }
}

/// A daemon with low limits, and a first scan in its map.
async fn limited() -> (tempfile::TempDir, Daemon) {
    let data = tempfile::tempdir().expect("a folder");
    let launch = Launch::on(data.path()).setting("max_scan_points", 100).setting("max_scan_tiles", 64);
    let daemon = launch.setting("max_batch_scans", 16).setting("max_message_bytes", 16 << 10).start();
    let grid = GridSpec::new(0.1);
    daemon.client().create_map(new_map(grid)).await.expect("a new map");
    (data, daemon)
}

async fn check(mut stream: RawStream, what: &str, Ending(reason, code, words): Ending) {
    let ended = stream.end().await;
    let found = ended.goodbye.as_ref().map(|goodbye| (goodbye.reason(), goodbye.durable_sequence));
    assert_eq!(found, Some((reason, 1)), "{what}: {ended:?}");
    let status = ended.error();
    assert_eq!(status.code(), code, "{what}: {status:?}");
    for word in words {
        assert!(status.message().contains(word), "{what}: {word:?} is not in {status:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn grid_messages_that_are_wrong_end_the_stream_and_nothing_of_them_is_kept() {
    let (_data, daemon) = limited().await;
    let mut neighbour = RawStream::open(&daemon.grpc, hello("neighbour", MAP)).await.expect("a Welcome").0;
    let mut expected = 0;
    for (number, (what, messages, ending)) in (1..).zip(cases()) {
        // Each with its own producer, so that each begins anew.
        let hello = hello(&format!("robot-{number}"), MAP);
        let mut stream = RawStream::open(&daemon.grpc, hello).await.expect("a Welcome").0;
        stream.send_message(Message::Scans(message(1, &[0, 0, 0], vec![shows(&[0; 64])]))).await;
        assert_eq!(stream.acknowledged(1).await.expect("taken"), [], "{what}");
        for message in messages {
            stream.send_message(message).await;
        }
        check(stream, what, ending).await;
        // Other streams are not affected.
        let tiles: &[i32] = if number == 1 { &[0, 0, 0] } else { &[] };
        neighbour.send_message(Message::Scans(message(number, tiles, vec![shows(&[0; 64])]))).await;
        assert_eq!(neighbour.acknowledged(number).await.expect("a stream goes on"), [], "{what}");
        expected += 2;
        assert_eq!(summary(&daemon).await.scans, expected, "{what}");
    }
    let log = daemon.stop_in_order();
    assert!(!log.contains("panicked"), "{log}");
}

#[tokio::test(flavor = "multi_thread")]
async fn grid_message_over_the_limit_of_bytes_ends_the_stream() {
    let (_data, daemon) = limited().await;
    let mut stream = opened(&daemon).await;
    stream.send_message(Message::Scans(message(1, &[0, 0, 0], vec![shows(&[0; 64])]))).await;
    stream.acknowledged(1).await.expect("taken");
    let huge = Content::Tiles(TileScan { seen: vec![0, 1], occupied: vec![7; 40_000], ..TileScan::default() });
    let request = ObserveRequest { message: Some(Message::Scans(message(2, &[], vec![huge]))) };
    stream.send(request).await;
    let ended = stream.end().await;
    assert_eq!(ended.goodbye.as_ref().map(|goodbye| goodbye.reason()), Some(GoodbyeReason::Invalid), "{ended:?}");
    let status = ended.error();
    let words = ["bytes of one message", "16384", "max_message_bytes"];
    assert!(words.iter().all(|word| status.message().contains(word)), "{words:?} are not in {status:?}");
    assert_eq!(summary(&daemon).await.scans, 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn grid_scan_whose_parts_come_one_by_one_counts_when_it_is_whole() {
    let (data, daemon) = limited().await;
    let mut stream = opened(&daemon).await;
    let piece = |xyz_m: &[f32]| {
        // Pose and limits are those of the first part.
        let elsewhere = PointCloud { pose: None, max_range_m: 0.25, ..cloud(xyz_m) };
        message(1, &[], vec![Content::Cloud(elsewhere)])
    };
    let first = message(1, &[], vec![Content::Cloud(cloud(&[1.0, 0.0, 0.0]))]);
    stream.send_message(Message::Scans(part(first.clone()))).await;
    stream.send_message(Message::Scans(part(piece(&[0.0, 1.0, 0.0])))).await;
    assert_eq!(summary(&daemon).await.scans, 0, "it is not whole");
    // The stream breaks in the middle of the scan: nothing of it is kept.
    drop(stream);
    daemon.kill();
    let daemon = Launch::on(data.path()).start();
    let (mut stream, welcome) = RawStream::open(&daemon.grpc, hello("robot", MAP)).await.expect("a Welcome");
    assert_eq!((welcome.durable_sequence, summary(&daemon).await.scans), (0, 0));
    stream.send_message(Message::Scans(part(first))).await;
    stream.send_message(Message::Scans(piece(&[0.0, 1.0, 0.0]))).await;
    assert_eq!(stream.acknowledged(1).await.expect("taken"), []);
    let latest = super::model(tidemap_client::queries::ModelKind::Latest, None);
    let grid = super::predicted(&daemon, 1_741_000_000_000_000_000, latest).await;
    for (cell, value) in [([10, 0, 0], 1.0), ([0, 10, 0], 1.0), ([9, 0, 0], 0.0), ([0, 9, 0], 0.0)] {
        assert_eq!(grid.cell(cell).value(), Some(value), "{cell:?}");
    }
}
