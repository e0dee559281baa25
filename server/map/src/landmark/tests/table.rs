//! The table of landmarks.

use nalgebra::Isometry3;

use super::super::*;
use crate::{
    name::{PlaceName, StateName},
    site::{Site, SiteEdit},
    topology::{EdgeEnds, Extent, NewEdge, NewNode, TopologyEdit},
};

fn name(text: &str) -> StateName {
    StateName::new(text).expect("a name")
}

fn place(text: &str) -> PlaceName {
    PlaceName::parse(text).expect("a place")
}

fn feature(byte: u8) -> ImageFeature {
    ImageFeature { u_px: 3.0, v_px: 4.0, descriptor: Descriptor::new(&[byte; 32]).expect("a descriptor") }
}

fn image(text: &str, byte: u8) -> Landmark {
    Landmark { name: name(text), kind: LandmarkKind::Image(feature(byte)), covariance: None }
}

fn path(text: &str, along_m: f64) -> Landmark {
    Landmark { name: name(text), kind: LandmarkKind::Path { along_m, feature: feature(1) }, covariance: None }
}

fn added(at: &str, landmarks: Vec<Landmark>) -> LandmarkEdit {
    LandmarkEdit::Add { place: place(at), descriptor_kind: "grief".to_owned(), landmarks, velocity_profile: None }
}

/// A site with the nodes a and b and edges both ways.
fn site() -> Site {
    let node = |text| NewNode { name: name(text), pose: None, dwell_secs: None };
    let edge = NewEdge { ends: EdgeEnds::link(name("a"), name("b")), extent: Extent::metres(5.0) };
    let load = TopologyEdit::Load { nodes: ["a", "b"].map(node).to_vec(), edges: vec![edge], replaces: true };
    let mut site = Site::default();
    site.apply(&SiteEdit::Topology(load), 0).expect("valid");
    site
}

fn edit(site: &mut Site, edit: LandmarkEdit) -> Result<(), String> {
    site.apply(&SiteEdit::Landmarks(edit), 0).map_err(|error| error.to_string())
}

fn names(site: &Site, at: &str) -> Vec<String> {
    let at = site.topology().place(&place(at)).expect("known");
    let landmarks = site.landmarks().at(at).map_or(&[][..], |known| known.landmarks());
    landmarks.iter().map(|landmark| landmark.name.to_string()).collect()
}

#[test]
fn added_landmarks_keep_their_order_and_replaced_ones_their_place() {
    let mut site = site();
    edit(&mut site, added("a", vec![image("one", 1), image("two", 2)])).expect("valid");
    edit(&mut site, added("a", vec![image("three", 3), image("one", 9)])).expect("valid");
    assert_eq!(names(&site, "a"), ["one", "two", "three"]);
    assert_eq!(site.landmarks().len(), 3);
    let at = site.topology().place(&place("a")).expect("known");
    let replaced = site.landmarks().at(at).and_then(|known| known.landmarks()[0].kind.feature().copied());
    assert_eq!(replaced, Some(feature(9)));
    edit(&mut site, LandmarkEdit::Remove { place: place("a"), names: vec![name("two")] }).expect("valid");
    assert_eq!((names(&site, "a"), site.landmarks().len()), (vec!["one".to_owned(), "three".to_owned()], 2));
}

#[test]
fn descriptors_of_one_map_are_of_one_kind_and_length_until_it_has_no_landmark() {
    let mut site = site();
    let other = LandmarkEdit::Add {
        place: place("b"),
        descriptor_kind: "orb".to_owned(),
        landmarks: vec![image("x", 1)],
        velocity_profile: None,
    };
    edit(&mut site, added("a", vec![image("one", 1)])).expect("valid");
    let refused = edit(&mut site, other.clone()).expect_err("another kind");
    assert_eq!(refused, "the map's descriptors are \"grief\", not \"orb\": descriptors of one map are of one kind");
    let short = ImageFeature { descriptor: Descriptor::new(&[1; 16]).expect("a descriptor"), ..feature(1) };
    let short = Landmark { kind: LandmarkKind::Image(short), ..image("short", 1) };
    let refused = edit(&mut site, added("a", vec![short])).expect_err("another length");
    assert_eq!(refused, "a descriptor has 16 bytes, and those of the map have 32");
    edit(&mut site, LandmarkEdit::Remove { place: place("a"), names: vec![name("one")] }).expect("valid");
    edit(&mut site, other).expect("nothing is left of the kind before");
}

