//! RPCs as JSON: `POST /api/v1/SERVICE/METHOD` with the request as an object.
//!
//! Invariant: messages are read and written by their descriptors alone, so each RPC that does not stream requests is
//! here as it is on the wire. A stream of replies is one object a line (NDJSON); an error inside it is its last line.

use axum::{
    body::{Body, Bytes, to_bytes},
    extract::{Path, Request, State},
    http::{HeaderMap, StatusCode, header},
    response::Response,
};
use prost_reflect::{DeserializeOptions, DynamicMessage, MessageDescriptor, MethodDescriptor, SerializeOptions};
use serde_json::{Value, json};
use tidemap_proto::dynamic::DynamicCodec;
use tokio::sync::OwnedSemaphorePermit;
use tokio_stream::StreamExt as _;
use tonic::{Code, Status, Streaming, client::Grpc, codegen::http::uri::PathAndQuery};
use tonic_types::StatusExt as _;

use super::Gateway;
use crate::rpc::status::code_name;

/// Maximum size of a request as JSON; larger ones go over gRPC. An object takes up to fifty times its text in memory.
const REQUEST_BYTES: usize = 1 << 20;
/// Requests beyond this wait for each other.
const SMALL_REQUEST_BYTES: usize = 64 << 10;
/// Maximum size of one reply message on the wire, before it becomes JSON.
const REPLY_BYTES: usize = 8 << 20;
/// Number of large requests and replies that are converted at once.
pub(super) const LARGE: usize = 4;
/// A request must arrive within this time.
const ARRIVES_WITHIN: std::time::Duration = std::time::Duration::from_secs(30);

/// The answer of a JSON document that is there.
pub(super) fn ok(document: Bytes) -> Response {
    reply(StatusCode::OK, "application/json", Body::from(document))
}

fn reply(code: StatusCode, content_type: &'static str, body: Body) -> Response {
    let mut response = Response::new(body);
    *response.status_mut() = code;
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, header::HeaderValue::from_static(content_type));
    headers.insert(header::CACHE_CONTROL, header::HeaderValue::from_static("no-store"));
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, header::HeaderValue::from_static("nosniff"));
    response
}

/// An error that no RPC gave.
pub(super) fn failure(http: StatusCode, code: &str, reason: &str, message: &str) -> Response {
    let error = json!({ "error": { "code": code, "reason": reason, "message": message } });
    reply(http, "application/json", Body::from(error.to_string()))
}

/// The HTTP code of a gRPC code, as google.rpc.Code maps them.
fn http_code(code: Code) -> StatusCode {
    match code {
        Code::Ok => StatusCode::OK,
        Code::InvalidArgument | Code::FailedPrecondition | Code::OutOfRange => StatusCode::BAD_REQUEST,
        Code::Unauthenticated => StatusCode::UNAUTHORIZED,
        Code::PermissionDenied => StatusCode::FORBIDDEN,
        Code::NotFound => StatusCode::NOT_FOUND,
        Code::AlreadyExists | Code::Aborted => StatusCode::CONFLICT,
        Code::ResourceExhausted => StatusCode::TOO_MANY_REQUESTS,
        Code::Unimplemented => StatusCode::NOT_IMPLEMENTED,
        Code::Unavailable => StatusCode::SERVICE_UNAVAILABLE,
        Code::DeadlineExceeded => StatusCode::GATEWAY_TIMEOUT,
        Code::Cancelled => StatusCode::REQUEST_TIMEOUT,
        Code::Unknown | Code::Internal | Code::DataLoss => StatusCode::INTERNAL_SERVER_ERROR,
    }
}

/// A status with its details.
fn error_object(status: &Status) -> Value {
    let mut error = json!({ "code": code_name(status.code()), "message": status.message() });
    if let Some(info) = status.get_error_details().error_info() {
        error["reason"] = info.reason.as_str().into();
        if !info.metadata.is_empty() {
            error["details"] = json!(info.metadata);
        }
    }
    json!({ "error": error })
}

/// The answer of an error that an RPC gave.
pub(super) fn status_reply(status: &Status) -> Response {
    reply(http_code(status.code()), "application/json", Body::from(error_object(status).to_string()))
}

fn invalid(message: &str) -> Response {
    failure(StatusCode::BAD_REQUEST, "INVALID_ARGUMENT", "INVALID_JSON", message)
}

/// The method of a path; its service with or without the package.
fn method(gateway: &Gateway, service: &str, method: &str) -> Option<MethodDescriptor> {
    let service = service.strip_prefix("tidemap.v1.").unwrap_or(service);
    let service = gateway.pool.get_service_by_name(&format!("tidemap.v1.{service}"))?;
    service.methods().find(|known| known.name() == method)
}

fn is_json(headers: &HeaderMap) -> bool {
    let of = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or("");
    of.split(';').next().is_some_and(|media| media.trim().eq_ignore_ascii_case("application/json"))
}

fn parse(text: &[u8], input: MessageDescriptor) -> Result<DynamicMessage, serde_json::Error> {
    // No text at all is a request without fields.
    let text = if text.trim_ascii().is_empty() { b"{}" } else { text };
    let mut json = serde_json::Deserializer::from_slice(text);
    let options = DeserializeOptions::new().deny_unknown_fields(true);
    let message = DynamicMessage::deserialize_with_options(input, &mut json, &options)?;
    json.end()?;
    Ok(message)
}

