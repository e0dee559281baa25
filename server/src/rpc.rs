//! The wire's side of the daemon: each service takes its request apart, asks the domain, and puts the reply together.
//!
//! Invariant: no decision about maps is taken here, and every error becomes a status in [`status`] and nowhere else.

pub(crate) mod exploration;
pub(crate) mod maintenance;
pub(crate) mod map;
pub(crate) mod observation;
pub(crate) mod query;
pub(crate) mod route;
pub(crate) mod serve;
pub(crate) mod status;

mod acks;
mod lookup;
mod page;
mod permits;
mod replies;
mod series;
