//! Scans of a simulated office of real size.
//!
//! Invariant: the office is the office of the published measurements: 213,000 cells of 0.1 m, of which 15,000 change.

use std::{fs, path::Path};

use tidemap_sim::{GridOffice, GridOfficeOptions};

use super::{SEED, SampleFile, ZONE};
use crate::commands::office_scans::record_office;

const DAYS: u32 = 14;
const SCANS_PER_DAY: u32 = 96;

const TRY: &str = r#"#!/bin/sh
# Two weeks of scans of an office. Start a daemon first, in a terminal of its own: tidemapd --data-dir ./tidemap-data
cd "$(dirname "$0")" || exit 1
set -ex

# A map with a grid of 0.1 m, and the scans. With --nightly it learns as if the two weeks happened now.
tidemap map create hall --time-zone Europe/London --grid resolution=0.1 --grid-retention forever
tidemap grid observe hall office.tms --producer robot-1 --nightly
tidemap update hall

# The map as it will probably be on the Monday after, at ten in the morning and at three at night.
tidemap grid predict hall --at 2025-03-17T10:00:00Z --z 0.1:1.8 --out ten.png
tidemap grid predict hall --at 2025-03-17T03:00:00Z --z 0.1:1.8 --out three.png

# The information of an observation from the middle, and a tour.
tidemap info hall --at 2025-03-17T10:00:00Z --view 0,0,1.2
tidemap tour hall --at 2025-03-17T10:00:00Z --count 4 --start 0,0

# The page, with a slider for the time: tidemap open hall
"#;

pub(super) fn write(folder: &Path) -> anyhow::Result<Vec<SampleFile>> {
    let office = GridOffice::new(&GridOfficeOptions {
        seed: SEED,
        zone: ZONE.to_owned(),
        scans_per_day: SCANS_PER_DAY,
        ..GridOfficeOptions::default()
    })?;
    record_office(&folder.join("office.tms"), &office, DAYS, SCANS_PER_DAY)?;
    fs::write(folder.join("try.sh"), TRY)?;
    let scans = u64::from(DAYS) * u64::from(SCANS_PER_DAY);
    Ok(vec![
        SampleFile { name: "office.tms", rows: scans, what: "scans, one every 15 minutes" },
        SampleFile { name: "try.sh", rows: TRY.lines().count() as u64, what: "commands to try" },
    ])
}
