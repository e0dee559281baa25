//! `PeerService`: this daemon sends its maps to other daemons of its cluster, and fetches theirs.
//!
//! Invariant: only a daemon that has the secret of the cluster gets an answer, and the secret goes over a network with
//! TLS only, unless an operator has allowed that. Only a part of a copy is in memory at a time, whatever its size.

use std::{
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use axum::http::header::AUTHORIZATION;
use tidemap_base::access::peer_secret::PeerSecret;
use tidemap_cluster::replica::ReplicaRole;
use tidemap_ingest::{
    catalog::Catalog,
    cluster::{Cluster, operations::OperationError},
    peers::SharedMaps,
};
use tidemap_proto::{
    convert::copies::{CopyMessage, FilePart, end_to_wire, message_from_wire, part_to_wire},
    v1::{self, peer_service_client::PeerServiceClient, peer_service_server::PeerService},
};
use tidemap_store::{COPY_PART_BYTES, CopyError, CopyPart, CopyTotal, MapCopy, MapId};
use tokio::{
    runtime::Handle,
    sync::{OwnedSemaphorePermit, Semaphore, mpsc},
};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, metadata::MetadataMap};

use super::{
    RpcReply,
    gateway::links::{Links, NoLink, PeerPlace},
    status::RpcError,
};

/// Maximum number of copies that are sent at once.
const COPIES_MAX: usize = 2;
/// Number of parts that are read before the other daemon takes them.
const PARTS_AHEAD: usize = 2;
/// Maximum time until the other daemon takes a part, or sends one.
const PART_WITHIN: Duration = Duration::from_secs(60);

/// The service.
#[derive(Debug)]
pub(crate) struct PeerCalls {
    catalog: Arc<Catalog>,
    copies: Arc<Semaphore>,
}

impl PeerCalls {
    pub(super) fn new(catalog: Arc<Catalog>) -> Self {
        Self { catalog, copies: Arc::new(Semaphore::new(COPIES_MAX)) }
    }

    fn cluster(&self) -> Result<&Cluster, OperationError> {
        self.catalog.context().cluster.as_ref().ok_or(OperationError::NoCluster)
    }

    /// The map of this number, if its log in this daemon is a prefix of the shared log.
    fn map_to_give(&self, uid: u64) -> Result<MapId, OperationError> {
        let status = self.cluster()?.replica_status(uid);
        let maps = self.catalog.all();
        let handle = maps.values().find(|handle| handle.shared_uid == Some(uid));
        let (Some(status), Some(handle)) = (status, handle) else {
            return Err(OperationError::NotHeld(format!("{uid:016x}")));
        };
        if !matches!(status.role, ReplicaRole::Following | ReplicaRole::Writing) {
            return Err(OperationError::NotAligned(handle.spec.name.as_str().to_owned()));
        }
        Ok(handle.id)
    }
}

type PartSender = mpsc::Sender<Result<v1::FetchMapResponse, Status>>;

#[tonic::async_trait]
impl PeerService for PeerCalls {
    type FetchMapStream = ReceiverStream<Result<v1::FetchMapResponse, Status>>;

    async fn fetch_map(&self, request: Request<v1::FetchMapRequest>) -> RpcReply<Self::FetchMapStream> {
        let id = self.map_to_give(request.get_ref().uid).map_err(RpcError::from)?;
        let busy = |_| Status::resource_exhausted("this daemon sends other copies: try again later");
        let permit = Arc::clone(&self.copies).try_acquire_owned().map_err(busy)?;
        let (parts, stream) = mpsc::channel(PARTS_AHEAD);
        let catalog = Arc::clone(&self.catalog);
        drop(tidemap_base::task::blocking(move || give(&catalog, id, &parts, permit)));
        Ok(Response::new(ReceiverStream::new(stream)))
    }
}

/// Sends a map part by part, on a blocking thread.
fn give(catalog: &Catalog, id: MapId, parts: &PartSender, _permit: OwnedSemaphorePermit) {
    let send = |message| {
        let sending = parts.send_timeout(message, PART_WITHIN);
        !catalog.is_stopping.load(Ordering::Relaxed) && Handle::current().block_on(sending).is_ok()
    };
    let failed = |error: CopyError| Status::from(RpcError::from(OperationError::Copy(error)));
    let source = match catalog.context().store.copy_source(id) {
        Ok(source) => source,
        Err(error) => {
            let _ = send(Err(failed(error)));
            return;
        }
    };
    let CopyTotal { files, bytes } = source.total();
    for part in source {
        let message = part
            .map(|CopyPart { name, offset, bytes, is_last }| part_to_wire(FilePart { name, offset, bytes, is_last }));
        let is_failure = message.is_err();
        // Without its end message the copy is not complete.
        if !send(message.map_err(failed)) || is_failure {
            return;
        }
    }
    let _ = send(Ok(end_to_wire(files, bytes)));
}

