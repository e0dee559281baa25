//! Single bad scans: each is refused with its reason and the value, uses up its number, and changes
//! nothing of the stream's tiles.

use tidemap_client::maps::{CellBox, GridSpec};
use tidemap_proto::v1::{
    ObservationBatch, PointCloud, Pose, RangeScan, RefusalReason, Scan, ScanBatch, TileScan, observe_request::Message,
    scan::Content,
};
use tidemap_tests::{
    daemon::{Daemon, Launch},
    stream::{RawStream, columns, hello},
};

use super::{MAP, model, office, predicted, summary};
use tidemap_client::queries::{CellPrediction, ModelKind};

const NOON_NANOS: i64 = 1_741_000_000_000_000_000;

/// 0.1 m, within 16 cells of the origin along x and y.
fn small() -> GridSpec {
    let extent = Some(CellBox { min: [-16, -16, 0].into(), max: [16, 16, 8].into() });
    GridSpec { frame_id: "floor".to_owned(), extent, ..GridSpec::new(0.1) }
}

pub(crate) async fn opened(daemon: &Daemon) -> RawStream {
    let opened = RawStream::open(&daemon.grpc, hello("robot", MAP)).await;
    opened.unwrap_or_else(|ended| panic!("no Welcome: {ended:?}")).0
}

/// A message of scans, a second apart.
pub(crate) fn message(first_sequence: u64, new_tiles: &[i32], scans: Vec<Content>) -> ScanBatch {
    let mut time_deltas = vec![1; scans.len()];
    if let Some(first) = time_deltas.first_mut() {
        *first = 0;
    }
    ScanBatch {
        first_sequence,
        new_tiles: new_tiles.to_vec(),
        time_unit_nanos: 1_000_000_000,
        first_time_nanos: NOON_NANOS + first_sequence.cast_signed() * 1_000_000_000,
        time_deltas,
        scans: scans.into_iter().map(|content| Scan { content: Some(content) }).collect(),
        ..ScanBatch::default()
    }
}

/// A scan of all cells of slot 0, with these occupied.
pub(crate) fn shows(occupied: &[u8; 64]) -> Content {
    let scan = TileScan { seen: vec![0, 1], masked: vec![0], occupied: occupied.to_vec(), ..TileScan::default() };
    Content::Tiles(scan)
}

/// A cloud of points from the middle of cell (0, 0, 0).
pub(crate) fn cloud(xyz_m: &[f32]) -> PointCloud {
    let pose = Some(Pose { x_m: 0.05, y_m: 0.05, z_m: 0.05, qw: 1.0, ..Pose::default() });
    PointCloud { pose, xyz_m: xyz_m.to_vec(), ..PointCloud::default() }
}

fn ranges() -> RangeScan {
    let PointCloud { pose, .. } = cloud(&[]);
    RangeScan { pose, angle_increment_rad: 0.1, ranges_m: vec![1.0; 3], max_range_m: 4.0, ..RangeScan::default() }
}

fn tiles(scan: TileScan) -> Content {
    Content::Tiles(scan)
}

