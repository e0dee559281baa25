//! A producer against a fake daemon that disconnects, ends streams and forgets on purpose; the real daemon does this
//! only when its machine fails.

use std::{
    collections::{HashMap, VecDeque},
    pin::Pin,
    sync::{Mutex, PoisonError},
    time::Duration,
};

use tidemap_proto::v1::{
    ClassifyActivityRequest, ClassifyActivityResponse, ObservationBatch, Probe, Refusal as WireRefusal,
    RefusalReason as WireReason, ReportRequest, ReportResponse,
    observation_service_server::{ObservationService, ObservationServiceServer},
};
use tokio::net::TcpListener;
use tokio_stream::{Stream, StreamExt as _, wrappers::TcpListenerStream};
use tonic::{Request, Response, Status, transport::Server};
use tonic_types::ErrorDetails;

use super::*;
use crate::observe::{Producer, ProducerOptions, RefusalReason, content::ContentCrc};

/// The behaviour of the daemon on one connection.
#[derive(Clone, Debug)]
enum Act {
    /// Works normally, refusing values above 1.
    Serve,
    /// Acknowledges the given number of observations; then stores one more batch and disconnects.
    ServeUntil(u64),
    /// Stores a batch, and disconnects without an acknowledgement.
    StoreAndBreak,
    /// Disconnects at the first batch.
    Break,
    /// Answers the Hello with an error.
    Refuse(Code),
    /// Ends the stream at the first batch, with a reason.
    End(GoodbyeReason),
    /// Acknowledges a batch, and then stops.
    ServeAndStop,
    /// Acknowledges a batch, and then needs the place for another stream.
    ServeAndDisplace,
    /// Probes whether the producer is there, and goes on only after the producer has answered.
    Probe,
    /// Is another data folder, with the given number of observations.
    Restored(usize),
}

#[derive(Clone, Debug, Default)]
struct Stored {
    rows: Vec<(String, f64)>,
    incarnations: Vec<u64>,
    acts: VecDeque<Act>,
}

impl Stored {
    fn crc(&self) -> u32 {
        let mut crc = ContentCrc::default();
        for (time, (state, value)) in (0..).zip(&self.rows) {
            crc.add(state, time, *value);
        }
        crc.value()
    }

    /// Observation n of the tests has the time n - 1, so that times need not be stored.
    fn take(&mut self, batch: ObservationBatch, names: &mut Vec<String>) -> Vec<WireRefusal> {
        let columns = batch.observations.unwrap_or_default();
        names.extend(columns.new_states);
        let mut refused = Vec::new();
        for i in 0..columns.time_deltas.len() {
            let sequence = batch.first_sequence + i as u64;
            let state = names[columns.state_indices.get(i).copied().unwrap_or(0) as usize].clone();
            let bit = || f64::from((columns.bits[i / 8] >> (i % 8)) & 1);
            let value = columns.values.get(i).copied().unwrap_or_else(bit);
            if sequence <= self.rows.len() as u64 {
                continue;
            }
            assert_eq!(sequence, self.rows.len() as u64 + 1, "a gap");
            if value > 1.0 {
                let reason = WireReason::Value.into();
                refused.push(WireRefusal { sequence, reason, detail: format!("value {value}") });
            }
            self.rows.push((state, value));
        }
        refused
    }
}

#[derive(Clone, Default)]
struct Fake(Arc<Mutex<Stored>>);

