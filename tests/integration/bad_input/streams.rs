//! Streams that break the protocol: each ends with its reason; the daemon, the map and other streams continue.

use std::io::{Read as _, Write as _};

use prost::Message as _;
use tidemap_proto::v1::{
    GoodbyeReason, Hello, ObservationBatch, ObservationColumns, ObserveRequest, ProducerSensor,
    observe_request::Message,
};
use tidemap_tests::{
    daemon::{Daemon, Launch},
    garbage,
    stream::{Ended, RawStream, columns, hello},
};
use tonic::Code;

use super::{observations, office};

#[track_caller]
fn check(ended: Ended, reason: Option<GoodbyeReason>, code: Code, words: &[&str]) {
    let found = ended.goodbye.as_ref().map(|goodbye| goodbye.reason());
    assert_eq!(found, reason, "{ended:?}");
    if let Some(goodbye) = &ended.goodbye {
        let message = ended.status.as_ref().map(|status| status.message());
        assert_eq!(Some(goodbye.detail.as_str()), message, "Goodbye and status agree");
    }
    let status = ended.error();
    assert_eq!(status.code(), code, "{status:?}");
    for word in words {
        assert!(status.message().contains(word), "{word:?} is not in {status:?}");
    }
}

fn no_columns(count: usize) -> ObservationColumns {
    columns(&["door"], &vec![(0, 1_000, 1.0); count])
}

async fn opened(daemon: &Daemon) -> RawStream {
    let opened = RawStream::open(&daemon.grpc, hello("robot", "office")).await;
    opened.unwrap_or_else(|ended| panic!("no Welcome: {ended:?}")).0
}

/// The daemon continues with all its data.
async fn goes_on(daemon: &Daemon, expected: u64) {
    assert_eq!(observations(daemon).await, expected);
    let (mut stream, welcome) = RawStream::open(&daemon.grpc, hello("neighbour", "office")).await.expect("a Welcome");
    let next = welcome.durable_sequence + 1;
    stream.batch(next, columns(&["neighbour"], &[(0, 1_000, 1.0)])).await;
    stream.acknowledged(next).await.expect("the daemon goes on");
}

