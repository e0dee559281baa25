//! The path of a tour around obstacles.
//!
//! Invariant: a path goes through passable columns only, and has the length of the tour, up to the way from the start
//! to the centre of its column.

use super::question::TourEnd;
use crate::travel::{Column, Distances, TravelGrid};

/// The data from which the path of a tour is made.
pub(super) struct TourPaths<'a> {
    pub travel: &'a TravelGrid,
    /// The column at which the robot starts.
    pub start: Column,
    pub from_start: &'a Distances,
    /// Columns of the goals.
    pub goals: &'a [Column],
    /// Distances from each goal.
    pub between: &'a [Distances],
}

impl TourPaths<'_> {
    /// The path from a point through goals in an order and to the end of the tour: the start, the goals, and the
    /// centres of the columns where it turns; x and y in metres.
    pub(super) fn path_m(&self, start_m: [f64; 2], order: &[usize], end: TourEnd) -> Vec<[f64; 2]> {
        let mut path = vec![start_m];
        let mut at = self.start;
        for &goal in order {
            self.append(&mut path, at, &self.between[goal]);
            at = self.goals[goal];
        }
        if end == TourEnd::Start {
            self.append(&mut path, at, self.from_start);
            if path.last() != Some(&start_m) {
                path.push(start_m);
            }
        }
        path
    }

    /// Appends the way from a column to the origin of the distances.
    fn append(&self, path: &mut Vec<[f64; 2]>, from: Column, to: &Distances) {
        let way = self.travel.way(from, to);
        let step = |one: &Column, next: &Column| (next.x as i64 - one.x as i64, next.y as i64 - one.y as i64);
        for (place, column) in way.iter().enumerate() {
            let goes_straight =
                place > 0 && way.get(place + 1).is_some_and(|next| step(&way[place - 1], column) == step(column, next));
            if !goes_straight {
                let centre_m = self.travel.centre_m(*column);
                // The end of one leg is the beginning of the next.
                if path.last() != Some(&centre_m) {
                    path.push(centre_m);
                }
            }
        }
    }
}
