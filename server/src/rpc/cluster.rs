//! `ClusterService`: what this daemon knows of its cluster, and what operators ask of it.
//!
//! Invariant: a caller is shown only maps that its token is for.

use std::{collections::BTreeMap, sync::Arc, time::Duration};

use tidemap_cluster::{
    engine::{EngineServer, StreamHealth},
    membership::Member,
    replica::{ReplicaRole, ReplicaStatus},
};
use tidemap_map::{
    event::{Event, SequenceSpan},
    ids::ProducerId,
    snapshot::ProducerMark,
};
use tidemap_proto::{
    convert::time::duration,
    v1::{self, cluster_service_server::ClusterService},
};
use tidemap_store::{EventLog as _, Fork, MapId, Store};
use tokio::{sync::oneshot, time::Instant};
use tonic::{Request, Response, Status};

use super::{
    RpcReply,
    lookup::{check_scope, find_map, find_published},
    permits::{Permits, run_blocking},
    status::RpcError,
};
use crate::{
    access::Caller,
    catalog::{Catalog, CatalogError},
    cluster::{
        Cluster,
        operations::{ListedMap, OperationError},
    },
    ingest::{
        digests::DigestStatus,
        handle::MapHandle,
        protocol::{Command, KnownProducer},
    },
};

/// How long the thread of a map may take to say which producers it knows.
const PRODUCERS_WITHIN: Duration = Duration::from_secs(1);

/// The service.
#[derive(Debug)]
pub(crate) struct ClusterCalls {
    pub catalog: Arc<Catalog>,
    /// For what reads a log.
    pub(super) permits: Permits,
}

/// An age in nanoseconds.
fn nanos(age: Duration) -> i64 {
    i64::try_from(age.as_nanos()).unwrap_or(i64::MAX)
}

fn member_to_wire((name, member): (&String, &Member)) -> v1::ClusterMember {
    let report = &member.report;
    v1::ClusterMember {
        name: name.clone(),
        address: report.address.clone(),
        version: report.version.clone(),
        disk_format: report.format,
        maths: report.maths,
        capacity: report.capacity,
        is_alive: member.is_alive,
        is_draining: report.draining,
        report_age: Some(duration(nanos(member.unchanged_for))),
    }
}

fn server_to_wire(server: EngineServer) -> v1::EngineServerInfo {
    v1::EngineServerInfo { name: server.name, version: server.version, syncs_always: server.syncs_always }
}

fn log_to_wire(health: StreamHealth) -> v1::SharedLogInfo {
    let follower = |(name, lag)| v1::SharedLogFollower { name, lag };
    v1::SharedLogInfo {
        leader: health.leader.unwrap_or_default(),
        replicas: u32::try_from(health.replicas).unwrap_or(u32::MAX),
        followers: health.followers.into_iter().map(follower).collect(),
        bytes: health.bytes,
    }
}

fn role_to_wire(role: ReplicaRole) -> v1::ReplicaRole {
    match role {
        ReplicaRole::Starting => v1::ReplicaRole::Starting,
        ReplicaRole::Following => v1::ReplicaRole::Following,
        ReplicaRole::TakingOver => v1::ReplicaRole::TakingOver,
        ReplicaRole::Writing => v1::ReplicaRole::Writing,
        ReplicaRole::Ahead => v1::ReplicaRole::Ahead,
        ReplicaRole::Forked => v1::ReplicaRole::Forked,
    }
}

fn digest_to_wire(status: DigestStatus) -> v1::GenerationDigest {
    let DigestStatus { generation, digest, is_equal } = status;
    v1::GenerationDigest { generation, value: digest.to_string(), is_equal }
}

fn replica_to_wire(status: ReplicaStatus, now: Instant) -> v1::MapReplica {
    v1::MapReplica {
        role: role_to_wire(status.role).into(),
        writer: status.writer.unwrap_or_default(),
        epoch: status.epoch,
        position: status.position,
        shared_position: status.shared_position.max(status.position),
        heard_age: status.heard.map(|heard| duration(nanos(now.saturating_duration_since(heard)))),
        trouble: status.trouble.unwrap_or_default(),
        digest: None,
        forks: Vec::new(),
    }
}

/// The producers of a map, by their number in it; none where the map does not answer.
async fn known_producers(handle: &MapHandle) -> BTreeMap<ProducerId, KnownProducer> {
    let (reply, known) = oneshot::channel();
    let answer = async { if handle.send(Command::ListProducers(reply)) { known.await.ok() } else { None } };
    let known = tokio::time::timeout(PRODUCERS_WITHIN, answer).await.ok().flatten().unwrap_or_default();
    known.into_iter().map(|producer| (producer.id, producer)).collect()
}

/// Up to which number of a part of a producer's sequence the map has the very observations of a fork. A producer that
/// began anew has sent others under the numbers.
fn known_to(mark: &ProducerMark, incarnation: u64, span: SequenceSpan) -> u64 {
    let at_last = mark.content_marks().into_iter().find(|content| content.sequence == span.last);
    let is_same = at_last.map_or(mark.incarnation == incarnation, |content| content.crc == span.content_crc);
    if is_same { span.last.min(mark.durable_sequence) } else { 0 }
}

