//! The plan for sending files as scans, with its checks.
//!
//! Invariant: in a plan every file exists, every point cloud has a pose, and every option applies to a file. The plan
//! is complete before the daemon is contacted.

use std::{
    collections::HashSet,
    fs::{self, File},
    io::Read as _,
    path::{Path, PathBuf},
};

use anyhow::Context as _;
use tidemap_client::observe::scan::Isometry3;

use super::{super::cell_masks::Between, plane_files};
use crate::{
    commands::{UsageError, files, usage},
    progress::status_line,
};
use tidemap_formats::pcd;

/// Maximum length of a point cloud's header, in bytes.
const HEADER_BYTES: u64 = 64 * 1024;

/// The options that describe the scans.
#[derive(Clone, Debug)]
pub(in crate::commands::grid) struct ScanOptions {
    pub(in crate::commands::grid) pose: Option<Isometry3<f64>>,
    pub(in crate::commands::grid) min_range_m: Option<f32>,
    pub(in crate::commands::grid) max_range_m: Option<f32>,
    pub(in crate::commands::grid) between: Option<Between>,
    /// Pixels of value 205 are unknown, whatever the thresholds.
    pub(in crate::commands::grid) is_205_unknown: bool,
}

/// The format of a file, by its ending.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::commands::grid) enum FileKind {
    Scans,
    Pcd,
    Ply,
    OctoMap,
    Plane,
}

/// The files to send.
#[derive(Debug)]
pub(in crate::commands::grid) enum ScanPlan {
    /// A file of scans.
    Scans(PathBuf),
    /// Files of one scan each.
    Each(Vec<(PathBuf, FileKind)>, ScanOptions),
}

/// The files that paths name: a folder means its files with a known ending, by name. The image of a 2D map is left out
/// if its YAML file is also named: both are one map.
///
/// # Errors
/// A folder cannot be read, or has no such file.
pub(in crate::commands::grid) fn named(paths: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let mut named = Vec::with_capacity(paths.len());
    for path in paths {
        if !path.is_dir() {
            named.push(path.clone());
            continue;
        }
        let shown = || path.display().to_string();
        let entries = fs::read_dir(path).with_context(shown)?.collect::<Result<Vec<_>, _>>().with_context(shown)?;
        let mut within: Vec<PathBuf> = entries.into_iter().map(|entry| entry.path()).collect();
        within.retain(|file| file.is_file() && kind(file).is_ok());
        if within.is_empty() {
            return Err(usage(format!("{}: no file there ends in .tms, .pcd, .ply, .bt, .ot, .yaml or .pgm", shown())));
        }
        within.sort_unstable();
        named.append(&mut within);
    }
    let images: HashSet<PathBuf> =
        named.iter().filter(|file| is_settings(file)).filter_map(|file| Some(plane_files(file).ok()?.1)).collect();
    let before = named.len();
    named.retain(|file| is_settings(file) || !images.contains(file));
    if named.len() < before {
        let count = before - named.len();
        let (images, are) = if count == 1 { ("image", "is") } else { ("images", "are") };
        status_line(&format!("{count} {images} of maps {are} left out: the .yaml files beside them are sent"));
    }
    Ok(named)
}

/// Whether a file is the YAML file of a 2D map.
fn is_settings(file: &Path) -> bool {
    matches!(files::ending(file).as_deref(), Some("yaml" | "yml"))
}

/// Plans how to send files. `has_times`: options give them times.
pub(in crate::commands::grid) fn plan(
    files: &[PathBuf],
    has_times: bool,
    options: &ScanOptions,
) -> anyhow::Result<ScanPlan> {
    let kinds = files.iter().map(|file| kind(file)).collect::<Result<Vec<FileKind>, UsageError>>()?;
    if kinds.contains(&FileKind::Scans) {
        let [file] = files else {
            return Err(usage("a .tms file is sent alone: give one file per command"));
        };
        if has_times || options.has_sensor() {
            let text = "a .tms file has its own times, poses and ranges: leave out --at, --every, --times-from, \
                        --times-file, --pose, --min-range and --max-range";
            return Err(usage(text));
        }
        options.check_between(&kinds)?;
        return Ok(ScanPlan::Scans(file.clone()));
    }
    options.check_ranges()?;
    options.check_between(&kinds)?;
    for (file, kind) in files.iter().zip(&kinds) {
        check(file, *kind, options)?;
    }
    Ok(ScanPlan::Each(files.iter().cloned().zip(kinds).collect(), options.clone()))
}