/// Scans that are refused, with the reason and what it names.
fn wrong() -> Vec<(Content, RefusalReason, Vec<&'static str>)> {
    use RefusalReason::{Empty, Frame, Scan};
    let seen = || TileScan { seen: vec![0, 1], ..TileScan::default() };
    let masks = |length: usize| TileScan { masked: vec![0], occupied: vec![0; length], ..seen() };
    let posed = |qw: f64| Some(Pose { qw, ..Pose::default() });
    let nan = f32::NAN;
    let in_frame = |frame: &str| PointCloud { frame_id: frame.to_owned(), ..cloud(&[1.0, 0.0, 0.0]) };
    vec![
        (tiles(masks(65)), Scan, vec!["occupied", "65", "64"]),
        (tiles(masks(128)), Scan, vec!["occupied", "128", "64"]),
        (tiles(masks(63)), Scan, vec!["occupied", "63", "64"]),
        (tiles(TileScan { observed: vec![255; 65], ..masks(64) }), Scan, vec!["observed", "65", "64"]),
        (tiles(TileScan { masked: vec![0, 0], occupied: vec![0; 128], ..seen() }), Scan, vec!["masked", "slot 0"]),
        // Place 9 was never shown as observed of slot 1.
        (
            tiles(TileScan { seen: vec![1, 1], occupied_flips: vec![512 + 9], ..TileScan::default() }),
            Scan,
            vec!["place 9", "slot 1", "not observed"],
        ),
        (
            tiles(TileScan { observed: vec![0; 64], ..TileScan { occupied: vec![1; 64], ..masks(64) } }),
            Scan,
            vec!["place 0", "slot 0", "not observed"],
        ),
        // A cell that is no longer observed must not be left occupied: place 3 is.
        (tiles(TileScan { observed_flips: vec![3], ..seen() }), Scan, vec!["place 3", "slot 0", "not observed"]),
        (tiles(TileScan { seen: vec![0, 9], ..seen() }), Scan, vec!["seen", "9", "2 tiles"]),
        (tiles(TileScan { seen: vec![0, 0], ..seen() }), Scan, vec!["seen", "0 slots"]),
        (tiles(TileScan { seen: vec![0], ..seen() }), Scan, vec!["seen", "pairs"]),
        (tiles(TileScan { masked: vec![7], occupied: vec![0; 64], ..seen() }), Scan, vec!["slot 7"]),
        (tiles(TileScan { occupied_flips: vec![5_000], ..seen() }), Scan, vec!["slot 9"]),
        (tiles(TileScan { occupied_flips: vec![4, 0], ..seen() }), Scan, vec!["occupied_flips", "4", "twice"]),
        (tiles(TileScan { occupied_flips: vec![4, u32::MAX], ..seen() }), Scan, vec!["4294967295"]),
        // Slot 1 has not changed, and is not seen.
        (tiles(TileScan { observed_flips: vec![512], ..seen() }), Scan, vec!["slot 1", "not seen"]),
        (Content::Cloud(cloud(&[nan, 0.0, 0.0, 1.0, f32::INFINITY, 2.0])), Empty, vec!["2 points", "finite"]),
        (Content::Cloud(cloud(&[])), Empty, vec!["0 points"]),
        (Content::Cloud(cloud(&[1.0, 2.0])), Scan, vec!["xyz_m", "2"]),
        (Content::Cloud(PointCloud { pose: posed(2.0), ..cloud(&[1.0; 3]) }), Scan, vec!["pose", "2.0000"]),
        (Content::Cloud(PointCloud { pose: posed(nan.into()), ..cloud(&[1.0; 3]) }), Scan, vec!["pose", "NaN"]),
        (Content::Cloud(PointCloud { max_range_m: nan, ..cloud(&[1.0; 3]) }), Scan, vec!["max_range_m", "NaN"]),
        (Content::Cloud(PointCloud { min_range_m: -1.0, ..cloud(&[1.0; 3]) }), Scan, vec!["min_range_m", "-1"]),
        (Content::Cloud(PointCloud { min_range_m: 9.0, ..cloud(&[1.0; 3]) }), Empty, vec!["min_range_m"]),
        (Content::Cloud(in_frame("odom")), Frame, vec!["odom", "floor"]),
        (Content::Ranges(RangeScan { frame_id: "map".to_owned(), ..ranges() }), Frame, vec!["map", "floor"]),
        (Content::Ranges(RangeScan { max_range_m: 0.0, ..ranges() }), Scan, vec!["max_range_m", "0"]),
        (Content::Ranges(RangeScan { max_range_m: f32::INFINITY, ..ranges() }), Scan, vec!["max_range_m", "inf"]),
        (Content::Ranges(RangeScan { angle_min_rad: nan, ..ranges() }), Scan, vec!["angle_min_rad", "NaN"]),
        (Content::Ranges(RangeScan { ranges_m: vec![nan; 3], ..ranges() }), Empty, vec!["3 ranges"]),
        // All of it lies outside of the grid's extent.
        (
            Content::Cloud(PointCloud { pose: Some(Pose { z_m: 50.0, ..Pose::default() }), ..cloud(&[1.0; 3]) }),
            Empty,
            vec!["extent"],
        ),
    ]
}