/// What a fork holds, beside what the map has meanwhile.
fn fork_to_wire(
    store: &Store,
    map: MapId,
    fork: Fork,
    known: &BTreeMap<ProducerId, KnownProducer>,
) -> Result<v1::LogFork, OperationError> {
    let mut producers: BTreeMap<(String, String), v1::ForkedProducer> = BTreeMap::new();
    // A producer that is new in the fork may have another number in the map.
    let mut new = BTreeMap::new();
    let mut other_records = 0;
    for (_, event) in store.fork_events(map, &fork.name)? {
        let Some(envelope) = event.envelope() else {
            // Neither says anything that the map lacks.
            other_records += u64::from(!matches!(event, Event::Epoch(_) | Event::UpdateDone(_)));
            continue;
        };
        if let Some(first) = &envelope.new_producer {
            new.insert(envelope.producer, first.key.clone());
        }
        let key = new.get(&envelope.producer).or_else(|| known.get(&envelope.producer).map(|known| &known.mark.key));
        let (producer, label) = key.map_or_else(
            || (format!("number {}", envelope.producer.0), String::new()),
            |key| (key.producer().to_owned(), key.label().to_owned()),
        );
        let same = |known: &&KnownProducer| known.mark.key.producer() == producer && known.mark.key.label() == label;
        let mark = known.values().find(same).map(|known| &known.mark);
        let span = envelope.span;
        let known_to = mark.map_or(0, |mark| known_to(mark, envelope.incarnation, span));
        let row = producers.entry((producer.clone(), label.clone())).or_insert_with(|| v1::ForkedProducer {
            producer,
            label,
            first_sequence: span.first,
            ..v1::ForkedProducer::default()
        });
        row.last_sequence = span.last;
        row.observations += (span.last + 1).saturating_sub(span.first);
        row.known_observations += (known_to + 1).saturating_sub(span.first);
    }
    Ok(v1::LogFork {
        name: fork.name,
        first_position: fork.first,
        last_position: fork.last,
        groups: fork.groups as u64,
        producers: producers.into_values().collect(),
        other_records,
    })
}

impl ClusterCalls {
    fn cluster(&self) -> Result<&Cluster, RpcError> {
        self.catalog.context().cluster.as_ref().ok_or(RpcError::Operation(OperationError::NoCluster))
    }

    /// The forks of a map of this daemon.
    async fn forks(&self, handle: &MapHandle) -> Result<Vec<v1::LogFork>, OperationError> {
        let (store, id) = (Arc::clone(&self.catalog.context().store), handle.id);
        let for_list = Arc::clone(&store);
        let stopping = || OperationError::NotHeld(handle.spec.name.as_str().to_owned());
        let forks = crate::task::blocking(move || for_list.forks(id)).await.map_err(|_| stopping())??;
        if forks.is_empty() {
            return Ok(Vec::new());
        }
        let known = known_producers(handle).await;
        let read = move || forks.into_iter().map(|fork| fork_to_wire(&store, id, fork, &known)).collect();
        crate::task::blocking(read).await.map_err(|_| stopping())?
    }

    /// A map with what this daemon is to it.
    async fn map_to_wire(&self, cluster: &Cluster, listed: ListedMap, now: Instant) -> v1::ClusterMapStatus {
        let mut replica =
            listed.uid.and_then(|uid| cluster.replica_status(uid)).map(|status| replica_to_wire(status, now));
        if let (Some(replica), Ok(handle)) = (&mut replica, self.catalog.get(&listed.name)) {
            replica.digest = handle.digest().map(digest_to_wire);
            match self.forks(&handle).await {
                Ok(forks) => replica.forks = forks,
                Err(error) => replica.trouble = format!("its forks cannot be read: {error}"),
            }
        }
        v1::ClusterMapStatus {
            map: listed.name,
            uid: listed.uid.map(|uid| format!("{uid:016x}")).unwrap_or_default(),
            pinned: listed.pinned.unwrap_or_default(),
            candidates: listed.holders,
            log: None,
            replica,
        }
    }

    /// The map of this name that this daemon holds, with its number in the cluster.
    async fn held(&self, name: &str) -> Result<(Arc<MapHandle>, u64), RpcError> {
        let handle = find_map(&self.catalog, name).await?;
        let uid = handle.shared_uid.ok_or_else(|| OperationError::NotHeld(name.to_owned()))?;
        Ok((handle, uid))
    }
}

