//! The scans of files, read on a thread of their own.
//!
//! Invariant: scans come in the order of their numbers, 1, 2, 3, ...; little is read ahead. A file that is cut off gives
//! its whole scans, then the error.

use std::{
    fs::{self, File},
    io::BufReader,
    path::{Path, PathBuf},
    thread,
};

use anyhow::Context as _;
use tidemap::{
    maps::Grid,
    observe::scan::{PointCloud, Pose, Scan},
    scan_file::{FileScan, ScanFile, ScanFileHeader},
};
use tidemap_proto::v1::scan::Content;
use tokio::sync::mpsc;

use super::cell_masks::{OnGrid, of_octomap, of_plane};
use crate::{
    commands::Misused,
    formats::{PointFile, nav2, octomap, pcd, ply},
    progress::Bar,
};

const BUFFER_BYTES: usize = 256 * 1024;
const CHUNKS_AHEAD: usize = 2;

/// A scan with its time.
#[derive(Debug)]
pub(super) enum FromFile {
    /// As a file of scans has it.
    Wire(FileScan),
    /// Made of a file.
    Given {
        /// When.
        time_nanos: i64,
        /// What.
        scan: Scan,
    },
}

/// Scans that were read together, and how far the reading is.
#[derive(Debug)]
pub(super) struct Chunk {
    pub(super) scans: Vec<FromFile>,
    /// Bytes of the file of scans, or number of files.
    pub(super) position: u64,
}

pub(super) type Chunks = mpsc::Receiver<anyhow::Result<Chunk>>;

/// What else than the files says what the scans are.
#[derive(Clone, Debug)]
pub(super) struct Given {
    pub(super) at_nanos: Option<i64>,
    pub(super) every_nanos: Option<i64>,
    pub(super) pose: Option<Pose>,
    pub(super) min_range_m: f32,
    pub(super) max_range_m: f32,
}

/// What the ending of a file says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Scans,
    Pcd,
    Ply,
    OctoMap,
    Plane,
}

fn kind(path: &Path) -> Result<Kind, Misused> {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    match ending.as_deref() {
        Some("tms") => Ok(Kind::Scans),
        Some("pcd") => Ok(Kind::Pcd),
        Some("ply") => Ok(Kind::Ply),
        Some("bt" | "ot") => Ok(Kind::OctoMap),
        Some("yaml" | "yml" | "pgm") => Ok(Kind::Plane),
        _ => Err(Misused(format!(
            "{}: its ending does not say what it is: use .tms, .pcd, .ply, .bt, .ot, .yaml or .pgm",
            path.display()
        ))),
    }
}

/// Opens files; gives their scans and a bar for them.
pub(super) fn open(files: &[PathBuf], given: &Given, grid: &Grid) -> anyhow::Result<(Chunks, Bar)> {
    let kinds = files.iter().map(|file| kind(file)).collect::<Result<Vec<Kind>, Misused>>()?;
    let (sender, receiver) = mpsc::channel(CHUNKS_AHEAD);
    if kinds.contains(&Kind::Scans) {
        let [file] = files else {
            return Err(Misused("a .tms file is sent by itself: one a command".to_owned()).into());
        };
        if given.at_nanos.is_some() || given.every_nanos.is_some() || given.pose.is_some() {
            return Err(Misused(
                "a .tms file has its own times and poses: leave out --at, --every and --pose".to_owned(),
            )
            .into());
        }
        let (scans, total) = scan_file(file).with_context(|| file.display().to_string())?;
        fits(scans.header(), grid).with_context(|| file.display().to_string())?;
        let (name, is_flat) = (file.display().to_string(), grid.is_flat);
        spawn(move || send_scans(scans, &name, is_flat, &sender))?;
        return Ok((receiver, Bar::bytes(total)));
    }
    let times = times(given, files.len())?;
    let bar = Bar::count("files");
    bar.set_of(0, files.len() as u64);
    let jobs: Vec<(PathBuf, Kind, i64)> =
        files.iter().cloned().zip(kinds).zip(times).map(|((f, k), t)| (f, k, t)).collect();
    let (given, grid, notices) = (given.clone(), grid.clone(), bar.clone());
    spawn(move || {
        for ((file, kind, time_nanos), position) in jobs.into_iter().zip(1..) {
            let scan = one_scan(&file, kind, &given, &grid, &notices).with_context(|| file.display().to_string());
            let failed = scan.is_err();
            let chunk = scan.map(|scan| Chunk { scans: vec![FromFile::Given { time_nanos, scan }], position });
            if sender.blocking_send(chunk).is_err() || failed {
                return;
            }
        }
    })?;
    Ok((receiver, bar))
}

