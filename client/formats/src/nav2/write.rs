//! A flat map as a PGM image and its YAML file, as the map savers of ROS write them.
//!
//! Invariant: read back by this crate or by a map server, every cell has the value of its thresholds (mode trinary) or
//! its probability to half a percent (modes raw and scale), and unknown cells stay unknown.

use super::{GridCell, GridMode};
use crate::{MapPicture, PictureCell, PictureError};

/// The pixels of mode trinary, as map savers write them.
const FREE: u8 = 254;
const UNKNOWN: u8 = 205;
const OCCUPIED: u8 = 0;

/// The thresholds between free, unknown and occupied, for mode trinary.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Thresholds {
    /// Highest probability that is free, rounded to a percent.
    pub free: f64,
    /// Lowest probability that is occupied, rounded to a percent.
    pub occupied: f64,
}

/// The two files of a grid.
#[derive(Clone, Debug, PartialEq)]
pub struct GridFiles {
    /// The image.
    pub image: Vec<u8>,
    /// The settings of the image.
    pub yaml: String,
}

impl Default for Thresholds {
    /// The thresholds of the map savers.
    fn default() -> Self {
        Self { free: 0.25, occupied: 0.65 }
    }
}

impl Thresholds {
    /// The cell that a map server shows in mode trinary for a value; `None`: the value is unknown.
    pub(super) fn cell(self, value: Option<f64>) -> GridCell {
        match value.map(percent) {
            Some(value) if value <= percent(self.free) => GridCell::Free,
            Some(value) if value >= percent(self.occupied) => GridCell::Occupied,
            _ => GridCell::Unknown,
        }
    }
}

/// Both files; the YAML file refers to the image by `image_name`. The thresholds apply to mode trinary only.
pub fn write(
    picture: &MapPicture,
    image_name: &str,
    mode: GridMode,
    thresholds: Thresholds,
) -> Result<GridFiles, PictureError> {
    picture.check_flat()?;
    let Thresholds { free, occupied } = thresholds;
    if !(0.0 <= free && free < occupied && occupied <= 1.0) {
        return Err(PictureError::Thresholds { free, occupied });
    }
    let unknown = picture.cells.iter().position(|cell| *cell == PictureCell::Unknown);
    if let (GridMode::Scale, Some(cell)) = (mode, unknown) {
        return Err(PictureError::UnknownInScale { cell });
    }
    let pixel = |cell: &PictureCell| match (mode, picture.value_of(*cell).map(f64::from)) {
        (GridMode::Trinary, value) => match thresholds.cell(value) {
            GridCell::Free => FREE,
            GridCell::Occupied => OCCUPIED,
            GridCell::Unknown | GridCell::Between { .. } => UNKNOWN,
        },
        (GridMode::Raw, Some(value)) => percent(value),
        (GridMode::Raw | GridMode::Scale, None) => u8::MAX,
        (GridMode::Scale, Some(value)) => byte((1.0 - value) * 255.0),
    };
    let [width, height, _] = picture.size_cells;
    let mut image = format!("P5\n{width} {height}\n255\n").into_bytes();
    image.extend(picture.rows_from_top().flatten().map(pixel));
    // These thresholds make pixels 0, 205 and 254 occupied, unknown and free; a scale goes from white to black; raw
    // uses none.
    let (occupied_thresh, free_thresh) = if mode == GridMode::Scale { ("1.0", "0.0") } else { ("0.65", "0.196") };
    let [x, y, _] = picture.origin_m.map(decimal);
    let yaml = format!(
        "image: {}\nmode: {}\nresolution: {}\norigin: [{x}, {y}, 0.0]\nnegate: 0\noccupied_thresh: {occupied_thresh}\n\
         free_thresh: {free_thresh}\n",
        yaml_word(image_name),
        mode.name(),
        decimal(picture.resolution_m),
    );
    Ok(GridFiles { image, yaml })
}

fn percent(value: f64) -> u8 {
    byte(value * 100.0)
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "values are checked; what is not saturates")]
fn byte(value: f64) -> u8 {
    value.round() as u8
}

/// A number that every YAML parser recognises: with a decimal point, and without an exponent.
fn decimal(number: f64) -> String {
    let text = format!("{}", number + 0.0);
    if text.contains('.') { text } else { format!("{text}.0") }
}

/// A file's name, quoted if YAML requires it.
fn yaml_word(name: &str) -> String {
    let plain = |character: char| character.is_ascii_alphanumeric() || "_-./".contains(character);
    if name.starts_with(|first: char| first.is_ascii_alphabetic() || first == '/') && name.chars().all(plain) {
        return name.to_owned();
    }
    // YAML reads JSON strings.
    serde_json::Value::from(name).to_string()
}
