//! Landmarks are read as they were written: from the log, a checkpoint and the index.

use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use prost::Message as _;
use tidemap_layout::landmark::LandmarksAtPlace;
use tidemap_map::{
    event::Event,
    landmark::{Descriptor, ImageFeature, Landmark, LandmarkEdit, LandmarkKind},
    name::{PlaceName, StateName},
    site::{Site, SiteEdit},
    snapshot::MapSnapshot,
    topology::{EdgeEnds, Extent, NewEdge, NewNode, TopologyEdit},
};

use super::example::{append, options, snapshot, spec, spoiled};
use crate::{
    MapId, Source, Store,
    record::{self, tables},
};

fn name(text: &str) -> StateName {
    StateName::new(text).expect("valid")
}

fn feature(seed: u8) -> ImageFeature {
    let descriptor = Descriptor::new(&[seed, 2, 3, seed]).expect("valid");
    ImageFeature { u_px: f64::from(seed) + 0.1, v_px: -7.5, descriptor }
}

pub(super) fn edits() -> Vec<SiteEdit> {
    let node = |text| NewNode { name: name(text), pose: None, dwell_secs: None };
    let edge = NewEdge { ends: EdgeEnds::link(name("a"), name("b")), extent: Extent::metres(5.0) };
    let load = TopologyEdit::Load { nodes: ["a", "b"].map(node).to_vec(), edges: vec![edge], replaces: true };
    let pose =
        Isometry3::from_parts(Translation3::new(0.1, -0.2, 3.0), UnitQuaternion::from_euler_angles(0.3, 0.2, 0.1));
    let marker = LandmarkKind::Marker { number: u64::MAX, pose: Box::new(pose) };
    let landmark = |text: &str, kind, covariance: &[f64]| Landmark {
        name: name(text),
        kind,
        covariance: (!covariance.is_empty()).then(|| covariance.into()),
    };
    let add = |place: &str, landmarks, profile: Option<&[u8]>| {
        SiteEdit::Landmarks(LandmarkEdit::Add {
            place: PlaceName::parse(place).expect("valid"),
            descriptor_kind: "grief-4".to_owned(),
            landmarks,
            velocity_profile: profile.map(Into::into),
        })
    };
    let path = |along_m| LandmarkKind::Path { along_m, feature: feature(9) };
    let remove = LandmarkEdit::Remove { place: PlaceName::parse("a").expect("valid"), names: vec![name("gone")] };
    vec![
        SiteEdit::Topology(load),
        add("a", vec![landmark("one", LandmarkKind::Image(feature(1)), &[0.5, -0.0, 2.0])], None),
        add(
            "a",
            vec![landmark("m", marker, &[0.25; 21]), landmark("gone", LandmarkKind::Image(feature(2)), &[])],
            None,
        ),
        add("a/b", vec![landmark("p", path(0.1), &[]), landmark("q", path(4.9), &[])], Some(&[1, 2, 3])),
        SiteEdit::Landmarks(remove),
    ]
}

fn with_site(snapshot: MapSnapshot, edits: &[SiteEdit]) -> MapSnapshot {
    let mut site = Site::default();
    edits.iter().for_each(|edit| site.apply(edit, 0).expect("valid"));
    MapSnapshot { site: Arc::new(site), ..snapshot }
}

#[test]
fn edits_come_back_and_keep_their_bytes() {
    let mut crc = 0;
    for edit in edits() {
        let event = Event::EditSite(edit);
        let (kind, payload) = record::event::encode(&event).expect("valid");
        assert_eq!(record::event::decode(kind, &payload).expect("readable"), event);
        crc = crc32c::crc32c_append(crc, &payload);
    }
    let whole = with_site(snapshot(&spec("map"), 3, 2), &edits());
    for row in tables::rows(&whole.site) {
        crc = crc32c::crc32c_append(crc, &row.encode_to_vec());
    }
    // A difference means that existing data folders cannot be read any more.
    assert_eq!(crc, 0xFB2D_A54B, "{crc:#X}");
}

#[test]
fn checkpoint_and_index_have_the_landmarks_of_their_generation() {
    let (directory, spec) = (tempfile::tempdir().expect("temporary directory"), spec("map"));
    let edits = edits();
    let numbered = |position| with_site(snapshot(&spec, position, 2), &edits[..position as usize]);
    {
        let store = Store::open(directory.path(), options()).expect("opens");
        assert_eq!(store.create_map(&spec).expect("creates"), MapId(1));
        let log = store.open_map(MapId(1), &spec).expect("opens").log;
        for (position, edit) in (1..).zip(&edits) {
            append(&log, &Event::EditSite(edit.clone())).expect("appends");
            let saved = numbered(position);
            store.save(MapId(1), &saved).expect("saves");
            let published = store.published(MapId(1), &spec).expect("whole");
            assert_eq!(published.site, saved.site, "the index at {position}");
        }
    }
    let store = Store::open(directory.path(), options()).expect("opens");
    assert_eq!(store.published(MapId(1), &spec).expect("whole").site, numbered(5).site);
    let opened = store.open_map(MapId(1), &spec).expect("opens");
    assert_eq!(
        (opened.source, opened.snapshot.map(|snapshot| snapshot.site)),
        (Source::Checkpoint, Some(numbered(5).site))
    );
    // Places that are gone leave no rows behind.
    let empty = MapSnapshot { position: 5, ..numbered(1) };
    store.save(MapId(1), &empty).expect("saves");
    assert_eq!(store.published(MapId(1), &spec).expect("whole").site, empty.site);
}

#[test]
fn what_breaks_a_rule_of_the_table_is_refused() {
    let whole = with_site(snapshot(&spec("map"), 3, 2), &edits());
    let rows: Vec<_> = tables::rows(&whole.site).collect();
    assert_eq!(tables::site(&rows, 2).expect("readable"), *whole.site);
    let first = rows.iter().position(|row| row.table == 8).expect("landmarks");
    type Spoil = fn(&mut LandmarksAtPlace);
    let spoil: [(usize, Spoil); 5] = [
        (0, |place| place.node = Some(99)),
        (0, |place| place.edge = Some(0)),
        (1, |place| place.landmarks[0].along_bits = None),
        (0, |place| place.landmarks[0].marker = place.landmarks[1].marker.clone()),
        (0, |place| place.landmarks[1].marker.as_mut().expect("a marker").pose_bits.truncate(6)),
    ];
    for (number, (place, spoil)) in spoil.into_iter().enumerate() {
        assert!(tables::site(&spoiled(&rows, first + place, spoil), 2).is_err(), "{number}");
    }
}
