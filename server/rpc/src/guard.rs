//! The guard of the RPCs: each request passes it before any service sees it.
//!
//! Invariant: the guard decides by the table and the token alone, before any of a request is counted or read. The map
//! of a request is checked where its name is known, for the caller that the guard has set. No service sees the token.

use axum::{
    body::Body,
    extract::{Request, State},
    http::{HeaderMap, header::AUTHORIZATION},
    middleware::Next,
    response::Response,
};
use tidemap_base::{
    access::{
        Caller, Role,
        keyring::{Denial, Keyring},
        table::{Need, need},
    },
    shares::client::Client,
};
use tonic::Status;
use tracing::info;

use super::{
    status::RpcError,
    watched_body::{Direction, WatchedBody},
};

/// The caller of the request that this task works on. Unit tests call services without a port: there it is anybody.
pub(crate) fn current_caller() -> Caller {
    Caller::known().unwrap_or(if cfg!(test) { Caller::Anybody } else { Caller::Stranger })
}

/// How a port checks its callers.
#[derive(Clone, Debug)]
pub enum Access {
    /// No tokens are configured: everybody may do everything.
    Anybody,
    /// No tokens are configured, and the port is for reading: everybody may read, and nobody may change anything.
    Readers,
    /// The holder of a token may do what the token allows.
    Tokens(Keyring),
}

impl Access {
    /// The caller of a method, by the headers of the request.
    ///
    /// # Errors
    /// The caller may not call this method.
    pub(super) fn check(&self, path: &str, headers: &HeaderMap) -> Result<Caller, RpcError> {
        let need = need(path).ok_or(RpcError::UnknownMethod)?;
        let keyring = match (self, need) {
            // No token is the secret of the cluster, which the admission checks.
            (_, Need::Peer) => return Err(RpcError::Denial(Denial::Unknown)),
            (Self::Tokens(keyring), _) => keyring,
            (Self::Readers, Need::Role(role) | Need::AllMaps(role)) if role != Role::Planner => {
                return Err(RpcError::ReadOnly { method: path.to_owned() });
            }
            (Self::Anybody, _) => return Ok(Caller::Anybody),
            (Self::Readers, _) => return Ok(Caller::Reader),
        };
        let caller = match (keyring.caller(headers), need) {
            (Ok(caller), _) => caller,
            (Err(_), Need::Open) => return Ok(Caller::Stranger),
            (Err(denied), _) => return Err(RpcError::Denial(denied)),
        };
        match need {
            Need::Role(role) | Need::AllMaps(role) if !caller.has(role) => {
                Err(RpcError::NeedsRole { method: path.to_owned(), role })
            }
            Need::AllMaps(_) if !caller.covers_all() => Err(RpcError::NeedsAllMaps),
            _ => Ok(caller),
        }
    }

    /// Whether these headers allow to read the metrics of the whole daemon.
    ///
    /// # Errors
    /// There is no token, or it is not valid.
    pub fn may_read_metrics(&self, headers: &HeaderMap) -> Result<bool, Denial> {
        let Self::Tokens(keyring) = self else { return Ok(true) };
        let caller = keyring.caller(headers)?;
        Ok(caller.has(Role::Planner) && caller.covers_all())
    }
}

impl Access {
    /// Ready when the token of a caller is no longer valid as it was; never for a caller without one.
    pub async fn revoked(self, caller: Caller) {
        match self {
            Self::Tokens(keyring) => keyring.revoked(caller).await,
            Self::Anybody | Self::Readers => std::future::pending().await,
        }
    }

    /// Does work for a caller, until the caller's token is revoked.
    ///
    /// # Errors
    /// The error of the work, or that the token was revoked.
    pub(super) async fn work_for<T>(
        &self,
        caller: Caller,
        work: impl Future<Output = Result<T, RpcError>>,
    ) -> Result<T, RpcError> {
        let (Self::Tokens(keyring), Caller::Holder(_)) = (self, &caller) else { return caller.scope(work).await };
        tokio::select! {
            done = caller.clone().scope(work) => done,
            () = keyring.clone().revoked(caller.clone()) => Err(RpcError::Revoked),
        }
    }
}

/// Works on a request for the caller that admission has found, until the caller's token is revoked.
pub(super) async fn serve_caller(State(access): State<Access>, mut request: Request, next: Next) -> Response {
    let caller = request.extensions_mut().remove::<Caller>().unwrap_or(Caller::Stranger);
    let client = request.extensions_mut().remove::<Client>().unwrap_or_else(Client::current);
    request.headers_mut().remove(AUTHORIZATION);
    let (Access::Tokens(keyring), Caller::Holder(token)) = (access, &caller) else {
        return client.scope(caller.scope(next.run(request))).await;
    };
    if let Some(Need::Role(Role::Operator | Role::Admin) | Need::AllMaps(_)) = need(request.uri().path()) {
        info!(token = %token.id, method = %request.uri().path(), "an operator's request");
    }
    let (for_caller, for_reply) = (caller.clone(), keyring.clone());
    let for_request = (keyring.clone(), caller.clone());
    let request = request.map(|body| WatchedBody::wrap(body, for_request.0, for_request.1, Direction::Request));
    let work = client.scope(for_caller.scope(next.run(request)));
    tokio::select! {
        response = work => response.map(|body| WatchedBody::wrap(body, for_reply, caller, Direction::Reply)),
        () = keyring.revoked(caller.clone()) => Status::from(RpcError::Revoked).into_http::<Body>(),
    }
}
