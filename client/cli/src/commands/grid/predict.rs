//! `tidemap grid predict`.
//!
//! Invariant: a file is written only after the whole prediction has arrived; unknown cells stay unknown.

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
    str::FromStr,
};

use clap::{Args, ValueEnum};
use tidemap_client::{
    Error,
    maps::{CellBox, CellIndex, GridSpec, Map},
    queries::{CellPrediction, GridOutput, GridQuery, ModelSelector, ORDER_MAX, WholeGrid},
};

use tonic::Code;

use super::{
    ever_occupied::{self, FileEverOccupied, ShownAs},
    place::{AxisRange, Rectangle, cells, corner_m},
};
use crate::{
    commands::{Session, UsageError, files, predict::check_for_cells, times::RequestedTimesArgs, usage},
    output,
    progress::status_line,
};
use tidemap_formats::{
    CELLS_MAX, MapPicture, PictureCell, PictureValue, SCALE_MAX, cells_csv, grid_text, nav2, octomap, ply, png,
    table::{Cell, Format},
};

mod compared;

/// Heights that matter to a robot, metres: without the floor and the ceiling, which are always occupied.
const HEIGHTS_M: (f64, f64) = (0.1, 1.8);

/// A prediction of fewer cells than this is not refused for their number.
const MANY_CELLS: u64 = 100_000;
/// Advice for too many cells.
const PART: &str = "Choose a part with --region X0:X1,Y0:Y1 or --z MIN:MAX; a map that has one layer takes fewest cells in \
                    a flat grid (map create --grid …,flat)";

#[derive(Debug, Args)]
pub(crate) struct GridPredictArgs {
    /// Name of the map
    map: String,
    #[command(flatten)]
    times: RequestedTimesArgs,
    /// File to write: .pgm (with a .yaml beside it), .png, .csv, .ply or .bt (OctoMap) [default: a picture in the
    /// terminal]
    #[arg(long, value_name = "PATH")]
    out: Option<PathBuf>,
    /// Draws the map for people, with a legend and a scale bar: in the terminal, or as a .png file. Several times stand
    /// beside each other, two with their difference. Without FILE it is the last option
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = "-", conflicts_with = "out")]
    picture: Option<PathBuf>,
    /// Number of spectral components, 0 to 15 [default: the number that the last update chose]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=ORDER_MAX as i64))]
    order: Option<u32>,
    /// Model: auto, mean, latest or spectral, each optionally with +persistence or +memory
    #[arg(long, value_name = "KIND", default_value = "auto")]
    model: ModelSelector,
    /// Only cells between these heights, metres [default: all; 0.1:1.8 for people, if the grid has cells there]
    #[arg(long, value_name = "MIN:MAX", allow_hyphen_values = true)]
    z: Option<AxisRange>,
    /// Only cells in this rectangle, metres
    #[arg(long, value_name = "X0:X1,Y0:Y1", allow_hyphen_values = true)]
    region: Option<Rectangle>,
    /// Projects the cells to one layer: each column becomes its most probable cell; always done for pictures
    #[arg(long)]
    project: bool,
    /// Writes the entropy in bits instead of the probability
    #[arg(long, conflicts_with = "threshold")]
    entropy: bool,
    /// Writes 1 if the probability is at least this, else 0
    #[arg(long, value_name = "P", value_parser = threshold)]
    threshold: Option<f64>,
    /// Encoding of probabilities in a .pgm file [default: trinary, or raw for entropies]
    #[arg(long, value_name = "MODE")]
    pgm_mode: Option<PgmMode>,
    /// Pixels along the side of a cell in a .png file, 1 to 16, or fit for a size that can be read; the picture then
    /// has a legend and a scale bar below it [default: 1, without them; fit with --picture]
    #[arg(long, value_name = "N|fit")]
    scale: Option<ScaleArg>,
}

/// The scale at which cells are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct ScaleArg(Option<u32>);

impl FromStr for ScaleArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.parse() {
            _ if text == "fit" => Ok(Self(None)),
            Ok(pixels) if (1..=SCALE_MAX).contains(&pixels) => Ok(Self(Some(pixels))),
            _ => Err(format!("{text:?} is not a scale: use 1 to {SCALE_MAX} pixels, or fit")),
        }
    }
}

/// The modes of Nav2's map server.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum PgmMode {
    /// Free up to 0.25, occupied from 0.65, else unknown
    Trinary,
    /// Probabilities in percent, and unknown
    Raw,
    /// Probabilities, where every cell is known
    Scale,
}