/// The reason why a daemon has not sent a copy.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the variants and fields")]
pub enum FetchError {
    #[error(transparent)]
    Link(#[from] NoLink),
    #[error("{}", .0.message())]
    Refused(Box<Status>),
    #[error("it sends nothing")]
    Silent,
    #[error("the copy has no end")]
    Cut,
    #[error("{0}")]
    Invalid(&'static str),
    #[error(transparent)]
    Copy(#[from] CopyError),
    #[error("this daemon stops")]
    Stopping,
}

impl From<Status> for FetchError {
    fn from(status: Status) -> Self {
        Self::Refused(Box::new(status))
    }
}

/// Fetches maps from other daemons.
#[derive(Debug)]
pub struct CopyClient {
    links: Links,
    secret: PeerSecret,
}

impl CopyClient {
    /// A client for the members of a cluster that share maps.
    pub fn new(shared: SharedMaps, secret: PeerSecret) -> Self {
        Self { links: Links::new(shared.tls, shared.tokens_in_clear), secret }
    }

    /// Fetches a map from the daemon at an address, complete and checked.
    ///
    /// # Errors
    /// See [`FetchError`]; nothing of the copy is left then.
    pub async fn fetch(&self, address: &str, uid: u64, copy: MapCopy) -> Result<MapCopy, FetchError> {
        let place = self.links.place(address, true).await?;
        let fetched = self.fetch_over(&place, uid, copy).await;
        if fetched.is_err() {
            self.links.forget(address, &place);
        }
        fetched
    }

    async fn fetch_over(&self, place: &PeerPlace, uid: u64, copy: MapCopy) -> Result<MapCopy, FetchError> {
        let mut copy = ArrivingCopy(Some(copy));
        let mut client =
            PeerServiceClient::new(place.channel.clone()).max_decoding_message_size(COPY_PART_BYTES + (64 << 10));
        let mut request = Request::new(v1::FetchMapRequest { uid });
        let mut headers = axum::http::HeaderMap::new();
        headers.extend(self.secret.header().map(|secret| (AUTHORIZATION, secret)));
        *request.metadata_mut() = MetadataMap::from_headers(headers);
        let answer = tokio::time::timeout(PART_WITHIN, client.fetch_map(request)).await;
        let mut messages = answer.map_err(|_| FetchError::Silent)??.into_inner();
        loop {
            let message = tokio::time::timeout(PART_WITHIN, messages.message()).await;
            let message = message.map_err(|_| FetchError::Silent)??.ok_or(FetchError::Cut)?;
            match message_from_wire(message).map_err(FetchError::Invalid)? {
                CopyMessage::Part(FilePart { name, offset, bytes, is_last }) => {
                    let part = CopyPart { name, offset, bytes, is_last };
                    copy.0 = Some(with(copy.take(), move |copy| copy.take(&part)).await?);
                }
                CopyMessage::End(files, bytes) => {
                    return with(copy.take(), move |copy| copy.check(CopyTotal { files, bytes })).await;
                }
            }
        }
    }
}

/// A copy that arrives. When it is dropped, it is deleted on a blocking thread, because it may be large.
struct ArrivingCopy(Option<MapCopy>);

impl ArrivingCopy {
    fn take(&mut self) -> Option<MapCopy> {
        self.0.take()
    }
}

impl Drop for ArrivingCopy {
    fn drop(&mut self) {
        if let Some(copy) = self.0.take() {
            drop(tidemap_base::task::blocking(move || drop(copy)));
        }
    }
}

/// Does work on a copy on a blocking thread. `None`: an earlier part could not be taken.
async fn with(
    copy: Option<MapCopy>,
    work: impl FnOnce(&mut MapCopy) -> Result<(), CopyError> + Send + 'static,
) -> Result<MapCopy, FetchError> {
    let mut copy = copy.ok_or(FetchError::Cut)?;
    let done = tidemap_base::task::blocking(move || work(&mut copy).map(|()| copy)).await;
    Ok(done.map_err(|_| FetchError::Stopping)??)
}
