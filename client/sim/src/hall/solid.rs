//! Upright boxes at any angle: where a beam hits them, how far a place is from them, which cells they touch.
//!
//! Invariant: geometry only; lengths in metres, angles in radians.

/// A box that stands upright.
#[derive(Clone, Copy, Debug)]
pub(super) struct Solid {
    middle: [f64; 2],
    half: [f64; 2],
    /// Sine and cosine of the angle of the first side from the x axis.
    turn: (f64, f64),
    /// Lower and upper end.
    heights: [f64; 2],
    /// Square of the distance of a corner from the middle.
    radius_squared: f64,
}

/// The place where a beam hits a solid.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    /// Distance along the beam.
    pub(super) range_m: f64,
    /// Cosine of the angle between the beam and the normal of the surface.
    pub(super) steepness: f64,
}

impl Solid {
    /// A box between two corners.
    pub(super) fn between(low: [f64; 2], high: [f64; 2], heights: [f64; 2]) -> Self {
        let middle = [0, 1].map(|axis| (low[axis] + high[axis]) / 2.0);
        Self::turned(middle, [0, 1].map(|axis| high[axis] - low[axis]), 0.0, heights)
    }

    /// A box around a middle, with its first side at an angle to the x axis.
    pub(super) fn turned(middle: [f64; 2], sides: [f64; 2], angle_rad: f64, heights: [f64; 2]) -> Self {
        let half = sides.map(|side| side / 2.0);
        let radius_squared = half[0] * half[0] + half[1] * half[1];
        Self { middle, half, turn: libm::sincos(angle_rad), heights, radius_squared }
    }

    /// Whether a plane at this height cuts the box.
    pub(super) fn stands_at(&self, height_m: f64) -> bool {
        (self.heights[0]..=self.heights[1]).contains(&height_m)
    }

    /// A direction in the axes of the box.
    fn inward(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.turn;
        [x * cos + y * sin, y * cos - x * sin]
    }

    /// A place relative to the box, in its axes.
    fn relative(&self, place: [f64; 2]) -> [f64; 2] {
        self.inward([place[0] - self.middle[0], place[1] - self.middle[1]])
    }

    /// The first place of a beam from outside, with a direction of length 1, at any height of the box.
    pub(super) fn hit(&self, from: [f64; 2], direction: [f64; 2]) -> Option<Hit> {
        let [x, y] = [self.middle[0] - from[0], self.middle[1] - from[1]];
        let beside = x * direction[1] - y * direction[0];
        if beside * beside > self.radius_squared {
            return None;
        }
        let (from, direction) = (self.relative(from), self.inward(direction));
        let (mut enters, mut leaves, mut steepness) = (0.0_f64, f64::INFINITY, 0.0);
        for axis in [0, 1] {
            if direction[axis] == 0.0 {
                if from[axis].abs() > self.half[axis] {
                    return None;
                }
                continue;
            }
            let near = (-self.half[axis].copysign(direction[axis]) - from[axis]) / direction[axis];
            let far = (self.half[axis].copysign(direction[axis]) - from[axis]) / direction[axis];
            if near > enters {
                (enters, steepness) = (near, direction[axis].abs());
            }
            leaves = leaves.min(far);
        }
        (enters > 0.0 && enters < leaves).then_some(Hit { range_m: enters, steepness })
    }

    /// The distance of a place from the box; 0 inside.
    pub(super) fn distance_m(&self, place: [f64; 2]) -> f64 {
        let place = self.relative(place);
        let [x, y] = [0, 1].map(|axis| (place[axis].abs() - self.half[axis]).max(0.0));
        (x * x + y * y).sqrt()
    }

    /// Whether the box and a square have more than a border in common: no axis of either separates them.
    pub(super) fn overlaps(&self, middle: [f64; 2], half_m: f64) -> bool {
        let apart = self.relative(middle);
        let (sin, cos) = self.turn;
        let reach = sin.abs() + cos.abs();
        let in_own_axes = [0, 1].iter().all(|&axis| apart[axis].abs() < self.half[axis] + half_m * reach);
        let [wide, high] = self.half;
        let spans = [wide * cos.abs() + high * sin.abs(), wide * sin.abs() + high * cos.abs()];
        let in_square = [0, 1].iter().all(|&axis| (middle[axis] - self.middle[axis]).abs() < spans[axis] + half_m);
        in_own_axes && in_square
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_beam_hits_the_side_that_it_meets_first() {
        let solid = Solid::between([1.0, -1.0], [3.0, 1.0], [0.0, 1.0]);
        let hit = solid.hit([0.0, 0.0], [0.6, 0.8]);
        assert!(hit.is_none_or(|hit| hit.range_m > 3.0), "the beam passes above: {hit:?}");
        let hit = solid.hit([0.0, 0.0], [1.0, 0.0]).expect("straight ahead");
        assert_eq!((hit.range_m, hit.steepness), (1.0, 1.0));
        let hit = solid.hit([0.0, -2.0], [0.8, 0.6]).expect("through the lower side");
        assert!((hit.range_m - 5.0 / 3.0).abs() < 1e-12 && (hit.steepness - 0.6).abs() < 1e-12, "{hit:?}");
        assert!(solid.hit([0.0, 0.0], [-1.0, 0.0]).is_none() && solid.hit([0.0, 1.5], [1.0, 0.0]).is_none());
        // A beam along a side hits it, so that none slips through between two walls that touch.
        assert!(solid.hit([0.0, 1.0], [1.0, 0.0]).is_some());
        assert!(solid.stands_at(0.2) && !solid.stands_at(2.0));
    }

    #[test]
    fn a_turned_box_touches_the_cells_below_it_only() {
        let solid = Solid::turned([0.0, 0.0], [2.0, 0.2], std::f64::consts::FRAC_PI_4, [0.0, 1.0]);
        assert!(solid.overlaps([0.65, 0.65], 0.05) && solid.overlaps([0.15, 0.05], 0.05));
        assert!(!solid.overlaps([0.65, -0.65], 0.05) && !solid.overlaps([0.35, 0.05], 0.05));
        assert!(!solid.overlaps([0.85, 0.85], 0.05));
        assert!((solid.distance_m([1.0, -1.0]) - (std::f64::consts::SQRT_2 - 0.1)).abs() < 1e-12);
    }
}
