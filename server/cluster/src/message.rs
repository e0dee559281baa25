//! Groups of records as messages of a stream. A group that is longer than a message is split into parts.
//!
//! A message is a header of [`HEADER_BYTES`] bytes and a part of the frames. All numbers are little-endian: magic 4,
//! version u8, zero u8, part u16, number of parts u16, zero u16, map u64, epoch u64, first position u64, chain before
//! u32, number of records u32, chain after u32, CRC-32C of the part u32, zero u32, CRC-32C of the header before u32.
//!
//! Invariant: a decoded part has valid checksums and numbers that can follow each other. The layout is part of the
//! format of the shared log: it changes with [`VERSION`] only.

use bytes::{BufMut as _, Bytes, BytesMut};
use tidemap_store::{LogPoint, RecordGroup};

use crate::engine::MESSAGE_BYTES_MAX;

/// Version of the layout.
pub const VERSION: u8 = 1;
/// Length of a header.
pub const HEADER_BYTES: usize = 60;

const MAGIC: [u8; 4] = *b"tmgr";
/// Bytes of frames in one message. The engine adds headers of its own. Tests cut small groups.
const PART_BYTES: usize = if cfg!(test) { 600 } else { MESSAGE_BYTES_MAX - HEADER_BYTES - 4096 };

/// A part of a group.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GroupPart {
    /// Number of the map in the cluster.
    pub map: u64,
    /// The epoch of the writer that appended it.
    pub epoch: u64,
    /// Index of the part in the group, from 0.
    pub part: u16,
    /// Number of parts.
    pub parts: u16,
    /// The point at which the group begins.
    pub before: LogPoint,
    /// The point at which the group ends.
    pub after: LogPoint,
    /// The frames that this part contains.
    pub frames: Bytes,
}

impl GroupPart {
    /// Whether this part is the last one of its group.
    #[must_use]
    pub fn is_last(&self) -> bool {
        self.part + 1 == self.parts
    }

    /// Reads a message; `None` for one that tidemap has not written.
    ///
    /// # Errors
    /// The fault of a message that tidemap has written.
    pub fn decode(message: &Bytes) -> Result<Option<GroupPart>, &'static str> {
        if message.get(..MAGIC.len()) != Some(&MAGIC) {
            return Ok(None);
        }
        let header: &[u8; HEADER_BYTES] =
            message.get(..HEADER_BYTES).and_then(|header| header.try_into().ok()).ok_or("it is too short")?;
        let u16_at = |at: usize| u16::from_le_bytes([header[at], header[at + 1]]);
        let u32_at = |at: usize| header[at..at + 4].iter().rev().fold(0, |number, &byte| number << 8 | u32::from(byte));
        let u64_at = |at: usize| u64::from(u32_at(at)) | u64::from(u32_at(at + 4)) << 32;
        if u32_at(HEADER_BYTES - 4) != crc32c::crc32c(&header[..HEADER_BYTES - 4]) {
            return Err("the checksum of its header does not match");
        }
        if header[4] != VERSION {
            return Err("it has a version that this daemon does not support");
        }
        let frames = message.slice(HEADER_BYTES..);
        if u32_at(48) != crc32c::crc32c(&frames) {
            return Err("its checksum does not match");
        }
        let (part, parts, first, records) = (u16_at(6), u16_at(8), u64_at(28), u32_at(40));
        let after = first.checked_add(u64::from(records)).and_then(|next| next.checked_sub(1));
        let (Some(before), Some(after)) = (first.checked_sub(1), after) else {
            return Err("its position is not valid");
        };
        if part >= parts || records == 0 || frames.is_empty() {
            return Err("it is empty, or has more parts than it states");
        }
        Ok(Some(GroupPart {
            map: u64_at(12),
            epoch: u64_at(20),
            part,
            parts,
            before: LogPoint { position: before, chain: u32_at(36) },
            after: LogPoint { position: after, chain: u32_at(44) },
            frames,
        }))
    }
}

