//! `LandmarkService`: the landmarks of nodes and edges, which are visible when, and where a robot is by what it sees.
//!
//! Invariant: an edit is durable and published when it is answered; an answer is of one view.

use std::sync::Arc;

use tidemap_map::{
    landmark::{LandmarkEdit, LandmarkPlace, LandmarksAtPlace},
    landmark_forecast::PredictedLandmark,
    name::{PlaceName, StateName},
    sighting::PartOfEdge,
    site::SiteEdit,
    view::MapView,
};
use tidemap_model::selector::ModelSelector;
use tidemap_plan::localise::{ExpectedLandmark, MatchRules, NodeMatch, SeenFeatures, localise, most_probable};
use tidemap_proto::{
    convert::{
        InvalidField, OverLimit,
        landmarks::{
            feature_from_wire, landmark_from_wire, landmark_to_wire, node_match_to_wire, place_from_wire,
            place_to_wire, whole_place_from_wire,
        },
        time::instant_from_wire,
    },
    v1::{self, landmark_service_server::LandmarkService},
};
use tonic::{Request, Response};

use super::{Routes, places::find_node};
use crate::{
    ingest::handle::MapHandle,
    rpc::{
        RpcReply,
        lookup::find_map,
        map::edit_site,
        status::{RouteError, RpcError},
    },
};

/// Default number of sightings from which on a landmark counts as seldom seen.
const MIN_SIGHTINGS: u64 = 10;
/// Default number of landmarks of each node to compare.
const COMPARED: usize = 100;
/// Maximum number of nodes to compare.
const NODES_MAX: usize = 1_000;
/// Minimum number of features: the nearest is compared with the next.
const FEATURES_MIN: usize = 2;

fn count(length: usize) -> u32 {
    u32::try_from(length).unwrap_or(u32::MAX)
}

/// All landmarks of a part of a place at a time, in the order in which they were added.
fn predicted<'a>(
    view: &'a MapView,
    place: &PlaceName,
    part: PartOfEdge,
    time_nanos: i64,
) -> Result<Vec<PredictedLandmark<'a>>, RouteError> {
    Ok(view.predict_landmarks(place, part, &view.prepare(&[time_nanos]), ModelSelector::default())?)
}

