//! `tidemap info`.
//!
//! Invariant: one row per target and time, by target and then by time; areas of the grid by time and then by their
//! information gain.

mod areas;

use std::process::ExitCode;

use clap::Args;
use tidemap_client::{
    exploration::{Sensor, Targets, View, Viewpoint},
    queries::ModelSelector,
};

use super::{Session, point::ViewArg, times};
use tidemap_formats::table::Cell;

#[derive(Debug, Args)]
pub(crate) struct InfoArgs {
    /// Name of the map
    map: String,
    /// Times, separated by commas
    #[arg(long, value_name = "TIME,…", value_parser = times::time, value_delimiter = ',', required = true)]
    at: Vec<i64>,
    /// States that are probabilities or categorical, or cells cell/X/Y/Z
    #[arg(long = "state", value_name = "STATE", num_args = 1..)]
    states: Vec<String>,
    /// Locations; the information of a location is the sum over its states
    #[arg(long = "location", value_name = "LOCATION", num_args = 1..)]
    locations: Vec<String>,
    /// An observation of the grid from a viewpoint, metres; the default range is 4; may be repeated
    #[arg(long = "view", value_name = "X,Y,Z[,RANGE]", allow_hyphen_values = true,
          conflicts_with_all = ["states", "locations"])]
    views: Vec<ViewArg>,
    /// Without other targets: the side of the areas of the grid, metres
    #[arg(long, value_name = "METRES", default_value = "2", conflicts_with_all = ["states", "locations", "views"])]
    area: areas::Side,
    /// Without other targets: the number of areas that are shown
    #[arg(long, value_name = "N", default_value_t = 20, conflicts_with_all = ["states", "locations", "views"])]
    count: usize,
    /// Model: those of predict, each optionally with +persistence or +memory
    #[arg(long, value_name = "KIND", default_value = "auto")]
    model: ModelSelector,
}

const COLUMNS: [&str; 4] = ["target", "entropy_bits", "information_bits", "time"];

pub(crate) async fn run(session: &Session, args: InfoArgs) -> anyhow::Result<ExitCode> {
    let InfoArgs { map, at, states, locations, views, area, count, model } = args;
    if states.is_empty() && locations.is_empty() && views.is_empty() {
        return session.print(&COLUMNS, areas::rows(session, (&map, &at, model), area, count).await?);
    }
    let mut rows = Vec::new();
    if views.is_empty() {
        let targets = Targets { states, locations };
        for answer in session.client.information(&map, targets, at.clone(), model).await? {
            let numbers = answer.entropy_bits.into_iter().zip(answer.information_bits);
            rows.extend(at.iter().zip(numbers).map(|(&time, (entropy, information))| {
                vec![Cell::Text(answer.target.clone()), entropy.into(), information.into(), Cell::Time(time)]
            }));
        }
    }
    // Views of the same range share a request.
    for group in views.chunk_by(|one, next| one.range_m == next.range_m) {
        let viewpoints: Vec<Viewpoint> = group
            .iter()
            .map(|view| Viewpoint { x_m: view.at_m[0], y_m: view.at_m[1], z_m: Some(view.at_m[2]), yaw_rad: 0.0 })
            .collect();
        let usual = Sensor::default();
        let range_m = group.first().and_then(|view| view.range_m).unwrap_or(usual.range_m);
        let sensor = Sensor { range_m, ..usual };
        let answers = session.client.evaluate_views(&map, &viewpoints, at.clone(), sensor, model).await?;
        for (view, answer) in group.iter().zip(answers) {
            let [x, y, z] = view.at_m;
            let target = format!("{x},{y},{z}");
            match answer {
                View::Information(bits) => rows.extend(at.iter().zip(bits).map(|(&time, bits)| {
                    vec![Cell::Text(target.clone()), Cell::Empty, Cell::maybe(bits), Cell::Time(time)]
                })),
                View::Blocked(reason) => anyhow::bail!(reason),
            }
        }
    }
    session.print(&COLUMNS, rows)
}
