//! `tidemap grid predict` at several times: the maps beside each other, and the difference if there are two.
//!
//! Invariant: all maps are of one region and of one size; nothing is drawn before all predictions have arrived.

use std::{path::Path, process::ExitCode};

use tidemap_client::queries::GridQuery;
use tidemap_formats::{CELLS_MAX, MapPicture, grid_text, png};

use super::{GridPredictArgs, PART, ScaleArg, heights_text, picture, predicted, put};
use crate::{
    commands::{Session, files, usage},
    output,
    progress::status_line,
};

/// Maximum number of maps beside each other: the hours of a day that is one hour longer.
const MAPS_MAX: usize = 25;
/// From this difference of probabilities on, a cell counts as different.
const DIFFERENT: f32 = 0.5;

/// Draws the maps, in the terminal or to a PNG file.
pub(super) async fn run(
    session: &Session,
    args: &GridPredictArgs,
    (query, times): (GridQuery, Vec<i64>),
    path: Option<&Path>,
) -> anyhow::Result<ExitCode> {
    if args.out.is_some() {
        return Err(usage(format!(
            "--out takes one time, and there are {}: --picture FILE.png draws them beside each other",
            times.len()
        )));
    }
    if times.len() > MAPS_MAX {
        return Err(usage(format!("{} times: at most {MAPS_MAX} maps are drawn, use a longer --step", times.len())));
    }
    let mut panels: Vec<(String, MapPicture)> = Vec::with_capacity(times.len());
    let (mut generation, mut heights) = (0, String::new());
    let (count, mut region) = (times.len(), None);
    for time_nanos in times {
        let predicted = predicted(session, &GridQuery { time_nanos, ..query.clone() }).await?;
        let drawn = picture(&predicted, args.value());
        if panels.is_empty() {
            let cells = (drawn.cells.len() as u64).saturating_mul(count as u64);
            anyhow::ensure!(
                cells <= CELLS_MAX,
                "{count} maps have {cells} cells, and a picture takes at most {CELLS_MAX}. {PART}, or fewer times"
            );
            heights = heights_text(&predicted.header.grid, query.region);
            (generation, region) = (predicted.header.generation, Some(predicted.header.region));
        } else if predicted.header.generation != generation || region != Some(predicted.header.region) {
            anyhow::bail!("the map has grown or was updated meanwhile, and the pictures would not compare: try again");
        }
        let heading = session.times.heading(time_nanos);
        // The zone stands in the caption.
        let title = heading.split(" (").next().unwrap_or(&heading).to_owned();
        panels.push((title, drawn));
    }
    let zone = session.times.heading(query.time_nanos);
    let zone = zone.split_once(" (").map_or(String::new(), |(_, zone)| format!(" ({zone}"));
    let caption = match &panels[..] {
        [(before, _), (after, _)] => format!("{}{heights}: {before} and {after}{zone}", args.map),
        panels => format!("{}{heights}: {} times{zone}", args.map, panels.len()),
    };
    match path {
        Some(path) => {
            let scale = args.scale.and_then(|ScaleArg(scale)| scale);
            files::write(path, png::write_compared(&panels, scale, &caption)?)?;
        }
        None => output::print(&grid_text::write_compared(&panels, &caption)?)?,
    }
    if let [(before, first), (after, second)] = &panels[..] {
        status_line(&changed(first, second, [before, after]));
    }
    match (panels.first(), path) {
        (Some((_, first)), Some(_)) => put(session, (path, None), first, generation),
        _ => {
            status_line("--picture FILE.png draws them in a file");
            Ok(ExitCode::SUCCESS)
        }
    }
}

/// The number of cells that differ between two times.
fn changed(before: &MapPicture, after: &MapPicture, [from, to]: [&str; 2]) -> String {
    let differences = before.cells.iter().zip(&after.cells).filter_map(|(before, after)| before.difference(*after));
    let (mut fuller, mut freer) = (0_u64, 0_u64);
    for difference in differences {
        fuller += u64::from(difference >= DIFFERENT);
        freer += u64::from(difference <= -DIFFERENT);
    }
    format!("from {from} to {to}, cells that become fuller by {DIFFERENT} or more: {fuller}, and freer: {freer}")
}
