//! Sightings of landmarks.
//!
//! Invariant: an invalid sighting is refused on its own, with a reason for programs and one in words.

use tidemap_map::{
    ids::RefusalReason,
    name::{InvalidName, StateName},
    sighting::{Sighting, SightingError},
};

use super::{
    landmarks::{place_from_wire, place_to_wire},
    traversals::{self, TraversalReport, refusal_of, report_to_wire, traversal_from_wire, traversal_to_wire},
};
use crate::v1::{self, landmark_place::Place};

/// Maximum number of bytes of a sighting on the wire in addition to its texts, and of a name in addition to its own.
const SIGHTING_BYTES_EXTRA: usize = 64;
const NAME_BYTES_EXTRA: usize = 6;

/// Advice how to find a valid name.
const WAY_OUT: &str = "LandmarkService has those there are, and can add more";

/// A checked sighting. Whether place and landmarks exist is not checked.
///
/// # Errors
/// The reason for programs, and the reason in words.
pub fn sighting_from_wire(wire: &v1::Sighting) -> Result<Sighting, (RefusalReason, String)> {
    let v1::Sighting { place, time_nanos, seen, out_of_view, traversal } = wire;
    let unknown = |error: &dyn std::fmt::Display| (RefusalReason::Landmark, format!("{error}; {WAY_OUT}"));
    let (place, part) = place_from_wire("place", place.as_ref()).map_err(|error| unknown(&error))?;
    let names = |names: &[String]| {
        let names: Result<Vec<StateName>, InvalidName> = names.iter().map(|name| StateName::new(name)).collect();
        names.map_err(|error| unknown(&error))
    };
    if *time_nanos < 0 {
        return Err(sighting_refusal(&SightingError::Before1970(*time_nanos)));
    }
    let traversal = traversal.as_ref().map(traversal_from_wire).transpose()?;
    Ok(Sighting {
        place,
        part,
        time_nanos: *time_nanos,
        seen: names(seen)?,
        out_of_view: names(out_of_view)?,
        traversal,
    })
}

/// A sighting for the wire.
#[must_use]
pub fn sighting_to_wire(sighting: &Sighting) -> v1::Sighting {
    let texts = |names: &[StateName]| names.iter().map(|name| name.as_str().to_owned()).collect();
    v1::Sighting {
        place: Some(place_to_wire(&sighting.place, sighting.part)),
        time_nanos: sighting.time_nanos,
        seen: texts(&sighting.seen),
        out_of_view: texts(&sighting.out_of_view),
        traversal: sighting.traversal.as_ref().map(traversal_to_wire),
    }
}

/// The refusal of an invalid sighting.
#[must_use]
pub fn sighting_refusal(error: &SightingError) -> (RefusalReason, String) {
    match error {
        SightingError::Traversal(error) => refusal_of(error),
        SightingError::Before1970(_) | SightingError::NotOnTheWay { .. } => (RefusalReason::Time, error.to_string()),
        SightingError::Landmark(_) => (RefusalReason::Landmark, format!("{error}; {WAY_OUT}")),
        SightingError::NamedTwice(_) | SightingError::Part { .. } | SightingError::OtherEdge { .. } => {
            (RefusalReason::Landmark, error.to_string())
        }
    }
}

fn place_texts(place: Option<&v1::LandmarkPlace>) -> [&str; 3] {
    match place.and_then(|place| place.place.as_ref()) {
        Some(Place::Node(node)) => [node, "", ""],
        Some(Place::Edge(v1::EdgeEnds { from, to, action, .. })) => [from, to, action],
        None => [""; 3],
    }
}

/// Bytes of a sighting's texts.
#[must_use]
pub fn text_bytes(sighting: &v1::Sighting) -> usize {
    let names = sighting.seen.iter().chain(&sighting.out_of_view).map(|name| name.len() + NAME_BYTES_EXTRA);
    let place: usize = place_texts(sighting.place.as_ref()).iter().map(|text| text.len()).sum();
    names.sum::<usize>() + place + sighting.traversal.as_ref().map_or(0, traversals::text_bytes)
}

/// Maximum number of bytes of a sighting in a message.
#[must_use]
pub(super) fn wire_bytes(sighting: &v1::Sighting) -> usize {
    2 * SIGHTING_BYTES_EXTRA + text_bytes(sighting)
}

/// Appends the bytes of a sighting that `Welcome.content_crc` covers.
pub(super) fn append_content(sighting: &v1::Sighting, bytes: &mut Vec<u8>) {
    let v1::Sighting { place, time_nanos, seen, out_of_view, traversal } = sighting;
    bytes.extend_from_slice(b"landmark");
    for text in place_texts(place.as_ref()).into_iter().filter(|text| !text.is_empty()) {
        bytes.push(b'/');
        bytes.extend_from_slice(text.as_bytes());
    }
    bytes.extend_from_slice(&time_nanos.to_le_bytes());
    let (from_m, to_m) = place.as_ref().map_or((None, None), |place| (place.from_m, place.to_m));
    for bound in [from_m, to_m] {
        bytes.extend_from_slice(&bound.unwrap_or(f64::NAN).to_le_bytes());
    }
    for (mark, names) in [(1, seen), (2, out_of_view)] {
        for name in names {
            bytes.push(mark);
            bytes.extend_from_slice(name.as_bytes());
        }
    }
    if let Some(traversal) = traversal {
        traversals::append_content(traversal, bytes);
    }
}

