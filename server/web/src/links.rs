//! The documents that people link to: a grid at a time as a picture, and the topological map at a time as GeoJSON.
//!
//! Invariant: requests for them pass the same guard and admission as the RPCs, with the caller's token, so that
//! permissions and limits are the same. Each document has a tag of its content, and browsers request it again each
//! time.

use axum::{
    body::Body,
    extract::Request,
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::{IntoResponse as _, Response},
};
use tidemap_base::clock::{Clock as _, SystemClock};
use tidemap_model::time::{InvalidTime, parse_time};
use tidemap_rpc::status::RpcError;
use tonic::Status;

use super::{
    Gateway,
    calls::{Caller, Calls},
    json,
};

mod parameters;
mod picture;
mod topology;

pub(super) use parameters::Given;
pub(super) use picture::{PARAMETERS as PICTURE_PARAMETERS, grid_png};
pub(super) use topology::{PARAMETERS as TOPOLOGY_PARAMETERS, topology_geojson};

/// The reason why there is no content.
#[derive(Debug)]
pub(super) enum Failure {
    /// An RPC refused or failed.
    Refused(Status),
    /// A parameter is wrong, or there is nothing to show.
    Invalid(String),
    /// The content is too large; the text states what to do instead.
    TooLarge(String),
}

impl From<Status> for Failure {
    fn from(status: Status) -> Self {
        Self::Refused(status)
    }
}

impl From<RpcError> for Failure {
    fn from(error: RpcError) -> Self {
        Self::Refused(error.into())
    }
}

impl From<InvalidTime> for Failure {
    fn from(error: InvalidTime) -> Self {
        Self::Invalid(error.to_string())
    }
}

impl Failure {
    /// The response for this failure.
    pub(super) fn response(&self) -> Response {
        match self {
            Self::Refused(status) => json::status_reply(status),
            Self::Invalid(text) => json::failure(StatusCode::BAD_REQUEST, "INVALID_ARGUMENT", "INVALID_FIELD", text),
            Self::TooLarge(text) => json::failure(StatusCode::BAD_REQUEST, "INVALID_ARGUMENT", "LIMIT", text),
        }
    }
}

/// A parameter of an address, as the description of the interface contains it.
#[derive(Clone, Copy)]
pub(super) struct Parameter {
    /// Name of the parameter, as in the query of an address.
    pub name: &'static str,
    /// The meaning of the parameter, and its default.
    pub description: &'static str,
    /// A value to try.
    pub example: &'static str,
}

/// The caller that requests a link, and the tag of the content that the caller has already.
struct Visitor {
    caller: Caller,
    known_tag: Option<HeaderValue>,
}

impl Visitor {
    fn of(request: &Request) -> Self {
        Self { caller: Caller::of(request), known_tag: request.headers().get(header::IF_NONE_MATCH).cloned() }
    }

    /// The RPCs about a map, for this caller.
    fn calls<'a>(&'a self, gateway: &'a Gateway, map: &'a str) -> Calls<'a> {
        Calls { services: &gateway.services, caller: &self.caller, map }
    }

    /// The response with the content, or with the status that the caller has it already.
    fn answer(&self, content_type: &'static str, content: Vec<u8>, facts: HeaderMap) -> Response {
        let digest = ring::digest::digest(&ring::digest::SHA256, &content);
        let hex: String = digest.as_ref().iter().take(12).map(|byte| format!("{byte:02x}")).collect();
        let tag = format!("\"{hex}\"");
        let is_known = self.known_tag.as_ref().is_some_and(|known| known.as_bytes() == tag.as_bytes());
        let mut response =
            if is_known { StatusCode::NOT_MODIFIED.into_response() } else { Body::from(content).into_response() };
        let headers = response.headers_mut();
        headers.extend(facts);
        // The next observation or update may change the content.
        headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("private, no-cache"));
        headers.insert(header::VARY, HeaderValue::from_static("authorization"));
        headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
        headers.insert("cross-origin-resource-policy", HeaderValue::from_static("same-origin"));
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(content_type));
        if let Ok(tag) = HeaderValue::from_str(&tag) {
            headers.insert(header::ETAG, tag);
        }
        response
    }
}

/// A time of an address: Unix seconds, RFC 3339 or `now`.
fn time(text: &str) -> Result<i64, Failure> {
    // A form writes a space as a plus, so that the plus of a time in an address may have become a space.
    if text == "now" { Ok(SystemClock.now_nanos()) } else { Ok(parse_time(&text.replace(' ', "+"))?) }
}

/// Runs a computation that takes much memory, off the async threads; few run at once.
async fn in_turn<T: Send + 'static>(
    gateway: &Gateway,
    work: impl FnOnce() -> Result<T, Failure> + Send + 'static,
) -> Result<T, Failure> {
    let turn = std::sync::Arc::clone(&gateway.large).acquire_owned().await;
    let done = tidemap_base::task::blocking(work).await;
    drop(turn);
    done.unwrap_or_else(|_| Err(Status::internal("the work was not done").into()))
}
