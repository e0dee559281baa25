//! The interfaces of the two ports for operators: health, reflection, metrics.

use tempfile::tempdir;
use tidemap_client::maps::NewMap;
use tidemap_tests::{
    daemon::{Daemon, Launch},
    stream::{RawStream, columns, hello},
};
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::TcpStream,
};
use tokio_stream::StreamExt as _;
use tonic_health::pb::{HealthCheckRequest, health_check_response::ServingStatus, health_client::HealthClient};
use tonic_reflection::pb::v1::{
    ServerReflectionRequest, server_reflection_client::ServerReflectionClient, server_reflection_request,
    server_reflection_response,
};

/// Status line and body of a GET.
pub(super) async fn get(daemon: &Daemon, path: &str) -> (String, String) {
    let mut connection = TcpStream::connect(&daemon.http).await.expect("the port is open");
    let request = format!("GET {path} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n\r\n", daemon.http);
    connection.write_all(request.as_bytes()).await.expect("a request");
    let mut text = String::new();
    connection.read_to_string(&mut text).await.expect("an answer");
    let (head, body) = text.split_once("\r\n\r\n").expect("a head and a body");
    (head.lines().next().expect("a status line").to_owned(), body.to_owned())
}

/// The value of a metric; `name` ends with the labels, if it has any.
pub(super) fn metric(text: &str, name: &str) -> Option<f64> {
    text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' ')?.parse().ok())
}

#[tokio::test(flavor = "multi_thread")]
async fn http_shows_life_readiness_and_metrics_and_nothing_about_maps() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    let map = NewMap { name: "secret-lab".to_owned(), ..NewMap::default() };
    daemon.client().create_map(map).await.expect("a new map");
    let (mut stream, _) = RawStream::open(&daemon.grpc, hello("robot", "secret-lab")).await.expect("a Welcome");
    stream.batch(1, columns(&["door"], &[(0, 1_000, 1.0), (0, 2_000, 7.0), (0, 3_000, 0.0)])).await;
    stream.acknowledged(3).await.expect("taken");

    for path in ["/", "/healthz", "/readyz", "/metrics"] {
        let (status, body) = get(&daemon, path).await;
        assert_eq!(status, "HTTP/1.1 200 OK", "{path}");
        // Metrics name maps and producers to those who may list them anyway.
        assert!(!body.is_empty() && (path == "/metrics" || !body.contains("secret-lab")), "{path}: {body}");
    }
    assert_eq!(get(&daemon, "/elsewhere").await.0, "HTTP/1.1 404 Not Found");
    let (_, metrics) = get(&daemon, "/metrics").await;
    for (name, value) in [
        ("tidemap_maps", 1.0),
        ("tidemap_states", 1.0),
        ("tidemap_observations", 2.0),
        ("tidemap_observations_total", 2.0),
        ("tidemap_refused_total", 1.0),
        ("tidemap_streams", 1.0),
    ] {
        assert_eq!(metric(&metrics, name), Some(value), "{name} in:\n{metrics}");
    }
    assert!(metric(&metrics, "tidemap_fdatasyncs").is_some_and(|count| count >= 1.0), "{metrics}");
}

#[tokio::test(flavor = "multi_thread")]
async fn every_metric_has_an_explanation_and_the_important_ones_are_there() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    let map = NewMap { name: "lab".to_owned(), ..NewMap::default() };
    daemon.client().create_map(map).await.expect("a new map");
    let (mut stream, _) = RawStream::open(&daemon.grpc, hello("robot", "lab")).await.expect("a Welcome");
    stream.batch(1, columns(&["door"], &[(0, 1_000, 1.0)])).await;
    stream.acknowledged(1).await.expect("taken");
    daemon.client().map("nowhere").await.expect_err("there is none");
    let (_, metrics) = get(&daemon, "/metrics").await;
    let names: std::collections::BTreeSet<&str> =
        metrics.lines().filter_map(|line| line.strip_prefix("# TYPE ")?.split(' ').next()).collect();
    for name in &names {
        assert!(metrics.contains(&format!("# HELP {name} ")), "{name} has no description");
    }
    for line in [
        "tidemap_acknowledgement_seconds_count 1",
        "tidemap_requests_total{method=\"/tidemap.v1.MapService/GetMap\",code=\"NOT_FOUND\"} 1",
        "tidemap_requests_total{method=\"/tidemap.v1.MapService/CreateMap\",code=\"OK\"} 1",
        "tidemap_request_duration_seconds_bucket{method=\"/tidemap.v1.MapService/CreateMap\",le=\"+Inf\"} 1",
        "tidemap_jobs_running 0",
        "tidemap_job_progress_ratio 1",
    ] {
        assert!(metrics.contains(line), "{line} in:\n{metrics}");
    }
    for name in ["process_resident_memory_bytes", "process_open_fds", "process_max_fds", "tidemap_disk_free_bytes"] {
        assert!(metric(&metrics, name).is_some_and(|value| value > 0.0), "{name} in:\n{metrics}");
    }
}

