//! Streams of observations and of replies through a daemon that passes them on.

use tidemap_proto::v1::{
    observation_service_client::ObservationServiceClient, observe_request::Message as Up,
    observe_response::Message as Down, query_service_client::QueryServiceClient,
};
use tokio_stream::wrappers::ReceiverStream;
use tonic::Streaming;

use super::*;

const BATCH: u64 = 500;
const ALL: u64 = 10_000;

/// A robot's stream.
struct Robot {
    requests: mpsc::Sender<v1::ObserveRequest>,
    replies: Streaming<v1::ObserveResponse>,
}

impl Robot {
    /// Opens a stream, and waits for its head before the robot sends its hello.
    async fn connect(member: &Member) -> Self {
        let (requests, outgoing) = mpsc::channel(64);
        let mut client = ObservationServiceClient::new(member.channel().await);
        let replies = client.observe(ReceiverStream::new(outgoing)).await.expect("a stream").into_inner();
        Self { requests, replies }
    }

    async fn send_message(&self, message: Up) {
        self.requests.send(v1::ObserveRequest { message: Some(message) }).await.expect("the stream is open");
    }

    async fn hello(member: &Member, incarnation: u64) -> Result<(Self, v1::Welcome), Status> {
        let mut robot = Self::connect(member).await;
        let (producer, map) = ("robot".to_owned(), "office".to_owned());
        robot.send_message(Up::Hello(v1::Hello { producer, map, incarnation, ..v1::Hello::default() })).await;
        match robot.reply().await? {
            Some(Down::Welcome(welcome)) => Ok((robot, welcome)),
            other => panic!("a Welcome should come, not {other:?}"),
        }
    }

    async fn reply(&mut self) -> Result<Option<Down>, Status> {
        let reply = tokio::time::timeout(Duration::from_secs(60), self.replies.message()).await.expect("an answer");
        Ok(reply?.and_then(|reply| reply.message))
    }

    async fn batch(&self, first: u64, is_first_of_stream: bool) {
        let columns = v1::ObservationColumns {
            new_states: if is_first_of_stream { vec!["door".to_owned()] } else { Vec::new() },
            first_time_nanos: 1_467_370_800_000_000_000 + i64::try_from(first).expect("small") * 1_000_000_000,
            time_deltas: (0..BATCH).map(|_| 1_000_000_000).collect(),
            values: (0..BATCH).map(|number| (number % 2) as f64).collect(),
            ..v1::ObservationColumns::default()
        };
        self.send_message(Up::Batch(v1::ObservationBatch { first_sequence: first, observations: Some(columns) })).await;
    }

    /// Waits until this number is acknowledged; returns the log position.
    async fn acknowledged(&mut self, sequence: u64) -> u64 {
        loop {
            match self.reply().await.expect("the stream goes on") {
                Some(Down::Ack(ack)) if ack.durable_sequence >= sequence => return ack.position,
                Some(Down::Ack(_) | Down::Busy(_)) => {}
                other => panic!("an Ack should come, not {other:?}"),
            }
        }
    }
}

fn predict() -> v1::PredictStatesRequest {
    v1::PredictStatesRequest {
        map: "office".to_owned(),
        states: vec!["door".to_owned()],
        times_nanos: (0..100).map(|number| 1_467_370_800_000_000_000 + number).collect(),
        ..v1::PredictStatesRequest::default()
    }
}

#[tokio::test]
async fn observations_through_another_daemon_are_taken_exactly_once() {
    let (a, b) = Member::pair().await;
    let (mut robot, welcome) = Robot::hello(&a, 0).await.expect("welcome");
    assert_eq!((welcome.durable_sequence, welcome.direct.as_str()), (0, b.address.as_str()));
    for first in (1..=ALL / 2).step_by(BATCH as usize) {
        robot.batch(first, first == 1).await;
    }
    robot.acknowledged(ALL / 2).await;
    drop(robot);
    // The robot does not know which numbers were acknowledged, and sends some again.
    let (mut robot, welcome) = Robot::hello(&a, welcome.incarnation).await.expect("welcome");
    assert_eq!(welcome.durable_sequence, ALL / 2);
    let from = ALL / 2 - 2 * BATCH + 1;
    for first in (from..=ALL).step_by(BATCH as usize) {
        robot.batch(first, first == from).await;
    }
    let position = robot.acknowledged(ALL).await;
    assert_eq!(b.handle().view().observations(), ALL);
    let token = ReadToken { map_uid: 0, position, generation: 0 };
    assert_eq!(a.states(Some(token)).await.expect("the daemon that has it responds").0, ["door"]);
}

#[tokio::test]
async fn a_stream_of_replies_is_passed_on() {
    let (a, b) = Member::pair().await;
    let token = shown(b.add_state("door").await.expect("added").metadata());
    let mut request = tonic::Request::new(predict());
    mark(&mut request, Some(token));
    let mut client = QueryServiceClient::new(a.channel().await);
    let mut replies = client.predict_states(request).await.expect("the writer responds").into_inner();
    let mut count = 0;
    while let Some(reply) = replies.message().await.expect("a reply") {
        count += reply.probabilities.len();
    }
    assert_eq!(count, 100);
    let refused = client.predict_states(predict()).await.expect_err("daemon a itself does not have the state");
    assert_eq!(refused.code(), Code::NotFound);
}

#[tokio::test]
async fn a_stream_that_is_passed_on_ends_with_a_status() {
    let (a, b) = Member::pair().await;
    let (mut robot, _) = Robot::hello(&a, 0).await.expect("welcome");
    b.notify(ReplicaEvent::Following { writer: Some("a".to_owned()) }).await;
    let ended = loop {
        match robot.reply().await {
            Ok(Some(Down::Goodbye(_))) => {}
            Err(status) => break status,
            other => panic!("the end should come, not {other:?}"),
        }
    };
    assert_eq!(reason(&ended), (Code::Unavailable, "NOT_WRITER".to_owned()));
    // Each member takes the other for the writer.
    let refused = Robot::hello(&a, 0).await.map(|_| ()).expect_err("passed on once");
    assert_eq!(reason(&refused), (Code::Unavailable, "NOT_WRITER".to_owned()));

    b.notify(ReplicaEvent::Writing { epoch: 3 }).await;
    let (mut robot, _) = Robot::hello(&a, 0).await.expect("welcome");
    a.stop.send_replace(true);
    let ended = robot.reply().await.expect_err("the daemon in between stops");
    assert_eq!(reason(&ended), (Code::Unavailable, "STOPPING".to_owned()));
}

#[tokio::test]
async fn a_robot_that_leaves_ends_its_stream_at_the_writer() {
    let (a, b) = Member::pair().await;
    let (mut robot, _) = Robot::hello(&a, 0).await.expect("welcome");
    robot.batch(1, true).await;
    robot.acknowledged(BATCH).await;
    drop(robot);
    // The stream at the writer ends with the robot's, so that its key is free.
    let mut attempts = 0;
    while let Err(status) = Robot::hello(&a, 0).await {
        assert_eq!(status.code(), Code::AlreadyExists, "{status:?}");
        attempts += 1;
        assert!(attempts < 1000, "the stream goes on");
    }
    assert_eq!(b.handle().view().observations(), BATCH);
}
