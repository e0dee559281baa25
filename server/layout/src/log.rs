//! The observation log. A segment is a header and then frames, one per record.
//!
//! A frame is a header of [`FRAME_HEADER_LENGTH`] bytes and a body. The body is the payload with a guard byte after
//! every 255 bytes and one more guard byte at its end.
//!
//! Invariant: no frame holds 512 zero bytes in a row, begins with a zero byte or ends with one. A sector that never
//! reached the disk reads as zeros, so it can be distinguished from a written sector with a flipped bit.

use super::{FORMAT, u32_at, u64_at};

/// First bytes of a segment.
pub const SEGMENT_MAGIC: [u8; 8] = *b"tidemlog";
/// Length of a segment's header.
pub const SEGMENT_HEADER_LENGTH: usize = 32;
/// Length of a frame's header.
pub const FRAME_HEADER_LENGTH: usize = 32;
/// Version of the frame's payload.
pub const FRAME_VERSION: u8 = 1;
/// Limit of a payload in bytes; longer payloads are refused when written and when read.
pub const PAYLOAD_MAX: usize = 16 << 20;
/// Value of the first record's chain.
pub const FIRST_CHAIN: u32 = 0;

/// The guard byte, which interrupts long runs of zeros.
const GUARD: u8 = 0xA5;
/// Payload bytes between two guards.
const GUARD_SPACING: usize = 255;

/// Header of a segment: magic 8, format u32, map u32, first position u64, chain u32, CRC-32C of the 28 bytes before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SegmentHeader {
    /// Number of the map.
    pub map: u32,
    /// Log position of the first record.
    pub first_position: u64,
    /// Header CRC of the record before the first.
    pub chain: u32,
}

impl SegmentHeader {
    pub fn encode(&self) -> [u8; SEGMENT_HEADER_LENGTH] {
        let mut bytes = [0; SEGMENT_HEADER_LENGTH];
        bytes[..8].copy_from_slice(&SEGMENT_MAGIC);
        bytes[8..12].copy_from_slice(&FORMAT.to_le_bytes());
        bytes[12..16].copy_from_slice(&self.map.to_le_bytes());
        bytes[16..24].copy_from_slice(&self.first_position.to_le_bytes());
        bytes[24..28].copy_from_slice(&self.chain.to_le_bytes());
        let crc = crc32c::crc32c(&bytes[..28]);
        bytes[28..].copy_from_slice(&crc.to_le_bytes());
        bytes
    }

    /// The header at the start of `bytes`, if it is complete and valid.
    pub fn decode(bytes: &[u8]) -> Option<SegmentHeader> {
        let bytes = bytes.get(..SEGMENT_HEADER_LENGTH)?;
        let sound = bytes[..8] == SEGMENT_MAGIC
            && u32_at(bytes, 8) == FORMAT
            && u32_at(bytes, 28) == crc32c::crc32c(&bytes[..28]);
        sound.then(|| SegmentHeader {
            map: u32_at(bytes, 12),
            first_position: u64_at(bytes, 16),
            chain: u32_at(bytes, 24),
        })
    }
}

/// The kind of a frame's payload. Each number has several bits set, so that no single flipped bit makes the first byte
/// of a frame zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameKind {
    /// [`super::event::Observations`].
    Observations = b'O' as isize,
    /// [`super::event::UpdateStart`].
    UpdateStart = b'U' as isize,
    /// [`super::event::Scans`].
    Scans = b'S' as isize,
    /// [`super::event::NewState`] of a state that has no observations yet.
    AddState = b'K' as isize,
    /// [`super::site::SiteEdit`].
    EditSite = b'E' as isize,
    /// [`super::cluster::Epoch`].
    Epoch = b'W' as isize,
    /// [`super::cluster::UpdateDone`].
    UpdateDone = b'D' as isize,
    /// [`super::event::ForgetProducers`].
    ForgetProducers = b'F' as isize,
}

/// Header of a frame: kind u8, version u8, zero u16, payload length u32, position u64, group index u32, chain u32,
/// body CRC-32C u32, CRC-32C of the 28 bytes before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameHeader {
    /// The kind of the payload.
    pub kind: FrameKind,
    /// Length of the payload, without guards.
    pub payload_length: u32,
    /// Number of the record, from 1.
    pub position: u64,
    /// Number of records before this one that were written together with it. All records before these were durable
    /// already, which distinguishes a torn tail from a damaged durable record.
    pub group_index: u32,
    /// Header CRC of the record before, [`FIRST_CHAIN`] for the first.
    pub chain: u32,
    /// CRC-32C of the body.
    pub body_crc: u32,
}

impl FrameHeader {
    pub fn encode(&self) -> [u8; FRAME_HEADER_LENGTH] {
        let mut bytes = [0; FRAME_HEADER_LENGTH];
        bytes[0] = self.kind as u8;
        bytes[1] = FRAME_VERSION;
        bytes[4..8].copy_from_slice(&self.payload_length.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.position.to_le_bytes());
        bytes[16..20].copy_from_slice(&self.group_index.to_le_bytes());
        bytes[20..24].copy_from_slice(&self.chain.to_le_bytes());
        bytes[24..28].copy_from_slice(&self.body_crc.to_le_bytes());
        let crc = crc32c::crc32c(&bytes[..28]);
        bytes[28..].copy_from_slice(&crc.to_le_bytes());
        bytes
    }

