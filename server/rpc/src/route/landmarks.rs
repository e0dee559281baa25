//! `LandmarkService`: the landmarks of nodes and edges, which of them are visible when, and the position of a robot
//! from its features.
//!
//! Invariant: an edit is durable and published when it is answered; an answer is of one view.

use std::{cmp::Reverse, sync::Arc};

use tidemap_ingest::handle::MapHandle;
use tidemap_map::{
    landmark::{LandmarkEdit, LandmarkPlace, LandmarksAtPlace},
    landmark_forecast::PredictedLandmark,
    name::{PlaceName, StateName},
    sighting::PartOfEdge,
    site::SiteEdit,
    view::MapView,
};
use tidemap_model::selector::ModelSelector;
use tidemap_plan::localise::{ExpectedLandmark, MatchRules, NodeMatch, localise, most_probable};
use tidemap_proto::{
    convert::{
        OverLimit,
        landmarks::{
            LandmarkRemoval, LocaliseQuestion, addition_from_wire, known_landmark_to_wire, landmark_count_to_wire,
            landmark_number_to_wire, localise_from_wire, node_match_to_wire, place_from_wire,
            predicted_landmark_to_wire, removal_from_wire, removed_landmarks_to_wire,
        },
        time::instant_from_wire,
    },
    v1::{self, landmark_service_server::LandmarkService},
};
use tonic::{Request, Response};

use super::{Routes, places::find_node};
use crate::{
    RpcReply,
    lookup::find_map,
    map::edit_site,
    status::{RouteError, RpcError},
};

/// Maximum number of comparisons of a feature with a landmark in one request: less than a second of work.
const COMPARISONS_MAX: usize = 1 << 27;
/// Maximum number of nodes to compare.
const NODES_MAX: usize = 1_000;

/// All landmarks of a part of a place at a time, in the order in which they were added.
fn predicted<'a>(
    view: &'a MapView,
    place: &PlaceName,
    part: PartOfEdge,
    time_nanos: i64,
) -> Result<Vec<PredictedLandmark<'a>>, RouteError> {
    Ok(view.predict_landmarks(place, part, &view.prepare(&[time_nanos]), ModelSelector::default())?)
}

