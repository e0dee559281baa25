//! Plans for recordings with the usual topics.

use nalgebra::Isometry3;

use super::*;
use crate::{frames::Transform, layout, recording::Encoding};

type Outcome = Result<(), Box<dyn std::error::Error>>;

fn topic(name: &str, type_name: &str, frame: &str) -> TopicSurvey {
    TopicSurvey {
        name: name.to_owned(),
        type_name: type_name.to_owned(),
        messages: 3,
        recorded: None,
        stamps: None,
        frame: frame.to_owned(),
        unread: 0,
        problem: None,
        layout: layout::of_type(type_name, "", &Encoding::Cdr).ok(),
        grid: None,
    }
}

fn surveyed(topics: Vec<TopicSurvey>, links: &[(&str, &str)]) -> Surveyed {
    let mut surveyed = Surveyed { topics, ..Surveyed::default() };
    for (parent, child) in links {
        let pose = Isometry3::identity();
        let transform = Transform { parent: (*parent).to_owned(), child: (*child).to_owned(), time_nanos: 0, pose };
        assert_eq!(surveyed.frames.add(transform, true), Ok(()));
    }
    surveyed
}

fn becomes(surveyed: &Surveyed, wishes: &Wishes) -> Result<Vec<String>, PlanError> {
    Ok(plan(surveyed, wishes)?.topics.iter().map(TopicPlan::becomes).collect())
}

#[test]
fn each_usual_type_becomes_what_it_is() -> Outcome {
    let topics = vec![
        topic("/scan", "sensor_msgs/LaserScan", "laser"),
        topic("/map", "nav_msgs/OccupancyGrid", "map"),
        topic("/local_costmap/costmap", "nav_msgs/OccupancyGrid", "map"),
        topic("/kitchen/door", "std_msgs/Bool", ""),
        topic("/door_states", "rmf_door_msgs/DoorState", ""),
        topic("/odom", "nav_msgs/Odometry", "odom"),
        topic("/people", "people_msgs/People", "map"),
        topic("/tf", "tf2_msgs/TFMessage", ""),
        topic("/rosout", "rosgraph_msgs/Log", ""),
    ];
    let mut surveyed = surveyed(topics, &[("base", "laser")]);
    let pose = Isometry3::identity();
    let transform = Transform { parent: "odom".to_owned(), child: "base".to_owned(), time_nanos: 0, pose };
    assert_eq!(surveyed.frames.add(transform, false), Ok(()));
    let nothing = "nothing";
    let usual = [
        "scans",
        nothing,
        nothing,
        "state kitchen-door",
        "state {door_name}",
        "positions odom",
        "positions person",
        "frames",
        nothing,
    ];
    assert_eq!(becomes(&surveyed, &Wishes::default())?, usual);
    let plan_made = plan(&surveyed, &Wishes::default())?;
    assert_eq!((plan_made.frame.as_deref(), plan_made.choice), (Some("odom"), FrameChoice::Usual));
    let why = |index: usize| plan_made.topics[index].skipped.clone().unwrap_or_default();
    assert!(why(1).contains("scans are taken") && why(2).contains("costs") && why(8).contains("without a mapping"));
    let mapping = Mapping::read("grid: [/map]\nskip: [/scan]\nstates: {/kitchen/door.data: door}")?;
    let wishes = Wishes { mapping, topics: vec!["/map".to_owned(), "/kitchen/door".to_owned()], ..Wishes::default() };
    assert_eq!(becomes(&surveyed, &wishes)?[..4], [nothing, "grids", nothing, "state door"]);
    Ok(())
}

#[test]
fn changes_go_with_the_grids_that_they_change() -> Outcome {
    let grids = topic("/map", "nav_msgs/OccupancyGrid", "map");
    let changes = topic("/map_updates", "map_msgs/OccupancyGridUpdate", "map");
    let both = surveyed(vec![changes.clone(), grids], &[]);
    let plan_made = plan(&both, &Wishes::default())?;
    assert_eq!(plan_made.topics[0].grid, Some(GridUse::GridChanges(1)));
    assert_eq!((plan_made.frame.as_deref(), plan_made.choice), (Some("map"), FrameChoice::OfMessages));
    let alone = plan(&surveyed(vec![changes], &[]), &Wishes::default())?;
    assert!(alone.topics[0].skipped.as_ref().is_some_and(|why| why.contains("/map")));
    Ok(())
}

#[test]
fn a_frame_is_found_or_asked_for() -> Outcome {
    let scan = || vec![topic("/scan", "sensor_msgs/LaserScan", "laser")];
    let chosen = |surveyed: &Surveyed, frame: Option<&str>| {
        let wishes = Wishes { frame: frame.map(str::to_owned), ..Wishes::default() };
        plan(surveyed, &wishes).map(|plan| (plan.frame, plan.choice))
    };
    let some = |frame: &str, choice| Ok((Some(frame.to_owned()), choice));
    let without = surveyed(scan(), &[]);
    assert_eq!(chosen(&without, None), Ok((None, FrameChoice::None)), "a sensor of which nothing is known moves");
    assert_eq!(chosen(&without, Some("/laser")), some("laser", FrameChoice::Requested));
    let fixed = surveyed(scan(), &[("base", "laser")]);
    assert_eq!(chosen(&fixed, None), Ok((None, FrameChoice::None)), "where the robot was is not known");
    let mut above = surveyed(scan(), &[]);
    let pose = Isometry3::identity();
    let transform = Transform { parent: "cloud".to_owned(), child: "laser".to_owned(), time_nanos: 0, pose };
    assert_eq!(above.frames.add(transform, false), Ok(()));
    assert_eq!(chosen(&above, None), some("cloud", FrameChoice::Root));
    let below = surveyed(scan(), &[("odom", "map"), ("odom", "base"), ("base", "laser"), ("odom", "map")]);
    assert_eq!(chosen(&below, None), some("map", FrameChoice::Usual), "map below odom");
    let error = chosen(&below, Some("mop")).err().map(|error| error.to_string());
    assert!(error.is_some_and(|error| error.contains("base, laser, map, odom")));
    Ok(())
}

#[test]
fn a_mapping_that_does_not_go_with_the_recording_is_refused() -> Outcome {
    let surveyed =
        surveyed(vec![topic("/people", "people_msgs/People", "map"), topic("/on", "std_msgs/Bool", "")], &[]);
    for (text, words) in [
        ("states: {/door.data: door}", "no topic \"/door\"; it has /people, /on"),
        ("states: {/on.date: door}", "no field \"date\"; it has data"),
        ("states: {'/on.data[]': door}", "no array"),
        ("states: {'/people.people.name': door}", "such as people[0]"),
        ("positions: {'/people.people[].place': person}", "no field \"place\""),
        ("skip: [/off]", "no topic \"/off\""),
    ] {
        let wishes = Wishes { mapping: Mapping::read(text)?, ..Wishes::default() };
        let error = plan(&surveyed, &wishes).err().map(|error| error.to_string());
        assert!(error.as_ref().is_some_and(|error| error.contains(words)), "{text}: {error:?}");
    }
    let each = Mapping::read(
        "states: {'/people.people[].reliability': 'seen-{name}', /people.people: {state: crowd, kind: count}}",
    )?;
    let wishes = Wishes { mapping: each, ..Wishes::default() };
    assert_eq!(becomes(&surveyed, &wishes)?[0], "state crowd, state seen-{name}");
    Ok(())
}
