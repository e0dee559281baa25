//! `ClusterService`: the state of the cluster as this daemon has it, and the operations of operators.
//!
//! Invariant: a caller is shown only maps that its token is for.

use std::{sync::Arc, time::Duration};

use tidemap_cluster::{
    engine::{EngineServer, StreamHealth},
    membership::Member,
    replica::{ReplicaRole, ReplicaStatus},
};
use tidemap_ingest::{
    catalog::{Catalog, CatalogError},
    cluster::{
        Cluster,
        operations::{ListedMap, OperationError},
    },
    digests::DigestStatus,
    handle::MapHandle,
};
use tidemap_proto::{
    convert::time::duration,
    v1::{self, cluster_service_server::ClusterService},
};
use tidemap_store::{EventLog as _, Fork};
use tokio::time::Instant;
use tonic::{Request, Response, Status};

use super::{
    RpcReply,
    forks::{content_of, fork_to_wire, known_producers, read_fork},
    guard::current_caller,
    lookup::{check_scope, find_map, find_published},
    permits::{Permits, run_blocking},
    replies::{Replies, compute_replies},
    status::RpcError,
};

/// The service.
#[derive(Debug)]
pub(crate) struct ClusterCalls {
    pub catalog: Arc<Catalog>,
    /// Permits for requests that read a log.
    pub(super) permits: Permits,
}

/// Converts an age to nanoseconds.
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
        heard_age: status.last_contact.map(|time| duration(nanos(now.saturating_duration_since(time)))),
        trouble: status.trouble.unwrap_or_default(),
        digest: None,
        forks: Vec::new(),
    }
}

/// The replica of a map that cannot begin yet. `trouble`: the reason.
fn waiting_to_wire(trouble: String) -> v1::MapReplica {
    v1::MapReplica { role: v1::ReplicaRole::Starting.into(), trouble, ..v1::MapReplica::default() }
}

fn listed_to_wire(listed: ListedMap, replica: Option<v1::MapReplica>) -> v1::ClusterMapStatus {
    v1::ClusterMapStatus {
        map: listed.name,
        uid: listed.uid.map(|uid| format!("{uid:016x}")).unwrap_or_default(),
        pinned: listed.pinned.unwrap_or_default(),
        candidates: listed.holders,
        log: None,
        replica,
    }
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
        let forks = tidemap_base::task::blocking(move || for_list.forks(id)).await.map_err(|_| stopping())??;
        if forks.is_empty() {
            return Ok(Vec::new());
        }
        let (view, known) = (handle.view(), known_producers(handle).await);
        let compared = move |fork: Fork| {
            let content = content_of(&store, id, &fork, (&*view, &known))?;
            Ok(fork_to_wire(fork, content))
        };
        let read = move || forks.into_iter().map(compared).collect();
        tidemap_base::task::blocking(read).await.map_err(|_| stopping())?
    }

    /// Encodes a map with the role of this daemon for it.
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
        if replica.is_none() {
            replica = listed.uid.and_then(|uid| cluster.waiting(uid)).map(waiting_to_wire);
        }
        listed_to_wire(listed, replica)
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
    type ReadForkStream = Replies<v1::ReadForkResponse>;

    async fn get_cluster_status(
        &self,
        request: Request<v1::GetClusterStatusRequest>,
    ) -> RpcReply<v1::GetClusterStatusResponse> {
        let (cluster, caller, now) = (self.cluster()?, current_caller(), Instant::now());
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
                    // Requests for the other maps would wait as long.
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
        // The operation reads a whole part of the log.
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
            // A file may be removed only if its name is that of a fork.
            if store.forks(id).map_err(OperationError::from)?.iter().all(|known| known.name != fork) {
                return Err(RpcError::from(unknown));
            }
            store.remove_fork(id, &fork).map_err(|error| RpcError::from(CatalogError::from(error)))
        };
        tidemap_base::task::blocking(discard).await.map_err(RpcError::from)??;
        tracing::warn!(map = %handle.spec.name, "an operator has removed a fork");
        Ok(Response::new(v1::DiscardForkResponse {}))
    }

    async fn read_fork(&self, request: Request<v1::ReadForkRequest>) -> RpcReply<Self::ReadForkStream> {
        let v1::ReadForkRequest { map, fork } = request.into_inner();
        check_scope(&map)?;
        self.cluster()?;
        let handle = find_published(&self.catalog, &map)?;
        let store = Arc::clone(&self.catalog.context().store);
        let (for_list, id) = (Arc::clone(&store), handle.id);
        let forks = tidemap_base::task::blocking(move || for_list.forks(id)).await.map_err(RpcError::from)?;
        let forks = forks.map_err(OperationError::from).map_err(RpcError::from)?;
        if forks.iter().all(|known| known.name != fork) {
            let fork = fork.chars().take(80).collect();
            return Err(RpcError::from(OperationError::UnknownFork { map, fork }).into());
        }
        let known = known_producers(&handle).await;
        // The operation reads the whole fork.
        let permit = self.permits.take().await?;
        Ok(Response::new(compute_replies(vec![permit], move |sink| read_fork(&store, &handle, &fork, &known, sink))))
    }

    async fn forget_member(&self, request: Request<v1::ForgetMemberRequest>) -> RpcReply<v1::ForgetMemberResponse> {
        self.cluster()?.forget(&request.get_ref().member).await.map_err(RpcError::from)?;
        Ok(Response::new(v1::ForgetMemberResponse {}))
    }

    async fn drain(&self, request: Request<v1::DrainRequest>) -> Result<Response<v1::DrainResponse>, Status> {
        self.cluster()?.drain(!request.get_ref().undo);
        Ok(Response::new(v1::DrainResponse {}))
    }
}
