//! Records as frames in a segment: writing them, reading the next one, and distinguishing a torn tail from damage.
//!
//! Invariant: a frame is used only if its header, its body, its position and its chain are valid.

use tidemap_layout::log::{FRAME_HEADER_LENGTH, FrameHeader, FrameKind, PAYLOAD_MAX, guard, unguard};
use tidemap_map::event::Event;

use crate::record::{self, Invalid};

/// Disks write a sector of this length completely or not at all.
const SECTOR: usize = 512;

/// An event, ready to be written once its position is known.
pub(crate) struct EncodedEvent {
    kind: FrameKind,
    payload_length: u32,
    body: Vec<u8>,
    body_crc: u32,
}

impl EncodedEvent {
    pub(crate) fn encode(event: &Event) -> Result<EncodedEvent, Invalid> {
        let (kind, payload) = record::event::encode(event)?;
        if payload.len() > PAYLOAD_MAX {
            return Err("it is longer than 16 MiB");
        }
        let body = guard(&payload);
        let body_crc = crc32c::crc32c(&body);
        Ok(EncodedEvent { kind, payload_length: payload.len() as u32, body, body_crc })
    }

    pub(crate) fn is_update_start(&self) -> bool {
        self.kind == FrameKind::UpdateStart
    }

    /// Bytes of the frame.
    pub(crate) fn frame_length(&self) -> usize {
        FRAME_HEADER_LENGTH + self.body.len()
    }

    /// Writes the frame to `out` and returns the chain for the next one.
    pub(crate) fn write(&self, position: u64, group_index: u32, chain: u32, out: &mut Vec<u8>) -> u32 {
        let header = FrameHeader {
            kind: self.kind,
            payload_length: self.payload_length,
            position,
            group_index,
            chain,
            body_crc: self.body_crc,
        };
        out.extend_from_slice(&header.encode());
        out.extend_from_slice(&self.body);
        header.next_chain()
    }
}

/// A point in a segment between two frames, with the position and chain that the next frame must have.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cursor {
    pub(crate) offset: usize,
    pub(crate) position: u64,
    pub(crate) chain: u32,
}

/// A valid frame.
pub(crate) struct Frame<'segment> {
    pub(crate) header: FrameHeader,
    body: &'segment [u8],
}

impl Frame<'_> {
    pub(crate) fn is_update_start(&self) -> bool {
        self.header.kind == FrameKind::UpdateStart
    }

    pub(crate) fn event(&self) -> Result<Event, Invalid> {
        let payload = unguard(self.body).ok_or("a guard byte is missing")?;
        record::event::decode(self.header.kind, &payload)
    }
}

/// An invalid frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct BadFrame {
    pub(crate) reason: Invalid,
    /// Whether part of it may never have reached the disk.
    pub(crate) is_unwritten: bool,
}

/// Reads the frame at the cursor and moves the cursor behind it; `None` at the end of the segment.
pub(crate) fn next_frame<'segment>(
    segment: &'segment [u8],
    cursor: &mut Cursor,
) -> Result<Option<Frame<'segment>>, BadFrame> {
    let rest = segment.get(cursor.offset..).unwrap_or_default();
    if rest.is_empty() {
        return Ok(None);
    }
    let Some(header) = FrameHeader::decode(rest) else {
        let is_unwritten = rest.len() < FRAME_HEADER_LENGTH
            || has_unwritten_sector(segment, cursor.offset, cursor.offset + FRAME_HEADER_LENGTH, segment.len());
        return Err(BadFrame { reason: "the header of the record is not valid", is_unwritten });
    };
    if header.position != cursor.position {
        return Err(BadFrame { reason: "the record has another number than it should", is_unwritten: false });
    }
    if header.chain != cursor.chain {
        return Err(BadFrame { reason: "the record does not follow the one before it", is_unwritten: false });
    }
    let Some(body) = rest.get(FRAME_HEADER_LENGTH..header.frame_length()) else {
        return Err(BadFrame { reason: "the record is cut off", is_unwritten: true });
    };
    if crc32c::crc32c(body) != header.body_crc {
        let end = cursor.offset + header.frame_length();
        let is_unwritten = has_unwritten_sector(segment, cursor.offset, end, end);
        return Err(BadFrame { reason: "the checksum of the record does not match", is_unwritten });
    }
    cursor.offset += header.frame_length();
    cursor.position += 1;
    cursor.chain = header.next_chain();
    Ok(Some(Frame { header, body }))
}

/// Whether any part of `start..end` within one sector is all zeros; parts end at `limit`. Written frames have no such
/// part.
pub(crate) fn has_unwritten_sector(segment: &[u8], start: usize, end: usize, limit: usize) -> bool {
    let mut start = start;
    while start < end {
        let next = (start / SECTOR + 1) * SECTOR;
        let part = segment.get(start..next.min(limit)).unwrap_or_default();
        if part.iter().all(|&byte| byte == 0) {
            return true;
        }
        start = next;
    }
    false
}

/// Whether a complete frame lies anywhere behind `offset` that was written after record `position` was durable.
/// If so, the record at `offset` had been acknowledged.
pub(crate) fn is_followed(segment: &[u8], offset: usize, position: u64) -> bool {
    (offset + 1..segment.len()).any(|start| {
        let rest = &segment[start..];
        let Some(header) = FrameHeader::decode(rest) else { return false };
        let group_start = header.position.saturating_sub(u64::from(header.group_index));
        let body = rest.get(FRAME_HEADER_LENGTH..header.frame_length());
        group_start > position && body.is_some_and(|body| crc32c::crc32c(body) == header.body_crc)
    })
}
