//! CSV files of landmarks and of image features.
//!
//! Landmarks: `place,name` and, for image features, `u_px,v_px,descriptor` with the descriptor in hexadecimal digits,
//! and at edges `along_m`; for markers, `number,x,y,z,qx,qy,qz,qw`. Features: `u_px,v_px,descriptor`.
//!
//! Invariant: a row is read completely, or its error is stated.

use std::str::FromStr;

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use tidemap_map::{
    landmark::{Descriptor, ImageFeature, Landmark, LandmarkKind},
    name::{PlaceName, StateName},
};

use super::{CsvHeader, Layout, RowError, RowPlace, RowRules, fields, shown};

/// A quaternion may be off by this much of a unit.
const UNIT_WITHIN: f64 = 1e-3;

/// A row of a file: its content, or its fault.
#[derive(Clone, Debug, PartialEq)]
pub struct CheckedRow<Content> {
    /// The place of the row in the file.
    pub at: RowPlace,
    /// The content, or the fault of the row.
    pub content: Result<Content, String>,
}

/// The columns of an image feature.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FeatureColumns {
    u: usize,
    v: usize,
    descriptor: usize,
    count: usize,
}

impl FeatureColumns {
    fn of(header: &CsvHeader<'_>) -> Result<Self, RowError> {
        let (u, v) = (header.column("u_px")?, header.column("v_px")?);
        Ok(Self { u, v, descriptor: header.column("descriptor")?, count: header.names.len() })
    }

    fn used(self) -> [usize; 3] {
        [self.u, self.v, self.descriptor]
    }

    fn read<Field: AsRef<str>>(self, fields: &[Field]) -> Result<ImageFeature, String> {
        let descriptor = fields[self.descriptor].as_ref().trim();
        let descriptor = descriptor.parse::<Descriptor>().map_err(|error| format!("descriptor {error}"))?;
        Ok(ImageFeature { u_px: number("u_px", fields, self.u)?, v_px: number("v_px", fields, self.v)?, descriptor })
    }
}

fn number<Field: AsRef<str>, Number: FromStr>(what: &str, fields: &[Field], column: usize) -> Result<Number, String> {
    let text = fields[column].as_ref().trim();
    text.parse().map_err(|_| format!("{what} {:?} is not a number", shown(text)))
}

impl Layout for FeatureColumns {
    const HEADER: &'static str = "u_px,v_px,descriptor";
    type Item = CheckedRow<ImageFeature>;

    fn new(header: &CsvHeader<'_>, _: &RowRules) -> Result<(Self, Vec<usize>), RowError> {
        let columns = Self::of(header)?;
        Ok((columns, columns.used().to_vec()))
    }

    fn row(&mut self, line: &[u8], at: RowPlace) -> (Self::Item, bool) {
        let content = fields(line, self.count).and_then(|fields| self.read(&fields));
        let is_whole = content.is_ok();
        (CheckedRow { at, content }, is_whole)
    }

    fn at(row: &Self::Item) -> RowPlace {
        row.at
    }
}

/// The columns of landmarks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LandmarkColumns {
    place: usize,
    name: usize,
    feature: Option<FeatureColumns>,
    along: Option<usize>,
    marker: Option<[usize; 8]>,
    count: usize,
}

impl Layout for LandmarkColumns {
    const HEADER: &'static str = "place,name,u_px,v_px,descriptor";
    type Item = CheckedRow<(PlaceName, Landmark)>;

    fn new(header: &CsvHeader<'_>, _: &RowRules) -> Result<(Self, Vec<usize>), RowError> {
        let marker = if header.has("number") {
            let mut columns = [0; 8];
            for (column, name) in columns.iter_mut().zip(["number", "x", "y", "z", "qx", "qy", "qz", "qw"]) {
                *column = header.column(name)?;
            }
            Some(columns)
        } else {
            None
        };
        let has_feature = marker.is_none() || header.has("descriptor");
        let columns = Self {
            place: header.column("place")?,
            name: header.column("name")?,
            feature: has_feature.then(|| FeatureColumns::of(header)).transpose()?,
            along: header.has("along_m").then(|| header.column("along_m")).transpose()?,
            marker,
            count: header.names.len(),
        };
        let of_feature = columns.feature.into_iter().flat_map(FeatureColumns::used);
        let of_marker = columns.marker.into_iter().flatten();
        let used = [columns.place, columns.name].into_iter().chain(of_feature).chain(columns.along).chain(of_marker);
        Ok((columns, used.collect()))
    }

    fn row(&mut self, line: &[u8], at: RowPlace) -> (Self::Item, bool) {
        let content = fields(line, self.count).and_then(|fields| self.read(&fields));
        let is_whole = content.is_ok();
        (CheckedRow { at, content }, is_whole)
    }

