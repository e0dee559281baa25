//! `TopologyService`: the topological map, and reports of failures.
//!
//! An edit of the topology is one event of the log; the writer takes one at a time, so that a load is checked against
//! the topology that it replaces, and is taken whole.
//!
//! Invariant: an edit is durable and published when it is answered.

use tidemap_map::{site::SiteEdit, topology::TopologyEdit};
use tidemap_proto::{
    convert::{
        topology::{edit_from_wire, load_from_wire, topology_to_wire},
        traversals::{failure_to_wire, is_of},
    },
    v1::{self, topology_service_server::TopologyService},
};
use tonic::{Request, Response};

use super::Routes;
use crate::{RpcReply, lookup::find_map, map::edit_site, status::RpcError};

impl Routes {
    /// Edits a map's topology. Returns the numbers of nodes and edges after that.
    async fn edit(&self, map: &str, edit: TopologyEdit) -> Result<(u32, u32), RpcError> {
        let handle = find_map(&self.catalog, map).await?;
        edit_site(&handle, SiteEdit::Topology(edit)).await?;
        let view = handle.view();
        let topology = view.site().topology();
        let count = |length: usize| u32::try_from(length).unwrap_or(u32::MAX);
        Ok((count(topology.nodes().len()), count(topology.edges().len())))
    }
}

#[tonic::async_trait]
impl TopologyService for Routes {
    async fn load_topology(&self, request: Request<v1::LoadTopologyRequest>) -> RpcReply<v1::LoadTopologyResponse> {
        let request = request.into_inner();
        let map = request.map.clone();
        find_map(&self.catalog, &map).await?;
        let edit = self.run_blocking(move || load_from_wire(&request)).await?.map_err(RpcError::from)?;
        let (nodes, edges) = self.edit(&map, edit).await?;
        Ok(Response::new(v1::LoadTopologyResponse { nodes, edges }))
    }

    async fn edit_topology(&self, request: Request<v1::EditTopologyRequest>) -> RpcReply<v1::EditTopologyResponse> {
        let v1::EditTopologyRequest { map, edit } = request.into_inner();
        find_map(&self.catalog, &map).await?;
        let edit = edit_from_wire(edit.as_ref()).map_err(RpcError::from)?;
        let (nodes, edges) = self.edit(&map, edit).await?;
        Ok(Response::new(v1::EditTopologyResponse { nodes, edges }))
    }

    async fn get_topology(&self, request: Request<v1::GetTopologyRequest>) -> RpcReply<v1::GetTopologyResponse> {
        let view = find_map(&self.catalog, &request.get_ref().map).await?.view();
        Ok(Response::new(self.run_blocking(move || topology_to_wire(view.site().topology())).await?))
    }

    async fn list_failures(&self, request: Request<v1::ListFailuresRequest>) -> RpcReply<v1::ListFailuresResponse> {
        let v1::ListFailuresRequest { map, limit, edge } = request.into_inner();
        let view = find_map(&self.catalog, &map).await?.view();
        let max_count = if limit == 0 { usize::MAX } else { usize::try_from(limit).unwrap_or(usize::MAX) };
        let requested = view.site().failures().newest_first();
        let requested = requested.filter(|failure| edge.as_ref().is_none_or(|edge| is_of(failure, edge)));
        let failures = requested.take(max_count).map(failure_to_wire).collect();
        Ok(Response::new(v1::ListFailuresResponse { failures }))
    }
}
