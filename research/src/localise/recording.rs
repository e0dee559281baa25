//! A recording of landmarks: pictures of places over months, as features, and the landmarks that were made of them.
//!
//! Four files in a folder: `images.csv` (place, month, date, time), `features.csv.gz` (place, month, index, u, v,
//! descriptor), `offsets.csv` (place, from_month, to_month, du), and `landmarks.csv.gz` (held_out, place, landmark, u,
//! v, seen, descriptor).
//! Invariant: each place has a picture in each month; places and months are counted from 0 inside.

use std::{
    fs::File,
    io::Read,
    path::{Path, PathBuf},
};

use flate2::read::GzDecoder;
use serde::{Deserialize, de::DeserializeOwned};
use tidemap_map::landmark::{DescriptorError, ImageFeature};
use tidemap_plan::localise::SeenFeatures;

use super::LocaliseError;

/// Maximum number of bytes of a file, uncompressed.
const FILE_BYTES_MAX: u64 = 256 * 1024 * 1024;
/// A landmark is seen again within these distances of where it is expected, pixels to the side and up or down.
const AGAIN_PX: [f64; 2] = [10.0, 15.0];

/// Why a recording cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{}: {wrong}", path.display())]
pub struct LandmarkRecordingError {
    /// The file.
    path: PathBuf,
    /// The fault, with the line.
    wrong: String,
}

/// A landmark of a place, made without the month held out.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct RecordedLandmark {
    /// In the frame of the first month.
    pub(super) feature: ImageFeature,
    /// For each month, whether the landmark was seen; `None`: the month held out.
    pub(super) seen: Vec<Option<bool>>,
}

/// A recording of landmarks.
#[derive(Clone, Debug)]
pub struct LandmarkRecording {
    /// The times of each place and month, nanoseconds UTC.
    times_nanos: Vec<Vec<i64>>,
    /// The features of the picture of each place and month.
    pictures: Vec<Vec<Vec<ImageFeature>>>,
    /// For each place and month: the shift of things to the right, against the first month, pixels.
    offsets_px: Vec<Vec<f64>>,
    /// By month held out and place.
    landmarks: Vec<Vec<Vec<RecordedLandmark>>>,
}

#[derive(Deserialize)]
struct ImageRow {
    place: usize,
    month: usize,
    time: i64,
}

#[derive(Deserialize)]
struct FeatureRow {
    place: usize,
    month: usize,
    u: f64,
    v: f64,
    descriptor: String,
}

#[derive(Deserialize)]
struct OffsetRow {
    place: usize,
    from_month: usize,
    to_month: usize,
    du: f64,
}

#[derive(Deserialize)]
struct LandmarkRow {
    held_out: usize,
    place: usize,
    u: f64,
    v: f64,
    seen: String,
    descriptor: String,
}

/// Reads the rows of a file, which may be compressed, and gives each to `take`, which returns its fault.
fn each_row<T: DeserializeOwned>(
    path: &Path,
    mut take: impl FnMut(T) -> Result<(), String>,
) -> Result<(), LandmarkRecordingError> {
    let wrong = |wrong: String| LandmarkRecordingError { path: path.to_owned(), wrong };
    let file = File::open(path).map_err(|error| wrong(error.to_string()))?;
    let plain: Box<dyn Read> = match path.extension().is_some_and(|ending| ending == "gz") {
        true => Box::new(GzDecoder::new(file)),
        false => Box::new(file),
    };
    let mut reader = csv::Reader::from_reader(plain.take(FILE_BYTES_MAX));
    for (row, line) in reader.deserialize().zip(2_u64..) {
        let row = row.map_err(|error| wrong(error.to_string()))?;
        take(row).map_err(|error| wrong(format!("line {line}: {error}")))?;
    }
    match reader.into_inner().limit() {
        0 => Err(wrong(format!("it has {FILE_BYTES_MAX} bytes or more, uncompressed"))),
        _ => Ok(()),
    }
}

/// The element at two numbers, which a file counts from 1.
fn counted<T>(rows: &mut [Vec<T>], first: usize, second: usize) -> Option<&mut T> {
    rows.get_mut(first.wrapping_sub(1)).and_then(|of_first| of_first.get_mut(second.wrapping_sub(1)))
}

fn no_picture(place: usize, month: usize) -> String {
    format!("place {place} in month {month} has no row in images.csv")
}

fn feature(u_px: f64, v_px: f64, hex: &str) -> Result<ImageFeature, String> {
    if !(u_px.is_finite() && v_px.is_finite()) {
        return Err(format!("the position {u_px}, {v_px} is not finite"));
    }
    let descriptor = hex.parse().map_err(|error: DescriptorError| error.to_string())?;
    Ok(ImageFeature { u_px, v_px, descriptor })
}

