//! Changed bytes of stored messages, to see which of them are refused.
//!
//! Invariant: only the named field changes; all other bytes stay as they are.

use prost::encoding::{WireType, decode_key, decode_varint, encode_key, encode_varint};

/// The fields of a message: tag, wire type, content without the length.
fn fields(mut message: &[u8]) -> Vec<(u32, WireType, Vec<u8>)> {
    let mut fields = Vec::new();
    while !message.is_empty() {
        let (tag, wire_type) = decode_key(&mut message).expect("a key");
        let length = match wire_type {
            WireType::Varint => {
                let mut after = message;
                decode_varint(&mut after).expect("a varint");
                message.len() - after.len()
            }
            WireType::SixtyFourBit => 8,
            WireType::ThirtyTwoBit => 4,
            WireType::LengthDelimited => decode_varint(&mut message).expect("a length") as usize,
            WireType::StartGroup | WireType::EndGroup => panic!("a group"),
        };
        fields.push((tag, wire_type, message[..length].to_vec()));
        message = &message[length..];
    }
    fields
}

/// A change of the content of a field.
type ContentChange<'a> = &'a dyn Fn(&mut Vec<u8>);

/// A message with another content of the field at a path of tags. `change`: changes the content, without its length;
/// `None` removes the field.
pub(super) fn changed(message: &[u8], path: &[u32], change: Option<ContentChange<'_>>) -> Vec<u8> {
    let mut out = Vec::new();
    for (tag, wire_type, mut content) in fields(message) {
        match (path, change) {
            (&[last], None) if tag == last => continue,
            (&[last], Some(change)) if tag == last => change(&mut content),
            (&[first, ref rest @ ..], _) if tag == first && !rest.is_empty() => {
                content = changed(&content, rest, change);
            }
            _ => {}
        }
        encode_key(tag, wire_type, &mut out);
        if wire_type == WireType::LengthDelimited {
            encode_varint(content.len() as u64, &mut out);
        }
        out.extend(content);
    }
    out
}

/// The content of the first field at a path of tags.
pub(super) fn content(message: &[u8], path: &[u32]) -> Option<Vec<u8>> {
    let (first, rest) = path.split_first()?;
    let (.., found) = fields(message).into_iter().find(|(tag, ..)| tag == first)?;
    if rest.is_empty() { Some(found) } else { content(&found, rest) }
}

/// A change of the content of a field; `None` removes the field.
type Change = Option<fn(&mut Vec<u8>)>;

/// The changes to try of a field of a wire type, by name. All leave the other fields readable.
fn changes(wire_type: WireType) -> Vec<(&'static str, Change)> {
    let mut changes: Vec<(&str, Change)> = vec![("removed", None)];
    match wire_type {
        WireType::Varint => changes.extend([
            ("great", Some((|content| *content = vec![0xFE, 0xFF, 0xFF, 0xFF, 0x0F]) as fn(&mut Vec<u8>))),
            ("greatest", Some(|content| *content = [&[0xFF; 9][..], &[1]].concat())),
        ]),
        WireType::LengthDelimited => changes.extend([
            ("cut", Some((|content| content.truncate(content.len().saturating_sub(1))) as fn(&mut Vec<u8>))),
            ("half", Some(|content| content.truncate(content.len() / 2))),
            ("longer", Some(|content| content.extend([0; 8]))),
        ]),
        _ => {}
    }
    if wire_type != WireType::Varint {
        changes.extend([
            ("ones", Some((|content| content.fill(0xFF)) as fn(&mut Vec<u8>))),
            ("negative", Some(|content| content.fill(0xBF))),
        ]);
    }
    changes
}

/// The changes of each field of the message at a path of tags that are refused, one line for each tag. A field with an
/// unknown tag is skipped.
pub(super) fn refusals(message: &[u8], path: &[u32], is_refused: &dyn Fn(&[u8]) -> bool) -> String {
    let unknown = changed(message, path, Some(&|content| content.extend([0xF8, 0x07, 0x01])));
    assert!(!is_refused(&unknown), "an unknown field at {path:?}");
    let whole = content(message, path).expect("it is there");
    let mut tags: Vec<(u32, WireType)> =
        fields(&whole).into_iter().map(|(tag, wire_type, _)| (tag, wire_type)).collect();
    tags.dedup();
    let line = |&(tag, wire_type): &(u32, WireType)| {
        let path = [path, &[tag]].concat();
        let refused = |change: &Change| {
            let change = change.as_ref().map(|change| change as ContentChange<'_>);
            is_refused(&changed(message, &path, change))
        };
        let names =
            changes(wire_type).into_iter().filter(|(_, change)| refused(change)).map(|(name, _)| format!(" {name}"));
        format!("{tag}:{}\n", names.collect::<String>())
    };
    tags.iter().map(line).collect()
}

/// A message that is written field by field.
#[derive(Clone, Debug, Default)]
pub(super) struct Message(pub(super) Vec<u8>);

impl Message {
    /// A field of bytes: a message, or numbers.
    pub(super) fn bytes(mut self, tag: u32, content: impl AsRef<[u8]>) -> Message {
        encode_key(tag, WireType::LengthDelimited, &mut self.0);
        encode_varint(content.as_ref().len() as u64, &mut self.0);
        self.0.extend(content.as_ref());
        self
    }

    /// Doubles, as a list.
    pub(super) fn doubles(self, tag: u32, numbers: &[f64]) -> Message {
        self.bytes(tag, numbers.iter().flat_map(|number| number.to_le_bytes()).collect::<Vec<u8>>())
    }

    /// Singles, as a list.
    pub(super) fn singles(self, tag: u32, numbers: &[f32]) -> Message {
        self.bytes(tag, numbers.iter().flat_map(|number| number.to_le_bytes()).collect::<Vec<u8>>())
    }

    /// One double.
    pub(super) fn double(mut self, tag: u32, number: f64) -> Message {
        encode_key(tag, WireType::SixtyFourBit, &mut self.0);
        self.0.extend(number.to_le_bytes());
        self
    }

    /// An integer without a sign, or a flag.
    pub(super) fn integer(mut self, tag: u32, number: u64) -> Message {
        encode_key(tag, WireType::Varint, &mut self.0);
        encode_varint(number, &mut self.0);
        self
    }

    /// A time or a day.
    pub(super) fn signed(self, tag: u32, number: i64) -> Message {
        self.integer(tag, zigzag(number))
    }

    /// Days, as a list.
    pub(super) fn days(self, tag: u32, days: &[i64]) -> Message {
        let mut content = Vec::new();
        days.iter().for_each(|&day| encode_varint(zigzag(day), &mut content));
        self.bytes(tag, content)
    }
}

impl AsRef<[u8]> for Message {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

fn zigzag(number: i64) -> u64 {
    ((number << 1) ^ (number >> 63)).cast_unsigned()
}
