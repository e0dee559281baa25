//! Grids of map savers and other writers, and damaged grids.
//!
//! Invariant: the meaning of pixels is taken from the map servers' documentation, not from the code.

use proptest::prelude::*;

use super::{
    super::{
        cuts::{every_cut_is_refused, no_change_panics},
        picture::{MapPicture, PictureCell, PictureError, samples},
    },
    *,
};

const YAML: &str = "image: office.pgm\nmode: trinary\nresolution: 0.05\norigin: [-1.5, 2, 0]\nnegate: 0\n\
    occupied_thresh: 0.65\nfree_thresh: 0.196\n";

fn settings(changes: &[(&str, &str)]) -> Result<GridSettings, FormatError> {
    let mut yaml = YAML.to_owned();
    for (from, to) in changes {
        assert!(yaml.contains(from), "{from}");
        yaml = yaml.replace(from, to);
    }
    read_settings(yaml.as_bytes())
}

fn refused<T: std::fmt::Debug>(result: Result<T, FormatError>, text: &str) {
    match result {
        Ok(value) => panic!("{text}: {value:?}"),
        Err(error) => assert!(error.to_string().contains(text), "{error:?} should say {text}: {error}"),
    }
}

fn percents(grid: &Grid) -> Vec<i32> {
    grid.cells.iter().map(|&cell| percent(cell).map_or(-1, i32::from)).collect()
}

/// The probability that a cell is occupied; none if it is unknown.
fn percent(cell: GridCell) -> Option<u8> {
    match cell {
        GridCell::Unknown => None,
        GridCell::Free => Some(0),
        GridCell::Between { percent } => Some(percent),
        GridCell::Occupied => Some(100),
    }
}

#[test]
fn the_yaml_file_is_read_in_any_style() -> Result<(), FormatError> {
    let expected = GridSettings {
        image: "office.pgm".to_owned(),
        resolution_m: 0.05,
        origin_m: [-1.5, 2.0],
        occupied_thresh: 0.65,
        free_thresh: 0.196,
        negate: false,
        mode: GridMode::Trinary,
        is_205_unknown: false,
    };
    assert_eq!(settings(&[])?, expected);
    assert_eq!(settings(&[("mode: trinary\n", "")])?, expected);
    let other = "---\n# saved by hand\nfree_thresh: 1.96e-1\n\"image\": 'office.pgm'   # beside this file\norigin:\n\
        - -1.5\n- 2.0\n- 0.0\nresolution: 5.0e-2\r\nnegate: false\noccupied_thresh: .65\nlayers: {walls: [a, b]}\n";
    assert_eq!(read_settings(other.as_bytes())?, expected);
    assert_eq!(settings(&[("mode: trinary", "mode: Raw")])?.mode, GridMode::Raw);
    assert!(settings(&[("negate: 0", "negate: 1")])?.negate);
    Ok(())
}

#[test]
fn errors_in_the_yaml_file_name_the_place_and_what_would_be_right() {
    refused(read_settings(b""), "lines of \"key: value\"");
    refused(read_settings(b"- 1\n"), "lines of \"key: value\"");
    refused(read_settings(b"image: [\n"), "no YAML");
    refused(read_settings(&[0xff, b'\n']), "byte 0: a byte is not UTF-8");
    refused(read_settings(&vec![b' '; 100_000]), "the file's length is 100000; at most 65536");
    refused(settings(&[("[-1.5, 2, 0]", "[-1.5, 2, 0.1]")]), "line 4: the yaw of origin is 0.1; it has to be 0");
    refused(settings(&[("[-1.5, 2, 0]", "[-1.5, 2]")]), "line 4: origin is \"-1.5, 2\"; it has to be three numbers");
    refused(settings(&[("[-1.5, 2, 0]", "5")]), "origin is no list");
    refused(settings(&[("[-1.5, 2, 0]", "[1, 2, [0]]")]), "origin is no list");
    refused(settings(&[("resolution: 0.05\n", "")]), "resolution is missing");
    refused(settings(&[("0.05", "0")]), "line 3: resolution is 0");
    refused(settings(&[("0.05", "five")]), "line 3: resolution is \"five\"");
    refused(settings(&[("0.05", ".inf")]), "resolution is \".inf\"");
    refused(settings(&[("0.05", "[1, 2]")]), "resolution is more than one value");
    refused(settings(&[("negate: 0", "negate: maybe")]), "negate is \"maybe\"");
    refused(settings(&[("negate: 0\n", "")]), "negate is missing");
    refused(settings(&[("trinary", "binary")]), "mode is \"binary\"; it has to be trinary, scale or raw");
    refused(settings(&[("0.65", "0.1")]), "occupied_thresh is 0.1 with free_thresh 0.196");
    refused(settings(&[("negate: 0", "image: b.pgm")]), "line 5: the key is \"image\"");
    refused(settings(&[("office.pgm", "''")]), "image is empty");
}

