//! The alert rules of `deploy/monitoring`: each fires for the first event of its kind, and names series that a daemon
//! has.
//!
//! Invariant: the series are searched in a real daemon before anything has happened. promtool plays the rules where it
//! is installed.

use std::{collections::BTreeSet, fmt::Write as _, fs, path::PathBuf, process::Command};

use serde_json::Value;
use tempfile::tempdir;
use tidemap_client::maps::NewMap;
use tidemap_tests::{
    certificates::{Authority, Validity},
    daemon::Launch,
    stream::{RawStream, columns, hello},
    tokens::Tokens,
    web,
};

/// The series that come when somebody sends.
const SILENT: &str = "tidemap_producer_silent_seconds";

fn rules_file() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/monitoring/alerts.yaml"))
}

/// Name and expression of each rule.
fn rules() -> Vec<(String, String)> {
    let text = fs::read_to_string(rules_file()).expect("the rules");
    let rules: Value = serde_saphyr::from_str(&text).expect("YAML");
    let rules = rules["groups"][0]["rules"].as_array().expect("rules").clone();
    let text = |rule: &Value, key: &str| rule[key].as_str().expect(key).to_owned();
    rules.iter().map(|rule| (text(rule, "alert"), text(rule, "expr"))).collect()
}

/// The series that an expression selects: name, and what its labels must be; one of each way that a label may be.
fn selected(expression: &str) -> Vec<(String, Vec<String>)> {
    let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let mut found = Vec::new();
    let mut rest = expression;
    while let Some(at) = ["tidemap_", "process_"].iter().filter_map(|start| rest.find(start)).min() {
        let end = rest[at..].find(|c| !is_word(c)).map_or(rest.len(), |length| at + length);
        let name = rest[at..end].to_owned();
        rest = &rest[end..];
        let matchers = rest.strip_prefix('{').and_then(|inner| inner.split_once('}')).map_or("", |(inner, _)| inner);
        let mut ways = vec![Vec::new()];
        for matcher in matchers.split(',').filter(|matcher| !matcher.is_empty()) {
            let (label, value) = matcher.split_once('=').expect("label=value");
            let values = value.trim_start_matches('~').trim_matches('"').split('|');
            let with = |way: &Vec<String>, value| [way.clone(), vec![format!("{label}=\"{value}\"")]].concat();
            ways = values.flat_map(|value| ways.iter().map(move |way| with(way, value))).collect();
        }
        found.extend(ways.into_iter().map(|way| (name.clone(), way)));
    }
    found
}

#[tokio::test(flavor = "multi_thread")]
async fn every_series_of_a_rule_is_there_before_the_first_event() {
    let work = tempdir().expect("a folder");
    let [certificate, key] = Authority::new("ours").sign(Validity::Years).write(work.path());
    let launch = Launch::on(&work.path().join("data")).setting("tls_certificate", certificate.display());
    let launch = launch.setting("tls_key", key.display()).setting("backup_dir", work.path().join("saved").display());
    let daemon = launch.setting("backup_every_secs", 86_400).start();
    let metrics = web::request(&daemon.http, "GET", "/metrics", &[], b"").text();
    let is_there = |name: &str, labels: &[String]| {
        let of_name = metrics.lines().filter_map(|line| line.strip_prefix(name));
        of_name.filter(|rest| rest.starts_with(['{', ' '])).any(|rest| labels.iter().all(|label| rest.contains(label)))
    };
    let mut examined = 0;
    for (alert, expression) in rules() {
        for (name, labels) in selected(&expression).into_iter().filter(|(name, _)| name != SILENT) {
            assert!(is_there(&name, &labels), "{alert} looks at {name}{labels:?}, which is not in:\n{metrics}");
            examined += 1;
        }
    }
    assert!(examined > 25, "{examined}");
    let zero = ["tidemap_update_failures_total 0", "tidemap_reload_failures_total{what=\"tokens\"} 0"];
    for line in zero {
        assert!(metrics.contains(&format!("\n{line}\n")), "{line} in:\n{metrics}");
    }
    let counters = metrics.lines().filter_map(|line| line.strip_prefix("# TYPE ")?.strip_suffix(" counter"));
    let counted: BTreeSet<&str> = counters.collect();
    assert!(counted.len() >= 23, "all counters are there: {counted:?}");
    daemon.stop_in_order();
}

/// A series, and its values in the words of promtool.
type Played = (&'static str, &'static str);

