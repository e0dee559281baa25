//! The recordings of the experiment: where each lies in the folder of data, how it is read, and which days are asked.
//!
//! Invariant: the readings of a state ascend by time, and no two have the same time. A recording whose files are
//! missing is not an error; an invalid row is one.

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};

use tidemap_model::{LocalDay, LocalInstant, Sample, StateKind, Zone};

use super::{
    FieldError,
    recording::{ReadRecording, ReadState},
};
use crate::{data::Reader, place_recording::PlaceRecording, protocol::RowFormat};

const SEC_NANOS: i64 = 1_000_000_000;
/// The resolution of presence in places.
const SLOT_SECS: i64 = 600;

/// A recording of the field.
#[derive(Debug)]
pub struct FieldRecording {
    /// The name in results.
    pub name: &'static str,
    /// The time zone by whose clocks people live there.
    zone: &'static str,
    /// The number of test days: the last local days of the recording.
    test_days: i32,
    /// The unit of states of one kind that are scored together.
    unit: &'static str,
    /// Paths of the files in the folder of data, in the order of time; or one for each place.
    files: &'static [&'static str],
    source: FieldSource,
}

/// How the files of a recording are read.
#[derive(Clone, Copy, Debug)]
enum FieldSource {
    /// Columns time, state and value.
    Rows(StateKind),
    /// A time and a value of one state, without a header.
    Pairs(StateKind),
    /// Columns time, state and value, of binary states that hold their value; they are read at every step, seconds.
    Changes(i64),
    /// A column of local times, and columns that each are a state.
    Columns(&'static [(&'static str, StateKind)]),
    /// The place of a person in every minute from a local midnight, the date of which is given.
    Stays(&'static str),
    /// Not suited to the experiment, with the reason.
    Unsuited(&'static str),
}

const COUNTS: FieldSource = FieldSource::Columns(&[("count", StateKind::Count)]);

/// The recordings, in the order of results.
pub const FIELD_RECORDINGS: [FieldRecording; 11] = [
    FieldRecording {
        name: "door",
        zone: "Europe/London",
        test_days: 28,
        unit: "door",
        files: &["door/train.csv", "door/week1.csv", "door/week2.csv", "door/week3.csv", "door/week4.csv"],
        source: FieldSource::Rows(StateKind::Probability),
    },
    FieldRecording {
        name: "velocity",
        zone: "Europe/London",
        // The test begins on the first of these days at 16:33.
        test_days: 3,
        unit: "speed",
        files: &["velocity/train.txt", "velocity/test1.txt"],
        source: FieldSource::Pairs(StateKind::Continuous),
    },
    FieldRecording {
        name: "office",
        zone: "Europe/Brussels",
        test_days: 4,
        unit: "",
        files: &["field/office-occupancy/datatest.csv", "field/office-occupancy/datatraining.csv"],
        source: FieldSource::Columns(&[
            ("occupied", StateKind::Probability),
            ("light", StateKind::Continuous),
            ("co2", StateKind::Continuous),
            ("temperature", StateKind::Continuous),
        ]),
    },
    FieldRecording {
        name: "fremont",
        zone: "America/Los_Angeles",
        test_days: 182,
        unit: "",
        files: &["field/fremont/2013_2016.csv"],
        source: COUNTS,
    },
    FieldRecording {
        name: "bikes",
        zone: "America/New_York",
        test_days: 112,
        unit: "",
        files: &["field/bikes/2011_2012h1.csv"],
        source: COUNTS,
    },
    FieldRecording {
        name: "yosemite",
        zone: "America/Los_Angeles",
        test_days: 10,
        unit: "",
        files: &["field/yosemite/may.csv"],
        source: FieldSource::Columns(&[("celsius", StateKind::Continuous)]),
    },
    FieldRecording {
        name: "brayford",
        zone: "Europe/London",
        test_days: 2,
        unit: "places",
        files: &[
            "field/brayford/place0.csv",
            "field/brayford/place1.csv",
            "field/brayford/place2.csv",
            "field/brayford/place3.csv",
            "field/brayford/place4.csv",
        ],
        source: FieldSource::Rows(StateKind::Probability),
    },
    FieldRecording {
        name: "tro-door",
        // Its times are local ones, counted as if they were UTC.
        zone: "UTC",
        test_days: 2,
        unit: "door",
        files: &["field/tro-door/week.csv"],
        source: FieldSource::Changes(60),
    },
    FieldRecording {
        name: "aruba31",
        // Its times are local ones, counted as if they were UTC.
        zone: "UTC",
        test_days: 14,
        unit: "places",
        files: &["field/aruba31/weeks1_8.csv"],
        source: FieldSource::Changes(SLOT_SECS),
    },
    FieldRecording {
        name: "aruba",
        zone: "UTC",
        test_days: 14,
        unit: "places",
        files: &["aruba/presence_8weeks.txt"],
        source: FieldSource::Stays("2010-11-04"),
    },
    FieldRecording {
        name: "room",
        zone: "UTC",
        test_days: 1,
        unit: "features",
        files: &["room/train.csv.gz", "room/test.csv.gz"],
        source: FieldSource::Unsuited("it has six hours of one day, and no midnight lies between learning and asking"),
    },
];

impl FieldRecording {
    /// The recording of this name.
    pub fn named(name: &str) -> Option<&'static FieldRecording> {
        FIELD_RECORDINGS.iter().find(|recording| recording.name == name)
    }

    /// The recording in a folder of data; or why it is left out, in words.
    ///
    /// # Errors
    /// [`FieldError`] if a file is invalid.
    pub(super) fn read(&self, folder: &Path) -> Result<Result<ReadRecording, String>, FieldError> {
        let left_out = |why: String| Ok(Err(format!("{} is left out: {why}", self.name)));
        let files: Vec<PathBuf> = self.files.iter().map(|file| folder.join(file)).collect();
        if let Some(missing) = files.iter().find(|file| !file.is_file()) {
            return left_out(format!("there is no file {}", missing.display()));
        }
        let zone = Zone::named(self.zone).map_err(FieldError::setting)?;
        let mut states = States { zone: &zone, places: HashMap::new(), found: Vec::new() };
        match self.source {
            FieldSource::Rows(kind) => states.read_rows(RowFormat::Csv, kind, &files)?,
            FieldSource::Pairs(kind) => states.read_rows(RowFormat::Pairs, kind, &files)?,
            FieldSource::Changes(step_secs) => {
                states.read_rows(RowFormat::Csv, StateKind::Probability, &files)?;
                states.hold(step_secs * SEC_NANOS);
            }
            FieldSource::Columns(columns) => files.iter().try_for_each(|file| states.read_columns(columns, file))?,
            FieldSource::Stays(day) => {
                let first = LocalDay::parse(day).ok_or_else(|| FieldError::setting(format!("no date: {day}")))?;
                files.iter().try_for_each(|file| states.read_stays(first, file))?;
            }
            FieldSource::Unsuited(why) => return left_out(why.to_owned()),
        }
        let is_one_unit = !matches!(self.source, FieldSource::Columns(_));
        let read = states.found;
        Ok(Ok(ReadRecording::new(self.name, is_one_unit.then_some(self.unit), zone, self.test_days, read)))
    }
}