#[test]
fn yaml_that_is_nested_without_end_is_borne() {
    for piece in ["[", "{", "- ", "? ", "a: {", "&a [", "\n - ", "!!", "|\n", "\"", "*a "] {
        let deep = format!("{YAML}deep: {}\n", piece.repeat(60_000 / piece.len()));
        let _ = read_settings(deep.as_bytes());
        let _ = read_settings(format!("{}\n", piece.repeat(60_000 / piece.len())).as_bytes());
    }
}

#[test]
fn the_top_row_of_the_image_has_the_largest_y() -> Result<(), FormatError> {
    let expected = [GridCell::Free, GridCell::Unknown, GridCell::Occupied, GridCell::Free];
    let text = b"P2\n# two by two\n2 2 # wide\n255\n0 254\n255 205\n";
    for image in [&b"P5\n2 2\n255\n\x00\xfe\xff\xcd"[..], b"P5 # a\n#b\n2\n2 255 \x00\xfe\xff\xcd\n", text] {
        let grid = read(&settings(&[])?, image)?;
        assert_eq!((grid.size_cells, grid.resolution_m, grid.origin_m), ([2, 2], 0.05, [-1.5, 2.0]));
        assert_eq!(grid.cells, expected);
    }
    // The picture with two bytes for each pixel, and with values from 0 to 15.
    let wide = [&b"P5\n2 2\n65535\n"[..], &[0, 0, 0xfe, 0xfe, 0xff, 0xff, 0xcd, 0xcd]].concat();
    assert_eq!(read(&settings(&[])?, &wide)?.cells, expected);
    assert_eq!(read(&settings(&[])?, b"P2 2 2 15 0 15\n14 12\n")?.cells, expected);
    Ok(())
}

#[test]
fn each_mode_means_what_map_servers_make_of_it() -> Result<(), FormatError> {
    let image = b"P5\n8 1\n255\n\x00\x32\x33\x64\x65\x99\xcd\xff";
    let read_as = |changes: &[(&str, &str)]| read(&settings(changes)?, image).map(|grid| percents(&grid));
    assert_eq!(read_as(&[])?, [100, 100, 100, -1, -1, -1, -1, 0]);
    assert_eq!(read_as(&[("negate: 0", "negate: 1")])?, [0, -1, -1, -1, -1, -1, 100, 100]);
    let all = [("trinary", "scale"), ("0.65", "1.0"), ("0.196", "0.0")];
    assert_eq!(read_as(&all)?, [100, 80, 80, 61, 60, 40, 20, 0]);
    // (1 - 100/255 - 0.196) / (0.65 - 0.196) is 0.9075.
    assert_eq!(read_as(&[("trinary", "scale")])?, [100, 100, 100, 91, 90, 45, 0, 0]);
    assert_eq!(read_as(&[("trinary", "raw")])?, [0, 50, 51, 100, -1, -1, -1, -1]);
    Ok(())
}

#[test]
fn errors_in_the_image_name_the_place_and_what_would_be_right() -> Result<(), FormatError> {
    let settings = settings(&[])?;
    refused(read(&settings, b""), "the file is empty");
    refused(read(&settings, b"\x89PNG\r\n"), "convert other images to PGM");
    refused(read(&settings, b"P5\n0 2\n255\n"), "the image's width is \"0\"; it has to be a number from 1");
    refused(read(&settings, b"P5\n2 x\n255\n"), "byte 5: the image's height is \"x\"");
    refused(read(&settings, b"P5\n2 2\n65536\n"), "the image's highest value is \"65536\"");
    refused(read(&settings, b"P5\n60000 60000\n255\n"), "the number of pixels is 3600000000; at most 50000000");
    refused(read(&settings, b"P5\n5000 5000\n255\n..."), "takes 25000000 bytes and 3 are there");
    refused(read(&settings, b"P2\n5000 5000\n255\n0 0"), "takes 50000000 bytes and 3 are there");
    refused(read(&settings, b"P5\n1 1\n255\n12"), "1 bytes follow the last pixel");
    refused(read(&settings, b"P5\n2 1\n7\n\x07\x08"), "byte 10: a pixel is 8; it has to be at most 7");
    refused(read(&settings, b"P2\n2 1\n7\n7 8\n"), "byte 11: a pixel is \"8\"");
    refused(read(&settings, b"P2\n2 1\n7\n7 -1\n"), "a pixel is \"-1\"");
    refused(read(&settings, b"P2\n2 1\n7\n7  1"), "no line end");
    refused(read(&settings, b"P2\n2 1\n7\n1234#\n"), "a pixel is \"1234\"");
    Ok(())
}