/// The series played for each rule, with their values, one a minute, and the minute at which the rule fires.
const PLAYED: &[(&str, &[Played], u32)] = &[
    ("TidemapDown", &[("up{job=\"tidemap\"}", "1x2 0x20")], 10),
    ("TidemapDiskFull", &[("tidemap_disk_full", "0x4 1x20")], 10),
    ("TidemapDiskFillsUp", &[("tidemap_disk_free_bytes", "50x4 5x40"), ("tidemap_disk_size_bytes", "100x60")], 30),
    ("TidemapMapUnavailable", &[("tidemap_maps_unavailable", "0x4 1x20")], 10),
    ("TidemapListsLost", &[("tidemap_lists_lost", "0x4 1x20")], 10),
    ("TidemapDamagedFiles", &[("tidemap_damaged_files", "0x4 1x20")], 10),
    ("TidemapSavesFail", &[("tidemap_maps_not_saved", "0x60"), ("tidemap_save_failures_total", "0x4 1x60")], 30),
    ("TidemapIndexUnavailable", &[("tidemap_index_unavailable", "0x4 1x40")], 30),
    ("TidemapUpdatesFail", &[("tidemap_update_failures_total", "0x4 1x20")], 10),
    ("TidemapGenerationOld", &[("tidemap_generation_age_seconds", "200000x100")], 90),
    ("TidemapUpdatesBehind", &[("tidemap_waiting_rows", "0x4 9x60"), ("tidemap_updates_waiting_turn", "0x70")], 40),
    (
        "TidemapSlowAcknowledgements",
        &[
            ("tidemap_acknowledgement_seconds_bucket{le=\"1\"}", "0x60"),
            ("tidemap_acknowledgement_seconds_bucket{le=\"2.5\"}", "0+1x60"),
            ("tidemap_acknowledgement_seconds_bucket{le=\"+Inf\"}", "0+1x60"),
        ],
        30,
    ),
    (
        "TidemapSlowQueries",
        &[
            (
                "tidemap_request_duration_seconds_bucket{method=\"/tidemap.v1.QueryService/PredictStates\",le=\"1\"}",
                "0x60",
            ),
            (
                "tidemap_request_duration_seconds_bucket{method=\"/tidemap.v1.QueryService/PredictStates\",le=\"2.5\"}",
                "0+1x60",
            ),
            (
                "tidemap_request_duration_seconds_bucket{method=\"/tidemap.v1.QueryService/PredictStates\",le=\"+Inf\"}",
                "0+1x60",
            ),
        ],
        30,
    ),
    ("TidemapErrors", &[("tidemap_requests_total{method=\"m\",code=\"INTERNAL\"}", "0x4 10x20")], 10),
    ("TidemapRefusesRequests", &[("tidemap_requests_refused", "0x4 200x20")], 10),
    ("TidemapRefusesConnections", &[("tidemap_connections_refused{port=\"grpc\"}", "0x4 50x20")], 10),
    ("TidemapDataMismatch", &[("tidemap_data_mismatches_total", "0x4 1x20")], 10),
    (
        "TidemapDescriptorsRunOut",
        &[("process_open_fds", "1x20"), ("process_max_fds", "100x20"), ("tidemap_accept_errors", "0x4 1x20")],
        8,
    ),
    ("TidemapReloadFails", &[("tidemap_reload_failures_total{what=\"certificates\"}", "0x4 1x20")], 10),
    ("TidemapBackupsFail", &[("tidemap_backup_failures_total", "0x4 1x20")], 10),
    (
        "TidemapBackupOld",
        &[("tidemap_backup_age_seconds", "Inf+0x100"), ("tidemap_backup_interval_seconds", "86400x100")],
        90,
    ),
    ("TidemapProducerSilent", &[("tidemap_producer_silent_seconds{map=\"lab\",producer=\"robot\"}", "90000x20")], 10),
    ("TidemapCertificateEnds", &[("tidemap_certificate_expiry_seconds", "600000x20")], 10),
    (
        "TidemapClusterMapWithoutWriter",
        &[
            ("tidemap_cluster_maps{instance=\"a\"}", "2x20"),
            ("tidemap_cluster_maps{instance=\"b\"}", "2x20"),
            ("tidemap_cluster_maps_written{instance=\"a\"}", "1x4 0x20"),
            ("tidemap_cluster_maps_written{instance=\"b\"}", "1x20"),
        ],
        10,
    ),
    ("TidemapClusterEngineSilent", &[("tidemap_cluster_engine_unavailable", "0x4 1x20")], 10),
    ("TidemapClusterFork", &[("tidemap_cluster_forks{groups=\"more\"}", "0x4 1x20")], 10),
    ("TidemapClusterRecordsAside", &[("tidemap_cluster_forks{groups=\"1\"}", "0x4 1x40")], 30),
    ("TidemapClusterDigestsDiffer", &[("tidemap_cluster_divergence_total", "0x4 1x20")], 10),
    (
        "TidemapClusterFollowerBehind",
        &[("tidemap_cluster_heard_age_seconds", "0x4 Inf+0x20"), ("tidemap_cluster_lag_records", "0x20")],
        10,
    ),
    ("TidemapClusterMemberGone", &[("tidemap_cluster_members{state=\"gone\"}", "0x4 1x20")], 10),
];

