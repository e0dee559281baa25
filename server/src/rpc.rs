//! The gRPC services: each decodes its request, calls the domain code, and encodes the reply.
//!
//! Invariant: no code here decides anything about maps, and every error becomes a status in [`status`] only.

pub(crate) mod admission;
pub(crate) mod cluster;
pub(crate) mod copies;
pub(crate) mod exploration;
pub(crate) mod forks;
pub(crate) mod gateway;
pub(crate) mod guard;
pub(crate) mod lookup;
pub(crate) mod maintenance;
pub(crate) mod map;
pub(crate) mod observation;
pub(crate) mod query;
pub(crate) mod route;
pub(crate) mod serve;
pub(crate) mod status;
pub(crate) mod tasks;

mod acks;
mod peer;
mod permits;
mod readings;
mod replies;
mod series;
mod training;
mod watched_body;

/// The outcome of a unary request, or the beginning of a stream.
type RpcReply<T> = Result<tonic::Response<T>, tonic::Status>;
