//! MCAP, read from the front to the back.
//!
//! Invariant: the summary is not used, so a file without one is read too. At most a chunk, as stored and as
//! decompressed, is in memory. The records are taken apart here, because a message that is too long is passed over: the
//! reader of the crate `mcap`, with a limit of a record's length, ends there.

use std::{
    collections::{HashMap, hash_map::Entry},
    io::{self, Read},
    mem,
    sync::Arc,
};

use crate::{
    chunk::{cdr_bytes, shortened, unpack},
    layout,
    recording::{
        BLOCK_BYTES_MAX, DEFINITION_BYTES_MAX, Encoding, Ending, MESSAGE_BYTES_MAX, RecordedMessage, RecordingError,
        Sink, Topic,
    },
    source::{ByteSource, Fields},
    topics::{Topics, bare_type, check_definitions, is_transient_local},
};

/// The first and last bytes of an MCAP file.
pub const MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";

const OP_FOOTER: u8 = 0x02;
const OP_SCHEMA: u8 = 0x03;
const OP_CHANNEL: u8 = 0x04;
const OP_MESSAGE: u8 = 0x05;
const OP_CHUNK: u8 = 0x06;

/// A message's record without its data, and a chunk's without its name of a compression and its data.
const MESSAGE_FIELDS_BYTES: usize = 22;
const CHUNK_FIELDS_BYTES: usize = 40;
const COMPRESSION_BYTES_MAX: usize = 256;

/// Reads an MCAP file. Records that hold no topics and no messages are passed over.
///
/// # Errors
/// If the source cannot be read, is no MCAP, breaks the format, a checksum or the limits of
/// [`recording`](crate::recording), or the sink wants no more.
pub fn read<R: Read>(source: R, sink: &mut dyn Sink) -> Result<Ending, RecordingError> {
    let mut reader = McapReader {
        source: ByteSource::new(source),
        place: "within its first bytes",
        record: Vec::new(),
        unpacked: Vec::new(),
        messages: Messages::default(),
    };
    match reader.read_all(sink) {
        Ok(()) => Ok(Ending::Whole),
        Err(RecordingError::Io(error)) if error.kind() == io::ErrorKind::UnexpectedEof => {
            let (position, place) = (reader.source.position(), reader.place);
            Ok(Ending::CutOff(format!("the file ends after {position} bytes, {place}")))
        }
        Err(error) => Err(error),
    }
}

struct McapReader<R> {
    source: ByteSource<R>,
    /// The place of the reading, for the text of a file that is cut off.
    place: &'static str,
    record: Vec<u8>,
    unpacked: Vec<u8>,
    messages: Messages,
}

impl<R: Read> McapReader<R> {
    fn read_all(&mut self, sink: &mut dyn Sink) -> Result<(), RecordingError> {
        if self.source.array::<8>()? != *MAGIC {
            return Err(RecordingError::Unknown("the file is no MCAP of version 0".to_owned()));
        }
        loop {
            let position = self.source.position();
            self.place = "before its footer";
            let [op] = self.source.array()?;
            let length = u64::from_le_bytes(self.source.array()?);
            let (what, max, place) = match op {
                OP_SCHEMA => ("the schema", DEFINITION_BYTES_MAX, "within a schema"),
                OP_CHANNEL => ("the channel", DEFINITION_BYTES_MAX, "within a channel"),
                OP_MESSAGE => ("the message", MESSAGE_BYTES_MAX + MESSAGE_FIELDS_BYTES, "within a message"),
                OP_CHUNK => {
                    let max = BLOCK_BYTES_MAX + CHUNK_FIELDS_BYTES + COMPRESSION_BYTES_MAX;
                    ("the chunk", max, "within a chunk; the chunks before were read")
                }
                _ => {
                    self.place = "within a record without messages";
                    self.source.skip(length)?;
                    if op == OP_FOOTER {
                        return self.end();
                    }
                    continue;
                }
            };
            self.place = place;
            let Some(count) = usize::try_from(length).ok().filter(|count| *count <= max) else {
                let what = format!("{what} at byte {position}");
                let error = RecordingError::TooLarge { what, bytes: length, max };
                if !matches!(op, OP_MESSAGE | OP_CHUNK) {
                    return Err(error);
                }
                sink.passed_over(&error);
                self.source.skip(length)?;
                continue;
            };
            self.source.take_into(&mut self.record, count)?;
            let record = mem::take(&mut self.record);
            let result = match op {
                OP_CHUNK => self.chunk(&record, position, sink),
                _ => self.messages.record(op, &record, (position, self.source.position()), sink),
            };
            self.record = record;
            result?;
        }
    }