#[tokio::test(flavor = "multi_thread")]
async fn batches_over_a_limit_end_the_stream_and_nothing_of_them_is_kept() {
    let (_data, daemon) = office(|launch| launch.setting("max_batch_observations", 100)).await;
    let mut stream = opened(&daemon).await;
    stream.batch(1, no_columns(100)).await;
    stream.acknowledged(100).await.expect("as many as allowed");
    stream.batch(101, no_columns(101)).await;
    let words = ["101", "100", "max_batch_observations"];
    check(stream.end().await, Some(GoodbyeReason::Invalid), Code::ResourceExhausted, &words);

    goes_on(&daemon, 100).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn messages_over_the_limit_of_bytes_end_the_stream_by_name() {
    let (_data, daemon) = office(|launch| launch.setting("max_message_bytes", 4096)).await;
    let mut stream = opened(&daemon).await;
    stream.batch(1, no_columns(1)).await;
    stream.acknowledged(1).await.expect("taken");
    let huge = ObservationColumns { new_states: vec!["x".repeat(20_000)], ..no_columns(1) };
    let batch = ObservationBatch { first_sequence: 2, observations: Some(huge) };
    let request = ObserveRequest { message: Some(Message::Batch(batch)) };
    stream.send(request).await;
    let ended = stream.end().await;
    assert_eq!(ended.goodbye.as_ref().map(|goodbye| goodbye.reason()), Some(GoodbyeReason::Invalid), "{ended:?}");
    let status = ended.error();
    let codes = [Code::InvalidArgument, Code::ResourceExhausted, Code::OutOfRange];
    assert!(codes.contains(&status.code()), "{status:?}");
    let words = ["bytes of one message", "4096", "max_message_bytes"];
    assert!(words.iter().all(|word| status.message().contains(word)), "{words:?} are not in {status:?}");
    goes_on(&daemon, 1).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn bytes_that_are_no_messages_are_malformed_messages() {
    let (_data, daemon) = office(|launch| launch).await;
    let greeting = ObserveRequest { message: Some(Message::Hello(hello("robot", "office"))) }.encode_to_vec();
    // A batch whose new state is no UTF-8, and a field that is longer than the message.
    let no_text = vec![0x12, 0x07, 0x08, 0x01, 0x12, 0x03, 0x2A, 0x01, 0xFF];
    let cut_off = vec![0x12, 0xFF, 0xFF, 0x03, 0x08, 0x01];
    let noise: Vec<u8> = (0..5_000_u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 11) as u8).collect();
    for bytes in [no_text, cut_off, noise] {
        for messages in [vec![bytes.clone()], vec![greeting.clone(), bytes]] {
            let greeted = messages.len() > 1;
            let ended = garbage::observe(&daemon.grpc, messages).await;
            let status = ended.expect_err("a malformed message is an error");
            assert_eq!(status.code(), Code::InvalidArgument, "after a Hello: {greeted}: {status:?}");
        }
    }
    // A megabyte of empty messages is many times that when it is decoded.
    let bomb = [0x12_u8, 0x00].repeat(500_000);
    let status = garbage::observe(&daemon.grpc, vec![greeting, bomb]).await.expect_err("a batch without observations");
    assert_eq!(status.code(), Code::InvalidArgument, "{status:?}");
    goes_on(&daemon, 0).await;
    let log = daemon.stop_in_order();
    assert!(!log.contains("panicked"), "{log}");
}

#[tokio::test(flavor = "multi_thread")]
async fn malformed_columns_name_the_column() {
    let (_data, daemon) = office(|launch| launch).await;
    let good = || columns(&["door"], &[(0, 1_000, 1.0), (0, 1_001, 0.0)]);
    let cases = [
        (ObservationColumns { time_deltas: Vec::new(), ..good() }, "observations.time_deltas"),
        (ObservationColumns { values: vec![1.0], ..good() }, "observations.values"),
        (ObservationColumns { values: Vec::new(), ..good() }, "observations.values"),
        (ObservationColumns { state_indices: vec![0], ..good() }, "observations.state_indices"),
        (ObservationColumns { bits: vec![3].into(), ..good() }, "observations.values"),
        (ObservationColumns { bits: vec![3, 3].into(), values: Vec::new(), ..good() }, "observations.bits"),
    ];
    for (columns, field) in cases {
        let mut stream = opened(&daemon).await;
        stream.batch(1, columns).await;
        check(stream.end().await, Some(GoodbyeReason::Invalid), Code::InvalidArgument, &[field]);
    }
    let mut stream = opened(&daemon).await;
    stream.send_message(Message::Batch(ObservationBatch { first_sequence: 1, observations: None })).await;
    check(stream.end().await, Some(GoodbyeReason::Invalid), Code::InvalidArgument, &["observations"]);
    let mut stream = opened(&daemon).await;
    stream.batch(0, good()).await;
    check(stream.end().await, Some(GoodbyeReason::Invalid), Code::InvalidArgument, &["first_sequence", "0"]);
    goes_on(&daemon, 0).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn numbers_that_leap_end_the_stream_and_numbers_again_are_no_news() {
    let (_data, daemon) = office(|launch| launch).await;
    let row = |time: i64| (0, time, 1.0);
    let mut stream = opened(&daemon).await;
    stream.batch(1, columns(&["door"], &[row(1), row(2), row(3)])).await;
    stream.acknowledged(3).await.expect("new");
    // Sent again: all, a part, and rows that overlap new ones.
    stream.batch(1, columns(&[], &[row(1), row(2), row(3)])).await;
    stream.acknowledged(3).await.expect("acknowledged again");
    stream.batch(2, columns(&[], &[row(2)])).await;
    stream.acknowledged(3).await.expect("acknowledged again");
    stream.batch(2, columns(&[], &[row(2), row(3), row(4), row(5)])).await;
    stream.acknowledged(5).await.expect("the new part");
    assert_eq!(observations(&daemon).await, 5);
    stream.batch(7, columns(&[], &[row(7)])).await;
    check(stream.end().await, Some(GoodbyeReason::OutOfSequence), Code::OutOfRange, &["7", "6"]);
    goes_on(&daemon, 5).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn numbers_again_with_other_content_end_the_stream_and_change_nothing() {
    let (data, daemon) = office(|launch| launch).await;
    let row = |time: i64| (0, time, 1.0);
    let mut stream = opened(&daemon).await;
    stream.batch(1, columns(&["door"], &[row(1), row(2), row(3)])).await;
    stream.acknowledged(3).await.expect("new");
    stream.batch(4, columns(&[], &[row(4)])).await;
    stream.acknowledged(4).await.expect("new");
    stream.batch(1, columns(&[], &[row(1), (0, 2, 0.0), row(3)])).await;
    let words = ["observations 1 to 3", "number new observations from 5"];
    check(stream.end().await, Some(GoodbyeReason::DataMismatch), Code::FailedPrecondition, &words);
    goes_on(&daemon, 4).await;
    // Observations that come again after a kill are compared too, whether new ones follow them or not.
    daemon.kill();
    let daemon = Launch::on(data.path()).start();
    let mut stream = opened(&daemon).await;
    stream.batch(4, columns(&["door"], &[(0, 4, 0.5), row(5)])).await;
    let words = ["observations 4 to 4", "from 5"];
    check(stream.end().await, Some(GoodbyeReason::DataMismatch), Code::FailedPrecondition, &words);
    assert_eq!(observations(&daemon).await, 5);
    let mut stream = opened(&daemon).await;
    stream.batch(1, columns(&["door"], &[row(1), row(2), row(3), row(4), row(5)])).await;
    stream.acknowledged(5).await.expect("the same, and a new one");
    assert_eq!(observations(&daemon).await, 6);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_begins_with_one_hello() {
    let (_data, daemon) = office(|launch| launch).await;
    let mut stream = RawStream::silent(&daemon.grpc).await.expect("a stream");
    stream.batch(1, no_columns(1)).await;
    check(stream.end().await, None, Code::InvalidArgument, &["Hello"]);

    let mut stream = RawStream::silent(&daemon.grpc).await.expect("a stream");
    stream.send(ObserveRequest { message: None }).await;
    check(stream.end().await, None, Code::InvalidArgument, &["Hello"]);

    let mut stream = opened(&daemon).await;
    stream.batch(1, no_columns(2)).await;
    stream.acknowledged(2).await.expect("taken");
    stream.send_message(Message::Hello(hello("robot", "office"))).await;
    check(stream.end().await, Some(GoodbyeReason::Invalid), Code::InvalidArgument, &["Hello", "batch"]);
    goes_on(&daemon, 2).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hello_names_a_map_and_a_producer() {
    let (_data, daemon) = office(|launch| launch).await;
    let long = "x".repeat(129);
    let sensor = ProducerSensor { hit: Some(0.9), false_alarm: None };
    for (hello, code, words) in [
        (hello("robot", "attic"), Code::NotFound, ["attic", "office"]),
        (hello("robot", ""), Code::NotFound, ["\"\"", "office"]),
        (hello("robot", "../../etc"), Code::NotFound, ["../../etc", "office"]),
        (hello("", "office"), Code::InvalidArgument, ["producer", "empty"]),
        (hello(&long, "office"), Code::InvalidArgument, ["producer", "129"]),
        (hello("a\nb", "office"), Code::InvalidArgument, ["producer", "U+000A"]),
        (Hello { label: long.clone(), ..hello("robot", "office") }, Code::InvalidArgument, ["label", "129"]),
        (Hello { sensor: Some(sensor), ..hello("robot", "office") }, Code::FailedPrecondition, ["no grid", "sensor"]),
    ] {
        check(RawStream::open(&daemon.grpc, hello).await.expect_err("refused"), None, code, &words);
    }
    goes_on(&daemon, 0).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn one_stream_of_a_producer_at_a_time() {
    let (_data, daemon) = office(|launch| launch).await;
    let as_robot = |incarnation| Hello { incarnation, ..hello("robot", "office") };
    let (mut first, welcome) = RawStream::open(&daemon.grpc, as_robot(0)).await.expect("a Welcome");
    first.batch(1, no_columns(1)).await;
    first.acknowledged(1).await.expect("taken");

    let refused = RawStream::open(&daemon.grpc, as_robot(0)).await.expect_err("in use");
    check(refused, None, Code::AlreadyExists, &["robot", "stop that stream"]);
    first.batch(2, columns(&[], &[(0, 2_000, 1.0)])).await;
    first.acknowledged(2).await.expect("the first stream is not harmed by that");

    // Another label is another sequence.
    let other = Hello { label: "other".to_owned(), ..as_robot(0) };
    let (_other, other_welcome) = RawStream::open(&daemon.grpc, other).await.expect("a Welcome");
    assert_eq!(other_welcome.durable_sequence, 0);

    let (mut second, again) = RawStream::open(&daemon.grpc, as_robot(welcome.incarnation)).await.expect("a Welcome");
    assert_eq!((again.incarnation, again.durable_sequence), (welcome.incarnation, 2));
    check(first.end().await, Some(GoodbyeReason::Superseded), Code::Aborted, &["took over"]);

    let newer = welcome.incarnation + 5;
    let (mut third, _) = RawStream::open(&daemon.grpc, as_robot(newer)).await.expect("a Welcome");
    check(second.end().await, Some(GoodbyeReason::Superseded), Code::Aborted, &["took over"]);
    third.batch(3, columns(&["door"], &[(0, 3_000, 1.0)])).await;
    third.acknowledged(3).await.expect("taken");
    let refused = RawStream::open(&daemon.grpc, as_robot(welcome.incarnation)).await.expect_err("fenced");
    check(refused, None, Code::Aborted, &["robot", &newer.to_string()]);
    goes_on(&daemon, 3).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn limits_of_streams_and_producers_are_named() {
    let (_data, daemon) = office(|launch| launch.setting("max_streams", 2).setting("max_producers_per_map", 2)).await;
    let take = async |producer: &str| {
        let (mut stream, _) = RawStream::open(&daemon.grpc, hello(producer, "office")).await.expect("a Welcome");
        stream.batch(1, no_columns(1)).await;
        stream.acknowledged(1).await.expect("taken");
        stream
    };
    let mut both = [take("a").await, take("b").await];
    let refused = RawStream::open(&daemon.grpc, hello("c", "office")).await.expect_err("too many streams");
    check(refused, None, Code::ResourceExhausted, &["max_streams"]);
    for stream in &mut both {
        stream.close();
        assert!(stream.end().await.status.is_none(), "a stream may end in order");
    }
    // The count of streams is reduced a moment after the stream's end is reported.
    let refused = loop {
        let refused = RawStream::open(&daemon.grpc, hello("c", "office")).await.expect_err("too many producers");
        if !refused.status.as_ref().is_some_and(|status| status.message().contains("max_streams")) {
            break refused;
        }
    };
    check(refused, None, Code::ResourceExhausted, &["max_producers_per_map"]);
    assert_eq!(observations(&daemon).await, 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn garbage_on_the_ports_harms_nobody() {
    let (_data, daemon) = office(|launch| launch).await;
    let mut stream = opened(&daemon).await;
    let preface = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
    let noise: Vec<u8> = (0..50_000_u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    let tail = |bytes: &[u8]| [preface.as_slice(), bytes].concat();
    for bytes in [noise.clone(), tail(&noise), tail(&[0xFF; 9]), b"GET / HTTP/1.1\r\n\r\n".to_vec(), tail(&[0; 90])] {
        for address in [&daemon.grpc, &daemon.http] {
            let mut connection = std::net::TcpStream::connect(address).expect("the port is open");
            // The daemon may have closed the connection already.
            let _ = connection.write_all(&bytes);
            let _ = connection.shutdown(std::net::Shutdown::Write);
            let _ = connection.read_to_end(&mut Vec::new());
        }
    }
    stream.batch(1, no_columns(1)).await;
    stream.acknowledged(1).await.expect("a stream that was open goes on");
    drop(stream);
    goes_on(&daemon, 1).await;
    let log = daemon.stop_in_order();
    assert!(!log.contains("panicked"), "{log}");
}
