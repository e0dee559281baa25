//! RPCs as JSON: `POST /api/v1/SERVICE/METHOD` with the request as an object.
//!
//! Invariant: messages are read and written by their descriptors alone, so each RPC that does not stream requests has
//! the same form as on the wire. A stream of replies is one object a line (NDJSON); an error inside it is its last
//! line. Nothing of a request is read before it is admitted, and no message but the smallest is converted on a thread
//! that answers others. A number that would be a time before 1990 reaches no map with a real clock.

use axum::{
    body::{Body, Bytes},
    extract::{Path, Request, State},
    http::{HeaderMap, StatusCode, header},
    response::Response,
};
use prost::Message as _;
use prost_reflect::{DeserializeOptions, DynamicMessage, MessageDescriptor, MethodDescriptor, SerializeOptions};
use serde_json::{Value, json};
use tidemap_ingest::intake::early::refusal;
use tidemap_proto::{bytes_codec::BytesCodec, map_of::map_of};
use tidemap_rpc::{admission::Admitted, status::code_name};
use tokio::sync::OwnedSemaphorePermit;
use tokio_stream::StreamExt as _;
use tonic::{Code, Status, Streaming, client::Grpc, codegen::http::uri::PathAndQuery};
use tonic_types::StatusExt as _;

use super::{
    Gateway,
    calls::{Caller, Calls},
    times::{self, Early, ReadRequest},
};

/// Maximum size of a request as JSON; larger requests go over gRPC. An object takes up to fifty times the size of its
/// text in memory.
const REQUEST_BYTES: usize = 1 << 20;
/// Messages that are larger than this are converted one after the other.
const SMALL_MESSAGE_BYTES: usize = 64 << 10;
/// Messages of at most this size are converted at once, in less time than another thread takes to begin.
const TINY_MESSAGE_BYTES: usize = 1 << 10;
/// Maximum size of one reply message on the wire, before it becomes JSON.
const REPLY_BYTES: usize = 8 << 20;

/// The response with a JSON document.
pub(super) fn ok(document: Bytes) -> Response {
    reply(StatusCode::OK, "application/json", Body::from(document))
}

/// A response that caches do not store.
pub(super) fn reply(code: StatusCode, content_type: &'static str, body: Body) -> Response {
    let mut response = Response::new(body);
    *response.status_mut() = code;
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, header::HeaderValue::from_static(content_type));
    headers.insert(header::CACHE_CONTROL, header::HeaderValue::from_static("no-store"));
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, header::HeaderValue::from_static("nosniff"));
    response
}

/// An error that does not come from an RPC.
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

/// The response for an error of an RPC.
pub(super) fn status_reply(status: &Status) -> Response {
    reply(http_code(status.code()), "application/json", Body::from(error_object(status).to_string()))
}

fn invalid(message: &str) -> Response {
    failure(StatusCode::BAD_REQUEST, "INVALID_ARGUMENT", "INVALID_JSON", message)
}

/// The method of a path; the service may be given with or without the package.
fn method(gateway: &Gateway, service: &str, method: &str) -> Option<MethodDescriptor> {
    let service = service.strip_prefix("tidemap.v1.").unwrap_or(service);
    let service = gateway.pool.get_service_by_name(&format!("tidemap.v1.{service}"))?;
    service.methods().find(|known| known.name() == method)
}

fn is_json(headers: &HeaderMap) -> bool {
    let media_type = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or("");
    media_type.split(';').next().is_some_and(|media| media.trim().eq_ignore_ascii_case("application/json"))
}

/// A request in wire format, and its first number that is an early time.
fn parse(text: &[u8], input: MessageDescriptor) -> Result<(Bytes, Option<Early>), String> {
    // No text at all is a request without fields.
    let text = if text.trim_ascii().is_empty() { b"{}" } else { text };
    let ReadRequest { text, early } = times::read(text, &input)?;
    let mut json = serde_json::Deserializer::from_slice(&text);
    let options = DeserializeOptions::new().deny_unknown_fields(true);
    let message = DynamicMessage::deserialize_with_options(input, &mut json, &options);
    let message = message.and_then(|message| json.end().map(|()| message)).map_err(|error| error.to_string())?;
    Ok((message.encode_to_vec().into(), early))
}

/// A message as one line. It includes fields that have their defaults, because a probability of 0 is information.
fn line(message: Bytes, output: MessageDescriptor) -> Result<Vec<u8>, Status> {
    let message = DynamicMessage::decode(output, message).map_err(|error| Status::internal(error.to_string()))?;
    let mut text = Vec::new();
    let options = SerializeOptions::new().skip_default_fields(false);
    message
        .serialize_with_options(&mut serde_json::Serializer::new(&mut text), &options)
        .map_err(|error| Status::internal(error.to_string()))?;
    text.push(b'\n');
    Ok(text)
}

/// Does the work on a message of this size.
async fn convert<T: Send + 'static>(bytes: usize, work: impl FnOnce() -> T + Send + 'static) -> Result<T, Status> {
    if bytes <= TINY_MESSAGE_BYTES {
        return Ok(work());
    }
    tidemap_base::task::blocking(work).await.map_err(|_| Status::internal("the message was not converted"))
}

impl Gateway {
    /// Waits for the turn of a large message; other messages need none.
    async fn turn(&self, bytes: usize) -> Option<OwnedSemaphorePermit> {
        if bytes <= SMALL_MESSAGE_BYTES {
            return None;
        }
        // The semaphore is never closed.
        std::sync::Arc::clone(&self.large).acquire_owned().await.ok()
    }