/// The messages of a group.
#[must_use]
pub fn encode(group: &RecordGroup, map: u64, epoch: u64) -> Vec<Bytes> {
    // The payload of a record is bounded, so that a group has few parts.
    let parts = group.frames.len().div_ceil(PART_BYTES) as u16;
    let message = |(part, frames): (usize, &[u8])| {
        let mut message = BytesMut::with_capacity(HEADER_BYTES + frames.len());
        message.put_slice(&MAGIC);
        message.put_u8(VERSION);
        message.put_u8(0);
        message.put_u16_le(part as u16);
        message.put_u16_le(parts);
        message.put_u16_le(0);
        message.put_u64_le(map);
        message.put_u64_le(epoch);
        message.put_u64_le(group.before.position + 1);
        message.put_u32_le(group.before.chain);
        message.put_u32_le(group.records() as u32);
        message.put_u32_le(group.after.chain);
        message.put_u32_le(crc32c::crc32c(frames));
        message.put_u32_le(0);
        let crc = crc32c::crc32c(&message);
        message.put_u32_le(crc);
        message.put_slice(frames);
        message.freeze()
    };
    group.frames.chunks(PART_BYTES).enumerate().map(message).collect()
}

/// The parts of a group that have arrived so far.
#[derive(Debug, Default)]
pub struct Assembly {
    parts: Vec<GroupPart>,
}

impl Assembly {
    /// Takes the next part; returns the group when it is complete. A part that does not continue the parts before it
    /// begins a new group: the group before it was never completed, because its writer was deposed.
    pub fn push(&mut self, part: GroupPart) -> Option<RecordGroup> {
        let continues = self.parts.last().is_some_and(|last| {
            (last.epoch, last.parts, last.before, last.after, last.part + 1)
                == (part.epoch, part.parts, part.before, part.after, part.part)
        });
        if !continues {
            self.parts.clear();
        }
        if !continues && part.part > 0 {
            return None;
        }
        let is_last = part.is_last();
        self.parts.push(part);
        if !is_last {
            return None;
        }
        let parts = std::mem::take(&mut self.parts);
        let (before, after) = parts.first().map(|first| (first.before, first.after))?;
        let mut frames = Vec::with_capacity(parts.iter().map(|part| part.frames.len()).sum());
        parts.iter().for_each(|part| frames.extend_from_slice(&part.frames));
        Some(RecordGroup { before, after, frames })
    }

    /// Forgets an incomplete group.
    pub fn clear(&mut self) {
        self.parts.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn group(bytes: usize) -> RecordGroup {
        RecordGroup {
            before: LogPoint { position: 7, chain: 0xAABB_CCDD },
            after: LogPoint { position: 9, chain: 5 },
            frames: (0..bytes).map(|byte| byte as u8 | 1).collect(),
        }
    }

    #[test]
    fn a_group_comes_back_from_its_messages() {
        for bytes in [1, 1000, PART_BYTES, PART_BYTES + 1, 3 * PART_BYTES + 17] {
            let group = group(bytes);
            let messages = encode(&group, 77, 3);
            assert!(messages.iter().all(|message| message.len() < MESSAGE_BYTES_MAX));
            let mut assembly = Assembly::default();
            let mut found = Vec::new();
            for message in &messages {
                let part = GroupPart::decode(message).expect("valid").expect("of tidemap");
                assert_eq!((part.map, part.epoch, usize::from(part.parts)), (77, 3, messages.len()));
                found.extend(assembly.push(part));
            }
            assert_eq!(found, [group]);
        }
    }

    #[test]
    fn a_changed_byte_is_noticed() {
        let message = encode(&group(100), 1, 1).remove(0);
        for at in 0..message.len() {
            let mut changed = message.to_vec();
            changed[at] ^= 0x10;
            // A message without these first bytes is not a message of tidemap.
            let is_read = |message: &Bytes| GroupPart::decode(message).is_ok_and(|part| part.is_some());
            assert!(!is_read(&Bytes::from(changed)), "byte {at}");
            assert!(!is_read(&message.slice(..at)), "cut at {at}");
        }
        assert_eq!(GroupPart::decode(&Bytes::from_static(b"hello")), Ok(None));
    }

    #[test]
    fn a_group_that_was_never_completed_is_left_out() {
        let long = encode(&group(2 * PART_BYTES), 1, 1);
        let mut other = group(10);
        other.after.chain = 6;
        let short = encode(&other, 1, 2).remove(0);
        let mut assembly = Assembly::default();
        assert_eq!(assembly.push(GroupPart::decode(&long[0]).expect("valid").expect("of tidemap")), None);
        assert_eq!(assembly.push(GroupPart::decode(&short).expect("valid").expect("of tidemap")), Some(other));
        assert_eq!(
            assembly.push(GroupPart::decode(&long[1]).expect("valid").expect("of tidemap")),
            None,
            "its beginning is gone"
        );
    }
}
