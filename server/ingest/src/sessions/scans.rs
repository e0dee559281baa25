//! Converts scans to events: flips against the last scan of each tile in the order of the log.
//!
//! Invariant: an event is at most 16 MiB, which the log accepts, for any content of the streams; the scans of one batch
//! are spread over several events if needed, in their order.

use tidemap_grid::{
    index::{CellBox, TileIndex},
    log_head::{LogHead, ScanDelta, StreamTiles},
    scan::{LoggedScan, Scans},
};
use tidemap_map::{
    event::{Event, Observations, SequenceSpan},
    ids::RefusalReason,
    live_map::LiveMap,
};
use tidemap_model::time::FUTURE_MAX_NANOS;

use super::{
    super::protocol::{CheckedScan, RefusedObservation, ScanBatch, ScanOrigin, SessionId},
    Session, Sessions, StreamEvent,
};

/// Maximum number of bits that one scan flips, not counting the tiles that are observed again as a whole. A flip takes
/// 2 bytes, because so many flips are close to each other.
const FLIPS_MAX: u64 = 8_000_000;
/// Number of flipped bits at which an event is complete. A flip takes at most 5 bytes, for any distance between flips.
const EVENT_FLIPS: u64 = 1_000_000;
/// Total number of tiles that the scans of an event see at which it is complete.
const EVENT_TILES: u64 = 500_000;
/// A scan of fewer tiles cannot exceed [`FLIPS_MAX`].
const TILES_UNCOUNTED: usize = (FLIPS_MAX / 1024) as usize;

/// The content of one event.
#[derive(Default)]
struct Portion {
    scans: Vec<LoggedScan>,
    new_tiles: Vec<TileIndex>,
    flips: u64,
    seen: u64,
    tiles_ahead: u64,
}

impl Portion {
    fn push(&mut self, taken: ScanDelta, tiles_ahead: u64) {
        self.tiles_ahead += tiles_ahead;
        let ScanDelta { scan, new_tiles } = taken;
        self.flips += (scan.observed_flips.len() + scan.occupied_flips.len()) as u64;
        self.seen += scan.seen.as_ref().map_or(0, |seen| seen.len() as u64);
        self.new_tiles.extend(new_tiles);
        self.scans.push(scan);
    }

    fn is_full(&self) -> bool {
        self.flips >= EVENT_FLIPS || self.seen >= EVENT_TILES
    }
}

impl Sessions {
    /// Converts scans to events; adds refusals if the map has no room for more tiles. Empty: the stream is closed, or
    /// there is nothing to log.
    pub(crate) fn scan_events(&mut self, id: SessionId, batch: ScanBatch, map: &LiveMap, now: i64) -> Vec<StreamEvent> {
        let ScanBatch { span, new_tiles, scans, mut shown, mut refused, .. } = batch;
        let Some(mut session) = self.sessions.remove(&id) else { return Vec::new() };
        let mut portions: Vec<(Portion, u64, u32)> = Vec::new();
        if session.open {
            for index in new_tiles {
                session.sent_tiles.push(index);
            }
            let mut portion = Portion::default();
            for taken in scans {
                let (sequence, crc) = (taken.sequence, taken.content_crc);
                match self.take(id, &mut session, taken, map, now) {
                    Ok(Some((scan, tiles_ahead))) => portion.push(scan, tiles_ahead),
                    Ok(None) => {}
                    Err(refusal) => refused.push(refusal),
                }
                if portion.is_full() {
                    portions.push((std::mem::take(&mut portion), sequence, crc));
                }
            }
            let done = portions.last().map_or(span.first.saturating_sub(1), |(_, sequence, _)| *sequence);
            if !span.is_empty() && span.last > done {
                portions.push((portion, span.last, span.content_crc));
            }
        }
        refused.sort_by_key(|refused| refused.sequence);
        let mut refused = refused.into_iter().peekable();
        let mut first = span.first;
        let mut events = Vec::with_capacity(portions.len());
        for (portion, last, content_crc) in portions {
            let mut of_portion: Vec<RefusedObservation> =
                std::iter::from_fn(|| refused.next_if(|refused| refused.sequence <= last)).collect();
            let span = SequenceSpan { first, last, content_crc };
            first = last.saturating_add(1);
            let envelope = session.envelope(map, &mut self.producers_in_flight, now, span, &mut of_portion);
            let Portion { scans, new_tiles, tiles_ahead, .. } = portion;
            // A map without a grid has no events of scans; their refusals are reported as an event of observations.
            let event = match map.grid() {
                Some(_) => {
                    // Refused scans show nothing.
                    let shown = if scans.is_empty() { CellBox::default() } else { std::mem::take(&mut shown) };
                    Event::Scans(envelope, Scans { new_tiles, scans, shown })
                }
                None => Event::Observations(envelope, Observations::default()),
            };
            events.push(StreamEvent { event, refused: of_portion, tiles_ahead });
        }
        self.sessions.insert(id, session);
        events
    }

    /// Takes one scan; returns the scan to log, and the number of its tiles that wait for their time; `None` if the
    /// scan is only remembered.
    fn take(
        &mut self,
        id: SessionId,
        session: &mut Session,
        taken: CheckedScan,
        map: &LiveMap,
        now: i64,
    ) -> Result<Option<(ScanDelta, u64)>, RefusedObservation> {
        let CheckedScan { sequence, origin, is_taken, scan, new_tiles, restarts, .. } = taken;
        let (source, stream) = match origin {
            ScanOrigin::Stream => (&mut session.sent_tiles, 2 * id.0),
            ScanOrigin::Cast => (&mut session.raycast_tiles, 2 * id.0 + 1),
        };
        if restarts {
            *source = StreamTiles::default();
        }
        for index in new_tiles {
            source.push(index);
        }
        let Some(grid) = map.grid().filter(|_| is_taken) else {
            source.skip(&scan);
            return Ok(None);
        };
        let refuse = |reason: RefusalReason, detail: String| Err(RefusedObservation { sequence, reason, detail });
        let is_ahead = scan.utc_nanos > now.saturating_add(FUTURE_MAX_NANOS);
        if is_ahead && map.future() + grid.future_tiles() + self.tiles_ahead >= self.limits.ahead {
            source.skip(&scan);
            let detail = format!(
                "time {} ns is more than 5 minutes ahead of the server's clock, and {} observations and \
                 tiles of scans wait for their time already, which is the maximum",
                scan.utc_nanos, self.limits.ahead
            );
            return refuse(RefusalReason::Time, detail);
        }
        let log_head = self.log_head.get_or_insert_with(|| LogHead::new(grid));
        if scan.seen.len() > TILES_UNCOUNTED {
            let flips = log_head.flips_at_most(grid, stream, source, &scan);
            if flips > FLIPS_MAX {
                source.skip(&scan);
                let detail = format!("the scan changes {flips} readings of cells, and one may change {FLIPS_MAX}");
                return refuse(RefusalReason::Scan, detail);
            }
        }
        let offset_secs = self.offsets.offset_secs(scan.utc_nanos);
        let room = self.tile_places.room(&session.client, log_head.tiles());
        let max = log_head.tiles().saturating_add(room.left());
        let Ok(taken) = log_head.take(grid, stream, source, &scan, offset_secs, max) else {
            return refuse(RefusalReason::TileLimit, format!("the scan has new tiles: {}", room.full()));
        };
        self.tile_places.take(&session.client, taken.new_tiles.len());
        let tiles_ahead = if is_ahead { scan.seen.len() as u64 } else { 0 };
        self.tiles_ahead += tiles_ahead;
        Ok(Some((taken, tiles_ahead)))
    }
}
