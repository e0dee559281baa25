//! `MapService`: creates, lists and deletes maps, adds states, and edits a map's site.

use std::sync::Arc;

use tidemap_answer::StateOrCell;
use tidemap_base::shares::client::Client;
use tidemap_ingest::{
    catalog::{Catalog, CatalogError, UnavailableMap},
    handle::MapHandle,
    protocol::{AddState, AddStateError, Command, EditSite, EditSiteError},
};
use tidemap_map::{
    ids::StateId,
    no_go::NoGoEdit,
    site::{Location, SiteEdit},
};
use tidemap_proto::{
    convert::{
        map::{map_to_wire, spec_from_request, state_to_wire},
        page::page_from_wire,
        site::{
            NamedLocation, area_from_wire, area_to_wire, location_from_wire, location_name_from_wire, location_to_wire,
            point_from_wire,
        },
        vectors::declared_state_from_wire,
    },
    v1::{self, map_service_server::MapService},
};
use tokio::sync::oneshot;
use tonic::{Request, Response};

use super::{RpcReply, guard::current_caller, status::RpcError};
use crate::lookup::{check_on_grid, check_scope, find_all, find_map, opened};

#[derive(Debug)]
pub(crate) struct Maps {
    pub catalog: Arc<Catalog>,
}

/// Edits a map's site; durable and published when this returns.
pub(super) async fn edit_site(handle: &MapHandle, edit: SiteEdit) -> Result<(), RpcError> {
    let (reply, answer) = oneshot::channel();
    let edit = EditSite { edit, reply };
    let answer = if handle.send(Command::EditSite(edit)) { answer.await.ok() } else { None };
    Ok(answer.unwrap_or(Err(EditSiteError::Closing))?)
}

fn unavailable_to_wire(map: &UnavailableMap) -> v1::UnavailableMap {
    v1::UnavailableMap { name: map.name.clone(), reason: map.reason.clone() }
}

#[tonic::async_trait]
impl MapService for Maps {
    async fn create_map(&self, request: Request<v1::CreateMapRequest>) -> RpcReply<v1::CreateMapResponse> {
        let now = self.catalog.context().clock.now_nanos();
        let spec = spec_from_request(request.into_inner(), now).map_err(RpcError::from)?;
        check_scope(spec.name.as_str())?;
        let handle = self.catalog.create(spec).await.map_err(RpcError::from)?;
        Ok(Response::new(v1::CreateMapResponse { map: Some(map_to_wire(&handle.view())) }))
    }

    async fn get_map(&self, request: Request<v1::GetMapRequest>) -> RpcReply<v1::GetMapResponse> {
        let handle = find_map(&self.catalog, &request.get_ref().name).await?;
        Ok(Response::new(v1::GetMapResponse { map: Some(map_to_wire(&handle.view())) }))
    }

    async fn list_maps(&self, request: Request<v1::ListMapsRequest>) -> RpcReply<v1::ListMapsResponse> {
        let request = request.into_inner();
        let (all, caller) = (self.catalog.all(), current_caller());
        let maps: Vec<_> = all.iter().filter(|(name, _)| caller.covers(name.as_str())).map(|(_, map)| map).collect();
        let page = page_from_wire(request.page_size, &request.page_token, 100, 1000).map_err(RpcError::from)?;
        let (range, next_page_token) = page.within(maps.len());
        let mut shown = Vec::with_capacity(range.len());
        for handle in maps.into_iter().skip(range.start).take(range.len()) {
            // A map that turns out to be unavailable meanwhile is among the unavailable maps.
            if let Err(error) = opened(handle).await {
                match self.catalog.get(handle.spec.name.as_str()) {
                    Err(CatalogError::Unavailable { .. }) => continue,
                    _ => return Err(error.into()),
                }
            }
            shown.push(map_to_wire(&handle.view()));
        }
        let unavailable = if next_page_token.is_empty() { self.catalog.unavailable() } else { Arc::default() };
        let unavailable = unavailable.iter().filter(|map| caller.covers(&map.name)).map(unavailable_to_wire);
        Ok(Response::new(v1::ListMapsResponse { maps: shown, next_page_token, unavailable: unavailable.collect() }))
    }

    async fn delete_map(&self, request: Request<v1::DeleteMapRequest>) -> RpcReply<v1::DeleteMapResponse> {
        let name = request.into_inner().name;
        // An unavailable map can be deleted as well, and so can a map that only other daemons hold.
        let unknown = match find_map(&self.catalog, &name).await {
            Ok(_) | Err(RpcError::Catalog(CatalogError::Unavailable { .. })) => None,
            Err(error @ RpcError::UnknownMap { .. }) => Some(error),
            Err(error) => return Err(error.into()),
        };
        match (self.catalog.delete(&name).await, unknown) {
            (Ok(()), _) => Ok(Response::new(v1::DeleteMapResponse {})),
            // This error lists the maps that exist.
            (Err(CatalogError::Unknown(_)), Some(unknown)) => Err(unknown.into()),
            (Err(error), _) => Err(RpcError::from(error).into()),
        }
    }

