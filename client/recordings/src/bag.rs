//! Bags of ROS 1, format 2.0, read from the front to the back.
//!
//! Invariant: the index is not used, so a bag without one is read too. At most a chunk, as stored and as decompressed,
//! is in memory.

use std::{
    collections::{HashMap, hash_map::Entry},
    io::{self, Read},
    mem,
};

use crate::{
    chunk::{shortened, unpack},
    recording::{
        BLOCK_BYTES_MAX, DEFINITION_BYTES_MAX, Encoding, Ending, MESSAGE_BYTES_MAX, RecordedMessage, RecordingError,
        Sink, Topic,
    },
    source::{ByteSource, Fields},
    topics::Topics,
};

/// The first bytes of a bag of format 2.0.
pub const MAGIC: &[u8; 13] = b"#ROSBAG V2.0\n";

/// The headers that the format knows have some hundred bytes, and a connection's name of a topic.
const HEADER_BYTES_MAX: u32 = 1 << 20;
/// The lengths of its header and its data.
const RECORD_BYTES_MIN: usize = 8;
const INDEX_ENTRY_BYTES: u64 = 12;
const SECOND_NANOS: i64 = 1_000_000_000;

const OP_MESSAGE: u8 = 2;
const OP_BAG: u8 = 3;
const OP_INDEX: u8 = 4;
const OP_CHUNK: u8 = 5;
const OP_CHUNK_INFO: u8 = 6;
const OP_CONNECTION: u8 = 7;

/// Reads a bag of format 2.0. Records of kinds that the format does not know are passed over.
///
/// # Errors
/// If the source cannot be read, is no bag of format 2.0, is encrypted, breaks the format or the limits of
/// [`recording`](crate::recording), or the sink wants no more.
pub fn read<R: Read>(source: R, sink: &mut dyn Sink) -> Result<Ending, RecordingError> {
    let mut reader = BagReader::new(source);
    match reader.read_all(sink) {
        Ok(()) => Ok(reader.ending()),
        Err(RecordingError::Io(error)) if error.kind() == io::ErrorKind::UnexpectedEof => {
            let place = reader.place;
            Ok(Ending::CutOff(format!("the bag ends after {} bytes, {place}", reader.source.position())))
        }
        Err(error) => Err(error),
    }
}

/// Advice for a bag of another version; `None` if these are not the first bytes of a bag.
pub(crate) fn other_version(bytes: &[u8]) -> Option<String> {
    let line = bytes.strip_prefix(b"#")?.split(|byte| *byte == b'\n').next()?;
    if bytes.starts_with(MAGIC) || !(line.starts_with(b"ROSRECORD V") || line.starts_with(b"ROSBAG V")) {
        return None;
    }
    let version = line[..line.len().min(32)].escape_ascii();
    Some(format!(
        "this is a bag of ROS 1 of format {version}; format 2.0 is read: convert it on a computer with ROS 1, with \
         `rosbag fix OLD.bag NEW.bag`"
    ))
}

struct BagReader<R> {
    source: ByteSource<R>,
    /// The place of the reading, for the text of a file that is cut off.
    place: &'static str,
    header: Vec<u8>,
    data: Vec<u8>,
    unpacked: Vec<u8>,
    connections: HashMap<u32, BagConnection>,
    topics: Topics,
    is_closed: bool,
    chunks_stated: u32,
    chunks: u32,
    chunk_infos: u32,
}

struct BagConnection {
    topic: usize,
    name: String,
    type_name: String,
}

impl<R: Read> BagReader<R> {
    fn new(source: R) -> Self {
        Self {
            source: ByteSource::new(source),
            place: "within its first line",
            header: Vec::new(),
            data: Vec::new(),
            unpacked: Vec::new(),
            connections: HashMap::new(),
            topics: Topics::default(),
            is_closed: false,
            chunks_stated: 0,
            chunks: 0,
            chunk_infos: 0,
        }
    }

