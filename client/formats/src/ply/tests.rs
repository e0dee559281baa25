//! PLY files of every encoding, valid and invalid, and written files.
//!
//! Invariant: files for the reader are made by hand; written files are also read back.

use proptest::prelude::*;

use super::{
    super::{
        cuts::{every_cut_is_refused, no_change_panics},
        picture::{MapPicture, samples},
    },
    *,
};

const HEADER: &str = "comment made by hand\nobj_info none\nelement camera 1\nproperty float view\n\
    element vertex 3\nproperty uchar red\nproperty list uchar short extra\nproperty double y\nproperty float x\n\
    property int16 z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n";

fn ascii_file() -> String {
    format!("ply\nformat ascii 1.0\n{HEADER}1.5\n255 0 2 1 3\n0 2 7 8 nan 1 3\n9 1 5 -2.5 1e1 -3\n3 0 1 2\n0\n")
}

fn binary_file(big: bool) -> Vec<u8> {
    let name = if big { "binary_big_endian" } else { "binary_little_endian" };
    let mut file = format!("ply\nformat {name} 1.0\n{HEADER}").into_bytes();
    let mut put = |little: &[u8]| {
        if big {
            file.extend(little.iter().rev());
        } else {
            file.extend(little);
        }
    };
    put(&1.5_f32.to_le_bytes());
    for (red, extra, y, x, z) in
        [(255_u8, &[][..], 2.0_f64, 1.0_f32, 3_i16), (0, &[7_i16, 8], f64::NAN, 1.0, 3), (9, &[5], -2.5, 10.0, -3)]
    {
        put(&[red]);
        put(&[extra.len() as u8]);
        extra.iter().for_each(|item| put(&item.to_le_bytes()));
        put(&y.to_le_bytes());
        put(&x.to_le_bytes());
        put(&z.to_le_bytes());
    }
    put(&[3]);
    for index in 0..3_i32 {
        put(&index.to_le_bytes());
    }
    put(&[0]);
    file
}

fn refused(file: impl AsRef<[u8]>, text: &str) {
    match read(file.as_ref()) {
        Ok(points) => panic!("{text}: {points:?}"),
        Err(error) => assert!(error.to_string().contains(text), "{error:?} should say {text}: {error}"),
    }
}

#[test]
fn every_encoding_gives_the_same_points() -> Result<(), FormatError> {
    let expected = PointFile { points: vec![[1.0, 2.0, 3.0], [10.0, -2.5, -3.0]], not_finite: 1, pose: None };
    assert_eq!(read(ascii_file().as_bytes())?, expected);
    assert_eq!(read(ascii_file().replace('\n', "\r\n").as_bytes())?, expected);
    assert_eq!(read(&binary_file(false))?, expected);
    assert_eq!(read(&binary_file(true))?, expected);
    assert_eq!(read(&[binary_file(true), vec![b'\n']].concat())?, expected);
    let capitals = ascii_file().replace("float x", "float X").replace("double y", "double Y");
    assert_eq!(read(capitals.trim_end().as_bytes())?, expected, "capital letters, and no line end");
    Ok(())
}

#[test]
fn errors_name_the_place_and_what_would_be_right() {
    refused("", "the file is empty");
    refused("VERSION 0.7\n", "the start of the file is \"VERSION 0.7\"");
    refused(ascii_file().replace("ascii 1.0", "ascii 2.0"), "line 2: format is \"ascii 2.0\"");
    refused(ascii_file().replace("format ascii 1.0\n", ""), "format is missing");
    refused(ascii_file().replace("element vertex 3", "element vertex many"), "line 7: the number of elements is");
    refused(ascii_file().replace("element vertex 3", "element point 3"), "element vertex is missing");
    refused(ascii_file().replace("property float x", "property float w"), "property x of element vertex is missing");
    refused(ascii_file().replace("property float x", "property list uchar float x"), "property x is a list or twice");
    refused(ascii_file().replace("property float x", "property half x"), "the property's type is \"half\"");
    refused(ascii_file().replace("list uchar int", "list float int"), "a type that counts");
    refused(ascii_file().replace("obj_info none", "object none"), "line 4: the line is \"object none\"");
    refused(ascii_file().replace("end_header\n", ""), "is \"1.5\"");
    refused(ascii_file().replace("2 7 8 nan", "3 7 8 nan"), "line 18");
    refused(ascii_file().replace("255 0 2 1 3", "255 0 2 1"), "line 17: z is missing");
    refused(ascii_file().replace("255 0 2 1 3", "255 0 2 a 3"), "line 17: x is \"a\"");
    refused(ascii_file().replace("255 0 2 1 3", "255 0 2 1 3 4"), "the line's end is \"4\"");
    refused(ascii_file() + "1\n", "the line is \"1\"; it has to be absent");
    refused([binary_file(true), b" 1".to_vec()].concat(), "2 bytes follow the last element");
    let signed = "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\nproperty float y\n\
        property float z\nproperty list char uchar tail\nend_header\n";
    refused([signed.as_bytes(), &[0; 12], &[0xff]].concat(), "the length of list tail is -1");
}

