//! The scans of files, read on a thread of their own.
//!
//! Invariant: scans are in the order of their numbers, 1, 2, 3, ...; the memory for scans that are read in advance is
//! bounded. A truncated file gives its complete scans, then the error.

mod plan;

use std::{
    collections::HashSet,
    fs::{self, File},
    io::BufReader,
    path::{Path, PathBuf},
    thread,
};

use anyhow::Context as _;
use tidemap_client::{
    maps::GridSpec,
    observe::scan::{PointCloud, Scan},
    scan_file::{FileScan, ScanFile, ScanFileHeader},
};
use tidemap_proto::v1::scan::Content;
use tokio::sync::mpsc;

use self::plan::FileKind;
pub(super) use self::plan::{ScanOptions, ScanPlan, named, plan};
use super::cell_masks::{CellCounts, GridMasks, check_reach, of_octomap, of_plane};
use crate::progress::Bar;
use tidemap_formats::{PointFile, nav2, octomap, pcd, ply};

const BUFFER_BYTES: usize = 256 * 1024;
const CHUNKS_AHEAD: usize = 2;

#[derive(Debug)]
pub(super) enum ScanInput {
    /// From a file of scans.
    Wire(FileScan),
    /// From a point cloud or a map.
    Single { time_nanos: i64, scan: Scan },
}

/// Scans that were read together, and the position of the reader.
#[derive(Debug)]
pub(super) struct ScanChunk {
    pub(super) scans: Vec<ScanInput>,
    /// Bytes of the file of scans, or the number of files.
    pub(super) position: u64,
}

pub(super) type ScanChunks = mpsc::Receiver<anyhow::Result<ScanChunk>>;

/// Files of one scan each, and their times in nanoseconds UTC.
type TimedFiles = Vec<(PathBuf, FileKind, i64)>;

/// Starts to read the files; returns their scans and a progress bar. `timed` gives files of one scan their times.
pub(super) fn open(
    plan: ScanPlan,
    timed: impl FnOnce(Vec<(PathBuf, FileKind)>) -> anyhow::Result<TimedFiles>,
    grid: &GridSpec,
) -> anyhow::Result<(ScanChunks, Bar)> {
    let (sender, receiver) = mpsc::channel(CHUNKS_AHEAD);
    let (each, options) = match plan {
        ScanPlan::Each(each, options) => (timed(each)?, options),
        ScanPlan::Scans(file) => {
            let (scans, total) = scan_file(&file).with_context(|| file.display().to_string())?;
            fits(scans.header(), grid).with_context(|| file.display().to_string())?;
            let (name, is_flat) = (file.display().to_string(), grid.is_flat);
            spawn(move || send_scans(scans, &name, is_flat, &sender))?;
            return Ok((receiver, Bar::bytes(total)));
        }
    };
    let bar = Bar::count("files");
    bar.set_of(0, each.len() as u64);
    let mut reader = FileReader::new(options, grid.clone(), bar.clone());
    spawn(move || {
        for ((file, kind, time_nanos), position) in each.into_iter().zip(1..) {
            let scan = reader.scan(&file, kind).with_context(|| file.display().to_string());
            let failed = scan.is_err();
            let chunk = scan.map(|scan| ScanChunk { scans: vec![ScanInput::Single { time_nanos, scan }], position });
            if sender.blocking_send(chunk).is_err() || failed {
                break;
            }
        }
        reader.report_counts();
    })?;
    Ok((receiver, bar))
}

fn spawn(work: impl FnOnce() + Send + 'static) -> anyhow::Result<()> {
    thread::Builder::new().name("scans".to_owned()).spawn(work).context("thread")?;
    Ok(())
}

fn scan_file(file: &Path) -> anyhow::Result<(ScanFile<BufReader<File>>, Option<u64>)> {
    let open = File::open(file)?;
    let total = open.metadata().ok().filter(|metadata| metadata.is_file()).map(|metadata| metadata.len());
    Ok((ScanFile::new(BufReader::with_capacity(BUFFER_BYTES, open))?, total))
}