fn spawn(work: impl FnOnce() + Send + 'static) -> anyhow::Result<()> {
    thread::Builder::new().name("scans".to_owned()).spawn(work).context("thread")?;
    Ok(())
}

/// A time for each file.
fn times(given: &Given, files: usize) -> anyhow::Result<Vec<i64>> {
    let at = given.at_nanos.ok_or_else(|| Misused("say when the scan was made, with --at".to_owned()))?;
    let every = match given.every_nanos {
        Some(every) => every,
        None if files == 1 => 0,
        None => {
            return Err(
                Misused(format!("{files} files are as many scans: say how far apart they are, with --every")).into()
            );
        }
    };
    let time = |index: i64| every.checked_mul(index).and_then(|after| at.checked_add(after));
    let times = (0..).take(files).map(time).collect::<Option<Vec<i64>>>();
    times.ok_or_else(|| Misused("--at and --every lead beyond the year 2262".to_owned()).into())
}

fn scan_file(file: &Path) -> anyhow::Result<(ScanFile<BufReader<File>>, Option<u64>)> {
    let open = File::open(file)?;
    let total = open.metadata().ok().filter(|metadata| metadata.is_file()).map(|metadata| metadata.len());
    Ok((ScanFile::new(BufReader::with_capacity(BUFFER_BYTES, open))?, total))
}

/// Whether the cells of a file of scans are those of the grid.
fn fits(header: &ScanFileHeader, grid: &Grid) -> anyhow::Result<()> {
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
    sender: &mpsc::Sender<anyhow::Result<Chunk>>,
) {
    loop {
        let chunk = match file.next_scans() {
            Ok(None) => return,
            Ok(Some(mut scans)) => {
                if is_flat {
                    scans.iter_mut().for_each(spell_out_layers);
                }
                let scans = scans.into_iter().map(FromFile::Wire).collect();
                Ok(Chunk { scans, position: file.bytes() })
            }
            Err(error) => Err(anyhow::Error::new(error).context(name.to_owned())),
        };
        let failed = chunk.is_err();
        if sender.blocking_send(chunk).is_err() || failed {
            return;
        }
    }
}

/// "Every cell was observed" means one layer in a flat grid: says so in full.
fn spell_out_layers(scan: &mut FileScan) {
    if let Some(Content::Tiles(tiles)) = &mut scan.scan.content
        && tiles.observed.is_empty()
    {
        let layer = [[u8::MAX; 8], [0; 8], [0; 8], [0; 8], [0; 8], [0; 8], [0; 8], [0; 8]];
        tiles.observed = layer.as_flattened().repeat(tiles.masked.len());
    }
}

/// The scan that a file makes.
fn one_scan(file: &Path, kind: Kind, given: &Given, grid: &Grid, bar: &Bar) -> anyhow::Result<Scan> {
    let tiles = |on: OnGrid| {
        if let Some(notice) = on.notice {
            bar.notice(&format!("{}: {notice}", file.display()));
        }
        Scan::Tiles(on.tiles)
    };
    match kind {
        Kind::Pcd => cloud(pcd::read(&fs::read(file)?)?, given),
        Kind::Ply => cloud(ply::read(&fs::read(file)?)?, given),
        Kind::OctoMap => of_octomap(&octomap::read(&fs::read(file)?)?, grid).map(tiles),
        Kind::Plane => of_plane(&plane(file)?, grid).map(tiles),
        Kind::Scans => anyhow::bail!("a file of scans is not one scan"),
    }
}

