//! Sends a file of scans over one stream, with the batches of the file unchanged.
//!
//! Invariant: batches are not decoded; the daemon receives the same bytes as from a producer's first connection. A
//! broken connection ends the measurement.

use std::{fs::File, io::BufReader, path::Path, thread};

use anyhow::{Context as _, bail};
use prost::{
    Message as _,
    bytes::{BufMut as _, Bytes, BytesMut},
};
use tidemap_client::{Client, scan_file::ScanFile};
use tidemap_proto::{
    bytes_codec::BytesCodec,
    v1::{Hello, ObserveRequest, ObserveResponse, ScanBatch, observe_request, observe_response},
};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::codegen::http::uri::PathAndQuery;

use tidemap_terminal::progress::{Bar, status_line};

const BUFFER_BYTES: usize = 1 << 20;
const BATCHES_AHEAD: usize = 4;
/// Field `scans` of `ObserveRequest`, of type bytes.
const SCANS_TAG: u8 = 3 << 3 | 2;

#[derive(Clone, Copy, Debug)]
pub(super) struct FeedTotals {
    pub(super) scans: u64,
    pub(super) refused: u64,
    pub(super) bytes: u64,
}

fn decoded(reply: Option<Bytes>) -> anyhow::Result<Option<observe_response::Message>> {
    Ok(reply.map(ObserveResponse::decode).transpose()?.and_then(|reply| reply.message))
}

/// Sends a file and waits until it is durable and the stream has ended.
pub(super) async fn send(client: &Client, map: &str, path: &Path) -> anyhow::Result<FeedTotals> {
    let shown = path.display().to_string();
    let open = File::open(path).with_context(|| shown.clone())?;
    let total = open.metadata()?.len();
    let file = ScanFile::new(BufReader::with_capacity(BUFFER_BYTES, open)).with_context(|| shown.clone())?;

    let (requests, outgoing) = mpsc::channel(BATCHES_AHEAD);
    let hello = Hello { producer: "bench".to_owned(), map: map.to_owned(), nightly: true, ..Hello::default() };
    let hello = ObserveRequest { message: Some(observe_request::Message::Hello(hello)) };
    requests.send(hello.encode_to_vec().into()).await?;
    let place = client.stream_place();
    let mut service = tonic::client::Grpc::new(place.connection());
    service.ready().await.context("the connection")?;
    let path = PathAndQuery::from_static("/tidemap.v1.ObservationService/Observe");
    let request = tonic::Request::new(ReceiverStream::new(outgoing));
    let mut replies = service.streaming(request, path, BytesCodec).await?.into_inner();
    match decoded(replies.message().await?)? {
        Some(observe_response::Message::Welcome(_)) => {}
        _ => bail!("no Welcome"),
    }

    let bar = Bar::bytes(Some(total));
    let progress = bar.clone();
    let (ended, last) = tokio::sync::oneshot::channel();
    thread::Builder::new().name("scans".to_owned()).spawn(move || {
        let _ = ended.send(read(file, &requests, &progress, total));
    })?;
    let (mut durable, mut refused) = (0, 0);
    while let Some(reply) = replies.message().await? {
        match decoded(Some(reply))? {
            Some(observe_response::Message::Ack(ack)) => {
                durable = ack.durable_sequence;
                refused += ack.refused.len() as u64;
                if let Some(refusal) = ack.refused.first().filter(|_| refused == ack.refused.len() as u64) {
                    bar.status_line(&format!("scan {} is refused: {}", refusal.sequence, refusal.detail));
                }
            }
            Some(observe_response::Message::Goodbye(goodbye)) => {
                bail!("the daemon ended the stream: {:?} {}", goodbye.reason(), goodbye.detail);
            }
            _ => {}
        }
    }
    bar.clear();
    let scans = last.await?.with_context(|| shown)?;
    anyhow::ensure!(durable == scans, "{durable} of {scans} scans are durable");
    Ok(FeedTotals { scans, refused, bytes: total })
}

/// Reads and queues the batches; returns the number of scans.
fn read(
    mut file: ScanFile<BufReader<File>>,
    requests: &mpsc::Sender<Bytes>,
    bar: &Bar,
    total: u64,
) -> anyhow::Result<u64> {
    let (mut last, mut tenth) = (Vec::new(), 0);
    while let Some(batch) = file.next_raw()? {
        let mut message = BytesMut::with_capacity(batch.bytes.len() + 8);
        message.put_u8(SCANS_TAG);
        prost::encode_length_delimiter(batch.bytes.len(), &mut message)?;
        message.put_slice(&batch.bytes);
        if requests.blocking_send(message.freeze()).is_err() {
            bail!("the stream ended early");
        }
        last = batch.bytes;
        bar.set(file.bytes());
        if file.bytes() * 10 / total.max(1) > tenth {
            tenth = file.bytes() * 10 / total.max(1);
            status_line(&format!("{tenth}0 % sent"));
        }
    }
    let last = ScanBatch::decode(last.as_slice())?;
    Ok((last.first_sequence + last.scans.len() as u64).saturating_sub(1))
}
