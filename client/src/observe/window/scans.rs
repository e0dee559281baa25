//! The scans of a window.
//!
//! Invariant: a scan of tiles is kept as its difference to the previous scan of tiles of the producer; each of its
//! slots is among the first [`KeptScan::tiles`] of the table of the producer.

use tidemap_grid::index::{CellBox, TileIndex};
use tidemap_proto::{
    convert::scans::{EncodedScan, TileError, TilePicture, TileTable, content_digest},
    v1::{self, scan::Content},
};

use super::{Item, Window};
use crate::observe::scan::{Scan, wire_bytes};

/// A scan that is kept until it is durable.
#[derive(Clone, Debug)]
pub struct KeptScan {
    time_nanos: i64,
    digest: u64,
    tiles: usize,
    content: Content,
    shown: CellBox,
}

impl KeptScan {
    /// Time, nanoseconds UTC.
    #[must_use]
    pub fn time_nanos(&self) -> i64 {
        self.time_nanos
    }

    /// Digest.
    #[must_use]
    pub fn digest(&self) -> u64 {
        self.digest
    }

    /// Length of the table of tiles, including the new tiles of this scan.
    #[must_use]
    pub fn tiles(&self) -> usize {
        self.tiles
    }

    /// Content, with the slots of the table of the producer.
    #[must_use]
    pub fn content(&self) -> &Content {
        &self.content
    }

    /// The cells that the scan shows; empty if the scan does not state them.
    #[must_use]
    pub fn shown(&self) -> CellBox {
        self.shown
    }

    /// Maximum number of bytes on the wire, without tiles that must be sent again.
    #[must_use]
    pub fn bytes(&self) -> usize {
        wire_bytes(&self.content)
    }

    /// Applies the scan to a picture.
    pub(crate) fn follow_in(&self, picture: &mut TilePicture) {
        if let Content::Tiles(scan) = &self.content {
            picture.grow(self.tiles);
            picture.follow(scan, |_| {});
        }
    }
}

impl Window {
    /// Pushes a scan and returns its number, whether there is room or not.
    ///
    /// # Errors
    /// [`TileError`]; it is then not accepted.
    pub fn push_scan(&mut self, time_nanos: i64, scan: Scan) -> Result<u64, TileError> {
        let shown = if let Scan::Map { shown, .. } = &scan { *shown } else { CellBox::default() };
        let (content, digest) = match scan {
            Scan::Tiles(tiles) | Scan::Map { tiles, .. } => {
                let EncodedScan { scan, digest, .. } = self.tiles.encode(&tiles)?;
                (Content::Tiles(scan), digest)
            }
            Scan::Cloud(cloud) => digested(Content::Cloud(cloud.into())),
            Scan::Ranges(ranges) => digested(Content::Ranges(ranges.into())),
        };
        Ok(self.keep(time_nanos, digest, content, shown))
    }

    /// Pushes a scan in wire form; its slots number the tiles so far, including `new_tiles`.
    ///
    /// # Errors
    /// [`TileError`]; it is then not accepted.
    pub fn push_wire_scan(&mut self, time_nanos: i64, new_tiles: &[i32], scan: v1::Scan) -> Result<u64, TileError> {
        self.tiles.extend(new_tiles)?;
        let content = scan.content.unwrap_or_else(|| Content::Tiles(v1::TileScan::default()));
        let (content, digest) = match content {
            Content::Tiles(scan) => {
                let digest = self.tiles.apply(&scan)?;
                (Content::Tiles(scan), digest)
            }
            points => digested(points),
        };
        Ok(self.keep(time_nanos, digest, content, CellBox::default()))
    }

    fn keep(&mut self, time_nanos: i64, digest: u64, content: Content, shown: CellBox) -> u64 {
        let tiles = self.tiles.tiles().len();
        self.take(Item::Scan(Box::new(KeptScan { time_nanos, digest, tiles, content, shown })))
    }

    /// Continues from the table of tiles after the last scan that the daemon has.
    pub fn go_on_from(&mut self, tiles: TileTable) {
        debug_assert!(self.entries.is_empty(), "scans follow it");
        self.base = tiles.picture().clone();
        self.tiles = tiles;
    }

    /// The table after the last pushed scan.
    #[must_use]
    pub fn into_tiles(self) -> TileTable {
        self.tiles
    }

    /// The producer's tiles.
    #[must_use]
    pub fn tiles(&self) -> &[TileIndex] {
        self.tiles.tiles()
    }

    /// Tiles after the last acknowledged scan.
    #[must_use]
    pub fn base(&self) -> &TilePicture {
        &self.base
    }

    /// The scans to send next, at most `max_count`; empty if it is better to wait for more, or another kind of item
    /// comes next.
    pub fn scans_to_send(&self, max_count: usize, bytes: usize, urgent: u64) -> impl Iterator<Item = &KeptScan> {
        self.unsent(max_count, bytes, urgent).map_while(|item| match item {
            Item::Scan(scan) => Some(&**scan),
            Item::Observation(_) | Item::Report(_) => None,
        })
    }
}

fn digested(content: Content) -> (Content, u64) {
    let digest = content_digest(&content);
    (content, digest)
}
