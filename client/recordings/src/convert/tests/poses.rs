//! Poses of topics in place of transforms.

use super::*;
use crate::{plan::PlanError, survey::PoseSource};

const ODOM: &str = "nav_msgs/Odometry";
const POSE: &str = "geometry_msgs/PoseStamped";
const POSE_COVARIANCE: &str = "geometry_msgs/PoseWithCovarianceStamped";

/// A pose at x that looks along y, in a message of one of the types.
fn pose(type_name: &str, stamp: i64, (parent, child): (&str, &str), x: f64) -> Vec<u8> {
    let cdr = Cdr::header(stamp, parent);
    let cdr = if type_name == ODOM { cdr.text(child) } else { cdr };
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let cdr = cdr.doubles([x, 0.0, 0.0, 0.0, 0.0, half, half]);
    if type_name == POSE { cdr.0 } else { cdr.doubles([0.0; 36 + 6 + 36]).0 }
}

/// A scan in the second 1.5, of a robot that is at x = 1 at second 1 and at x = 2 at second 2. Its sensor is half a
/// metre in front of its body, unless the recording has no transforms.
fn recorded(type_name: &'static str, frames: (&str, &str), has_transforms: bool) -> Recorded {
    let at = |second: i64, x| ("/pose", type_name, second * SECOND, pose(type_name, second * SECOND, frames, x));
    let ranges = [3.0];
    let stamp = SECOND * 3 / 2;
    let scan = ScanText { stamp, frame: "laser", increments: [0.0; 2], limits: [0.1, 10.0], ranges: &ranges };
    let mut recorded = vec![at(1, 1.0), at(2, 2.0), ("/scan", SCAN, stamp, scan.bytes())];
    if has_transforms {
        // Wheels that turn on the spot: the transform that the poses replace.
        for second in [1, 2] {
            let stamp = second * SECOND;
            recorded.push(("/tf", TF, stamp, transform(stamp, ("odom", "base"), [0.0; 3])));
        }
        recorded.push(("/tf_static", TF, SECOND, transform(SECOND, ("base", "laser"), [0.5, 0.0, 0.0])));
    }
    recorded
}

fn wishes(source: &str) -> Wishes {
    Wishes { pose_from: Some(PoseSource::read(source)), ..Wishes::default() }
}

#[test]
fn poses_of_each_type_place_a_scan() {
    for (type_name, child, source, has_transforms, y) in [
        (ODOM, "base", "/pose", true, 3.5),
        (ODOM, "", "/pose", true, 3.5),
        (ODOM, "/base", "/pose", true, 3.5),
        (POSE, "", "/pose", true, 3.5),
        (POSE_COVARIANCE, "", "/pose", true, 3.5),
        (POSE, "", "/pose=/laser", true, 3.0),
        (POSE, "", "/pose", false, 3.0),
        (ODOM, "laser", "/pose", false, 3.0),
    ] {
        let result = converted(
            &recorded(type_name, ("odom", child), has_transforms),
            &wishes(source),
            ConvertOptions::default(),
        );
        let scans: Vec<_> =
            result.made.iter().filter(|item| !matches!(item, Ok(Item { made: Made::Position { .. }, .. }))).collect();
        assert_eq!(scans.len(), 1);
        let end = ends(scans[0])[0];
        assert!((end.x - 1.5).abs() < 1e-6 && (end.y - y).abs() < 1e-6, "{type_name} {child:?} {source}: {end}");
    }
}

#[test]
fn a_topic_that_gives_no_poses_is_an_error_with_those_that_do() {
    let error = |recorded: &Recorded, source: &str| {
        let topics = topics(recorded);
        let mut survey = Survey::default();
        survey.take_poses(PoseSource::read(source));
        for topic in &topics {
            survey.topic(topic);
        }
        for (position, (name, _, recorded_nanos, data)) in (0..).zip(recorded) {
            let topic = topics.iter().position(|topic| topic.name == *name).unwrap();
            survey.message(RecordedMessage { topic, recorded_nanos: *recorded_nanos, data }, position).unwrap();
        }
        match plan(&survey.finish(), &wishes(source)) {
            Err(error @ PlanError::NoPoses { .. }) => error.to_string(),
            other => panic!("{other:?}"),
        }
    };
    let with = recorded(ODOM, ("odom", "base"), true);
    assert_eq!(
        error(&with, "/odom"),
        "the recording has no topic \"/odom\" to take poses from; topics with poses are /pose"
    );
    let wrong = error(&with, "/scan");
    assert!(wrong.contains("/scan has messages of sensor_msgs/LaserScan, which are no poses: poses are nav_msgs/Odom"));
    assert!(wrong.ends_with("topics with poses are /pose"), "{wrong}");
    let without = recorded(ODOM, ("", "base"), true);
    assert_eq!(
        error(&without, "/pose"),
        "no pose can be taken from /pose: the pose names no frame in its header; no other topic of the recording has \
         poses"
    );
}