#[test]
fn no_memory_is_taken_for_what_a_header_only_claims() {
    let claims = |count: &str| ascii_file().replace("element vertex 3", &format!("element vertex {count}"));
    refused(claims("50000000"), "element vertex of 50000000 at 10 bytes or more takes 500000000 bytes");
    refused(claims("18446744073709551615"), "at most 50000000 can be read");
    refused(ascii_file().replace("face 2", "face 18446744073709551615"), "takes 18446744073709551615 bytes and 11");
    let nothing = ascii_file().replace("element face 2\n", "element nothing 9999999999\nelement face 2\n");
    refused(nothing, "a property of element \"nothing\" is missing");
    refused(ascii_file().replace("255 0 2 1 3", "255 99999999999 2 1 3"), "line 17");
    let mut long = binary_file(false);
    let at = long.windows(11).position(|bytes| bytes == b"end_header\n").map_or(0, |at| at + 11 + 4 + 1);
    long[at] = 255;
    refused(long, "extra takes 510 bytes");
}

#[test]
fn a_cut_file_is_refused_wherever_it_is_cut() {
    // The end of the last line may be missing.
    every_cut_is_refused(ascii_file().trim_end().as_bytes(), read);
    every_cut_is_refused(&binary_file(false), read);
    every_cut_is_refused(&binary_file(true), read);
    no_change_panics(ascii_file().as_bytes(), read);
    no_change_panics(&binary_file(false), read);
    no_change_panics(&binary_file(true), read);
}

#[test]
fn coordinates_far_from_the_origin_are_doubles() -> Result<(), Box<dyn std::error::Error>> {
    let near = MapPicture { origin_m: [4_000.0, 0.0, 0.0], ..samples::flat() };
    assert!(String::from_utf8_lossy(&write(&near)?).contains("property float x"));
    // A float next to 5548000 has steps of half a metre.
    let far = MapPicture { origin_m: [458_000.0, 5_548_000.0, 0.0], ..samples::flat() };
    let file = write(&far)?;
    let header = b"property double z\nproperty float probability\n";
    assert!(file.windows(header.len()).any(|bytes| bytes == header));
    let end = b"end_header\n";
    let at = file.windows(end.len()).position(|bytes| bytes == end).ok_or("no header")? + end.len();
    let vertices: Vec<[f64; 3]> = file[at..]
        .chunks_exact(3 * 8 + 4 + 3)
        .map(|vertex| std::array::from_fn(|axis| Scalar::F64.read(vertex, 8 * axis, Endian::Little)))
        .collect();
    assert_eq!(vertices, far.known().map(|(centre, _)| centre).collect::<Vec<_>>());
    assert_eq!(read(&file)?.points.len(), vertices.len());
    Ok(())
}

#[test]
fn a_map_is_written_as_points() -> Result<(), Box<dyn std::error::Error>> {
    let file = write(&samples::flat())?;
    let points = read(&file)?.points;
    let expected = [
        [-1.475, 2.025, 0.025],
        [-1.425, 2.025, 0.025],
        [-1.475, 2.075, 0.025],
        [-1.425, 2.075, 0.025],
        [-1.375, 2.075, 0.025],
    ];
    assert_eq!(points, expected);
    // The last vertex: probability and colour.
    let last = &file[file.len() - 7..];
    assert_eq!(last[..4], 1.0_f32.to_le_bytes());
    assert_eq!(last[4..], [0; 3]);
    every_cut_is_refused(&file, read);
    Ok(())
}

proptest! {
    #[test]
    fn random_data_never_panics(kind in 0_usize..3, body in proptest::collection::vec(any::<u8>(), 0..200)) {
        let format = ["ascii", "binary_little_endian", "binary_big_endian"][kind];
        let header = format!("ply\nformat {format} 1.0\n{HEADER}").into_bytes();
        if let Ok(read) = read(&[header, body].concat()) {
            prop_assert_eq!(read.points.len() as u64 + read.not_finite, 3);
        }
    }

    #[test]
    fn random_headers_never_panic(
        lines in proptest::collection::vec(
            "comment|element (vertex|face) [0-9]{1,20}|property (list )?(uchar |int |float ){1,2}[xyz]|end_header",
            0..12,
        ),
    ) {
        let file = lines.join("\n");
        let _ = read(format!("ply\nformat ascii 1.0\n{file}").as_bytes());
        let _ = read(format!("ply\nformat binary_big_endian 1.0\n{file}").as_bytes());
    }
}