    fn end(&mut self) -> Result<(), RecordingError> {
        self.place = "within its last bytes";
        if self.source.array::<8>()? == *MAGIC {
            return Ok(());
        }
        let position = self.source.position();
        Err(RecordingError::Broken(format!(
            "the 8 bytes before byte {position}, behind the footer, do not end an MCAP"
        )))
    }

    fn chunk(&mut self, record: &[u8], position: u64, sink: &mut dyn Sink) -> Result<(), RecordingError> {
        let what = format!("the chunk at byte {position}");
        let short = || RecordingError::Broken(format!("{what} is shorter than its fields"));
        let chunk = Chunk::new(record).ok_or_else(short)?;
        let mut unpacked = mem::take(&mut self.unpacked);
        let result = chunk.bytes(&what, &mut unpacked).and_then(|bytes| {
            let mut rest = Fields(bytes);
            while !rest.0.is_empty() {
                let within = bytes.len() - rest.0.len();
                let Some((op, record)) = inner_record(&mut rest) else {
                    return Err(RecordingError::Broken(format!("{what} ends within its record at byte {within}")));
                };
                self.messages.record(op, record, (position, self.source.position()), sink)?;
            }
            Ok(())
        });
        self.unpacked = unpacked;
        result
    }
}

fn inner_record<'a>(rest: &mut Fields<'a>) -> Option<(u8, &'a [u8])> {
    let op = rest.u8()?;
    let length = usize::try_from(rest.u64()?).ok()?;
    Some((op, rest.take(length)?))
}

/// The fields of a chunk's record.
struct Chunk<'a> {
    size: u64,
    checksum: u32,
    compression: String,
    stored: &'a [u8],
}

impl<'a> Chunk<'a> {
    fn new(record: &'a [u8]) -> Option<Self> {
        let mut fields = Fields(record);
        let (_first_time, _last_time) = (fields.u64()?, fields.u64()?);
        let (size, checksum, compression) = (fields.u64()?, fields.u32()?, fields.text()?);
        let length = usize::try_from(fields.u64()?).ok()?;
        Some(Self { size, checksum, compression, stored: fields.take(length)? })
    }

    /// The records inside, if their checksum holds; 0 states none.
    fn bytes<'b>(&self, what: &str, buffer: &'b mut Vec<u8>) -> Result<&'b [u8], RecordingError>
    where
        'a: 'b,
    {
        let bytes = unpack(&self.compression, self.stored, buffer, what)?;
        if bytes.len() as u64 != self.size {
            let (found, stated) = (bytes.len(), self.size);
            return Err(RecordingError::Broken(format!("{what} has {found} bytes and states {stated}")));
        }
        let found = if self.checksum == 0 { 0 } else { crc32fast::hash(bytes) };
        if found != self.checksum {
            let stated = self.checksum;
            return Err(RecordingError::Broken(format!("{what} has the checksum {found:08x} and states {stated:08x}")));
        }
        Ok(bytes)
    }
}

/// The schemas and channels that were found.
#[derive(Default)]
struct Messages {
    schemas: HashMap<u16, Schema>,
    schema_bytes: usize,
    channels: HashMap<u16, Channel>,
    topics: Topics,
    unpacked: Vec<u8>,
}

