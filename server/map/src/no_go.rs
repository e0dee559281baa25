//! Areas of a site that no route, tour or search is planned through.
//!
//! An area is a polygon. Its border belongs to it. An edge of the topological map is closed where the straight line
//! between its nodes touches an area; an edge at a node without a position is never closed.
//!
//! Invariant: an area has 3 to [`CORNERS_MAX`] corners, which are finite. A new area is a simple polygon: where sides
//! cross, the inside of the area would be a guess.

use std::{collections::BTreeMap, sync::Arc};

use crate::{
    name::StateName,
    topology::{Edge, Topology, TopologyParts},
};

/// Corners lie on a line if the area of each triangle of them is smaller than this, square metres.
const LINE_M2: f64 = 1e-6;
/// Maximum distance of a corner from the map's origin, metres.
const PLACE_MAX_M: f64 = 1e7;
/// Maximum number of areas of a map.
pub const NO_GO_MAX: usize = 1_000;
/// Maximum number of corners of an area.
pub const CORNERS_MAX: usize = 1_000;

/// Maximum number of corners of all areas of a map: each is compared with every edge.
pub(crate) const CORNERS_OF_MAP_MAX: usize = 10_000;

/// Why an area is invalid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum NoGoError {
    /// The corners are no polygon.
    #[error("area {name:?} has {got} corners: expected 3 to {CORNERS_MAX}")]
    Corners { name: String, got: usize },
    /// A coordinate is out of range.
    #[error("a corner of area {name:?} is not a number of metres between -1e7 and 1e7")]
    Coordinate { name: String },
    /// Two corners are at one place.
    #[error(
        "corners {one} and {other} of area {name:?} are both at ({}, {}): name each corner once, the last side leads back \
         to the first corner", .at_m[0], .at_m[1]
    )]
    EqualCorners { name: String, one: usize, other: usize, at_m: [f64; 2] },
    /// All corners lie on a line.
    #[error("the corners of area {name:?} lie on one line: an area needs three that do not")]
    Line { name: String },
    /// Two sides cross, or touch where no corner joins them.
    #[error(
        "the sides after corners {one} and {other} of area {name:?} cross or touch: name the corners in their order \
         around the area, or make two areas of it"
    )]
    Crossing { name: String, one: usize, other: usize },
    /// The map has too many areas.
    #[error("the map has the maximum of {NO_GO_MAX} areas")]
    TooMany,
    /// The areas together have too many corners.
    #[error("the areas of the map would have {0} corners: at most {CORNERS_OF_MAP_MAX}")]
    TooManyCorners(usize),
    /// There is no such area.
    #[error("area {0:?} does not exist")]
    Unknown(String),
}

/// A change of the areas.
#[derive(Clone, Debug, PartialEq)]
pub enum NoGoEdit {
    /// An area is added, or replaces the one of its name: its corners, x and y in the map's frame, metres.
    Set(StateName, Vec<[f64; 2]>),
    /// An area is removed.
    Remove(StateName),
}

/// The areas of a site.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NoGoAreas(Arc<BTreeMap<StateName, Vec<[f64; 2]>>>);