/// Checks that a file of scans has the cells of the grid.
fn fits(header: &ScanFileHeader, grid: &GridSpec) -> anyhow::Result<()> {
    let ScanFileHeader { resolution_m, frame_id, origin_m } = header;
    let resolution = grid.resolution_m;
    anyhow::ensure!(
        *resolution_m == 0.0 || (resolution_m - resolution).abs() < 1e-9 * resolution,
        "its cells are {resolution_m} m wide and those of the grid {resolution} m"
    );
    anyhow::ensure!(
        frame_id.is_empty() || *frame_id == grid.frame_id,
        "its scans are in frame {frame_id:?} and the grid in {:?}",
        grid.frame_id
    );
    let off = origin_m.iter().zip(grid.origin_m).any(|(origin, of_grid)| (origin - of_grid).abs() > 1e-6 * resolution);
    anyhow::ensure!(!off, "its cells begin at {origin_m:?} m and those of the grid at {:?} m", grid.origin_m);
    Ok(())
}

fn send_scans(
    mut file: ScanFile<BufReader<File>>,
    name: &str,
    is_flat: bool,
    sender: &mpsc::Sender<anyhow::Result<ScanChunk>>,
) {
    loop {
        let chunk = match file.next_scans() {
            Ok(None) => return,
            Ok(Some(mut scans)) => {
                if is_flat {
                    scans.iter_mut().for_each(spell_out_layers);
                }
                let scans = scans.into_iter().map(ScanInput::Wire).collect();
                Ok(ScanChunk { scans, position: file.bytes() })
            }
            Err(error) => Err(anyhow::Error::new(error).context(name.to_owned())),
        };
        let failed = chunk.is_err();
        if sender.blocking_send(chunk).is_err() || failed {
            return;
        }
    }
}

/// Writes out the observed layer of a flat grid, where "every cell was observed" means one layer.
fn spell_out_layers(scan: &mut FileScan) {
    if let Some(Content::Tiles(tiles)) = &mut scan.scan.content
        && tiles.observed.is_empty()
    {
        let layer = [[u8::MAX; 8], [0; 8], [0; 8], [0; 8], [0; 8], [0; 8], [0; 8], [0; 8]];
        tiles.observed = layer.as_flattened().repeat(tiles.masked.len());
    }
}

/// Reads files of one scan each, and reports which parts of them are not used.
struct FileReader {
    options: ScanOptions,
    grid: GridSpec,
    bar: Bar,
    /// Notices so far: each is printed once, for the first file to which it applies.
    printed: HashSet<String>,
    counts: CellCounts,
}

impl FileReader {
    fn new(options: ScanOptions, grid: GridSpec, bar: Bar) -> Self {
        Self { options, grid, bar, printed: HashSet::new(), counts: CellCounts::default() }
    }

    /// Reads a file as one scan.
    fn scan(&mut self, file: &Path, kind: FileKind) -> anyhow::Result<Scan> {
        match kind {
            FileKind::Pcd => self.cloud(file, pcd::read(&fs::read(file)?)?),
            FileKind::Ply => self.cloud(file, ply::read(&fs::read(file)?)?),
            FileKind::OctoMap => {
                let on = of_octomap(&octomap::read(&fs::read(file)?)?, &self.grid)?;
                Ok(self.tiles(file, on))
            }
            FileKind::Plane => {
                let (map, settings) = plane(file, self.options.is_205_unknown)?;
                let mut on = of_plane(&map, settings.mode, self.options.between, &self.grid)?;
                on.counts.add_free_205(map.free_205, settings.free_thresh);
                Ok(self.tiles(file, on))
            }
            FileKind::Scans => anyhow::bail!("a file of scans is not one scan"),
        }
    }

