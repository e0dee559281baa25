//! A message of scans as sent, before its scans are decoded.
//!
//! Invariant: its sequence numbers begin at 1 or more; nothing else of it is checked.

use std::ops::RangeInclusive;

use tidemap_grid::index::CellBox;

use crate::{
    convert::{InvalidField, grid::cell_box_from_wire, sequences::sequences_from_wire},
    v1::{self, scan::Content},
};

/// Scans of one message, still packed.
#[derive(Clone, Debug)]
pub struct ScanMessage {
    sequences: RangeInclusive<u64>,
    pub(super) batch: v1::ScanBatch,
}

/// Scans of one message.
///
/// # Errors
/// The first sequence number is 0.
pub fn scans_from_wire(batch: v1::ScanBatch) -> Result<ScanMessage, InvalidField> {
    let sequences = sequences_from_wire(batch.first_sequence, batch.scans.len())?;
    Ok(ScanMessage { sequences, batch })
}

/// The readings of a scan, or of a part of it, as sent: any number, and NaN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SentReadings<'a> {
    /// Points: x, y, z of each in metres.
    Points(&'a [f32]),
    /// Ranges, metres.
    Ranges(&'a [f32]),
}

/// The rays of a scan, or of a part of it, as sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SentRays<'a> {
    /// The readings.
    pub readings: SentReadings<'a>,
    /// Maximum length of a ray, metres; `None`: not given, perhaps because another part has it.
    pub max_range_m: Option<f32>,
}

impl ScanMessage {
    /// The sequence numbers of the scans.
    #[must_use]
    pub fn sequences(&self) -> &RangeInclusive<u64> {
        &self.sequences
    }

    /// Whether the last scan continues in the next message.
    #[must_use]
    pub fn continues(&self) -> bool {
        self.batch.continues
    }

    /// The cells that its scans are pictures of, as sent; empty if the message has none.
    #[must_use]
    pub fn shown(&self) -> CellBox {
        self.batch.shown.as_ref().map(cell_box_from_wire).unwrap_or_default()
    }

    /// The rays of each scan; `None`: it has none, because it is of tiles.
    pub fn rays(&self) -> impl ExactSizeIterator<Item = Option<SentRays<'_>>> {
        self.batch.scans.iter().map(|scan| rays_of(scan.content.as_ref()?))
    }
}

fn rays_of(content: &Content) -> Option<SentRays<'_>> {
    let (readings, max_range_m) = match content {
        Content::Cloud(cloud) => (SentReadings::Points(&cloud.xyz_m), cloud.max_range_m),
        Content::Ranges(scan) => (SentReadings::Ranges(&scan.ranges_m), scan.max_range_m),
        Content::Tiles(_) => return None,
    };
    Some(SentRays { readings, max_range_m: (max_range_m > 0.0).then_some(max_range_m) })
}
