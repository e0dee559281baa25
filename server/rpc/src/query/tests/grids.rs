//! Cells by name, and whole grids.

use tidemap_grid::predict::{GridQuestion, TileCells};
use tidemap_model::selector::{ModelKind, ModelSelector};
use tidemap_proto::convert::query::selector_to_wire;

use super::*;

fn box_of(min: [i32; 3], max: [i32; 3]) -> Option<v1::CellBox> {
    let ([min_x, min_y, min_z], [max_x, max_y, max_z]) = (min, max);
    Some(v1::CellBox { min_x, min_y, min_z, max_x, max_y, max_z })
}

fn at(time_nanos: i64) -> v1::PredictGridRequest {
    v1::PredictGridRequest { time: Some(timestamp(time_nanos)), ..v1::PredictGridRequest::default() }
}

#[tokio::test]
async fn cells_are_predicted_and_described_by_name() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = Bench::new(dir.path(), Retention::Forever, Some(Retention::None)).await;
    let mut robot = bench.robot("r").await;
    let door: Vec<(i64, f64)> = (0..240).map(|i| (NOON + i * MINUTE, (i / 60 % 2) as f64)).collect();
    robot.observe(&bench, &door).await;
    bench.robot("s").await.show(&bench, &minutes(240)).await;
    let fresh = bench.names(&["cell/2/0/0"], &[NOON]).await.expect("known");
    assert_eq!(fresh[0].probabilities, [0.5], "nothing is learned yet");
    bench.update().await;

    let times: Vec<i64> = (0..300).map(|i| NOON + i * 7 * MINUTE).collect();
    let spectral = Some(selector_to_wire(ModelSelector { kind: ModelKind::Spectral, ..ModelSelector::default() }));
    let names = ["cell/2/0/0", "door", "cell/1/0/0", "cell/3/0/0"];
    let replies = bench.predict(&names, &times, spectral).await.expect("known");
    assert_eq!(replies.iter().map(|reply| reply.state_index).collect::<Vec<_>>(), [0, 1, 2, 3]);
    assert_eq!(replies[0].probabilities.len(), 300);
    let mut apart = replies[0].probabilities.iter().zip(&replies[1].probabilities).map(|(a, b)| (a - b).abs());
    assert!(apart.all(|apart| apart < 1e-9), "a cell that does what a door does is predicted as the door");
    assert_eq!(replies[2].probabilities, [1.0; 300]);
    assert_eq!(replies[3].probabilities, [0.0; 300]);
    assert_eq!(replies.iter().map(|reply| reply.observations).collect::<Vec<_>>(), [240, 240, 240, 48]);
    assert_eq!(replies[3].last_time.map(|time| time.seconds), Some((NOON + 235 * MINUTE) / 1_000_000_000));

    let describe = |name: &str| {
        let request = v1::DescribeModelRequest { map: "office".to_owned(), state: name.to_owned() };
        bench.queries.describe_model(Request::new(request))
    };
    let (cell, door) = (describe("cell/2/0/0").await.expect("known"), describe("door").await.expect("known"));
    let (cell, door) = (cell.into_inner(), door.into_inner());
    // Four hours are eight bins of half an hour; the first is at the mean time of its scans.
    assert_eq!((cell.state.as_str(), cell.learned_observations, cell.order_errors.len()), ("cell/2/0/0", 8, 16));
    assert_eq!((cell.last_time, cell.order), (door.last_time, door.order));
    let first_bin = NOON + 29 * MINUTE / 2;
    assert_eq!(cell.first_time.map(|t| t.seconds * 1_000_000_000 + i64::from(t.nanos)), Some(first_bin));
    let periods =
        |model: &v1::DescribeModelResponse| model.components.iter().map(|c| c.period_secs).collect::<Vec<_>>();
    assert_eq!(periods(&cell), periods(&door));
    let wall = describe("cell/1/0/0").await.expect("known").into_inner();
    assert_eq!((wall.mean, wall.order, wall.order_errors, wall.last_value), (1.0, 0, vec![0.0; 16], Some(1.0)));

    check_refused(
        bench.names(&["door", "cell/4/0/0"], &times).await,
        Code::NotFound,
        &["cell/4/0/0", "never observed"],
    );
    check_refused(bench.names(&["cell/99/0/0"], &times).await, Code::NotFound, &["cell/99/0/0"]);
    check_refused(
        bench.names(&["door", "cell/1/0"], &times).await,
        Code::InvalidArgument,
        &["states[1]", "cell/X/Y/Z"],
    );
    check_refused(describe("cell/4/0/0").await, Code::NotFound, &["cell/4/0/0"]);
    let unnamed = describe("cell/1/0").await.expect_err("refused");
    assert!(unnamed.message().starts_with("state: "), "{unnamed:?}");
}

#[tokio::test]
async fn a_map_without_a_grid_has_no_cells() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = Bench::new(dir.path(), Retention::Forever, None).await;
    check_refused(bench.names(&["cell/0/0/0"], &[NOON]).await, Code::FailedPrecondition, &["no grid"]);
    check_refused(bench.grid(at(NOON)).await, Code::FailedPrecondition, &["\"office\" has no grid"]);
    check_refused(bench.past("cell/0/0/0", 0, 1).await, Code::FailedPrecondition, &["no grid"]);
}