/// The states that were read so far.
struct States<'a> {
    zone: &'a Zone,
    places: HashMap<String, usize>,
    found: Vec<ReadState>,
}

impl States<'_> {
    fn state(&mut self, name: &str, kind: StateKind) -> &mut ReadState {
        let place = match self.places.get(name) {
            Some(&place) => place,
            None => {
                self.places.insert(name.to_owned(), self.found.len());
                self.found.push(ReadState { name: name.to_owned(), kind, samples: Vec::new() });
                self.found.len() - 1
            }
        };
        &mut self.found[place]
    }

    /// Adds a reading. Files of one recording may share a time, of which the first reading counts.
    fn add(&mut self, name: &str, kind: StateKind, sample: Sample) {
        let samples = &mut self.state(name, kind).samples;
        if samples.last().is_none_or(|last| last.utc_nanos < sample.utc_nanos) {
            samples.push(sample);
        }
    }

    fn read_rows(&mut self, format: RowFormat, kind: StateKind, files: &[PathBuf]) -> Result<(), FieldError> {
        let mut reader = Reader::all_states(format, kind, self.zone);
        for file in files {
            reader.read(file, |state, sample| {
                self.add(state, kind, sample);
                Ok(())
            })?;
        }
        Ok(())
    }

    /// Replaces changes by readings at multiples of a step of time, up to the last change of any state.
    fn hold(&mut self, step_nanos: i64) {
        let ends = self.found.iter().filter_map(|state| state.samples.last());
        let Some(end) = ends.map(|last| last.utc_nanos).max() else { return };
        let mut offsets = self.zone.offset_cache();
        for state in &mut self.found {
            let changes = std::mem::take(&mut state.samples);
            let begin = changes.first().map_or(end, |first| first.utc_nanos);
            let first = begin.div_euclid(step_nanos) + i64::from(begin.rem_euclid(step_nanos) > 0);
            let mut next = 0;
            for utc_nanos in (first..=end.div_euclid(step_nanos)).map(|step| step * step_nanos) {
                next += changes[next..].iter().take_while(|change| change.utc_nanos <= utc_nanos).count();
                if let Some(held) = next.checked_sub(1).and_then(|newest| changes.get(newest)) {
                    let offset_secs = offsets.offset_secs(utc_nanos);
                    state.samples.push(Sample { utc_nanos, offset_secs, value: held.value });
                }
            }
        }
    }

    fn read_columns(&mut self, columns: &[(&str, StateKind)], file: &Path) -> Result<(), FieldError> {
        let wrong = |why: String| FieldError::Setting(format!("{}: {why}", file.display()));
        let mut reader = csv::Reader::from_path(file).map_err(|error| wrong(error.to_string()))?;
        let headers = reader.headers().map_err(|error| wrong(error.to_string()))?.clone();
        let place = |name: &str| {
            let found = headers.iter().position(|header| header == name);
            found.ok_or_else(|| wrong(format!("column {name:?} is missing")))
        };
        let time = place("local_time")?;
        let places = columns.iter().map(|(name, _)| place(name)).collect::<Result<Vec<usize>, FieldError>>()?;
        let mut offsets = self.zone.offset_cache();
        let mut before = i64::MIN;
        for (line, row) in (2_u64..).zip(reader.records()) {
            let row = row.map_err(|error| wrong(error.to_string()))?;
            let text = &row[time];
            let utc_nanos = match self.zone.local_instant(text) {
                Some(LocalInstant::Once(nanos)) => nanos,
                // The second of the two hours follows the first in the file.
                Some(LocalInstant::Twice(first, second)) => {
                    if first > before {
                        first
                    } else {
                        second
                    }
                }
                Some(LocalInstant::Never) => continue,
                None => return Err(wrong(format!("line {line}: {text:?} is no local time"))),
            };
            before = utc_nanos;
            for (&(name, kind), &place) in columns.iter().zip(&places) {
                let value = row[place].parse().ok().filter(|&value| kind.allows(value));
                let value = value.ok_or_else(|| {
                    wrong(format!("line {line}: {name} {:?} is not {}", &row[place], kind.expected()))
                })?;
                self.add(name, kind, Sample { utc_nanos, offset_secs: offsets.offset_secs(utc_nanos), value });
            }
        }
        Ok(())
    }

    fn read_stays(&mut self, first: LocalDay, file: &Path) -> Result<(), FieldError> {
        let world = PlaceRecording::read(file, (SLOT_SECS / 60) as usize).map_err(FieldError::setting)?;
        let begin = self.zone.midnight_nanos(first);
        let mut offsets = self.zone.offset_cache();
        for slot in 0..world.days() * world.slots() {
            let seen = world.seen(slot);
            let utc_nanos = begin + (slot as i64 * SLOT_SECS + SLOT_SECS / 2) * SEC_NANOS;
            for (index, place) in world.places.iter().enumerate() {
                let value = f64::from(u8::from(index == seen));
                let sample = Sample { utc_nanos, offset_secs: offsets.offset_secs(utc_nanos), value };
                self.add(place, StateKind::Probability, sample);
            }
        }
        Ok(())
    }
}
