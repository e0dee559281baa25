//! Invalid requests: maps, periods, times, pages, models.

use prost_types::{Duration, Timestamp};
use tidemap_proto::v1::{
    self, CreateMapRequest, DescribeModelRequest, GetMapRequest, Harmonics, ListMapsRequest, ListStatesRequest,
    ModelKind, ModelSelector, PeriodList, Periodicities, PredictStatesRequest, RunUpdateRequest,
    maintenance_service_client::MaintenanceServiceClient, map_service_client::MapServiceClient, periodicities::Set,
    query_service_client::QueryServiceClient,
};
use tidemap_tests::stream::{RawStream, columns, hello};
use tonic::{Code, Status};

use super::{observations, office};

#[track_caller]
fn check(status: &Status, code: Code, words: &[&str]) {
    assert_eq!(status.code(), code, "{status:?}");
    for word in words {
        assert!(status.message().contains(word), "{word:?} is not in {status:?}");
    }
}

fn secs(seconds: i64) -> Duration {
    Duration { seconds, nanos: 0 }
}

fn harmonics(base: Option<Duration>, count: u32) -> Option<Periodicities> {
    Some(Periodicities { set: Some(Set::Harmonics(Harmonics { base, count })) })
}

fn list(periods: Vec<Duration>) -> Option<Periodicities> {
    Some(Periodicities { set: Some(Set::List(PeriodList { periods })) })
}