/// The indices of the expected landmarks, the most probable first.
fn expected(landmarks: &[PredictedLandmark<'_>], max_count: usize) -> Vec<usize> {
    let numbers: Vec<_> = landmarks.iter().map(|landmark| [landmark.probability, landmark.mean]).collect();
    most_probable(&numbers, max_count)
}

async fn edit(handle: &MapHandle, edit: LandmarkEdit) -> Result<(), RpcError> {
    edit_site(handle, SiteEdit::Landmarks(edit)).await
}

/// The landmarks of a place that were in view often enough, but were hardly ever seen.
fn seldom_seen(
    view: &MapView,
    place: &PlaceName,
    below: f64,
    min_sightings: u64,
) -> Result<Vec<StateName>, RouteError> {
    let landmarks = predicted(view, place, PartOfEdge::WHOLE, 0)?;
    let is_seldom = |known: &&PredictedLandmark<'_>| known.learned >= min_sightings.max(1) && known.mean < below;
    Ok(landmarks.iter().filter(is_seldom).map(|known| known.landmark.name.clone()).collect())
}

fn all_places(view: &MapView) -> Vec<(PlaceName, LandmarkPlace, Arc<LandmarksAtPlace>)> {
    let topology = view.site().topology();
    let named = |(at, known): (LandmarkPlace, &Arc<LandmarksAtPlace>)| {
        Some((topology.place_name(at).ok()?, at, Arc::clone(known)))
    };
    view.site().landmarks().places().filter_map(named).collect()
}

/// The landmarks that a request removes, by place.
fn to_remove(view: &MapView, removal: LandmarkRemoval) -> Result<Vec<(PlaceName, Vec<StateName>)>, RouteError> {
    let (place, below, min_sightings) = match removal {
        LandmarkRemoval::Named(place, names) => return Ok(vec![(place, names)]),
        LandmarkRemoval::SeldomSeen { place, below, min_sightings } => (place, below, min_sightings),
    };
    let places = match place {
        Some(place) => vec![place],
        None => all_places(view).into_iter().map(|(place, ..)| place).collect(),
    };
    let seldom = |place: PlaceName| {
        let names = seldom_seen(view, &place, below, min_sightings)?;
        Ok((place, names))
    };
    let found = places.into_iter().map(seldom).collect::<Result<Vec<_>, RouteError>>()?;
    Ok(found.into_iter().filter(|(_, names)| !names.is_empty()).collect())
}

/// The nodes at which the robot may be: those of the question, or all with image features.
fn requested_nodes(view: &MapView, map: &str, nodes: Vec<PlaceName>) -> Result<Vec<PlaceName>, RouteError> {
    if !nodes.is_empty() {
        let known = |node: &PlaceName| find_node(map, view.site().topology(), &node.to_string()).map(drop);
        nodes.iter().try_for_each(known)?;
        return Ok(nodes);
    }
    let has_images =
        |known: &LandmarksAtPlace| known.landmarks().iter().any(|landmark| landmark.kind.feature().is_some());
    let is_requested =
        |at: &LandmarkPlace, known: &LandmarksAtPlace| matches!(at, LandmarkPlace::Node(_)) && has_images(known);
    let nodes = all_places(view).into_iter().filter(|(_, at, known)| is_requested(at, known));
    let nodes: Vec<PlaceName> = nodes.map(|(place, ..)| place).collect();
    match nodes.len() {
        0 => Err(RouteError::NoLandmarks(map.to_owned())),
        1..=NODES_MAX => Ok(nodes),
        found => Err(RouteError::TooManyNodes { found, max: NODES_MAX }),
    }
}

/// Compares the features with the landmarks that are expected at each node.
fn found(
    view: &MapView,
    map: &str,
    question: LocaliseQuestion,
    predictions_max: u64,
) -> Result<v1::LocaliseResponse, RpcError> {
    let LocaliseQuestion { time_nanos, seen, per_node, nodes } = question;
    let nodes = requested_nodes(view, map, nodes)?;
    let at = |node| view.landmarks_at(node).ok().flatten().map_or(0, |known| known.landmarks().len());
    let max = usize::try_from(predictions_max).unwrap_or(usize::MAX);
    let what = "landmarks of the nodes of one request";
    OverLimit::check(what, nodes.iter().map(at).sum(), max, "setting max_predictions")?;
    let compared_at = |node| per_node.min(at(node));
    let comparisons = nodes.iter().map(compared_at).sum::<usize>().saturating_mul(seen.len());
    OverLimit::check("comparisons of features with landmarks", comparisons, COMPARISONS_MAX, "the protocol")?;
    let times = view.prepare(&[time_nanos]);
    let mut compared: Vec<Vec<ExpectedLandmark>> = Vec::with_capacity(nodes.len());
    for node in &nodes {
        let landmarks = view.predict_landmarks(node, PartOfEdge::WHOLE, &times, ModelSelector::default());
        let mut landmarks = landmarks.map_err(RouteError::from)?;
        landmarks.retain(|known| known.landmark.kind.feature().is_some());
        let landmark = |number: usize| {
            let known = landmarks.get(number)?;
            Some(ExpectedLandmark { feature: *known.landmark.kind.feature()?, visible: known.probability })
        };
        compared.push(expected(&landmarks, per_node).into_iter().filter_map(landmark).collect());
    }
    let found = localise(&seen, &compared, &MatchRules::default()).map_err(RouteError::from)?;
    let mut order: Vec<usize> = (0..found.len()).collect();
    order.sort_by_key(|number| Reverse(found.get(*number).map(NodeMatch::rank)));
    let node = |number: usize| {
        let (place, landmarks, found) = (nodes.get(number)?, compared.get(number)?, found.get(number)?);
        Some(node_match_to_wire(place.to_string(), landmarks.len(), found))
    };
    Ok(v1::LocaliseResponse { nodes: order.into_iter().filter_map(node).collect() })
}

#[tonic::async_trait]
impl LandmarkService for Routes {
    async fn add_landmarks(&self, request: Request<v1::AddLandmarksRequest>) -> RpcReply<v1::AddLandmarksResponse> {
        let request = request.into_inner();
        let handle = find_map(&self.catalog, &request.map).await?;
        let add = self.run_blocking(move || addition_from_wire(&request)).await?.map_err(RpcError::from)?;
        let (LandmarkEdit::Add { place, .. } | LandmarkEdit::Remove { place, .. }) = &add;
        let place = place.clone();
        edit(&handle, add).await?;
        let view = handle.view();
        let at_place = view.landmarks_at(&place).ok().flatten().map_or(0, |known| known.landmarks().len());
        let [at_place, in_map] = [at_place, view.site().landmarks().len()].map(landmark_number_to_wire);
        Ok(Response::new(v1::AddLandmarksResponse { at_place, in_map }))
    }

    async fn list_landmarks(&self, request: Request<v1::ListLandmarksRequest>) -> RpcReply<v1::ListLandmarksResponse> {
        let v1::ListLandmarksRequest { map, place } = request.into_inner();
        let view = find_map(&self.catalog, &map).await?.view();
        let place = place.map(|place| place_from_wire("place", Some(&place))).transpose().map_err(RpcError::from)?;
        let list = move || {
            let kind = view.site().landmarks().descriptor_kind();
            let descriptor_kind = kind.map_or_else(String::new, |kind| kind.name.clone());
            let mut reply = v1::ListLandmarksResponse { descriptor_kind, ..v1::ListLandmarksResponse::default() };
            let Some((place, part)) = place else {
                let places = all_places(&view);
                let counts = places.iter().map(|(place, _, known)| (place, known.landmarks().len()));
                reply.places = counts.map(|(place, count)| landmark_count_to_wire(place, count)).collect();
                return Ok(reply);
            };
            let landmarks = predicted(&view, &place, part, 0)?;
            reply.landmarks = landmarks.iter().map(known_landmark_to_wire).collect();
            let known = view.landmarks_at(&place).ok().flatten();
            reply.velocity_profile = known.map_or_else(Vec::new, |known| known.velocity_profile().to_vec());
            Ok::<_, RouteError>(reply)
        };
        Ok(Response::new(self.run_blocking(list).await?.map_err(RpcError::from)?))
    }

    async fn remove_landmarks(
        &self,
        request: Request<v1::RemoveLandmarksRequest>,
    ) -> RpcReply<v1::RemoveLandmarksResponse> {
        let request = request.into_inner();
        let handle = find_map(&self.catalog, &request.map).await?;
        let (view, is_dry_run) = (handle.view(), request.dry_run);
        let removal = removal_from_wire(&request).map_err(RpcError::from)?;
        let found = self.run_blocking(move || to_remove(&view, removal)).await?.map_err(RpcError::from)?;
        let mut removed = Vec::with_capacity(found.len());
        for (place, names) in found {
            removed.push(removed_landmarks_to_wire(&place, &names));
            if !is_dry_run {
                edit(&handle, LandmarkEdit::Remove { place, names }).await?;
            }
        }
        Ok(Response::new(v1::RemoveLandmarksResponse { removed }))
    }

    async fn predict_landmarks(
        &self,
        request: Request<v1::PredictLandmarksRequest>,
    ) -> RpcReply<v1::PredictLandmarksResponse> {
        let v1::PredictLandmarksRequest { map, place, time, limit } = request.into_inner();
        let view = find_map(&self.catalog, &map).await?.view();
        let (place, part) = place_from_wire("place", place.as_ref()).map_err(RpcError::from)?;
        let time_nanos = instant_from_wire("time", time).map_err(RpcError::from)?;
        let predict = move || {
            let landmarks = predicted(&view, &place, part, time_nanos)?;
            let max_count = if limit == 0 { usize::MAX } else { limit as usize };
            let wire = |number: usize| landmarks.get(number).map(predicted_landmark_to_wire);
            let known = landmark_number_to_wire(landmarks.len());
            let landmarks = expected(&landmarks, max_count).into_iter().filter_map(wire).collect();
            Ok::<_, RouteError>(v1::PredictLandmarksResponse { landmarks, known })
        };
        Ok(Response::new(self.run_blocking(predict).await?.map_err(RpcError::from)?))
    }

    async fn localise(&self, request: Request<v1::LocaliseRequest>) -> RpcReply<v1::LocaliseResponse> {
        let request = request.into_inner();
        let view = find_map(&self.catalog, &request.map).await?.view();
        let predictions_max = self.predictions;
        let localise = move || found(&view, &request.map, localise_from_wire(&request)?, predictions_max);
        Ok(Response::new(self.run_blocking(localise).await??))
    }
}
