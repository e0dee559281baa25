//! `GetInformation`: the entropy of states, locations and regions, and the expected information of an observation.
//!
//! Invariant: replies come in the order of states, locations, region; each has a number per time.

use std::sync::Arc;

use tidemap_answer::StateOrCell;
use tidemap_map::{name::StateName, view::MapView};
use tidemap_model::{
    StopSignal,
    label_evidence::{entropy_of_labels_bits, normalise},
};
use tidemap_plan::{
    information::{Certainty, entropy_of},
    predicted::{PredictError, PredictOptions, PredictedTimes},
};
use tidemap_proto::{
    convert::exploration::{
        InformationQuestion, InformationTargets, TargetInformation, information_from_wire, information_to_wire,
    },
    v1,
};

use super::{Explorations, locations::find_members};
use crate::{
    lookup::{check_kind, check_limit, find_all, find_map},
    permits::run_blocking,
    replies::{Replies, compute_replies, stream_replies},
    series::predict_series,
    status::{PlanError, RpcError},
};

/// Maximum number of targets of one request.
const TARGETS_MAX: usize = 10_000;

/// A target whose information is requested.
struct Target {
    name: String,
    states: Vec<StateOrCell>,
    /// Whether the states are the labels of one categorical state.
    are_labels: bool,
}

fn of_target(
    Target { name: target, are_labels, .. }: &Target,
    rows: &[Vec<f64>],
    times: usize,
    certainty: Certainty,
) -> TargetInformation {
    if *are_labels {
        let shares = |time: usize| {
            let mut shares: Vec<f64> = rows.iter().map(|row| row[time]).collect();
            normalise(&mut shares);
            shares
        };
        return TargetInformation {
            target: target.clone(),
            entropy_bits: (0..times).map(|time| entropy_of_labels_bits(&shares(time))).collect(),
            information_bits: (0..times).map(|time| certainty.bits_of_labels(&shares(time))).collect(),
            states: rows.len() as u64,
        };
    }
    let at = |time: usize| rows.iter().map(move |row| row[time]);
    TargetInformation {
        target: target.clone(),
        entropy_bits: (0..times).map(|time| entropy_of(at(time))).collect(),
        information_bits: (0..times).map(|time| certainty.bits_of(at(time))).collect(),
        states: rows.len() as u64,
    }
}

/// The information of all observed cells of a region.
fn of_region(
    view: &MapView,
    times_nanos: &[i64],
    options: &PredictOptions,
    (certainty, max_predictions): (Certainty, u64),
    stop: StopSignal<'_>,
) -> Result<TargetInformation, RpcError> {
    let grid = PredictedTimes::new(view, times_nanos, options, stop).map_err(PlanError::from)?;
    let cells = grid.lattice().size().iter().map(|&along| along as u64).product::<u64>();
    check_limit("cells x times", cells * times_nanos.len() as u64, max_predictions, "setting max_predictions")?;
    let mut found = TargetInformation { target: "region".to_owned(), ..TargetInformation::default() };
    for time in 0..grid.times() {
        stop.check()?;
        let Some(grid) = grid.at(time) else { break };
        let known = || grid.known().map(f64::from);
        found.states = known().count() as u64;
        found.entropy_bits.push(entropy_of(known()));
        found.information_bits.push(certainty.bits_of(known()));
    }
    Ok(found)
}

pub(super) async fn get_information(
    explorations: &Explorations,
    request: v1::GetInformationRequest,
) -> Result<Replies<v1::GetInformationResponse>, RpcError> {
    let handle = find_map(&explorations.catalog, &request.map).await?;
    let InformationQuestion { times_nanos, selector, certainty, targets } = information_from_wire(request)?;
    match targets {
        InformationTargets::Region(region) => {
            let options = PredictOptions { selector, region: Some(region), ..explorations.predict_options() };
            send_region(explorations, handle.view(), times_nanos, options, certainty).await
        }
        InformationTargets::Named { states, locations } => {
            let view = handle.view();
            let targets = named_targets(&view, states, &locations, explorations.limits.predictions).await?;
            let all = targets.iter().map(|target| target.states.len() as u64).sum::<u64>();
            let (predictions, max) = (all * times_nanos.len() as u64, explorations.limits.predictions);
            check_limit("predictions", predictions, max, "setting max_predictions")?;
            let shared = explorations.clone();
            Ok(stream_replies(move |sink| async move {
                for target in targets {
                    let wanted = (target.states.clone(), times_nanos.clone());
                    let rows = tokio::select! {
                        () = sink.closed() => return Ok(()),
                        rows = predict_series(shared.predict_context(), &handle, &view, wanted, selector) => rows?,
                    };
                    let answer = information_to_wire(of_target(&target, &rows, times_nanos.len(), certainty));
                    let to = sink.clone();
                    if !run_blocking((), move || to.send(answer)).await? {
                        break;
                    }
                }
                Ok(())
            }))
        }
    }
}

/// The information of a region, in one reply.
async fn send_region(
    explorations: &Explorations,
    view: Arc<MapView>,
    times_nanos: Vec<i64>,
    options: PredictOptions,
    certainty: Certainty,
) -> Result<Replies<v1::GetInformationResponse>, RpcError> {
    view.grid().ok_or(PlanError::from(PredictError::NoGrid))?;
    Explorations::check_grid_times(&times_nanos)?;
    let max = explorations.limits.predictions;
    let permit = explorations.permits.take().await?;
    Ok(compute_replies(vec![permit], move |sink| {
        let is_left = || sink.is_closed();
        let stop = StopSignal::new(&is_left);
        sink.send(information_to_wire(of_region(&view, &times_nanos, &options, (certainty, max), stop)?));
        Ok(())
    }))
}

/// The targets in the order of states and locations: the name of each, with its states and cells.
async fn named_targets(
    view: &Arc<MapView>,
    states: Vec<String>,
    locations: &[StateName],
    max: u64,
) -> Result<Vec<Target>, RpcError> {
    check_limit("targets", (states.len() + locations.len()) as u64, TARGETS_MAX as u64, "one request")?;
    let mut targets = Vec::with_capacity(states.len() + locations.len());
    for (i, name) in states.into_iter().enumerate() {
        let labels = view.labels(&name);
        if !labels.is_empty() {
            let states = labels.into_iter().map(|(id, _)| StateOrCell::State(id)).collect();
            targets.push(Target { name, states, are_labels: true });
            continue;
        }
        let states = find_all(view, move |_| format!("states[{i}]"), vec![name.clone()]).await?;
        if let [StateOrCell::State(id)] = states[..] {
            check_kind(view, id, &format!("states[{i}]"))?;
        }
        targets.push(Target { name, states, are_labels: false });
    }
    let of_locations = find_members(view, locations, max).await?;
    let names = locations.iter().map(|name| name.as_str().to_owned());
    targets.extend(names.zip(of_locations).map(|(name, states)| Target { name, states, are_labels: false }));
    Ok(targets)
}
