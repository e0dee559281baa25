//! Frames of the observation log: those of format 1 and further kinds.
//!
//! Invariant: a frame of format 1 is the same to the byte.

use crate::v1::{
    log::{FRAME_HEADER_LENGTH, FRAME_VERSION, PAYLOAD_MAX, body_length},
    u32_at, u64_at,
};

/// What a frame's payload is. The numbers have several bits set, so that no single flipped bit makes a first byte zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameKind {
    /// [`super::event::Observations`].
    Observations = b'O' as isize,
    /// [`crate::v1::event::UpdateStart`].
    UpdateStart = b'U' as isize,
    /// [`super::event::Scans`].
    Scans = b'S' as isize,
    /// [`crate::v1::event::NewState`], which has no observations yet.
    AddState = b'K' as isize,
    /// [`super::site::SiteEdit`].
    EditSite = b'E' as isize,
}

/// Header of a frame: kind u8, version u8, zero u16, payload length u32, position u64, group index u32, chain u32,
/// body CRC-32C u32, CRC-32C of the 28 bytes before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameHeader {
    /// What the payload is.
    pub kind: FrameKind,
    /// Length of the payload, without guards.
    pub payload_length: u32,
    /// Number of the record, from 1.
    pub position: u64,
    /// How many records before this one were written together with it. All records before those were durable, which
    /// distinguishes a torn tail from a damaged durable record.
    pub group_index: u32,
    /// Header CRC of the record before, [`crate::v1::log::FIRST_CHAIN`] for the first.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::format_1;

    fn header(kind: FrameKind) -> FrameHeader {
        FrameHeader { kind, payload_length: 300, position: 12, group_index: 4, chain: 9, body_crc: 8 }
    }

    #[test]
    fn frames_of_format_1_are_the_same() {
        for (old, new) in [
            (format_1::FrameKind::Observations, FrameKind::Observations),
            (format_1::FrameKind::UpdateStart, FrameKind::UpdateStart),
        ] {
            let old = format_1::FrameHeader {
                kind: old,
                payload_length: 300,
                position: 12,
                group_index: 4,
                chain: 9,
                body_crc: 8,
            };
            assert_eq!(header(new).encode(), old.encode());
            assert_eq!(header(new).next_chain(), old.next_chain());
            assert_eq!(header(new).frame_length(), old.frame_length());
        }
        assert_eq!(format_1::FrameHeader::decode(&header(FrameKind::Scans).encode()), None);
    }

    #[test]
    fn headers_come_back_and_every_flipped_bit_is_noticed() {
        for frame in [FrameKind::Scans, FrameKind::AddState, FrameKind::EditSite].map(header) {
            assert_eq!(FrameHeader::decode(&frame.encode()), Some(frame));
            for bit in 0..256 {
                let mut bytes = frame.encode();
                bytes[bit / 8] ^= 1 << (bit % 8);
                assert_eq!(FrameHeader::decode(&bytes), None, "bit {bit}");
            }
        }
    }
}
