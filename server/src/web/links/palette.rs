//! The colours of pictures: those of the page (`client/web/src/lib/colours.ts`), as palettes of 256 entries.
//!
//! Invariant: entry 255 is for what is not known, and is transparent; entries 0 to 254 stand for 0 to 1. A test
//! compares the colours with those of the page.

use tidemap_picture::{Colour, LegendRow};

/// The index of a value that is not known.
pub(super) const UNKNOWN: u8 = 255;
/// The index that stands for 1.
pub(super) const FULL: u8 = 254;

const VIRIDIS: [Colour; 9] = [
    [68, 1, 84],
    [71, 44, 122],
    [59, 81, 139],
    [44, 113, 142],
    [33, 144, 141],
    [39, 173, 129],
    [92, 200, 99],
    [170, 220, 50],
    [253, 231, 37],
];
const CIVIDIS: [Colour; 9] = [
    [0, 32, 77],
    [0, 51, 111],
    [57, 72, 107],
    [87, 93, 109],
    [112, 113, 115],
    [138, 134, 120],
    [166, 157, 117],
    [196, 182, 108],
    [255, 234, 70],
];
const CHANGE: [Colour; 9] = [
    [33, 102, 172],
    [67, 147, 195],
    [146, 197, 222],
    [197, 205, 212],
    [200, 200, 200],
    [222, 208, 190],
    [253, 184, 99],
    [224, 130, 20],
    [179, 88, 6],
];

/// What a picture shows of the cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Layer {
    /// The probability that a cell is occupied.
    Probability,
    /// The entropy of that probability.
    Entropy,
    /// The last readings.
    Seen,
    /// How much more probable a cell is than at another time, as (difference + 1) / 2.
    Difference,
}

impl Layer {
    /// The layers by their names in addresses.
    pub(super) const ALL: [(&'static str, Self); 4] = [
        ("probability", Self::Probability),
        ("entropy", Self::Entropy),
        ("seen", Self::Seen),
        ("difference", Self::Difference),
    ];

    /// The colours of a legend, from the lowest value to the highest, and what they mean.
    pub(super) fn legend(self) -> LegendRow {
        const STEPS: u8 = 16;
        let colours = |colour: &dyn Fn(f64) -> Colour| {
            (0..=STEPS).map(|step| colour(f64::from(step) / f64::from(STEPS))).collect()
        };
        let of_value = |share: f64| self.colour(share);
        match self {
            Self::Probability => LegendRow::new(colours(&of_value), "probability of occupied, 0 to 1"),
            Self::Entropy => LegendRow::new(colours(&|bits| mix(&CIVIDIS, bits)), "entropy in bits, 0 to 1"),
            Self::Seen => LegendRow::new(colours(&of_value), "seen last: 0 free, 1 occupied"),
            Self::Difference => {
                LegendRow::new(colours(&of_value), "difference of the probability of occupied, -1 to 1")
            }
        }
    }

    /// The colour of a value from 0 to 1.
    pub(super) fn colour(self, share: f64) -> Colour {
        match self {
            Self::Probability | Self::Seen => mix(&VIRIDIS, share),
            Self::Entropy => mix(&CIVIDIS, tidemap_model::entropy_bits(share)),
            Self::Difference => mix(&CHANGE, share),
        }
    }

    /// The colours of the entries, three bytes each.
    pub(super) fn palette(self) -> Vec<u8> {
        let known = (0..=FULL).flat_map(|index| self.colour(f64::from(index) / f64::from(FULL)));
        known.chain([0; 3]).collect()
    }
}

/// The entry of a value from 0 to 1.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "it is clamped")]
pub(super) fn entry(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * f32::from(FULL)).round() as u8
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a mean of two bytes is a byte")]
fn mix(stops: &[Colour; 9], share: f64) -> Colour {
    let at = share.clamp(0.0, 1.0) * (stops.len() - 1) as f64;
    let low = (at as usize).min(stops.len() - 2);
    let part = at - low as f64;
    std::array::from_fn(|channel| {
        let [from, to] = [low, low + 1].map(|stop| f64::from(stops[stop][channel]));
        (from + (to - from) * part).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The stops of a colour map of the page.
    fn of_page(name: &str) -> Vec<Colour> {
        let source = include_str!("../../../../client/web/src/lib/colours.ts");
        let (_, rest) = source.split_once(&format!("const {name} = [")).expect("the colour map");
        let (list, _) = rest.split_once("];").expect("its end");
        let numbers: Vec<u8> =
            list.split(|byte: char| !byte.is_ascii_digit()).filter_map(|number| number.parse().ok()).collect();
        numbers.chunks(3).map(|colour| [colour[0], colour[1], colour[2]]).collect()
    }

    #[test]
    fn the_colours_are_those_of_the_page() {
        for (name, stops) in [("VIRIDIS", VIRIDIS), ("CIVIDIS", CIVIDIS), ("CHANGE", CHANGE)] {
            assert_eq!(of_page(name), stops, "{name}");
        }
    }

    #[test]
    fn a_palette_goes_from_one_end_to_the_other() {
        for (name, layer) in Layer::ALL {
            let palette = layer.palette();
            assert_eq!(palette.len(), 3 * 256, "{name}");
            assert_ne!(palette[..3], palette[3 * 127..3 * 128], "{name}");
        }
        let probability = Layer::Probability.palette();
        assert_eq!((&probability[..3], &probability[3 * 254..3 * 255]), (&VIRIDIS[0][..], &VIRIDIS[8][..]));
        // The most uncertain cell is in the middle.
        assert_eq!(Layer::Entropy.palette()[3 * 127..3 * 128], CIVIDIS[8]);
        assert_eq!([0.0, 0.5, 1.0, 7.0, -1.0, f32::NAN].map(entry), [0, 127, 254, 254, 0, 0]);
    }
}