    fn cloud(&self, file: &Path, points: PointFile) -> anyhow::Result<Scan> {
        if points.points.is_empty() && points.not_finite > 0 {
            let text = format!("it has no finite points: {} points are left out", points.not_finite);
            self.bar.status_line(&format!("{}: {text}", file.display()));
        }
        let cloud = cloud(points, &self.options)?;
        let at_m = cloud.pose.translation.vector.into();
        check_reach(&self.grid, at_m, at_m)?;
        Ok(Scan::Cloud(cloud))
    }

    fn tiles(&mut self, file: &Path, on: GridMasks) -> Scan {
        if let Some(notice) = on.notice.filter(|notice| self.printed.insert(notice.clone())) {
            self.bar.status_line(&format!("{}: {notice}", file.display()));
        }
        self.counts.add(&on.counts);
        match on.shown {
            Some(shown) => Scan::Map { tiles: on.tiles, shown },
            None => Scan::Tiles(on.tiles),
        }
    }

    /// Reports the cells of all files together that are not used, or are used with a changed value.
    fn report_counts(&self) {
        self.counts.notices().iter().for_each(|notice| self.bar.status_line(notice));
    }
}

fn cloud(points: PointFile, options: &ScanOptions) -> anyhow::Result<PointCloud> {
    let pose = options.pose.or(points.pose).context("the file has no sensor pose: give one with --pose")?;
    Ok(PointCloud {
        pose,
        frame_id: String::new(),
        xyz_m: points.points.into_flattened(),
        min_range_m: options.min_range_m.unwrap_or(0.0),
        max_range_m: options.max_range_m.unwrap_or(0.0),
    })
}

/// A 2D grid from its YAML file, or from its image with the YAML file of the same name beside it; and its settings. An
/// error names the file if it is not `file`.
pub(super) fn plane(file: &Path, is_205_unknown: bool) -> anyhow::Result<(nav2::Grid, nav2::GridSettings)> {
    let (mut settings, image_path) = plane_files(file)?;
    settings.is_205_unknown = is_205_unknown;
    let read = || Ok(nav2::read(&settings, &fs::read(&image_path)?)?);
    of_file(read(), &image_path, file).map(|grid| (grid, settings))
}

/// The settings of a 2D grid, and the path of its image.
fn plane_files(file: &Path) -> anyhow::Result<(nav2::GridSettings, PathBuf)> {
    let is_image = file.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("pgm"));
    let settings_path = if is_image { file.with_extension("yaml") } else { file.to_path_buf() };
    let read = || Ok(nav2::read_settings(&fs::read(&settings_path)?)?);
    let settings = of_file(read(), &settings_path, file)?;
    let image_path = match (is_image, settings_path.parent()) {
        (true, _) => file.to_path_buf(),
        (false, Some(folder)) => folder.join(&settings.image),
        (false, None) => PathBuf::from(&settings.image),
    };
    Ok((settings, image_path))
}

/// Adds the path to the error; for the given file, the caller adds it.
fn of_file<T>(read: anyhow::Result<T>, path: &Path, named: &Path) -> anyhow::Result<T> {
    if path == named { read } else { read.with_context(|| path.display().to_string()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_of_scans_has_to_be_of_the_same_cells() {
        let grid = GridSpec::new(0.1);
        let header = ScanFileHeader { resolution_m: 0.1, frame_id: "map".to_owned(), origin_m: vec![0.0; 3] };
        let message =
            |header: ScanFileHeader| fits(&header, &grid).err().map(|error| error.to_string()).unwrap_or_default();
        assert_eq!(message(header.clone()), "");
        assert_eq!(message(ScanFileHeader::default()), "");
        assert!(message(ScanFileHeader { resolution_m: 0.05, ..header.clone() }).contains("0.05 m wide"));
        assert!(message(ScanFileHeader { frame_id: "odom".to_owned(), ..header.clone() }).contains("\"odom\""));
        assert!(message(ScanFileHeader { origin_m: vec![0.0, 0.05, 0.0], ..header }).contains("0.05"));
    }
}
