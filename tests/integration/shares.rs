//! Shares from outside: one token takes what it can get, and another one works.
//!
//! Invariant: what is refused to one client is refused by its own share, whose setting the message names.

use tempfile::{TempDir, tempdir};
use tidemap_client::{
    Client,
    maps::{GridSpec, NewMap, StateKind, StateShape},
};
use tidemap_proto::v1::{
    Refusal, RunUpdateRequest, Scan, ScanBatch, TileScan, WatchAnomaliesRequest,
    maintenance_service_client::MaintenanceServiceClient, observe_request::Message,
    query_service_client::QueryServiceClient, scan::Content,
};
use tidemap_tests::{
    daemon::{Daemon, Launch},
    stream::{RawStream, columns, hello},
    tokens::Tokens,
};
use tonic::{Code, Status};

/// A daemon with tokens and two maps, and clients with a token each.
async fn guarded<const N: usize>(change: impl FnOnce(Launch) -> Launch) -> (TempDir, Daemon, [Client; N], [String; N]) {
    let work = tempdir().expect("a folder");
    let tokens = Tokens::of(work.path());
    let made = [(); N].map(|()| tokens.create(&["admin"], &[]));
    let launch = Launch::on(&work.path().join("data")).setting("tokens_file", tokens.path.display());
    let daemon = change(launch).start();
    let clients = made.each_ref().map(|token| Client::with_token(&daemon.grpc, token).expect("loopback needs no TLS"));
    for name in ["office", "lab"] {
        clients[0].create_map(NewMap { name: name.to_owned(), ..NewMap::default() }).await.expect("a new map");
        let shape = StateShape::Scalar(StateKind::Probability);
        clients[0].add_state(name, "door", shape, None, None).await.expect("a new state");
    }
    (work, daemon, clients, made)
}

