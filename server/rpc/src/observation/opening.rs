//! How a stream begins and ends: the hello, the session at the map's writer, and the goodbye.
//!
//! Invariant: a session that was opened is ended at the writer, whatever its client does.

use std::{convert::Infallible, sync::Arc, time::Duration};

use tidemap_base::shares::client::Client;
use tidemap_ingest::{
    handle::MapHandle,
    probe::{Probe, probe},
    protocol::{Command, Hello, HelloError, SessionEvent, Welcome},
};
use tidemap_proto::{
    convert::observe::{StreamStart, hello_from_wire, hello_of},
    v1::{self, observe_response::Message as Down},
};
use tokio::sync::{mpsc, oneshot};
use tokio_stream::StreamExt as _;

use super::{
    Observations,
    acknowledgements::Acknowledgements,
    channel::{Replies, Requests, reply, unread},
    open_streams::StreamEntry,
    session::OpenSession,
    stream::Stream,
};
use crate::{
    lookup::{check_producer, find_map},
    status::RpcError,
};

/// Maximum time for a stream to send its hello.
pub(crate) const HELLO_WITHIN: Duration = Duration::from_secs(10);

/// Serves a stream from its first message to its end.
///
/// # Errors
/// The reason why it ended, unless the client ended it.
pub(super) async fn open_and_serve(
    service: &Observations,
    entry: &mut StreamEntry,
    requests: &mut impl Requests,
    replies: &Replies,
) -> Result<(), RpcError> {
    if *service.stopping.borrow() {
        return Err(RpcError::Stopping);
    }
    let Some(hello) = first_hello(service, entry, requests).await? else { return Ok(()) };
    // The check whether the caller may see the map comes first.
    find_map(&service.catalog, &hello.map).await?;
    let start = hello_from_wire(&hello)?;
    let handle = take_seat(service, entry, &hello.map, &start).await?;
    let (probe, probed, questions) = probe();
    let opened = open_session(&handle, (&start, entry.client()), start.answers_probes.then_some(probe)).await?;
    entry.mark_active();
    let session = OpenSession::new(service, handle, opened, start.reporting, Acknowledgements::Stream(replies), entry);
    let mut stream = Stream::new(session, replies, probed);
    let result = tokio::select! {
        result = stream.serve(requests) => result,
        never = pass_on_questions(questions, replies) => match never {},
    };
    stream.end(&result).await;
    result
}

/// Finds the map of a sender, checks that the caller may send as this producer, and takes a place for the session.
///
/// # Errors
/// The map does not exist, the caller may not send to it, or there is no place.
pub(super) async fn take_seat(
    service: &Observations,
    entry: &mut StreamEntry,
    map: &str,
    start: &StreamStart,
) -> Result<Arc<MapHandle>, RpcError> {
    if *service.stopping.borrow() {
        return Err(RpcError::Stopping);
    }
    let handle = find_map(&service.catalog, map).await?;
    check_producer(start.key.producer())?;
    entry.seat(handle.id)?;
    Ok(handle)
}

/// The hello of a stream; `None`: the client leaves before it.
async fn first_hello(
    service: &Observations,
    entry: &mut StreamEntry,
    requests: &mut impl Requests,
) -> Result<Option<v1::Hello>, RpcError> {
    let first = tokio::select! {
        first = tokio::time::timeout(HELLO_WITHIN, requests.next()) => first,
        ended = entry.displaced() => return Err(ended),
    };
    entry.mark_active();
    match first {
        Ok(Some(Ok(request))) => Ok(Some(hello_of(request)?)),
        Ok(Some(Err(status))) => Err(unread(&status, &service.limits)),
        Ok(None) => Ok(None),
        Err(_) => Err(RpcError::NoHello),
    }
}

/// Opens a session at the writer of its map. The session takes over from a stream of the same key whose client does not
/// answer.
///
/// # Errors
/// The writer refuses the session.
pub(super) async fn open_session(
    handle: &Arc<MapHandle>,
    (start, client): (&StreamStart, &Client),
    probe: Option<Probe>,
) -> Result<(Welcome, mpsc::UnboundedReceiver<SessionEvent>), RpcError> {
    let mut takes_over = None;
    loop {
        let (events_sender, events) = mpsc::unbounded_channel();
        let (answer, answered) = oneshot::channel();
        let hello = Hello {
            key: start.key.clone(),
            incarnation: start.incarnation,
            client: client.share_name(),
            probe: probe.clone(),
            takes_over,
            nightly: start.is_nightly,
            sensor: start.sensor,
            events: events_sender,
            reply: answer,
        };
        if !handle.send(Command::Hello(hello)) {
            return Err(RpcError::Stopping);
        }
        match answered.await.map_err(|_| RpcError::Stopping)? {
            Ok(opened) => return Ok((opened, events)),
            Err(HelloError::AlreadyStreaming { open: Some((session, probe)), .. })
                if takes_over != Some(session) && !probe.is_alive().await =>
            {
                takes_over = Some(session);
            }
            Err(error) => return Err(error.into()),
        }
    }
}

/// Sends a Probe whenever another stream wants this key. A client that does not read its replies does not answer
/// either.
async fn pass_on_questions(mut questions: mpsc::Receiver<()>, replies: &Replies) -> Infallible {
    while questions.recv().await.is_some() {
        // The replies of the stream itself fail as well, and end it.
        let _ = reply(replies, Down::Probe(v1::Probe {})).await;
    }
    std::future::pending().await
}
