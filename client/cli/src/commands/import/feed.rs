//! Reads recordings a second time, on a thread of its own, and makes observations of their messages.
//!
//! Invariant: observations come in the order of the recordings; the memory for observations that are read in advance is
//! bounded, whatever the size of the recordings.

use std::{
    collections::{BTreeMap, HashSet},
    thread,
};

use anyhow::Context as _;
use tidemap_client::{
    maps::GridSpec,
    observe::{TraversalReport, scan::Scan},
    routes::StateName,
};
use tidemap_recordings::{
    convert::{BeamCounts, ConvertOptions, Converter, Item, Made, NotMade},
    recording::{RecordedMessage, RecordingError, Sink, Stopped, Topic},
};
use tokio::sync::mpsc;

use super::{
    ImportArgs, Planned,
    files::Recording,
    grid::{self, Ranges},
    prepare::Prepared,
};
use crate::progress::status_line;

/// A chunk ends with this many observations, or bytes of scans.
const CHUNK_ITEMS: usize = 1024;
const CHUNK_BYTES: usize = 1 << 20;
const CHUNKS_AHEAD: usize = 2;

/// An observation to send.
#[derive(Debug)]
pub(super) struct ImportItem {
    pub(super) time_nanos: i64,
    pub(super) content: ImportContent,
}

#[derive(Debug)]
pub(super) enum ImportContent {
    Scan(Scan),
    /// A value of the rule with this index among the rules of the topic.
    Value {
        state: String,
        value: f64,
        rule: usize,
    },
    Label {
        state: String,
        label: String,
        rule: usize,
    },
    Position {
        state: String,
        coordinates: Vec<f64>,
    },
    Traversal(TraversalReport),
}

/// Observations made of messages, each with the index of its topic.
#[derive(Debug, Default)]
pub(super) struct ImportChunk {
    pub(super) items: Vec<(usize, Result<ImportItem, NotMade>)>,
    /// Bytes of the recordings read so far.
    pub(super) position: u64,
    /// Whether this is the last chunk of all files.
    pub(super) is_last: bool,
    /// The beams of each topic so far.
    pub(super) beams: BTreeMap<usize, BeamCounts>,
    bytes: usize,
}

pub(super) type ImportChunks = mpsc::Receiver<anyhow::Result<ImportChunk>>;

/// Begins to read.
pub(super) fn open(planned: &Planned, prepared: &Prepared, args: &ImportArgs) -> anyhow::Result<ImportChunks> {
    let (sender, receiver) = mpsc::channel(CHUNKS_AHEAD);
    let merge = if args.every_point { None } else { prepared.cells() };
    let options =
        ConvertOptions { clock: args.times.into(), merge, period_nanos: args.period, at_header: args.at_stamp };
    let mut reader = Reader {
        converter: Converter::new(planned.surveyed.clone(), planned.plan.clone(), options),
        grid: prepared.grid.clone(),
        ranges: Ranges { min_m: args.min_range, max_m: args.max_range, free_m: args.free_range },
        chunk: ImportChunk::default(),
        before: 0,
        printed: HashSet::new(),
        sender,
    };
    let recording = planned.recording.clone();
    thread::Builder::new()
        .name("recordings".to_owned())
        .spawn(move || {
            if let Err(error) = reader.read(&recording) {
                // Nobody waits any more if this fails.
                let _ = reader.sender.blocking_send(Err(error));
            }
        })
        .context("thread")?;
    Ok(receiver)
}

struct Reader {
    converter: Converter,
    grid: Option<GridSpec>,
    ranges: Ranges,
    chunk: ImportChunk,
    /// Bytes of the files before this one.
    before: u64,
    /// Notices about grids so far; each is printed once.
    printed: HashSet<String>,
    sender: mpsc::Sender<anyhow::Result<ImportChunk>>,
}

