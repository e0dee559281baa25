//! Unexpected observations: found in the past, and reported as they arrive.

use tidemap_ingest::protocol::NewName;
use tidemap_map::event::{SequenceSpan, StateKind};
use tidemap_model::selector::{Blend, ModelKind, ModelSelector};
use tidemap_proto::convert::query::selector_to_wire;
use tokio_stream::wrappers::ReceiverStream;

use super::*;

const HOUR: i64 = 60 * MINUTE;

type Rows = Vec<(i64, f64, f64)>;
type Watching = ReceiverStream<Result<v1::WatchAnomaliesResponse, Status>>;

/// A reading every twenty minutes: 1 in the first half of each twelve hours, with exceptions.
fn door(count: i64) -> Vec<(i64, f64)> {
    let value = |i: i64| f64::from(u8::from((i % 36 < 18) != (i % 61 == 7)));
    (0..count).map(|i| (NOON + i * 20 * MINUTE, value(i))).collect()
}

fn wire(kind: ModelKind) -> Option<v1::ModelSelector> {
    Some(selector_to_wire(ModelSelector { kind, ..ModelSelector::default() }))
}

fn with_persistence() -> Option<v1::ModelSelector> {
    Some(selector_to_wire(ModelSelector { blend: Blend::Persistence, ..ModelSelector::default() }))
}

impl Bench {
    async fn find(&self, request: v1::FindAnomaliesRequest) -> Result<Rows, Status> {
        let request = v1::FindAnomaliesRequest { map: "office".to_owned(), ..request };
        let mut replies = self.queries.find_anomalies(Request::new(request)).await?.into_inner();
        let mut found = Vec::new();
        while let Some(reply) = replies.next().await {
            let v1::FindAnomaliesResponse { times_nanos, values, probabilities, .. } = reply?;
            assert_eq!((times_nanos.len(), times_nanos.len()), (values.len(), probabilities.len()));
            found.extend(times_nanos.into_iter().zip(values).zip(probabilities).map(|((t, v), p)| (t, v, p)));
        }
        Ok(found)
    }

    async fn watch(&self, request: v1::WatchAnomaliesRequest) -> Result<Watching, Status> {
        let request = v1::WatchAnomaliesRequest { map: "office".to_owned(), ..request };
        Ok(self.queries.watch_anomalies(Request::new(request)).await?.into_inner())
    }

    /// The anomalies among the kept observations, computed from predictions.
    async fn naive(&self, state: &str, range: (i64, i64), confidence: f64, kind: ModelKind) -> Rows {
        let readings = self.past(state, range.0, range.1).await.expect("kept");
        let times: Vec<i64> = readings.iter().map(|(time, _)| *time).collect();
        let replies = self.predict(&[state], &times, wire(kind)).await.expect("an answer");
        let expected = replies.into_iter().flat_map(|reply| reply.probabilities);
        let rows = readings.into_iter().zip(expected).map(|((time, value), p)| (time, value, p));
        rows.filter(|&(_, v, p)| if v < 0.5 { p >= confidence } else { p <= 1.0 - confidence }).collect()
    }
}

fn about(state: &str, (from_nanos, to_nanos): (i64, i64)) -> v1::FindAnomaliesRequest {
    let [from_time, to_time] = [from_nanos, to_nanos].map(|nanos| Some(timestamp(nanos)));
    v1::FindAnomaliesRequest { state: state.to_owned(), from_time, to_time, ..Default::default() }
}

