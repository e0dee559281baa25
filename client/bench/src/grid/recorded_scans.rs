//! An existing file of scans.
//!
//! Invariant: its content is read from the file; options are only compared with it.

use std::{
    fs::File,
    io::BufReader,
    path::{Path, PathBuf},
};

use anyhow::Context as _;
use tidemap_client::{observe::tiles::TileTable, scan_file::ScanFile};
use tidemap_proto::v1::scan::Content;
use tidemap_sim::GridStream;

use super::{GridArgs, office};

const BUFFER_BYTES: usize = 1 << 20;
const DAY_NANOS: f64 = 86_400e9;

/// Full comparisons of all cells per day.
const COMPARISONS_PER_DAY: u32 = 24;

/// A file and its rate of scans.
#[derive(Debug)]
pub(super) struct RecordedScans {
    path: PathBuf,
    scans_per_day: Option<f64>,
}

impl RecordedScans {
    /// Reads the first two scans.
    pub(super) fn inspect(path: &Path) -> anyhow::Result<Self> {
        let shown = || path.display().to_string();
        let mut file = open(path).with_context(shown)?;
        let mut times = Vec::new();
        while times.len() < 2 {
            let Some(scans) = file.next_scans().with_context(shown)? else { break };
            times.extend(scans.iter().map(|scan| scan.time_nanos));
        }
        let step_nanos = times.first().zip(times.get(1)).map(|(first, second)| (second - first) as f64);
        let scans_per_day = step_nanos.filter(|step| *step > 0.0).map(|step| (DAY_NANOS / step).round());
        Ok(Self { path: path.to_path_buf(), scans_per_day })
    }

    /// Scans per day; `None` if the file has fewer than two scans.
    pub(super) fn scans_per_day(&self) -> Option<f64> {
        self.scans_per_day
    }

    /// Whether its first day matches the options.
    pub(super) fn matches(&self, args: &GridArgs) -> anyhow::Result<bool> {
        let shown = || self.path.display().to_string();
        let office = office::make(args)?;
        let (mut stream, mut wire_scans) = (GridStream::new(&office, 1), tidemap_cli::WireScans::new(&office));
        let (mut actual, mut expected) = (TileTable::default(), TileTable::default());
        let mut file = open(&self.path).with_context(shown)?;
        let comparison_every = u64::from((args.scans_per_day / COMPARISONS_PER_DAY).max(1));
        while let Some(scans) = file.next_scans().with_context(shown)? {
            for of_file in scans {
                let Some(scan) = stream.next() else { return Ok(true) };
                if scan.utc_nanos != of_file.time_nanos {
                    return Ok(false);
                }
                let (new_tiles, wire) = wire_scans.wire(&scan);
                show(&mut expected, &new_tiles, wire.content.as_ref())?;
                show(&mut actual, &of_file.new_tiles, of_file.scan.content.as_ref()).with_context(shown)?;
                let is_comparison = of_file.number % comparison_every == 1 % comparison_every;
                if is_comparison
                    && (actual.tiles() != expected.tiles() || !actual.picture().all().eq(expected.picture().all()))
                {
                    return Ok(false);
                }
            }
        }
        Ok(true)
    }
}

fn open(path: &Path) -> anyhow::Result<ScanFile<BufReader<File>>> {
    Ok(ScanFile::new(BufReader::with_capacity(BUFFER_BYTES, File::open(path)?))?)
}

fn show(table: &mut TileTable, new_tiles: &[i32], content: Option<&Content>) -> anyhow::Result<()> {
    table.extend(new_tiles)?;
    if let Some(Content::Tiles(tiles)) = content {
        table.apply(tiles)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: GridArgs,
    }

    #[test]
    fn a_file_matches_the_options_that_it_was_made_with() -> anyhow::Result<()> {
        let usual = "bench --cells 20000 --changing-cells 1400 --scans-per-day 96 --days 1";
        let args =
            |more: &str| Line::try_parse_from(usual.split(' ').chain(more.split_whitespace())).map(|line| line.args);
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("made.tms");
        office::write(&path, &args("")?)?;
        let recorded = RecordedScans::inspect(&path)?;
        assert_eq!(recorded.scans_per_day(), Some(96.0));
        assert!(recorded.matches(&args("")?)? && recorded.matches(&args("--keep")?)?);
        for other in ["--seed 2", "--views 2", "--changes-per-day 20"] {
            assert!(!recorded.matches(&args(other)?)?, "{other}");
        }
        Ok(())
    }
}
