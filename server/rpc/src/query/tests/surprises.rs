//! Tests of surprises: pending and learned.

use tidemap_model::selector::ModelSelector;
use tidemap_proto::convert::query::selector_to_wire;

use super::*;

/// A door every half-hour: open in the first half of each day.
fn usual(slots: std::ops::Range<i64>) -> Vec<(i64, f64)> {
    slots.map(|slot| (NOON + slot * 30 * MINUTE, f64::from(u8::from(slot % 48 < 24)))).collect()
}

impl Bench {
    async fn surprises(&self, request: v1::ListSurprisesRequest) -> Result<v1::ListSurprisesResponse, Status> {
        // The interval begins after the days in which the rhythm was learned.
        let (from_time, to_time) = (Some(timestamp(NOON + 27 * 48 * 30 * MINUTE)), Some(timestamp(i64::MAX)));
        let confidence = request.confidence.or(Some(0.9));
        let request = v1::ListSurprisesRequest { map: "office".to_owned(), from_time, to_time, confidence, ..request };
        Ok(self.queries.list_surprises(Request::new(request)).await?.into_inner())
    }

    async fn all(&self) -> Vec<v1::Surprise> {
        self.surprises(v1::ListSurprisesRequest::default()).await.expect("an answer").surprises
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_observation_is_as_surprising_after_it_was_learned_as_before() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = Bench::new(dir.path(), Retention::None, None).await;
    let mut robot = bench.robot("r").await;
    robot.observe(&bench, &usual(0..48 * 28)).await;
    bench.update().await;
    assert_eq!(bench.all().await, [], "a rhythm that is learned is no surprise");
    // These observations are of the next local day, which begins half a day after noon: all of them are of one day.
    let mut night = usual(48 * 28 - 24 + 48..48 * 28 - 24 + 60);
    for (_, value) in &mut night {
        *value = 1.0 - *value;
    }
    let times: Vec<i64> = night.iter().map(|(time, _)| *time).collect();
    let long_term = Some(selector_to_wire(ModelSelector::default().long_term()));
    let replies = bench.predict(&["door"], &times, long_term).await.expect("an answer");
    let expected: Vec<f64> = replies.into_iter().flat_map(|reply| reply.probabilities).collect();
    robot.observe(&bench, &night).await;
    let pending = bench.all().await;
    let [run] = &pending[..] else { panic!("one run: {pending:?}") };
    assert_eq!((run.state.as_str(), run.observations, run.above), ("door", 12, night[0].1 == 1.0));
    assert_eq!((run.first_time, run.last_time), (Some(timestamp(times[0])), Some(timestamp(times[11]))));
    // The surprise has the predictions of these times: the least likely one, and all half-hours together.
    let observed = |p: &f64| if run.above { *p } else { 1.0 - p };
    let least = expected.iter().map(observed).fold(1.0, f64::min);
    assert!((observed(&run.probability) - least).abs() < 1e-12, "{} {least}", run.probability);
    let bits: f64 = expected.iter().map(|p| -observed(p).max(1.0 / 1024.0).log2()).sum();
    assert!((run.bits - bits).abs() < 1e-9, "{} {bits}", run.bits);
    bench.update().await;
    assert_eq!(bench.all().await, pending);
    // A restored map returns the same.
    let bench = bench.again(dir.path()).await;
    assert_eq!(bench.all().await, pending);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wrong_request_is_refused() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let mut bench = Bench::new(dir.path(), Retention::None, Some(Retention::Forever)).await;
    let mut robot = bench.robot("r").await;
    robot.observe(&bench, &usual(0..60)).await;
    let named = |state: &str| v1::ListSurprisesRequest { states: vec![state.to_owned()], ..Default::default() };
    let invalid = Code::InvalidArgument;
    check_refused(bench.surprises(named("window")).await, Code::NotFound, &["window", "door"]);
    check_refused(bench.surprises(named("cell/1/2/3")).await, invalid, &["states[0]", "FindAnomalies"]);
    let low = v1::ListSurprisesRequest { confidence: Some(0.6), ..Default::default() };
    check_refused(bench.surprises(low).await, invalid, &["confidence", "0.9"]);
    let many = v1::ListSurprisesRequest { top: 10_001, ..Default::default() };
    check_refused(bench.surprises(many).await, invalid, &["top", "10000"]);
    bench.queries.max_predictions = 59;
    robot.observe(&bench, &usual(48 * 28..48 * 28 + 60)).await;
    check_refused(bench.surprises(named("door")).await, Code::ResourceExhausted, &["max_predictions"]);
}