impl NoGoAreas {
    /// The areas with their corners, by name.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = (&StateName, &[[f64; 2]])> {
        self.0.iter().map(|(name, corners)| (name, corners.as_slice()))
    }

    /// Whether there are no areas.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Checks that an edit may be accepted now.
    ///
    /// # Errors
    /// [`NoGoError`], with what is wrong.
    pub fn check(&self, edit: &NoGoEdit) -> Result<(), NoGoError> {
        self.check_bounds(edit)?;
        match edit {
            NoGoEdit::Set(name, corners) => check_shape(name, corners),
            NoGoEdit::Remove(_) => Ok(()),
        }
    }

    /// Checks the rules that also hold for areas that are in a log.
    fn check_bounds(&self, edit: &NoGoEdit) -> Result<(), NoGoError> {
        match edit {
            NoGoEdit::Set(name, corners) => {
                let text = || name.as_str().to_owned();
                if !(3..=CORNERS_MAX).contains(&corners.len()) {
                    return Err(NoGoError::Corners { name: text(), got: corners.len() });
                }
                if corners.iter().flatten().any(|along| !(-PLACE_MAX_M..=PLACE_MAX_M).contains(along)) {
                    return Err(NoGoError::Coordinate { name: text() });
                }
                let is_room = self.0.len() < NO_GO_MAX || self.0.contains_key(name);
                let others = self.0.iter().filter(|(other, _)| *other != name).map(|(_, corners)| corners.len());
                let all = others.sum::<usize>() + corners.len();
                match is_room {
                    false => Err(NoGoError::TooMany),
                    true if all > CORNERS_OF_MAP_MAX => Err(NoGoError::TooManyCorners(all)),
                    true => Ok(()),
                }
            }
            NoGoEdit::Remove(name) if self.0.contains_key(name) => Ok(()),
            NoGoEdit::Remove(name) => Err(NoGoError::Unknown(name.as_str().to_owned())),
        }
    }

    /// Applies an edit that was accepted before. The shape of an area is not checked again, so that no log becomes
    /// invalid.
    ///
    /// # Errors
    /// The errors of [`NoGoAreas::check`], except those for the shape; nothing is changed then.
    pub fn apply(&mut self, edit: &NoGoEdit) -> Result<(), NoGoError> {
        self.check_bounds(edit)?;
        let areas = Arc::make_mut(&mut self.0);
        match edit {
            NoGoEdit::Set(name, corners) => drop(areas.insert(name.clone(), corners.clone())),
            NoGoEdit::Remove(name) => drop(areas.remove(name)),
        }
        Ok(())
    }

    /// Whether a place is in an area.
    #[must_use]
    pub fn has(&self, at_m: [f64; 2]) -> bool {
        self.touches(at_m, at_m)
    }

    /// Whether the straight line between two places touches an area.
    #[must_use]
    pub fn touches(&self, from_m: [f64; 2], to_m: [f64; 2]) -> bool {
        self.0.values().filter(|corners| is_near(corners, from_m, to_m)).any(|corners| {
            let mut sides = corners.iter().zip(corners.iter().cycle().skip(1));
            is_inside(corners, from_m) || sides.any(|(one, other)| meet(from_m, to_m, *one, *other))
        })
    }

    /// The topological map without the edges that touch an area.
    #[must_use]
    pub fn without_closed(&self, topology: &Arc<Topology>) -> Arc<Topology> {
        if self.is_empty() {
            return Arc::clone(topology);
        }
        let at = |edge: &Edge| {
            let place = |node| topology.node(node).ok()?.pose.map(|pose| [pose.x_m, pose.y_m]);
            place(edge.from).zip(place(edge.to))
        };
        let parts = topology.to_parts();
        let is_open = |edge: &Edge| !at(edge).is_some_and(|(from_m, to_m)| self.touches(from_m, to_m));
        let edges = parts.edges.iter().filter(|edge| is_open(edge)).cloned().collect();
        // A map without some of its edges is valid.
        Topology::from_parts(TopologyParts { edges, ..parts }).map_or_else(|_| Arc::clone(topology), Arc::new)
    }
}

/// Checks that corners are those of a simple polygon.
fn check_shape(name: &StateName, corners: &[[f64; 2]]) -> Result<(), NoGoError> {
    let text = || name.as_str().to_owned();
    let sides: Vec<[[f64; 2]; 2]> =
        corners.iter().zip(corners.iter().cycle().skip(1)).map(|(one, other)| [*one, *other]).collect();
    let pairs = || (0..sides.len()).flat_map(|one| (one + 1..sides.len()).map(move |other| (one, other)));
    if let Some((one, other)) = pairs().find(|&(one, other)| corners[one] == corners[other]) {
        return Err(NoGoError::EqualCorners { name: text(), one: one + 1, other: other + 1, at_m: corners[one] });
    }
    if lie_on_a_line(corners) {
        return Err(NoGoError::Line { name: text() });
    }
    let are_wrong = |&(one, other): &(usize, usize)| {
        let ([a, b], [c, d]) = (sides[one], sides[other]);
        match (b == c, d == a) {
            (true, _) => folds_back(a, b, d),
            (_, true) => folds_back(c, d, b),
            _ => meet(a, b, c, d),
        }
    };
    match pairs().find(are_wrong) {
        Some((one, other)) => Err(NoGoError::Crossing { name: text(), one: one + 1, other: other + 1 }),
        None => Ok(()),
    }
}