impl ScanOptions {
    /// Whether an option describes the sensor.
    fn has_sensor(&self) -> bool {
        self.pose.is_some() || self.min_range_m.is_some() || self.max_range_m.is_some()
    }

    fn check_between(&self, kinds: &[FileKind]) -> Result<(), UsageError> {
        match self.between {
            Some(_) if !kinds.contains(&FileKind::Plane) => {
                Err(UsageError("--between is for maps of Nav2, .yaml or .pgm: leave it out".to_owned()))
            }
            _ if self.is_205_unknown && !kinds.contains(&FileKind::Plane) => {
                Err(UsageError("--unknown-205 is for maps of Nav2, .yaml or .pgm: leave it out".to_owned()))
            }
            _ => Ok(()),
        }
    }

    fn check_ranges(&self) -> Result<(), UsageError> {
        match (self.min_range_m, self.max_range_m) {
            // A maximum range of 0 means no limit.
            (Some(min), Some(max)) if max > 0.0 && min > max => {
                Err(UsageError(format!("--min-range {min} is above --max-range {max}: no point would be left")))
            }
            _ => Ok(()),
        }
    }
}

fn kind(path: &Path) -> Result<FileKind, UsageError> {
    match files::ending(path).as_deref() {
        Some("tms") => Ok(FileKind::Scans),
        Some("pcd") => Ok(FileKind::Pcd),
        Some("ply") => Ok(FileKind::Ply),
        Some("bt" | "ot") => Ok(FileKind::OctoMap),
        Some("yaml" | "yml" | "pgm") => Ok(FileKind::Plane),
        _ => Err(UsageError(format!(
            "{}: unknown ending: use .tms, .pcd, .ply, .bt, .ot, .yaml or .pgm",
            path.display()
        ))),
    }
}

