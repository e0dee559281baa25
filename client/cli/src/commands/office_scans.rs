//! The simulated office as a file of scans.
//!
//! Invariant: the same office makes the same file. The first scan of a tile holds its whole mask, later scans only its
//! changes.

use std::{
    fs::File,
    io::BufWriter,
    path::{Path, PathBuf},
};

use anyhow::Context as _;
use tidemap_client::{
    observe::tiles::{MASK_BYTES, pack_seen},
    scan_file::{ScanFileHeader, ScanFileWriter},
};
use tidemap_proto::v1::{Scan, TileScan, scan::Content};
use tidemap_sim::{GridOffice, GridScan, GridStream};

use crate::progress::Bar;

/// Time zone of the office.
pub const OFFICE_ZONE: &str = "Europe/London";
/// Edge of a cell of the office, metres.
pub const OFFICE_RESOLUTION_M: f64 = 0.1;

/// Writes days of scans of an office and returns the length of the file. An incomplete file keeps the ending .part.
///
/// # Errors
/// The file cannot be written.
pub fn record_office(path: &Path, office: &GridOffice, days: u32, scans_per_day: u32) -> anyhow::Result<u64> {
    let mut unfinished = path.as_os_str().to_owned();
    unfinished.push(".part");
    let unfinished = PathBuf::from(unfinished);
    let shown = || unfinished.display().to_string();
    let file = File::create(&unfinished).with_context(shown)?;
    let header = ScanFileHeader { resolution_m: OFFICE_RESOLUTION_M, ..ScanFileHeader::default() };
    let mut writer = ScanFileWriter::new(BufWriter::new(file), &header).with_context(shown)?;
    let mut scans = WireScans::new(office);
    let mut stream = GridStream::new(office, days);
    let (bar, total) = (Bar::count("scans recorded"), u64::from(days) * u64::from(scans_per_day));
    let mut recorded = 0_u64;
    while let Some(scan) = stream.next() {
        let (new_tiles, wire) = scans.wire(&scan);
        writer.wire_scan(scan.utc_nanos, &new_tiles, wire).with_context(shown)?;
        recorded += 1;
        if recorded.is_multiple_of(1024) {
            bar.set_of(recorded, total);
        }
    }
    bar.clear();
    let (_, bytes) = writer.finish().with_context(shown)?;
    std::fs::rename(&unfinished, path).with_context(|| path.display().to_string())?;
    Ok(bytes)
}

/// Converts scans of the office to scans of the wire.
#[derive(Debug)]
pub struct WireScans<'a> {
    office: &'a GridOffice,
    shown: Vec<bool>,
    view: Option<u32>,
}

impl<'a> WireScans<'a> {
    /// Begins before the first scan.
    #[must_use]
    pub fn new(office: &'a GridOffice) -> Self {
        Self { office, shown: Vec::new(), view: None }
    }

    /// The converted scan, and the tiles that are new to the stream's table.
    pub fn wire(&mut self, scan: &GridScan<'_>) -> (Vec<i32>, Scan) {
        let mut tiles = TileScan::default();
        let mut new_tiles = Vec::new();
        if self.view.is_none() {
            new_tiles = self.office.tiles().as_flattened().to_vec();
        }
        if self.view != Some(scan.view) {
            let slots = self.office.view_slots(scan.view);
            tiles.seen = pack_seen(slots.iter().copied());
            let view = scan.view as usize;
            if self.shown.len() <= view {
                self.shown.resize(view + 1, false);
            }
            if !std::mem::replace(&mut self.shown[view], true) {
                // Everything is observed; whole masks of the occupied cells are smaller than one flip per cell.
                tiles.masked = slots.to_vec();
                tiles.occupied = occupied_masks(slots, scan.occupied_flips);
            }
            self.view = Some(scan.view);
        }
        if !tiles.masked.is_empty() {
            return (new_tiles, Scan { content: Some(Content::Tiles(tiles)) });
        }
        let mut before = 0;
        let difference = |&cell: &u32| cell - std::mem::replace(&mut before, cell);
        tiles.occupied_flips = scan.occupied_flips.iter().map(difference).collect();
        (new_tiles, Scan { content: Some(Content::Tiles(tiles)) })
    }
}

/// The masks of slots with these occupied cells; both are ascending.
fn occupied_masks(slots: &[u32], occupied: &[u32]) -> Vec<u8> {
    let mut masks = vec![0; slots.len() * MASK_BYTES];
    let mut cells = occupied.iter().peekable();
    for (slot, mask) in slots.iter().zip(masks.chunks_exact_mut(MASK_BYTES)) {
        while let Some(cell) = cells.next_if(|cell| **cell / 512 <= *slot) {
            mask[*cell as usize % 512 / 8] |= 1 << (cell % 8);
        }
    }
    masks
}

#[cfg(test)]
mod tests {
    use tidemap_client::observe::tiles::{Mask, TileTable};
    use tidemap_sim::GridOfficeOptions;

    use super::*;

    #[test]
    fn the_file_shows_the_office() -> anyhow::Result<()> {
        let options = GridOfficeOptions {
            cells: 20_000,
            changing_cells: 1_000,
            scans_per_day: 96,
            views: 3,
            dwell_scans: 2,
            ..GridOfficeOptions::default()
        };
        let office = GridOffice::new(&options)?;
        let (mut table, mut scans) = (TileTable::default(), WireScans::new(&office));
        let mut stream = GridStream::new(&office, 1);
        while let Some(scan) = stream.next() {
            let (new_tiles, wire) = scans.wire(&scan);
            table.extend(&new_tiles)?;
            let Some(Content::Tiles(tiles)) = wire.content else { anyhow::bail!("tiles") };
            table.apply(&tiles)?;
            let seen: Vec<u32> = table.picture().seen().collect();
            assert_eq!(seen, office.view_slots(scan.view));
            for &slot in seen.iter().step_by(5) {
                let masks = table.picture().masks(slot);
                assert_eq!(masks.observed(), Mask::FULL);
                for cell in (0..512).step_by(37) {
                    let shown = masks.occupied().contains(cell as u16);
                    assert_eq!(shown, office.truth(slot, cell, scan.utc_nanos), "{slot} {cell}");
                }
            }
        }
        assert!(table.tiles().iter().map(|tile| [tile.x, tile.y, tile.z]).eq(office.tiles().iter().copied()));
        Ok(())
    }
}