    /// The header at the start of `bytes`, if it is complete and valid.
    pub fn decode(bytes: &[u8]) -> Option<FrameHeader> {
        let bytes = bytes.get(..FRAME_HEADER_LENGTH)?;
        let kind = match bytes[0] {
            b'O' => FrameKind::Observations,
            b'U' => FrameKind::UpdateStart,
            b'S' => FrameKind::Scans,
            b'K' => FrameKind::AddState,
            b'E' => FrameKind::EditSite,
            b'W' => FrameKind::Epoch,
            b'D' => FrameKind::UpdateDone,
            b'F' => FrameKind::ForgetProducers,
            _ => return None,
        };
        let payload_length = u32_at(bytes, 4);
        let sound = bytes[1] == FRAME_VERSION
            && bytes[2..4] == [0, 0]
            && payload_length as usize <= PAYLOAD_MAX
            && u32_at(bytes, 28) == crc32c::crc32c(&bytes[..28]);
        sound.then(|| FrameHeader {
            kind,
            payload_length,
            position: u64_at(bytes, 8),
            group_index: u32_at(bytes, 16),
            chain: u32_at(bytes, 20),
            body_crc: u32_at(bytes, 24),
        })
    }

    /// The chain of the next record.
    pub fn next_chain(&self) -> u32 {
        u32_at(&self.encode(), 28)
    }

    /// Length of the frame, header and guards included.
    pub fn frame_length(&self) -> usize {
        FRAME_HEADER_LENGTH + body_length(self.payload_length as usize)
    }
}

/// Length of the body of a payload.
pub fn body_length(payload_length: usize) -> usize {
    payload_length + payload_length / GUARD_SPACING + 1
}

/// The body of a payload: the payload with its guards.
pub fn guard(payload: &[u8]) -> Vec<u8> {
    let mut body = Vec::with_capacity(body_length(payload.len()));
    let chunks = payload.chunks_exact(GUARD_SPACING);
    let rest = chunks.remainder();
    for chunk in chunks {
        body.extend_from_slice(chunk);
        body.push(GUARD);
    }
    body.extend_from_slice(rest);
    body.push(GUARD);
    body
}

/// The payload of a body; `None` if a guard is missing.
pub fn unguard(body: &[u8]) -> Option<Vec<u8>> {
    let mut payload = Vec::with_capacity(body.len());
    let mut chunks = body.chunks_exact(GUARD_SPACING + 1);
    for chunk in &mut chunks {
        let (&guard, bytes) = chunk.split_last()?;
        if guard != GUARD {
            return None;
        }
        payload.extend_from_slice(bytes);
    }
    let rest = chunks.remainder();
    match rest.split_last() {
        Some((&GUARD, bytes)) => payload.extend_from_slice(bytes),
        _ => return None,
    }
    Some(payload)
}

#[cfg(test)]
mod tests {
    use super::*;

    const KINDS: [FrameKind; 5] =
        [FrameKind::Observations, FrameKind::UpdateStart, FrameKind::Scans, FrameKind::AddState, FrameKind::EditSite];

    fn header(kind: FrameKind) -> FrameHeader {
        FrameHeader { kind, payload_length: 300, position: 12, group_index: 4, chain: 9, body_crc: 8 }
    }

    #[test]
    fn guards_come_and_go_at_every_length() {
        for length in 0..1100 {
            let payload: Vec<u8> = (0..length).map(|i| (i % 7) as u8).collect();
            let body = guard(&payload);
            assert_eq!(body.len(), body_length(length), "{length}");
            assert_eq!(unguard(&body).as_deref(), Some(&payload[..]), "{length}");
        }
        assert_eq!(unguard(&[]), None);
        assert_eq!(unguard(&[0]), None);
    }

    #[test]
    fn no_frame_looks_like_a_sector_that_was_never_written() {
        let body = guard(&[0; 5000]);
        assert!(body.windows(256).all(|window| window.iter().any(|&byte| byte != 0)));
        assert_eq!(body.last(), Some(&GUARD));
    }

    #[test]
    fn headers_come_back_and_every_flipped_bit_is_noticed() {
        let segment = SegmentHeader { map: 3, first_position: 77, chain: 0xDEAD_BEEF };
        let frame = header(FrameKind::UpdateStart);
        assert_eq!(SegmentHeader::decode(&segment.encode()), Some(segment));
        assert_eq!(FrameHeader::decode(&frame.encode()), Some(frame));
        assert_eq!(frame.frame_length(), 32 + 302);
        for bit in 0..256 {
            let mut bytes = segment.encode();
            bytes[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(SegmentHeader::decode(&bytes), None, "bit {bit}");
            let mut bytes = frame.encode();
            bytes[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(FrameHeader::decode(&bytes), None, "bit {bit}");
        }
    }

    #[test]
    fn frames_of_every_kind_come_back_and_every_flipped_bit_is_noticed() {
        for frame in KINDS.map(header) {
            assert_eq!(FrameHeader::decode(&frame.encode()), Some(frame));
            for bit in 0..256 {
                let mut bytes = frame.encode();
                bytes[bit / 8] ^= 1 << (bit % 8);
                assert_eq!(FrameHeader::decode(&bytes), None, "bit {bit}");
            }
        }
    }
}