impl Reader {
    fn read(&mut self, recording: &Recording) -> anyhow::Result<()> {
        for (file, before) in recording.files() {
            self.before = before;
            self.converter.next_file();
            match file.read(self) {
                // A cut file was reported when the file was read first.
                Ok(_) => {}
                Err(RecordingError::Stopped) => return Ok(()),
                Err(error) => {
                    let _ = self.pass_on();
                    return Err(anyhow::Error::new(error).context(file.shown()));
                }
            }
        }
        self.chunk.position = recording.bytes();
        self.chunk.is_last = true;
        // Nobody waits any more if this fails.
        let _ = self.pass_on();
        Ok(())
    }

    fn pass_on(&mut self) -> Result<(), Stopped> {
        let position = self.chunk.position;
        let mut chunk = std::mem::replace(&mut self.chunk, ImportChunk { position, ..ImportChunk::default() });
        chunk.beams.clone_from(self.converter.beams());
        self.sender.blocking_send(Ok(chunk)).map_err(|_| Stopped)
    }

    fn item(&mut self, item: Item) -> Result<ImportItem, NotMade> {
        let Item { time_nanos, made } = item;
        if time_nanos < 0 {
            return Err(NotMade::Wrong(format!("its time, {time_nanos} ns, is before 1970")));
        }
        let content = match made {
            Made::Scan(scan) => ImportContent::Scan(grid::ranges(scan, self.ranges)),
            Made::Cloud(cloud) => ImportContent::Scan(grid::cloud(cloud, self.ranges)),
            Made::Grid(placed) => match &self.grid {
                Some(grid) => {
                    let (scan, notice) = grid::cells(&placed, grid).map_err(NotMade::Wrong)?;
                    if let Some(notice) = notice.filter(|notice| self.printed.insert(notice.clone())) {
                        status_line(&notice);
                    }
                    ImportContent::Scan(scan)
                }
                None => return Err(NotMade::Wrong("the map has no grid".to_owned())),
            },
            Made::Value { state, value, rule } => ImportContent::Value { state, value, rule },
            Made::Label { state, label, rule } => ImportContent::Label { state, label, rule },
            Made::Position { state, coordinates_m } => ImportContent::Position { state, coordinates: coordinates_m },
            Made::Traversal { from, to, start_nanos, success, reason } => {
                let action = String::new();
                let report = TraversalReport { from, to, action, start_nanos, end_nanos: time_nanos, success, reason };
                match report.wrong() {
                    Some(wrong) => return Err(NotMade::Wrong(wrong)),
                    None => ImportContent::Traversal(report),
                }
            }
        };
        if let ImportContent::Value { state, .. }
        | ImportContent::Label { state, .. }
        | ImportContent::Position { state, .. } = &content
        {
            StateName::observed(state).map_err(|error| NotMade::Wrong(error.to_string()))?;
        }
        Ok(ImportItem { time_nanos, content })
    }
}

impl Sink for Reader {
    fn topic(&mut self, topic: &Topic) -> bool {
        self.converter.topic(topic)
    }

    fn message(&mut self, message: RecordedMessage<'_>, position: u64) -> Result<(), Stopped> {
        self.chunk.position = self.before + position;
        let Some(topic) = self.converter.topic_index(message.topic) else { return Ok(()) };
        for made in self.converter.convert(message.topic, message.recorded_nanos, message.data) {
            let item = made.and_then(|item| self.item(item));
            self.chunk.bytes += item.as_ref().map_or(0, bytes);
            self.chunk.items.push((topic, item));
        }
        if self.chunk.items.len() >= CHUNK_ITEMS || self.chunk.bytes >= CHUNK_BYTES { self.pass_on() } else { Ok(()) }
    }
}

/// Bytes of an observation, about.
fn bytes(item: &ImportItem) -> usize {
    match &item.content {
        ImportContent::Scan(Scan::Cloud(cloud)) => cloud.xyz_m.len() * 4,
        ImportContent::Scan(Scan::Ranges(ranges)) => ranges.ranges_m.len() * 4,
        ImportContent::Scan(Scan::Tiles(tiles) | Scan::Map { tiles, .. }) => tiles.len() * 144,
        _ => 64,
    }
}
