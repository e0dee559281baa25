//! One door, as a robot saw it that passes it now and then.
//!
//! Invariant: the door is a door of the simulated office.

use std::{fs, path::Path};

use tidemap_sim::Office;

use super::{SEED, SampleFile, ZONE, observed};

const TRY: &str = r#"#!/bin/sh
# A door, three weeks long. Start a daemon first, in a terminal of its own: tidemapd --data-dir ./tidemap-data
cd "$(dirname "$0")" || exit 1
set -ex

# A map, and the observations of the robot. Sending the file again changes nothing.
tidemap map create door --time-zone Europe/London
tidemap observe door door.csv --producer robot-ada

# Learn now instead of at midnight, and predict the Tuesday after.
tidemap update door
tidemap predict door office-1-door --from 2025-01-28T00:00:00Z --to 2025-01-29T00:00:00Z --step 2h

# The learned model, and the unusual observations.
tidemap model show door office-1-door
tidemap anomalies door office-1-door --confidence 0.9 --from 2025-01-06T00:00:00Z --to 2025-01-27T00:00:00Z
"#;

pub(super) fn write(folder: &Path) -> anyhow::Result<Vec<SampleFile>> {
    let office = Office::new(SEED, ZONE)?;
    let (text, rows) = observed(&office, 0, 21, |state| state == "office-1-door");
    fs::write(folder.join("door.csv"), text)?;
    fs::write(folder.join("try.sh"), TRY)?;
    Ok(vec![
        SampleFile { name: "door.csv", rows, what: "the door, open (1) or shut (0), observed by robot-ada" },
        SampleFile { name: "try.sh", rows: TRY.lines().count() as u64, what: "commands to try" },
    ])
}
