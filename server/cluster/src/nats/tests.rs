//! The NATS engine on real servers: it behaves as an engine, keeps acknowledged messages when a leader is killed, and
//! maps errors exactly. Skipped where nats-server is missing.
//!
//! Invariant: no server outlives its test, and no time is asserted.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
    time::Duration,
};

use bytes::Bytes;
use rcgen::{BasicConstraints, CertificateParams, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair, KeyUsagePurpose};
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpListener,
    time::{Instant, sleep},
};

use super::*;
use crate::{
    engine::tests::behaves,
    nats_process::{NatsSecurity, NatsServers},
};

const STREAM: &str = "tm_a";
const PATIENCE: Duration = Duration::from_secs(20);
/// A request rarely comes before the server of a new consumer listens, so the test makes many lists.
const LISTS: usize = 300;

/// Settings of a test. It waits longer than a daemon, because the machine may be busy.
fn patient(mut settings: NatsSettings) -> NatsSettings {
    settings.request_time_out = PATIENCE;
    settings
}

async fn connect(settings: NatsSettings) -> NatsEngine {
    NatsEngine::connect(settings).await.expect("a connection")
}

fn bytes(text: &str) -> Bytes {
    Bytes::copy_from_slice(text.as_bytes())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn three_servers_behave_as_an_engine() {
    let servers = match NatsServers::start(3).await {
        Ok(servers) => servers,
        Err(reason) => return println!("SKIPPED: {reason}"),
    };
    let (first, second) = (connect(patient(servers.settings())).await, connect(patient(servers.settings())).await);
    behaves(first.clone(), second, 3).await;
    let checked = loop {
        let checked = check(&first, true).await.expect("servers that can be used");
        // On a busy machine one server may reply too late.
        if checked.len() == 3 {
            break checked;
        }
    };
    let reported: Vec<_> = checked.iter().map(|server| (server.name.as_str(), server.syncs_always)).collect();
    assert_eq!(reported, [("nats-0", Some(true)), ("nats-1", Some(true)), ("nats-2", Some(true))]);
    // The largest message can be appended, and both kinds of read return it.
    let largest = Bytes::from(vec![7; MESSAGE_BYTES_MAX]);
    first.create_stream("tm_large", 3).await.expect("create");
    assert_eq!(first.append_if("tm_large", 0, largest.clone(), PATIENCE).await, Ok(1));
    assert_eq!(first.read("tm_large", 1).await.expect("read").expect("a message").content, largest);
    assert_eq!(first.read_from("tm_large", 1, 1 << 20, PATIENCE).await.expect("read")[0].content, largest);
    // Another cluster on the same servers has its own streams and keys.
    let mut other = patient(servers.settings());
    "other".clone_into(&mut other.cluster);
    let other = connect(other).await;
    assert_eq!(other.ends("tm_large").await, Err(EngineError::Missing("stream".to_owned())));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_list_is_whole_whatever_server_makes_it() {
    let servers = match NatsServers::start(3).await {
        Ok(servers) => servers,
        Err(reason) => return println!("SKIPPED: {reason}"),
    };
    let engine = connect(patient(servers.settings())).await;
    engine.create_buckets(3).await.expect("buckets");
    let mut revisions = BTreeMap::new();
    for key in ["a", "b", "c"] {
        revisions.insert(key, engine.set_if(Bucket::Members, key, 0, bytes("0")).await.expect("set"));
    }
    // A member replaces its report continually.
    for round in 0..LISTS {
        let key = ["a", "b", "c"][round % 3];
        let revision = engine.set_if(Bucket::Members, key, revisions[key], bytes("1")).await.expect("set");
        revisions.insert(key, revision);
        let found = engine.list(Bucket::Members).await.expect("a list");
        assert_eq!(found.iter().map(|(key, _)| key.as_str()).collect::<BTreeSet<_>>(), ["a", "b", "c"].into());
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_server_behaves_as_an_engine_and_is_checked() {
    let servers = match NatsServers::start_unsynced(1).await {
        Ok(servers) => servers,
        Err(reason) => return println!("SKIPPED: {reason}"),
    };
    let engine = connect(patient(servers.settings())).await;
    behaves(engine.clone(), connect(patient(servers.settings())).await, 1).await;
    let unsynced = NatsCheckError::NotSynced { server: "nats-0".to_owned() };
    assert_eq!(check(&engine, true).await, Err(unsynced));
    assert_eq!(check(&engine, false).await.expect("allowed").len(), 1);
    // A single server cannot hold three replicas.
    let outcome = engine.create_stream("tm_three", 3).await;
    assert!(matches!(outcome, Err(EngineError::Refused(_))), "{outcome:?}");
    let outcome = engine.set(Bucket::Maps, "no key", bytes("1")).await;
    assert!(matches!(outcome, Err(EngineError::Refused(_))), "{outcome:?}");
    let too_large = engine.append_if("tm_read", 4, Bytes::from(vec![0; MESSAGE_BYTES_MAX + 1]), PATIENCE).await;
    assert!(matches!(too_large, Err(AppendIfError::Engine(EngineError::Refused(_)))), "{too_large:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn errors_state_what_is_known_of_the_effect() {
    let mut servers = match NatsServers::start(1).await {
        Ok(servers) => servers,
        Err(reason) => return println!("SKIPPED: {reason}"),
    };
    let mut settings = patient(servers.settings());
    settings.stream_bytes_max = Some(100_000);
    let engine = connect(settings).await;
    engine.create_stream(STREAM, 1).await.expect("create");
    let content = Bytes::from(vec![0; 30_000]);
    let mut last = 0;
    let full = loop {
        match engine.append_if(STREAM, last, content.clone(), PATIENCE).await {
            Ok(sequence) => last = sequence,
            Err(error) => break error,
        }
    };
    assert!(matches!(full, AppendIfError::Engine(EngineError::Full(_))), "{full:?}");
    assert_eq!((last, engine.ends(STREAM).await.expect("ends").last), (3, 3));
    // A purge makes room.
    engine.purge_before(STREAM, 3).await.expect("purge");
    assert_eq!(engine.append_if(STREAM, 3, content, PATIENCE).await, Ok(4));

    let mut guest = servers.settings_as("guest");
    guest.request_time_out = Duration::from_secs(1);
    let guest = connect(guest).await;
    let refused = guest.append_if(STREAM, 4, bytes("x"), Duration::from_secs(1)).await;
    assert!(matches!(refused, Err(AppendIfError::Engine(EngineError::Refused(_)))), "{refused:?}");
    let stranger = NatsEngine::connect(servers.settings_as("stranger")).await.err();
    assert!(matches!(stranger, Some(EngineError::Refused(_))), "{stranger:?}");

    // A frozen server may have taken the message.
    servers.signal(0, "STOP");
    // The signal may not have arrived yet.
    sleep(Duration::from_millis(200)).await;
    let unknown = engine.append_if(STREAM, 4, bytes("b"), Duration::from_millis(300)).await;
    assert!(matches!(unknown, Err(AppendIfError::Engine(EngineError::Unknown(_)))), "{unknown:?}");
    servers.signal(0, "CONT");
    // The repetition with the same expectation succeeds or is refused. In the end the stream has exactly one message.
    let again = engine.append_if(STREAM, 4, bytes("b"), PATIENCE).await;
    assert!(matches!(again, Ok(5) | Err(AppendIfError::NotExpected)), "{again:?}");
    assert_eq!(engine.ends(STREAM).await.expect("ends").last, 5);

    // Without a server a call has no effect, once the client has noticed it.
    servers.kill(0);
    let unavailable = loop {
        match engine.append_if(STREAM, 5, bytes("c"), Duration::from_millis(300)).await {
            Err(AppendIfError::Engine(EngineError::Unknown(_))) => {}
            outcome => break outcome,
        }
    };
    assert!(matches!(unavailable, Err(AppendIfError::Engine(EngineError::Unavailable(_)))), "{unavailable:?}");
    servers.run(0);
    // The connection comes back by itself.
    while engine.ends(STREAM).await.is_err() {
        sleep(Duration::from_millis(50)).await;
    }
    assert_eq!(engine.read(STREAM, 5).await.expect("read").expect("a message").content, bytes("b"));
    let nobody = NatsEngine::connect(NatsSettings::new(vec!["nats://127.0.0.1:1".to_owned()])).await.err();
    assert!(matches!(nobody, Some(EngineError::Unavailable(_))), "{nobody:?}");
}

/// Appends until a number of messages is acknowledged, as a writer does: it finds out the outcome of an append that is
/// not known.
async fn write(engine: &NatsEngine, count: u64, acknowledged: &mut BTreeMap<u64, String>) -> Duration {
    let mut longest = Duration::ZERO;
    let mut last_success = Instant::now();
    let mut last = acknowledged.keys().last().copied().unwrap_or_default();
    let goal = last + count;
    while last < goal {
        let content = format!("message {}", last + 1);
        match engine.append_if(STREAM, last, bytes(&content), Duration::from_millis(500)).await {
            Ok(sequence) => {
                assert_eq!(sequence, last + 1);
            }
            // This is the only writer, so the message was appended.
            Err(AppendIfError::NotExpected) => match engine.read(STREAM, last + 1).await {
                Ok(Some(message)) => assert_eq!(message.content, bytes(&content)),
                Ok(None) => panic!("the stream refuses {}, and does not have it", last + 1),
                Err(_) => continue,
            },
            Err(AppendIfError::Engine(EngineError::Unknown(_))) => continue,
            Err(AppendIfError::Engine(EngineError::Unavailable(_))) => {
                sleep(Duration::from_millis(20)).await;
                continue;
            }
            Err(error) => panic!("{error:?}"),
        }
        last += 1;
        acknowledged.insert(last, content);
        longest = longest.max(last_success.elapsed());
        last_success = Instant::now();
    }
    longest
}

/// The reply of the engine once it is available: it may have to elect leaders after the actions of a test.
async fn answer<T>(mut ask: impl AsyncFnMut() -> Result<T, EngineError>) -> T {
    loop {
        match ask().await {
            Ok(answer) => return answer,
            Err(EngineError::Unavailable(_) | EngineError::Unknown(_)) => sleep(Duration::from_millis(50)).await,
            Err(error) => panic!("{error:?}"),
        }
    }
}

/// Checks that the stream has all acknowledged messages, and no others.
async fn check_all(engine: &NatsEngine, acknowledged: BTreeMap<u64, String>) {
    let ends = answer(async || engine.ends(STREAM).await).await;
    assert_eq!((ends.first, ends.last), (1, acknowledged.len() as u64));
    for (sequence, content) in acknowledged {
        let message = answer(async || engine.read(STREAM, sequence).await).await.expect("what was acknowledged");
        assert_eq!(message.content, bytes(&content));
    }
}

/// The server that leads the stream, once one does.
async fn leader(engine: &NatsEngine) -> String {
    loop {
        match engine.health(STREAM).await {
            Ok(StreamHealth { leader: Some(leader), .. }) => return leader,
            _ => sleep(Duration::from_millis(50)).await,
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_killed_leader_loses_nothing_and_appends_come_back() {
    let mut servers = match NatsServers::start(3).await {
        Ok(servers) => servers,
        Err(reason) => return println!("SKIPPED: {reason}"),
    };
    let engine = connect(servers.settings()).await;
    engine.create_stream(STREAM, 3).await.expect("create");
    let mut acknowledged = BTreeMap::new();
    // A follower that reads through all of it.
    let follower = engine.clone();
    let following = tokio::spawn(async move {
        let mut next = 1;
        while next <= 150 {
            match follower.read_from(STREAM, next, 1 << 20, Duration::from_secs(1)).await {
                Ok(messages) => {
                    for message in messages {
                        assert_eq!((message.sequence, message.content), (next, bytes(&format!("message {next}"))));
                        next += 1;
                    }
                }
                Err(EngineError::Unknown(_) | EngineError::Unavailable(_)) => sleep(Duration::from_millis(20)).await,
                Err(error) => panic!("{error:?}"),
            }
        }
    });
    write(&engine, 50, &mut acknowledged).await;
    for _ in 0..2 {
        let leader = leader(&engine).await;
        let index = servers.index(&leader).expect("a server of the cluster");
        servers.kill(index);
        let longest = write(&engine, 50, &mut acknowledged).await;
        println!("kill -9 of the leader {leader}: {longest:.1?} without appends");
        servers.run(index);
        // The expected number is checked under every leader.
        let is_refused = answer(async || match engine.append_if(STREAM, 1, bytes("x"), PATIENCE).await {
            Err(AppendIfError::Engine(error)) => Err(error),
            outcome => Ok(outcome == Err(AppendIfError::NotExpected)),
        });
        assert!(is_refused.await);
    }
    following.await.expect("the follower");
    check_all(&engine, acknowledged).await;
}

/// The names of the consumers of a stream.
async fn consumers(engine: &NatsEngine, name: &str) -> Vec<String> {
    let listed: serde_json::Value =
        engine.calls.api(&format!("CONSUMER.NAMES.{name}"), &json!({}), PATIENCE).await.expect("names");
    let names = listed["consumers"].as_array().into_iter().flatten();
    names.filter_map(|name| name.as_str().map(str::to_owned)).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_consumer_that_is_silent_while_its_stream_goes_on_is_replaced() {
    let servers = match NatsServers::start(1).await {
        Ok(servers) => servers,
        Err(reason) => return println!("SKIPPED: {reason}"),
    };
    let engine = connect(patient(servers.settings())).await;
    engine.create_stream(STREAM, 1).await.expect("create");
    assert_eq!(engine.append_if(STREAM, 0, bytes("a"), PATIENCE).await, Ok(1));
    assert_eq!(engine.read_from(STREAM, 1, 1 << 20, PATIENCE).await.expect("read").len(), 1);
    // Simulates a consumer on a server that does not catch up: it is alive, and delivers nothing.
    let name = engine.stream_name(STREAM);
    let before = consumers(&engine, &name).await;
    assert_eq!(before.len(), 1, "{before:?}");
    let until = json!({ "pause_until": "2100-01-01T00:00:00Z" });
    let api = format!("CONSUMER.PAUSE.{name}.{}", before[0]);
    engine.calls.api::<serde_json::Value>(&api, &until, PATIENCE).await.expect("a pause");
    assert_eq!(engine.append_if(STREAM, 1, bytes("b"), PATIENCE).await, Ok(2));
    let read = async {
        loop {
            let messages = engine.read_from(STREAM, 2, 1 << 20, Duration::from_millis(250)).await.expect("read");
            if !messages.is_empty() {
                return messages;
            }
        }
    };
    let messages = tokio::time::timeout(PATIENCE, read).await.expect("the message comes without that consumer");
    assert_eq!((messages.len(), messages[0].sequence), (1, 2));
    assert_eq!(engine.append_if(STREAM, 2, bytes("c"), PATIENCE).await, Ok(3));
    assert_eq!(engine.read_from(STREAM, 3, 1 << 20, PATIENCE).await.expect("read").len(), 1);
    assert_ne!(consumers(&engine, &name).await, before, "another one takes its place");
}

/// The public key of a user, and its seed, from the example in the NATS documentation.
const NKEY: (&str, &str) = (
    "UDXU4RCSJNZOIQHZNWXHXORDPRTGNJAHAHFRGZNEEJCPQTT2M7NLCNF4",
    "SUACSSL3UAHUDXKFSNVUZRF5UHPMWZ6BFDTJ7M6USDXIEDNPPQYYYCU3VY",
);

/// Writes the certificates of an authority, and of a server and a client of this machine, as files in a folder.
fn secured(folder: &Path) -> NatsSecurity {
    let mut params = CertificateParams::new(Vec::<String>::new()).expect("parameters");
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::DigitalSignature];
    let key = KeyPair::generate().expect("a key");
    let file = |name: &str, text: &str| {
        let path = folder.join(name);
        std::fs::write(&path, text).expect("a file");
        path
    };
    let authority = file("authority.pem", &params.self_signed(&key).expect("a certificate").pem());
    let issuer = Issuer::new(params, key);
    let pair = |name: &str| {
        let mut params = CertificateParams::new(vec!["127.0.0.1".to_owned()]).expect("parameters");
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth];
        let key = KeyPair::generate().expect("a key");
        let certificate = params.signed_by(&key, &issuer).expect("a certificate");
        (file(&format!("{name}.pem"), &certificate.pem()), file(&format!("{name}.key"), &key.serialize_pem()))
    };
    NatsSecurity {
        server: pair("server"),
        client: NatsTls { authority: Some(authority), client: Some(pair("client")) },
        nkey: NKEY.0.to_owned(),
        seed: file("seed", NKEY.1),
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn servers_that_want_certificates_and_an_nkey_get_them() {
    let folder = tempfile::tempdir().expect("a folder");
    let servers = match NatsServers::start_secured(1, secured(folder.path())).await {
        Ok(servers) => servers,
        Err(reason) => return println!("SKIPPED: {reason}"),
    };
    let settings = patient(servers.settings());
    let engine = connect(settings.clone()).await;
    engine.create_stream(STREAM, 1).await.expect("create");
    assert_eq!(engine.append_if(STREAM, 0, bytes("a"), PATIENCE).await, Ok(1));
    let without_nkey = NatsSettings { credentials: NatsCredentials::None, ..settings.clone() };
    let outcome = NatsEngine::connect(without_nkey).await.err();
    assert!(matches!(outcome, Some(EngineError::Refused(_))), "{outcome:?}");
    let without_certificates = NatsSettings { tls: None, ..settings.clone() };
    let outcome = NatsEngine::connect(without_certificates).await.err();
    assert!(outcome.is_some(), "{outcome:?}");
    let missing = NatsSettings { credentials: NatsCredentials::File(folder.path().join("none")), ..settings };
    let outcome = NatsEngine::connect(missing).await.err();
    assert!(matches!(outcome, Some(EngineError::Refused(_))), "{outcome:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_leader_that_stood_still_takes_nothing_when_it_wakes() {
    let servers = match NatsServers::start(3).await {
        Ok(servers) => servers,
        Err(reason) => return println!("SKIPPED: {reason}"),
    };
    let any = connect(servers.settings()).await;
    any.create_stream(STREAM, 3).await.expect("create");
    let mut acknowledged = BTreeMap::new();
    write(&any, 10, &mut acknowledged).await;
    let leader = leader(&any).await;
    let index = servers.index(&leader).expect("a server of the cluster");
    // One client is connected to the leader, the other one to the two other servers.
    let on_leader = connect(NatsSettings { servers: vec![servers.url(index)], ..servers.settings() }).await;
    let others = (0..3).filter(|&other| other != index).map(|other| servers.url(other)).collect();
    let elsewhere = connect(NatsSettings { servers: others, ..servers.settings() }).await;
    servers.signal(index, "STOP");
    let frozen = tokio::spawn({
        let on_leader = on_leader.clone();
        // The message is in the frozen leader's socket when it wakes.
        async move { on_leader.append_if(STREAM, 10, bytes("of the frozen"), Duration::from_secs(12)).await }
    });
    let longest = write(&elsewhere, 10, &mut acknowledged).await;
    println!("SIGSTOP of the leader {leader}: {longest:.1?} without appends");
    servers.signal(index, "CONT");
    let outcome = frozen.await.expect("the task");
    assert!(outcome.is_err(), "{outcome:?}");
    write(&elsewhere, 10, &mut acknowledged).await;
    check_all(&elsewhere, acknowledged).await;
}

/// A server that reports a given version, and answers pings only.
async fn pretend(listener: TcpListener, version: &'static str) {
    while let Ok((mut connection, _)) = listener.accept().await {
        tokio::spawn(async move {
            let info = format!(
                "INFO {{\"server_id\":\"A\",\"server_name\":\"old\",\"version\":\"{version}\",\"proto\":1,\
                 \"headers\":true,\"max_payload\":2097152,\"jetstream\":true}}\r\n"
            );
            connection.write_all(info.as_bytes()).await.expect("write");
            let mut buffer = [0; 4096];
            while let Ok(read @ 1..) = connection.read(&mut buffer).await {
                let pings = buffer[..read].windows(4).filter(|window| window == b"PING").count();
                for _ in 0..pings {
                    connection.write_all(b"PONG\r\n").await.expect("write");
                }
            }
        });
    }
}

#[tokio::test]
async fn a_server_that_is_too_old_is_refused() {
    for (version, is_refused) in
        [("2.9.10", true), ("2.15.0", true), ("junk", true), ("2.15.1", false), ("3.0.0", false)]
    {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("an address");
        let server = tokio::spawn(pretend(listener, version));
        let engine = connect(NatsSettings::new(vec![format!("nats://{address}")])).await;
        let outcome = check(&engine, true).await;
        if is_refused {
            let expected = NatsCheckError::Version { server: "old".to_owned(), version: version.to_owned() };
            assert_eq!(outcome, Err(expected));
        } else {
            assert_eq!(outcome.expect("new enough")[0].syncs_always, None, "{version}");
        }
        server.abort();
    }
}

/// A server that is cut off from the others returns its own part of a stream, which may end before the stream.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stream_that_has_lost_most_servers_has_no_known_end() {
    let mut servers = match NatsServers::start(3).await {
        Ok(servers) => servers,
        Err(reason) => return println!("SKIPPED: {reason}"),
    };
    let engine = connect(servers.settings()).await;
    engine.create_stream(STREAM, 3).await.expect("create");
    write(&engine, 3, &mut BTreeMap::new()).await;
    servers.kill(0);
    servers.kill(1);
    // The leader notices after a while that it is alone, and is the leader until then.
    loop {
        match engine.health(STREAM).await {
            Ok(StreamHealth { leader: None, .. }) => break,
            _ => sleep(Duration::from_millis(200)).await,
        }
    }
    for _ in 0..5 {
        let ends = engine.ends(STREAM).await;
        assert!(matches!(ends, Err(EngineError::Unavailable(_) | EngineError::Unknown(_))), "{ends:?}");
    }
    servers.run(0);
    // Two servers of three sometimes need minutes to elect a leader. With the third one they need no luck.
    let mut waits = 0;
    while engine.ends(STREAM).await.map(|ends| ends.last) != Ok(3) {
        sleep(Duration::from_millis(200)).await;
        waits += 1;
        if waits == 100 {
            servers.run(1);
        }
    }
}
