//! The options of a grid office and their ranges.

use jiff::civil::{Date, date};

use super::floor::TILE_CELLS;
use crate::zone::UnknownZone;

/// The options of a grid office.
#[derive(Clone, Debug, PartialEq)]
pub struct GridOfficeOptions {
    /// Different seeds give different people, things and days.
    pub seed: u64,
    /// IANA name of the time zone of the office.
    pub zone: String,
    /// The local date at whose midnight the stream starts; 1970 to 2200.
    pub first_day: Date,
    /// Number of cells, rounded up to whole tiles of 512; 1 to 2^31.
    pub cells: u32,
    /// Scans in 86,400 s; 1 to 86,400.
    pub scans_per_day: u32,
    /// Number of cells that change; at least 1, at most an eighth of all. Routines are realistic up to a twelfth of
    /// all cells and from about 100,000 cells on; beyond that, more of the changing cells are edges.
    pub changing_cells: u32,
    /// Mean number of changes of a changing cell in a day; at most 500, and not below the number that routines alone
    /// make, about 4. A sensor with a scan every 6 s or more often sees every change.
    pub changes_per_day: f64,
    /// 1: a fixed sensor that sees all cells in each scan. N: a sensor that visits N views in turn, each of about 1/N
    /// of the tiles; at most the number of tiles.
    pub views: u32,
    /// Number of consecutive scans of one view; at least 1.
    pub dwell_scans: u32,
}

impl Default for GridOfficeOptions {
    /// The size of the published office grid, in London, starting on a Monday in spring.
    fn default() -> Self {
        Self {
            seed: 1,
            zone: "Europe/London".to_owned(),
            first_day: date(2025, 3, 3),
            cells: 213_000,
            scans_per_day: 17_200,
            changing_cells: 15_000,
            changes_per_day: 40.0,
            views: 1,
            dwell_scans: 1,
        }
    }
}

/// Why the options of a grid office are invalid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of each variant names its fields")]
pub enum GridOfficeError {
    /// The time zone is not known.
    #[error(transparent)]
    Zone(#[from] UnknownZone),
    /// An option is out of its range.
    #[error("{option} must be {allowed}, and is {given}")]
    OutOfRange { option: &'static str, allowed: String, given: String },
    /// People, chairs and doors alone make more changes.
    #[error("changes_per_day is {requested}, and the routines of this office alone make {least:.1}")]
    TooQuiet { requested: f64, least: f64 },
}

impl GridOfficeOptions {
    /// Checks every range; `tiles` is the number of tiles that the cells take.
    pub(super) fn check(&self, tiles: u32) -> Result<(), GridOfficeError> {
        let within = |option, given: u32, from: u32, to: u32| {
            let refused =
                || GridOfficeError::OutOfRange { option, allowed: format!("{from} to {to}"), given: given.to_string() };
            (from..=to).contains(&given).then_some(()).ok_or_else(refused)
        };
        within("the year of first_day", u32::try_from(self.first_day.year()).unwrap_or(0), 1970, 2200)?;
        within("cells", self.cells, 1, 1 << 31)?;
        within("scans_per_day", self.scans_per_day, 1, 86_400)?;
        within("changing_cells", self.changing_cells, 1, tiles * TILE_CELLS / 8)?;
        within("views", self.views, 1, tiles)?;
        within("dwell_scans", self.dwell_scans, 1, u32::MAX)?;
        if !(0.0..=500.0).contains(&self.changes_per_day) {
            return Err(GridOfficeError::OutOfRange {
                option: "changes_per_day",
                allowed: "0 to 500".to_owned(),
                given: self.changes_per_day.to_string(),
            });
        }
        Ok(())
    }
}
