//! The specification of a grid: choices made when the map is created, which never change afterwards.
//!
//! Invariant: a specification that [`GridSpec::check`] accepts keeps every cell of every valid tile at finite
//! coordinates.

use tidemap_model::{StateSensor, time::HALF_LIFE_MIN_NANOS};

use crate::index::{CellBox, CellIndex, TILE_EDGE, TILE_LIMIT};

/// Maximum length of a frame id in bytes.
pub(crate) const FRAME_BYTES_MAX: usize = 128;

/// The fixed properties of a map's occupancy grid.
#[derive(Clone, Debug, PartialEq)]
pub struct GridSpec {
    /// The name of the map's frame, for example `map`; data in another frame is refused.
    pub frame_id: String,
    /// Whether the grid has only the layer z = 0.
    pub is_flat: bool,
    /// Length of a cell's edge in metres, 0.001 to 1000.
    pub resolution_m: f64,
    /// Lower corner of cell (0, 0, 0) in the map's frame, metres.
    pub origin_m: [f64; 3],
    /// The cells that may exist; scans beyond them are ignored. `None`: the grid grows where it is observed.
    pub extent: Option<CellBox>,
    /// How reliable a reading is.
    pub sensor: SensorNoise,
    /// The time for which the exact readings are kept.
    pub retention: Retention,
    /// A reading this much older than the newest reading of its cell counts half in the nightly model; in nanoseconds,
    /// at least [`HALF_LIFE_MIN_NANOS`], counted in whole local days. `None`: all readings count alike.
    pub half_life_nanos: Option<i64>,
    /// The piece of evidence from which cells learn.
    pub evidence: Evidence,
}

/// A piece of evidence from which cells learn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Evidence {
    /// The readings of a bin of half an hour together (see [`crate::bins`]), as in all maps that are stored or sent.
    #[default]
    Bins,
    /// Each reading, as published (T-RO 2017, eq. 10 and 11), for research.
    Readings,
}

/// The time for which exact observations are kept. Models do not need them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Retention {
    /// Exact observations are not kept.
    #[default]
    None,
    /// Exact observations are kept for this long, in nanoseconds of the data's own time, at least 1.
    Duration(i64),
    /// Exact observations are kept for ever.
    Forever,
}

/// How reliable a reading is: a reading counts as the posterior P(occupied | reading) under a prior.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorNoise {
    /// P(reads occupied | is occupied), in (0, 1].
    pub hit: f64,
    /// P(reads occupied | is free), in [0, 1), below `hit`.
    pub false_alarm: f64,
    /// P(is occupied) before any reading, in (0, 1).
    pub prior: f64,
}

impl Default for SensorNoise {
    /// A sensor that is always right.
    fn default() -> SensorNoise {
        SensorNoise { hit: 1.0, false_alarm: 0.0, prior: 0.5 }
    }
}

impl SensorNoise {
    /// The values of a free and an occupied reading: P(occupied | reads free), P(occupied | reads occupied).
    pub fn levels(&self) -> (f64, f64) {
        let posterior = |if_occupied: f64, if_free: f64| {
            let occupied = if_occupied * self.prior;
            occupied / (occupied + if_free * (1.0 - self.prior))
        };
        (posterior(1.0 - self.hit, 1.0 - self.false_alarm), posterior(self.hit, self.false_alarm))
    }
}

