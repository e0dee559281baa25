//! The gRPC services: each decodes its request, calls the domain code, and encodes the reply.
//!
//! Invariant: no code here decides anything about maps, and every error becomes a status in [`status`] only.

pub mod admission;
pub mod cluster;
pub mod copies;
pub(crate) mod exploration;
pub mod forks;
pub mod gateway;
pub mod guard;
pub mod lookup;
pub mod maintenance;
pub mod map;
pub mod observation;
pub mod query;
pub mod route;
pub mod serve;
pub mod status;
pub(crate) mod tasks;

mod acks;
mod model_cache;
mod peer;
mod permits;
mod readings;
mod replies;
mod series;
mod training;
mod update_worth;
mod watched_body;

/// The outcome of a unary request, or the beginning of a stream.
type RpcReply<T> = Result<tonic::Response<T>, tonic::Status>;
