//! A cluster as its operator sees it: three engines and three daemons on this machine, and `tidemap cluster`.
//!
//! Invariant: skipped with the reason where there is no nats-server. Every deadline only detects what hangs.

mod check_engine;
mod other_bits;

use std::{
    fs,
    path::Path,
    time::{Duration, Instant},
};

use serde_json::Value;
use tempfile::tempdir;
use tidemap_client::maps::{NewMap, StateKind, StateShape};
use tidemap_cluster::nats_process::NatsServers;
use tidemap_tests::{
    certificates::{Authority, Validity, private_file},
    cli::{Outcome, tidemap},
    daemon::{Daemon, Launch, lasting_port},
};
use tonic::Code;

use crate::json_output::validate;

mod metrics;

/// A deadline for every wait: the awaited event has happened by then, or the test hangs.
pub(crate) const WITHIN: Duration = Duration::from_secs(120);
pub(crate) const POLL: Duration = Duration::from_millis(200);
const NAMES: [&str; 3] = ["north", "east", "west"];

fn start(folder: &Path, name: &str, engine: &NatsServers) -> Daemon {
    start_with(folder, name, (engine, 3), "")
}

/// Starts a daemon with so many servers of the engine, and more lines of the section.
pub(crate) fn start_with(folder: &Path, name: &str, engine: (&NatsServers, usize), more: &str) -> Daemon {
    launch(folder, name, engine, more).start()
}

/// Prepares a daemon. In the lines, PORT is the port of the daemon.
fn launch(folder: &Path, name: &str, (engine, count): (&NatsServers, usize), more: &str) -> Launch {
    let servers: Vec<String> = (0..count).map(|index| format!("{:?}", engine.url(index))).collect();
    let port = lasting_port();
    let more = more.replace("PORT", &port.to_string());
    let config = folder.join(format!("{name}.toml"));
    let text = format!(
        "listen = \"127.0.0.1:{port}\"\n[cluster]\nmember = \"{name}\"\nservers = [{}]\n{more}",
        servers.join(", ")
    );
    fs::write(&config, text).expect("a config file");
    // The address that a member reports is the one of its config file.
    let launch = Launch::bare().setting("http_listen", "127.0.0.1:0").setting("data_dir", folder.join(name).display());
    launch.args(["--config".into(), config.into_os_string()])
}

/// Repeats a command until its outcome is as expected.
pub(crate) fn eventually(daemon: &Daemon, line: &str, is_expected: impl Fn(&Outcome) -> bool) -> Outcome {
    let begun = Instant::now();
    loop {
        let outcome = tidemap(daemon, line.split(' '));
        if is_expected(&outcome) {
            return outcome;
        }
        assert!(begun.elapsed() < WITHIN, "{line}: {outcome:?}");
        std::thread::sleep(POLL);
    }
}

/// The member that writes the map, if one does.
pub(crate) fn writer(outcome: &Outcome) -> Option<String> {
    if outcome.code == Some(2) && outcome.stdout.is_empty() {
        return None;
    }
    let table = tidemap_tests::cli::Table::parse(&outcome.stdout);
    let rows = table.column("role").into_iter().zip(table.column("member"));
    rows.filter(|(role, _)| *role == "writing").map(|(_, member)| member.to_owned()).next()
}

/// Whether all three members hold the map, and none is behind.
fn is_held_by_all(outcome: &Outcome) -> bool {
    outcome.code == Some(0) && tidemap_tests::cli::Table::parse(&outcome.stdout).rows.len() == 3
}

/// Checks that the JSON output of a command matches its schema.
fn check_json(daemon: &Daemon, line: &str) -> Value {
    let root: Value = serde_json::from_str(&tidemap(daemon, ["schema"]).stdout).expect("a schema");
    let outcome = tidemap(daemon, line.split(' ').chain(["--output", "json"]));
    let value = serde_json::from_str(&outcome.stdout).unwrap_or_else(|error| panic!("{error}: {outcome:?}"));
    let words = line.split(' ').take(2).collect::<Vec<_>>().join(" ");
    validate(&root, &root["$defs"][&words], &value, line).unwrap_or_else(|error| panic!("{error}"));
    value
}

/// Observations of a day, of a door that is open in every other hour.
fn day(folder: &Path, number: i64) -> String {
    let row = |minute: i64| format!("{},door,{}\n", 1_451_865_600 + number * 86_400 + minute * 60, minute / 60 % 2);
    let rows: String = (0..1440).step_by(10).map(row).collect();
    let file = folder.join(format!("day-{number}.csv"));
    fs::write(&file, format!("time,state,value\n{rows}")).expect("a file");
    file.display().to_string()
}

