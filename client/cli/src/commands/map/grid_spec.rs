//! A grid on the command line: `resolution=0.1,origin=-5:-5:0,size=100x80x20,frame=map`.
//!
//! Invariant: the daemon chooses omitted values; an error names the invalid part and the correct form.

use std::{fmt::Write as _, str::FromStr};

use tidemap_client::maps::{CellBox, CellIndex, GridSpec, Retention, SensorNoise};
use tidemap_model::time::{format_duration, parse_duration};

/// A grid, parsed from the command line.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct GridArg(pub(crate) GridSpec);

/// An invalid grid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum InvalidGridSpec {
    #[error(
        "{0:?}: a grid has resolution=M, flat, origin=X:Y:Z, size=NXxNYxNZ or min=X:Y:Z and max=X:Y:Z, frame=NAME, \
         hit=P, false-alarm=P and prior=P, with commas between"
    )]
    Unknown(String),
    #[error("{0} is given twice")]
    Twice(&'static str),
    #[error("resolution is missing: give the edge of a cell in metres, such as resolution=0.1")]
    NoResolution,
    #[error("{key}={value}: {right}")]
    Value { key: &'static str, value: String, right: &'static str },
    #[error("{0}")]
    Together(&'static str),
}

const RESOLUTION: &str = "has to be the edge of a cell in metres, above 0, such as 0.1";
const METRES: &str = "has to be metres, as X:Y:Z such as -5:-5:0";
const CELLS: &str = "has to be whole cells, as X:Y:Z such as -50:-50:0";
const SIZE: &str = "has to be cells along each axis, such as 100x80x20, or 100x80 for a flat grid";
const PROBABILITY: &str = "has to be a number from 0 to 1";
const KEYS: [&str; 10] = ["resolution", "flat", "origin", "size", "min", "max", "frame", "hit", "false-alarm", "prior"];

impl FromStr for GridArg {
    type Err = InvalidGridSpec;

    fn from_str(text: &str) -> Result<Self, InvalidGridSpec> {
        let mut values: [Option<&str>; KEYS.len()] = [None; KEYS.len()];
        for part in text.split(',') {
            let (name, value) = part.split_once('=').unwrap_or((part, ""));
            let at = KEYS.iter().position(|key| *key == name.trim());
            let at = at.filter(|&at| part.contains('=') != (KEYS[at] == "flat"));
            let at = at.ok_or_else(|| InvalidGridSpec::Unknown(part.to_owned()))?;
            if values[at].replace(value.trim()).is_some() {
                return Err(InvalidGridSpec::Twice(KEYS[at]));
            }
        }
        let [resolution, flat, origin, size, min, max, frame, hit, false_alarm, prior] = values;
        let resolution = resolution.ok_or(InvalidGridSpec::NoResolution)?;
        let number = |key, text: &str, right| text.parse::<f64>().map_err(|_| wrong(key, text, right));
        let resolution_m = number("resolution", resolution, RESOLUTION)?;
        if !(resolution_m > 0.0 && resolution_m.is_finite()) {
            return Err(wrong("resolution", resolution, RESOLUTION));
        }
        let is_flat = flat.is_some();
        let origin_m = origin.map_or(Ok([0.0; 3]), |text| triple("origin", text, ':', 0.0, METRES))?;
        let probability =
            |key, text: Option<&str>, usual| text.map_or(Ok(usual), |text| number(key, text, PROBABILITY));
        let sensor = (hit.is_some() || false_alarm.is_some() || prior.is_some()).then(|| {
            Ok(SensorNoise {
                hit: probability("hit", hit, 1.0)?,
                false_alarm: probability("false-alarm", false_alarm, 0.0)?,
                prior: probability("prior", prior, 0.5)?,
            })
        });
        let sensor: Option<SensorNoise> = sensor.transpose()?;
        if let Some(SensorNoise { hit, false_alarm, prior }) = sensor {
            if !((0.0..1.0).contains(&false_alarm) && hit > false_alarm && hit <= 1.0) {
                return Err(InvalidGridSpec::Together("hit has to be above false-alarm, both within 0 and 1"));
            }
            if !(prior > 0.0 && prior < 1.0) {
                return Err(InvalidGridSpec::Together("prior has to be above 0 and below 1"));
            }
        }
        let mut grid = GridSpec::new(resolution_m);
        if let Some(frame) = frame {
            grid.frame_id = frame.to_owned();
        }
        let extent = extent(size, min, max, is_flat)?;
        Ok(Self(GridSpec { is_flat, origin_m, extent, sensor: sensor.unwrap_or_default(), ..grid }))
    }
}

fn wrong(key: &'static str, value: &str, right: &'static str) -> InvalidGridSpec {
    InvalidGridSpec::Value { key, value: value.to_owned(), right }
}

/// Two or three numbers; the default of the third is `usual`.
fn triple<T: FromStr + Copy>(
    key: &'static str,
    text: &str,
    separator: char,
    usual: T,
    right: &'static str,
) -> Result<[T; 3], InvalidGridSpec> {
    let parts = text.split(separator).map(str::parse::<T>).collect::<Result<Vec<T>, _>>();
    match parts.as_deref() {
        Ok(&[x, y, z]) => Ok([x, y, z]),
        Ok(&[x, y]) => Ok([x, y, usual]),
        _ => Err(wrong(key, text, right)),
    }
}

fn extent(
    size: Option<&str>,
    min: Option<&str>,
    max: Option<&str>,
    is_flat: bool,
) -> Result<Option<CellBox>, InvalidGridSpec> {
    if !is_flat && size.is_some_and(|size| size.split('x').count() == 2) {
        return Err(wrong("size", size.unwrap_or_default(), SIZE));
    }
    match (size, min, max) {
        (None, None, None) => Ok(None),
        (Some(size), None, None) => {
            let cells = CellBox { min: [0; 3].into(), max: triple("size", size, 'x', 1, SIZE)?.into() };
            if cells.is_empty() {
                return Err(wrong("size", size, "has to be at least 1 along each axis"));
            }
            Ok(Some(cells))
        }
        (None, Some(min), Some(max)) => {
            let [min, max] = [triple("min", min, ':', 0, CELLS)?, triple("max", max, ':', 1, CELLS)?];
            let cells = CellBox { min: min.into(), max: max.into() };
            let unordered = InvalidGridSpec::Together("max has to be above min along each axis, and is not included");
            if cells.is_empty() { Err(unordered) } else { Ok(Some(cells)) }
        }
        (Some(_), ..) => Err(InvalidGridSpec::Together("give either size, or min and max, not both")),
        _ => Err(InvalidGridSpec::Together("min and max go together: give both, in cells")),
    }
}

/// A grid in the notation of the command line.
pub(crate) fn spec_text(grid: &GridSpec) -> String {
    let triple = |[x, y, z]: [f64; 3]| format!("{x}:{y}:{z}");
    let cells = |CellIndex { x, y, z }| format!("{x}:{y}:{z}");
    let mut text = format!("resolution={}", grid.resolution_m);
    // Writing to a String cannot fail.
    if grid.is_flat {
        let _ = write!(text, ",flat");
    }
    if grid.origin_m != [0.0; 3] {
        let _ = write!(text, ",origin={}", triple(grid.origin_m));
    }
    if let Some(CellBox { min, max }) = grid.extent {
        let _ = write!(text, ",min={},max={}", cells(min), cells(max));
    }
    if !grid.frame_id.is_empty() {
        let _ = write!(text, ",frame={}", grid.frame_id);
    }
    let SensorNoise { hit, false_alarm, prior } = grid.sensor;
    if hit < 1.0 || false_alarm > 0.0 {
        let _ = write!(text, ",hit={hit},false-alarm={false_alarm},prior={prior}");
    }
    text
}

/// A box of cells, as `X0:X1,Y0:Y1,Z0:Z1`; the ends are not included.
pub(crate) fn box_text(cells: &CellBox) -> String {
    let CellBox { min, max } = cells;
    format!("{}:{},{}:{},{}:{}", min.x, max.x, min.y, max.y, min.z, max.z)
}

/// A retention: `none`, `forever` or a duration.
pub fn retention(text: &str) -> Result<Retention, String> {
    match text {
        "none" => Ok(Retention::None),
        "forever" => Ok(Retention::Forever),
        _ => parse_duration(text)
            .map(Retention::Duration)
            .map_err(|_| format!("{text:?} is not a retention: use none, forever or a duration such as 90d")),
    }
}

/// A retention in the notation of [`retention`].
pub(crate) fn retention_text(retention: Retention) -> String {
    match retention {
        Retention::None => "none".to_owned(),
        Retention::Duration(nanos) => format_duration(nanos),
        Retention::Forever => "forever".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> Result<GridSpec, String> {
        text.parse::<GridArg>().map(|spec| spec.0).map_err(|error| error.to_string())
    }

    #[test]
    fn a_grid_is_shown_as_it_was_given() -> Result<(), String> {
        for text in [
            "resolution=0.1,frame=map",
            "resolution=0.05,flat,origin=-1.5:2:0,min=-8:0:0,max=8:5:1,frame=odom",
            "resolution=0.1,frame=map,hit=0.9,false-alarm=0.1,prior=0.5",
        ] {
            assert_eq!(spec_text(&parsed(text)?), text);
        }
        assert_eq!(
            parsed("resolution=1,size=3x4x5")?.extent,
            Some(CellBox { min: [0; 3].into(), max: [3, 4, 5].into() })
        );
        let flat = parsed("flat,resolution=1,min=-3:-4,max=3:4,origin=1:2")?;
        assert_eq!(flat.extent, Some(CellBox { min: [-3, -4, 0].into(), max: [3, 4, 1].into() }));
        assert_eq!(flat.origin_m, [1.0, 2.0, 0.0]);
        let noise = parsed("resolution=1,hit=0.9")?.sensor;
        assert_eq!(noise, SensorNoise { hit: 0.9, false_alarm: 0.0, prior: 0.5 });
        Ok(())
    }

    #[test]
    fn a_mistake_names_the_part() {
        for (text, words) in [
            ("flat", "resolution is missing"),
            ("resolution=wide", "resolution=wide"),
            ("resolution=1,resolution=2", "resolution is given twice"),
            ("resolution=1,colour=red", "\"colour=red\""),
            ("resolution=1,flat=yes", "\"flat=yes\""),
            ("resolution", "\"resolution\""),
            ("resolution=1,origin=5", "origin=5: has to be metres"),
            ("resolution=1,size=5x5", "size=5x5: has to be cells"),
            ("resolution=1,size=5x5x5,min=0:0:0,max=1:1:1", "either size, or min and max"),
            ("resolution=1,min=0:0:0", "min and max go together"),
            ("resolution=1,hit=often", "hit=often"),
            ("resolution=0", "resolution=0: has to be the edge of a cell in metres, above 0"),
            ("resolution=nan", "resolution=nan"),
            ("resolution=1,size=0x1x1", "size=0x1x1: has to be at least 1"),
            ("resolution=1,min=0:0:0,max=1:0:1", "above min along each axis"),
            ("resolution=1,hit=0.3,false-alarm=0.5", "hit has to be above false-alarm"),
            ("resolution=1,prior=1", "prior has to be"),
        ] {
            let error = parsed(text).expect_err(text);
            assert!(error.contains(words), "{text}: {error}");
        }
    }

    #[test]
    fn a_retention_is_none_forever_or_a_duration() {
        for text in ["none", "forever", "90d"] {
            assert_eq!(retention(text).map(retention_text), Ok(text.to_owned()));
        }
        assert!(retention("0d").is_err_and(|error| error.contains("\"0d\"")));
    }
}
