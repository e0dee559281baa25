//! Tokens: each role may call what it may, on its maps; a revoked one ends what it does.

use std::{
    fs,
    os::unix::fs::PermissionsExt as _,
    path::Path,
    time::{Duration, Instant},
};

use tempfile::tempdir;
use tidemap_client::{
    Client, Error,
    classify::{ClassifyRequest, LearnAs, Learning},
    maps::NewMap,
};
use tidemap_tests::{
    certificates::private_file,
    cli,
    daemon::{Daemon, Launch},
    raw_calls::{call, methods},
    tokens::Tokens,
};
use tonic::Code;
use tonic_health::pb::{HealthCheckRequest, health_client::HealthClient};

use super::eventually;

/// A refusal comes within this time, also on a busy machine.
const ANSWER_WITHIN: Duration = Duration::from_secs(30);
/// A stream that has not ended after this time was let in.
const LET_IN_AFTER: Duration = Duration::from_millis(500);

fn launch(folder: &Path, tokens: &Tokens) -> Launch {
    Launch::on(&folder.join("data")).setting("tokens_file", tokens.path.display())
}

fn client(daemon: &Daemon, token: &str) -> Client {
    Client::with_token(&daemon.grpc, token).expect("loopback needs no TLS")
}

async fn create_map(client: &Client, name: &str) {
    client.create_map(NewMap { name: name.to_owned(), ..NewMap::default() }).await.expect("a new map");
}