#[test]
fn cut_files_are_refused_wherever_they_are_cut() -> Result<(), FormatError> {
    let settings = settings(&[])?;
    let image = |bytes: &[u8]| read(&settings, bytes);
    for whole in
        [&b"P5\n2 2\n255\n\x00\xfe\xff\xcd"[..], b"P2\n# c\n2 2\n255\n0 254 255 205\n", b"P5 1 2 999 \0\0\x03\xe7"]
    {
        every_cut_is_refused(whole, image);
        no_change_panics(whole, image);
    }
    // Truncated before the end of the last key's value; from there on every key is present.
    let end = YAML.len() - "0.196\n".len();
    for length in 0..end {
        assert!(read_settings(&YAML.as_bytes()[..length]).is_err(), "cut off at byte {length}");
    }
    assert_eq!(read_settings(YAML.trim_end().as_bytes())?, settings);
    no_change_panics(YAML.as_bytes(), read_settings);
    Ok(())
}

fn back(picture: &MapPicture, mode: GridMode) -> Result<(Grid, String), Box<dyn std::error::Error>> {
    let files = write(picture, "office.pgm", mode, Thresholds::default())?;
    Ok((read(&read_settings(files.yaml.as_bytes())?, &files.image)?, files.yaml))
}

#[test]
fn a_written_grid_is_that_of_a_map_saver() -> Result<(), Box<dyn std::error::Error>> {
    let picture = samples::flat();
    let files = write(&picture, "office.pgm", GridMode::Trinary, Thresholds::default())?;
    assert_eq!(files.yaml, YAML.replace("2, 0]", "2.0, 0.0]"));
    assert_eq!(files.image, b"P5\n3 2\n255\n\xfe\xcd\x00\xfe\x00\xcd");
    let (grid, _) = back(&picture, GridMode::Trinary)?;
    assert_eq!((grid.size_cells, grid.origin_m), ([3, 2], [-1.5, 2.0]));
    assert_eq!(percents(&grid), [0, 100, -1, 0, -1, 100]);

    let files = write(&picture, "a: b.pgm", GridMode::Raw, Thresholds::default())?;
    assert_eq!(files.image, b"P5\n3 2\n255\n\x00\x32\x64\x00\x64\xff");
    assert_eq!(read_settings(files.yaml.as_bytes())?.image, "a: b.pgm");
    let (grid, yaml) = back(&picture, GridMode::Raw)?;
    assert!(yaml.contains("mode: raw\n"));
    assert_eq!(percents(&grid), [0, 100, -1, 0, 50, 100]);

    let unknown = write(&picture, "a.pgm", GridMode::Scale, Thresholds::default());
    assert_eq!(unknown, Err(PictureError::UnknownInScale { cell: 2 }));
    let turned = write(&picture, "a.pgm", GridMode::Trinary, Thresholds { free: 0.7, occupied: 0.6 });
    assert!(matches!(turned, Err(PictureError::Thresholds { .. })));
    Ok(())
}

#[test]
fn thresholds_are_those_of_whole_percents() -> Result<(), Box<dyn std::error::Error>> {
    let mut picture = samples::flat();
    for (cell, probability) in picture.cells.iter_mut().zip([0.25, 0.254, 0.26, 0.64, 0.646, 0.65]) {
        *cell = PictureCell::Changing { probability };
    }
    assert_eq!(percents(&back(&picture, GridMode::Trinary)?.0), [0, 0, -1, -1, 100, 100]);
    let files = write(&picture, "a.pgm", GridMode::Trinary, Thresholds { free: 0.63, occupied: 0.64 })?;
    let grid = read(&read_settings(files.yaml.as_bytes())?, &files.image)?;
    assert_eq!(percents(&grid), [0, 0, 0, 100, 100, 100], "the file's own thresholds stay what its pixels need");
    Ok(())
}

