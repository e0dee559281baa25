//! Poses by transforms that were written here.

use std::f64::consts::FRAC_PI_2;

use proptest::prelude::*;

use super::*;

const CENTISECOND: i64 = 10_000_000;

fn turned(x: f64, yaw: f64) -> Isometry3<f64> {
    Isometry3::new(Vector3::new(x, 0.0, 0.0), Vector3::z() * yaw)
}

fn add(frames: &mut Frames, parent: &str, child: &str, time_nanos: i64, pose: Isometry3<f64>, is_static: bool) {
    let transform = Transform { parent: parent.to_owned(), child: child.to_owned(), time_nanos, pose };
    assert_eq!(frames.add(transform, is_static), Ok(()));
}

#[test]
fn a_transform_is_interpolated_between_its_samples_and_holds_nowhere_else() -> Result<(), FrameError> {
    let mut frames = Frames::default();
    add(&mut frames, "odom", "base", 200 * CENTISECOND, turned(2.0, FRAC_PI_2), false);
    add(&mut frames, "odom", "base", 100 * CENTISECOND, turned(1.0, 0.0), false);
    add(&mut frames, "base", "laser", 0, turned(0.5, 0.0), true);
    frames.finish();
    let half = frames.pose("base", "odom", 150 * CENTISECOND)?;
    assert!((half.translation.x - 1.5).abs() < 1e-12 && (half.rotation.angle() - FRAC_PI_2 / 2.0).abs() < 1e-12);
    let laser = frames.pose("laser", "odom", 200 * CENTISECOND)?;
    assert!((laser.translation.vector - Vector3::new(2.0, 0.5, 0.0)).norm() < 1e-12, "{laser}");
    assert!((frames.pose("odom", "laser", 200 * CENTISECOND)? * laser).translation.vector.norm() < 1e-12);
    let (parent, child) = ("odom".to_owned(), "base".to_owned());
    let before = FrameError::Before { parent: parent.clone(), child: child.clone() };
    assert_eq!(frames.pose("laser", "odom", 99 * CENTISECOND), Err(before));
    assert_eq!(frames.pose("laser", "odom", 201 * CENTISECOND), Err(FrameError::After { parent, child }));
    assert!(frames.pose("laser", "base", 999).is_ok(), "a static transform holds for all time");
    Ok(())
}

#[test]
fn frames_that_nothing_connects_are_named() {
    let mut frames = Frames::default();
    add(&mut frames, "map", "a", 0, turned(0.0, 0.0), true);
    add(&mut frames, "other", "b", 0, turned(0.0, 0.0), true);
    let not_connected = FrameError::NotConnected { frame: "a".to_owned(), within: "b".to_owned() };
    assert_eq!(frames.pose("a", "b", 0), Err(not_connected));
    assert_eq!(frames.pose("c", "b", 0), Err(FrameError::Unknown("c".to_owned())));
    assert!(frames.pose("c", "c", 0).is_ok(), "a frame within itself needs no transform");
}

#[test]
fn of_two_parents_the_one_with_more_transforms_counts_and_both_are_reported() {
    let mut frames = Frames::default();
    for time in 0..9 {
        add(&mut frames, "odom", "base", time, turned(1.0, 0.0), false);
        if time % 3 == 0 {
            add(&mut frames, "map", "base", time, turned(5.0, 0.0), false);
        }
    }
    frames.finish();
    assert!(frames.pose("base", "odom", 7).is_ok_and(|pose| pose.translation.x == 1.0));
    assert_eq!(frames.conflicts().collect::<Vec<_>>(), ["base"]);
    add(&mut frames, "base", "laser", 0, turned(0.0, 0.0), true);
    add(&mut frames, "base", "laser", 0, turned(0.5, 0.0), true);
    assert_eq!(frames.conflicts().collect::<Vec<_>>(), ["base", "laser"]);
    assert!(frames.moves("base") && !frames.moves("laser") && frames.connects("laser", "odom"));
}

#[test]
fn frames_in_a_circle_end() {
    let mut frames = Frames::default();
    add(&mut frames, "a", "b", 0, turned(1.0, 0.0), true);
    add(&mut frames, "b", "a", 0, turned(1.0, 0.0), true);
    assert!(frames.pose("a", "c", 0).is_err());
    assert!(frames.chain("a").len() <= 2);
}