impl Fake {
    fn stored(&self) -> std::sync::MutexGuard<'_, Stored> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    async fn serve(
        &self,
        act: Act,
        mut requests: Streaming<ObserveRequest>,
        replies: &mpsc::Sender<Result<ObserveResponse, Status>>,
    ) -> Result<(), Status> {
        let send_reply = |message| replies.send(Ok(ObserveResponse { message: Some(message) }));
        let hello = requests.message().await?.and_then(|request| request.message);
        let Some(observe_request::Message::Hello(hello)) = hello else { return Err(Status::invalid_argument("Hello")) };
        let welcome = {
            let mut stored = self.stored();
            stored.incarnations.push(hello.incarnation);
            if let Act::Refuse(code) = act {
                return Err(Status::new(code, "no"));
            }
            if let Act::Restored(rows) = act {
                stored.rows.truncate(rows);
            }
            Welcome {
                store_id: format!("{act:?}"),
                incarnation: hello.incarnation.max(7),
                durable_sequence: stored.rows.len() as u64,
                content_crc: stored.crc(),
                max_batch_observations: 3,
                max_message_bytes: 4096,
                ..Welcome::default()
            }
        };
        let _ = send_reply(observe_response::Message::Welcome(welcome)).await;
        let mut names = Vec::new();
        if matches!(act, Act::Probe) {
            let _ = send_reply(observe_response::Message::Probe(Probe {})).await;
            let answer = requests.message().await?.and_then(|request| request.message);
            assert_eq!(answer, Some(observe_request::Message::Alive(Alive {})));
        }
        while let Some(request) = requests.message().await? {
            let Some(observe_request::Message::Batch(batch)) = request.message else { continue };
            match act {
                Act::Break => return Err(Status::unavailable("broken")),
                Act::StoreAndBreak => {
                    self.stored().take(batch, &mut names);
                    return Ok(());
                }
                Act::End(reason) => {
                    let goodbye = Goodbye { reason: reason.into(), durable_sequence: 0, detail: "so".to_owned() };
                    let _ = send_reply(observe_response::Message::Goodbye(goodbye)).await;
                    return Err(Status::unavailable("so"));
                }
                Act::Serve
                | Act::ServeAndStop
                | Act::ServeAndDisplace
                | Act::Probe
                | Act::ServeUntil(_)
                | Act::Refuse(_)
                | Act::Restored(_) => {
                    let ack = {
                        let mut stored = self.stored();
                        let refused = stored.take(batch, &mut names);
                        Ack { durable_sequence: stored.rows.len() as u64, refused, position: 0 }
                    };
                    if matches!(act, Act::ServeUntil(rows) if ack.durable_sequence > rows) {
                        return Ok(());
                    }
                    let durable_sequence = ack.durable_sequence;
                    let _ = send_reply(observe_response::Message::Ack(ack)).await;
                    if matches!(act, Act::ServeAndDisplace) {
                        let details = ErrorDetails::with_error_info("IDLE", "tidemap", HashMap::new());
                        return Err(Status::with_error_details(Code::Unavailable, "idle", details));
                    }
                    if matches!(act, Act::ServeAndStop) {
                        let (reason, detail) = (GoodbyeReason::Shutdown.into(), String::new());
                        let goodbye = Goodbye { reason, durable_sequence, detail };
                        let _ = send_reply(observe_response::Message::Goodbye(goodbye)).await;
                        return Err(Status::unavailable("stopping"));
                    }
                }
            }
        }
        Ok(())
    }
}

#[tonic::async_trait]
impl ObservationService for Fake {
    type ObserveStream = Pin<Box<dyn Stream<Item = Result<ObserveResponse, Status>> + Send>>;

    async fn classify_activity(
        &self,
        _: Request<ClassifyActivityRequest>,
    ) -> Result<Response<ClassifyActivityResponse>, Status> {
        Err(Status::unimplemented("nobody asks it"))
    }

    async fn report(&self, _: Request<ReportRequest>) -> Result<Response<ReportResponse>, Status> {
        Err(Status::unimplemented("a robot uses streams"))
    }

    async fn observe(
        &self,
        request: Request<Streaming<ObserveRequest>>,
    ) -> Result<Response<Self::ObserveStream>, Status> {
        let act = self.stored().acts.pop_front().unwrap_or(Act::Serve);
        let (sender, receiver) = mpsc::channel(8);
        let fake = self.clone();
        tokio::spawn(async move {
            if let Err(status) = fake.serve(act, request.into_inner(), &sender).await {
                let _ = sender.send(Err(status)).await;
            }
        });
        Ok(Response::new(Box::pin(ReceiverStream::new(receiver).map(|reply| reply))))
    }
}

async fn producer(acts: &[Act]) -> Result<(Fake, Producer), Box<dyn std::error::Error>> {
    producer_with(acts, |options| options).await
}

async fn producer_with(
    acts: &[Act],
    change: impl FnOnce(ProducerOptions) -> ProducerOptions,
) -> Result<(Fake, Producer), Box<dyn std::error::Error>> {
    let fake = Fake::default();
    fake.stored().acts = acts.iter().cloned().collect();
    let listener = TcpListener::bind("127.0.0.1:0").await?;
    let address = listener.local_addr()?;
    let service = ObservationServiceServer::new(fake.clone());
    tokio::spawn(Server::builder().add_service(service).serve_with_incoming(TcpListenerStream::new(listener)));
    let client = Client::new(&address.to_string())?;
    let (patience, key_patience) = (Duration::from_secs(30), Duration::ZERO);
    let options = ProducerOptions { patience, key_patience, ..ProducerOptions::new("robot", "", "office") };
    Ok((fake, Producer::start(&client, change(options))))
}

