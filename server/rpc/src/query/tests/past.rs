//! Tests of the observations of the past, wherever they are kept.

use super::*;

/// The scans of `minutes` of a cell.
fn expected(count: usize, cell: u16) -> Vec<(i64, f64)> {
    let seen = minutes(count).into_iter().filter(|(_, shown)| shown[0].1.observed().contains(cell));
    seen.map(|(time, shown)| (time, f64::from(u8::from(shown[0].1.occupied().contains(cell))))).collect()
}

fn door(count: i64) -> Vec<(i64, f64)> {
    (0..count).map(|i| (NOON + i * MINUTE, (i % 10) as f64 / 10.0)).collect()
}

#[track_caller]
fn check(found: Result<Vec<(i64, f64)>, Status>, expected: &[(i64, f64)]) {
    let found = found.expect("kept");
    let differ = found.iter().zip(expected).position(|(found, expected)| found != expected);
    assert_eq!((found.len(), differ), (expected.len(), None));
}

#[tokio::test]
async fn what_was_observed_is_returned_wherever_it_is() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let mut bench = Bench::new(dir.path(), Retention::Forever, Some(Retention::Forever)).await;
    let (door, scans) = (door(4000), minutes(4000));
    let mut robot = bench.robot("r").await;
    let mut scanner = bench.robot("s").await;
    // Some observations are in the store, some are learned and not saved, some are pending.
    for part in 0..4 {
        robot.observe(&bench, &door[part * 1000..(part + 1) * 1000]).await;
        scanner.show(&bench, &scans[part * 1000..(part + 1) * 1000]).await;
        let so_far = (part + 1) * 1000;
        for after_update in [false, true] {
            check(bench.past("door", 0, i64::MAX).await, &door[..so_far]);
            for cell in 0..4 {
                let name = format!("cell/{cell}/0/0");
                check(bench.past(&name, 0, i64::MAX).await, &expected(so_far, cell));
            }
            if part < 3 && !after_update {
                // The request comes while the update has the observations, or just before or after that.
                let (past, ()) = tokio::join!(bench.past("door", 0, i64::MAX), bench.update());
                check(past, &door[..so_far]);
            }
        }
        if part == 1 {
            bench = bench.again(dir.path()).await;
            robot = bench.robot("r").await;
            scanner = bench.robot("s2").await;
        }
    }
    let (from, to) = (NOON + 1500 * MINUTE, NOON + 3500 * MINUTE);
    check(bench.past("door", from, to).await, &door[1500..3500]);
    let all = expected(4000, 2);
    check(bench.past("cell/2/0/0", from, to).await, &all[1500..3500]);
    check(bench.past("door", 5, 6).await, &[]);
    bench.queries.max_predictions = 1999;
    for name in ["door", "cell/2/0/0"] {
        check_refused(bench.past(name, from, to).await, Code::ResourceExhausted, &["1999", "max_predictions"]);
    }
    bench.queries.max_predictions = 2000;
    check(bench.past("door", from, to).await, &door[1500..3500]);
}

#[tokio::test]
async fn what_is_not_kept_is_reported_as_not_kept() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = Bench::new(dir.path(), Retention::None, Some(Retention::None)).await;
    bench.robot("r").await.observe(&bench, &door(5)).await;
    bench.robot("s").await.show(&bench, &minutes(5)).await;
    let words = ["\"office\" keeps no history of states", "with a retention"];
    check_refused(bench.past("door", 0, 1).await, Code::FailedPrecondition, &words);
    let words = ["history of its grid", "grid retention"];
    check_refused(bench.past("cell/0/0/0", 0, 1).await, Code::FailedPrecondition, &words);
    check_refused(bench.past("window", 0, 1).await, Code::NotFound, &["window", "door"]);
    check_refused(bench.past("cell/7/0/0", 0, 1).await, Code::NotFound, &["cell/7/0/0"]);
    check_refused(bench.past("door", -1, 1).await, Code::InvalidArgument, &["from_time"]);
    check_refused(bench.past("door", 5, 5).await, Code::InvalidArgument, &["to_time"]);
}

#[tokio::test]
async fn history_begins_where_it_begins() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let hour = Retention::Duration(60 * MINUTE);
    let mut bench = Bench::new(dir.path(), hour, Some(hour)).await;
    let (door, scans) = (door(600), minutes(600));
    bench.robot("r").await.observe(&bench, &door[..100]).await;
    bench.robot("s").await.show(&bench, &scans[..100]).await;
    bench.update().await;
    bench = bench.again(dir.path()).await;
    let mut robot = bench.robot("later").await;
    robot.observe(&bench, &door[500..]).await;
    bench.robot("s2").await.show(&bench, &scans[500..]).await;
    bench.update().await;
    bench = bench.again(dir.path()).await;
    check(bench.past("door", 0, i64::MAX).await, &door[500..]);
    check(bench.past("cell/2/0/0", 0, i64::MAX).await, &expected(600, 2)[500..]);
    for name in ["door", "cell/2/0/0"] {
        let old = bench.past(name, NOON, NOON + 100 * MINUTE).await;
        check_refused(old, Code::OutOfRange, &[name, "kept"]);
        let partly = bench.past(name, NOON, NOON + 700 * MINUTE).await.expect("partly kept");
        assert_eq!((partly.len(), partly[0].0), (100, NOON + 500 * MINUTE));
    }
}