struct Schema {
    name: String,
    encoding: String,
    /// Empty if the language is not read.
    data: Arc<[u8]>,
}

impl Schema {
    fn text(&self) -> String {
        String::from_utf8_lossy(&self.data).into_owned()
    }

    /// The definition in the language of `.msg` files; empty if the schema is in another one.
    fn definition(&self) -> String {
        if matches!(self.encoding.as_str(), "ros1msg" | "ros2msg") { self.text() } else { String::new() }
    }
}

/// The layout of the messages of a channel.
fn encoding_of(encoding: String, schema: Option<&Schema>) -> Encoding {
    let language = schema.map_or("", |schema| schema.encoding.as_str());
    let of_language = |wanted: &str| {
        let encoding = &encoding;
        let text = match language {
            "" => format!("its schema names no language; messages in {encoding} need one in {wanted}"),
            language => format!("its schema is in {language:?}; messages in {encoding} need one in {wanted}"),
        };
        Encoding::Unreadable(text)
    };
    match (encoding.as_str(), schema) {
        ("cdr" | "ros1" | "json" | "protobuf", None) => {
            Encoding::Unreadable("its channel has no schema, so the fields of its messages are not known".to_owned())
        }
        ("json", Some(schema)) if language == "jsonschema" => Encoding::Json(schema.text().into()),
        ("json", Some(_)) => of_language("jsonschema"),
        ("protobuf", Some(schema)) if language == "protobuf" => Encoding::Protobuf(schema.data.clone()),
        ("protobuf", Some(_)) => of_language("protobuf"),
        ("cdr" | "ros1", Some(schema)) => {
            let encoding_read = if encoding == "cdr" { Encoding::Cdr } else { Encoding::Ros1 };
            // The types that everybody uses are known without a schema.
            let is_usual = || layout::of_type(&schema.name, "", &encoding_read).is_ok();
            if matches!(language, "ros1msg" | "ros2msg") || is_usual() {
                encoding_read
            } else {
                of_language(if encoding == "cdr" { "ros2msg" } else { "ros1msg" })
            }
        }
        _ => Encoding::Other(encoding),
    }
}

struct Channel {
    topic: usize,
    name: String,
    schema: u16,
    is_cdr: bool,
}

impl Messages {
    /// Takes a record. `place`: where it, or its chunk, begins, and how many bytes have been read.
    fn record(&mut self, op: u8, record: &[u8], place: (u64, u64), sink: &mut dyn Sink) -> Result<(), RecordingError> {
        let position = place.0;
        let fields = Fields(record);
        let short = |what: &str| {
            RecordingError::Broken(format!(
                "{what} at byte {position}, or in the chunk there, is shorter than its fields"
            ))
        };
        match op {
            OP_SCHEMA => self.schema(fields)?.ok_or_else(|| short("the schema")),
            OP_CHANNEL => self.channel(fields, position, sink)?.ok_or_else(|| short("the channel")),
            OP_MESSAGE => self.message(fields, place, sink)?.ok_or_else(|| short("the message")),
            _ => Ok(()),
        }
    }

    fn schema(&mut self, mut fields: Fields<'_>) -> Result<Option<()>, RecordingError> {
        let mut parse = || Some((fields.u16()?, fields.text()?, fields.text()?, fields.counted()?));
        let Some((id, name, encoding, data)) = parse() else { return Ok(None) };
        if let Entry::Vacant(place) = self.schemas.entry(id) {
            let is_read = matches!(encoding.as_str(), "ros1msg" | "ros2msg" | "jsonschema" | "protobuf");
            let data: Arc<[u8]> = if is_read { data.into() } else { Arc::default() };
            self.schema_bytes = self.schema_bytes.saturating_add(name.len() + data.len());
            check_definitions(self.schema_bytes)?;
            place.insert(Schema { name, encoding, data });
        }
        Ok(Some(()))
    }

