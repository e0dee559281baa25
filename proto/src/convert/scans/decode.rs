//! Decodes messages of scans on the receiving side: checks them, joins their parts, and returns scans one by one.
//!
//! Invariant: scans are returned in the order of their numbers. An error concerns the message and ends its stream; a
//! refusal concerns one scan, and the picture of the stream is then unchanged unless the content of the scan must be
//! remembered.

use std::vec::IntoIter;

use tidemap_grid::{index::TileIndex, spec::GridSpec};
use tidemap_map::ids::RefusalReason;

use super::{
    DecodedScan, ScanContent, ScanError, ScanLimits, ScanRefusal,
    decoder_table::DecoderTable,
    digest::{points_digest, ranges_digest},
    message::ScanMessage,
    parts::Parts,
    points,
    tile_scan::TileScans,
};
use crate::{
    convert::{InvalidField, OverLimit},
    v1::{self, scan::Content},
};

/// Decodes the scans of one stream.
#[derive(Debug)]
pub struct ScanDecoder {
    spec: Option<GridSpec>,
    limits: ScanLimits,
    shown: DecoderTable,
    tile_scans: TileScans,
    /// A scan that continues in the next message.
    open: Option<Parts>,
    message: Message,
}

/// The rest of a message.
#[derive(Debug, Default)]
struct Message {
    sequence: u64,
    unit: i64,
    /// Time of the previous scan; `None` if it is invalid.
    time: Option<i64>,
    deltas: IntoIter<i64>,
    scans: IntoIter<v1::Scan>,
    continues: bool,
}

impl ScanDecoder {
    /// A new stream to a map with this grid, or without one.
    #[must_use]
    pub fn new(spec: Option<&GridSpec>, limits: ScanLimits) -> ScanDecoder {
        ScanDecoder {
            spec: spec.cloned(),
            limits,
            shown: DecoderTable::new(spec),
            tile_scans: TileScans::default(),
            open: None,
            message: Message::default(),
        }
    }

    /// The number of the scan that continues in the next message.
    #[must_use]
    pub fn open_sequence(&self) -> Option<u64> {
        self.open.as_ref().map(|open| open.sequence)
    }

    /// Approximate memory that the stream takes between messages, bytes: its table of tiles, and an unfinished scan.
    #[must_use]
    pub fn held_bytes(&self) -> usize {
        self.shown.bytes() + self.open.as_ref().map_or(0, Parts::bytes)
    }

    /// Begins a message; call [`ScanDecoder::next_scan`] until it returns `None` before the next message. Returns the
    /// tiles that the message adds to the table of the stream.
    ///
    /// # Errors
    /// The error ends the stream.
    pub fn begin(&mut self, message: ScanMessage) -> Result<Vec<TileIndex>, ScanError> {
        let message = message.batch;
        let count = message.scans.len();
        if count == 0 {
            return Err(InvalidField::new("scans.scans", "there is no scan: send at least 1").into());
        }
        OverLimit::check("scans of one message", count, self.limits.batch_scans, "setting max_batch_scans")?;
        if message.time_deltas.len() != count {
            let text = format!("{} entries for {count} scans: there is one per scan", message.time_deltas.len());
            return Err(InvalidField::new("scans.time_deltas", text).into());
        }
        // 0 is what proto3 sends for "not set", and the default is 1.
        let unit = i64::try_from(message.time_unit_nanos.max(1)).map_err(|_| {
            let text = format!("{} ns is too large: at most {} are possible", message.time_unit_nanos, i64::MAX);
            InvalidField::new("scans.time_unit_nanos", text)
        })?;
        let new_tiles = self.shown.extend(&message.new_tiles, self.limits.tiles)?;
        self.message = Message {
            sequence: message.first_sequence,
            unit,
            time: Some(message.first_time_nanos),
            deltas: message.time_deltas.into_iter(),
            scans: message.scans.into_iter(),
            continues: message.continues,
        };
        Ok(new_tiles)
    }

