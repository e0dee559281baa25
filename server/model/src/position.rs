//! Positions: values that have two or three coordinates.
//!
//! Invariant: the number of coordinates matches the dimensions. [`Position::invalid_coordinate`] checks the values,
//! because they come from outside.

use crate::StateKind;

/// Names of the axes.
const AXES: [&str; 3] = ["x", "y", "z"];

/// The number of coordinates of a position.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Dimensions {
    /// x and y.
    Two,
    /// x, y and z.
    Three,
}

impl Dimensions {
    /// Both dimensions.
    pub const ALL: [Dimensions; 2] = [Dimensions::Two, Dimensions::Three];

    /// The dimensions of a number of coordinates; `None` unless it is 2 or 3.
    pub fn of(count: usize) -> Option<Dimensions> {
        Self::ALL.into_iter().find(|dimensions| dimensions.count() == count)
    }

    /// The number of coordinates: 2 or 3.
    pub fn count(self) -> usize {
        match self {
            Dimensions::Two => 2,
            Dimensions::Three => 3,
        }
    }

    /// Names of the axes, in order: `x`, `y` and, if there are three, `z`.
    pub fn axes(self) -> &'static [&'static str] {
        &AXES[..self.count()]
    }

    /// The number of an axis by its name: 0 for `x`, 1 for `y`, 2 for `z`.
    pub fn axis(name: &str) -> Option<usize> {
        AXES.iter().position(|axis| *axis == name)
    }
}

/// A place, in metres along the axes of the map's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Position {
    dimensions: Dimensions,
    /// Coordinates beyond the dimensions are 0.
    coordinates: [f64; 3],
}

impl Position {
    /// The position with these coordinates; `None` unless there are 2 or 3.
    pub fn of(coordinates: &[f64]) -> Option<Position> {
        let dimensions = Dimensions::of(coordinates.len())?;
        let mut all = [0.0; 3];
        all[..coordinates.len()].copy_from_slice(coordinates);
        Some(Position { dimensions, coordinates: all })
    }

    /// The number of coordinates.
    pub fn dimensions(self) -> Dimensions {
        self.dimensions
    }

    /// The coordinates in metres, by axis.
    pub fn coordinates(&self) -> &[f64] {
        &self.coordinates[..self.dimensions.count()]
    }

    /// The first invalid coordinate with the name of its axis: not finite, or of a magnitude above
    /// [`crate::VALUE_MAX`].
    pub fn invalid_coordinate(&self) -> Option<(&'static str, f64)> {
        let mut axes = AXES.into_iter().zip(self.coordinates().iter().copied());
        axes.find(|(_, coordinate)| !StateKind::Continuous.allows(*coordinate))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_position_has_two_or_three_coordinates_which_are_numbers() {
        for count in [0, 1, 4] {
            assert_eq!(Position::of(&vec![0.0; count]), None);
            assert_eq!(Dimensions::of(count), None);
        }
        let flat = Position::of(&[1.0, -2.5]).unwrap();
        assert_eq!(
            (flat.dimensions(), flat.coordinates(), flat.invalid_coordinate()),
            (Dimensions::Two, &[1.0, -2.5][..], None)
        );
        assert_eq!(Dimensions::Three.axes(), ["x", "y", "z"]);
        assert_eq!((Dimensions::axis("z"), Dimensions::axis("w")), (Some(2), None));
        assert_eq!(Position::of(&[0.0, 1.0, -1e12]).unwrap().invalid_coordinate(), None);
        assert_eq!(Position::of(&[0.0, 1.1e12, f64::NAN]).unwrap().invalid_coordinate(), Some(("y", 1.1e12)));
        assert_eq!(
            Position::of(&[f64::NEG_INFINITY, 0.0]).unwrap().invalid_coordinate(),
            Some(("x", f64::NEG_INFINITY))
        );
    }
}