fn threshold(text: &str) -> Result<f64, String> {
    let right = || format!("{text:?} is not a threshold: use a probability above 0, at most 1");
    text.parse::<f64>().ok().filter(|threshold| *threshold > 0.0 && *threshold <= 1.0).ok_or_else(right)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum OutputKind {
    Pgm,
    Png,
    Csv,
    Ply,
    /// A tree of OctoMap.
    Bt,
    /// Text for a terminal.
    Drawing,
}

impl OutputKind {
    /// Whether the map has one layer.
    fn is_flat(self) -> bool {
        matches!(self, Self::Pgm | Self::Png | Self::Drawing)
    }
}

fn kind(path: &Path) -> Result<OutputKind, UsageError> {
    match files::ending(path).as_deref() {
        Some("pgm") => Ok(OutputKind::Pgm),
        Some("png") => Ok(OutputKind::Png),
        Some("csv") => Ok(OutputKind::Csv),
        Some("ply") => Ok(OutputKind::Ply),
        Some("bt") => Ok(OutputKind::Bt),
        _ => Err(UsageError(format!("--out {}: its ending has to be .pgm, .png, .csv, .ply or .bt", path.display()))),
    }
}

impl GridPredictArgs {
    /// The target of the map: a file, or the terminal.
    fn target(&self, format: Format) -> anyhow::Result<(OutputKind, Option<&Path>)> {
        let picture = self.picture.as_deref();
        match (&self.out, picture.filter(|path| path.as_os_str() != "-")) {
            (Some(out), _) => Ok((kind(out)?, Some(out))),
            (None, Some(path)) if files::ending(path).as_deref() == Some("png") => Ok((OutputKind::Png, Some(path))),
            (None, Some(path)) => Err(usage(format!("--picture {}: its ending has to be .png", path.display()))),
            (None, None) if picture.is_some() || format == Format::Table => Ok((OutputKind::Drawing, None)),
            (None, None) => Err(usage(
                "name the file to write with --out FILE.png, .pgm, .csv, .ply or .bt, or draw in the terminal with --picture",
            )),
        }
    }

    fn pgm_mode(&self) -> nav2::GridMode {
        match (self.pgm_mode, self.entropy) {
            (Some(PgmMode::Raw), _) | (None, true) => nav2::GridMode::Raw,
            (Some(PgmMode::Scale), _) => nav2::GridMode::Scale,
            (Some(PgmMode::Trinary), _) | (None, false) => nav2::GridMode::Trinary,
        }
    }

    fn value(&self) -> PictureValue {
        match self.threshold {
            Some(threshold) => PictureValue::AtLeast(threshold),
            None if self.entropy => PictureValue::Entropy,
            None => PictureValue::Probability,
        }
    }
}

pub(crate) async fn run(session: &Session, args: GridPredictArgs) -> anyhow::Result<ExitCode> {
    let (kind, path) = args.target(session.format)?;
    if args.order.is_some() && !args.model.kind.has_order() {
        let text = format!("--order does not go with --model {}: only auto and spectral have one", args.model);
        return Err(usage(text));
    }
    check_for_cells(args.model)?;
    if args.entropy && kind == OutputKind::Csv {
        return Err(usage("a .csv file has the entropy in a column of its own: leave out --entropy"));
    }
    if args.entropy && kind == OutputKind::Bt {
        return Err(usage("a .bt file has free and occupied cells only: leave out --entropy"));
    }
    if args.scale.is_some() && kind != OutputKind::Png {
        return Err(usage("--scale goes with a .png file only"));
    }
    if args.pgm_mode.is_some() && kind != OutputKind::Pgm {
        return Err(usage("--pgm-mode goes with --out FILE.pgm only"));
    }
    let times = args.times.resolve(session, &args.map).await?;
    let query = GridQuery {
        map: args.map.clone(),
        time_nanos: times.first().copied().unwrap_or_default(),
        model: ModelSelector { order: args.order.map(|order| order as usize), ..args.model },
        region: region(session, &args).await?,
        is_projected: args.project || kind.is_flat(),
        output: match args.value() {
            PictureValue::AtLeast(threshold) => GridOutput::Threshold(threshold),
            // A picture of entropies shows the walls beneath them, which are known from probabilities alone.
            PictureValue::Entropy | PictureValue::Probability => GridOutput::Probability,
        },
    };
    if times.len() > 1 {
        return compared::run(session, &args, (query, times), path).await;
    }
    let predicted = predicted(session, &query).await?;
    let picture = picture(&predicted, args.value());
    let caption = format!(
        "{} at {}{}",
        args.map,
        session.times.heading(query.time_nanos),
        heights_text(&predicted.header.grid, query.region)
    );
    match path {
        Some(path) => write((kind, path), &picture, &args, &caption)?,
        None => output::print(&grid_text::write(&picture, &caption)?)?,
    }
    if kind.is_flat() && !args.entropy && args.z.is_none() && !predicted.header.grid.is_flat && is_full(&picture) {
        status_line("every column is occupied at some height: choose heights with --z MIN:MAX");
    }
    let occupied = ever_occupied(kind, &args, &picture);
    put(session, (path, occupied), &picture, predicted.header.generation)
}

/// The cells that were occupied at some time, in a .pgm file of mode trinary.
fn ever_occupied(kind: OutputKind, args: &GridPredictArgs, picture: &MapPicture) -> Option<FileEverOccupied> {
    if kind != OutputKind::Pgm || args.pgm_mode() != nav2::GridMode::Trinary || args.entropy {
        return None;
    }
    let thresholds = nav2::Thresholds::default();
    let kind = args.threshold.map_or(ShownAs::Map(thresholds), ShownAs::AtLeast);
    Some(FileEverOccupied { occupied: nav2::in_map(picture, thresholds), kind })
}

/// The whole prediction of a query.
pub(crate) async fn predicted(session: &Session, query: &GridQuery) -> anyhow::Result<WholeGrid> {
    let predicted = match session.client.predict_grid(query).await {
        Ok(predicted) => predicted,
        Err(error) => return Err(explained(session, query, error).await),
    };
    let region = predicted.header().region;
    anyhow::ensure!(region.count() > 0, "map {:?} has no observed cells in the region", query.map);
    let cells = region.count();
    anyhow::ensure!(
        cells <= u128::from(CELLS_MAX),
        "the region has {cells} cells, and a file takes at most {CELLS_MAX}. {PART}"
    );
    Ok(predicted.whole().await?)
}

/// Prints a message about the written file, or the drawing in the terminal.
fn put(
    session: &Session,
    (path, ever_occupied): (Option<&Path>, Option<FileEverOccupied>),
    picture: &MapPicture,
    generation: u64,
) -> anyhow::Result<ExitCode> {
    let count = |wanted: fn(&PictureCell) -> bool| picture.cells.iter().filter(|cell| wanted(cell)).count() as u64;
    let known = count(|cell| *cell != PictureCell::Unknown);
    let changing = count(|cell| matches!(cell, PictureCell::Changing { .. }));
    let Some(path) = path else {
        let all = picture.cells.len();
        status_line(&format!("{all} cells, {known} known, {changing} with a model; --out FILE writes them to a file"));
        return Ok(ExitCode::SUCCESS);
    };
    // In a table the line has the numbers.
    let columns = ever_occupied.filter(|_| session.format != Format::Table);
    let names = ["out", "cells", "known", "changing", "generation"].into_iter();
    let names = names.chain(columns.iter().flat_map(|_| ever_occupied::COLUMNS)).collect::<Vec<_>>();
    let mut row = vec![
        Cell::Text(path.display().to_string()),
        (picture.cells.len() as u64).into(),
        known.into(),
        changing.into(),
        generation.into(),
    ];
    row.extend(columns.iter().flat_map(FileEverOccupied::cells));
    session.print(&names, [row])?;
    ever_occupied.iter().for_each(|occupied| status_line(&occupied.line(&path.display().to_string())));
    Ok(ExitCode::SUCCESS)
}

/// An error of the daemon; with advice, if the request was for many cells.
async fn explained(session: &Session, query: &GridQuery, error: Error) -> anyhow::Error {
    let is_limit = matches!(&error, Error::Server(server) if server.code == Code::ResourceExhausted);
    match session.client.estimate_grid(query).await {
        Ok(header) if is_limit && header.cells >= MANY_CELLS => anyhow::anyhow!("{error}. {PART}"),
        _ => error.into(),
    }
}

/// The requested cells; `None` for all.
async fn region(session: &Session, args: &GridPredictArgs) -> anyhow::Result<Option<CellBox>> {
    if args.region.is_none() && args.z.is_none() && args.out.is_some() {
        return Ok(None);
    }
    cells_between(session, &args.map, (args.region, args.z), args.out.is_none()).await
}

/// The requested cells of a map; without heights, the cells that matter to a robot. `None` for all.
pub(crate) async fn usual_region(
    session: &Session,
    map: &str,
    rectangle: Option<Rectangle>,
    z: Option<AxisRange>,
) -> anyhow::Result<Option<CellBox>> {
    cells_between(session, map, (rectangle, z), true).await
}

/// The cells of a map in a rectangle and between two heights. `is_usual`: without heights, the cells that matter to a
/// robot.
async fn cells_between(
    session: &Session,
    map: &str,
    (rectangle, z): (Option<Rectangle>, Option<AxisRange>),
    is_usual: bool,
) -> anyhow::Result<Option<CellBox>> {
    let map = session.client.map(map).await?;
    let Some(grid) = map.grid else { return Ok(None) };
    if grid.is_flat && z.is_some() {
        return Err(usage(format!("--z: the grid of map {:?} is flat, it has one layer", map.name)));
    }
    // Without observations the prediction is empty, whatever the region.
    let Some(bounds) = map.grid_summary.and_then(|summary| summary.region) else { return Ok(None) };
    let has_layers = |region: &CellBox| region.min.z < bounds.max.z && region.max.z > bounds.min.z;
    let usual = Some(cells(&grid, &bounds, rectangle, Some(AxisRange::new(HEIGHTS_M.0, HEIGHTS_M.1))))
        .filter(|region| is_usual && !grid.is_flat && z.is_none() && has_layers(region));
    let region = usual.unwrap_or_else(|| cells(&grid, &bounds, rectangle, z));
    Ok(Some(if grid.is_flat {
        CellBox { min: CellIndex { z: 0, ..region.min }, max: CellIndex { z: 1, ..region.max } }
    } else {
        region
    }))
}

/// The cells of a map between two heights, metres; `None` for a flat or an empty grid.
pub(crate) fn heights(map: &Map, from_m: f64, to_m: f64) -> Option<CellBox> {
    let grid = map.grid.as_ref().filter(|grid| !grid.is_flat)?;
    let bounds = map.grid_summary.as_ref()?.region.as_ref()?;
    Some(cells(grid, bounds, None, Some(AxisRange::new(from_m, to_m))))
}

/// The heights of a region in the form of captions.
fn heights_text(grid: &GridSpec, region: Option<CellBox>) -> String {
    let metres = |cell: i32| (grid.origin_m[2] + f64::from(cell) * grid.resolution_m) as f32;
    match region {
        Some(CellBox { min, max }) if !grid.is_flat => format!(", {} to {} m", metres(min.z), metres(max.z)),
        _ => String::new(),
    }
}

/// Whether there are known cells, and all of them are more likely occupied than free.
fn is_full(picture: &MapPicture) -> bool {
    let mut values = picture.cells.iter().filter_map(|cell| cell.probability()).peekable();
    values.peek().is_some() && values.all(|probability| probability >= 0.5)
}

/// The known cells of a prediction: their centres in metres, and their values.
pub(crate) fn known_centres(predicted: &WholeGrid) -> impl Iterator<Item = ([f64; 3], f64)> + '_ {
    let grid = &predicted.header.grid;
    predicted.tiles.iter().flat_map(move |tile| {
        tile.cells.iter().enumerate().filter_map(move |(place, cell)| {
            let at = [place % 8, place / 8 % 8, place / 64];
            let index = |axis: usize| f64::from(tile.place[axis] * 8 + at[axis] as i32) + 0.5;
            let centre = std::array::from_fn(|axis| grid.origin_m[axis] + index(axis) * grid.resolution_m);
            cell.value().map(|value| (centre, f64::from(value)))
        })
    })
}

