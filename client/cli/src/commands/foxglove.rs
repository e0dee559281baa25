//! `tidemap foxglove`: a server for the program Foxglove, whose time bar then reaches from the first observation of a
//! map into the future.
//!
//! Invariant: it answers reads only. Other machines reach it only with `--allow-insecure-remote`.

#[cfg(any(feature = "foxglove", test))]
mod playback;
#[cfg(feature = "foxglove")]
mod server;

use std::{net::IpAddr, process::ExitCode};

use clap::Args;
use tidemap_client::{clock, queries::ModelSelector};
use tidemap_model::time::format_rfc3339;

use super::{
    Session,
    export::frames::FrameOptions,
    grid::place::{AxisRange, Rectangle},
    predict::names,
    times, usage,
};
use crate::progress::status_line;

/// Maximum number of states, each of which is a channel.
const STATES_MAX: usize = 1_000;
/// A map without observations of states begins this long before its last update.
const UNKNOWN_PAST_NANOS: i64 = 28 * 86_400_000_000_000;
/// The number of states whose first observation is requested.
const ASKED_STATES: usize = 100;
/// Confidence of the intervals of states.
const INTERVAL: f64 = 0.9;

#[derive(Debug, Args)]
pub(crate) struct FoxgloveArgs {
    /// Name of the map [default: the only one]
    map: Option<String>,
    /// Port to listen on; 0 for any that is free
    #[arg(long, default_value_t = 8765)]
    port: u16,
    /// Address to listen on; another than one of this machine alone needs --allow-insecure-remote
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1")]
    listen: IpAddr,
    /// Listen where other machines reach the server: they then see the map, because there is neither a key nor
    /// encryption
    #[arg(long)]
    allow_insecure_remote: bool,
    /// Beginning of the time bar [default: the first observation]
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    from: Option<i64>,
    /// Length of the time bar after now
    #[arg(long, value_name = "DURATION", value_parser = times::duration, default_value = "7d")]
    ahead: i64,
    /// Name or pattern of states to show, such as 'door-*'; may be repeated [default: all]
    #[arg(long = "state", value_name = "STATE")]
    states: Vec<String>,
    /// Model, as in `predict` [default: auto]
    #[arg(long, value_name = "KIND")]
    model: Option<ModelSelector>,
    /// Only cells between these heights, metres [default: 0.1:1.8, if the grid has cells there]
    #[arg(long, value_name = "MIN:MAX", allow_hyphen_values = true)]
    z: Option<AxisRange>,
    /// Only cells in this rectangle, metres
    #[arg(long, value_name = "X0:X1,Y0:Y1", allow_hyphen_values = true)]
    region: Option<Rectangle>,
}

/// The data that is served.
#[derive(Clone, Debug)]
#[cfg_attr(not(feature = "foxglove"), expect(dead_code, reason = "the server is left out of this build"))]
struct Served {
    options: FrameOptions,
    /// Names of states.
    states: Vec<String>,
    /// The frame of the map.
    frame: String,
    /// First and last time of the time bar, nanoseconds UTC.
    range_nanos: (i64, i64),
    address: (IpAddr, u16),
}

pub(crate) async fn run(session: &Session, args: FoxgloveArgs) -> anyhow::Result<ExitCode> {
    if !args.listen.is_loopback() && !args.allow_insecure_remote {
        return Err(usage(format!(
            "--listen {}: all who reach the server see the map, because there is neither a key nor encryption. Use a \
             tunnel (ssh -L), or add --allow-insecure-remote",
            args.listen
        )));
    }
    let name = match &args.map {
        Some(name) => name.clone(),
        None => only_map(session).await?,
    };
    let map = session.client.map(&name).await?;
    let states = match args.states.is_empty() {
        true => names::all(session, &name).await?,
        false => names::meant(session, &name, args.states).await?,
    };
    if states.len() > STATES_MAX {
        let count = states.len();
        return Err(usage(format!("{count} states, and at most {STATES_MAX} are shown: choose some with --state")));
    }
    let now = clock::now_nanos();
    let from = match args.from {
        Some(from) => from,
        None => first_observation(session, &name, &states)
            .await?
            .or(map.last_update.cut_nanos.map(|cut| cut.saturating_sub(UNKNOWN_PAST_NANOS)))
            .or(map.created_nanos)
            .unwrap_or(now),
    };
    let to = now.saturating_add(args.ahead);
    if from < 0 || from >= to {
        return Err(usage(format!(
            "the time bar would begin at {}: --from has to be in 1970 or later, and before its end",
            format_rfc3339(from)
        )));
    }
    if !args.listen.is_loopback() {
        status_line(&format!(
            "warning: all who reach {} see map {name:?}: this server has no key and no encryption",
            args.listen
        ));
    }
    let options = FrameOptions {
        map: name,
        model: args.model.unwrap_or_default(),
        region: args.region,
        z: args.z,
        speed_m_per_s: None,
        recovery_secs: 60.0,
        interval: INTERVAL,
    };
    let frame = map.grid.map_or_else(|| "map".to_owned(), |grid| grid.frame_id);
    let served = Served { options, states, frame, range_nanos: (from, to), address: (args.listen, args.port) };
    serve(session, served).await
}

#[cfg(feature = "foxglove")]
async fn serve(session: &Session, served: Served) -> anyhow::Result<ExitCode> {
    server::run(session, served).await
}

#[cfg(not(feature = "foxglove"))]
async fn serve(_session: &Session, served: Served) -> anyhow::Result<ExitCode> {
    drop(served);
    Err(usage("this tidemap was built without the feature foxglove: build it with --features foxglove"))
}

/// The map that is meant where none is named.
async fn only_map(session: &Session) -> anyhow::Result<String> {
    let maps = session.client.maps().await?;
    match maps.as_slice() {
        [map] => Ok(map.name.clone()),
        [] => Err(usage("there is no map: tidemap map create NAME makes one")),
        [first, second, ..] => Err(usage(format!(
            "there are {} maps, such as {:?} and {:?}: name one",
            maps.len(),
            first.name,
            second.name
        ))),
    }
}

/// The first observation time of a map's states, over the first states; `None`: there are no such observations.
async fn first_observation(session: &Session, map: &str, states: &[String]) -> anyhow::Result<Option<i64>> {
    let mut first: Option<i64> = None;
    for state in states.iter().take(ASKED_STATES) {
        // A vector has no model of its own, only its axes have.
        let Ok(model) = session.client.describe_model(map, state).await else { continue };
        first = first.into_iter().chain(model.first_nanos).min();
    }
    Ok(first)
}
