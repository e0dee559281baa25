//! The files of `deploy/` for clusters of daemons: the daemon and nats-server take the settings, and the parts of a
//! deployment name each other as they are.
//!
//! Invariant: nothing is started. nats-server only checks its settings; where it is missing, that is skipped.

use std::{collections::BTreeMap, fs, process::Command};

use serde_json::Value;
use tidemap_cluster::nats_process::nats_server;

use super::{check_mounted, documents, root, settings};

type Environment = BTreeMap<String, String>;

const PASSWORDS: [(&str, &str); 3] = [("ROUTES_PASSWORD", "r1"), ("SYS_PASSWORD", "s1"), ("TIDEMAP_PASSWORD", "t1")];

fn passwords() -> Environment {
    PASSWORDS.map(|(name, value)| (name.to_owned(), value.to_owned())).into()
}

/// The environment of a service of compose, with the passwords filled in.
fn environment_of_service(service: &Value) -> Environment {
    let fill = |text: &str| {
        PASSWORDS.iter().fold(text.to_owned(), |text, (name, value)| text.replace(&format!("${{{name}:?}}"), value))
    };
    let variables = service["environment"].as_object().expect("an environment");
    variables.iter().map(|(name, value)| (name.clone(), fill(value.as_str().expect("a text")))).collect()
}

/// The environment of a container of Kubernetes in the pod of this name. The keys of the Secret are the passwords'.
fn environment_of_container(container: &Value, pod: &str) -> Environment {
    let mut known = Environment::new();
    for variable in container["env"].as_array().expect("an environment") {
        let from = &variable["valueFrom"];
        let value = match from["fieldRef"]["fieldPath"].as_str() {
            Some("metadata.name") => pod.to_owned(),
            Some("metadata.namespace") => "maps".to_owned(),
            Some(other) => panic!("{other}"),
            None => match from["secretKeyRef"]["key"].as_str() {
                Some(key) => passwords()[&format!("{}_PASSWORD", key.to_uppercase())].clone(),
                None => {
                    let text = variable["value"].as_str().expect("a value").to_owned();
                    // Variables are replaced as by Kubernetes: a variable refers to those before it in the list.
                    known.iter().fold(text, |text, (name, value)| text.replace(&format!("$({name})"), value))
                }
            },
        };
        known.insert(variable["name"].as_str().expect("a name").to_owned(), value);
    }
    known
}

/// Whether nats-server takes a config file with these variables; `None`: it is missing here.
fn engine_takes(file: &str, environment: &Environment) -> Option<bool> {
    let program = match nats_server() {
        Ok(program) => program,
        Err(reason) => {
            println!("SKIPPED: {reason}");
            return None;
        }
    };
    let mut command = Command::new(program);
    command.args(["-t", "--name", "nats-1", "-c"]).arg(root().join(file)).env_clear().envs(environment);
    Some(command.output().expect("nats-server runs").status.success())
}

fn check_engine(file: &str, environment: &Environment) {
    let text = fs::read_to_string(root().join(file)).expect(file);
    let guide = fs::read_to_string(root().join("../docs/src/clusters.md")).expect("the guide");
    let lines = [
        "max_payload: 2MB",
        "sync_interval: always }",
        "exports: [{ service: \"$SYS.REQ.SERVER.PING.VARZ\", response_type: stream }]",
        "imports: [{ service: { account: SYS, subject: \"$SYS.REQ.SERVER.PING.VARZ\" } }]",
    ];
    for line in lines {
        assert!(text.contains(line) && guide.contains(line), "{line} in {file} as in the guide");
    }
    let Some(is_taken) = engine_takes(file, environment) else { return };
    assert!(is_taken, "{file}");
    for name in environment.keys().filter(|name| name.ends_with("PASSWORD") || name.starts_with("ROUTE_")) {
        let mut less = environment.clone();
        less.remove(name);
        assert_eq!(engine_takes(file, &less), Some(false), "{file} has no use for {name}");
    }
}

/// Checks that the settings which a daemon reads from its file and its environment contain its name and address.
fn check_member(taken: &str, name: &str, address: &str, servers: &[String]) {
    let servers = servers.iter().map(|server| format!("\"nats://tidemap:t1@{server}:4222\"")).collect::<Vec<_>>();
    for line in [
        format!("member = \"{name}\""),
        format!("advertise = \"{address}\""),
        format!("servers = [{}]", servers.join(",")),
        "require_synced_engine = true".to_owned(),
        "engine_replicas = 3".to_owned(),
    ] {
        assert!(taken.contains(&format!("\n{line}\n")), "{line} in:\n{taken}");
    }
}

