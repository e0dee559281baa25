//! A cluster as all of its daemons report it.
//!
//! Invariant: each daemon has answered for itself; a daemon that does not answer is included with the reason.

use std::{collections::BTreeMap, time::Duration};

use anyhow::Context as _;
use tidemap_client::{Client, connection::Credentials};
use tidemap_proto::v1;

/// The time limit for the reply of a daemon.
const ANSWER_WITHIN: Duration = Duration::from_secs(5);

/// The replies of the daemons of a cluster.
#[derive(Debug, Default)]
pub(super) struct ClusterView {
    /// The reply of the first daemon; only this one includes the engine's report.
    pub first_reply: v1::GetClusterStatusResponse,
    /// The reply of each member, or the reason why there is none.
    pub answers: BTreeMap<String, Result<v1::GetClusterStatusResponse, String>>,
}

/// Whether a member writes the map.
pub(super) fn is_writing(replica: &v1::MapReplica) -> bool {
    replica.role() == v1::ReplicaRole::Writing
}

/// The reply of a daemon; an error if it is late.
pub(super) async fn answer_of(client: &Client, with_engine: bool) -> anyhow::Result<v1::GetClusterStatusResponse> {
    let answer = tokio::time::timeout(ANSWER_WITHIN, client.cluster_status(with_engine)).await;
    let late = || format!("{} did not respond within {} seconds", client.server(), ANSWER_WITHIN.as_secs());
    Ok(answer.with_context(late)??)
}

impl ClusterView {
    /// Sends requests to all daemons, beginning with one.
    ///
    /// # Errors
    /// The first daemon does not answer.
    pub(super) async fn ask(client: &Client, credentials: &Credentials) -> anyhow::Result<ClusterView> {
        let first_reply = answer_of(client, true).await?;
        let mut asking = Vec::new();
        for member in first_reply.members.iter().filter(|member| member.name != first_reply.member) {
            let other = Client::with_credentials(&member.address, credentials);
            let answer = tokio::spawn(async move {
                match other {
                    Ok(other) => answer_of(&other, false).await.map_err(|error| format!("{error:#}")),
                    Err(error) => Err(error.to_string()),
                }
            });
            asking.push((member.name.clone(), answer));
        }
        let mut answers = BTreeMap::from([(first_reply.member.clone(), Ok(first_reply.clone()))]);
        for (name, answer) in asking {
            answers.insert(name, answer.await?);
        }
        Ok(ClusterView { first_reply, answers })
    }

    /// A client of each member that answers, by name.
    pub(super) fn clients(
        &self,
        client: &Client,
        credentials: &Credentials,
    ) -> anyhow::Result<BTreeMap<String, Client>> {
        let mut clients = BTreeMap::new();
        for (name, _) in self.answers.iter().filter(|(_, answer)| answer.is_ok()) {
            let address =
                self.first_reply.members.iter().find(|member| member.name == *name).map(|member| &member.address);
            let own = match address.filter(|_| self.first_reply.member != *name) {
                Some(address) => Client::with_credentials(address, credentials)?,
                None => client.clone(),
            };
            clients.insert(name.clone(), own);
        }
        Ok(clients)
    }

    /// The replicas of a map, by the members that hold it.
    pub(super) fn replicas(&self, map: &str) -> Vec<(&str, &v1::MapReplica)> {
        let mut held = Vec::new();
        for (name, answer) in &self.answers {
            let maps = answer.iter().flat_map(|answer| &answer.maps);
            held.extend(
                maps.filter(|found| found.map == map).filter_map(|found| Some((&**name, found.replica.as_ref()?))),
            );
        }
        held
    }

    /// The member that writes a map.
    pub(super) fn writer(&self, map: &str) -> Option<String> {
        let mut writing = self.replicas(map);
        writing.retain(|(_, replica)| is_writing(replica));
        writing.into_iter().max_by_key(|(_, replica)| replica.epoch).map(|(name, _)| name.to_owned())
    }

    /// Position of the last record of a map, as far as any member knows.
    pub(super) fn end(&self, map: &str) -> u64 {
        self.replicas(map).iter().map(|(_, replica)| replica.shared_position).max().unwrap_or(0)
    }
}