pub(crate) struct Members(pub(crate) Vec<(&'static str, Daemon)>);

impl Members {
    pub(crate) fn of(&self, name: &str) -> &Daemon {
        &self.0.iter().find(|(known, _)| *known == name).unwrap_or_else(|| panic!("{name} does not run")).1
    }

    pub(crate) fn first(&self) -> &Daemon {
        &self.0[0].1
    }

    pub(crate) fn take(&mut self, name: &str) -> Daemon {
        let at = self.0.iter().position(|(known, _)| *known == name).expect("it runs");
        self.0.remove(at).1
    }

    /// Sends a day to the writer, learns it there, and waits until all members have learned the same.
    fn learn(&self, folder: &Path, number: i64) {
        let found = eventually(self.first(), "cluster maps", |outcome| writer(outcome).is_some());
        let writer = self.of(&writer(&found).expect("a writer"));
        let sent = tidemap(writer, ["observe", "office", &day(folder, number), "--producer", "robot-1"]).table();
        assert_eq!(sent.number("accepted"), 144.0, "each day is new");
        assert_eq!(tidemap(writer, ["update", "office"]).table().rows.len(), 1);
        let members = self.0.len();
        eventually(self.first(), "cluster verify office", |outcome| {
            let text = format!("of {members} members: equal");
            // All members have equal logs and equal generations.
            outcome.stderr.matches(&text).count() == 1 && outcome.stderr.matches(": equal").count() == 2
        });
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_operator_sees_moves_drains_and_verifies_maps_and_a_killed_writer_is_replaced() {
    let engine = match NatsServers::start(3).await {
        Ok(engine) => engine,
        Err(reason) => return println!("SKIPPED: {reason}"),
    };
    let work = tempdir().expect("a folder");
    let folder = work.path();
    let mut members = Members(NAMES.map(|name| (name, start(folder, name, &engine))).into());
    tidemap(members.first(), ["map", "create", "office"]).table();
    let held = eventually(members.first(), "cluster maps", is_held_by_all);
    let before = writer(&held).expect("a writer");
    check_json(members.first(), "cluster status");
    check_json(members.first(), "cluster maps");
    members.learn(folder, 0);
    check_json(members.first(), "cluster verify office");

    // The map moves to each member once; any member takes the request.
    for name in NAMES.iter().filter(|name| **name != before).chain([&before.as_str()]) {
        let moved = check_json(members.first(), &format!("cluster move office {name}"));
        assert_eq!(moved[0]["writer"], *name);
        let found = eventually(members.first(), "cluster maps", |outcome| writer(outcome).is_some());
        assert_eq!(writer(&found).as_deref(), Some(*name));
    }
    tidemap(members.first(), ["cluster", "move", "office", "south"]).fails(2, &["south", "north"]);
    check_json(members.first(), "cluster move office --unpin");
    members.learn(folder, 1);

    let drained = check_json(members.first(), &format!("cluster drain {before}"));
    assert_eq!(drained[0]["map"], "office");
    let taken = drained[0]["writer"].as_str().expect("a writer").to_owned();
    assert_ne!(taken, before, "it gives its maps away");
    tidemap(members.first(), ["cluster", "move", "office", &before]).fails(2, &[&before, "--undo"]);
    tidemap(members.first(), ["cluster", "drain", &before, "--undo"]).table();
    assert_eq!(check_json(members.first(), "cluster heal office").as_array().map(Vec::len), Some(0));
    eventually(members.first(), "cluster status", |outcome| outcome.code == Some(0));

    members.take(&taken).kill();
    let found = eventually(members.first(), "cluster maps", |outcome| writer(outcome).is_some_and(|now| now != taken));
    assert_ne!(writer(&found).as_deref(), Some(taken.as_str()));
    let seen = eventually(members.first(), "cluster status", |outcome| outcome.stderr.contains("is gone"));
    assert!(seen.code == Some(1) && seen.stderr.contains(&format!("member {taken} is gone")), "{seen:?}");
    members.learn(folder, 2);
    let left = check_json(members.first(), &format!("cluster forget {taken}"));
    assert_eq!(left.as_array().map(Vec::len), Some(2));
    eventually(members.first(), "cluster status", |outcome| !outcome.stderr.contains("is gone"));
    let alive = members.0[1].0;
    tidemap(members.first(), ["cluster", "forget", alive]).fails(2, &[alive, "is alive"]);
    drop(members);
}

/// Repeats a request until its result is as expected.
async fn until<T: std::fmt::Debug>(what: &str, ask: impl AsyncFn() -> T, is_expected: impl Fn(&T) -> bool) -> T {
    let begun = Instant::now();
    loop {
        let answer = ask().await;
        if is_expected(&answer) {
            return answer;
        }
        assert!(begun.elapsed() < WITHIN, "{what}: {answer:?}");
        tokio::time::sleep(POLL).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_member_that_holds_no_maps_shows_deletes_and_creates_those_of_others() {
    let engine = match NatsServers::start(1).await {
        Ok(engine) => engine,
        Err(reason) => return println!("SKIPPED: {reason}"),
    };
    let work = tempdir().expect("a folder");
    let holder = start_with(work.path(), "north", (&engine, 1), "engine_replicas = 1\n");
    let gateway = start_with(work.path(), "west", (&engine, 1), "engine_replicas = 1\ncapacity = 0\n");
    let (at_holder, at_gateway) = (holder.client(), gateway.client());
    let office = || NewMap { name: "office".to_owned(), ..NewMap::default() };
    at_holder.create_map(office()).await.expect("created");
    for number in 0..10 {
        let (state, shape) = (format!("door-{number}"), StateShape::Scalar(StateKind::Probability));
        let add = async || at_holder.add_state("office", &state, shape, None, None).await;
        until("a writer", add, Result::is_ok).await.expect("added");
    }
    let map = until("its map", async || at_gateway.map("office").await, Result::is_ok).await.expect("passed on");
    assert_eq!((map.name.as_str(), map.states), ("office", 10));

    at_gateway.delete_map("office").await.expect("deleted where it is");
    until("no map", async || at_holder.maps().await.expect("a list"), Vec::is_empty).await;
    let gone = at_gateway.delete_map("office").await.expect_err("there is none");
    assert_eq!(gone.code(), Some(Code::NotFound), "{gone}");

    at_gateway.create_map(office()).await.expect("the name is free");
    eventually(&holder, "cluster maps", |outcome| writer(outcome).as_deref() == Some("north"));
    // This client has seen more of the map that had the name before.
    let (states, _) = at_holder.states("office", "").await.expect("another map");
    assert!(states.is_empty(), "{states:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn members_with_tls_know_each_other_by_the_files_of_now() {
    let engine = match NatsServers::start(1).await {
        Ok(engine) => engine,
        Err(reason) => return println!("SKIPPED: {reason}"),
    };
    let work = tempdir().expect("a folder");
    let (authority, other) = (Authority::new("ours"), Authority::new("theirs"));
    let ours = private_file(&work.path().join("ours.pem"), authority.pem());
    let of_peers = private_file(&work.path().join("peers.pem"), other.pem());
    let pair = authority.sign(Validity::Years);
    let [certificate, key] = pair.write(work.path());
    let start = |name, capacity| {
        let section = format!(
            "engine_replicas = 1\ncapacity = {capacity}\nadvertise = \"https://localhost:PORT\"\npeer_ca = {of_peers:?}\n"
        );
        let launch = launch(work.path(), name, (&engine, 1), &section);
        let launch = launch.setting("tls_certificate", certificate.display()).setting("tls_key", key.display());
        launch.setting("tls_client_ca", ours.display()).start()
    };
    let (holder, gateway) = (start("north", 1), start("west", 0));
    let [at_holder, at_gateway] = [&holder, &gateway].map(|daemon| authority.client(daemon, Some(&pair), None));
    at_holder.create_map(NewMap { name: "office".to_owned(), ..NewMap::default() }).await.expect("created");
    let ask = async || at_gateway.map("office").await.map_err(|error| error.to_string());
    let is_unknown_issuer = |answer: &Result<_, String>| {
        answer.as_ref().is_err_and(|error| error.contains("cannot reach: invalid peer certificate"))
    };
    until("the authority is another", ask, is_unknown_issuer).await.expect_err("not reached");
    private_file(&of_peers, authority.pem());
    assert_eq!(ask().await.expect("passed on").name, "office");
}

#[test]
fn a_daemon_that_is_alone_reports_it() {
    let work = tempdir().expect("a folder");
    let daemon = Launch::on(work.path()).start();
    for line in ["cluster status", "cluster maps", "cluster verify office", "cluster drain north"] {
        tidemap(&daemon, line.split(' ')).fails(2, &["not a member of a cluster", "[cluster]"]);
    }
    daemon.stop_in_order();
}

/// Ends all servers of the engine, and starts them again after something was done to their disks.
fn restart_engine(engine: &mut NatsServers, meanwhile: impl FnOnce(&NatsServers)) {
    (0..3).for_each(|index| engine.kill(index));
    meanwhile(engine);
    (0..3).for_each(|index| engine.run(index));
}

/// Daemons that run make everything again that an engine with empty disks does not have.
#[tokio::test(flavor = "multi_thread")]
async fn an_engine_that_has_lost_all_disks_gets_everything_from_the_daemons() {
    let mut engine = match NatsServers::start(3).await {
        Ok(engine) => engine,
        Err(reason) => return println!("SKIPPED: {reason}"),
    };
    restart_engine(&mut engine, NatsServers::save);
    let work = tempdir().expect("a folder");
    let folder = work.path();
    let members = Members(NAMES.map(|name| (name, start(folder, name, &engine))).into());
    tidemap(members.first(), ["map", "create", "office"]).table();
    eventually(members.first(), "cluster maps", is_held_by_all);
    members.learn(folder, 0);
    let identity = members.first().client().cluster_status(false).await.expect("answered").cluster_id;
    restart_engine(&mut engine, NatsServers::set_back);
    eventually(members.first(), "cluster status", |outcome| {
        outcome.code == Some(0) && writer(&tidemap(members.first(), ["cluster", "maps"])).is_some()
    });
    members.learn(folder, 1);
    let now = members.first().client().cluster_status(false).await.expect("answered").cluster_id;
    assert_eq!(now, identity, "producers do not see another cluster");
}

/// A fork needs an engine that forgets, and a writer that was alone with what was forgotten.
#[tokio::test(flavor = "multi_thread")]
async fn observations_of_a_fork_are_taken_into_the_map_again_by_an_operators_word() {
    let mut engine = match NatsServers::start(3).await {
        Ok(engine) => engine,
        Err(reason) => return println!("SKIPPED: {reason}"),
    };
    let work = tempdir().expect("a folder");
    let folder = work.path();
    let begin = |name: &'static str, engine: &NatsServers| {
        (name, start_with(folder, name, (engine, 3), "heal_wait_secs = 0\n"))
    };
    let mut members = Members(NAMES.map(|name| begin(name, &engine)).into());
    tidemap(members.first(), ["map", "create", "office"]).table();
    let held = eventually(members.first(), "cluster maps", is_held_by_all);
    members.learn(folder, 0);
    let alone = NAMES.into_iter().find(|name| writer(&held).as_deref() == Some(name)).expect("a writer");
    NAMES.iter().filter(|name| **name != alone).for_each(|name| drop(members.take(name).kill()));

    restart_engine(&mut engine, NatsServers::save);
    let rows = (0..40).map(|i| format!("{},{},1\n", 1_452_000_000 + i * 60, if i % 2 == 0 { "door" } else { "gate" }));
    let file = folder.join("forked.csv");
    fs::write(&file, format!("time,state,value\n{}", rows.collect::<String>())).expect("a file");
    let observe = ["observe", "office", file.to_str().expect("a path"), "--producer", "robot-1", "--label", "forked"];
    assert_eq!(tidemap(members.of(alone), observe).table().number("accepted"), 40.0);
    // A single group may never have been acknowledged, and is not reported as a fork.
    let more = ["observe", "office", &day(folder, 2), "--producer", "robot-3"];
    assert_eq!(tidemap(members.of(alone), more).table().number("accepted"), 144.0);
    drop(members.take(alone).kill());
    restart_engine(&mut engine, NatsServers::set_back);
    members.0.extend(NAMES.iter().filter(|name| **name != alone).map(|name| begin(name, &engine)));
    eventually(members.first(), "cluster maps", |outcome| writer(outcome).is_some());
    let other = tidemap(members.first(), ["observe", "office", &day(folder, 1), "--producer", "robot-2"]);
    assert_eq!(other.table().number("accepted"), 144.0, "the log goes on without the forgotten records");
    members.0.push(begin(alone, &engine));

    let shown = eventually(members.first(), "cluster heal office --dry-run", |outcome| outcome.code == Some(2));
    let row = shown.stdout.lines().nth(1).expect("a fork").to_owned();
    assert!(row.starts_with(&format!("office,{alone},")) && row.ends_with(",robot-1,forked,1,40,40,0,false"), "{row}");
    assert!(shown.stderr.contains("has 184 records that the map lacks"), "{shown:?}");
    let seen = tidemap(members.first(), ["cluster", "status"]);
    assert!(seen.code == Some(2) && seen.stderr.contains("FORKED"), "{seen:?}");
    let forks = || metrics::value(members.of(alone), "tidemap_cluster_forks{groups=\"more\"}");
    assert_eq!(forks(), Some(1.0));
    let healed = tidemap(members.first(), ["cluster", "heal", "office"]);
    assert_eq!(healed.code, Some(0), "{healed:?}");
    assert!(healed.stdout.contains(",robot-1,forked,1,40,40,40,true\n"), "{healed:?}");
    assert!(healed.stdout.contains(",robot-3,day-2.csv,1,144,144,144,true\n"), "{healed:?}");
    assert_eq!(forks(), Some(0.0));
    eventually(members.first(), "cluster verify office", |outcome| outcome.code == Some(0));
    let states = tidemap(members.first(), ["state", "list", "office"]).table();
    let seen: Vec<(&str, &str)> = states.column("state").into_iter().zip(states.column("observations")).collect();
    assert_eq!(seen, [("door", "452"), ("gate", "20")]);
    // Observations that the map has are not taken twice.
    let again = tidemap(members.first(), observe).table();
    assert_eq!((again.number("accepted"), again.number("duplicate")), (0.0, 40.0));
}