#[tonic::async_trait]
impl ClusterService for ClusterCalls {
    async fn get_cluster_status(
        &self,
        request: Request<v1::GetClusterStatusRequest>,
    ) -> RpcReply<v1::GetClusterStatusResponse> {
        let (cluster, caller, now) = (self.cluster()?, Caller::current(), Instant::now());
        let mut reply = v1::GetClusterStatusResponse {
            cluster: cluster.name().to_owned(),
            cluster_id: cluster.id().to_owned(),
            member: cluster.member().to_owned(),
            ..v1::GetClusterStatusResponse::default()
        };
        let view = cluster.members_view();
        reply.members = view.members.iter().map(member_to_wire).collect();
        reply.engine_trouble = view.trouble.map(|trouble| trouble.to_string()).unwrap_or_default();
        let mut listed = cluster.listed_maps().await.unwrap_or_else(|error| {
            reply.engine_trouble = error.to_string();
            cluster.held_maps()
        });
        listed.retain(|map| caller.covers(&map.name));
        let mut asks_engine = request.get_ref().with_engine && reply.engine_trouble.is_empty();
        if asks_engine {
            match cluster.engine_servers().await {
                Ok(servers) => reply.engine_servers = servers.into_iter().map(server_to_wire).collect(),
                Err(error) => reply.engine_trouble = error.to_string(),
            }
        }
        for map in listed {
            let uid = map.uid;
            let mut wire = self.map_to_wire(cluster, map, now).await;
            if asks_engine && let Some(uid) = uid {
                match cluster.log_health(uid).await {
                    Ok(health) => wire.log = Some(log_to_wire(health)),
                    // The others would wait as long.
                    Err(error) => {
                        reply.engine_trouble = error.to_string();
                        asks_engine = false;
                    }
                }
            }
            reply.maps.push(wire);
        }
        Ok(Response::new(reply))
    }

    async fn move_map(&self, request: Request<v1::MoveMapRequest>) -> RpcReply<v1::MoveMapResponse> {
        let v1::MoveMapRequest { map, member } = request.into_inner();
        check_scope(&map)?;
        let member = Some(member.as_str()).filter(|member| !member.is_empty());
        self.cluster()?.pin(&map, member).await.map_err(RpcError::from)?;
        Ok(Response::new(v1::MoveMapResponse {}))
    }

    async fn get_log_point(&self, request: Request<v1::GetLogPointRequest>) -> RpcReply<v1::GetLogPointResponse> {
        let v1::GetLogPointRequest { map, position } = request.into_inner();
        check_scope(&map)?;
        let cluster = self.cluster()?;
        let (handle, uid) = self.held(&map).await?;
        let log = cluster.log_of(&map, uid).map_err(RpcError::from)?;
        // A part of the log is read whole.
        let permit = self.permits.take().await?;
        let end_position = log.end();
        let at = if position == 0 { end_position } else { position };
        let chain = run_blocking(permit, move || log.chain_at(at)).await?;
        let chain = chain.map_err(|error| RpcError::from(OperationError::from(error)))?;
        let digest = handle.digest().map(digest_to_wire);
        Ok(Response::new(v1::GetLogPointResponse { end_position, chain, digest }))
    }

    async fn discard_fork(&self, request: Request<v1::DiscardForkRequest>) -> RpcReply<v1::DiscardForkResponse> {
        let v1::DiscardForkRequest { map, fork } = request.into_inner();
        check_scope(&map)?;
        self.cluster()?;
        let handle = find_published(&self.catalog, &map)?;
        let (store, id) = (Arc::clone(&self.catalog.context().store), handle.id);
        let unknown = OperationError::UnknownFork { map, fork: fork.chars().take(80).collect() };
        let discard = move || {
            // What is no name of a fork is no file that may be removed.
            if store.forks(id).map_err(OperationError::from)?.iter().all(|known| known.name != fork) {
                return Err(RpcError::from(unknown));
            }
            store.remove_fork(id, &fork).map_err(|error| RpcError::from(CatalogError::from(error)))
        };
        crate::task::blocking(discard).await.map_err(|_| RpcError::Stopping)??;
        tracing::warn!(map = %handle.spec.name, "an operator has given up the records of a fork");
        Ok(Response::new(v1::DiscardForkResponse {}))
    }

    async fn drain(&self, request: Request<v1::DrainRequest>) -> Result<Response<v1::DrainResponse>, Status> {
        self.cluster()?.drain(!request.get_ref().undo);
        Ok(Response::new(v1::DrainResponse {}))
    }
}

#[cfg(test)]
mod tests {
    use tidemap_map::{name::ProducerKey, snapshot::ContentMark};

    use super::*;

    #[test]
    fn the_map_has_observations_of_a_fork_only_if_the_producer_has_not_begun_anew() {
        let mark = ProducerMark {
            key: ProducerKey::new("robot", "").expect("valid"),
            incarnation: 3,
            durable_sequence: 20,
            content_crc: 0xB,
            sensor: None,
            received_nanos: 0,
            newest_nanos: 0,
            recent: vec![ContentMark { sequence: 15, crc: 0xA }],
            has_scans: false,
        };
        let span = |first, last, content_crc| SequenceSpan { first, last, content_crc };
        assert_eq!(known_to(&mark, 3, span(9, 12, 0)), 12, "it is the producer that the fork knew");
        assert_eq!(known_to(&mark, 3, span(19, 24, 0)), 20, "some came after");
        assert_eq!(known_to(&mark, 2, span(9, 12, 0)), 0, "it began anew, and may have sent others");
        assert_eq!(known_to(&mark, 2, span(9, 15, 0xA)), 15, "it sent the very observations");
        assert_eq!(known_to(&mark, 3, span(19, 20, 0xC)), 0, "the map has others");
    }
}
