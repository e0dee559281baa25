//! Recordings of real robots, as an independent program has counted them.
//!
//! Invariant: the recordings lie beside the repository; without them the tests are skipped and print so.

use tidemap_tests::{daemon::Daemon, recordings};

use super::{counts, started, words};

#[track_caller]
fn imported(daemon: &Daemon, map: &str, file: &str, topics: &[(&str, [u64; 3])], code: i32) -> String {
    let Some(bags) = recordings::folder("bags") else { return String::new() };
    // The reference has one pose a scan, at its stamp.
    let outcome = words(daemon, &format!("import {map} {}/{file} --producer robot-1 --at-stamp", bags.display()));
    let table = outcome.table_with(code);
    for (topic, wanted) in topics {
        assert_eq!(counts(&table, topic), *wanted, "{file} {topic}: {}", outcome.stderr);
    }
    outcome.stderr
}

#[test]
fn real_recordings_become_what_is_in_them() {
    if recordings::folder("bags").is_none() {
        return;
    }
    let (_folder, daemon) = started();
    let jarvis = [
        ("/driver_laser_navigation/laser_scan", [204, 0, 0]),
        ("/driver_laser_security/laser_scan", [212, 1, 0]),
        ("/pose_ground_truth", [204, 0, 0]),
    ];
    let printed = imported(&daemon, "jarvis", "jarvis.bag", &jarvis, 0);
    assert!(printed.contains("frame \"map\""), "{printed}");
    imported(&daemon, "jarvis2", "jarvis_zstd", &jarvis, 0);
    let cut =
        [("/driver_laser_navigation/laser_scan", [108, 0, 0]), ("/driver_laser_security/laser_scan", [111, 2, 0])];
    let printed = imported(&daemon, "cut", "jarvis-cut.bag", &cut, 0);
    assert!(printed.contains("jarvis-cut.bag: "), "{printed}");
    let tilt = [("/guardian/laser_tilt_front", [415, 6, 0]), ("/guardian/laser_horizontal_back", [413, 5, 0])];
    imported(&daemon, "tilt", "guardian-tilt.bag", &tilt, 0);
    let simulated = [("/scan", [134, 0, 0]), ("/odom", [788, 0, 0])];
    let printed = imported(&daemon, "simulated", "turtlebot3", &simulated, 0);
    assert!(printed.contains("before 1990"), "{printed}");
}

#[test]
fn a_scan_of_which_beams_come_after_the_last_transform_has_no_place() {
    let Some(bags) = recordings::folder("bags") else { return };
    let (_folder, daemon) = started();
    let outcome = words(&daemon, &format!("import jarvis {}/jarvis.bag --producer robot-1", bags.display()));
    // The last two of the 204 scans take longer than the transforms last.
    assert_eq!(counts(&outcome.table(), "/driver_laser_navigation/laser_scan"), [202, 2, 0], "{}", outcome.stderr);
    for words in ["laser_scan: 980 of 293760 beams have no return, and hit nothing", "after the last transform"] {
        assert!(outcome.stderr.contains(words), "{}", outcome.stderr);
    }
}

#[test]
fn poses_of_which_some_are_not_finite_are_refused_one_by_one() {
    if recordings::folder("bags").is_none() {
        return;
    }
    let (_folder, daemon) = started();
    let poses = [
        ("/cf_controll", [28, 0, 209]),
        ("/cf_logerr", [28, 0, 209]),
        ("/cf_logpos", [0, 0, 236]),
        ("/vicon/Group466CF/Group466CF/pose", [2359, 0, 0]),
    ];
    let printed = imported(&daemon, "crazyflie", "crazyflie-nan", &poses, 1);
    assert!(printed.contains("is not finite"), "{printed}");
    let printed = imported(&daemon, "zeros", "zeros.bag", &[("/occupancygrid", [0, 0, 1])], 1);
    assert!(printed.contains("the resolution must be above 0"), "{printed}");
}

#[test]
fn recordings_with_nothing_to_take_or_of_an_old_version_are_refused_with_the_reason() {
    let Some(bags) = recordings::folder("bags") else { return };
    let (_folder, daemon) = started();
    let bags = bags.display();
    let turtles = words(&daemon, &format!("import turtles {bags}/turtlesim-lz4.bag"));
    turtles.fails(1, &["no observations can be made from these recordings"]);
    let mumble = words(&daemon, &format!("import mumble {bags}/mumble"));
    assert_eq!(counts(&mumble.table_with(1), "/scan"), [0, 508, 0]);
    mumble.fails(1, &["--frame laser_frame", "none of these messages has a place"]);
    words(&daemon, &format!("import old {bags}/rosrecord-1.2.bag")).fails(1, &["ROSRECORD V1.2"]);
}