impl LandmarkRecording {
    /// Reads the files of a folder.
    ///
    /// # Errors
    /// [`LandmarkRecordingError`] with the file, the line and the fault.
    pub fn read(folder: &Path) -> Result<LandmarkRecording, LandmarkRecordingError> {
        let mut times: Vec<(usize, usize, i64)> = Vec::new();
        each_row(&folder.join("images.csv"), |row: ImageRow| {
            let nanos = row.time.checked_mul(1_000_000_000).ok_or_else(|| format!("time {}", row.time))?;
            times.push((row.place, row.month, nanos));
            Ok(())
        })?;
        let wrong = |wrong: String| LandmarkRecordingError { path: folder.join("images.csv"), wrong };
        times.sort_unstable();
        let last = |number: fn(&(usize, usize, i64)) -> usize| times.iter().map(number).max().unwrap_or(0);
        let (places, months) = (last(|row| row.0), last(|row| row.1));
        let all = (1..=places).flat_map(|place| (1..=months).map(move |month| (place, month)));
        if months < 3 || !all.eq(times.iter().map(|&(place, month, _)| (place, month))) {
            return Err(wrong("it needs one row for each place in each of at least three months".to_owned()));
        }
        let times_nanos: Vec<Vec<i64>> =
            times.chunks(months).map(|row| row.iter().map(|(.., nanos)| *nanos).collect()).collect();
        let mut pictures: Vec<Vec<Vec<ImageFeature>>> = vec![vec![Vec::new(); months]; places];
        each_row(&folder.join("features.csv.gz"), |row: FeatureRow| {
            let picture =
                counted(&mut pictures, row.place, row.month).ok_or_else(|| no_picture(row.place, row.month))?;
            picture.push(feature(row.u, row.v, &row.descriptor)?);
            Ok(())
        })?;
        let mut offsets_px = vec![vec![0.0; months]; places];
        each_row(&folder.join("offsets.csv"), |row: OffsetRow| {
            if row.from_month == 1 {
                let offset = counted(&mut offsets_px, row.place, row.to_month);
                *offset.ok_or_else(|| no_picture(row.place, row.to_month))? = row.du;
            }
            Ok(())
        })?;
        let mut landmarks: Vec<Vec<Vec<RecordedLandmark>>> = vec![vec![Vec::new(); places]; months];
        each_row(&folder.join("landmarks.csv.gz"), |row: LandmarkRow| {
            let of_month = |mark: char| match mark {
                '1' => Ok(Some(true)),
                '0' => Ok(Some(false)),
                '-' => Ok(None),
                other => Err(format!("{other:?} in seen is neither 1, 0 nor -")),
            };
            let seen: Vec<Option<bool>> = row.seen.chars().map(of_month).collect::<Result<_, _>>()?;
            if seen.len() != months || (1..=months).any(|month| seen[month - 1].is_none() != (month == row.held_out)) {
                return Err(format!("seen is {:?}: it needs {months} marks, and - for the month held out", row.seen));
            }
            let landmark = RecordedLandmark { feature: feature(row.u, row.v, &row.descriptor)?, seen };
            let of_place = counted(&mut landmarks, row.held_out, row.place);
            of_place.ok_or_else(|| no_picture(row.place, row.held_out))?.push(landmark);
            Ok(())
        })?;
        Ok(LandmarkRecording { times_nanos, pictures, offsets_px, landmarks })
    }

    /// Number of places.
    pub(super) fn places(&self) -> usize {
        self.pictures.len()
    }

    /// Number of months.
    pub(super) fn months(&self) -> usize {
        self.landmarks.len()
    }

    /// The time of a picture, nanoseconds UTC.
    pub(super) fn time_nanos(&self, place: usize, month: usize) -> i64 {
        self.times_nanos[place][month]
    }

    /// The features of a picture.
    pub(super) fn picture(&self, place: usize, month: usize) -> &[ImageFeature] {
        &self.pictures[place][month]
    }

    /// The shift of things to the right in a picture, against the first month, pixels.
    pub(super) fn offset_px(&self, place: usize, month: usize) -> f64 {
        self.offsets_px[place][month]
    }

    /// The landmarks of each place that were made without a month.
    pub(super) fn held_out(&self, month: usize) -> &[Vec<RecordedLandmark>] {
        &self.landmarks[month]
    }

    /// The landmarks of a place that are seen in its picture of a month.
    pub(super) fn seen_again(
        &self,
        landmarks: &[Vec<RecordedLandmark>],
        place: usize,
        month: usize,
    ) -> Result<Vec<bool>, LocaliseError> {
        let seen = SeenFeatures::new(self.picture(place, month).to_vec())?;
        let offset_px = self.offset_px(place, month);
        let is_seen = |landmark: &RecordedLandmark| {
            seen.clearly_nearest(&landmark.feature.descriptor).is_some_and(|feature| {
                (feature.u_px - offset_px - landmark.feature.u_px).abs() <= AGAIN_PX[0]
                    && (feature.v_px - landmark.feature.v_px).abs() <= AGAIN_PX[1]
            })
        };
        Ok(landmarks[place].iter().map(is_seen).collect())
    }
}