/// A message as one line. Fields with their defaults are there as well: a probability of 0 is a statement.
fn line(message: &DynamicMessage) -> Result<Vec<u8>, Status> {
    let mut text = Vec::new();
    let options = SerializeOptions::new().skip_default_fields(false);
    message
        .serialize_with_options(&mut serde_json::Serializer::new(&mut text), &options)
        .map_err(|error| Status::internal(error.to_string()))?;
    text.push(b'\n');
    Ok(text)
}

impl Gateway {
    /// A turn for a large message; small ones need none.
    async fn turn(&self, bytes: usize) -> Option<OwnedSemaphorePermit> {
        if bytes <= SMALL_REQUEST_BYTES {
            return None;
        }
        // The semaphore is never closed.
        std::sync::Arc::clone(&self.large).acquire_owned().await.ok()
    }

    async fn converted(&self, message: DynamicMessage) -> Result<Bytes, Status> {
        let bytes = prost::Message::encoded_len(&message);
        let turn = self.turn(bytes).await;
        if turn.is_none() {
            return line(&message).map(Bytes::from);
        }
        let work = tokio::task::spawn_blocking(move || line(&message));
        let text = work.await.map_err(|_| Status::internal("the reply was not converted"))?;
        drop(turn);
        text.map(Bytes::from)
    }
}

/// Calls an RPC.
pub(super) async fn call(
    State(gateway): State<Gateway>,
    Path((service, name)): Path<(String, String)>,
    request: Request,
) -> Response {
    let Some(method) = method(&gateway, &service, &name) else {
        let message = format!("there is no method {service}/{name}; /api/v1/openapi.json lists all");
        return failure(StatusCode::NOT_FOUND, "NOT_FOUND", "UNKNOWN_METHOD", &message);
    };
    if method.is_client_streaming() {
        let message = format!("{service}/{name} takes a stream of requests: call it over gRPC");
        return failure(StatusCode::BAD_REQUEST, "UNIMPLEMENTED", "STREAM", &message);
    }
    if !is_json(request.headers()) {
        let message = "send the request as application/json";
        return failure(StatusCode::UNSUPPORTED_MEDIA_TYPE, "INVALID_ARGUMENT", "MEDIA_TYPE", message);
    }
    let (parts, body) = request.into_parts();
    let text = match tokio::time::timeout(ARRIVES_WITHIN, to_bytes(body, REQUEST_BYTES)).await {
        Ok(Ok(text)) => text,
        Ok(Err(_)) => {
            let message = format!("the request has more than {REQUEST_BYTES} bytes, or broke off: use gRPC");
            return failure(StatusCode::PAYLOAD_TOO_LARGE, "RESOURCE_EXHAUSTED", "LIMIT", &message);
        }
        Err(_) => {
            let message = format!("the request did not arrive within {} seconds", ARRIVES_WITHIN.as_secs());
            return failure(StatusCode::REQUEST_TIMEOUT, "DEADLINE_EXCEEDED", "LATE", &message);
        }
    };
    let turn = gateway.turn(text.len()).await;
    let message = match parse(&text, method.input()) {
        Ok(message) => message,
        Err(error) => return invalid(&error.to_string()),
    };
    drop((text, turn));
    let mut request = tonic::Request::new(message);
    if let Some(token) = parts.headers.get(header::AUTHORIZATION)
        && let Ok(token) = tonic::metadata::MetadataValue::try_from(token.as_bytes())
    {
        request.metadata_mut().insert("authorization", token);
    }
    for header in ["traceparent", "tracestate"] {
        if let Some(context) = parts.headers.get(header)
            && let Ok(context) = tonic::metadata::MetadataValue::try_from(context.as_bytes())
        {
            request.metadata_mut().insert(header, context);
        }
    }
    if let Some(peer) = parts.extensions.get::<crate::connections::Peer>() {
        request.extensions_mut().insert(*peer);
    }
    let path = format!("/{}/{}", method.parent_service().full_name(), method.name());
    let Ok(path) = PathAndQuery::try_from(path) else { return invalid("the path of the method") };
    let mut client = Grpc::new(gateway.services.clone()).max_decoding_message_size(REPLY_BYTES);
    let codec = DynamicCodec { output: method.output() };
    let replies = match client.server_streaming(request, path, codec).await {
        Ok(replies) => replies.into_inner(),
        Err(status) => return status_reply(&status),
    };
    if method.is_server_streaming() { stream(gateway, replies) } else { single(&gateway, replies).await }
}

async fn single(gateway: &Gateway, mut replies: Streaming<DynamicMessage>) -> Response {
    let converted = match replies.message().await {
        Ok(Some(message)) => gateway.converted(message).await,
        Ok(None) => Err(Status::internal("the method gave no reply")),
        Err(status) => Err(status),
    };
    match converted {
        Ok(text) => reply(StatusCode::OK, "application/json", Body::from(text)),
        Err(status) => status_reply(&status),
    }
}

fn stream(gateway: Gateway, replies: Streaming<DynamicMessage>) -> Response {
    let lines = replies.then(move |message| {
        let gateway = gateway.clone();
        async move {
            let text = match message {
                Ok(message) => gateway.converted(message).await,
                Err(status) => Err(status),
            };
            let text = text.unwrap_or_else(|status| format!("{}\n", error_object(&status)).into());
            Ok::<Bytes, std::convert::Infallible>(text)
        }
    });
    reply(StatusCode::OK, "application/x-ndjson", Body::from_stream(lines))
}
