//! Jobs of other daemons.
//!
//! Invariant: a job that this daemon knows is answered by this daemon.

use axum::{body::Body, http::HeaderMap, middleware::Next, response::Response};
use http_body_util::Full;
use prost::Message as _;
use tidemap_proto::{first_message::PeekedBody, v1};

use super::{ClusterGateway, GatewayCall, WRITER_WITHIN};
use crate::status::{GatewayError, RpcError};

/// NOT_FOUND, as gRPC writes it.
const NOT_FOUND: &str = "5";

impl ClusterGateway {
    /// Answers a request of a job in the daemon that knows the job: this daemon asks the other daemons one after the
    /// other.
    pub(super) async fn find_job(
        &self,
        call: GatewayCall,
        message: Option<&[u8]>,
        next: Next,
    ) -> Result<Response, RpcError> {
        // All requests of jobs have the number in their first field.
        let id = message.and_then(|message| v1::GetJobRequest::decode(message).ok()).map(|request| request.id);
        let (Some(id), Some(message), None) = (id, message, call.passed_by()) else {
            return Ok(call.answer(next).await);
        };
        if self.catalog.context().jobs.get(id).is_some() {
            return Ok(call.answer(next).await);
        }
        let mut silent = None;
        for member in self.peers.others() {
            let Some(address) = self.peers.address_of(&member) else { continue };
            let deadline = tokio::time::Instant::now() + WRITER_WITHIN;
            let place = match self.place(&address, call.authorization.is_some(), deadline).await {
                Ok(place) => place,
                Err(why) => {
                    silent = Some((member, why));
                    continue;
                }
            };
            let body = PeekedBody::new(Body::new(Full::new(framed(message))));
            let question = GatewayCall { parts: call.parts.clone(), body, authorization: call.authorization.clone() };
            match self.pass(question, (member.clone(), &address, place)).await {
                Ok(reply) if is_unknown(reply.headers()) => {}
                Err(RpcError::Gateway(GatewayError::Broke { .. })) => {
                    silent = Some((member, "the connection broke".to_owned()));
                }
                answer => return answer,
            }
        }
        match silent {
            Some((member, why)) => Err(GatewayError::JobAway { id, member, why }.into()),
            None => Ok(call.answer(next).await),
        }
    }
}

fn is_unknown(headers: &HeaderMap) -> bool {
    headers.get("grpc-status").is_some_and(|status| status == NOT_FOUND)
}

/// Frames a message for a body.
fn framed(message: &[u8]) -> axum::body::Bytes {
    let length = u32::try_from(message.len()).unwrap_or(u32::MAX);
    [&[0][..], &length.to_be_bytes(), message].concat().into()
}
