//! How often robots have reached places: a plane of cells of 50 cm, each with its last five attempts (RA-L, section
//! III.D).
//!
//! A place that no robot has tried has the prior, so that robots try it: RA-L drops places with a rate of 0 and does
//! not treat unknown places. Rates are not smoothed: five failures in a row are a rate of 0, and only a later success
//! changes it, from a robot that goes there for another reason.
//!
//! Invariant: the content is a function of the reports and their order of arrival, and its size is bounded by a number
//! of cells.

use std::collections::BTreeMap;

#[cfg(test)]
mod tests;

/// Length of a cell's edge, metres.
pub(crate) const REACHABILITY_CELL_M: f64 = 0.5;
/// Number of newest attempts that count for a cell.
pub(crate) const REACHABILITY_ATTEMPTS: u32 = 5;
/// Coordinates lie within ± this, metres.
pub(crate) const REACHABILITY_LIMIT_M: f64 = 1e7;

/// The position of a cell of 50 cm: x and y in cells from the origin of the map's frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ReachabilityCell {
    /// Index along x.
    pub x: i32,
    /// Index along y.
    pub y: i32,
}

impl ReachabilityCell {
    /// The cell that holds a point of the map's frame, metres.
    ///
    /// # Errors
    /// [`ReachabilityError::Place`] for a point that is not finite or too far away.
    pub fn at(x_m: f64, y_m: f64) -> Result<ReachabilityCell, ReachabilityError> {
        let limit = -REACHABILITY_LIMIT_M..=REACHABILITY_LIMIT_M;
        if !(limit.contains(&x_m) && limit.contains(&y_m)) {
            return Err(ReachabilityError::Place { x_m, y_m });
        }
        let along = |along_m: f64| (along_m / REACHABILITY_CELL_M).floor() as i32;
        Ok(ReachabilityCell { x: along(x_m), y: along(y_m) })
    }

    /// The centre of the cell in the map's frame, metres.
    #[must_use]
    pub fn centre_m(self) -> [f64; 2] {
        [self.x, self.y].map(|along| (f64::from(along) + 0.5) * REACHABILITY_CELL_M)
    }

    fn is_valid(self) -> bool {
        let limit = (REACHABILITY_LIMIT_M / REACHABILITY_CELL_M) as i32;
        [self.x, self.y].iter().all(|along| (-limit..=limit).contains(along))
    }
}

/// The last attempts to reach a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attempts {
    /// Number of attempts, 1 to 5.
    pub count: u8,
    /// Whether each attempt succeeded, with the newest in the lowest bit; no bit beyond `count` is set.
    pub reached: u8,
    /// Time of the newest attempt, by the attempts' own times, nanoseconds UTC.
    pub last_nanos: i64,
}

impl Attempts {
    /// Share of the attempts that succeeded.
    pub fn rate(&self) -> f64 {
        f64::from(self.reached.count_ones()) / f64::from(self.count.max(1))
    }

    fn is_valid(&self) -> bool {
        (1..=REACHABILITY_ATTEMPTS).contains(&u32::from(self.count)) && u32::from(self.reached) < 1 << self.count
    }
}

/// How probable it is to reach a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReachabilityRate {
    /// Share of the counted attempts that succeeded; the prior without attempts.
    pub rate: f64,
    /// Number of counted attempts, 0 to 5.
    pub attempts: u8,
}

/// Why a report or stored content is invalid.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ReachabilityError {
    /// The place is invalid.
    #[error("place ({x_m}, {y_m}) m: both must be finite and within ±{REACHABILITY_LIMIT_M} m")]
    Place {
        /// The x coordinate in the map's frame, metres.
        x_m: f64,
        /// The y coordinate in the map's frame, metres.
        y_m: f64,
    },
    /// The prior is not a probability.
    #[error("prior reachability {0}: it must be above 0 and at most 1, or no unknown place would ever be tried")]
    Prior(f64),
    /// There is no room for another cell.
    #[error("attempts are kept for {max} cells, and for no more")]
    TooManyCells {
        /// The maximum.
        max: usize,
    },
    /// The stored content of a cell is invalid.
    #[error("stored attempts of cell ({}, {}) are damaged: {} attempts with bits {:#b}", .cell.x, .cell.y, .attempts.count, .attempts.reached)]
    Damaged {
        /// The cell.
        cell: ReachabilityCell,
        /// The stored attempts.
        attempts: Attempts,
    },
    /// A cell was stored twice.
    #[error("cell ({}, {}) is stored twice", .0.x, .0.y)]
    Twice(ReachabilityCell),
}

/// How often robots have reached places.
#[derive(Clone, Debug, PartialEq)]
pub struct Reachability {
    prior: f64,
    max_cells: usize,
    cells: BTreeMap<ReachabilityCell, Attempts>,
}

