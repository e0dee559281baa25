//! A stream of observations without the client library, to send what a correct producer does not send.
//!
//! Invariant: nothing is added, repeated or left out: the messages are those of the test, and replies are returned
//! unchanged.

use std::time::Duration;

use tidemap_proto::v1::{
    Ack, Goodbye, Hello, ObservationBatch, ObservationColumns, ObserveRequest, ObserveResponse, Refusal, Welcome,
    observation_service_client::ObservationServiceClient, observe_request, observe_response::Message,
};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Status, Streaming};

use crate::feed::{Observation, state_name};

/// Timeout of an answer.
const ANSWER_WITHIN: Duration = Duration::from_secs(60);

/// How a stream ended.
#[derive(Debug)]
pub struct Ended {
    /// The Goodbye before the status, if there was one.
    pub goodbye: Option<Goodbye>,
    /// The status; `None` if the daemon ended the stream in order.
    pub status: Option<Status>,
}

impl Ended {
    /// The status.
    ///
    /// # Panics
    /// If the stream ended in order.
    #[must_use]
    pub fn error(self) -> Status {
        self.status.expect("the stream should have ended with an error")
    }
}

/// A stream.
#[derive(Debug)]
pub struct RawStream {
    requests: Option<mpsc::Sender<ObserveRequest>>,
    replies: Streaming<ObserveResponse>,
    names_sent: u32,
}

impl RawStream {
    /// Connects and opens a stream without sending anything.
    ///
    /// # Errors
    /// The status, or the connection error.
    pub async fn silent(address: &str) -> Result<Self, Status> {
        let connected = ObservationServiceClient::connect(format!("http://{address}")).await;
        let mut client = connected.map_err(|error| Status::from_error(Box::new(error)))?;
        let (requests, outgoing) = mpsc::channel(64);
        let replies = client.observe(ReceiverStream::new(outgoing)).await?.into_inner();
        Ok(Self { requests: Some(requests), replies, names_sent: 0 })
    }

    /// Opens a stream over the connection of a client, which may have a token, and sends a Hello.
    ///
    /// # Errors
    /// The status with which the stream ended instead.
    ///
    /// # Panics
    /// If the answer is not a Welcome.
    pub async fn open_as(client: &tidemap_client::Client, hello: Hello) -> Result<Self, Status> {
        let (requests, outgoing) = mpsc::channel(64);
        let mut service = ObservationServiceClient::new(client.requests());
        let replies = service.observe(ReceiverStream::new(outgoing)).await?.into_inner();
        let mut stream = Self { requests: Some(requests), replies, names_sent: 0 };
        stream.send_message(observe_request::Message::Hello(hello)).await;
        match stream.reply().await {
            Ok(Message::Welcome(_)) => Ok(stream),
            Ok(other) => panic!("a Welcome should come first, not {other:?}"),
            Err(ended) => Err(ended.error()),
        }
    }

    /// Opens a stream and sends a Hello.
    ///
    /// # Errors
    /// How the stream ended instead, or the connection error.
    ///
    /// # Panics
    /// If the answer is not a Welcome.
    pub async fn open(address: &str, hello: Hello) -> Result<(Self, Welcome), Ended> {
        let in_status = |status| Ended { goodbye: None, status: Some(status) };
        let mut stream = Self::silent(address).await.map_err(in_status)?;
        stream.send_message(observe_request::Message::Hello(hello)).await;
        match stream.reply().await? {
            Message::Welcome(welcome) => Ok((stream, welcome)),
            other => panic!("a Welcome should come first, not {other:?}"),
        }
    }

    /// Sends a message; the reason why a stream has ended is returned by reading it.
    pub async fn send_message(&mut self, message: observe_request::Message) {
        self.send(ObserveRequest { message: Some(message) }).await;
    }

    /// Sends a request as it is.
    pub async fn send(&mut self, request: ObserveRequest) {
        if let Some(requests) = &self.requests {
            let _ = requests.send(request).await;
        }
    }

    /// Number of names that batches have put into the stream's table so far.
    #[must_use]
    pub fn names_sent(&self) -> u32 {
        self.names_sent
    }