/// Why a grid specification is invalid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum InvalidGrid {
    /// The frame id is empty, too long, or not printable.
    #[error("frame id {0:?}: it must have 1 to {FRAME_BYTES_MAX} printable characters")]
    Frame(String),
    /// The resolution is out of range.
    #[error("resolution {0} m: it must be between 0.001 and 1000")]
    Resolution(f64),
    /// The origin is too far away, or not a number.
    #[error("origin {0} m: it must be between -1e7 and 1e7")]
    Origin(f64),
    /// The extent is empty or too large.
    #[error("an extent of {}x{}x{} cells from ({}, {}, {}): it must contain at least one cell, within ±{} cells of the \
        origin{}",
        .0.size()[0], .0.size()[1], .0.size()[2], .0.min.x, .0.min.y, .0.min.z, TILE_LIMIT * TILE_EDGE,
        if *.1 { ", and the layer z = 0 alone" } else { "" })]
    Extent(CellBox, bool),
    /// The sensor's probabilities are inconsistent.
    #[error(
        "sensor noise hit {}, false alarm {}, prior {}: it must satisfy 0 <= false alarm < hit <= 1 and 0 < prior < 1",
        .0.hit, .0.false_alarm, .0.prior
    )]
    Sensor(SensorNoise),
    /// The retention is not positive.
    #[error("retention of {0} ns: it must be at least 1 ns")]
    Retention(i64),
    /// The half-life is too short.
    #[error("half-life of {0} ns: it must be at least 0.1 days (8640 s)")]
    HalfLife(i64),
}

impl GridSpec {
    /// A grid in frame `map`, in three dimensions and without an extent, with a sensor that is always right, without
    /// history.
    pub fn new(resolution_m: f64) -> GridSpec {
        GridSpec {
            frame_id: "map".to_owned(),
            is_flat: false,
            resolution_m,
            origin_m: [0.0; 3],
            extent: None,
            sensor: SensorNoise::default(),
            retention: Retention::None,
            half_life_nanos: None,
            evidence: Evidence::default(),
        }
    }

    /// Checks every field.
    ///
    /// # Errors
    /// [`InvalidGrid`] with the wrong value and the correct range.
    pub fn check(&self) -> Result<(), InvalidGrid> {
        let frame = &self.frame_id;
        if frame.is_empty() || frame.len() > FRAME_BYTES_MAX || frame.chars().any(|c| c.is_control()) {
            return Err(InvalidGrid::Frame(frame.chars().take(60).collect()));
        }
        if !(0.001..=1000.0).contains(&self.resolution_m) {
            return Err(InvalidGrid::Resolution(self.resolution_m));
        }
        if let Some(&origin) = self.origin_m.iter().find(|origin| !(-1e7..=1e7).contains(*origin)) {
            return Err(InvalidGrid::Origin(origin));
        }
        if let Some(extent) = self.extent {
            let flat = CellBox { min: CellIndex { z: 0, ..extent.min }, max: CellIndex { z: 1, ..extent.max } };
            let within = extent.intersection(&Self::limits());
            if extent.is_empty() || within != extent || (self.is_flat && flat != extent) {
                return Err(InvalidGrid::Extent(extent, self.is_flat));
            }
        }
        let SensorNoise { hit, false_alarm, prior } = self.sensor;
        let is_sensor = StateSensor::new(hit, false_alarm).is_ok();
        if !(is_sensor && prior > 0.0 && prior < 1.0) {
            return Err(InvalidGrid::Sensor(self.sensor));
        }
        match (self.retention, self.half_life_nanos) {
            (Retention::Duration(nanos), _) if nanos < 1 => Err(InvalidGrid::Retention(nanos)),
            (_, Some(nanos)) if nanos < HALF_LIFE_MIN_NANOS => Err(InvalidGrid::HalfLife(nanos)),
            _ => Ok(()),
        }
    }

    fn limits() -> CellBox {
        let limit = TILE_LIMIT * TILE_EDGE;
        CellBox { min: CellIndex { x: -limit, y: -limit, z: -limit }, max: CellIndex { x: limit, y: limit, z: limit } }
    }

    /// The cells that may exist.
    pub fn allowed(&self) -> CellBox {
        let mut allowed = self.extent.unwrap_or_else(Self::limits);
        if self.is_flat {
            (allowed.min.z, allowed.max.z) = (0, 1);
        }
        allowed
    }