    fn channel(
        &mut self,
        mut fields: Fields<'_>,
        position: u64,
        sink: &mut dyn Sink,
    ) -> Result<Option<()>, RecordingError> {
        let mut parse = || Some((fields.u16()?, fields.u16()?, fields.text()?, fields.text()?, fields.counted()?));
        let Some((id, schema, name, encoding, metadata)) = parse() else { return Ok(None) };
        match self.channels.entry(id) {
            Entry::Occupied(known) if known.get().name == name && known.get().schema == schema => Ok(Some(())),
            Entry::Occupied(known) => Err(RecordingError::Broken(format!(
                "channel {id} at byte {position}, or in the chunk there, is one of {:?}; before it was one of {:?}",
                shortened(&name),
                shortened(&known.get().name)
            ))),
            Entry::Vacant(place) => {
                let Some(is_latched) = is_latched(metadata) else { return Ok(None) };
                let about = self.schemas.get(&schema);
                if schema != 0 && about.is_none() {
                    return Err(RecordingError::Broken(format!(
                        "channel {id} at byte {position}, or in the chunk there, has the schema {schema}, which was not \
                         described before it"
                    )));
                }
                let is_cdr = encoding == "cdr";
                let topic = Topic {
                    name: name.clone(),
                    type_name: about.map(|schema| bare_type(&schema.name)).unwrap_or_default(),
                    encoding: encoding_of(encoding, about),
                    definition: about.map(Schema::definition).unwrap_or_default(),
                    is_latched,
                };
                let topic = self.topics.add(&topic, sink)?;
                place.insert(Channel { topic, name, schema, is_cdr });
                Ok(Some(()))
            }
        }
    }

    fn message(
        &mut self,
        mut fields: Fields<'_>,
        (position, bytes_read): (u64, u64),
        sink: &mut dyn Sink,
    ) -> Result<Option<()>, RecordingError> {
        let mut parse = || Some((fields.u16()?, fields.u32()?, fields.u64()?, fields.u64()?));
        let Some((id, _sequence, recorded, _published)) = parse() else { return Ok(None) };
        let data = fields.0;
        let Some(channel) = self.channels.get(&id) else {
            return Err(RecordingError::Broken(format!(
                "a message at byte {position}, or in the chunk there, is one of channel {id}, which was not described \
                 before it"
            )));
        };
        if !self.topics.is_wanted(channel.topic) {
            return Ok(Some(()));
        }
        let what = || format!("a message of {:?} at byte {position}", shortened(&channel.name));
        if data.len() > MESSAGE_BYTES_MAX {
            return Err(RecordingError::TooLarge { what: what(), bytes: data.len() as u64, max: MESSAGE_BYTES_MAX });
        }
        let recorded_nanos = i64::try_from(recorded).map_err(|_| {
            RecordingError::Broken(format!("{} has the time {recorded} ns, after the year 2262", what()))
        })?;
        let data = if channel.is_cdr { cdr_bytes(data, &mut self.unpacked, what)? } else { data };
        sink.message(RecordedMessage { topic: channel.topic, recorded_nanos, data }, bytes_read)?;
        Ok(Some(()))
    }
}

/// Whether the map of a channel's metadata calls it latched (ROS 1) or transient local (ROS 2).
fn is_latched(metadata: &[u8]) -> Option<bool> {
    let mut rest = Fields(metadata);
    let mut is_latched = false;
    while !rest.0.is_empty() {
        let (key, value) = (rest.counted()?, rest.counted()?);
        is_latched |= match key {
            b"offered_qos_profiles" => is_transient_local(&String::from_utf8_lossy(value)),
            b"latching" => matches!(value, b"1" | b"true"),
            _ => false,
        };
    }
    Some(is_latched)
}

#[cfg(test)]
mod tests;