    /// Sends a batch.
    ///
    /// # Panics
    /// If it has more names than can be counted.
    pub async fn batch(&mut self, first_sequence: u64, observations: ObservationColumns) {
        self.names_sent += u32::try_from(observations.new_states.len()).expect("a few names");
        let batch = ObservationBatch { first_sequence, observations: Some(observations) };
        self.send_message(observe_request::Message::Batch(batch)).await;
    }

    /// Closes the sending side.
    pub fn close(&mut self) {
        self.requests = None;
    }

    /// The next reply.
    ///
    /// # Errors
    /// How the stream ended.
    ///
    /// # Panics
    /// If neither arrives.
    pub async fn reply(&mut self) -> Result<Message, Ended> {
        match self.next().await {
            Ok(Some(Message::Goodbye(goodbye))) => {
                let status = self.next().await.err();
                Err(Ended { goodbye: Some(goodbye), status })
            }
            Ok(Some(message)) => Ok(message),
            Ok(None) => Err(Ended { goodbye: None, status: None }),
            Err(status) => Err(Ended { goodbye: None, status: Some(status) }),
        }
    }

    async fn next(&mut self) -> Result<Option<Message>, Status> {
        let reply = tokio::time::timeout(ANSWER_WITHIN, self.replies.message()).await.expect("the daemon responds");
        Ok(reply?.and_then(|reply| reply.message))
    }

    /// Reads until everything up to `sequence` is acknowledged; returns the refusals.
    ///
    /// # Errors
    /// How the stream ended.
    ///
    /// # Panics
    /// If anything but an acknowledgement arrives.
    pub async fn acknowledged(&mut self, sequence: u64) -> Result<Vec<Refusal>, Ended> {
        let mut all = Vec::new();
        loop {
            match self.reply().await? {
                Message::Ack(Ack { durable_sequence, refused, .. }) => {
                    all.extend(refused);
                    if durable_sequence >= sequence {
                        return Ok(all);
                    }
                }
                Message::Busy(_) => {}
                other => panic!("an Ack should come, not {other:?}"),
            }
        }
    }

    /// Reads to the end.
    ///
    /// # Panics
    /// If it does not end.
    pub async fn end(&mut self) -> Ended {
        loop {
            if let Err(ended) = self.reply().await {
                return ended;
            }
        }
    }
}

/// A Hello that requests a new incarnation.
#[must_use]
pub fn hello(producer: &str, map: &str) -> Hello {
    Hello {
        producer: producer.to_owned(),
        label: String::new(),
        map: map.to_owned(),
        incarnation: 0,
        nightly: false,
        sensor: None,
        reporting: None,
        answers_probes: false,
    }
}

/// Observations as columns in their simplest form. `names` are added to the stream's table before.
#[must_use]
pub fn columns(names: &[&str], rows: &[(u32, i64, f64)]) -> ObservationColumns {
    let first_time_nanos = rows.first().map_or(0, |row| row.1);
    let mut before = first_time_nanos;
    let mut delta = |time: i64| time.wrapping_sub(std::mem::replace(&mut before, time));
    ObservationColumns {
        time_unit_nanos: 1,
        first_time_nanos,
        time_deltas: rows.iter().map(|row| delta(row.1)).collect(),
        state_indices: rows.iter().map(|row| row.0).collect(),
        new_states: names.iter().map(|&name| name.to_owned()).collect(),
        bits: Vec::new().into(),
        new_kinds: Vec::new(),
        new_dimensions: Vec::new(),
        coordinates: Vec::new(),
        shares: Vec::new(),
        values: rows.iter().map(|row| row.2).collect(),
    }
}

/// Observations of a feed as columns; `first` names all states of the feed, for the first batch of a stream.
#[must_use]
pub fn feed_columns(observations: &[Observation], states: u32, first: bool) -> ObservationColumns {
    let names: Vec<String> = if first { (0..states).map(state_name).collect() } else { Vec::new() };
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let rows: Vec<_> = observations.iter().map(|o| (o.state, o.time_nanos, o.value)).collect();
    columns(&names, &rows)
}
