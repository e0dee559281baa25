//! The peer of a request: the other end of its connection.
//!
//! Invariant: every request of the gRPC port carries a [`Remote`] among its extensions.

use tonic::transport::server::Connected;

use crate::connections::{Remote, guard::GuardedConnection};

impl<S> Connected for GuardedConnection<S> {
    type ConnectInfo = Remote;

    fn connect_info(&self) -> Remote {
        self.remote()
    }
}
