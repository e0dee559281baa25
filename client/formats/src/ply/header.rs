//! The header of a PLY file.
//!
//! Invariant: the header has one element `vertex` with one x, y and z each, which are no lists, and a number of
//! vertices within the limit; a non-empty element has at least one property, so that it takes space in the file.

use crate::{
    POINTS_MAX,
    error::{FilePlace, FormatError, shown_start},
    scalar::{Endian, Scalar},
    text::{Line, Lines},
};

/// The header of a file.
pub(super) struct PlyHeader<'a> {
    /// The encoding of the elements.
    pub encoding: Encoding,
    /// The elements, in the order of the file.
    pub elements: Vec<Element<'a>>,
}

/// The encoding of elements.
#[derive(Clone, Copy)]
pub(super) enum Encoding {
    /// Text.
    Ascii,
    /// Bytes.
    Binary(Endian),
}

/// A group of equal records, such as vertices or faces.
pub(super) struct Element<'a> {
    /// Name of the group, as in the header.
    pub name: &'a str,
    /// Number of records.
    pub count: u64,
    /// The properties of each record.
    pub properties: Vec<Property<'a>>,
    /// Indices of the properties x, y and z, if the records are the points.
    pub points: Option<[usize; 3]>,
    line: u64,
}

/// A property of an element.
pub(super) struct Property<'a> {
    /// Name of the property, as in the header.
    pub name: &'a str,
    /// The kind: one number, or a list of numbers.
    pub kind: PropertyKind,
}

/// The type of a property.
#[derive(Clone, Copy)]
pub(super) enum PropertyKind {
    /// A number.
    Scalar(Scalar),
    /// A length, then that many numbers.
    List {
        /// The type of the length.
        count: Scalar,
        /// The type of the numbers.
        item: Scalar,
    },
}

impl Element<'_> {
    /// The coordinate of a point that a property contains.
    pub(super) fn axis(&self, property: usize) -> Option<usize> {
        self.points?.iter().position(|&index| index == property)
    }
}

/// Reads the lines of the header, including the last.
pub(super) fn read<'a>(bytes: &'a [u8], lines: &mut Lines<'a>) -> Result<PlyHeader<'a>, FormatError> {
    if !(bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r\n")) {
        return Err(FormatError::value(
            FilePlace::Byte(0),
            "the start of the file",
            shown_start(bytes),
            "\"ply\" and a line end, as in a PLY file",
        ));
    }
    lines.next_line()?;
    let mut encoding = None;
    let mut elements: Vec<Element<'a>> = Vec::new();
    loop {
        let line = lines.next_line()?.ok_or_else(|| {
            FormatError::missing(FilePlace::Line(lines.number()), "end_header", "the header of a PLY file ends with it")
        })?;
        let mut words = line.words();
        match words.next() {
            None | Some("comment" | "obj_info") => {}
            Some("format") if encoding.is_none() => encoding = Some(format(line)?),
            Some("element") => elements.push(Element {
                name: line.parse_name(words.next(), "the element's name")?,
                count: line.parse("the number of elements", words.next(), "a number from 0")?,
                properties: Vec::new(),
                points: None,
                line: line.number,
            }),
            Some("property") => match elements.last_mut() {
                Some(element) => element.properties.push(property(line)?),
                None => return Err(line.wrong("the line", line.text, "below the line of an element")),
            },
            Some("end_header") => break,
            Some(_) => {
                let right = "format (once), comment, obj_info, element, property or end_header";
                return Err(line.wrong("the line", line.text, right));
            }
        }
    }
    let end = FilePlace::Line(lines.number());
    let encoding = encoding
        .ok_or_else(|| FormatError::missing(end, "format", "for example \"format ascii 1.0\", below \"ply\""))?;
    if elements.iter().filter(|element| element.name == "vertex").count() != 1 {
        return Err(FormatError::missing(end, "element vertex", "the header announces the points with it, once"));
    }
    for element in &mut elements {
        check(element)?;
    }
    Ok(PlyHeader { encoding, elements })
}

fn format(line: Line<'_>) -> Result<Encoding, FormatError> {
    let words: Vec<&str> = line.words().skip(1).collect();
    match words[..] {
        ["ascii", "1.0"] => Ok(Encoding::Ascii),
        ["binary_little_endian", "1.0"] => Ok(Encoding::Binary(Endian::Little)),
        ["binary_big_endian", "1.0"] => Ok(Encoding::Binary(Endian::Big)),
        _ => {
            let right = "ascii, binary_little_endian or binary_big_endian, and 1.0";
            Err(line.wrong("format", &words.join(" "), right))
        }
    }
}

fn property(line: Line<'_>) -> Result<Property<'_>, FormatError> {
    let mut words = line.words().skip(1);
    let mut first = words.next();
    let scalar = |word: Option<&str>, integer: bool| {
        word.and_then(scalar).filter(|scalar| !integer || scalar.is_integer()).ok_or_else(|| {
            let right = if integer { "a type that counts, such as uchar" } else { "a type such as float or uchar" };
            line.wrong("the property's type", word.unwrap_or_default(), right)
        })
    };
    let kind = if first == Some("list") {
        let count = scalar(words.next(), true)?;
        first = words.next();
        PropertyKind::List { count, item: scalar(first, false)? }
    } else {
        PropertyKind::Scalar(scalar(first, false)?)
    };
    let name = line.parse_name(words.next(), "the property's name")?;
    match words.next() {
        None => Ok(Property { name, kind }),
        Some(word) => Err(line.wrong("the line's end", word, "after the property's name")),
    }
}

fn scalar(word: &str) -> Option<Scalar> {
    Some(match word {
        "char" | "int8" => Scalar::I8,
        "uchar" | "uint8" => Scalar::U8,
        "short" | "int16" => Scalar::I16,
        "ushort" | "uint16" => Scalar::U16,
        "int" | "int32" => Scalar::I32,
        "uint" | "uint32" => Scalar::U32,
        "float" | "float32" => Scalar::F32,
        "double" | "float64" => Scalar::F64,
        _ => return None,
    })
}

fn check(element: &mut Element<'_>) -> Result<(), FormatError> {
    let place = FilePlace::Line(element.line);
    if element.properties.is_empty() && element.count > 0 {
        let what = format!("a property of element {:?}", element.name);
        return Err(FormatError::missing(place, what, "an element has one or more"));
    }
    if element.name != "vertex" {
        return Ok(());
    }
    if element.count > POINTS_MAX {
        return Err(FormatError::too_many(place, "the number of points", element.count, POINTS_MAX));
    }
    let mut points = [0; 3];
    for (axis, name) in points.iter_mut().zip(["x", "y", "z"]) {
        // Some writers use capital letters.
        let has_small = element.properties.iter().any(|property| property.name == name);
        let is_axis = |property: &Property<'_>| match has_small {
            true => property.name == name,
            false => property.name.eq_ignore_ascii_case(name),
        };
        let mut found = element.properties.iter().enumerate().filter(|(_, property)| is_axis(property));
        match (found.next(), found.next()) {
            (Some((index, Property { kind: PropertyKind::Scalar(_), .. })), None) => *axis = index,
            (None, _) => {
                let what = format!("property {name} of element vertex");
                return Err(FormatError::missing(place, what, format!("for example \"property float {name}\"")));
            }
            _ => return Err(FormatError::value(place, format!("property {name}"), "a list or twice", "one number")),
        }
    }
    element.points = Some(points);
    Ok(())
}