fn check(refused: &Status, words: &[&str]) {
    assert_eq!(refused.code(), Code::ResourceExhausted, "{refused:?}");
    assert!(words.iter().all(|word| refused.message().contains(word)), "{refused:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn one_token_leaves_streams_to_others() {
    let change = |launch: Launch| launch.setting("max_streams", 6).setting("max_streams_per_client", 4);
    let (_work, daemon, [greedy, other], _) = guarded(change).await;
    let mut held = Vec::new();
    for number in 0..4 {
        held.push(RawStream::open_as(&greedy, hello(&format!("greedy-{number}"), "office")).await.expect("its share"));
    }
    let refused = RawStream::open_as(&greedy, hello("greedy-4", "office")).await.expect_err("its share is taken");
    check(&refused, &["max_streams_per_client"]);
    for number in 0..2 {
        let stream = RawStream::open_as(&other, hello(&format!("robot-{number}"), "office")).await;
        let mut stream = stream.expect("the places of others");
        stream.batch(1, columns(&["door"], &[(0, 1_000, 1.0)])).await;
        stream.acknowledged(1).await.expect("durable");
        held.push(stream);
    }
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_of_one_map_never_keep_those_of_another_out() {
    let change = |launch: Launch| launch.setting("max_streams", 6).setting("max_streams_per_client", 3);
    let (_work, daemon, clients, _) = guarded::<3>(change).await;
    let [one, two, other] = clients;
    let mut crowd = Vec::new();
    for (number, client) in [&one, &two, &one, &two, &one, &two].into_iter().enumerate() {
        crowd.push(RawStream::open_as(client, hello(&format!("office-{number}"), "office")).await.expect("a place"));
    }
    let mut lab = Vec::new();
    for number in 0..3 {
        let stream = RawStream::open_as(&other, hello(&format!("lab-{number}"), "lab")).await;
        let mut stream = stream.expect("a map with fewer streams gets a place");
        stream.batch(1, columns(&["door"], &[(0, 1_000, 1.0)])).await;
        stream.acknowledged(1).await.expect("durable");
        lab.push(stream);
    }
    // Both maps have half of the room: nobody makes room for the next any more.
    let refused = RawStream::open_as(&one, hello("office-7", "office")).await.expect_err("no place");
    check(&refused, &["max_streams"]);
    for stream in &mut lab {
        stream.batch(2, columns(&[], &[(0, 2_000, 1.0)])).await;
        stream.acknowledged(2).await.expect("a client with few places keeps them");
    }
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn one_token_leaves_watches_of_anomalies_to_others() {
    let change = |launch: Launch| launch.setting("max_watches", 3).setting("max_watches_per_client", 2);
    let (_work, daemon, [greedy, other], _) = guarded(change).await;
    let watch = async |client: &Client| {
        let request = WatchAnomaliesRequest { map: "office".to_owned(), ..Default::default() };
        QueryServiceClient::new(client.requests()).watch_anomalies(request).await
    };
    let _held = [watch(&greedy).await.expect("its share"), watch(&greedy).await.expect("its share")];
    check(&watch(&greedy).await.expect_err("its share is taken"), &["max_watches_per_client"]);
    watch(&other).await.expect("the place of others");
    daemon.stop_in_order();
}

/// Sends observations of so many new states at once; gives the refusals.
async fn new_states(client: &Client, producer: &str, count: u32) -> Vec<Refusal> {
    let names: Vec<String> = (0..count).map(|number| format!("{producer} {number}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let rows: Vec<_> = (0..count).map(|state| (state, 1_000, 1.0)).collect();
    let mut stream = RawStream::open_as(client, hello(producer, "office")).await.expect("a stream");
    stream.batch(1, columns(&names, &rows)).await;
    stream.acknowledged(count.into()).await.expect("durable, or refused")
}

#[tokio::test(flavor = "multi_thread")]
async fn one_token_leaves_states_of_a_map_to_others() {
    let (_work, daemon, [admin, greedy, other], _) = guarded(|launch| launch.setting("max_states_per_map", 9)).await;
    // All 9 places were free when the first one was added.
    let refused = new_states(&greedy, "greedy", 8).await;
    assert_eq!(refused.len(), 3, "5 of 9: {refused:?}");
    assert!(refused[0].detail.contains("half of the free places") && refused[0].detail.contains("max_states_per_map"));
    let shape = StateShape::Scalar(StateKind::Probability);
    let added = greedy.add_state("office", "lamp", shape, None, None).await.expect_err("its share is taken");
    assert_eq!(added.code(), Some(Code::ResourceExhausted));
    assert!(added.to_string().contains("half of the free places"), "{added}");
    let refused = new_states(&other, "robot", 4).await;
    assert!(refused.len() == 1 && refused[0].detail.contains("the map has 9 states"), "3 are left: {refused:?}");
    // Known states are observed as before.
    let mut stream = RawStream::open_as(&greedy, hello("late", "office")).await.expect("a stream");
    stream.batch(1, columns(&["door"], &[(0, 2_000, 1.0)])).await;
    assert_eq!(stream.acknowledged(1).await.expect("durable"), []);
    assert_eq!(admin.map("office").await.expect("the map").states, 9);
    daemon.stop_in_order();
}

/// Sends scans that show a new tile each; gives the refusals.
async fn new_tiles(client: &Client, producer: &str, y: i32, count: u32) -> Vec<Refusal> {
    let scan = |slot| TileScan { seen: vec![slot, 1], masked: vec![slot], occupied: vec![0; 64], ..Default::default() };
    let scans = (0..count).map(|slot| Scan { content: Some(Content::Tiles(scan(slot))) }).collect();
    let batch = ScanBatch {
        first_sequence: 1,
        new_tiles: (0..count.cast_signed()).flat_map(|x| [x, y, 0]).collect(),
        time_unit_nanos: 1_000_000_000,
        first_time_nanos: 1_000_000_000,
        time_deltas: (0..count).map(|number| i64::from(number > 0)).collect(),
        scans,
        ..ScanBatch::default()
    };
    let mut stream = RawStream::open_as(client, hello(producer, "hall")).await.expect("a stream");
    stream.send_message(Message::Scans(batch)).await;
    stream.acknowledged(count.into()).await.expect("durable, or refused")
}

#[tokio::test(flavor = "multi_thread")]
async fn one_token_leaves_tiles_of_a_map_to_others() {
    let (_work, daemon, [admin, greedy, other], _) = guarded(|launch| launch.setting("max_tiles_per_map", 8)).await;
    let map = NewMap { name: "hall".to_owned(), grid: Some(GridSpec::new(0.1)), ..NewMap::default() };
    admin.create_map(map).await.expect("a new map");
    let refused = new_tiles(&greedy, "greedy", 0, 6).await;
    assert_eq!(refused.len(), 2, "4 of 8: {refused:?}");
    assert!(refused[0].detail.contains("half of the free places") && refused[0].detail.contains("max_tiles_per_map"));
    assert_eq!(new_tiles(&other, "robot", 1, 4).await, []);
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn requests_count_by_token_and_not_by_address() {
    let change = |launch: Launch| launch.setting("max_requests", 4).setting("max_requests_per_client", 1);
    let (_work, daemon, [greedy, other], [token, _]) = guarded(change).await;
    // A request that lasts: its messages do not come. The client library would wait for the first one.
    let channel = tonic::transport::Channel::from_shared(format!("http://{}", daemon.grpc)).expect("an address");
    let channel = channel.connect().await.expect("a connection");
    let lasting = || {
        let (open, requests) = tokio::sync::mpsc::channel(1);
        let mut request = tonic::Request::new(tokio_stream::wrappers::ReceiverStream::new(requests));
        let bearer = format!("Bearer {token}").parse().expect("text");
        request.metadata_mut().insert("authorization", bearer);
        let mut service = QueryServiceClient::new(channel.clone());
        tokio::spawn(async move {
            let _open = open;
            service.evaluate_states(request).await
        })
    };
    let mut held = lasting();
    let refused = loop {
        match greedy.maps().await {
            Err(error) => break error,
            // One stream of both came while the other was under way.
            Ok(_) if held.is_finished() => held = lasting(),
            Ok(_) => tokio::time::sleep(std::time::Duration::from_millis(5)).await,
        }
    };
    assert!(refused.to_string().contains("max_requests_per_client"), "{refused}");
    other.maps().await.expect("another token of the same address is served");
    held.abort();
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn updates_that_were_requested_give_their_places_back() {
    let (_work, daemon, [client], _) = guarded(|launch| launch).await;
    let mut service = MaintenanceServiceClient::new(client.requests());
    let mut taken = 0;
    while taken < 40 {
        let request = RunUpdateRequest { map: "office".to_owned(), until: None };
        match service.run_update(request).await {
            Ok(_) => taken += 1,
            Err(refused) => check(&refused, &["one client has requested"]),
        }
        tokio::time::sleep(std::time::Duration::from_millis(5)).await;
    }
    daemon.stop_in_order();
}