    /// The next scan of the message; `None` after the last.
    ///
    /// # Errors
    /// The error ends the stream.
    pub fn next_scan(&mut self) -> Result<Option<DecodedScan>, ScanError> {
        let message = &mut self.message;
        let (Some(scan), Some(delta)) = (message.scans.next(), message.deltas.next()) else { return Ok(None) };
        // A product that overflows is an invalid time; a sum may wrap, as for observations.
        message.time = message.time.and_then(|time| Some(time.wrapping_add(delta.checked_mul(message.unit)?)));
        let sequence = message.sequence;
        message.sequence = sequence.saturating_add(1);
        let utc_nanos = message.time.unwrap_or(-1);
        let goes_on = message.continues && message.scans.len() == 0;
        let mut parts = match self.open.take() {
            Some(mut open) => {
                open.join(sequence, utc_nanos, scan.content)?;
                open
            }
            None => Parts { sequence, utc_nanos, content: scan.content, dropped: None },
        };
        parts.check(&self.limits)?;
        if self.spec.is_none() {
            parts.fold();
        }
        if goes_on {
            self.open = Some(parts);
            return Ok(None);
        }
        if let Some(dropped) = parts.dropped {
            let (digest, refusal) = (dropped.digest(), Some(no_grid()));
            return Ok(Some(DecodedScan { sequence, utc_nanos, digest, content: None, refusal }));
        }
        let content = parts.content.take();
        Ok(Some(self.whole(sequence, utc_nanos, content)))
    }

    fn whole(&mut self, sequence: u64, utc_nanos: i64, content: Option<Content>) -> DecodedScan {
        let (digest, read) = match content {
            None => (0, Err(ScanRefusal::malformed("it is neither of tiles nor of points nor of ranges"))),
            Some(Content::Tiles(scan)) => match self.tile_scans.read(&mut self.shown, &scan, utc_nanos) {
                Ok(scan) => (self.shown.digest, Ok(ScanContent::Tiles(scan))),
                Err(refusal) => (0, Err(refusal)),
            },
            Some(Content::Cloud(cloud)) => (points_digest(&cloud), self.readings(|spec| points::cloud(spec, cloud))),
            Some(Content::Ranges(scan)) => (ranges_digest(&scan), self.readings(|spec| points::ranges(spec, scan))),
        };
        let scan = DecodedScan { sequence, utc_nanos, digest, content: None, refusal: None };
        if self.spec.is_none() {
            return DecodedScan { refusal: Some(no_grid()), ..scan };
        }
        match read {
            Err(refusal) => DecodedScan { refusal: Some(refusal), ..scan },
            Ok(content) if utc_nanos < 0 => {
                let detail = format!("time {utc_nanos} ns is before 1970");
                let refusal = Some(ScanRefusal { reason: RefusalReason::Time, detail });
                let content = Some(content).filter(|content| matches!(content, ScanContent::Tiles(_)));
                DecodedScan { content, refusal, ..scan }
            }
            Ok(ScanContent::Tiles(sent)) if self.shown.cells == 0 => {
                let detail = format!("no cell of the {} tiles seen is observed within the grid", self.seen());
                let refusal = Some(ScanRefusal { reason: RefusalReason::Empty, detail });
                DecodedScan { content: Some(ScanContent::Tiles(sent)), refusal, ..scan }
            }
            Ok(content) => DecodedScan { content: Some(content), ..scan },
        }
    }

    /// Number of tiles of the last scan of tiles, as sent.
    fn seen(&self) -> u64 {
        self.shown.runs.iter().map(|(first, end)| u64::from(end - first)).sum()
    }

    fn readings(
        &self,
        read: impl FnOnce(&GridSpec) -> Result<tidemap_grid::raycast::Readings, ScanRefusal>,
    ) -> Result<ScanContent, ScanRefusal> {
        self.spec.as_ref().map_or_else(|| Err(no_grid()), |spec| read(spec).map(ScanContent::Readings))
    }
}

fn no_grid() -> ScanRefusal {
    ScanRefusal { reason: RefusalReason::NoGrid, detail: "the map has no grid".to_owned() }
}