type Tested = Result<(), Box<dyn std::error::Error>>;

async fn send(producer: &mut Producer, values: &[f64]) -> Result<(), ProducerError> {
    for &value in values {
        let time = i64::try_from(producer.last_sequence()).unwrap_or(0);
        producer.send(if value < 0.5 { "a" } else { "b" }, time, value).await?;
    }
    producer.flush().await.map(|_| ())
}

#[tokio::test]
async fn whatever_breaks_each_observation_arrives_once() -> Tested {
    let acts = [
        Act::Refuse(Code::Unavailable),
        Act::StoreAndBreak,
        Act::Break,
        Act::End(GoodbyeReason::Shutdown),
        Act::Refuse(Code::Internal),
        Act::StoreAndBreak,
        Act::Serve,
    ];
    let (fake, mut producer) = producer(&acts).await?;
    let values: Vec<f64> = (0..20).map(|i| f64::from(i % 4) / 3.0).collect();
    send(&mut producer, &values).await?;
    let stored = fake.stored().clone();
    assert_eq!(stored.rows.iter().map(|(_, value)| *value).collect::<Vec<_>>(), values);
    assert!(stored.rows.iter().all(|(state, value)| state == if *value < 0.5 { "a" } else { "b" }));
    assert_eq!(stored.incarnations, [0, 0, 7, 7, 7, 7, 7], "a reconnection presents its incarnation");
    assert!(producer.progress().unreported > 0);
    producer.close().await?;
    assert_eq!(producer.send("a", 0, 1.0).await, Err(ProducerError::Closed));
    Ok(())
}

#[tokio::test]
async fn refusals_come_back_with_their_numbers() -> Tested {
    let (_fake, mut producer) = producer(&[]).await?;
    send(&mut producer, &[0.0, 2.0, 1.0, 3.0]).await?;
    let refused: Vec<_> = producer.take_refusals().into_iter().map(|r| (r.sequence, r.reason, r.detail)).collect();
    assert_eq!(
        refused,
        [(2, Some(RefusalReason::Value), "value 2".to_owned()), (4, Some(RefusalReason::Value), "value 3".to_owned())]
    );
    assert!(producer.take_refusals().is_empty());
    Ok(())
}

#[tokio::test]
async fn ends_that_no_new_attempt_can_mend_are_final() -> Tested {
    let so = || "so".to_owned();
    for (act, error) in [
        (Act::End(GoodbyeReason::DiskFull), ProducerError::Exhausted(so())),
        (Act::End(GoodbyeReason::Superseded), ProducerError::Superseded(so())),
        (Act::End(GoodbyeReason::DataMismatch), ProducerError::DataMismatch(so())),
        (Act::End(GoodbyeReason::OutOfSequence), ProducerError::OutOfSequence(so())),
        (Act::End(GoodbyeReason::Invalid), ProducerError::Invalid(so())),
        (Act::End(GoodbyeReason::MapDeleted), ProducerError::MapDeleted(so())),
        (Act::End(GoodbyeReason::Storage), ProducerError::Storage(so())),
        (Act::Refuse(Code::AlreadyExists), ProducerError::KeyInUse("no".to_owned())),
        (Act::Refuse(Code::NotFound), ProducerError::MapNotFound("no".to_owned())),
        (Act::Refuse(Code::Aborted), ProducerError::Superseded("no".to_owned())),
        (Act::Refuse(Code::InvalidArgument), ProducerError::Invalid("no".to_owned())),
    ] {
        let (fake, mut producer) = producer(std::slice::from_ref(&act)).await?;
        assert_eq!(send(&mut producer, &[1.0]).await, Err(error.clone()), "{act:?}");
        assert_eq!(producer.send("a", 0, 1.0).await, Err(error), "{act:?}");
        assert_eq!(fake.stored().incarnations.len(), 1, "{act:?}");
    }
    Ok(())
}

#[tokio::test]
async fn a_key_held_by_an_own_lost_hello_is_tried_again() -> Tested {
    let (_fake, mut producer) = producer(&[Act::Refuse(Code::Unavailable), Act::Refuse(Code::AlreadyExists)]).await?;
    assert_eq!(send(&mut producer, &[1.0]).await, Ok(()));
    Ok(())
}