fn cloud(points: PointFile, given: &Given) -> anyhow::Result<Scan> {
    let own = points.pose.map(|pose| Pose { position_m: pose.position_m, quaternion_xyzw: pose.quaternion_xyzw });
    let pose = given.pose.or(own).context("the file does not say where the sensor was: say it with --pose")?;
    Ok(Scan::Cloud(PointCloud {
        pose,
        frame_id: String::new(),
        xyz_m: points.points.into_flattened(),
        min_range_m: given.min_range_m,
        max_range_m: given.max_range_m,
    }))
}

/// A grid in the plane from its YAML file, or from its image with the YAML file of the same name beside it.
fn plane(file: &Path) -> anyhow::Result<nav2::Grid> {
    let is_image = file.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("pgm"));
    let settings_path = if is_image { file.with_extension("yaml") } else { file.to_path_buf() };
    let settings = fs::read(&settings_path).with_context(|| settings_path.display().to_string())?;
    let settings = nav2::read_settings(&settings).with_context(|| settings_path.display().to_string())?;
    let image_path = match (is_image, settings_path.parent()) {
        (true, _) => file.to_path_buf(),
        (false, Some(folder)) => folder.join(&settings.image),
        (false, None) => PathBuf::from(&settings.image),
    };
    let image = fs::read(&image_path).with_context(|| image_path.display().to_string())?;
    nav2::read(&settings, &image).with_context(|| image_path.display().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn given() -> Given {
        Given { at_nanos: Some(100), every_nanos: None, pose: None, min_range_m: 0.0, max_range_m: 0.0 }
    }

    #[test]
    fn an_ending_says_what_a_file_is() {
        assert_eq!(kind(Path::new("a/b.TMS")).ok(), Some(Kind::Scans));
        assert_eq!(kind(Path::new("map.pgm")).ok(), Some(Kind::Plane));
        for unknown in ["scan", "scan.las", "-"] {
            assert!(kind(Path::new(unknown)).is_err_and(|error| error.0.contains(".tms, .pcd")), "{unknown}");
        }
    }

    #[test]
    fn each_file_has_a_time() -> anyhow::Result<()> {
        assert_eq!(times(&given(), 1)?, [100]);
        assert_eq!(times(&Given { every_nanos: Some(5), ..given() }, 3)?, [100, 105, 110]);
        let said = |given: &Given, files| times(given, files).err().map(|error| error.to_string()).unwrap_or_default();
        assert!(said(&given(), 2).contains("--every"));
        assert!(said(&Given { at_nanos: None, ..given() }, 1).contains("--at"));
        assert!(said(&Given { every_nanos: Some(i64::MAX), ..given() }, 3).contains("2262"));
        Ok(())
    }

    #[test]
    fn a_file_of_scans_has_to_be_of_the_same_cells() {
        let grid = Grid { resolution_m: 0.1, frame_id: "map".to_owned(), ..Grid::default() };
        let header = ScanFileHeader { resolution_m: 0.1, frame_id: "map".to_owned(), origin_m: vec![0.0; 3] };
        let said =
            |header: ScanFileHeader| fits(&header, &grid).err().map(|error| error.to_string()).unwrap_or_default();
        assert_eq!(said(header.clone()), "");
        assert_eq!(said(ScanFileHeader::default()), "");
        assert!(said(ScanFileHeader { resolution_m: 0.05, ..header.clone() }).contains("0.05 m wide"));
        assert!(said(ScanFileHeader { frame_id: "odom".to_owned(), ..header.clone() }).contains("\"odom\""));
        assert!(said(ScanFileHeader { origin_m: vec![0.0, 0.05, 0.0], ..header }).contains("0.05"));
    }
}
