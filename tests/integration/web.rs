//! The HTTP port: RPCs as JSON and gRPC-Web, with the same permissions and limits as over gRPC, and closed to the pages
//! of others.

mod links;
mod recordings;
mod reference;

use serde_json::{Value, json};
use tempfile::tempdir;
use tidemap_client::{maps::NewMap, queries::ModelSelector};
use tidemap_tests::{
    daemon::{Daemon, Launch},
    stream::{RawStream, columns, hello},
    tokens::Tokens,
    web::{Answer, call, request},
};

async fn daemon_with_a_door(data: &std::path::Path) -> Daemon {
    let daemon = Launch::on(data).start();
    let map = NewMap { name: "home".to_owned(), ..NewMap::default() };
    daemon.client().create_map(map).await.expect("a new map");
    let (mut stream, _) = RawStream::open(&daemon.grpc, hello("robot", "home")).await.expect("a Welcome");
    stream.batch(1, columns(&["door"], &[(0, 1_000, 1.0), (0, 2_000_000_000, 0.0)])).await;
    stream.acknowledged(2).await.expect("taken");
    daemon
}

/// One message of gRPC-Web.
fn grpc_web(daemon: &Daemon, method: &str, headers: &[(&str, &str)], message: &[u8]) -> Answer {
    let mut body = vec![0];
    body.extend(u32::try_from(message.len()).expect("short").to_be_bytes());
    body.extend(message);
    let mut all = vec![("content-type", "application/grpc-web+proto"), ("x-grpc-web", "1")];
    all.extend_from_slice(headers);
    request(&daemon.http, "POST", &format!("/tidemap.v1.{method}"), &all, &body)
}

#[tokio::test(flavor = "multi_thread")]
async fn every_rpc_that_takes_one_request_is_there_as_json() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).setting("http_write", true).start();
    let document = request(&daemon.http, "GET", "/api/v1/openapi.json", &[], b"");
    assert_eq!(document.code, 200);
    let document = document.json();
    let paths = document["paths"].as_object().expect("paths").iter();
    let is_method = |path: &str, methods: &Value| methods["post"].is_object() && !path.contains("/recordings/");
    let paths: Vec<&String> = paths.filter(|(path, methods)| is_method(path, methods)).map(|(path, _)| path).collect();
    assert!(paths.len() >= 40, "{paths:?}");
    for path in paths {
        let headers = [("content-type", "application/json")];
        for body in ["{}", "", "{\"map\":\"nowhere\"}", "{\"map\":\"a/../b\"}", "[]", "{", "{\"nonsense\":1}", "null"] {
            let answer = request(&daemon.http, "POST", path, &headers, body.as_bytes());
            assert!(answer.code < 500, "{path} {body}: {}", answer.text());
            if answer.code != 200 {
                let error = &answer.json()["error"];
                assert!(error["code"].is_string() && error["message"].is_string(), "{path} {body}: {error}");
            }
        }
        assert_eq!(request(&daemon.http, "GET", path, &[], b"").code, 405, "{path}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn json_and_grpc_give_equal_answers() {
    let data = tempdir().expect("a folder");
    let daemon = daemon_with_a_door(data.path()).await;
    let map = call(&daemon.http, "MapService/GetMap", &[], &json!({ "name": "home" }));
    assert_eq!((map.code, map.json()["map"]["observations"].as_str()), (200, Some("2")), "{}", map.text());

    let request = json!({ "map": "home", "states": ["door"], "timesNanos": ["5000000000", "9000000000"] });
    let answer = call(&daemon.http, "tidemap.v1.QueryService/PredictStates", &[], &request);
    assert_eq!((answer.code, answer.headers["content-type"].as_str()), (200, "application/x-ndjson"));
    let line: Value = serde_json::from_str(answer.text().trim_end()).expect("one line");
    let times = vec![5_000_000_000, 9_000_000_000];
    let mut typed = daemon.client().predict("home", vec!["door".to_owned()], times, ModelSelector::default());
    let typed = typed.next().await.expect("a good one").expect("one");
    let same: Vec<f64> = line["probabilities"].as_array().expect("numbers").iter().filter_map(|p| p.as_f64()).collect();
    assert_eq!(same, typed.probabilities);

    let unknown = call(&daemon.http, "MapService/GetMap", &[], &json!({ "name": "hone" }));
    assert_eq!((unknown.code, unknown.reason().as_str()), (404, "UNKNOWN_MAP"));
    assert!(unknown.text().contains("home"), "the message lists the maps: {}", unknown.text());
    let misspelt = call(&daemon.http, "MapService/GetMap", &[], &json!({ "nmae": "home" }));
    assert!(misspelt.code == 400 && misspelt.text().contains("'nmae' at line 1"), "{}", misspelt.text());
    let elsewhere = call(&daemon.http, "MapService/Explode", &[], &json!({}));
    assert_eq!((elsewhere.code, elsewhere.reason().as_str()), (404, "UNKNOWN_METHOD"));
    let stream = call(&daemon.http, "ObservationService/Observe", &[], &json!({}));
    assert_eq!((stream.code, stream.reason().as_str()), (400, "STREAM"));
}

#[tokio::test(flavor = "multi_thread")]
async fn requests_are_json_and_of_bounded_size() {
    let data = tempdir().expect("a folder");
    let daemon = daemon_with_a_door(data.path()).await;
    for media in ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data"] {
        let answer = request(&daemon.http, "POST", "/api/v1/MapService/ListMaps", &[("content-type", media)], b"{}");
        assert_eq!(answer.code, 415, "{media}");
    }
    assert_eq!(request(&daemon.http, "POST", "/api/v1/MapService/ListMaps", &[], b"{}").code, 415);
    let large = format!("{{\"name\":\"{}\"}}", "a".repeat(2 << 20));
    let headers = [("content-type", "application/json")];
    let answer = request(&daemon.http, "POST", "/api/v1/MapService/GetMap", &headers, large.as_bytes());
    assert_eq!((answer.code, answer.reason().as_str()), (413, "LIMIT"));
    let deep = "[".repeat(200_000);
    let answer = request(&daemon.http, "POST", "/api/v1/MapService/GetMap", &headers, deep.as_bytes());
    assert_eq!((answer.code, answer.reason().as_str()), (400, "INVALID_JSON"));
}

