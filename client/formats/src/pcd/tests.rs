//! PCD files of every form, valid and invalid.
//!
//! Invariant: every file is made by hand, so that no error of a writer can hide an error of the reader.

use proptest::prelude::*;

use super::{
    super::cuts::{every_cut_is_refused, no_change_panics},
    *,
};

fn header(fields: &str, sizes: &str, types: &str, points: usize, data: &str) -> String {
    let ones = vec!["1"; fields.split(' ').count()].join(" ");
    format!(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {types}\n\
         COUNT {ones}\nWIDTH {points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\nDATA {data}\n"
    )
}

fn ascii_file() -> String {
    header("x y z", "4 4 4", "F F F", 3, "ascii") + "1 2 3\nnan nan nan\n-1.5 2.25e1 +3\n"
}

fn binary_file() -> Vec<u8> {
    // An intensity before, padding between, z before y, x in double precision.
    let mut file = header("i x _ z y", "2 8 4 4 2", "U F U F I", 2, "binary").into_bytes();
    for (x, y, z) in [(1.5_f64, -2_i16, 3.25_f32), (f64::INFINITY, 1, 1.0)] {
        file.extend(7_u16.to_le_bytes());
        file.extend(x.to_le_bytes());
        file.extend(99_u32.to_le_bytes());
        file.extend(z.to_le_bytes());
        file.extend(y.to_le_bytes());
    }
    file
}

/// Compressed by hand: literals only.
fn compressed_file(padding: bool) -> Vec<u8> {
    let mut fields: Vec<u8> = Vec::new();
    fields.extend([1.0_f32, 2.0].iter().flat_map(|x| x.to_le_bytes()));
    if padding {
        fields.extend([0; 2 * 4]);
    }
    fields.extend([3.0_f64, 4.0].iter().flat_map(|y| y.to_le_bytes()));
    fields.extend([5_i8, -6].iter().flat_map(|z| z.to_le_bytes()));
    let packed: Vec<u8> = fields.chunks(32).flat_map(|piece| [&[(piece.len() - 1) as u8], piece].concat()).collect();
    let mut file = header("x _ y z", "4 4 8 1", "F F F I", 2, "binary_compressed").into_bytes();
    file.extend((packed.len() as u32).to_le_bytes());
    file.extend((fields.len() as u32).to_le_bytes());
    file.extend(packed);
    file
}

fn refused(file: impl AsRef<[u8]>, text: &str) {
    match read(file.as_ref()) {
        Ok(points) => panic!("{text}: {points:?}"),
        Err(error) => assert!(error.to_string().contains(text), "{error:?} should say {text}: {error}"),
    }
}

#[test]
fn ascii_is_read_and_what_is_not_finite_counted() -> Result<(), FormatError> {
    let expected = PointFile { points: vec![[1.0, 2.0, 3.0], [-1.5, 22.5, 3.0]], not_finite: 1, pose: None };
    assert_eq!(read(ascii_file().as_bytes())?, expected);
    assert_eq!(read(ascii_file().replace('\n', "\r\n").as_bytes())?, expected);
    let others = header("a z y x", "4 4 4 4", "F U I F", 1, "ascii").replace("COUNT 1", "COUNT 2") + "9 9 3 2 1\n";
    assert_eq!(read(others.as_bytes())?.points, [[1.0, 2.0, 3.0]]);
    let none = header("x y z", "4 4 4", "F F F", 0, "ascii");
    assert_eq!(read(none.as_bytes())?, PointFile::default());
    Ok(())
}

#[test]
fn binary_fields_of_any_type_are_found() -> Result<(), FormatError> {
    let expected = PointFile { points: vec![[1.5, -2.0, 3.25]], not_finite: 1, pose: None };
    assert_eq!(read(&binary_file())?, expected);
    let padded = [binary_file(), vec![0; 5]].concat();
    assert_eq!(read(&padded)?, expected, "zeros behind the data are padding");
    refused([binary_file(), vec![1]].concat(), "1 bytes follow the last point");
    Ok(())
}

#[test]
fn compressed_data_is_unpacked() -> Result<(), FormatError> {
    for padding in [false, true] {
        assert_eq!(read(&compressed_file(padding))?.points, [[1.0, 3.0, 5.0], [2.0, 4.0, -6.0]], "{padding}");
    }
    let mut wrong = compressed_file(true);
    let at = wrong.windows(5).position(|bytes| bytes == b"ssed\n").map_or(0, |at| at + 5 + 4);
    wrong[at] += 1;
    refused(wrong, "for 2 points");
    Ok(())
}

#[test]
fn the_viewpoint_is_the_pose() -> Result<(), FormatError> {
    let posed = ascii_file().replace("VIEWPOINT 0 0 0 1 0 0 0", "VIEWPOINT 1 -2 3.5 0.6 0 0.8 0");
    let pose = read(posed.as_bytes())?.pose;
    assert_eq!(pose.map(|pose| pose.translation.vector.into()), Some([1.0, -2.0, 3.5]));
    assert_eq!(pose.map(|pose| pose.rotation.coords.into()), Some([0.0, 0.8, 0.0, 0.6]));
    let moved = ascii_file().replace("VIEWPOINT 0 0 0", "VIEWPOINT 0 0 1");
    assert!(read(moved.as_bytes())?.pose.is_some());
    let absent = ascii_file().replace("VIEWPOINT 0 0 0 1 0 0 0\n", "");
    assert_eq!(read(absent.as_bytes())?.pose, None);
    refused(ascii_file().replace("0 0 0 1 0 0 0", "0 0 0 0 0 0 0"), "quaternion is 0; it has to be 1");
    refused(ascii_file().replace("0 0 0 1 0 0 0", "0 0 0 1 0 0"), "seven finite numbers");
    refused(ascii_file().replace("0 0 0 1 0 0 0", "0 0 inf 1 0 0 0"), "seven finite numbers");
    Ok(())
}

#[test]
fn errors_name_the_place_and_what_would_be_right() {
    refused("", "the file is empty");
    refused("ply\n", "the start of the file is \"ply\"");
    refused(ascii_file().replace("0.7\nF", "0.8\nF"), "line 2: VERSION is \"0.8\"; it has to be 0.5, 0.6 or 0.7");
    refused(ascii_file().replace("x y z\n", "X Y Q\n"), "the field z is missing");
    refused(ascii_file().replace("x y z\n", "X Y Z Z\n").replace("4\n", "4 4\n"), "the number of values of TYPE");
    refused(ascii_file().replace("FIELDS x y z", "FIELDS x y q"), "line 3: the field z is missing");
    refused(ascii_file().replace("FIELDS x y z", "FIELDS x y y"), "line 3: a field's name is \"y\"");
    refused(ascii_file().replace("SIZE 4 4 4", "SIZE 4 4"), "line 4: the number of values of SIZE is 2");
    refused(ascii_file().replace("SIZE 4", "SIZE 3"), "F of 3 bytes");
    refused(ascii_file().replace("TYPE F", "TYPE X"), "line 5: the type of field \"x\" is \"X of 4 bytes\"");
    refused(ascii_file().replace("COUNT 1", "COUNT 2"), "COUNT is 2; it has to be 1 for x, y and z");
    refused(ascii_file().replace("COUNT 1", "COUNT 0"), "COUNT is 0");
    refused(ascii_file().replace("POINTS 3", "POINTS 4"), "POINTS is 4; it has to be 3");
    refused(ascii_file().replace("HEIGHT 1", "HEIGHT 1\nHEIGHT 1"), "line 9: the entry is \"HEIGHT\"");
    refused(ascii_file().replace("HEIGHT", "DEPTH"), "the first word is \"DEPTH\"");
    refused(ascii_file().replace("DATA ascii", "DATA text"), "DATA is \"text\"");
    refused(ascii_file().replace("1 2 3\n", "1 2\n"), "line 12: the line is 2 values; it has to be 3 values");
    refused(ascii_file().replace("1 2 3\n", "1 2 b\n"), "line 12: z is \"b\"; it has to be a number");
    refused(ascii_file() + "1 2 3\n", "line 15: the number of points is more than 3");
    refused(&ascii_file()[..ascii_file().len() - 16], "line 13: the last line has no line end");
}

#[test]
fn files_of_other_writers_are_read() -> Result<(), FormatError> {
    let expected = read(ascii_file().as_bytes())?;
    let capitals = ascii_file().replace("x y z", "X Y Z");
    assert_eq!(read(capitals.as_bytes())?, expected);
    for version in [".5", "0.5", ".6", ".7"] {
        let older = capitals.replace("VERSION 0.7", &format!("VERSION {version}"));
        assert_eq!(read(older.replace("VIEWPOINT 0 0 0 1 0 0 0\n", "").trim_end().as_bytes())?, expected);
    }
    // A field that is only spelt like a coordinate.
    let both = header("x y z X", "4 4 4 4", "F F F F", 1, "ascii") + "1 2 3 9";
    assert_eq!(read(both.as_bytes())?.points, [[1.0, 2.0, 3.0]]);
    Ok(())
}

#[test]
fn no_memory_is_taken_for_what_a_header_only_claims() {
    let claims = |points: &str| ascii_file().replace("WIDTH 3", &format!("WIDTH {points}")).replace("POINTS 3\n", "");
    refused(claims("40000000"), "data of 40000000 points takes 240000000 bytes and 33 are there");
    refused(claims("18446744073709551615"), "at most 50000000 can be read");
    refused(claims("40000000").replace("ascii", "binary"), "takes 480000000 bytes");
    refused(ascii_file().replace("COUNT 1 1 1", "COUNT 1 1 99999999999999999999"), "COUNT is \"99999999999999999999\"");
    let padded = ascii_file().replace("x y z", "x y z _").replace("4 4 4", "4 4 4 8").replace("F F F", "F F F F");
    refused(padded.replace("1 1 1", "1 1 1 4294967295"), "the length of a point is");
    let mut bomb = header("x y z", "4 4 4", "F F F", 40_000_000, "binary_compressed").into_bytes();
    bomb.extend(2_u32.to_le_bytes());
    bomb.extend(480_000_000_u32.to_le_bytes());
    bomb.extend([0, 0]);
    refused(bomb, "at most 88 times the packed length 2");
}

#[test]
fn a_cut_file_is_refused_wherever_it_is_cut() {
    // The end of the last line may be missing.
    every_cut_is_refused(ascii_file().trim_end().as_bytes(), read);
    every_cut_is_refused(&binary_file(), read);
    every_cut_is_refused(&compressed_file(true), read);
    no_change_panics(ascii_file().as_bytes(), read);
    no_change_panics(&binary_file(), read);
    no_change_panics(&compressed_file(false), read);
}

proptest! {
    #[test]
    fn random_data_never_panics(
        kind in 0_usize..3,
        points in 0_usize..6,
        body in proptest::collection::vec(any::<u8>(), 0..200),
        length in any::<u8>(),
    ) {
        let data = ["ascii", "binary", "binary_compressed"][kind];
        let mut file = header("x y z q", "4 8 2 1", "F F U I", points, data).into_bytes();
        if kind == 2 {
            file.extend((body.len() as u32).to_le_bytes());
            file.extend(u32::from(length).to_le_bytes());
        }
        file.extend(body);
        if let Ok(read) = read(&file) {
            prop_assert_eq!(read.points.len() as u64 + read.not_finite, points as u64);
        }
    }

    #[test]
    fn random_files_never_panic(file in proptest::collection::vec(any::<u8>(), 0..300)) {
        let _ = read(&[b"# .PCD v0.7\n", file.as_slice()].concat());
        let _ = read(&file);
    }

    #[test]
    fn points_come_back(points in proptest::collection::vec(any::<[f32; 3]>(), 0..40)) {
        let mut file = header("x y z", "4 4 4", "F F F", points.len(), "binary").into_bytes();
        file.extend(points.iter().flatten().flat_map(|value| value.to_le_bytes()));
        let text = header("x y z", "4 4 4", "F F F", points.len(), "ascii")
            + &points.iter().map(|[x, y, z]| format!("{x} {y} {z}\n")).collect::<String>();
        let kept: Vec<[f32; 3]> = points.iter().copied().filter(|point| point.iter().all(|x| x.is_finite())).collect();
        let (binary, ascii) = (read(&file).expect("binary"), read(text.as_bytes()).expect("ascii"));
        prop_assert_eq!(&binary.points, &kept);
        prop_assert_eq!(binary.not_finite as usize, points.len() - kept.len());
        prop_assert_eq!(ascii, binary);
    }
}