    /// The cell that holds a point of the map's frame, in metres; `None` for a point that is not finite or beyond any
    /// cell.
    pub fn cell_at(&self, point_m: [f64; 3]) -> Option<CellIndex> {
        let limit = f64::from(TILE_LIMIT * TILE_EDGE);
        let mut index = [0; 3];
        for ((index, point), origin) in index.iter_mut().zip(point_m).zip(self.origin_m) {
            let cell = ((point - origin) / self.resolution_m).floor();
            if !(-limit..limit).contains(&cell) {
                return None;
            }
            *index = cell as i32;
        }
        Some(CellIndex { x: index[0], y: index[1], z: index[2] })
    }

    /// Lower corner of a cell in the map's frame, metres.
    pub fn corner_m(&self, cell: CellIndex) -> [f64; 3] {
        let along = |axis: usize, index: i32| self.origin_m[axis] + f64::from(index) * self.resolution_m;
        [along(0, cell.x), along(1, cell.y), along(2, cell.z)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec() -> GridSpec {
        GridSpec {
            frame_id: "map".to_owned(),
            is_flat: false,
            resolution_m: 0.1,
            origin_m: [-5.0, 0.0, 0.0],
            extent: None,
            sensor: SensorNoise::default(),
            retention: Retention::None,
            half_life_nanos: None,
            evidence: Evidence::default(),
        }
    }

    #[test]
    fn mistakes_name_the_value() {
        assert_eq!(spec().check(), Ok(()));
        let cube = |min, max| {
            Some(CellBox { min: CellIndex { x: min, y: min, z: min }, max: CellIndex { x: max, y: max, z: max } })
        };
        for (wrong, word) in [
            (GridSpec { frame_id: String::new(), ..spec() }, "frame"),
            (GridSpec { resolution_m: f64::NAN, ..spec() }, "NaN"),
            (GridSpec { resolution_m: 0.0, ..spec() }, "0.001"),
            (GridSpec { origin_m: [0.0, f64::INFINITY, 0.0], ..spec() }, "inf"),
            (GridSpec { extent: cube(3, 3), ..spec() }, "0x0x0"),
            (GridSpec { extent: cube(0, i32::MAX), ..spec() }, "within"),
            (GridSpec { extent: cube(0, 2), is_flat: true, ..spec() }, "z = 0"),
            (GridSpec { sensor: SensorNoise { hit: 0.3, false_alarm: 0.4, prior: 0.5 }, ..spec() }, "0.4"),
            (GridSpec { retention: Retention::Duration(0), ..spec() }, "at least 1"),
            (GridSpec { half_life_nanos: Some(HALF_LIFE_MIN_NANOS - 1), ..spec() }, "8639999999999 ns"),
            (GridSpec { half_life_nanos: Some(0), ..spec() }, "8640 s"),
        ] {
            let error = wrong.check().expect_err(word).to_string();
            assert!(error.contains(word), "{error}");
        }
    }

    #[test]
    fn points_lie_in_their_cells() {
        let spec = spec();
        assert_eq!(spec.cell_at([-5.0, 0.05, -0.05]), Some(CellIndex { x: 0, y: 0, z: -1 }));
        assert_eq!(spec.cell_at([f64::NAN, 0.0, 0.0]), None);
        assert_eq!(spec.cell_at([1e9, 0.0, 0.0]), None);
        assert_eq!(spec.corner_m(CellIndex { x: 10, y: 0, z: -1 }), [-4.0, 0.0, -0.1]);
    }

    #[test]
    fn a_perfect_sensor_has_levels_0_and_1() {
        assert_eq!(SensorNoise::default().levels(), (0.0, 1.0));
        let (free, occupied) = SensorNoise { hit: 0.9, false_alarm: 0.1, prior: 0.5 }.levels();
        assert!((free - 0.1).abs() < 1e-12 && (occupied - 0.9).abs() < 1e-12);
    }
}
