//! The YAML file of a grid.
//!
//! The keys `image`, `resolution`, `origin`, `negate`, `occupied_thresh` and `free_thresh` are required, as in the map
//! servers; `mode` is trinary by default. Other keys are ignored. The last line needs no line end if every required key
//! has a value.
//!
//! Invariant: settings are finite and consistent: 0 <= free < occupied <= 1, a positive resolution, and a grid without
//! rotation.

use saphyr_parser::{Event, Parser};

use super::{super::error::shown, FilePlace, FormatError};

/// Maximum length of a YAML file; files of grids have a few hundred bytes.
const YAML_BYTES_MAX: usize = 64 * 1024;

/// The settings of a grid.
#[derive(Clone, Debug, PartialEq)]
pub struct GridSettings {
    /// The image file: absolute, or relative to the YAML file's folder.
    pub image: String,
    /// Length of a cell's side.
    pub resolution_m: f64,
    /// Lower left corner of the grid.
    pub origin_m: [f64; 2],
    /// Darkness above which a cell is occupied, from 0 white to 1 black.
    pub occupied_thresh: f64,
    /// Darkness below which a cell is free.
    pub free_thresh: f64,
    /// Whether white is occupied and black is free.
    pub negate: bool,
    /// The meaning of the pixels.
    pub mode: GridMode,
    /// Whether a pixel of value 205 is unknown in mode trinary, whatever the thresholds; no file states this.
    pub is_205_unknown: bool,
}

/// The meaning of the pixels of a grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GridMode {
    /// Free, occupied or unknown.
    Trinary,
    /// Probabilities.
    Scale,
    /// Probabilities in percent, or unknown.
    Raw,
}

impl GridMode {
    /// The name of the mode in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Trinary => "trinary",
            Self::Scale => "scale",
            Self::Raw => "raw",
        }
    }
}

/// An entry of the file.
struct YamlEntry {
    key: String,
    place: FilePlace,
    value: YamlValue,
}

enum YamlValue {
    Word(String),
    List(Vec<String>),
    Other,
}

/// Reads the YAML file of a grid.
pub fn read_settings(bytes: &[u8]) -> Result<GridSettings, FormatError> {
    if bytes.len() > YAML_BYTES_MAX {
        let place = FilePlace::Byte(YAML_BYTES_MAX as u64);
        return Err(FormatError::too_many(place, "the file's length", bytes.len() as u64, YAML_BYTES_MAX as u64));
    }
    let text = std::str::from_utf8(bytes).map_err(|error| {
        FormatError::value(FilePlace::Byte(error.valid_up_to() as u64), "a byte", "not UTF-8", "text")
    })?;
    let lines = text.lines().count() as u64;
    let entries = YamlEntries { entries: entries(text)?, lines };
    let image = entries.word("image", "the name of the image file")?;
    if image.0.is_empty() {
        return Err(FormatError::value(image.1, "image", "empty", "the name of the image file"));
    }
    let (resolution_m, place) = entries.number("resolution", "the side of a cell in metres, a positive number")?;
    if resolution_m <= 0.0 {
        return Err(FormatError::value(place, "resolution", resolution_m, "the side of a cell in metres, above 0"));
    }
    let (occupied_thresh, place) = entries.number("occupied_thresh", "a number from 0 to 1")?;
    let (free_thresh, _) = entries.number("free_thresh", "a number from 0 to 1")?;
    if !(0.0 <= free_thresh && free_thresh < occupied_thresh && occupied_thresh <= 1.0) {
        let found = format!("{occupied_thresh} with free_thresh {free_thresh}");
        return Err(FormatError::value(place, "occupied_thresh", found, "above free_thresh, both within 0 and 1"));
    }
    Ok(GridSettings {
        image: image.0.to_owned(),
        resolution_m,
        origin_m: entries.origin()?,
        occupied_thresh,
        free_thresh,
        negate: entries.negate()?,
        mode: entries.mode()?,
        is_205_unknown: false,
    })
}

struct YamlEntries {
    entries: Vec<YamlEntry>,
    lines: u64,
}

impl YamlEntries {
    fn find(&self, key: &str, right: &str) -> Result<&YamlEntry, FormatError> {
        let found = self.entries.iter().find(|entry| entry.key == key);
        found.ok_or_else(|| FormatError::missing(FilePlace::Line(self.lines), key, format!("write {right}")))
    }

    fn word(&self, key: &'static str, right: &str) -> Result<(&str, FilePlace), FormatError> {
        let entry = self.find(key, right)?;
        match &entry.value {
            YamlValue::Word(word) => Ok((word, entry.place)),
            YamlValue::List(_) | YamlValue::Other => {
                Err(FormatError::value(entry.place, key, "more than one value", right))
            }
        }
    }