proptest! {
    #[test]
    fn a_pose_and_its_inverse_cancel(x in -9.0..9.0f64, yaw in -3.0..3.0f64, time in 0..100i64) {
        let mut frames = Frames::default();
        add(&mut frames, "map", "odom", 0, turned(x, yaw), false);
        add(&mut frames, "map", "odom", 100 * CENTISECOND, turned(-x, -yaw / 3.0), false);
        add(&mut frames, "odom", "base", 0, turned(yaw, x / 9.0), true);
        let there = frames.pose("base", "map", time * CENTISECOND).map_err(|error| TestCaseError::fail(error.to_string()))?;
        let back = frames.pose("map", "base", time * CENTISECOND).map_err(|error| TestCaseError::fail(error.to_string()))?;
        prop_assert!((there * back).translation.vector.norm() < 1e-9);
        prop_assert!((there * back).rotation.angle() < 1e-7);
    }
}

#[test]
fn between_transforms_that_are_far_apart_and_differ_there_is_no_pose() {
    let mut frames = Frames::default();
    for (time, x) in [(0, 0.0), (3_600, 100.0), (7_200, 100.0), (7_202, 101.0)] {
        add(&mut frames, "odom", "base", time * 1_000_000_000, turned(x, 0.0), false);
    }
    frames.finish();
    let x = |frames: &Frames, time: i64| {
        frames
            .pose("base", "odom", time * 1_000_000_000)
            .map(|pose| pose.translation.x)
            .map_err(|error| error.to_string())
    };
    let words = "the transforms from \"odom\" to \"base\" before and after it are more than 2 s apart and differ; \
                 --transform-gap allows more";
    assert_eq!(x(&frames, 1_800), Err(words.to_owned()));
    assert_eq!(x(&frames, 3_600), Ok(100.0), "at a transform it is known");
    assert_eq!(x(&frames, 5_000), Ok(100.0), "what does not change is known however long it takes");
    assert_eq!(x(&frames, 7_201), Ok(100.5));
    frames.set_gap(3_600 * 1_000_000_000);
    assert_eq!(x(&frames, 1_800), Ok(50.0));
    frames.set_gap(0);
    assert!(x(&frames, 7_201).is_err_and(|error| error.contains("more than 0 s apart")));
}

fn drive(frames: &mut Frames, parent: &str, place: impl Fn(f64) -> Isometry3<f64>) {
    for step in 0..100 {
        add(frames, parent, "base", step * 100_000_000, place(step as f64 / 10.0), false);
    }
}

fn at_5_secs(frames: &Frames, within: &str) -> Result<f64, String> {
    let pose = frames.pose("base", within, 5_050_000_000);
    pose.map(|pose| pose.translation.x).map_err(|error| error.to_string())
}

#[test]
fn two_robots_with_the_same_frames_have_no_place() {
    // Each of the two publishes in turn, or both at the same times.
    for offset in [50_000_000, 0] {
        let mut frames = Frames::default();
        for step in 0..100 {
            let x = step as f64 / 100.0;
            add(&mut frames, "odom", "base", step * 100_000_000, turned(x, 0.0), false);
            add(&mut frames, "odom", "base", step * 100_000_000 + offset, turned(5.0 - x, 0.0), false);
        }
        frames.finish();
        assert!(at_5_secs(&frames, "odom").is_err_and(|why| why.contains("\"base\" jumps to and fro in \"odom\"")));
        assert_eq!(frames.doubts().count(), 1);
    }
    let mut frames = Frames::default();
    drive(&mut frames, "one/odom", |secs| turned(secs, 0.0));
    drive(&mut frames, "two/odom", |secs| turned(3.0 - secs, 0.0));
    frames.finish();
    let why = at_5_secs(&frames, "one/odom");
    assert!(why.is_err_and(|why| why.contains("moves differently in \"one/odom\" and in \"two/odom\"")));
}

#[test]
fn one_robot_in_two_parents_or_with_a_corrected_place_keeps_its_place() {
    let mut frames = Frames::default();
    drive(&mut frames, "odom", |secs| turned(secs, secs / 9.0));
    // The position in the map is that of the odometry, turned, and corrected once by a metre.
    drive(&mut frames, "map", |secs| turned(if secs > 4.0 { 8.0 } else { 7.0 }, 1.0) * turned(secs, secs / 9.0));
    frames.finish();
    assert_eq!(frames.doubts().count(), 0);
    assert!(at_5_secs(&frames, "odom").is_ok_and(|x| (x - 5.05).abs() < 1e-9));
    let mut corrected = Frames::default();
    drive(&mut corrected, "map", |secs| turned(if secs > 5.0 { 20.0 } else { 0.0 }, 0.0));
    corrected.finish();
    assert_eq!(
        at_5_secs(&corrected, "map"),
        Err("the transforms from \"map\" to \"base\" jump from one place to another there".to_owned())
    );
    assert!(corrected.pose("base", "map", 5_150_000_000).is_ok());
}
