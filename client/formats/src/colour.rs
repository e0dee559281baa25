//! The colours of cells.
//!
//! Invariant: unknown, free and occupied static cells are mid-grey, white and black, and no changing cell has a similar
//! colour; the scale of changing cells goes from pale blue to strong orange and gets darker. People with any kind of
//! colour vision can distinguish them.

use super::PictureCell;

/// An unknown cell.
pub(crate) const UNKNOWN: [u8; 3] = [128, 128, 128];
/// A static cell that is free.
pub(crate) const FREE: [u8; 3] = [255, 255, 255];
/// A static cell that is occupied.
pub(crate) const OCCUPIED: [u8; 3] = [0, 0, 0];

/// The scale of changing cells at the values 0, 1/2 and 1.
const SCALE: [[u8; 3]; 3] = [[150, 205, 250], [253, 190, 90], [205, 70, 0]];

/// The colour of a cell. Values outside 0 to 1 are clamped.
pub(crate) fn colour(cell: PictureCell) -> [u8; 3] {
    match cell {
        PictureCell::Unknown => UNKNOWN,
        PictureCell::Static { probability } if probability < 0.5 => FREE,
        PictureCell::Static { .. } => OCCUPIED,
        PictureCell::Changing { probability } => changing(probability),
    }
}

/// The colour of the probability of a changing cell, or of a node. Values outside 0 to 1 are clamped.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a mean of two bytes is a byte")]
pub(crate) fn changing(value: f32) -> [u8; 3] {
    let [low, middle, high] = SCALE;
    let along = value.clamp(0.0, 1.0) * 2.0;
    let (from, to, part) = if along < 1.0 { (low, middle, along) } else { (middle, high, along - 1.0) };
    std::array::from_fn(|band| (f32::from(from[band]) * (1.0 - part) + f32::from(to[band]) * part).round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    type Matrix = [[f64; 3]; 3];

    /// How linear light appears without one kind of cone, after Machado, Oliveira and Fernandes (2009).
    const SEEN_BY: [(&str, Matrix); 4] = [
        ("normal", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        (
            "protan",
            [
                [0.152_286, 1.052_583, -0.204_868],
                [0.114_503, 0.786_281, 0.099_216],
                [-0.003_882, -0.048_116, 1.051_998],
            ],
        ),
        (
            "deutan",
            [[0.367_322, 0.860_646, -0.227_968], [0.280_085, 0.672_501, 0.047_413], [-0.011_820, 0.042_940, 0.968_881]],
        ),
        (
            "tritan",
            [
                [1.255_528, -0.076_749, -0.178_779],
                [-0.078_411, 0.930_809, 0.147_602],
                [0.004_733, 0.691_367, 0.303_900],
            ],
        ),
    ];

    fn seen(colour: [u8; 3], by: &Matrix) -> [f64; 3] {
        let linear = colour.map(|band| (f64::from(band) / 255.0).powf(2.2));
        by.map(|row| {
            let light: f64 = row.iter().zip(linear).map(|(weight, band)| weight * band).sum();
            light.clamp(0.0, 1.0).powf(1.0 / 2.2) * 255.0
        })
    }

    /// The perceived distance of two colours.
    fn apart(one: [u8; 3], other: [u8; 3], by: &Matrix) -> f64 {
        let (one, other) = (seen(one, by), seen(other, by));
        one.iter().zip(other).map(|(one, other)| (one - other).powi(2)).sum::<f64>().sqrt()
    }

    fn changing_at(probability: f32) -> [u8; 3] {
        colour(PictureCell::Changing { probability })
    }

    #[test]
    fn everyone_can_distinguish_the_colours() {
        for (name, matrix) in SEEN_BY {
            for step in 0..=100_u8 {
                let shade = changing_at(f32::from(step) / 100.0);
                for fixed in [UNKNOWN, FREE, OCCUPIED] {
                    let apart = apart(shade, fixed, &matrix);
                    assert!(apart > 45.0, "{name}: {shade:?} and {fixed:?} are {apart:.0} apart");
                }
            }
            for (low, high) in [(0.0, 0.5), (0.5, 1.0), (0.0, 1.0)] {
                let apart = apart(changing_at(low), changing_at(high), &matrix);
                assert!(apart > 45.0, "{name}: {low} and {high} are {apart:.0} apart");
            }
        }
        assert_eq!(colour(PictureCell::Static { probability: 0.2 }), FREE);
        assert_eq!(colour(PictureCell::Static { probability: 0.5 }), OCCUPIED);
    }

    #[test]
    fn the_scale_gets_darker() {
        let light = |[r, g, b]: [u8; 3]| {
            0.2126 * f64::from(r).powf(2.2) + 0.7152 * f64::from(g).powf(2.2) + 0.0722 * f64::from(b).powf(2.2)
        };
        let lights: Vec<f64> = (0..=100_u8).map(|step| light(changing_at(f32::from(step) / 100.0))).collect();
        assert!(lights.windows(2).all(|pair| pair[1] < pair[0] * 1.01), "{lights:?}");
    }
}
