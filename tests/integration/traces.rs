//! Traces: a collector gets the spans of what the daemon did, and a collector that fails costs nothing but spans.

use std::{net::TcpListener, time::Duration};

use serde_json::json;
use tempfile::tempdir;
use tidemap_client::{Client, maps::NewMap};
use tidemap_tests::{
    collector::{Collector, attribute},
    daemon::{Daemon, Launch},
    oracle::run_update,
    tokens::Tokens,
    web::{call, request},
};

/// A trace that a caller has begun, recorded and not.
const RECORDED: &str = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01";
const NOT_RECORDED: &str = "00-11111111111111111111111111111111-b7ad6b7169203331-00";

async fn create_map(client: &Client) {
    client.create_map(NewMap { name: "home".to_owned(), ..NewMap::default() }).await.expect("a new map");
}

fn metric(daemon: &Daemon, name: &str) -> f64 {
    let text = request(&daemon.http, "GET", "/metrics", &[], b"").text();
    let line = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
    line.map_or(f64::NAN, |value| value.parse().expect("a number"))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_collector_gets_spans_of_requests_commits_jobs_and_checkpoints() {
    let work = tempdir().expect("a folder");
    let tokens = Tokens::of(work.path());
    let secret = tokens.create(&["admin"], &[]);
    let collector = Collector::start().await;
    let launch = Launch::on(&work.path().join("data")).setting("tokens_file", tokens.path.display());
    let daemon = launch.setting("otlp_endpoint", &collector.endpoint).start();
    let client = Client::with_token(&daemon.grpc, &secret).expect("loopback needs no TLS");
    create_map(&client).await;
    let bearer = format!("Bearer {secret}");
    let ask = |method: &str, context: &str, body: serde_json::Value| {
        let headers = [("authorization", bearer.as_str()), ("traceparent", context)];
        call(&daemon.http, method, &headers, &body)
    };
    let reading = json!([{ "state": "door", "value": 1.0, "time": "2026-03-21T10:00:00Z" }]);
    let report = json!({ "map": "home", "producer": "robot", "readings": reading });
    assert_eq!(ask("ObservationService/Report", RECORDED, report).code, 200);
    run_update(&client, "home", None).await;
    assert_eq!(ask("MapService/GetMap", NOT_RECORDED, json!({ "name": "home" })).code, 200);
    assert_eq!(ask("MapService/GetMap", "", json!({ "name": "attic" })).code, 404);
    daemon.stop_in_order();

    let one = |name: &str| {
        let mut spans = collector.named(name);
        assert_eq!(spans.len(), 1, "{name}: {:#?}", collector.spans());
        let span = spans.pop().expect("one");
        assert!(span.end_time_unix_nano >= span.start_time_unix_nano && span.start_time_unix_nano > 0);
        span
    };
    let create = one("tidemap.v1.MapService/CreateMap");
    assert_eq!(attribute(&create, "rpc.method").as_deref(), Some("CreateMap"));
    assert_eq!(attribute(&create, "rpc.grpc.status_code").as_deref(), Some("0"));
    let report = one("tidemap.v1.ObservationService/Report");
    assert_eq!(hex(&report.trace_id), &RECORDED[3..35], "the trace of the caller goes on");
    assert_eq!(hex(&report.parent_span_id), &RECORDED[36..52]);
    assert_eq!(attribute(&report, "tidemap.map").as_deref(), Some("home"));
    // The span of the unrecorded trace is missing.
    let failed = one("tidemap.v1.MapService/GetMap");
    assert_eq!(attribute(&failed, "rpc.grpc.status_code").as_deref(), Some("5"));
    assert_eq!(attribute(&failed, "tidemap.map"), None, "there is no such map");
    assert_eq!(failed.status.map(|status| status.message).as_deref(), Some("NOT_FOUND"));
    for (name, parts) in [("commit", &["write", "fdatasync"][..]), ("update", &["wait", "learn", "publish"])] {
        let spans = collector.named(name);
        assert!(!spans.is_empty(), "{name}: {:#?}", collector.spans());
        for span in spans {
            assert_eq!(attribute(&span, "tidemap.map").as_deref(), Some("home"));
            for part in parts {
                let found = collector.named(part);
                assert!(
                    found.iter().any(|found| found.parent_span_id == span.span_id),
                    "{part} of {span:#?} in {found:#?}"
                );
            }
        }
    }
    assert_eq!(attribute(&one("update"), "tidemap.observations").as_deref(), Some("1"));
    assert_eq!(attribute(&one("checkpoint"), "tidemap.generation").as_deref(), Some("1"));
    let sent = String::from_utf8_lossy(&collector.bytes()).into_owned();
    assert!(sent.contains("service.name") && sent.contains("tidemapd"));
    let hidden = secret.rsplit('_').next().expect("the secret part");
    for (what, text) in [("the token", hidden), ("a path", &work.path().display().to_string()), ("a state", "door")] {
        assert!(!sent.contains(text), "{what} is in a span");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_collector_that_is_absent_or_hangs_costs_spans_only() {
    // It takes connections and sends nothing.
    let hanging = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let absent = TcpListener::bind("127.0.0.1:0").and_then(|socket| socket.local_addr()).expect("a free port");
    for address in [absent, hanging.local_addr().expect("an address")] {
        let work = tempdir().expect("a folder");
        let daemon = Launch::on(work.path()).setting("otlp_endpoint", format!("http://{address}")).start();
        let client = daemon.client();
        create_map(&client).await;
        let mut requests = 0;
        // A batch is given up after five seconds. Until then, and after, requests are answered.
        while metric(&daemon, "tidemap_spans_dropped_total") == 0.0 {
            client.map("home").await.expect("an answer");
            requests += 1;
            assert!(requests < 100_000, "spans should be dropped");
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
        assert_eq!(metric(&daemon, "tidemap_spans_exported_total"), 0.0);
        let log = daemon.stop_in_order();
        assert_eq!(log.matches("spans cannot be sent").count(), 1, "{log}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_share_of_the_traces_is_recorded() {
    let work = tempdir().expect("a folder");
    let collector = Collector::start().await;
    let launch = Launch::on(work.path()).setting("otlp_endpoint", &collector.endpoint);
    let daemon = launch.setting("trace_ratio", 0.0).start();
    create_map(&daemon.client()).await;
    let recorded = [("traceparent", RECORDED)];
    assert_eq!(call(&daemon.http, "MapService/GetMap", &recorded, &json!({ "name": "home" })).code, 200);
    daemon.stop_in_order();
    let names: Vec<String> = collector.spans().into_iter().map(|span| span.name).collect();
    assert_eq!(names, ["tidemap.v1.MapService/GetMap"], "only what its caller records");
}
