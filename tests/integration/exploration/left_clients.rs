//! Work stops when its client leaves, or when the deadline of its call passes: plans, and the training of models.
//!
//! Invariant: each request would compute for at least twice [`ENDS_WITHIN`], and the daemon computes nothing within
//! this time after the client has left. How many requests compute is a metric, `tidemap_computing_requests`.

use std::{future::Future, time::Duration};

use super::{MAP, START_SECS, room};
use tidemap_proto::v1::{
    self, exploration_service_client::ExplorationServiceClient, query_service_client::QueryServiceClient,
};
use tidemap_tests::{cli, daemon::Daemon};
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::TcpStream,
};

/// Time limit for what takes some milliseconds: a fraction of what the work would take.
const ENDS_WITHIN: Duration = Duration::from_secs(3);
const BEGINS_WITHIN: Duration = Duration::from_secs(30);

/// Number of requests that compute.
async fn computing(daemon: &Daemon) -> u64 {
    let mut socket = TcpStream::connect(&daemon.http).await.expect("the port is open");
    socket.write_all(b"GET /metrics HTTP/1.1\r\nHost: here\r\nConnection: close\r\n\r\n").await.expect("a request");
    let mut text = String::new();
    socket.read_to_string(&mut text).await.expect("an answer");
    let line = text.lines().find_map(|line| line.strip_prefix("tidemap_computing_requests ")).unwrap_or("0");
    line.parse::<f64>().expect("a number") as u64
}

/// Waits until any request computes, or none.
async fn wait_until(daemon: &Daemon, is_so: bool, what: &str) {
    let within = if is_so { BEGINS_WITHIN } else { ENDS_WITHIN };
    let waited = async {
        while (computing(daemon).await > 0) != is_so {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    tokio::time::timeout(within, waited).await.unwrap_or_else(|_| panic!("{what}"));
}

/// A client sends a request, and leaves as soon as the daemon computes.
async fn leave<T: Send + 'static>(daemon: &Daemon, what: &str, call: impl Future<Output = T> + Send + 'static) {
    let call = tokio::spawn(call);
    wait_until(daemon, true, &format!("{what} does not begin")).await;
    // Well into the work.
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert!(computing(daemon).await > 0 && !call.is_finished(), "{what} is too short to be left");
    call.abort();
    wait_until(daemon, false, &format!("{what} goes on without its client")).await;
}

/// Reads all replies.
async fn read<T>(replies: Result<tonic::Response<tonic::Streaming<T>>, tonic::Status>) {
    let mut replies = replies.expect("accepted").into_inner();
    while replies.message().await.expect("a reply").is_some() {}
}

#[tokio::test(flavor = "multi_thread")]
async fn work_stops_when_its_client_leaves() {
    let data = tempfile::tempdir().expect("a folder");
    let (_launch, daemon) = room(data.path()).await;
    let csv = data.path().join("speed.csv");
    let rows = (0..20_000).map(|row| {
        let secs = START_SECS - 40 * 86_400 + row * 179;
        format!("{secs},speed,{}\n", (row * 7 + secs / 86_400) % 11 + secs % 86_400 / 10_000)
    });
    std::fs::write(&csv, format!("time,state,value\n{}", rows.collect::<String>())).expect("a file");
    let csv = csv.to_str().expect("text");
    cli::tidemap(&daemon, ["state", "add", MAP, "speed", "--kind", "continuous"]).table();
    cli::tidemap(&daemon, ["observe", MAP, csv, "--producer", "hand"]).table();
    cli::tidemap(&daemon, ["update", MAP]).table();

    let exploring = || ExplorationServiceClient::new(daemon.client().requests());
    let asking = || QueryServiceClient::new(daemon.client().requests());
    let at = |secs: i64| START_SECS + 7 * 86_400 + secs;
    let map = || MAP.to_owned();
    let start = Some(v1::Point { x_m: 1.0, y_m: 7.0 });
    let times = |count: i64| (0..count).map(|minute| at(60 * minute) * 1_000_000_000).collect::<Vec<i64>>();

    // A tour in each minute of a day.
    let tour = v1::PlanTourRequest { map: map(), start, count: 100, spacing_m: 0.1, ..Default::default() };
    let slot = Some(prost_types::Duration { seconds: 60, nanos: 0 });
    let budget = Some(v1::plan_day_request::Budget::Explore(3));
    let day = v1::PlanDayRequest {
        map: map(),
        date: "2016-01-12".to_owned(),
        slot,
        budget,
        tour: Some(tour),
        ..Default::default()
    };
    let mut client = exploring();
    let request = day.clone();
    leave(&daemon, "a day of tours", async move { client.plan_day(request).await }).await;

    let model =
        v1::ModelSelector { kind: v1::ModelKind::HypertimeEm.into(), parameter: Some(50), ..Default::default() };
    let predict = v1::PredictStatesRequest {
        map: map(),
        states: vec!["speed".to_owned()],
        times_nanos: times(1),
        model: Some(model),
        ..Default::default()
    };
    let (mut one, mut other) = (asking(), asking());
    let same = predict.clone();
    let staying = tokio::spawn(async move { read(one.predict_states(same).await).await });
    wait_until(&daemon, true, "the training does not begin").await;
    // Training that another request waits for goes on.
    let leaving = tokio::spawn(async move { read(other.predict_states(predict).await).await });
    tokio::time::sleep(Duration::from_millis(300)).await;
    leaving.abort();
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert!(computing(&daemon).await > 0, "one request still waits");
    staying.abort();
    wait_until(&daemon, false, "the training goes on without its clients").await;

    // A call whose deadline passes is as good as left.
    let mut client = exploring();
    let mut late = tonic::Request::new(day);
    late.set_timeout(Duration::from_millis(500));
    client.plan_day(late).await.expect_err("too long");
    wait_until(&daemon, false, "a day goes on after its deadline").await;
}
