//! Any RPC by its name, with requests and replies as JSON.
//!
//! Invariant: messages are read and written by their descriptors alone, so that every RPC that does not stream requests
//! is here as it is on the wire. 64-bit integers are JSON numbers, which Python reads exactly.

use std::sync::{Arc, OnceLock};

use prost::{Message as _, bytes::Bytes};
use prost_reflect::{
    DescriptorPool, DeserializeOptions, DynamicMessage, MessageDescriptor, MethodDescriptor, SerializeOptions,
};
use pyo3::prelude::*;
use tidemap_client::{Client, queries::ModelSelector};
use tidemap_proto::bytes_codec::BytesCodec;
use tokio::sync::{Mutex, watch};
use tonic::{Code, Status, Streaming, client::Grpc, codegen::http::uri::PathAndQuery};

use crate::{
    failure,
    room::{Room, Turn},
    waiting::{Maker, wait},
};

/// Maximum size of one reply, as of the client library.
const REPLY_BYTES: usize = 64 << 20;

fn pool() -> Option<&'static DescriptorPool> {
    static POOL: OnceLock<Option<DescriptorPool>> = OnceLock::new();
    POOL.get_or_init(|| DescriptorPool::decode(tidemap_proto::v1::DESCRIPTORS).ok()).as_ref()
}

/// The method `SERVICE/METHOD`, of the package `tidemap.v1`.
pub(crate) fn method(name: &str) -> Option<MethodDescriptor> {
    let (service, method) = name.split_once('/')?;
    let service = pool()?.get_service_by_name(&format!("tidemap.v1.{service}"))?;
    let found = service.methods().find(|known| known.name() == method);
    found.filter(|method| !method.is_client_streaming())
}

/// A request from JSON, as bytes of the wire.
pub(crate) fn request(method: &MethodDescriptor, json: &str) -> Result<Bytes, serde_json::Error> {
    let mut json = serde_json::Deserializer::from_str(json);
    let options = DeserializeOptions::new().deny_unknown_fields(true);
    let message = DynamicMessage::deserialize_with_options(method.input(), &mut json, &options)?;
    json.end()?;
    Ok(message.encode_to_vec().into())
}

fn text(message: &DynamicMessage) -> Result<String, Status> {
    let mut text = Vec::new();
    let options =
        SerializeOptions::new().skip_default_fields(false).use_proto_field_name(true).stringify_64_bit_integers(false);
    let mut json = serde_json::Serializer::new(&mut text);
    message.serialize_with_options(&mut json, &options).map_err(|error| Status::internal(error.to_string()))?;
    String::from_utf8(text).map_err(|error| Status::internal(error.to_string()))
}

/// A model, named as on the command line.
pub(crate) fn model_named(py: Python<'_>, name: &str) -> PyResult<ModelSelector> {
    name.parse().map_err(|error| failure::invalid(py, &format!("model {name:?}: {error}")))
}

/// A model, named as on the command line, as the JSON of a ModelSelector.
#[pyfunction]
pub(crate) fn model_request(py: Python<'_>, name: &str) -> PyResult<String> {
    let selector = tidemap_proto::convert::query::selector_to_wire(model_named(py, name)?);
    let descriptor = pool().and_then(|pool| pool.get_message_by_name("tidemap.v1.ModelSelector"));
    let message = descriptor.and_then(|known| DynamicMessage::decode(known, selector.encode_to_vec().as_slice()).ok());
    let json = message.and_then(|message| serde_json::to_string(&message).ok());
    json.ok_or_else(|| failure::exception(py, "INTERNAL", "the descriptors of the wire cannot be read"))
}

/// Calls a method when it is its turn. A stream of replies gives its turn to others as soon as it has begun: it may
/// last for long.
pub(crate) async fn call(
    (client, room): (Client, Room),
    method: MethodDescriptor,
    request: Bytes,
) -> Result<(Streaming<Bytes>, Option<Turn>), Status> {
    let is_stream = method.is_server_streaming();
    let (replies, turn) = room.ask(|| called(client.clone(), method.clone(), request.clone())).await?;
    Ok((replies, Some(turn).filter(|_| !is_stream)))
}

async fn called(client: Client, method: MethodDescriptor, request: Bytes) -> Result<Streaming<Bytes>, Status> {
    let path = format!("/{}/{}", method.parent_service().full_name(), method.name());
    let path = PathAndQuery::try_from(path).map_err(|error| Status::internal(error.to_string()))?;
    let mut grpc = Grpc::new(client.requests()).max_decoding_message_size(REPLY_BYTES);
    grpc.ready().await.map_err(|error| Status::unavailable(error.to_string()))?;
    Ok(grpc.server_streaming(tonic::Request::new(request), path, BytesCodec).await?.into_inner())
}

/// The exception of a status.
pub(crate) fn raised(py: Python<'_>, server: &str, status: &Status) -> PyErr {
    let mut message = status.message().to_owned();
    if status.code() == Code::Unavailable && std::error::Error::source(status).is_some() {
        message = format!("no daemon responds at {server}: {message}");
    }
    failure::exception(py, &failure::code_name(status.code()), &message)
}

/// Replies of a method, one by one, each as JSON.
#[pyclass(frozen)]
pub(crate) struct Replies {
    server: String,
    kind: MessageDescriptor,
    /// With the turn of the request.
    replies: Arc<Mutex<(Streaming<Bytes>, Option<Turn>)>>,
    maker: Maker,
    /// Set where no further reply is wanted.
    ended: Arc<watch::Sender<bool>>,
}

impl Replies {
    /// Replies of a server, of the type `kind`.
    pub(crate) fn new(
        server: String,
        kind: MessageDescriptor,
        replies: (Streaming<Bytes>, Option<Turn>),
    ) -> Self {
        let (replies, ended) = (Arc::new(Mutex::new(replies)), Arc::new(watch::Sender::new(false)));
        Self { server, kind, replies, maker: Maker::here(), ended }
    }
}

impl Drop for Replies {
    fn drop(&mut self) {
        // In a child of a fork they are the parent's, whose threads are not there.
        if self.maker != Maker::here() {
            std::mem::forget(Arc::clone(&self.replies));
        }
    }
}

#[pymethods]
impl Replies {
    fn __iter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    fn __next__(&self, py: Python<'_>) -> PyResult<Option<String>> {
        self.maker.check(py, "stream of replies")?;
        let (replies, kind, mut ended) = (Arc::clone(&self.replies), self.kind.clone(), self.ended.subscribe());
        let next = async move {
            let mut held = replies.lock().await;
            let (replies, turn) = &mut *held;
            let message = tokio::select! {
                _ = ended.wait_for(|ended| *ended) => Ok(None),
                message = replies.message() => message,
            };
            let Ok(Some(bytes)) = message else {
                *turn = None;
                return message.map(|_| None);
            };
            let message = DynamicMessage::decode(kind, bytes).map_err(|error| Status::internal(error.to_string()))?;
            text(&message).map(Some)
        };
        wait(py, next, |_| Ok(()))?.map_err(|status| raised(py, &self.server, &status))
    }

    /// Ends the stream: no further reply is wanted. A thread that waits for a reply gets the end of the stream.
    fn cancel(&self) {
        self.ended.send_replace(true);
    }
}
