//! Who makes a request: the peer of its connection.
//!
//! Invariant: every request of the gRPC port carries a [`Peer`] among its extensions.

use tonic::transport::server::Connected;

use crate::connections::{Peer, guard::GuardedConnection};

impl<S> Connected for GuardedConnection<S> {
    type ConnectInfo = Peer;

    fn connect_info(&self) -> Peer {
        self.peer()
    }
}