    fn read_all(&mut self, sink: &mut dyn Sink) -> Result<(), RecordingError> {
        let other = other_version(self.source.peek(32)?);
        if self.source.array::<13>()? != *MAGIC {
            let text = other.unwrap_or_else(|| "the file is no bag of ROS 1, format 2.0".to_owned());
            return Err(RecordingError::Unknown(text));
        }
        while !self.source.is_at_end()? {
            self.place = "within the header of a record";
            let position = self.source.position();
            let header = self.take_header(position)?;
            let result = self.take_record(&Header::new(&header, position)?, position, sink);
            self.header = header;
            result?;
        }
        Ok(())
    }

    /// A bag that its recorder closed states how many chunks it has.
    fn ending(&self) -> Ending {
        if !self.is_closed {
            return Ending::CutOff("the recorder did not close the bag: it has no index".to_owned());
        }
        let found = self.chunks.min(self.chunk_infos);
        if found < self.chunks_stated {
            let (position, stated) = (self.source.position(), self.chunks_stated);
            return Ending::CutOff(format!(
                "the bag ends after {position} bytes: {} chunks and the index of {} are there, of {stated}",
                self.chunks, self.chunk_infos
            ));
        }
        Ending::Whole
    }

    fn take_header(&mut self, position: u64) -> Result<Vec<u8>, RecordingError> {
        let length = u32::from_le_bytes(self.source.array()?);
        if length > HEADER_BYTES_MAX {
            return Err(RecordingError::Broken(format!(
                "the record at byte {position} states a header of {length} bytes; at most {HEADER_BYTES_MAX} are read"
            )));
        }
        let mut header = mem::take(&mut self.header);
        self.source.take_into(&mut header, length as usize)?;
        Ok(header)
    }

    fn take_record(&mut self, header: &Header<'_>, position: u64, sink: &mut dyn Sink) -> Result<(), RecordingError> {
        let length = u32::from_le_bytes(self.source.array()?);
        match header.op()? {
            OP_MESSAGE => {
                self.place = "within a message";
                if self.passes_over("the message", (position, length), MESSAGE_BYTES_MAX, sink)? {
                    return Ok(());
                }
                self.take_data("the message", position, length, MESSAGE_BYTES_MAX)?;
                let data = mem::take(&mut self.data);
                let result = self.message(header, &data, sink);
                self.data = data;
                result
            }
            OP_BAG => {
                self.place = "within its first record";
                self.begin(header)?;
                Ok(self.source.skip(u64::from(length))?)
            }
            OP_INDEX => {
                self.place = "within the index of a chunk";
                self.pass_index(header, length)
            }
            OP_CHUNK => {
                self.place = "within a chunk; the chunks before were read";
                if self.passes_over("the chunk", (position, length), BLOCK_BYTES_MAX, sink)? {
                    self.chunks = self.chunks.saturating_add(1);
                    return Ok(());
                }
                self.take_data("the chunk", position, length, BLOCK_BYTES_MAX)?;
                let (data, mut unpacked) = (mem::take(&mut self.data), mem::take(&mut self.unpacked));
                let result = self.chunk(header, &data, &mut unpacked, sink);
                (self.data, self.unpacked) = (data, unpacked);
                self.chunks = self.chunks.saturating_add(1);
                result
            }
            OP_CHUNK_INFO => {
                self.place = "within its index";
                self.source.skip(u64::from(length))?;
                self.chunk_infos = self.chunk_infos.saturating_add(1);
                Ok(())
            }
            OP_CONNECTION => {
                self.place = "within a connection";
                self.take_data("the connection", position, length, DEFINITION_BYTES_MAX)?;
                let data = mem::take(&mut self.data);
                let result = self.connection(header, &data, sink);
                self.data = data;
                result
            }
            _ => {
                self.place = "within a record of an unknown kind";
                Ok(self.source.skip(u64::from(length))?)
            }
        }
    }

    /// Passes over the data of a record that is too long.
    fn passes_over(
        &mut self,
        what: &str,
        (position, length): (u64, u32),
        max: usize,
        sink: &mut dyn Sink,
    ) -> Result<bool, RecordingError> {
        if length as usize <= max {
            return Ok(false);
        }
        let what = format!("{what} at byte {position}");
        sink.passed_over(&RecordingError::TooLarge { what, bytes: u64::from(length), max });
        self.source.skip(u64::from(length))?;
        Ok(true)
    }