#[tokio::test(flavor = "multi_thread")]
async fn grid_scans_that_are_wrong_are_refused_one_by_one() {
    let (data, daemon) = office(small()).await;
    let mut stream = opened(&daemon).await;
    let mut occupied = [0; 64];
    occupied[0] = 0b1000;
    stream.send_message(Message::Scans(message(1, &[0, 0, 0, 1, 0, 0], vec![shows(&occupied)]))).await;
    assert_eq!(stream.acknowledged(1).await.expect("taken"), []);
    // The scans are sent one by one, and then all in one message with a good scan at its end.
    let mut sequence = 1;
    for (content, reason, words) in wrong() {
        sequence += 1;
        let what = format!("{content:?}");
        stream.send_message(Message::Scans(message(sequence, &[], vec![content]))).await;
        let refused = stream.acknowledged(sequence).await.expect("the stream goes on");
        assert_eq!(refused.len(), 1, "{what} should be refused");
        assert_eq!((refused[0].sequence, refused[0].reason()), (sequence, reason), "{what}: {refused:?}");
        for word in words {
            assert!(refused[0].detail.contains(word), "{word:?} is not in {:?} of {what}", refused[0].detail);
        }
        assert!(refused[0].detail.chars().count() <= 200, "{refused:?}");
    }
    let all: Vec<Content> = wrong().into_iter().map(|(content, ..)| content).collect();
    let count = all.len() as u64;
    // The refused scans have used its slots, so all cells are sent again.
    let (mut observed, mut occupied) = (vec![0xFF; 64], vec![0; 128]);
    observed.extend(std::iter::once(1).chain([0; 63]));
    occupied[0] = 0b10_1000;
    let good = tiles(TileScan { seen: vec![0, 2], masked: vec![0, 1], observed, occupied, ..TileScan::default() });
    let last = sequence + count + 1;
    stream.send_message(Message::Scans(message(sequence + 1, &[], all.into_iter().chain([good]).collect()))).await;
    let refused = stream.acknowledged(last).await.expect("the stream goes on");
    let numbers: Vec<u64> = refused.iter().map(|refusal| refusal.sequence).collect();
    assert_eq!(numbers, (sequence + 1..last).collect::<Vec<u64>>());
    drop(stream);

    let mut daemon = daemon;
    for restart in [false, true] {
        if restart {
            daemon.kill();
            daemon = Launch::on(data.path()).start();
        }
        let found = summary(&daemon).await;
        assert_eq!((found.scans, found.cell_observations), (2, 512 + 512 + 1), "refused scans do not count");
        let latest = predicted(&daemon, NOON_NANOS, model(ModelKind::Latest, None)).await;
        let cells = [[3, 0, 0], [5, 0, 0], [4, 0, 0], [8, 0, 0], [9, 0, 0]].map(|cell| latest.cell(cell).value());
        assert_eq!(cells, [Some(1.0), Some(1.0), Some(0.0), Some(0.0), None]);
        assert_eq!(latest.cell([-1, 0, 0]), CellPrediction::Unknown);
        let (mut again, welcome) = RawStream::open(&daemon.grpc, hello("robot", MAP)).await.expect("a Welcome");
        assert_eq!(welcome.durable_sequence, last, "a refused scan uses up its number");
        again.close();
        again.end().await;
    }
    let log = daemon.stop_in_order();
    assert!(!log.contains("panicked"), "{log}");
}

#[tokio::test(flavor = "multi_thread")]
async fn grid_scans_and_observations_share_one_sequence() {
    let (_data, daemon) = office(small()).await;
    let mut stream = opened(&daemon).await;
    stream.send_message(Message::Scans(message(1, &[0, 0, 0], vec![shows(&[0; 64]), shows(&[1; 64])]))).await;
    stream.batch(3, columns(&["door"], &[(0, NOON_NANOS, 1.0)])).await;
    stream.send_message(Message::Scans(message(4, &[], vec![shows(&[0; 64])]))).await;
    assert_eq!(stream.acknowledged(4).await.expect("taken"), []);
    // All scans again, as after a broken connection.
    stream.send_message(Message::Scans(message(1, &[], vec![shows(&[0; 64]), shows(&[1; 64])]))).await;
    let door = Some(columns(&[], &[(0, NOON_NANOS, 1.0)]));
    stream.send_message(Message::Batch(ObservationBatch { first_sequence: 3, observations: door })).await;
    stream.send_message(Message::Scans(message(4, &[], vec![shows(&[0; 64]), shows(&[2; 64])]))).await;
    assert_eq!(stream.acknowledged(5).await.expect("taken"), []);
    let map = daemon.client().map(MAP).await.expect("the map");
    assert_eq!((map.observations, summary(&daemon).await.scans), (1, 4));
}