#[tokio::test]
async fn a_key_that_an_ended_stream_still_holds_is_waited_for() -> Tested {
    let held = [Act::Refuse(Code::AlreadyExists), Act::Refuse(Code::AlreadyExists)];
    let patient = |key_patience| move |options| ProducerOptions { key_patience, ..options };
    let (fake, mut producer) = producer_with(&held, patient(Duration::from_secs(30))).await?;
    assert_eq!(send(&mut producer, &[1.0]).await, Ok(()));
    assert_eq!(fake.stored().incarnations.len(), 3);

    let held = vec![Act::Refuse(Code::AlreadyExists); 100];
    let (fake, mut producer) = producer_with(&held, patient(Duration::from_millis(300))).await?;
    assert_eq!(send(&mut producer, &[1.0]).await, Err(ProducerError::KeyInUse("no".to_owned())));
    let attempts = fake.stored().incarnations.len();
    assert!((2..=3).contains(&attempts), "{attempts}");
    Ok(())
}

#[tokio::test]
async fn a_producer_that_is_asked_answers_that_it_is_there() -> Tested {
    let (_fake, mut producer) = producer(&[Act::Probe]).await?;
    assert_eq!(send(&mut producer, &[1.0]).await, Ok(()));
    Ok(())
}

#[tokio::test]
async fn a_producer_that_made_room_comes_back_when_it_has_more() -> Tested {
    let (fake, mut producer) = producer(&[Act::ServeAndDisplace, Act::ServeAndDisplace]).await?;
    for sent in 1..=3 {
        send(&mut producer, &[1.0]).await?;
        tokio::time::sleep(Duration::from_millis(300)).await;
        assert_eq!(fake.stored().incarnations.len(), sent, "it does not come back before");
    }
    producer.close().await?;
    assert_eq!(fake.stored().rows.len(), 3);
    // A producer that has nothing more to send ends without coming back.
    let (fake, mut producer) = self::producer(&[Act::ServeAndDisplace]).await?;
    send(&mut producer, &[1.0]).await?;
    producer.close().await?;
    assert!(fake.stored().incarnations.len() <= 2);
    Ok(())
}

#[tokio::test]
async fn a_restored_daemon_gets_what_it_lacks_or_is_noticed() -> Tested {
    let (fake, mut mended) = producer(&[Act::ServeUntil(3), Act::Restored(3)]).await?;
    send(&mut mended, &[0.0, 1.0, 0.0]).await?;
    let store_id = mended.progress().store_id;
    // This observation becomes durable without an acknowledgement, and is lost with the data folder.
    send(&mut mended, &[1.0]).await?;
    assert_ne!(mended.progress().store_id, store_id);
    assert_eq!(mended.progress().store_changes, 1);
    assert_eq!(fake.stored().rows.len(), 4);

    let (_fake, mut lost) = producer(&[Act::ServeUntil(3), Act::Restored(2)]).await?;
    send(&mut lost, &[0.0, 1.0, 0.0]).await?;
    assert_eq!(send(&mut lost, &[1.0]).await, Err(ProducerError::Lost { durable: 2, acknowledged: 3 }));
    Ok(())
}

#[tokio::test]
async fn a_daemon_that_has_everything_and_is_gone_does_not_hold_up_the_end() -> Tested {
    let mut acts = vec![Act::Refuse(Code::Unavailable); 30];
    acts[0] = Act::ServeAndStop;
    let (fake, mut producer) = producer(&acts).await?;
    send(&mut producer, &[1.0]).await?;
    while fake.stored().incarnations.len() < 5 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    producer.close().await?;
    // An attempt may have been in progress; a producer that waits for the daemon would make all attempts.
    assert!(fake.stored().incarnations.len() <= 7, "{}", fake.stored().incarnations.len());
    Ok(())
}

#[tokio::test]
async fn a_producer_that_announced_data_time_announces_its_end() -> Tested {
    let acts = [Act::ServeAndStop, Act::Refuse(Code::Unavailable), Act::Refuse(Code::Unavailable), Act::Serve];
    let (fake, mut producer) = producer_with(&acts, |options| ProducerOptions { nightly: true, ..options }).await?;
    send(&mut producer, &[1.0]).await?;
    producer.close().await?;
    assert_eq!(fake.stored().incarnations.len(), 4);
    Ok(())
}
