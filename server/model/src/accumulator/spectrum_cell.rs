//! The sums A_k and B_k of a state between updates: in memory, or in the file where they were saved.
//!
//! Invariant: the content of a cell never changes, only the place where it is stored; all clones of a model share its
//! cell. Predictions do not need the sums, so readers never wait here.

use std::{
    fmt,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

/// A place outside of memory where sums are stored.
pub trait SpectrumSource: fmt::Debug + Send + Sync {
    /// Reads the sums at a place: `[re A_k, im A_k, re B_k, im B_k]` per periodicity.
    ///
    /// # Errors
    /// Returns the reason if they cannot be read.
    fn read(&self, place: u64) -> Result<Vec<[f64; 4]>, String>;
}

#[derive(Debug)]
enum Held {
    Here(Box<[[f64; 4]]>),
    There(Arc<dyn SpectrumSource>, u64),
}

/// The sums of a state, wherever they are stored. Clones are the same cell.
#[derive(Clone, Debug)]
pub struct SpectrumCell(Arc<Mutex<Held>>);

impl SpectrumCell {
    pub(super) fn new(spectrum: Vec<[f64; 4]>) -> SpectrumCell {
        SpectrumCell(Arc::new(Mutex::new(Held::Here(spectrum.into()))))
    }

    fn held(&self) -> MutexGuard<'_, Held> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the sums.
    ///
    /// # Errors
    /// Returns the reason if they cannot be read from the place where they are stored.
    pub fn read(&self) -> Result<Vec<[f64; 4]>, String> {
        let (source, place) = match &*self.held() {
            Held::Here(spectrum) => return Ok(spectrum.to_vec()),
            Held::There(source, place) => (Arc::clone(source), *place),
        };
        source.read(place)
    }

    /// Bytes in memory; 0 if the sums are stored elsewhere.
    pub fn bytes(&self) -> usize {
        match &*self.held() {
            Held::Here(spectrum) => size_of_val(&**spectrum),
            Held::There(..) => 0,
        }
    }

    /// Frees the memory: from now on the sums are read from `place`, which must contain equal sums.
    pub fn move_to(&self, source: &Arc<dyn SpectrumSource>, place: u64) {
        *self.held() = Held::There(Arc::clone(source), place);
    }
}
