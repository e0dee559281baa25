//! Copies of maps as daemons send them to each other.
//!
//! Invariant: a part whose checksum does not match is refused. The store decides which names are valid.

use crate::v1;

/// Bytes of a file that came from another daemon.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FilePart {
    /// The file within the folder of the map.
    pub name: String,
    /// Where the bytes begin in the file.
    pub offset: u64,
    /// The bytes.
    pub bytes: Vec<u8>,
    /// Whether the file ends with these bytes.
    pub is_last: bool,
}

/// The content of a message of a copy.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CopyMessage {
    /// Bytes of a file.
    Part(FilePart),
    /// The copy is whole: number of files, and bytes.
    End(u64, u64),
}

/// A part for the wire.
#[must_use]
pub fn part_to_wire(part: FilePart) -> v1::FetchMapResponse {
    let FilePart { name, offset, bytes, is_last } = part;
    let crc = crc32c::crc32c(&bytes);
    let part = v1::MapFilePart { name, offset, content: bytes, crc, is_last };
    v1::FetchMapResponse { item: Some(v1::fetch_map_response::Item::Part(part)) }
}

/// The end of a copy for the wire.
#[must_use]
pub fn end_to_wire(files: u64, bytes: u64) -> v1::FetchMapResponse {
    v1::FetchMapResponse { item: Some(v1::fetch_map_response::Item::End(v1::MapCopyEnd { files, bytes })) }
}

/// Reads the content of a message of a copy.
///
/// # Errors
/// A description of what is wrong with the message.
pub fn message_from_wire(message: v1::FetchMapResponse) -> Result<CopyMessage, &'static str> {
    match message.item {
        Some(v1::fetch_map_response::Item::Part(part)) => {
            let v1::MapFilePart { name, offset, content, crc, is_last } = part;
            if crc32c::crc32c(&content) != crc {
                return Err("the checksum of a part does not match");
            }
            Ok(CopyMessage::Part(FilePart { name, offset, bytes: content, is_last }))
        }
        Some(v1::fetch_map_response::Item::End(end)) => Ok(CopyMessage::End(end.files, end.bytes)),
        None => Err("a message is empty"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_come_back_and_a_changed_byte_is_noticed() {
        let part = FilePart { name: "log/x".to_owned(), offset: 7, bytes: vec![1, 2, 3], is_last: true };
        let wire = part_to_wire(part.clone());
        assert_eq!(message_from_wire(wire.clone()), Ok(CopyMessage::Part(part)));
        let Some(v1::fetch_map_response::Item::Part(mut changed)) = wire.item else { panic!("a part") };
        changed.content[1] ^= 4;
        let changed = v1::FetchMapResponse { item: Some(v1::fetch_map_response::Item::Part(changed)) };
        assert!(message_from_wire(changed).is_err());
        assert_eq!(message_from_wire(end_to_wire(2, 9)), Ok(CopyMessage::End(2, 9)));
        assert!(message_from_wire(v1::FetchMapResponse::default()).is_err());
    }
}
