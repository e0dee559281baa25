//! The colours of all pictures: free white, occupied black, unknown grey, as RViz and Nav2 show maps.
//!
//! Invariant: a greater probability is darker, and no probability looks unknown, also for people without red or green
//! cones. `client/web/src/lib/palette.ts` has the same colours; a test checks that they are equal.

use crate::Colour;

/// A cell that was never observed: the grey of Nav2's maps.
pub const UNKNOWN: Colour = [205; 3];

/// Probabilities of occupied from 0 to 1: from white by way of yellow, orange, red and purple to black.
pub(crate) const OCCUPANCY: [Colour; 11] = [
    [255, 255, 255],
    [255, 230, 177],
    [255, 200, 127],
    [255, 164, 83],
    [253, 123, 54],
    [239, 84, 60],
    [211, 42, 72],
    [172, 2, 86],
    [119, 13, 96],
    [59, 21, 71],
    [0, 0, 0],
];

/// The map below another layer: the same probabilities, without colours that the layer could have.
pub(crate) const MUTED: [Colour; 5] = [[255, 255, 255], [236, 230, 244], [172, 158, 190], [92, 86, 104], [40, 40, 44]];

/// An entropy of one bit.
pub(crate) const UNCERTAIN: Colour = [0, 122, 156];
/// A cell that was occupied and is free now.
pub(crate) const FREER: Colour = [0, 114, 178];
/// A cell that was free and is occupied now.
pub(crate) const FULLER: Colour = [213, 94, 0];

/// The part of the colours of occupancy that can be seen as a line or a disc on white.
pub(crate) const MARKS: [f64; 2] = [0.2, 0.8];

/// The colour of a probability of occupied, or of the share of any other value in its range. Values outside 0 to 1 are
/// clamped; NaN is 0.
pub fn occupancy(probability: f64) -> Colour {
    mix(&OCCUPANCY, probability)
}

/// The colour of a line or a disc that shows a value from 0 to 1. Does the same as [`occupancy`], without the colours
/// of white paper or black ink.
pub fn mark(value: f64) -> Colour {
    let [low, high] = MARKS;
    occupancy(low + (high - low) * within(value))
}

/// Whether a text on this colour is white; otherwise it is black.
pub fn is_dark([red, green, blue]: Colour) -> bool {
    // Weights of ITU-R BT.601, which suffice here.
    299 * u32::from(red) + 587 * u32::from(green) + 114 * u32::from(blue) < 128_000
}

/// The colour of an entropy from 0 to 1 bit, over the map with this probability.
pub(crate) fn entropy(bits: f64, beneath: f64) -> Colour {
    blend(mix(&MUTED, beneath), UNCERTAIN, within(bits))
}

/// The colour of a difference of probabilities from -1 to 1, over the map with this probability.
pub(crate) fn difference(difference: f64, beneath: f64) -> Colour {
    blend(mix(&MUTED, beneath), if difference < 0.0 { FREER } else { FULLER }, within(difference.abs()))
}

/// A value from 0 to 1; NaN is 0.
fn within(value: f64) -> f64 {
    value.clamp(0.0, 1.0).max(0.0)
}

/// The colour at a share of the way along stops of equal distance.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the share is from 0 to 1")]
fn mix<const N: usize>(stops: &[Colour; N], share: f64) -> Colour {
    let at = within(share) * (N - 1) as f64;
    let low = (at as usize).min(N - 2);
    blend(stops[low], stops[low + 1], at - low as f64)
}

/// The colour at a share, from 0 to 1, of the way between two.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "between two bytes is a byte")]
fn blend(from: Colour, to: Colour, share: f64) -> Colour {
    std::array::from_fn(|band| {
        let [from, to] = [from[band], to[band]].map(f64::from);
        // Halves are rounded up, as in JavaScript.
        (from + (to - from) * share + 0.5).floor() as u8
    })
}

#[cfg(test)]
#[path = "palette/tests.rs"]
mod tests;
