//! The simulated office of the options.
//!
//! Invariant: the same options make the same file.

use std::path::Path;

use tidemap_cli::{OFFICE_ZONE, record_office};
use tidemap_sim::{GridOffice, GridOfficeError, GridOfficeOptions};
use tidemap_terminal::failure::usage;

use super::GridArgs;

/// The office that the options describe.
pub(super) fn make(args: &GridArgs) -> anyhow::Result<GridOffice> {
    let office = GridOffice::new(&GridOfficeOptions {
        seed: args.seed,
        zone: OFFICE_ZONE.to_owned(),
        cells: args.cells,
        scans_per_day: args.scans_per_day,
        changing_cells: args.changing_cells,
        changes_per_day: args.changes_per_day,
        views: args.views,
        dwell_scans: args.dwell_scans,
        ..GridOfficeOptions::default()
    });
    office.map_err(|error| match error {
        GridOfficeError::OutOfRange { option, allowed, given } => {
            let option = option.replace('_', "-");
            usage(format!("--{option} {given}: it has to be {allowed}"))
        }
        GridOfficeError::TooQuiet { requested, least } => {
            let text = format!("--changes-per-day {requested}: the routines of this office alone make {least:.1}");
            usage(text)
        }
        GridOfficeError::Zone(_) => error.into(),
    })
}

/// Writes the file of the office that the options describe, and returns its length.
pub(super) fn write(path: &Path, args: &GridArgs) -> anyhow::Result<u64> {
    record_office(path, &make(args)?, args.days, args.scans_per_day)
}
