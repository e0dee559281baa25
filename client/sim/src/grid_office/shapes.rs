//! The cells that a thing fills in each of its poses, relative to its corner.
//!
//! Invariant: pose 0 is the pose in an empty building, and no shape has more than 16 poses.

use std::collections::BTreeMap;

use super::thing_kind::ThingKind;

/// A cell relative to the corner of its thing: x, y, z.
pub(crate) type Offset = (u32, u32, u32);

/// The first pose of a workplace with a person at it. Poses below are positions of the empty chair.
pub(crate) const SEATED: u8 = 5;
/// Number of poses of a person at a workplace: upright, forward, back, left, right, standing.
pub(crate) const POSTURES: u8 = 6;
/// Number of sections of a way; a person in section s is pose s + 1.
pub(crate) const SECTIONS: u8 = 4;
/// Number of places in a kitchen or at a meeting table; further people are not visible.
pub(crate) const SPOTS: u8 = 6;
/// Poses of doors, curtains, parcels and belongings.
pub(crate) const SHUT: u8 = 0;
pub(crate) const OPEN: u8 = 1;
pub(crate) const HALF_OPEN: u8 = 2;

/// Cells of a door leaf's width.
pub(crate) const DOOR_WIDTH: u32 = 9;
const DOOR_HEIGHT: u32 = 20;

/// Filled cells, each with a bit mask of the poses in which it is filled.
#[derive(Clone, Debug, Default)]
pub(crate) struct ThingShape(BTreeMap<Offset, u16>);

impl ThingShape {
    /// Fills a block of cells from `corner` in the poses of the bit mask `poses`.
    fn fill(&mut self, poses: u16, corner: Offset, size: Offset) {
        for x in corner.0..corner.0 + size.0 {
            for y in corner.1..corner.1 + size.1 {
                for z in corner.2..corner.2 + size.2 {
                    *self.0.entry((x, y, z)).or_default() |= poses;
                }
            }
        }
    }

    /// The cells, each with a bit mask of the poses in which it is filled.
    pub(crate) fn into_cells(self) -> impl Iterator<Item = (Offset, u16)> {
        self.0.into_iter()
    }
}

/// The shape of a kind of thing. Edges have none.
pub(crate) fn shape(kind: ThingKind) -> ThingShape {
    let mut shape = ThingShape::default();
    match kind {
        ThingKind::Workplace => workplace(&mut shape),
        ThingKind::Belongings => {
            shape.fill(1 << OPEN, (11, 7, 1), (3, 3, 5));
            shape.fill(1 << OPEN, (5, 3, 8), (5, 3, 1));
        }
        ThingKind::Door => {
            shape.fill(1 << SHUT, (0, DOOR_WIDTH, 1), (DOOR_WIDTH, 1, DOOR_HEIGHT));
            shape.fill(1 << OPEN, (0, 0, 1), (1, DOOR_WIDTH, DOOR_HEIGHT));
        }
        ThingKind::Curtain => {
            shape.fill(1 << SHUT | 1 << HALF_OPEN, (0, 0, 9), (20, 1, 12));
            shape.fill(1 << SHUT, (20, 0, 9), (20, 1, 12));
        }
        ThingKind::Way => {
            for section in 0..SECTIONS {
                person(&mut shape, 1 << (section + 1), (u32::from(section) * 9, 0), 17);
            }
        }
        // Spots fill in order.
        ThingKind::Kitchen => spots(&mut shape, |spot| (spot * 7, 0), 17),
        ThingKind::Meeting => spots(&mut shape, |spot| (spot / 2 * 7, spot % 2 * 14), 13),
        ThingKind::Parcel => shape.fill(1 << OPEN, (0, 0, 1), (4, 4, 4)),
        ThingKind::Edge | ThingKind::DaylightEdge => {}
    }
    shape
}

/// A person of the given height, in cells.
fn person(shape: &mut ThingShape, poses: u16, (x, y): (u32, u32), height: u32) {
    shape.fill(poses, (x, y, 1), (4, 4, height - 4));
    shape.fill(poses, (x + 1, y + 1, height - 3), (2, 2, 3));
}

fn spots(shape: &mut ThingShape, at: impl Fn(u32) -> (u32, u32), height: u32) {
    for spot in 0..SPOTS {
        person(shape, u16::MAX << (spot + 1), at(u32::from(spot)), height);
    }
}

fn workplace(shape: &mut ThingShape) {
    // The chair under the desk, and the other positions where people leave it.
    for (pose, at) in (0..).zip([(5, 4), (5, 8), (1, 12), (9, 13), (5, 16)]) {
        chair(shape, 1 << pose, at);
    }
    let seated = (1 << POSTURES) - 1;
    chair(shape, seated << SEATED, (5, 7));
    // Legs and thighs do not move; the upper body leans.
    shape.fill(seated << SEATED, (5, 6, 1), (4, 1, 4));
    shape.fill(seated << SEATED, (5, 7, 5), (4, 2, 2));
    for (posture, (x, y)) in (SEATED..).zip([(5, 8), (5, 7), (5, 10), (3, 8), (7, 8)]) {
        shape.fill(1 << posture, (x, y, 5), (4, 3, 7));
        shape.fill(1 << posture, (x + 1, y, 12), (2, 2, 3));
    }
    person(shape, 1 << (SEATED + POSTURES - 1), (5, 12), 17);
}

fn chair(shape: &mut ThingShape, poses: u16, (x, y): (u32, u32)) {
    shape.fill(poses, (x, y, 4), (5, 5, 1));
    shape.fill(poses, (x, y + 4, 5), (5, 1, 5));
    shape.fill(poses, (x + 2, y + 2, 1), (1, 1, 3));
    shape.fill(poses, (x, y + 2, 1), (5, 1, 1));
    shape.fill(poses, (x + 2, y, 1), (1, 5, 1));
}