/// The region cell by cell, as files show it.
pub(crate) fn picture(predicted: &WholeGrid, value: PictureValue) -> MapPicture {
    let CellBox { min, max } = predicted.header.region;
    let (min, max): ([i32; 3], [i32; 3]) = (min.into(), max.into());
    let grid = &predicted.header.grid;
    let size_cells = predicted.header.region.size().map(|size| size as u32);
    let [width, height, _] = size_cells.map(|size| size as usize);
    let mut picture = vec![PictureCell::Unknown; size_cells.iter().map(|&size| size as usize).product()];
    for tile in &predicted.tiles {
        for (place, cell) in tile.cells.iter().enumerate() {
            let at = [place % 8, place / 8 % 8, place / 64];
            let index: [i32; 3] = std::array::from_fn(|axis| tile.place[axis] * 8 + at[axis] as i32);
            if (0..3).any(|axis| index[axis] < min[axis] || index[axis] >= max[axis]) {
                continue;
            }
            let [x, y, z] = std::array::from_fn(|axis| (index[axis] - min[axis]) as usize);
            picture[x + width * (y + height * z)] = match *cell {
                CellPrediction::Unknown => PictureCell::Unknown,
                CellPrediction::Static(probability) => PictureCell::Static { probability },
                CellPrediction::Changing(probability) => PictureCell::Changing { probability },
            };
        }
    }
    MapPicture {
        resolution_m: grid.resolution_m,
        origin_m: std::array::from_fn(|axis| corner_m(grid.origin_m[axis], min[axis], grid.resolution_m)),
        min_cell: min,
        size_cells,
        cells: picture,
        value,
        levels: grid.sensor.levels(),
    }
}

