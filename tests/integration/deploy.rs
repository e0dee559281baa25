//! The files of `deploy/` for containers and clusters: they can be read, and the daemon takes their settings.
//!
//! Invariant: no engine and no cluster is needed. Properties that need them are not tested here.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use serde_json::Value;
use tidemap_tests::binaries;

mod cluster;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the crate is in a workspace").join("deploy")
}

fn documents(path: &str) -> Vec<Value> {
    let text = fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"));
    serde_saphyr::from_multiple(&text).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// The settings that the daemon reads, as `key = value`.
fn settings(config: Option<&Path>, environment: &BTreeMap<String, String>) -> String {
    let mut command = Command::new(binaries::tidemapd());
    for (name, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("TIDEMAP_")) {
        command.env_remove(name);
    }
    if let Some(config) = config {
        command.arg("--config").arg(config);
    }
    let shown = command.envs(environment).arg("config").output().expect("tidemapd runs");
    assert!(shown.status.success(), "{}", String::from_utf8_lossy(&shown.stderr));
    String::from_utf8(shown.stdout).expect("text")
}

/// The files and folders that settings name lie where a container has something mounted.
fn check_mounted(taken: &str, container: &Value) {
    let mounts = container["volumeMounts"].as_array().expect("mounts");
    let mounts: Vec<&str> = mounts.iter().filter_map(|mount| mount["mountPath"].as_str()).collect();
    for line in taken.lines().filter(|line| line.contains("\"/")) {
        let path = line.split('"').nth(1).expect("a path");
        assert!(mounts.iter().any(|mount| path.starts_with(mount)), "{line} lies in none of {mounts:?}");
    }
}

#[test]
fn the_daemon_takes_the_settings_of_the_cluster_and_probes_ask_what_it_serves() {
    let taken = settings(Some(&root().join("kubernetes/tidemapd.toml")), &BTreeMap::new());
    let objects = documents("kubernetes/tidemap.yaml");
    let set = objects.iter().find(|object| object["kind"] == "StatefulSet").expect("a StatefulSet");
    let pod = &set["spec"]["template"]["spec"];
    let daemon = &pod["containers"][0];
    for (port, key) in [("grpc", "listen"), ("http", "http_listen")] {
        let ports = daemon["ports"].as_array().expect("ports");
        let number = &ports.iter().find(|each| each["name"] == port).expect("a port")["containerPort"];
        assert!(taken.contains(&format!("\n{key} = \"0.0.0.0:{number}\"\n")), "{key} is not {number} in:\n{taken}");
    }
    for (probe, path) in [("livenessProbe", "/healthz"), ("startupProbe", "/healthz"), ("readinessProbe", "/readyz")] {
        assert_eq!(daemon[probe]["httpGet"]["path"], path);
        assert_eq!(daemon[probe]["httpGet"]["scheme"], "HTTPS", "{probe}: there are TLS and tokens");
    }
    // Files that the settings name lie where something is mounted, and the data where the volume is.
    check_mounted(&taken, daemon);
    assert_eq!(set["spec"]["replicas"], 1, "a folder belongs to one daemon");
    let budget = objects.iter().find(|object| object["kind"] == "PodDisruptionBudget").expect("a PodDisruptionBudget");
    assert_eq!(budget["spec"]["selector"], set["spec"]["selector"]);
    for setting in ["backup_dir = \"/var/backups/tidemap/", "backup_every_secs = 86400"] {
        assert!(taken.contains(setting), "{setting} in:\n{taken}");
    }
}

/// The words of an instruction of the Containerfile.
fn instruction(name: &str) -> Vec<String> {
    let image = fs::read_to_string(root().join("container/Containerfile")).expect("a Containerfile");
    let last = image.lines().filter_map(|line| line.strip_prefix(name)?.strip_prefix(' ')).next_back();
    let is_mark = |c| ['[', ']', '"', ',', ' '].contains(&c);
    last.expect(name).split(is_mark).filter(|word| !word.is_empty()).map(str::to_owned).collect()
}

#[test]
fn the_settings_of_the_image_are_defaults_and_its_folders_lie_on_volumes() {
    assert_eq!(instruction("ENTRYPOINT"), ["/usr/bin/tidemapd"], "a flag would win over every file");
    let environment = instruction("ENV");
    assert_eq!(environment, ["TIDEMAP_CONFIG=/etc/tidemap/tidemapd.toml"], "a setting would win over every file");
    let volumes = instruction("VOLUME");
    let of_image = root().join("container/tidemapd.toml");
    let taken = settings(Some(&of_image), &BTreeMap::new());
    for key in ["data_dir", "backup_dir"] {
        let line = taken.lines().find(|line| line.starts_with(key)).expect(key);
        let path = Path::new(line.split('"').nth(1).expect("a path"));
        assert!(volumes.iter().any(|volume| path.starts_with(volume)), "{line} lies on none of {volumes:?}");
    }
    assert!(!taken.contains("data_dir = \"/var/lib/tidemap\""), "the root of a volume may belong to root");
    // A file that is named takes the place of the image's, and the environment wins over it.
    let image = BTreeMap::from([("TIDEMAP_CONFIG".to_owned(), of_image.display().to_string())]);
    let cluster = root().join("kubernetes/tidemapd.toml");
    assert!(settings(Some(&cluster), &image).contains("listen = \"0.0.0.0:7435\""));
    let changed = [("TIDEMAP_DATA_DIR".to_owned(), "/elsewhere".to_owned())].into_iter().chain(image).collect();
    let taken = settings(None, &changed);
    assert!(taken.contains("data_dir = \"/elsewhere\"") && taken.contains("backup_dir = \"/var/backups"), "{taken}");
}

#[test]
fn pods_and_containers_have_few_rights() {
    let objects = documents("kubernetes/tidemap.yaml");
    let set = objects.iter().find(|object| object["kind"] == "StatefulSet").expect("a StatefulSet");
    let pod = &set["spec"]["template"]["spec"];
    assert_eq!(pod["securityContext"]["runAsNonRoot"], true);
    assert_eq!(pod["securityContext"]["seccompProfile"]["type"], "RuntimeDefault");
    assert_eq!(pod["automountServiceAccountToken"], false);
    let own = &pod["containers"][0]["securityContext"];
    assert_eq!(own["allowPrivilegeEscalation"], false);
    assert_eq!(own["readOnlyRootFilesystem"], true);
    assert_eq!(own["capabilities"]["drop"][0], "ALL");
    let policy = objects.iter().find(|object| object["kind"] == "NetworkPolicy").expect("a NetworkPolicy");
    assert_eq!(policy["spec"]["policyTypes"], serde_json::json!(["Ingress", "Egress"]));
    assert_eq!(policy["spec"]["egress"], serde_json::json!([]), "the daemon reaches nobody");

    let compose = documents("container/compose.yaml").remove(0);
    let services = compose["services"].as_object().expect("services");
    for (name, service) in services {
        for port in service["ports"].as_array().expect("ports") {
            assert!(port.as_str().is_some_and(|port| port.starts_with("127.0.0.1:")), "{name}: {port}");
        }
        assert_eq!(service["cap_drop"][0], "ALL", "{name}");
    }
    let image = fs::read_to_string(root().join("container/Containerfile")).expect("a Containerfile");
    assert!(image.contains("\nFROM scratch\n") && image.contains("\nUSER 10001:10001\n"));
}

#[test]
fn the_daemon_takes_the_environment_of_compose_and_mounted_files_exist() {
    let compose = documents("container/compose.yaml").remove(0);
    let environment: BTreeMap<String, String> = compose["services"]["tidemap"]["environment"]
        .as_object()
        .expect("an environment")
        .iter()
        .map(|(name, value)| (name.clone(), value.as_str().expect("a text").to_owned()))
        .collect();
    let taken = settings(Some(&root().join("container/tidemapd.toml")), &environment);
    let known: Vec<&str> = taken.lines().filter_map(|line| line.split(" = ").next()).collect();
    for name in environment.keys() {
        let key = name.trim_start_matches("TIDEMAP_").to_lowercase();
        assert!(known.contains(&key.as_str()), "{name} is no setting");
    }
    assert!(taken.contains("listen = \"0.0.0.0:7435\"") && taken.contains("http_hosts = [\"tidemap\"]"), "{taken}");
    let mounted: Vec<&str> = compose["services"]["tidemap"]["volumes"]
        .as_array()
        .expect("volumes")
        .iter()
        .filter_map(|volume| volume.as_str()?.split(':').nth(1))
        .collect();
    assert_eq!(mounted, instruction("VOLUME"), "data and backups outlive the container");
    assert!(taken.contains("backup_every_secs = 86400"), "{taken}");
    for service in compose["services"].as_object().expect("services").values() {
        for volume in service["volumes"].as_array().expect("volumes").iter().filter_map(Value::as_str) {
            let source = volume.split(':').next().expect("a source");
            assert!(!source.starts_with('.') || root().join("container").join(source).is_file(), "{volume}");
        }
    }
    for file in ["container/prometheus.yaml", "container/grafana/source.yaml", "container/grafana/dashboards.yaml"] {
        assert!(documents(file)[0].is_object(), "{file}");
    }
}