    async fn converted(&self, message: Bytes, output: MessageDescriptor) -> Result<Bytes, Status> {
        let bytes = message.len();
        let turn = self.turn(bytes).await;
        // The work holds the turn, also when nobody waits for it any more.
        let work = move || (line(message, output), turn);
        convert(bytes, work).await?.0.map(Bytes::from)
    }

    /// Reads the message of an admitted request, and converts it to wire format.
    async fn read(
        &self,
        admitted: &Admitted,
        body: Body,
        input: MessageDescriptor,
    ) -> Result<(Bytes, Option<Early>), Box<Response>> {
        let refused = |status: Status| {
            let mut response = status_reply(&status);
            if status.code() == Code::DeadlineExceeded {
                // The client was late, and not a server behind this one.
                *response.status_mut() = StatusCode::REQUEST_TIMEOUT;
            }
            Box::new(response)
        };
        let place = |bytes: usize| {
            let place = (bytes > SMALL_MESSAGE_BYTES).then(|| self.services.large_json(admitted)).transpose();
            place.map_err(&refused)
        };
        // The room is reserved before the body is read, if the length is declared.
        let declared = usize::try_from(http_body::Body::size_hint(&body).lower()).unwrap_or(usize::MAX);
        let known = place(declared)?;
        let text = self.services.read_all(admitted, body, REQUEST_BYTES).await.map_err(refused)?;
        let Some((text, held)) = text else {
            let message = format!("the request has more than {REQUEST_BYTES} bytes, or broke off: use gRPC");
            return Err(Box::new(failure(StatusCode::PAYLOAD_TOO_LARGE, "RESOURCE_EXHAUSTED", "LIMIT", &message)));
        };
        let bytes = text.len();
        let place = if known.is_some() { known } else { place(bytes)? };
        let turn = self.turn(bytes).await;
        let work = move || (parse(&text, input), held, place, turn);
        let (message, ..) = convert(bytes, work).await.map_err(refused)?;
        message.map_err(|error| Box::new(invalid(&error)))
    }

    /// The refusal of an early time for a map whose clock is real. If it is unknown whether the clock is real, the RPC
    /// itself refuses the call.
    async fn refused_time(&self, early: &Early, (path, message): (&str, &[u8]), caller: &Caller) -> Option<Response> {
        let map = map_of(path, message)?;
        let calls = Calls { services: &self.services, caller, map };
        if !calls.has_real_clock().await.unwrap_or(false) {
            return None;
        }
        let text = format!("{}: {}", early.field, refusal(early.nanos));
        Some(failure(StatusCode::BAD_REQUEST, "INVALID_ARGUMENT", "INVALID_FIELD", &text))
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
    let path = format!("/{}/{}", method.parent_service().full_name(), method.name());
    let admitted = match gateway.services.admit(&path, &parts.headers, &parts.extensions) {
        Ok(admitted) => admitted,
        Err(error) => return status_reply(&error.into()),
    };
    let (message, early) = match gateway.read(&admitted, body, method.input()).await {
        Ok(read) => read,
        Err(response) => return *response,
    };
    if let Some(early) = early {
        let caller = Caller::of_head(&parts.headers, &parts.extensions);
        if let Some(response) = gateway.refused_time(&early, (&path, &message), &caller).await {
            return response;
        }
    }
    let mut request = tonic::Request::new(message);
    request.extensions_mut().insert(admitted);
    if let Some(remote) = parts.extensions.get::<tidemap_base::connections::Remote>() {
        request.extensions_mut().insert(remote.clone());
    }
    for header in ["traceparent", "tracestate"] {
        if let Some(context) = parts.headers.get(header)
            && let Ok(context) = tonic::metadata::MetadataValue::try_from(context.as_bytes())
        {
            request.metadata_mut().insert(header, context);
        }
    }
    let Ok(path) = PathAndQuery::try_from(path) else { return invalid("the path of the method") };
    let mut client = Grpc::new(gateway.services.clone()).max_decoding_message_size(REPLY_BYTES);
    let replies = match client.server_streaming(request, path, BytesCodec).await {
        Ok(replies) => replies.into_inner(),
        Err(status) => return status_reply(&status),
    };
    let (output, is_stream) = (method.output(), method.is_server_streaming());
    if is_stream { stream(gateway, output, replies) } else { single(&gateway, output, replies).await }
}

async fn single(gateway: &Gateway, output: MessageDescriptor, mut replies: Streaming<Bytes>) -> Response {
    let converted = match replies.message().await {
        Ok(Some(message)) => gateway.converted(message, output).await,
        Ok(None) => Err(Status::internal("the method gave no reply")),
        Err(status) => Err(status),
    };
    match converted {
        Ok(text) => reply(StatusCode::OK, "application/json", Body::from(text)),
        Err(status) => status_reply(&status),
    }
}

fn stream(gateway: Gateway, output: MessageDescriptor, replies: Streaming<Bytes>) -> Response {
    let lines = replies.then(move |message| {
        let (gateway, output) = (gateway.clone(), output.clone());
        async move {
            let text = match message {
                Ok(message) => gateway.converted(message, output).await,
                Err(status) => Err(status),
            };
            let text = text.unwrap_or_else(|status| format!("{}\n", error_object(&status)).into());
            Ok::<Bytes, std::convert::Infallible>(text)
        }
    });
    reply(StatusCode::OK, "application/x-ndjson", Body::from_stream(lines))
}