/// Whether all corners lie on a line, within rounding.
fn lie_on_a_line(corners: &[[f64; 2]]) -> bool {
    let Some(&first) = corners.first() else { return true };
    let apart = |at: &[f64; 2]| {
        let [x, y] = [at[0] - first[0], at[1] - first[1]];
        x * x + y * y
    };
    let far = corners.iter().max_by(|one, other| apart(one).total_cmp(&apart(other)));
    far.is_none_or(|&far| corners.iter().all(|&at| turn(first, far, at).abs() <= LINE_M2))
}

/// Whether the way from `a` to `b` to `c` goes back on itself.
fn folds_back(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> bool {
    let along = (b[0] - a[0]) * (c[0] - b[0]) + (b[1] - a[1]) * (c[1] - b[1]);
    turn(a, b, c) == 0.0 && along < 0.0
}

/// Whether the boxes around an area and around a line overlap.
fn is_near(corners: &[[f64; 2]], from_m: [f64; 2], to_m: [f64; 2]) -> bool {
    (0..2).all(|axis| {
        let (low, high) = (from_m[axis].min(to_m[axis]), from_m[axis].max(to_m[axis]));
        corners.iter().any(|corner| corner[axis] >= low) && corners.iter().any(|corner| corner[axis] <= high)
    })
}

/// Whether a place is inside, by the number of sides that a ray to the right crosses.
fn is_inside(corners: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    let sides = corners.iter().zip(corners.iter().cycle().skip(1));
    let is_crossed = |&(one, other): &(&[f64; 2], &[f64; 2])| {
        (one[1] > y) != (other[1] > y) && x < (other[0] - one[0]) * (y - one[1]) / (other[1] - one[1]) + one[0]
    };
    sides.filter(is_crossed).count() % 2 == 1
}

/// Twice the area of the triangle, above 0 if it turns left.
fn turn(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Whether two lines with ends have a point in common.
fn meet(a: [f64; 2], b: [f64; 2], c: [f64; 2], d: [f64; 2]) -> bool {
    let (abc, abd, cda, cdb) = (turn(a, b, c), turn(a, b, d), turn(c, d, a), turn(c, d, b));
    let is_between = |from: [f64; 2], to: [f64; 2], at: [f64; 2]| {
        (0..2).all(|axis| (from[axis].min(to[axis])..=from[axis].max(to[axis])).contains(&at[axis]))
    };
    (abc * abd < 0.0 && cda * cdb < 0.0)
        || (abc == 0.0 && is_between(a, b, c))
        || (abd == 0.0 && is_between(a, b, d))
        || (cda == 0.0 && is_between(c, d, a))
        || (cdb == 0.0 && is_between(c, d, b))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::topology::{Extent, NodePose};

    fn name(text: &str) -> StateName {
        StateName::new(text).unwrap()
    }

    /// A square from 0 to 2 with a notch that reaches from the right to its middle.
    fn areas() -> NoGoAreas {
        let mut areas = NoGoAreas::default();
        let corners = vec![[0.0, 0.0], [2.0, 0.0], [1.0, 1.0], [2.0, 2.0], [0.0, 2.0]];
        areas.apply(&NoGoEdit::Set(name("hole"), corners)).unwrap();
        areas
    }

    #[test]
    fn a_place_is_in_an_area_or_on_its_border() {
        for (at_m, expected) in [
            ([0.5, 1.0], true),
            ([1.5, 1.0], false),
            ([1.5, 0.2], true),
            ([0.0, 1.0], true),
            ([1.0, 1.0], true),
            ([-0.1, 1.0], false),
            ([3.0, 2.0], false),
        ] {
            assert_eq!(areas().has(at_m), expected, "{at_m:?}");
        }
    }

    #[test]
    fn a_line_touches_an_area_that_it_passes_through() {
        for (from_m, to_m, expected) in [
            ([-1.0, 1.0], [3.0, 1.0], true),
            ([1.6, 1.0], [3.0, 1.0], false),
            ([2.5, 0.0], [2.5, 2.0], false),
            ([-1.0, 0.0], [3.0, 0.0], true),
            ([-1.0, -1.0], [0.0, 0.0], true),
            ([0.5, 0.5], [0.6, 0.6], true),
        ] {
            assert_eq!(areas().touches(from_m, to_m), expected, "{from_m:?} {to_m:?}");
            assert_eq!(areas().touches(to_m, from_m), expected, "{to_m:?} {from_m:?}");
        }
    }

    #[test]
    fn closed_edges_are_left_out_and_others_keep_their_numbers() {
        let mut topology = Topology::new();
        let at = |x_m: f64, y_m: f64| Some(NodePose { x_m, y_m, yaw_rad: 0.0 });
        let mut node = |text: &str, pose| topology.add_node(name(text), pose, None).unwrap();
        let (west, east, north, far) =
            (node("west", at(-1.0, 1.0)), node("east", at(3.0, 1.0)), node("north", at(1.0, 5.0)), node("far", None));
        for (from, to) in [(west, east), (west, north), (north, east), (west, far)] {
            topology.link(from, to, Extent::metres(4.0)).unwrap();
        }
        let topology = Arc::new(topology);
        let open = areas().without_closed(&topology);
        let ends: Vec<_> = open.edges().map(|edge| (edge.from, edge.to)).collect();
        assert_eq!(ends.len(), 6);
        assert!(!ends.contains(&(west, east)) && !ends.contains(&(east, west)), "{ends:?}");
        assert!(open.edges().all(|edge| topology.edges().any(|known| known == edge)));
        assert!(Arc::ptr_eq(&NoGoAreas::default().without_closed(&topology), &topology));
    }

    #[test]
    fn invalid_areas_change_nothing() {
        let mut known = areas();
        let set = |corners: &[[f64; 2]]| NoGoEdit::Set(name("hole"), corners.to_vec());
        let line = known.apply(&set(&[[0.0, 0.0], [1.0, 1.0]])).unwrap_err();
        assert_eq!(line, NoGoError::Corners { name: "hole".to_owned(), got: 2 });
        let endless = known.apply(&set(&[[0.0, 0.0], [1.0, f64::NAN], [1.0, 0.0]])).unwrap_err();
        assert_eq!(endless, NoGoError::Coordinate { name: "hole".to_owned() });
        // The meaning of an area is unique: no corner twice, an inside, and sides that do not cross.
        let (tie, hole) = ([[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]], || "hole".to_owned());
        let closed = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 0.0]];
        let spike = [[0.0, 0.0], [2.0, 0.0], [1.0, 0.0], [1.0, 1.0]];
        let touching = [[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [2.0, 0.0], [0.0, 2.0]];
        for (corners, expected) in [
            (&[[1.0, 2.0]; 3][..], NoGoError::EqualCorners { name: hole(), one: 1, other: 2, at_m: [1.0, 2.0] }),
            (&closed, NoGoError::EqualCorners { name: hole(), one: 1, other: 4, at_m: [0.0, 0.0] }),
            (&[[0.0, 0.0], [0.1, 0.3], [0.2, 0.6]], NoGoError::Line { name: hole() }),
            (&[[0.0, 0.0], [3.0, 0.0], [1.0, 0.0], [2.0, 0.0]], NoGoError::Line { name: hole() }),
            (&tie, NoGoError::Crossing { name: hole(), one: 1, other: 3 }),
            (&spike, NoGoError::Crossing { name: hole(), one: 1, other: 2 }),
            (&touching, NoGoError::Crossing { name: hole(), one: 1, other: 3 }),
        ] {
            assert_eq!(known.check(&set(corners)).unwrap_err(), expected, "{corners:?}");
        }
        // Corners along a side, in either direction, and far from the origin are accepted.
        for corners in [
            [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 2.0]],
            [[2.0, 2.0], [2.0, 0.0], [1.0, 0.0], [0.0, 0.0]],
            [[9e6, 9e6], [9e6 + 1.0, 9e6], [9e6 + 1.0, 9e6 + 1.0], [9e6, 9e6 + 1.0]],
        ] {
            known.check(&set(&corners)).unwrap();
        }
        // A log may hold an area that an earlier version accepted.
        areas().apply(&set(&tie)).unwrap();
        let other = known.apply(&NoGoEdit::Remove(name("pit"))).unwrap_err();
        assert_eq!(other, NoGoError::Unknown("pit".to_owned()));
        assert_eq!(known, areas());
        known.apply(&NoGoEdit::Remove(name("hole"))).unwrap();
        assert!(known.is_empty());
    }
}
