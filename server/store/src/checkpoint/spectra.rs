//! The sums of states that are not in memory: read from a checkpoint, or from a scratch file until the next one.
//!
//! A scratch file has no name once it is open, so that nothing of it is left after a crash. Invariant: sums are used
//! only if their checksum is valid.

use std::{
    fmt, io,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use prost::Message as _;
use tidemap_layout::{file::RecordKind, map as layout};
use tidemap_map::{
    snapshot::StateSnapshot,
    update::{SpectrumRoom, SpectrumSpill},
};
use tidemap_model::SpectrumSource;

use super::{Checkpoints, NEW_SUFFIX};
use crate::{
    disk::{Disk, DiskFile, DiskReader},
    record::doubles,
    record_file::anywhere,
};

/// Length of the checksum behind sums in a scratch file.
const CRC_LENGTH: usize = 4;

/// The states of one checkpoint; a place is the offset of a state's record.
pub(crate) struct CheckpointSpectra {
    file: Box<dyn DiskReader>,
    path: PathBuf,
}

impl fmt::Debug for CheckpointSpectra {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("CheckpointSpectra").field("path", &self.path).finish_non_exhaustive()
    }
}

impl SpectrumSource for CheckpointSpectra {
    fn read(&self, place: u64) -> Result<Vec<[f64; 4]>, String> {
        let spectrum = || {
            let (payload, _) = anywhere::raw(&*self.file, RecordKind::State, place)?;
            let message = layout::State::decode(&payload[..]).map_err(|_| "a state is not a message".to_owned())?;
            numbers(&message.spectrum)
        };
        spectrum().map_err(|reason| format!("{} is damaged or not readable: {reason}", self.path.display()))
    }
}

fn numbers(bytes: &[u8]) -> Result<Vec<[f64; 4]>, String> {
    let mut numbers = Vec::with_capacity(bytes.len() / 8);
    doubles::take(bytes, &mut numbers);
    match numbers.as_chunks::<4>() {
        (spectrum, []) if bytes.len().is_multiple_of(8) => Ok(spectrum.to_vec()),
        _ => Err("a spectrum does not have its length".to_owned()),
    }
}

/// The places of the states in the file of a checkpoint.
pub(crate) struct StatePlaces {
    pub(crate) source: Arc<dyn SpectrumSource>,
    /// The offsets by the number of the state.
    pub(crate) offsets: Vec<u64>,
}

impl StatePlaces {
    /// Leaves at most `bytes_max` of the sums of these states in memory; all others are read from here from now on.
    pub(crate) fn follow(&self, states: &[StateSnapshot], bytes_max: u64) {
        let mut bytes = 0;
        for (state, &offset) in states.iter().zip(&self.offsets) {
            let Some(cell) = state.model.accumulator().cell() else { continue };
            let here = cell.bytes() as u64;
            if here > 0 && bytes + here <= bytes_max {
                bytes += here;
            } else {
                cell.move_to(&self.source, offset);
            }
        }
    }
}

impl Checkpoints<'_> {
    /// The sums of the states of a checkpoint, in a file that stays open.
    pub(super) fn spectra(&self, path: &Path) -> io::Result<Arc<dyn SpectrumSource>> {
        let file = self.disk.read_anywhere(path)?;
        let is_new = path.extension().is_some_and(|extension| extension == "new");
        let path = if is_new { path.with_extension("") } else { path.to_owned() };
        Ok(Arc::new(CheckpointSpectra { file, path }))
    }
}

/// Memory for the sums of the states of a map, with a scratch file in a folder for others.
pub(crate) fn room(disk: Arc<dyn Disk>, folder: &Path, bytes_max: u64) -> SpectrumRoom {
    let path = folder.join(format!("spectra{NEW_SUFFIX}"));
    SpectrumRoom { bytes_max, spill: Arc::new(Scratch { disk, path, opened: Mutex::new(Opened::NotYet) }) }
}

/// A scratch file that is created when it is needed.
struct Scratch {
    disk: Arc<dyn Disk>,
    path: PathBuf,
    opened: Mutex<Opened>,
}

enum Opened {
    NotYet,
    Here {
        file: Box<dyn DiskFile>,
        length: u64,
        reader: Arc<ScratchReader>,
    },
    /// After an error nothing more is written.
    Failed,
}

struct ScratchReader(Box<dyn DiskReader>);

impl fmt::Debug for Scratch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Scratch").field("path", &self.path).finish_non_exhaustive()
    }
}

impl fmt::Debug for ScratchReader {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ScratchReader").finish_non_exhaustive()
    }
}

impl Scratch {
    fn open(&self) -> io::Result<Opened> {
        let file = self.disk.create(&self.path)?;
        let reader = self.disk.read_anywhere(&self.path);
        // From here on the file has no name.
        self.disk.remove(&self.path)?;
        Ok(Opened::Here { file, length: 0, reader: Arc::new(ScratchReader(reader?)) })
    }

    /// Gives the offset; it is followed by the length of the sums, the sums, and their checksum.
    fn append(&self, opened: &mut Opened, payload: &[u8]) -> io::Result<(Arc<dyn SpectrumSource>, u64)> {
        if matches!(opened, Opened::NotYet) {
            *opened = self.open()?;
        }
        let Opened::Here { file, length, reader } = opened else { return Err(io::ErrorKind::Other.into()) };
        let mut bytes = Vec::with_capacity(payload.len() + 2 * CRC_LENGTH);
        bytes.extend_from_slice(&(payload.len() as u32).to_le_bytes());
        bytes.extend_from_slice(payload);
        bytes.extend_from_slice(&crc32c::crc32c(payload).to_le_bytes());
        file.append(&bytes)?;
        let place = *length;
        *length += bytes.len() as u64;
        Ok((Arc::clone(reader) as Arc<dyn SpectrumSource>, place))
    }
}

impl SpectrumSpill for Scratch {
    fn write(&self, spectrum: &[[f64; 4]]) -> Option<(Arc<dyn SpectrumSource>, u64)> {
        let mut payload = Vec::with_capacity(size_of_val(spectrum));
        doubles::push(&mut payload, spectrum.as_flattened());
        let mut opened = self.opened.lock().unwrap_or_else(PoisonError::into_inner);
        if matches!(*opened, Opened::Failed) {
            return None;
        }
        let written = self.append(&mut opened, &payload);
        written
            .inspect_err(|error| {
                tracing::warn!(file = %self.path.display(), %error, "sums of states stay in memory");
                *opened = Opened::Failed;
            })
            .ok()
    }
}

impl SpectrumSource for ScratchReader {
    fn read(&self, place: u64) -> Result<Vec<[f64; 4]>, String> {
        let unreadable = |error: io::Error| format!("a scratch file is not readable: {error}");
        let mut length = [0; 4];
        self.0.read_exact_at(&mut length, place).map_err(unreadable)?;
        // A length is that of at most 2,048 periodicities; a damaged one is found at the end of the file or below.
        let mut payload = vec![0; (u32::from_le_bytes(length) as usize).min(1 << 20)];
        let mut crc = [0; CRC_LENGTH];
        self.0.read_exact_at(&mut payload, place + 4).map_err(unreadable)?;
        self.0.read_exact_at(&mut crc, place + 4 + payload.len() as u64).map_err(unreadable)?;
        if crc32c::crc32c(&payload) != u32::from_le_bytes(crc) {
            return Err("a scratch file is damaged".to_owned());
        }
        numbers(&payload)
    }
}