#[test]
fn every_rule_rings_for_the_first_event_of_its_kind() {
    let played: Vec<&str> = PLAYED.iter().map(|(alert, ..)| *alert).collect();
    let names: Vec<String> = rules().into_iter().map(|(alert, _)| alert).collect();
    assert_eq!(played, names, "each rule is played");
    let mut text = format!("rule_files: [{:?}]\nevaluation_interval: 1m\ntests:\n", rules_file());
    for (alert, series, minute) in PLAYED {
        text += "- interval: 1m\n  input_series:\n";
        for (series, values) in *series {
            // Writing to a text cannot fail.
            let _ = writeln!(text, "  - {{ series: '{series}', values: '{values}' }}");
        }
        let _ = writeln!(
            text,
            "  promql_expr_test:\n  - expr: count(ALERTS{{alertname=\"{alert}\",alertstate=\"firing\"}})\n    eval_time: \
             {minute}m\n    exp_samples: [{{ labels: '{{}}', value: 1 }}]"
        );
    }
    let work = tempdir().expect("a folder");
    let file = work.path().join("test.yaml");
    fs::write(&file, text).expect("written");
    let run = match Command::new("promtool").args(["test", "rules"]).arg(&file).output() {
        Ok(run) => run,
        Err(error) => return println!("SKIPPED: promtool: {error}"),
    };
    let output = [run.stdout, run.stderr].concat();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&output));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_is_silent_is_named_to_those_who_may_list_it() {
    let work = tempdir().expect("a folder");
    let tokens = Tokens::of(work.path());
    let (all, of_one) = (tokens.create(&["planner"], &[]), tokens.create(&["admin"], &["lab"]));
    let open = Launch::on(&work.path().join("data")).setting("metrics_max_producers", 2);
    let daemon = open.start();
    daemon.client().create_map(NewMap { name: "lab".to_owned(), ..NewMap::default() }).await.expect("a new map");
    let metrics = |address: &str, headers: &[(&str, &str)]| {
        let answer = web::request(address, "GET", "/metrics", headers, b"");
        assert_eq!(answer.code, 200, "{}", answer.text());
        answer.text()
    };
    let named = |text: &str| -> Vec<String> {
        let lines = text.lines().filter_map(|line| line.strip_prefix(SILENT)?.strip_prefix("{map=\"lab\",producer=\""));
        lines.filter_map(|rest| Some(rest.split_once("\"} ")?.0.to_owned())).collect()
    };
    assert_eq!(named(&metrics(&daemon.http, &[])), Vec::<String>::new(), "no producer has sent anything");
    // The first producer is silent for longest; producers beyond the setting are not reported.
    for producer in ["robot-1", "robot \"2\"", "robot-3"] {
        let (mut stream, _) = RawStream::open(&daemon.grpc, hello(producer, "lab")).await.expect("a Welcome");
        stream.batch(1, columns(&["door"], &[(0, 1_000, 1.0)])).await;
        stream.acknowledged(1).await.expect("taken");
    }
    assert_eq!(named(&metrics(&daemon.http, &[])), ["robot-1", "robot \\\"2\\\""]);
    // A page that reached the port by a name of its own learns no names.
    assert!(!metrics(&daemon.http, &[("host", "evil.example")]).contains(SILENT));
    daemon.stop_in_order();

    let daemon = open.setting("tokens_file", tokens.path.display()).start();
    let bearer = |token: &str| format!("Bearer {token}");
    assert!(!metrics(&daemon.http, &[]).contains(SILENT));
    assert!(!metrics(&daemon.http, &[("authorization", &bearer(&of_one))]).contains(SILENT));
    let text = metrics(&daemon.http, &[("authorization", &bearer(&all))]);
    assert_eq!(named(&text).len(), 2, "a restart keeps the producers that have sent: {text}");
    assert!(text.contains("\ntidemap_build_info{version=\""), "{text}");
    daemon.stop_in_order();
}
