//! `tidemap grid compare`.
//!
//! Invariant: nothing is compared before the whole prediction has arrived. A file of another frame is refused, never
//! compared as if it were of the map's.

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::Context as _;
use clap::Args;
use tidemap_client::queries::{GridOutput, GridQuery, ModelKind, ModelSelector};
use tidemap_formats::{
    PictureValue,
    nav2::{self, Agreement, SideCounts, Thresholds},
    table::{Cell, Format},
};

use super::{
    grid_of_map,
    place::AxisRange,
    predict::{picture, predicted, usual_region},
    scans::plane,
};
use crate::{
    commands::{Session, UsageError, files, predict::check_for_cells, shell_word::quoted, times},
    counted::{count, counted, percent},
    output,
    progress::status_line,
};

#[derive(Debug, Args)]
pub(crate) struct GridCompareArgs {
    /// Name of the map
    map: String,
    /// Map of a ROS map server: a .yaml file, with the image that it names (.pgm or .png), or the .pgm file beside it
    file: PathBuf,
    /// Time of the map, past or future
    #[arg(long, value_name = "TIME", default_value = "now", value_parser = times::time)]
    at: i64,
    /// Model of the map: auto, mean, latest or spectral, each optionally with +persistence or +memory
    #[arg(long, value_name = "KIND", default_value = "auto")]
    model: ModelSelector,
    /// Only cells between these heights, metres [default: 0.1:1.8, if the grid has cells there]
    #[arg(long, value_name = "MIN:MAX", allow_hyphen_values = true)]
    z: Option<AxisRange>,
    /// Frame of the file, which has to be the frame of the grid; the file does not name it [default: that of the grid]
    #[arg(long, value_name = "FRAME")]
    frame: Option<String>,
    /// Pixels of value 205, which map savers write for unknown, are unknown in mode trinary; without this they count as
    /// free with free_thresh 0.25, as in Nav2's map server
    #[arg(long)]
    unknown_205: bool,
}

const COLUMNS: [&str; 11] = [
    "file",
    "within",
    "file_occupied",
    "file_found",
    "map_occupied",
    "map_found",
    "file_free_map_occupied",
    "map_free_file_occupied",
    "unknown_in_map",
    "unknown_in_file",
    "generation",
];

pub(crate) async fn run(session: &Session, args: GridCompareArgs) -> anyhow::Result<ExitCode> {
    check_for_cells(args.model)?;
    check_ending(&args.file)?;
    let shown = args.file.display().to_string();
    let (file, settings) = plane(&args.file, args.unknown_205).with_context(|| shown.clone())?;
    let map = session.client.map(&args.map).await?;
    let is_learned = map.not_learned.is_none_or(|waiting| !waiting.is_all);
    let (grid, _) = grid_of_map(map)?;
    if !is_learned && args.model.kind != ModelKind::Latest {
        anyhow::bail!(
            "no update has learned anything of map {0:?}, so its cells are unknown: tidemap update {1}, or --model latest",
            args.map,
            quoted(&args.map)
        );
    }
    if let Some(frame) = args.frame.filter(|frame| *frame != grid.frame_id) {
        anyhow::bail!(
            "{shown} is in frame {frame:?}, and the grid of map {:?} in frame {:?}: only maps of one frame can be \
             compared",
            args.map,
            grid.frame_id
        );
    }
    if file.free_205 > 0 {
        status_line(&format!(
            "{} of {shown} have the value 205, which map savers write for unknown, and count as free with free_thresh \
             {}, as in Nav2's map server. --unknown-205 reads them as unknown",
            counted(file.free_205, "pixel"),
            settings.free_thresh
        ));
    }
    let query = GridQuery {
        map: args.map.clone(),
        time_nanos: args.at,
        model: args.model,
        region: usual_region(session, &args.map, None, args.z).await?,
        is_projected: true,
        output: GridOutput::Probability,
    };
    let predicted = predicted(session, &query).await?;
    let map = picture(&predicted, PictureValue::Probability);
    let compared = nav2::compare(&file, &map, Thresholds::default()).with_context(|| shown.clone())?;
    if session.format == Format::Table {
        output::print(&sentences(&base_name(&args.file), &args.map, &compared))?;
        return Ok(ExitCode::SUCCESS);
    }
    let Agreement { file: of_file, map: of_map, within_m } = compared;
    session.print(
        &COLUMNS,
        [vec![
            Cell::Text(shown),
            within_m.into(),
            of_file.occupied.into(),
            of_file.found.into(),
            of_map.occupied.into(),
            of_map.found.into(),
            of_file.free_but_occupied.into(),
            of_map.free_but_occupied.into(),
            of_file.unknown_there.into(),
            of_map.unknown_there.into(),
            predicted.header.generation.into(),
        ]],
    )
}

fn check_ending(file: &Path) -> Result<(), UsageError> {
    match files::ending(file).as_deref() {
        Some("yaml" | "yml" | "pgm") => Ok(()),
        _ => Err(UsageError(format!("{}: name the .yaml file of a ROS map server, or its .pgm file", file.display()))),
    }
}

/// The name of a file in sentences.
fn base_name(file: &Path) -> String {
    file.file_name().map_or_else(|| file.display().to_string(), |name| name.to_string_lossy().into_owned())
}

/// The result, for people.
fn sentences(file: &str, map: &str, compared: &Agreement) -> String {
    let Agreement { file: of_file, map: of_map, within_m } = compared;
    let found = |counts: &SideCounts, own: &str, other: &str| {
        format!(
            "f {} of {own}, {}{} {} occupied in {other}",
            counted(counts.occupied, "occupied cell"),
            count(counts.found),
            percent(counts.found, counts.occupied),
            if counts.found == 1 { "is" } else { "are" },
        )
    };
    // To a micrometre: the last digits of a file's numbers are rounding.
    let within_m = (within_m * 1e6).round() / 1e6;
    format!(
        "O{}, within a cell ({within_m} m); o{}.\nFree in {file} and occupied in {map}, farther apart than that: {}; free \
         in {map} and occupied in {file}: {}. Known in {file} only: {}; in {map} only: {}.\n",
        found(of_file, file, map),
        found(of_map, map, file),
        counted(of_file.free_but_occupied, "cell"),
        counted(of_map.free_but_occupied, "cell"),
        counted(of_file.unknown_there, "cell"),
        counted(of_map.unknown_there, "cell"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_result_is_a_sentence() {
        let side = |occupied, found, free_but_occupied, unknown_there| SideCounts {
            occupied,
            found,
            free_but_occupied,
            unknown_there,
        };
        let compared = Agreement { file: side(1204, 1150, 1, 0), map: side(1, 1, 2, 3000), within_m: 0.1 };
        assert_eq!(
            sentences("ten.yaml", "lab", &compared),
            "Of 1,204 occupied cells of ten.yaml, 1,150 (96 %) are occupied in lab, within a cell (0.1 m); of 1 occupied \
             cell of lab, 1 (100 %) is occupied in ten.yaml.\nFree in ten.yaml and occupied in lab, farther apart than \
             that: 1 cell; free in lab and occupied in ten.yaml: 2 cells. Known in ten.yaml only: 0 cells; in lab only: \
             3,000 cells.\n"
        );
    }
}
