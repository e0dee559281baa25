//! `tidemap export`: maps of any time as files that other programs read.
//!
//! Invariant: the ending of PATH decides what is written. A file appears under its name when it is complete; a file
//! that was there before stays if the export fails.

mod args;
pub(crate) mod frames;
mod graph;
mod image;
mod recording;

use std::{path::Path, process::ExitCode};

use super::{
    Session, UsageError, files,
    grid::ever_occupied::{self, FileEverOccupied},
    usage,
};
use crate::progress::status_line;
use tidemap_formats::table::{Cell, Format};

pub(crate) use args::ExportArgs;

/// The kind of export that the ending of a path selects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ExportKind {
    /// Maps over time, as MCAP.
    Recording,
    /// A map or a mask of Nav2: YAML, and an image beside it.
    Image,
    /// A graph for Nav2's route server.
    Graph,
}

/// A written file: its path, the kind of its content, and the number of items.
struct Written {
    path: String,
    content: &'static str,
    count: u64,
    /// The cells that were occupied at some time, in a map or a keepout mask.
    ever_occupied: Option<FileEverOccupied>,
}

fn kind(path: &Path) -> Result<ExportKind, UsageError> {
    match files::ending(path).as_deref() {
        Some("mcap") => Ok(ExportKind::Recording),
        Some("yaml") => Ok(ExportKind::Image),
        Some("geojson") => Ok(ExportKind::Graph),
        _ => Err(UsageError(format!("{}: its ending has to be .mcap, .yaml or .geojson", path.display()))),
    }
}

pub(crate) async fn run(session: &Session, args: ExportArgs) -> anyhow::Result<ExitCode> {
    let kind = kind(&args.path)?;
    args.check(kind)?;
    let times = args.times.resolve(session, &args.map).await?;
    let written = match (kind, times.as_slice()) {
        (ExportKind::Recording, _) => recording::write(session, &args, times).await?,
        (ExportKind::Image, &[time]) => image::write(session, &args, time).await?,
        (ExportKind::Graph, &[time]) => graph::write(session, &args, time).await?,
        _ => {
            return Err(usage(format!(
                "{}: it takes one time, and there are {}; a .mcap file takes many",
                args.path.display(),
                times.len()
            )));
        }
    };
    let image = args.path.with_extension("pgm").display().to_string();
    let lines: Vec<String> = written.iter().filter_map(|file| Some(file.ever_occupied?.line(&image))).collect();
    // In a table the line has the numbers.
    let has_columns = session.format != Format::Table && !lines.is_empty();
    let columns =
        ["out", "content", "count"].into_iter().chain(ever_occupied::COLUMNS.into_iter().filter(|_| has_columns));
    let row = |Written { path, content, count, ever_occupied }| {
        let occupied =
            ever_occupied.filter(|_| has_columns).map_or_else(Vec::new, |occupied: FileEverOccupied| occupied.cells());
        [vec![Cell::Text(path), content.into(), count.into()], occupied].concat()
    };
    session.print(&columns.collect::<Vec<_>>(), written.into_iter().map(row))?;
    lines.iter().for_each(|line| status_line(line));
    Ok(ExitCode::SUCCESS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ending_decides_what_to_export() {
        let kind = |path: &str| kind(Path::new(path)).map_err(|error| error.0);
        assert_eq!(kind("week.mcap"), Ok(ExportKind::Recording));
        assert_eq!(kind("a/ten.YAML"), Ok(ExportKind::Image));
        assert_eq!(kind("graph.geojson"), Ok(ExportKind::Graph));
        assert!(kind("ten.pgm").is_err_and(|text| text.contains(".mcap, .yaml or .geojson")));
    }
}