#[tokio::test(flavor = "multi_thread")]
async fn maps_that_cannot_be_are_not_created() {
    let (_data, daemon) = office(|launch| launch.setting("max_maps", 2)).await;
    let mut maps = MapServiceClient::new(daemon.client().requests());
    let named = |name: &str| CreateMapRequest { name: name.to_owned(), ..CreateMapRequest::default() };
    let with = |periodicities| CreateMapRequest { periodicities, ..named("lab") };
    let long = "m".repeat(64);
    let year = 366 * 86_400;
    let mut cases = vec![
        (named("office"), Code::AlreadyExists, "office"),
        (CreateMapRequest { time_zone: "Mars/Base".to_owned(), ..named("lab") }, Code::InvalidArgument, "Mars/Base"),
        (CreateMapRequest { order_criterion: 7, ..named("lab") }, Code::InvalidArgument, "7"),
        (with(harmonics(Some(secs(0)), 1)), Code::InvalidArgument, "periodicities.harmonics"),
        (with(harmonics(Some(secs(-60)), 1)), Code::InvalidArgument, "periodicities.harmonics"),
        (with(harmonics(Some(secs(101 * year)), 1)), Code::InvalidArgument, "periodicities.harmonics"),
        (with(harmonics(None, 2049)), Code::InvalidArgument, "2049"),
        (with(harmonics(Some(secs(i64::MAX)), 1)), Code::InvalidArgument, "periodicities.harmonics.base"),
        (with(list(vec![])), Code::InvalidArgument, "periodicities.list.periods"),
        (with(list(vec![secs(60), secs(3600), secs(60)])), Code::InvalidArgument, "periodicities.list.periods"),
        (with(list(vec![secs(60), secs(0)])), Code::InvalidArgument, "periodicities.list.periods"),
        (with(list(vec![secs(60), secs(200 * year)])), Code::InvalidArgument, "periodicities.list.periods"),
        (with(list((1..=2049).map(|i| secs(i + 10)).collect())), Code::InvalidArgument, "2049"),
    ];
    for name in ["", "-a", "_a", "Office", "office 2", "../etc", "a/b", "a\0", "büro", "CON", &long] {
        cases.push((named(name), Code::InvalidArgument, "map name"));
    }
    for (request, code, word) in cases {
        let status = maps.create_map(request.clone()).await.expect_err(word);
        check(&status, code, &[word]);
    }
    maps.create_map(named("lab")).await.expect("a second map");
    check(&maps.create_map(named("attic")).await.expect_err("too many"), Code::ResourceExhausted, &["max_maps", "2"]);
    let names: Vec<String> = daemon.client().maps().await.expect("maps").into_iter().map(|map| map.name).collect();
    assert_eq!(names, ["lab", "office"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn names_that_are_not_known_are_not_found() {
    let (_data, daemon) = office(|launch| launch).await;
    let (mut stream, _) = RawStream::open(&daemon.grpc, hello("robot", "office")).await.expect("a Welcome");
    stream.batch(1, columns(&["door"], &[(0, 1_000, 1.0)])).await;
    stream.acknowledged(1).await.expect("taken");
    let channel = daemon.client().requests();
    let (mut maps, mut queries) = (MapServiceClient::new(channel.clone()), QueryServiceClient::new(channel.clone()));
    let mut maintenance = MaintenanceServiceClient::new(channel);
    let attic = || "attic".to_owned();
    let unknown = [
        maps.get_map(GetMapRequest { name: attic() }).await.err(),
        maps.delete_map(v1::DeleteMapRequest { name: attic() }).await.err(),
        maps.list_states(ListStatesRequest { map: attic(), ..ListStatesRequest::default() }).await.err(),
        maintenance.run_update(RunUpdateRequest { map: attic(), until: None }).await.err(),
        maintenance.get_statistics(v1::GetStatisticsRequest { map: attic() }).await.err(),
        queries.describe_model(DescribeModelRequest { map: attic(), state: "door".to_owned() }).await.err(),
    ];
    for status in unknown {
        check(&status.expect("refused"), Code::NotFound, &["attic", "office"]);
    }
    let describe = DescribeModelRequest { map: "office".to_owned(), state: "gate".to_owned() };
    check(&queries.describe_model(describe).await.expect_err("refused"), Code::NotFound, &["gate", "door"]);
    let predict = predict(&["door", "gate"], &[0]);
    check(&queries.predict_states(predict).await.expect_err("refused"), Code::NotFound, &["gate", "door"]);
    for status in [
        maintenance.get_job(v1::GetJobRequest { id: 99 }).await.err(),
        maintenance.watch_job(v1::WatchJobRequest { id: 99 }).await.err(),
        maintenance.get_update_report(v1::GetUpdateReportRequest { job_id: 99, ..Default::default() }).await.err(),
    ] {
        check(&status.expect("refused"), Code::NotFound, &["99"]);
    }
    assert_eq!(observations(&daemon).await, 1);
}

fn predict(states: &[&str], times_nanos: &[i64]) -> PredictStatesRequest {
    PredictStatesRequest {
        map: "office".to_owned(),
        states: states.iter().map(|&state| state.to_owned()).collect(),
        times_nanos: times_nanos.to_vec(),
        model: None,
        interval_level: 0.0,
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn questions_that_make_no_sense_name_their_field() {
    let (_data, daemon) = office(|launch| launch.setting("max_predictions", 10)).await;
    let (mut stream, _) = RawStream::open(&daemon.grpc, hello("robot", "office")).await.expect("a Welcome");
    stream.batch(1, columns(&["door"], &[(0, 1_000, 1.0)])).await;
    stream.acknowledged(1).await.expect("taken");
    let mut queries = QueryServiceClient::new(daemon.client().requests());
    let with = |kind: i32, order| PredictStatesRequest {
        model: Some(ModelSelector { kind, order, ..ModelSelector::default() }),
        ..predict(&["door"], &[0])
    };
    let selected = |model| PredictStatesRequest { model: Some(model), ..predict(&["door"], &[0]) };
    let of_kind = |kind: ModelKind| ModelSelector { kind: kind.into(), ..ModelSelector::default() };
    let fine = |kind, parameter| selected(ModelSelector { parameter: Some(parameter), ..of_kind(kind) });
    let of_cycle = |kind, cycle| selected(ModelSelector { cycle, ..of_kind(kind) });
    let of_period = |kind, seconds| {
        let period = Some(prost_types::Duration { seconds, nanos: 0 });
        selected(ModelSelector { period, ..of_kind(kind) })
    };
    let with_level = |interval_level| PredictStatesRequest { interval_level, ..predict(&["door"], &[0]) };
    for (request, code, words) in [
        (predict(&[], &[0]), Code::InvalidArgument, ["states", "one"]),
        (predict(&["door"], &[]), Code::InvalidArgument, ["times_nanos", "one"]),
        (predict(&["door"], &[0, 5, -7]), Code::InvalidArgument, ["times_nanos[2]", "-7"]),
        (with_level(1.0), Code::InvalidArgument, ["interval_level", "1"]),
        (with_level(-0.1), Code::InvalidArgument, ["interval_level", "-0.1"]),
        (with_level(f64::NAN), Code::InvalidArgument, ["interval_level", "NaN"]),
        (predict(&["door"; 11], &[0]), Code::ResourceExhausted, ["max_predictions", "11"]),
        (predict(&["door"], &[0; 11]), Code::ResourceExhausted, ["max_predictions", "11"]),
        (with(99, None), Code::InvalidArgument, ["model.kind", "99"]),
        (with(ModelKind::Spectral.into(), Some(16)), Code::InvalidArgument, ["model.order", "16"]),
        (with(ModelKind::Mean.into(), Some(1)), Code::InvalidArgument, ["model.order", "1"]),
        (with(ModelKind::Pergam.into(), Some(3)), Code::InvalidArgument, ["model.order", "3"]),
        (fine(ModelKind::Histogram, 0), Code::InvalidArgument, ["model.parameter", "0"]),
        (fine(ModelKind::Histogram, 1441), Code::InvalidArgument, ["model.parameter", "1441"]),
        (fine(ModelKind::Pergam, 1000), Code::InvalidArgument, ["model.parameter", "1000"]),
        (fine(ModelKind::HypertimeEm, 1_000_000), Code::InvalidArgument, ["model.parameter", "1000000"]),
        (fine(ModelKind::HypertimeKm, u32::MAX), Code::InvalidArgument, ["model.parameter", "4294967295"]),
        (fine(ModelKind::Spectral, 3), Code::InvalidArgument, ["model.parameter", "3"]),
        (of_cycle(ModelKind::Pergam, 2), Code::InvalidArgument, ["model.cycle", "histogram"]),
        (of_period(ModelKind::Histogram, 604_800), Code::InvalidArgument, ["model.period", "pergam"]),
        (of_period(ModelKind::Pergam, 59), Code::InvalidArgument, ["model.period", "1 minute to 366 days"]),
        (of_period(ModelKind::Pergam, i64::MAX), Code::InvalidArgument, ["model.period", "292 years"]),
        (of_period(ModelKind::Pergam, -604_800), Code::InvalidArgument, ["model.period", "-604800"]),
        (of_cycle(ModelKind::Histogram, 9), Code::InvalidArgument, ["model.cycle", "9"]),
        (
            PredictStatesRequest { states: vec!["cell/0/0/0".to_owned()], ..fine(ModelKind::Pergam, 3) },
            Code::FailedPrecondition,
            ["office", "no grid"],
        ),
    ] {
        check(&queries.predict_states(request).await.expect_err("refused"), code, &words);
    }
    let mut answers = queries.predict_states(predict(&["door"; 5], &[0; 2])).await.expect("allowed").into_inner();
    let mut count = 0;
    while let Some(answer) = answers.message().await.expect("an answer") {
        count += answer.probabilities.len();
    }
    assert_eq!(count, 10, "as many as allowed are answered");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_evaluation_of_what_cannot_be_is_refused_whole() {
    use v1::{EvaluateHeader, EvaluateStatesRequest, evaluate_states_request::Message};
    let (_data, daemon) = office(|launch| launch).await;
    let (mut stream, _) = RawStream::open(&daemon.grpc, hello("robot", "office")).await.expect("a Welcome");
    stream.batch(1, columns(&["door"], &[(0, 1_000, 1.0)])).await;
    stream.acknowledged(1).await.expect("taken");
    let header =
        |map: &str, max_order| Message::Header(EvaluateHeader { map: map.to_owned(), models: Vec::new(), max_order });
    let rows = |names: &[&str], rows: &[_]| Message::Observations(columns(names, rows));
    for (messages, code, words) in [
        (vec![], Code::InvalidArgument, ["header", "first"]),
        (vec![rows(&["door"], &[(0, 0, 1.0)])], Code::InvalidArgument, ["header", "first"]),
        (vec![header("attic", None)], Code::NotFound, ["attic", "office"]),
        (vec![header("office", Some(16))], Code::InvalidArgument, ["max_order", "16"]),
        (vec![header("office", None), header("office", None)], Code::InvalidArgument, ["observations", "message"]),
        (vec![header("office", None), rows(&["gate"], &[(0, 0, 1.0)])], Code::NotFound, ["gate", "door"]),
        (vec![header("office", None), rows(&["door"], &[(0, 0, 1.5)])], Code::InvalidArgument, ["values", "1.5"]),
        (vec![header("office", None), rows(&["door"], &[(0, -4, 1.0)])], Code::InvalidArgument, ["times", "-4"]),
        (vec![header("office", None), rows(&["door"], &[(3, 0, 1.0)])], Code::InvalidArgument, ["state_indices", "3"]),
    ] {
        let requests = messages.into_iter().map(|message| EvaluateStatesRequest { message: Some(message) });
        let requests: Vec<EvaluateStatesRequest> = requests.collect();
        let mut queries = QueryServiceClient::new(daemon.client().requests());
        let answer = queries.evaluate_states(tokio_stream::iter(requests)).await;
        check(&answer.expect_err("refused"), code, &words);
    }
    assert_eq!(observations(&daemon).await, 1, "what is evaluated is not learned");
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_follow_each_other_and_wrong_tokens_are_named() {
    let (_data, daemon) = office(|launch| launch).await;
    let (mut stream, _) = RawStream::open(&daemon.grpc, hello("robot", "office")).await.expect("a Welcome");
    let rows: Vec<_> = (0..5).map(|i| (i, 1_000, 1.0)).collect();
    stream.batch(1, columns(&["a", "b", "c", "d", "e"], &rows)).await;
    stream.acknowledged(5).await.expect("taken");
    let channel = daemon.client().requests();
    let mut maps = MapServiceClient::new(channel.clone());
    let mut maintenance = MaintenanceServiceClient::new(channel);
    let request = |page_size, token: &str| ListStatesRequest {
        map: "office".to_owned(),
        page_size,
        page_token: token.to_owned(),
    };
    let (mut names, mut token) = (Vec::new(), String::new());
    loop {
        let page = maps.list_states(request(2, &token)).await.expect("a page").into_inner();
        assert!(page.states.len() <= 2);
        names.extend(page.states.into_iter().map(|state| state.name));
        token = page.next_page_token;
        if token.is_empty() {
            break;
        }
    }
    assert_eq!(names, ["a", "b", "c", "d", "e"]);
    let bad = "not-a-token";
    for (status, words) in [
        (maps.list_states(request(2, bad)).await.err(), ["page_token", bad]),
        (maps.list_states(request(2, "-1")).await.err(), ["page_token", "-1"]),
        (maps.list_states(request(10_001, "")).await.err(), ["page_size", "10001"]),
        (maps.list_maps(ListMapsRequest { page_size: 1, page_token: bad.to_owned() }).await.err(), ["page_token", bad]),
        (maps.list_maps(ListMapsRequest { page_size: 1_001, ..Default::default() }).await.err(), ["page_size", "1001"]),
        (
            maintenance.list_jobs(v1::ListJobsRequest { page_size: 1, page_token: bad.to_owned() }).await.err(),
            ["page_token", bad],
        ),
    ] {
        check(&status.expect("refused"), Code::InvalidArgument, &words);
    }
    let far = maps.list_states(request(2, &u64::MAX.to_string())).await.expect("beyond the end").into_inner();
    assert_eq!((far.states.len(), far.next_page_token.as_str()), (0, ""));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_update_until_an_impossible_time_is_refused() {
    let (_data, daemon) = office(|launch| launch).await;
    let mut maintenance = MaintenanceServiceClient::new(daemon.client().requests());
    for seconds in [-1, 9_223_372_037, i64::MAX] {
        let request = RunUpdateRequest { map: "office".to_owned(), until: Some(Timestamp { seconds, nanos: 0 }) };
        let status = maintenance.run_update(request).await.expect_err("refused");
        check(&status, Code::InvalidArgument, &["until", &seconds.to_string()]);
    }
    assert_eq!(daemon.client().map("office").await.expect("the map").last_update.generation, 0);
}

/// Peak resident memory of the daemon, in bytes.
fn peak_bytes(daemon: &tidemap_tests::daemon::Daemon) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", daemon.process().pid())).expect("a process");
    let line = status.lines().find(|line| line.starts_with("VmHWM:")).expect("a peak");
    line.split_whitespace().nth(1).and_then(|kib| kib.parse::<u64>().ok()).expect("a number") * 1024
}

#[tokio::test(flavor = "multi_thread")]
async fn empty_elements_are_counted_before_they_take_memory() {
    let (_data, daemon) = office(|launch| launch).await;
    let before = peak_bytes(&daemon);
    // 11 MB of edges without a name would take half a gigabyte.
    let hostile = || v1::LoadTopologyRequest {
        map: "office".to_owned(),
        edges: vec![v1::TopologyEdge::default(); 5_500_000],
        ..v1::LoadTopologyRequest::default()
    };
    let mut topologies = v1::topology_service_client::TopologyServiceClient::new(daemon.client().requests());
    let refused = topologies.load_topology(hostile()).await.expect_err("too many");
    check(&refused, Code::ResourceExhausted, &["LoadTopologyRequest.edges", "250000"]);
    let grown = peak_bytes(&daemon) - before;
    assert!(grown < 100 << 20, "{grown} bytes for one request");
    let names = vec![String::new(); 70_000];
    let many = PredictStatesRequest { map: "office".to_owned(), states: names, ..Default::default() };
    let refused = QueryServiceClient::new(daemon.client().requests()).predict_states(many).await;
    check(&refused.expect_err("too many"), Code::ResourceExhausted, &["PredictStatesRequest.states", "65536"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn who_reads_no_replies_does_not_stop_the_queries_of_others() {
    let (_data, daemon) = office(|launch| launch).await;
    let (mut stream, _) = RawStream::open(&daemon.grpc, hello("robot", "office")).await.expect("a Welcome");
    stream.batch(1, columns(&["door"], &[(0, 1_000, 1.0), (0, 2_000, 0.0)])).await;
    stream.acknowledged(2).await.expect("taken");
    let ask = |times: usize| PredictStatesRequest {
        map: "office".to_owned(),
        states: vec!["door".to_owned()],
        times_nanos: (0..times as i64).map(|hour| hour * 3_600_000_000_000).collect(),
        ..Default::default()
    };
    // Sixteen clients send requests that take long, and read nothing.
    let mut unread = Vec::new();
    for _ in 0..16 {
        let mut queries = QueryServiceClient::new(daemon.client().requests());
        let many = PredictStatesRequest { states: vec!["door".to_owned(); 50], ..ask(100_000) };
        unread.push(tokio::spawn(async move { queries.predict_states(many).await }));
    }
    let mut queries = QueryServiceClient::new(daemon.client().requests());
    tokio::time::sleep(std::time::Duration::from_millis(300)).await;
    let short = async {
        for _ in 0..20 {
            let mut replies = queries.predict_states(ask(24)).await.expect("answered").into_inner();
            let reply = replies.message().await.expect("answered").expect("one state");
            assert_eq!(reply.probabilities.len(), 24);
        }
    };
    // If they waited for the readers of others, each would take half a minute.
    tokio::time::timeout(std::time::Duration::from_secs(120), short).await.expect("they wait for no reader");
    drop(unread);
    daemon.stop_in_order();
}
