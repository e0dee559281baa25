//! Points as arguments: X,Y and X,Y,Z[,RANGE], metres.
//!
//! Invariant: every number of a point is finite.

use std::str::FromStr;

/// x and y in the map's frame, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Point(pub(crate) [f64; 2]);

/// A viewpoint and its range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ViewArg {
    /// x, y and z in the map's frame, metres.
    pub(crate) at_m: [f64; 3],
    pub(crate) range_m: Option<f64>,
}

fn numbers(text: &str) -> Option<Vec<f64>> {
    text.split(',').map(|part| part.trim().parse().ok().filter(|number: &f64| number.is_finite())).collect()
}

impl FromStr for Point {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match numbers(text).as_deref() {
            Some(&[x, y]) => Ok(Self([x, y])),
            _ => Err(format!("{text:?} is not a point: use X,Y in metres, such as 1.5,-2")),
        }
    }
}

impl FromStr for ViewArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match numbers(text).as_deref() {
            Some(&[x, y, z]) => Ok(Self { at_m: [x, y, z], range_m: None }),
            Some(&[x, y, z, range]) if range > 0.0 => Ok(Self { at_m: [x, y, z], range_m: Some(range) }),
            _ => Err(format!("{text:?} is not a view: use X,Y,Z or X,Y,Z,RANGE in metres, such as 1.5,-2,1.2,4")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_and_views_are_read() {
        assert_eq!("1.5,-2".parse(), Ok(Point([1.5, -2.0])));
        assert_eq!("0, 1,2".parse(), Ok(ViewArg { at_m: [0.0, 1.0, 2.0], range_m: None }));
        assert_eq!("0,1,2,3".parse(), Ok(ViewArg { at_m: [0.0, 1.0, 2.0], range_m: Some(3.0) }));
        for wrong in ["", "1", "1,", "1,2,3", "nan,0", "inf,0", "a,b"] {
            assert!(wrong.parse::<Point>().is_err(), "{wrong:?}");
        }
        for wrong in ["1,2", "1,2,3,0", "1,2,3,-1", "1,2,3,4,5", "1,2,nan"] {
            assert!(wrong.parse::<ViewArg>().is_err(), "{wrong:?}");
        }
    }
}