#[tokio::test]
async fn a_grid_is_sent_tile_by_tile() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = Bench::new(dir.path(), Retention::None, Some(Retention::None)).await;
    let nothing = bench.grid(at(NOON)).await.expect("a grid");
    assert_eq!((nothing.0.tiles, nothing.0.cells, nothing.0.region, nothing.1.len()), (0, 0, None, 0));
    let mut robot = bench.robot("r").await;
    robot.show(&bench, &minutes(240)).await;
    let full = TileMasks::clipped(Mask::FULL, cells(&[5, 64]));
    robot.show(&bench, &[(NOON + 241 * MINUTE, vec![(tile(-1, 2, 0), full), (tile(-1, 2, 3), full)])]).await;
    bench.update().await;

    let (header, pages) = bench.grid(at(NOON + 90 * MINUTE)).await.expect("a grid");
    assert_eq!((header.tiles, header.cells, header.generation), (3, 1280, 1));
    assert_eq!(header.region, box_of([-8, 0, 0], [4, 24, 32]), "four columns of the tile are known");
    let tiles: Vec<_> = pages.into_iter().flat_map(|page| page.tiles).collect();
    assert_eq!(
        tiles.iter().map(|tile| (tile.x, tile.y, tile.z)).collect::<Vec<_>>(),
        [(0, 0, 0), (-1, 2, 0), (-1, 2, 3)]
    );
    assert_eq!((tiles[0].known[0], tiles[0].changed[0], tiles[0].high[0]), (0b1111, 0b100, 0b10));
    assert_eq!((tiles[0].static_low, tiles[0].static_high, tiles[0].values.len()), (0.0, 1.0, 1));
    assert_eq!((tiles[1].known.len(), tiles[1].changed.len(), tiles[1].values.len()), (64, 0, 0));
    let expected = bench.names(&["cell/2/0/0"], &[NOON + 90 * MINUTE]).await.expect("known");
    assert!((f64::from(tiles[0].values[0]) - expected[0].probabilities[0]).abs() < 1e-6);

    let estimate = v1::PredictGridRequest { estimate_only: true, ..at(NOON + 90 * MINUTE) };
    assert_eq!(bench.grid(estimate.clone()).await.expect("a grid"), (header, Vec::new()));
    let all = box_of([i32::MIN; 3], [i32::MAX; 3]);
    let (header, pages) =
        bench.grid(v1::PredictGridRequest { region: all, project: true, ..at(NOON) }).await.expect("a grid");
    assert_eq!((header.tiles, header.cells, header.region), (2, 1280, box_of([-8, 0, 0], [4, 24, 1])));
    assert_eq!(pages[0].tiles[1].high, [0b0010_0001, 0, 0, 0, 0, 0, 0, 0]);
    for (min, max) in [([100, 0, 0], [200, 9, 9]), ([3, 3, 3], [3, 3, 3]), ([5, 5, 5], [1, 1, 1])] {
        let (header, pages) =
            bench.grid(v1::PredictGridRequest { region: box_of(min, max), ..at(NOON) }).await.expect("a grid");
        assert_eq!((header.tiles, header.cells, pages.len()), (0, 0, 0));
    }
}

#[tokio::test]
async fn questions_that_cannot_be_answered_end_with_the_reason() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let mut bench = Bench::new(dir.path(), Retention::None, Some(Retention::None)).await;
    bench.robot("r").await.show(&bench, &minutes(3)).await;
    bench.queries.max_predictions = 3;
    check_refused(bench.grid(at(NOON)).await, Code::ResourceExhausted, &["4 is", "the 3", "max_predictions"]);
    let estimate = v1::PredictGridRequest { estimate_only: true, ..at(NOON) };
    assert_eq!(bench.grid(estimate).await.expect("costs nothing").0.cells, 4);
    bench.queries.max_predictions = 4;
    bench.grid(at(NOON)).await.expect("as many as may be");
    check_refused(bench.grid(at(-1)).await, Code::InvalidArgument, &["time", "1970"]);
    let threshold = v1::PredictGridRequest { output: v1::GridOutput::Threshold.into(), threshold: 1.5, ..at(NOON) };
    check_refused(bench.grid(threshold).await, Code::InvalidArgument, &["threshold", "1.5"]);
    let model = Some(v1::ModelSelector { order: Some(16), ..v1::ModelSelector::default() });
    check_refused(bench.grid(v1::PredictGridRequest { model, ..at(NOON) }).await, Code::InvalidArgument, &["16"]);
}

#[tokio::test]
async fn a_large_grid_comes_in_pages_of_one_view() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let mut bench = Bench::new(dir.path(), Retention::None, Some(Retention::None)).await;
    bench.queries.max_predictions = u64::MAX;
    let mut robot = bench.robot("r").await;
    let shown = |occupied: Mask| {
        (0..800).map(|i| (tile(i % 40, i / 40, 0), TileMasks::clipped(Mask::FULL, occupied))).collect()
    };
    robot.show(&bench, &[(NOON, shown(Mask::EMPTY)), (NOON + 30 * MINUTE, shown(Mask::FULL))]).await;
    bench.update().await;
    let view = bench.handle.view();
    let (header, pages) = bench.grid(at(NOON + 30 * MINUTE)).await.expect("a grid");
    assert!(pages.len() > 5);
    let tiles: Vec<_> = pages.into_iter().flat_map(|page| page.tiles).collect();
    assert_eq!((tiles.len() as u64, header.cells), (header.tiles, 800 * 512));
    let question = GridQuestion { utc_nanos: NOON + 30 * MINUTE, ..GridQuestion::default() };
    let selection = view.grid().expect("a grid").select(&question);
    for (answered, expected) in tiles.iter().zip(view.predict_grid(&question, &selection)) {
        let expected: TileCells = expected.expect("in memory");
        assert_eq!((answered.x, answered.y, answered.z), (expected.index.x, expected.index.y, expected.index.z));
        assert_eq!(answered.values, expected.values);
    }
}
