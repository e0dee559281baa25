//! Tests the value that a sighting has for each landmark.

use super::*;
use crate::{
    landmark::{Descriptor, ImageFeature, LandmarkEdit, LandmarkKind},
    name::EdgeName,
    report::Report,
    site::SiteEdit,
    topology::{EdgeEnds, Extent, NewEdge, NewNode, TopologyEdit},
};

fn name(text: &str) -> StateName {
    StateName::new(text).expect("a name")
}

fn place(text: &str) -> PlaceName {
    PlaceName::parse(text).expect("a place")
}

/// Node a with the landmarks 1, 2 and 3; edge a/b of 10 m with landmarks p2, p5 and p8 at 2, 5 and 8 m.
fn site() -> Site {
    let feature = ImageFeature { u_px: 1.0, v_px: 2.0, descriptor: Descriptor::new(&[7]).expect("a descriptor") };
    let at_node = |text| Landmark { name: name(text), kind: LandmarkKind::Image(feature), covariance: None };
    let along = |text: &str, along_m| Landmark {
        name: name(text),
        kind: LandmarkKind::Path { along_m, feature },
        covariance: None,
    };
    let add = |at: &str, landmarks: Vec<Landmark>| {
        let (place, descriptor_kind) = (place(at), "orb".to_owned());
        SiteEdit::Landmarks(LandmarkEdit::Add { place, descriptor_kind, landmarks, velocity_profile: None })
    };
    let node = |text| NewNode { name: name(text), pose: None, dwell_secs: None };
    let edge = NewEdge { ends: EdgeEnds::link(name("a"), name("b")), extent: Extent::metres(10.0) };
    let load = TopologyEdit::Load { nodes: ["a", "b"].map(node).to_vec(), edges: vec![edge], replaces: true };
    let mut site = Site::default();
    let edits = [
        SiteEdit::Topology(load),
        add("a", ["1", "2", "3"].map(at_node).to_vec()),
        add("a/b", vec![along("p2", 2.0), along("p5", 5.0), along("p8", 8.0)]),
    ];
    edits.iter().for_each(|edit| site.apply(edit, 0).expect("valid"));
    site
}

fn sighting(at: &str, seen: &[&str], out_of_view: &[&str]) -> Sighting {
    let names = |names: &[&str]| names.iter().map(|text| name(text)).collect();
    Sighting {
        place: place(at),
        part: PartOfEdge::WHOLE,
        time_nanos: 9,
        seen: names(seen),
        out_of_view: names(out_of_view),
        traversal: None,
    }
}

fn values(sighting: &Sighting) -> Vec<(String, f64)> {
    let samples = sighting.samples(&site()).expect("valid");
    samples.into_iter().map(|sample| (sample.state.to_string(), sample.value)).collect()
}

#[test]
fn landmarks_are_seen_or_not_and_those_out_of_view_are_left_out() {
    let expected =
        |states: &[(&str, f64)]| states.iter().map(|(state, value)| ((*state).to_owned(), *value)).collect::<Vec<_>>();
    assert_eq!(values(&sighting("a", &["2"], &["3"])), expected(&[("landmark/a/1", 0.0), ("landmark/a/2", 1.0)]));
    assert_eq!(values(&sighting("a", &[], &["1", "2", "3"])), expected(&[]));
}

#[test]
fn only_the_part_that_was_travelled_is_missed_and_what_is_seen_beyond_counts() {
    let part = PartOfEdge { from_m: 4.0, to_m: 6.0 };
    let partial = |seen: &[&str]| values(&Sighting { part, ..sighting("a/b", seen, &[]) });
    assert_eq!(partial(&[]), [("landmark/a/b/p5".to_owned(), 0.0)]);
    assert_eq!(partial(&["p8"]), [("landmark/a/b/p5".to_owned(), 0.0), ("landmark/a/b/p8".to_owned(), 1.0)]);
}

#[test]
fn a_traversal_is_observed_with_it() {
    let edge = EdgeName::parse("a/b").expect("an edge");
    let traversal = Traversal { edge, start_nanos: 5, end_nanos: 5_000_000_005, success: true, reason: String::new() };
    let with = Sighting { traversal: Some(traversal.clone()), ..sighting("a/b", &["p2", "p5", "p8"], &[]) };
    let samples = with.samples(&site()).expect("valid");
    let of_edge: Vec<_> =
        samples.iter().skip(3).map(|sample| (sample.state.as_str(), sample.time_nanos, sample.value)).collect();
    assert_eq!(of_edge, [("edge/a/b", 5, 1.0), ("speed/a/b", 5, 2.0)]);
    let other = Sighting { traversal: Some(traversal), ..sighting("b/a", &[], &[]) };
    assert!(other.samples(&site()).is_err());
    let of_node = Sighting { place: place("a"), ..with };
    assert!(matches!(of_node.samples(&site()), Err(SightingError::Landmark(_) | SightingError::OtherEdge { .. })));
}

#[test]
fn an_error_names_what_is_wrong() {
    for (wrong, words) in [
        (sighting("c", &[], &[]), "\"c\""),
        (sighting("b", &[], &[]), "\"b\" has no landmarks"),
        (sighting("a", &["9"], &[]), "\"a\" has no landmark \"9\""),
        (sighting("a", &[], &["9"]), "\"a\" has no landmark \"9\""),
        (sighting("a", &["1", "1"], &[]), "\"1\" is named twice"),
        (sighting("a", &["1"], &["1"]), "\"1\" is named twice"),
        (Sighting { time_nanos: -1, ..sighting("a", &[], &[]) }, "before 1970"),
        (Sighting { part: PartOfEdge { from_m: 0.0, to_m: 1.0 }, ..sighting("a", &[], &[]) }, "only an edge has parts"),
        (Sighting { part: PartOfEdge { from_m: 3.0, to_m: f64::NAN }, ..sighting("a/b", &[], &[]) }, "3 m to NaN m"),
    ] {
        let message = wrong.samples(&site()).expect_err("wrong").to_string();
        assert!(message.contains(words), "{message}");
    }
}

#[test]
fn the_size_of_a_report_covers_its_observations() {
    let edge = EdgeName::new("a", "b", "").expect("valid");
    let traversal = Traversal { edge, start_nanos: 5, end_nanos: 15, success: true, reason: "late".to_owned() };
    let name = crate::name::TaskName::new("clean", "a").expect("valid");
    let run = crate::task::TaskRun {
        name,
        start_nanos: 5,
        end_nanos: 9,
        success: false,
        intervention: false,
        reason: "stuck".to_owned(),
    };
    let with_traversal = Sighting { traversal: Some(traversal.clone()), ..sighting("a/b", &["p2"], &[]) };
    for report in [
        Report::Sighting(sighting("a", &["1"], &["2"])),
        Report::Sighting(with_traversal),
        Report::Traversal(traversal),
        Report::TaskRun(run),
    ] {
        let samples = report.samples(&site()).expect("valid");
        // The minimum is the record of an observation: its state's name, its time and its value.
        let least: usize = samples.iter().map(|sample| sample.state.as_str().len() + 16).sum();
        let bytes = report.log_bytes(&site());
        assert!((least..10 * least).contains(&bytes), "{report:?}: {bytes} bytes for {least}");
    }
}