    fn number(&self, key: &'static str, right: &str) -> Result<(f64, FilePlace), FormatError> {
        let (word, place) = self.word(key, right)?;
        number(word).map(|number| (number, place)).ok_or_else(|| FormatError::value(place, key, shown(word), right))
    }

    fn origin(&self) -> Result<[f64; 2], FormatError> {
        const RIGHT: &str = "three numbers: [x, y, yaw] of the lower left corner";
        let entry = self.find("origin", RIGHT)?;
        let YamlValue::List(words) = &entry.value else {
            return Err(FormatError::value(entry.place, "origin", "no list", RIGHT));
        };
        let numbers: Option<Vec<f64>> = words.iter().map(|word| number(word)).collect();
        match numbers.as_deref() {
            Some(&[x, y, 0.0]) => Ok([x, y]),
            Some([_, _, yaw]) => {
                let right = "0: rotated grids are not supported; rotate the image and set the yaw to 0";
                Err(FormatError::value(entry.place, "the yaw of origin", yaw, right))
            }
            _ => Err(FormatError::value(entry.place, "origin", shown(&words.join(", ")), RIGHT)),
        }
    }

    fn negate(&self) -> Result<bool, FormatError> {
        const RIGHT: &str = "0 or 1";
        let (word, place) = self.word("negate", RIGHT)?;
        match word.to_ascii_lowercase().as_str() {
            "0" | "false" | "no" | "off" => Ok(false),
            "1" | "true" | "yes" | "on" => Ok(true),
            _ => Err(FormatError::value(place, "negate", shown(word), RIGHT)),
        }
    }

    fn mode(&self) -> Result<GridMode, FormatError> {
        const RIGHT: &str = "trinary, scale or raw";
        if !self.entries.iter().any(|entry| entry.key == "mode") {
            return Ok(GridMode::Trinary);
        }
        let (word, place) = self.word("mode", RIGHT)?;
        let modes = [GridMode::Trinary, GridMode::Scale, GridMode::Raw];
        let found = modes.into_iter().find(|mode| mode.name().eq_ignore_ascii_case(word));
        found.ok_or_else(|| FormatError::value(place, "mode", shown(word), RIGHT))
    }
}

fn number(word: &str) -> Option<f64> {
    word.parse().ok().filter(|number: &f64| number.is_finite())
}

/// The entries of a YAML mapping.
fn entries(text: &str) -> Result<Vec<YamlEntry>, FormatError> {
    let mut events = Parser::new_from_str(text);
    let mut next = || match events.next_event() {
        None => Ok((Event::StreamEnd, FilePlace::Line(1))),
        Some(Ok((event, span))) => Ok((event, FilePlace::Line(span.start.line() as u64))),
        Some(Err(error)) => {
            let place = FilePlace::Line(error.marker().line() as u64);
            Err(FormatError::value(place, "the text", format!("no YAML ({})", error.info()), "YAML"))
        }
    };
    loop {
        match next()? {
            (Event::StreamStart | Event::DocumentStart(_), _) => {}
            (Event::MappingStart(..), _) => break,
            (_, place) => {
                return Err(FormatError::value(place, "the file", "no list of keys", "lines of \"key: value\""));
            }
        }
    }
    let mut entries: Vec<YamlEntry> = Vec::new();
    loop {
        let (key, place) = match next()? {
            (Event::MappingEnd, _) => return Ok(entries),
            (Event::Scalar(key, ..), place) => (key.into_owned(), place),
            (_, place) => return Err(FormatError::value(place, "a key", "no word", "a word")),
        };
        if entries.iter().any(|entry| entry.key == key) {
            return Err(FormatError::value(place, "the key", shown(&key), "there once"));
        }
        let value = match next()?.0 {
            Event::Scalar(word, ..) => YamlValue::Word(word.into_owned()),
            start @ (Event::SequenceStart(..) | Event::MappingStart(..)) => {
                let mut words = matches!(start, Event::SequenceStart(..)).then(Vec::new);
                let mut depth = 1;
                while depth > 0 {
                    match next()?.0 {
                        Event::SequenceStart(..) | Event::MappingStart(..) => (depth, words) = (depth + 1, None),
                        Event::SequenceEnd | Event::MappingEnd => depth -= 1,
                        Event::Scalar(word, ..) => {
                            if let Some(words) = &mut words {
                                words.push(word.into_owned());
                            }
                        }
                        Event::StreamEnd => break,
                        _ => words = None,
                    }
                }
                words.map_or(YamlValue::Other, YamlValue::List)
            }
            _ => YamlValue::Other,
        };
        entries.push(YamlEntry { key, place, value });
    }
}