#[tokio::test(flavor = "multi_thread")]
async fn anomalies_are_the_readings_that_predictions_of_their_times_contradict() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = Bench::new(dir.path(), Retention::Forever, Some(Retention::Forever)).await;
    let readings = door(6000);
    let mut robot = bench.robot("r").await;
    robot.observe(&bench, &readings[..5500]).await;
    bench.robot("s").await.show(&bench, &minutes(1000)).await;
    bench.update().await;
    // Some observations are pending: they are judged, too.
    robot.observe(&bench, &readings[5500..]).await;
    let all = (NOON, NOON + 6000 * 20 * MINUTE);
    let part = (NOON + 777 * 20 * MINUTE, NOON + 5800 * 20 * MINUTE);
    let histogram = ModelKind::Histogram { cycle: tidemap_model::models::HistogramCycle::Day, bins: 24 };
    for kind in [ModelKind::Auto, ModelKind::Mean, ModelKind::Spectral, histogram, ModelKind::Calibrated] {
        for (state, range) in [("door", all), ("door", part), ("cell/2/0/0", all)] {
            for confidence in [0.51, 0.8, 0.99, 1.0] {
                let request =
                    v1::FindAnomaliesRequest { confidence: Some(confidence), model: wire(kind), ..about(state, range) };
                let found = bench.find(request).await.expect("an answer");
                let naive = bench.naive(state, range, confidence, kind).await;
                assert_eq!(found, naive, "{kind} of {state} at {confidence}");
                assert!(found.is_sorted_by_key(|row| row.0));
            }
        }
    }
    let found = bench.find(v1::FindAnomaliesRequest { confidence: Some(0.8), ..about("door", all) }).await;
    let found = found.expect("an answer").len();
    assert!((20..400).contains(&found), "{found} of 6000: the exceptions, and not much else");
    // Confidence and model have their defaults.
    assert_eq!(
        bench.find(about("door", all)).await.expect("an answer"),
        bench.naive("door", all, 0.99, ModelKind::Auto).await
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_judged_is_refused() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let mut bench = Bench::new(dir.path(), Retention::None, Some(Retention::Forever)).await;
    bench.robot("r").await.observe(&bench, &door(50)).await;
    bench.robot("s").await.show(&bench, &minutes(50)).await;
    let ask = |model| v1::FindAnomaliesRequest { model, ..about("cell/2/0/0", (0, i64::MAX)) };
    let invalid = Code::InvalidArgument;
    for confidence in [0.3, 0.5, 1.01, f64::NAN] {
        let request = v1::FindAnomaliesRequest { confidence: Some(confidence), ..ask(None) };
        check_refused(bench.find(request).await, invalid, &["confidence", "above 0.5 and at most 1"]);
    }
    for (model, words) in [
        (wire(ModelKind::Latest), ["model.kind", "latest"]),
        (wire(ModelKind::Persistence), ["model.kind", "persistence"]),
        (with_persistence(), ["model.persistence", "leave it out"]),
    ] {
        check_refused(bench.find(ask(model)).await, invalid, &words);
    }
    check_refused(bench.find(about("door", (5, 5))).await, invalid, &["to_time"]);
    check_refused(bench.find(about("door", (-1, 5))).await, invalid, &["from_time"]);
    check_refused(bench.find(about("window", (0, 5))).await, Code::NotFound, &["window", "door"]);
    check_refused(bench.find(about("cell/9/9/9", (0, 5))).await, Code::NotFound, &["cell/9/9/9"]);
    let words = ["keeps no history of states", "with a retention"];
    check_refused(bench.find(about("door", (0, 5))).await, Code::FailedPrecondition, &words);
    bench.queries.max_predictions = 49;
    check_refused(bench.find(ask(None)).await, Code::ResourceExhausted, &["max_predictions"]);

    let watch = |states: &[&str], model| v1::WatchAnomaliesRequest {
        states: states.iter().map(ToString::to_string).collect(),
        model,
        ..Default::default()
    };
    for (states, model, code, words) in [
        (&["door"][..], wire(ModelKind::Calibrated), invalid, ["model.kind", "must be trained"]),
        (&["door"], wire(ModelKind::Latest), invalid, ["model.kind", "latest"]),
        (&["door"], with_persistence(), invalid, ["model.persistence", "leave it out"]),
        (&["door", "cell/2/0"], None, invalid, ["states[1]", "cell/2/0"]),
        (&["door", "cell/9/9/9"], None, Code::NotFound, ["cell/9/9/9", "office"]),
        (&["window"], None, Code::NotFound, ["window", "door"]),
    ] {
        check_refused(bench.watch(watch(states, model)).await.map(drop), code, &words);
    }
    let region = |max_x| v1::WatchAnomaliesRequest {
        region: Some(v1::CellBox { max_x, max_y: 10, max_z: 10, ..Default::default() }),
        ..watch(&["door"], None)
    };
    check_refused(bench.watch(region(0)).await.map(drop), invalid, &["region", "no cells"]);
    let too_many = Code::ResourceExhausted;
    check_refused(bench.watch(region(101)).await.map(drop), too_many, &["cells", "10100"]);
    check_refused(bench.watch(region(100)).await.map(drop), too_many, &["states and cells", "10001"]);
    let request = v1::WatchAnomaliesRequest { location: "desk".to_owned(), ..watch(&[], None) };
    check_refused(bench.watch(request).await.map(drop), Code::NotFound, &["desk"]);
    let request = v1::WatchAnomaliesRequest { confidence: Some(0.5), ..watch(&[], None) };
    check_refused(bench.watch(request).await.map(drop), invalid, &["confidence"]);
}