    async fn add_state(&self, request: Request<v1::AddStateRequest>) -> RpcReply<v1::AddStateResponse> {
        let request = request.into_inner();
        let handle = find_map(&self.catalog, &request.map).await?;
        let state = declared_state_from_wire(&request).map_err(RpcError::from)?;
        let (reply, answer) = oneshot::channel();
        let add = AddState { state, client: Client::current().share_name(), reply };
        let answer = if handle.send(Command::AddState(add)) { answer.await.ok() } else { None };
        answer.unwrap_or(Err(AddStateError::Closing)).map_err(RpcError::from)?;
        let view = handle.view();
        let state = view.shape(&request.state).and_then(|(id, _)| state_to_wire(&view, id));
        Ok(Response::new(v1::AddStateResponse { state }))
    }

    async fn list_states(&self, request: Request<v1::ListStatesRequest>) -> RpcReply<v1::ListStatesResponse> {
        let request = request.into_inner();
        let view = find_map(&self.catalog, &request.map).await?.view();
        let page = page_from_wire(request.page_size, &request.page_token, 1000, 10_000).map_err(RpcError::from)?;
        let (range, next_page_token) = page.within(view.len());
        let ids = range.filter_map(|index| u32::try_from(index).ok()).map(StateId);
        let states = ids.filter_map(|id| state_to_wire(&view, id)).collect();
        Ok(Response::new(v1::ListStatesResponse { states, next_page_token }))
    }

    async fn set_charger(&self, request: Request<v1::SetChargerRequest>) -> RpcReply<v1::SetChargerResponse> {
        let v1::SetChargerRequest { map, charger } = request.into_inner();
        let handle = find_map(&self.catalog, &map).await?;
        let at_m = charger.map(|at| point_from_wire("charger", at)).transpose().map_err(RpcError::from)?;
        if let Some(at_m) = at_m {
            check_on_grid(&handle.view(), "charger", at_m).map_err(RpcError::from)?;
        }
        edit_site(&handle, SiteEdit::Charger(at_m)).await?;
        Ok(Response::new(v1::SetChargerResponse {}))
    }

    async fn set_location(&self, request: Request<v1::SetLocationRequest>) -> RpcReply<v1::SetLocationResponse> {
        let v1::SetLocationRequest { map, location } = request.into_inner();
        let handle = find_map(&self.catalog, &map).await?;
        let NamedLocation { name, members, position_m } = location_from_wire(location).map_err(RpcError::from)?;
        let mut location = Location { position_m, ..Location::default() };
        for found in find_all(&handle.view(), |i| format!("location.states[{i}]"), members).await? {
            match found {
                StateOrCell::State(id) => location.states.push(id),
                StateOrCell::Cell(cell) => location.cells.push(cell.index),
            }
        }
        location.states.sort_unstable();
        location.cells.sort_unstable();
        edit_site(&handle, SiteEdit::SetLocation(name.clone(), location)).await?;
        let view = handle.view();
        let location = view.site().locations().get(&name).map(|set| location_to_wire(&view, &name, set));
        Ok(Response::new(v1::SetLocationResponse { location }))
    }

    async fn delete_location(
        &self,
        request: Request<v1::DeleteLocationRequest>,
    ) -> RpcReply<v1::DeleteLocationResponse> {
        let v1::DeleteLocationRequest { map, location } = request.into_inner();
        let handle = find_map(&self.catalog, &map).await?;
        let name = location_name_from_wire("location", &location).map_err(RpcError::from)?;
        edit_site(&handle, SiteEdit::RemoveLocation(name)).await?;
        Ok(Response::new(v1::DeleteLocationResponse {}))
    }

    async fn list_locations(&self, request: Request<v1::ListLocationsRequest>) -> RpcReply<v1::ListLocationsResponse> {
        let request = request.into_inner();
        let view = find_map(&self.catalog, &request.map).await?.view();
        let all = view.site().locations();
        let page = page_from_wire(request.page_size, &request.page_token, 100, 1000).map_err(RpcError::from)?;
        let (range, next_page_token) = page.within(all.len());
        let locations = all.iter().skip(range.start).take(range.len());
        let locations = locations.map(|(name, location)| location_to_wire(&view, name, location)).collect();
        Ok(Response::new(v1::ListLocationsResponse { locations, next_page_token }))
    }

    async fn set_no_go(&self, request: Request<v1::SetNoGoRequest>) -> RpcReply<v1::SetNoGoResponse> {
        let v1::SetNoGoRequest { map, area } = request.into_inner();
        let handle = find_map(&self.catalog, &map).await?;
        let (name, corners) = area_from_wire(area).map_err(RpcError::from)?;
        edit_site(&handle, SiteEdit::NoGo(NoGoEdit::Set(name, corners))).await?;
        Ok(Response::new(v1::SetNoGoResponse {}))
    }

    async fn delete_no_go(&self, request: Request<v1::DeleteNoGoRequest>) -> RpcReply<v1::DeleteNoGoResponse> {
        let v1::DeleteNoGoRequest { map, area } = request.into_inner();
        let handle = find_map(&self.catalog, &map).await?;
        let name = location_name_from_wire("area", &area).map_err(RpcError::from)?;
        edit_site(&handle, SiteEdit::NoGo(NoGoEdit::Remove(name))).await?;
        Ok(Response::new(v1::DeleteNoGoResponse {}))
    }

    async fn list_no_go(&self, request: Request<v1::ListNoGoRequest>) -> RpcReply<v1::ListNoGoResponse> {
        let view = find_map(&self.catalog, &request.get_ref().map).await?.view();
        let areas = view.site().no_go().iter().map(|(name, corners)| area_to_wire(name, corners)).collect();
        Ok(Response::new(v1::ListNoGoResponse { areas }))
    }
}