#[tokio::test(flavor = "multi_thread")]
async fn grpc_web_serves_browsers() {
    let data = tempdir().expect("a folder");
    let daemon = daemon_with_a_door(data.path()).await;
    let answer = grpc_web(&daemon, "MapService/ListMaps", &[], b"");
    assert_eq!(answer.code, 200);
    assert!(answer.text().contains("home") && answer.text().contains("grpc-status:0"), "{}", answer.text());
    assert_eq!(request(&daemon.http, "POST", "/tidemap.v1.MapService/ListMaps", &[], b"").code, 400);
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_of_others_are_refused() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).setting("http_write", true).setting("http_hosts", "[\"lab.example\"]").start();
    let list = |headers: &[(&str, &str)]| call(&daemon.http, "MapService/ListMaps", headers, &json!({}));
    let own = format!("http://{}", daemon.http);
    assert_eq!(list(&[("origin", &own)]).code, 200);
    for headers in [
        [("origin", "https://evil.example")],
        [("origin", "null")],
        [("host", "evil.example")],
        [("host", "evil.example:7436")],
        [("sec-fetch-site", "cross-site")],
    ] {
        let answer = list(&headers);
        assert_eq!((answer.code, answer.reason().as_str()), (403, "FOREIGN_REQUEST"), "{headers:?}");
        assert!(!answer.headers.contains_key("access-control-allow-origin"));
        assert_eq!(grpc_web(&daemon, "MapService/ListMaps", &headers, b"").code, 403);
        let create = call(&daemon.http, "MapService/CreateMap", &headers, &json!({ "name": "stolen" }));
        assert_eq!(create.code, 403);
    }
    assert_eq!(list(&[("host", "lab.example:80")]).code, 200);
    assert_eq!(list(&[]).json()["maps"].as_array().map(Vec::len), Some(0), "nothing was created");
    // Health and metrics contain nothing about maps, and monitors reach them by any name.
    for path in ["/healthz", "/readyz", "/metrics"] {
        assert_eq!(request(&daemon.http, "GET", path, &[("host", "tidemap.lab")], b"").code, 200, "{path}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn without_tokens_the_port_is_for_reading_unless_the_operator_allows_more() {
    let data = tempdir().expect("a folder");
    let daemon = daemon_with_a_door(data.path()).await;
    let create = json!({ "name": "new" });
    for (method, body) in [
        ("MapService/CreateMap", &create),
        ("MapService/DeleteMap", &json!({ "name": "home" })),
        ("MapService/AddState", &json!({ "map": "home", "state": "window" })),
        ("MaintenanceService/RunUpdate", &json!({ "map": "home" })),
    ] {
        let answer = call(&daemon.http, method, &[], body);
        assert_eq!((answer.code, answer.reason().as_str()), (403, "READ_ONLY"), "{method}: {}", answer.text());
        assert!(answer.text().contains("--http-write"), "{}", answer.text());
    }
    assert_eq!(grpc_web(&daemon, "MapService/DeleteMap", &[], b"").headers["grpc-status"], "7");
    drop(daemon);
    let daemon = Launch::on(data.path()).args(["--http-write"]).start();
    let created = call(&daemon.http, "MapService/CreateMap", &[], &create);
    assert_eq!(created.code, 200, "{}", created.text());
}

#[tokio::test(flavor = "multi_thread")]
async fn with_tokens_they_decide() {
    let work = tempdir().expect("a folder");
    let tokens = Tokens::of(work.path());
    let planner = format!("Bearer {}", tokens.create(&["planner"], &["home"]));
    let admin = format!("Bearer {}", tokens.create(&["admin"], &[]));
    let data = work.path().join("data");
    let daemon = Launch::on(&data).setting("tokens_file", tokens.path.display()).start();
    let create = json!({ "name": "home" });
    let answer = call(&daemon.http, "MapService/CreateMap", &[], &create);
    assert_eq!((answer.code, answer.reason().as_str()), (401, "NO_TOKEN"));
    let answer = call(&daemon.http, "MapService/CreateMap", &[("authorization", &planner)], &create);
    assert_eq!((answer.code, answer.reason().as_str()), (403, "NEEDS_ROLE"));
    for name in ["home", "workshop"] {
        let answer = call(&daemon.http, "MapService/CreateMap", &[("authorization", &admin)], &json!({ "name": name }));
        assert_eq!(answer.code, 200, "{}", answer.text());
    }
    let answer = call(&daemon.http, "MapService/ListMaps", &[("authorization", &planner)], &json!({}));
    assert!(answer.text().contains("home") && !answer.text().contains("workshop"), "{}", answer.text());
    let answer = grpc_web(&daemon, "MapService/ListMaps", &[("authorization", &planner)], b"");
    assert!(answer.text().contains("home") && !answer.text().contains("workshop"), "{}", answer.text());
    let answer = grpc_web(&daemon, "MapService/ListMaps", &[], b"");
    assert_eq!(answer.headers["grpc-status"], "16", "{answer:?}");
}
