//! Streams that send observations as fast as the daemon accepts them.
//!
//! Invariant: the messages are packed by the same code as those of any client.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use anyhow::{Context as _, bail};
use tidemap_client::{
    Client,
    observe::columns::{Entry, StreamTable, pack},
};
use tidemap_proto::v1::{
    Hello, ObservationBatch, ObserveRequest, ObserveResponse, observation_service_client::ObservationServiceClient,
    observe_request, observe_response,
};
use tokio::{sync::mpsc, task::JoinSet};
use tokio_stream::wrappers::ReceiverStream;
use tonic::Streaming;

/// Maximum number of unacknowledged observations of a stream, as in a producer's window.
const IN_FLIGHT_MAX: u64 = 65_536;

/// The observations to send.
#[derive(Clone, Debug)]
pub(super) struct Load {
    pub(super) map: String,
    pub(super) streams: u64,
    pub(super) states: u64,
    pub(super) name_chars: usize,
    /// Over all streams.
    pub(super) observations: u64,
    pub(super) batch: u64,
    /// Generates the observation of a number below `observations`.
    pub(super) observation: fn(&Load, u64) -> Entry,
}

/// The result of sending a load.
#[derive(Clone, Copy, Debug)]
pub(super) struct FeedRate {
    /// From the first batch to the last acknowledgement.
    pub(super) elapsed: Duration,
    pub(super) refused: u64,
}

impl Load {
    /// Sends all observations and waits until they are durable.
    pub(super) async fn send(&self, client: &Client) -> anyhow::Result<FeedRate> {
        let names: Arc<[Box<str>]> = (0..self.states).map(|state| self.name(state).into()).collect();
        let mut opening = JoinSet::new();
        for stream in 0..self.streams {
            let (load, client, names) = (self.clone(), client.clone(), Arc::clone(&names));
            opening.spawn(async move { Stream::open(load, &client, stream, names).await });
        }
        let mut streams = Vec::new();
        while let Some(stream) = opening.join_next().await {
            streams.push(stream??);
        }
        let began = Instant::now();
        let mut running: JoinSet<_> = streams.into_iter().map(Stream::run).collect();
        let mut refused = 0;
        while let Some(stream) = running.join_next().await {
            refused += stream??;
        }
        Ok(FeedRate { elapsed: began.elapsed(), refused })
    }

    pub(super) fn name(&self, state: u64) -> String {
        format!("s{state:0>width$}", width = self.name_chars.saturating_sub(1))
    }
}

struct Stream {
    load: Load,
    names: Arc<[Box<str>]>,
    /// Number of the first observation of this stream; the next ones are `streams` apart.
    index: u64,
    requests: mpsc::Sender<ObserveRequest>,
    replies: Streaming<ObserveResponse>,
    /// Reserves the stream's place on the connection.
    _place: tidemap_client::connection::StreamPlace,
}

impl Stream {
    async fn open(load: Load, client: &Client, index: u64, names: Arc<[Box<str>]>) -> anyhow::Result<Self> {
        let place = client.stream_place();
        let (requests, outgoing) = mpsc::channel(2);
        let hello = Hello { producer: format!("bench-{index}"), map: load.map.clone(), ..Hello::default() };
        requests.send(ObserveRequest { message: Some(observe_request::Message::Hello(hello)) }).await?;
        let mut service = ObservationServiceClient::new(place.connection());
        let mut replies = service.observe(ReceiverStream::new(outgoing)).await?.into_inner();
        let welcome = replies.message().await?.and_then(|reply| reply.message);
        let Some(observe_response::Message::Welcome(welcome)) = welcome else { bail!("no Welcome") };
        anyhow::ensure!(
            load.batch <= u64::from(welcome.max_batch_observations),
            "--batch is {}, the daemon takes at most {}",
            load.batch,
            welcome.max_batch_observations
        );
        Ok(Self { load, names, index, requests, replies, _place: place })
    }

    /// Sends the observations of this stream; returns the number of refusals.
    async fn run(mut self) -> anyhow::Result<u64> {
        let Load { streams, observations, batch, .. } = self.load;
        let share = observations / streams + u64::from(self.index < observations % streams);
        let (mut sent, mut durable, mut refused) = (0, 0, 0);
        let mut table = StreamTable::default();
        while durable < share {
            let room = sent < share && sent - durable < IN_FLIGHT_MAX;
            tokio::select! {
                Ok(permit) = self.requests.reserve(), if room => {
                    let count = batch.min(share - sent);
                    let entries: Vec<Entry> = (sent..sent + count)
                        .map(|number| (self.load.observation)(&self.load, number * streams + self.index))
                        .collect();
                    let observations = Some(pack(&entries, &self.names, &mut table));
                    let message = ObservationBatch { first_sequence: sent + 1, observations };
                    permit.send(ObserveRequest { message: Some(observe_request::Message::Batch(message)) });
                    sent += count;
                }
                reply = self.replies.message() => match reply?.and_then(|reply| reply.message) {
                    Some(observe_response::Message::Ack(ack)) => {
                        durable = ack.durable_sequence;
                        refused += ack.refused.len() as u64;
                    }
                    Some(observe_response::Message::Goodbye(goodbye)) => {
                        bail!("the daemon ended a stream: {:?} {}", goodbye.reason(), goodbye.detail);
                    }
                    Some(_) => {}
                    None => return Err(anyhow::anyhow!("the daemon ended a stream")).context("bench"),
                },
            }
        }
        Ok(refused)
    }
}

/// Pseudo-random bits that depend on the number only (the finaliser of splitmix64).
pub(super) fn scrambled(number: u64) -> u64 {
    let mut bits = number.wrapping_add(0x9e37_79b9_7f4a_7c15);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^ (bits >> 31)
}