    fn take_data(&mut self, what: &str, position: u64, length: u32, max: usize) -> Result<(), RecordingError> {
        if length as usize > max {
            let what = format!("{what} at byte {position}");
            return Err(RecordingError::TooLarge { what, bytes: u64::from(length), max });
        }
        Ok(self.source.take_into(&mut self.data, length as usize)?)
    }

    fn begin(&mut self, header: &Header<'_>) -> Result<(), RecordingError> {
        if let Some(encryptor) = header.field("encryptor").filter(|name| !name.is_empty()) {
            let name = String::from_utf8_lossy(encryptor);
            return Err(RecordingError::Unknown(format!(
                "the bag is encrypted by {:?}: decrypt it first with `rosbag decrypt`",
                shortened(&name)
            )));
        }
        self.is_closed = header.u64("index_pos").is_some_and(|position| position != 0);
        self.chunks_stated = header.u32("chunk_count").unwrap_or(0);
        Ok(())
    }

    /// Some recorders of 2010 state 20 bytes for an entry of 12: where the two lengths differ, the shorter holds if a
    /// record follows it.
    fn pass_index(&mut self, header: &Header<'_>, stated: u32) -> Result<(), RecordingError> {
        let stated = u64::from(stated);
        let counted = match (header.u32("ver"), header.u32("count")) {
            (Some(1), Some(count)) => u64::from(count) * INDEX_ENTRY_BYTES,
            _ => stated,
        };
        self.source.skip(stated.min(counted))?;
        if stated == counted {
            return Ok(());
        }
        let ahead = self.source.peek(32)?;
        if !ahead.is_empty() && ahead.len() < RECORD_BYTES_MIN {
            return Err(RecordingError::Io(io::ErrorKind::UnexpectedEof.into()));
        }
        if !begins_record(ahead) {
            self.source.skip(stated.abs_diff(counted))?;
        }
        Ok(())
    }

    fn chunk(
        &mut self,
        header: &Header<'_>,
        stored: &[u8],
        unpacked: &mut Vec<u8>,
        sink: &mut dyn Sink,
    ) -> Result<(), RecordingError> {
        let compression = String::from_utf8_lossy(header.required("compression")?);
        let what = format!("the chunk at byte {}", header.position);
        let bytes = unpack(&compression, stored, unpacked, &what)?;
        if let Some(stated) = header.u32("size").filter(|size| *size as usize != bytes.len()) {
            return Err(RecordingError::Broken(format!("{what} has {} bytes and states {stated}", bytes.len())));
        }
        let mut rest = Fields(bytes);
        while !rest.0.is_empty() {
            let within = bytes.len() - rest.0.len();
            let (Some(inner), Some(data)) = (rest.counted(), rest.counted()) else {
                return Err(RecordingError::Broken(format!("{what} ends within its record at byte {within}")));
            };
            let inner = Header::new(inner, header.position)?;
            match inner.op()? {
                OP_MESSAGE => self.message(&inner, data, sink)?,
                OP_CONNECTION => self.connection(&inner, data, sink)?,
                _ => {}
            }
        }
        Ok(())
    }

    fn message(&self, header: &Header<'_>, data: &[u8], sink: &mut dyn Sink) -> Result<(), RecordingError> {
        let id = header.required_u32("conn")?;
        let Some(connection) = self.connections.get(&id) else {
            return Err(header.broken(&format!("is a message of connection {id}, which was not described before it")));
        };
        if !self.topics.is_wanted(connection.topic) {
            return Ok(());
        }
        if data.len() > MESSAGE_BYTES_MAX {
            let what = format!("a message of {:?} at byte {}", shortened(&connection.name), header.position);
            sink.passed_over(&RecordingError::TooLarge { what, bytes: data.len() as u64, max: MESSAGE_BYTES_MAX });
            return Ok(());
        }
        let mut time = Fields(header.required("time")?);
        let (Some(secs), Some(nanos)) = (time.u32(), time.u32()) else {
            return Err(header.broken("has a field \"time\" of fewer than 8 bytes"));
        };
        let recorded_nanos = i64::from(secs) * SECOND_NANOS + i64::from(nanos);
        let message = RecordedMessage { topic: connection.topic, recorded_nanos, data };
        Ok(sink.message(message, self.source.position())?)
    }

