//! The wire's side of the daemon: each service takes its request apart, asks the domain, and puts the reply together.
//!
//! Invariant: no decision about maps is taken here, and every error becomes a status in [`status`] and nowhere else.

pub mod exploration;
pub mod maintenance;
pub mod map;
pub mod observation;
pub mod query;
pub mod route;
pub mod serve;
pub mod status;

mod acks;
mod lookup;
mod page;
mod permits;
mod replies;
mod series;