impl Default for Reachability {
    /// No attempts, with a prior of 0.5 and room for a million cells.
    fn default() -> Reachability {
        Reachability { prior: 0.5, max_cells: 1_000_000, cells: BTreeMap::new() }
    }
}

impl Reachability {
    /// No attempts. `prior` is the rate of places without attempts, in (0, 1]; `max_cells` limits the cells kept.
    ///
    /// # Errors
    /// [`ReachabilityError::Prior`]
    pub fn new(prior: f64, max_cells: usize) -> Result<Reachability, ReachabilityError> {
        if !(prior > 0.0 && prior <= 1.0) {
            return Err(ReachabilityError::Prior(prior));
        }
        Ok(Reachability { prior, max_cells, cells: BTreeMap::new() })
    }

    /// This prior and limit with the result of [`Reachability::parts`], in any order, and nothing else.
    ///
    /// # Errors
    /// [`ReachabilityError`] where it cannot be such a result.
    pub fn with_parts(
        self,
        parts: impl IntoIterator<Item = (ReachabilityCell, Attempts)>,
    ) -> Result<Reachability, ReachabilityError> {
        Reachability::from_parts(self.prior, self.max_cells, parts)
    }

    /// Restores from the result of [`Reachability::parts`], in any order.
    ///
    /// # Errors
    /// [`ReachabilityError`] where it cannot be such a result.
    pub fn from_parts(
        prior: f64,
        max_cells: usize,
        parts: impl IntoIterator<Item = (ReachabilityCell, Attempts)>,
    ) -> Result<Reachability, ReachabilityError> {
        let mut whole = Reachability::new(prior, max_cells)?;
        for (cell, attempts) in parts {
            if !attempts.is_valid() || !cell.is_valid() {
                return Err(ReachabilityError::Damaged { cell, attempts });
            }
            if whole.cells.len() >= max_cells {
                return Err(ReachabilityError::TooManyCells { max: max_cells });
            }
            if whole.cells.insert(cell, attempts).is_some() {
                return Err(ReachabilityError::Twice(cell));
            }
        }
        Ok(whole)
    }

    /// Whether a report of a place can be applied.
    ///
    /// # Errors
    /// The errors of [`Reachability::report`].
    pub fn check(&self, x_m: f64, y_m: f64) -> Result<(), ReachabilityError> {
        let cell = ReachabilityCell::at(x_m, y_m)?;
        let has_room = self.cells.contains_key(&cell) || self.cells.len() < self.max_cells;
        if has_room { Ok(()) } else { Err(ReachabilityError::TooManyCells { max: self.max_cells }) }
    }

    /// Applies a report of whether a robot reached the place it was sent to, at a time in nanoseconds UTC. Attempts
    /// count in the order of their reports, whatever their times are.
    ///
    /// # Errors
    /// [`ReachabilityError::Place`]; [`ReachabilityError::TooManyCells`] for a new cell where there is no room.
    pub fn report(&mut self, x_m: f64, y_m: f64, reached: bool, utc_nanos: i64) -> Result<(), ReachabilityError> {
        let cell = ReachabilityCell::at(x_m, y_m)?;
        if let Some(known) = self.cells.get_mut(&cell) {
            let bits = (1_u8 << REACHABILITY_ATTEMPTS) - 1;
            known.reached = (known.reached << 1 | u8::from(reached)) & bits;
            known.count = (known.count + 1).min(REACHABILITY_ATTEMPTS as u8);
            known.last_nanos = known.last_nanos.max(utc_nanos);
            return Ok(());
        }
        if self.cells.len() >= self.max_cells {
            return Err(ReachabilityError::TooManyCells { max: self.max_cells });
        }
        self.cells.insert(cell, Attempts { count: 1, reached: u8::from(reached), last_nanos: utc_nanos });
        Ok(())
    }

    /// The probability of reaching a place in the map's frame, in metres; 0 for a place that is not finite or too far
    /// away.
    pub fn rate(&self, x_m: f64, y_m: f64) -> ReachabilityRate {
        let Ok(cell) = ReachabilityCell::at(x_m, y_m) else { return ReachabilityRate { rate: 0.0, attempts: 0 } };
        match self.cells.get(&cell) {
            Some(known) => ReachabilityRate { rate: known.rate(), attempts: known.count },
            None => ReachabilityRate { rate: self.prior, attempts: 0 },
        }
    }

    /// The rate of places without attempts.
    pub fn prior(&self) -> f64 {
        self.prior
    }

    /// Number of cells that were tried.
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// Whether nothing was ever tried.
    pub fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }

    /// The cells that were tried, ascending, for storage.
    pub fn parts(&self) -> impl Iterator<Item = (ReachabilityCell, Attempts)> {
        self.cells.iter().map(|(&cell, &attempts)| (cell, attempts))
    }
}