    fn connection(&mut self, header: &Header<'_>, data: &[u8], sink: &mut dyn Sink) -> Result<(), RecordingError> {
        let id = header.required_u32("conn")?;
        let name = String::from_utf8_lossy(header.required("topic")?).into_owned();
        let about = Header::new(data, header.position)?;
        let text = |field: &str| String::from_utf8_lossy(about.field(field).unwrap_or_default()).into_owned();
        let type_name = text("type");
        match self.connections.entry(id) {
            Entry::Occupied(known) if known.get().name == name && known.get().type_name == type_name => Ok(()),
            Entry::Occupied(known) => Err(header.broken(&format!(
                "makes connection {id} one of {:?}; before it was one of {:?}",
                shortened(&name),
                shortened(&known.get().name)
            ))),
            Entry::Vacant(place) => {
                let topic = Topic {
                    name: name.clone(),
                    type_name: type_name.clone(),
                    encoding: Encoding::Ros1,
                    definition: text("message_definition"),
                    is_latched: about.field("latching") == Some(b"1"),
                };
                let topic = self.topics.add(&topic, sink)?;
                place.insert(BagConnection { topic, name, type_name });
                Ok(())
            }
        }
    }
}

/// The fields of a record's header, `name=value` each behind its length.
struct Header<'a> {
    fields: Vec<(&'a [u8], &'a [u8])>,
    position: u64,
}

impl<'a> Header<'a> {
    /// No record that the format knows has more fields.
    const FIELDS_MAX: usize = 64;

    fn new(bytes: &'a [u8], position: u64) -> Result<Self, RecordingError> {
        let mut header = Self { fields: Vec::new(), position };
        let mut rest = Fields(bytes);
        while !rest.0.is_empty() {
            let Some(field) = rest.counted() else { return Err(header.broken("has a field that does not end")) };
            let Some(equals) = field.iter().position(|byte| *byte == b'=') else {
                return Err(header.broken("has a field without \"=\""));
            };
            if header.fields.len() == Self::FIELDS_MAX {
                return Err(header.broken(&format!("has more than {} fields", Self::FIELDS_MAX)));
            }
            header.fields.push((&field[..equals], &field[equals + 1..]));
        }
        Ok(header)
    }

    fn field(&self, name: &str) -> Option<&'a [u8]> {
        self.fields.iter().find(|(field, _)| *field == name.as_bytes()).map(|(_, value)| *value)
    }

    fn required(&self, name: &str) -> Result<&'a [u8], RecordingError> {
        self.field(name).ok_or_else(|| self.broken(&format!("has no field {name:?}")))
    }

    fn op(&self) -> Result<u8, RecordingError> {
        self.required("op")?.first().copied().ok_or_else(|| self.broken("has an empty field \"op\""))
    }

    fn u32(&self, name: &str) -> Option<u32> {
        Fields(self.field(name)?).u32()
    }

    fn u64(&self, name: &str) -> Option<u64> {
        Fields(self.field(name)?).u64()
    }

    fn required_u32(&self, name: &str) -> Result<u32, RecordingError> {
        let mut value = Fields(self.required(name)?);
        value.u32().ok_or_else(|| self.broken(&format!("has a field {name:?} of fewer than 4 bytes")))
    }

    fn broken(&self, how: &str) -> RecordingError {
        RecordingError::Broken(format!("the record at byte {}, or one inside of it, {how}", self.position))
    }
}

/// Whether bytes have the form of the begin of a record: a header's length, a field's length within it, a name and `=`.
/// A missing field at the end of the file is no counter-evidence.
fn begins_record(bytes: &[u8]) -> bool {
    let mut rest = Fields(bytes);
    let (Some(header), Some(field)) = (rest.u32(), rest.u32()) else { return true };
    let is_name = |byte: &u8| byte.is_ascii_lowercase() || *byte == b'_';
    let name = rest.0.iter().take_while(|byte| is_name(byte)).count();
    header <= HEADER_BYTES_MAX
        && field <= header.saturating_sub(4)
        && (name > 0 || rest.0.is_empty())
        && rest.0.get(name).is_none_or(|byte| *byte == b'=')
}

#[cfg(test)]
pub(crate) mod tests;
