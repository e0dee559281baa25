//! Clusters: their members and maps as one daemon sees them, and the operations on them.
//!
//! Invariant: each call is answered by the daemon of this client, for itself. Replies are messages of the wire.

pub use tidemap_proto::v1::read_fork_response::Part as ForkPart;
use tidemap_proto::v1::{self, cluster_service_client::ClusterServiceClient};
use tonic::Streaming;

use crate::{
    connection::{Client, Connection, REPLY_BYTES_MAX},
    error::Error,
};

/// The parts of a fork, as they arrive.
#[derive(Debug)]
pub struct ForkParts {
    parts: Streaming<v1::ReadForkResponse>,
    client: Client,
}

impl ForkParts {
    /// The next part; `None`: that was the last one.
    ///
    /// # Errors
    /// [`Error`] where not everything could be read.
    pub async fn next(&mut self) -> Result<Option<ForkPart>, Error> {
        let message = self.parts.message().await.map_err(|status| self.client.error(&status))?;
        Ok(message.and_then(|message| message.part))
    }
}

impl Client {
    fn cluster_service(&self) -> ClusterServiceClient<Connection> {
        ClusterServiceClient::new(self.requests()).max_decoding_message_size(REPLY_BYTES_MAX)
    }

    /// The members and maps of the daemon's cluster, and the role of the daemon for each map. `with_engine`: also the
    /// servers and logs that the engine reports.
    ///
    /// # Errors
    /// [`Error`]; the code is `FAILED_PRECONDITION` if the daemon is not a member of a cluster.
    pub async fn cluster_status(&self, with_engine: bool) -> Result<v1::GetClusterStatusResponse, Error> {
        let request = v1::GetClusterStatusRequest { with_engine };
        let answer = self.cluster_service().get_cluster_status(request).await;
        Ok(answer.map_err(|status| self.error(&status))?.into_inner())
    }

    /// Pins a map to a member, which is to write it; `None`: removes the pin, and the present writer stays.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` or `FAILED_PRECONDITION` if the member cannot write it.
    pub async fn move_map(&self, map: &str, member: Option<&str>) -> Result<(), Error> {
        let request = v1::MoveMapRequest { map: map.to_owned(), member: member.unwrap_or_default().to_owned() };
        self.cluster_service().move_map(request).await.map_err(|status| self.error(&status))?;
        Ok(())
    }

    /// The end of the daemon's own log of a map, and the chain at a position; 0: at the end.
    ///
    /// # Errors
    /// [`Error`]; the code is `FAILED_PRECONDITION` if the daemon does not hold the map.
    pub async fn log_point(&self, map: &str, position: u64) -> Result<v1::GetLogPointResponse, Error> {
        let request = v1::GetLogPointRequest { map: map.to_owned(), position };
        let answer = self.cluster_service().get_log_point(request).await;
        Ok(answer.map_err(|status| self.error(&status))?.into_inner())
    }

    /// Removes one fork of a map from this daemon. Its records are lost.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if there is no such fork.
    pub async fn discard_fork(&self, map: &str, fork: &str) -> Result<(), Error> {
        let request = v1::DiscardForkRequest { map: map.to_owned(), fork: fork.to_owned() };
        self.cluster_service().discard_fork(request).await.map_err(|status| self.error(&status))?;
        Ok(())
    }

    /// Reads the content of a fork of a map of this daemon, in the order of the fork.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if there is no such fork.
    pub async fn read_fork(&self, map: &str, fork: &str) -> Result<ForkParts, Error> {
        let request = v1::ReadForkRequest { map: map.to_owned(), fork: fork.to_owned() };
        let parts = self.cluster_service().read_fork(request).await.map_err(|status| self.error(&status))?;
        Ok(ForkParts { parts: parts.into_inner(), client: self.clone() })
    }

    /// Removes a member that no longer runs from the list of members.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if there is no such member, `FAILED_PRECONDITION` if it is alive.
    pub async fn forget_member(&self, member: &str) -> Result<(), Error> {
        let request = v1::ForgetMemberRequest { member: member.to_owned() };
        self.cluster_service().forget_member(request).await.map_err(|status| self.error(&status))?;
        Ok(())
    }

    /// Drains the daemon, which hands over its maps and takes no new ones, or ends the drain.
    ///
    /// # Errors
    /// [`Error`]; the code is `FAILED_PRECONDITION` if the daemon is not a member of a cluster.
    pub async fn drain(&self, undo: bool) -> Result<(), Error> {
        let request = v1::DrainRequest { undo };
        self.cluster_service().drain(request).await.map_err(|status| self.error(&status))?;
        Ok(())
    }
}
