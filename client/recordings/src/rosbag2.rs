//! Recordings of rosbag2 in SQLite: its tables of topics and messages.
//!
//! Invariant: columns are found by their names. Messages come in the order in which they were written.

use std::{
    collections::HashMap,
    io::{self, Read, Seek},
};

use crate::{
    chunk::cdr_bytes,
    recording::{Encoding, Ending, RecordedMessage, RecordingError, Sink, Topic},
    sqlite::{Database, Table, TableRow, row::Value},
    topics::{Topics, bare_type, check_definitions, is_transient_local},
};

/// End of the name of a file beside a database, in which the newest rows may stand. The reader does not read it: rows
/// are missing if that file is there and not empty. `sqlite3 FILE 'PRAGMA wal_checkpoint(TRUNCATE)'` joins the two.
pub const LOG_ENDING: &str = "-wal";

/// Reads a database of rosbag2. Messages of topics that its table of topics lacks are passed over, as ROS 2 does.
///
/// # Errors
/// If the source cannot be read, is no SQLite database or none of rosbag2, breaks the format or the limits of
/// [`recording`](crate::recording), or the sink wants no more.
pub fn read<R: Read + Seek>(source: R, sink: &mut dyn Sink) -> Result<Ending, RecordingError> {
    let mut rows_read = 0;
    let cut_off = |rows: u64| {
        Ok(Ending::CutOff(format!("the database lacks pages that it refers to; {rows} messages before them were read")))
    };
    match read_rows(source, sink, &mut rows_read) {
        Ok((has, states)) if has < states => {
            Ok(Ending::CutOff(format!("the database ends after {has} bytes and states {states}")))
        }
        Ok(_) => Ok(Ending::Whole),
        Err(RecordingError::Io(error)) if error.kind() == io::ErrorKind::UnexpectedEof => cut_off(rows_read),
        Err(error) => Err(error),
    }
}

/// Gives the length of the file, and the length that it states.
fn read_rows<R: Read + Seek>(
    source: R,
    sink: &mut dyn Sink,
    rows_read: &mut u64,
) -> Result<(u64, u64), RecordingError> {
    let mut database = Database::open(source)?;
    let (Some(topics), Some(messages)) = (database.table("topics"), database.table("messages")) else {
        return Err(RecordingError::Unknown(if database.has_log() {
            "the database has no tables \"topics\" and \"messages\" yet: they may stand in the file beside it whose name \
             ends in -wal. Close the recorder, or run `sqlite3 FILE 'PRAGMA wal_checkpoint(TRUNCATE)'`"
                .to_owned()
        } else {
            "the database is none of rosbag2: it has no tables \"topics\" and \"messages\"".to_owned()
        }));
    };
    let definitions = match database.table("message_definitions") {
        Some(table) => read_definitions(&mut database, &table)?,
        None => HashMap::new(),
    };
    let mut found = Topics::default();
    let topics = read_topics(&mut database, &topics, &definitions, &mut found, sink)?;
    read_messages(&mut database, &messages, &topics, &found, sink, rows_read)?;
    Ok(database.lengths())
}

/// The definitions in the language of `.msg` files, by the name of their type.
fn read_definitions<R: Read + Seek>(
    database: &mut Database<R>,
    table: &Table,
) -> Result<HashMap<String, String>, RecordingError> {
    let columns = ["topic_type", "encoding", "encoded_message_definition"].map(|name| table.column(name));
    let [Some(type_name), Some(encoding), Some(definition)] = columns else { return Ok(HashMap::new()) };
    let (mut definitions, mut bytes) = (HashMap::new(), 0_usize);
    let (mut walk, mut row) = (database.walk(table), TableRow::default());
    while database.next(&mut walk, &mut row)? {
        check_definitions(usize::try_from(row.bytes_stated()).unwrap_or(usize::MAX))?;
        database.complete(&mut walk, &mut row)?;
        if text(&row, encoding)? != "ros2msg" {
            continue;
        }
        let (type_name, definition) = (text(&row, type_name)?, text(&row, definition)?);
        bytes = bytes.saturating_add(type_name.len() + definition.len());
        check_definitions(bytes)?;
        definitions.insert(type_name, definition);
    }
    Ok(definitions)
}

