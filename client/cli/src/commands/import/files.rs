//! The files of a recording: found, opened and read one after the other.
//!
//! Invariant: files are read in the order in which they are named; files of a folder of rosbag2 in the order of its
//! `metadata.yaml`. An error names the file.

use std::{
    fs::{self, File},
    io::{BufReader, Read as _},
    path::{Path, PathBuf},
};

use anyhow::Context as _;
use tidemap_recordings::{
    folder::{Folder, METADATA_BYTES_MAX, METADATA_NAME, ZSTD_ENDING, renamed},
    kind::{self, DETECT_BYTES},
    plan::Wishes,
    recording::{Ending, FileKind, RecordedMessage, RecordingError, Sink, Stopped, Topic},
    rosbag2::LOG_ENDING,
    survey::{Survey, Surveyed},
    zstd_stream::ZstdStream,
};

use crate::{
    commands::{shell_word::quoted, usage},
    progress::{Bar, status_line},
};

const BUFFER_BYTES: usize = 256 * 1024;

/// A file of a recording.
#[derive(Clone, Debug)]
pub(super) struct RecordedFile {
    path: PathBuf,
    kind: FileKind,
    /// Whether the file is compressed as a whole.
    is_packed: bool,
    bytes: u64,
}

/// The files of the recordings of a command, in their order.
#[derive(Clone, Debug)]
pub(super) struct Recording {
    files: Vec<RecordedFile>,
}

impl Recording {
    /// Finds the files, and what each is.
    pub(super) fn open(paths: &[PathBuf]) -> anyhow::Result<Self> {
        let mut files = Vec::new();
        for path in paths {
            if path.is_dir() {
                for file in of_folder(path)? {
                    files.push(RecordedFile::open(&file)?);
                }
            } else {
                files.push(RecordedFile::open(path)?);
            }
        }
        Ok(Self { files })
    }

    /// Number of bytes of all files.
    pub(super) fn bytes(&self) -> u64 {
        self.files.iter().map(|file| file.bytes).sum()
    }

    /// The files, each with the number of bytes of those before it.
    pub(super) fn files(&self) -> impl Iterator<Item = (&RecordedFile, u64)> {
        self.files.iter().scan(0, |before, file| {
            let start = *before;
            *before += file.bytes;
            Some((file, start))
        })
    }
}

impl RecordedFile {
    fn open(path: &Path) -> anyhow::Result<Self> {
        let shown = path.display().to_string();
        let open = || -> anyhow::Result<Self> {
            let mut file = File::open(path)?;
            let bytes = file.metadata()?.len();
            let is_packed = shown.ends_with(ZSTD_ENDING) || shown.ends_with(".zst");
            let mut start = Vec::new();
            if is_packed {
                ZstdStream::new(BufReader::new(&mut file)).take(DETECT_BYTES as u64).read_to_end(&mut start)?;
            } else {
                (&mut file).take(DETECT_BYTES as u64).read_to_end(&mut start)?;
            }
            let kind = FileKind::detect(&start)?;
            let log = PathBuf::from(format!("{shown}{LOG_ENDING}"));
            if kind == FileKind::Sqlite && fs::metadata(&log).is_ok_and(|log| log.len() > 0) {
                status_line(&format!(
                    "{shown}: the newest messages are not in this file yet, but in {} beside it, and are left out: \
                     close the recorder, or run sqlite3 {} 'PRAGMA wal_checkpoint(TRUNCATE)'",
                    log.display(),
                    quoted(&shown)
                ));
            }
            Ok(Self { path: path.to_path_buf(), kind, is_packed, bytes })
        };
        open().with_context(|| shown.clone())
    }

    /// Name of the file, for messages.
    pub(super) fn shown(&self) -> String {
        self.path.display().to_string()
    }

    /// Reads the file. If a file is damaged after its first message, the messages before the damage are read.
    pub(super) fn read(&self, sink: &mut dyn Sink) -> Result<Ending, RecordingError> {
        let file = BufReader::with_capacity(BUFFER_BYTES, File::open(&self.path)?);
        let mut counting = Counting { sink, messages: 0 };
        let read = if self.is_packed {
            kind::read_stream(self.kind, ZstdStream::new(file), &mut counting)
        } else {
            kind::read(self.kind, file, &mut counting)
        };
        match read {
            Err(RecordingError::Broken(how)) if counting.messages > 0 => {
                Ok(Ending::CutOff(format!("the file is damaged: {how}")))
            }
            read => read,
        }
    }
}

/// Counts the messages that pass through.
struct Counting<'a> {
    sink: &'a mut dyn Sink,
    messages: u64,
}

impl Sink for Counting<'_> {
    fn topic(&mut self, topic: &Topic) -> bool {
        self.sink.topic(topic)
    }

    fn message(&mut self, message: RecordedMessage<'_>, position: u64) -> Result<(), Stopped> {
        self.messages += 1;
        self.sink.message(message, position)
    }

    fn passed_over(&mut self, why: &RecordingError) {
        self.sink.passed_over(why);
    }
}

/// The files of a folder of rosbag2.
fn of_folder(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let metadata = folder.join(METADATA_NAME);
    let shown = || metadata.display().to_string();
    if !metadata.exists() {
        return Err(usage(format!(
            "{}: the folder has no {METADATA_NAME}, so it is no recording of rosbag2: name the files in it",
            folder.display()
        )));
    }
    let mut text = String::new();
    let file = File::open(&metadata).with_context(shown)?;
    file.take(METADATA_BYTES_MAX as u64 + 1).read_to_string(&mut text).with_context(shown)?;
    let read = Folder::parse(&text).with_context(shown)?;
    let present: Vec<String> = fs::read_dir(folder)
        .with_context(|| folder.display().to_string())?
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .collect();
    let (files, renamed) = renamed(read.files, &present).with_context(shown)?;
    for (before, now) in renamed {
        status_line(&format!("{}: {METADATA_NAME} lists {before}, which is missing; {now} is taken", folder.display()));
    }
    Ok(files.into_iter().map(|name| folder.join(name)).collect())
}

/// Reads the files once, to find their contents.
pub(super) fn survey(recording: &Recording, wishes: &Wishes, bar: &Bar) -> anyhow::Result<Surveyed> {
    let mut survey = Survey::without_transforms_of(&wishes.mapping.skip);
    if let Some(source) = wishes.pose_source() {
        survey.take_poses(source.clone());
    }
    surveyed(recording, bar, &mut survey, true)?;
    if survey.has_too_many_transforms() {
        survey.again_with_sensors(wishes.frame.as_deref());
        surveyed(recording, bar, &mut survey, false)?;
    }
    let mut surveyed = survey.finish();
    surveyed.frames.set_gap(wishes.gap_nanos());
    Ok(surveyed)
}

fn surveyed(recording: &Recording, bar: &Bar, survey: &mut Survey, is_first: bool) -> anyhow::Result<()> {
    for (file, before) in recording.files() {
        survey.next_file();
        let watched = bar.clone();
        survey.watch(move |position| watched.set(before + position));
        let messages = survey.messages();
        if let Ending::CutOff(how) = file.read(survey).with_context(|| file.shown())?
            && is_first
        {
            let taken =
                if survey.messages() > messages { "the part before is taken" } else { "it has no message before that" };
            bar.status_line(&format!("{}: {how}; {taken}", file.shown()));
        }
    }
    Ok(())
}
