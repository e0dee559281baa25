//! Memory for the sums of states while an update runs, and the place for sums that have no room in it.
//!
//! Invariant: the place of sums does not change their values.

use std::{
    fmt,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use tidemap_model::{SpectrumSource, StateModel};

/// A place outside of memory that takes sums.
pub trait SpectrumSpill: fmt::Debug + Send + Sync {
    /// Writes sums. They are read from the returned place as long as its source is held. `None` if they cannot be
    /// written: then they stay in memory.
    fn write(&self, spectrum: &[[f64; 4]]) -> Option<(Arc<dyn SpectrumSource>, u64)>;
}

/// Memory for sums over periodicities, and the place for other sums.
#[derive(Clone, Debug)]
pub struct SpectrumRoom {
    /// Maximum number of bytes of sums in memory, including the sums of the generation in force.
    pub bytes_max: u64,
    /// The place for other sums.
    pub spill: Arc<dyn SpectrumSpill>,
}

/// The memory that a running update uses.
pub(super) struct RoomInUse {
    room: Option<SpectrumRoom>,
    bytes: AtomicU64,
}

impl RoomInUse {
    /// Begins with the memory of the models of the generation in force.
    pub(super) fn new(room: Option<SpectrumRoom>, models: &[Arc<StateModel>]) -> RoomInUse {
        let room_bytes = |model: &Arc<StateModel>| model.accumulator().cell().map_or(0, |cell| cell.bytes() as u64);
        let bytes = if room.is_some() { models.iter().map(room_bytes).sum() } else { 0 };
        RoomInUse { room, bytes: AtomicU64::new(bytes) }
    }

    /// Subtracts the sums of a model that was taken in and is about to be replaced.
    pub(super) fn let_go(&self, model: &StateModel) {
        if let (Some(_), Some(cell)) = (&self.room, model.accumulator().cell()) {
            self.bytes.fetch_sub(cell.bytes() as u64, Ordering::Relaxed);
        }
    }

    /// Moves the sums of a new model out of memory if there is no room for them.
    pub(super) fn take_in(&self, model: &StateModel) {
        let (Some(room), Some(cell)) = (&self.room, model.accumulator().cell()) else { return };
        let bytes = cell.bytes() as u64;
        if self.bytes.fetch_add(bytes, Ordering::Relaxed).saturating_add(bytes) <= room.bytes_max {
            return;
        }
        if let Ok(spectrum) = cell.read()
            && let Some((source, place)) = room.spill.write(&spectrum)
        {
            cell.move_to(&source, place);
            self.bytes.fetch_sub(bytes, Ordering::Relaxed);
        }
    }
}
