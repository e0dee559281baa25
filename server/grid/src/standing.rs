//! Heights of sensors in a flat grid: a sensor frees only the cells that it has read as occupied itself.
//!
//! A scanner at two metres passes over a table that a scanner below sees. So the sources of scans are kept apart: a
//! cell is occupied if one of them reads it as occupied, and free only if none of them last read it as occupied.
//!
//! Invariant: the sources ascend, and each has a cell. One source alone never hides its own readings.

use crate::{
    mask::{Mask, TileMasks},
    scan::ScanSource,
};

/// The cells of a tile that each source of scans last read as occupied.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Standing {
    of_sources: Vec<(ScanSource, Mask)>,
}

/// The sources do not ascend, or one has no cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the sources of a tile do not ascend, or one has no cell")]
pub struct InvalidStanding;

impl Standing {
    /// Restores the cells of each source.
    ///
    /// # Errors
    /// [`InvalidStanding`] where the sources do not ascend, or one has no cell.
    pub fn from_sources(of_sources: Vec<(ScanSource, Mask)>) -> Result<Standing, InvalidStanding> {
        let ascends = of_sources.is_sorted_by(|(one, _), (next, _)| one < next);
        let has_cells = of_sources.iter().all(|(_, cells)| !cells.is_empty());
        if ascends && has_cells { Ok(Standing { of_sources }) } else { Err(InvalidStanding) }
    }

    /// The cells of each source.
    pub fn sources(&self) -> &[(ScanSource, Mask)] {
        &self.of_sources
    }

    /// Memory in bytes beyond its own size, about.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(self.of_sources.as_slice())
    }

    /// The masks of the tile after the readings of some sources at one time. A free cell that another source last read
    /// as occupied counts as not observed.
    pub(crate) fn read(&mut self, readings: &[(ScanSource, TileMasks)]) -> TileMasks {
        let (mut observed, mut occupied) = (Mask::EMPTY, Mask::EMPTY);
        for &(source, masks) in readings {
            observed |= masks.observed();
            occupied |= masks.occupied();
            match self.of_sources.binary_search_by_key(&source, |(source, _)| *source) {
                Ok(at) => {
                    let cells = &mut self.of_sources[at].1;
                    *cells = cells.without(masks.observed()) | masks.occupied();
                }
                Err(at) => self.of_sources.insert(at, (source, masks.occupied())),
            }
        }
        self.of_sources.retain(|(_, cells)| !cells.is_empty());
        let standing = self.of_sources.iter().fold(Mask::EMPTY, |all, (_, cells)| all | *cells);
        TileMasks::clipped(observed.without(standing.without(occupied)), occupied)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOW: ScanSource = ScanSource::Rays { height: 1 };
    const HIGH: ScanSource = ScanSource::Rays { height: 8 };

    fn masks(observed: u64, occupied: u64) -> TileMasks {
        let layer = |bits| Mask([bits, 0, 0, 0, 0, 0, 0, 0]);
        TileMasks::clipped(layer(observed), layer(occupied))
    }

    #[test]
    fn a_sensor_frees_only_its_own_height() {
        let mut tile = Standing::default();
        // Both see cell 0, the lower sensor alone sees a table in cell 1, and cell 2 is free.
        assert_eq!(tile.read(&[(LOW, masks(7, 3)), (HIGH, masks(7, 1))]), masks(7, 3));
        // The upper sensor passes above the table and states nothing about it.
        assert_eq!(tile.read(&[(HIGH, masks(7, 1))]), masks(5, 1));
        assert_eq!(tile.read(&[(HIGH, masks(7, 0))]), masks(4, 0));
        // The lower sensor sees that the table is gone.
        assert_eq!(tile.read(&[(LOW, masks(7, 0)), (HIGH, masks(6, 0))]), masks(7, 0));
        assert_eq!(tile, Standing::default());
    }

    #[test]
    fn one_sensor_alone_is_read_as_it_is() {
        let mut tile = Standing::default();
        for read in [masks(7, 5), masks(6, 2), masks(7, 0), masks(1, 1)] {
            assert_eq!(tile.read(&[(LOW, read)]), read);
        }
    }

    #[test]
    fn invalid_sources_are_refused() {
        let cell = Mask::of(3);
        assert!(Standing::from_sources(vec![(LOW, cell), (HIGH, cell)]).is_ok());
        for wrong in [vec![(HIGH, cell), (LOW, cell)], vec![(LOW, cell), (LOW, cell)], vec![(LOW, Mask::EMPTY)]] {
            assert_eq!(Standing::from_sources(wrong), Err(InvalidStanding));
        }
    }
}