/// A sighting as a robot or a file reports it: names and times are not checked. The daemon replies to an invalid one
/// with a refusal, so that its sequence number is used up.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SightingReport {
    /// `N` for a node, `A/B` or `A/B/ACTION` for an edge.
    pub place: String,
    /// Part of the edge, metres from its beginning; absent: the whole.
    pub from_m: Option<f64>,
    /// End of the part, metres.
    pub to_m: Option<f64>,
    /// Time of the sighting, nanoseconds UTC.
    pub time_nanos: i64,
    /// Names of the landmarks that it saw.
    pub seen: Vec<String>,
    /// Names of those that it could not have seen.
    pub out_of_view: Vec<String>,
    /// The traversal during the sighting, of the edge that is the place: learned with the sighting, or both refused.
    pub traversal: Option<TraversalReport>,
}

impl SightingReport {
    /// The sighting for the wire.
    #[must_use]
    pub fn to_wire(&self) -> v1::Sighting {
        let Self { place, from_m, to_m, time_nanos, seen, out_of_view, traversal } = self.clone();
        let place = match place.splitn(3, '/').collect::<Vec<_>>().as_slice() {
            [from, to] => Place::Edge(v1::EdgeEnds { from: (*from).into(), to: (*to).into(), ..Default::default() }),
            [from, to, action] => Place::Edge(v1::EdgeEnds {
                from: (*from).into(),
                to: (*to).into(),
                action: (*action).into(),
                both_ways: false,
            }),
            _ => Place::Node(place),
        };
        let place = Some(v1::LandmarkPlace { place: Some(place), from_m, to_m });
        let traversal = traversal.as_ref().map(report_to_wire);
        v1::Sighting { place, time_nanos, seen, out_of_view, traversal }
    }

    /// The report for the wire.
    #[must_use]
    pub fn to_report(&self) -> v1::Report {
        v1::Report { report: Some(v1::report::Report::Sighting(self.to_wire())) }
    }

    /// Why the report is invalid, as far as this is known without the map. The daemon refuses it for the same reason.
    #[must_use]
    pub fn wrong(&self) -> Option<String> {
        sighting_from_wire(&self.to_wire()).err().map(|(_, text)| text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report() -> SightingReport {
        SightingReport {
            place: "hall/lab".to_owned(),
            from_m: Some(1.0),
            time_nanos: 5,
            seen: vec!["a".to_owned(), "b".to_owned()],
            out_of_view: vec!["c".to_owned()],
            ..SightingReport::default()
        }
    }

    #[test]
    fn a_sighting_comes_back() {
        let traversal = v1::Traversal {
            from: "hall".to_owned(),
            to: "lab".to_owned(),
            end_nanos: 7,
            success: true,
            ..v1::Traversal::default()
        };
        let node = SightingReport { place: "hall".to_owned(), from_m: None, ..report() }.to_wire();
        let with_action = SightingReport { place: "hall/lab/door".to_owned(), ..report() }.to_wire();
        for wire in
            [report().to_wire(), v1::Sighting { traversal: Some(traversal), ..report().to_wire() }, node, with_action]
        {
            assert_eq!(sighting_to_wire(&sighting_from_wire(&wire).expect("right")), wire);
        }
    }

    #[test]
    fn what_is_wrong_has_a_reason() {
        for (wrong, words) in [
            (SightingReport { place: String::new(), ..report() }, "name is empty"),
            (SightingReport { place: "a/b/c/d".to_owned(), ..report() }, "'/'"),
            (SightingReport { from_m: Some(-1.0), ..report() }, "-1 m"),
            (SightingReport { place: "hall".to_owned(), ..report() }, "only an edge has parts"),
            (SightingReport { seen: vec!["a/b".to_owned()], ..report() }, "a/b"),
            (SightingReport { time_nanos: -1, ..report() }, "before 1970"),
        ] {
            let text = wrong.wrong().expect("wrong");
            assert!(text.contains(words), "{text}");
        }
        assert_eq!(report().wrong(), None);
    }

    #[test]
    fn the_content_is_the_documented_bytes() {
        let mut bytes = Vec::new();
        append_content(&report().to_wire(), &mut bytes);
        let (one, nan) = (1.0_f64.to_le_bytes(), f64::NAN.to_le_bytes());
        let expected: [&[u8]; 7] =
            [b"landmark/hall/lab", &5_i64.to_le_bytes(), &one, &nan, b"\x01a", b"\x01b", b"\x02c"];
        assert_eq!(bytes, expected.concat());
    }
}