#[test]
fn the_dashboard_and_the_alerts_name_metrics_that_exist_and_each_alert_is_explained() {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../");
    let read = |path: &str| std::fs::read_to_string(root.to_owned() + path).expect(path);
    let described = read("server/base/src/telemetry/descriptions.rs");
    for file in ["deploy/monitoring/alerts.yaml", "deploy/monitoring/dashboard.json"] {
        let names = named_metrics(&read(file));
        assert!(names.len() > 10, "{file} names {names:?}");
        for name in names {
            let base = ["_bucket", "_count", "_sum"].iter().find_map(|end| name.strip_suffix(end)).unwrap_or(&name);
            assert!(
                described.contains(&format!("(\"{base}\"")) || described.contains(&format!("\"{base}\",")),
                "{name}"
            );
        }
    }
    let page = read("docs/src/alerts.md");
    let alerts = read("deploy/monitoring/alerts.yaml");
    let names: Vec<&str> = alerts.lines().filter_map(|line| line.trim().strip_prefix("- alert: ")).collect();
    assert!(names.len() >= 14, "{names:?}");
    for name in &names {
        assert!(page.contains(&format!("\n## {name}\n")), "docs/src/alerts.md does not explain {name}");
        assert!(alerts.contains(&format!("\"alerts.md#{}\"", name.to_lowercase())), "{name} has no runbook");
    }
    let explained = page.lines().filter_map(|line| line.strip_prefix("## Tidemap")).count();
    assert_eq!(explained, names.len(), "docs/src/alerts.md explains an alert that does not exist");
}

/// The metrics that a text names.
fn named_metrics(text: &str) -> Vec<String> {
    let is_name = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    let words = text.split(|c| !is_name(c));
    words.filter(|word| word.starts_with("tidemap_") || word.starts_with("process_")).map(str::to_owned).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn grpc_has_health_for_the_daemon_and_its_services() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    let mut health = HealthClient::new(daemon.client().requests());
    for service in ["", "tidemap.v1.ObservationService", "tidemap.v1.QueryService"] {
        let answer = health.check(HealthCheckRequest { service: service.to_owned() }).await.expect(service);
        assert_eq!(answer.into_inner().status(), ServingStatus::Serving, "{service}");
    }
    let unknown = health.check(HealthCheckRequest { service: "elsewhere".to_owned() }).await;
    assert_eq!(unknown.expect_err("no such service").code(), tonic::Code::NotFound);
}

#[tokio::test(flavor = "multi_thread")]
async fn grpc_lists_which_services_there_are() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    let mut reflection = ServerReflectionClient::new(daemon.client().requests());
    let request = ServerReflectionRequest {
        host: String::new(),
        message_request: Some(server_reflection_request::MessageRequest::ListServices(String::new())),
    };
    let mut answers =
        reflection.server_reflection_info(tokio_stream::once(request)).await.expect("reflection").into_inner();
    let answer = answers.next().await.expect("an answer").expect("a good one").message_response;
    let Some(server_reflection_response::MessageResponse::ListServicesResponse(list)) = answer else {
        panic!("no list of services: {answer:?}");
    };
    let names: Vec<&str> = list.service.iter().map(|service| service.name.as_str()).collect();
    for service in ["MapService", "ObservationService", "QueryService", "MaintenanceService"] {
        assert!(names.contains(&format!("tidemap.v1.{service}").as_str()), "{service} is not in {names:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn older_tools_find_the_services_too() {
    use tonic_reflection::pb::v1alpha::{
        ServerReflectionRequest, server_reflection_client::ServerReflectionClient,
        server_reflection_request::MessageRequest, server_reflection_response::MessageResponse,
    };
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    let mut reflection = ServerReflectionClient::new(daemon.client().requests());
    let symbol = "tidemap.v1.QueryService.PredictStates".to_owned();
    let request = ServerReflectionRequest {
        host: String::new(),
        message_request: Some(MessageRequest::FileContainingSymbol(symbol)),
    };
    let mut answers =
        reflection.server_reflection_info(tokio_stream::once(request)).await.expect("reflection").into_inner();
    let answer = answers.next().await.expect("an answer").expect("a good one").message_response;
    assert!(matches!(answer, Some(MessageResponse::FileDescriptorResponse(_))), "{answer:?}");
}

#[test]
fn a_port_in_use_names_its_option_and_nothing_is_created() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(&data.path().join("first")).start();
    let other = data.path().join("second");
    for (option, listen, http) in
        [("--listen", daemon.grpc.as_str(), "127.0.0.1:0"), ("--http-listen", "127.0.0.1:0", daemon.http.as_str())]
    {
        let output = std::process::Command::new(tidemap_tests::binaries::tidemapd())
            .args(["--listen", listen.trim_start_matches("http://"), "--http-listen", http])
            .arg("--data-dir")
            .arg(&other)
            .output()
            .expect("the daemon can be started");
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(69), "{text}");
        assert!(text.contains(&format!("Choose another with {option}")), "{text}");
        assert!(!other.exists(), "nothing was created");
    }
}