/// Checks that a file exists and that the sensor options fit it.
fn check(file: &Path, kind: FileKind, options: &ScanOptions) -> anyhow::Result<()> {
    let shown = || file.display().to_string();
    if matches!(kind, FileKind::OctoMap | FileKind::Plane) && options.has_sensor() {
        let text = "it is a map, not a sensor scan: leave out --pose, --min-range and --max-range";
        return Err(usage(format!("{}: {text}", file.display())));
    }
    let open = File::open(file).with_context(shown)?;
    let has_pose = match kind {
        FileKind::Pcd if options.pose.is_none() => {
            let mut start = Vec::new();
            open.take(HEADER_BYTES).read_to_end(&mut start).with_context(shown)?;
            // Errors in the file are reported when it is read.
            pcd::read_pose(&start).map_or(true, |pose| pose.is_some())
        }
        FileKind::Ply => options.pose.is_some(),
        FileKind::Plane => {
            let (_, image) = plane_files(file).with_context(shown)?;
            File::open(&image).with_context(|| image.display().to_string())?;
            true
        }
        FileKind::Pcd | FileKind::OctoMap | FileKind::Scans => true,
    };
    if has_pose {
        return Ok(());
    }
    let text = "the file has no sensor pose: give one with --pose";
    Err(usage(format!("{}: {text}", file.display())))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options() -> ScanOptions {
        ScanOptions { pose: None, min_range_m: None, max_range_m: None, between: None, is_205_unknown: false }
    }

    fn message(file: &Path, options: &ScanOptions) -> (String, bool) {
        let error = plan(&[file.to_path_buf()], true, options).err();
        error.map(|error| (format!("{error:#}"), error.is::<UsageError>())).unwrap_or_default()
    }

    #[test]
    fn an_ending_decides_what_a_file_is() {
        assert_eq!(kind(Path::new("a/b.TMS")).ok(), Some(FileKind::Scans));
        assert_eq!(kind(Path::new("map.pgm")).ok(), Some(FileKind::Plane));
        for unknown in ["scan", "scan.las", "-"] {
            assert!(kind(Path::new(unknown)).is_err_and(|error| error.0.contains(".tms, .pcd")), "{unknown}");
        }
    }

    #[test]
    fn what_makes_no_sense_is_noticed_beforehand() -> anyhow::Result<()> {
        let folder = tempfile::tempdir()?;
        let file = |name: &str, text: &str| -> anyhow::Result<PathBuf> {
            let path = folder.path().join(name);
            std::fs::write(&path, text)?;
            Ok(path)
        };
        let header = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 1\nHEIGHT 1\n";
        let turned = file("posed.pcd", &format!("{header}VIEWPOINT 1 2 3 1 0 0 0\nDATA ascii\n1 2 3\n"))?;
        let bare = file("bare.pcd", &format!("{header}DATA ascii\n1 2 3\n"))?;
        let posed = ScanOptions { pose: Some(Isometry3::identity()), ..options() };
        assert_eq!(message(&turned, &options()), (String::new(), false));
        assert_eq!(message(&bare, &posed), (String::new(), false));
        for cloud in [bare, file("bare.ply", "ply\n")?] {
            let (error, is_usage) = message(&cloud, &options());
            assert!(is_usage && error.contains("bare.") && error.contains("--pose"), "{error}");
        }
        let octomap = file("map.bt", "")?;
        assert_eq!(message(&octomap, &options()), (String::new(), false));
        for sensor in [&posed, &ScanOptions { max_range_m: Some(5.0), ..options() }] {
            let (error, is_usage) = message(&octomap, sensor);
            assert!(is_usage && error.contains("leave out --pose"), "{error}");
        }
        let ranges = |min, max| ScanOptions { min_range_m: Some(min), max_range_m: Some(max), ..posed.clone() };
        assert_eq!(message(&turned, &ranges(5.0, 0.0)), (String::new(), false));
        let (error, is_usage) = message(&turned, &ranges(5.0, 3.0));
        assert!(is_usage && error.contains("--min-range 5 is above --max-range 3"), "{error}");
        let (error, is_usage) = message(&octomap, &ScanOptions { between: Some(Between::Leave), ..options() });
        assert!(is_usage && error.contains("--between"), "{error}");
        let (error, is_usage) = message(Path::new("office.tms"), &options());
        assert!(is_usage && error.contains("leave out --at"), "{error}");
        let (error, is_usage) = message(&folder.path().join("absent.pcd"), &options());
        assert!(!is_usage && error.contains("absent.pcd"), "{error}");
        Ok(())
    }

    #[test]
    fn a_folder_is_its_maps_and_an_image_beside_its_settings_is_none_of_its_own() -> anyhow::Result<()> {
        let folder = tempfile::tempdir()?;
        let settings = |image: &str| {
            format!(
                "image: {image}\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
            )
        };
        for (name, text) in [
            ("b.yaml", settings("b.pgm")),
            ("b.pgm", String::new()),
            ("a.yaml", settings("other.pgm")),
            ("other.pgm", String::new()),
            ("notes.txt", String::new()),
        ] {
            std::fs::write(folder.path().join(name), text)?;
        }
        let path = |name: &str| folder.path().join(name);
        assert_eq!(named(&[folder.path().to_path_buf()])?, [path("a.yaml"), path("b.yaml")]);
        assert_eq!(named(&[path("b.pgm"), path("b.yaml"), path("a.yaml")])?, [path("b.yaml"), path("a.yaml")]);
        assert_eq!(named(&[path("b.pgm")])?, [path("b.pgm")], "an image alone is a map");
        assert_eq!(named(&[path("b.yaml"), path("b.yaml")])?.len(), 2, "what is named twice is meant twice");
        let empty = tempfile::tempdir()?;
        assert!(named(&[empty.path().to_path_buf()]).is_err_and(|error| error.is::<UsageError>()));
        Ok(())
    }

    #[test]
    fn a_file_is_named_once() -> anyhow::Result<()> {
        let folder = tempfile::tempdir()?;
        let yaml = folder.path().join("g.yaml");
        std::fs::write(&yaml, "image: absent.pgm\n")?;
        let (error, _) = message(&yaml, &options());
        assert_eq!(error.matches("g.yaml").count(), 1, "{error}");
        Ok(())
    }
}