    fn at(row: &Self::Item) -> RowPlace {
        row.at
    }
}

impl LandmarkColumns {
    fn read<Field: AsRef<str>>(&self, fields: &[Field]) -> Result<(PlaceName, Landmark), String> {
        let given = |column: usize| !fields[column].as_ref().trim().is_empty();
        let place = PlaceName::parse(fields[self.place].as_ref().trim()).map_err(|error| format!("place {error}"))?;
        let name = StateName::new(fields[self.name].as_ref().trim()).map_err(|error| error.to_string())?;
        let along = self.along.filter(|&column| given(column));
        let kind = match (self.marker, self.feature) {
            (Some(marker), _) if given(marker[0]) => read_marker(marker, fields)?,
            (_, Some(feature)) => match along {
                Some(column) => {
                    let along_m = number("along_m", fields, column)?;
                    LandmarkKind::Path { along_m, feature: feature.read(fields)? }
                }
                None => LandmarkKind::Image(feature.read(fields)?),
            },
            _ => return Err("number is missing".to_owned()),
        };
        Ok((place, Landmark { name, kind, covariance: None }))
    }
}

fn read_marker<Field: AsRef<str>>(columns: [usize; 8], fields: &[Field]) -> Result<LandmarkKind, String> {
    let [number_column, numbers @ ..] = columns;
    let mut pose = [0.0_f64; 7];
    for ((value, column), what) in pose.iter_mut().zip(numbers).zip(["x", "y", "z", "qx", "qy", "qz", "qw"]) {
        *value = number(what, fields, column)?;
    }
    let [x, y, z, i, j, k, w] = pose;
    let turn = Quaternion::new(w, i, j, k);
    if !pose.iter().all(|value| value.is_finite()) || (turn.norm() - 1.0).abs() > UNIT_WITHIN {
        return Err(format!("the length of qx,qy,qz,qw is {}: it must be 1", turn.norm()));
    }
    let pose = Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(turn));
    Ok(LandmarkKind::Marker { number: number("number", fields, number_column)?, pose: Box::new(pose) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observation_file::read_rows;

    type Read = Result<(PlaceName, Landmark), String>;

    fn read(text: &str) -> Result<Vec<Read>, RowError> {
        Ok(read_rows::<LandmarkColumns>(text)?.into_iter().map(|row| row.content).collect())
    }

    #[test]
    fn each_kind_of_landmark_is_read() -> Result<(), RowError> {
        let text = "place,name,u_px,v_px,descriptor,along_m,number,x,y,z,qx,qy,qz,qw\n\
                    hall,1,10,-2.5,00ff,,,,,,,,,\n\
                    hall/lab,2,1,2,0a0B,3.5,,,,,,,,\n\
                    hall,tag,,,,,77,1,2,3,0,0,0,1\n";
        let rows = read(text)?;
        let kinds: Vec<_> =
            rows.iter().map(|row| row.as_ref().map(|(place, landmark)| (place.to_string(), &landmark.kind))).collect();
        let feature =
            |u_px, v_px, bytes: &[u8]| ImageFeature { u_px, v_px, descriptor: Descriptor::new(bytes).expect("valid") };
        let pose = Box::new(Isometry3::translation(1.0, 2.0, 3.0));
        assert_eq!(
            kinds,
            [
                Ok(("hall".to_owned(), &LandmarkKind::Image(feature(10.0, -2.5, &[0, 255])))),
                Ok((
                    "hall/lab".to_owned(),
                    &LandmarkKind::Path { along_m: 3.5, feature: feature(1.0, 2.0, &[10, 11]) }
                )),
                Ok(("hall".to_owned(), &LandmarkKind::Marker { number: 77, pose })),
            ]
        );
        Ok(())
    }

    #[test]
    fn an_error_names_what_is_wrong() -> Result<(), RowError> {
        for (row, words) in [
            ("hall,1,x,2,00", "u_px \"x\" is not a number"),
            ("hall,1,1,2,0", "descriptor"),
            ("hall,1,1,2,zz", "descriptor"),
            ("a//b,1,1,2,00", "place"),
            ("hall,,1,2,00", "empty"),
        ] {
            let wrong = read(&format!("place,name,u_px,v_px,descriptor\n{row}\n"))?.remove(0).expect_err("wrong");
            assert!(wrong.contains(words), "{wrong}");
        }
        let turned = "place,name,number,x,y,z,qx,qy,qz,qw\nhall,tag,7,1,2,3,0,0,0,2\n";
        assert_eq!(read(turned)?.remove(0).expect_err("wrong"), "the length of qx,qy,qz,qw is 2: it must be 1");
        Ok(())
    }
}