/// A map whose door has always been open, and its robot.
async fn always_open(dir: &Path) -> (Bench, Robot) {
    let bench = Bench::new(dir, Retention::Forever, None).await;
    let mut robot = bench.robot("r").await;
    let open: Vec<(i64, f64)> = (0..500).map(|i| (NOON + i * HOUR, 1.0)).collect();
    robot.observe(&bench, &open).await;
    bench.update().await;
    (bench, robot)
}

const LATER: i64 = NOON + 1000 * HOUR;

fn rows(reply: v1::WatchAnomaliesResponse) -> Vec<(String, i64, f64, f64)> {
    let v1::WatchAnomaliesResponse { states, times_nanos, values, probabilities, .. } = reply;
    assert_eq!((states.len(), states.len(), states.len()), (times_nanos.len(), values.len(), probabilities.len()));
    let rows = states.into_iter().zip(times_nanos).zip(values).zip(probabilities);
    rows.map(|(((state, time), value), probability)| (state, time, value, probability)).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_watcher_receives_what_is_not_expected_as_soon_as_it_is_durable() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (bench, mut robot) = always_open(dir.path()).await;
    let mut all = bench.watch(v1::WatchAnomaliesRequest::default()).await.expect("accepted");
    let only =
        v1::WatchAnomaliesRequest { states: vec!["door".to_owned()], confidence: Some(1.0), ..Default::default() };
    let mut only = bench.watch(only).await.expect("accepted");
    // Anomalies come in the order of arrival. The time of the last one is decades after the clock, and it waits to be
    // learned.
    let ahead = NOON + 100 * 365 * 24 * HOUR;
    robot.observe(&bench, &[(LATER + 1, 1.0), (LATER, 0.0), (LATER - HOUR, 0.4), (LATER, 0.5), (ahead, 0.0)]).await;
    let expected: Vec<_> = [(LATER, 0.0), (LATER - HOUR, 0.4), (ahead, 0.0)]
        .map(|(time, value)| ("door".to_owned(), time, value, 1.0))
        .into();
    for watching in [&mut all, &mut only] {
        let reply = watching.next().await.expect("a reply").expect("well");
        assert_eq!(reply.missed_observations, 0);
        assert_eq!(rows(reply), expected);
    }
    // An untrained door is never a surprise; the next anomaly is of the other door.
    drop(only);
    let mut other = bench.robot("other").await;
    other.observe(&bench, &[(LATER, 0.0)]).await;
    bench.update().await;
    let reply = all.next().await.expect("a reply").expect("well");
    assert_eq!(rows(reply), [("door".to_owned(), LATER, 0.0, 1.0)]);
    bench.queries.catalog.stop().await;
    let end = all.next().await.expect("a status").expect_err("an end");
    assert_eq!(end.code(), Code::Unavailable, "{end:?}");
    assert!(all.next().await.is_none());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_watcher_receives_of_cells_what_is_found_later() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = Bench::new(dir.path(), Retention::Forever, Some(Retention::Forever)).await;
    let mut robot = bench.robot("s").await;
    robot.show(&bench, &minutes(1000)).await;
    bench.update().await;
    // The request selects one cell by name, and a box that reaches into a tile that was never seen. Cell 2 changes, and
    // is never certain.
    let request = v1::WatchAnomaliesRequest {
        states: vec!["cell/0/0/0".to_owned()],
        region: Some(v1::CellBox { min_x: 1, max_x: 12, max_y: 1, max_z: 1, ..Default::default() }),
        model: wire(ModelKind::Mean),
        ..Default::default()
    };
    let mut watching = bench.watch(request).await.expect("accepted");
    let seen =
        |observed: &[u16], occupied: &[u16]| (tile(0, 0, 0), TileMasks::clipped(cells(observed), cells(occupied)));
    let new = (tile(1, 0, 0), TileMasks::clipped(cells(&[0, 1]), cells(&[1])));
    let scans: Vec<(i64, Shown)> = [
        vec![seen(&[0, 1, 2], &[0, 1])],
        vec![seen(&[0, 1, 2], &[0, 2]), new],
        vec![new],
        vec![seen(&[1, 2, 3], &[1])],
        vec![seen(&[1, 3], &[])],
    ]
    .into_iter()
    .enumerate()
    .map(|(number, shown)| (LATER + number as i64 * MINUTE, shown))
    .collect();
    robot.show(&bench, &scans).await;
    let at = |number: i64| LATER + number * MINUTE;
    let expected = [
        ("cell/0/0/0", at(0), 1.0, 0.0),
        ("cell/0/0/0", at(1), 1.0, 0.0),
        ("cell/1/0/0", at(1), 0.0, 1.0),
        ("cell/1/0/0", at(4), 0.0, 1.0),
    ];
    let mut reported = Vec::new();
    while reported.len() < expected.len() {
        let reply = watching.next().await.expect("a reply").expect("well");
        assert_eq!(reply.missed_observations, 0);
        reported.extend(rows(reply));
    }
    assert_eq!(reported, expected.map(|(cell, time, value, p)| (cell.to_owned(), time, value, p)));
    for cell in ["cell/0/0/0", "cell/1/0/0", "cell/2/0/0", "cell/3/0/0"] {
        let later =
            bench.find(v1::FindAnomaliesRequest { model: wire(ModelKind::Mean), ..about(cell, (LATER, LATER + HOUR)) });
        let of_cell = reported.iter().filter(|row| row.0 == cell).map(|&(_, time, value, p)| (time, value, p));
        assert_eq!(later.await.expect("an answer"), of_cell.collect::<Rows>(), "{cell}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn each_observation_is_judged_by_the_models_in_force_when_it_comes() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (bench, mut robot) = always_open(dir.path()).await;
    let request =
        || v1::WatchAnomaliesRequest { confidence: Some(0.9), model: wire(ModelKind::Mean), ..Default::default() };
    let (mut prompt, mut late) =
        (bench.watch(request()).await.expect("accepted"), bench.watch(request()).await.expect("accepted"));
    let mut predictions = Vec::new();
    for round in 0..3 {
        robot.observe(&bench, &[(LATER + round, 0.0)]).await;
        let in_force =
            bench.predict(&["door"], &[LATER], wire(ModelKind::Mean)).await.expect("an answer")[0].probabilities[0];
        let reply = prompt.next().await.expect("a reply").expect("well");
        assert_eq!(rows(reply), [("door".to_owned(), LATER + round, 0.0, in_force)]);
        predictions.push(in_force);
        bench.update().await;
    }
    assert!(
        predictions[0] == 1.0 && predictions[1] < predictions[0] && predictions[2] < predictions[1],
        "each update has learned of one: {predictions:?}"
    );
    // A slow reader receives the same replies.
    for (round, in_force) in (0..3).zip(predictions) {
        let reply = late.next().await.expect("a reply").expect("well");
        assert_eq!(rows(reply), [("door".to_owned(), LATER + round, 0.0, in_force)]);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn numbers_are_anomalous_by_how_far_they_lie_from_what_is_expected() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (bench, mut robot) = always_open(dir.path()).await;
    let mut counter = bench.robot("counter").await;
    let mut all = bench.watch(v1::WatchAnomaliesRequest::default()).await.expect("accepted");
    let people = StateName::new("people").expect("valid");
    let session = counter.opened.session;
    let batch = |first_sequence: u64, readings: &[(i64, f64)], new_names| {
        let batch = ObservationBatch {
            span: SequenceSpan {
                first: first_sequence,
                last: first_sequence + readings.len() as u64 - 1,
                content_crc: 1,
            },
            new_names,
            table_indices: vec![0; readings.len()],
            times_nanos: readings.iter().map(|(nanos, _)| *nanos).collect(),
            values: readings.iter().map(|(_, value)| *value).collect(),
            ..ObservationBatch::default()
        };
        assert!(
            bench
                .handle
                .send(Command::StreamData { session, data: StreamData::Observations(batch, vec![permit(), permit()]) })
        );
    };
    // An untrained state has no anomalies.
    let usual: Vec<(i64, f64)> = (0..400).map(|i| (NOON + i * HOUR, f64::from((i % 3) as u8) + 3.0)).collect();
    batch(1, &usual, vec![Some(NewName { name: people, shape: Some(StateKind::Count.into()), reporting: None })]);
    counter.sent = 400;
    counter.settled().await;
    bench.update().await;
    let found = bench.find(about("people", (0, i64::MAX))).await.expect("kept");
    assert_eq!(found, []);
    let mut watched = bench
        .watch(v1::WatchAnomaliesRequest { states: vec!["people".to_owned()], ..Default::default() })
        .await
        .expect("accepted");
    let at = NOON + 400 * HOUR;
    batch(401, &[(at, 4.0), (at + 1, 40.0), (at + 2, 3.0), (at + 3, 0.0)], Vec::new());
    counter.sent = 404;
    counter.settled().await;
    robot.observe(&bench, &[(LATER, 0.0)]).await;
    // Four is usual, with the variance of counts: 0 is less extreme than 40.
    let counted = rows(watched.next().await.expect("a reply").expect("well"));
    assert_eq!(counted.len(), 1, "{counted:?}");
    let (state, time, value, tail) = counted[0].clone();
    assert_eq!((&*state, time, value), ("people", at + 1, 40.0));
    assert!((0.0..1e-9).contains(&tail), "{tail}");
    let mut both = Vec::new();
    while both.len() < 2 {
        both.extend(rows(all.next().await.expect("a reply").expect("well")));
    }
    assert_eq!(both, [counted[0].clone(), ("door".to_owned(), LATER, 0.0, 1.0)]);
    // A query of the past returns the same until an update has learned the observations.
    let found = bench.find(about("people", (0, i64::MAX))).await.expect("kept");
    assert_eq!(found, [(at + 1, 40.0, tail)]);
    let lenient = v1::FindAnomaliesRequest { confidence: Some(0.9), ..about("people", (0, i64::MAX)) };
    let found = bench.find(lenient).await.expect("kept");
    assert!(found.contains(&(at + 1, 40.0, tail)) && found.iter().all(|row| row.2 <= 0.1), "{found:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_watch_ends_with_its_map_and_its_place_is_free_again() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (bench, _robot) = always_open(dir.path()).await;
    let request = v1::WatchAnomaliesRequest::default;
    let first = bench.watch(request()).await.expect("accepted");
    let mut second = bench.watch(request()).await.expect("accepted");
    let words = ["2 are in use", "setting max_watches:"];
    check_refused(bench.watch(request()).await.map(drop), Code::ResourceExhausted, &words);
    // One watcher leaves without a message, and nothing has arrived meanwhile.
    drop(first);
    let mut third = loop {
        match bench.watch(request()).await {
            Ok(third) => break third,
            Err(_) => tokio::time::sleep(std::time::Duration::from_millis(5)).await,
        }
    };
    bench.queries.catalog.delete("office").await.expect("deleted");
    for watching in [&mut second, &mut third] {
        let end = watching.next().await.expect("a status").expect_err("an end");
        assert_eq!((end.code(), end.message()), (Code::NotFound, "the map was deleted"));
        assert!(watching.next().await.is_none());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn one_who_does_not_read_holds_nobody_up_and_receives_the_number_of_missed() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (bench, mut robot) = always_open(dir.path()).await;
    let mut slow = bench.watch(v1::WatchAnomaliesRequest::default()).await.expect("accepted");
    let count = 200;
    for i in 0..count {
        // The observations are acknowledged one by one, whether anybody reads or not.
        robot.observe(&bench, &[(LATER + i, 0.0), (LATER + i, 1.0)]).await;
    }
    let (mut reported, mut missed) = (Vec::new(), 0);
    while missed + 2 * reported.len() as u64 != 2 * count as u64 {
        let reply = slow.next().await.expect("a reply").expect("well");
        missed += reply.missed_observations;
        reported.extend(rows(reply).into_iter().map(|(_, time, ..)| time - LATER));
    }
    assert!(missed > 0 && reported.len() > 60 && reported.is_sorted(), "{missed} missed, {reported:?}");
    assert!(reported.starts_with(&[0, 1, 2]) && reported.ends_with(&[count - 1]), "the oldest are lost: {reported:?}");
    // The watcher reads from now on.
    robot.observe(&bench, &[(LATER, 0.0)]).await;
    let reply = slow.next().await.expect("a reply").expect("well");
    assert_eq!((reply.missed_observations, rows(reply).len()), (0, 1));
}