/// The topics' indices by the numbers of their rows, and whether their messages are in CDR.
fn read_topics<R: Read + Seek>(
    database: &mut Database<R>,
    table: &Table,
    definitions: &HashMap<String, String>,
    found: &mut Topics,
    sink: &mut dyn Sink,
) -> Result<HashMap<i64, (usize, bool)>, RecordingError> {
    let [id, name, type_name, format] =
        required_columns(table, "topics", ["id", "name", "type", "serialization_format"])?;
    let profiles = table.column("offered_qos_profiles");
    let mut topics = HashMap::new();
    let (mut walk, mut row) = (database.walk(table), TableRow::default());
    while database.next(&mut walk, &mut row)? {
        check_definitions(usize::try_from(row.bytes_stated()).unwrap_or(usize::MAX))?;
        database.complete(&mut walk, &mut row)?;
        let id = integer(&row, table, id, "topics")?;
        let type_name = text(&row, type_name)?;
        let format = text(&row, format)?;
        let topic = Topic {
            name: text(&row, name)?,
            type_name: bare_type(&type_name),
            encoding: if format == "cdr" { Encoding::Cdr } else { Encoding::Other(format) },
            definition: definitions.get(&type_name).cloned().unwrap_or_default(),
            is_latched: match profiles {
                Some(profiles) => is_transient_local(&text(&row, profiles)?),
                None => false,
            },
        };
        topics.insert(id, (found.add(&topic, sink)?, topic.encoding == Encoding::Cdr));
    }
    Ok(topics)
}

fn read_messages<R: Read + Seek>(
    database: &mut Database<R>,
    table: &Table,
    topics: &HashMap<i64, (usize, bool)>,
    found: &Topics,
    sink: &mut dyn Sink,
    rows_read: &mut u64,
) -> Result<(), RecordingError> {
    let [topic_id, timestamp, data] = required_columns(table, "messages", ["topic_id", "timestamp", "data"])?;
    let (mut walk, mut row, mut unpacked) = (database.walk(table), TableRow::default(), Vec::new());
    while database.next(&mut walk, &mut row)? {
        *rows_read = rows_read.saturating_add(1);
        // Usually the number of the topic stands before the data, so the data of others need not be read.
        if let Some(Value::Integer(id)) = row.value(topic_id)?
            && !topics.get(&id).is_some_and(|(topic, _)| found.is_wanted(*topic))
        {
            continue;
        }
        match database.complete(&mut walk, &mut row) {
            Err(error @ RecordingError::TooLarge { .. }) => {
                sink.passed_over(&error);
                continue;
            }
            completed => completed?,
        }
        let id = integer(&row, table, topic_id, "messages")?;
        let Some((topic, is_cdr)) = topics.get(&id).filter(|(topic, _)| found.is_wanted(*topic)) else { continue };
        let recorded_nanos = integer(&row, table, timestamp, "messages")?;
        let (Some(Value::Bytes(bytes)) | Some(Value::Text(bytes))) = row.value(data)? else {
            return Err(unexpected(&row, "messages", "data", "bytes"));
        };
        let what = || format!("the message in row {} of the table \"messages\"", row.number());
        let bytes = if *is_cdr { cdr_bytes(bytes, &mut unpacked, what)? } else { bytes };
        sink.message(RecordedMessage { topic: *topic, recorded_nanos, data: bytes }, database.bytes_read())?;
    }
    Ok(())
}

fn required_columns<const N: usize>(
    table: &Table,
    table_name: &str,
    names: [&str; N],
) -> Result<[usize; N], RecordingError> {
    let mut columns = [0; N];
    for (column, name) in columns.iter_mut().zip(names) {
        *column = table.column(name).ok_or_else(|| {
            RecordingError::Unknown(format!(
                "the database is none of rosbag2: its table {table_name:?} has no column {name:?}"
            ))
        })?;
    }
    Ok(columns)
}

fn integer(row: &TableRow, table: &Table, column: usize, table_name: &str) -> Result<i64, RecordingError> {
    match row.value(column)? {
        Some(Value::Integer(number)) => Ok(number),
        Some(Value::Null) if table.row_number_column == Some(column) => Ok(row.number()),
        _ => Err(unexpected(row, table_name, &format!("of index {column}"), "a whole number")),
    }
}

/// Text; empty for NULL and for a value that is not text.
fn text(row: &TableRow, column: usize) -> Result<String, RecordingError> {
    Ok(match row.value(column)? {
        Some(Value::Text(text) | Value::Bytes(text)) => String::from_utf8_lossy(text).into_owned(),
        _ => String::new(),
    })
}

fn unexpected(row: &TableRow, table_name: &str, column: &str, wanted: &str) -> RecordingError {
    let number = row.number();
    RecordingError::Broken(format!("row {number} of the table {table_name:?} has not {wanted} in its column {column}"))
}

#[cfg(test)]
mod tests;