/// The version of nats-server that the tests run with.
fn tested_version() -> String {
    let script = fs::read_to_string(root().join("nats-server.sh")).expect("a script");
    script.lines().find_map(|line| line.strip_prefix("VERSION=")).expect("a version").to_owned()
}

#[test]
fn compose_runs_three_engines_and_three_daemons_that_know_each_other() {
    let compose = documents("container/cluster.yaml").remove(0);
    let services = compose["services"].as_object().expect("services");
    let names =
        |start: &str| -> Vec<String> { services.keys().filter(|name| name.starts_with(start)).cloned().collect() };
    let (engines, daemons) = (names("nats-"), names("tidemap-"));
    assert_eq!([engines.len(), daemons.len(), services.len()], [3, 3, 6]);
    for (index, name) in engines.iter().enumerate() {
        let service = &services[name];
        let image = service["image"].as_str().expect("an image");
        assert_eq!(image, format!("docker.io/library/nats:{}-alpine", tested_version()));
        assert_eq!(service["command"], serde_json::json!(["--config", "/etc/nats/tidemap.conf", "--name", name]));
        let environment = environment_of_service(service);
        assert_eq!(environment[&format!("ROUTE_{}", index + 1)], format!("nats://routes:r1@{name}:6222"));
        assert!(service["ports"].is_null(), "nobody outside reaches the engine");
        check_engine("container/cluster/nats.conf", &environment);
    }
    for name in &daemons {
        let service = &services[name];
        let taken = settings(Some(&root().join("container/cluster/tidemapd.toml")), &environment_of_service(service));
        check_member(&taken, name, &format!("http://{name}:7435"), &engines);
        assert!(taken.contains("listen = \"0.0.0.0:7435\"") && taken.contains("allow_insecure_remote = true"));
    }
}

#[test]
fn containers_of_a_cluster_have_few_rights_and_a_volume_each_and_open_ports_on_this_machine_only() {
    let compose = documents("container/cluster.yaml").remove(0);
    let mut volumes = Vec::new();
    let mut ports = Vec::new();
    for (name, service) in compose["services"].as_object().expect("services") {
        assert_eq!((&service["cap_drop"][0], &service["read_only"]), (&"ALL".into(), &true.into()), "{name}");
        assert!(service["healthcheck"]["test"].is_array(), "{name}");
        ports.extend(service["ports"].as_array().into_iter().flatten().map(|port| port.as_str().expect("a port")));
        for volume in service["volumes"].as_array().expect("volumes").iter().filter_map(Value::as_str) {
            let source = volume.split(':').next().expect("a source");
            if source.starts_with('.') {
                assert!(root().join("container").join(source).is_file() && volume.ends_with(":ro"), "{volume}");
            } else {
                volumes.push(source);
            }
        }
    }
    let count = ports.len();
    assert!(count == 4 && ports.iter().all(|port| port.starts_with("127.0.0.1:")), "{ports:?}");
    let published: std::collections::BTreeSet<_> = ports.iter().filter_map(|port| port.split(':').nth(1)).collect();
    assert_eq!(published.len(), count, "each has a number of its own: {ports:?}");
    volumes.sort_unstable();
    let declared: Vec<&str> = compose["volumes"].as_object().expect("volumes").keys().map(String::as_str).collect();
    assert_eq!(volumes, declared, "no two share a folder");
}

struct Manifests(Vec<Value>);

impl Manifests {
    fn read() -> Self {
        let files = ["kubernetes/cluster/nats.yaml", "kubernetes/cluster/tidemap.yaml"];
        Self(files.iter().flat_map(|file| documents(file)).collect())
    }

    fn get(&self, kind: &str, name: &str) -> &Value {
        let found = self.0.iter().find(|object| object["kind"] == kind && object["metadata"]["name"] == name);
        found.unwrap_or_else(|| panic!("no {kind} {name}"))
    }
}

const SETS: [(&str, &str); 2] = [("tidemap-nats", "tidemap-nats"), ("tidemap-cluster", "tidemap-members")];

