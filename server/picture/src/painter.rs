//! The painter of grids: it colours a cell by its probability and by the value of a layer.
//!
//! Invariant: in every layer a cell at the map's free level is white or nearly white, a cell at its occupied level is
//! black or nearly black, and an unknown cell is grey. So walls are visible in all layers. Layers differ only between
//! these levels.

use crate::{
    Colour, LegendRow,
    palette::{UNKNOWN, difference, entropy, occupancy},
    short,
};

/// The values that a picture of a grid shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Layer {
    /// The probability that a cell is occupied.
    #[default]
    Probability,
    /// The entropy of the probability that a cell is occupied, bits.
    Entropy,
    /// The probability that a cell is occupied, minus that of another time.
    Difference,
}

/// A known cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CellPaint {
    /// The probability that the cell is occupied.
    pub probability: f64,
    /// The value in the layer: the probability, its entropy from 0 to 1 bit, or a difference from -1 to 1.
    pub value: f64,
}

/// Paints the cells of a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Painter {
    layer: Layer,
    levels: (f64, f64),
}

impl Painter {
    /// A painter of a layer. `levels`: the probability after a free and after an occupied reading of the map's sensor,
    /// the first below the second. A cell that is always read free has the first level and is white, also if the sensor
    /// is poor.
    pub fn new(layer: Layer, levels: (f64, f64)) -> Self {
        Self { layer, levels }
    }

    /// The colour of a cell; `None`: the cell was never observed.
    pub fn colour(&self, cell: Option<CellPaint>) -> Colour {
        let Some(CellPaint { probability, value }) = cell else { return UNKNOWN };
        let (free, occupied) = self.levels;
        let beneath = (probability - free) / (occupied - free);
        match self.layer {
            Layer::Probability => occupancy(beneath),
            Layer::Entropy => entropy(value, beneath),
            Layer::Difference => difference(value, beneath),
        }
    }

    /// The meaning of the colours: the values of the layer, the map beneath them, and unknown cells.
    pub fn legend(&self) -> Vec<LegendRow> {
        const STEPS: u8 = 32;
        let steps = (0..=STEPS).map(|step| f64::from(step) / f64::from(STEPS));
        let (free, occupied) = self.levels;
        let walls =
            || LegendRow::new([0.0, 1.0].map(|beneath| entropy(0.0, beneath)).to_vec(), "certain: free, occupied");
        let still = || {
            LegendRow::new([0.0, 1.0].map(|beneath| difference(0.0, beneath)).to_vec(), "no difference: free, occupied")
        };
        let mut rows = match self.layer {
            Layer::Probability => {
                let text = format!("{} free ... {} occupied (probability)", short(free), short(occupied));
                vec![LegendRow::new(steps.map(occupancy).collect(), &text)]
            }
            Layer::Entropy => {
                let row = LegendRow::new(
                    steps.map(|bits| entropy(bits, 0.0)).collect(),
                    "0 certain ... 1 uncertain (entropy in bits)",
                );
                vec![row, walls()]
            }
            Layer::Difference => {
                let colours = steps.map(|share| difference(2.0 * share - 1.0, 0.0)).collect();
                let row = LegendRow::new(colours, "-1 freer ... 1 fuller (difference of the probability)");
                vec![row, still()]
            }
        };
        rows.push(LegendRow::new(vec![UNKNOWN], "unknown: not observed"));
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHITE: Colour = [255; 3];

    fn paint(layer: Layer, probability: f64, value: f64) -> Colour {
        Painter::new(layer, (0.0, 1.0)).colour(Some(CellPaint { probability, value }))
    }

    fn light(colour: Colour) -> u32 {
        colour.iter().map(|&band| u32::from(band)).sum()
    }

    #[test]
    fn free_is_white_occupied_black_and_unknown_grey() {
        let probability = |probability| paint(Layer::Probability, probability, probability);
        assert_eq!((probability(0.0), probability(1.0)), (WHITE, [0; 3]));
        for layer in [Layer::Probability, Layer::Entropy, Layer::Difference] {
            assert_eq!(Painter::new(layer, (0.0, 1.0)).colour(None), UNKNOWN, "{layer:?}");
        }
    }

    #[test]
    fn walls_stay_dark_below_other_layers_and_free_cells_white() {
        for layer in [Layer::Entropy, Layer::Difference] {
            assert_eq!(paint(layer, 0.0, 0.0), WHITE, "{layer:?}");
            assert!(light(paint(layer, 1.0, 0.0)) < 150, "{layer:?}");
            // A wall that is hardly uncertain or changed still differs from a free cell.
            assert!(light(paint(layer, 0.97, 0.2)) + 200 < light(paint(layer, 0.03, 0.2)), "{layer:?}");
        }
    }

    #[test]
    fn what_a_layer_shows_stands_out_in_a_colour_of_its_own() {
        let [r, _, b] = paint(Layer::Entropy, 0.5, 1.0);
        assert!(b > r + 100, "uncertain is blue-green");
        let ([fr, _, fb], [or, _, ob]) = (paint(Layer::Difference, 0.0, -1.0), paint(Layer::Difference, 1.0, 1.0));
        assert!(fb > fr + 100 && or > ob + 100, "freer is blue, fuller is orange");
    }

    #[test]
    fn what_a_poor_sensor_always_reads_the_same_is_white_or_black() {
        let painter = Painter::new(Layer::Probability, (0.25, 0.75));
        let colour = |probability| painter.colour(Some(CellPaint { probability, value: probability }));
        assert_eq!([0.1, 0.25, 0.75, 0.9].map(colour), [WHITE, WHITE, [0; 3], [0; 3]]);
        assert_eq!(colour(0.5), paint(Layer::Probability, 0.5, 0.5));
        assert!(painter.legend()[0].text.starts_with("0.25 free ... 0.75 occupied"), "{:?}", painter.legend());
    }

    #[test]
    fn a_legend_has_the_ends_of_its_layer_and_the_unknown() {
        for layer in [Layer::Probability, Layer::Entropy, Layer::Difference] {
            let rows = Painter::new(layer, (0.0, 1.0)).legend();
            let (first, last) = (&rows[0].colours, rows.last().expect("rows"));
            let value = |value: f64| paint(layer, if layer == Layer::Probability { value } else { 0.0 }, value);
            let low = if layer == Layer::Difference { -1.0 } else { 0.0 };
            assert_eq!((first[0], first[first.len() - 1]), (value(low), value(1.0)), "{layer:?}");
            assert_eq!((last.colours.as_slice(), last.text.contains("unknown")), (&[UNKNOWN][..], true));
        }
    }
}