/// Which of them are expected, the most probable first.
fn expected(landmarks: &[PredictedLandmark<'_>], max_count: usize) -> Vec<usize> {
    let numbers: Vec<_> = landmarks.iter().map(|landmark| [landmark.probability, landmark.mean]).collect();
    most_probable(&numbers, max_count)
}

async fn edit(handle: &MapHandle, edit: LandmarkEdit) -> Result<(), RpcError> {
    edit_site(handle, SiteEdit::Landmarks(edit)).await
}

/// The landmarks of a place that were in view often enough, and hardly ever seen.
fn seldom_seen(view: &MapView, place: &PlaceName, which: &v1::SeldomSeen) -> Result<Vec<StateName>, RouteError> {
    let min_sightings = if which.min_sightings == 0 { MIN_SIGHTINGS } else { which.min_sightings };
    let landmarks = predicted(view, place, PartOfEdge::WHOLE, 0)?;
    let is_seldom = |known: &&PredictedLandmark<'_>| known.sightings >= min_sightings && known.mean < which.below;
    Ok(landmarks.iter().filter(is_seldom).map(|known| known.landmark.name.clone()).collect())
}

fn all_places(view: &MapView) -> Vec<(PlaceName, LandmarkPlace, Arc<LandmarksAtPlace>)> {
    let topology = view.site().topology();
    let named = |(at, known): (LandmarkPlace, &Arc<LandmarksAtPlace>)| {
        Some((topology.place_name(at).ok()?, at, Arc::clone(known)))
    };
    view.site().landmarks().places().filter_map(named).collect()
}

fn names_from_wire(names: &[String]) -> Result<Vec<StateName>, InvalidField> {
    let name = |(number, name): (usize, &String)| {
        StateName::new(name).map_err(|error| InvalidField::new(format!("names[{number}]"), error))
    };
    names.iter().enumerate().map(name).collect()
}

/// What a request removes, by place.
fn to_remove(
    view: &MapView,
    request: &v1::RemoveLandmarksRequest,
) -> Result<Vec<(PlaceName, Vec<StateName>)>, RpcError> {
    let v1::RemoveLandmarksRequest { place, names, seldom_seen: which, .. } = request;
    let places = match place {
        Some(place) => vec![whole_place_from_wire("place", Some(place))?],
        None if which.is_none() => return Err(InvalidField::new("place", "missing: name a node, or an edge").into()),
        None => all_places(view).into_iter().map(|(place, ..)| place).collect(),
    };
    match (which, names.is_empty()) {
        (Some(which), true) => {
            if !(which.below > 0.0 && which.below <= 1.0) {
                let text = format!("{}: it must be above 0 and at most 1", which.below);
                return Err(InvalidField::new("seldom_seen.below", text).into());
            }
            let of_place = |place: PlaceName| {
                let names = seldom_seen(view, &place, which)?;
                Ok((place, names))
            };
            let found = places.into_iter().map(of_place).collect::<Result<Vec<_>, RouteError>>()?;
            Ok(found.into_iter().filter(|(_, names)| !names.is_empty()).collect())
        }
        (None, false) => {
            let names = names_from_wire(names)?;
            Ok(places.into_iter().map(|place| (place, names.clone())).collect())
        }
        _ => Err(InvalidField::new("names", "name landmarks, or say seldom_seen: one of the two").into()),
    }
}

/// A request to localise, checked.
struct LocaliseQuestion {
    time_nanos: i64,
    seen: SeenFeatures,
    per_node: usize,
    nodes: Vec<PlaceName>,
}

impl LocaliseQuestion {
    fn new(view: &MapView, request: v1::LocaliseRequest) -> Result<LocaliseQuestion, RpcError> {
        let v1::LocaliseRequest { map, time, features, landmarks_per_node, nodes } = request;
        let time_nanos = instant_from_wire("time", time)?;
        if features.len() < FEATURES_MIN {
            let text =
                format!("{}: at least {FEATURES_MIN} features are needed, to tell which is nearest", features.len());
            return Err(InvalidField::new("features", text).into());
        }
        let feature = |(number, wire): (usize, &v1::ImageFeature)| {
            feature_from_wire(wire).map_err(|error| InvalidField::new(format!("features[{number}]"), error))
        };
        let features = features.iter().enumerate().map(feature).collect::<Result<Vec<_>, InvalidField>>()?;
        if let Some(wrong) = features.iter().position(|feature| !(feature.u_px.is_finite() && feature.v_px.is_finite()))
        {
            return Err(InvalidField::new(format!("features[{wrong}]"), "u_px and v_px must be numbers").into());
        }
        let seen = SeenFeatures::new(features).map_err(RouteError::from)?;
        let mut named = Vec::with_capacity(nodes.len());
        for node in &nodes {
            find_node(&map, view.site().topology(), node)?;
            let name = StateName::new(node).map_err(|error| InvalidField::new("nodes", error))?;
            named.push(PlaceName::Node(name));
        }
        if named.is_empty() {
            let has_images =
                |known: &LandmarksAtPlace| known.landmarks().iter().any(|landmark| landmark.kind.feature().is_some());
            let places = all_places(view).into_iter();
            let nodes = places.filter(|(_, at, known)| matches!(at, LandmarkPlace::Node(_)) && has_images(known));
            named = nodes.map(|(place, ..)| place).collect();
            if named.is_empty() {
                return Err(RouteError::NoLandmarks(map).into());
            }
            if named.len() > NODES_MAX {
                let text = format!("{} nodes have landmarks: name at most {NODES_MAX} of them", named.len());
                return Err(InvalidField::new("nodes", text).into());
            }
        }
        let per_node = if landmarks_per_node == 0 { COMPARED } else { landmarks_per_node as usize };
        Ok(LocaliseQuestion { time_nanos, seen, per_node, nodes: named })
    }

    fn answer(&self, view: &MapView, predictions_max: u64) -> Result<v1::LocaliseResponse, RpcError> {
        let at = |node| view.landmarks_at(node).ok().flatten().map_or(0, |known| known.landmarks().len());
        let max = usize::try_from(predictions_max).unwrap_or(usize::MAX);
        let what = "landmarks of the nodes of one request";
        OverLimit::check(what, self.nodes.iter().map(at).sum(), max, "setting max_predictions")?;
        let times = view.prepare(&[self.time_nanos]);
        let mut compared: Vec<Vec<ExpectedLandmark>> = Vec::with_capacity(self.nodes.len());
        for node in &self.nodes {
            let landmarks = view.predict_landmarks(node, PartOfEdge::WHOLE, &times, ModelSelector::default());
            let mut landmarks = landmarks.map_err(RouteError::from)?;
            landmarks.retain(|known| known.landmark.kind.feature().is_some());
            let landmark = |number: usize| {
                let known = landmarks.get(number)?;
                Some(ExpectedLandmark { feature: *known.landmark.kind.feature()?, visible: known.probability })
            };
            compared.push(expected(&landmarks, self.per_node).into_iter().filter_map(landmark).collect());
        }
        let found = localise(&self.seen, &compared, &MatchRules::default()).map_err(RouteError::from)?;
        let mut order: Vec<usize> = (0..found.len()).collect();
        let key = |number: &usize| found.get(*number).map(NodeMatch::rank);
        order.sort_by(|a, b| key(b).cmp(&key(a)));
        let node = |number: usize| {
            let (place, landmarks, found) = (self.nodes.get(number)?, compared.get(number)?, found.get(number)?);
            Some(node_match_to_wire(place.to_string(), landmarks.len(), found))
        };
        Ok(v1::LocaliseResponse { nodes: order.into_iter().filter_map(node).collect() })
    }
}

#[tonic::async_trait]
impl LandmarkService for Routes {
    async fn add_landmarks(&self, request: Request<v1::AddLandmarksRequest>) -> RpcReply<v1::AddLandmarksResponse> {
        let request = request.into_inner();
        let handle = find_map(&self.catalog, &request.map).await?;
        let add = move || {
            let v1::AddLandmarksRequest { place, landmarks, descriptor_kind, velocity_profile, .. } = &request;
            let place = whole_place_from_wire("place", place.as_ref())?;
            let landmark = |(number, landmark)| landmark_from_wire(&format!("landmarks[{number}]"), landmark);
            let landmarks = landmarks.iter().enumerate().map(landmark).collect::<Result<Vec<_>, InvalidField>>()?;
            let (descriptor_kind, profile) = (descriptor_kind.clone(), velocity_profile.clone());
            let velocity_profile = profile.map(Vec::into_boxed_slice);
            Ok::<_, InvalidField>(LandmarkEdit::Add { place, descriptor_kind, landmarks, velocity_profile })
        };
        let add = self.run_blocking(add).await?.map_err(RpcError::from)?;
        let (LandmarkEdit::Add { place, .. } | LandmarkEdit::Remove { place, .. }) = &add;
        let place = place.clone();
        edit(&handle, add).await?;
        let view = handle.view();
        let at_place = view.landmarks_at(&place).ok().flatten().map_or(0, |known| known.landmarks().len());
        let in_map = count(view.site().landmarks().len());
        Ok(Response::new(v1::AddLandmarksResponse { at_place: count(at_place), in_map }))
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
                let counted =
                    |(place, _, known): (PlaceName, LandmarkPlace, Arc<LandmarksAtPlace>)| v1::LandmarkCount {
                        place: Some(place_to_wire(&place, PartOfEdge::WHOLE)),
                        landmarks: count(known.landmarks().len()),
                    };
                reply.places = all_places(&view).into_iter().map(counted).collect();
                return Ok(reply);
            };
            let landmarks = predicted(&view, &place, part, 0)?;
            reply.landmarks = landmarks
                .iter()
                .map(|known| v1::KnownLandmark {
                    landmark: Some(landmark_to_wire(known.landmark)),
                    seen_share: known.mean,
                    sightings: known.sightings,
                })
                .collect();
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
        let found = self.run_blocking(move || to_remove(&view, &request)).await??;
        let mut removed = Vec::with_capacity(found.len());
        for (place, names) in found {
            removed.push(v1::RemovedLandmarks {
                place: Some(place_to_wire(&place, PartOfEdge::WHOLE)),
                names: names.iter().map(|name| name.as_str().to_owned()).collect(),
            });
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
            let wire = |number: usize| {
                let known = landmarks.get(number)?;
                let landmark = Some(landmark_to_wire(known.landmark));
                Some(v1::PredictedLandmark { landmark, probability: known.probability, sightings: known.sightings })
            };
            let known = count(landmarks.len());
            let landmarks = expected(&landmarks, max_count).into_iter().filter_map(wire).collect();
            Ok::<_, RouteError>(v1::PredictLandmarksResponse { landmarks, known })
        };
        Ok(Response::new(self.run_blocking(predict).await?.map_err(RpcError::from)?))
    }

    async fn localise(&self, request: Request<v1::LocaliseRequest>) -> RpcReply<v1::LocaliseResponse> {
        let request = request.into_inner();
        let view = find_map(&self.catalog, &request.map).await?.view();
        let predictions_max = self.predictions;
        let localise = move || LocaliseQuestion::new(&view, request)?.answer(&view, predictions_max);
        Ok(Response::new(self.run_blocking(localise).await??))
    }
}