#[test]
fn in_kubernetes_one_of_three_pods_may_go_and_no_two_share_a_node() {
    let manifests = Manifests::read();
    for (name, service) in SETS {
        let set = manifests.get("StatefulSet", name);
        let (spec, pod) = (&set["spec"], &set["spec"]["template"]["spec"]);
        assert_eq!((&spec["replicas"], &spec["serviceName"]), (&3.into(), &service.into()));
        assert_eq!(spec["podManagementPolicy"], "Parallel", "{name}: one alone is of no use");
        assert_eq!(spec["selector"]["matchLabels"], spec["template"]["metadata"]["labels"]);
        let spread = &pod["topologySpreadConstraints"][0];
        assert_eq!(
            (&spread["topologyKey"], &spread["whenUnsatisfiable"], &spread["labelSelector"]),
            (&"kubernetes.io/hostname".into(), &"DoNotSchedule".into(), &spec["selector"])
        );
        let budget = &manifests.get("PodDisruptionBudget", name)["spec"];
        assert_eq!((&budget["maxUnavailable"], &budget["selector"]), (&1.into(), &spec["selector"]));
        let headless = &manifests.get("Service", service)["spec"];
        assert_eq!((&headless["clusterIP"], &headless["publishNotReadyAddresses"]), (&"None".into(), &true.into()));
        assert_eq!(headless["selector"], spec["selector"]["matchLabels"]);
        assert_eq!(pod["securityContext"]["runAsNonRoot"], true);
        assert_eq!(pod["securityContext"]["seccompProfile"]["type"], "RuntimeDefault");
        let container = &pod["containers"][0];
        let own = &container["securityContext"];
        assert_eq!((&own["allowPrivilegeEscalation"], &own["readOnlyRootFilesystem"]), (&false.into(), &true.into()));
        assert_eq!(own["capabilities"]["drop"][0], "ALL");
        let ports = container["ports"].as_array().expect("ports");
        for probe in ["startupProbe", "livenessProbe", "readinessProbe"] {
            let port = &container[probe]["httpGet"]["port"];
            assert!(ports.iter().any(|known| known["name"] == *port), "{name} {probe}: {port}");
        }
        let policy = &manifests.get("NetworkPolicy", name)["spec"];
        assert_eq!(policy["podSelector"], spec["selector"]);
        assert_eq!(policy["policyTypes"], serde_json::json!(["Ingress", "Egress"]));
    }
    // A pod that takes no part yet would be killed before the engine is there.
    let daemon = &manifests.get("StatefulSet", "tidemap-cluster")["spec"]["template"]["spec"]["containers"][0];
    let probe = &daemon["startupProbe"];
    let patience = probe["periodSeconds"].as_u64().zip(probe["failureThreshold"].as_u64()).map(|(a, b)| a * b);
    assert!(patience >= Some(3600), "{patience:?}");
    assert_eq!((&probe["httpGet"]["path"], &probe["httpGet"]["scheme"]), (&"/healthz".into(), &"HTTPS".into()));
    assert_eq!(daemon["readinessProbe"]["httpGet"]["path"], "/readyz");
}

#[test]
fn in_kubernetes_daemons_and_engines_take_their_settings_and_find_each_other() {
    let manifests = Manifests::read();
    let container = |set| &manifests.get("StatefulSet", set)["spec"]["template"]["spec"]["containers"][0];
    let engine = container("tidemap-nats");
    assert_eq!(engine["image"], format!("docker.io/library/nats:{}", tested_version()));
    let servers: Vec<String> = (0..3).map(|index| format!("tidemap-nats-{index}.tidemap-nats")).collect();
    let of_engine = environment_of_container(engine, "tidemap-nats-0");
    for (index, server) in servers.iter().enumerate() {
        assert_eq!(of_engine[&format!("ROUTE_{index}")], format!("nats://routes:r1@{server}:6222"));
    }
    check_engine("kubernetes/cluster/nats.conf", &of_engine);
    let store = fs::read_to_string(root().join("kubernetes/cluster/nats.conf")).expect("a file");
    assert!(store.contains("store_dir: \"/data/") && engine["volumeMounts"][0]["mountPath"] == "/data");

    let daemon = container("tidemap-cluster");
    let config = root().join("kubernetes/cluster/tidemapd.toml");
    let taken = settings(Some(&config), &environment_of_container(daemon, "tidemap-cluster-2"));
    let address = "https://tidemap-cluster-2.tidemap-members.maps.svc:7435";
    check_member(&taken, "tidemap-cluster-2", address, &servers);
    check_mounted(&taken, daemon);
    // The files are in the place where the pods search for them.
    let kustomization = documents("kubernetes/cluster/kustomization.yaml").remove(0);
    for map in kustomization["configMapGenerator"].as_array().expect("config maps") {
        let file = map["files"][0].as_str().expect("a file");
        assert!(root().join("kubernetes/cluster").join(file).is_file(), "{file}");
        let used = SETS.iter().any(|(set, _)| {
            let pod = &manifests.get("StatefulSet", set)["spec"]["template"]["spec"];
            let argument = format!("/config/{file}");
            pod["volumes"][0]["configMap"]["name"] == map["name"]
                && pod["containers"][0]["args"][1].as_str().is_some_and(|path| path.ends_with(&argument))
        });
        assert!(used, "nobody uses {file}");
    }
}