/// The roles that may call a method, from the documentation, written a second time.
fn roles_of(method: &str) -> &'static [&'static str] {
    match method {
        "GetMap" | "ListMaps" | "ListStates" | "ListLocations" | "ListNoGo" | "GetJob" | "ListJobs" | "WatchJob"
        | "GetUpdateReport" => &["observer", "planner", "operator", "admin"],
        "Observe" | "Report" | "AddState" | "ReportVisit" | "ReportTask" => &["observer", "operator", "admin"],
        "SetNoGo" | "DeleteNoGo" | "SetTask" | "RemoveTask" | "KeepPlan" | "AddLandmarks" | "RemoveLandmarks" => {
            &["operator", "admin"]
        }
        "SetCharger" | "SetLocation" | "DeleteLocation" | "LoadTopology" | "EditTopology" | "RunUpdate"
        | "ForgetProducer" => &["operator", "admin"],
        "CreateMap" | "DeleteMap" | "Erase" | "MoveMap" | "DiscardFork" | "ReadFork" => &["admin"],
        // These methods act on all maps, and none of these tokens is for all.
        "CreateBackup" | "Drain" | "ForgetMember" => &[],
        // Daemons of a cluster know a secret in place of a token.
        "FetchMap" => &[],
        _ => &["planner", "operator", "admin"],
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_method_is_for_its_roles_and_the_maps_of_the_token() {
    let work = tempdir().expect("a folder");
    let tokens = Tokens::of(work.path());
    let all = tokens.create(&["admin"], &[]);
    let roles = ["observer", "planner", "operator", "admin"];
    let held = roles.map(|role| (role, tokens.create(&[role], &["office*"])));
    let daemon = launch(work.path(), &tokens).start();
    for map in ["office", "secret"] {
        create_map(&client(&daemon, &all), map).await;
    }
    let methods = methods();
    assert!(methods.len() > 40 && methods.iter().filter(|method| method.names_a_map()).count() > 35);
    for method in &methods {
        for (role, token) in &held {
            let connection = client(&daemon, token).requests();
            let is_for_role = roles_of(&method.name).contains(role);
            let within = if is_for_role { LET_IN_AFTER } else { ANSWER_WITHIN };
            // Methods that create and delete do so to a map of their own.
            let map = if method.name == "DeleteMap" { "office-gone" } else { "office" };
            let code = call(connection.clone(), &method.path, method.request(map), within).await;
            let is_refused = matches!(code, Code::PermissionDenied | Code::Unauthenticated | Code::Unimplemented);
            assert_eq!(!is_refused, is_for_role, "{role} calls {}: {code:?}", method.path);
            if method.names_a_map() {
                for other in ["secret", "nowhere"] {
                    let code = call(connection.clone(), &method.path, method.request(other), ANSWER_WITHIN).await;
                    assert_eq!(code, Code::PermissionDenied, "{role} calls {} on {other}", method.path);
                }
            }
        }
        for (what, stranger) in [("none", daemon.client()), ("unknown", client(&daemon, &tokens_like(&all)))] {
            let code = call(stranger.requests(), &method.path, method.request("office"), ANSWER_WITHIN).await;
            assert_eq!(code, Code::Unauthenticated, "{what} calls {}", method.path);
        }
    }
    let mut health = HealthClient::new(daemon.client().requests());
    health.check(HealthCheckRequest::default()).await.expect("health is open");
    let watched = health.watch(HealthCheckRequest::default()).await.expect_err("but not watched by strangers");
    assert_eq!(watched.code(), Code::Unauthenticated);
    for path in ["/tidemap.v1.MapService/Elsewhere", "/elsewhere.Service/Method", "/"] {
        let code = call(client(&daemon, &all).requests(), path, "".into(), ANSWER_WITHIN).await;
        assert_eq!(code, Code::Unimplemented, "{path}");
    }
    daemon.stop_in_order();
}

/// Another token of the same id.
fn tokens_like(token: &str) -> String {
    let last = if token.ends_with('0') { "1" } else { "0" };
    format!("{}{last}", &token[..token.len() - 1])
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_sees_its_maps_only() {
    let work = tempdir().expect("a folder");
    let tokens = Tokens::of(work.path());
    let (all, lab) = (tokens.create(&["admin"], &[]), tokens.create(&["operator"], &["lab-*"]));
    let daemon = launch(work.path(), &tokens).start();
    let (admin, guest) = (client(&daemon, &all), client(&daemon, &lab));
    for map in ["lab-1", "office"] {
        create_map(&admin, map).await;
        admin.run_update(map, None).await.expect("an update");
    }
    let names = async |client: &Client| {
        let maps = client.maps().await.expect("a list");
        maps.into_iter().map(|map| map.name.clone()).collect::<Vec<String>>()
    };
    assert_eq!((names(&admin).await.len(), names(&guest).await), (2, vec!["lab-1".to_owned()]));
    let unknown = guest.map("lab-2").await.expect_err("no such map").to_string();
    assert!(unknown.contains("lab-1") && !unknown.contains("office"), "{unknown}");
    let (forbidden, absent) = (guest.map("office").await, guest.map("attic").await);
    let text = |result: Result<_, Error>| result.map(drop).expect_err("refused").to_string();
    assert_eq!(text(forbidden).replace("office", "attic"), text(absent));
    let jobs = admin.jobs().await.expect("jobs");
    let of_office = jobs.iter().find(|job| job.map == "office").expect("a job").id;
    assert!(guest.jobs().await.expect("jobs").iter().all(|job| job.map == "lab-1"));
    assert_eq!(guest.job(of_office).await.expect_err("unknown to it").code(), Some(Code::NotFound));
    assert_eq!(guest.statistics("").await.expect_err("all maps").code(), Some(Code::PermissionDenied));
    guest.statistics("lab-1").await.expect("its map");
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_revoked_token_ends_its_streams_and_others_go_on() {
    let work = tempdir().expect("a folder");
    let tokens = Tokens::of(work.path());
    let all = tokens.create(&["admin"], &[]);
    let (lost, kept) = (tokens.create(&["operator"], &["office"]), tokens.create(&["operator"], &["office"]));
    let daemon = launch(work.path(), &tokens).start();
    create_map(&client(&daemon, &all), "office").await;
    let methods = methods();
    let open = |token: &str, name: &str| {
        let method = methods.iter().find(|method| method.name == name).expect("a method");
        let connection = client(&daemon, token).requests();
        let (path, message) = (method.path.clone(), method.request("office"));
        tokio::spawn(async move { call(connection, &path, message, Duration::from_secs(20)).await })
    };
    let (watch, other_watch) = (open(&lost, "WatchAnomalies"), open(&kept, "WatchAnomalies"));
    let (mut robot, mut other_robot) = (stream(&daemon, &lost).await, stream(&daemon, &kept).await);
    // Both watches are open before the token goes.
    tokio::time::sleep(Duration::from_millis(500)).await;
    assert!(!watch.is_finished());

    let revoked = Instant::now();
    tokens.revoke(&lost);
    assert_eq!(watch.await.expect("a status"), Code::Unauthenticated);
    let ended = robot.message().await.expect_err("the stream ends");
    assert_eq!(ended.code(), Code::Unauthenticated, "{ended}");
    println!("streams ended {:.1} s after the revocation", revoked.elapsed().as_secs_f64());
    let refused = client(&daemon, &lost).maps().await.expect_err("revoked");
    assert_eq!(refused.code(), Some(Code::Unauthenticated));

    client(&daemon, &kept).maps().await.expect("still valid");
    assert!(tokio::time::timeout(LET_IN_AFTER, other_robot.message()).await.is_err(), "the other stream goes on");
    assert_eq!(other_watch.await.expect("a status"), Code::Ok);
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_sends_as_its_producers_only() {
    let work = tempdir().expect("a folder");
    let tokens = Tokens::of(work.path());
    let all = tokens.create(&["admin"], &[]);
    let made = tokens.run(&["create", "--role", "observer", "--producer", "robot-7", "--producer", "lab/*"]);
    let own = String::from_utf8(made.stdout).expect("text").trim().to_owned();
    let wrong = tokens.run(&["create", "--role", "observer", "--producer", "r*t"]);
    assert!(!wrong.status.success() && String::from_utf8_lossy(&wrong.stderr).contains("not a pattern of producers"));
    let listed = String::from_utf8(tokens.run(&["list"]).stdout).expect("text");
    assert!(listed.lines().any(|line| line.ends_with(",robot-7 lab/*")), "{listed}");
    let daemon = launch(work.path(), &tokens).start();
    create_map(&client(&daemon, &all), "office").await;
    let report = async |token: &str, producer: &str| {
        use tidemap_proto::v1::{Reading, ReportRequest, observation_service_client::ObservationServiceClient};
        let reading = Reading { state: "door".to_owned(), value: 1.0, ..Reading::default() };
        let request = ReportRequest {
            map: "office".to_owned(),
            producer: producer.to_owned(),
            readings: vec![reading],
            ..ReportRequest::default()
        };
        let mut service = ObservationServiceClient::new(client(&daemon, token).requests());
        service.report(request).await.map(drop)
    };
    for producer in ["robot-7", "lab/camera"] {
        report(&own, producer).await.expect("its own name");
    }
    report(&all, "robot-8").await.expect("all names");
    for producer in ["robot-8", "robot-71", "lab", ""] {
        let refused = report(&own, producer).await.expect_err("another's name");
        let expected = if producer.is_empty() { Code::InvalidArgument } else { Code::PermissionDenied };
        assert_eq!(refused.code(), expected, "{producer:?}: {refused}");
    }
    assert_eq!(client(&daemon, &all).map("office").await.expect("the map").observations, 3);
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_classification_that_may_not_be_learned_adds_no_state() {
    let work = tempdir().expect("a folder");
    let tokens = Tokens::of(work.path());
    let all = tokens.create(&["admin"], &[]);
    let planner = tokens.create(&["planner"], &[]);
    let made = tokens.run(&["create", "--role", "observer", "--role", "planner", "--producer", "robot-7"]);
    let own = String::from_utf8(made.stdout).expect("text").trim().to_owned();
    let daemon = launch(work.path(), &tokens).start();
    let admin = client(&daemon, &all);
    create_map(&admin, "office").await;
    let labels = ["sleep", "work"].map(str::to_owned).to_vec();
    admin.add_categorical("office", "activity", &labels).await.expect("a state");
    let classify = async |token: &str, producer: &str, place: &str| {
        let request = ClassifyRequest {
            state: "activity".to_owned(),
            likelihoods: vec![("work".to_owned(), 1.0)],
            place: Some(place.to_owned()),
            learn: Some(LearnAs {
                what: Learning::Label,
                producer: producer.to_owned(),
                label: "seen".to_owned(),
                first_sequence: None,
            }),
            ..ClassifyRequest::default()
        };
        client(&daemon, token).classify("office", request).await
    };
    for (token, producer, expected) in [
        (&own, "robot-8", Code::PermissionDenied),
        (&planner, "robot-7", Code::PermissionDenied),
        (&own, "", Code::InvalidArgument),
    ] {
        let refused = classify(token, producer, "desk").await.expect_err("not as this producer");
        assert_eq!(refused.code(), Some(expected), "{producer:?}: {refused}");
    }
    let states = async || -> Vec<String> {
        admin.states("office", "").await.expect("states").0.into_iter().map(|state| state.name).collect()
    };
    assert_eq!(states().await, ["activity"], "what was refused added nothing");
    classify(&own, "robot-7", "desk").await.expect("its own name");
    assert_eq!(states().await, ["activity", "activity@desk"]);
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_ends_when_it_expires_and_so_do_its_streams() {
    let work = tempdir().expect("a folder");
    let tokens = Tokens::of(work.path());
    let all = tokens.create(&["admin"], &[]);
    let daemon = launch(work.path(), &tokens).start();
    create_map(&client(&daemon, &all), "office").await;
    let made = tokens.run(&["create", "--role", "operator", "--expires", "12s"]);
    let short = String::from_utf8(made.stdout).expect("text").trim().to_owned();
    let long = tokens.run(&["create", "--role", "operator", "--expires", "90d", "--note", "of the lab"]);
    let long = String::from_utf8(long.stdout).expect("text").trim().to_owned();
    while client(&daemon, &short).maps().await.is_err() {
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    let mut robot = stream(&daemon, &short).await;

    let ended = robot.message().await.expect_err("the stream ends");
    assert_eq!(ended.code(), Code::Unauthenticated, "{ended}");
    let refused = client(&daemon, &short).maps().await.expect_err("expired");
    assert!(refused.code() == Some(Code::Unauthenticated) && refused.to_string().contains("expired"), "{refused}");
    client(&daemon, &long).maps().await.expect("valid for months");
    let listed = String::from_utf8(tokens.run(&["list"]).stdout).expect("text");
    let expiries: Vec<&str> = listed.lines().skip(1).filter_map(|line| line.rsplit(',').nth(1)).collect();
    assert!(expiries.len() == 3 && expiries[0].is_empty() && expiries[1].ends_with('Z'), "{listed}");
    for when in ["soon", "0d", "-3d", "2001-01-01T00:00:00Z", "2031-01-01"] {
        let wrong = tokens.run(&["create", "--role", "admin", &format!("--expires={when}")]);
        assert!(!wrong.status.success() && String::from_utf8_lossy(&wrong.stderr).contains(when), "{when}");
    }
    daemon.stop_in_order();
}

/// An open stream of observations, after its Welcome.
async fn stream(daemon: &Daemon, token: &str) -> tonic::Streaming<tidemap_proto::v1::ObserveResponse> {
    use tidemap_proto::v1::{ObserveRequest, observation_service_client::ObservationServiceClient, observe_request};
    let mut service = ObservationServiceClient::new(client(daemon, token).requests());
    let mut hello = tidemap_tests::stream::hello("robot", "office");
    hello.label = token.split('_').nth(1).expect("an id").to_owned();
    let first = ObserveRequest { message: Some(observe_request::Message::Hello(hello)) };
    let requests = tokio_stream::StreamExt::chain(tokio_stream::once(first), tokio_stream::pending());
    let mut replies = service.observe(requests).await.expect("a stream").into_inner();
    replies.message().await.expect("well").expect("a Welcome");
    replies
}

#[tokio::test(flavor = "multi_thread")]
async fn secrets_are_in_no_log_error_or_metric() {
    let work = tempdir().expect("a folder");
    let tokens = Tokens::of(work.path());
    let good = tokens.create(&["admin"], &["office"]);
    let unknown = tokens_like(&good);
    let odd = "tm_ffffffffffff_canarycanarycanary";
    let daemon = launch(work.path(), &tokens).setting("log_level", "trace").start();
    let mut errors = Vec::new();
    for token in [good.as_str(), &unknown, odd] {
        let client = client(&daemon, token);
        errors.push(format!("{client:?}"));
        for map in ["office", "secret"] {
            errors.extend(client.map(map).await.err().map(|error| format!("{error} {error:?}")));
        }
        let file = private_file(&work.path().join("presented.token"), &format!("{token}\n"));
        let mut listed = cli::command(&daemon.grpc, ["map", "list"]);
        let listed = listed.env("TIDEMAP_TOKEN_FILE", &file).output().expect("tidemap runs");
        assert_eq!(listed.status.success(), token == good, "{}", String::from_utf8_lossy(&listed.stderr));
        errors.push(String::from_utf8_lossy(&listed.stderr).into_owned());
        let flag = ["--token-file", file.to_str().expect("text"), "map", "show", "secret"];
        let shown = cli::tidemap(&daemon, flag);
        assert_eq!(shown.code, Some(1));
        errors.push(shown.stderr);
    }
    // Whole tokens by mistake, where an id or a file is expected.
    errors.push(String::from_utf8_lossy(&tokens.run(&["revoke", &good]).stderr).into_owned());
    fs::write(&tokens.path, format!("[[token]]\nid = \"{good}\"\nsha256 = \"{good}\"\nroles = []\nmaps = []\n"))
        .expect("written");
    eventually("the bad file is logged", async || daemon.process().stderr().contains("tokens changed")).await;
    fs::write(&tokens.path, format!("token = \"{good}\"\n")).expect("written");
    client(&daemon, &good).maps().await.expect("the tokens before stay");
    let metrics = super::metrics(&daemon);
    assert!(metrics.contains("tidemap_denied_total{reason=\"UNKNOWN_TOKEN\"}"), "{metrics}");
    errors.push(metrics);
    errors.push(daemon.stop_in_order());
    for secret in [good.rsplit('_').next().expect("a secret"), unknown.rsplit('_').next().expect("a secret"), "canary"]
    {
        for (number, text) in errors.iter().enumerate() {
            let line = text.lines().find(|line| line.contains(secret));
            assert!(line.is_none(), "text {number} shows a secret: {line:?}");
        }
    }
}

#[test]
fn a_token_file_is_private_and_holds_no_token() {
    let work = tempdir().expect("a folder");
    let tokens = Tokens::of(work.path());
    let made: Vec<String> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..4).map(|_| scope.spawn(|| tokens.create(&["observer"], &["lab-*"]))).collect();
        threads.into_iter().map(|thread| thread.join().expect("a token")).collect()
    });
    let text = fs::read_to_string(&tokens.path).expect("a file");
    let listed = String::from_utf8(tokens.run(&["list"]).stdout).expect("text");
    for token in &made {
        let (id, secret) = token.strip_prefix("tm_").expect("a prefix").split_once('_').expect("a secret");
        assert!(secret.len() == 64 && text.contains(id) && listed.contains(&format!("{id},observer,lab-*,")));
        assert!(!text.contains(secret) && !listed.contains(secret));
    }
    let mode = |path: &Path| fs::metadata(path).expect("a file").permissions().mode() & 0o777;
    assert_eq!(mode(&tokens.path), 0o600);
    for args in [&["create", "--role", "king"][..], &["create"], &["create", "--role", "admin", "--map", "../x"]] {
        assert_eq!(tokens.run(args).status.code(), Some(2), "{args:?}");
    }

    for (mode, text, words) in [
        (0o644, text.as_str(), "chmod 600"),
        (0o600, "this is no TOML", "not a list of [[token]]"),
        (0o600, "[[token]]\nid = \"a\"\nsha256 = \"1234\"\nroles = [\"admin\"]\nmaps = [\"*\"]", "token 1: sha256"),
    ] {
        fs::write(&tokens.path, text).expect("written");
        fs::set_permissions(&tokens.path, fs::Permissions::from_mode(mode)).expect("permissions");
        let exit = launch(work.path(), &tokens).try_start().expect_err(words);
        assert!(exit.code() == Some(78) && exit.stderr.contains(words), "{words}: {exit}");
    }
    fs::remove_file(&tokens.path).expect("removed");
    let exit = launch(work.path(), &tokens).try_start().expect_err("no file");
    assert!(exit.code() == Some(78) && !work.path().join("data").exists(), "{exit}");
}