#[test]
fn what_is_wrong_changes_nothing_and_is_an_error() {
    let mut site = site();
    edit(&mut site, added("a", vec![image("one", 1)])).expect("valid");
    let before = site.clone();
    let pixel = ImageFeature { u_px: f64::NAN, ..feature(1) };
    let nan = Landmark { kind: LandmarkKind::Image(pixel), ..image("nan", 1) };
    let covariance = Landmark { covariance: Some([1.0].into()), ..image("cov", 1) };
    let pose = Box::new(Isometry3::identity());
    let marker = Landmark { kind: LandmarkKind::Marker { number: 7, pose }, ..covariance.clone() };
    let profile = |at: &str, bytes: usize| LandmarkEdit::Add {
        place: place(at),
        descriptor_kind: String::new(),
        landmarks: Vec::new(),
        velocity_profile: Some(vec![0; bytes].into()),
    };
    for (wrong, words) in [
        (added("c", vec![image("x", 1)]), "\"c\""),
        (added("a", vec![image("x", 1), image("x", 2)]), "\"x\" is given twice"),
        (added("a", vec![path("x", 1.0)]), "along_m"),
        (added("a/b", vec![image("x", 1)]), "along_m"),
        (added("a/b", vec![path("x", -1.0)]), "-1 m"),
        (added("a", vec![nan]), "NaN px"),
        (added("a", vec![covariance]), "3 finite numbers"),
        (added("a", vec![marker]), "21 finite numbers"),
        (profile("a", 1), "velocity profile"),
        (profile("a/b", PROFILE_BYTES_MAX + 1), "65537 bytes"),
        (LandmarkEdit::Remove { place: place("a"), names: vec![name("z")] }, "\"a\" has no landmark \"z\""),
        (LandmarkEdit::Remove { place: place("b"), names: vec![name("z")] }, "\"b\" has no landmarks"),
        (added("a", (0..LANDMARKS_AT_PLACE_MAX).map(|n| image(&n.to_string(), 1)).collect()), "more than 4096"),
    ] {
        let message = edit(&mut site, wrong).expect_err("wrong");
        assert!(message.contains(words), "{message}");
        assert_eq!(site, before);
    }
}

#[test]
fn landmarks_go_with_their_place() {
    let mut site = site();
    edit(&mut site, added("a", vec![image("one", 1)])).expect("valid");
    edit(&mut site, added("a/b", vec![path("p", 2.0)])).expect("valid");
    let rename = TopologyEdit::RenameNode { from: name("a"), to: name("hall") };
    site.apply(&SiteEdit::Topology(rename), 0).expect("valid");
    assert_eq!((names(&site, "hall"), names(&site, "hall/b")), (vec!["one".to_owned()], vec!["p".to_owned()]));
    site.apply(&SiteEdit::Topology(TopologyEdit::RemoveNode(name("b"))), 0).expect("valid");
    assert_eq!(site.landmarks().len(), 1);
    site.apply(&SiteEdit::Topology(TopologyEdit::RemoveNode(name("hall"))), 0).expect("valid");
    assert!(site.landmarks().is_empty());
    assert_eq!(site.landmarks().descriptor_kind(), None);
}

#[test]
fn parts_come_back() {
    let mut site = site();
    edit(&mut site, added("a", vec![image("one", 1), image("two", 2)])).expect("valid");
    edit(&mut site, added("a/b", vec![path("p", 2.0)])).expect("valid");
    let parts: Vec<_> = site.landmarks().places().collect();
    let parts = parts
        .into_iter()
        .map(|(at, known)| (at, known.landmarks().to_vec(), known.velocity_profile().into()))
        .collect::<Vec<_>>();
    let kind = site.landmarks().descriptor_kind().cloned();
    assert_eq!(
        Landmarks::from_parts(site.topology(), kind.clone(), parts.clone()),
        Ok(site.landmarks().as_ref().clone())
    );
    let twice = [parts.clone(), parts].concat();
    assert!(Landmarks::from_parts(site.topology(), kind, twice).is_err());
}

#[test]
fn a_velocity_profile_stays_without_landmarks_until_it_is_cleared() {
    let mut site = site();
    let profile = |bytes: &[u8]| LandmarkEdit::Add {
        place: place("a/b"),
        descriptor_kind: String::new(),
        landmarks: Vec::new(),
        velocity_profile: Some(bytes.into()),
    };
    edit(&mut site, added("a/b", vec![path("p", 2.0)])).expect("valid");
    edit(&mut site, profile(&[1, 2])).expect("valid");
    edit(&mut site, LandmarkEdit::Remove { place: place("a/b"), names: vec![name("p")] }).expect("valid");
    let at = site.topology().place(&place("a/b")).expect("known");
    assert_eq!(site.landmarks().at(at).map(|known| known.velocity_profile().to_vec()), Some(vec![1, 2]));
    edit(&mut site, profile(&[])).expect("valid");
    assert!(site.landmarks().is_empty());
    assert_eq!(site.landmarks().descriptor_kind(), None);
}