fn write(
    (kind, out): (OutputKind, &Path),
    picture: &MapPicture,
    args: &GridPredictArgs,
    caption: &str,
) -> anyhow::Result<()> {
    match kind {
        OutputKind::Drawing => files::write(out, grid_text::write(picture, caption)?),
        OutputKind::Png if args.picture.is_none() && args.scale.is_none() => files::write(out, png::write(picture, 1)?),
        OutputKind::Png => {
            let scale = args.scale.and_then(|ScaleArg(scale)| scale);
            files::write(out, png::write_for_people(picture, scale, caption)?)
        }
        OutputKind::Csv => files::write(out, cells_csv::write(picture)?),
        OutputKind::Ply => files::write(out, ply::write(picture)?),
        OutputKind::Bt => files::write(out, octomap::write(picture)?),
        OutputKind::Pgm => {
            let name = out.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            let map = nav2::write(picture, &name, args.pgm_mode(), nav2::Thresholds::default())?;
            files::write(out, &map.image)?;
            files::write(&out.with_extension("yaml"), &map.yaml)
        }
    }
}

#[cfg(test)]
mod tests {
    use tidemap_client::queries::{GridHeader, PredictedTile};

    use super::*;

    #[test]
    fn a_picture_is_the_region_and_no_more() {
        let mut cells = Box::new([CellPrediction::Unknown; 512]);
        cells[1 + 8 * 2 + 64 * 3] = CellPrediction::Static(0.25);
        cells[3 + 8 * 2 + 64 * 3] = CellPrediction::Changing(0.5);
        cells[7 + 8 * 7 + 64 * 7] = CellPrediction::Changing(1.0);
        let tiles = vec![PredictedTile { place: [-1, 0, 1], cells }];
        let grid = GridSpec { origin_m: [10.0, 0.0, 0.0], ..GridSpec::new(0.5) };
        let region = CellBox { min: [-7, 2, 10].into(), max: [-3, 4, 12].into() };
        let header = GridHeader { grid, region, tiles: 1, cells: 512, bytes: 0, generation: 3 };
        let picture = picture(&WholeGrid { header, tiles }, PictureValue::Probability);
        assert_eq!((picture.size_cells, picture.origin_m), ([4, 2, 2], [6.5, 1.0, 5.0]));
        let indices: Vec<_> = picture.known_indices().map(|(index, _)| index).collect();
        assert_eq!(indices, [[-7, 2, 11], [-5, 2, 11]]);
        assert!(!is_full(&picture));
        let known: Vec<_> = picture.known().collect();
        assert_eq!(
            known,
            [
                ([6.75, 1.25, 5.75], PictureCell::Static { probability: 0.25 }),
                ([7.75, 1.25, 5.75], PictureCell::Changing { probability: 0.5 }),
            ]
        );
    }

    #[test]
    fn an_ending_decides_what_to_write() {
        assert_eq!(kind(Path::new("a/map.PGM")).ok(), Some(OutputKind::Pgm));
        assert!(kind(Path::new("map.tif")).is_err_and(|error| error.0.contains(".pgm, .png, .csv, .ply or .bt")));
        assert_eq!(
            ["fit", "1", "16"].map(|text| text.parse().ok()),
            [None, Some(1), Some(16)].map(|n| Some(ScaleArg(n)))
        );
        assert!(["0", "17", "", "x"].iter().all(|text| text.parse::<ScaleArg>().is_err()));
        assert!(threshold("0").is_err() && threshold("1.1").is_err() && threshold("1").is_ok());
    }
}