proptest! {
    #[test]
    fn probabilities_come_back(
        values in proptest::collection::vec(proptest::option::of(0.0_f32..=1.0), 1..40),
        resolution_m in 1e-9_f64..1e6,
        origin in any::<[i32; 2]>(),
    ) {
        let cells = values.iter().map(|value| match value {
            None => PictureCell::Unknown,
            Some(probability) => PictureCell::Changing { probability: *probability },
        });
        let origin_m = [f64::from(origin[0]) / 7.0, f64::from(origin[1]) * 1e-12, 0.0];
        let mut picture =
            MapPicture { size_cells: [values.len() as u32, 1, 1], resolution_m, origin_m, cells: cells.collect(), ..samples::flat() };
        let (grid, _) = back(&picture, GridMode::Raw).expect("raw");
        prop_assert_eq!((grid.resolution_m, &grid.origin_m[..]), (resolution_m, &origin_m[..2]));
        for (cell, value) in grid.cells.iter().zip(&values) {
            prop_assert_eq!(percent(*cell), value.map(|value| (f64::from(value) * 100.0).round() as u8));
        }
        picture.cells.iter_mut().filter(|cell| **cell == PictureCell::Unknown).for_each(|cell| {
            *cell = PictureCell::Static { probability: 0.0 };
        });
        let (grid, _) = back(&picture, GridMode::Scale).expect("scale");
        for (cell, value) in grid.cells.iter().zip(&values) {
            let percent = f64::from(percent(*cell).expect("no cell is unknown"));
            prop_assert!((percent - f64::from(value.unwrap_or(0.0)) * 100.0).abs() < 0.75);
        }
    }

    #[test]
    fn random_images_never_panic(
        header in "P[25][ \n][0-9]{1,5}[ \n][0-9]{1,5}[ \n][0-9]{1,5}[ \n]",
        body in proptest::collection::vec(any::<u8>(), 0..200),
    ) {
        let settings = settings(&[("trinary", "scale")]).expect("settings");
        let _ = read(&settings, &[header.as_bytes(), &body].concat());
        let _ = read(&settings, &[&b"P2 3 2 255 "[..], &body].concat());
        let _ = read(&settings, &[&b"P5 3 2 999 "[..], &body].concat());
    }

    #[test]
    fn random_settings_never_panic(
        tail in "(\\PC|[-:\\[\\]{}&*#?|>!%@`'\", \n\t]){0,80}",
        bytes in proptest::collection::vec(any::<u8>(), 0..200),
    ) {
        let _ = read_settings(format!("{YAML}{tail}\n").as_bytes());
        let _ = read_settings(format!("{tail}\n{YAML}").as_bytes());
        let _ = read_settings(&bytes);
        let _ = read_settings(&[bytes.as_slice(), b"\n"].concat());
    }
}

#[test]
fn the_pixel_of_the_unknown_is_free_above_a_free_threshold_of_one_fifth_and_counted() -> Result<(), FormatError> {
    let image = b"P5\n3 1\n255\n\xcd\xfe\x00";
    let cells = |settings: &GridSettings| read(settings, image).map(|grid| (grid.cells, grid.free_205));
    let known = [GridCell::Free, GridCell::Occupied];
    let with = |first: GridCell| [&[first][..], &known].concat();
    let low = settings(&[])?;
    assert_eq!(cells(&low)?, (with(GridCell::Unknown), 0));
    let quarter = settings(&[("free_thresh: 0.196", "free_thresh: 0.25")])?;
    assert_eq!(quarter.free_thresh, 0.25);
    assert_eq!(cells(&quarter)?, (with(GridCell::Free), 1), "as Nav2's map server reads it");
    assert_eq!(cells(&GridSettings { is_205_unknown: true, ..quarter.clone() })?, (with(GridCell::Unknown), 0));
    // In mode scale it is a probability, which no map saver writes for unknown.
    assert_eq!(cells(&GridSettings { mode: GridMode::Scale, ..quarter })?.1, 0);
    Ok(())
}
